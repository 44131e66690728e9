//! The integer lattice on which every point lives.
//!
//! A structured volume of `dims` samples is meshed in index space. Each voxel edge is divided into 2^s steps, s the
//! largest with `(max(dims) - 1)·2^s <= 2^24`. So a voxel is an exact lattice position, a coordinate has at most 24
//! bits (plus the value 2^24 itself), is exact as an `f32`, and the geometric predicates are exact in `i128`.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// A position in lattice steps, x first; each coordinate is at most [`Lattice::LARGEST`].
pub type LatticePos = [u32; 3];

/// The lattice of a structured volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lattice {
    /// Samples along x, y, z; at least 2 each.
    pub dims: [u64; 3],
    /// Lattice steps a voxel edge, as a power of two.
    pub log2_steps: u32,
}

impl Lattice {
    /// The largest lattice coordinate: 2^24.
    pub const LARGEST: u32 = 1 << 24;

    /// The lattice of a volume of `dims` samples.
    ///
    /// # Errors
    /// [`Error::Usage`] when an axis has fewer than 2 samples or more than 2^24 + 1.
    pub fn new(dims: [u64; 3]) -> Result<Self> {
        let longest = dims.into_iter().max().unwrap_or(0);
        if dims.iter().any(|&d| d < 2) {
            return Err(Error::usage(format!(
                "a volume of {}x{}x{} samples has no cells: every axis needs at least 2 samples",
                dims[0], dims[1], dims[2]
            )));
        }
        if longest - 1 > u64::from(Self::LARGEST) {
            return Err(Error::usage(format!(
                "an axis of {longest} samples is longer than the 2^24 + 1 supported"
            )));
        }
        let log2_steps = (u64::from(Self::LARGEST) / (longest - 1)).ilog2();
        Ok(Self { dims, log2_steps })
    }

    /// The largest coordinate on each axis: the position of the last sample.
    pub fn max(&self) -> LatticePos {
        self.dims.map(|d| ((d - 1) << self.log2_steps) as u32)
    }

    /// The box of the whole domain.
    pub fn domain(&self) -> LatticeBox {
        LatticeBox { lo: [0; 3], hi: self.max().map(|m| m + 1) }
    }

    /// The lattice position of a sample.
    pub fn of_voxel(&self, ijk: [u64; 3]) -> LatticePos {
        ijk.map(|i| (i << self.log2_steps) as u32)
    }

    /// A lattice position in voxel units (exact).
    pub fn to_index_space(&self, pos: LatticePos) -> [f64; 3] {
        let step = 1.0 / f64::from(1u32 << self.log2_steps);
        pos.map(|p| f64::from(p) * step)
    }
}

/// A half-open box of lattice positions: `lo <= p < hi` on each axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LatticeBox {
    /// Smallest corner, inside.
    pub lo: LatticePos,
    /// Largest corner, outside.
    pub hi: LatticePos,
}

impl LatticeBox {
    /// Whether `p` lies in the box.
    #[inline]
    pub fn contains(&self, p: LatticePos) -> bool {
        (0..3).all(|a| self.lo[a] <= p[a] && p[a] < self.hi[a])
    }

    /// Whether no position lies in the box.
    pub fn is_empty(&self) -> bool {
        (0..3).any(|a| self.lo[a] >= self.hi[a])
    }

    /// The common part of two boxes; may be empty.
    #[must_use]
    pub fn intersect(&self, other: &Self) -> Self {
        Self {
            lo: std::array::from_fn(|a| self.lo[a].max(other.lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].min(other.hi[a])),
        }
    }

    /// The box grown by `by` steps on each side of each axis and clipped to `domain`.
    #[must_use]
    pub fn grow_within(&self, by: LatticePos, domain: &Self) -> Self {
        self.grow_sides([by; 2], domain)
    }

    /// The box grown by so many steps along each axis, on its low sides and on its high ones, but not beyond `domain`.
    #[must_use]
    pub fn grow_sides(&self, by: [LatticePos; 2], domain: &Self) -> Self {
        Self {
            lo: std::array::from_fn(|a| self.lo[a].saturating_sub(by[0][a])),
            hi: std::array::from_fn(|a| self.hi[a].saturating_add(by[1][a])),
        }
        .intersect(domain)
    }

    /// Lattice positions in the box.
    pub fn volume(&self) -> u128 {
        if self.is_empty() { 0 } else { (0..3).map(|a| u128::from(self.hi[a] - self.lo[a])).product() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_fill_24_bits_and_no_more() {
        for n in [2u64, 3, 50, 103, 161, 256, 257, 512, 513, 4097, (1 << 24) + 1] {
            let l = Lattice::new([n, 2, 2]).unwrap();
            assert!((n - 1) << l.log2_steps <= 1 << 24, "{n}");
            assert!((n - 1) << (l.log2_steps + 1) > 1 << 24, "{n}");
        }
        assert!(Lattice::new([1, 5, 5]).is_err());
        assert!(Lattice::new([(1 << 24) + 2, 5, 5]).is_err());
    }
}
