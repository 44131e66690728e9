//! Exact Delaunay tetrahedralization of lattice points, chunk by chunk.

pub mod tet;
