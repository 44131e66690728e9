//! The files of a segment while they are made: the mesh, and the values and sums of each step.

use super::encoded::EncodedChunk;
use super::sums::FinishedSteps;
use crate::archive::chunked::ChunkSegmentWriter;
use crate::archive::manifest::StepPlan;
use crate::archive::segment::{PlanHash, SegmentKind};
use crate::pipeline::plan::{Layout, Plan, Watch};
use crate::pipeline::read::{Depth, SegmentState, inspect};
use crate::pipeline::stage::StageTimes;
use isospan_io::bytes::publish::Left;
use isospan_io::error::Result;
use isospan_io::grid::ChunkId;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The files of segments that are made: the mesh, where it is not there yet, and the values of
/// steps.
pub(super) struct SegmentFiles<'a> {
    layout: &'a Layout,
    parts: Vec<SegmentFile>,
    steps: u64,
}

impl<'a> SegmentFiles<'a> {
    /// The files of some steps of a plan.
    pub(super) fn new(
        plan: &Plan,
        steps: &Range<usize>,
        with_mesh: bool,
        layout: &'a Layout,
        finished: &FinishedSteps,
    ) -> Self {
        let mesh = with_mesh.then(|| SegmentFile::Mesh(plan.mesh_hash()));
        let of_step = |(n, step): (usize, usize)| {
            let file = (plan.steps[step].number, plan.step_hash(step));
            let sums = finished.needs_sums(&plan.steps[step]).then_some(SegmentFile::Sums(n, file));
            std::iter::once(SegmentFile::Values(n, file)).chain(sums)
        };
        let parts = mesh.into_iter().chain(steps.clone().enumerate().flat_map(of_step)).collect();
        Self { layout, parts, steps: steps.len() as u64 }
    }

    /// The files of the details of a step of a pyramid.
    pub(super) fn of_details(number: u64, hash: PlanHash, layout: &'a Layout) -> Self {
        let file = (number, hash);
        Self { layout, parts: vec![SegmentFile::Values(0, file), SegmentFile::Low(file)], steps: 1 }
    }

    /// The file of the labels of a step.
    pub(super) fn of_labels(number: u64, hash: PlanHash, layout: &'a Layout) -> Self {
        Self { layout, parts: vec![SegmentFile::Values(0, (number, hash))], steps: 1 }
    }

    /// The files of the ranges of a step of a pyramid.
    pub(super) fn of_ranges(number: u64, hash: PlanHash, with_sums: bool, layout: &'a Layout) -> Self {
        let file = (number, hash);
        let sums = with_sums.then_some(SegmentFile::Sums(0, file));
        let parts = std::iter::once(SegmentFile::Ranges(file)).chain(sums).collect();
        Self { layout, parts, steps: 1 }
    }

    pub(super) fn chunks_of(&self, segment: u64) -> Range<u64> {
        self.layout.chunks_of(segment)
    }

    /// How many steps there are.
    pub(super) fn steps(&self) -> u64 {
        self.steps
    }

    /// Done means that all files are there, belong to this plan, and verify; not that they exist.
    pub(super) fn is_done(&self, segment: u64) -> bool {
        let chunks = self.chunks_of(segment);
        self.parts.iter().all(|part| part.is_whole(self, segment, &chunks))
    }

    /// What writers that run, or were killed, have left of the archive.
    pub(super) fn left(&self) -> Left {
        Left::in_folders(&[self.layout.mesh_folder(), self.layout.steps_folder()])
    }
}

/// Whether the mesh of some segments is there.
pub(super) fn has_mesh(hash: PlanHash, layout: &Layout, segments: &Range<u64>) -> bool {
    let whole = |n| is_whole(&layout.mesh(n), SegmentKind::Mesh, hash, &layout.chunks_of(n));
    segments.clone().all(whole)
}

/// Whether the values of a step in some segments are there, and the sums that it needs.
pub(super) fn has_values(
    plan: &StepPlan,
    hash: PlanHash,
    layout: &Layout,
    segments: &Range<u64>,
    finished: &FinishedSteps,
) -> bool {
    let layout = layout.at(plan.number);
    let needs_sums = finished.needs_sums(plan);
    let whole = |n| {
        let chunks = layout.chunks_of(n);
        is_whole(&layout.values(n), SegmentKind::Values, hash, &chunks)
            && (!needs_sums || is_whole(&layout.sums(n), SegmentKind::Sums, hash, &chunks))
    };
    segments.clone().all(whole)
}

/// Whether a segment of some chunks is there, is that of a plan, and verifies.
pub(super) fn is_whole(path: &Path, kind: SegmentKind, hash: PlanHash, chunks: &Range<u64>) -> bool {
    inspect(path, kind, hash, chunks, Depth::All) == SegmentState::Whole
}

/// One of the files of a segment.
#[derive(Clone, Copy)]
enum SegmentFile {
    /// The mesh, with its hash.
    Mesh(PlanHash),
    /// The values of a step: which of the pass, its number and hash.
    Values(usize, (u64, PlanHash)),
    /// What chunks add to its sums.
    Sums(usize, (u64, PlanHash)),
    /// The low coefficients of a step of a pyramid.
    Low((u64, PlanHash)),
    /// Its ranges and corrections.
    Ranges((u64, PlanHash)),
}

impl SegmentFile {
    fn path(self, files: &SegmentFiles<'_>, segment: u64) -> PathBuf {
        match self {
            Self::Mesh(_) => files.layout.mesh(segment),
            Self::Values(_, (number, _)) => files.layout.at(number).values(segment),
            Self::Sums(_, (number, _)) => files.layout.at(number).sums(segment),
            Self::Low((number, _)) => files.layout.at(number).low(segment),
            Self::Ranges((number, _)) => files.layout.at(number).ranges(segment),
        }
    }

    fn kind(self) -> (SegmentKind, PlanHash) {
        match self {
            Self::Mesh(hash) => (SegmentKind::Mesh, hash),
            Self::Values(_, (_, hash)) => (SegmentKind::Values, hash),
            Self::Sums(_, (_, hash)) => (SegmentKind::Sums, hash),
            Self::Low((_, hash)) => (SegmentKind::Low, hash),
            Self::Ranges((_, hash)) => (SegmentKind::Ranges, hash),
        }
    }

    fn is_whole(self, files: &SegmentFiles<'_>, segment: u64, chunks: &Range<u64>) -> bool {
        let (kind, hash) = self.kind();
        is_whole(&self.path(files, segment), kind, hash, chunks)
    }

    /// A writer that continues after at most `most` chunks, where writers may have `left` some.
    /// `None` when the file is complete already, because a run was killed between two files.
    fn resume(
        self,
        files: &SegmentFiles<'_>,
        segment: u64,
        chunks: &Range<u64>,
        most: u64,
        left: bool,
    ) -> Result<Option<ChunkSegmentWriter>> {
        if self.is_whole(files, segment, chunks) {
            return Ok(None);
        }
        let (kind, hash) = self.kind();
        let (path, first) = (self.path(files, segment), ChunkId(chunks.start));
        // One of a chunk is published as soon as it is written: there is nothing to go on with, and
        // no need of a journal.
        let several = chunks.end - chunks.start > 1;
        match (left, several) {
            (false, journal) => ChunkSegmentWriter::begin(path, kind, hash, first, journal),
            (true, false) => ChunkSegmentWriter::create(path, kind, hash, first),
            (true, true) => ChunkSegmentWriter::resume(path, kind, hash, first, most),
        }
        .map(Some)
    }

    /// The blocks of an encoded chunk for the file.
    fn blocks(self, encoded: &EncodedChunk) -> &[Vec<u8>] {
        match self {
            Self::Mesh(_) => &encoded.mesh_blocks,
            Self::Values(n, _) => &encoded.value_blocks[n],
            Self::Sums(n, _) => &encoded.sum_blocks[n],
            Self::Low(_) => &encoded.sum_blocks[0],
            Self::Ranges(_) => &encoded.value_blocks[0],
        }
    }
}

/// The files of a segment being written; `None` in place of a file that exists already.
pub(super) struct Sink {
    files: Vec<(SegmentFile, Option<ChunkSegmentWriter>)>,
    times: StageTimes,
}

impl Sink {
    /// Continues after the chunks that an earlier run has left in all files, and returns their
    /// number too. `left`: what they have left.
    pub(super) fn resume(
        files: &SegmentFiles<'_>,
        segment: u64,
        chunks: &Range<u64>,
        left: &Left,
    ) -> Result<(Self, u64)> {
        let all = chunks.end - chunks.start;
        let count = |w: &Option<ChunkSegmentWriter>| w.as_ref().map_or(all, ChunkSegmentWriter::chunk_count);
        let open = |part: SegmentFile| {
            Ok((part, part.resume(files, segment, chunks, all, left.has(&part.path(files, segment)))?))
        };
        let mut opened: Vec<(SegmentFile, Option<ChunkSegmentWriter>)> =
            files.parts.iter().copied().map(open).collect::<Result<_>>()?;
        // Nothing is written again to a complete file; the others need all chunks after their last
        // common one.
        let done = opened.iter().map(|(_, w)| count(w)).min().unwrap_or(all);
        for (part, writer) in &mut opened {
            if writer.is_some() && count(writer) > done {
                *writer = None;
                *writer = part.resume(files, segment, chunks, done, true)?;
            }
        }
        Ok((Self { files: opened, times: StageTimes::default() }, done))
    }

    pub(super) fn write(&mut self, encoded: &EncodedChunk) -> Result<()> {
        let start = Instant::now();
        for (part, writer) in &mut self.files {
            if let Some(writer) = writer {
                writer.push_chunk(part.blocks(encoded))?;
            }
        }
        self.times.add(&encoded.times);
        self.times.write += start.elapsed();
        Ok(())
    }

    /// Publishes the files; where the input has changed meanwhile, removes them.
    pub(super) fn finish(mut self, watch: &Watch) -> Result<StageTimes> {
        let start = Instant::now();
        if let Err(e) = watch.check() {
            let writers = self.files.into_iter().filter_map(|(_, writer)| writer);
            writers.for_each(ChunkSegmentWriter::discard);
            return Err(e);
        }
        for writer in self.files.into_iter().filter_map(|(_, writer)| writer) {
            writer.finish()?;
        }
        self.times.write += start.elapsed();
        Ok(self.times)
    }
}
