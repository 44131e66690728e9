//! Numbers the corners and edges of tetrahedra of which nothing is known yet, in the order in which
//! they are met.
//!
//! An edge is found in a table of the numbers of its two ends.
//!
//! # Which edges has the patch alone?
//!
//! It has those alone around which its tetrahedra close a ring. Around an edge (a, b) each
//! tetrahedron has two further corners; in a ring every corner is met twice, by neighbours:
//!
//! ```text
//!      d───c          ring: (c,d) (d,e) (e,c)         fan: (c,d) (d,e)
//!       \ab|                c, d, e twice each             d twice, but c and e once
//!        \ |
//!         e
//! ```
//!
//! So the codes of the corners that are met are XORed: in a ring nothing is left. What a fan leaves
//! is the codes of its two ends, and of up to 16 codes none is the XOR of others: they are columns
//! of a parity check matrix of a code with distance 17 (Bose, Ray-Chaudhuri 1960, "On a class of
//! error correcting binary group codes"). So up to [`SURE`] tetrahedra, which are as many fans at
//! most, leave nothing if, and only if, they close rings; about edges with more, nothing is
//! claimed. All tetrahedra at a crossed edge are active, so a ring has them all: its sum is final,
//! and no table is asked for the edge.

use super::cells::{CellSource, Sorted};
use super::fours::Corner;
use super::patch::{ActiveTet, CORNERS, Corners, NO_EDGE, Patch};
use isospan_io::geom::PointId;
use isospan_mesh::mesh::tet::Tet;

/// Tetrahedra of a patch, at most.
const TETS: usize = 512;

/// Slots for the edges between the corners of a patch.
const SLOTS: usize = CORNERS * CORNERS;

/// Buffers, some hundred kilobytes, from the first tetrahedron on. One is enough for all surfaces
/// that a thread works on.
#[derive(Debug, Default)]
pub(super) struct Numbering {
    /// The number here of each corner of the source.
    here: Vec<u16>,
    /// The corners of the source, by their numbers here.
    corners: Vec<u32>,
    at: Vec<Corner>,
    slots: Vec<u16>,
    /// For each tetrahedron the codes of its corners.
    codes: Vec<u64>,
    rings: Vec<Ring>,
}

/// What is known of the tetrahedra at an edge.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ring {
    /// The codes of their corners, XORed.
    code: u64,
    count: u32,
}

/// A code for each corner: x, x³, x⁵, … x¹⁵ of its number in the field of 256 elements, a byte
/// each. As the two ends of a fan come together, their number is even, and 0 may have the code 0.
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

/// The most tetrahedra at an edge for which the codes surely show whether they close a ring.
const SURE: u32 = 8;

/// The product of two elements of the field of 256 elements: polynomials over {0, 1}, modulo x⁸ +
/// x⁴ + x³ + x² + 1.
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

/// The code of a tetrahedron.
#[inline(always)]
pub(super) fn code_of(corners: [u8; 4]) -> u64 {
    corners.iter().fold(0, |all, &c| all ^ CODES[usize::from(c)])
}

impl Ring {
    /// Counts a tetrahedron.
    #[inline(always)]
    pub(super) fn add(&mut self, code: u64) {
        self.code ^= code;
        self.count += 1;
    }

    /// Whether the tetrahedra around an edge are known to close a ring.
    #[inline(always)]
    pub(super) fn is_closed(&self, ends: [u8; 2]) -> bool {
        let [a, b] = ends.map(|corner| CODES[usize::from(corner)]);
        // An odd number of tetrahedra leaves the ends of the edge.
        self.code == (a ^ b) & u64::from(self.count & 1).wrapping_neg() && self.count <= SURE
    }
}

/// The slot of an edge.
#[inline(always)]
fn join([low, high]: [u8; 2]) -> u16 {
    u16::from(low) << 8 | u16::from(high)
}

/// A slot for each edge between the corners of a patch, empty.
fn empty_slots(slots: &mut Vec<u16>) -> &mut [u16; SLOTS] {
    slots.resize(SLOTS, NO_EDGE);
    slots.as_mut_slice().try_into().expect("it was made so long just now")
}

impl Numbering {
    /// Lists the first ones of some active tetrahedra, while there is room for their corners;
    /// returns how many these are.
    #[inline(always)]
    pub(super) fn list(
        &mut self,
        cells: &CellSource<'_>,
        isovalue: f32,
        sort: impl Fn(&Tet) -> Sorted,
        patch: &mut Patch,
    ) -> usize {
        self.here.resize(cells.ids.len().max(self.here.len()), NO_EDGE);
        self.corners.resize(CORNERS + 4, 0);
        self.codes.clear();
        let mut list = patch.list(cells.tets.len().min(TETS), empty_slots(&mut self.slots));
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
                let is_new = *slot == NO_EDGE;
                *slot = if is_new { count as u16 } else { *slot };
                *number = *slot as u8;
                self.corners[count] = corner;
                count += usize::from(is_new);
            }
            self.codes.push(code_of(corners));
            list.add(ActiveTet { corners, case: sorted.case }, |case, k| {
                join(case.edges[k].map(|corner| corners[usize::from(corner) % 4]))
            });
        }
        list.end();
        self.place(cells, count);
        self.find_rings(patch);
        self.codes.len()
    }

    /// Looks up the corners, and forgets their numbers.
    #[inline(always)]
    fn place(&mut self, cells: &CellSource<'_>, count: usize) {
        self.corners.truncate(count);
        self.at.clear();
        for &corner in &self.corners {
            self.here[corner as usize] = NO_EDGE;
            // At most 2^24: exact; unlike u32, i32 converts in one instruction.
            let [x, y, z] = cells.positions[corner as usize].map(|x| x as i32 as f32);
            self.at.push([x, y, z, cells.values[corner as usize]]);
        }
    }

    #[inline(always)]
    fn find_rings(&mut self, patch: &mut Patch) {
        self.rings.clear();
        self.rings.resize(patch.edges().len(), Ring::default());
        for &[t, e] in patch.uses() {
            self.rings[usize::from(e)].add(self.codes[usize::from(t)]);
        }
        patch.tell_alone(|edge, ends| self.rings[edge].is_closed(ends));
    }

    /// The corners of the patch that was listed last, and of its source.
    pub(super) fn corners<'a>(&'a self, cells: &'a CellSource<'a>) -> Numbered<'a> {
        Numbered { numbering: self, cells }
    }
}

/// Corners that were numbered.
pub(super) struct Numbered<'a> {
    numbering: &'a Numbering,
    cells: &'a CellSource<'a>,
}

impl Numbered<'_> {
    #[inline(always)]
    fn in_source(&self, corner: u8) -> usize {
        self.numbering.corners[usize::from(corner)] as usize
    }
}

impl Corners for Numbered<'_> {
    #[inline(always)]
    fn at(&self) -> &[Corner] {
        &self.numbering.at
    }

    #[inline(always)]
    fn number(&self, corner: u8) -> u32 {
        let corner = self.in_source(corner);
        self.cells.numbers.map_or(corner as u32, |numbers| numbers[corner])
    }

    #[inline(always)]
    fn shared(&self, ends: [u8; 2]) -> Option<(PointId, PointId)> {
        let [a, b] = ends.map(|corner| self.in_source(corner));
        (self.cells.shared[a] && self.cells.shared[b]).then(|| (self.cells.ids[a], self.cells.ids[b]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
