//! The cache of decoded blocks, in bounded memory.
//!
//! ```text
//!  archive ──▶ Block (a reused buffer) ──▶ numbered ──▶ on the next use: precomputed
//! ```
//!
//! Precomputing a block ([`crate::surface::precomputed`]) takes as long as ten surfaces of its
//! numbered form. So it waits until the block is used again, and is spread out: at the first
//! repeated use one block is due, at the second the next one, and so on. No question then takes
//! much longer than others. The precomputed form is more than twice as large; a block stays
//! numbered where there is no room for it.
//!
//! Eviction follows the clock algorithm (Corbató 1968): the hand skips a block once if it was used
//! since the hand last passed.

use super::block::{Block, BlockCorners, NumberedShape};
use crate::exec::will_read;
use crate::grid::ChunkId;
use crate::surface::extract::{Precomputed, PrecomputedBlock, Unpacked, Workbench};
use rustc_hash::FxHashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A block in the cache.
#[derive(Debug)]
pub(in crate::pipeline) enum CachedBlock {
    /// As it was read, its edges numbered.
    Numbered(NumberedShape),
    /// Precomputed for the surface of any isovalue, and the number of corners of its chunk.
    Precomputed(PrecomputedBlock, usize),
}

impl CachedBlock {
    fn bytes(&self) -> usize {
        match self {
            Self::Numbered(block) => size_of::<Self>() + block.bytes(),
            Self::Precomputed(block, _) => size_of::<Self>() + block.bytes(),
        }
    }

    /// The block as it was read, its corners maybe in another order.
    pub(in crate::pipeline) fn unpack(&self, out: &mut Block) {
        let (block, of_corners) = match self {
            Self::Numbered(block) => return block.unpack(out),
            Self::Precomputed(block, of_corners) => (block, *of_corners),
        };
        unpack_precomputed(block.view(), of_corners, out);
    }

    /// Prefetches what is read in any case.
    pub(in crate::pipeline) fn will_be_read(&self) {
        match self {
            Self::Numbered(block) => block.numbered.will_be_read(),
            Self::Precomputed(block, _) => block.view().corners_will_be_read(),
        }
    }

    /// Prefetches the rest.
    pub(in crate::pipeline) fn rest_will_be_read(&self, isovalues: &[f32]) {
        if let Self::Precomputed(block, _) = self {
            block.view().tets_will_be_read(isovalues);
        }
    }
}

/// A precomputed block as it was read, its corners maybe in another order; its chunk has
/// `of_corners` corners.
pub(in crate::pipeline) fn unpack_precomputed(block: Precomputed<'_>, of_corners: usize, out: &mut Block) {
    let Block { corners, tets, bytes } = out;
    let BlockCorners { numbers, positions, ids, values, shared, of_chunk } = corners;
    block.unpack(&mut Unpacked { numbers, positions, ids, values, shared, tets });
    (*of_chunk, *bytes) = (of_corners, 0);
}

/// A cached block that was asked for.
#[derive(Debug)]
pub(in crate::pipeline) struct CacheHit {
    pub(in crate::pipeline) block: Arc<CachedBlock>,
    /// Whether it is to be precomputed now, if it is not yet.
    pub(in crate::pipeline) is_due: bool,
}

/// A block is precomputed at most this many uses after the first one; some are after fewer.
const DUE: u32 = 8;

/// Decoded blocks, up to a number of bytes; from any thread.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct BlockCache {
    most: usize,
    blocks: Mutex<CachedBlocks>,
}

type BlockKey = (ChunkId, u32);

#[derive(Debug, Default)]
struct CachedBlocks {
    /// Where in `slots` each is.
    by_place: FxHashMap<BlockKey, usize>,
    slots: Vec<Slot>,
    /// The slot at which the next search for room begins.
    hand: usize,
    bytes: usize,
}

#[derive(Debug)]
struct Slot {
    place: BlockKey,
    block: Arc<CachedBlock>,
    /// Whether it was used since the hand came by.
    used: bool,
    /// How often it was used since it was read, at most [`DUE`].
    uses: u32,
}

impl BlockCache {
    /// Caches up to about `most` bytes.
    pub(super) fn new(most: usize) -> Self {
        Self { most, blocks: Mutex::default() }
    }

    fn blocks(&self) -> MutexGuard<'_, CachedBlocks> {
        self.blocks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The most bytes that are cached.
    pub(in crate::pipeline) fn most(&self) -> usize {
        self.most
    }

    /// Replaces `out` by the blocks of a chunk, those that are cached.
    pub(in crate::pipeline) fn get(
        &self,
        chunk: ChunkId,
        numbers: impl Iterator<Item = u32>,
        out: &mut Vec<Option<CacheHit>>,
    ) {
        out.clear();
        if self.most == 0 {
            return out.extend(numbers.map(|_| None));
        }
        let mut blocks = self.blocks();
        let CachedBlocks { by_place, slots, .. } = &mut *blocks;
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
            slot.uses = DUE.min(slot.uses + 1);
            Some(CacheHit { block: Arc::clone(&slot.block), is_due: slot.uses > slot.place.1 % DUE })
        }));
    }

    /// Caches a block, and drops others to make room.
    pub(in crate::pipeline) fn put(&self, chunk: ChunkId, number: u32, block: &Block, bench: &mut Workbench) {
        if self.most == 0 {
            return;
        }
        let Some(numbered) = NumberedShape::of(block, bench) else { return };
        let (block, place) = (CachedBlock::Numbered(numbered), (chunk, number));
        let bytes = block.bytes();
        let mut blocks = self.blocks();
        // Another thread may have been faster.
        if bytes > self.most || blocks.by_place.contains_key(&place) {
            return;
        }
        while blocks.bytes + bytes > self.most {
            blocks.drop_one();
        }
        blocks.add(Slot { place, block: Arc::new(block), used: false, uses: 0 });
    }

    /// Caches a block in another form, if it is still there and there is room: others are worth
    /// more than this.
    pub(in crate::pipeline) fn replace(&self, chunk: ChunkId, number: u32, block: CachedBlock) {
        let mut blocks = self.blocks();
        let CachedBlocks { by_place, slots, bytes, .. } = &mut *blocks;
        let Some(slot) = by_place.get(&(chunk, number)).map(|&slot| &mut slots[slot]) else { return };
        let after = *bytes - slot.block.bytes() + block.bytes();
        if after <= self.most {
            (*bytes, slot.block) = (after, Arc::new(block));
        }
    }

    /// Bytes that the blocks take.
    pub(in crate::pipeline) fn bytes(&self) -> usize {
        self.blocks().bytes
    }
}

impl CachedBlocks {
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
    use super::super::block::tests::block;
    use super::*;
    use crate::geom::Lattice;
    use crate::grid::Geometry;
    use crate::surface::WorldMap;
    use crate::surface::extract::{Workbench, in_order};

    fn precomputed(Block { corners, tets, .. }: &Block) -> Option<CachedBlock> {
        let world = WorldMap::new(&Lattice::new([9; 3]).unwrap(), &Geometry::default());
        let block = Workbench::default().precompute(&corners.cells(tets), &world)?;
        Some(CachedBlock::Precomputed(block, corners.of_chunk))
    }

    #[test]
    fn a_cached_block_is_the_block() {
        let block = block(200, 10.0);
        let mut unpacked = Block::default();
        precomputed(&block).unwrap().unpack(&mut unpacked);
        let all = |Block { corners: c, tets, .. }: &Block| -> Vec<_> {
            let corner = |v: u32| {
                let v = v as usize;
                (c.numbers[v], c.positions[v], c.ids[v], c.values[v].to_bits(), c.shared[v])
            };
            tets.iter().map(|t| in_order(&c.ids, t).map(corner)).collect()
        };
        assert_eq!(all(&unpacked), all(&block));
        assert_eq!(unpacked.corners.of_chunk, block.corners.of_chunk);
        assert!(unpacked.corners.ids.is_sorted());
        assert!(precomputed(&self::block(257, 0.0)).is_none());
    }

    #[test]
    fn blocks_that_were_not_used_go() {
        let bench = &mut Workbench::default();
        let one = CachedBlock::Numbered(NumberedShape::of(&block(100, 0.0), bench).unwrap()).bytes();
        let cache = BlockCache::new(3 * one + one / 2);
        for n in 0..3 {
            cache.put(ChunkId(1), n, &block(100, n as f32), bench);
        }
        let get = |chunk, number| {
            let mut found = vec![];
            cache.get(ChunkId(chunk), [number].into_iter(), &mut found);
            found.pop().unwrap().map(|found: CacheHit| found.block)
        };
        assert!(get(1, 0).is_some());
        cache.put(ChunkId(2), 1, &block(100, 9.0), bench);
        assert_eq!(cache.bytes(), 3 * one);
        let there = [(1, 0), (1, 1), (1, 2), (2, 1)].map(|(c, n)| get(c, n).is_some());
        assert_eq!(there, [true, false, true, true]);
        // In another form where there is room, and where it is cached.
        cache.replace(ChunkId(1), 0, precomputed(&block(100, 0.0)).unwrap());
        assert!(matches!(&*get(1, 0).unwrap(), CachedBlock::Numbered(_)), "it is larger");
        cache.replace(ChunkId(1), 0, precomputed(&block(10, 0.0)).unwrap());
        assert!(matches!(&*get(1, 0).unwrap(), CachedBlock::Precomputed(_, 20)) && cache.bytes() < 3 * one);
        cache.replace(ChunkId(1), 1, precomputed(&block(10, 0.0)).unwrap());
        assert!(get(1, 1).is_none());
        cache.put(ChunkId(9), 9, &block(10, 0.0), bench);
        let bytes = cache.bytes();
        // Of too many corners.
        cache.put(ChunkId(3), 0, &block(1000, 0.0), bench);
        assert!(get(3, 0).is_none() && cache.bytes() == bytes);
        let small = BlockCache::new(one - 1);
        small.put(ChunkId(1), 0, &block(100, 0.0), bench);
        assert_eq!(small.bytes(), 0, "it is larger than the cache");
        // Block 3 is due when it is used for the fourth time, and from then on.
        let (cache, mut found) = (BlockCache::new(1 << 20), vec![]);
        cache.put(ChunkId(1), 3, &block(10, 0.0), bench);
        let mut is_due = || {
            cache.get(ChunkId(1), [3].into_iter(), &mut found);
            found[0].as_ref().unwrap().is_due
        };
        assert!((0..20).map(|_| is_due()).eq((0..20).map(|n| n >= 3)));
        let none = BlockCache::new(0);
        none.put(ChunkId(1), 0, &block(100, 0.0), bench);
        let mut found = vec![];
        none.get(ChunkId(1), 0..2, &mut found);
        assert!(found.iter().all(Option::is_none) && found.len() == 2 && none.bytes() == 0);
    }
}
