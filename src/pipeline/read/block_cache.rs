//! The cache of decoded blocks, in bounded memory. Their edges are numbered
//! (`surface/extract/numbered`), so that a surface looks nothing up.
//!
//! Eviction follows the clock algorithm (Corbató 1968): the hand skips a block once if it was used
//! since the hand last passed.

use super::block::{Block, NumberedShape};
use crate::surface::extract::Workbench;
use isospan_io::exec::will_read;
use isospan_io::grid::ChunkId;
use rustc_hash::FxHashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

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
    block: Arc<NumberedShape>,
    /// Whether it was used since the hand came by.
    used: bool,
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
        out: &mut Vec<Option<Arc<NumberedShape>>>,
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
            Some(Arc::clone(&slot.block))
        }));
    }

    /// Caches a block, and drops others to make room.
    pub(in crate::pipeline) fn put(&self, chunk: ChunkId, number: u32, block: &Block, bench: &mut Workbench) {
        if self.most == 0 {
            return;
        }
        let Some(block) = NumberedShape::of(block, bench) else { return };
        let place = (chunk, number);
        let bytes = block.bytes();
        let mut blocks = self.blocks();
        // Another thread may have been faster.
        if bytes > self.most || blocks.by_place.contains_key(&place) {
            return;
        }
        while blocks.bytes + bytes > self.most {
            blocks.drop_one();
        }
        blocks.add(Slot { place, block: Arc::new(block), used: false });
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
    use crate::surface::extract::in_order;

    #[test]
    fn a_cached_block_is_the_block() {
        let (block, bench) = (block(200, 10.0), &mut Workbench::default());
        let mut unpacked = Block::default();
        NumberedShape::of(&block, bench).unwrap().unpack(&mut unpacked);
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
        assert!(NumberedShape::of(&self::block(257, 0.0), bench).is_none());
    }

    #[test]
    fn blocks_that_were_not_used_go() {
        let bench = &mut Workbench::default();
        let one = NumberedShape::of(&block(100, 0.0), bench).unwrap().bytes();
        let cache = BlockCache::new(3 * one + one / 2);
        for n in 0..3 {
            cache.put(ChunkId(1), n, &block(100, n as f32), bench);
        }
        let get = |chunk, number| {
            let mut found = vec![];
            cache.get(ChunkId(chunk), [number].into_iter(), &mut found);
            found.pop().unwrap()
        };
        assert!(get(1, 0).is_some());
        cache.put(ChunkId(2), 1, &block(100, 9.0), bench);
        assert_eq!(cache.bytes(), 3 * one);
        let there = [(1, 0), (1, 1), (1, 2), (2, 1)].map(|(c, n)| get(c, n).is_some());
        assert_eq!(there, [true, false, true, true]);
        let bytes = cache.bytes();
        // Of too many corners.
        cache.put(ChunkId(3), 0, &block(1000, 0.0), bench);
        assert!(get(3, 0).is_none() && cache.bytes() == bytes);
        let small = BlockCache::new(one - 1);
        small.put(ChunkId(1), 0, &block(100, 0.0), bench);
        assert_eq!(small.bytes(), 0, "it is larger than the cache");
        let none = BlockCache::new(0);
        none.put(ChunkId(1), 0, &block(100, 0.0), bench);
        let mut found = vec![];
        none.get(ChunkId(1), 0..2, &mut found);
        assert!(found.iter().all(Option::is_none) && found.len() == 2 && none.bytes() == 0);
    }
}
