//! Meshes: finds out which of their formats a file has.

use super::{OpenOptions, VolumeSource, gmsh, has_suffix, open_volume, tetgen, vtk_legacy, vtk_xml};
use crate::bytes::ByteSource;
use crate::cells::CellMesh;
use crate::error::{Error, Result};
use std::path::Path;

/// What a file holds.
pub enum Input {
    /// A structured volume.
    Volume(VolumeSource),
    /// An unstructured mesh.
    Mesh(CellMesh),
}

/// A format of meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Gmsh,
    Pair,
    VtkLegacy,
    VtkXml,
}

/// Opens a volume or a mesh of any format that is read.
///
/// # Errors
/// Those of [`open_volume`] and [`open_mesh`].
pub fn open_input(path: &Path, options: &OpenOptions) -> Result<Input> {
    match kind_of(path, options)? {
        Some(kind) => Ok(Input::Mesh(open_kind(kind, path, options)?)),
        None => Ok(Input::Volume(open_volume(path, options)?)),
    }
}

/// Whether a file is a mesh, by its first bytes and its name.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::BadInput`] for an empty file.
pub fn is_mesh(path: &Path, options: &OpenOptions) -> Result<bool> {
    Ok(kind_of(path, options)?.is_some())
}

/// Opens a mesh of any format that is read: VTU, PVTU, legacy VTK, Gmsh, TetGen, points and
/// tetrahedra as text.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file or another kind; [`Error::Usage`] when there is no
/// field of the name wanted.
pub fn open_mesh(path: &Path, options: &OpenOptions) -> Result<CellMesh> {
    match kind_of(path, options)? {
        Some(kind) => open_kind(kind, path, options),
        None => Err(Error::bad_input(path, "kind of file", "a mesh", "none by name or first bytes")),
    }
}

fn open_kind(kind: Kind, path: &Path, options: &OpenOptions) -> Result<CellMesh> {
    if options.values.is_some() && kind != Kind::Pair {
        return Err(Error::usage(format!("{} has its own fields: leave out --value-file", path.display())));
    }
    options.refuse_geometry(path, "a mesh")?;
    match kind {
        Kind::Gmsh => gmsh::open_mesh(path, options),
        Kind::Pair => tetgen::open_mesh(path, options),
        Kind::VtkLegacy => vtk_legacy::open_mesh(path, options),
        Kind::VtkXml => vtk_xml::open_mesh(path, options),
    }
}

fn kind_of(path: &Path, options: &OpenOptions) -> Result<Option<Kind>> {
    // Folders and patterns for names are volumes, and so are files that are declared headerless.
    if options.raw.is_some() || !path.is_file() {
        return Ok(None);
    }
    let source = ByteSource::open(path, options.io)?;
    let mut head = vec![0; source.len().min(4096) as usize];
    source.read_at(0, &mut head)?;
    Ok(if vtk_legacy::is_mesh(&head) {
        Some(Kind::VtkLegacy)
    } else if head.starts_with(b"$MeshFormat") || has_suffix(path, &[".msh"]) {
        Some(Kind::Gmsh)
    } else if tetgen::is_mesh(path) {
        Some(Kind::Pair)
    } else if vtk_xml::is_mesh(&head) || has_suffix(path, &[".vtu", ".pvtu"]) {
        Some(Kind::VtkXml)
    } else {
        None
    })
}

#[cfg(test)]
pub(in crate::formats) mod tests;
