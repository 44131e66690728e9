//! Blocks of values that several chunks need: what was read of them last, from any thread.
//!
//! ```text
//!  chunk A ── needs a brick of chunk B ──▶ read, decoded ──▶ Recent ──▶ chunk B, when it is read
//! ```
//!
//! Chunks are read in order, so a block is mostly needed again soon. The blocks that came first are
//! dropped first, half of the memory at a time.

use crate::error::Result;
use crate::grid::ChunkId;
use rustc_hash::FxHashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes of the blocks of one kind, about, at most.
const MOST_BYTES: usize = 4 << 20;

/// A block: the position of its step in the manifest, its chunk, and its number there.
pub(super) type BlockKey = (usize, ChunkId, u64);

/// A block that was read.
pub(super) struct RecentBlock<T> {
    /// Bytes that were read for it.
    pub(super) bytes: u64,
    pub(super) values: Arc<[T]>,
}

impl<T> Clone for RecentBlock<T> {
    fn clone(&self) -> Self {
        Self { bytes: self.bytes, values: Arc::clone(&self.values) }
    }
}

/// Blocks of one kind.
pub(super) struct Recent<T>(Mutex<Generations<T>>);

/// The blocks of late, and those before them.
struct Generations<T> {
    late: FxHashMap<BlockKey, RecentBlock<T>>,
    before: FxHashMap<BlockKey, RecentBlock<T>>,
    late_bytes: usize,
}

impl<T> Default for Recent<T> {
    fn default() -> Self {
        let (late, before) = Default::default();
        Self(Mutex::new(Generations { late, before, late_bytes: 0 }))
    }
}

impl<T> Recent<T> {
    /// A block, if it is still there.
    pub(super) fn find(&self, key: &BlockKey) -> Option<RecentBlock<T>> {
        let blocks = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        blocks.late.get(key).or_else(|| blocks.before.get(key)).cloned()
    }

    /// A block; `read` reads it unless it is there. Two threads may read the same one.
    pub(super) fn get(
        &self,
        key: BlockKey,
        read: impl FnOnce() -> Result<RecentBlock<T>>,
    ) -> Result<RecentBlock<T>> {
        if let Some(found) = self.find(&key) {
            return Ok(found);
        }
        let block = read()?;
        let mut blocks = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if blocks.late_bytes > MOST_BYTES / 2 {
            blocks.before = std::mem::take(&mut blocks.late);
            blocks.late_bytes = 0;
        }
        blocks.late_bytes += size_of_val(&*block.values) + size_of::<(BlockKey, RecentBlock<T>)>();
        blocks.late.insert(key, block.clone());
        Ok(block)
    }
}

/// The blocks of a view that several chunks need.
#[derive(Default)]
pub(super) struct RecentBlocks {
    /// Blocks of files that several bricks share, as they are stored.
    pub(super) shared: Recent<u8>,
    /// Values of a chunk's points that chunks before it have at their far ends.
    pub(super) values: Recent<f32>,
    /// Values of nodes, in parts of a step.
    pub(super) nodes: Recent<i32>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    fn block(values: usize) -> Result<RecentBlock<u8>> {
        Ok(RecentBlock { bytes: 7, values: vec![1; values].into() })
    }

    fn unread() -> Result<RecentBlock<u8>> {
        Err(Error::Cancelled)
    }

    #[test]
    fn a_block_is_read_once_while_it_is_recent() {
        let recent = Recent::default();
        let key = |number| (0, ChunkId(3), number);
        assert!(recent.find(&key(0)).is_none());
        assert!(recent.get(key(0), unread).is_err());
        recent.get(key(0), || block(1000)).unwrap();
        let again = recent.get(key(0), unread).unwrap();
        assert_eq!((again.bytes, again.values.len()), (7, 1000));
        for other in [(1, ChunkId(3), 0), (0, ChunkId(4), 0), (0, ChunkId(3), 1)] {
            assert!(recent.get(other, unread).is_err());
        }
    }

    #[test]
    fn the_first_blocks_go_first() {
        let recent = Recent::default();
        let (size, count) = (100_000, 200);
        for number in 0..count {
            recent.get((0, ChunkId(0), number), || block(size)).unwrap();
        }
        let there = |number| recent.find(&(0, ChunkId(0), number)).is_some();
        let first = (0..count).find(|&number| there(number)).unwrap();
        assert!((first..count).all(there), "all after the first that is there");
        let bytes = (count - first) as usize * size;
        assert!((MOST_BYTES / 2..MOST_BYTES + 2 * size).contains(&bytes), "{bytes}");
    }
}
