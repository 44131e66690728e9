//! Blocks of values that are stored: their bytes, which several bricks may share, and their ranges.

use super::damaged::damaged;
use super::recent::RecentBlock;
use super::step_view::StepView;
use crate::archive::chunked::{BlockRange, ChunkSegment, decode_value_ranges};
use crate::archive::values::{BrickGroups, KnownOfBlock, ValueBlocks, decode_values, needs_before};
use crate::error::Result;
use crate::grid::ChunkId;

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
        let segment = self.values_of(step, id)?;
        let (mut bytes, mut found, mut read) = (vec![], vec![], 0);
        let number = self.stored_bytes(step, id, at, &mut bytes)?;
        let base = self.manifest.base_of(step).filter(|_| needs_before(&bytes));
        let before = match (base, known) {
            (Some(base), Some(known)) if known.step == base => known.values,
            (Some(base), _) => {
                read = self.stored_block(base, id, at, known, &mut found)?;
                &found
            }
            (None, _) => &[],
        };
        let (n, cells) = (at.blocks.range(at.block).len(), at.blocks.cells(at.block));
        let quantiser = self.manifest.step_at(step).plan.quantiser.as_ref();
        let known = KnownOfBlock { n, cells, quantiser, before };
        decode_values(&bytes, &known, out).map_err(|m| segment.blame(id, number, m))?;
        Ok(read + bytes.len() as u64)
    }

    /// Finds the bytes of a block of values, and returns the number in its chunk of the file's
    /// block that has them.
    pub(super) fn stored_bytes(
        &self,
        step: usize,
        id: ChunkId,
        at: BlockAt<'_>,
        out: &mut Vec<u8>,
    ) -> Result<u64> {
        let segment = self.values_of(step, id)?;
        let groups = self.brick_groups(&segment, id, at.blocks)?;
        let number = groups.stored_block(at.block);
        if !groups.is_shared(at.block) {
            return segment.block(id, number, out).map(|()| number);
        }
        let shared = self.recent.shared.get((step, id, number), || {
            let mut bytes = vec![];
            segment.block(id, number, &mut bytes)?;
            Ok(RecentBlock { bytes: bytes.len() as u64, values: bytes.into() })
        })?;
        let own = groups.part(at.block, &shared.values).map_err(|m| segment.blame(id, number, m))?;
        out.clear();
        out.extend_from_slice(&shared.values[own]);
        Ok(number)
    }

    /// How the bricks of a chunk share blocks of its file.
    pub(super) fn brick_groups(
        &self,
        segment: &ChunkSegment,
        id: ChunkId,
        blocks: &ValueBlocks,
    ) -> Result<BrickGroups> {
        let count = segment.block_count(id);
        let stored = count.checked_sub(BLOCKS_BEHIND_VALUES);
        let groups = stored.and_then(|stored| BrickGroups::of(blocks, stored));
        groups.ok_or_else(|| damaged(segment, id, "chunk table", &format!("{count} blocks")))
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
        let decode = |bytes: &[u8]| decode_value_ranges(bytes, blocks.stored_count());
        segment.block_from_end(id, BLOCKS_BEHIND_VALUES - 1, decode).map(Some)
    }
}
