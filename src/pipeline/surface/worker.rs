//! One chunk: the surfaces of its active blocks, at all isovalues of a step.

use super::question::Question;
use crate::index::Entry;
use crate::pipeline::read::{BufferPool, Buffers, NumberedShape};
use crate::surface::extract::{ChunkSurface, cap::select_boundary};
use isospan_mesh::mesh::tet::is_active;

/// The surfaces of a chunk, one for each isovalue.
pub(super) type ChunkSurfaces = Vec<ChunkSurface>;

/// The surfaces of a chunk while blocks are added to them.
pub(super) struct ChunkWorker<'a> {
    question: &'a Question<'a>,
    surfaces: ChunkSurfaces,
    started: bool,
}

impl<'a> ChunkWorker<'a> {
    /// No surfaces yet, in memory that is spare.
    pub(super) fn new(question: &'a Question<'a>, spare: &BufferPool) -> Self {
        let surfaces = question.isovalues.iter().map(|_| spare.surface()).collect();
        Self { question, surfaces, started: false }
    }

    /// Adds a numbered block to the surfaces.
    pub(super) fn add_numbered(&mut self, entry: &Entry, shape: &NumberedShape, buffers: &mut Buffers) {
        let question = self.question;
        if question.cut.is_some() || question.caps.is_some() {
            shape.unpack(&mut buffers.block);
            return self.add(entry, buffers);
        }
        self.start(shape.of_chunk);
        for (surface, &isovalue) in self.surfaces.iter_mut().zip(question.isovalues) {
            if is_active(entry.min, entry.max, isovalue) {
                surface.add_numbered(&shape.numbered, &question.world, &mut buffers.bench);
            }
        }
    }

    /// Adds the block in the buffers to the surfaces.
    pub(super) fn add(&mut self, entry: &Entry, buffers: &mut Buffers) {
        let Buffers { block, sides, active, bench, .. } = buffers;
        let (question, corners) = (self.question, &block.corners);
        self.start(corners.of_chunk);
        for (surface, &isovalue) in self.surfaces.iter_mut().zip(question.isovalues) {
            if is_active(entry.min, entry.max, isovalue) {
                active.clear();
                sides.select(&block.tets, &corners.values, isovalue, active);
                question.keep_in_cut(corners, active);
                surface.add_active(&corners.cells(active), &question.world, bench);
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
