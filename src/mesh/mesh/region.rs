//! A chunk's boxes, and its part of the mesh.

use super::list::TetList;
use super::tet::Tet;
use isospan_io::error::{Error, Result};
use isospan_io::geom::LatticeBox;

/// The boxes of a chunk; all half-open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkRegion {
    /// The part of the domain that the chunk owns.
    pub core: LatticeBox,
    /// Core and inner halo, clipped to the domain: the points that are inserted at once. Those
    /// further out are inserted where a tetrahedron needs them.
    pub near: LatticeBox,
    /// Core and halo, clipped to the domain: where the chunk knows all points.
    pub region: LatticeBox,
    /// The whole domain: no point lies outside it.
    pub domain: LatticeBox,
}

/// The tetrahedra of a chunk.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChunkMesh {
    /// Owned tetrahedra: vertex numbers are indices into the chunk's positions, positively
    /// oriented, least number first; ascending by that. Behind them, where they were asked for,
    /// those around, positively oriented.
    pub tets: TetList,
    /// For each position: whether another chunk may own a tetrahedron at it. Only an edge between
    /// two shared vertices can also occur in another chunk. Positions outside the core are always
    /// shared.
    pub shared: Vec<bool>,
}

/// The border between the tetrahedra that a chunk owns and those of others, in numbers of its
/// positions.
#[derive(Clone, Copy, Debug)]
pub struct Border<'a> {
    /// Its tetrahedra with three such points or more; there may be others.
    pub tets: &'a [Tet],
    /// For each position, whether one of its tetrahedra has it and one of others may.
    pub points: &'a [bool],
}

impl ChunkRegion {
    /// An error unless each box lies in the next.
    pub(super) fn check(&self) -> Result<()> {
        let nested = |inner: &LatticeBox, outer: &LatticeBox| inner.intersect(outer) == *inner;
        let Self { core, near, region, domain } = self;
        if nested(core, near) && nested(near, region) && nested(region, domain) {
            return Ok(());
        }
        Err(Error::usage(format!("the boxes of a chunk are not nested: {self:?}")))
    }
}
