//! Files that isospan writes: surfaces, which it reads too, and tetrahedra; tables of labels.

pub mod labels;
pub mod surface;
pub(crate) mod tets;
