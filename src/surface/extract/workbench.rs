//! The buffers of a thread that extracts surfaces.

use super::cells::{CellSource, Sides};
use super::numbered::{BlockBuffers, NumberedBlock};
use super::numbering::Numbering;
use super::patch::Patch;
use isospan_mesh::mesh::tet::Tet;

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
}
