//! Formats of tetrahedral and mixed meshes, one file or folder each.

pub(in crate::formats) mod ensight;
pub(in crate::formats) mod exodus;
pub(in crate::formats) mod gmsh;
pub(in crate::formats) mod tetgen;
pub(in crate::formats) mod vtkhdf;

#[cfg(test)]
pub(in crate::formats) mod tests;
