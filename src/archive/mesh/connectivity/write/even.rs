//! Even stars, coded by the encoder with half of the geometry and none of the tables.
//!
//! The coder looks at gates four at a time, predicts what is behind each, and compares that with
//! the truth before it looks at the next. The encoder need not: it knows the truth. If the star is
//! even, each gate with an uncoded triangle behind it was a hit, and no other gate was. So gates,
//! hits and bits follow from the triangles alone. What remains is whether all hits are predicted.
//! That is checked afterwards, for many gates at once with all lanes in use. Gates with nothing
//! behind them (about two of five) need no check.
//!
//! Triangles that are not coded yet are bits of one word. A gate is the *side* on which the
//! triangle behind it is entered: four times that triangle's number and which of its three. One
//! number stands for all that is not there, one for all that was known before. A table has the side
//! of each directed edge. A triangle that is coded opens the gates across its two other edges,
//! except those to what is known; no gate need be closed. All this has no branch, for none could be
//! predicted.
//!
//! A star that is not even is coded in the usual way: it is mostly odd. Where most stars are odd
//! (many points on one sphere), only few are tried.

use super::super::link::{Gate, Gates, LANES, Link, Path};
use super::super::{Stars, Waiting, least_first};
use super::Truth;

/// Places of a link that is tried.
const PLACES: usize = 64;
/// The most of them that known triangles add.
const MORE_PLACES: usize = 8;
/// The most triangles, known triangles with edges of it, and bits of a star that is tried.
const MOST_HITS: usize = 60;
const MOST_KNOWN: usize = 60;
const MOST_BITS: u32 = 60;
/// Triangles for which there is space, a multiple of [`LANES`], and numbers for two that are none.
const ROOM: usize = 64;
/// More than all gates of a star.
const RING: usize = 256;
/// The side of a triangle that is not there, and of one that is known.
const NOTHING: u8 = 62 << 2;
const KNOWN: u8 = 63 << 2;

/// What is found out about a star.
pub(in crate::archive::mesh::connectivity) struct FoundGate {
    /// For each directed edge, a row of [`PLACES`] for each place that it is from, the side of the
    /// triangle that has it.
    sides: Box<[u8; PLACES * PLACES]>,
    /// The places of a triangle (a, b, c), a byte each: a, b, c, a, b. Entered on side i, it is
    /// that from byte i.
    triangles: [u64; ROOM],
    /// Gates that are open in the beginning, as the table has their edges.
    known: [u16; ROOM],
    /// Gates in the order in which they are opened: a triangle opens two at most.
    ring: [u8; RING],
    /// The gates that are hits if all are predicted, and the triangles behind them as they are
    /// entered.
    hits: [u8; ROOM],
    places: [u32; ROOM],
}

impl Default for FoundGate {
    fn default() -> Self {
        Self {
            sides: Box::new([NOTHING; PLACES * PLACES]),
            triangles: [0; ROOM],
            known: [0; ROOM],
            ring: [KNOWN; RING],
            hits: [0; ROOM],
            places: [0; ROOM],
        }
    }
}

/// The place of an edge in the table.
#[inline(always)]
fn edge(from: usize, to: usize) -> usize {
    (from * PLACES + to) % (PLACES * PLACES)
}

impl FoundGate {
    /// Gives what is known of the link a place, clears the table, and notes the gates that open:
    /// their number. `None` if they are too many, or those of no mesh.
    #[inline(always)]
    fn set_known(&mut self, stars: &mut Stars) -> Option<usize> {
        let rows = stars.link.len + MORE_PLACES;
        let (sides, known) = (&mut *self.sides, &mut self.known);
        sides.get_mut(..rows * PLACES)?.fill(NOTHING);
        let (link, cloud, waiting) = (&mut stars.link, &stars.cloud, &stars.waiting[..]);
        let (mut at, mut n, mut open, mut double) = (stars.heads[stars.v], 0, 0, 0);
        while let Some(&Waiting { others, next }) = waiting.get(usize::from(at)) {
            let from = link.place(cloud, others as u16)?;
            let to = link.place(cloud, (others >> 16) as u16)?;
            // A known triangle has the edge of the other direction.
            double |= std::mem::replace(&mut sides[edge(to, from)], KNOWN) ^ NOTHING;
            known[open % ROOM] = edge(from, to) as u16;
            open += usize::from(sides[edge(from, to)] != KNOWN);
            n += 1;
            at = next;
        }
        (n <= MOST_KNOWN && link.len <= rows && double == 0).then_some(open)
    }

    /// Finds out what is behind the gates as if all were predicted, given how many open and how
    /// many triangles there are. Gives the bits of the star and their number; `None` if not all
    /// triangles are found.
    #[inline(always)]
    fn follow(&mut self, known: usize, n: usize) -> Option<(u64, u32)> {
        let Self { sides, triangles, known: edges, ring, hits, places: behind, .. } = self;
        let (sides, triangles) = (&**sides, &*triangles);
        for (gate, &at) in ring.iter_mut().zip(&edges[..known]) {
            *gate = sides[usize::from(at) % (PLACES * PLACES)];
        }
        // A star that is not odd begins with a zero.
        let (mut bits, mut len) = (0u64, 1u32);
        let (mut head, mut tail, mut found) = (0, known, 0);
        // A bit for each triangle; what is behind a gate to nothing is never coded.
        const NEVER: u64 = 1 << (NOTHING >> 2);
        let mut uncoded = (1u64 << n) - 1;
        while head < tail {
            for k in 0..LANES {
                ring[(tail + k) % RING] = KNOWN;
            }
            let were_open = uncoded | NEVER;
            let four: [u8; LANES] = std::array::from_fn(|k| ring[(head + k) % RING]);
            head += LANES.min(tail - head);
            for side in four {
                let triangle = side >> 2;
                let hit = uncoded >> triangle & 1;
                uncoded ^= hit << triangle;
                let are_open = uncoded | NEVER;
                let places = (triangles[usize::from(triangle)] >> (8 * (side & 3))) as u32;
                let [c, d, w] = [0, 8, 16].map(|bit| (places >> bit) as usize % PLACES);
                for across in [sides[edge(c, w)], sides[edge(w, d)]] {
                    ring[tail % RING] = across;
                    tail += (are_open >> (across >> 2) & hit) as usize;
                }
                bits |= hit.wrapping_shl(len);
                len += (were_open >> triangle & 1) as u32;
                (hits[found % ROOM], behind[found % ROOM]) = (side, places);
                found += hit as usize;
            }
        }
        (uncoded == 0 && len <= MOST_BITS).then_some((bits, len))
    }

    /// Whether all that was found is predicted.
    #[inline(always)]
    fn are_predicted(&self, path: impl Path, link: &Link, n: usize) -> bool {
        let (mut gates, mut good) = (Gates::default(), true);
        for first in (0..n).step_by(LANES) {
            let four: [u32; LANES] = std::array::from_fn(|k| self.places[first + k]);
            for (gate, places) in gates.gates.iter_mut().zip(four) {
                *gate = (places as Gate).swap_bytes();
            }
            path.search(link, &mut gates);
            for (lane, places) in four.into_iter().enumerate() {
                let is_right = gates.apex(lane) == (places >> 16) as usize % 256;
                good &= is_right | (first + lane >= n);
            }
        }
        good
    }
}

/// Whether stars are worth a try.
#[derive(Default)]
pub(in crate::archive::mesh::connectivity) struct Luck {
    /// Stars to pass over, and how many they will be after the next try that fails.
    pass: u32,
    then: u32,
}

impl Luck {
    /// Tries no star, for as long as a test takes.
    #[cfg(test)]
    pub(in crate::archive::mesh::connectivity) fn none() -> Self {
        Self { pass: u32::MAX, then: 0 }
    }

    fn tries(&mut self) -> bool {
        let tries = self.pass == 0;
        self.pass = self.pass.saturating_sub(1);
        tries
    }

    fn learn(&mut self, is_even: bool) {
        self.then = if is_even { self.then / 2 } else { (2 * self.then + 1).min(63) };
        self.pass = if is_even { 0 } else { self.then / 2 };
    }
}

impl Truth {
    /// Codes the star that begins, if it is even, and gives the number of its triangles. If it is
    /// not, nothing is coded and no gate is open.
    #[inline(always)]
    pub(super) fn tell_even(&mut self, path: impl Path, stars: &mut Stars) -> Option<usize> {
        if !self.luck.tries() {
            return None;
        }
        let found = self.find(path, stars);
        self.luck.learn(found.is_some());
        let (n, bits, len) = found?;
        // If the input is no mesh, more may have been coded than there is.
        if self.at + n > self.coded.len() || stars.waiters + n > stars.waiting.len() {
            return None;
        }
        let first = len.min(32);
        self.bits.put((bits & 0xffff_ffff) as u32, first);
        self.bits.put((bits >> first) as u32, len - first);
        self.tell_found(stars, n);
        Some(n)
    }

    /// The number of the star's triangles, its bits and their number. `None` if it is not even.
    #[inline(always)]
    fn find(&mut self, path: impl Path, stars: &mut Stars) -> Option<(usize, u64, u32)> {
        let known = self.found.set_known(stars)?;
        let n = self.set_triangles(stars)?;
        let (bits, len) = self.found.follow(known, n)?;
        self.found.are_predicted(path, &stars.link, n).then_some((n, bits, len))
    }

    /// Numbers the triangles of the star. `None` if they are too many, or no mesh, or have a vertex
    /// without a place.
    #[inline(always)]
    fn set_triangles(&mut self, stars: &Stars) -> Option<usize> {
        let (v, link) = (stars.v, &stars.link);
        let FoundGate { sides, triangles, .. } = &mut self.found;
        let sides = &mut **sides;
        let (mut n, mut places, mut double) = (0, 0, 0);
        for &[first, a, b, c] in &self.tets[self.rest..] {
            if usize::from(first) != v {
                break;
            }
            let [a, b, c] = [a, b, c].map(|w| link.place_if_any(w));
            places |= a | b | c;
            let [a, b, c] = [a, b, c].map(|place| place as usize % PLACES);
            for (i, (from, to)) in (0..).zip([(a, b), (b, c), (c, a)]) {
                let side = (n << 2) as u8 | i;
                double |= std::mem::replace(&mut sides[edge(from, to)], side) ^ NOTHING;
            }
            let [a, b, c] = [a, b, c].map(|place| place as u64);
            triangles[n % ROOM] = a | b << 8 | c << 16 | a << 24 | b << 32;
            n += 1;
        }
        (n <= MOST_HITS && double == 0 && places < PLACES as u32).then_some(n)
    }

    /// Codes the triangles that were found.
    #[inline(always)]
    fn tell_found(&mut self, stars: &mut Stars, n: usize) {
        let (ids, hits) = (&self.ids[..], &self.found.hits[..n]);
        let tets = &self.tets[self.rest..self.rest + n];
        let coded = &mut self.coded[self.at..self.at + n];
        self.rest += n;
        self.at += n;
        let (heads, waiting) = (&mut stars.heads[..], &mut stars.waiting[stars.waiters..stars.waiters + n]);
        for k in 0..n {
            let side = hits[k];
            let [v, a, b, c] = tets[usize::from(side >> 2)].map(u64::from);
            let turn = 16 * (side & 3);
            let all = a | b << 16 | c << 32;
            let all = all >> turn | all << (48 - turn);
            let [c, d, w] = [0, 16, 32].map(|bit| (all >> bit) as u16);
            coded[k] = [v as u16, c, d, w].map(|i| ids[usize::from(i)]);
            let (least, others) = least_first([c, d, w]);
            let head = &mut heads[usize::from(least).min(stars.own)];
            let next = std::mem::replace(head, (stars.waiters + k) as u16);
            waiting[k] = Waiting { others, next };
        }
        stars.waiters += n;
    }
}
