//! Tries of a search for a target: their errors, and which one becomes the archive.

use super::existing::replace_archive;
use super::job::Job;
use super::report::ReduceReport;
use crate::archive::manifest::Manifest;
use crate::error::{Error, Result};
use crate::pipeline::plan::{Attachments, Plan};
use crate::pipeline::settings::Target;
use std::fs;
use std::path::Path;

/// The error of the worst step.
pub(super) fn error_of(target: Target, report: &ReduceReport) -> f64 {
    let which = usize::from(matches!(target, Target::Max(_)));
    report.steps.iter().filter_map(|s| s.error).map(|e| e[which]).fold(0.0, f64::max)
}

/// Cells of an archive that have a point a sample or more, and all cells.
pub(super) fn full_cells(archive: &Path) -> Result<[u64; 2]> {
    let manifest = Manifest::read(archive)?;
    let (plan, attachments) = (&manifest.plan, Attachments::read(archive, &manifest.plan)?);
    let levels = attachments.levels.expect("its points adapt");
    let densities = Plan::densities(plan, &levels);
    let full = levels.as_slice().iter().filter(|&&l| densities[usize::from(l)] >= FULL).count();
    Ok([full as u64, levels.as_slice().len() as u64])
}

/// Points a voxel of which one says that there is one for each: numbers of points are rounded.
const FULL: f64 = 0.9;

/// Puts a try in the place of the archive. One that is there is whole until then.
pub(super) fn publish(job: &Job<'_>, best: &Path) -> Result<()> {
    let mut manifest = Manifest::read(best)?;
    manifest.target = Some(job.settings.hash());
    manifest.write(best)?;
    replace_archive(best, job.out)
}

pub(super) fn rename(from: &Path, to: &Path) -> Result<()> {
    fs::rename(from, to).map_err(|e| Error::io("rename", from, e))
}
