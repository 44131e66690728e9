//! Meshes of tetrahedra, written: their arrays, in parts, and these compressed. The formats differ
//! in what lies around the arrays.
//!
//! | format | file | arrays |
//! |---|---|---|
//! | [`vtu`] | VTK XML UnstructuredGrid | raw, or zlib in blocks of 1 MiB |
//! | [`vtkhdf`] | VTK's UnstructuredGrid in HDF5 | the same |
//!
//! All lengths follow from the two counts, so a head is final before the first point, and the
//! memory used is that of a buffer. Those of compressed arrays are known only at the end: they wait
//! in a nameless file next to the target until the head is written.
//!
//! Coordinates are `f64`: the lattice is finer than `f32` can resolve, and rounding could turn over
//! a flat tetrahedron. Every tetrahedron has a positive volume as VTK counts it, also where the
//! volume's geometry mirrors. On a curvilinear grid this excludes those that its coordinates turn
//! over: tetrahedra in folded cells, and slivers where cells are bent.

pub(crate) mod arrays;
mod vtkhdf;
mod vtu;

use crate::tets::StoredTets;
use arrays::TetMeta;
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::sink::Sink;
use std::path::Path;

/// A format that tetrahedra are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TetFormat {
    /// VTK XML UnstructuredGrid.
    Vtu,
    /// VTKHDF UnstructuredGrid.
    VtkHdf,
}

impl TetFormat {
    /// The format that a file name asks for, by its extension in any case.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no extension or it is none of ours.
    pub(crate) fn from_path(path: &Path) -> Result<Self> {
        let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        match extension.as_deref() {
            Some("vtu") => Ok(Self::Vtu),
            Some("vtkhdf") => Ok(Self::VtkHdf),
            _ => Err(Error::usage(format!(
                "cannot tell the mesh format of {}: end its name in .vtu or .vtkhdf",
                path.display()
            ))),
        }
    }
}

/// Writes a mesh to `path` and returns the bytes of the file. A mesh without tetrahedra gives an
/// empty, valid file.
///
/// # Errors
/// [`Error::Usage`] when the target is a folder or lies in none; [`Error::Io`] when the system
/// refuses to write; those of reading the mesh. After an error nothing new lies under `path`.
pub(crate) fn write_tetrahedra(
    mesh: &StoredTets,
    path: &Path,
    format: TetFormat,
    meta: &TetMeta<'_>,
) -> Result<u64> {
    let mut sink = Sink::create(path)?;
    match format {
        TetFormat::Vtu => vtu::write(mesh, meta, &mut sink)?,
        TetFormat::VtkHdf => vtkhdf::write(mesh, meta, &mut sink)?,
    }
    sink.publish()
}
