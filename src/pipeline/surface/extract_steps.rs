//! Extracts isosurfaces of several steps from an archive in one pass. The tetrahedra and positions,
//! which the steps share, are decoded once.
//!
//! ```text
//!  a chunk:  blocks that can hold an answer at any step ──▶ numbered, without values
//!            step after step: values of the blocks that can at that step ──▶ its surfaces
//! ```
//!
//! Values are put into the numbered blocks ([`crate::surface::numbered`]) in place; differences are
//! added to the values of the step before, which are still there. Each step has a weld of its own,
//! so each surface is, byte by byte, the one that a single extraction gives.
//!
//! A chunk at work needs memory for its blocks, and for its surfaces at all steps. So a pass takes
//! as many steps as fit into memory ([`Pass::next`]). Finished surfaces that exceed their share of
//! it wait in the scratch folder. Where there is a choice, a pass ends before a keyframe, so that
//! no values are decoded only for the differences to them.

use super::extract::{Extracted, SurfaceStorage, Weld};
use super::query::{Effort, FinishedSurfaces, Prepared, make};
use super::settings::SurfaceSettings;
use super::worker::{ChunkSurfaces, ChunkWorker, Question};
use crate::error::{Error, Result};
use crate::exec::{Clock, Progress, in_order};
use crate::grid::ChunkId;
use crate::index::Entry;
use crate::pipeline::plan::{SurfaceShares, estimate};
use crate::pipeline::read::{
    Block, BufferPool, Buffers, ChunkReader, NumberedShape, StepView, ValuesOverTime, bytes_per_vertex,
};
use crate::surface::TriMesh;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Steps that are extracted together, at most: what is done once for all of them is then a tenth of
/// the work.
pub(super) const MOST_STEPS: usize = 32;
/// Bytes of a numbered tetrahedron, with its part of its block.
const NUMBERED_TET: u64 = 40;
/// Bytes of the surface in a tetrahedron of a block that can hold an answer, about: 24 a triangle,
/// in one tetrahedron of three.
const SURFACE_IN_TET: u64 = 8;

/// Steps that are extracted together, and where surfaces are kept meanwhile.
pub(super) struct Pass<'a> {
    steps: Vec<Prepared<'a>>,
    scratch: PathBuf,
}

impl<'a> Pass<'a> {
    /// The first ones of some consecutive steps, as many as are extracted together.
    pub(super) fn next(views: &'a [StepView], settings: &SurfaceSettings, scratch: &Path) -> Result<Self> {
        let count = views.len().min(MOST_STEPS);
        let is_key = |n: &usize| {
            let next = views[0].manifest.steps.get(views[0].position() + n);
            next.is_none_or(|step| step.plan.base.is_none())
        };
        let count = (count / 2 + 1..=count).rev().find(is_key).unwrap_or(count);
        let mut steps = vec![];
        for view in &views[..count] {
            settings.resources.cancel.check()?;
            // Nothing of an unpacked step is decoded, so it is fastest alone.
            let is_alone = view.unpacked()?.is_some_and(|file| file.table().answers(&settings.kept(view)));
            if is_alone && !steps.is_empty() {
                break;
            }
            steps.push(Prepared::new(view, settings)?);
            if is_alone {
                break;
            }
        }
        while steps.len() > 1 && !Work::of(settings, &steps).fits(settings, scratch) {
            steps.truncate(steps.len() / 2);
        }
        Ok(Self { steps, scratch: scratch.to_path_buf() })
    }

    /// The surfaces of each step. What was read for all of them is reported with the first. The
    /// memory of surfaces that are no longer needed is taken from `reused`.
    ///
    /// Where chunks share too many edges for several steps, fewer steps are taken. The number of
    /// results says how many.
    pub(super) fn extract(
        mut self,
        settings: &SurfaceSettings,
        reused: &mut Vec<Vec<TriMesh>>,
        progress: &dyn Progress,
    ) -> Result<Vec<FinishedSurfaces>> {
        let view = self.steps[0].view;
        while self.steps.len() > 1 {
            let (start, read_before) = (Clock::start(), view.bytes_read());
            let work = Work::of(settings, &self.steps);
            let surfaces = match work.extract(settings, &self.scratch, reused, progress) {
                Err(Error::Budget { .. }) => {
                    self.steps.truncate(self.steps.len() / 2);
                    continue;
                }
                surfaces => surfaces?,
            };
            let mut effort = Effort {
                bytes_read: view.bytes_read() - read_before,
                active_bytes: work.active_bytes.into_inner(),
                time: start.elapsed(),
            };
            let finish = |(step, surfaces): (&Prepared<'_>, _)| {
                step.finish(settings, surfaces, std::mem::take(&mut effort), &self.scratch)
            };
            return self.steps.iter().zip(surfaces).map(finish).collect();
        }
        let storage = SurfaceStorage { scratch: self.scratch, reused: reused.pop().unwrap_or_default() };
        // A view of its own, so that what is read of unpacked blocks is counted from the start.
        let alone = view.archive().step_at(view.position());
        Ok(vec![make(&alone, settings, storage, None, progress)?])
    }
}

/// What is asked of a chunk.
#[derive(Default)]
struct ChunkPart {
    /// The questions, and what each asks of it, by their numbers.
    asked: Vec<(usize, usize)>,
    /// The blocks of all questions, in order, each with a range that holds those at all steps.
    blocks: Vec<Entry>,
}

/// The questions of a pass, chunk by chunk.
struct Work<'a> {
    /// The first step, for all that the steps share.
    archive: &'a StepView,
    questions: Vec<Question<'a>>,
    chunks: Vec<(ChunkId, ChunkPart)>,
    active_bytes: AtomicU64,
}

impl<'a> Work<'a> {
    fn of(settings: &SurfaceSettings, steps: &'a [Prepared<'a>]) -> Self {
        let mut chunks: BTreeMap<ChunkId, ChunkPart> = BTreeMap::new();
        for (question, step) in steps.iter().enumerate() {
            for (number, work) in step.work.iter().enumerate() {
                let part = chunks.entry(work.chunk).or_default();
                part.asked.push((question, number));
                part.blocks.extend_from_slice(&work.blocks);
            }
        }
        chunks.values_mut().for_each(|part| join(&mut part.blocks));
        let questions = steps.iter().map(|step| step.question(settings)).collect();
        let archive = steps[0].view;
        Self { archive, questions, chunks: chunks.into_iter().collect(), active_bytes: AtomicU64::new(0) }
    }

    /// Whether memory suffices for all steps at one time; and disk, where their surfaces may exceed
    /// it.
    fn fits(&self, settings: &SurfaceSettings, scratch: &Path) -> bool {
        let Ok((shares, _)) = self.shares(settings.resources.memory) else { return false };
        let blocks = self
            .questions
            .iter()
            .flat_map(|q| q.work.iter().flat_map(move |w| &w.blocks).map(move |b| (q, b)));
        let tets: u64 = blocks.map(|(q, b)| u64::from(b.tets) * q.times_active(b)).sum();
        let surfaces = tets.saturating_mul(SURFACE_IN_TET);
        surfaces <= shares.finished || estimate::free_bytes(scratch).is_none_or(|free| surfaces <= free / 4)
    }

    /// How memory is shared out, and what each chunk needs of it.
    fn shares(&self, memory: u64) -> Result<(SurfaceShares, Vec<u64>)> {
        let bytes: Vec<u64> = self.chunks.iter().map(|(id, part)| self.need(*id, part)).collect();
        let entries = |q: &Question<'_>| q.work.iter().map(|w| w.blocks.len() as u64).sum::<u64>();
        let entries = self.questions.iter().map(entries).sum::<u64>()
            + self.chunks.iter().map(|c| c.1.blocks.len() as u64).sum::<u64>();
        let shares = SurfaceShares::of(memory, entries, bytes.iter().copied().max().unwrap_or(0))?;
        Ok((shares, bytes))
    }

    /// Bytes in which a chunk is extracted.
    fn need(&self, id: ChunkId, part: &ChunkPart) -> u64 {
        let tets = |blocks: &[Entry], question: Option<&Question<'_>>| -> u64 {
            let times = |b: &Entry| question.map_or(1, |q| q.times_active(b));
            blocks.iter().map(|b| u64::from(b.tets) * times(b)).sum()
        };
        let vertices = self.questions[0].vertices_near(id);
        let surface = |&(question, work): &(usize, usize)| {
            let question = &self.questions[question];
            let per_vertex = estimate::SURFACE_PER_VERTEX * question.isovalues.len() as u64;
            estimate::extraction_bytes(
                vertices,
                per_vertex,
                tets(&question.work[work].blocks, Some(question)),
            )
        };
        let shared = (vertices * bytes_per_vertex(self.archive))
            .saturating_add(tets(&part.blocks, None) * NUMBERED_TET);
        part.asked.iter().map(surface).fold(shared, u64::saturating_add)
    }

    /// The surfaces of each question.
    fn extract(
        &self,
        settings: &SurfaceSettings,
        scratch: &Path,
        reused: &mut Vec<Vec<TriMesh>>,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<Extracted>>> {
        let (shares, bytes) = self.shares(settings.resources.memory)?;
        let each = shares.of_each(self.questions.len() as u64);
        let weld = |question| {
            let storage =
                SurfaceStorage { scratch: scratch.to_path_buf(), reused: reused.pop().unwrap_or_default() };
            Weld::new(question, settings, each, storage, progress)
        };
        let mut welds: Vec<Weld<'_>> = self.questions.iter().map(weld).collect();
        let pool = self.archive.pools.lend(settings.resources.threads)?;
        let blocks = self.questions.iter().flat_map(|q| q.work).map(|w| w.blocks.len() as u64).sum();
        progress.begin("surface", blocks, "blocks");
        let spare = BufferPool::default();
        let extract = |n: usize| {
            settings.resources.cancel.check()?;
            self.chunk_surfaces(n, &spare)
        };
        in_order(&bytes, shares.batch, &pool, extract, |n, surfaces: Vec<ChunkSurfaces>| {
            let (id, part) = &self.chunks[n];
            self.archive.close_before(*id);
            let mut asked = part.asked.iter().zip(surfaces);
            asked.try_for_each(|(&(question, _), surfaces)| welds[question].push(surfaces, &spare))
        })?;
        welds.into_iter().map(Weld::finish).collect()
    }

    /// The surfaces of a chunk, of each question that is asked of it.
    fn chunk_surfaces(&self, n: usize, spare: &BufferPool) -> Result<Vec<ChunkSurfaces>> {
        let (id, part) = &self.chunks[n];
        let mut buffers = spare.buffers();
        let mut reader = ChunkReader::open(self.archive, *id, std::mem::take(&mut buffers.reader))?;
        reader.expect_all(part.blocks.iter().map(|b| b.block))?;
        let shapes = self.shapes(part, &mut reader, &mut buffers)?;
        let values = ValuesOverTime::new(self.archive, *id, reader.vertices());
        buffers.reader = reader.into_memory();
        let mut chunk = ShapedChunk { part, shapes, values, active_bytes: 0 };
        let surfaces = |&(question, work): &(usize, usize)| {
            let question = &self.questions[question];
            chunk.surfaces(question, &question.work[work].blocks, &mut buffers, spare)
        };
        let surfaces = part.asked.iter().map(surfaces).collect();
        self.active_bytes.fetch_add(chunk.active_bytes, Ordering::Relaxed);
        spare.give_buffers(buffers);
        surfaces
    }

    /// The blocks of a chunk, with `None` in place of one that is not wanted.
    fn shapes(
        &self,
        part: &ChunkPart,
        reader: &mut ChunkReader<'_>,
        Buffers { block, bench, .. }: &mut Buffers,
    ) -> Result<Vec<Option<Shape>>> {
        let shape = |entry: &Entry| {
            if !reader.shape(entry.block, &self.questions[0].wanted(entry), block)? {
                return Ok(None);
            }
            let (bytes, mut value_blocks) = (block.bytes, vec![]);
            let of = |&n: &u32| reader.value_blocks().of(n as usize) as u32;
            value_blocks.extend(block.corners.numbers.iter().map(of));
            value_blocks.dedup();
            value_blocks.sort_unstable();
            value_blocks.dedup();
            let corners = match NumberedShape::of(block, bench) {
                Some(shape) => ShapeCorners::Numbered(shape),
                None => ShapeCorners::Plain(Box::new(std::mem::take(block))),
            };
            Ok(Some(Shape { corners, value_blocks: value_blocks.into(), bytes }))
        };
        part.blocks.iter().map(shape).collect()
    }
}

/// Sorts blocks, and makes one of those with the same number.
fn join(blocks: &mut Vec<Entry>) {
    blocks.sort_unstable_by_key(Entry::place);
    blocks.dedup_by(|next, joined| {
        let same = next.place() == joined.place();
        if same {
            (joined.min, joined.max) = (joined.min.min(next.min), joined.max.max(next.max));
            joined.tets = joined.tets.max(next.tets);
        }
        same
    });
}

/// A block whose corners are given the values of one step after another.
struct Shape {
    corners: ShapeCorners,
    /// The blocks of values that have some of its corners.
    value_blocks: Box<[u32]>,
    /// Bytes that its tetrahedra took in the archive; 0 once they were counted.
    bytes: u64,
}

enum ShapeCorners {
    Numbered(NumberedShape),
    /// One with too many corners to be numbered, which is rare.
    Plain(Box<Block>),
}

/// A chunk whose blocks have been read.
struct ShapedChunk<'a> {
    part: &'a ChunkPart,
    shapes: Vec<Option<Shape>>,
    values: ValuesOverTime<'a>,
    active_bytes: u64,
}

impl ShapedChunk<'_> {
    /// The surfaces of a question in some of the blocks.
    fn surfaces(
        &mut self,
        question: &Question<'_>,
        blocks: &[Entry],
        buffers: &mut Buffers,
        spare: &BufferPool,
    ) -> Result<ChunkSurfaces> {
        let Self { part, shapes, values, active_bytes } = self;
        let mut worker = ChunkWorker::new(question, spare);
        let mut all = part.blocks.iter().zip(shapes);
        for entry in blocks {
            let (_, shape) = all
                .find(|(any, _)| any.block == entry.block)
                .expect("the blocks of a question are among those of all, in order");
            let Some(Shape { corners, value_blocks, bytes }) = shape else { continue };
            for &block in &**value_blocks {
                values.load(block as usize, question.archive.position())?;
            }
            let before = worker.active();
            match corners {
                ShapeCorners::Numbered(shape) => {
                    shape.numbered.set_values(values.values());
                    worker.add_shape(entry, shape, buffers);
                }
                ShapeCorners::Plain(block) => {
                    std::mem::swap(&mut **block, &mut buffers.block);
                    buffers.block.corners.take_values(values.values());
                    worker.add(entry, buffers, None);
                    std::mem::swap(&mut **block, &mut buffers.block);
                }
            }
            if worker.active() > before {
                *active_bytes += std::mem::take(bytes);
                *active_bytes +=
                    value_blocks.iter().map(|&block| values.take_bytes(block as usize)).sum::<u64>();
            }
        }
        Ok(worker.finish())
    }
}
