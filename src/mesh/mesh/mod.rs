//! Exact Delaunay tetrahedralization of lattice points, chunk by chunk.

mod certify;
pub mod check;
pub mod chunk;
mod delaunay;
mod late;
pub mod list;
pub mod mesher;
mod owned;
mod region;
mod stars;
pub mod tet;
