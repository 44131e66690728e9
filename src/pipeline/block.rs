//! A block of a chunk, by itself: its corners, numbered from 0, and its tetrahedra.
//!
//! All that is looked at while a surface is extracted from it lies together: some ten kilobytes. Blocks that are kept for the next
//! question ([`Kept`]) have small numbers, in the order of the corners' ids, so that tetrahedra need not be sorted again, and the range of
//! values of each few tetrahedra that follow each other, so that an isovalue passes over most of them:
//!
//! ```text
//!  archive ──▶ Block (a buffer, read again and again) ──▶ KeptBlock, in the memory given, those not used lately dropped
//! ```
//!
//! Which blocks go is found by a hand that goes round (the "clock" of Corbató 1968): it passes over a block that was used since
//! it came by last, once.

use crate::exec::will_read;
use crate::geom::{LatticePos, PointId};
use crate::grid::ChunkId;
use crate::mesh::tet::{Tet, is_active, range};
use crate::surface::marching_tets::{CellSource, Sides, in_order};
use rustc_hash::FxHashMap;
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
    /// The corners in another order.
    fn permuted(&self, order: &[u16]) -> Self {
        fn of<T: Copy>(all: &[T], order: &[u16]) -> Vec<T> {
            order.iter().map(|&i| all[usize::from(i)]).collect()
        }
        Self {
            numbers: of(&self.numbers, order),
            positions: of(&self.positions, order),
            ids: of(&self.ids, order),
            values: of(&self.values, order),
            shared: of(&self.shared, order),
            of_chunk: self.of_chunk,
        }
    }

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
        let Block { corners, tets, .. } = block;
        let count = corners.numbers.len();
        if count > 1 << 16 {
            return None;
        }
        let mut order: Vec<u16> = (0..count).map(|i| i as u16).collect();
        order.sort_unstable_by_key(|&i| corners.ids[usize::from(i)]);
        let mut rank = vec![0; count];
        (0..).zip(&order).for_each(|(r, &i)| rank[usize::from(i)] = r);
        let values = &corners.values;
        let ranges = block.tets.chunks(GROUP).map(|group| {
            group
                .iter()
                .filter_map(|t| range(t.map(|v| values[v as usize])))
                .fold([f32::INFINITY, f32::NEG_INFINITY], |[lo, hi], (least, most)| {
                    [lo.min(least), hi.max(most)]
                })
        });
        let ranges = ranges.collect();
        let ordered = |t: &Tet| in_order(&corners.ids, t).map(|v| rank[v as usize]);
        Some(Self { corners: corners.permuted(&order), tets: tets.iter().map(ordered).collect(), ranges })
    }

    fn bytes(&self) -> usize {
        let corners = self.corners.numbers.len() * (4 + 12 + 8 + 4 + 1);
        size_of::<Self>() + corners + self.tets.len() * 8 + self.ranges.len() * 8
    }

    /// Asks the processor for what extraction reads.
    pub(super) fn will_be_read(&self) {
        will_read(&self.corners.values);
        will_read(&self.ranges);
        will_read(&self.tets);
        will_read(&self.corners.positions);
        will_read(&self.corners.numbers);
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
    /// Where in `slots` each is.
    by_place: FxHashMap<Place, usize>,
    slots: Vec<Slot>,
    /// The slot at which room is looked for next.
    hand: usize,
    bytes: usize,
}

#[derive(Debug)]
struct Slot {
    place: Place,
    block: Arc<KeptBlock>,
    /// Whether it was used since the hand came by.
    used: bool,
}

impl Kept {
    /// Keeps up to about so many bytes.
    pub(super) fn new(most: usize) -> Self {
        Self { most, blocks: Mutex::default() }
    }

    fn blocks(&self) -> MutexGuard<'_, KeptBlocks> {
        self.blocks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The most bytes that are kept.
    pub(super) fn most(&self) -> usize {
        self.most
    }

    /// Replaces `out` by the blocks of a chunk, those that are kept.
    pub(super) fn get(
        &self,
        chunk: ChunkId,
        numbers: impl Iterator<Item = u32>,
        out: &mut Vec<Option<Arc<KeptBlock>>>,
    ) {
        out.clear();
        if self.most == 0 {
            return out.extend(numbers.map(|_| None));
        }
        let mut blocks = self.blocks();
        let KeptBlocks { by_place, slots, .. } = &mut *blocks;
        out.extend(numbers.map(|number| {
            let slot = &mut slots[*by_place.get(&(chunk, number))?];
            slot.used = true;
            Some(Arc::clone(&slot.block))
        }));
    }

    /// Keeps a block, and drops others to make room.
    pub(super) fn put(&self, chunk: ChunkId, number: u32, block: &Block) {
        if self.most == 0 {
            return;
        }
        let Some(kept) = KeptBlock::of(block) else { return };
        let (bytes, place) = (kept.bytes(), (chunk, number));
        let mut blocks = self.blocks();
        // Another thread may have been faster.
        if bytes > self.most || blocks.by_place.contains_key(&place) {
            return;
        }
        while blocks.bytes + bytes > self.most {
            blocks.drop_one();
        }
        blocks.add(Slot { place, block: Arc::new(kept), used: false });
    }

    /// Bytes that the blocks take.
    pub(super) fn bytes(&self) -> usize {
        self.blocks().bytes
    }
}

impl KeptBlocks {
    fn add(&mut self, slot: Slot) {
        self.bytes += slot.block.bytes();
        self.by_place.insert(slot.place, self.slots.len());
        self.slots.push(slot);
    }

    /// Drops the next block that was not used since the hand came by.
    fn drop_one(&mut self) {
        loop {
            self.hand %= self.slots.len();
            let slot = &mut self.slots[self.hand];
            if !std::mem::take(&mut slot.used) {
                break;
            }
            self.hand += 1;
        }
        let dropped = self.slots.swap_remove(self.hand);
        self.by_place.remove(&dropped.place);
        self.bytes -= dropped.block.bytes();
        if let Some(moved) = self.slots.get(self.hand) {
            self.by_place.insert(moved.place, self.hand);
        }
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
                ids: (0..corners).map(|i| PointId(u64::from(i * 7919 % 8191))).collect(),
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
        let known = |tets: &[Tet], corners: &BlockCorners| -> Vec<_> {
            let tet = |t: &Tet| in_order(&corners.ids, t).map(|v| corners.numbers[v as usize]);
            tets.iter().map(tet).collect()
        };
        assert_eq!(known(&all, &kept.corners), known(&block.tets, &block.corners));
        assert!(kept.corners.ids.is_sorted());
        let mut sides = Sides::default();
        for isovalue in [-1.0, 10.0, 10.5, 17.0, 18.5, 99.0, 209.0, 209.5, f32::NAN] {
            let (mut here, mut there) = (vec![], vec![]);
            kept.select(isovalue, &mut sides, &mut here);
            sides.select(&block.tets, &block.corners.values, isovalue, &mut there);
            assert_eq!(known(&here, &kept.corners), known(&there, &block.corners), "{isovalue}");
        }
        assert!(KeptBlock::of(&self::block(70_000, 0.0)).is_none());
    }

    #[test]
    fn blocks_that_were_not_used_go() {
        let one = KeptBlock::of(&block(100, 0.0)).unwrap().bytes();
        let kept = Kept::new(3 * one + one / 2);
        for n in 0..3 {
            kept.put(ChunkId(1), n, &block(100, n as f32));
        }
        let get = |chunk, number| {
            let mut found = vec![];
            kept.get(ChunkId(chunk), [number].into_iter(), &mut found);
            found.pop().unwrap()
        };
        assert_eq!(get(1, 0).unwrap().corners.values[0], 0.0);
        kept.put(ChunkId(2), 1, &block(100, 9.0));
        assert_eq!(kept.bytes(), 3 * one);
        let there = [(1, 0), (1, 1), (1, 2), (2, 1)].map(|(c, n)| get(c, n).is_some());
        assert_eq!(there, [true, false, true, true]);
        // What is larger than all is not kept, nothing is where nothing may be.
        kept.put(ChunkId(3), 0, &block(1000, 0.0));
        assert!(get(3, 0).is_none() && kept.bytes() == 3 * one);
        let none = Kept::new(0);
        none.put(ChunkId(1), 0, &block(100, 0.0));
        let mut found = vec![];
        none.get(ChunkId(1), 0..2, &mut found);
        assert!(found.iter().all(Option::is_none) && found.len() == 2 && none.bytes() == 0);
    }
}
