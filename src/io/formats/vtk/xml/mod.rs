//! VTK XML files: the machinery for all of them, and images (`.vti`) as volumes.
//!
//! ```text
//! <VTKFile type="ImageData" byte_order="LittleEndian" header_type="UInt64" compressor="vtkZLibDataCompressor">
//!   <ImageData WholeExtent="x0 x1 y0 y1 z0 z1" Origin="…" Spacing="…" Direction="…">
//!     <Piece Extent="x0 x1 y0 y1 z0 z1">
//!       <PointData Scalars="density">
//!         <DataArray type="Float32" Name="density" format="appended" offset="0"/>
//!       </PointData>
//!     </Piece>
//!   </ImageData>
//!   <AppendedData encoding="raw"> _… </AppendedData>
//! </VTKFile>
//! ```
//!
//! The reader takes ascii, base64 and raw data, inline and appended, uncompressed, zlib and LZ4, in
//! both byte orders and with both widths of header numbers. Uncompressed raw data of one piece are
//! mapped where they lie; everything else is a stream of slabs in constant memory. LZMA is refused
//! by name.
//!
//! **Extents.** They are inclusive, and need not begin at 0: sample (x0, y0, z0) of the whole
//! extent is our (0, 0, 0), and its world position includes x0 steps of the spacing. Pieces are
//! joined; neighbours usually share a layer of samples, which is stored twice.
//!
//! **Fields** are the arrays of the point data. Without `field` the one that the file names as
//! its active `Scalars` is read, else the only one with one component.
//!
//! **Indices** (`.pvti`, `.pvtr`, `.pvts`) list files of one piece each, which are joined like
//! pieces of one file. A missing file, a part of the image in no file, and samples that two pieces
//! have with different numbers are errors.
//!
//! **Cell data** are samples in the middles of the cells: one fewer along each axis, in an image
//! the first half a step from the origin. They are read where there is no scalar point data, or by
//! their name.
//!
//! **Rectilinear and curvilinear grids** (`.vtr`, `.vts`) are read like images, in index space;
//! [`coordinates`] gives the positions of their samples.
//!
//! **Unstructured grids** (`.vtu`, `.pvtu`), and lists of blocks of them (`.vtm`, `.vtpc`,
//! `.vtpd`), are opened as meshes, by [`open_mesh`].
//!
//! Modules: `head` (the XML), `array` (the data of an array), `stored` (raw bytes and base64),
//! `image` (extents, pieces, fields), `grid` (coordinates of rectilinear and curvilinear grids),
//! `cells` (unstructured grids).

pub mod array;
mod cells;
mod grid;
pub mod head;
mod image;
mod stored;

#[cfg(test)]
mod pieces_tests;
#[cfg(test)]
pub(in crate::formats) mod tests;

use crate::bytes::ByteSource;
use crate::cells::CellMesh;
use crate::error::Result;
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::format::{Format, Head};
use crate::formats::shared::{OpenOptions, has_suffix};
use crate::volume::VolumeSource;
use head::Document;
use image::Image;
use std::path::Path;
use std::sync::Arc;

/// VTK XML.
pub(in crate::formats) struct VtkXml;

impl Format for VtkXml {
    fn name(&self) -> &'static str {
        "a VTK XML file"
    }

    fn suffixes(&self) -> &'static [&'static str] {
        &[
            ".vti", ".vtr", ".vts", ".vtu", ".pvti", ".pvtr", ".pvts", ".pvtu", ".vtm", ".vtmb", ".vtpc",
            ".vtpd",
        ]
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        // Other XML, such as XDMF, is of other programs.
        head.text().starts_with(b"<") && head.bytes.windows(8).any(|tag| tag == b"<VTKFile")
    }

    fn is_mesh(&self, head: &Head<'_>) -> bool {
        is_mesh(&head.bytes) || has_suffix(head.path, &[".vtu", ".pvtu", ".vtm", ".vtmb", ".vtpc", ".vtpd"])
    }

    fn volume(&self, path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
        open(path, options)
    }

    fn mesh(&self, path: &Path, options: &OpenOptions) -> Result<CellMesh> {
        open_mesh(path, options)
    }

    fn coordinates(&self, path: &Path, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
        coordinates(&Arc::new(ByteSource::open(path, options.io)?), options.field.as_deref())
    }

    fn time(&self, path: &Path, options: &OpenOptions) -> Result<Option<f64>> {
        time(&Arc::new(ByteSource::open(path, options.io)?))
    }
}

/// Opens the image of a `.vti` file, or the samples of the grid of a `.vtr` or `.vts` file.
///
/// # Errors
/// [`Error::BadInput`](crate::Error::BadInput) for a malformed file, another VTK type, vectors;
/// [`Error::Usage`](crate::Error::Usage) when several fields ask for a choice.
pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    image::open(&Arc::new(ByteSource::open(path, options.io)?), options.field.as_deref())
}

/// The coordinates of the samples of a field of a `.vtr` or `.vts` file; `None` of an image.
///
/// # Errors
/// As [`open`].
pub(crate) fn coordinates(source: &Arc<ByteSource>, wanted: Option<&str>) -> Result<Option<GridCoordinates>> {
    grid::coordinates(&Image::open(source)?, wanted)
}

/// The time that a file, or the first one that an index lists, has in its field data as
/// `TimeValue`.
///
/// # Errors
/// [`Error::BadInput`](crate::Error::BadInput) for a malformed file.
pub(in crate::formats) fn time(source: &Arc<ByteSource>) -> Result<Option<f64>> {
    grid::time(&Document::open_one_of(
        source,
        &[
            "ImageData",
            "RectilinearGrid",
            "StructuredGrid",
            "UnstructuredGrid",
            "PImageData",
            "PRectilinearGrid",
            "PStructuredGrid",
            "PUnstructuredGrid",
            "vtkMultiBlockDataSet",
            "vtkPartitionedDataSetCollection",
            "vtkPartitionedDataSet",
        ],
    )?)
}

/// Opens the mesh of a `.vtu` or `.pvtu` file, or of a list of blocks.
///
/// # Errors
/// [`Error::BadInput`](crate::Error::BadInput) for a malformed file or another VTK type;
/// [`Error::Usage`](crate::Error::Usage) when there is no field of the name wanted.
pub(crate) fn open_mesh(path: &Path, options: &OpenOptions) -> Result<CellMesh> {
    CellMesh::new(Arc::new(cells::open(path, options.io)?), options.field.as_deref())
}

/// Whether the head of a VTK XML file says that it is an unstructured grid, or a list of blocks.
pub(in crate::formats) fn is_mesh(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let tag =
        text.split_once("<VTKFile").and_then(|(_, rest)| rest.split_once('>')).map_or("", |(tag, _)| tag);
    let kind = tag.split_once("type").map_or("", |(_, rest)| rest.trim_start_matches([' ', '=', '"', '\'']));
    let kinds = ["UnstructuredGrid", "PUnstructuredGrid", "vtkMultiBlockDataSet", "vtkPartitionedDataSet"];
    kinds.iter().any(|k| kind.starts_with(k))
}
