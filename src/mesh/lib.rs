//! isospan-mesh joins points by their Delaunay tetrahedralization: exact, in chunks that agree.
//!
//! * [`points`] are quasi-Monte Carlo sets: Hammersley, Halton, hyperbolic cross, and regular ones.
//!   A brick of the domain lists its own points.
//! * [`mesh`] makes the tetrahedra of a chunk, and proves which of them are those of the whole.
//! * [`predicates`] say on which side a point lies, exactly.
//! * [`sample`] interpolates a grid of samples at positions.
//! * [`raster`] finds the samples in a tetrahedron, [`locate`] the tetrahedron of a position.
//! * [`simd`] is vector code with the same bits on every machine.
//!
//! Positions are whole numbers of at most 24 bits, so predicates are exact, and the mesh of given
//! points is one and the same, in whatever chunks it is made.
//!
//! # Example
//!
//! ```
//! use isospan_io::geom::Lattice;
//! use isospan_io::geom::curve::Order;
//! use isospan_mesh::mesh::mesher::Mesher;
//! use isospan_mesh::points::{PointSet, PointSpec};
//! use isospan_mesh::predicates::signed_volume6;
//!
//! # fn main() -> isospan_io::Result<()> {
//! // 1000 Halton points in a box of 65 x 65 x 33 samples, and points on its boundary.
//! let lattice = Lattice::new([65, 65, 33])?;
//! let set = PointSet::new(PointSpec::Halton { n: 1_000 }, lattice)?;
//! let mut sites = vec![];
//! set.sites_in(&lattice.domain(), &mut sites);
//! let positions: Vec<_> = sites.iter().map(|site| site.pos).collect();
//!
//! // All in one: `mesh::chunk` has the way in chunks.
//! let mut mesher = Mesher::new();
//! mesher.delaunay(&positions, &Order::for_count(positions.len() as u64))?;
//! let (mut tetrahedra, mut volume6) = (0, 0);
//! mesher.for_each_tet(|corners| {
//!     let [a, b, c, d] = corners.map(|number| positions[number as usize]);
//!     tetrahedra += 1;
//!     volume6 += signed_volume6(a, b, c, d);
//! });
//! println!("{tetrahedra} tetrahedra");
//! assert_eq!(volume6, lattice.volume6(), "they fill the box exactly");
//! # assert!(tetrahedra > 6_000);
//! # Ok(())
//! # }
//! ```

// What only vector code of x86-64 uses is looked for there.
#![cfg_attr(not(target_arch = "x86_64"), allow(dead_code, unused_imports, unused_mut))]

pub mod locate;
pub mod mesh;
pub mod points;
pub mod predicates;
pub mod raster;
pub mod sample;
pub mod simd;
