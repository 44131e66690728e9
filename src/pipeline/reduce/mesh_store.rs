//! How the mesh of a job is read, and the disk that this takes.

use super::job::Job;
use crate::domain::settings::{BadValue, StoreSettings};
use crate::pipeline::plan::{MOST_SMALL_STEPS_AT_ONCE, free_bytes};
use crate::pipeline::settings::{CompleteSettings, NanPolicy};
use isospan_io::cells::CellMesh;
use isospan_io::error::{Error, Result};
use isospan_io::formats::{Input, StepSource};
use isospan_mesh::sample::{Interpolation, Values};
use std::path::Path;

/// Scratch bytes of a vertex (position in the world and on the lattice, value; to find equals,
/// sorted in runs and merged) and of a tetrahedron (vertices, twice; body; four faces, sorted in
/// runs and merged; about two bricks, twice).
const VERTEX_BYTES: u64 = 24 + 24 + 4 + 2 * 40 + 8;
const TET_BYTES: u64 = 2 * 32 + 8 + 2 * 4 * 32 + 2 * 2 * 16;
/// Gradients of a vertex, and their records of a tetrahedron.
const GRADIENT_BYTES: u64 = 24;
const GRADIENT_RECORDS: u64 = 2 * 4 * 48;
/// Of a vertex that values are fitted to: its body, its record by brick, sorted in runs and merged.
const FITTED_VERTEX: u64 = 8 + 3 * 24;

/// The mesh of a step.
pub(super) fn open_mesh_of(source: &StepSource) -> Result<CellMesh> {
    match source.open()? {
        Input::Mesh(mesh) => Ok(mesh),
        Input::Volume(_) => {
            let expected = "a mesh, as other steps are";
            Err(Error::bad_input(&source.path, "kind of file", expected, "a volume"))
        }
    }
}

pub(super) fn store_settings(job: &Job<'_>, offset: f64) -> StoreSettings {
    let (settings, resources) = (job.settings, &job.run.resources);
    StoreSettings {
        // Memory has two sorters at a time, one merging into the other, and the bodies.
        memory: resources.memory / 4,
        scratch: resources.scratch_folder(),
        bad_value: match settings.nan {
            NanPolicy::Error => BadValue::Refuse,
            NanPolicy::Mask => BadValue::Void,
            NanPolicy::Value(v) => BadValue::Use((v - offset) as f32),
        },
        missing: settings.missing,
        offset,
        cancel: resources.cancel.clone(),
    }
}

/// Bytes on disk for a mesh of `points` points and `cells` cells.
pub(super) fn scratch_bytes([points, cells]: [u64; 2], job: &Job<'_>) -> u64 {
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
        Some(available) if needed > available => Err(Error::disk(&scratch, needed, available)),
        _ => Ok(()),
    }
}

/// Settings that are for volumes are refused.
fn check_settings(settings: &CompleteSettings, path: &Path) -> Result<()> {
    let path = path.display();
    if !settings.interpolation.is_of_meshes() {
        return Err(Error::usage(format!(
            "{} interpolation is for volumes; {path} is a mesh: choose linear or quadratic",
            settings.interpolation
        )));
    }
    Ok(())
}
