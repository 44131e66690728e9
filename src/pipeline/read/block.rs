//! One block of a chunk: its corners, numbered from 0, and its tetrahedra.
//!
//! All data of an extraction lie together: some ten kilobytes. The blocks of a series are numbered
//! once for all steps ([`crate::surface::numbered`]).

use crate::exec::will_read;
use crate::geom::{LatticePos, PointId};
use crate::mesh::tet::Tet;
use crate::surface::extract::{CellSource, NumberedBlock, Unpacked, Workbench};

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
    /// Replaces the values by those that `values` has at the corners' numbers.
    pub(in crate::pipeline) fn take_values(&mut self, values: &[f32]) {
        self.values.clear();
        self.values.extend(self.numbers.iter().map(|&n| values[n as usize]));
    }

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

    /// The block as it was read, its corners in another order.
    pub(in crate::pipeline) fn unpack(&self, Block { corners, tets, bytes }: &mut Block) {
        let BlockCorners { numbers, positions, ids, values, shared, of_chunk } = corners;
        self.numbered.unpack(&mut Unpacked { numbers, positions, ids, values, shared, tets });
        (*of_chunk, *bytes) = (self.of_chunk, 0);
    }
}

/// A block in as little memory as is quickly had: a copy.
#[derive(Debug)]
pub(in crate::pipeline) struct PackedBlock {
    /// Number, position, value and id of each corner, then the corners of each tetrahedron, of two
    /// bytes each.
    words: Box<[u32]>,
    corners: usize,
    of_chunk: usize,
}

/// Words a corner.
const PER_CORNER: usize = 7;
/// In the number of a corner: other chunks may have it.
const SHARED: u32 = 1 << 31;

impl PackedBlock {
    /// `None` of a block with more corners than 16 bits number, or whose chunk has more than 31.
    pub(super) fn of(Block { corners, tets, .. }: &Block) -> Option<Self> {
        let BlockCorners { numbers, positions, ids, values, shared, of_chunk } = corners;
        if numbers.len() > 1 << 16 || *of_chunk > SHARED as usize {
            return None;
        }
        let mut words = Vec::with_capacity(PER_CORNER * numbers.len() + 2 * tets.len());
        for i in 0..numbers.len() {
            let ([x, y, z], id) = (positions[i], ids[i].0);
            let number = numbers[i] | if shared[i] { SHARED } else { 0 };
            words.extend([number, x, y, z, values[i].to_bits(), id as u32, (id >> 32) as u32]);
        }
        words.extend(tets.iter().flat_map(|t| bytemuck::cast::<[u16; 4], [u32; 2]>(t.map(|v| v as u16))));
        Some(Self { words: words.into(), corners: numbers.len(), of_chunk: *of_chunk })
    }

    pub(super) fn bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.words)
    }

    /// Asks the processor for it.
    pub(super) fn will_be_read(&self) {
        will_read(&self.words);
    }

    /// The block as it was, except for its bytes in the archive.
    pub(super) fn unpack(&self, Block { corners, tets, bytes }: &mut Block) {
        self.unpack_corners(corners);
        tets.clear();
        tets.extend(self.tets().iter().map(|t| t.map(u32::from)));
        *bytes = 0;
    }

    /// Its tetrahedra.
    pub(in crate::pipeline) fn tets(&self) -> &[[u16; 4]] {
        bytemuck::cast_slice(&self.words[PER_CORNER * self.corners..])
    }

    /// The corners as they were.
    pub(in crate::pipeline) fn unpack_corners(&self, corners: &mut BlockCorners) {
        let BlockCorners { numbers, positions, ids, values, shared, of_chunk } = corners;
        let (of_corners, _) = self.words[..PER_CORNER * self.corners].as_chunks::<PER_CORNER>();
        numbers.clear();
        numbers.extend(of_corners.iter().map(|c| c[0] & !SHARED));
        shared.clear();
        shared.extend(of_corners.iter().map(|c| c[0] & SHARED != 0));
        positions.clear();
        positions.extend(of_corners.iter().map(|&[_, x, y, z, ..]| [x, y, z]));
        values.clear();
        values.extend(of_corners.iter().map(|c| f32::from_bits(c[4])));
        ids.clear();
        ids.extend(of_corners.iter().map(|c| PointId(u64::from(c[5]) | u64::from(c[6]) << 32)));
        *of_chunk = self.of_chunk;
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

    #[test]
    fn a_packed_block_is_the_block() {
        let known = |Block { corners: c, tets, .. }: &Block| {
            let values: Vec<u32> = c.values.iter().map(|v| v.to_bits()).collect();
            (
                c.numbers.clone(),
                c.positions.clone(),
                c.ids.clone(),
                values,
                c.shared.clone(),
                c.of_chunk,
                tets.clone(),
            )
        };
        let mut unpacked = Block::default();
        for corners in [0, 4, 200, 4000] {
            let block = block(corners, 10.0);
            PackedBlock::of(&block).unwrap().unpack(&mut unpacked);
            assert_eq!(known(&unpacked), known(&block));
        }
        assert!(PackedBlock::of(&block((1 << 16) + 1, 0.0)).is_none());
    }
}
