//! What the chunks of one archive have in common.

use crate::domain::own::OwnCells;
use crate::domain::store::CellStore;
use crate::pipeline::plan::{Halo, estimate};
use isospan_io::geom::curve::Order;
use isospan_io::grid::{BrickGrid, Chunk};
use isospan_mesh::mesh::chunk::ChunkRegion;
use isospan_mesh::points::PointSet;

/// What the chunks of one archive have in common.
pub(in crate::pipeline) struct Recipe<'a> {
    pub(in crate::pipeline) points: &'a PointSet,
    pub(in crate::pipeline) bricks: BrickGrid,
    pub(in crate::pipeline) order: Order,
    /// The surroundings of a chunk that are needed.
    pub(in crate::pipeline) halo: Halo,
    /// The mesh whose own tetrahedra are kept, where they are.
    pub(in crate::pipeline) own: Option<OwnMesh<'a>>,
}

impl Recipe<'_> {
    /// The boxes of a chunk, at first.
    pub(super) fn boxes(&self, chunk: &Chunk) -> ChunkRegion {
        let (points, core, domain) = (self.points, chunk.core, self.bricks.lattice.domain());
        let near = estimate::near(points, &core, &domain, self.halo);
        ChunkRegion { core, near, region: estimate::region(points, &core, &domain, self.halo, 0), domain }
    }
}

/// A mesh whose own tetrahedra are kept.
#[derive(Clone, Copy)]
pub(in crate::pipeline) struct OwnMesh<'a> {
    pub(in crate::pipeline) store: &'a CellStore,
    pub(in crate::pipeline) cells: &'a OwnCells,
}
