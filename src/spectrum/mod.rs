//! The contour spectrum: how large is the isosurface, before it is extracted?
//!
//! For every isovalue v (a value `>=` v is inside) there are the number of active tetrahedra N(v),
//! the area A(v) of the isosurface, the volume V(v) that it encloses, and the gradient integrated
//! over it, T(v) = ∫|∇f| dA: the *contour spectrum* of Bajaj, Pascucci and Schikore 1997 ("The
//! contour spectrum"). Seen as curves they show where something happens, and [`suggest`] reads
//! isovalues off them.
//!
//! **What one tetrahedron contributes.** Take its corner values f0 <= f1 <= f2 <= f3, its volume
//! Vol and its gradient g. As the field is linear there, the share of its volume below v is the
//! integral of the quadratic B-spline M over the knots f0, f1, f2, f3 (Curry and Schoenberg), and
//! its area at v is |g| Vol M(v):
//!
//! ```text
//!   M(v) │      ╭──╮          three parabolas that meet smoothly; no root, no slicing:
//!        │    ╱      ╲        |g| Vol is one cross product sum a tetrahedron, and M(v) a
//!        │  ╱          ╲_     handful of multiplications an isovalue
//!        └─f0──f1────f2────f3── v
//! ```
//!
//! **What is exact.** N, A, V and T are stored at up to 128 isovalues, the *knots*: multiples of a
//! power of two. There they are sums over all tetrahedra that are not void, in world units: N
//! exact, the others to one part in two million. Between knots A, V and T are not stored: extract
//! the surface.
//!
//! N alone is stored at many more isovalues, the *levels*: multiples of a round step, 1 or 2 times
//! a power of ten, up to 8192 of them in the range. A tetrahedron is active for min < v <= max, so
//! N(v) counts the minima below v less the maxima below v. So N is known at most isovalues that a
//! person writes ([`SpectrumFile::active`]). For the others
//! [`crate::pipeline::Step::count`] decodes the blocks of the isovalue, and is as exact.
//!
//! **Cells of a grid.** Volumes that are stored as samples are measured cell by cell instead
//! ([`ChunkPart::of_cells`]): N is as exact, A, V and T are those of marching cubes, to about one
//! part in a hundred. What is said of tetrahedra here holds for cells, then.
//!
//! **Chunk by chunk.** Which isovalues these are depends on the range of all values, which is known
//! when the last chunk has been made. So each chunk is measured while its tetrahedra and values are
//! at hand, on grids of its own range, which are finer, or as fine, and hold all isovalues of the
//! coarser grids of the whole ([`grid`](self::IsovalueGrid)); a spectrum is put together from those
//! parts ([`ChunkPart`]), which are some thousand bytes each, and not from tetrahedra. An archive
//! that is finished has the sum alone, and a small one has none: its tetrahedra are summed up again
//! when it is asked for.
//!
//! **Determinism.** Integers are added in any order; `f64` sums are made over the tetrahedra of a
//! chunk in the order in which its blocks decode, and over chunks in their order. A part is a
//! function of the chunk, its values and the [`Limits`].

mod builder;
mod cubes;
mod design;
mod grid;
mod lanes;
mod measure;
mod part;
mod store;
pub mod suggest;
mod sums;
mod tetra;

pub use builder::SpectrumBuilder;
pub use cubes::CellShapes;
pub use design::{Design, Limits};
pub use grid::{Family, IsovalueGrid, LevelStep};
pub use lanes::LaneBuffers;
pub use part::{ChunkPart, Digits, Vertices};
pub use store::SpectrumFile;

#[cfg(test)]
pub(crate) use design::MOST_LEVELS;

/// The isosurface of one isovalue. Lengths are world units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpectrumKnot {
    /// The isovalue.
    pub isovalue: f32,
    /// Cells that the isosurface crosses: tetrahedra, or cubes of a pyramid.
    pub active_cells: u64,
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
    pub knots: Vec<SpectrumKnot>,
    /// Isovalues at which the number of active tetrahedra is stored.
    pub levels: IsovalueGrid,
}

#[cfg(test)]
mod tests;
