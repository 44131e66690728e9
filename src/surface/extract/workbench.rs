//! The buffers of a thread that extracts surfaces.

use super::cells::{CellSource, Sides};
use super::numbered::{BlockBuffers, NumberedBlock};
use super::numbering::Numbering;
use super::patch::Patch;
use super::precomputed::{Crossed, Maker, PrecomputedBlock};
use crate::mesh::tet::Tet;
use crate::surface::world_map::WorldMap;

/// Buffers in which surfaces are made, some hundred kilobytes. One is enough for all surfaces that
/// a thread works on.
#[derive(Debug, Default)]
pub struct Workbench {
    /// Finds the active tetrahedra of a block, which are then in the list.
    pub(super) sides: Sides,
    pub(super) active: Vec<Tet>,
    pub(super) numbering: Numbering,
    pub(super) block: BlockBuffers,
    pub(super) patch: Patch,
    maker: Maker,
    pub(super) crossed: Crossed,
}

impl Workbench {
    /// Numbers a block, for many isovalues. `None` of one that is too large, or whose corners have
    /// no numbers in a chunk.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(crate) fn number(&mut self, block: &CellSource<'_>) -> Option<NumberedBlock> {
        NumberedBlock::of(block, &mut self.block)
    }

    /// Finds out all about a block that does not depend on the isovalue. `None` of one that is too
    /// large.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(crate) fn precompute(
        &mut self,
        block: &CellSource<'_>,
        world: &WorldMap,
    ) -> Option<PrecomputedBlock> {
        self.maker.make(block, world)
    }
}
