//! Exact Delaunay tetrahedralization of lattice points, chunk by chunk.

pub mod check;
pub mod delaunay;
pub mod tet;
