//! One worker: the memory in which it makes one mesh after another.

use super::delaunay::Kernel;
use super::list::{Memory, TetList};
use super::owned::Owned;
use super::stars::Stars;
use super::tet::Tet;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::geom::curve::Order;

/// The reusable memory of one worker, and the mesh that was last built in it by insertion.
#[derive(Debug, Default)]
pub struct Mesher {
    pub(super) kernel: Kernel,
    /// Of the chunk stage, kept here so that its pages are not asked for again in each chunk.
    pub(super) owned: Owned,
    pub(super) stars: Stars,
}

impl Mesher {
    /// An empty worker.
    pub fn new() -> Self {
        Self::default()
    }

    /// Gives back the memory in which the tetrahedra of a chunk are: the next will be meshed in it.
    pub fn reuse(&mut self, tets: TetList) {
        match tets.into_memory() {
            Memory::Among(records, _) => self.kernel.reuse(records),
            Memory::Listed(tets) => self.stars.reuse(tets),
        }
    }

    /// Tetrahedralizes `positions`; of equal positions only the first becomes a vertex. Sets that
    /// span no volume (fewer than four points, all on one line or plane) have no tetrahedra.
    ///
    /// # Errors
    /// [`Error::Usage`](isospan_io::error::Error::Usage) for a coordinate above 2^24, an order
    /// finer than [`Order::MOST_BITS`], or more points or tetrahedra than 2^30 records hold.
    pub fn delaunay(&mut self, positions: &[LatticePos], order: &Order) -> Result<()> {
        self.kernel.delaunay(positions, order)
    }

    /// Calls `f` with each tetrahedron: vertex numbers are indices into the `positions` last
    /// meshed. The order of calls and the starting vertex of each are not specified.
    pub fn for_each_tet(&self, f: impl FnMut(Tet)) {
        self.kernel.for_each_tet(f);
    }
}
