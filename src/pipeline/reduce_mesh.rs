//! The reduction of a tetrahedral mesh: another field on another lattice, then the same way as a volume.
//!
//! ```text
//!  mesh ─▶ store (files) ─▶ how much of the box is filled ─▶ plan: points of the box ─▶ boundary samples, cells by brick ─▶ produce
//! ```
//!
//! The amount is that of points **inside** the mesh: the set fills the box, so it has as many more as the box is larger.

use super::beside::Beside;
use super::cell_field::CellField;
use super::field::{Field, NanPolicy};
use super::need::{Estimate, Need, Question, free_bytes};
use super::plan::{Amount, MeshParts, Plan, ReduceSettings, parts};
use super::reduce::{
    Job, MOST_STEPS_AT_ONCE, ReduceReport, RunSettings, folder_bytes, need_of, produce, scratch_folder,
    threads,
};
use super::series::{Fields, Means, PlannedSource, SeriesPlan, is_of_data, of_step};
use crate::archive::explicit::ExplicitRecord;
use crate::archive::manifest::{MeshSource, Source, StepPlan};
use crate::archive::values::Quantiser;
use crate::cells::{CellBlock, CellMesh};
use crate::domain::boundary::BoundarySamples;
use crate::domain::buckets::Buckets;
use crate::domain::column::Column;
use crate::domain::gradients::gradients;
use crate::domain::store::{BadValue, CellStore, StoreSettings};
use crate::error::{Error, Result};
use crate::formats::{self, Input, StepSource};
use crate::grid::BrickGrid;
use crate::pipeline::fingerprint::fingerprint;
use crate::points::PointSet;
use crate::sample::{Interpolation, Values};
use std::path::{Path, PathBuf};
use std::time::Instant;
use xxhash_rust::xxh3::Xxh3;

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
    series: SeriesPlan,
    boundary: BoundarySamples,
}

pub(super) fn reduce_mesh(mesh: &CellMesh, job: &Job<'_>) -> Result<ReduceReport> {
    let scratch = scratch_folder(job.run);
    check_scratch(mesh, job, &scratch)?;
    let reading = Instant::now();
    job.progress.begin("read the mesh", 0, "points");
    let settings = store_settings(job.settings, job.run, &scratch);
    let Prepared { store, series, boundary } = prepare(mesh, job, &settings)?;
    let mut seconds = vec![("read".to_owned(), reading.elapsed().as_secs_f64())];
    job.part.expect_planned(&series)?;
    let plan = &series.plan;
    let parts = parts(&plan.mesh, listed(&boundary))?;
    let memory = job.run.memory.saturating_sub(boundary_bytes(&boundary));
    let need = need_of(&parts, plan.steps.len(), memory, job.run);
    estimate_of(plan, &need, memory, job.out, job.run, (&scratch, 0))?.check()?;
    let shares = need.shares(memory, threads(job.run))?;
    let sorting = Instant::now();
    let buckets = Buckets::new(&store, &plan.mesh.bricks(), &settings)?;
    seconds.push(("sort".to_owned(), sorting.elapsed().as_secs_f64()));
    let report = ReduceReport {
        samples: store.census.vertices,
        mesh: Some(store.census),
        seconds,
        ..ReduceReport::default()
    };
    let bricks = plan.mesh.bricks();
    let fields = MeshFields { store: &store, buckets: &buckets, boundary: &boundary, bricks, settings };
    produce(job, series, &Means { parts: &parts, fields: &fields, shares, at_once: need.steps() }, report)
}

/// Opens the values of steps on a mesh.
struct MeshFields<'a> {
    store: &'a CellStore,
    buckets: &'a Buckets,
    boundary: &'a BoundarySamples,
    bricks: BrickGrid,
    settings: StoreSettings<'a>,
}

impl Fields for MeshFields<'_> {
    fn open<'a>(&'a self, series: &SeriesPlan, n: usize) -> Result<Box<dyn Field + 'a>> {
        let source = &series.sources[n].source;
        let mesh = formats::open_mesh(&source.path, &source.options)?;
        let values = self.store.values_of(&mesh, &self.settings)?;
        let interpolation = series.plan.steps[n].interpolation;
        let gradients = match interpolation {
            Interpolation::Quadratic => Some(gradients(self.store, &values, &self.settings)?),
            _ => None,
        };
        Ok(Box::new(CellField {
            store: self.store,
            buckets: self.buckets,
            boundary: self.boundary,
            bricks: self.bricks,
            interpolation,
            values,
            gradients,
        }))
    }
}

/// As [`make_plan`](super::reduce::make_plan): the mesh is read for that.
pub(super) fn plan_mesh(mesh: &CellMesh, job: &Job<'_>) -> Result<(SeriesPlan, MeshParts, Estimate)> {
    let (settings, scratch) = (job.settings, scratch_folder(job.run));
    check_scratch(mesh, job, &scratch)?;
    job.progress.begin("read the mesh", 0, "points");
    let Prepared { series, boundary, .. } = prepare(mesh, job, &store_settings(settings, job.run, &scratch))?;
    let plan = &series.plan;
    let parts = parts(&plan.mesh, listed(&boundary))?;
    let memory = job.run.memory.saturating_sub(boundary_bytes(&boundary));
    let bytes = scratch_bytes(mesh, job);
    let need = need_of(&parts, plan.steps.len(), memory, job.run);
    let estimate = estimate_of(plan, &need, memory, job.out, job.run, (&scratch, bytes))?;
    Ok((series, parts, estimate))
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
fn listed(boundary: &BoundarySamples) -> Beside {
    Beside { explicit: Some(boundary.points.clone()), levels: None }
}

fn boundary_bytes(boundary: &BoundarySamples) -> u64 {
    boundary.points.len().saturating_mul(100)
}

fn scratch_bytes(mesh: &CellMesh, job: &Job<'_>) -> u64 {
    let (points, cells) = (mesh.info().points, mesh.info().cells);
    let quadratic = u64::from(job.settings.interpolation == Interpolation::Quadratic);
    // Values and gradients of the steps that are made at a time.
    let steps = (job.sources.len() as u64).min(MOST_STEPS_AT_ONCE);
    points
        .saturating_mul(VERTEX_BYTES + steps * (4 + quadratic * GRADIENT_BYTES))
        .saturating_add(cells.saturating_mul(TET_BYTES + quadratic * GRADIENT_RECORDS))
}

fn check_scratch(mesh: &CellMesh, job: &Job<'_>, scratch: &Path) -> Result<()> {
    let needed = scratch_bytes(mesh, job);
    match free_bytes(scratch) {
        Some(available) if needed > available => {
            Err(Error::Budget { what: format!("disk space for {}", scratch.display()), needed, available })
        }
        _ => Ok(()),
    }
}

fn prepare(mesh: &CellMesh, job: &Job<'_>, how: &StoreSettings<'_>) -> Result<Prepared> {
    let settings = job.settings;
    let path = &mesh.info().path;
    if !settings.interpolation.is_of_meshes() {
        return Err(Error::usage(format!(
            "{} interpolation is for volumes; {} is a mesh: choose linear or quadratic",
            settings.interpolation,
            path.display()
        )));
    }
    if settings.values == Values::Fit {
        return Err(Error::usage(format!(
            "values are fitted to the samples of volumes; {} is a mesh: choose --values sample",
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
    if settings.adapt.is_some() || settings.target.is_some() {
        return Err(Error::usage(
            "--adapt is for volumes: a mesh is reduced with the same density everywhere",
        ));
    }
    let count = (inside / store.filled()).round().max(1.0) as u64;
    let mut plan = Plan::on_lattice(lattice, count, source, settings)?;
    let spacing = PointSet::new(plan.mesh.points, lattice)?.mean_spacing();
    let spacing = spacing.into_iter().max().expect("three axes");
    let boundary = BoundarySamples::new(&store, spacing, how.memory, path)?;
    plan.mesh.explicit = Some(ExplicitRecord::of(&boundary.points));
    let series = plan_steps(mesh, &store, plan, job, how)?;
    Ok(Prepared { store, series, boundary })
}

/// Plans all steps: the mesh of each must be that of the first, point by point and cell by cell.
fn plan_steps(
    first: &CellMesh,
    store: &CellStore,
    plan: Plan,
    job: &Job<'_>,
    how: &StoreSettings<'_>,
) -> Result<SeriesPlan> {
    let (template, several) = (plan.first().clone(), job.sources.len() > 1);
    let expected = if several { Some(geometry_hash(first, how)?) } else { None };
    let mut hashed = (first.info().path.clone(), expected);
    let mut series = SeriesPlan {
        plan: Plan { steps: vec![], ..plan },
        sources: vec![],
        skipped: vec![],
        before: None,
        keyframes: job.settings.keyframes,
        beside: Beside::default(),
        bound: None,
    };
    let mut plan_one = |number: u64, source: &StepSource| -> Result<StepPlan> {
        let mesh = match formats::open_input(&source.path, &source.options)? {
            Input::Mesh(mesh) => mesh,
            Input::Volume(_) => {
                let expected = "a mesh, as other steps are";
                return Err(Error::bad_input(&source.path, "kind of file", expected, "a volume"));
            }
        };
        if several && hashed.0 != mesh.info().path {
            hashed = (mesh.info().path.clone(), Some(geometry_hash(&mesh, how)?));
        }
        if hashed.1 != expected {
            let expected = format!("those of {}", first.info().path.display());
            return Err(Error::bad_input(&source.path, "points and cells", expected, "others").with_help(
                "the steps of a series share one mesh; --keep-going leaves out those that do not fit",
            ));
        }
        let told = source_of(&mesh)?;
        let of_first = template.source.clone();
        let source_record = Source {
            path: told.path,
            fingerprint: told.fingerprint,
            format: told.format,
            scalar: told.scalar,
            field: told.field,
            ..of_first
        };
        let quantiser = match job.part.planned() {
            Some(plan) => plan.steps.iter().find(|s| s.number == number).and_then(|s| s.quantiser),
            None if job.settings.value_bits.is_some() => {
                quantiser(&store.values_of(&mesh, how)?, job.settings)?
            }
            None => None,
        };
        Ok(StepPlan { number, time: source.time, source: source_record, quantiser, ..template.clone() })
    };
    let mut first_error = None;
    for (number, source) in job.sources {
        match plan_one(*number, source).map_err(|e| if several { of_step(e, *number) } else { e }) {
            Ok(step) => {
                series.plan.steps.push(step);
                series.sources.push(PlannedSource {
                    source: source.clone(),
                    copied: 0,
                    shared_copy: 0,
                    copying: 0,
                });
            }
            Err(e) if job.run.keep_going && several && is_of_data(&e) => {
                series.skip(*number, source, e.to_string());
                first_error.get_or_insert(e);
            }
            Err(e) => return Err(e),
        }
    }
    if series.plan.steps.is_empty() {
        return Err(first_error.unwrap_or_else(|| Error::usage("there is no step to reduce")));
    }
    series.connect()?;
    Ok(series)
}

/// A hash of all points and cells.
fn geometry_hash(mesh: &CellMesh, how: &StoreSettings<'_>) -> Result<u128> {
    let mut hash = Xxh3::new();
    let (mut points, mut block) = (mesh.points()?, vec![]);
    while points.next_block(&mut block)? {
        how.cancel.check()?;
        block.iter().flatten().for_each(|x| hash.update(&x.to_le_bytes()));
    }
    let (mut cells, mut block) = (mesh.cells()?, CellBlock::default());
    while cells.next_block(&mut block)? {
        how.cancel.check()?;
        for (kind, vertices) in block.iter() {
            hash.update(format!("{kind:?}").as_bytes());
            vertices.iter().for_each(|v| hash.update(&v.to_le_bytes()));
        }
    }
    Ok(hash.digest128())
}

/// Steps of the range of the vertices' values.
fn quantiser(values: &Column<f32>, settings: &ReduceSettings) -> Result<Option<Quantiser>> {
    let Some(bits) = settings.value_bits else { return Ok(None) };
    let values = values.get()?.iter().filter(|v| !v.is_nan());
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
