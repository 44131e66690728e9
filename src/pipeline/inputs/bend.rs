//! How a volume bends along its axes, found in blocks of samples while it is read once, in pieces
//! of any kind.
//!
//! Blocks are spread evenly over the volume, at most 216 of 33³ samples, so that time and memory
//! have a bound. Their sums are added in their order, so the result is the same for any pieces.
//! Memory: the blocks that are not complete yet, 5 MiB where slices come one after the other.

use crate::density::Bend;
use crate::grid::IndexBox;
use std::collections::BTreeMap;

/// Samples of a block along an axis.
const EDGE: u64 = 33;
/// Blocks along an axis, at most.
const MOST: u64 = 6;

/// The blocks of a volume.
pub(super) struct BendBlocks {
    blocks: Vec<Block>,
    /// Positions among the blocks, by the first slice that they need.
    waiting: BTreeMap<u64, Vec<usize>>,
    /// Positions of the blocks that are begun.
    open: Vec<usize>,
    missing: Option<f32>,
}

struct Block {
    samples: IndexBox,
    values: Vec<f32>,
    filled: usize,
    bend: Bend,
}

impl BendBlocks {
    /// The blocks of a volume; the value `missing` means "no data".
    pub(super) fn new(dims: [u64; 3], missing: Option<f32>) -> Self {
        let starts = dims.map(|n| {
            let edge = EDGE.min(n);
            let count = (n / EDGE).clamp(1, MOST);
            // Halves of the gaps are at either end.
            (0..count).map(move |i| (n - edge) * (2 * i + 1) / (2 * count)).collect::<Vec<_>>()
        });
        let [xs, ys, zs] = &starts;
        let mut blocks = vec![];
        let mut waiting: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
        for &z in zs {
            for &y in ys {
                for &x in xs {
                    let lo = [x, y, z];
                    let hi = std::array::from_fn(|a| lo[a] + EDGE.min(dims[a]));
                    waiting.entry(z).or_default().push(blocks.len());
                    let samples = IndexBox { lo, hi };
                    blocks.push(Block { samples, values: vec![], filled: 0, bend: Bend::default() });
                }
            }
        }
        Self { blocks, waiting, open: vec![], missing }
    }

    /// Takes what blocks have of the samples of a box, x fastest. Each sample comes once.
    pub(super) fn add(&mut self, piece: &IndexBox, values: &[f32]) {
        while let Some(first) = self.waiting.first_entry().filter(|e| *e.key() < piece.hi[2]) {
            self.open.extend(first.remove());
        }
        let Self { blocks, open, missing, .. } = self;
        open.retain(|&n| {
            blocks[n].take(piece, values, *missing);
            !blocks[n].is_complete()
        });
    }

    /// How the field bends in all blocks that are complete.
    pub(super) fn bend(&self) -> Bend {
        let mut all = Bend::default();
        self.blocks.iter().for_each(|block| all.add(&block.bend));
        all
    }
}

impl Block {
    fn is_complete(&self) -> bool {
        self.filled == self.samples.len()
    }

    fn take(&mut self, piece: &IndexBox, values: &[f32], missing: Option<f32>) {
        let lo: [u64; 3] = std::array::from_fn(|a| self.samples.lo[a].max(piece.lo[a]));
        let hi: [u64; 3] = std::array::from_fn(|a| self.samples.hi[a].min(piece.hi[a]));
        if (0..3).any(|a| lo[a] >= hi[a]) {
            return;
        }
        self.values.resize(self.samples.len(), f32::NAN);
        let at = |b: &IndexBox, y: u64, z: u64| {
            let [nx, ny, _] = b.dims();
            (((z - b.lo[2]) * ny + y - b.lo[1]) * nx + lo[0] - b.lo[0]) as usize
        };
        let width = (hi[0] - lo[0]) as usize;
        for z in lo[2]..hi[2] {
            for y in lo[1]..hi[1] {
                let (to, from) = (at(&self.samples, y, z), at(piece, y, z));
                self.values[to..][..width].copy_from_slice(&values[from..][..width]);
                self.filled += width;
            }
        }
        if self.is_complete() {
            let is_none = |v: &f32| !v.is_finite() || Some(*v) == missing;
            self.values.iter_mut().filter(|v| is_none(v)).for_each(|v| *v = f32::NAN);
            self.bend = Bend::of(&self.samples, &self.values);
            self.values = vec![];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(x: u64, y: u64, z: u64) -> f32 {
        (x * x + 3 * y * y + z % 7) as f32
    }

    fn samples(b: &IndexBox) -> Vec<f32> {
        let mut values = vec![];
        for z in b.lo[2]..b.hi[2] {
            for y in b.lo[1]..b.hi[1] {
                values.extend((b.lo[0]..b.hi[0]).map(|x| value(x, y, z)));
            }
        }
        values
    }

    /// Read in pieces of such dimensions.
    fn read(dims: [u64; 3], piece: [u64; 3]) -> BendBlocks {
        let mut blocks = BendBlocks::new(dims, None);
        for z in (0..dims[2]).step_by(piece[2] as usize) {
            for y in (0..dims[1]).step_by(piece[1] as usize) {
                for x in (0..dims[0]).step_by(piece[0] as usize) {
                    let lo = [x, y, z];
                    let hi = std::array::from_fn(|a| (lo[a] + piece[a]).min(dims[a]));
                    let b = IndexBox { lo, hi };
                    blocks.add(&b, &samples(&b));
                }
            }
        }
        blocks
    }

    #[test]
    fn pieces_do_not_show() {
        for dims in [[70, 40, 110], [5, 33, 34], [300, 9, 2]] {
            let whole = read(dims, dims);
            assert!(whole.blocks.iter().all(Block::is_complete), "{dims:?}");
            assert!(whole.bend() != Bend::default());
            for piece in [[dims[0], dims[1], 1], [dims[0], 7, 1], [dims[0], dims[1], 50], [31, 17, 13]] {
                let found = read(dims, piece);
                assert_eq!(found.bend(), whole.bend(), "{dims:?} {piece:?}");
                assert!(found.open.is_empty() && found.waiting.is_empty());
            }
        }
    }

    #[test]
    fn blocks_are_few_and_lie_in_the_volume() {
        for dims in [[1000, 900, 800], [2, 2, 100_000], [33, 34, 66], [1 << 24, 2, 2]] {
            let blocks = BendBlocks::new(dims, None).blocks;
            assert!(!blocks.is_empty() && blocks.len() <= 216);
            for block in blocks {
                let IndexBox { lo, hi } = block.samples;
                assert!((0..3).all(|a| lo[a] < hi[a] && hi[a] <= dims[a]), "{dims:?}: {lo:?} {hi:?}");
            }
        }
    }

    #[test]
    fn samples_without_a_value_do_not_bend() {
        let dims = [33, 33, 33];
        let with = |missing: Option<f32>, hole: f32| {
            let mut blocks = BendBlocks::new(dims, missing);
            let b = IndexBox::whole(dims);
            let mut values = samples(&b);
            values[40..300].fill(hole);
            blocks.add(&b, &values);
            blocks.bend()
        };
        assert_eq!(with(None, f32::NAN), with(Some(-9e9), -9e9));
        assert!(with(None, f32::NAN) != with(None, -9e9));
    }
}
