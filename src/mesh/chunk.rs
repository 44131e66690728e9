//! Meshing a domain chunk by chunk, so that the union of the chunks is exactly the mesh of the whole.
//!
//! A chunk meshes the points of its **region** (core and halo) and keeps the tetrahedra it **owns**: those whose least vertex (x,
//! then y, then z) lies in its core. Cores tile the domain, so each tetrahedron has one owner. The halo must be wide enough
//! that what is kept is what the whole mesh would have there; `certify.rs` says when that is proven. If it is not,
//! the answer is [`ChunkOutcome::WidenHalo`], and the caller gathers a larger region.
//!
//! ```text
//! ┌─────────────┐  region
//! │  ┌───────┐  │  certified: circumsphere holds no unseen point
//! │  │ core  │  │  owned: least vertex in core
//! │  └───────┘  │  shared vertex: has a tetrahedron that another chunk owns
//! └─────────────┘
//! ```
//!
//! Time: that of the kernel for the points of the region, plus about a fifth for ownership, certification and output order.

use super::certify::Unseen;
use super::delaunay::Mesher;
use super::tet::Tet;
use crate::error::{Error, Result};
use crate::geom::curve::Order;
use crate::geom::{LatticeBox, LatticePos};

/// The boxes of a chunk; all half-open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkRegion {
    /// What the chunk owns.
    pub core: LatticeBox,
    /// Core and halo, clipped to the domain: where the chunk knows all points.
    pub region: LatticeBox,
    /// The whole domain: no point lies outside it.
    pub domain: LatticeBox,
}

/// The tetrahedra of a chunk.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChunkMesh {
    /// Owned tetrahedra: vertex numbers are indices into the chunk's positions, positively oriented, least number first,
    /// least of the other three second; sorted.
    pub tets: Vec<Tet>,
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
/// domain that lies in the region, in any order; of equal positions only the first becomes a vertex. A region equal to the domain is always
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
    check(region, positions)?;
    mesher.delaunay(positions, order)?;
    let unseen = Unseen::new(region, mesher.local());
    let mut owned = std::mem::take(&mut mesher.owned);
    owned.clear();
    let (outcome, owned) = Sorter::new(mesher, region, positions, owned).run(&unseen);
    mesher.owned = owned;
    Ok(outcome)
}

fn check(boxes: &ChunkRegion, positions: &[LatticePos]) -> Result<()> {
    let nested = |inner: &LatticeBox, outer: &LatticeBox| inner.intersect(outer) == *inner;
    if !nested(&boxes.core, &boxes.region) || !nested(&boxes.region, &boxes.domain) {
        return Err(Error::usage(format!(
            "the core, region and domain of a chunk are not nested: {boxes:?}"
        )));
    }
    match positions.iter().find(|p| !boxes.region.contains(**p)) {
        Some(p) => Err(Error::usage(format!("position {p:?} lies outside its chunk's region"))),
        None => Ok(()),
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
    mesher: &'a Mesher,
    positions: &'a [LatticePos],
    /// By vertex of the mesher: whether it lies in the core; infinity does not.
    in_core: Vec<bool>,
    /// In the order of the mesher's records.
    owned: Vec<Tet>,
    shared: Vec<bool>,
    uncertified: u64,
}

impl<'a> Sorter<'a> {
    fn new(mesher: &'a Mesher, region: &ChunkRegion, positions: &'a [LatticePos], owned: Vec<Tet>) -> Self {
        let shared: Vec<bool> = positions.iter().map(|p| !region.core.contains(*p)).collect();
        let in_core =
            std::iter::once(false).chain(mesher.sources().iter().map(|&s| !shared[s as usize])).collect();
        Self { mesher, positions, in_core, owned, shared, uncertified: 0 }
    }

    /// The outcome, and the scratch back.
    fn run(mut self, unseen: &Unseen) -> (ChunkOutcome, Vec<Tet>) {
        if self.mesher.is_empty() && !unseen.is_empty() {
            // No tetrahedron to tell what the core's points are joined to.
            self.uncertified = self.in_core.iter().filter(|&&c| c).count() as u64;
        }
        let mesher = self.mesher;
        mesher.for_each_record(|v, sphere| self.record(unseen, v, sphere));
        if self.uncertified > 0 {
            return (ChunkOutcome::WidenHalo { uncertified: self.uncertified }, self.owned);
        }
        let tets = sorted(&self.owned, self.positions.len());
        (ChunkOutcome::Done(ChunkMesh { tets, shared: self.shared }), self.owned)
    }

    #[inline]
    fn record(&mut self, unseen: &Unseen, v: [u32; 4], sphere: &[f64; 4]) {
        let core = v.map(|v| self.in_core[v as usize]);
        if core == [false; 4] {
            return;
        }
        if let Some(k) = v.iter().position(|&v| v == 0) {
            return self.ghost(unseen, v, k);
        }
        let relation =
            if core == [true; 4] { Relation { owned: true, checked: true } } else { self.relation(v, core) };
        if relation.checked && !unseen.spares(|| v.map(|v| self.at(v)), sphere) {
            self.uncertified += 1;
        }
        if relation.owned {
            self.owned.push(canonical(v.map(|v| self.mesher.source(v))));
        } else {
            // Those outside the core are shared already.
            v.iter().for_each(|&v| self.shared[self.mesher.source(v) as usize] = true);
        }
    }

    fn at(&self, vertex: u32) -> LatticePos {
        self.positions[self.mesher.source(vertex) as usize]
    }

    fn relation(&self, v: [u32; 4], core: [bool; 4]) -> Relation {
        let mut by_position: [(LatticePos, bool); 4] = std::array::from_fn(|i| (self.at(v[i]), core[i]));
        by_position.sort_unstable();
        Relation { owned: by_position[0].1, checked: by_position[..3].iter().any(|p| p.1) }
    }

    /// A hull facet at a core vertex: it must be one of the whole mesh.
    fn ghost(&mut self, unseen: &Unseen, v: [u32; 4], infinite: usize) {
        // Infinity to the last place by an even permutation: a point beyond makes it positive.
        let [a, b, c] = super::delaunay::face(infinite).map(|k| self.at(v[k]));
        if !unseen.spares_beyond([a, b, c]) {
            self.uncertified += 1;
        }
    }
}

/// The even permutation with the least number first and the least of the rest second.
#[inline]
fn canonical([a, b, c, d]: Tet) -> Tet {
    let least = a.min(b).min(c.min(d));
    let [p, q, r] = match least {
        l if l == a => [b, c, d],
        l if l == b => [a, d, c],
        l if l == c => [d, a, b],
        _ => [c, b, a],
    };
    match q.min(r) {
        l if p < l => [least, p, q, r],
        l if l == q => [least, q, r, p],
        _ => [least, r, p, q],
    }
}

/// Sorts canonical tetrahedra of `vertices` vertices: a bucket for each first vertex, then the few in it.
fn sorted(tets: &[Tet], vertices: usize) -> Vec<Tet> {
    let mut end = vec![0u32; vertices + 1];
    for t in tets {
        end[t[0] as usize + 1] += 1;
    }
    for v in 0..vertices {
        end[v + 1] += end[v];
    }
    let mut all = vec![[0; 4]; tets.len()];
    for &t in tets {
        let place = &mut end[t[0] as usize];
        all[*place as usize] = t;
        *place += 1;
    }
    let mut start = 0;
    for &end in &end[..vertices] {
        all[start..end as usize].sort_unstable();
        start = end as usize;
    }
    all
}

#[cfg(test)]
mod tests;
