//! The tetrahedra of some points of a region: those of an archive that stores none.
//!
//! A tetrahedron belongs to its vertex with the smallest number. Which points will be asked for is
//! known before, so that a face of a tetrahedron that was found waits for the first of these (see
//! [`super`]): what lies beyond it is not searched for twice.

use super::machine::Vectors;
use super::{Chunk, Stars};
use crate::error::Result;
use crate::geom::LatticePos;
use crate::geom::curve::Order;
use crate::mesh::chunk::ChunkRegion;
use crate::mesh::delaunay::Mesher;
use crate::mesh::tet::Tet;

/// The points of a region some of whose tetrahedra are asked for. The memory serves one region
/// after another.
#[derive(Debug, Default)]
pub(crate) struct PointStars {
    stars: Stars,
    mesher: Mesher,
    region: Option<Region>,
    positions: Vec<LatticePos>,
    /// For each position, whether it is asked for.
    asked: Vec<bool>,
    /// The rows of points around the cell.
    rows: Vec<[u32; 2]>,
    cell: [usize; 3],
    /// The first point that may be asked for next.
    next: u32,
}

/// A region at work.
#[derive(Debug)]
struct Region {
    boxes: ChunkRegion,
    order: Order,
    spacing: f64,
    /// How many positions are the core's.
    core: usize,
}

impl PointStars {
    /// Prepares for the points of `boxes.region`; `fill` appends their positions, those in the core
    /// first, and returns how many these are. False where these are too few for the region.
    ///
    /// # Errors
    /// Those of `fill`.
    pub(crate) fn start(
        &mut self,
        boxes: ChunkRegion,
        order: Order,
        fill: impl FnOnce(&mut Vec<LatticePos>) -> Result<usize>,
    ) -> Result<bool> {
        self.positions.clear();
        let core = fill(&mut self.positions)?;
        self.asked.clear();
        self.asked.resize(self.positions.len(), false);
        (self.next, self.cell) = (0, [usize::MAX; 3]);
        let spacing = self.stars.list(&boxes, &self.positions);
        self.region = spacing.map(|spacing| Region { boxes, order, spacing, core });
        Ok(self.region.is_some())
    }

    /// Says that a point will be asked for.
    pub(crate) fn will_ask(&mut self, point: u32) {
        self.asked[point as usize] = true;
    }

    /// Replaces `out` by the tetrahedra that the core owns and whose smallest vertex is `point`,
    /// that first, positively oriented. False where the region is too small to prove them. Takes
    /// least time for points that ascend, and that were announced.
    ///
    /// # Errors
    /// As [`Mesher::delaunay`].
    ///
    /// # Panics
    /// When no region was started, or the point is not of its core.
    pub(crate) fn star(&mut self, point: u32, out: &mut Vec<Tet>) -> Result<bool> {
        let Self { stars, mesher, region, positions, asked, rows, cell, next } = self;
        let region = region.as_ref().expect("a region was started");
        assert!((point as usize) < region.core, "a point of the core");
        let passed = (point.min(*next) as usize)..point as usize;
        if point < *next || !asked[point as usize] || asked[passed].contains(&true) {
            // Faces wait for points that have no turn, or not for this one: all is forgotten.
            stars.forget();
            asked[..point as usize].fill(false);
            asked[point as usize] = true;
        }
        *next = point + 1;
        out.clear();
        stars.slow.stars = 0;
        let mut chunk = Chunk {
            vectors: Vectors::found(),
            boxes: &region.boxes,
            positions,
            order: &region.order,
            spacing: region.spacing,
            core: region.core,
            rows: std::mem::take(rows),
            cell: *cell,
            used: std::mem::take(asked),
            turned: 0,
            knows_owned: false,
        };
        let is_whole = chunk.close(stars, mesher, point)?;
        if is_whole {
            let is_first = |t: &Tet| t[1].min(t[2]).min(t[3]) > point;
            out.extend(stars.star.iter().filter(|t| is_first(t) && chunk.owns(**t)));
            chunk.wait(stars, true);
        }
        (self.rows, self.cell, self.asked) = (chunk.rows, chunk.cell, chunk.used);
        if !is_whole {
            // The star may have been begun.
            self.stars.forget();
            self.asked[..=point as usize].fill(false);
        }
        Ok(is_whole)
    }

    /// Bytes of memory.
    pub(crate) fn bytes(&self) -> usize {
        self.stars.bytes()
            + self.positions.capacity() * size_of::<LatticePos>()
            + self.asked.capacity()
            + self.rows.capacity() * size_of::<[u32; 2]>()
    }
}
