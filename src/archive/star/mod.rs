//! The star coder of a tetrahedron block: vertex after vertex, the tetrahedra of which it is the smallest vertex.
//!
//! The tetrahedra around a vertex v, seen from v, are the triangles of a sphere, the *link* of v. Those that have a vertex smaller
//! than v were told before; the coder tells the others, growing the known part of the link a triangle at a time.
//!
//! ```text
//!      ┄┄┄ c              Each edge of the boundary of what is known is a *gate* to an unknown triangle. The mesh is a Delaunay
//!     known ╲    · w      tetrahedralization of known points: behind the gate cd is the point in front of it whose sphere with
//!            ╲  ·         v, c and d is empty, and it is found by looking at the points nearby. So what is written is, mostly, one
//!      ┄┄┄┄┄┄ d           cheap bit: *as foretold*.
//! ```
//!
//! It is no triangulation anew: no conflict is searched for, nothing is exact. Where the bit is not set, the gate is mostly a *border*:
//! the tetrahedron behind it is in another block (of smaller vertices), or there is none. But the foretelling may be wrong, and is where
//! more than four points lie on a sphere, or where rounding decides. Then the star is *odd*, as a bit before it tells, and the truth follows:
//!
//! * the rank of the apex among the points in front, in the order in which the growing sphere meets them;
//! * its number among the vertices of the block, if it is too far away to have a rank.
//!
//! A star is odd too where its link has several pieces: each begins at an edge (c, d) that is told by ranks, of c by distance, of d by
//! the size of the circle.
//!
//! So a block has two streams. Bits of stars and gates, and the differences of the other vertices' numbers, are there as they are ([`bits`]): to read
//! some costs a shift. What odd stars have is rare, and goes through a range coder ([`range`](super::range)) whose probabilities
//! begin with [`first_odds`] and learn within the block.
//!
//! A triangle (c, d, w) of the link of v is the tetrahedron (v, c, d, w). Its face (c, d, w) is a gate in the link of the smallest of
//! them, which comes later; two such gates of opposite direction are the two sides of one face and vanish.
//!
//! A link is a dozen points and a matrix of flags. Gates are looked at in the order in which they were opened, four at a time, and the bits
//! of four are read at once: a bit a gate is more than its entropy (about 0.7), but whatever waits for one bit after another, and branches
//! on it, takes longer than all the geometry.

mod bits;
mod link;
mod odds;
#[cfg(target_arch = "x86_64")]
mod simd;

use self::bits::{BitReader, BitWriter};
use self::link::{Cloud, GATES, Gate, Gates, LANES, Link, MOST, NOBODY, Path, Plain, VERTICES, ends, gate};
use self::odds::first_odds;
use super::range::{Decoder, Encoder, Odds};
use super::wire::{Cursor, Malformed, put_varint};
use crate::geom::LatticePos;
use crate::mesh::tet::Tet;
use std::ops::Range;

/// The most tetrahedra of a block of this codec.
pub(crate) const LARGEST_STARS: usize = 1 << 14;
/// Own vertices and others are fewer each.
pub(crate) const LARGEST_LIST: u32 = 1 << 11;
/// The most larger vertices that a link may have, those that are only nearby included.
pub(crate) const LARGEST_LINK: usize = 124;

/// A local vertex number; [`NONE`] is none.
type Local = u16;
const NONE: u16 = u16::MAX;

/// Ranks that are told as such; this one says that a number follows.
const FAR_RANK: usize = 8;

// Where the odds of each decision are.
/// Whether there is a triangle behind a gate that is not as foretold, where one and where none was.
const WRONG: usize = 0;
const GATE_RANK: usize = WRONG + 2;
/// Whether there is another piece, without and with a gate before.
const MORE: usize = GATE_RANK + FAR_RANK;
const C_RANK: usize = MORE + 2;
const D_RANK: usize = C_RANK + FAR_RANK;
const DECISIONS: usize = D_RANK + FAR_RANK;

/// The two ends of the coder. The encoder writes the truth that it is given; the decoder ignores it and gives what it
/// reads. So one function is both.
trait End {
    /// Whether this is the encoder: what costs time to find out is asked only then.
    const KNOWS: bool;
    #[must_use]
    fn bit(&mut self, odds: &mut [Odds; DECISIONS], at: usize, truth: bool) -> bool;
    /// A number of at most 16 bits.
    fn raw(&mut self, bits: u32, truth: u32) -> u32;
    /// The star of a vertex begins, with what is known of its link. `None` if a directed edge has two triangles.
    fn star(&mut self, v: Local, link: &Link) -> Option<()>;
    /// Of some gates that were looked at those behind which is what was foretold, a bit each, which is told now; and whether there is a triangle
    /// behind any other that is open then.
    fn hits(&mut self, link: &Link, gates: &Gates) -> (u32, bool);
    /// The apex of the untold triangle behind a gate, which is told now; [`NONE`] if there is none.
    fn apex(&mut self, link: &Link, gate: Gate) -> Local;
    /// Whether the star has anything but foretold triangles behind gates that are known.
    fn is_odd(&mut self) -> bool;
    /// Whether triangles of the star are not told yet.
    fn is_untold(&self) -> bool;
    /// The star is told.
    fn end_star(&mut self);
    /// Their vertices, three each.
    fn untold(&self, link: &Link, to: &mut Vec<[Local; 3]>);
    /// A tetrahedron that is told now.
    fn tell(&mut self, tet: [Local; 4]);
}

/// A face that waits for its smallest vertex to come: the other two.
#[derive(Clone, Copy, Default)]
struct Waiting {
    /// The second one 2^16 times.
    others: u32,
    next: u16,
}

/// What both ends know.
struct Stars {
    own: usize,
    vertices: usize,
    v: usize,
    cloud: Cloud,
    link: Link,
    gates: Gates,
    odds: [Odds; DECISIONS],
    /// For each own vertex its first entry of `waiting`; one more for all others.
    heads: Vec<u16>,
    waiting: Vec<Waiting>,
    waiters: usize,
    untold: Vec<[Local; 3]>,
    /// Whether to go without vector code: for tests.
    plain: bool,
}

impl Default for Stars {
    fn default() -> Self {
        Self {
            own: 0,
            vertices: 0,
            v: 0,
            cloud: Cloud::default(),
            link: Link::default(),
            gates: Gates::default(),
            odds: first_odds(),
            heads: vec![],
            waiting: vec![],
            waiters: 0,
            untold: vec![],
            plain: false,
        }
    }
}

impl Stars {
    /// Prepares for a block.
    fn set(&mut self, own: usize, positions: &[LatticePos], size: u8, tets: usize) {
        (self.own, self.vertices) = (own, positions.len());
        self.cloud.set(positions, size);
        self.link.clear();
        self.heads.clear();
        self.heads.resize(own + 1, NONE);
        self.waiting.resize(self.waiting.len().max(tets), Waiting::default());
        self.waiters = 0;
    }

    /// Begins the star of the next vertex with what is known of its link.
    #[inline(always)]
    fn begin(&mut self, path: impl Path, v: usize) -> Option<()> {
        self.v = v;
        self.link.begin(path, &self.cloud, v);
        let mut at = self.heads[v];
        while let Some(&Waiting { others, next }) = self.waiting.get(usize::from(at)) {
            let (a, b) = (others as Local, (others >> 16) as Local);
            let (a, b) = (self.link.place(&self.cloud, a)?, self.link.place(&self.cloud, b)?);
            self.link.meet(gate(a, b));
            at = next;
        }
        Some(())
    }

    /// Tells what is behind some gates, and gives the number of triangles. `None` if what is read cannot be.
    #[inline(always)]
    fn pass<E: End>(&mut self, path: impl Path, end: &mut E) -> Option<usize> {
        let (mut hits, is_wrong) = end.hits(&self.link, &self.gates);
        let mut told = hits.count_ones() as usize;
        while hits != 0 {
            let lane = hits.trailing_zeros() as usize;
            hits &= hits - 1;
            self.attach(end, self.gates.gates[lane % LANES], self.gates.apex(lane))?;
        }
        if is_wrong {
            told += path.apart(
                #[inline(always)]
                || self.correct(end),
            )?;
        }
        // Behind those that are still open is nothing.
        for lane in 0..LANES {
            self.link.close(self.gates.gates[lane]);
        }
        Some(told)
    }

    /// Tells the triangles that were not foretold, and gives their number.
    #[inline(always)]
    fn correct<E: End>(&mut self, end: &mut E) -> Option<usize> {
        let mut told = 0;
        for lane in 0..self.gates.len {
            let gate = self.gates.gates[lane % LANES];
            if !self.link.is_open(gate) {
                continue;
            }
            let truth = if E::KNOWS { end.apex(&self.link, gate) } else { NONE };
            let nobody = self.gates.apex(lane) == NOBODY;
            if end.bit(&mut self.odds, WRONG + usize::from(nobody), truth != NONE) {
                let scores = self.link.scores(gate);
                // The first is the one that was foretold.
                let w = self.ranked(end, &scores, 1, GATE_RANK, truth)?;
                self.attach(end, gate, w)?;
                told += 1;
            }
        }
        Some(told)
    }

    /// Tells a vertex by its rank, at least `least`, or else by its number. `None` if what is read is none.
    #[inline(always)]
    fn ranked<E: End>(
        &mut self,
        end: &mut E,
        scores: &[f32; MOST],
        least: usize,
        odds: usize,
        truth: Local,
    ) -> Option<usize> {
        let known =
            if E::KNOWS { self.link.find(truth).and_then(|i| self.link.rank(scores, i)) } else { None };
        let known = known.filter(|&r| r >= least).unwrap_or(FAR_RANK);
        let told = |k: &usize| end.bit(&mut self.odds, odds + k, *k == known);
        if let Some(rank) = (least..FAR_RANK).find(told) {
            return self.link.nth(scores, rank);
        }
        // Numbers begin behind the vertex whose star this is.
        let first = self.v + 1;
        let bits = usize::BITS - (self.vertices - first).leading_zeros();
        let number = end.raw(bits, u32::from(truth).wrapping_sub(first as u32) & ((1 << bits) - 1));
        let w = first + number as usize;
        if w >= self.vertices { None } else { self.link.place(&self.cloud, w as Local) }
    }

    /// A triangle on a gate, which it closes. `None` if that is not open, or the vertex is none or of the gate.
    #[inline(always)]
    fn attach<E: End>(&mut self, end: &mut E, on: Gate, w: usize) -> Option<()> {
        let [c, d] = ends(on);
        if !self.link.is_open(on) | (w == c) | (w == d) | (w == NOBODY) {
            return None;
        }
        self.link.close(on);
        self.link.meet(gate(c, w));
        self.link.meet(gate(w, d));
        let [c, d, w] = [c, d, w].map(|i| self.link.id[i % MOST]);
        end.tell([self.v as Local, c, d, w]);
        // The least, and the other two by shifting (c, d, w, c): no branch, for none could be foretold.
        let least = c.min(d).min(w);
        let turn = if least == c {
            16
        } else if least == d {
            32
        } else {
            0
        };
        let [c, d, w] = [c, d, w].map(u64::from);
        let others = ((c | d << 16 | w << 32 | c << 48) >> turn) as u32;
        let head = self.heads.get_mut(usize::from(least).min(self.own))?;
        let next = std::mem::replace(head, self.waiters as u16);
        *self.waiting.get_mut(self.waiters)? = Waiting { others, next };
        self.waiters += 1;
        Some(())
    }

    /// Tells whether there is another piece, and an edge of it.
    #[inline(always)]
    fn piece<E: End>(&mut self, path: impl Path, end: &mut E, before: bool) -> Option<bool> {
        if !end.is_odd() || !end.bit(&mut self.odds, MORE + usize::from(before), end.is_untold()) {
            return Some(false);
        }
        path.apart(
            #[inline(always)]
            || self.edge_of_piece(end),
        )?;
        Some(true)
    }

    #[inline(always)]
    fn edge_of_piece<E: End>(&mut self, end: &mut E) -> Option<()> {
        self.untold.clear();
        end.untold(&self.link, &mut self.untold);
        let scores = self.link.by_distance();
        let truth = self.least_of(&scores, None);
        let c = self.ranked(end, &scores, 0, C_RANK, truth)?;
        let scores = self.link.by_circle(c);
        let truth = self.least_of(&scores, Some(truth));
        let d = self.ranked(end, &scores, 0, D_RANK, truth).filter(|&d| d != c)?;
        self.link.open(c, d);
        self.link.open(d, c);
        Some(())
    }

    /// Of the untold triangles (those with a vertex) the vertex of least score; the decoder, which has none, gets any.
    fn least_of(&self, scores: &[f32; MOST], with: Option<Local>) -> Local {
        let score = |&w: &Local| (self.link.find(w).map_or(f32::INFINITY, |i| scores[i]), w);
        let triangles = self.untold.iter().filter(|t| with.is_none_or(|w| t.contains(&w)));
        let vertices = triangles.flatten().copied().filter(|&w| Some(w) != with);
        vertices.min_by(|a, b| score(a).partial_cmp(&score(b)).expect("scores are no NaN")).unwrap_or(0)
    }

    /// Tells all stars of a block of `tets` tetrahedra. `None` if what is read cannot be one, or a link is too large.
    fn tell<E: End>(&mut self, end: &mut E, tets: usize) -> Option<()> {
        let told = self.tell_as_may_be(end, tets);
        if told.is_none() {
            self.link.give_up();
        }
        told
    }

    fn tell_as_may_be<E: End>(&mut self, end: &mut E, tets: usize) -> Option<()> {
        #[cfg(target_arch = "x86_64")]
        if let Some(vectors) = simd::Vectors::find()
            && !self.plain
        {
            return vectors.run(
                #[inline(always)]
                || self.tell_on(vectors, end, tets),
            );
        }
        self.tell_on(Plain, end, tets)
    }

    #[inline(always)]
    fn tell_on<E: End>(&mut self, path: impl Path, end: &mut E, tets: usize) -> Option<()> {
        let mut left = tets;
        for v in 0..self.own {
            self.begin(path, v)?;
            end.star(v as Local, &self.link)?;
            let (mut any, mut before) = (false, left + 1);
            loop {
                if self.link.is_crowded() {
                    return None;
                }
                if self.link.foretell(path, &mut self.gates) {
                    if self.gates.len > 0 {
                        any = true;
                        left = left.checked_sub(self.pass(path, end)?)?;
                    }
                    continue;
                }
                // A piece has a triangle.
                if before == left {
                    return None;
                }
                before = left;
                if !self.piece(path, end, any)? {
                    break end.end_star();
                }
            }
        }
        (left == 0).then_some(())
    }
}

/// Encodes blocks of one chunk.
#[derive(Default)]
pub(crate) struct Writer {
    stars: Stars,
    truth: Truth,
    /// For each vertex of the chunk its local number in the last block that has it, and 2^16 times that block's number.
    numbers: Vec<u32>,
    block: u16,
    others: Vec<u32>,
    positions: Vec<LatticePos>,
}

/// The encoder's end: what it knows, and what it writes.
struct Truth {
    coder: Encoder,
    bits: BitWriter,
    /// Of the star: numbers of gates that were looked at together, with their hits; and whether there is more to it.
    hits: Vec<(u8, u8)>,
    is_odd: bool,
    tets: Vec<[Local; 4]>,
    /// Where the tetrahedra of the stars to come begin.
    rest: usize,
    star: Range<usize>,
    /// Triangles of the star that are not told.
    untold: usize,
    /// For each directed edge between places of the link the third place of the triangle that has it and is not told.
    thirds: Box<[u8; GATES]>,
    /// Triangles that are not told and had a vertex without a place when the star began.
    loose: Vec<[Local; 3]>,
    /// The vertices by local number, and the tetrahedra as they are told: as they will be decoded.
    ids: Vec<u32>,
    told: Vec<Tet>,
    /// For the test that makes `odds.rs`: of each decision how often, and how often so.
    #[cfg(test)]
    counts: std::collections::BTreeMap<usize, [f64; 2]>,
}

/// No third place.
const TOLD: u8 = NOBODY as u8;

impl Default for Truth {
    fn default() -> Self {
        Self {
            coder: Encoder::default(),
            bits: BitWriter::default(),
            hits: vec![],
            is_odd: false,
            tets: vec![],
            rest: 0,
            star: 0..0,
            untold: 0,
            thirds: Box::new([TOLD; GATES]),
            loose: vec![],
            ids: vec![],
            told: vec![],
            #[cfg(test)]
            counts: Default::default(),
        }
    }
}

/// Of so many edges in a hundred the longer end is within the radius of a neighbourhood.
const WITHIN: usize = 99;

impl Writer {
    /// Encodes canonical tetrahedra, ascending by their first vertices, given where all vertices are; false, with nothing written, if the
    /// block is none for this coder: empty, too large, no mesh, or with too large a star.
    pub(crate) fn encode(&mut self, tets: &[Tet], positions: &[LatticePos], out: &mut Vec<u8>) -> bool {
        let (Some(first), Some(last)) = (tets.first(), tets.last()) else { return false };
        let (first, own) = (first[0], last[0] - first[0] + 1);
        if tets.len() > LARGEST_STARS
            || own >= LARGEST_LIST
            || !self.localise(tets, first, own, positions.len())
        {
            return false;
        }
        let ids = (first..first + own).chain(self.others.iter().copied());
        self.truth.ids.clear();
        self.truth.ids.extend(ids);
        self.truth.told.clear();
        self.positions.clear();
        self.positions.extend(self.truth.ids.iter().map(|&v| positions[v as usize]));
        let size = self.size();
        let n = self.others.len() as u32;
        let stars = &mut self.stars;
        stars.odds = first_odds();
        stars.set(own as usize, &self.positions, size, tets.len());
        self.truth.begin();
        let mut least = first + own;
        for &v in &self.others {
            self.truth.bits.put_number(v - least);
            least = v + 1;
        }
        if stars.tell(&mut self.truth, tets.len()).is_none() {
            self.truth.give_up();
            return false;
        }
        for number in [first, own, n, tets.len() as u32] {
            put_varint(out, u64::from(number));
        }
        out.push(size);
        self.truth.bits.finish(out);
        self.truth.coder.finish(out);
        true
    }

    /// The tetrahedra of the block that was just encoded, as they will be decoded.
    pub(crate) fn told(&self) -> &[Tet] {
        &self.truth.told
    }

    /// Lists the others and numbers the vertices; false if there are too many, or a tetrahedron has a vertex twice.
    fn localise(&mut self, tets: &[Tet], first: u32, own: u32, vertices: usize) -> bool {
        self.block = self.block.wrapping_add(1);
        if self.block == 0 || self.numbers.len() != vertices {
            self.numbers.clear();
            self.numbers.resize(vertices, 0);
            self.block = 1;
        }
        let stamp = u32::from(self.block) << 16;
        let numbers = &mut self.numbers[..];
        (stamp..).zip(&mut numbers[first as usize..(first + own) as usize]).for_each(|(n, to)| *to = n);
        // What is not new is overwritten: no branch, for none could be foretold.
        self.others.resize(3 * tets.len() + 1, 0);
        let (mut n, others) = (0, &mut self.others[..]);
        for t in tets {
            for &v in &t[1..] {
                let number = &mut numbers[v as usize];
                others[n] = v;
                n += usize::from(*number < stamp);
                *number = stamp.max(*number);
            }
        }
        self.others.truncate(n);
        if n >= LARGEST_LIST as usize {
            return false;
        }
        self.others.sort_unstable();
        (stamp + own..).zip(&self.others).for_each(|(n, &v)| numbers[v as usize] = n);
        let here = &mut self.truth.tets;
        here.resize(tets.len(), [0; 4]);
        let mut good = true;
        for (to, t) in here.iter_mut().zip(tets) {
            // The low half is the local number.
            let [a, b, c, d] = t.map(|v| numbers[v as usize] as Local);
            *to = [a, b, c, d];
            good &= (a < b) & (a < c) & (a < d) & (b != c) & (c != d) & (d != b);
        }
        good
    }

    /// The radius of a neighbourhood, as [`Cloud::set`] takes it: from the edges of all tetrahedra to their largest vertices. (Of some, it would
    /// depend on the order in which the mesher gives them.)
    fn size(&self) -> u8 {
        let mut counts = [0usize; 256];
        for &[a, b, c, d] in &self.truth.tets {
            let (a, d) = (self.positions[usize::from(a)], self.positions[usize::from(b.max(c).max(d))]);
            let along = |k: usize| (d[k] as i32).wrapping_sub(a[k] as i32) as f32;
            let square = along(0) * along(0) + along(1) * along(1) + along(2) * along(2);
            let quarter = (square.to_bits() >> 21) as i32 - (127 << 2);
            counts[quarter.clamp(0, 254) as usize + 1] += 1;
        }
        let wanted = self.truth.tets.len() * WITHIN / 100;
        let mut sum = 0;
        let reached = |n: &usize| {
            sum += n;
            sum >= wanted
        };
        counts.iter().position(reached).unwrap_or(255) as u8
    }
}

impl Truth {
    /// Prepares for a block.
    fn begin(&mut self) {
        (self.rest, self.star, self.untold) = (0, 0..0, 0);
    }

    /// Forgets what a block has left that cannot be told.
    fn give_up(&mut self) {
        self.coder.clear();
        self.bits.clear();
        self.hits.clear();
        self.is_odd = false;
        self.thirds.fill(TOLD);
    }

    #[inline(always)]
    fn third(&self, on: Gate) -> usize {
        usize::from(self.thirds[usize::from(on) % GATES])
    }

    /// Tells the triangle behind a gate if it has a certain apex: whether it does. Without a branch, for none could be foretold.
    #[inline(always)]
    fn take_if(&mut self, on: Gate, apex: usize) -> bool {
        let hit = (self.third(on) == apex) & (apex != NOBODY);
        let [c, d] = ends(on);
        // All bits of a place set are no place.
        let told = TOLD * u8::from(hit);
        for edge in [on, gate(d, apex), gate(apex, c)] {
            self.thirds[usize::from(edge) % GATES] |= told;
        }
        self.untold -= usize::from(hit);
        hit
    }

    /// The triangle is told now.
    #[inline(always)]
    fn take(&mut self, on: Gate, third: usize) {
        let [c, d] = ends(on);
        for edge in [on, gate(d, third), gate(third, c)] {
            self.thirds[usize::from(edge) % GATES] = TOLD;
        }
        self.untold -= 1;
    }

    /// Which of the loose triangles is behind a gate, and its apex.
    #[cold]
    fn find_loose(&self, link: &Link, on: Gate) -> Option<(usize, Local)> {
        let [c, d] = ends(on).map(|i| link.id[i]);
        let apex =
            |t: &[Local; 3]| (0..3).find(|&k| t[k] == c && t[(k + 1) % 3] == d).map(|k| t[(k + 2) % 3]);
        self.loose.iter().enumerate().find_map(|(i, t)| Some((i, apex(t)?)))
    }

    /// Tells those that are foretold.
    #[cold]
    fn loose_hits(&mut self, link: &Link, gates: &Gates) -> u32 {
        let mut hits = 0;
        for lane in 0..gates.len {
            let (on, told) = (gates.gates[lane % LANES], gates.apex(lane));
            if let Some((i, w)) = self.find_loose(link, on)
                && told != NOBODY
                && w == link.id[told]
            {
                self.loose.swap_remove(i);
                self.untold -= 1;
                hits |= 1 << lane;
            }
        }
        hits
    }

    /// Writes the hits of a star, before them whether it is odd.
    #[inline(always)]
    fn write_star(&mut self) {
        self.bits.put(u32::from(self.is_odd), 1);
        let more = u32::from(self.is_odd);
        for &(gates, hits) in &self.hits {
            self.bits.put(hits.into(), u32::from(gates) + more);
        }
        self.hits.clear();
        self.is_odd = false;
    }

    /// Such a triangle is told now: its apex, or [`NONE`] if there is none.
    #[cold]
    fn take_loose(&mut self, link: &Link, on: Gate) -> Local {
        let Some((i, w)) = self.find_loose(link, on) else { return NONE };
        self.loose.swap_remove(i);
        self.untold -= 1;
        w
    }
}

impl End for Truth {
    const KNOWS: bool = true;

    #[inline(always)]
    fn bit(&mut self, odds: &mut [Odds; DECISIONS], at: usize, truth: bool) -> bool {
        self.coder.bit(&mut odds[at], truth);
        #[cfg(test)]
        self.count(at, truth);
        truth
    }

    #[inline]
    fn raw(&mut self, bits: u32, truth: u32) -> u32 {
        self.coder.raw(bits, truth);
        truth
    }

    #[inline(always)]
    fn star(&mut self, v: Local, link: &Link) -> Option<()> {
        let n = self.tets[self.rest..].iter().take_while(|t| t[0] == v).count();
        self.star = self.rest..self.rest + n;
        self.rest += n;
        self.untold = n;
        self.loose.clear();
        for &[_, t @ ..] in &self.tets[self.star.clone()] {
            let [Some(a), Some(b), Some(c)] = t.map(|w| link.find(w)) else {
                self.loose.push(t);
                continue;
            };
            for [from, to, third] in [[a, b, c], [b, c, a], [c, a, b]] {
                let place = &mut self.thirds[usize::from(gate(from, to)) % GATES];
                // A directed edge of a mesh has one triangle.
                if std::mem::replace(place, third as u8) != TOLD {
                    return None;
                }
            }
        }
        Some(())
    }

    #[inline(always)]
    fn hits(&mut self, link: &Link, gates: &Gates) -> (u32, bool) {
        let mut hits = 0;
        for lane in 0..LANES {
            hits |= u32::from(self.take_if(gates.gates[lane], gates.apex(lane))) << lane;
        }
        let open = &gates.gates[..gates.len];
        let mut wrong = open.iter().fold(false, |any, &on| any | (self.third(on) != NOBODY));
        if !self.loose.is_empty() {
            hits |= self.loose_hits(link, gates);
            wrong |= open.iter().any(|&on| self.find_loose(link, on).is_some());
        }
        self.is_odd |= wrong;
        self.hits.push((gates.len as u8, hits as u8 | u8::from(wrong) << gates.len));
        (hits, wrong)
    }

    fn apex(&mut self, link: &Link, on: Gate) -> Local {
        let third = self.third(on);
        if third == NOBODY {
            return self.take_loose(link, on);
        }
        self.take(on, third);
        link.id[third % MOST]
    }

    #[inline(always)]
    fn is_odd(&mut self) -> bool {
        self.is_odd |= self.untold > 0;
        self.is_odd
    }

    #[inline(always)]
    fn is_untold(&self) -> bool {
        self.untold > 0
    }

    #[inline(always)]
    fn end_star(&mut self) {
        self.write_star();
    }

    fn untold(&self, link: &Link, to: &mut Vec<[Local; 3]>) {
        let is_told = |t: &[Local; 3]| match [t[0], t[1], t[2]].map(|w| link.find(w)) {
            [Some(a), Some(b), Some(c)] => self.third(gate(a, b)) != c,
            _ => true,
        };
        let star = self.tets[self.star.clone()].iter().map(|&[_, t @ ..]| t);
        to.extend(star.filter(|t| !is_told(t)));
        to.extend(&self.loose);
    }

    #[inline(always)]
    fn tell(&mut self, tet: [Local; 4]) {
        let id = |v: Local| self.ids[usize::from(v)];
        self.told.push([id(tet[0]), id(tet[1]), id(tet[2]), id(tet[3])]);
    }
}

/// The decoder's end.
struct Told<'a, 'o> {
    coder: Decoder<'a>,
    bits: BitReader<'a>,
    is_odd: bool,
    /// The vertices by local number.
    ids: &'o [u32; VERTICES],
    /// Room for the tetrahedra, and how many of them are told.
    out: &'o mut [Tet],
    told: usize,
}

impl End for Told<'_, '_> {
    const KNOWS: bool = false;

    #[inline(always)]
    fn bit(&mut self, odds: &mut [Odds; DECISIONS], at: usize, _: bool) -> bool {
        self.coder.bit(&mut odds[at])
    }

    #[inline]
    fn raw(&mut self, bits: u32, _: u32) -> u32 {
        self.coder.raw(bits)
    }

    #[inline(always)]
    fn star(&mut self, _: Local, _: &Link) -> Option<()> {
        self.is_odd = self.bits.take(1) == 1;
        Some(())
    }

    #[inline(always)]
    fn hits(&mut self, _: &Link, gates: &Gates) -> (u32, bool) {
        let bits = self.bits.take(gates.len as u32 + u32::from(self.is_odd));
        (bits & !(u32::MAX << gates.len), bits >> gates.len != 0)
    }

    #[inline(always)]
    fn apex(&mut self, _: &Link, _: Gate) -> Local {
        NONE
    }

    #[inline(always)]
    fn is_odd(&mut self) -> bool {
        self.is_odd
    }

    #[inline(always)]
    fn is_untold(&self) -> bool {
        false
    }

    #[inline(always)]
    fn end_star(&mut self) {}

    fn untold(&self, _: &Link, _: &mut Vec<[Local; 3]>) {}

    #[inline(always)]
    fn tell(&mut self, tet: [Local; 4]) {
        let id = |v: Local| self.ids[usize::from(v) % VERTICES];
        let tet = [id(tet[0]), id(tet[1]), id(tet[2]), id(tet[3])];
        // Stars that tell more than there is room for are refused.
        if let Some(room) = self.out.get_mut(self.told) {
            *room = tet;
        }
        self.told += 1;
    }
}

fn bad() -> Malformed {
    Malformed::new("tetrahedra", "the stars of a run of vertices", "something else")
}

/// Memory that decoding reuses.
pub(crate) struct Scratch {
    stars: Stars,
    ids: Box<[u32; VERTICES]>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self { stars: Stars::default(), ids: Box::new([0; VERTICES]) }
    }
}

/// A block whose vertices are known, and that waits for their positions.
pub(crate) struct Reader<'a> {
    coder: Decoder<'a>,
    bits: BitReader<'a>,
    own: usize,
    tets: usize,
    size: u8,
}

impl<'a> Reader<'a> {
    /// Reads the vertices of a block, and appends them to `ids`; each is below `vertices`.
    pub(crate) fn open(bytes: &'a [u8], vertices: u32, ids: &mut Vec<u32>) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let (first, own) = (c.varint32("first vertex")?, c.varint32("own vertices")?);
        let (others, tets) = (c.varint32("other vertices")?, c.varint32("tetrahedra")?);
        let size = c.u8("size of neighbourhoods")?;
        let bits = c.varint32("bytes of bits")? as usize;
        let mut bits = BitReader::new(c.take(bits, "bits")?);
        let fits = first.checked_add(own).is_some_and(|end| end <= vertices);
        if tets as usize > LARGEST_STARS || own.max(others) >= LARGEST_LIST || !fits {
            return Err(bad());
        }
        ids.reserve((own + others) as usize);
        ids.extend(first..first + own);
        let mut least = first + own;
        for _ in 0..others {
            let v = bits.take_number().and_then(|gap| least.checked_add(gap)).filter(|&v| v < vertices);
            let v = v.ok_or_else(bad)?;
            ids.push(v);
            least = v + 1;
        }
        Ok(Self { coder: Decoder::new(c.rest()), bits, own: own as usize, tets: tets as usize, size })
    }

    /// Appends the tetrahedra, given the vertices and their positions.
    pub(crate) fn decode(
        self,
        scratch: &mut Scratch,
        ids: &[u32],
        positions: &[LatticePos],
        out: &mut Vec<Tet>,
    ) -> Result<(), Malformed> {
        let stars = &mut scratch.stars;
        stars.odds = first_odds();
        stars.set(self.own, positions, self.size, self.tets);
        scratch.ids[..ids.len()].copy_from_slice(ids);
        let before = out.len();
        out.resize(before + self.tets, [0; 4]);
        let (ids, room) = (&*scratch.ids, &mut out[before..]);
        let mut end = Told { coder: self.coder, bits: self.bits, is_odd: false, ids, out: room, told: 0 };
        stars.tell(&mut end, self.tets).ok_or_else(bad)?;
        if end.coder.at_end() && end.bits.at_end() { Ok(()) } else { Err(bad()) }
    }
}

#[cfg(test)]
mod tests;
