//! The reduction of a tetrahedral mesh: another field on another lattice, then the same way as a volume.
//!
//! ```text
//!  mesh ─▶ store (files) ─▶ how much of the box is filled ─▶ plan: points of the box ─▶ boundary samples, cells by brick ─▶ produce
//! ```
//!
//! The amount is that of points **inside** the mesh: the set fills the box, so it has as many more as the box is larger.

use super::cell_field::CellField;
use super::field::{Field, NanPolicy};
use super::need::{Estimate, Need, Question, free_bytes};
use super::plan::{Amount, MeshParts, Plan, ReduceSettings, parts};
use super::reduce::{Job, ReduceReport, RunSettings, folder_bytes, produce, scratch_folder, threads};
use super::series::{Fields, Means, PlannedSource, SeriesPlan};
use crate::archive::explicit::ExplicitRecord;
use crate::archive::manifest::{MeshSource, Source};
use crate::archive::values::Quantiser;
use crate::cells::CellMesh;
use crate::domain::boundary::BoundarySamples;
use crate::domain::buckets::Buckets;
use crate::domain::gradients::gradients;
use crate::domain::store::{BadValue, CellStore, StoreSettings};
use crate::error::{Error, Result};
use crate::pipeline::fingerprint::fingerprint;
use crate::points::PointSet;
use crate::sample::Interpolation;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Scratch bytes of a vertex (position in the world and on the lattice, value; to find equals, sorted in runs and merged) and of a tetrahedron
/// (vertices, twice; body; four faces, sorted in runs and merged; about two bricks, twice).
const VERTEX_BYTES: u64 = 24 + 24 + 4 + 2 * 40 + 8;
const TET_BYTES: u64 = 2 * 32 + 8 + 2 * 4 * 32 + 2 * 2 * 16;
/// Gradients of a vertex, and their records of a tetrahedron.
const GRADIENT_BYTES: u64 = 24;
const GRADIENT_RECORDS: u64 = 2 * 4 * 48;

/// A mesh made ready.
struct Prepared {
    store: CellStore,
    plan: Plan,
    boundary: BoundarySamples,
}

pub(super) fn reduce_mesh(mesh: &CellMesh, job: &Job<'_>) -> Result<ReduceReport> {
    if job.sources.len() > 1 {
        return Err(Error::usage("a series of tetrahedral meshes is not reduced: give one file and field"));
    }
    let scratch = scratch_folder(job.run);
    check_scratch(mesh, job.settings, &scratch)?;
    let reading = Instant::now();
    job.progress.begin("read the mesh", 0, "points");
    let settings = store_settings(job.settings, job.run, &scratch);
    let Prepared { store, plan, boundary } = prepare(mesh, job.settings, &settings)?;
    let mut seconds = vec![("read".to_owned(), reading.elapsed().as_secs_f64())];
    let series = one_step(plan, job);
    job.part.expect_planned(&series)?;
    let plan = &series.plan;
    let parts = parts(&plan.mesh, Some(boundary.points.clone()))?;
    let need = Need::of(&parts);
    let memory = job.run.memory.saturating_sub(boundary_bytes(&boundary));
    estimate_of(plan, &need, memory, job.out, job.run, (&scratch, 0))?.check()?;
    let shares = need.shares(memory, threads(job.run))?;
    let sorting = Instant::now();
    let buckets = Buckets::new(&store, &plan.mesh.bricks(), &settings)?;
    let gradients = match plan.first().interpolation {
        Interpolation::Quadratic => Some(gradients(&store, &settings)?),
        _ => None,
    };
    seconds.push(("sort".to_owned(), sorting.elapsed().as_secs_f64()));
    let field = CellField {
        store: &store,
        buckets: &buckets,
        boundary: &boundary,
        bricks: plan.mesh.bricks(),
        interpolation: plan.first().interpolation,
        gradients,
    };
    let report = ReduceReport {
        samples: store.census.vertices,
        mesh: Some(store.census),
        seconds,
        ..ReduceReport::default()
    };
    let fields = OneMesh(&field);
    produce(job, series, &Means { parts: &parts, fields: &fields, shares, at_once: 1 }, report)
}

fn one_step(plan: Plan, job: &Job<'_>) -> SeriesPlan {
    let source = PlannedSource { source: job.sources[0].1.clone(), copied: 0, copying: 0 };
    SeriesPlan {
        plan,
        sources: vec![source],
        skipped: vec![],
        before: None,
        keyframes: job.settings.keyframes,
    }
}

/// The one step of a mesh.
struct OneMesh<'a>(&'a CellField<'a>);

impl Fields for OneMesh<'_> {
    fn open<'a>(&'a self, _: &SeriesPlan, _: usize) -> Result<Box<dyn Field + 'a>> {
        Ok(Box::new(self.0))
    }
}

/// As [`make_plan`](super::reduce::make_plan): the mesh is read for that.
pub(super) fn plan_mesh(mesh: &CellMesh, job: &Job<'_>) -> Result<(SeriesPlan, MeshParts, Estimate)> {
    let (settings, scratch) = (job.settings, scratch_folder(job.run));
    check_scratch(mesh, settings, &scratch)?;
    job.progress.begin("read the mesh", 0, "points");
    let Prepared { plan, boundary, .. } =
        prepare(mesh, settings, &store_settings(settings, job.run, &scratch))?;
    let parts = parts(&plan.mesh, Some(boundary.points.clone()))?;
    let memory = job.run.memory.saturating_sub(boundary_bytes(&boundary));
    let bytes = scratch_bytes(mesh, settings);
    let estimate = estimate_of(&plan, &Need::of(&parts), memory, job.out, job.run, (&scratch, bytes))?;
    Ok((one_step(plan, job), parts, estimate))
}

fn estimate_of(
    plan: &Plan,
    need: &Need,
    memory: u64,
    out: &Path,
    run: &RunSettings,
    scratch: (&Path, u64),
) -> Result<Estimate> {
    Ok(Estimate::new(&Question {
        plan,
        need,
        memory,
        threads: threads(run),
        out,
        there: if out.is_dir() { folder_bytes(out)? } else { 0 },
        scratch,
        copying: 0,
    }))
}

fn store_settings<'a>(
    settings: &ReduceSettings,
    run: &'a RunSettings,
    scratch: &'a Path,
) -> StoreSettings<'a> {
    StoreSettings {
        // Two sorters are there at a time, of which one merges into the other, and the bodies.
        memory: run.memory / 4,
        scratch,
        bad_value: match settings.nan {
            NanPolicy::Error => BadValue::Refuse,
            NanPolicy::Mask => BadValue::Void,
            NanPolicy::Value(v) => BadValue::Use(v),
        },
        missing: settings.missing,
        cancel: &run.cancel,
    }
}

/// Memory of the boundary's samples and of the list of their positions.
fn boundary_bytes(boundary: &BoundarySamples) -> u64 {
    boundary.points.len().saturating_mul(100)
}

fn scratch_bytes(mesh: &CellMesh, settings: &ReduceSettings) -> u64 {
    let (points, cells) = (mesh.info().points, mesh.info().cells);
    let quadratic = u64::from(settings.interpolation == Interpolation::Quadratic);
    points
        .saturating_mul(VERTEX_BYTES + quadratic * GRADIENT_BYTES)
        .saturating_add(cells.saturating_mul(TET_BYTES + quadratic * GRADIENT_RECORDS))
}

fn check_scratch(mesh: &CellMesh, settings: &ReduceSettings, scratch: &Path) -> Result<()> {
    let needed = scratch_bytes(mesh, settings);
    match free_bytes(scratch) {
        Some(available) if needed > available => {
            Err(Error::Budget { what: format!("disk space for {}", scratch.display()), needed, available })
        }
        _ => Ok(()),
    }
}

fn prepare(mesh: &CellMesh, settings: &ReduceSettings, how: &StoreSettings<'_>) -> Result<Prepared> {
    let path = &mesh.info().path;
    if !settings.interpolation.is_of_meshes() {
        return Err(Error::usage(format!(
            "{} interpolation is for volumes; {} is a mesh: choose linear or quadratic",
            settings.interpolation,
            path.display()
        )));
    }
    let source = source_of(mesh)?;
    let store = CellStore::build(mesh, how)?;
    let (lattice, geometry) = (store.frame.lattice, store.frame.geometry);
    let counts = MeshSource { vertices: store.census.vertices, tetrahedra: store.census.tetrahedra };
    let source =
        Source { dims: lattice.dims, geometry, missing: settings.missing, mesh: Some(counts), ..source };
    let inside = match settings.amount {
        Amount::Count(n) => n as f64,
        Amount::Fraction(f) => counts.vertices as f64 * f,
    };
    let count = (inside / store.filled()).round().max(1.0) as u64;
    let mut plan = Plan::on_lattice(lattice, count, source, settings)?;
    let spacing = PointSet::new(plan.mesh.points, lattice)?.mean_spacing();
    let spacing = spacing.into_iter().max().expect("three axes");
    let boundary = BoundarySamples::new(&store, spacing, how.memory, path)?;
    plan.mesh.explicit = Some(ExplicitRecord::of(&boundary.points));
    plan.steps[0].quantiser = quantiser(&store, settings)?;
    Ok(Prepared { store, plan, boundary })
}

/// Steps of the range of the vertices' values.
fn quantiser(store: &CellStore, settings: &ReduceSettings) -> Result<Option<Quantiser>> {
    let Some(bits) = settings.value_bits else { return Ok(None) };
    let values = store.values.get()?.iter().filter(|v| !v.is_nan());
    let range = values.fold([f32::INFINITY, f32::NEG_INFINITY], |[lo, hi], &v| [lo.min(v), hi.max(v)]);
    let range = if range[0] <= range[1] { range } else { Default::default() };
    Ok(Some(Quantiser::new(bits, range)))
}

/// What the file tells; lattice and geometry follow when it has been read.
fn source_of(mesh: &CellMesh) -> Result<Source> {
    let (info, field) = (mesh.info(), mesh.field()?);
    let files: Vec<PathBuf> = std::iter::once(info.path.clone())
        .chain(info.data_files.iter().filter(|f| **f != info.path).cloned())
        .collect();
    Ok(Source {
        path: info.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
        fingerprint: fingerprint(&files)?,
        format: info.format.clone(),
        dims: [2; 3],
        scalar: field.scalar,
        field: field.name.clone(),
        geometry: crate::grid::Geometry::default(),
        slope: 1.0,
        intercept: 0.0,
        missing: None,
        mesh: None,
    })
}
