//! Extracts isosurfaces of one step, or of several that share a mesh, in one pass: each block is
//! decoded once, for any number of isovalues and steps.
//!
//! ```text
//!  a chunk: block after block, decoded ──▶ step after step: its values ──▶ its surfaces
//! ```
//!
//! Chunks are extracted in parallel, and welded in chunk order while others are extracted
//! ([`in_order`]). Blocks of a chunk are decoded one after another into the same small buffer, so
//! the memory of a chunk is that of its corners, of their values and of its surfaces, not of its
//! tetrahedra. For several steps the edges of a block are numbered once
//! (`surface/extract/numbered`).

use super::cubes::part_bytes;
use super::parts::Parts;
use super::question::{Cells, Question};
use super::settings::SurfaceSettings;
use super::weld::{Extracted, SurfaceStorage, Weld};
use super::worker::{ChunkSurfaces, ChunkWorker};
use crate::index::Entry;
use crate::pipeline::plan::{SurfaceShares, estimate};
use crate::pipeline::read::{
    BufferPool, Buffers, ChunkReader, CornerValues, NumberedShape, READER_PER_VERTEX, StepView,
};
use isospan_io::error::Result;
use isospan_io::exec::{Progress, in_order};
use isospan_io::grid::ChunkId;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes of the surface in a tetrahedron of a block that can hold an answer, about: 24 a triangle,
/// in one tetrahedron of three.
const SURFACE_IN_TET: u64 = 8;
/// Cached blocks that are looked up together, and held meanwhile.
const AT_ONCE: usize = 32;

/// What is asked of a chunk.
struct ChunkPart<'a> {
    chunk: ChunkId,
    /// The questions, and what each asks of it, by their numbers.
    asked: Vec<(usize, usize)>,
    /// The blocks of all questions, in order, each with a range that holds those of all.
    blocks: Cow<'a, [Entry]>,
    /// Of a pyramid, the cells of a part of the chunk.
    cells: Option<Cells>,
}

/// Questions about steps of one archive, that are answered together.
pub(super) struct Extraction<'a> {
    questions: &'a [Question<'a>],
    parts: Vec<ChunkPart<'a>>,
    /// Bytes of the blocks that hold an active tetrahedron, and of the values of their corners.
    active_bytes: AtomicU64,
}

impl<'a> Extraction<'a> {
    /// Some questions, at least one; of a pyramid one.
    pub(super) fn new(questions: &'a [Question<'a>]) -> Self {
        let parts = match questions {
            [one] => one.work.iter().enumerate().map(|(n, work)| ChunkPart {
                chunk: work.chunk,
                asked: vec![(0, n)],
                blocks: Cow::Borrowed(&*work.blocks),
                cells: work.cells,
            }),
            several => return Self { parts: join(several), questions, active_bytes: AtomicU64::new(0) },
        };
        Self { parts: parts.collect(), questions, active_bytes: AtomicU64::new(0) }
    }

    /// Whether memory suffices for all steps at one time; and disk, where their surfaces may exceed
    /// it.
    pub(super) fn fits(&self, memory: u64, scratch: &Path) -> bool {
        let Ok((shares, _)) = self.shares(memory) else { return false };
        let tets = |q: &Question<'_>| -> u64 {
            let blocks = q.work.iter().flat_map(|w| &w.blocks);
            blocks.map(|b| u64::from(b.tets) * q.times_active(b)).sum()
        };
        let surfaces = self.questions.iter().map(tets).sum::<u64>().saturating_mul(SURFACE_IN_TET);
        surfaces <= shares.finished || estimate::free_bytes(scratch).is_none_or(|free| surfaces <= free / 4)
    }

    /// How memory is shared out, and what each chunk needs of it.
    fn shares(&self, memory: u64) -> Result<(SurfaceShares, Vec<u64>)> {
        let bytes: Vec<u64> = self.parts.iter().map(|part| self.need(part)).collect();
        let joined = |part: &ChunkPart<'_>| match &part.blocks {
            Cow::Borrowed(_) => 0,
            Cow::Owned(blocks) => blocks.len() as u64,
        };
        let entries = self.blocks() + self.parts.iter().map(joined).sum::<u64>();
        let shares = SurfaceShares::of(memory, entries, bytes.iter().copied().max().unwrap_or(0))?;
        Ok((shares, bytes))
    }

    /// The blocks of all questions.
    fn blocks(&self) -> u64 {
        self.questions.iter().flat_map(|q| q.work).map(|work| work.blocks.len() as u64).sum()
    }

    /// Bytes in which a chunk is extracted: from the plan's target and the point set, without
    /// reading.
    fn need(&self, part: &ChunkPart<'_>) -> u64 {
        let first = &self.questions[0];
        if let Some(cells) = &part.cells {
            return part_bytes(cells, part.blocks.len() as u64, first.isovalues.len() as u64);
        }
        let vertices = first.vertices_near(part.chunk);
        let surfaces = part.asked.iter().map(|&(question, work)| {
            let question = &self.questions[question];
            question.surface_bytes(vertices, &question.work[work].blocks)
        });
        surfaces.fold(vertices * READER_PER_VERTEX, u64::saturating_add)
    }

    /// The surfaces of each question, in its storage. What is finished goes to `parts`, too, where
    /// there are some: of one question.
    pub(super) fn surfaces(
        &self,
        settings: &SurfaceSettings,
        storages: Vec<SurfaceStorage>,
        mut parts: Option<&mut Parts<'_>>,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<Extracted>>> {
        let (shares, bytes) = self.shares(settings.resources.memory)?;
        let each = shares.of_each(self.questions.len() as u64);
        let weld = |(question, storage)| Weld::new(question, settings, each, storage, progress);
        let mut welds: Vec<Weld<'_>> = self.questions.iter().zip(storages).map(weld).collect();
        let archive = self.questions[0].archive;
        let pool = archive.pools.lend(settings.resources.threads)?;
        progress.begin("surface", self.blocks(), "blocks");
        let (cache, of_this_question) = (&archive.cache, BufferPool::default());
        let spare = if cache.most() > 0 { &archive.spare } else { &of_this_question };
        let extract = |n: usize| {
            settings.resources.cancel.check()?;
            self.part_surfaces(&self.parts[n], spare)
        };
        in_order(&bytes, shares.batch, &pool, extract, |n, surfaces: Vec<ChunkSurfaces>| {
            let part = &self.parts[n];
            archive.close_before(part.chunk);
            let mut asked = part.asked.iter().zip(surfaces);
            asked.try_for_each(|(&(question, _), surfaces)| welds[question].push(surfaces, spare))?;
            // After the last chunk comes the surface of which others are previews.
            let has_more = n + 1 < self.parts.len();
            let parts = parts.as_mut().filter(|parts| has_more || !parts.are_previews());
            parts.map_or(Ok(()), |parts| welds[0].hand_on(parts, part.chunk.0 + 1))
        })?;
        if let Some(parts) = parts.filter(|parts| !parts.are_previews()) {
            welds[0].close()?;
            welds[0].hand_on(parts, archive.chunks.len())?;
        }
        archive.spare.trim(cache.most() / 4);
        welds.into_iter().map(Weld::finish).collect()
    }

    /// Bytes of the blocks that held an active tetrahedron, and of the values of their corners.
    pub(super) fn active_bytes(&self) -> u64 {
        self.active_bytes.load(Ordering::Relaxed)
    }

    /// The surfaces of a chunk, of each question that is asked of it; buffers come from `spare`
    /// where there are any.
    fn part_surfaces(&self, part: &ChunkPart<'_>, spare: &BufferPool) -> Result<Vec<ChunkSurfaces>> {
        let questions = part.asked.iter().map(|&(question, _)| &self.questions[question]);
        if let Some(cells) = &part.cells {
            return questions.map(|question| question.cube_surfaces(cells, spare)).collect();
        }
        let first = &self.questions[0];
        let mut steps: Vec<AskedStep<'_>> = part
            .asked
            .iter()
            .map(|&(question, work)| AskedStep::new(&self.questions[question], work, spare))
            .collect();
        let (mut buffers, mut open, mut cached, mut announced) = (spare.buffers(), None, vec![], 0);
        for (n, block) in part.blocks.iter().enumerate() {
            if n % AT_ONCE == 0 {
                let next = part.blocks[n..].iter().take(AT_ONCE).map(|b| b.block);
                first.archive.cache.get(part.chunk, next, &mut cached);
            }
            prefetch(&cached, n % AT_ONCE + 1);
            // Blocks are cached by a step that is asked alone.
            if let (Some(shape), [step]) = (&cached[n % AT_ONCE], &mut steps[..]) {
                step.worker.add_numbered(block, shape, &mut buffers);
                continue;
            }
            let OpenChunk { reader, values } = match &mut open {
                Some(open) => open,
                None => open.insert(OpenChunk::new(part.chunk, &steps, &mut buffers)?),
            };
            if n >= announced {
                announced = n / AT_ONCE * AT_ONCE + cached.len();
                let next = part.blocks[n..announced].iter().zip(&cached[n % AT_ONCE..]);
                reader.expect(next.filter(|(_, cached)| cached.is_none()).map(|(b, _)| b.block));
            }
            if !reader.block(block.block, &first.wanted(block), &mut buffers.block)? {
                continue;
            }
            let bytes = add_block(part.chunk, block.block, &mut steps, values, &mut buffers)?;
            self.active_bytes.fetch_add(bytes, Ordering::Relaxed);
        }
        if let Some(OpenChunk { reader, values }) = open {
            buffers.reader = reader.into_memory();
            buffers.values = values.into_iter().map(CornerValues::into_memory).collect();
        }
        spare.give_buffers(buffers);
        Ok(steps.into_iter().map(|step| step.worker.finish()).collect())
    }
}

/// The chunks of several questions, each with the blocks of all.
fn join<'a>(questions: &[Question<'a>]) -> Vec<ChunkPart<'a>> {
    let mut chunks: BTreeMap<ChunkId, ChunkPart<'a>> = BTreeMap::new();
    for (question, asked) in questions.iter().enumerate() {
        for (number, work) in asked.work.iter().enumerate() {
            let (chunk, blocks) = (work.chunk, Cow::Owned(vec![]));
            let part = chunks.entry(chunk).or_insert(ChunkPart { chunk, asked: vec![], blocks, cells: None });
            part.asked.push((question, number));
            part.blocks.to_mut().extend_from_slice(&work.blocks);
        }
    }
    for part in chunks.values_mut() {
        let blocks = part.blocks.to_mut();
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
    chunks.into_values().collect()
}

/// Prefetches the next cached block.
fn prefetch(cached: &[Option<Arc<NumberedShape>>], next: usize) {
    if let Some(Some(next)) = cached.get(next) {
        next.numbered.will_be_read();
    }
}

/// A step that is asked about a chunk.
struct AskedStep<'a> {
    question: &'a Question<'a>,
    /// The blocks that can hold an answer, from the next one on.
    entries: &'a [Entry],
    worker: ChunkWorker<'a>,
}

impl<'a> AskedStep<'a> {
    fn new(question: &'a Question<'a>, work: usize, spare: &BufferPool) -> Self {
        let entries = &question.work[work].blocks;
        Self { question, entries, worker: ChunkWorker::new(question, spare) }
    }

    /// The entry of a block, if it can hold an answer; blocks ascend.
    fn entry(&mut self, block: u32) -> Option<&'a Entry> {
        let passed = self.entries.iter().take_while(|entry| entry.block < block).count();
        self.entries = &self.entries[passed..];
        self.entries.first().filter(|entry| entry.block == block)
    }
}

/// A chunk of which blocks are read, and its values at all steps that are asked.
struct OpenChunk<'a> {
    reader: ChunkReader<'a>,
    values: Vec<CornerValues<'a>>,
}

impl<'a> OpenChunk<'a> {
    fn new(chunk: ChunkId, steps: &[AskedStep<'a>], buffers: &mut Buffers) -> Result<Self> {
        let archive: &'a StepView = steps[0].question.archive;
        let reader = ChunkReader::open(archive, chunk, std::mem::take(&mut buffers.reader))?;
        let mut memory = std::mem::take(&mut buffers.values).into_iter();
        let vertices = reader.vertices();
        let values = |step: &AskedStep<'a>| {
            let memory = memory.next().unwrap_or_default();
            match steps {
                [_] => CornerValues::new(archive, chunk, vertices, memory),
                // One view opens the files of all.
                _ => {
                    CornerValues::of_step(archive, step.question.archive.position(), chunk, vertices, memory)
                }
            }
        };
        let values = steps.iter().map(values).collect::<Result<_>>()?;
        Ok(Self { reader, values })
    }
}

/// Adds the block in the buffers to the surfaces of all steps. Returns the bytes of it and of its
/// values, if it has an active tetrahedron.
fn add_block(
    chunk: ChunkId,
    number: u32,
    steps: &mut [AskedStep<'_>],
    values: &mut [CornerValues<'_>],
    buffers: &mut Buffers,
) -> Result<u64> {
    let Buffers { block, bench, .. } = buffers;
    let (mut of_block, mut bytes, is_alone) = (block.bytes, 0, steps.len() == 1);
    let mut shape = if is_alone { None } else { NumberedShape::of(block, bench) };
    for (n, step) in steps.iter_mut().enumerate() {
        let Some(entry) = step.entry(number) else { continue };
        let (before, Buffers { block, bench, .. }) = (step.worker.active(), &mut *buffers);
        if is_alone {
            values[n].take(&step.question.needed(), block)?;
            step.question.archive.cache.put(chunk, number, block, bench);
            step.worker.add(entry, buffers);
        } else {
            CornerValues::load_of_steps(values, n, &block.corners.numbers)?;
            match &mut shape {
                Some(shape) => {
                    shape.numbered.set_values(values[n].values());
                    step.worker.add_numbered(entry, shape, buffers);
                }
                // One with too many corners, which is rare.
                None => {
                    values[n].gather(block);
                    step.worker.add(entry, buffers);
                }
            }
        }
        if step.worker.active() > before {
            bytes += std::mem::take(&mut of_block) + values[n].count(&buffers.block.corners.numbers);
        }
    }
    Ok(bytes)
}
