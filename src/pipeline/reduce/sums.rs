//! What chunks add to sums over all of them: errors, and parts of the spectrum.
//!
//! ```text
//!  chunk ─▶ values-000000.seg        stays
//!        ╲▶ sums-000000.seg ─▶ all chunks added up ─▶ spectrum.seg, error in the manifest ─▶ removed
//! ```
//!
//! They are files of their own, next to those of the values, so that workers make them, and runs
//! that were killed go on. A finished step has its sums, and needs the parts no more.

use crate::archive::chunked::ChunkSegment;
use crate::archive::manifest::{Manifest, StepPlan, StoredStep};
use crate::archive::segment::{PlanHash, Segment, SegmentKind};
use crate::archive::tables::{ChunkErrors, decode_errors};
use crate::measure::{BrickErrors, ErrorSums, FieldError, LevelError};
use crate::pipeline::chunk::field_error_of;
use crate::pipeline::plan::{Layout, Plan};
use crate::pipeline::read::{StepView, pyramid_of};
use crate::spectrum::{ChunkPart, Digits, Limits};
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;

/// The sums of some chunks of a step.
pub(super) struct StoredSums {
    segment: ChunkSegment,
    measured: bool,
}

impl StoredSums {
    /// Those in a segment of a step of this hash.
    pub(super) fn open(layout: &Layout, segment: u64, step: &StepPlan, hash: PlanHash) -> Result<Self> {
        let path = layout.at(step.number).sums(segment);
        let segment = ChunkSegment::open(path, SegmentKind::Sums, Some(hash))?;
        Ok(Self { segment, measured: step.measured })
    }

    /// All blocks of a chunk.
    pub(super) fn blocks(&self, chunk: ChunkId) -> Result<Vec<Vec<u8>>> {
        self.segment.blocks(chunk)
    }

    /// The errors of a chunk, of a step that is measured.
    pub(super) fn errors(&self, chunk: ChunkId) -> Result<ChunkErrors> {
        let behind = self.segment.block_count(chunk).saturating_sub(1);
        self.segment.block_from_end(chunk, behind, decode_errors)
    }

    /// The part of a chunk of the spectrum.
    pub(super) fn part(&self, chunk: ChunkId, limits: Limits) -> Result<ChunkPart> {
        let expected = 1 + u64::from(self.measured);
        if self.segment.block_count(chunk) != expected {
            let (path, got) = (self.segment.segment().path(), self.segment.block_count(chunk));
            let at = format!("chunk {}, blocks", chunk.0);
            return Err(Error::bad_input(path, at, expected.to_string(), got.to_string()));
        }
        self.segment.block_from_end(chunk, 0, |bytes| ChunkPart::decode(bytes, limits, Digits::All))
    }
}

/// The error of the archive's step, and those in the cells of each level, or of each level of a
/// pyramid from 1 on, added up from what its chunks have stored.
pub(super) fn summed_error(archive: &StepView) -> Result<(FieldError, Vec<LevelError>)> {
    let pyramid = pyramid_of(archive.manifest.plan.points);
    let levels = match &pyramid {
        Some(pyramid) => pyramid.coarsest(),
        None => archive.points.levels().map_or(0, |levels| usize::from(levels.top()) + 1),
    };
    let (mut sums, mut by_level) = (ErrorSums::default(), vec![BrickErrors::default(); levels]);
    let (layout, plan) = (&archive.layout, &archive.step().plan);
    for number in 0..layout.segment_count() {
        let stored = StoredSums::open(layout, number, plan, archive.step_hash())?;
        for chunk in layout.chunks_of(number).map(ChunkId) {
            let found = stored.errors(chunk)?;
            let in_levels = found.levels.iter().map(|level| u128::from(level.samples)).sum::<u128>();
            // Cells have one level each; a level of a pyramid has all samples up to its last node.
            let is_sorted = match (&pyramid, levels) {
                (None, 1..) => in_levels == u128::from(found.sums.measured),
                _ => true,
            };
            if found.levels.len() > levels || !is_sorted {
                let (path, got) = (layout.sums(number), found.levels.len().to_string());
                let at = format!("chunk {}, levels of its errors", chunk.0);
                return Err(Error::bad_input(path, at, format!("those of {levels} levels"), got));
            }
            sums.merge(&found.sums);
            by_level.iter_mut().zip(&found.levels).for_each(|(all, part)| all.merge(part));
        }
    }
    let level_error = |e: &BrickErrors| LevelError {
        samples: e.samples,
        rms: if e.samples == 0 { 0.0 } else { e.rms() },
        max: e.max,
    };
    let rounding = plan.source.rounding;
    let level_error = |e: &BrickErrors| level_error(e).with_rounding(rounding);
    Ok((field_error_of(archive, &sums)?, by_level.iter().map(level_error).collect()))
}

/// Steps of a plan that an archive has, with their sums: its manifest and the spectra are there.
pub(in crate::pipeline) struct FinishedSteps {
    steps: Vec<StoredStep>,
    /// Whether chunks add to a spectrum.
    has_parts: bool,
}

impl FinishedSteps {
    /// Those in the folder of a layout.
    pub(in crate::pipeline) fn of(layout: &Layout, plan: &Plan) -> Self {
        let steps = Manifest::read(layout.root()).map_or(vec![], |manifest| manifest.steps);
        let is_of_plan = |step: &StoredStep| {
            let found = plan.steps.iter().position(|planned| planned.number == step.plan.number);
            found.is_some_and(|n| plan.step_hash(n) == step.plan.hash(plan.mesh_hash()))
        };
        let has_spectrum = |step: &StoredStep| {
            let Some(recorded) = &step.spectrum else { return true };
            let hash = step.plan.hash(plan.mesh_hash());
            let path = layout.at(step.plan.number).spectrum();
            let found = Segment::open(path, SegmentKind::Spectrum, Some(hash));
            found.is_ok_and(|file| file.info() == *recorded && file.verify().is_ok())
        };
        let has_error = |step: &StoredStep| step.error.is_some() || !step.plan.measured;
        let finished = |step: &StoredStep| is_of_plan(step) && has_error(step) && has_spectrum(step);
        let has_parts = !plan.mesh.is_pyramid();
        Self { steps: steps.into_iter().filter(finished).collect(), has_parts }
    }

    /// The step of a number.
    pub(in crate::pipeline) fn get(&self, number: u64) -> Option<&StoredStep> {
        self.steps.iter().find(|step| step.plan.number == number)
    }

    /// Whether a step of the plan waits for the sums of its chunks.
    pub(in crate::pipeline) fn needs_sums(&self, step: &StepPlan) -> bool {
        (step.measured || self.has_parts) && self.get(step.number).is_none()
    }
}
