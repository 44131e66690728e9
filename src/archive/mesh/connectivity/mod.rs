//! The connectivity coder of a tetrahedron block. It goes from vertex to vertex and codes the
//! tetrahedra of which each is the smallest vertex (the *star*).
//!
//! The tetrahedra around a vertex v, seen from v, are the triangles of a sphere, the *link* of v.
//! Those with a vertex smaller than v were coded before. The coder adds the others, growing the
//! known part of the link a triangle at a time, as Edgebreaker does.
//!
//! ```text
//!      ┄┄┄ c              Each boundary edge of the known part is a *gate* to an unknown triangle. The mesh is a
//!     known ╲    · w      Delaunay tetrahedralization of known points: behind the gate cd is the point in front of it
//!            ╲  ·         whose sphere with v, c and d is empty. A look at the points nearby finds it. So mostly one
//!      ┄┄┄┄┄┄ d           cheap bit is written: *as predicted*.
//! ```
//!
//! This is no new triangulation: no conflict is searched for, nothing is exact. Where the bit is
//! not set, the gate is mostly a *border*: the tetrahedron behind it is in another block (of
//! smaller vertices), or there is none. A prediction can be wrong, where more than four points lie
//! on a sphere or where rounding decides. Then the star is *odd*, as a bit before the star says,
//! and the correction follows:
//!
//! * the rank of the apex among the points in front, in the order in which the growing sphere meets
//!   them;
//! * its number among the vertices of the block, if it is too far away to have a rank.
//!
//! A star is also odd if its link has several pieces. Each piece begins at an edge (c, d) that is
//! coded by ranks: c by distance, d by the size of the circle.
//!
//! So a block has two streams. Bits of stars and gates, and the differences of the other vertices'
//! numbers, are stored as they are ([`bits`]): reading some costs a shift. The corrections of odd
//! stars are rare. They go through a range coder ([`range`](crate::archive::range_coder)) whose
//! probabilities begin with [`first_odds`] and learn within the block.
//!
//! A triangle (c, d, w) of the link of v is the tetrahedron (v, c, d, w). Its face (c, d, w) is a
//! gate in the link of the smallest of them, which comes later. Two such gates of opposite
//! direction are the two sides of one face and vanish.
//!
//! A link is a dozen points and a matrix of flags. Gates are examined in the order in which they
//! were opened, four at a time, and the bits of four are read at once. A bit per gate is more than
//! its entropy (about 0.7), but waiting for one bit after another takes longer than all the
//! geometry.
//!
//! The decoder must predict what is behind one gate before it knows the next. The encoder knows
//! them all (`write/even.rs`). A third of its time goes into following gates and coding what is
//! behind them, a quarter into prediction, a fifth into numbering vertices, an eighth into odd
//! stars.

mod bits;
mod link;
mod odds;
mod read;
#[cfg(target_arch = "x86_64")]
mod simd;
#[cfg(target_arch = "x86_64")]
mod wide;
mod write;

use self::link::{Cloud, Gate, Gates, LANES, Link, MOST, NOBODY, Path, Plain, ends, gate};
use self::odds::first_odds;
pub(crate) use self::read::{Reader, Scratch};
pub(crate) use self::write::Writer;
use crate::archive::range_coder::Odds;
use isospan_io::geom::LatticePos;

/// The most tetrahedra of a block of this codec.
pub(crate) const LARGEST_STARS: usize = 1 << 14;
/// Own vertices and others are fewer each.
pub(crate) const LARGEST_LIST: u32 = 1 << 11;
/// The most larger vertices that a link may have, those that are only nearby included.
pub(crate) const LARGEST_LINK: usize = 124;

/// A local vertex number; [`NONE`] is none.
type Local = u16;
const NONE: u16 = u16::MAX;

/// Lower ranks are coded as such; this one says that a number follows.
const FAR_RANK: usize = 8;

// Where the odds of each decision are.
/// Whether there is a triangle behind a gate that is not as predicted, where one and where none
/// was.
const WRONG: usize = 0;
const GATE_RANK: usize = WRONG + 2;
/// Whether there is another piece, without and with a gate before.
const MORE: usize = GATE_RANK + FAR_RANK;
const C_RANK: usize = MORE + 2;
const D_RANK: usize = C_RANK + FAR_RANK;
const DECISIONS: usize = D_RANK + FAR_RANK;

/// The two ends of the coder. The encoder writes the truth that it is given; the decoder ignores it
/// and gives what it reads. So one function is both.
trait End {
    /// Whether this is the encoder: what costs time to find out is asked only then.
    const KNOWS: bool;
    #[must_use]
    fn bit(&mut self, odds: &mut [Odds; DECISIONS], at: usize, truth: bool) -> bool;
    /// A number of at most 16 bits.
    fn raw(&mut self, bits: u32, truth: u32) -> u32;
    /// The star of a vertex begins, with what is known of its link. `None` if a directed edge has
    /// two triangles.
    fn star(&mut self, v: Local, link: &Link) -> Option<()>;
    /// Which of the gates that were looked at have the predicted triangle behind them, a bit each;
    /// these triangles are now coded. Also, whether there is a triangle behind any other gate that
    /// is then open.
    fn hits(&mut self, link: &Link, gates: &Gates) -> (u32, bool);
    /// The apex of the uncoded triangle behind a gate, which is now coded; [`NONE`] if there is
    /// none.
    fn apex(&mut self, link: &Link, gate: Gate) -> Local;
    /// Whether the star has anything but predicted triangles behind gates that are known.
    fn is_odd(&mut self) -> bool;
    /// Whether triangles of the star are not coded yet.
    fn has_uncoded(&self) -> bool;
    /// All of the star is coded.
    fn end_star(&mut self);
    /// The vertices of the uncoded triangles, three each.
    fn uncoded(&self, link: &Link, to: &mut Vec<[Local; 3]>);
    /// A tetrahedron that is now coded.
    fn tell(&mut self, tet: [Local; 4]);
    /// Codes the star that begins, if this end knows that all of it is as predicted, and gives the
    /// number of its triangles.
    #[inline(always)]
    fn even(&mut self, _: impl Path, _: &mut Stars) -> Option<usize> {
        None
    }
}

/// A face that waits for its smallest vertex to come: the other two.
#[derive(Clone, Copy, Default)]
struct Waiting {
    /// The second one times 2^16.
    others: u32,
    next: u16,
}

/// The least vertex of a face, and the two that follow it, the second one times 2^16.
#[inline(always)]
fn least_first([c, d, w]: [Local; 3]) -> (Local, u32) {
    // By shifting (c, d, w, c): no branch, for none could be predicted.
    let least = c.min(d).min(w);
    let turn = 16 * u32::from(least == c) + 32 * u32::from(least == d);
    let [c, d, w] = [c, d, w].map(u64::from);
    (least, ((c | d << 16 | w << 32 | c << 48) >> turn) as u32)
}

/// The vector code that may be used.
#[derive(Clone, Copy, PartialEq)]
enum Paths {
    All,
    #[cfg_attr(not(test), expect(dead_code, reason = "tests ask for it"))]
    Narrow,
    Plain,
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
    uncoded: Vec<[Local; 3]>,
    /// Narrowed by tests.
    path: Paths,
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
            uncoded: vec![],
            path: Paths::All,
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

    /// Opens the gates of what is known of the link.
    #[inline(always)]
    fn meet_known(&mut self) -> Option<()> {
        let mut at = self.heads[self.v];
        while let Some(&Waiting { others, next }) = self.waiting.get(usize::from(at)) {
            let (a, b) = (others as Local, (others >> 16) as Local);
            let (a, b) = (self.link.place(&self.cloud, a)?, self.link.place(&self.cloud, b)?);
            self.link.meet(gate(a, b));
            at = next;
        }
        Some(())
    }

    /// Codes what is behind some gates, and gives the number of triangles. `None` if what is read
    /// is impossible.
    #[inline(always)]
    fn pass<E: End>(&mut self, path: impl Path, end: &mut E) -> Option<usize> {
        let (mut hits, is_wrong) = end.hits(&self.link, &self.gates);
        let mut found = hits.count_ones() as usize;
        while hits != 0 {
            let lane = hits.trailing_zeros() as usize;
            hits &= hits - 1;
            self.attach(end, self.gates.gates[lane % LANES], self.gates.apex(lane))?;
        }
        if is_wrong {
            found += path.apart(
                #[inline(always)]
                || self.correct(end),
            )?;
        }
        // Behind those that are still open is nothing.
        for lane in 0..LANES {
            self.link.close(self.gates.gates[lane]);
        }
        Some(found)
    }

    /// Codes the triangles that were not predicted, and gives their number.
    #[inline(always)]
    fn correct<E: End>(&mut self, end: &mut E) -> Option<usize> {
        let mut found = 0;
        for lane in 0..self.gates.len {
            let gate = self.gates.gates[lane % LANES];
            if !self.link.is_open(gate) {
                continue;
            }
            let truth = if E::KNOWS { end.apex(&self.link, gate) } else { NONE };
            let nobody = self.gates.apex(lane) == NOBODY;
            if end.bit(&mut self.odds, WRONG + usize::from(nobody), truth != NONE) {
                let scores = self.link.scores(gate);
                // The first is the one that was predicted.
                let w = self.ranked(end, &scores, 1, GATE_RANK, truth)?;
                self.attach(end, gate, w)?;
                found += 1;
            }
        }
        Some(found)
    }

    /// Codes a vertex by its rank, at least `least`, or else by its number. `None` if what is read
    /// is no vertex.
    #[inline(always)]
    fn ranked<E: End>(
        &mut self,
        end: &mut E,
        scores: &[f32; MOST],
        least: usize,
        odds: usize,
        truth: Local,
    ) -> Option<usize> {
        let place = if E::KNOWS { self.link.find(truth) } else { None };
        let known = place.and_then(|i| self.link.rank(scores, i));
        let known = known.filter(|&r| r >= least).unwrap_or(FAR_RANK);
        let is_it = |k: &usize| end.bit(&mut self.odds, odds + k, *k == known);
        if let Some(rank) = (least..FAR_RANK).find(is_it) {
            return if E::KNOWS { place } else { self.link.nth(scores, rank) };
        }
        // Numbers begin behind the vertex whose star this is.
        let first = self.v + 1;
        let bits = usize::BITS - (self.vertices - first).leading_zeros();
        let number = end.raw(bits, u32::from(truth).wrapping_sub(first as u32) & ((1 << bits) - 1));
        let w = first + number as usize;
        if w >= self.vertices { None } else { self.link.place(&self.cloud, w as Local) }
    }

    /// Adds a triangle on a gate, which it closes. `None` if the gate is not open, or the vertex is
    /// none or belongs to the gate.
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
        self.wait(c, d, w)
    }

    /// A face waits for the star of its smallest vertex. `None` if there are more faces than
    /// tetrahedra.
    #[inline(always)]
    fn wait(&mut self, c: Local, d: Local, w: Local) -> Option<()> {
        let (least, others) = least_first([c, d, w]);
        let head = self.heads.get_mut(usize::from(least).min(self.own))?;
        let next = std::mem::replace(head, self.waiters as u16);
        *self.waiting.get_mut(self.waiters)? = Waiting { others, next };
        self.waiters += 1;
        Some(())
    }

    /// Codes whether there is another piece, and an edge of it.
    #[inline(always)]
    fn piece<E: End>(&mut self, path: impl Path, end: &mut E, before: bool) -> Option<bool> {
        if !end.is_odd() || !end.bit(&mut self.odds, MORE + usize::from(before), end.has_uncoded()) {
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
        self.uncoded.clear();
        end.uncoded(&self.link, &mut self.uncoded);
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

    /// The vertex of least score among the uncoded triangles (those with a vertex). The decoder has
    /// no such triangles, and gets any vertex.
    fn least_of(&self, scores: &[f32; MOST], with: Option<Local>) -> Local {
        let score = |&w: &Local| (self.link.find(w).map_or(f32::INFINITY, |i| scores[i]), w);
        let triangles = self.uncoded.iter().filter(|t| with.is_none_or(|w| t.contains(&w)));
        let vertices = triangles.flatten().copied().filter(|&w| Some(w) != with);
        vertices.min_by(|a, b| score(a).partial_cmp(&score(b)).expect("scores are no NaN")).unwrap_or(0)
    }

    /// Codes all stars of a block of `tets` tetrahedra. `None` if what is read cannot be one, or a
    /// link is too large.
    fn tell<E: End>(&mut self, end: &mut E, tets: usize) -> Option<()> {
        let coded = self.tell_as_may_be(end, tets);
        if coded.is_none() {
            self.link.give_up();
        }
        coded
    }

    fn tell_as_may_be<E: End>(&mut self, end: &mut E, tets: usize) -> Option<()> {
        #[cfg(target_arch = "x86_64")]
        if let Some(wide) = wide::Wide::find().filter(|_| self.path == Paths::All) {
            return wide.run(
                #[inline(always)]
                || self.tell_on(wide, end, tets),
            );
        }
        #[cfg(target_arch = "x86_64")]
        if let Some(vectors) = simd::Vectors::find().filter(|_| self.path != Paths::Plain) {
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
            self.v = v;
            self.link.begin(path, &self.cloud, v);
            if let Some(triangles) = end.even(path, self) {
                left = left.checked_sub(triangles)?;
                continue;
            }
            self.meet_known()?;
            end.star(v as Local, &self.link)?;
            let (mut any, mut before) = (false, left + 1);
            loop {
                if self.link.is_crowded() {
                    return None;
                }
                if self.link.predict(path, &mut self.gates) {
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

#[cfg(test)]
mod tests;
