//! The cells of each brick.

use super::column::{Column, ColumnWriter};
use super::settings::StoreSettings;
use super::store::CellStore;
use isospan_io::bytes::sorter::Sorter;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::grid::{BrickGrid, BrickId};
use isospan_mesh::locate::{CellBatch, FINE_BITS, FinePos};

/// Cells handed out at a time.
pub(super) const BATCH: usize = 4096;

/// For each brick, the numbers of the cells whose bounding box meets it, ascending.
pub(crate) struct Buckets {
    cells: Column<u64>,
    /// Where each brick's cells begin, and the end.
    starts: Column<u64>,
}

impl Buckets {
    /// Sorts the cells into bricks.
    pub(crate) fn new(store: &CellStore, bricks: &BrickGrid, settings: &StoreSettings) -> Result<Self> {
        let memory = usize::try_from(settings.memory).unwrap_or(usize::MAX);
        let mut sorter: Sorter<[u64; 2]> = Sorter::new(memory, &settings.scratch);
        let positions = store.positions.get()?;
        for (number, tet) in store.tets.get()?.iter().enumerate() {
            if number % BATCH == 0 {
                settings.cancel.check()?;
            }
            let [lo, hi] = reach(bricks, tet.map(|v| positions[v as usize]));
            for z in lo[2]..=hi[2] {
                for y in lo[1]..=hi[1] {
                    for x in lo[0]..=hi[0] {
                        sorter.push([bricks.id([x, y, z]).0, number as u64])?;
                    }
                }
            }
        }
        let (mut cells, mut starts) =
            (ColumnWriter::new(&settings.scratch)?, ColumnWriter::new(&settings.scratch)?);
        let mut sorted = sorter.finish()?;
        while let Some([brick, cell]) = sorted.next()? {
            while starts.len() <= brick {
                starts.push(&cells.len())?;
            }
            cells.push(&cell)?;
        }
        while starts.len() <= bricks.len() {
            starts.push(&cells.len())?;
        }
        Ok(Self { cells: cells.finish()?, starts: starts.finish()? })
    }

    /// Calls `visit` with the cells of a brick, some at a time.
    pub(crate) fn each_batch(
        &self,
        store: &CellStore,
        brick: BrickId,
        batch: &mut CellBatch,
        mut visit: impl FnMut(&CellBatch),
    ) -> Result<()> {
        let starts = self.starts.get()?;
        let (from, to) = (starts[brick.0 as usize] as usize, starts[brick.0 as usize + 1] as usize);
        for cells in self.cells.get()?[from..to].chunks(BATCH) {
            store.fill(batch, cells.iter().copied())?;
            visit(batch);
        }
        Ok(())
    }
}

/// The bricks, by coordinates, that have the corners of a tetrahedron's bounding box.
fn reach(bricks: &BrickGrid, corners: [FinePos; 4]) -> [[u64; 3]; 2] {
    let extreme = |pick: fn(i64, i64) -> i64| -> LatticePos {
        std::array::from_fn(|a| {
            (corners.iter().map(|c| c[a]).reduce(pick).expect("four corners") >> FINE_BITS) as u32
        })
    };
    [bricks.brick_at(extreme(i64::min)), bricks.brick_at(extreme(i64::max))]
}
