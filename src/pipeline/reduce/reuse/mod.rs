//! Reuses unchanged chunks from one try of a search to the next.
//!
//! A round of a search makes some cells denser, and the rest stays as it is. The contents of a
//! chunk follow from the points in its region and from the samples there. Nothing else of the plan
//! matters, as long as chunks are cut and points ordered as before. So the next plan keeps a
//! [`PlanFrame`] of the one before, and each chunk is compared:
//!
//! ```text
//!  levels ─▶ frame ─▶ plan ─▶ for each chunk: the same levels wherever its mesh reached (core, halo, all retries)?
//!                                  ├─ yes ─▶ blocks of mesh and values are copied from the try before
//!                                  └─ no ──▶ meshed, fitted, measured, encoded
//! ```
//!
//! The result is that of a plain run of the last plan, byte for byte. The frame is given up, and
//! all chunks made again, when the points have become so many that bricks or chunks would be too
//! large. Whether they have does not depend on memory or threads.

use super::encoded::EncodedChunk;
use super::sums::StoredSums;
use crate::archive::manifest::{FrameRecord, MeshPlan, StepPlan};
use crate::density::Choice;
use crate::pipeline::plan::{Halo, MeshParts, Plan, PlanFrame, estimate};
use crate::pipeline::read::{StepView, limits};
use crate::pipeline::stage::StageTimes;
use isospan_io::error::Result;
use isospan_io::grid::{Chunk, ChunkId};
use isospan_mesh::points::{PointSet, PointSpec};
use std::ops::Range;
use std::sync::Arc;

/// A brick's edge of more than this many times the one that the points ask for is too long: a brick
/// would have four times as many points as it should.
const LONGEST_BRICK: f64 = 1.6;

/// A round of a search, after the first.
pub(in crate::pipeline) struct Round {
    /// The wanted density of points.
    pub(super) choice: Choice,
    /// What the plan has from that of the try before.
    pub(super) frame: Option<PlanFrame>,
    /// That try.
    pub(super) before: StepView,
}

impl Round {
    pub(super) fn new(choice: Choice, before: StepView) -> Result<Self> {
        let frame = PlanFrame::of(&before, &choice)?;
        Ok(Self { choice, frame, before })
    }
}

impl PlanFrame {
    /// The frame of an archive, for other levels of its points; `None` where their bricks or chunks
    /// would be too large.
    fn of(before: &StepView, choice: &Choice) -> Result<Option<Self>> {
        let (plan, levels) = (&before.manifest.plan, Arc::new(choice.levels.clone()));
        let spec = PointSpec::Halton { n: choice.n };
        if plan.points != spec || plan.lattice != levels.cells().lattice {
            return Ok(None);
        }
        let asked = Plan::brick_edge(plan, &levels);
        let is_long = |(now, asked): (u64, u64)| now as f64 > LONGEST_BRICK * asked as f64;
        if plan.brick_edge.into_iter().zip(asked).any(is_long) {
            return Ok(None);
        }
        let points = PointSet::graded(spec, plan.lattice, levels)?;
        let count = move |b: &_| points.count_in(b);
        let (chunks, target) = (&before.chunks, plan.chunk_target);
        let largest = chunks.iter().map(|c| before.points.count_in(&c.core)).max().unwrap_or(0);
        let most = largest.max(target.saturating_mul(2));
        let cuts = chunks.cuts().refined(plan.bricks(), target, most, count);
        Ok(cuts.map(|cuts| Self {
            brick_edge: plan.brick_edge,
            order_bits: plan.order_bits,
            record: FrameRecord { site_bits: before.points.order_bits(), cuts },
        }))
    }
}

/// The chunks of a try that are those of the one before.
pub(super) struct ReusedChunks<'a> {
    before: &'a StepView,
    /// Of each chunk, which one.
    from: Vec<Option<ChunkId>>,
}

impl<'a> ReusedChunks<'a> {
    /// Compares all chunks, for the steps of the plan up to `steps`; `None` where the plans differ
    /// in more than levels. Memory: 16 bytes a chunk.
    pub(super) fn new(
        before: &'a StepView,
        plan: &Plan,
        parts: &MeshParts,
        steps: usize,
    ) -> Result<Option<Self>> {
        let same_mesh = is_alike(&before.manifest.plan, &plan.mesh)
            && before.points.order_bits() == parts.points.order_bits()
            && limits(&before.manifest.plan, before.points.len()) == limits(&plan.mesh, parts.points.len());
        let made = before.manifest.steps.iter().map(|s| &s.plan);
        let same_steps =
            made.len() >= steps && made.zip(&plan.steps[..steps]).all(|(a, b)| is_alike_step(a, b));
        if !same_mesh || !same_steps {
            return Ok(None);
        }
        let mut from = vec![];
        for chunk in parts.chunks.iter() {
            from.push(match before.chunks.find(chunk.brick_lo, chunk.brick_hi) {
                Some(id) if is_same(before, id, parts, &chunk)? => Some(id),
                _ => None,
            });
        }
        before.close_before(ChunkId(u64::MAX));
        Ok(Some(Self { before, from }))
    }

    /// The number of chunks that are reused.
    pub(super) fn count(&self) -> u64 {
        self.from.iter().flatten().count() as u64
    }

    /// The blocks of a chunk to write, if it is reused: those of its mesh, where that is wanted,
    /// and the values of some steps.
    pub(super) fn encoded(
        &self,
        chunk: ChunkId,
        mesh: bool,
        steps: &Range<usize>,
    ) -> Result<Option<EncodedChunk>> {
        let Some(id) = self.from[chunk.0 as usize] else { return Ok(None) };
        let segment = self.before.mesh_of(id)?;
        let points = u64::from(segment.mesh_summary(id)?.sizes.core);
        let mesh_blocks = if mesh { segment.blocks(id)? } else { vec![] };
        let values = |step| self.before.values_of(step, id)?.blocks(id);
        let value_blocks = steps.clone().map(values).collect::<Result<_>>()?;
        let sum_blocks = steps.clone().map(|step| self.sums(step, id)).collect::<Result<_>>()?;
        Ok(Some(EncodedChunk { points, mesh_blocks, value_blocks, sum_blocks, times: StageTimes::default() }))
    }

    /// What a chunk adds to the sums of a step.
    fn sums(&self, step: usize, id: ChunkId) -> Result<Vec<Vec<u8>>> {
        let (plan, segment) = (&self.before.manifest.steps[step].plan, self.before.layout.segment_of(id));
        let hash = plan.hash(self.before.manifest.plan_hash);
        StoredSums::open(&self.before.layout, segment, plan, hash)?.blocks(id)
    }

    /// Notes that no chunk before this one will be asked for again.
    pub(super) fn pass(&self, chunk: ChunkId) {
        if let Some(id) = self.from[chunk.0 as usize] {
            self.before.close_before(id);
        }
    }
}

/// Whether plans differ in levels and cuts alone.
fn is_alike(a: &MeshPlan, b: &MeshPlan) -> bool {
    let bare = |plan: &MeshPlan| MeshPlan { levels: None, frame: None, ..plan.clone() };
    a.levels.is_some() && b.levels.is_some() && bare(a) == bare(b)
}

/// Whether the values of steps are the same on the same mesh. The hash of a base covers the mesh
/// too, and the base is compared by itself.
fn is_alike_step(a: &StepPlan, b: &StepPlan) -> bool {
    let bare = |plan: &StepPlan| StepPlan { base: None, ..plan.clone() };
    a.base.map(|base| base.number) == b.base.map(|base| base.number) && bare(a) == bare(b)
}

/// Whether a chunk has the points of chunk `id` before in all its region, and the same region.
fn is_same(before: &StepView, id: ChunkId, parts: &MeshParts, chunk: &Chunk) -> Result<bool> {
    let (Some(old), Some(new)) = (before.points.levels(), parts.points.levels()) else { return Ok(false) };
    if before.points.spacing_around(&chunk.core) != parts.points.spacing_around(&chunk.core) {
        return Ok(false);
    }
    before.close_before(id);
    let retries = before.mesh_sizes(id)?.retries;
    let (plan, domain) = (&before.manifest.plan, parts.chunks.bricks().lattice.domain());
    let region = estimate::region(&parts.points, &chunk.core, &domain, Halo::of(plan), retries);
    Ok(new.same_in(old, &region))
}

#[cfg(test)]
mod tests;
