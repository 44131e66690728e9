//! Exact Delaunay tetrahedralization of lattice points, chunk by chunk.

mod certify;
pub mod check;
pub mod chunk;
pub mod delaunay;
mod late;
pub mod list;
mod owned;
pub(crate) mod stars;
pub mod tet;
