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
//! their coordinates are the positions of their samples.
//!
//! **Unstructured grids** (`.vtu`, `.pvtu`), and lists of blocks of them (`.vtm`, `.vtpc`,
//! `.vtpd`), are opened as meshes.
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

use crate::cells::CellMesh;
use crate::error::Result;
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::mesh_file::MeshFile;
use crate::formats::shared::{OpenOptions, has_suffix};
use crate::volume::VolumeSource;
use image::Image;
use std::path::PathBuf;

/// VTK XML.
pub(in crate::formats) struct VtkXml;

static ABOUT: About = About {
    volumes: &["VTI", "VTR", "VTS", "PVTI", "PVTR", "PVTS"],
    meshes: &["VTU", "PVTU", "VTM"],
    suffixes: &[
        ".vti", ".vtr", ".vts", ".vtu", ".pvti", ".pvtr", ".pvts", ".pvtu", ".vtm", ".vtmb", ".vtpc", ".vtpd",
    ],
    ..About::named("a VTK XML file")
};

impl Format for VtkXml {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        // Other XML, such as XDMF, is of other programs.
        head.text().starts_with(b"<") && head.bytes.windows(8).any(|tag| tag == b"<VTKFile")
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let is_mesh = is_mesh(&head.bytes)
            || has_suffix(head.path, &[".vtu", ".pvtu", ".vtm", ".vtmb", ".vtpc", ".vtpd"]);
        match is_mesh {
            true => Ok(Box::new(MeshFile::new(cells::open(head.file()?, head.io)?)?)),
            false => Ok(Box::new(Image::open(head.file()?)?)),
        }
    }
}

/// An image (`.vti`), or a rectilinear or curvilinear grid (`.vtr`, `.vts`).
impl Dataset for Image {
    fn files(&self) -> Vec<PathBuf> {
        self.files.clone()
    }

    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        image::volume(self, options.field.as_deref())
    }

    fn coordinates(&self, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
        grid::coordinates(self, options.field.as_deref())
    }

    /// `TimeValue` of its field data, or of those of the first file that an index lists.
    fn time(&self, _: &OpenOptions) -> Result<Option<f64>> {
        grid::time(&self.doc)
    }
}

/// A mesh (`.vtu`, `.pvtu`), or a list of blocks (`.vtm`).
impl Dataset for MeshFile<cells::Grid> {
    fn is_mesh(&self) -> bool {
        true
    }

    fn files(&self) -> Vec<PathBuf> {
        self.data_files()
    }

    fn mesh(&self, options: &OpenOptions) -> Result<CellMesh> {
        self.of_field(options)
    }

    fn time(&self, _: &OpenOptions) -> Result<Option<f64>> {
        grid::time(self.file.document())
    }
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
