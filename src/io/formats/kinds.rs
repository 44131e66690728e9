//! The formats that are read: one line each. What a file or a folder is follows from its first
//! bytes or, where they do not show it, from its name. What messages say of all formats is made
//! from the same table.

use crate::bytes::remote::is_remote;
use crate::error::{Error, Result};
use crate::formats::mesh::{ensight::EnSight, exodus::Exodus, gmsh::Gmsh, tetgen::Tetgen, vtkhdf::VtkHdf};
use crate::formats::shared::format::{About, Format, Head};
use crate::formats::shared::small::SmallFiles;
use crate::formats::shared::unread::Unread;
use crate::formats::shared::{OpenOptions, has_suffix};
use crate::formats::volume::{
    amira::Amira,
    bricks::Bricks,
    dicom::Dicom,
    hdf5::Hdf5,
    metaimage::MetaImage,
    mrc::Mrc,
    netcdf::NetCdf,
    nifti::Nifti,
    npy::Npy,
    npz::Npz,
    nrrd::Nrrd,
    raw, stack,
    tiff::TiffFile,
    zarr::{Zarr, is_in_archive, is_zarr},
};
use crate::formats::vtk::{legacy::VtkLegacy, xml::VtkXml};
use std::path::Path;
use std::sync::Arc;

/// All formats, in the order in which they are looked for.
static FORMATS: &[&dyn Format] = &[
    &Nrrd, &Amira, &Npy, &Npz, &Exodus, &VtkHdf, &Hdf5, &NetCdf, &VtkLegacy, &VtkXml, &Bricks, &Dicom,
    &TiffFile, &Nifti, &Mrc, &MetaImage, &Gmsh, &Tetgen, &EnSight, &Zarr,
];

/// The formats of a program and those of this crate, in the order in which they are looked for.
fn formats(options: &OpenOptions) -> impl Iterator<Item = &dyn Format> {
    options.formats.formats().chain(FORMATS.iter().copied())
}

/// The format of a file or a folder.
pub(super) fn found<'a>(head: &Head<'_>, options: &'a OpenOptions) -> Option<&'a dyn Format> {
    let by_name = |f: &&dyn Format| !head.is_folder && has_suffix(head.path, f.about().suffixes);
    formats(options).find(|f| f.is_in(head)).or_else(|| formats(options).find(by_name))
}

/// The beginning of a file, or a folder. A server has no folders: what a Zarr array or group has is
/// looked for where the address has ".zarr" in it, and where no file is found there.
///
/// # Errors
/// [`Error::BadInput`] for a format that is not read from servers.
pub(super) fn head_of<'a>(path: &'a Path, options: &OpenOptions) -> Result<Head<'a>> {
    let small: Arc<SmallFiles> = Arc::default();
    let folder = |small| Ok(Head::of_folder(path, options.io, small));
    if !is_remote(path) {
        Unread::refuse_empty(path)?;
        let is_zarr = options.raw.is_none() && is_in_archive(path, &small)?;
        return if is_zarr { folder(small) } else { Head::of(path, options.io) };
    }
    if stack::has_wildcard(path) {
        return Err(Error::bad_input(path, "address", "one file, or a Zarr array or group", "a pattern")
            .with_help("patterns are for folders of this machine"));
    }
    let is_called = path.to_str().is_some_and(|p| p.contains(".zarr"));
    if is_called && options.raw.is_none() && is_zarr(path, &small)? {
        return folder(small);
    }
    let head = Head::of(path, options.io);
    let is_known = head.as_ref().is_ok_and(|head| found(head, options).is_some());
    if !is_known && !is_called && options.raw.is_none() && is_zarr(path, &small).is_ok_and(|found| found) {
        return folder(small);
    }
    let head = head?;
    match found(&head, options) {
        Some(format) if !format.about().on_servers => Err(not_on_servers(path, format.about(), options)),
        _ => Ok(head),
    }
}

fn not_on_servers(path: &Path, about: &About, options: &OpenOptions) -> Error {
    let there = formats(options).map(Format::about).filter(|about| about.on_servers);
    let names = names(there.map(|about| about.volumes), &["raw"]).join(", ");
    let expected = format!("a volume that is read by ranges ({names}), or a copy on a disk");
    Error::bad_input(path, "kind of file", expected, about.name)
        .with_help("copy it to a disk, and name that copy")
}

/// The names of lists, each once, and some more.
fn names(
    lists: impl Iterator<Item = &'static [&'static str]>,
    more: &'static [&'static str],
) -> Vec<&'static str> {
    let mut all: Vec<&str> = vec![];
    for name in lists.flatten().chain(more) {
        if !all.contains(name) {
            all.push(name);
        }
    }
    all
}

/// Names as a sentence lists them.
fn listed(names: &[&str], word: &str) -> String {
    match names {
        [] => String::new(),
        [only] => (*only).to_owned(),
        [first @ .., last] => format!("{} {word} {last}", first.join(", ")),
    }
}

/// The error for a file of no format that is read.
pub(super) fn unknown_kind(head: &Head<'_>, options: &OpenOptions) -> Error {
    let wrong = |got: String, help: &str| {
        let volumes = names(formats(options).map(|f| f.about().volumes), &["a folder of slices"]);
        let meshes = names(formats(options).map(|f| f.about().meshes), &[]);
        let expected = format!("a volume ({}) or a mesh ({})", listed(&volumes, "or"), listed(&meshes, "or"));
        Error::bad_input(head.path, "kind of file", expected, got).with_help(help)
    };
    if has_suffix(head.path, &[".ply", ".stl", ".obj", ".vtp", ".glb"]) {
        return wrong("a surface".into(), "of surfaces, isospan check tells what is in them");
    }
    if let Some(Unread { name, help }) = Unread::of(head) {
        return wrong(format!("{name}, which isospan does not read"), help);
    }
    let shown: Vec<String> = head.bytes.iter().take(8).map(|b| format!("{b:02x}")).collect();
    wrong(
        format!("none of these: it begins with {}", shown.join(" ")),
        "a headerless file needs `dims` and `type`; of other compressed files, unpack them first",
    )
}

/// The error for a headerless file without its layout, where the name says that it is one.
pub(super) fn unknown(head: &Head<'_>, options: &OpenOptions) -> Error {
    match has_suffix(head.path, &[".raw", ".bin", ".dat", ".raw.gz"]) {
        true => raw::no_layout(head.path),
        false => unknown_kind(head, options),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_format_is_in_the_table_whole() {
        for about in FORMATS.iter().map(|format| format.about()) {
            assert!(about.name.starts_with("a ") || about.name.starts_with("an "), "{}", about.name);
            let is_left_out = cfg!(not(feature = "hdf5")) && about.name.contains("HDF5");
            let is_listed = !about.volumes.is_empty() || !about.meshes.is_empty();
            assert!(is_listed != is_left_out, "{}", about.name);
            let is_lower = |suffix: &&str| suffix.starts_with('.') && **suffix == suffix.to_ascii_lowercase();
            assert!(about.suffixes.iter().all(is_lower), "{}", about.name);
        }
    }
}
