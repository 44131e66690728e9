//! The surface in some tetrahedra that lie together, made by itself before it becomes part of its
//! chunk's surface.
//!
//! Corners and edges have small numbers, so that all that is looked at stays in the nearest cache:
//!
//! ```text
//!  tetrahedra ─▶ corners, numbered ─▶ crossed edges, numbered; triangles ─▶ gradients ─▶ their sums around edges
//! ```
//!
//! Each step is taken for all tetrahedra before the next one, without branches that depend on a
//! single one. The numbers are found while tetrahedra are looked at ([`super::numbering`]), or are
//! known from before ([`super::numbered`]); what follows is here.

use super::cases::{CASES, Case, ODD};
use super::fours::{self, Corner, Gradient};
use crate::surface::model::Vertex;
use crate::surface::world_map::WorldMap;
use isospan_io::geom::PointId;
use isospan_mesh::simd::F64x4s;

/// Corners of a patch, at most: their numbers have a byte.
pub(super) const CORNERS: usize = 256;

/// Tetrahedra and their crossed edges: buffers, some ten kilobytes.
#[derive(Debug, Default)]
pub(super) struct Patch {
    tets: Vec<ActiveTet>,
    gradients: Vec<Gradient>,
    edges: Edges,
    /// A tetrahedron and an edge of it, for each of them.
    uses: Vec<[u16; 2]>,
    triangles: Vec<[u16; 3]>,
}

/// An active tetrahedron: its corners in the order of their ids.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ActiveTet {
    pub(super) corners: [u8; 4],
    /// The mask of corners inside, and [`ODD`].
    pub(super) case: u8,
}

/// The crossed edges of a patch, in the order in which they are met.
#[derive(Debug, Default)]
struct Edges {
    ends: Vec<[u8; 2]>,
    /// Where the number of each is noted while they are listed.
    slots: Vec<u16>,
    /// Whether the patch is known to have all tetrahedra around it.
    alone: Vec<bool>,
    /// Units of the sums per value × lattice step².
    units: Vec<f64>,
    /// The gradient around each edge; what is last means nothing.
    sums: Vec<[i64; 4]>,
}

/// What is known of the corners of a patch.
pub(super) trait Corners {
    /// Their positions and values.
    fn at(&self) -> &[Corner];
    /// The number that a corner has in its chunk.
    fn number(&self, corner: u8) -> u32;
    /// The ids of two corners, if other chunks may have both.
    fn shared(&self, ends: [u8; 2]) -> Option<(PointId, PointId)>;
}

impl Patch {
    /// Empties the patch for up to `tets` tetrahedra. Each of their edges has a slot for its
    /// number, [`NO_EDGE`] before and after.
    #[inline(always)]
    pub(super) fn list<'a, const SLOTS: usize>(
        &'a mut self,
        tets: usize,
        slots: &'a mut [u16; SLOTS],
    ) -> Listing<'a, SLOTS> {
        let most = 4 * tets;
        self.tets.clear();
        self.edges.ends.resize(most + 1, [0; 2]);
        self.edges.slots.resize(most + 1, 0);
        self.uses.resize(most, [0; 2]);
        self.triangles.resize(most / 2, [0; 3]);
        Listing { patch: self, slots, edges: 0, uses: 0, triangles: 0 }
    }

    /// Records which edges have all their tetrahedra in the patch, by their numbers and ends.
    #[inline(always)]
    pub(super) fn tell_alone(&mut self, is_alone: impl Fn(usize, [u8; 2]) -> bool) {
        let Edges { alone, ends, .. } = &mut self.edges;
        alone.clear();
        alone.extend(ends.iter().enumerate().map(|(edge, &ends)| is_alone(edge, ends)));
    }

    /// The same, by their slots.
    #[inline(always)]
    pub(super) fn alone_are(&mut self, is_alone: impl Fn(u16) -> bool) {
        let Edges { alone, slots, .. } = &mut self.edges;
        alone.clear();
        alone.extend(slots.iter().map(|&slot| is_alone(slot)));
    }

    /// A tetrahedron and an edge of it, for each of them.
    #[inline(always)]
    pub(super) fn uses(&self) -> &[[u16; 2]] {
        &self.uses
    }

    /// Sums up the gradients around edges.
    #[inline(always)]
    pub(super) fn sum_gradients<W: F64x4s>(&mut self, token: W::Token, at: &[Corner]) {
        self.find_gradients::<W>(token, at);
        self.find_units::<W>(token, at);
        self.add_gradients();
    }

    #[inline(always)]
    fn find_gradients<W: F64x4s>(&mut self, token: W::Token, at: &[Corner]) {
        self.gradients.clear();
        for four in self.tets.chunks(4) {
            let mut corners = [[&at[0]; 4]; 4];
            let mut signs = [1.0; 4];
            for (t, tet) in four.iter().enumerate() {
                for (to, corner) in corners[t].iter_mut().zip(tet.corners) {
                    *to = &at[usize::from(corner)];
                }
                signs[t] = tet.sign();
            }
            self.gradients.extend_from_slice(&fours::gradients::<W>(token, corners, &signs));
        }
    }

    #[inline(always)]
    fn find_units<W: F64x4s>(&mut self, token: W::Token, at: &[Corner]) {
        self.edges.units.clear();
        for four in self.edges.ends.chunks(4) {
            let mut ends = [at_ends(at, four[0]); 4];
            for (to, &edge) in ends.iter_mut().zip(four) {
                *to = at_ends(at, edge);
            }
            self.edges.units.extend_from_slice(&fours::units::<W>(token, ends));
        }
    }

    /// Adds to the sum of each edge the gradients of its tetrahedra, rounded to integers.
    #[inline(always)]
    fn add_gradients(&mut self) {
        let Self { gradients, uses, edges: Edges { ends, units, sums, .. }, .. } = self;
        sums.clear();
        sums.resize(ends.len(), [0; 4]);
        let largest = units.iter().fold(0.0, |a: f64, &b| a.max(b));
        // Nearly always no term is too long, and none of them need be looked at.
        if gradients.iter().all(|g| g[3] * largest <= LONGEST) {
            for &[t, e] in &*uses {
                let (gradient, unit) = (gradients[usize::from(t)], units[usize::from(e)]);
                add(&mut sums[usize::from(e)], gradient.map(|x| x * unit));
            }
            return;
        }
        for &[t, e] in &*uses {
            let (gradient, unit) = (gradients[usize::from(t)], units[usize::from(e)]);
            add_term(&mut sums[usize::from(e)], gradient.map(|x| x * unit));
        }
    }

    /// The ends of the crossed edges.
    #[inline(always)]
    pub(super) fn edges(&self) -> &[[u8; 2]] {
        &self.edges.ends
    }

    /// Whether the patch is known to have all tetrahedra around an edge.
    #[inline(always)]
    pub(super) fn is_alone(&self, edge: usize) -> bool {
        self.edges.alone[edge]
    }

    /// The gradient around an edge.
    #[inline(always)]
    pub(super) fn gradient(&self, edge: usize) -> [i64; 3] {
        let [x, y, z, _] = self.edges.sums[edge];
        [x, y, z]
    }

    /// From the lower to the higher value of an edge.
    #[inline(always)]
    pub(super) fn up(&self, at: &[Corner], edge: usize) -> [f32; 3] {
        up(at_ends(at, self.edges.ends[edge]))
    }

    /// Appends the vertices of edges, without normals.
    #[inline(always)]
    pub(super) fn append_vertices<W: F64x4s>(
        &self,
        token: W::Token,
        at: &[Corner],
        edges: &[u16],
        isovalue: f32,
        world: &WorldMap,
        out: &mut Vec<Vertex>,
    ) {
        for four in edges.chunks(4) {
            let mut ends = [at_ends(at, self.edges.ends[usize::from(four[0])]); 4];
            for (to, &edge) in ends.iter_mut().zip(four) {
                *to = at_ends(at, self.edges.ends[usize::from(edge)]);
            }
            let positions = fours::crossings::<W>(token, ends, isovalue, world);
            let vertices = positions.map(|position| Vertex { position, normal: [0.0; 3] });
            match four.len() {
                4 => out.extend(vertices),
                n => out.extend_from_slice(&vertices[..n]),
            }
        }
    }

    /// Triangles, of numbers of edges.
    pub(super) fn triangles(&self) -> &[[u16; 3]] {
        &self.triangles
    }
}

#[inline(always)]
fn at_ends(at: &[Corner], [a, b]: [u8; 2]) -> [&Corner; 2] {
    [&at[usize::from(a)], &at[usize::from(b)]]
}

/// A patch while its tetrahedra are listed.
pub(super) struct Listing<'a, const SLOTS: usize> {
    patch: &'a mut Patch,
    slots: &'a mut [u16; SLOTS],
    edges: usize,
    uses: usize,
    triangles: usize,
}

impl<const SLOTS: usize> Listing<'_, SLOTS> {
    /// Lists the next tetrahedron, and the triangles in it. `slot_of` gives the slot of the edge at
    /// a place of its case.
    ///
    /// A second triangle and a fourth edge are written even where there is none, and then ignored.
    #[inline(always)]
    pub(super) fn add(&mut self, member: ActiveTet, slot_of: impl Fn(&Case, usize) -> u16) {
        let Patch { tets, edges, uses, triangles, .. } = &mut *self.patch;
        let case = &CASES[usize::from(member.case) % CASES.len()];
        let tet = tets.len() as u16;
        tets.push(member);
        let mut vertex = [0u16; 4];
        for (k, vertex) in vertex.iter_mut().enumerate() {
            let at = slot_of(case, k);
            let slot = &mut self.slots[usize::from(at) % SLOTS];
            let is_new = *slot == NO_EDGE;
            *vertex = if is_new { self.edges as u16 } else { *slot };
            *slot = *vertex;
            edges.ends[self.edges] = case.edges[k].map(|corner| member.corners[usize::from(corner) % 4]);
            edges.slots[self.edges] = at;
            self.edges += usize::from(is_new);
            uses[self.uses + k] = [tet, *vertex];
        }
        for (k, corners) in case.corners.iter().enumerate() {
            triangles[self.triangles + k] = corners.map(|e| vertex[usize::from(e) % 4]);
        }
        self.uses += 2 + usize::from(case.triangles);
        self.triangles += usize::from(case.triangles);
    }

    /// Ends the list.
    #[inline(always)]
    pub(super) fn end(self) {
        let Patch { edges, uses, triangles, .. } = self.patch;
        edges.ends.truncate(self.edges);
        edges.slots.truncate(self.edges);
        uses.truncate(self.uses);
        triangles.truncate(self.triangles);
        edges.slots.iter().for_each(|&at| self.slots[usize::from(at) % SLOTS] = NO_EDGE);
    }
}

/// No number of an edge.
pub(super) const NO_EDGE: u16 = u16::MAX;

/// From the lower to the higher value of an edge. At most 2^24 in size: exact.
#[inline(always)]
pub(super) fn up([a, b]: [&Corner; 2]) -> [f32; 3] {
    let (low, high) = if a[3] < b[3] { (a, b) } else { (b, a) };
    std::array::from_fn(|k| high[k] - low[k])
}

impl ActiveTet {
    /// -1 if the corners' order is an odd permutation of a positively oriented one.
    #[inline(always)]
    fn sign(&self) -> f64 {
        if self.case & ODD != 0 { -1.0 } else { 1.0 }
    }
}

/// Longest component of a term; 2^12 such terms do not overflow.
const LONGEST: f64 = (1u64 << 50) as f64;

#[inline(always)]
fn add(sum: &mut [i64; 4], term: Gradient) {
    for k in 0..4 {
        sum[k] = sum[k].wrapping_add(round(term[k]));
    }
}

/// Adds a term of any length.
#[inline(always)]
pub(super) fn add_term(sum: &mut [i64; 4], term: Gradient) {
    add(sum, if term[3] <= LONGEST { term } else { shorten(term) });
}

/// A term too long to add, shortened by a power of two; nothing for one that is infinite or NaN.
#[cold]
fn shorten([x, y, z, _]: Gradient) -> Gradient {
    let mut term = [x, y, z, 0.0];
    if !term.iter().all(|x| x.is_finite()) {
        return [0.0; 4];
    }
    while term.iter().any(|x| x.abs() > LONGEST) {
        term = term.map(|x| x * 0.5);
    }
    term
}

/// The nearest integer, for |x| <= 2^50: adding 1.5 · 2^52 leaves it in the low bits.
#[inline(always)]
fn round(x: f64) -> i64 {
    const MAGIC: f64 = (3u64 << 51) as f64;
    ((x + MAGIC).to_bits() as i64).wrapping_sub(MAGIC.to_bits() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_to_the_nearest() {
        for x in [0.0, 0.4, -0.4, 0.6, -0.6, 1e9 + 0.3, -1e9 - 0.3, LONGEST, -LONGEST, 12345.75] {
            assert_eq!(round(x), f64::round_ties_even(x) as i64, "{x}");
        }
        assert_eq!(shorten([f64::INFINITY, 0.0, 1.0, 0.0]), [0.0; 4]);
        assert_eq!(shorten([2.0 * LONGEST, 8.0, -2.0, 0.0]), [LONGEST, 4.0, -1.0, 0.0]);
    }
}
