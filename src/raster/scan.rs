//! Scan conversion of a tetrahedron on a grid of samples.

use super::planes::{Int, LONGEST_64, Planes, bounds};
use super::{Axis, SampleGrid};
use crate::geom::LatticePos;
use crate::grid::IndexBox;

/// Calls `each` for every sample of the window that belongs to a positively oriented tetrahedron, with its place in an
/// x-fastest array of the window, and the weights of the corners. See the module for the rule for ties.
///
/// # Panics
/// When the window is not one of the grid.
#[inline]
pub fn each_sample(
    grid: &SampleGrid,
    window: &IndexBox,
    corners: [LatticePos; 4],
    each: impl FnMut(usize, [f64; 4]),
) {
    let (lo, hi) = bounds(&corners);
    let inside = grid.within(lo, hi).intersect(window);
    if inside.is_empty() {
        return;
    }
    let far = grid.far();
    let scan = Scan { grid, window, inside };
    if (0..3).any(|k| hi[k] == far[k] || hi[k] - lo[k] > LONGEST_64) {
        scan.one_by_one(corners, each);
    } else {
        scan.rows(corners, each);
    }
}

/// Rows of at most so many samples are tested sample by sample; of longer ones the ends of the run inside are computed.
const SHORT_ROW: usize = 4;
/// What a computed end of a span may be wrong by, in lattice steps: far more than it is (2^24 · 2^-51).
const SLACK: f64 = 1e-6;

struct Scan<'a> {
    grid: &'a SampleGrid,
    window: &'a IndexBox,
    /// The samples of the window in the tetrahedron's bounding box.
    inside: IndexBox,
}

/// The samples of a row: λ of its first, biased, and what they grow by a lattice step.
struct Row {
    lambda: [i64; 4],
    growth: [i64; 4],
    /// Position of the first sample.
    x: u32,
}

impl Row {
    #[inline(always)]
    fn at(&self, x: u32) -> [i64; 4] {
        let steps = i64::from(x - self.x);
        std::array::from_fn(|k| self.lambda[k] + self.growth[k] * steps)
    }

    #[inline(always)]
    fn has(&self, x: u32) -> bool {
        is_inside(self.at(x))
    }

    /// The samples `start..end` of the row that are inside; `lo..hi` are those of the bounding box.
    #[inline(always)]
    fn span(&self, xs: &Axis, [lo, hi]: [usize; 2], inverse: &[f64; 4]) -> (usize, usize) {
        let (mut from, mut to) = (0.0f64, f64::from(xs.position(hi - 1) - self.x));
        for ((&lambda, &growth), &inverse) in self.lambda.iter().zip(&self.growth).zip(inverse) {
            let crossing = lambda as f64 * inverse;
            match growth {
                1.. => from = from.max(crossing),
                0 => {}
                _ => to = to.min(crossing),
            }
        }
        // Casts saturate; what they lose is outside of the row.
        let mut start = xs.below(self.x.saturating_add((from - SLACK).ceil() as u32)).clamp(lo, hi);
        let mut end = xs.below(self.x.saturating_add((to + SLACK).floor() as u32 + 1)).clamp(lo, hi);
        // Exactly, at the ends: the samples inside are one run.
        while start < end && !self.has(xs.position(start)) {
            start += 1;
        }
        while start < end && !self.has(xs.position(end - 1)) {
            end -= 1;
        }
        (start, end)
    }
}

#[inline(always)]
fn is_inside(l: [i64; 4]) -> bool {
    l[0] | l[1] | l[2] | l[3] >= 0
}

#[inline(always)]
fn sum(a: [i64; 4], b: [i64; 4]) -> [i64; 4] {
    std::array::from_fn(|k| a[k] + b[k])
}

impl Scan<'_> {
    /// Row by row; for tetrahedra that touch no far face of the domain, so that one rule breaks all ties.
    #[inline(always)]
    fn rows(&self, corners: [LatticePos; 4], mut each: impl FnMut(usize, [f64; 4])) {
        let [xs, ys, zs] = self.grid.axes();
        let IndexBox { lo, hi } = self.inside;
        let (lo, hi) = (lo.map(|n| n as usize), hi.map(|n| n as usize));
        let planes = Planes::<i64>::new(corners);
        let (bias, unit) = (planes.bias([false; 3]), 1.0 / planes.volume.float());
        let gradient = |axis: usize| planes.gradient.map(|g| g[axis]);
        let (gx, gy, gz) = (gradient(0), gradient(1), gradient(2));
        let (x, y, z) = (xs.position(lo[0]), ys.position(lo[1]), zs.position(lo[2]));
        // The most that a λ can be above its value at the first sample of a row, of a layer.
        let most = |g: [i64; 4], length: u32| g.map(|g| g.max(0) * i64::from(length));
        let in_row = most(gx, xs.position(hi[0] - 1) - x);
        let in_layer = sum(in_row, most(gy, ys.position(hi[1] - 1) - y));
        let is_short = hi[0] - lo[0] <= SHORT_ROW;
        let inverse = if is_short { [0.0; 4] } else { gx.map(|g| -1.0 / g as f64) };
        let first = sum(planes.at([x, y, z]), bias);
        for iz in lo[2]..hi[2] {
            let dz = i64::from(zs.position(iz) - z);
            let layer = sum(first, gz.map(|g| g * dz));
            if !is_inside(sum(layer, in_layer)) {
                continue;
            }
            for iy in lo[1]..hi[1] {
                let dy = i64::from(ys.position(iy) - y);
                let lambda = sum(layer, gy.map(|g| g * dy));
                if !is_inside(sum(lambda, in_row)) {
                    continue;
                }
                let row = Row { lambda, growth: gx, x };
                let (start, end) =
                    if is_short { (lo[0], hi[0]) } else { row.span(xs, [lo[0], hi[0]], &inverse) };
                let place = self.window.offset([lo[0] as u64, iy as u64, iz as u64]);
                for ix in start..end {
                    let lambda = row.at(xs.position(ix));
                    if !is_short || is_inside(lambda) {
                        let weights = std::array::from_fn(|k| (lambda[k] - bias[k]) as f64 * unit);
                        each(place + (ix - lo[0]), weights);
                    }
                }
            }
        }
    }

    /// Each sample by itself, whatever the tetrahedron.
    #[inline(never)]
    fn one_by_one(&self, corners: [LatticePos; 4], mut each: impl FnMut(usize, [f64; 4])) {
        let (lo, hi) = bounds(&corners);
        if (0..3).all(|k| hi[k] - lo[k] <= LONGEST_64) {
            self.each_inside(&Planes::<i64>::new(corners), &mut each);
        } else {
            self.each_inside(&Planes::<i128>::new(corners), &mut each);
        }
    }

    fn each_inside<I: Int>(&self, planes: &Planes<I>, each: &mut impl FnMut(usize, [f64; 4])) {
        let [xs, ys, zs] = self.grid.axes();
        let IndexBox { lo, hi } = self.inside;
        for iz in lo[2]..hi[2] {
            for iy in lo[1]..hi[1] {
                let row = self.window.offset([lo[0], iy, iz]);
                for ix in lo[0]..hi[0] {
                    let p = [xs.position(ix as usize), ys.position(iy as usize), zs.position(iz as usize)];
                    if let Some(weights) = planes.weights(p, self.grid.far()) {
                        each(row + (ix - lo[0]) as usize, weights);
                    }
                }
            }
        }
    }
}
