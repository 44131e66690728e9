//! One chunk: the surfaces of its active blocks, at all isovalues.

use crate::error::Result;
use crate::geom::LatticePos;
use crate::grid::ChunkId;
use crate::index::Entry;
use crate::mesh::tet::{Tet, is_active};
use crate::pipeline::read::{
    Block, BlockCorners, BufferPool, Buffers, CacheHit, CachedBlock, ChunkReader, Cut, NumberedShape,
    StepView,
};
use crate::surface::WorldMap;
use crate::surface::extract::{ChunkSurface, Precomputed, PrecomputedBlock, Workbench, cap::select_boundary};
use std::sync::atomic::AtomicU64;

/// Cells of a box along each axis, from the first to past the last.
pub(super) type Cells = [[u64; 2]; 3];

/// The blocks of a chunk that can hold an answer, in order.
#[derive(Clone)]
pub(super) struct ChunkWork {
    pub(super) chunk: ChunkId,
    pub(super) blocks: Vec<Entry>,
    /// Of a pyramid: the cells of a part of the chunk, whose bricks these are.
    pub(super) cells: Option<Cells>,
}

/// Blocks, as an index lists them, chunk by chunk.
pub(super) fn by_chunk(archive: &StepView, refs: &[Entry]) -> Result<Vec<ChunkWork>> {
    refs.chunk_by(|a, b| a.chunk == b.chunk)
        .map(|run| {
            let chunk = ChunkId(run[0].chunk);
            archive.expect_chunk(chunk)?;
            Ok(ChunkWork { chunk, blocks: run.to_vec(), cells: None })
        })
        .collect()
}

/// What to extract.
pub(super) struct Question<'a> {
    pub(super) archive: &'a StepView,
    pub(super) isovalues: &'a [f32],
    /// Where; everywhere without.
    pub(super) cut: Option<&'a Cut>,
    pub(super) world: WorldMap,
    /// The level of a pyramid.
    pub(super) level: usize,
    /// The upper corner of the domain, where caps are wanted on its faces.
    pub(super) caps: Option<LatticePos>,
    /// Active blocks, chunk by chunk.
    pub(super) work: &'a [ChunkWork],
    /// Counts the bytes of the blocks and values that hold an active tetrahedron.
    pub(super) active_bytes: AtomicU64,
}

/// The surfaces of a chunk, one for each isovalue.
pub(super) type ChunkSurfaces = Vec<ChunkSurface>;

impl Question<'_> {
    fn keep_in_cut(&self, corners: &BlockCorners, tets: &mut Vec<Tet>) {
        if let Some(cut) = self.cut {
            tets.retain(|t| cut.may_touch(&t.map(|v| corners.positions[v as usize])));
        }
    }
}

/// The surfaces of a chunk while blocks are added to them.
pub(super) struct ChunkWorker<'a> {
    pub(super) question: &'a Question<'a>,
    surfaces: ChunkSurfaces,
    started: bool,
}

impl<'a> ChunkWorker<'a> {
    /// No surfaces yet, in memory that is spare.
    pub(super) fn new(question: &'a Question<'a>, spare: &BufferPool) -> Self {
        let surfaces = question.isovalues.iter().map(|_| spare.surface()).collect();
        Self { question, surfaces, started: false }
    }

    /// Adds a block with the values of a step to the surfaces.
    pub(super) fn add_shape(&mut self, entry: &Entry, shape: &NumberedShape, buffers: &mut Buffers) {
        let question = self.question;
        if question.cut.is_some() || question.caps.is_some() {
            shape.unpack(&mut buffers.block);
            return self.add(entry, buffers, None);
        }
        self.start(shape.of_chunk);
        for (surface, &isovalue) in self.surfaces.iter_mut().zip(question.isovalues) {
            if is_active(entry.min, entry.max, isovalue) {
                surface.add_numbered(&shape.numbered, &question.world, &mut buffers.bench);
            }
        }
    }

    /// Adds a cached block to the surfaces, and precomputes it, if that is due.
    pub(super) fn add_cached(
        &mut self,
        chunk: ChunkId,
        entry: &Entry,
        found: &CacheHit,
        buffers: &mut Buffers,
    ) {
        let question = self.question;
        let is_whole = question.is_whole();
        match &*found.block {
            CachedBlock::Precomputed(block, of_chunk) if is_whole => {
                return self.add_cached_precomputed(entry, block, *of_chunk, &mut buffers.bench);
            }
            CachedBlock::Numbered(shape) if !(is_whole && found.is_due) => {
                return self.add_shape(entry, shape, buffers);
            }
            block => block.unpack(&mut buffers.block),
        }
        let Buffers { block: Block { corners, tets, .. }, bench, .. } = &mut *buffers;
        match is_whole.then(|| bench.precompute(&corners.cells(tets), &question.world)).flatten() {
            Some(known) => {
                self.add_cached_precomputed(entry, &known, corners.of_chunk, bench);
                let known = CachedBlock::Precomputed(known, corners.of_chunk);
                question.archive.cache.replace(chunk, entry.block, known);
            }
            None => self.add(entry, buffers, None),
        }
    }

    fn add_cached_precomputed(
        &mut self,
        entry: &Entry,
        block: &PrecomputedBlock,
        of_chunk: usize,
        bench: &mut Workbench,
    ) {
        let is_sound = self.add_precomputed(entry, block.view(), of_chunk, bench);
        assert!(is_sound, "a block that was made here has the edges of its tetrahedra");
    }

    /// Makes room for `count` edges of the chunk that have numbers.
    pub(super) fn number_edges(&mut self, count: usize) {
        self.surfaces.iter_mut().for_each(|surface| surface.number_edges(count));
    }

    /// Adds a precomputed block to the surfaces. False if it is none: see
    /// [`ChunkSurface::add_precomputed`].
    #[must_use]
    pub(super) fn add_precomputed(
        &mut self,
        entry: &Entry,
        block: Precomputed<'_>,
        of_chunk: usize,
        bench: &mut Workbench,
    ) -> bool {
        self.start(of_chunk);
        let mut is_sound = true;
        for (surface, &isovalue) in self.surfaces.iter_mut().zip(self.question.isovalues) {
            if is_active(entry.min, entry.max, isovalue) {
                is_sound &= surface.add_precomputed(block, &self.question.world, bench);
            }
        }
        is_sound
    }

    /// Adds the block in the buffers to the surfaces, and notifies `reader` if it is active.
    pub(super) fn add(
        &mut self,
        entry: &Entry,
        buffers: &mut Buffers,
        mut reader: Option<&mut ChunkReader<'_>>,
    ) {
        let Buffers { block, sides, active, bench, .. } = buffers;
        let (question, corners) = (self.question, &block.corners);
        // The bytes of a block count once, for any number of isovalues.
        let mut bytes = block.bytes;
        self.start(corners.of_chunk);
        for (surface, &isovalue) in self.surfaces.iter_mut().zip(question.isovalues) {
            if is_active(entry.min, entry.max, isovalue) {
                active.clear();
                sides.select(&block.tets, &corners.values, isovalue, active);
                question.keep_in_cut(corners, active);
                surface.add_active(&corners.cells(active), &question.world, bench);
                if let Some(reader) = reader.as_mut().filter(|_| !active.is_empty()) {
                    let used = active.iter().flatten().map(|&v| corners.numbers[v as usize]);
                    reader.count_active(std::mem::take(&mut bytes), used);
                }
            }
            if let Some(top) = question.caps.filter(|_| isovalue <= entry.max) {
                active.clear();
                select_boundary(&corners.cells(&block.tets), top, isovalue, active);
                surface.add_caps(&corners.cells(active), &question.world, top);
            }
        }
    }

    /// Empties the surfaces before the first block.
    fn start(&mut self, corners: usize) {
        if self.started {
            return;
        }
        for (surface, &isovalue) in self.surfaces.iter_mut().zip(self.question.isovalues) {
            surface.start(isovalue, corners);
        }
        self.started = true;
    }

    /// Active tetrahedra so far, once for each isovalue.
    pub(super) fn active(&self) -> u64 {
        self.surfaces.iter().map(|s| if self.started { s.active_cells() } else { 0 }).sum()
    }

    pub(super) fn finish(mut self) -> ChunkSurfaces {
        self.start(0);
        self.surfaces.iter_mut().for_each(|surface| surface.finish(&self.question.world));
        self.surfaces
    }
}
