//! Unstructured meshes: points, cells that name their vertices, and a field on points or cells.
//!
//! A reader of `formats/` opens a file as a [`CellFile`]: what is in it, and streams of its
//! numbers. [`CellMesh`] makes of it what the pipeline needs, in three passes that can be made any
//! number of times, each in blocks and in constant memory:
//!
//! ```text
//!  points()  positions of points 0, 1, 2, …                   checked to be finite
//!  values()  a value for each, in the same order              one component, or the magnitude; cell data averaged
//!  cells()   cells as kinds and vertex numbers                checked against the number of points
//!              └─▶ split()  into tetrahedra, by a rule that neighbours agree on
//!                    └─▶ orient()  once positions are at hand: inverted ones turned, degenerate ones marked
//! ```
//!
//! **Numbers.** Points are numbered in the order of the stream, whatever labels a file gives them.
//! Nothing here holds a point, a value or a cell longer than its block; who needs them together
//! sorts them (externally).  **Cells.** [`CellKind`] lists the kinds that are read: linear and
//! quadratic ones, and polyhedra. Polyhedra and some quadratic ones need vertices of their own
//! ([`polyhedron`], [`quadratic`]). Cells without a volume (vertices, lines, triangles: Gmsh writes
//! the boundary too) are counted and passed over; kinds that are neither are refused by name.
//!
//! **Cell data** are averaged to the vertices: the mean over the cells that use the vertex, each
//! counted once. See [`average`](mod@average) for how that is done in bounded memory.

pub mod average;
mod blocks;
pub mod kind;
mod order;
pub mod orient;
pub mod polyhedron;
pub mod quadratic;
pub mod scan;
pub mod split;
mod star;
mod survey;

mod mesh;

pub use blocks::{CellBlocks, Part, PointBlocks};
pub use kind::CellKind;
pub use mesh::{CellMesh, ChosenField, FieldBlocks, StoredBlocks};
pub use orient::{Orientation, orient};
pub use split::split;
pub use star::CellTet;

use crate::error::Result;
use crate::volume::ScalarType;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Points or cells in a block of a stream, at most.
pub const BLOCK: usize = 4096;

/// Whether a field has a value for each point or for each cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Center {
    /// A value for each point.
    Point,
    /// A value for each cell; averaged to the vertices before it is used.
    Cell,
}

/// A field that a file offers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellField {
    /// Its name in the file.
    pub name: String,
    /// Type of a stored number.
    #[serde(
        serialize_with = "ScalarType::serialize_name",
        deserialize_with = "ScalarType::deserialize_name"
    )]
    pub scalar: ScalarType,
    /// Numbers a point or cell: 1 for a scalar, 3 for a vector, 9 for a tensor.
    pub components: u32,
    /// Where it is given.
    pub center: Center,
}

/// What a file tells of its mesh before its numbers are read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellsInfo {
    /// The file that was named.
    pub path: PathBuf,
    /// The format, as a person would call it: "VTK XML UnstructuredGrid (appended raw, zlib, UInt32
    /// header)".
    pub format: String,
    /// Number of points.
    pub points: u64,
    /// Number of cells, those without a volume included.
    pub cells: u64,
    /// All fields of numbers, in file order.
    pub fields: Vec<CellField>,
    /// The field that the file names as its active one, by its place in `fields`.
    pub active: Option<usize>,
    /// The files that hold the mesh, where it is more than the one that was named.
    pub data_files: Vec<PathBuf>,
}

impl CellsInfo {
    /// All files that make up the mesh, the one that was named first.
    pub fn files(&self) -> Vec<PathBuf> {
        let others = self.data_files.iter().filter(|f| **f != self.path);
        std::iter::once(&self.path).chain(others).cloned().collect()
    }
}

/// Numbers front to back.
pub trait NumberStream: Send {
    /// Fills `out` with the next numbers.
    ///
    /// # Errors
    /// When the file cannot be read, decoded, or ends too early.
    fn fill(&mut self, out: &mut [f64]) -> Result<()>;

    /// To be called after the last number.
    ///
    /// # Errors
    /// When more follow.
    fn finish(&mut self) -> Result<()>;
}

/// Cells front to back.
pub trait CellStream: Send {
    /// Puts the next cells, at most [`BLOCK`], into `out` (cleared first); `false` after the last.
    /// Vertex numbers need not be checked against the number of points: [`CellMesh`] does that.
    ///
    /// # Errors
    /// When the file cannot be read, decoded, ends too early, goes on too long, or has a cell of a
    /// kind that is not read.
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool>;
}

/// A mesh in a file. Implemented by the formats; used through [`CellMesh`].
pub trait CellFile: Send + Sync {
    /// What is in it.
    fn info(&self) -> &CellsInfo;

    /// The positions: x, y, z of each point.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn points(&self) -> Result<Box<dyn NumberStream>>;

    /// The cells, those without a volume included.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn cells(&self) -> Result<Box<dyn CellStream>>;

    /// The numbers of the field `info().fields[field]`: all components of a point or cell, then
    /// those of the next.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>>;

    /// Whether some cells may be polyhedra.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn may_have_polyhedra(&self) -> Result<bool> {
        Ok(false)
    }

    /// A hash of all that points and cells are read from, as it is stored: files of the same one
    /// have the same of both. `None` where that is not known before they are read.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn stored_hash(&self) -> Result<Option<u128>> {
        Ok(None)
    }
}

/// The field of cells in which VTK marks those that another piece has too (1), and hidden ones
/// (32).
pub(crate) const GHOSTS: &str = "vtkGhostType";

/// Whether marks say that a cell does not count.
fn is_ghost(marks: f64) -> bool {
    marks as u8 & (1 | 32) != 0
}

/// The marks of points that are hidden, and of cells that are hidden or refined by other cells; of
/// a structured grid.
pub(crate) const HIDDEN: [(&str, u8); 2] = [("PointData", 2), ("CellData", 8 | 32)];

/// Some cells, one after another.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellBlock {
    kinds: Vec<CellKind>,
    vertices: Vec<u64>,
    /// Where the vertices of each cell end.
    ends: Vec<usize>,
}

impl CellBlock {
    /// Removes all cells.
    pub fn clear(&mut self) {
        self.kinds.clear();
        self.vertices.clear();
        self.ends.clear();
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.kinds.len()
    }

    /// Whether there is no cell.
    pub fn is_empty(&self) -> bool {
        self.kinds.is_empty()
    }

    /// Appends a cell.
    ///
    /// # Panics
    /// When the number of vertices is not that of the kind, or the kind is a polyhedron.
    pub fn push(&mut self, kind: CellKind, vertices: &[u64]) {
        assert!(kind != CellKind::Polyhedron, "polyhedra are told by their faces");
        assert_eq!(vertices.len(), kind.vertices(), "readers count vertices");
        self.kinds.push(kind);
        self.vertices.extend_from_slice(vertices);
        self.ends.push(self.vertices.len());
    }

    /// Appends a polyhedron, face by face: of each its number of vertices, then these. The numbers
    /// must agree; [`CellMesh`] checks the rest.
    pub fn push_polyhedron(&mut self, faces: &[u64]) {
        self.kinds.push(CellKind::Polyhedron);
        self.vertices.extend_from_slice(faces);
        self.ends.push(self.vertices.len());
    }

    /// Numbers that the cells take.
    pub fn numbers(&self) -> usize {
        self.vertices.len()
    }

    /// What is kept of a cell.
    fn of_mut(&mut self, i: usize) -> &mut [u64] {
        let start = if i == 0 { 0 } else { self.ends[i - 1] };
        &mut self.vertices[start..self.ends[i]]
    }

    /// Makes cells without a volume of those at certain places.
    fn flatten(&mut self, is_ghost: impl Fn(usize) -> bool) {
        let (mut start, mut kept) = (0, 0);
        for i in 0..self.kinds.len() {
            let end = self.ends[i];
            if is_ghost(i) {
                self.kinds[i] = CellKind::Flat;
            } else {
                self.vertices.copy_within(start..end, kept);
                kept += end - start;
            }
            (start, self.ends[i]) = (end, kept);
        }
        self.vertices.truncate(kept);
    }

    /// The cells in order: kind and vertex numbers, in VTK's order of vertices. Those of a cell
    /// without a volume are not kept. Of a polyhedron there are its faces, each with its number of
    /// vertices before these ([`polyhedron::Faces`]).
    pub fn iter(&self) -> impl Iterator<Item = (CellKind, &[u64])> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        let spans = starts.zip(&self.ends).map(|(start, &end)| &self.vertices[start..end]);
        self.kinds.iter().copied().zip(spans)
    }
}
