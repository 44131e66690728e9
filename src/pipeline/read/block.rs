//! One block of a chunk: its corners, numbered from 0, and its tetrahedra.
//!
//! All data of an extraction lie together: some ten kilobytes. The blocks of a series are numbered
//! once for all steps (`surface/extract/numbered`).

use crate::surface::extract::{CellSource, NumberedBlock, Unpacked, Workbench};
use isospan_io::geom::{LatticePos, PointId};
use isospan_mesh::mesh::tet::Tet;

/// The corners of a block, and of its chunk how many.
#[derive(Clone, Debug, Default)]
pub(in crate::pipeline) struct BlockCorners {
    /// Their numbers in the chunk.
    pub(in crate::pipeline) numbers: Vec<u32>,
    pub(in crate::pipeline) positions: Vec<LatticePos>,
    pub(super) ids: Vec<PointId>,
    pub(in crate::pipeline) values: Vec<f32>,
    pub(super) shared: Vec<bool>,
    pub(in crate::pipeline) of_chunk: usize,
}

impl BlockCorners {
    /// Tetrahedra between these corners.
    pub(in crate::pipeline) fn cells<'a>(&'a self, tets: &'a [Tet]) -> CellSource<'a> {
        CellSource {
            positions: &self.positions,
            values: &self.values,
            ids: &self.ids,
            shared: &self.shared,
            numbers: Some(&self.numbers),
            tets,
        }
    }
}

/// A block that has been read.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct Block {
    pub(in crate::pipeline) corners: BlockCorners,
    /// Corners are places in `corners`.
    pub(in crate::pipeline) tets: Vec<Tet>,
    /// Bytes that the tetrahedra took in the archive; 0 of a block that was kept.
    pub(in crate::pipeline) bytes: u64,
}

/// A block whose edges are numbered, and that gets the values of one step after another.
#[derive(Debug)]
pub(in crate::pipeline) struct NumberedShape {
    pub(in crate::pipeline) numbered: NumberedBlock,
    /// Corners of its chunk.
    pub(in crate::pipeline) of_chunk: usize,
}

impl NumberedShape {
    /// `None` for a block with too many corners, which are rare.
    pub(in crate::pipeline) fn of(
        Block { corners, tets, .. }: &Block,
        bench: &mut Workbench,
    ) -> Option<Self> {
        Some(Self { numbered: bench.number(&corners.cells(tets))?, of_chunk: corners.of_chunk })
    }

    /// Bytes of memory.
    pub(super) fn bytes(&self) -> usize {
        size_of::<Self>() + self.numbered.bytes()
    }

    /// The block as it was read, its corners in another order.
    pub(in crate::pipeline) fn unpack(&self, Block { corners, tets, bytes }: &mut Block) {
        let BlockCorners { numbers, positions, ids, values, shared, of_chunk } = corners;
        self.numbered.unpack(&mut Unpacked { numbers, positions, ids, values, shared, tets });
        (*of_chunk, *bytes) = (self.of_chunk, 0);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Corners in a row, and tetrahedra of neighbours.
    pub(in super::super) fn block(corners: u32, first: f32) -> Block {
        let values: Vec<f32> =
            (0..corners).map(|i| if i == 7 { f32::NAN } else { first + i as f32 }).collect();
        Block {
            corners: BlockCorners {
                numbers: (0..corners).map(|i| 2 * i).collect(),
                positions: (0..corners).map(|i| [i, i.wrapping_mul(i), (1 << 24) - i]).collect(),
                ids: (0..corners).map(|i| PointId(u64::from(i * 7919 % 8191) << 20)).collect(),
                values,
                shared: (0..corners).map(|i| i % 3 == 0).collect(),
                of_chunk: 2 * corners as usize,
            },
            tets: (3..corners).map(|i| [i, i - 1, i - 2, i - 3]).collect(),
            bytes: 1,
        }
    }
}
