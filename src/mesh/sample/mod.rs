//! Values at points: interpolation of a structured volume at lattice positions.
//!
//! # How it works
//!
//! A position is an integer number of lattice steps, 2^s to a voxel edge, so on each axis
//!
//! ```text
//!   p  =  i · 2^s  +  r            cell i = p >> s,  fraction b = r / 2^s  (exact in f64),  a = 1 - b
//!
//!   voxel   i-1        i     p      i+1       i+2
//!            ●─────────●─────×───────●─────────●
//!                      ├─ b ─┤─ a ───┤
//! ```
//!
//! and no search is needed: the cell is a shift, the fraction a mask. Each rule is one-dimensional,
//! a few weights on consecutive voxels, and is applied along x, then y, then z (thesis,
//! section 3.2; its two linear weights are printed swapped):
//!
//! | [`Interpolation`] | voxels an axis | exact for | error on a smooth field |
//! |---|---|---|---|
//! | `Linear` | 2 | linear fields | O(h²), and never outside the range of the 8 corners |
//! | `Cubic` | 4 | cubic polynomials, at the border too | O(h⁴) |
//! | `CubicThesis` | 6 | linear fields | O(h²), no better than `Linear` |
//! | `Nearest` | 1 | constants | O(h) |
//!
//! The modules [`trilinear`], [`cubic`] and [`nearest`] derive them.
//!
//! # What holds
//!
//! * A position on a voxel gives that voxel's value, exactly, whatever its neighbours hold.
//! * A NaN voxel with a weight other than zero makes the value NaN: a void point. One with weight
//!   zero does not count. An infinite voxel does what arithmetic says; `nan` treats infinities
//!   before they come here.
//! * A value is computed in `f64` by `+ - *` and one `/` by a constant, in an order fixed by the
//!   position, and rounded to `f32` once: the same bits on every machine, in whichever block the
//!   position is sampled. Finite voxels give a finite value: what overshoots `f32` becomes the
//!   largest finite one.
//!
//! Cost: one pass over the positions, no allocation but the caller's output. `benches/sample.rs`
//! measures it.

pub mod cubic;
pub mod nearest;
pub mod trilinear;

use crate::simd::with_vectors;
use isospan_io::error::Error;
use isospan_io::geom::{Lattice, LatticePos};
use isospan_io::grid::IndexBox;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// How a value between voxels is had from them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// Trilinear.
    #[default]
    Linear,
    /// Tricubic: second derivatives by second differences.
    Cubic,
    /// Tricubic as the thesis prints it, a fourth difference in the place of the second derivative:
    /// for its tables.
    CubicThesis,
    /// The nearest voxel; half-way, the higher one.
    Nearest,
    /// Of a tetrahedral mesh: quadratic, with gradients estimated at the vertices.
    Quadratic,
    /// Of a tetrahedral mesh: quadratic as the thesis prints it, which is linear: for its tables.
    QuadraticThesis,
}

impl Interpolation {
    /// All of them, in the order of the command line's help.
    pub const ALL: [Self; 6] =
        [Self::Linear, Self::Cubic, Self::CubicThesis, Self::Nearest, Self::Quadratic, Self::QuadraticThesis];

    /// Whether it works on the samples of a volume.
    pub fn is_of_volumes(self) -> bool {
        !matches!(self, Self::Quadratic | Self::QuadraticThesis)
    }

    /// Whether it works on the cells of a tetrahedral mesh ([`crate::locate`]).
    pub fn is_of_meshes(self) -> bool {
        matches!(self, Self::Linear | Self::Quadratic | Self::QuadraticThesis)
    }

    /// Its name on the command line and in a manifest.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Cubic => "cubic",
            Self::CubicThesis => "cubic-thesis",
            Self::Nearest => "nearest",
            Self::Quadratic => "quadratic",
            Self::QuadraticThesis => "quadratic-thesis",
        }
    }

    /// The smallest box of voxels, within the volume, from which all of `positions` can be sampled;
    /// empty for none.
    ///
    /// The positions are within the lattice's domain.
    ///
    /// # Panics
    /// For an interpolation that is not [of volumes](Self::is_of_volumes).
    pub fn voxels_for(&self, lattice: &Lattice, positions: &[LatticePos]) -> IndexBox {
        let Some((lo, hi)) = bounds(positions) else { return IndexBox { lo: [0; 3], hi: [0; 3] } };
        // Every rule's first and last voxel grow with the position, so two corners tell the box.
        let span = |a: usize, p: u32| {
            let axis = SampledAxis::new(lattice, a);
            match self {
                Self::Linear => trilinear::span(&axis, p),
                Self::Cubic => axis.stencil(axis.cell(p), cubic::CUBIC),
                Self::CubicThesis => axis.stencil(axis.cell(p), cubic::THESIS),
                Self::Nearest => nearest::span(&axis, p),
                Self::Quadratic | Self::QuadraticThesis => unreachable!("{OF_MESHES}"),
            }
        };
        IndexBox {
            lo: std::array::from_fn(|a| span(a, lo[a]).0),
            hi: std::array::from_fn(|a| span(a, hi[a]).1),
        }
    }
}

/// How a vertex comes by its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Values {
    /// The field is interpolated at the vertex.
    Sample,
    /// From there it is moved towards the least squared error over the samples around it, not past
    /// them (`fit`).
    Fit,
}

impl Values {
    /// What is meant where nobody says how vertices come by their values: fitted, but for
    /// interpolations whose very values are wanted. The nearest voxel's may be a label, between two
    /// of which there is nothing; the thesis's two are for its tables.
    pub fn usual(interpolation: Interpolation) -> Self {
        match interpolation {
            Interpolation::Nearest | Interpolation::CubicThesis | Interpolation::QuadraticThesis => {
                Self::Sample
            }
            Interpolation::Linear | Interpolation::Cubic | Interpolation::Quadratic => Self::Fit,
        }
    }

    /// [`Values::Sample`].
    pub fn sampled() -> Self {
        Self::Sample
    }

    /// Whether it is [`Values::Sample`].
    pub fn is_sample(&self) -> bool {
        *self == Self::Sample
    }

    /// Its name on the command line and in a manifest.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sample => "sample",
            Self::Fit => "fit",
        }
    }
}

impl fmt::Display for Interpolation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Interpolation {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|i| i.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::usage(format!("no interpolation is called {name:?}; give one of {names}"))
        })
    }
}

/// Broken when a plan of a volume has an interpolation of meshes, which
/// [`Interpolation::is_of_volumes`] tells.
const OF_MESHES: &str = "a volume is never planned with an interpolation of meshes";

/// The samples of a box of voxels.
#[derive(Clone, Copy, Debug)]
pub struct VoxelBlock<'a> {
    /// Which voxels.
    pub voxels: IndexBox,
    /// Their values, x fastest.
    pub values: &'a [f32],
}

/// Appends the value at each of `positions` to `out`.
///
/// # Panics
/// When `block` does not hold [`Interpolation::voxels_for`] these positions, or its length is not
/// its box's: the caller made the block for them. For an interpolation that is not
/// [of volumes](Interpolation::is_of_volumes).
pub fn sample(
    how: Interpolation,
    lattice: &Lattice,
    block: &VoxelBlock<'_>,
    positions: &[LatticePos],
    out: &mut Vec<f32>,
) {
    let needed = how.voxels_for(lattice, positions);
    assert_eq!(block.values.len(), block.voxels.len(), "a block holds every voxel of its box once");
    assert!(
        needed.is_empty() || needed.intersect(&block.voxels) == needed,
        "the block {:?} lacks voxels of {needed:?}",
        block.voxels
    );
    match how {
        Interpolation::Linear => with_vectors(
            #[inline(always)]
            || trilinear::sample(block, trilinear::spots(lattice, &block.voxels, positions), out),
        ),
        Interpolation::Cubic => cubic::sample(lattice, block, positions, out),
        Interpolation::CubicThesis => cubic::sample_thesis(lattice, block, positions, out),
        Interpolation::Nearest => nearest::sample(lattice, block, positions, out),
        Interpolation::Quadratic | Interpolation::QuadraticThesis => unreachable!("{OF_MESHES}"),
    }
}

/// Some positions that are sampled in several volumes alike: what does not depend on the samples is
/// found out once.
pub struct Places<'a> {
    how: Interpolation,
    lattice: &'a Lattice,
    positions: Vec<LatticePos>,
    voxels: IndexBox,
    /// Of linear interpolation alone: it is the one where the rest takes no longer.
    spots: Vec<trilinear::Spot>,
}

impl<'a> Places<'a> {
    /// Of points of a lattice; there are none yet.
    pub fn new(how: Interpolation, lattice: &'a Lattice) -> Self {
        let voxels = IndexBox { lo: [0; 3], hi: [0; 3] };
        Self { how, lattice, positions: vec![], voxels, spots: vec![] }
    }

    /// Goes on to others: of these positions those in a range, then some of given numbers.
    pub fn find(&mut self, positions: &[LatticePos], range: Range<usize>, others: &[u32]) {
        let Self { how, lattice, positions: all, voxels, spots } = self;
        all.clear();
        all.extend_from_slice(&positions[range]);
        all.extend(others.iter().map(|&v| positions[v as usize]));
        *voxels = how.voxels_for(lattice, all);
        spots.clear();
        if *how == Interpolation::Linear {
            with_vectors(
                #[inline(always)]
                || spots.extend(trilinear::spots(lattice, voxels, all)),
            );
        }
    }

    /// The samples that are needed.
    pub fn voxels(&self) -> IndexBox {
        self.voxels
    }

    /// The points that are there.
    pub fn positions(&self) -> &[LatticePos] {
        &self.positions
    }

    /// Appends the value at each position, given the samples.
    ///
    /// # Panics
    /// When they are not those of [`Places::voxels`].
    pub fn sample(&self, values: &[f32], out: &mut Vec<f32>) {
        let block = VoxelBlock { voxels: self.voxels, values };
        if self.how != Interpolation::Linear {
            return sample(self.how, self.lattice, &block, &self.positions, out);
        }
        assert_eq!(values.len(), self.voxels.len(), "a block holds every voxel of its box once");
        with_vectors(
            #[inline(always)]
            || trilinear::sample(&block, self.spots.iter().copied(), out),
        );
    }
}

/// Smallest and largest coordinate on each axis; `None` without positions.
fn bounds(positions: &[LatticePos]) -> Option<(LatticePos, LatticePos)> {
    // Four lanes are a vector.
    let four = |[x, y, z]: LatticePos| [x, y, z, z];
    let first = four(*positions.first()?);
    let ([x, y, z, _], [u, v, w, _]) = with_vectors(
        #[inline(always)]
        || {
            positions.iter().fold((first, first), |(lo, hi), &p| {
                let p = four(p);
                ([0, 1, 2, 3].map(|a| p[a].min(lo[a])), [0, 1, 2, 3].map(|a| p[a].max(hi[a])))
            })
        },
    );
    Some(([x, y, z], [u, v, w]))
}

/// One axis of a lattice: from a coordinate to cell and fraction.
#[derive(Clone, Copy, Debug)]
struct SampledAxis {
    log2_steps: u32,
    /// The last cell: the far face belongs to it.
    last_cell: u32,
    /// 2^-s: the length of a step in voxel edges, exact.
    step: f64,
}

impl SampledAxis {
    fn new(lattice: &Lattice, axis: usize) -> Self {
        let log2_steps = lattice.log2_steps[axis];
        // A lattice has 2 to 2^24 + 1 samples an axis.
        let last_cell = (lattice.dims[axis] - 2) as u32;
        Self { log2_steps, last_cell, step: 1.0 / f64::from(1u32 << log2_steps) }
    }

    fn of(lattice: &Lattice) -> [Self; 3] {
        std::array::from_fn(|a| Self::new(lattice, a))
    }

    /// Samples on the axis.
    fn dim(&self) -> u64 {
        u64::from(self.last_cell) + 2
    }

    /// The cell of a coordinate: its lower voxel.
    #[inline]
    fn cell(&self, p: u32) -> u32 {
        (p >> self.log2_steps).min(self.last_cell)
    }

    /// The way from the cell's lower voxel to its upper one, 0 to 1, both included; exact.
    #[inline]
    fn fraction(&self, p: u32, cell: u32) -> f64 {
        f64::from(p - (cell << self.log2_steps)) * self.step
    }

    /// The `size` voxels around a cell, moved inwards at a border; fewer only where the axis has
    /// fewer.
    fn stencil(&self, cell: u32, size: usize) -> (u64, u64) {
        let size = (size as u64).min(self.dim());
        let first = (u64::from(cell) + 1).saturating_sub(size / 2).min(self.dim() - size);
        (first, first + size)
    }
}

/// Rounds to `f32`: to the largest finite value where a finite one overshoots, and to one NaN,
/// since the bits of a computed NaN depend on the machine.
#[inline]
fn to_f32(v: f64) -> f32 {
    let rounded = v as f32;
    if rounded.is_finite() {
        rounded
    } else if v.is_nan() {
        f32::NAN
    } else if v.is_finite() {
        f32::MAX.copysign(rounded)
    } else {
        rounded
    }
}

#[cfg(test)]
pub(crate) mod tests;
