//! A block of a chunk, by itself: its corners, numbered from 0, and its tetrahedra.
//!
//! All that is looked at while a surface is extracted from it lies together: some ten kilobytes. Blocks that are kept for the next
//! question ([`Kept`]) have small numbers, and the range of values of each few tetrahedra that follow each other, so that
//! an isovalue passes over most of them:
//!
//! ```text
//!  archive ──▶ Block (a buffer, read again and again) ──▶ KeptBlock, in the memory given, the least recently used ones dropped
//! ```

use crate::geom::{LatticePos, PointId};
use crate::grid::ChunkId;
use crate::mesh::tet::{Tet, is_active, range};
use crate::surface::marching_tets::{CellSource, Sides};
use rustc_hash::FxHashMap;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The corners of a block, and of its chunk how many.
#[derive(Clone, Debug, Default)]
pub(super) struct BlockCorners {
    /// Their numbers in the chunk.
    pub(super) numbers: Vec<u32>,
    pub(super) positions: Vec<LatticePos>,
    pub(super) ids: Vec<PointId>,
    pub(super) values: Vec<f32>,
    pub(super) shared: Vec<bool>,
    pub(super) of_chunk: usize,
}

impl BlockCorners {
    /// Tetrahedra between these corners.
    pub(super) fn cells<'a>(&'a self, tets: &'a [Tet]) -> CellSource<'a> {
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
pub(super) struct Block {
    pub(super) corners: BlockCorners,
    /// Corners are places in `corners`.
    pub(super) tets: Vec<Tet>,
    /// Bytes that the tetrahedra took in the archive.
    pub(super) bytes: u64,
}

/// Tetrahedra that have a range of values together.
const GROUP: usize = 16;

/// A block kept in memory.
#[derive(Debug)]
pub(super) struct KeptBlock {
    pub(super) corners: BlockCorners,
    tets: Box<[[u16; 4]]>,
    /// Least and largest value of each [`GROUP`] of tetrahedra, void ones left out.
    ranges: Box<[[f32; 2]]>,
}

impl KeptBlock {
    /// `None` for a block with too many corners, which only a mesh that is no Delaunay tetrahedralization has.
    fn of(block: &Block) -> Option<Self> {
        if block.corners.numbers.len() > 1 << 16 {
            return None;
        }
        let values = &block.corners.values;
        let ranges = block.tets.chunks(GROUP).map(|group| {
            group
                .iter()
                .filter_map(|t| range(t.map(|v| values[v as usize])))
                .fold([f32::INFINITY, f32::NEG_INFINITY], |[lo, hi], (least, most)| {
                    [lo.min(least), hi.max(most)]
                })
        });
        let ranges = ranges.collect();
        Some(Self {
            corners: block.corners.clone(),
            tets: block.tets.iter().map(|t| t.map(|v| v as u16)).collect(),
            ranges,
        })
    }

    fn bytes(&self) -> usize {
        let corners = self.corners.numbers.len() * (4 + 12 + 8 + 4 + 1);
        size_of::<Self>() + corners + self.tets.len() * 8 + self.ranges.len() * 8
    }

    /// Appends the active tetrahedra to `active`.
    pub(super) fn select(&self, isovalue: f32, sides: &mut Sides, active: &mut Vec<Tet>) {
        sides.set(&self.corners.values, isovalue);
        for (group, &[lo, hi]) in self.tets.chunks(GROUP).zip(&self.ranges) {
            if is_active(lo, hi, isovalue) {
                sides.active_of(group, active);
            }
        }
    }

    /// Appends all tetrahedra.
    pub(super) fn tets(&self, out: &mut Vec<Tet>) {
        out.extend(self.tets.iter().map(|t| t.map(u32::from)));
    }
}

/// Blocks kept in memory, up to a number of bytes; from any thread.
#[derive(Debug, Default)]
pub(super) struct Kept {
    most: usize,
    blocks: Mutex<KeptBlocks>,
}

type Place = (ChunkId, u32);

#[derive(Debug, Default)]
struct KeptBlocks {
    by_place: FxHashMap<Place, (u64, Arc<KeptBlock>)>,
    /// By when they were last used.
    by_use: BTreeMap<u64, Place>,
    uses: u64,
    bytes: usize,
}

impl Kept {
    /// Keeps up to about so many bytes.
    pub(super) fn new(most: usize) -> Self {
        Self { most, blocks: Mutex::default() }
    }

    fn blocks(&self) -> MutexGuard<'_, KeptBlocks> {
        self.blocks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The block, if it is kept.
    pub(super) fn get(&self, chunk: ChunkId, block: u32) -> Option<Arc<KeptBlock>> {
        if self.most == 0 {
            return None;
        }
        let mut blocks = self.blocks();
        let blocks = &mut *blocks;
        let (used, kept) = blocks.by_place.get_mut(&(chunk, block))?;
        blocks.uses += 1;
        blocks.by_use.remove(used);
        blocks.by_use.insert(blocks.uses, (chunk, block));
        *used = blocks.uses;
        Some(Arc::clone(kept))
    }

    /// Keeps a block, and drops those that were not used for the longest time to make room.
    pub(super) fn put(&self, chunk: ChunkId, number: u32, block: &Block) {
        if self.most == 0 {
            return;
        }
        let Some(kept) = KeptBlock::of(block) else { return };
        let bytes = kept.bytes();
        let mut blocks = self.blocks();
        // Another thread may have been faster.
        if bytes > self.most || blocks.by_place.contains_key(&(chunk, number)) {
            return;
        }
        blocks.uses += 1;
        let used = blocks.uses;
        blocks.by_place.insert((chunk, number), (used, Arc::new(kept)));
        blocks.by_use.insert(used, (chunk, number));
        blocks.bytes += bytes;
        while blocks.bytes > self.most {
            let (_, oldest) = blocks.by_use.pop_first().expect("the bytes are those of the blocks");
            let (_, dropped) = blocks.by_place.remove(&oldest).expect("each block is in both maps");
            blocks.bytes -= dropped.bytes();
        }
    }

    /// Bytes that the blocks take.
    pub(super) fn bytes(&self) -> usize {
        self.blocks().bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Corners in a row, and tetrahedra of neighbours.
    fn block(corners: u32, first: f32) -> Block {
        let values: Vec<f32> =
            (0..corners).map(|i| if i == 7 { f32::NAN } else { first + i as f32 }).collect();
        Block {
            corners: BlockCorners {
                numbers: (0..corners).map(|i| 2 * i).collect(),
                positions: vec![[0; 3]; corners as usize],
                ids: vec![PointId(0); corners as usize],
                values,
                shared: vec![false; corners as usize],
                of_chunk: 2 * corners as usize,
            },
            tets: (3..corners).map(|i| [i, i - 1, i - 2, i - 3]).collect(),
            bytes: 1,
        }
    }

    #[test]
    fn a_kept_block_has_the_active_tetrahedra_of_the_block() {
        let block = block(200, 10.0);
        let kept = KeptBlock::of(&block).unwrap();
        let mut all = vec![];
        kept.tets(&mut all);
        assert_eq!(all, block.tets);
        let mut sides = Sides::default();
        for isovalue in [-1.0, 10.0, 10.5, 17.0, 18.5, 99.0, 209.0, 209.5, f32::NAN] {
            let (mut here, mut there) = (vec![], vec![]);
            kept.select(isovalue, &mut sides, &mut here);
            sides.select(&block.tets, &block.corners.values, isovalue, &mut there);
            assert_eq!(here, there, "{isovalue}");
        }
        assert!(KeptBlock::of(&self::block(70_000, 0.0)).is_none());
    }

    #[test]
    fn the_least_recently_used_blocks_go() {
        let one = KeptBlock::of(&block(100, 0.0)).unwrap().bytes();
        let kept = Kept::new(3 * one + one / 2);
        for n in 0..3 {
            kept.put(ChunkId(1), n, &block(100, n as f32));
        }
        assert_eq!(kept.get(ChunkId(1), 0).unwrap().corners.values[0], 0.0);
        kept.put(ChunkId(2), 1, &block(100, 9.0));
        assert_eq!(kept.bytes(), 3 * one);
        let there = [(1, 0), (1, 1), (1, 2), (2, 1)].map(|(c, n)| kept.get(ChunkId(c), n).is_some());
        assert_eq!(there, [true, false, true, true]);
        // What is larger than all is not kept, nothing is where nothing may be.
        kept.put(ChunkId(3), 0, &block(1000, 0.0));
        assert!(kept.get(ChunkId(3), 0).is_none() && kept.bytes() == 3 * one);
        let none = Kept::new(0);
        none.put(ChunkId(1), 0, &block(100, 0.0));
        assert!(none.get(ChunkId(1), 0).is_none() && none.bytes() == 0);
    }
}
