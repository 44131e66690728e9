//! Which level of a pyramid a question is asked of.

use super::pyramid::{chunk_place, pyramid_of};
use super::step_view::StepView;
use crate::archive::chunked::ChunkSegment;
use crate::archive::manifest::CorrectionRecord;
use crate::pipeline::settings::Bound;
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;
use isospan_wavelet::Pyramid;
use std::ops::Range;

/// Which level of a pyramid answers a question.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LevelChoice {
    /// The one of this number: 0 is the finest, each further one has half as many nodes along each
    /// axis that is split.
    Level(u32),
    /// The finest one whose surfaces have at most so many triangles, those of all isovalues
    /// together, before components are chosen and triangles decimated.
    Triangles(u64),
    /// The coarsest one whose RMS error is at most this, as it was measured when the archive was
    /// made. A part is one of the range of the samples.
    Error(Bound),
}

impl LevelChoice {
    /// The flag of the command line.
    pub(in crate::pipeline) fn flag(self) -> &'static str {
        match self {
            Self::Level(_) => "`level`",
            Self::Triangles(_) => "`triangles`",
            Self::Error(_) => "`error`",
        }
    }
}

impl StepView {
    /// The level of a question that has no surface; the finest one where none is chosen.
    ///
    /// # Errors
    /// [`Error::Usage`] for an archive without levels, for a level that is not there, for an error
    /// that no level has, and for a number of triangles.
    pub(in crate::pipeline) fn level(&self, choice: Option<LevelChoice>) -> Result<usize> {
        let Some(choice) = choice else { return Ok(0) };
        let coarsest = self.coarsest_level(choice)?;
        if let LevelChoice::Level(level) = choice {
            self.expect_level_of_labels(level as usize)?;
        }
        match choice {
            LevelChoice::Level(level) => match usize::try_from(level).ok().filter(|l| *l <= coarsest) {
                Some(level) => Ok(level),
                None => Err(Error::usage(format!(
                    "{} has no level {level}: it has levels 0 (the finest) to {coarsest}",
                    self.path().display()
                ))),
            },
            LevelChoice::Triangles(_) => Err(Error::usage(
                "`triangles` chooses a level by its surfaces, and here is none: give `level` or `error`",
            )),
            LevelChoice::Error(bound) => self.level_of_error(bound),
        }
    }

    /// The coarsest level.
    ///
    /// # Errors
    /// [`Error::Usage`] for an archive without levels, from which a level is chosen.
    pub(in crate::pipeline) fn coarsest_level(&self, choice: LevelChoice) -> Result<usize> {
        let pyramid = pyramid_of(self.manifest.plan.points);
        pyramid.map(|pyramid| pyramid.coarsest()).ok_or_else(|| {
            Error::usage(format!(
                "{} is no pyramid: it has no levels, from which {} chooses one",
                self.path().display(),
                choice.flag()
            ))
        })
    }

    /// The coarsest level with an error of at most so much.
    fn level_of_error(&self, bound: Bound) -> Result<usize> {
        let step = self.step();
        let refuse = |why: String| Err(Error::usage(format!("{}: {why}", self.path().display())));
        if self.is_between() {
            return refuse(
                "`error`: errors are those of steps, and this is a moment between two: give `level`".into(),
            );
        }
        let (Some(error), Some(wavelet)) = (&step.error, step.plan.wavelet) else {
            return refuse(
                "`error`: no error was measured when the archive was made: give `level`, or reduce without `measure=false`"
                    .into(),
            );
        };
        if step.level_rms.len() != pyramid_of(self.manifest.plan.points).map_or(0, |p| p.coarsest()) {
            return refuse(
                "`error`: an earlier version made the archive, without errors of levels: give `level`, or reduce again"
                    .into(),
            );
        }
        let most = bound.in_units(wavelet.range);
        let errors = || std::iter::once(error.rms).chain(step.level_rms.iter().copied()).enumerate();
        if let Some((level, _)) = errors().filter(|(_, rms)| *rms <= most).last() {
            return Ok(level);
        }
        let least = errors().reduce(|a, b| if b.1 < a.1 { b } else { a });
        let (level, rms) = least.unwrap_or_default();
        refuse(format!("no level has an RMS error of at most {most}: the least is {rms}, of level {level}"))
    }

    /// The RMS error of a level of a pyramid, where it was measured.
    pub(super) fn level_rms(&self, level: usize) -> Option<f64> {
        let step = self.step();
        match level.checked_sub(1) {
            None => step.error.as_ref().map(|e| e.rms),
            Some(n) => step.level_rms.get(n).copied(),
        }
    }

    /// The bytes that are read for all nodes of each level: its tiles, those of coarser levels, and
    /// those of the steps that these may refer to. None where that takes the directories of many
    /// segments.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged archive.
    pub(super) fn level_bytes(&self, pyramid: &Pyramid) -> Result<Option<Vec<u64>>> {
        if self.layout.segment_count() > MOST_SEGMENTS {
            return Ok(None);
        }
        let chain = || std::iter::successors(Some(self.position()), |step| self.manifest.base_of(*step));
        let coarse = chain().filter_map(|step| self.manifest.step_at(step).coarse);
        let mut bytes = vec![coarse.map(|file| file.bytes).sum::<u64>(); pyramid.coarsest() + 1];
        let wavelet = self.step().plan.wavelet;
        let is_corrected = wavelet.is_some_and(|w| w.correction != CorrectionRecord::None);
        for id in (0..self.chunks.len()).map(ChunkId) {
            for step in chain() {
                let file = self.values_of(step, id)?;
                let found = lengths(&file, id, 0..file.block_count(id))?;
                for (block, length) in pyramid.blocks(chunk_place(pyramid, id)).iter().zip(found) {
                    bytes[..block.level.max(1)].iter_mut().for_each(|sum| *sum += length);
                }
            }
            if is_corrected {
                let file = self.ranges_of(id)?;
                bytes[0] += lengths(&file, id, 0..file.block_count(id).min(1))?.iter().sum::<u64>();
            }
        }
        Ok(Some(bytes))
    }
}

/// Segments of an archive whose levels' bytes are told, at most.
const MOST_SEGMENTS: u64 = 64;

/// Bytes of some blocks of a chunk.
fn lengths(file: &ChunkSegment, id: ChunkId, blocks: Range<u64>) -> Result<Vec<u64>> {
    blocks.map(|n| file.segment().block_len(file.block_number(id, n))).collect()
}
