//! Files that isospan writes: surfaces, which it reads too, and tetrahedra.

pub mod surface;
pub(crate) mod tets;
