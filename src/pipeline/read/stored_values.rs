//! Blocks of values that are stored: their bytes, and their ranges.

use super::damaged::damaged;
use super::step_view::StepView;
use crate::archive::chunked::{BlockRange, ChunkSegment, decode_value_ranges};
use crate::archive::values::{KnownOfBlock, ValueBlocks, decode_values, needs_before};
use isospan_io::error::Result;
use isospan_io::grid::ChunkId;
use std::sync::Arc;

/// Blocks of a chunk behind those of its values: their ranges, and its summary.
const BLOCKS_BEHIND_VALUES: u64 = 2;

/// A block of a chunk's values.
#[derive(Clone, Copy)]
pub(super) struct BlockAt<'a> {
    pub(super) block: usize,
    pub(super) blocks: &'a ValueBlocks,
}

/// Values of a block that are known already.
#[derive(Clone, Copy)]
pub(super) struct KnownValues<'a> {
    /// Position in the manifest of the step that they are of.
    pub(super) step: usize,
    pub(super) values: &'a [f32],
}

impl StepView {
    /// Appends the values of a block at the step at a position in the manifest, and returns the
    /// bytes that they take. `known`: the same values at a step before.
    pub(super) fn stored_block(
        &self,
        step: usize,
        id: ChunkId,
        at: BlockAt<'_>,
        known: Option<KnownValues<'_>>,
        out: &mut Vec<f32>,
    ) -> Result<u64> {
        self.value_block(step, id, at)?.decode(known, out)
    }

    /// The bytes of a block of values at the step at a position in the manifest.
    pub(super) fn value_block<'a>(
        &'a self,
        step: usize,
        id: ChunkId,
        at: BlockAt<'a>,
    ) -> Result<StoredBlock<'a>> {
        let (segment, mut bytes) = (self.values_of(step, id)?, vec![]);
        expect_values(&segment, id, at.blocks)?;
        segment.block(id, at.block as u64, &mut bytes)?;
        let base = self.manifest.base_of(step).filter(|_| needs_before(&bytes));
        Ok(StoredBlock { archive: self, segment, id, at, bytes, base })
    }

    /// The ranges of the value blocks of a chunk that are stored, rounded outwards, with a number
    /// that is 0 where all are void. None of a moment between two steps.
    pub(in crate::pipeline) fn value_ranges(
        &self,
        id: ChunkId,
        blocks: &ValueBlocks,
    ) -> Result<Option<Vec<BlockRange>>> {
        if self.is_between() {
            return Ok(None);
        }
        let segment = self.values_of(self.position(), id)?;
        let decode = |bytes: &[u8]| decode_value_ranges(bytes, blocks.count());
        segment.block_from_end(id, BLOCKS_BEHIND_VALUES - 1, decode).map(Some)
    }
}

/// A block of values that was read, and not decoded yet.
pub(super) struct StoredBlock<'a> {
    archive: &'a StepView,
    segment: Arc<ChunkSegment>,
    id: ChunkId,
    at: BlockAt<'a>,
    bytes: Vec<u8>,
    /// Position of the step to which it holds differences.
    pub(super) base: Option<usize>,
}

impl StoredBlock<'_> {
    /// Appends its values, and returns the bytes that were read for them.
    pub(super) fn decode(&self, known: Option<KnownValues<'_>>, out: &mut Vec<f32>) -> Result<u64> {
        let Self { archive, segment, id, at, bytes, base } = self;
        let (mut found, mut read) = (vec![], 0);
        let before = match (base, known) {
            (Some(base), Some(known)) if known.step == *base => known.values,
            (Some(base), _) => {
                read = archive.stored_block(*base, *id, *at, known, &mut found)?;
                &found
            }
            (None, _) => &[],
        };
        let known = KnownOfBlock { n: at.blocks.range(at.block).len(), before };
        decode_values(bytes, &known, out).map_err(|m| segment.blame(*id, at.block as u64, m))?;
        Ok(read + bytes.len() as u64)
    }
}

/// Whether a chunk has as many blocks of values as its vertices ask for.
pub(super) fn expect_values(segment: &ChunkSegment, id: ChunkId, expected: &ValueBlocks) -> Result<()> {
    let count = segment.block_count(id);
    if count == expected.count() as u64 + BLOCKS_BEHIND_VALUES {
        return Ok(());
    }
    Err(damaged(segment, id, "chunk table", &format!("{count} blocks")))
}
