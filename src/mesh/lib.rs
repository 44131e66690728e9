//! isospan-mesh joins points by their Delaunay tetrahedralization: exact, in chunks that agree.
//!
//! * [`points`] are quasi-Monte Carlo sets: Hammersley, Halton, hyperbolic cross, and regular ones.
//!   A brick of the domain lists its own points.
//! * [`mesh`] makes the tetrahedra of a chunk, and proves which of them are those of the whole.
//! * [`predicates`] say on which side a point lies, exactly.
//! * [`sample`] interpolates a grid of samples at positions.
//! * [`raster`] finds the samples in a tetrahedron, [`locate`] the tetrahedron of a position.
//! * [`simd`] is vector code with the same bits on every machine.

// What only vector code of x86-64 uses is looked for there.
#![cfg_attr(not(target_arch = "x86_64"), allow(dead_code, unused_imports, unused_mut))]

pub mod locate;
pub mod mesh;
pub mod points;
pub mod predicates;
pub mod raster;
pub mod sample;
pub mod simd;
