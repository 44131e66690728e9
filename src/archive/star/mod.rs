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
//! It is no triangulation anew: no conflict is searched for, nothing is exact. The foretelling may be wrong, and is where more than
//! four points lie on a sphere, at the edge of a block, or where rounding decides; then the truth follows:
//!
//! * a *border*: the tetrahedron behind is in another block (of smaller vertices), or there is none;
//! * its rank among the points in front, in the order in which the growing sphere meets them;
//! * its number among the vertices of the block, if it is too far away to have a rank.
//!
//! The probabilities depend on the size of the foretold sphere (large ones are wrong more often) and learn within the block
//! ([`range`](super::range)), beginning with [`first_odds`]. When a link has no gate left, a bit tells whether there is another piece
//! of it, which begins at an edge (c, d) that is told by ranks: of c by distance, of d by the size of the circle.
//!
//! A triangle (c, d, w) of the link of v is the tetrahedron (v, c, d, w). Its face (c, d, w) is a gate in the link of the smallest of
//! them, which comes later; two such gates of opposite direction are the two sides of one face and vanish.
//!
//! A link is a few dozen points and a matrix of bits, and up to eight gates are looked at together: about as much work as merely
//! decoding an entropy code of connectivity alone, which takes four times the bytes.

mod link;
mod odds;
#[cfg(target_arch = "x86_64")]
mod simd;

use self::link::{Cloud, Gates, Link, MOST, NOBODY, Path, Plain, SIZES};
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
pub(crate) const LARGEST_LINK: usize = 64;

/// A local vertex number; [`NONE`] is none.
type Local = u16;
const NONE: u16 = u16::MAX;

/// Ranks that are told as such; this one says that a number follows.
const FAR_RANK: usize = 8;

// Where the odds of each decision are.
const HIT: usize = 0;
const BORDER: usize = HIT + SIZES;
const GATE_RANK: usize = BORDER + SIZES;
/// Whether there is another piece, without and with a gate before.
const MORE: usize = GATE_RANK + FAR_RANK;
const C_RANK: usize = MORE + 2;
const D_RANK: usize = C_RANK + FAR_RANK;
/// Length of a difference of numbers, by the class of the one before.
const GAP: usize = D_RANK + FAR_RANK;
const GAP_LENGTHS: usize = 32;
const DECISIONS: usize = GAP + 3 * GAP_LENGTHS;

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
    /// The apex of the untold triangle behind a gate between two places of the link, which is told now; [`NONE`] if there is none.
    fn apex(&mut self, link: &Link, c: usize, d: usize) -> Local;
    /// Whether triangles of the star are not told yet.
    fn is_untold(&self) -> bool;
    /// Their vertices, three each.
    fn untold(&self, link: &Link, to: &mut Vec<[Local; 3]>);
    /// A tetrahedron that is told now.
    fn tell(&mut self, tet: [Local; 4]);
}

/// A face that waits for its smallest vertex to come: the other two.
#[derive(Clone, Copy, Default)]
struct Waiting {
    a: Local,
    b: Local,
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
        self.link.clear(positions.len());
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
        while let Some(&Waiting { a, b, next }) = self.waiting.get(usize::from(at)) {
            let (a, b) = (self.link.place(&self.cloud, a)?, self.link.place(&self.cloud, b)?);
            self.link.meet(a, b);
            at = next;
        }
        Some(())
    }

    /// Tells what is behind a gate: whether a triangle. `None` if what is read cannot be.
    #[inline(always)]
    fn pass<E: End>(&mut self, end: &mut E, lane: usize) -> Option<bool> {
        let (c, d) = (usize::from(self.gates.c[lane]) % MOST, usize::from(self.gates.d[lane]) % MOST);
        if !self.link.close(c, d) {
            return Some(false);
        }
        let told = usize::from(self.gates.told[lane]);
        let (foretold, size) = (told & 0xff, told >> 8 & (SIZES - 1));
        let truth = if E::KNOWS { end.apex(&self.link, c, d) } else { NONE };
        let hit =
            foretold != NOBODY && end.bit(&mut self.odds, HIT + size, truth == self.link.id[foretold % MOST]);
        let w = if hit {
            foretold
        } else if end.bit(&mut self.odds, BORDER + size, truth == NONE) {
            return Some(false);
        } else {
            self.correct(end, c, d, truth)?
        };
        self.attach(end, [c, d, w])?;
        Some(true)
    }

    /// Tells the apex that was not foretold.
    #[inline(always)]
    fn correct<E: End>(&mut self, end: &mut E, c: usize, d: usize, truth: Local) -> Option<usize> {
        let scores = self.link.scores(c, d);
        self.ranked(end, &scores, 1, GATE_RANK, truth).filter(|&w| w != c && w != d)
    }

    /// Tells a vertex by its rank, at least `least`, or else by its number. `None` if what is read is none.
    #[inline(always)]
    fn ranked<E: End>(
        &mut self,
        end: &mut E,
        scores: &[f32; NOBODY],
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

    /// A triangle on the (closed) gate from c to d.
    #[inline(always)]
    fn attach<E: End>(&mut self, end: &mut E, [c, d, w]: [usize; 3]) -> Option<()> {
        self.link.meet(c, w);
        self.link.meet(w, d);
        let [c, d, w] = [c, d, w].map(|i| self.link.id[i % MOST]);
        end.tell([self.v as Local, c, d, w]);
        // The place of the least by comparing (vertex, place): no branch, for none could be foretold.
        let placed = |v: Local, place: u32| u32::from(v) << 2 | place;
        let least = placed(c, 0).min(placed(d, 1)).min(placed(w, 2));
        let (a, b) = [(d, w), (w, c), (c, d), (c, d)][(least & 3) as usize];
        let least = least >> 2;
        let head = self.heads.get_mut((least as usize).min(self.own))?;
        let next = std::mem::replace(head, self.waiters as u16);
        *self.waiting.get_mut(self.waiters)? = Waiting { a, b, next };
        self.waiters += 1;
        Some(())
    }

    /// Tells whether there is another piece, and an edge of it.
    #[inline(always)]
    fn piece<E: End>(&mut self, end: &mut E, before: bool) -> Option<bool> {
        if !end.bit(&mut self.odds, MORE + usize::from(before), end.is_untold()) {
            return Some(false);
        }
        self.edge_of_piece(end)?;
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
    fn least_of(&self, scores: &[f32; NOBODY], with: Option<Local>) -> Local {
        let score = |&w: &Local| (self.link.find(w).map_or(f32::INFINITY, |i| scores[i]), w);
        let triangles = self.untold.iter().filter(|t| with.is_none_or(|w| t.contains(&w)));
        let vertices = triangles.flatten().copied().filter(|&w| Some(w) != with);
        vertices.min_by(|a, b| score(a).partial_cmp(&score(b)).expect("scores are no NaN")).unwrap_or(0)
    }

    /// Tells all stars of a block of `tets` tetrahedra. `None` if what is read cannot be one, or a link is too large.
    fn tell<E: End>(&mut self, end: &mut E, tets: usize) -> Option<()> {
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
                self.link.foretell(path, &self.cloud, &mut self.gates);
                if self.gates.len > 0 {
                    any = true;
                    for lane in 0..self.gates.len {
                        left = left.checked_sub(usize::from(self.pass(end, lane)?))?;
                    }
                    continue;
                }
                // A piece has a triangle.
                if before == left {
                    return None;
                }
                before = left;
                if !self.piece(end, any)? {
                    break;
                }
            }
        }
        (left == 0).then_some(())
    }

    /// Tells the others, ascending, each at least `first` and below `end_of_ids`.
    fn tell_others<E: End>(
        &mut self,
        end: &mut E,
        first: u32,
        n: u32,
        truth: &[u32],
        end_of_ids: u32,
        list: &mut Vec<u32>,
    ) -> Option<()> {
        let (mut least, mut class) = (first, 2);
        for i in 0..n as usize {
            let gap = self.gap(end, class, truth.get(i).map_or(0, |v| v - least))?;
            class = gap_class(gap);
            let v = least.checked_add(gap).filter(|&v| v < end_of_ids)?;
            list.push(v);
            least = v + 1;
        }
        Some(())
    }

    /// A difference: the length of the number that is one more, and the bits below its highest.
    fn gap<E: End>(&mut self, end: &mut E, class: usize, truth: u32) -> Option<u32> {
        let truth = truth.checked_add(1)?;
        let length = truth.ilog2() as usize;
        let at = GAP + class * GAP_LENGTHS;
        let length = (0..GAP_LENGTHS - 1)
            .find(|&k| end.bit(&mut self.odds, at + k, k == length))
            .unwrap_or(GAP_LENGTHS - 1);
        let (mut number, mut left) = (1, length as u32);
        while left > 0 {
            let take = left.min(16);
            left -= take;
            number = number << take | end.raw(take, truth >> left & ((1 << take) - 1));
        }
        Some(number - 1)
    }
}

/// How large the difference before was.
fn gap_class(gap: u32) -> usize {
    match gap {
        0..4 => 0,
        4..40 => 1,
        _ => 2,
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
    tets: Vec<[Local; 4]>,
    /// Where the tetrahedra of the stars to come begin.
    rest: usize,
    star: Range<usize>,
    /// Triangles of the star that are not told.
    untold: usize,
    /// For each directed edge between places of the link the third place of the triangle that has it and is not told.
    thirds: Box<[[u8; MOST]; MOST]>,
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
            tets: vec![],
            rest: 0,
            star: 0..0,
            untold: 0,
            thirds: Box::new([[TOLD; MOST]; MOST]),
            loose: vec![],
            ids: vec![],
            told: vec![],
            #[cfg(test)]
            counts: Default::default(),
        }
    }
}

/// Of so many edges in a hundred the longer end is within the radius of a neighbourhood.
const WITHIN: usize = 97;

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
        let (end, others) = (&mut self.truth, &self.others);
        let told = stars
            .tell_others(end, first + own, n, others, positions.len() as u32, &mut vec![])
            .and_then(|()| stars.tell(end, tets.len()));
        if told.is_none() {
            self.truth.coder.clear();
            return false;
        }
        for number in [first, own, n, tets.len() as u32] {
            put_varint(out, u64::from(number));
        }
        out.push(size);
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
        self.others.clear();
        for &v in tets.iter().flat_map(|t| &t[1..]) {
            let number = &mut numbers[v as usize];
            if *number < stamp {
                *number = stamp;
                self.others.push(v);
            }
        }
        if self.others.len() >= LARGEST_LIST as usize {
            return false;
        }
        self.others.sort_unstable();
        (stamp + own..).zip(&self.others).for_each(|(n, &v)| numbers[v as usize] = n);
        let tets_here = &mut self.truth.tets;
        tets_here.clear();
        // The low half is the local number.
        tets_here.extend(tets.iter().map(|t| t.map(|v| numbers[v as usize] as Local)));
        let good = |&[a, b, c, d]: &[Local; 4]| (a < b) & (a < c) & (a < d) & (b != c) & (c != d) & (d != b);
        tets_here.iter().fold(true, |all, t| all & good(t))
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
        // A block that was given up leaves something.
        self.thirds.fill([TOLD; MOST]);
    }

    #[cold]
    fn loose_apex(&mut self, c: Local, d: Local) -> Local {
        for i in 0..self.loose.len() {
            let t = self.loose[i];
            if let Some(k) = (0..3).find(|&k| t[k] == c && t[(k + 1) % 3] == d) {
                self.loose.swap_remove(i);
                self.untold -= 1;
                return t[(k + 2) % 3];
            }
        }
        NONE
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
                let place = &mut self.thirds[from % MOST][to % MOST];
                // A directed edge of a mesh has one triangle.
                if std::mem::replace(place, third as u8) != TOLD {
                    return None;
                }
            }
        }
        Some(())
    }

    #[inline(always)]
    fn apex(&mut self, link: &Link, c: usize, d: usize) -> Local {
        let (c, d) = (c % MOST, d % MOST);
        let third = self.thirds[c][d];
        if third == TOLD {
            return if self.loose.is_empty() { NONE } else { self.loose_apex(link.id[c], link.id[d]) };
        }
        let third = usize::from(third) % MOST;
        for (from, to) in [(c, d), (d, third), (third, c)] {
            self.thirds[from][to] = TOLD;
        }
        self.untold -= 1;
        link.id[third]
    }

    fn is_untold(&self) -> bool {
        self.untold > 0
    }

    fn untold(&self, link: &Link, to: &mut Vec<[Local; 3]>) {
        let is_told = |t: &[Local; 3]| match [t[0], t[1], t[2]].map(|w| link.find(w)) {
            [Some(a), Some(b), Some(c)] => usize::from(self.thirds[a % MOST][b % MOST]) != c,
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
    /// The vertices by local number.
    ids: &'o [u32],
    out: &'o mut Vec<Tet>,
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
        Some(())
    }

    #[inline(always)]
    fn apex(&mut self, _: &Link, _: usize, _: usize) -> Local {
        NONE
    }

    #[inline(always)]
    fn is_untold(&self) -> bool {
        false
    }

    fn untold(&self, _: &Link, _: &mut Vec<[Local; 3]>) {}

    #[inline(always)]
    fn tell(&mut self, tet: [Local; 4]) {
        let id = |v: Local| self.ids[usize::from(v)];
        self.out.push([id(tet[0]), id(tet[1]), id(tet[2]), id(tet[3])]);
    }
}

fn bad() -> Malformed {
    Malformed::new("tetrahedra", "the stars of a run of vertices", "something else")
}

/// Memory that decoding reuses.
#[derive(Default)]
pub(crate) struct Scratch {
    stars: Stars,
}

/// A block whose vertices are known, and that waits for their positions.
pub(crate) struct Reader<'a> {
    coder: Decoder<'a>,
    own: usize,
    tets: usize,
    size: u8,
}

impl<'a> Reader<'a> {
    /// Reads the vertices of a block, and appends them to `ids`; each is below `vertices`.
    pub(crate) fn open(
        bytes: &'a [u8],
        vertices: u32,
        scratch: &mut Scratch,
        ids: &mut Vec<u32>,
    ) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let (first, own) = (c.varint32("first vertex")?, c.varint32("own vertices")?);
        let (others, tets) = (c.varint32("other vertices")?, c.varint32("tetrahedra")?);
        let size = c.u8("size of neighbourhoods")?;
        let fits = first.checked_add(own).is_some_and(|end| end <= vertices);
        if tets as usize > LARGEST_STARS || own.max(others) >= LARGEST_LIST || !fits {
            return Err(bad());
        }
        ids.reserve((own + others) as usize);
        ids.extend(first..first + own);
        let mut nothing = vec![];
        let mut end = Told { coder: Decoder::new(c.rest()), ids: &[], out: &mut nothing };
        let (stars, first) = (&mut scratch.stars, first + own);
        stars.odds = first_odds();
        stars.tell_others(&mut end, first, others, &[], vertices, ids).ok_or_else(bad)?;
        Ok(Self { coder: end.coder, own: own as usize, tets: tets as usize, size })
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
        out.reserve(self.tets);
        let mut end = Told { coder: self.coder, ids, out };
        stars.tell(&mut end, self.tets).ok_or_else(bad)?;
        if end.coder.at_end() { Ok(()) } else { Err(bad()) }
    }
}

#[cfg(test)]
mod tests;
