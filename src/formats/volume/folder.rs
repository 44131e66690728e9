//! A folder, or a pattern for file names, as a volume: a stack of slices.

use super::dicom;
use super::stack;
use super::tiff;
use crate::bytes::IoMode;
use crate::error::{Error, Result};
use crate::formats::shared::format::Head;
use crate::formats::shared::unread::Unread;
use crate::formats::shared::{OpenOptions, has_suffix};
use crate::volume::VolumeSource;
use std::path::Path;

/// Opens a folder or a pattern.
///
/// # Errors
/// [`Error::BadInput`] when there is no volume in it, or a malformed one; [`Error::Usage`] for the
/// layout of a raw file.
pub(in crate::formats) fn open(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    if options.raw.is_some() {
        let message = "--dims, --type, --endian and --offset tell of one headerless file";
        return Err(Error::usage(format!("{} stands for several files: {message}", path.display())));
    }
    if stack::is_pattern(path) {
        if let Some(source) = dicom::open_folder(path, options)? {
            return Ok(source);
        }
        let slices = stack::matching(path)?;
        if let Some(other) = slices.iter().find(|slice| !has_suffix(slice, &tiff::SUFFIXES)) {
            return Err(Error::bad_input(
                path,
                "pattern",
                "slices (*.tif) or DICOM",
                format!("{}", other.display()),
            )
            .with_help("other files are volumes, one each: name the one that is meant"));
        }
        return tiff::open_stack(path, slices, options);
    }
    let slices = stack::in_folder(path, &tiff::SUFFIXES)?;
    if !slices.is_empty() {
        return tiff::open_stack(path, slices, options);
    }
    if path.join("manifest.json").is_file() {
        return Err(Error::bad_input(path, "folder", "a volume or a mesh", "an isospan archive"));
    }
    if path.join("mesh").is_dir() && path.join("steps").is_dir() {
        return Err(Error::bad_input(path, "archive", "a finished one", "one without a manifest").with_help(
            "the reduce command that began it goes on with it; isospan status tells how far a planned one is",
        ));
    }
    if let Some(source) = dicom::open_folder(path, options)? {
        return Ok(source);
    }
    let (got, help) = match unread_in(path) {
        Some(Unread { name, help }) => (format!("{name}, which isospan does not read"), help),
        None => ("none of these".into(), "name a file in it, or a pattern for its slices, in quotes"),
    };
    Err(Error::bad_input(path, "folder", "slices (*.tif), DICOM, or a Zarr array or group", got)
        .with_help(help))
}

/// The kind of the first file of a folder, by its name, if it is one that is not read.
fn unread_in(folder: &Path) -> Option<Unread> {
    let files = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let first = files.filter(|path| path.is_file()).min()?;
    Unread::of(&Head::of(&first, IoMode::Read).ok()?)
}
