//! The try that becomes the archive, when a target was searched for.

use super::existing::{remove_strays, replace_archive};
use crate::archive::manifest::Manifest;
use crate::error::{Error, Result};
use crate::pipeline::plan::{Attachments, Plan};
use crate::pipeline::settings::ReduceSettings;
use std::fs;
use std::path::Path;

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
pub(super) fn publish(settings: &ReduceSettings, best: &Path, out: &Path) -> Result<()> {
    let mut manifest = Manifest::read(best)?;
    manifest.target = Some(settings.hash());
    manifest.write(best)?;
    remove_strays(best, &manifest);
    replace_archive(best, out)
}

pub(super) fn rename(from: &Path, to: &Path) -> Result<()> {
    fs::rename(from, to).map_err(|e| Error::io("rename", from, e))
}
