//! What is asked of a step, and of which blocks.

use crate::index::Entry;
use crate::pipeline::plan::estimate;
use crate::pipeline::read::{BlockCorners, Cut, Needed, StepView, WantedBlocks};
use crate::surface::WorldMap;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::grid::ChunkId;
use isospan_mesh::mesh::tet::{Tet, is_active};

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

/// What to extract of a step.
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
}

impl Question<'_> {
    /// Leaves those of some tetrahedra that may touch the cut.
    pub(super) fn keep_in_cut(&self, corners: &BlockCorners, tets: &mut Vec<Tet>) {
        if let Some(cut) = self.cut {
            tets.retain(|t| cut.may_touch(&t.map(|v| corners.positions[v as usize])));
        }
    }

    /// Vertices that a chunk uses, about.
    pub(super) fn vertices_near(&self, chunk: ChunkId) -> u64 {
        let archive = self.archive;
        let core = &archive.chunks.chunk(chunk).core;
        // The halo points that tetrahedra use lie within about one spacing.
        let near =
            core.grow_sides(archive.points.spacing_around(core), &archive.chunks.bricks().lattice.domain());
        archive.points.count_in(&near)
    }

    /// For how many isovalues a block can hold an answer.
    pub(super) fn times_active(&self, block: &Entry) -> u64 {
        self.isovalues.iter().filter(|&&v| self.is_wanted(block, v)).count() as u64
    }

    /// Whether a block is active, or may have caps.
    fn is_wanted(&self, block: &Entry, isovalue: f32) -> bool {
        is_active(block.min, block.max, isovalue) || self.caps.is_some() && isovalue <= block.max
    }

    /// Bytes in which a chunk of so many vertices has its surfaces from some blocks, what reads
    /// them left out.
    pub(super) fn surface_bytes(&self, vertices: u64, blocks: &[Entry]) -> u64 {
        let tets: u64 = blocks.iter().map(|b| u64::from(b.tets) * self.times_active(b)).sum();
        let per_vertex =
            estimate::VALUE_PER_VERTEX + estimate::SURFACE_PER_VERTEX * self.isovalues.len() as u64;
        estimate::extraction_bytes(vertices, per_vertex, tets)
    }

    /// What is wanted of an entry's block; one without active tetrahedra is read for caps only.
    pub(super) fn wanted(&self, entry: &Entry) -> WantedBlocks<'_> {
        match (self.cut, self.caps) {
            (Some(cut), _) => WantedBlocks::Touching(cut),
            (None, Some(top)) if !self.isovalues.iter().any(|&v| is_active(entry.min, entry.max, v)) => {
                WantedBlocks::AtEnds(top)
            }
            _ => WantedBlocks::All,
        }
    }

    /// Caps have triangles in tetrahedra that are not active, and cached blocks are for
    /// other isovalues too.
    pub(super) fn needed(&self) -> Needed<'_> {
        match self.caps.is_some() || self.archive.cache.most() > 0 {
            true => Needed::All,
            false => Needed::ForActive(self.isovalues),
        }
    }
}
