//! The reduction of a tetrahedral mesh: another field on another lattice, then the same way as a volume.
//!
//! ```text
//!  mesh ─▶ store (files) ─▶ how much of the box is filled ─▶ plan: points of the box ─▶ boundary samples, cells by brick ─▶ produce
//!                       └▶ asked for whole ─▶ plan: its own vertices ─▶ its own cells by brick ─────────────────────────┘
//! ```
//!
//! The amount is that of points **with a value**, the boundary's samples included. The set fills the box, so it has more.

use super::job::{Job, ReduceReport, finished};
use super::meshes::{Laid, MeshFields, Prepared, offset_of, prepare};
use super::passes::{Means, SeriesPlan};
use super::{made_before, produce};
use crate::cells::CellMesh;
use crate::domain::store::{BadValue, StoreSettings};
use crate::error::{Error, Result};
use crate::pipeline::plan::{
    Estimate, Held, MOST_SMALL_STEPS_AT_ONCE, MeshParts, Need, Plan, Question, folder_bytes, free_bytes,
    need_of, parts,
};
use crate::pipeline::settings::{NanPolicy, ReduceSettings, RunSettings};
use crate::pipeline::stage::Stage;
use crate::sample::{Interpolation, Values};
use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

/// Scratch bytes of a vertex (position in the world and on the lattice, value; to find equals, sorted in runs and merged) and of a tetrahedron
/// (vertices, twice; body; four faces, sorted in runs and merged; about two bricks, twice).
const VERTEX_BYTES: u64 = 24 + 24 + 4 + 2 * 40 + 8;
const TET_BYTES: u64 = 2 * 32 + 8 + 2 * 4 * 32 + 2 * 2 * 16;
/// Gradients of a vertex, and their records of a tetrahedron.
const GRADIENT_BYTES: u64 = 24;
const GRADIENT_RECORDS: u64 = 2 * 4 * 48;
/// Of a vertex that values are fitted to: its body, its record by brick, sorted in runs and merged.
const FITTED_VERTEX: u64 = 8 + 3 * 24;

/// Does a job whose input is a mesh.
pub(super) fn reduce_mesh(job: &Job<'_>) -> Result<ReduceReport> {
    let scratch = job.run.resources.scratch_folder();
    let reading = Instant::now();
    job.progress.begin("read the mesh", 0, "points");
    let settings = store_settings(job.settings, job.run, &scratch, offset_of(job)?);
    let Prepared { store, series, listed, wanted } = prepare(job, &settings)?;
    let mut seconds = vec![(Stage::Read, reading.elapsed().as_secs_f64())];
    job.part.expect_planned(&series)?;
    if let Some(report) = made_before(job, &series, wanted)? {
        return Ok(finished(report, job.started));
    }
    let plan = &series.plan;
    let parts = parts(&plan.mesh, series.attachments.clone())?;
    let (held, memory) = (Held { always: listed.bytes(), ..Held::default() }, job.run.resources.memory);
    let need = need_of(&parts, held, plan.steps.len(), memory, job.run);
    estimate_of(plan, &need, memory, job.out, job.run, (&scratch, 0))?.check()?;
    let shares = need.shares(memory, job.run.resources.worker_threads())?;
    let sorting = Instant::now();
    let laid = Laid::new(listed, &store, plan, &settings)?;
    seconds.push((Stage::Sort, sorting.elapsed().as_secs_f64()));
    let report = ReduceReport {
        samples: store.census.vertices,
        inner_points: wanted,
        bound: series.bound,
        mesh: Some(store.census),
        seconds,
        ..ReduceReport::default()
    };
    let bricks = plan.mesh.bricks();
    let fields = MeshFields { store: &store, laid, bricks, settings, last: Mutex::default() };
    produce(job, series, &Means { parts: &parts, fields: &fields, shares, at_once: need.steps() }, report)
}

/// As [`make_plan`](super::make_plan): the mesh is read for that.
pub(super) fn plan_mesh(job: &Job<'_>) -> Result<(SeriesPlan, MeshParts, Estimate)> {
    let (settings, scratch) = (job.settings, job.run.resources.scratch_folder());
    job.progress.begin("read the mesh", 0, "points");
    let Prepared { store, series, listed, .. } =
        prepare(job, &store_settings(settings, job.run, &scratch, offset_of(job)?))?;
    let plan = &series.plan;
    let parts = parts(&plan.mesh, series.attachments.clone())?;
    let (held, memory) = (Held { always: listed.bytes(), ..Held::default() }, job.run.resources.memory);
    let bytes = scratch_bytes([store.census.vertices, store.census.cells], job);
    let need = need_of(&parts, held, plan.steps.len(), memory, job.run);
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
        threads: run.resources.worker_threads(),
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
    offset: f64,
) -> StoreSettings<'a> {
    StoreSettings {
        // Two sorters are there at a time, of which one merges into the other, and the bodies.
        memory: run.resources.memory / 4,
        scratch,
        bad_value: match settings.nan {
            NanPolicy::Error => BadValue::Refuse,
            NanPolicy::Mask => BadValue::Void,
            NanPolicy::Value(v) => BadValue::Use((v - offset) as f32),
        },
        missing: settings.missing,
        offset,
        cancel: &run.resources.cancel,
    }
}

/// Of a mesh of so many points and cells.
fn scratch_bytes([points, cells]: [u64; 2], job: &Job<'_>) -> u64 {
    let quadratic = u64::from(job.settings.interpolation == Interpolation::Quadratic);
    let fitted = u64::from(job.settings.values == Values::Fit);
    // Values and gradients of the steps that are made at a time.
    let steps = (job.sources.len() as u64).min(MOST_SMALL_STEPS_AT_ONCE);
    points
        .saturating_mul(VERTEX_BYTES + fitted * FITTED_VERTEX + steps * (4 + quadratic * GRADIENT_BYTES))
        .saturating_add(cells.saturating_mul(TET_BYTES + quadratic * GRADIENT_RECORDS))
}

/// Whether a job can be done with a mesh: its settings, and room on disk.
pub(super) fn check_job(job: &Job<'_>, mesh: &CellMesh) -> Result<()> {
    check_settings(job.settings, &mesh.info().path)?;
    let scratch = job.run.resources.scratch_folder();
    let needed = scratch_bytes([mesh.info().points, mesh.info().cells], job);
    match free_bytes(&scratch) {
        Some(available) if needed > available => {
            Err(Error::Budget { what: format!("disk space for {}", scratch.display()), needed, available })
        }
        _ => Ok(()),
    }
}

/// Settings that are for volumes are refused.
fn check_settings(settings: &ReduceSettings, path: &Path) -> Result<()> {
    let path = path.display();
    if !settings.interpolation.is_of_meshes() {
        return Err(Error::usage(format!(
            "{} interpolation is for volumes; {path} is a mesh: choose linear or quadratic",
            settings.interpolation
        )));
    }
    Ok(())
}
