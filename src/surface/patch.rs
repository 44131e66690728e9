//! The surface in some tetrahedra that lie together, by itself, before it becomes part of its chunk's.
//!
//! Corners and edges get small numbers, in the order in which they are met, so that all that is looked at stays in the nearest
//! cache, and an edge is found in a table by its two ends:
//!
//! ```text
//!  tetrahedra ─▶ corners, numbered ─▶ crossed edges, numbered; triangles ─▶ gradients ─▶ their sums around edges
//! ```
//!
//! Each step is taken for all tetrahedra before the next one, without branches that depend on a single one.
//!
//! # Which edges has the patch alone?
//!
//! Those around which its tetrahedra close a ring. Around an edge (a, b) each tetrahedron has two further corners; in a
//! ring every corner is met twice, by neighbours:
//!
//! ```text
//!      d───c          ring: (c,d) (d,e) (e,c)         fan: (c,d) (d,e)
//!       \ab|                c, d, e twice each             d twice, but c and e once
//!        \ |
//!         e
//! ```
//!
//! So the codes of the corners that are met are XORed: in a ring nothing is left. What a fan leaves is the codes of its two ends, and
//! of up to 16 codes none is the XOR of others: they are columns of a parity check matrix of a code with distance 17 (Bose, Ray-Chaudhuri
//! 1960, "On a class of error correcting binary group codes"). So up to [`SURE`] tetrahedra, which are as many fans at most, leave
//! nothing if, and only if, they close rings; about edges with more, nothing is claimed. All tetrahedra at a crossed edge are active, so a
//! ring has them all: its sum is final, and no table is asked for the edge.

use super::cases::CASES;
use super::fours::{self, Corner, Gradient};
use super::marching_tets::{CellSource, Sorted};
use super::{Vertex, WorldMap};
use crate::exec::lanes::Four;
use crate::mesh::tet::Tet;

/// Corners of a patch, at most: their numbers have a byte.
const CORNERS: usize = 256;
/// Tetrahedra of a patch, at most.
const TETS: usize = 512;
/// No number.
const NONE: u16 = u16::MAX;

/// The buffers of a patch: some hundred kilobytes, from the first tetrahedron on. One is enough for all surfaces that a thread works on.
#[derive(Debug, Default)]
pub(crate) struct Patch {
    /// The number here of each corner of the source.
    here: Vec<u16>,
    /// The corners of the source, by their numbers here.
    corners: Vec<u32>,
    at: Vec<Corner>,
    tets: Vec<Member>,
    gradients: Vec<Gradient>,
    /// The number of each edge, by its ends; `NONE` between two patches.
    slots: Vec<u16>,
    edges: Edges,
    /// A tetrahedron and an edge of it, for each of them.
    uses: Vec<[u16; 2]>,
    triangles: Vec<[u16; 3]>,
}

/// A tetrahedron of a patch: its corners by their numbers here, in the order of their ids.
#[derive(Clone, Copy, Debug)]
struct Member {
    corners: [u8; 4],
    case: u8,
    /// The codes of the four corners, XORed.
    code: u64,
}

/// The crossed edges of a patch, in the order in which they are met.
#[derive(Debug, Default)]
struct Edges {
    /// The ends, as [`join`] has them.
    ends: Vec<u16>,
    /// Units of the sums per value × lattice step².
    units: Vec<f64>,
    /// The gradient around each edge, and the number of its tetrahedra.
    sums: Vec<[i64; 4]>,
    /// The codes of the corners of tetrahedra at each edge, XORed.
    rings: Vec<u64>,
}

/// A code for each corner: x, x³, x⁵, … x¹⁵ of its number in the field of 256 elements, a byte each. As the two ends of a fan come together,
/// their number is even, and 0 may have the code 0.
static CODES: [u64; CORNERS] = {
    let mut codes = [0; CORNERS];
    let mut x = 0;
    while x < CORNERS {
        let (square, mut power, mut k) = (product(x as u8, x as u8), x as u8, 0);
        while k < 8 {
            codes[x] |= (power as u64) << (8 * k);
            power = product(power, square);
            k += 1;
        }
        x += 1;
    }
    codes
};

/// Tetrahedra at an edge of which the codes are sure to tell whether they close a ring.
const SURE: i64 = 8;

/// Of two elements of the field of 256 elements: polynomials over {0, 1}, modulo x⁸ + x⁴ + x³ + x² + 1.
const fn product(mut a: u8, mut b: u8) -> u8 {
    let mut product = 0;
    while b != 0 {
        if b & 1 != 0 {
            product ^= a;
        }
        a = (a << 1) ^ (if a & 0x80 != 0 { 0x1d } else { 0 });
        b >>= 1;
    }
    product
}

/// An edge as one number.
#[inline(always)]
fn join([low, high]: [u8; 2]) -> u16 {
    u16::from(low) << 8 | u16::from(high)
}

#[inline(always)]
fn ends_of(edge: u16) -> [u8; 2] {
    edge.to_be_bytes()
}

impl Patch {
    /// The surface of the first ones of some active tetrahedra; tells how many.
    #[inline(always)]
    pub(super) fn make<W: Four>(
        &mut self,
        proof: W::Proof,
        cells: &CellSource<'_>,
        isovalue: f32,
        sort: impl Fn(&Tet) -> Sorted,
    ) -> usize {
        let taken = self.take(cells, isovalue, sort);
        self.number_edges();
        self.find_gradients::<W>(proof);
        self.find_units::<W>(proof);
        self.add_gradients();
        taken
    }

    /// Takes tetrahedra while there is room for their corners.
    #[inline(always)]
    fn take(&mut self, cells: &CellSource<'_>, isovalue: f32, sort: impl Fn(&Tet) -> Sorted) -> usize {
        self.here.resize(cells.ids.len().max(self.here.len()), NONE);
        self.corners.resize(CORNERS + 4, 0);
        self.tets.clear();
        let mut count = 0;
        for tet in cells.tets.iter().take(TETS) {
            if count > CORNERS - 4 {
                break;
            }
            let mut sorted = sort(tet);
            sorted.look(cells.values, isovalue);
            let mut corners = [0; 4];
            for (number, corner) in corners.iter_mut().zip(sorted.corners) {
                let slot = &mut self.here[corner as usize];
                let is_new = *slot == NONE;
                *slot = if is_new { count as u16 } else { *slot };
                *number = *slot as u8;
                self.corners[count] = corner;
                count += usize::from(is_new);
            }
            let code = corners.iter().fold(0, |all, &c| all ^ CODES[usize::from(c)]);
            self.tets.push(Member { corners, case: sorted.case, code });
        }
        self.at.clear();
        for &corner in &self.corners[..count] {
            self.here[corner as usize] = NONE;
            // At most 2^24; unlike u32, i32 converts in one instruction.
            let [x, y, z] = cells.positions[corner as usize];
            let value = f64::from(cells.values[corner as usize]);
            self.at.push([f64::from(x as i32), f64::from(y as i32), f64::from(z as i32), value]);
        }
        self.tets.len()
    }

    /// Numbers the crossed edges, and lists the triangles between their vertices. A second triangle, a fourth edge are
    /// written where there is none too, and ignored.
    #[inline(always)]
    fn number_edges(&mut self) {
        let most = 4 * self.tets.len();
        self.edges.ends.resize(most + 1, 0);
        self.uses.resize(most, [0; 2]);
        self.triangles.resize(most / 2, [0; 3]);
        self.slots.resize(CORNERS * CORNERS, NONE);
        let slots: &mut [u16; CORNERS * CORNERS] =
            self.slots.as_mut_slice().try_into().expect("it was made so long just now");
        let (mut edges, mut uses, mut triangles) = (0, 0, 0);
        for (t, tet) in (0..).zip(&self.tets) {
            let case = &CASES[usize::from(tet.case) % CASES.len()];
            let mut vertex = [0u16; 4];
            for (k, vertex) in vertex.iter_mut().enumerate() {
                let [low, high] = case.edges[k];
                let edge = join([tet.corners[usize::from(low) % 4], tet.corners[usize::from(high) % 4]]);
                let slot = &mut slots[usize::from(edge)];
                let is_new = *slot == NONE;
                *vertex = if is_new { edges as u16 } else { *slot };
                *slot = *vertex;
                self.edges.ends[edges] = edge;
                edges += usize::from(is_new);
                self.uses[uses + k] = [t, *vertex];
            }
            for (k, &[a, b, c]) in case.corners.iter().enumerate() {
                let vertex = |e: u8| vertex[usize::from(e) % 4];
                self.triangles[triangles + k] = [vertex(a), vertex(b), vertex(c)];
            }
            uses += 2 + usize::from(case.triangles);
            triangles += usize::from(case.triangles);
        }
        self.edges.ends.truncate(edges);
        self.uses.truncate(uses);
        self.triangles.truncate(triangles);
        self.edges.ends.iter().for_each(|&edge| slots[usize::from(edge)] = NONE);
    }

    #[inline(always)]
    fn find_gradients<W: Four>(&mut self, proof: W::Proof) {
        self.gradients.clear();
        for four in self.tets.chunks(4) {
            let mut corners = [[&self.at[0]; 4]; 4];
            let mut signs = [1.0; 4];
            for (t, tet) in four.iter().enumerate() {
                for (at, corner) in corners[t].iter_mut().zip(tet.corners) {
                    *at = &self.at[usize::from(corner)];
                }
                signs[t] = tet.sign();
            }
            self.gradients.extend_from_slice(&fours::gradients::<W>(proof, corners, &signs));
        }
    }

    #[inline(always)]
    fn find_units<W: Four>(&mut self, proof: W::Proof) {
        self.edges.units.clear();
        for four in self.edges.ends.chunks(4) {
            let mut ends = [self.at_ends(four[0]); 4];
            for (e, &edge) in four.iter().enumerate() {
                ends[e] = self.at_ends(edge);
            }
            self.edges.units.extend_from_slice(&fours::units::<W>(proof, ends));
        }
    }

    #[inline(always)]
    fn at_ends(&self, edge: u16) -> [&Corner; 2] {
        let [a, b] = ends_of(edge);
        [&self.at[usize::from(a)], &self.at[usize::from(b)]]
    }

    /// Adds to the sum of each edge the gradients of its tetrahedra, rounded to integers.
    #[inline(always)]
    fn add_gradients(&mut self) {
        let Edges { ends, units, sums, rings } = &mut self.edges;
        sums.clear();
        sums.resize(ends.len(), [0; 4]);
        rings.clear();
        rings.resize(ends.len(), 0);
        for &[t, e] in &self.uses {
            let (t, e) = (usize::from(t), usize::from(e));
            let (mut term, unit) = (self.gradients[t], units[e]);
            for x in &mut term {
                *x *= unit;
            }
            if term[3] > LONGEST || term[3].is_nan() {
                term = shorten(term);
            }
            term[3] = 1.0;
            let sum = &mut sums[e];
            for k in 0..4 {
                sum[k] = sum[k].wrapping_add(round(term[k]));
            }
            rings[e] ^= self.tets[t].code;
        }
    }

    /// Crossed edges.
    pub(super) fn edges(&self) -> usize {
        self.edges.ends.len()
    }

    /// Whether the tetrahedra around an edge are known to close a ring.
    #[inline(always)]
    pub(super) fn is_ring(&self, edge: usize) -> bool {
        let [a, b] = ends_of(self.edges.ends[edge]).map(|corner| CODES[usize::from(corner)]);
        let count = self.edges.sums[edge][3];
        // An odd number of tetrahedra leaves the ends of the edge.
        self.edges.rings[edge] == (a ^ b) & (count & 1).wrapping_neg() as u64 && count <= SURE
    }

    /// The ends of an edge, as corners of the source.
    #[inline(always)]
    pub(super) fn ends(&self, edge: usize) -> [u32; 2] {
        let [a, b] = ends_of(self.edges.ends[edge]);
        [self.corners[usize::from(a)], self.corners[usize::from(b)]]
    }

    /// The gradient around an edge.
    #[inline(always)]
    pub(super) fn gradient(&self, edge: usize) -> [i64; 3] {
        let [x, y, z, _] = self.edges.sums[edge];
        [x, y, z]
    }

    /// From the lower to the higher value of an edge.
    #[inline(always)]
    pub(super) fn up(&self, edge: usize) -> [f32; 3] {
        up(self.at_ends(self.edges.ends[edge]))
    }

    /// Appends the vertices of edges, without normals.
    #[inline(always)]
    pub(super) fn append_vertices<W: Four>(
        &self,
        proof: W::Proof,
        edges: &[u16],
        isovalue: f32,
        world: &WorldMap,
        out: &mut Vec<Vertex>,
    ) {
        for four in edges.chunks(4) {
            let mut ends = [self.at_ends(self.edges.ends[usize::from(four[0])]); 4];
            for (e, &edge) in four.iter().enumerate() {
                ends[e] = self.at_ends(self.edges.ends[usize::from(edge)]);
            }
            let positions = fours::crossings::<W>(proof, ends, isovalue, world);
            let mut vertices = [Vertex::default(); 4];
            for (vertex, position) in vertices.iter_mut().zip(positions) {
                vertex.position = position;
            }
            out.extend_from_slice(&vertices[..four.len()]);
        }
    }

    /// Triangles, of numbers of edges.
    pub(super) fn triangles(&self) -> &[[u16; 3]] {
        &self.triangles
    }

    pub(super) fn bytes(&self) -> usize {
        const PER_TET: usize = size_of::<Member>() + size_of::<Gradient>() + 4 * (4 + 2 + 8 + 32 + 8) + 12;
        (self.here.capacity() + self.slots.len()) * 2 + self.tets.capacity() * PER_TET
    }
}

/// From the lower to the higher value of an edge. At most 2^24 in size: exact.
#[inline(always)]
pub(super) fn up([a, b]: [&Corner; 2]) -> [f32; 3] {
    let (low, high) = if a[3] < b[3] { (a, b) } else { (b, a) };
    std::array::from_fn(|k| (high[k] - low[k]) as f32)
}

impl Member {
    /// -1 if the corners' order is an odd permutation of a positively oriented one.
    #[inline(always)]
    fn sign(&self) -> f64 {
        if self.case & super::cases::ODD != 0 { -1.0 } else { 1.0 }
    }
}

/// Longest component of a term; 2^12 such terms do not overflow.
const LONGEST: f64 = (1u64 << 50) as f64;

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

    /// Gauss's elimination of up to 16 codes at a time: each leaves something.
    #[test]
    fn no_corners_of_up_to_eight_fans_leave_nothing() {
        let mut state = 1u64;
        let mut draw = |n: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % n
        };
        for _ in 0..5000 {
            let mut corners: Vec<usize> = (1..CORNERS).collect();
            let mut basis: Vec<u64> = vec![];
            for _ in 0..2 * SURE {
                let mut code = CODES[corners.swap_remove(draw(corners.len()))];
                basis.iter().for_each(|&b| code = code.min(code ^ b));
                assert_ne!(code, 0);
                basis.push(code);
            }
        }
        assert_eq!(CODES[0], 0);
        assert!((1..=255).all(|x| (1..=255).filter(|&y| product(x, y) == 1).count() == 1), "a field");
    }
}
