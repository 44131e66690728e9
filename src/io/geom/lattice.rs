//! The integer lattice on which every point lives.
//!
//! A structured volume of `dims` samples is meshed in index space. Each voxel edge is divided into
//! 2^s steps, s the largest with `(max(dims) - 1)·2^s <= 2^24`. So a voxel is an exact lattice
//! position, a coordinate has at most 24 bits (plus the value 2^24 itself), is exact as an `f32`,
//! and the geometric predicates are exact in `i128`.
//!
//! Points are spread as evenly along all axes **of the lattice**. Where a field bends more along
//! one axis than along others, that axis has two or four times as many steps a voxel
//! ([`Lattice::stretched`]): what is even on the lattice is then denser along it.
//!
//! ```text
//!   voxels ●───────●───────●        s = 2, 2        ●───────●───────●     s = 2, 3: as isotropic to all stages,
//!          │ · · · │ · · · │                        │ ····· │ ····· │     and as far as they can tell a volume
//!          ●───────●───────●                        ●───────●───────●     of voxels twice as high
//! ```

use crate::error::{Error, Result};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A position in lattice steps, x first; each coordinate is at most [`Lattice::LARGEST`].
pub type LatticePos = [u32; 3];

/// The lattice of a structured volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lattice {
    /// Samples along x, y, z; at least 2 each.
    pub dims: [u64; 3],
    /// Lattice steps a voxel edge along x, y, z, as powers of two. Written as one number where they
    /// are the same.
    #[serde(serialize_with = "write_steps", deserialize_with = "read_steps")]
    pub log2_steps: [u32; 3],
}

/// How steps are written.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Steps {
    Same(u32),
    Each([u32; 3]),
}

fn write_steps<S: Serializer>(steps: &[u32; 3], out: S) -> std::result::Result<S::Ok, S::Error> {
    let [x, y, z] = *steps;
    if x == y && y == z { Steps::Same(x) } else { Steps::Each(*steps) }.serialize(out)
}

fn read_steps<'de, D: Deserializer<'de>>(input: D) -> std::result::Result<[u32; 3], D::Error> {
    Ok(match Steps::deserialize(input)? {
        Steps::Same(steps) => [steps; 3],
        Steps::Each(steps) => steps,
    })
}

impl Lattice {
    /// The largest lattice coordinate: 2^24.
    pub const LARGEST: u32 = 1 << 24;
    /// An axis has at most so many times the steps a voxel that another one has, as a power of two.
    pub const MOST_FINER: u32 = 2;

    /// The lattice of a volume of `dims` samples.
    ///
    /// # Errors
    /// [`Error::Usage`] when an axis has fewer than 2 samples or more than 2^24 + 1.
    pub fn new(dims: [u64; 3]) -> Result<Self> {
        Self::stretched(dims, [0; 3])
    }

    /// The lattice of a volume of `dims` samples with 2^`finer` times as many steps a voxel along
    /// some axes.
    ///
    /// # Errors
    /// [`Error::Usage`] as for [`Lattice::new`], for an axis of which so many steps are more than
    /// 2^24, and for one that is finer by more than [`Lattice::MOST_FINER`] than another.
    pub fn stretched(dims: [u64; 3], finer: [u32; 3]) -> Result<Self> {
        if dims.iter().any(|&d| d < 2) {
            return Err(Error::usage(format!(
                "a volume of {}x{}x{} samples has no cells: every axis needs at least 2 samples",
                dims[0], dims[1], dims[2]
            )));
        }
        let [least, most] = [finer.into_iter().min(), finer.into_iter().max()].map(Option::unwrap_or_default);
        if most - least > Self::MOST_FINER {
            return Err(Error::usage(format!("an axis with 2^{} times the steps of another", most - least)));
        }
        let finer = finer.map(|f| f - least);
        let longest = dims.into_iter().max().unwrap_or(0);
        let steps = (0..3).map(|a| (dims[a] - 1).saturating_mul(1 << finer[a])).max().unwrap_or(1);
        if steps > u64::from(Self::LARGEST) {
            return Err(Error::usage(format!(
                "an axis of {longest} samples is longer than the 2^24 + 1 supported"
            )));
        }
        let log2_steps = (u64::from(Self::LARGEST) / steps).ilog2();
        Ok(Self { dims, log2_steps: finer.map(|f| log2_steps + f) })
    }

    /// How many times as many steps a voxel each axis has as the one with the fewest, as powers of
    /// two.
    pub fn finer(&self) -> [u32; 3] {
        let least = self.log2_steps.into_iter().min().unwrap_or_default();
        self.log2_steps.map(|s| s - least)
    }

    /// Whether it is the lattice that [`Lattice::stretched`] makes of its dimensions; one from a
    /// file may be none.
    pub fn is_valid(&self) -> bool {
        Self::stretched(self.dims, self.finer()).ok() == Some(*self)
    }

    /// The length of each axis in steps, divided by the number of steps that a voxel has along the
    /// axis with the fewest.
    pub(crate) fn extent(&self) -> [f64; 3] {
        let finer = self.finer();
        std::array::from_fn(|a| (self.dims[a] - 1) as f64 * f64::from(1u32 << finer[a]))
    }

    /// The edges, in voxels, of a box that is a cube on the lattice and as large as a voxel.
    pub fn cube(&self) -> [f64; 3] {
        let finer = self.finer().map(|f| f64::from(1u32 << f));
        let all = libm::cbrt(finer.iter().product::<f64>());
        finer.map(|f| all / f)
    }

    /// The largest coordinate on each axis: the position of the last sample.
    pub fn max(&self) -> LatticePos {
        std::array::from_fn(|a| ((self.dims[a] - 1) << self.log2_steps[a]) as u32)
    }

    /// The box of the whole domain.
    pub fn domain(&self) -> LatticeBox {
        LatticeBox { lo: [0; 3], hi: self.max().map(|m| m + 1) }
    }

    /// Six times the volume of the domain, in cubic lattice steps.
    pub fn volume6(&self) -> i128 {
        6 * self.max().iter().map(|&m| i128::from(m)).product::<i128>()
    }

    /// The lattice position of a sample.
    #[inline]
    pub fn of_voxel(&self, ijk: [u64; 3]) -> LatticePos {
        std::array::from_fn(|a| (ijk[a] << self.log2_steps[a]) as u32)
    }

    /// A lattice position in voxel units (exact).
    pub fn to_index_space(&self, pos: LatticePos) -> [f64; 3] {
        std::array::from_fn(|a| f64::from(pos[a]) * (1.0 / f64::from(1u32 << self.log2_steps[a])))
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
    /// The box that holds nothing: its hull with another box is that box.
    pub const NOTHING: Self = Self { lo: [u32::MAX; 3], hi: [0; 3] };

    /// The least box that holds both.
    pub fn hull(&self, other: &Self) -> Self {
        Self {
            lo: std::array::from_fn(|a| self.lo[a].min(other.lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].max(other.hi[a])),
        }
    }

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

    /// At most six boxes that tile this one without what another one has of it.
    #[must_use]
    pub fn without(&self, other: &Self) -> Vec<Self> {
        let (mut rest, inner, mut boxes) = (*self, self.intersect(other), vec![]);
        if inner.is_empty() {
            return vec![rest];
        }
        for a in 0..3 {
            let (mut below, mut above) = (rest, rest);
            (below.hi[a], above.lo[a]) = (inner.lo[a], inner.hi[a]);
            (rest.lo[a], rest.hi[a]) = (inner.lo[a], inner.hi[a]);
            boxes.extend([below, above].into_iter().filter(|b| !b.is_empty()));
        }
        boxes
    }

    /// The box grown by `by` steps on each side of each axis and clipped to `domain`.
    #[must_use]
    pub fn grow_within(&self, by: LatticePos, domain: &Self) -> Self {
        self.grow_sides([by; 2], domain)
    }

    /// The box grown by so many steps along each axis, on its low sides and on its high ones, but
    /// not beyond `domain`.
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
            assert_eq!(l.log2_steps, [l.log2_steps[0]; 3]);
            assert!((n - 1) << l.log2_steps[0] <= 1 << 24, "{n}");
            assert!((n - 1) << (l.log2_steps[0] + 1) > 1 << 24, "{n}");
        }
        assert!(Lattice::new([1, 5, 5]).is_err());
        assert!(Lattice::new([(1 << 24) + 2, 5, 5]).is_err());
    }

    #[test]
    fn a_stretched_axis_has_more_steps_and_none_has_too_many() {
        for (dims, finer) in
            [([500, 500, 100], [0, 0, 1]), ([9, 300, 200], [0, 2, 1]), ([64, 64, 64], [1, 0, 0])]
        {
            let l = Lattice::stretched(dims, finer).unwrap();
            assert_eq!(l.finer(), finer);
            let most = l.max().into_iter().max().unwrap();
            assert!(most <= Lattice::LARGEST && 2 * most > Lattice::LARGEST, "{most}");
            assert_eq!(l.to_index_space(l.of_voxel([3, 5, 7])), [3.0, 5.0, 7.0]);
            assert!(l.is_valid() && !Lattice { log2_steps: l.log2_steps.map(|s| s - 1), ..l }.is_valid());
        }
        assert_eq!(Lattice::stretched([5; 3], [1; 3]).unwrap(), Lattice::new([5; 3]).unwrap());
        assert!(Lattice::stretched([5; 3], [0, 3, 0]).is_err());
        assert!(Lattice::stretched([(1 << 23) + 2, 5, 5], [1, 0, 0]).is_err());
        for log2_steps in [[u32::MAX; 3], [0, 31, 0], [0, u32::MAX, 3]] {
            assert!(!Lattice { dims: [5; 3], log2_steps }.is_valid());
        }
    }

    #[test]
    fn steps_that_are_the_same_are_written_as_one_number() {
        let text = |l: &Lattice| serde_json::to_string(l).unwrap();
        let (even, stretched) =
            (Lattice::new([5; 3]).unwrap(), Lattice::stretched([5; 3], [0, 0, 1]).unwrap());
        assert_eq!(text(&even), r#"{"dims":[5,5,5],"log2_steps":22}"#);
        assert_eq!(text(&stretched), r#"{"dims":[5,5,5],"log2_steps":[21,21,22]}"#);
        for l in [even, stretched] {
            assert_eq!(serde_json::from_str::<Lattice>(&text(&l)).unwrap(), l);
        }
    }
}
