//! Meshing a domain chunk by chunk, so that the union of the chunks is exactly the mesh of the whole.
//!
//! A chunk meshes the points of its **region** (core and halo) and keeps the tetrahedra it **owns**: those whose least vertex (x,
//! then y, then z) lies in its core. Cores tile the domain, so each tetrahedron has one owner. The halo must be wide enough
//! that what is kept is what the whole mesh would have there; `certify.rs` says when that is proven.
//!
//! ```text
//! ┌───────────────┐  region: its outer points are inserted only where needed
//! │ ┌───────────┐ │  near: its points are all inserted
//! │ │  ┌─────┐  │ │  certified: circumsphere holds no point that is not inserted
//! │ │  │core │  │ │  owned: least vertex in core
//! │ │  └─────┘  │ │  shared vertex: has a tetrahedron that another chunk owns
//! ```
//!
//! A halo wide enough for the largest sphere would be three spacings wide, nearly a third of all points at 250 000 owned ones. But few
//! spheres are large. So a narrow halo is inserted with the core; the tetrahedra whose spheres leave it are looked at
//! again with the outer points at hand (`late.rs`), and those found in a sphere are inserted, until each tetrahedron is
//! certified. When a sphere leaves even the region the answer is [`ChunkOutcome::WidenHalo`], and the caller gathers a larger one.
//!
//! Of 2.2 M points in 11 chunks a tenth more are inserted than owned (8 to 13 % by chunk; 16 to 25 % with the tetrahedra around), and hardly any late. An inner halo a
//! quarter of a spacing narrower takes Hammersley points 2 % less time, but Halton points, the cross and the regular grid 2 to 3 % more; half a spacing narrower
//! gains nothing, three quarters lose 8 %.
//!
//! Time: that of the kernel for the points inserted, plus about a tenth for ownership, certification and output order.

use super::certify::Unseen;
use super::delaunay::Mesher;
use super::late::Late;
use super::list::TetList;
use super::owned::{Owned, each_bit};
use crate::error::{Error, Result};
use crate::geom::curve::Order;
use crate::geom::{LatticeBox, LatticePos};

/// The boxes of a chunk; all half-open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkRegion {
    /// What the chunk owns.
    pub core: LatticeBox,
    /// Core and inner halo, clipped to the domain: the points that are inserted at once. Those further out are inserted where
    /// a tetrahedron needs them.
    pub near: LatticeBox,
    /// Core and halo, clipped to the domain: where the chunk knows all points.
    pub region: LatticeBox,
    /// The whole domain: no point lies outside it.
    pub domain: LatticeBox,
}

/// The tetrahedra of a chunk.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChunkMesh {
    /// Owned tetrahedra: vertex numbers are indices into the chunk's positions, positively oriented, least number first;
    /// ascending by that. Behind them, where they were asked for, those around, positively oriented.
    pub tets: TetList,
    /// For each position: whether another chunk may own a tetrahedron at it. Only an edge between two shared
    /// vertices can also occur in another chunk. Positions outside the core are always shared.
    pub shared: Vec<bool>,
}

/// What came of meshing a chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChunkOutcome {
    /// The chunk's part of the mesh, proven.
    Done(ChunkMesh),
    /// Points outside the region could matter; try again with a wider halo.
    WidenHalo {
        /// Tetrahedra and hull facets at core vertices that are not certified; if there is no tetrahedron, the core's
        /// points.
        uncertified: u64,
    },
}

/// Tetrahedralizes the `positions` of a region and keeps what the chunk owns. `positions` must hold every point of the
/// domain that lies in the region, those in `near` first and otherwise in any order; of equal positions only the first becomes a vertex. A region equal to the domain is always
/// [`ChunkOutcome::Done`].
///
/// # Errors
/// [`Error::Usage`] when the boxes are not nested, a position lies outside the region, or [`Mesher::delaunay`] refuses.
pub fn mesh_chunk(
    mesher: &mut Mesher,
    region: &ChunkRegion,
    positions: &[LatticePos],
    order: &Order,
) -> Result<ChunkOutcome> {
    mesh_with_stars(mesher, region, positions, order, false)
}

/// As [`mesh_chunk`]; with `stars`, also the tetrahedra around those owned ([`TetList::around`]), so that all tetrahedra
/// at each vertex of an owned one are known. That takes a wider halo, by one tetrahedron and its sphere.
///
/// # Errors
/// As [`mesh_chunk`].
pub fn mesh_with_stars(
    mesher: &mut Mesher,
    region: &ChunkRegion,
    positions: &[LatticePos],
    order: &Order,
    stars: bool,
) -> Result<ChunkOutcome> {
    let (mut region, mut first) = (*region, check(region, positions)?);
    mesher.delaunay_of_first(positions, first, order)?;
    if mesher.is_empty() && first < positions.len() {
        // The inner points span no volume: nothing to add the others to.
        (region.near, first) = (region.region, positions.len());
        mesher.delaunay(positions, order)?;
    }
    let region = &region;
    let mut owned = std::mem::take(&mut mesher.owned);
    owned.clear(mesher.records());
    let mut sorter = Sorter::new(mesher, region, positions, owned, stars);
    let mut late = None;
    let mut uncertified = sorter.run(mesher, region, first, &mut late);
    if stars && matches!(uncertified, Ok(0)) {
        uncertified = sorter.run_around(mesher, region, first, &mut late);
    }
    let Sorter { mut owned, shared, .. } = sorter;
    let outcome = uncertified.map(|n| match n {
        0 => ChunkOutcome::Done(ChunkMesh { tets: owned.take(mesher, positions.len()), shared }),
        uncertified => ChunkOutcome::WidenHalo { uncertified },
    });
    mesher.owned = owned;
    outcome
}

/// The number of positions that are inserted at once.
fn check(boxes: &ChunkRegion, positions: &[LatticePos]) -> Result<usize> {
    let nested = |inner: &LatticeBox, outer: &LatticeBox| inner.intersect(outer) == *inner;
    let ChunkRegion { core, near, region, domain } = boxes;
    if !nested(core, near) || !nested(near, region) || !nested(region, domain) {
        return Err(Error::usage(format!("the boxes of a chunk are not nested: {boxes:?}")));
    }
    let first = positions.iter().take_while(|p| near.contains(**p)).count();
    match positions[first..].iter().find(|p| near.contains(**p) || !region.contains(**p)) {
        Some(p) if near.contains(*p) => {
            Err(Error::usage(format!("position {p:?} must come before those outside the inner box")))
        }
        Some(p) => Err(Error::usage(format!("position {p:?} lies outside its chunk's region"))),
        None => Ok(first),
    }
}

/// How a tetrahedron relates to the core.
struct Relation {
    owned: bool,
    /// Whether it must be certified.
    checked: bool,
}

/// Sorts the mesher's records into owned, foreign and doubtful ones.
struct Sorter<'a> {
    positions: &'a [LatticePos],
    /// What lies outside the points inserted at once.
    close: Unseen,
    /// By vertex of the mesher: whether it lies in the core; infinity does not.
    in_core: Vec<bool>,
    owned: Owned,
    shared: Vec<bool>,
    /// Records to be looked at again.
    doubtful: Vec<u32>,
    /// By vertex of the mesher: whether an owned tetrahedron has it. Empty where nobody asks for those around.
    used: Vec<bool>,
    /// Whether those around are looked for: the owned ones are known.
    looks_around: bool,
}

impl<'a> Sorter<'a> {
    fn new(
        mesher: &Mesher,
        region: &ChunkRegion,
        positions: &'a [LatticePos],
        owned: Owned,
        stars: bool,
    ) -> Self {
        let shared: Vec<bool> = positions.iter().map(|p| !region.core.contains(*p)).collect();
        let in_core =
            std::iter::once(false).chain(mesher.sources().iter().map(|&s| !shared[s as usize])).collect();
        let close = Unseen::new(region.near, region.domain, mesher.local());
        let used = vec![false; if stars { mesher.sources().len() + 1 } else { 0 }];
        Self { positions, close, in_core, owned, shared, doubtful: vec![], used, looks_around: false }
    }

    /// Sorts all records; then inserts what the doubtful ones ask for, until none is left. Returns how many cannot be
    /// certified.
    fn run(
        &mut self,
        mesher: &mut Mesher,
        region: &ChunkRegion,
        first: usize,
        late: &mut Option<Late<'a>>,
    ) -> Result<u64> {
        if mesher.is_empty() && !self.close.is_empty() {
            // No tetrahedron to tell what the core's points are joined to.
            return Ok(self.in_core.iter().filter(|&&c| c).count() as u64);
        }
        for first in (0..mesher.records()).step_by(u64::BITS as usize) {
            let mut inner = 0u64;
            for id in first..mesher.records().min(first + u64::BITS) {
                let Some((v, sphere)) = mesher.record(id) else { continue };
                let core = v.map(|v| self.in_core[v as usize]);
                // The usual cases: nothing of the core's, and nothing but that and certified.
                if core[0] & core[1] & core[2] & core[3] && self.close.quickly(sphere) {
                    inner |= 1 << (id - first);
                    self.use_corners(v);
                } else if core[0] | core[1] | core[2] | core[3] {
                    self.core_record(mesher, id, &mut None);
                }
            }
            self.owned.insert_word(first, inner);
        }
        self.settle(mesher, region, first, late)
    }

    /// Looks at the tetrahedra around those owned, all of which are certified: nothing that is inserted for their neighbours
    /// touches them.
    fn run_around(
        &mut self,
        mesher: &mut Mesher,
        region: &ChunkRegion,
        first: usize,
        late: &mut Option<Late<'a>>,
    ) -> Result<u64> {
        self.looks_around = true;
        for first in (0..mesher.records()).step_by(u64::BITS as usize) {
            for bit in each_bit(self.owned.others(first)).take_while(|bit| first + bit < mesher.records()) {
                self.record_around(mesher, first + bit, &mut None);
            }
        }
        self.settle(mesher, region, first, late)
    }

    fn settle(
        &mut self,
        mesher: &mut Mesher,
        region: &ChunkRegion,
        first: usize,
        late: &mut Option<Late<'a>>,
    ) -> Result<u64> {
        if self.doubtful.is_empty() {
            return Ok(0);
        }
        late.get_or_insert_with(|| {
            let far = Unseen::new(region.region, region.domain, mesher.local());
            Late::new(self.positions, first, region.region, far, mesher.local())
        });
        while !self.doubtful.is_empty() {
            for id in std::mem::take(&mut self.doubtful) {
                self.record(mesher, id, late);
            }
            let found = late.as_mut().expect("it was just made");
            if found.uncovered > 0 {
                return Ok(found.uncovered);
            }
            mesher.add(self.positions, found.take_wanted(), &mut self.doubtful)?;
            self.owned.grow(mesher.records());
            self.doubtful.sort_unstable();
            self.doubtful.dedup();
            self.in_core.resize(mesher.sources().len() + 1, false);
            if !self.used.is_empty() {
                self.used.resize(mesher.sources().len() + 1, false);
            }
        }
        Ok(0)
    }

    #[inline]
    fn record(&mut self, mesher: &Mesher, id: u32, late: &mut Option<Late<'_>>) {
        if self.looks_around {
            self.record_around(mesher, id, late);
        } else {
            self.core_record(mesher, id, late);
        }
    }

    /// Notes that an owned tetrahedron has these vertices.
    #[inline]
    fn use_corners(&mut self, v: [u32; 4]) {
        if !self.used.is_empty() {
            v.iter().for_each(|&v| self.used[v as usize] = true);
        }
    }

    #[inline]
    fn record_around(&mut self, mesher: &Mesher, id: u32, late: &mut Option<Late<'_>>) {
        let Some((v, sphere)) = mesher.record(id) else { return };
        if self.owned.has(id) || v.iter().all(|&v| !self.used[v as usize]) {
            return;
        }
        if let Some(k) = v.iter().position(|&v| v == 0) {
            return self.ghost(mesher, id, super::delaunay::face(k).map(|i| v[i]), late);
        }
        if !self.close.quickly(sphere) {
            let tet = v.map(|v| self.at(mesher, v));
            if !late.as_mut().is_some_and(|late| late.spares(&self.close, tet, sphere)) {
                self.doubtful.push(id);
                return;
            }
        }
        self.owned.insert_around(id);
    }

    fn core_record(&mut self, mesher: &Mesher, id: u32, late: &mut Option<Late<'_>>) {
        let Some((v, sphere)) = mesher.record(id) else { return };
        let core = v.map(|v| self.in_core[v as usize]);
        if core == [false; 4] {
            return;
        }
        if let Some(k) = v.iter().position(|&v| v == 0) {
            return self.ghost(mesher, id, super::delaunay::face(k).map(|i| v[i]), late);
        }
        let relation = if core == [true; 4] {
            Relation { owned: true, checked: true }
        } else {
            self.relation(mesher, v, core)
        };
        if relation.checked && !self.close.quickly(sphere) {
            let tet = v.map(|v| self.at(mesher, v));
            if !late.as_mut().is_some_and(|late| late.spares(&self.close, tet, sphere)) {
                self.doubtful.push(id);
                return;
            }
        }
        if relation.owned {
            self.owned.insert(id);
            self.use_corners(v);
        } else {
            // Those outside the core are shared already.
            v.iter().for_each(|&v| self.shared[mesher.source(v) as usize] = true);
        }
    }

    fn at(&self, mesher: &Mesher, vertex: u32) -> LatticePos {
        self.positions[mesher.source(vertex) as usize]
    }

    fn relation(&self, mesher: &Mesher, v: [u32; 4], core: [bool; 4]) -> Relation {
        let at = v.map(|v| self.at(mesher, v));
        let (mut least, mut greatest) = (0, 0);
        for i in 1..4 {
            least = if at[i] < at[least] { i } else { least };
            greatest = if at[i] > at[greatest] { i } else { greatest };
        }
        // Of four that differ, as the vertices of a tetrahedron do, three are less than the greatest.
        Relation { owned: core[least], checked: (0..4).any(|i| core[i] & (i != greatest)) }
    }

    /// A hull facet at a core vertex: it must be one of the whole mesh.
    fn ghost(&mut self, mesher: &Mesher, id: u32, facet: [u32; 3], late: &mut Option<Late<'_>>) {
        let facet = facet.map(|v| self.at(mesher, v));
        let settled =
            self.close.spares_beyond(facet) || late.as_mut().is_some_and(|late| late.spares_beyond(facet));
        if !settled {
            self.doubtful.push(id);
        }
    }
}

#[cfg(test)]
mod tests;
