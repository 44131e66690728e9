//! The memory in which tetrahedra are made again, block after block.

use crate::geom::Site;
use crate::mesh::stars::asked::PointStars;
use crate::mesh::tet::Tet;

/// Memory in which stars are made.
#[derive(Default)]
pub(super) struct StarMemory {
    pub(super) stars: PointStars,
    /// For each listed point of the chunk, its number there.
    pub(super) numbers: Vec<u32>,
    /// The other listed points.
    pub(super) others: Vec<Site>,
    /// For each brick of the chunk, the first of its listed points.
    pub(super) firsts: Vec<u32>,
    pub(super) star: Vec<Tet>,
    /// The tetrahedra of a block.
    pub(super) tets: Vec<Tet>,
}

impl StarMemory {
    pub(super) fn bytes(&self) -> usize {
        self.stars.bytes()
            + self.numbers.capacity() * size_of::<u32>()
            + self.others.capacity() * size_of::<Site>()
    }
}
