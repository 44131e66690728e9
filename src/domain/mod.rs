//! A tetrahedral mesh of any size, laid out so that a brick finds its cells.
//!
//! A reader gives points, values and cells in the order of the file. Here they become files in the
//! scratch folder, each written front to back and then mapped, so that nothing of the size of the
//! mesh is in memory:
//!
//! ```text
//!  points ─▶ positions on the fine lattice ┐                               ┌─▶ faces, sorted: those of one tetrahedron ─▶ boundary
//!  values ─▶ one a point                   ├─▶ cells, split in tetrahedra ─┤                  those of two ─▶ bodies
//!  equals ─▶ one vertex                    │   turned the right way        ├─▶ gradients at vertices, sorted by vertex
//!  cells ──────────────────────────────────┘                               └─▶ (brick, cell), sorted ─▶ the cells of each brick
//! ```
//!
//! Sorting is external ([`isospan_io::bytes`]). A brick has all cells whose bounding box meets it;
//! a point is looked for among the cells of its brick, in batches, by [`isospan_mesh::locate`].
//! Where values are fitted to those at the mesh's vertices, a brick has these too ([`vertices`]).
//!
//! Some cells add vertices to those of the file before: see [`middles`].
//!
//! # The box around it
//!
//! The mesh lies in a box of cubes ("voxels", so that bricks and chunks are those of a volume) on
//! the integer lattice: the longest side of its bounding box is 2^24 steps, the others are rounded
//! up to whole cubes. Points of the set outside of the mesh are void.
//!
//! # Its own vertices
//!
//! A mesh that is asked for whole is not sampled: see [`own`]. What follows is about those that
//! are.
//!
//! # Its boundary
//!
//! Points inside stop short of the boundary, and the reduced domain would end a point spacing too
//! early. So the boundary is sampled too ([`boundary`]), at matching density, its corners and edges
//! ([`creases`]) first. A tetrahedron of the reduction is **inside** if all its corners lie in one
//! body of the mesh ([`bodies`]) and, where a corner is a boundary sample, its centroid does too:
//! what spans a hole, a concavity, the gap between two bodies or the face at which they touch is
//! left out.

pub(crate) mod amount;
pub(crate) mod bodies;
pub(crate) mod boundary;
pub(crate) mod buckets;
pub(crate) mod column;
mod contact;
mod creases;
pub(crate) mod frame;
pub(crate) mod gradients;
pub(crate) mod identity;
pub(crate) mod merge;
mod middles;
mod near;
pub(crate) mod nearest;
pub(crate) mod own;
mod scatter;
pub(crate) mod settings;
pub(crate) mod spacing;
pub(crate) mod store;
pub(crate) mod vertices;
pub(crate) mod voxels;
pub(crate) mod wall;
