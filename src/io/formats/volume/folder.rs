//! A folder, or a pattern for file names, as a volume: a stack of slices.

use super::dicom;
use super::stack;
use super::tiff;
use super::zarr;
use crate::bytes::IoMode;
use crate::bytes::remote::is_remote;
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Head};
use crate::formats::shared::small::SmallFiles;
use crate::formats::shared::unread::Unread;
use crate::formats::shared::{OpenOptions, has_suffix};
use crate::volume::VolumeInfo;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Opens a folder or a pattern.
///
/// # Errors
/// [`Error::BadInput`] when there is no volume in it, or a malformed one; [`Error::Usage`] for the
/// layout of a raw file.
pub(in crate::formats) fn open(path: &Path, options: &OpenOptions) -> Result<(About, Box<dyn Dataset>)> {
    if options.raw.is_some() {
        let message = "`dims`, `type`, `endian` and `offset` tell of one headerless file";
        return Err(Error::usage(format!("{} stands for several files: {message}", path.display())));
    }
    if stack::is_pattern(path) {
        if let Some(series) = dicom::open_folder(path, options.io)? {
            return Ok((dicom::OF_SERIES, series));
        }
        let slices = stack::matching(path)?;
        if let Some(other) = slices.iter().find(|slice| !has_suffix(slice, &tiff::SUFFIXES)) {
            if let Some(unread) = unread_of(other) {
                return Err(unread.error(path, "pattern", "slices (*.tif) or DICOM"));
            }
            return Err(Error::bad_input(
                path,
                "pattern",
                "slices (*.tif) or DICOM",
                format!("{}", other.display()),
            )
            .with_help("other files are volumes, one each: name the one that is meant"));
        }
        return Ok((tiff::OF_STACK, tiff::open_stack(path, slices, options.io)?));
    }
    let slices = stack::in_folder(path, &tiff::SUFFIXES)?;
    if !slices.is_empty() {
        return Ok((tiff::OF_STACK, tiff::open_stack(path, slices, options.io)?));
    }
    if path.join("manifest.zst").is_file() {
        return Err(Error::bad_input(path, "folder", "a volume or a mesh", "an isospan archive"));
    }
    if path.join("mesh").is_dir() && path.join("steps").is_dir() {
        return Err(Error::bad_input(path, "archive", "a finished one", "one without a manifest").with_help(
            "the reduce command that began it goes on with it; isospan status tells how far a planned one is",
        ));
    }
    if let Some(series) = dicom::open_folder(path, options.io)? {
        return Ok((dicom::OF_SERIES, series));
    }
    let expected = "slices (*.tif), DICOM, or a Zarr array or group";
    Err(match Unread::of_folder(path).or_else(|| unread_in(path)) {
        Some(unread) => unread.error(path, "folder", expected),
        None => Error::bad_input(path, "folder", expected, "none of these")
            .with_help("name a file in it, or a pattern for its slices, in quotes"),
    })
}

/// The files of a folder that are no part of the volume that it was read as, by their names. A Zarr
/// array is no such folder: it may have any files.
pub fn passed_over(info: &VolumeInfo) -> Vec<String> {
    let folder = &info.path;
    let is_in_it = |file: &PathBuf| file.parent() == Some(folder);
    if is_remote(folder) || !folder.is_dir() || !info.data_files.iter().all(is_in_it) || is_zarr(folder) {
        return vec![];
    }
    let read: HashSet<&PathBuf> = info.data_files.iter().collect();
    let files = stack::files(folder).unwrap_or_default().into_iter().filter(|file| !read.contains(file));
    files.filter_map(|file| Some(file.file_name()?.to_string_lossy().into_owned())).collect()
}

fn is_zarr(folder: &Path) -> bool {
    zarr::is_zarr(folder, &SmallFiles::default()).unwrap_or(true)
}

/// The kind of the first files of a folder, by their names, that is not read.
fn unread_in(folder: &Path) -> Option<Unread> {
    const LOOKED_AT: usize = 16;
    stack::files(folder).ok()?.iter().take(LOOKED_AT).find_map(|file| unread_of(file))
}

fn unread_of(file: &Path) -> Option<Unread> {
    Unread::of(&Head::of(file, IoMode::Read).ok()?)
}
