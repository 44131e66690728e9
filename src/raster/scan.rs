//! Scan conversion of a tetrahedron on a grid of samples.

use super::SampleGrid;
use super::planes::{Int, LONGEST_64, Planes, bounds};
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
    } else if let Some(pitch) = grid.axes()[0].pitch {
        scan.rows(corners, pitch, each);
    } else {
        scan.one_by_one(corners, each);
    }
}

struct Scan<'a> {
    grid: &'a SampleGrid,
    window: &'a IndexBox,
    /// The samples of the window in the tetrahedron's bounding box.
    inside: IndexBox,
}

impl Scan<'_> {
    /// By additions along rows; for tetrahedra that touch no far face of the domain, so that one rule breaks all ties.
    #[inline(always)]
    fn rows(&self, corners: [LatticePos; 4], pitch: u32, mut each: impl FnMut(usize, [f64; 4])) {
        let [xs, ys, zs] = self.grid.axes();
        let IndexBox { lo, hi } = self.inside;
        let planes = Planes::<i64>::new(corners);
        let (bias, unit) = (planes.bias([false; 3]), 1.0 / planes.volume.float());
        let step = planes.gradient.map(|g| g[0].wrapping_mul(i64::from(pitch)));
        // The most that a λ can grow from a row's first sample to its last.
        let growth = step.map(|s| s.max(0).wrapping_mul((hi[0] - lo[0] - 1) as i64));
        let x = xs.position(lo[0] as usize);
        for iz in lo[2]..hi[2] {
            for iy in lo[1]..hi[1] {
                let first = planes.at([x, ys.position(iy as usize), zs.position(iz as usize)]);
                let mut lambda: [i64; 4] = std::array::from_fn(|k| first[k].wrapping_add(bias[k]));
                let reach: [i64; 4] = std::array::from_fn(|k| lambda[k].wrapping_add(growth[k]));
                if reach[0] | reach[1] | reach[2] | reach[3] < 0 {
                    continue;
                }
                let row = self.window.offset([lo[0], iy, iz]);
                for i in 0..(hi[0] - lo[0]) as usize {
                    if lambda[0] | lambda[1] | lambda[2] | lambda[3] >= 0 {
                        each(row + i, std::array::from_fn(|k| (lambda[k] - bias[k]) as f64 * unit));
                    }
                    lambda = std::array::from_fn(|k| lambda[k].wrapping_add(step[k]));
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
