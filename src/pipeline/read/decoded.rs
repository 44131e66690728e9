//! Whole blocks of a chunk, decoded at once: for questions that look at all of it.

use super::chunk_reader::ChunkReader;
use super::corner_values::CornerValues;
use super::reader_memory::{ReaderMemory, ValuesMemory};
use super::step_view::StepView;
use isospan_io::error::Result;
use isospan_io::geom::{LatticePos, PointId};
use isospan_io::grid::ChunkId;
use isospan_mesh::mesh::tet::Tet;

/// Some blocks of a chunk, decoded: tetrahedra, and position, id and value of the corners they use.
/// Corner arrays are indexed by chunk-local vertex number; corners that are not used hold anything.
#[derive(Default)]
pub(in crate::pipeline) struct DecodedChunk {
    pub(in crate::pipeline) positions: Vec<LatticePos>,
    pub(in crate::pipeline) ids: Vec<PointId>,
    pub(in crate::pipeline) values: Vec<f32>,
    pub(in crate::pipeline) shared: Vec<bool>,
    /// Tetrahedra, block after block.
    pub(in crate::pipeline) tets: Vec<Tet>,
    /// End of each block in `tets`.
    pub(in crate::pipeline) block_ends: Vec<usize>,
    /// Corners that the chunk owns; the others are halo.
    pub(in crate::pipeline) core: usize,
}

impl StepView {
    /// Decodes `blocks` (numbers within the chunk) of a chunk, and the values and positions that
    /// they use. For a question that needs only some of that, or a block at a time, there is
    /// [`ChunkReader`].
    pub(in crate::pipeline) fn decode(&self, id: ChunkId, blocks: &[u32]) -> Result<DecodedChunk> {
        let mut reader = ChunkReader::open(self, id, ReaderMemory::default())?;
        reader.expect(blocks.iter().copied());
        let (mut tets, mut block_ends) = (vec![], vec![]);
        for &block in blocks {
            reader.tets(block, &mut tets)?;
            block_ends.push(tets.len());
        }
        reader.load_all_flags()?;
        let values = self.values_of_tets(id, reader.vertices(), &tets)?;
        let core = reader.core();
        let (positions, ids, shared) = reader.into_corners();
        Ok(DecodedChunk { positions, ids, values, shared, tets, block_ends, core })
    }

    /// The values at the corners of some tetrahedra of a chunk of so many vertices, by chunk-local
    /// vertex number; the others are anything.
    pub(in crate::pipeline) fn values_of_tets(
        &self,
        id: ChunkId,
        vertices: usize,
        tets: &[Tet],
    ) -> Result<Vec<f32>> {
        let mut values = CornerValues::new(self, id, vertices, ValuesMemory::default())?;
        values.load_of(tets)?;
        Ok(values.into_values())
    }
}
