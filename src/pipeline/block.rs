//! A block of a chunk, by itself: its corners, numbered from 0, and its tetrahedra.
//!
//! All that is looked at while a surface is extracted from it lies together: some ten kilobytes. Blocks that are kept for the next
//! question ([`Kept`]) are numbered once and for all ([`crate::surface::numbered`]):
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
use crate::mesh::tet::Tet;
use crate::surface::marching_tets::{CellSource, Workbench};
use crate::surface::numbered::{NumberedBlock, Unpacked};
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
    /// Replaces the values by those that `values` has at the corners' numbers.
    pub(super) fn take_values(&mut self, values: &[f32]) {
        self.values.clear();
        self.values.extend(self.numbers.iter().map(|&n| values[n as usize]));
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
    /// Bytes that the tetrahedra took in the archive; 0 of a block that was kept.
    pub(super) bytes: u64,
}

/// A block kept in memory.
#[derive(Debug)]
pub(super) struct KeptBlock {
    pub(super) numbered: NumberedBlock,
    /// Corners of its chunk.
    pub(super) of_chunk: usize,
}

impl KeptBlock {
    /// `None` for a block with too many corners, which are rare.
    pub(super) fn of(Block { corners, tets, .. }: &Block, bench: &mut Workbench) -> Option<Self> {
        Some(Self { numbered: bench.number(&corners.cells(tets))?, of_chunk: corners.of_chunk })
    }

    pub(super) fn bytes(&self) -> usize {
        size_of::<usize>() + self.numbered.bytes()
    }

    /// The block as it was read, its corners in another order.
    pub(super) fn unpack(&self, Block { corners, tets, bytes }: &mut Block) {
        let BlockCorners { numbers, positions, ids, values, shared, of_chunk } = corners;
        self.numbered.unpack(&mut Unpacked { numbers, positions, ids, values, shared, tets });
        (*of_chunk, *bytes) = (self.of_chunk, 0);
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
        let slots_of = numbers.map(|number| by_place.get(&(chunk, number)).copied());
        let found: Vec<Option<usize>> = slots_of
            .inspect(|slot| {
                // A count that is in no cache is waited for, one after another.
                slot.iter().for_each(|&slot| will_read(std::slice::from_ref(&*slots[slot].block)));
            })
            .collect();
        out.extend(found.into_iter().map(|slot| {
            let slot = &mut slots[slot?];
            slot.used = true;
            Some(Arc::clone(&slot.block))
        }));
    }

    /// Keeps a block, and drops others to make room.
    pub(super) fn put(&self, chunk: ChunkId, number: u32, block: &Block, bench: &mut Workbench) {
        if self.most == 0 {
            return;
        }
        let Some(kept) = KeptBlock::of(block, bench) else { return };
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
    use crate::surface::marching_tets::in_order;

    /// Corners in a row, and tetrahedra of neighbours.
    fn block(corners: u32, first: f32) -> Block {
        let values: Vec<f32> =
            (0..corners).map(|i| if i == 7 { f32::NAN } else { first + i as f32 }).collect();
        Block {
            corners: BlockCorners {
                numbers: (0..corners).map(|i| 2 * i).collect(),
                positions: (0..corners).map(|i| [i, i * i, (1 << 24) - i]).collect(),
                ids: (0..corners).map(|i| PointId(u64::from(i * 7919 % 8191))).collect(),
                values,
                shared: (0..corners).map(|i| i % 3 == 0).collect(),
                of_chunk: 2 * corners as usize,
            },
            tets: (3..corners).map(|i| [i, i - 1, i - 2, i - 3]).collect(),
            bytes: 1,
        }
    }

    #[test]
    fn a_kept_block_is_the_block() {
        let (block, mut bench) = (block(200, 10.0), Workbench::default());
        let kept = KeptBlock::of(&block, &mut bench).unwrap();
        let mut unpacked = Block::default();
        kept.unpack(&mut unpacked);
        let known = |Block { corners: c, tets, .. }: &Block| -> Vec<_> {
            let corner = |v: u32| {
                let v = v as usize;
                (c.numbers[v], c.positions[v], c.ids[v], c.values[v].to_bits(), c.shared[v])
            };
            tets.iter().map(|t| in_order(&c.ids, t).map(corner)).collect()
        };
        assert_eq!(known(&unpacked), known(&block));
        assert_eq!(unpacked.corners.of_chunk, block.corners.of_chunk);
        assert!(unpacked.corners.ids.is_sorted());
        assert!(KeptBlock::of(&self::block(257, 0.0), &mut bench).is_none());
    }

    #[test]
    fn blocks_that_were_not_used_go() {
        let mut bench = Workbench::default();
        let one = KeptBlock::of(&block(100, 0.0), &mut bench).unwrap().bytes();
        let kept = Kept::new(3 * one + one / 2);
        for n in 0..3 {
            kept.put(ChunkId(1), n, &block(100, n as f32), &mut bench);
        }
        let get = |chunk, number| {
            let mut found = vec![];
            kept.get(ChunkId(chunk), [number].into_iter(), &mut found);
            found.pop().unwrap()
        };
        assert_eq!(get(1, 0).unwrap().of_chunk, 200);
        kept.put(ChunkId(2), 1, &block(100, 9.0), &mut bench);
        assert_eq!(kept.bytes(), 3 * one);
        let there = [(1, 0), (1, 1), (1, 2), (2, 1)].map(|(c, n)| get(c, n).is_some());
        assert_eq!(there, [true, false, true, true]);
        // What is larger than all is not kept, nothing is where nothing may be.
        kept.put(ChunkId(3), 0, &block(1000, 0.0), &mut bench);
        assert!(get(3, 0).is_none() && kept.bytes() == 3 * one);
        let none = Kept::new(0);
        none.put(ChunkId(1), 0, &block(100, 0.0), &mut bench);
        let mut found = vec![];
        none.get(ChunkId(1), 0..2, &mut found);
        assert!(found.iter().all(Option::is_none) && found.len() == 2 && none.bytes() == 0);
    }
}
