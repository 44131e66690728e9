//! Cuts between chunks that are given, and do not follow from the points.
//!
//! Chunks whose cuts follow from the points change as soon as a few points are added. Where most of
//! them are to stay as they are, the cuts of an earlier grid are kept. Only a chunk that has become
//! too large is cut again, along x, and the others are not affected:
//!
//! ```text
//!  ┌───────┬──────┬────────┐      ┌───────┬───┬──┬────────┐
//!  │       │ ∘∘∘∘∘│        │      │       │ ∘∘│∘∘│        │
//!  ├─────┬─┴──────┴┬───────┤  ─▶  ├─────┬─┴───┴──┴┬───────┤
//!  │     │         │       │      │     │         │       │
//!  └─────┴─────────┴───────┘      └─────┴─────────┴───────┘
//! ```

use super::{BrickGrid, ChunkGrid, ChunkId, Counter, XCuts, balanced_cuts, check_size, counts};
use crate::error::{Error, Result};
use crate::geom::LatticeBox;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Where bricks are cut into chunks: of each axis 0, ends, and the number of bricks, ascending.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChunkCuts {
    /// Along z.
    pub z: Vec<u64>,
    /// Along y, of each layer.
    pub y: Vec<Vec<u64>>,
    /// Along x, of each row of each layer.
    pub x: Vec<Vec<u64>>,
}

impl ChunkCuts {
    /// # Errors
    /// [`Error::Usage`] unless they cut bricks of these dimensions.
    fn check(&self, dims: [u64; 3]) -> Result<()> {
        let whole = |cuts: &[u64], n: u64| {
            cuts.first() == Some(&0) && cuts.last() == Some(&n) && cuts.is_sorted_by(|a, b| a < b)
        };
        let rows: usize = self.y.iter().map(|y| y.len().saturating_sub(1)).sum();
        let each = self.y.iter().all(|y| whole(y, dims[1])) && self.x.iter().all(|x| whole(x, dims[0]));
        if whole(&self.z, dims[2]) && self.y.len() + 1 == self.z.len() && self.x.len() == rows && each {
            return Ok(());
        }
        Err(Error::usage(format!("cuts between chunks that do not cut {dims:?} bricks")))
    }

    /// The same, chunks of more than `most` points cut further, into some of about `target`; `None`
    /// where cuts along x do not do.
    pub fn refined(
        mut self,
        bricks: BrickGrid,
        target: u64,
        most: u64,
        count: impl Fn(&LatticeBox) -> u64 + Send + Sync + 'static,
    ) -> Option<Self> {
        let count: Counter = Box::new(count);
        let mut rows = self.x.iter_mut();
        for (z, ys) in self.z.windows(2).zip(&self.y) {
            for (y, x) in ys.windows(2).zip(&mut rows) {
                let of = |lo: u64, hi: u64| ([lo, y[0], z[0]], [hi, y[1], z[1]]);
                let mut refined = vec![0];
                for run in x.windows(2) {
                    let (lo, hi) = of(run[0], run[1]);
                    let points = count(&bricks.lattice_box(lo, hi));
                    if points > most {
                        let slices = counts(&bricks, &count, 0, lo, hi);
                        let cuts = balanced_cuts(&slices, points.div_ceil(target));
                        let parts = cuts.windows(2);
                        let sum = |p: &[u64]| slices[p[0] as usize..p[1] as usize].iter().sum::<u64>();
                        // A single brick is not cut, for any cuts.
                        let thick = y[1] - y[0] > 1 || z[1] - z[0] > 1;
                        if thick && parts.clone().any(|p| sum(p) > most) {
                            return None;
                        }
                        refined.extend(parts.map(|p| run[0] + p[1]));
                    } else {
                        refined.push(run[1]);
                    }
                }
                *x = refined;
            }
        }
        Some(self)
    }
}

impl ChunkGrid {
    /// Chunks of a brick each.
    ///
    /// # Errors
    /// [`Error::Usage`] for too many bricks.
    pub fn of_bricks(bricks: BrickGrid) -> Result<Self> {
        check_size(bricks.dims())?;
        let [x, y, z] = bricks.dims();
        let rows = usize::try_from(y * z).map_err(|_| Error::usage("there are too many chunks"))?;
        let all = |n: u64| (0..=n).collect::<Vec<u64>>();
        let cuts = ChunkCuts { z: all(z), y: vec![all(y); z as usize], x: vec![all(x); rows] };
        Self::from_cuts(bricks, &cuts)
    }

    /// Bricks with the given cuts.
    ///
    /// # Errors
    /// [`Error::Usage`] for cuts that are not those of such bricks, and for too many bricks.
    pub fn from_cuts(bricks: BrickGrid, cuts: &ChunkCuts) -> Result<Self> {
        check_size(bricks.dims())?;
        cuts.check(bricks.dims())?;
        let in_layer = |(layer, y): (usize, &Vec<u64>)| (0..y.len() - 1).map(move |row| (layer, row));
        let all = cuts.y.iter().enumerate().flat_map(in_layer);
        let (mut rows, mut len) = (vec![], 0);
        for ((layer, row), x) in all.zip(&cuts.x) {
            rows.push((len, layer, row));
            len += x.len() as u64 - 1;
        }
        let x_cuts = XCuts::Given(cuts.x.iter().cloned().map(Arc::new).collect());
        Ok(Self { bricks, z_cuts: cuts.z.clone(), y_cuts: cuts.y.clone(), x_cuts, rows, len })
    }

    /// The cuts of this grid.
    pub fn cuts(&self) -> ChunkCuts {
        let x = (0..self.rows.len()).map(|at| self.row_cuts(at).to_vec()).collect();
        ChunkCuts { z: self.z_cuts.clone(), y: self.y_cuts.clone(), x }
    }

    /// The chunk that has the bricks `lo <= c < hi` and no other ones.
    pub fn find(&self, lo: [u64; 3], hi: [u64; 3]) -> Option<ChunkId> {
        let run = |cuts: &[u64], a: usize| {
            let at = cuts.binary_search(&lo[a]).ok()?;
            (cuts.get(at + 1) == Some(&hi[a])).then_some(at)
        };
        let layer = run(&self.z_cuts, 2)?;
        let row = run(&self.y_cuts[layer], 1)?;
        let at = self.rows.binary_search_by_key(&(layer, row), |&(_, layer, row)| (layer, row)).ok()?;
        Some(ChunkId(self.rows[at].0 + run(&self.row_cuts(at), 0)? as u64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Lattice;

    fn grid(target: u64) -> ChunkGrid {
        let bricks = BrickGrid::new(Lattice::new([103, 94, 161]).unwrap(), [4, 4, 5]);
        ChunkGrid::new(bricks, target, points(1)).unwrap()
    }

    /// So many times as many in the half that is nearer to the origin, 1 a voxel elsewhere.
    fn points(times: u64) -> impl Fn(&LatticeBox) -> u64 {
        let lattice = Lattice::new([103, 94, 161]).unwrap();
        let half = LatticeBox { lo: [0; 3], hi: [51 << lattice.log2_steps[0], u32::MAX, u32::MAX] };
        let voxels = move |b: &LatticeBox| (b.volume() >> (3 * lattice.log2_steps[0])) as u64;
        move |b: &LatticeBox| voxels(b) + (times - 1) * voxels(&b.intersect(&half))
    }

    #[test]
    fn a_grid_that_is_told_is_the_same_and_finds_its_chunks() {
        let counted = grid(20_000);
        let again = ChunkGrid::from_cuts(*counted.bricks(), &counted.cuts()).unwrap();
        assert!(counted.iter().eq(again.iter()) && again.len() > 50);
        assert_eq!(again.cuts(), counted.cuts());
        for chunk in counted.iter() {
            for grid in [&counted, &again] {
                assert_eq!(grid.find(chunk.brick_lo, chunk.brick_hi), Some(chunk.id));
            }
            let [x, y, z] = chunk.brick_hi;
            assert_eq!(again.find(chunk.brick_lo, [x + 1, y, z]), None);
            assert_eq!(again.find([chunk.brick_lo[0], y, chunk.brick_lo[2]], chunk.brick_hi), None);
        }
    }

    #[test]
    fn chunks_that_grow_are_cut_and_others_stay() {
        let before = grid(20_000);
        let bricks = *before.bricks();
        assert_eq!(before.cuts().refined(bricks, 20_000, 40_000, points(1)), Some(before.cuts()));
        let refined = before.cuts().refined(bricks, 20_000, 40_000, points(4)).unwrap();
        let after = ChunkGrid::from_cuts(bricks, &refined).unwrap();
        let stayed = |c: &crate::grid::Chunk| after.find(c.brick_lo, c.brick_hi).is_some();
        let (stay, all) = (before.iter().filter(stayed).count(), before.len() as usize);
        assert!(stay * 3 > all && stay * 3 < all * 2, "{stay} of {all}");
        assert!(after.iter().all(|c| points(4)(&c.core) <= 40_000));
        assert_eq!(before.cuts().refined(bricks, 20_000, 40_000, points(1 << 20)), None);
    }

    #[test]
    fn cuts_that_are_none_are_refused() {
        let (bricks, good) = (*grid(20_000).bricks(), grid(20_000).cuts());
        let refused = |edit: fn(&mut ChunkCuts)| {
            let mut bad = good.clone();
            edit(&mut bad);
            assert!(ChunkGrid::from_cuts(bricks, &bad).is_err(), "{bad:?}");
        };
        refused(|c| c.z.clear());
        refused(|c| c.z[1] = c.z[2]);
        refused(|c| *c.z.last_mut().unwrap() += 1);
        refused(|c| c.y[0] = vec![]);
        refused(|c| c.y[0][0] = 1);
        refused(|c| c.y[0].swap(1, 2));
        refused(|c| _ = c.y.pop());
        refused(|c| c.x.push(vec![0]));
        refused(|c| c.x[3] = vec![0]);
        refused(|c| _ = c.x[3].pop());
        refused(|c| _ = c.x.pop());
    }
}
