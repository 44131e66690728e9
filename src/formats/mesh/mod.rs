//! Formats of tetrahedral and mixed meshes, one file or folder each, and the writers of meshes.

pub(in crate::formats) mod ensight;
pub(in crate::formats) mod exodus;
pub(in crate::formats) mod gmsh;
pub(crate) mod tet_arrays;
pub(in crate::formats) mod tetgen;
pub(crate) mod tetrahedra;
pub(in crate::formats) mod vtkhdf;
mod vtu;

#[cfg(test)]
pub(in crate::formats) mod tests;
