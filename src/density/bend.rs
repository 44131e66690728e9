//! Along which axes does a field bend most?
//!
//! Points are as far apart along one axis as along another, unless that makes a larger error than
//! it must. How large an error is at a distance h along axis a is **measured**: of lines of samples
//! along it every h-th is kept, h = 2, 4 … 32, and the others are interpolated between them. With a
//! number of points the product of the three distances is given, and what is looked for are the
//! distances of least E_x²(h_x) + E_y²(h_y) + E_z²(h_z):
//!
//! ```text
//!          h =  2    4    8   16   32          hurricane wind, 125 x 125 x 25 samples: 2 voxels apart along z are as bad as
//!   E along x   1    2    4    9   15          8 along x. With 4 times the points along z, and less along x and y, the
//!   E along z   5   11   19   28   36          same number of points has half the error.
//! ```
//!
//! Distances are changed by factors of 2, for the whole volume at once: the lattice gets 2 or 4
//! times the steps a voxel along such an axis
//! ([`Lattice::stretched`](isospan_io::geom::Lattice::stretched)), and all that is even on it
//! follows. For a field that is smooth at all distances that is the rule of D'Azevedo and Simpson
//! ("On optimal interpolation triangle incidences", 1989): a distance goes with the inverse root of
//! the second difference.
//!
//! The cells of a lattice may have any edges: their distances are those of least error on a grid of
//! quarters of a factor 2.
//!
//! Time: a quarter of the lines are looked at, four operations a sample, axis and distance. The
//! sums are those of blocks, added in their order: the same for any threads.

use super::SCALES;
use isospan_io::geom::Lattice;
use isospan_io::grid::IndexBox;

/// The part of the error that is expected to be left, at most, where an axis is made finer: a
/// smaller gain is not worth longer tetrahedra.
const WORTH: f64 = 0.9;
/// The same for the edges of a lattice's cells, which cost nothing but rounder triangles.
const WORTH_OF_CELLS: f64 = 0.95;
/// Edges are looked for in steps of 2^(1/4). The longest one has this many more steps than the
/// shortest: it is four times as long.
const MOST_QUARTERS: i32 = 8;
/// Every so-many-th line of samples along each of the two other axes.
const EVERY: usize = 2;

/// Errors of interpolation along each axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bend {
    axes: [Along; 3],
}

/// Sums of squared errors at all distances, and of how many samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Along {
    squares: [f64; SCALES],
    samples: u64,
}

impl Bend {
    /// Measures the samples of a box, x fastest, NaN where there is none.
    ///
    /// # Panics
    /// When the samples are not as many as the box has.
    pub fn of(samples: &IndexBox, values: &[f32]) -> Self {
        assert_eq!(values.len(), samples.len(), "a value for each sample of the box");
        let dims = samples.dims().map(|n| n as usize);
        Self { axes: [0, 1, 2].map(|axis| Along::measure(axis, dims, values)) }
    }

    /// Adds what was found elsewhere.
    pub fn add(&mut self, other: &Self) {
        for (along, more) in self.axes.iter_mut().zip(&other.axes) {
            along.samples += more.samples;
            along.squares.iter_mut().zip(more.squares).for_each(|(sum, more)| *sum += more);
        }
    }

    /// The same in units in which a square is `scale` times as large.
    #[must_use]
    pub fn scaled(mut self, scale: f64) -> Self {
        self.axes.iter_mut().flat_map(|along| &mut along.squares).for_each(|sum| *sum *= scale);
        self
    }

    /// How many times as many steps a voxel each axis should have as the one with the fewest, as
    /// powers of two, for points at this mean distance, in voxels.
    pub fn finer(&self, spacing: f64) -> [u32; 3] {
        let logs = self.axes.map(|along| along.logs());
        let error = |finer: [u32; 3]| {
            // The logarithm of the mean distance on a lattice of no axis finer.
            let even = libm::log2(spacing) + f64::from(finer.iter().sum::<u32>()) / 3.0;
            (0..3).map(|a| error_at(&logs[a], even - f64::from(finer[a]))).sum::<f64>()
        };
        let each = 0..=Lattice::MOST_FINER;
        // Without any error there is nothing to choose by.
        let even = Some(error([0; 3])).filter(|&e| e > 1e-200);
        let Some(mut least) = even.map(|e| WORTH * WORTH * e) else { return [0; 3] };
        let mut best = [0; 3];
        for z in each.clone() {
            for y in each.clone() {
                for finer in each.clone().map(|x| [x, y, z]).filter(|finer| finer.contains(&0)) {
                    let error = error(finer);
                    if error < least {
                        (best, least) = (finer, error);
                    }
                }
            }
        }
        best
    }
}

impl Bend {
    /// How far apart points should be along each axis, in voxels, where `mean` is the geometric
    /// mean of the three; equally far where that is nearly as good. Not nearer than samples are,
    /// which would bring nothing, and not farther than was measured.
    pub fn spacing(&self, mean: f64) -> [f64; 3] {
        let logs = self.axes.map(|along| along.logs());
        let middle = libm::log2(mean);
        let error = |logs2: [f64; 3]| (0..3).map(|a| error_at(&logs[a], logs2[a])).sum::<f64>();
        let even = error([middle; 3]);
        let mut least = WORTH_OF_CELLS * WORTH_OF_CELLS * even;
        let mut best = [middle; 3];
        // Without any error there is nothing to choose by.
        if even > 1e-200 {
            let quarters = |n: i32| -n..=n;
            for [x, y] in quarters(MOST_QUARTERS).flat_map(|y| quarters(MOST_QUARTERS).map(move |x| [x, y])) {
                let steps = [x, y, -x - y];
                let at = steps.map(|q| middle + f64::from(q) / 4.0);
                let is_measured = at.iter().all(|log| (0.0..=SCALES as f64).contains(log));
                let is_round = (0..3).all(|a| (steps[a] - steps[(a + 1) % 3]).abs() <= MOST_QUARTERS);
                if is_measured && is_round && error(at) < least {
                    (best, least) = (at, error(at));
                }
            }
        }
        best.map(libm::exp2)
    }
}

impl Along {
    fn measure(axis: usize, dims: [usize; 3], values: &[f32]) -> Self {
        let stride = [1, dims[0], dims[0] * dims[1]];
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        let (mut along, mut line) = (Self::default(), vec![]);
        for first in (0..dims[v])
            .step_by(EVERY)
            .flat_map(|j| (0..dims[u]).step_by(EVERY).map(move |i| i * stride[u] + j * stride[v]))
        {
            line.clear();
            line.extend((0..dims[axis]).map(|i| f64::from(values[first + i * stride[axis]])));
            along.add_line(&line);
        }
        along
    }

    fn add_line(&mut self, line: &[f64]) {
        self.samples += line.iter().filter(|v| !v.is_nan()).count() as u64;
        let last = line.len() - 1;
        for (scale, sum) in self.squares.iter_mut().enumerate() {
            let step = 2 << scale;
            for from in (0..last).step_by(step) {
                let to = (from + step).min(last);
                let slope = (line[to] - line[from]) / (to - from) as f64;
                for (i, v) in line[from..to].iter().enumerate() {
                    let error = line[from] + slope * i as f64 - v;
                    if error.is_finite() {
                        *sum += error * error;
                    }
                }
            }
        }
    }

    /// The logarithms (base 2) of the mean squared errors; without error, and without samples, a
    /// very small one.
    fn logs(&self) -> [f64; SCALES] {
        self.squares.map(|sum| libm::log2((sum / self.samples.max(1) as f64).max(f64::MIN_POSITIVE)))
    }
}

/// The mean squared error at a distance whose logarithm (base 2) is this, from those at 2, 4 …:
/// between two of them a power of the distance, below the first one as before, but at best that of
/// a smooth field, above the last one no more.
fn error_at(logs: &[f64; SCALES], distance: f64) -> f64 {
    let scales = distance - 1.0;
    if scales < 0.0 {
        return libm::exp2(logs[0] + (logs[1] - logs[0]).clamp(0.0, 4.0) * scales);
    }
    let below = (scales as usize).min(SCALES - 2);
    let part = (scales - below as f64).min(1.0);
    libm::exp2(logs[below] + (logs[below + 1] - logs[below]) * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field that bends as given along each axis, at all distances.
    fn bend(bends: [f64; 3], dims: [u64; 3]) -> Bend {
        let mut values = vec![];
        for z in 0..dims[2] {
            for y in 0..dims[1] {
                for x in 0..dims[0] {
                    let squares = [x, y, z].into_iter().zip(bends).map(|(i, b)| b * (i * i) as f64);
                    values.push(squares.sum::<f64>() as f32);
                }
            }
        }
        Bend::of(&IndexBox::whole(dims), &values)
    }

    #[test]
    fn axes_of_smooth_fields_are_finer_by_the_root_of_what_they_bend_more() {
        for (bends, finer) in [
            ([1.0, 1.0, 1.0], [0, 0, 0]),
            ([1.0, 1.0, 1.5], [0, 0, 0]),
            ([1.0, 1.0, 4.0], [0, 0, 1]),
            ([1.0, 4.0, 4.0], [0, 1, 1]),
            ([16.0, 1.0, 1.0], [2, 0, 0]),
            ([300.0, 1.0, 1.0], [2, 0, 0]),
            ([1.0, 16.0, 4.0], [0, 2, 1]),
            ([0.0, 0.0, 0.0], [0, 0, 0]),
        ] {
            for spacing in [0.5, 2.0, 3.3, 5.0] {
                assert_eq!(bend(bends, [33; 3]).finer(spacing), finer, "{bends:?} {spacing}");
            }
        }
    }

    #[test]
    fn cells_are_longer_along_axes_on_which_a_field_bends_less() {
        for (bends, mean, expected) in [
            ([1.0, 1.0, 1.0], 4.0, [4.0, 4.0, 4.0]),
            ([1.0, 1.0, 1.2], 4.0, [4.0, 4.0, 4.0]),
            ([0.0, 0.0, 0.0], 4.0, [4.0, 4.0, 4.0]),
            ([1.0, 1.0, 16.0], 4.0, [6.35, 6.35, 1.59]),
            ([1.0, 1.0, 1e6], 4.0, [6.35, 6.35, 1.59]),
            ([4.0, 1.0, 1.0], 4.0, [2.52, 5.04, 5.04]),
            // Not nearer than samples.
            ([1.0, 1.0, 1e6], 1.42, [1.68, 1.68, 1.0]),
            ([1.0, 1.0, 1e6], 0.5, [0.5, 0.5, 0.5]),
        ] {
            let found = bend(bends, [33; 3]).spacing(mean);
            let is_near = |a: usize| (found[a] / expected[a]).max(expected[a] / found[a]) < 1.2;
            assert!((0..3).all(is_near), "{bends:?} {mean}: {found:?}");
        }
    }

    #[test]
    fn what_is_as_bad_at_all_distances_is_not_worth_points() {
        let dims = [33; 3];
        let mut values = vec![];
        for n in 0..33 * 33 * 33usize {
            let (x, z) = (n % 33, n / (33 * 33));
            // Smooth along x, jagged along z, but little.
            values.push((x * x) as f32 + if z % 2 == 0 { 3.0 } else { 0.0 });
        }
        let found = Bend::of(&IndexBox::whole(dims), &values);
        assert_eq!(found.finer(1.0), [0, 0, 0]);
        assert_eq!(found.finer(8.0), [2, 0, 0]);
    }

    #[test]
    fn parts_add_up_and_samples_without_a_value_do_not_count() {
        let samples = IndexBox::whole([9, 9, 9]);
        let mut values: Vec<f32> = (0..729).map(|n| (n / 81 * (n / 81)) as f32).collect();
        let all = Bend::of(&samples, &values);
        let mut twice = all;
        twice.add(&all);
        assert_eq!(twice.axes[2].samples, 2 * all.axes[2].samples);
        assert_eq!(twice.axes[2].squares, all.axes[2].squares.map(|s| 2.0 * s));
        assert_eq!((twice.finer(2.0), Bend::default().finer(2.0)), (all.finer(2.0), [0; 3]));
        values[364] = f32::NAN;
        let found = Bend::of(&samples, &values);
        assert!(found.axes.iter().all(|a| a.squares.iter().all(|s| s.is_finite())));
        assert_eq!(found.finer(2.0), all.finer(2.0));
        assert_eq!(bend([1.0, 1.0, 9.0], [33, 33, 2]).axes[2].squares, [0.0; SCALES]);
    }
}
