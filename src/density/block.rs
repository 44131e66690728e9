//! The errors of one block of samples at all densities.

use super::SCALES;
use isospan_io::grid::{BrickGrid, BrickId, IndexBox};

/// Voxel cells along each edge of a block: the widest distance of samples that are kept.
pub const BLOCK_EDGE: u64 = 1 << SCALES;

/// Sums of squared errors of the cells that a block touches.
#[derive(Clone, Debug)]
pub struct BlockErrors {
    grid: BrickGrid,
    /// The cells, in cell coordinates: first and past the last.
    lo: [u64; 3],
    dims: [u64; 3],
    sums: Vec<[f64; SCALES]>,
    /// Samples with a value, and without.
    samples: Vec<[u32; 2]>,
}

/// Where a coordinate lies between the samples that are kept: those before and after it, and the
/// weight of the second.
#[derive(Clone, Copy)]
struct Between {
    before: usize,
    after: usize,
    weight: f32,
}

impl BlockErrors {
    /// The blocks of a volume. The samples of one are those of its voxel cells, on both sides:
    /// [`BlockErrors::samples_of`].
    pub fn blocks(cells: &BrickGrid) -> BrickGrid {
        BrickGrid::new(cells.lattice, [BLOCK_EDGE; 3])
    }

    /// The samples that a block needs.
    pub fn samples_of(blocks: &BrickGrid, block: BrickId) -> IndexBox {
        let c = blocks.coords(block);
        let dims = blocks.lattice.dims;
        IndexBox {
            lo: c.map(|c| c * BLOCK_EDGE),
            hi: std::array::from_fn(|a| ((c[a] + 1) * BLOCK_EDGE + 1).min(dims[a])),
        }
    }

    /// Measures a block, given its samples, NaN where there is none. Samples of its far faces count
    /// for the next block, where there is one.
    ///
    /// # Panics
    /// When the samples are not as many as the box has.
    pub fn measure(cells: &BrickGrid, samples: &IndexBox, values: &[f32]) -> Self {
        assert_eq!(values.len(), samples.len(), "a value for each sample of the block");
        let (n, dims) = (samples.dims().map(|n| n as usize), cells.lattice.dims);
        let own = [0, 1, 2].map(|a| n[a] - usize::from(samples.hi[a] < dims[a]));
        let cell = |a: usize, i: usize| ((samples.lo[a] + i as u64) / cells.edge[a]).min(cells.dims()[a] - 1);
        let lo = [0, 1, 2].map(|a| cell(a, 0));
        let cell_dims = [0, 1, 2].map(|a| cell(a, own[a] - 1) + 1 - lo[a]);
        let count = cell_dims.iter().product::<u64>() as usize;
        let (sums, counts) = (vec![[0.0; SCALES]; count], vec![[0; 2]; count]);
        let mut all = Self { grid: *cells, lo, dims: cell_dims, sums, samples: counts };
        let at = [0, 1, 2].map(|a| (0..own[a]).map(|i| (cell(a, i) - lo[a]) as usize).collect::<Vec<_>>());
        all.count(n, &at, values);
        (0..SCALES).for_each(|scale| all.add_scale(scale, n, &at, values));
        all
    }

    #[inline]
    fn row(&self, at: &[Vec<usize>; 3], y: usize, z: usize) -> usize {
        (at[2][z] * self.dims[1] as usize + at[1][y]) * self.dims[0] as usize
    }

    fn count(&mut self, n: [usize; 3], at: &[Vec<usize>; 3], values: &[f32]) {
        for z in 0..at[2].len() {
            for y in 0..at[1].len() {
                let (row, line) = (self.row(at, y, z), &values[(z * n[1] + y) * n[0]..][..at[0].len()]);
                for (v, cell) in line.iter().zip(&at[0]) {
                    self.samples[row + cell][usize::from(v.is_nan())] += 1;
                }
            }
        }
    }

    fn add_scale(&mut self, scale: usize, n: [usize; 3], at: &[Vec<usize>; 3], values: &[f32]) {
        let step = 2 << scale;
        let [xs, ys, zs] = n.map(|n| between(n, step));
        let kept: Vec<usize> = (0..n[0] - 1).step_by(step).chain([n[0] - 1]).collect();
        let mut row = vec![0.0f32; n[0]];
        for (z, bz) in zs.iter().enumerate().take(at[2].len()) {
            for (y, by) in ys.iter().enumerate().take(at[1].len()) {
                let line = |y: usize, z: usize| &values[(z * n[1] + y) * n[0]..][..n[0]];
                let [a, b, c, d] = [
                    (by.before, bz.before),
                    (by.after, bz.before),
                    (by.before, bz.after),
                    (by.after, bz.after),
                ]
                .map(|(y, z)| line(y, z));
                for &x in &kept {
                    row[x] = mix(mix(a[x], b[x], by.weight), mix(c[x], d[x], by.weight), bz.weight);
                }
                let first = self.row(at, y, z);
                for ((x, &v), &cell) in xs.iter().zip(line(y, z)).zip(&at[0]) {
                    let error = f64::from(mix(row[x.before], row[x.after], x.weight)) - f64::from(v);
                    if !error.is_nan() {
                        self.sums[first + cell][scale] += error * error;
                    }
                }
            }
        }
    }

    /// The cells, the sums of squared errors of each at all densities, and how many samples it has
    /// with a value, and without.
    pub(super) fn cells(&self) -> impl Iterator<Item = (BrickId, &[f64; SCALES], [u32; 2])> {
        let [nx, ny, _] = self.dims;
        self.sums.iter().zip(&self.samples).enumerate().map(move |(i, (sums, &samples))| {
            let i = i as u64;
            let c = [i % nx, i / nx % ny, i / nx / ny];
            (self.grid.id([0, 1, 2].map(|a| self.lo[a] + c[a])), sums, samples)
        })
    }
}

#[inline]
fn mix(a: f32, b: f32, weight: f32) -> f32 {
    // Not a + (b - a) · weight: where the weight is 0, a NaN on the other side would make it NaN.
    if weight == 0.0 { a } else { a * (1.0 - weight) + b * weight }
}

/// For each of `n` coordinates its neighbours among every `step`-th and the last.
fn between(n: usize, step: usize) -> Vec<Between> {
    let place = |i: usize| {
        let before = i / step * step;
        let after = (before + step).min(n - 1);
        let width = after.saturating_sub(before).max(1);
        Between { before, after, weight: (i - before) as f32 / width as f32 }
    };
    (0..n).map(place).collect()
}
