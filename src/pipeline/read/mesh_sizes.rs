//! The sizes of a chunk's mesh that is not stored.

use crate::archive::chunked::MeshSizes;
use crate::mesh::bcc::BccChunk;

/// The sizes of a mesh that follows by formula.
pub(in crate::pipeline) fn sizes_of(chunk: &BccChunk) -> MeshSizes {
    MeshSizes {
        core: chunk.core() as u32,
        halo: (chunk.points() - chunk.core()) as u32,
        tet_blocks: chunk.brick_count() as u32,
        retries: 0,
        tets: chunk.tet_count(),
    }
}
