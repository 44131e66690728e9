//! How do the nodes of a grid at or above an isovalue hang together, and those below, and which
//! ball fits between the others?
//!
//! ```text
//!  values, box by box ─▶ PhaseMap: a bit a node ─┬─▶ connected: pieces, which faces they join
//!                                                └─▶ largest_ball: the node farthest from others
//! ```
//!
//! The two *phases* are the nodes whose value is at or above the isovalue, and those below it. A
//! node without a value is in neither.
//!
//! # What hangs together?
//!
//! Marching cubes keeps two corners inside apart where they lie on a diagonal of a face, and so
//! joins the two others. What is above hangs together along edges of cells alone (6 neighbours);
//! what is below also along diagonals of faces (18 neighbours). So pieces of phases are those that
//! the surface bounds. Planes of runs are joined by union-find, and of pieces that have ended only
//! their number stays: memory is that of the runs of two planes.
//!
//! # Which ball?
//!
//! The one around the node that is farthest from all nodes of the other phase, from those without
//! a value, and from the faces of the grid: an exact Euclidean distance transform, axis after axis
//! by lower envelopes of parabolas. Of each node the nearest foreign one in its plane is kept, 4
//! bytes on disk beyond memory. Columns that cannot hold a larger ball are passed over.
//!
//! # Cost
//! A pass over planes for each question and phase, linear in the nodes. The answers depend on
//! neither threads nor memory.
//!
//! # References
//! Felzenszwalb, Huttenlocher 2012, "Distance transforms of sampled functions". Kong, Rosenfeld
//! 1989, "Digital topology": why the two phases need neighbours of two kinds.

mod ball;
mod connected;
mod map;
#[cfg(test)]
mod tests;

pub use ball::{Ball, BallMeans, largest_ball};
pub use connected::{Connected, connected};
pub use map::{Phase, PhaseMap, PhaseSlab};
