//! The formats that are read: one line each. What a file or a folder is follows from its first
//! bytes or, where they do not show it, from its name.

use crate::bytes::remote::is_remote;
use crate::cells::CellMesh;
use crate::error::{Error, Result};
use crate::formats::mesh::{ensight::EnSight, exodus::Exodus, gmsh::Gmsh, tetgen::Tetgen, vtkhdf::VtkHdf};
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::format::{Format, Head};
use crate::formats::shared::unread::Unread;
use crate::formats::shared::{OpenOptions, has_suffix};
use crate::formats::volume::{
    amira::Amira,
    bricks::Bricks,
    dicom::Dicom,
    folder,
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
use crate::volume::VolumeSource;
use crate::volume::chunked::refuse_many_chunks;
use std::path::Path;

/// All formats, in the order in which they are looked for.
static FORMATS: &[&dyn Format] = &[
    &Nrrd, &Amira, &Npy, &Npz, &Exodus, &VtkHdf, &Hdf5, &NetCdf, &VtkLegacy, &VtkXml, &Bricks, &Dicom,
    &TiffFile, &Nifti, &Mrc, &MetaImage, &Gmsh, &Tetgen, &EnSight, &Zarr,
];

/// What a file holds.
pub enum Input {
    /// A structured volume.
    Volume(VolumeSource),
    /// An unstructured mesh.
    Mesh(CellMesh),
}

/// The format of a file or a folder; `None` of an unknown one, and where options say that a file is
/// headerless.
pub(super) fn format_of(path: &Path, options: &OpenOptions) -> Result<Option<&'static dyn Format>> {
    if options.raw.is_some() || stack::is_pattern(path) {
        return Ok(None);
    }
    Ok(found(&head_of(path, options)?))
}

fn found(head: &Head<'_>) -> Option<&'static dyn Format> {
    let by_name = |f: &&dyn Format| !head.is_folder && has_suffix(head.path, f.suffixes());
    let by_bytes = FORMATS.iter().find(|f| f.is_in(head));
    by_bytes.or_else(|| FORMATS.iter().find(|f| by_name(f))).copied()
}

/// The beginning of a file, or a folder. A server has no folders: what a Zarr array or group has is
/// looked for where the address has ".zarr" in it, and where no file is found there.
///
/// # Errors
/// [`Error::BadInput`] for a format that is not read from servers.
fn head_of<'a>(path: &'a Path, options: &OpenOptions) -> Result<Head<'a>> {
    if !is_remote(path) {
        Unread::refuse_empty(path)?;
        let is_zarr = options.raw.is_none() && is_in_archive(path)?;
        return if is_zarr { Ok(Head::of_folder(path)) } else { Head::of(path, options.io) };
    }
    if stack::has_wildcard(path) {
        return Err(Error::bad_input(path, "address", "one file, or a Zarr array or group", "a pattern")
            .with_help("patterns are for folders of this machine"));
    }
    let is_called = path.to_str().is_some_and(|p| p.contains(".zarr"));
    if is_called && options.raw.is_none() && is_zarr(path)? {
        return Ok(Head::of_folder(path));
    }
    let head = Head::of(path, options.io);
    let is_known = head.as_ref().is_ok_and(|head| found(head).is_some());
    if !is_known && !is_called && options.raw.is_none() && is_zarr(path).is_ok_and(|found| found) {
        return Ok(Head::of_folder(path));
    }
    let head = head?;
    match found(&head) {
        Some(format) if !format.is_on_servers() => {
            let expected = "a volume that is read by ranges (Zarr, HDF5, NetCDF, TIFF, MRC, AmiraMesh, NRRD, NIfTI, \
                            NPY, NPZ, MetaImage, raw), or a copy on a disk";
            Err(Error::bad_input(path, "kind of file", expected, format.name())
                .with_help("copy it to a disk, and name that copy"))
        }
        _ => Ok(head),
    }
}

/// Opens a volume of any format that is read: a file, a folder of slices, or a pattern for the
/// names of slices.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file or an unknown kind; [`Error::Usage`] when several
/// fields ask for a choice, when a headerless file comes without its layout, or another with one,
/// or a volume with a table of values.
pub fn open_volume(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    if options.values.is_some() {
        return Err(Error::usage(format!("{} is no mesh: leave out `value_file`", path.display())));
    }
    if options.jumps {
        return Err(Error::usage(format!("{} is no mesh: leave out `jumps`", path.display())));
    }
    if stack::is_pattern(path) {
        options.refuse_channel(path)?;
        options.refuse_scale(path)?;
        return folder::open(path, options);
    }
    let head = head_of(path, options)?;
    if found(&head).is_none_or(|format| !format.has_channels()) {
        options.refuse_channel(path)?;
    }
    if found(&head).is_none_or(|format| !format.has_scales()) {
        options.refuse_scale(path)?;
    }
    match (found(&head), &options.raw) {
        (Some(format), Some(_)) => Err(Error::usage(format!(
            "{} is {}, which tells its own layout: leave out `dims`, `type`, `endian` and `offset`",
            path.display(),
            format.name()
        ))),
        (Some(format), None) => {
            if format.has_spacing() {
                options.refuse_geometry(path, format.name())?;
            }
            let source = format.volume(path, options)?;
            if let VolumeSource::Chunked(chunks) = &source {
                refuse_many_chunks(path, source.info().dims, chunks.chunk_dims())?;
            }
            Ok(source)
        }
        (None, _) if head.is_folder => folder::open(path, options),
        (None, Some(_)) => raw::open(path, options),
        (None, None) if has_suffix(path, &[".raw", ".bin", ".dat", ".raw.gz"]) => Err(raw::no_layout(path)),
        (None, None) => Err(unknown_kind(&head)),
    }
}

/// Opens a volume or a mesh of any format that is read.
///
/// # Errors
/// Those of [`open_volume`] and [`open_mesh`].
pub fn open_input(path: &Path, options: &OpenOptions) -> Result<Input> {
    match mesh_format(path, options)? {
        Some(format) => Ok(Input::Mesh(open_as(format, path, options)?)),
        None => Ok(Input::Volume(open_volume(path, options)?)),
    }
}

/// Whether a file is a mesh, by its first bytes and its name.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::BadInput`] for an empty file.
pub fn is_mesh(path: &Path, options: &OpenOptions) -> Result<bool> {
    Ok(mesh_format(path, options)?.is_some())
}

/// Opens a mesh of any format that is read: VTU, PVTU, VTM, VTKHDF, legacy VTK, Exodus II, EnSight
/// Gold, Gmsh, TetGen, points and tetrahedra as text.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file or another kind; [`Error::Usage`] when there is no
/// field of the name wanted.
pub fn open_mesh(path: &Path, options: &OpenOptions) -> Result<CellMesh> {
    match mesh_format(path, options)? {
        Some(format) => open_as(format, path, options),
        None => Err(Error::bad_input(path, "kind of file", "a mesh", "none by name or first bytes")),
    }
}

fn open_as(format: &dyn Format, path: &Path, options: &OpenOptions) -> Result<CellMesh> {
    if options.values.is_some() && !format.has_value_file() {
        return Err(Error::usage(format!("{} has its own fields: leave out `value_file`", path.display())));
    }
    options.refuse_geometry(path, "a mesh")?;
    options.refuse_channel(path)?;
    options.refuse_scale(path)?;
    let mesh = format.mesh(path, options)?;
    match options.jumps {
        false => Ok(mesh),
        true if mesh.field().is_ok_and(|_| !mesh.is_of_cells()) => Err(Error::usage(format!(
            "{}: a value for each point may always jump between points of one place: leave out `jumps`",
            path.display()
        ))),
        true => Ok(mesh.jumping()),
    }
}

/// The format of a mesh; `None` of anything else.
fn mesh_format(path: &Path, options: &OpenOptions) -> Result<Option<&'static dyn Format>> {
    // Folders and patterns for names are volumes, and so are files that are declared headerless,
    // and what is on a server.
    if options.raw.is_some() || is_remote(path) || !path.is_file() {
        return Ok(None);
    }
    Unread::refuse_empty(path)?;
    let head = Head::of(path, options.io)?;
    Ok(found(&head).filter(|format| format.is_mesh(&head)))
}

/// The coordinates of a file that [`open_volume`] reads; `None` where its volume has a spacing.
///
/// # Errors
/// As [`open_volume`].
pub fn open_coordinates(path: &Path, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
    format_of(path, options)?.map_or(Ok(None), |format| format.coordinates(path, options))
}

fn unknown_kind(head: &Head<'_>) -> Error {
    let wrong = |got: String, help: &str| {
        Error::bad_input(
            head.path,
            "kind of file",
            "a volume (NRRD, MetaImage, NPY, NPZ, NIfTI, TIFF, DICOM, MRC, AmiraMesh, HDF5, NetCDF, VTI, VTR, VTS, \
             PVTI, PVTR, PVTS, legacy VTK, .bricks, a folder of slices or Zarr) or a mesh (VTU, PVTU, VTM, \
             VTKHDF, legacy VTK, Exodus II, EnSight Gold, Gmsh, TetGen, .pts and .tet)",
            got,
        )
        .with_help(help)
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
