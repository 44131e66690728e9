//! The files of a segment while they are made: the mesh, and the values of each step.

use super::encode::Product;
use super::workers::{StageTimes, Work};
use crate::archive::chunked::ChunkSegmentWriter;
use crate::archive::manifest::StepPlan;
use crate::archive::publish::Left;
use crate::archive::segment::{PlanHash, SegmentKind};
use crate::error::Result;
use crate::grid::ChunkId;
use crate::pipeline::plan::{Layout, Watch};
use crate::pipeline::read::{Depth, SegmentState, inspect};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Done means that all files are there, belong to this plan, and verify; not that they exist.
pub(super) fn is_done(work: &Work<'_>, segment: u64) -> bool {
    let chunks = work.layout.chunks_of(segment);
    Part::all(work).all(|part| part.is_whole(work, segment, &chunks))
}

/// What writers that run, or were killed, have left of an archive.
pub(super) fn left(layout: &Layout) -> Left {
    Left::in_folders(&[layout.mesh_folder(), layout.steps_folder()])
}

/// Whether the mesh of some segments is there.
pub(super) fn has_mesh(hash: PlanHash, layout: &Layout, segments: &Range<u64>) -> bool {
    let whole = |n| is_whole(&layout.mesh(n), SegmentKind::Mesh, hash, &layout.chunks_of(n));
    segments.clone().all(whole)
}

/// Whether the values of a step in some segments are there.
pub(super) fn has_values(plan: &StepPlan, hash: PlanHash, layout: &Layout, segments: &Range<u64>) -> bool {
    let layout = layout.at(plan.number);
    let whole = |n| is_whole(&layout.values(n), SegmentKind::Values, hash, &layout.chunks_of(n));
    segments.clone().all(whole)
}

fn is_whole(path: &Path, kind: SegmentKind, hash: PlanHash, chunks: &Range<u64>) -> bool {
    inspect(path, kind, hash, chunks, Depth::All) == SegmentState::Whole
}

/// One of the files of a segment that are made: the mesh, where it is not there yet, and the values of each step.
#[derive(Clone, Copy)]
enum Part {
    Mesh,
    Values(usize),
}

impl Part {
    fn all<'a>(work: &'a Work<'_>) -> impl Iterator<Item = Self> + use<'a> {
        let mesh = work.stored.is_none().then_some(Self::Mesh);
        mesh.into_iter().chain((0..work.steps.len()).map(Self::Values))
    }

    fn path(self, work: &Work<'_>, segment: u64) -> PathBuf {
        match self {
            Self::Mesh => work.layout.mesh(segment),
            Self::Values(n) => work.layout.at(work.steps[n].plan.number).values(segment),
        }
    }

    fn kind(self, work: &Work<'_>) -> (SegmentKind, PlanHash) {
        match self {
            Self::Mesh => (SegmentKind::Mesh, work.mesh_hash),
            Self::Values(n) => (SegmentKind::Values, work.steps[n].hash),
        }
    }

    fn is_whole(self, work: &Work<'_>, segment: u64, chunks: &Range<u64>) -> bool {
        let (kind, hash) = self.kind(work);
        is_whole(&self.path(work, segment), kind, hash, chunks)
    }

    /// A writer that goes on behind at most `most` chunks, where writers may have `left` some; `None` when the file is whole already: a run was
    /// killed between two of them.
    fn resume(
        self,
        work: &Work<'_>,
        segment: u64,
        chunks: &Range<u64>,
        most: u64,
        left: bool,
    ) -> Result<Option<ChunkSegmentWriter>> {
        if self.is_whole(work, segment, chunks) {
            return Ok(None);
        }
        let (kind, hash) = self.kind(work);
        let (path, first) = (self.path(work, segment), ChunkId(chunks.start));
        // One of a chunk is published as soon as it is written: there is nothing to go on with, and no need of a journal.
        let several = chunks.end - chunks.start > 1;
        match (left, several) {
            (false, journal) => ChunkSegmentWriter::begin(path, kind, hash, first, journal),
            (true, false) => ChunkSegmentWriter::create(path, kind, hash, first),
            (true, true) => ChunkSegmentWriter::resume(path, kind, hash, first, most),
        }
        .map(Some)
    }

    /// The blocks that a product has for the file.
    fn blocks(self, product: &Product) -> &[Vec<u8>] {
        match self {
            Self::Mesh => &product.mesh_blocks,
            Self::Values(n) => &product.value_blocks[n],
        }
    }
}

/// The files of a segment being written; none in place of one that is there.
pub(super) struct Sink {
    files: Vec<(Part, Option<ChunkSegmentWriter>)>,
    times: StageTimes,
}

impl Sink {
    /// Goes on behind the chunks that an earlier run has left in all files; also tells how many these are. `left`: what they have left.
    pub(super) fn resume(
        work: &Work<'_>,
        segment: u64,
        chunks: &Range<u64>,
        left: &Left,
    ) -> Result<(Self, u64)> {
        let all = chunks.end - chunks.start;
        let count = |w: &Option<ChunkSegmentWriter>| w.as_ref().map_or(all, ChunkSegmentWriter::chunk_count);
        let open = |part: Part| {
            Ok((part, part.resume(work, segment, chunks, all, left.has(&part.path(work, segment)))?))
        };
        let mut files: Vec<(Part, Option<ChunkSegmentWriter>)> =
            Part::all(work).map(open).collect::<Result<_>>()?;
        // Of a file that is whole nothing is written again; the others need all chunks behind their last common one.
        let done = files.iter().map(|(_, w)| count(w)).min().unwrap_or(all);
        for (part, writer) in &mut files {
            if writer.is_some() && count(writer) > done {
                *writer = None;
                *writer = part.resume(work, segment, chunks, done, true)?;
            }
        }
        Ok((Self { files, times: StageTimes::default() }, done))
    }

    pub(super) fn write(&mut self, product: &Product) -> Result<()> {
        let start = Instant::now();
        for (part, writer) in &mut self.files {
            if let Some(writer) = writer {
                writer.push_chunk(part.blocks(product))?;
            }
        }
        self.times.add(&product.times);
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
