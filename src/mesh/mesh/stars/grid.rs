//! The points of a region in cells, so that the points near one of them are a few runs.

use super::LANES;
use isospan_io::geom::{LatticeBox, LatticePos};

/// So many cells are never too many.
const FEW_CELLS: usize = 64;

/// The points of a region by cells, row after row along x.
#[derive(Debug, Default)]
pub(super) struct StarGrid {
    lo: LatticePos,
    /// Cells a lattice step, rounded down.
    pub(super) per_step: f64,
    cells: [usize; 3],
    /// Where the points of each cell begin; the end at the end.
    starts: Vec<u32>,
    /// Coordinates from `lo`, by a power of two so that the mean spacing is about 1: exact. Cell
    /// after cell, with some room behind.
    pub(super) at: [Vec<f32>; 3],
    pub(super) ids: Vec<u32>,
    pub(super) scale: f32,
}

impl StarGrid {
    /// `side`: of a cell, in lattice steps. False where there would be more cells than points, but
    /// for a few, as in a domain that is much thinner than a cell.
    pub(super) fn fill(
        &mut self,
        region: &LatticeBox,
        positions: &[LatticePos],
        side: f64,
        spacing: f64,
    ) -> bool {
        self.lo = region.lo;
        self.per_step = (1.0 - 1e-9) / side;
        self.scale = f32::exp2(-(spacing.log2().round() as f32));
        self.cells =
            std::array::from_fn(|a| (f64::from(region.hi[a] - region.lo[a]) * self.per_step) as usize + 1);
        if self.cells.iter().map(|&n| n as f64).product::<f64>() > positions.len().max(FEW_CELLS) as f64 {
            return false;
        }
        self.starts.clear();
        self.starts.resize(self.cells.iter().product::<usize>() + 1, 0);
        for p in positions {
            let cell = self.index(self.cell(p));
            self.starts[cell] += 1;
        }
        let mut sum = 0;
        for n in &mut self.starts {
            sum += *n;
            *n = sum;
        }
        for at in &mut self.at {
            at.resize(positions.len() + LANES, 0.0);
        }
        self.ids.resize(positions.len() + LANES, 0);
        // Backwards, so that the points of a cell ascend.
        for (id, p) in positions.iter().enumerate().rev() {
            let cell = self.index(self.cell(p));
            self.starts[cell] -= 1;
            let place = self.starts[cell] as usize;
            for a in 0..3 {
                self.at[a][place] = self.local(p, a);
            }
            self.ids[place] = id as u32;
        }
        true
    }

    #[inline]
    pub(super) fn local(&self, p: &LatticePos, a: usize) -> f32 {
        (p[a] - self.lo[a]) as f32 * self.scale
    }

    #[inline]
    pub(super) fn cell(&self, p: &LatticePos) -> [usize; 3] {
        std::array::from_fn(|a| (f64::from(p[a] - self.lo[a]) * self.per_step) as usize)
    }

    #[inline]
    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.cells[1] + y) * self.cells[0] + x
    }

    /// The places of the points of each row of the cells within `reach` cells.
    pub(super) fn rows(&self, cell: [usize; 3], reach: usize, rows: &mut Vec<[u32; 2]>) {
        let span = |a: usize| cell[a].saturating_sub(reach)..(cell[a] + reach + 1).min(self.cells[a]);
        rows.clear();
        for z in span(2) {
            for y in span(1) {
                let row = [span(0).start, span(0).end].map(|x| self.starts[self.index([x, y, z])]);
                rows.push(row);
            }
        }
    }
}
