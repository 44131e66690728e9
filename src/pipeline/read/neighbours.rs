//! Values of a lattice's chunk that are not stored with it: those of nodes around, and those of
//! points that other chunks own.
//!
//! ```text
//!       ┌───────┬───────┐
//!       │ chunk h · · · │   h  points at its far ends: the chunks after it own them
//!       └─h─h─h─┼ · · · │
//!         · · · │ · · · │
//!         · · · ┴───────┘
//! ```

use super::damaged::damaged;
use super::node_values::NodeCache;
use super::recent::RecentBlock;
use super::step_view::StepView;
use super::stored_values::{BlockAt, KnownValues};
use crate::archive::chunked::{BlockRange, ValueRange};
use crate::archive::values::ValueBlocks;
use crate::error::Result;
use crate::grid::ChunkId;
use crate::mesh::bcc::BccChunk;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Range;
use std::sync::Arc;

/// What has been read of the chunks around one that is read.
#[derive(Default)]
pub(in crate::pipeline) struct Neighbours {
    pub(super) nodes: NodeCache,
    chunks: HashMap<ChunkId, Arc<Owner>>,
    /// Values of blocks, by step, chunk and block.
    blocks: HashMap<(usize, ChunkId, usize), Arc<[f32]>>,
    /// The step that was read last.
    step: usize,
    /// The ranges of the blocks that chunks have stored, at the step of the archive.
    ranges: HashMap<ChunkId, Arc<[BlockRange]>>,
}

/// A chunk, and how its values are cut into blocks.
struct Owner {
    bcc: BccChunk,
    blocks: ValueBlocks,
}

impl Neighbours {
    /// Appends the values of points of a chunk at the step at a position in the manifest, and
    /// returns the bytes read.
    pub(super) fn values(
        &mut self,
        archive: &StepView,
        step: usize,
        chunk: ChunkId,
        points: Range<usize>,
        out: &mut Vec<f32>,
    ) -> Result<u64> {
        if std::mem::replace(&mut self.step, step) != step {
            // Differences refer to the step before.
            self.blocks.retain(|key, _| key.0 == step || key.0 + 1 == step);
        }
        let own = self.chunk(archive, chunk)?;
        let bcc = &own.bcc;
        let mut read = 0;
        // Points in a row are mostly in one brick.
        let (mut brick, mut home, mut owner) = ([u64::MAX; 3], chunk, Arc::clone(&own));
        let (mut block, mut values) = (None, Arc::default());
        for place in bcc.point_places(points) {
            let of_place = bcc.home(place);
            if brick != of_place {
                (brick, home) = (of_place, archive.chunks.of_brick(of_place));
                owner = self.chunk(archive, home)?;
            }
            let Some(number) = owner.bcc.own_number(place) else {
                let segment = archive.values_of(step, chunk)?;
                return Err(damaged(&segment, chunk, "points", "one that no chunk owns"));
            };
            let of_number = owner.blocks.of(number);
            if block != Some((home, of_number)) {
                block = Some((home, of_number));
                values = self.block(archive, step, home, (&owner, of_number), &mut read)?;
            }
            out.push(values[number - owner.blocks.range(of_number).start]);
        }
        Ok(read)
    }

    /// A range that holds the values of points of a chunk: that of the blocks that are stored of
    /// them. Any value may be at a point that no stored block has.
    pub(super) fn range(
        &mut self,
        archive: &StepView,
        chunk: ChunkId,
        points: Range<usize>,
    ) -> Result<ValueRange> {
        let own = self.chunk(archive, chunk)?;
        let [mut lo, mut hi] = [f32::INFINITY, f32::NEG_INFINITY];
        // Points in a row are mostly in one brick.
        let (mut brick, mut home, mut owner) = ([u64::MAX; 3], chunk, Arc::clone(&own));
        for place in own.bcc.point_places(points) {
            let of_place = own.bcc.home(place);
            if brick != of_place {
                (brick, home) = (of_place, archive.chunks.of_brick(of_place));
                owner = self.chunk(archive, home)?;
            }
            let ranges = match self.ranges.entry(home) {
                Entry::Occupied(found) => found.into_mut(),
                Entry::Vacant(empty) => {
                    let ranges = archive.value_ranges(home, &owner.blocks)?;
                    empty.insert(ranges.unwrap_or_default().into())
                }
            };
            let block = owner.bcc.own_number(place).map(|number| owner.blocks.of(number));
            let Some(range) = block.and_then(|block| ranges.get(block)) else {
                return Ok([f32::NEG_INFINITY, f32::INFINITY]);
            };
            (lo, hi) = (lo.min(range.min), hi.max(range.max));
        }
        Ok([lo, hi])
    }

    /// The values of a block of a chunk; adds the bytes that were read.
    fn block(
        &mut self,
        archive: &StepView,
        step: usize,
        chunk: ChunkId,
        (owner, block): (&Owner, usize),
        read: &mut u64,
    ) -> Result<Arc<[f32]>> {
        if let Some(values) = self.blocks.get(&(step, chunk, block)) {
            return Ok(Arc::clone(values));
        }
        let before = step.checked_sub(1).and_then(|step| {
            let values = self.blocks.get(&(step, chunk, block))?;
            Some(KnownValues { step, values })
        });
        let found = archive.recent.values.get((step, chunk, block as u64), || {
            let (mut found, at) = (vec![], BlockAt { block, blocks: &owner.blocks });
            let bytes = archive.stored_block(step, chunk, at, before, &mut found)?;
            Ok(RecentBlock { bytes, values: found.into() })
        })?;
        *read += found.bytes;
        self.blocks.insert((step, chunk, block), Arc::clone(&found.values));
        Ok(found.values)
    }

    fn chunk(&mut self, archive: &StepView, id: ChunkId) -> Result<Arc<Owner>> {
        match self.chunks.entry(id) {
            Entry::Occupied(found) => Ok(Arc::clone(found.get())),
            Entry::Vacant(place) => {
                let Some(bcc) = archive.bcc_chunk(id) else {
                    let segment = archive.values_of(archive.position(), id)?;
                    return Err(damaged(&segment, id, "values", "fewer than those of its points"));
                };
                let blocks = archive.value_blocks(id, bcc.points());
                Ok(Arc::clone(place.insert(Arc::new(Owner { bcc, blocks }))))
            }
        }
    }
}
