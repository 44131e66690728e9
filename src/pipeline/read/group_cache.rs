//! Blocks of files that several bricks share: read once, also for neighbouring chunks.

use crate::error::Result;
use crate::grid::ChunkId;
use std::collections::HashMap;
use std::collections::hash_map::Entry;

/// Bytes of such blocks, about, at most.
const MOST_CACHED: usize = 1 << 20;

/// A block: the hash of the contents of its file, its chunk, and its number there.
pub(super) type GroupKey = (u64, ChunkId, u64);

/// The bytes of blocks.
#[derive(Default)]
pub(super) struct GroupCache {
    groups: HashMap<GroupKey, Vec<u8>>,
    bytes: usize,
}

impl GroupCache {
    /// A block, which `read` reads unless it is there.
    pub(super) fn get(&mut self, key: GroupKey, read: impl FnOnce() -> Result<Vec<u8>>) -> Result<&[u8]> {
        if self.bytes > MOST_CACHED {
            *self = Self::default();
        }
        match self.groups.entry(key) {
            Entry::Occupied(found) => Ok(found.into_mut()),
            Entry::Vacant(place) => {
                let bytes = read()?;
                self.bytes += bytes.len();
                Ok(place.insert(bytes))
            }
        }
    }
}
