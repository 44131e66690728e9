//! The triangles of one chunk: marching tetrahedra on its blocks, or marching cubes on blocks of a
//! grid.
//!
//! ```text
//!  cells ─▶ numbering ─▶ patch ───┐      tetrahedra as they were read
//!  numbered ──────────▶ patch ────┼──▶ chunk_surface ──▶ weld
//!  marching_cubes ────────────────┘    cells of a grid
//! ```
//!
//! The arithmetic of four edges or tetrahedra at a time is in `fours`, the table of cases in
//! `cases`.

pub mod cap;
mod cases;
mod cells;
mod chunk_surface;
mod edges;
mod fours;
mod marching_cubes;
pub mod marching_tets;
mod numbered;
mod numbering;
mod ordered;
mod patch;
mod workbench;

#[cfg(test)]
pub(crate) use cells::in_order;
pub use cells::{CellSource, Sides};
pub use chunk_surface::{ChunkSurface, SharedEdge};
pub use marching_cubes::{CubeBench, GridBlock, marching_cubes, share_inside};
pub use marching_tets::extract;
pub(crate) use numbered::NumberedBlock;
pub(crate) use ordered::Unpacked;
pub use workbench::Workbench;
