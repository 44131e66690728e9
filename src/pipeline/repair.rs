//! A finished archive, and the reduction that made it once more: a run that was killed when all was done is asked to continue, or files have got lost.
//!
//! Nothing is done where nothing is missing; files that are lost are made again, and the others kept. The manifest stays in its place meanwhile; it tells that this is the same
//! reduction, and its like replaces it in the end.

use super::beside::Beside;
use super::plan::{Plan, ReduceSettings};
use crate::archive::manifest::{
    MANIFEST_NAME, Manifest, coordinates_path, index_path, mesh_segment_path, spectrum_path,
    values_segment_path,
};
use crate::archive::segment::PlanHash;
use crate::error::{Error, Result};
use crate::formats::StepSource;
use std::fs;
use std::path::{Path, PathBuf};

/// Whether a file that the manifest of an archive names is not there, or not as long as it was. What a file holds is not looked at.
pub(super) fn lacks_files(archive: &Path, manifest: &Manifest) -> bool {
    let gone = |path: PathBuf, bytes: u64| fs::metadata(path).map_or(true, |file| file.len() != bytes);
    let of_mesh = (0..).zip(&manifest.mesh).any(|(n, s)| gone(mesh_segment_path(archive, n), s.info.bytes));
    let of_steps = manifest.steps.iter().any(|step| {
        let number = step.plan.number;
        let values = (0..).zip(&step.values);
        let mut others = [
            step.index.map(|i| (index_path(archive, number), i)),
            step.spectrum.map(|i| (spectrum_path(archive, number), i)),
            step.coordinates.map(|c| (coordinates_path(archive, number), c.info)),
        ]
        .into_iter()
        .flatten();
        values.into_iter().any(|(n, s)| gone(values_segment_path(archive, number, n), s.info.bytes))
            || others.any(|(path, info)| gone(path, info.bytes))
    });
    of_mesh || of_steps || !Beside::missing(archive, &manifest.plan).is_empty()
}

/// Whether a manifest is that of a plan: the same mesh, the same steps.
pub(super) fn is_of(manifest: &Manifest, mesh: PlanHash, plan: &Plan) -> bool {
    manifest.plan_hash == mesh && manifest.steps.iter().map(|s| &s.plan).eq(&plan.steps)
}

/// Whether a finished archive may be that of a reduction of these steps, or one that has lost files: its plan will tell. To plan may take reading all samples, or a mesh; so what has other
/// settings, or was made from a file of another name, is told from it without. What a target is met with is found anew each time.
pub(super) fn may_be_of(archive: &Path, steps: &[StepSource], settings: &ReduceSettings) -> bool {
    // An archive whose manifest cannot be read may be anything.
    let Ok(manifest) = Manifest::read(archive) else { return false };
    let first = manifest.steps.first().map(|step| &step.plan);
    let name = |step: &StepSource| step.path.file_name().map(|name| name.to_string_lossy().into_owned());
    let is_alike = manifest.steps.len() <= steps.len()
        && manifest.plan.levels.is_some() == settings.adapt.is_some()
        && first.and_then(|plan| plan.quantiser).map(|q| q.bits) == settings.value_bits
        && steps.iter().any(|step| name(step).as_ref() == first.map(|plan| &plan.source.path));
    settings.target.is_none() && (is_alike || lacks_files(archive, &manifest))
}

/// The manifest, if there is one: of a finished archive of this very plan.
///
/// # Errors
/// [`Error::Usage`] when there is a finished archive of another plan, or with steps that were appended.
pub(super) fn finished(out: &Path, plan: &Plan) -> Result<Option<Manifest>> {
    if !out.join(MANIFEST_NAME).exists() {
        return Ok(None);
    }
    let manifest = Manifest::read(out)?;
    if is_of(&manifest, plan.mesh_hash(), plan) {
        return Ok(Some(manifest));
    }
    Err(if lacks_files(out, &manifest) {
        let text = "lacks files, and was not made by this reduction alone; choose another name, or --force to replace it";
        Error::usage(format!("{} {text}", out.display()))
    } else {
        exists(out)
    })
}

/// There is something of this name.
pub(super) fn exists(out: &Path) -> Error {
    Error::usage(format!("{} exists; choose another name, or --force to replace it", out.display()))
}
