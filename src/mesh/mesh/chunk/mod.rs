//! Meshing a domain chunk by chunk, so that the union of the chunks is exactly the mesh of the
//! whole.
//!
//! A chunk meshes the points of its **region** (core and halo) and keeps the tetrahedra
//! it **owns**: those whose least vertex (x, then y, then z) lies in its core. Cores tile the
//! domain, so each tetrahedron has one owner. The halo must be wide enough that what is kept is
//! what the whole mesh would have there; `certify.rs` says when that is proven.
//!
//! ```text
//! ┌───────────────┐  region: its outer points are inserted only where needed
//! │ ┌───────────┐ │  near: its points are all inserted
//! │ │  ┌─────┐  │ │  certified: circumsphere holds no point that is not inserted
//! │ │  │core │  │ │  owned: least vertex in core
//! │ │  └─────┘  │ │  shared vertex: has a tetrahedron that another chunk owns
//! ```
//!
//! A halo wide enough for the largest sphere would be three spacings wide, nearly a third of all
//! points at 250 000 owned ones. But few spheres are large. So a narrow halo is inserted with the
//! core; the tetrahedra whose spheres leave it are looked at again with the outer points at hand
//! (`late.rs`), and those found in a sphere are inserted, until each tetrahedron is certified. When
//! a sphere leaves even the region the caller gathers a larger one ([`Widen`]): its points are
//! outer points like the others, and what is meshed stays. So a few large spheres, as there are
//! between the planes of a hyperbolic cross, cost a few insertions; of 10.5 M such points in chunks
//! of 250 000, two chunks of three need a wider region.
//!
//! For 2.2 M points in 11 chunks, a tenth more points are inserted than owned (8 to 13 % by chunk;
//! 16 to 25 % with the tetrahedra around), and hardly any late. An inner halo a quarter of a
//! spacing narrower takes Hammersley points 2 % less time, but Halton points, the cross and the
//! regular grid 2 to 3 % more; half a spacing narrower gains nothing, three quarters lose 8 %.
//!
//! Evenly spread points need no halo meshed: `stars.rs` makes the same mesh of them in less time.
//!
//! Time of insertion: that of the kernel for the points inserted, plus about a tenth for ownership,
//! certification and output order.

use super::certify::Unseen;
use super::delaunay::Kernel;
use super::late::{Finding, Late, Outer};
use super::mesher::Mesher;
use super::owned::{Owned, each_bit};
pub use super::region::{Border, ChunkMesh, ChunkRegion};
use super::tet::Tet;
use isospan_io::error::{Error, Result};
use isospan_io::geom::curve::Order;
use isospan_io::geom::{Lattice, LatticeBox, LatticePos};

/// The result of meshing a chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChunkOutcome {
    /// The chunk's part of the mesh, proven.
    Done(ChunkMesh),
    /// Points outside the region could matter, and no wider one was given.
    WidenHalo {
        /// Tetrahedra and hull facets at core vertices that are not certified; if there is no
        /// tetrahedron, the core's points.
        uncertified: u64,
    },
}

/// How a chunk is meshed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Manner {
    /// Also the tetrahedra around those owned ([`TetList::around`](super::list::TetList::around)),
    /// so that all tetrahedra at each vertex of an owned one are known. That takes a wider halo, by
    /// one tetrahedron and its sphere.
    pub around: bool,
    /// Whether the points are as dense everywhere, no more of them than by chance on a sphere, and
    /// those of the core come first: then the chunk is meshed star by star, to the same mesh in
    /// less time.
    pub even: bool,
}

/// Gives a wider region: appends the positions between the old one and the new one, and returns
/// that; `None` where there is no room for it.
pub type Widen<'a> = dyn FnMut(&mut Vec<LatticePos>) -> Result<Option<LatticeBox>> + 'a;

/// Tetrahedralizes the `positions` of a region and keeps what the chunk owns. `positions` must hold
/// every point of the domain that lies in the region, those in `near` first and otherwise in any
/// order; of equal positions only the first becomes a vertex. A region equal to the domain is
/// always [`ChunkOutcome::Done`].
///
/// # Errors
/// [`Error::Usage`] when the boxes are not nested, a position lies outside the region, or
/// [`Mesher::delaunay`] refuses.
pub fn mesh_chunk(
    mesher: &mut Mesher,
    boxes: &ChunkRegion,
    positions: &[LatticePos],
    order: &Order,
) -> Result<ChunkOutcome> {
    mesh_widening(mesher, boxes, &mut positions.to_vec(), order, Manner::default(), &mut |_| Ok(None))
}

/// As [`mesh_chunk`], but where a sphere leaves the region, `widen` is asked for a wider one. Only
/// those of its points are inserted that a tetrahedron needs.
///
/// # Errors
/// As [`mesh_chunk`], and those of `widen`.
pub fn mesh_widening(
    mesher: &mut Mesher,
    boxes: &ChunkRegion,
    positions: &mut Vec<LatticePos>,
    order: &Order,
    manner: Manner,
    widen: &mut Widen<'_>,
) -> Result<ChunkOutcome> {
    let (mut boxes, mut first) = (*boxes, check(boxes, positions)?);
    if manner.even {
        let mesh = mesher.stars.mesh(&mut mesher.kernel, &boxes, positions, order, manner.around);
        if let Some(mesh) = mesh? {
            return Ok(ChunkOutcome::Done(mesh));
        }
    }
    let kernel = &mut mesher.kernel;
    kernel.delaunay_of_first(positions, first, order)?;
    while kernel.is_empty() && boxes.near != boxes.domain {
        // The inner points span no volume: nothing to add the others to.
        if boxes.near == boxes.region {
            // No tetrahedron shows what the core's points are joined to.
            let uncertified = positions.iter().filter(|p| boxes.core.contains(**p)).count() as u64;
            if uncertified == 0 {
                break;
            }
            if !boxes.widen(positions, widen)? {
                return Ok(ChunkOutcome::WidenHalo { uncertified });
            }
        }
        (boxes.near, first) = (boxes.region, positions.len());
        kernel.delaunay(positions, order)?;
    }
    let mut owned = std::mem::take(&mut mesher.owned);
    owned.clear(kernel.records());
    let mut sorter = Sorter::new(kernel, boxes, positions, owned, manner.around, first, widen);
    let mut uncertified = sorter.run(kernel);
    if manner.around && matches!(uncertified, Ok(0)) {
        uncertified = sorter.run_around(kernel);
    }
    let Sorter { mut owned, shared, .. } = sorter;
    let outcome = uncertified.map(|n| match n {
        0 => ChunkOutcome::Done(ChunkMesh { tets: owned.take(kernel, shared.len()), shared }),
        uncertified => ChunkOutcome::WidenHalo { uncertified },
    });
    mesher.owned = owned;
    outcome
}

/// The tetrahedra around those that a chunk owns, if the border of the latter is known. They are
/// those that [`mesh_widening`] finds for evenly spread points, in canonical order. The time is
/// that of these tetrahedra, not of the whole chunk. `positions` are as there. `None` where that
/// cannot be done: then the chunk has to be meshed.
///
/// # Errors
/// As [`mesh_chunk`].
pub fn mesh_around(
    mesher: &mut Mesher,
    boxes: &ChunkRegion,
    positions: &[LatticePos],
    order: &Order,
    border: Border<'_>,
) -> Result<Option<Vec<Tet>>> {
    check(boxes, positions)?;
    mesher.stars.around(&mut mesher.kernel, boxes, positions, order, border)
}

/// The positions from `first` on, which are not inserted.
fn outer(positions: &[LatticePos], first: usize) -> impl Iterator<Item = Outer> {
    (first as u32..).zip(&positions[first..]).map(|(index, &at)| Outer { at, index })
}

impl ChunkRegion {
    /// Widens the region, and returns whether that was possible.
    fn widen(&mut self, positions: &mut Vec<LatticePos>, widen: &mut Widen<'_>) -> Result<bool> {
        let (before, known) = (self.region, positions.len());
        let Some(wider) = widen(positions)? else { return Ok(false) };
        self.region = wider;
        self.check()?;
        if before.intersect(&wider) != before || before == wider {
            return Err(Error::usage(format!("a region {before:?} is not widened to {wider:?}")));
        }
        let fits = |p: &LatticePos| wider.contains(*p) && p.iter().all(|&c| c <= Lattice::LARGEST);
        match positions[known..].iter().find(|p| before.contains(**p) || !fits(p)) {
            Some(p) => Err(Error::usage(format!(
                "position {p:?} lies outside what its chunk's region was widened by"
            ))),
            None => Ok(true),
        }
    }
}

/// The number of positions that are inserted at once.
fn check(boxes: &ChunkRegion, positions: &[LatticePos]) -> Result<usize> {
    boxes.check()?;
    let ChunkRegion { near, region, .. } = boxes;
    let first = positions.iter().take_while(|p| near.contains(**p)).count();
    match positions[first..].iter().find(|p| near.contains(**p) || !region.contains(**p)) {
        Some(p) if near.contains(*p) => {
            Err(Error::usage(format!("position {p:?} must come before those outside the inner box")))
        }
        Some(p) => Err(Error::usage(format!("position {p:?} lies outside its chunk's region"))),
        None => Ok(first),
    }
}

/// Sorts the kernel's records into owned, foreign and doubtful ones.
struct Sorter<'a> {
    boxes: ChunkRegion,
    positions: &'a mut Vec<LatticePos>,
    /// What lies outside the points inserted at once.
    close: Unseen,
    /// For each vertex of the kernel, whether it lies in the core; infinity does not.
    in_core: Vec<bool>,
    owned: Owned,
    shared: Vec<bool>,
    /// Records to be looked at again, and whether each record is among them.
    doubtful: Vec<u32>,
    waits: Vec<bool>,
    /// For each vertex of the kernel, whether an owned tetrahedron has it. Empty if those around
    /// are not asked for.
    used: Vec<bool>,
    /// Whether those around are looked for: the owned ones are known.
    looks_around: bool,
    /// Positions from here on are not inserted with the rest.
    first: usize,
    /// Those positions, as soon as they are needed.
    late: Option<Late>,
    widen: &'a mut Widen<'a>,
}

impl<'a> Sorter<'a> {
    fn new(
        kernel: &Kernel,
        boxes: ChunkRegion,
        positions: &'a mut Vec<LatticePos>,
        owned: Owned,
        stars: bool,
        first: usize,
        widen: &'a mut Widen<'a>,
    ) -> Self {
        let shared: Vec<bool> = positions.iter().map(|p| !boxes.core.contains(*p)).collect();
        let in_core =
            std::iter::once(false).chain(kernel.sources().iter().map(|&s| !shared[s as usize])).collect();
        Self {
            close: Unseen::new(boxes.near, boxes.domain, kernel.local()),
            boxes,
            positions,
            in_core,
            owned,
            shared,
            doubtful: vec![],
            waits: vec![],
            used: vec![false; if stars { kernel.sources().len() + 1 } else { 0 }],
            looks_around: false,
            first,
            late: None,
            widen,
        }
    }

    /// Sorts all records; then inserts what the doubtful ones ask for, until none is left. Returns
    /// how many cannot be certified.
    fn run(&mut self, kernel: &mut Kernel) -> Result<u64> {
        for first in (0..kernel.records()).step_by(u64::BITS as usize) {
            let mut inner = 0u64;
            for id in first..kernel.records().min(first + u64::BITS) {
                let Some((v, sphere)) = kernel.record(id) else { continue };
                let core = v.map(|v| self.in_core[v as usize]);
                // The usual cases: nothing of the core's, and nothing but that and certified.
                if core[0] & core[1] & core[2] & core[3] && self.close.quickly(sphere) {
                    inner |= 1 << (id - first);
                    self.use_corners(v);
                } else if core[0] | core[1] | core[2] | core[3] {
                    self.first_look(kernel, id);
                }
            }
            self.owned.insert_word(first, inner);
        }
        self.settle(kernel)
    }

    /// Looks at the tetrahedra around those owned. All of the owned ones are certified, so nothing
    /// that is inserted for their neighbours touches them.
    fn run_around(&mut self, kernel: &mut Kernel) -> Result<u64> {
        self.looks_around = true;
        for first in (0..kernel.records()).step_by(u64::BITS as usize) {
            for bit in each_bit(self.owned.others(first)).take_while(|bit| first + bit < kernel.records()) {
                self.first_look(kernel, first + bit);
            }
        }
        self.settle(kernel)
    }

    #[inline]
    fn first_look(&mut self, kernel: &Kernel, id: u32) {
        if !matches!(self.look(kernel, id, None), Finding::Certified) {
            self.doubtful.push(id);
        }
    }

    /// Looks at the doubtful records until none is left, with the points at hand that are not
    /// inserted.
    fn settle(&mut self, kernel: &mut Kernel) -> Result<u64> {
        if self.doubtful.is_empty() {
            return Ok(0);
        }
        let mut late = match self.late.take() {
            Some(late) => late,
            None => self.look_from(kernel, outer(self.positions, self.first).collect()),
        };
        self.waits.clear();
        let (mut wanted, mut uncovered) = (vec![], vec![]);
        loop {
            for id in std::mem::take(&mut self.doubtful) {
                if let Some(waits) = self.waits.get_mut(id as usize) {
                    *waits = false;
                }
                match self.look(kernel, id, Some(&late)) {
                    Finding::Certified => {}
                    Finding::Uncovered => uncovered.push(id),
                    Finding::Holds(point) => wanted.push((point, id)),
                }
            }
            if !wanted.is_empty() {
                self.add(kernel, &mut late, &mut wanted)?;
                continue;
            }
            if uncovered.is_empty() {
                break;
            }
            let known = self.positions.len();
            if !self.boxes.widen(self.positions, self.widen)? {
                return Ok(uncovered.len() as u64);
            }
            let mut out = late.points();
            out.extend(outer(self.positions, known));
            late = self.look_from(kernel, out);
            self.shared.resize(self.positions.len(), true);
            self.doubtful.append(&mut uncovered);
        }
        self.late = Some(late);
        Ok(0)
    }

    /// Inserts points, each with a record that asks for it. Those that are new are to be looked at,
    /// and those that asked, for a point may just touch a sphere.
    fn add(&mut self, kernel: &mut Kernel, late: &mut Late, wanted: &mut Vec<(Outer, u32)>) -> Result<()> {
        self.look_again(wanted.iter().map(|(_, asking)| *asking));
        // Neighbours one after the other, each once.
        wanted.sort_unstable_by_key(|(point, id)| (kernel.key(point.at), point.at, point.index, *id));
        wanted.dedup_by_key(|(point, _)| point.at);
        for (point, asking) in wanted.drain(..) {
            if !kernel.has_room(point.at) {
                kernel.make_room(self.positions)?;
                *late = self.look_from(kernel, late.points());
            }
            late.take(point.at);
            self.look_again(kernel.add(point.at, point.index, asking)?.iter().copied());
            self.in_core.push(false);
            if !self.used.is_empty() {
                self.used.push(false);
            }
        }
        self.owned.grow(kernel.records());
        Ok(())
    }

    /// Notes records that are to be looked at, each once.
    fn look_again(&mut self, records: impl Iterator<Item = u32>) {
        for id in records {
            if self.waits.len() <= id as usize {
                self.waits.resize(id as usize + 1, false);
            }
            if !std::mem::replace(&mut self.waits[id as usize], true) {
                self.doubtful.push(id);
            }
        }
    }

    /// Gets ready to look at spheres in the coordinates that the kernel has now; `out` are the
    /// positions that are not inserted.
    fn look_from(&mut self, kernel: &Kernel, out: Vec<Outer>) -> Late {
        let (ChunkRegion { near, region, domain, .. }, local) = (self.boxes, kernel.local());
        self.close = Unseen::new(near, domain, local);
        Late::new(out, region, domain, local)
    }

    #[inline]
    fn look(&mut self, kernel: &Kernel, id: u32, late: Option<&Late>) -> Finding {
        if self.looks_around {
            self.look_around(kernel, id, late)
        } else {
            self.look_at_core(kernel, id, late)
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
    fn look_around(&mut self, kernel: &Kernel, id: u32, late: Option<&Late>) -> Finding {
        let Some((v, sphere)) = kernel.record(id) else { return Finding::Certified };
        if self.owned.has(id) || v.iter().all(|&v| !self.used[v as usize]) {
            return Finding::Certified;
        }
        if let Some(k) = v.iter().position(|&v| v == 0) {
            return self.look_beyond(kernel, super::delaunay::face(k).map(|i| v[i]), late);
        }
        let found = self.look_in(kernel, v, sphere, late);
        if matches!(found, Finding::Certified) {
            self.owned.insert_around(id);
        }
        found
    }

    fn look_at_core(&mut self, kernel: &Kernel, id: u32, late: Option<&Late>) -> Finding {
        let Some((v, sphere)) = kernel.record(id) else { return Finding::Certified };
        let core = v.map(|v| self.in_core[v as usize]);
        if core == [false; 4] {
            return Finding::Certified;
        }
        if let Some(k) = v.iter().position(|&v| v == 0) {
            return self.look_beyond(kernel, super::delaunay::face(k).map(|i| v[i]), late);
        }
        let found = self.look_in(kernel, v, sphere, late);
        if !matches!(found, Finding::Certified) {
            return found;
        }
        if core == [true; 4] || self.is_owned(kernel, v, core) {
            self.owned.insert(id);
            self.use_corners(v);
        } else {
            // Points outside the core are shared already.
            v.iter().for_each(|&v| self.shared[kernel.source(v) as usize] = true);
        }
        Finding::Certified
    }

    /// Looks for a point in a tetrahedron's sphere that is not inserted; without `late`, an
    /// uncertain case counts as uncovered.
    #[inline]
    fn look_in(&self, kernel: &Kernel, v: [u32; 4], sphere: &[f64; 4], late: Option<&Late>) -> Finding {
        if self.close.quickly(sphere) {
            return Finding::Certified;
        }
        late.map_or(Finding::Uncovered, |late| {
            late.look_in(&self.close, || v.map(|v| self.at(kernel, v)), sphere)
        })
    }

    /// What lies beyond a hull facet at a core vertex: it must be one of the whole mesh.
    fn look_beyond(&self, kernel: &Kernel, facet: [u32; 3], late: Option<&Late>) -> Finding {
        let facet = facet.map(|v| self.at(kernel, v));
        if self.close.spares_beyond(facet) {
            return Finding::Certified;
        }
        late.map_or(Finding::Uncovered, |late| late.look_beyond(facet))
    }

    fn at(&self, kernel: &Kernel, vertex: u32) -> LatticePos {
        self.positions[kernel.source(vertex) as usize]
    }

    /// Whether the least vertex lies in the core.
    fn is_owned(&self, kernel: &Kernel, v: [u32; 4], core: [bool; 4]) -> bool {
        let least = (0..4).min_by_key(|&i| self.at(kernel, v[i]));
        least.is_some_and(|i| core[i])
    }
}

#[cfg(test)]
mod tests;
