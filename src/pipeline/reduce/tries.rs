//! The tries of a search for a target: where they lie, and the one that becomes the archive.

use super::existing::{remove_strays, replace_archive};
use super::plan_file::work_folder;
use crate::archive::manifest::Manifest;
use crate::pipeline::plan::{Attachments, Plan};
use crate::pipeline::settings::CompleteSettings;
use isospan_io::bytes::publish::remove_folder;
use isospan_io::error::Result;
use std::fs;
use std::path::{Path, PathBuf};

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
pub(super) fn publish(settings: &CompleteSettings, best: &Path, out: &Path) -> Result<()> {
    let mut manifest = Manifest::read(best)?;
    manifest.target = Some(settings.hash());
    manifest.write(best)?;
    remove_strays(best, &manifest, None);
    replace_archive(best, out)
}

/// Removes what a try that is complete does not need, and a kill has left: its bytes count.
pub(super) fn tidy(made: &Path) {
    if let Ok(manifest) = Manifest::read(made) {
        remove_strays(made, &manifest, None);
    }
}

/// Removes the tries of an archive whose names begin so, all but some.
pub(in crate::pipeline) fn remove_tries(archive: &Path, name: &str, kept: &[Option<u32>]) -> Result<()> {
    for (number, path) in tries_in(&work_folder(archive), name) {
        if !kept.contains(&Some(number)) {
            remove_folder(&path)?;
        }
    }
    Ok(())
}

/// The tries in a folder whose names begin so; none where it cannot be listed.
pub(super) fn tries_in(folder: &Path, name: &str) -> Vec<(u32, PathBuf)> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| Some((number_of(&entry.path(), name)?, entry.path()))).collect()
}

/// The number of a try, by the name of its folder.
fn number_of(path: &Path, name: &str) -> Option<u32> {
    path.file_name()?.to_str()?.strip_prefix(name)?.strip_suffix(".isospan")?.parse().ok()
}
