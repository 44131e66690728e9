//! Exact Delaunay tetrahedralization of lattice points, chunk by chunk.

mod certify;
pub mod check;
pub mod chunk;
pub mod delaunay;
pub mod tet;
