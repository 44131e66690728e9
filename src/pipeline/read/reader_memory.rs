//! The memory in which chunks are read, one after another.

use super::star_memory::StarMemory;
use crate::archive::mesh::TetScratch;
use crate::geom::{LatticePos, PointId, Site};
use crate::mesh::tet::Tet;
use std::collections::HashMap;

/// A position that no corner has: the lattice ends at 2^24.
pub(super) const UNPLACED: LatticePos = [u32::MAX; 3];

/// The memory of a reader, for the next one: pages that a process has need not be cleared again.
#[derive(Default)]
pub(in crate::pipeline) struct ReaderMemory {
    pub(super) positions: Vec<LatticePos>,
    pub(super) ids: Vec<PointId>,
    pub(super) values: Vec<f32>,
    /// Buffers: the bytes of a block, the points of a brick, the values of a block.
    pub(super) bytes: Vec<u8>,
    pub(super) sites: Vec<Site>,
    pub(super) decoded: Vec<f32>,
    /// Positions of the corners of a block, and what decoding it needs.
    pub(super) here: Vec<LatticePos>,
    pub(super) scratch: TetScratch,
    /// Blocks whose tetrahedra are made again: what makes them, the tetrahedra of one, the numbers
    /// of a chunk's halo points.
    pub(super) stars: StarMemory,
    pub(super) tets: Vec<Tet>,
    pub(super) halo: HashMap<PointId, u32>,
    /// For each corner of the chunk, its place in the block at hand; else `u32::MAX`.
    pub(super) places: Vec<u32>,
}

impl ReaderMemory {
    /// Bytes of what is per vertex of a chunk.
    pub(super) fn bytes(&self) -> usize {
        self.positions.capacity() * size_of::<LatticePos>()
            + self.ids.capacity() * size_of::<PointId>()
            + self.values.capacity() * size_of::<f32>()
            + self.stars.bytes()
            + self.halo.capacity() * size_of::<(PointId, u32)>()
            + self.places.capacity() * size_of::<u32>()
    }

    /// Prepares for a chunk. Ids of corners that are not placed, and values that are not loaded,
    /// are not asked for.
    pub(super) fn start(&mut self, vertices: usize) {
        self.positions.clear();
        self.positions.resize(vertices, UNPLACED);
        self.ids.resize(vertices, PointId(0));
        self.values.resize(vertices, f32::NAN);
        self.halo.clear();
    }
}
