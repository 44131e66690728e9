//! The positions of samples, axis by axis.

use isospan_io::error::{Error, Result};
use isospan_io::geom::{Lattice, LatticePos};
use isospan_io::grid::IndexBox;

/// The most samples of an axis: one for each lattice position.
const MOST: u64 = (1 << 24) + 1;

/// Sample positions along one axis, ascending lattice coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    positions: Vec<u32>,
    first: u32,
    /// log2 of the distance of neighbours, where it is the same power of two for all.
    shift: Option<u32>,
    /// Samples a lattice step.
    density: f64,
}

impl Axis {
    /// `n` samples from `lo` to `hi`, both included; a single one lies in the middle. Positions
    /// between are rounded to lattice steps, halves up: by at most 2^-25 of the domain's longest
    /// axis.
    ///
    /// # Errors
    /// [`Error::Usage`] for no samples, more than 2^24 + 1, or `lo > hi`.
    pub fn even(lo: u32, hi: u32, n: u64) -> Result<Self> {
        if !(1..=MOST).contains(&n) || lo > hi {
            return Err(Error::usage(format!(
                "an axis has 1 to {MOST} samples, from lower to higher; not {n}"
            )));
        }
        let (length, parts) = (u64::from(hi - lo), (n - 1).max(1));
        let at = |i: u64| lo + ((2 * i * length + parts) / (2 * parts)) as u32;
        let positions: Vec<u32> =
            if n == 1 { vec![lo + (hi - lo).div_ceil(2)] } else { (0..n).map(at).collect() };
        Ok(Self::of(positions))
    }

    fn of(positions: Vec<u32>) -> Self {
        let pitch = match positions[..] {
            [a, b, ..] => Some(b - a),
            _ => Some(1),
        };
        let is_even = |p: u32| positions.windows(2).all(|w| w[1] - w[0] == p);
        let shift = pitch.filter(|&p| p.is_power_of_two() && is_even(p)).map(u32::trailing_zeros);
        let length = positions[positions.len() - 1] - positions[0];
        let density = if length == 0 { 0.0 } else { (positions.len() - 1) as f64 / f64::from(length) };
        Self { first: positions[0], positions, shift, density }
    }

    /// Number of samples.
    #[allow(clippy::len_without_is_empty, reason = "an axis has at least one sample")]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Lattice coordinate of a sample.
    #[inline]
    pub fn position(&self, sample: usize) -> u32 {
        self.positions[sample]
    }

    /// Lattice coordinates of all samples, ascending.
    #[inline]
    pub(super) fn positions(&self) -> &[u32] {
        &self.positions
    }

    /// The distance of neighbours in lattice steps, where it is the same power of two for all;
    /// exact.
    pub(super) fn pitch(&self) -> Option<f32> {
        self.shift.map(|s| (1u32 << s) as f32)
    }

    /// log2 of that, where the first sample is at 0.
    pub(super) fn shift_from_zero(&self) -> Option<u32> {
        self.shift.filter(|_| self.first == 0)
    }

    /// Number of samples at or below a coordinate.
    #[inline]
    pub(super) fn up_to(&self, coordinate: u32) -> usize {
        self.below(coordinate.saturating_add(1))
    }

    /// Number of samples below a coordinate: the first at or above it.
    #[inline]
    pub fn below(&self, coordinate: u32) -> usize {
        let p = &self.positions;
        if let Some(shift) = self.shift {
            let above = coordinate.saturating_sub(self.first);
            return ((above + ((1 << shift) - 1)) >> shift).min(p.len() as u32) as usize;
        }
        self.search(coordinate)
    }

    /// Evenly spaced but for rounding: the guess is right to one or two.
    #[inline(never)]
    fn search(&self, coordinate: u32) -> usize {
        let p = &self.positions;
        let guess = f64::from(coordinate.saturating_sub(p[0])) * self.density;
        let mut n = (guess as usize).min(p.len());
        while n > 0 && p[n - 1] >= coordinate {
            n -= 1;
        }
        while n < p.len() && p[n] < coordinate {
            n += 1;
        }
        n
    }
}

/// A rectilinear grid of samples in a domain.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleGrid {
    axes: [Axis; 3],
    far: LatticePos,
}

impl SampleGrid {
    /// Samples in the domain of a lattice, at all combinations of the axes' positions.
    ///
    /// # Errors
    /// [`Error::Usage`] for a position outside the domain.
    pub fn new(lattice: &Lattice, axes: [Axis; 3]) -> Result<Self> {
        let far = lattice.max();
        if (0..3).any(|a| axes[a].positions.last() > Some(&far[a])) {
            return Err(Error::usage("a grid to be sampled must lie in the domain"));
        }
        Ok(Self { axes, far })
    }

    /// The samples of the volume that a lattice belongs to.
    pub fn voxels(lattice: &Lattice) -> Self {
        let axis =
            |a: usize| Axis::of((0..lattice.dims[a]).map(|i| (i << lattice.log2_steps[a]) as u32).collect());
        Self { axes: std::array::from_fn(axis), far: lattice.max() }
    }

    /// The three axes.
    pub fn axes(&self) -> &[Axis; 3] {
        &self.axes
    }

    /// Samples along each axis.
    pub fn dims(&self) -> [u64; 3] {
        std::array::from_fn(|a| self.axes[a].len() as u64)
    }

    /// The largest position of the domain.
    pub fn far(&self) -> LatticePos {
        self.far
    }

    /// The samples between two lattice positions, both included.
    #[inline]
    pub fn within(&self, lo: LatticePos, hi: LatticePos) -> IndexBox {
        IndexBox {
            lo: std::array::from_fn(|a| self.axes[a].below(lo[a]) as u64),
            hi: std::array::from_fn(|a| self.axes[a].below(hi[a] + 1) as u64),
        }
    }
}
