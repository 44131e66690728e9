//! The contour spectrum: how large is the isosurface, before it is extracted?
//!
//! For every isovalue v (a value `>=` v is inside) there are the number of active tetrahedra N(v), the area A(v) of the isosurface, the
//! volume V(v) that it encloses, and the gradient integrated over it, T(v) = ∫|∇f| dA: the *contour spectrum* of Bajaj, Pascucci
//! and Schikore 1997 ("The contour spectrum"). Seen as curves they tell where something happens, and [`suggest`] reads isovalues off them.
//!
//! **What one tetrahedron contributes.** Take its corner values f0 <= f1 <= f2 <= f3, its volume Vol and its gradient g. As the field is linear
//! there, the share of its volume below v is the integral of the quadratic B-spline M over the knots f0, f1, f2, f3 (Curry and Schoenberg),
//! and its area at v is |g| Vol M(v):
//!
//! ```text
//!   M(v) │      ╭──╮          three parabolas that meet smoothly; no root, no slicing:
//!        │    ╱      ╲        |g| Vol is one cross product sum a tetrahedron, and M(v) a
//!        │  ╱          ╲_     handful of multiplications an isovalue
//!        └─f0──f1────f2────f3── v
//! ```
//!
//! **What is exact.** N, A, V and T are stored at up to 256 isovalues, the *knots*: three in four of them multiples of a round
//! step (1, 2 or 5 times a power of ten), the others where block values are dense. There they are sums over all tetrahedra that are not void, in world
//! units: N exact, the others but for rounding in `f64`. Between knots A, V and T are not stored: extract the surface.
//!
//! N alone is stored at many more isovalues, the *levels*: all multiples in the range of a finer round step, so fine that there is a level
//! for every four points (at most 2^20). A tetrahedron is active for min < v <= max, so N(v) counts the minima below v
//! less the maxima below v; both are values of vertices. The difference of N from level to level is small and takes about a byte and a half. So
//! N is known at any isovalue that a person writes, for one page of 4096 levels read ([`SpectrumFile::active`]); to store it at all
//! isovalues would take 10 to 14 bits a point, more than connectivity allows. For the others [`crate::pipeline::count_active`]
//! decodes the blocks of the isovalue, and is as exact.
//!
//! **Determinism.** Integers are added in any order; `f64` sums are made over the tetrahedra of a chunk in the order of the archive, and over
//! chunks in their order. A chunk's part ([`ChunkPart`]) is a function of the chunk and the [`Design`].

mod design;
mod levels;
mod measure;
mod store;
pub mod suggest;

pub use design::{Design, ValueCounts};
pub use levels::{Levels, Step};
pub use measure::{Cells, ChunkPart, SpectrumBuilder};
pub use store::SpectrumFile;

#[cfg(test)]
pub(crate) use {
    levels::MOST_LEVELS,
    store::{LARGEST_KNOTS, PAGE_ACTIVE},
};

use serde::Serialize;

/// The isosurface of one isovalue. Lengths are world units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Knot {
    /// The isovalue.
    pub isovalue: f32,
    /// Tetrahedra that the isosurface crosses.
    pub active_tetrahedra: u64,
    /// Its area.
    pub area: f64,
    /// The volume of the tetrahedra where the field is at or above the isovalue.
    pub volume: f64,
    /// The length of the gradient, integrated over the isosurface.
    pub gradient: f64,
}

/// The contour spectrum of a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectrum {
    /// Least and largest value.
    pub range: [f32; 2],
    /// Tetrahedra that are not void.
    pub tetrahedra: u64,
    /// Their volume.
    pub volume: f64,
    /// Isovalues, ascending.
    pub knots: Vec<Knot>,
    /// Isovalues at which the number of active tetrahedra is stored.
    pub levels: Levels,
}

impl Spectrum {
    /// What it was measured at.
    pub fn design(&self) -> Design {
        Design {
            range: self.range,
            knots: self.knots.iter().map(|k| k.isovalue).collect(),
            levels: self.levels,
        }
    }
}

#[cfg(test)]
mod tests;
