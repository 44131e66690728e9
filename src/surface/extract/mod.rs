//! The triangles of one chunk: marching tetrahedra on its blocks.
//!
//! ```text
//!  cells ─▶ numbering ─▶ patch ───────────┐      tetrahedra of which nothing is known yet
//!  numbered ──────────▶ patch ────────────┼──▶ chunk_surface ──▶ weld
//!  known ─▶ crossed edges and tetrahedra ─┘      a block that is kept for many isovalues
//! ```
//!
//! The arithmetic of four edges or tetrahedra at a time is in `fours`, the table of cases in
//! `cases`.

mod add_known;
pub mod cap;
mod cases;
mod cells;
mod chunk_surface;
mod edges;
mod fours;
mod known;
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
pub(crate) use known::{Flaw, Joiner, Known, KnownBlock};
pub use marching_tets::extract;
pub(crate) use numbered::NumberedBlock;
pub(crate) use ordered::Unpacked;
pub use workbench::Workbench;
