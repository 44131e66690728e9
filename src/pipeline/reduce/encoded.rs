//! What one chunk becomes on disk.

use crate::pipeline::stage::StageTimes;

/// A chunk ready to be written.
pub(super) struct EncodedChunk {
    pub(super) points: u64,
    /// Empty where the mesh is there already.
    pub(super) mesh_blocks: Vec<Vec<u8>>,
    /// The value blocks of each step.
    pub(super) value_blocks: Vec<Vec<Vec<u8>>>,
    /// What it adds to the sums of each step.
    pub(super) sum_blocks: Vec<Vec<Vec<u8>>>,
    pub(super) times: StageTimes,
}
