//! Isosurfaces: marching tetrahedra, welding, checking.
//!
//! ```text
//!  tetrahedra of a chunk ──▶ ChunkSurface ──▶ SurfaceBuilder ──▶ StoredSurface ──▶ a writer of formats/
//!                    extract (any thread)   push (chunk order)   finish
//! ```
//!
//! * [`extract`] turns the active tetrahedra of one chunk into triangles, welded inside the chunk.
//!   Any number of chunks may be extracted at once.
//! * [`weld`] joins the chunks, in chunk order, by edge key, and stores the result on disk beyond a
//!   given size.
//! * [`edit`] changes a finished surface: cuts it, keeps some of its components, makes do with
//!   fewer triangles, splits vertices at which it touches itself.
//! * [`nets`] makes the surfaces of labels, with walls that neighbours share.
//! * [`check`] says of any triangle mesh whether it is closed, manifold and oriented.
//!
//! An edge of the mesh is the pair of its [`isospan_io::geom::PointId`]s, the lower first.
//! Everything about a surface vertex is a function of its edge, so neither the threads nor the cut
//! into chunks show in the surface.

pub mod check;
mod closest;
pub mod edit;
pub mod extract;
mod model;
pub mod nets;
#[cfg(test)]
mod testing;
pub mod weld;
mod world_map;

#[cfg(feature = "compare")]
pub(crate) use closest::closest;
pub(crate) use model::relative_to;
pub(crate) use model::vertices_from;
pub use model::{Joined, SurfaceSource, TriMesh, Vertex};
pub use world_map::{WorldMap, nearby_origin};
