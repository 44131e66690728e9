//! The memory in which chunks are read, one after another: pages that a process has need not be
//! cleared again.

use crate::archive::mesh::TetScratch;
use isospan_io::geom::{LatticePos, Site};

/// What is known of the corners of a chunk, by their numbers. Its pages are touched where corners
/// are placed only.
#[derive(Default)]
pub(super) struct CornersMemory {
    pub(super) positions: Vec<LatticePos>,
    /// Ids, as numbers.
    pub(super) ids: Vec<u64>,
    /// What is known of each: [`PLACED`], [`SHARED`].
    pub(super) states: Vec<u8>,
    /// The points of a brick.
    pub(super) sites: Vec<Site>,
}

/// Whether a corner has its position and id.
pub(super) const PLACED: u8 = 1;
/// Whether another chunk has a corner.
pub(super) const SHARED: u8 = 2;

impl CornersMemory {
    /// Prepares for a chunk: no corner is placed, and all are shared.
    pub(super) fn start(&mut self, vertices: usize) {
        self.states.clear();
        self.states.resize(vertices, SHARED);
        if self.positions.len() < vertices {
            // A system hands out cleared pages when they are touched.
            let room = vertices + vertices / 4;
            (self.positions, self.ids) = (vec![[0; 3]; room], vec![0; room]);
        }
    }

    /// Bytes of what is per vertex of a chunk.
    pub(super) fn bytes(&self) -> usize {
        self.positions.capacity() * size_of::<LatticePos>()
            + self.ids.capacity() * size_of::<u64>()
            + self.states.capacity()
    }
}

/// The memory of a reader, for the next one.
#[derive(Default)]
pub(in crate::pipeline) struct ReaderMemory {
    pub(super) corners: CornersMemory,
    /// The bytes of some blocks.
    pub(super) bytes: Vec<u8>,
    /// Positions of the corners of a block, and what decoding it needs.
    pub(super) here: Vec<LatticePos>,
    pub(super) scratch: TetScratch,
}

impl ReaderMemory {
    /// Bytes of what is per vertex of a chunk.
    pub(super) fn bytes(&self) -> usize {
        self.corners.bytes()
    }
}

/// The memory of values, for the next chunk.
#[derive(Default)]
pub(in crate::pipeline) struct ValuesMemory {
    pub(super) values: Vec<f32>,
    /// The values of a block.
    pub(super) decoded: Vec<f32>,
}

impl ValuesMemory {
    /// Prepares for a chunk, none of whose values is known.
    pub(super) fn start(&mut self, vertices: usize) {
        if self.values.len() < vertices {
            self.values = vec![0.0; vertices + vertices / 4];
        }
    }

    /// Bytes of what is per vertex of a chunk.
    pub(super) fn bytes(&self) -> usize {
        self.values.capacity() * size_of::<f32>()
    }
}
