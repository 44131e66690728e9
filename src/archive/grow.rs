//! The region-growing coder of a tetrahedron block, in the spirit of the cut-border machine (Gumhold, Guthe, Straßer
//! 1999, "Tetrahedral mesh compression with the cut-border machine").
//!
//! Encoder and decoder grow the same region, a tetrahedron at a time. What they know is the region's surface, the *front*:
//! triangles, each linked across each of its edges to the triangle at the other end of the *fan*, the run of the
//! region's tetrahedra around that edge.
//!
//! ```text
//!            w                 The front's face abc. Across the edge ab, at the other end of a fan of three
//!         a /|                 tetrahedra (seen along the edge), lies the face abw. If the tetrahedron beyond
//!          * |                 abc has w as its apex, the fan is full: one bit tells, and since edges of a
//!         /|\| fan of 3        Delaunay mesh have about five tetrahedra, that bit is cheap for a fan of four.
//!        c   w
//! ```
//!
//! The next face is one with a largest fan, the latest such. For it is told, each by one adaptive decision of the range coder:
//! 1. Is the apex the third vertex across an edge? First asked for the most promising edge: the one whose vertex is
//!    across several edges, then the one with the largest fan.
//! 2. Is there no tetrahedron beyond in this block (a *border*)?
//! 3. Is it the third vertex across another edge?
//! 4. Else: a vertex that the region has or a new one, of the own or of the others, and its rank among those, counted
//!    from the rank of a vertex of the face, for ids of neighbours are near each other.
//!
//! The new tetrahedron's faces that meet the face across an edge vanish with it. Where the region closes in on itself without a common
//! edge, a face remains though both its sides are known; it is told to be a border, which costs a little and harms nothing.
//! When no face is left, a seed tetrahedron is told by its four vertices.
//!
//! **Vertices.** A block has all tetrahedra whose smallest vertex is in a run of ids, its *own* vertices; the *others* have larger
//! ids and are listed in front, as differences.
//!
//! **Cost**, measured on blocks of 1 000 from 26 000 points: 5.1 bits a tetrahedron for Hammersley points, 5.3 Halton, 3.6
//! BCC, of which the vertices are two; 4.8, 5.1 and 3.2 in blocks of 2 000. Decisions are few in a block, so probabilities start
//! where they ended on average in such meshes ([`ODDS`]).

use super::grow_odds::ODDS;
use super::range_coder::{Decoder, Encoder, Odds};
use super::wire::{Cursor, Malformed, put_varint};
use crate::mesh::tet::Tet;
use rustc_hash::FxHashMap;

/// The most tetrahedra of a block of this codec.
pub(crate) const LARGEST_GROWN: usize = 1 << 16;
/// The most own, and the most other, vertices.
pub(crate) const LARGEST_LIST: u32 = 1 << 15;

/// No vertex; also what the decoder takes for the truth that only the encoder knows.
const NONE: u32 = u32::MAX;

// Contexts of decisions: a range of `ODDS` for each question, by what bears on the answer. "Owned" is the number of
// own vertices of the face, "borders" the number of its neighbours that are borders.
/// Votes 3 x fan 8 x owned 4 x own 2 x borders 3.
const BEST: usize = 0;
/// Owned 4 x fan 8 x borders 4.
const BORDER: usize = BEST + 576;
/// Fan 8 x owned 4 x own 2.
const SECOND: usize = BORDER + 128;
/// As `SECOND`.
const THIRD: usize = SECOND + 64;
/// Owned 4 x borders 4.
const NEW: usize = THIRD + 64;
/// Old or new 2 x owned 4 x borders 4.
const OWN: usize = NEW + 16;
/// Class of the difference before 3 x gamma.
const GAP: usize = OWN + 32;
/// Old or new 2 x other or own 2 x (up or down, gamma twice).
const RANK: usize = GAP + 3 * GAMMA;
/// Contexts of a number.
const GAMMA: usize = 40;
/// Number of contexts.
pub(crate) const CONTEXTS: usize = RANK + 4 * (2 * GAMMA + 1);

/// A triangle of the front, oriented so that (v, apex beyond) is positive.
#[derive(Clone, Copy)]
struct Face {
    v: [u32; 3],
    /// For edge i, from v[i] to v[i+1]: the face at the other end of the fan, times 4, plus its edge.
    hinge: [u32; 3],
    /// Tetrahedra in the fan at edge i.
    fan: [u8; 3],
    state: State,
    /// One more than the largest fan with which it was last put on a stack.
    urgency: u8,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Open,
    Border,
    Gone,
}

const fn next(i: usize) -> usize {
    if i == 2 { 0 } else { i + 1 }
}

/// The face and edge of a hinge.
const fn unpack(hinge: u32) -> (usize, usize) {
    ((hinge >> 2) as usize, (hinge & 3) as usize)
}

/// The surface of the region.
struct Front {
    faces: Vec<Face>,
    /// Open faces by their largest fan; those that are no longer open are skipped.
    stacks: [Vec<u32>; 8],
}

impl Front {
    fn new(tets: usize) -> Self {
        Self { faces: Vec::with_capacity(3 * tets + 2), stacks: Default::default() }
    }

    #[inline]
    fn add(&mut self, v: [u32; 3]) {
        self.faces.push(Face { v, hinge: [0; 3], fan: [0; 3], state: State::Open, urgency: 0 });
    }

    #[inline]
    fn link(&mut self, a: u32, b: u32, fan: u8) {
        for (from, to) in [(a, b), (b, a)] {
            let (face, edge) = unpack(from);
            self.faces[face].hinge[edge] = to;
            self.faces[face].fan[edge] = fan;
        }
    }

    /// The vertex of a hinge's face that is not on its edge.
    #[inline]
    fn third(&self, hinge: u32) -> (&Face, u32) {
        let (face, edge) = unpack(hinge);
        let f = &self.faces[face];
        (f, f.v[next(next(edge))])
    }

    #[inline]
    fn push(&mut self, face: u32) {
        let f = &mut self.faces[face as usize];
        let fan = f.fan[0].max(f.fan[1]).max(f.fan[2]).min(7);
        if f.state == State::Open && fan + 1 > f.urgency {
            f.urgency = fan + 1;
            self.stacks[fan as usize].push(face);
        }
    }

    fn pop(&mut self) -> Option<u32> {
        for stack in self.stacks.iter_mut().rev() {
            while let Some(face) = stack.pop() {
                if self.faces[face as usize].state == State::Open {
                    return Some(face);
                }
            }
        }
        None
    }

    /// A triangle and its back, and a tetrahedron on it.
    fn seed(&mut self, [a, b, c, d]: Tet) {
        let n = self.faces.len() as u32;
        self.add([a, b, c]);
        self.add([a, c, b]);
        let (front, back) = (n << 2, (n + 1) << 2);
        self.link(front, back + 2, 0);
        self.link(front + 1, back + 1, 0);
        self.link(front + 2, back, 0);
        self.push(n + 1);
        self.attach(n, d);
    }

    /// Puts a tetrahedron of apex `d` on an open face.
    fn attach(&mut self, face: u32, d: u32) {
        let n = self.faces.len() as u32;
        let f = self.faces[face as usize];
        self.faces[face as usize].state = State::Gone;
        (0..3).for_each(|i| self.add([f.v[i], f.v[next(i)], d]));
        for i in 0..3 {
            let (here, after) = ((n + i as u32) << 2, (n + next(i) as u32) << 2);
            self.link(here + 1, after + 2, 1);
            self.link(here, f.hinge[i], f.fan[i].saturating_add(1));
        }
        let mut glued = (0..3).filter(|i| self.glue(n + i, 0)).count();
        while glued > 0 {
            glued = (0..9).filter(|i| self.glue(n + i / 3, *i as usize % 3)).count();
        }
        for i in n..n + 3 {
            if self.faces[i as usize].state == State::Open {
                self.push(i);
                let hinges = self.faces[i as usize].hinge;
                hinges.into_iter().filter(|h| h >> 2 < n).for_each(|h| self.push(h >> 2));
            }
        }
    }

    /// Takes away a face and its neighbour across an edge if they are two sides of one triangle.
    fn glue(&mut self, p: u32, edge: usize) -> bool {
        let f = self.faces[p as usize];
        if f.state != State::Open {
            return false;
        }
        let (q, q_edge) = unpack(f.hinge[edge]);
        let (g, third) = self.third(f.hinge[edge]);
        if g.state != State::Open || q == p as usize || third != f.v[next(next(edge))] {
            return false;
        }
        self.faces[p as usize].state = State::Gone;
        self.faces[q].state = State::Gone;
        // p's next edge is q's previous one, and the other way round.
        for (a, b) in [(next(edge), next(next(q_edge))), (next(next(edge)), next(q_edge))] {
            let (f, g) = (self.faces[p as usize], self.faces[q]);
            if f.hinge[a] != (q << 2 | b) as u32 {
                self.link(f.hinge[a], g.hinge[b], f.fan[a].saturating_add(g.fan[b]));
                self.push(f.hinge[a] >> 2);
                self.push(g.hinge[b] >> 2);
            }
        }
        true
    }

    /// What is across the edges of a face: vertices to guess the apex from, and the number of borders.
    #[inline]
    fn guesses(&self, f: &Face) -> ([Guess; 3], usize) {
        let mut guesses = [Guess { weight: 0, vertex: NONE }; 3];
        let mut borders = 0;
        for (guess, (&hinge, &fan)) in guesses.iter_mut().zip(f.hinge.iter().zip(&f.fan)) {
            let (g, vertex) = self.third(hinge);
            borders += usize::from(g.state == State::Border);
            if g.state == State::Open && !f.v.contains(&vertex) {
                *guess = Guess { weight: 8 | fan.min(7), vertex };
            }
        }
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (guesses[i], guesses[j]);
            if a.weight > 0 && a.vertex == b.vertex {
                guesses[i].weight = (a.weight & !7) + (b.weight & !7) + (a.weight & 7).max(b.weight & 7);
                guesses[j] = Guess { weight: 0, vertex: NONE };
            }
        }
        for (i, j) in [(0, 1), (1, 2), (0, 1)] {
            if guesses[i].weight < guesses[j].weight {
                guesses.swap(i, j);
            }
        }
        (guesses, borders)
    }
}

/// A vertex that may be the apex.
#[derive(Clone, Copy)]
struct Guess {
    /// Edges that it is across, times 8, plus the largest fan of theirs; 0: no guess.
    weight: u8,
    vertex: u32,
}

impl Guess {
    /// Context by fan, owned, own.
    fn context(self, owned: usize, own: u32) -> usize {
        ((self.weight as usize & 7) * 4 + owned) * 2 + usize::from(self.vertex < own)
    }
}

/// The two ends of the coder. The encoder writes the truth that it is given; the decoder ignores it and gives what it reads. So
/// one function is both.
trait End {
    fn bit(&mut self, context: usize, truth: bool) -> bool;
    /// `count` bits of equal probability, at most 16.
    fn raw(&mut self, truth: u32, count: u32) -> u32;
    /// The apex beyond a face; [`NONE`] for a border, and always to the decoder.
    fn apex(&mut self, face: [u32; 3]) -> u32;
    /// A tetrahedron not yet told.
    fn seed(&mut self) -> Tet;
    /// Whether more was read than there is.
    fn overrun(&self) -> bool;
}

struct Writing<'a> {
    coder: Encoder,
    odds: Vec<Odds>,
    tets: &'a [Tet],
    told: Vec<bool>,
    /// The tetrahedron on a face, turned so that its smallest vertex is first.
    beyond: FxHashMap<[u32; 3], u32>,
    next_seed: usize,
}

fn turned(v: [u32; 3]) -> [u32; 3] {
    match v[0].min(v[1]).min(v[2]) {
        least if v[0] == least => v,
        least if v[1] == least => [v[1], v[2], v[0]],
        _ => [v[2], v[0], v[1]],
    }
}

impl<'a> Writing<'a> {
    fn new(tets: &'a [Tet]) -> Self {
        let mut beyond = FxHashMap::with_capacity_and_hasher(4 * tets.len(), Default::default());
        for (i, &[a, b, c, d]) in (0..).zip(tets) {
            for face in [[a, b, c], [a, c, d], [a, d, b], [b, d, c]] {
                beyond.insert(turned(face), i);
            }
        }
        let told = vec![false; tets.len()];
        Self { coder: Encoder::new(), odds: initial_odds(), tets, told, beyond, next_seed: 0 }
    }
}

impl End for Writing<'_> {
    fn bit(&mut self, context: usize, truth: bool) -> bool {
        self.coder.bit(&mut self.odds[context], truth);
        truth
    }

    fn raw(&mut self, truth: u32, count: u32) -> u32 {
        self.coder.raw(truth, count);
        truth
    }

    fn apex(&mut self, face: [u32; 3]) -> u32 {
        match self.beyond.get(&turned(face)) {
            Some(&t) if !self.told[t as usize] => {
                self.told[t as usize] = true;
                let tet = self.tets[t as usize];
                tet.into_iter().find(|v| !face.contains(v)).expect("a tetrahedron has four vertices")
            }
            _ => NONE,
        }
    }

    fn seed(&mut self) -> Tet {
        while self.told[self.next_seed] {
            self.next_seed += 1;
        }
        self.told[self.next_seed] = true;
        self.tets[self.next_seed]
    }

    fn overrun(&self) -> bool {
        false
    }
}

struct Reading<'a> {
    coder: Decoder<'a>,
    odds: Vec<Odds>,
}

impl End for Reading<'_> {
    #[inline]
    fn bit(&mut self, context: usize, _: bool) -> bool {
        self.coder.bit(&mut self.odds[context])
    }

    #[inline]
    fn raw(&mut self, _: u32, count: u32) -> u32 {
        self.coder.raw(count)
    }

    #[inline]
    fn apex(&mut self, _: [u32; 3]) -> u32 {
        NONE
    }

    fn seed(&mut self) -> Tet {
        [NONE; 4]
    }

    #[inline]
    fn overrun(&self) -> bool {
        self.coder.overrun()
    }
}

fn initial_odds() -> Vec<Odds> {
    ODDS.iter().map(|&o| if o == 0 { Odds::UNKNOWN } else { Odds::known(o) }).collect()
}

/// A number by Elias's gamma code: its length in unary, then its bits; the length and the first two bits are adaptive.
#[inline]
fn gamma<E: End>(end: &mut E, base: usize, truth: u32) -> u32 {
    let n = truth.wrapping_add(1);
    let bits = (n | 1).ilog2();
    let mut len = 0;
    while len < 24 && end.bit(base + len.min(12) as usize, len < bits) {
        len += 1;
    }
    if len == 0 {
        return 0;
    }
    let at = base + 13 + 3 * (len as usize - 1).min(8);
    let mut out = 2 | u32::from(end.bit(at, n >> (len - 1) & 1 == 1));
    if len > 1 {
        out = out << 1 | u32::from(end.bit(at + 1 + (out & 1) as usize, n >> (len - 2) & 1 == 1));
    }
    let mut left = len.saturating_sub(2);
    while left > 0 {
        let take = left.min(12);
        left -= take;
        out = out << take | end.raw(n >> left & ((1 << take) - 1), take);
    }
    out - 1
}

/// Which vertices of a list the region does not have yet: a bit each.
struct Unmet {
    words: Vec<u64>,
    len: u32,
    unmet: u32,
}

impl Unmet {
    fn new(len: u32) -> Self {
        let mut words = vec![u64::MAX; len as usize / 64 + 1];
        words[len as usize / 64] = (1 << (len % 64)) - 1;
        Self { words, len, unmet: len }
    }

    fn has(&self, i: u32) -> bool {
        self.words[i as usize / 64] >> (i % 64) & 1 == 1
    }

    fn meet(&mut self, i: u32) {
        self.unmet -= u32::from(self.has(i));
        self.words[i as usize / 64] &= !(1 << (i % 64));
    }

    /// The number of unmet (or met) ones.
    fn count(&self, met: bool) -> u32 {
        if met { self.len - self.unmet } else { self.unmet }
    }

    /// The number of unmet (or met) ones before `i`.
    fn rank(&self, i: u32, met: bool) -> u32 {
        let word = i as usize / 64;
        let full: u32 = self.words[..word].iter().map(|w| w.count_ones()).sum();
        let unmet = full + (self.words[word] & ((1 << (i % 64)) - 1)).count_ones();
        if met { i - unmet } else { unmet }
    }

    /// The unmet (or met) one of a rank that is below their number.
    fn select(&self, mut rank: u32, met: bool) -> u32 {
        for (at, &word) in (0..).zip(&self.words) {
            let mut word = if met { !word } else { word };
            let ones = word.count_ones();
            if rank < ones {
                (0..rank).for_each(|_| word &= word - 1);
                return at * 64 + word.trailing_zeros();
            }
            rank -= ones;
        }
        unreachable!("the rank is below the number of ones")
    }

    /// Tells an unmet (or met) one by its rank, counted from that of `near`. `None` if what is read is none.
    fn tell<E: End>(&mut self, end: &mut E, met: bool, base: usize, near: u32, truth: u32) -> Option<u32> {
        let count = self.count(met);
        if count == 0 {
            return None;
        }
        let here = self.rank(near, met);
        let there = if truth == NONE { 0 } else { self.rank(truth, met) };
        let up = here == 0 || (here < count && end.bit(base, there >= here));
        let rank = if up {
            here.checked_add(gamma(end, base + 1, there.wrapping_sub(here)))?
        } else {
            here.checked_sub(gamma(end, base + 1 + GAMMA, here.wrapping_sub(there + 1)).checked_add(1)?)?
        };
        if rank >= count {
            return None;
        }
        let found = self.select(rank, met);
        self.meet(found);
        Some(found)
    }
}

/// The vertices of a block: the own ones are numbered first, then the others.
struct Vertices {
    own: u32,
    others: u32,
    unmet_own: Unmet,
    unmet_others: Unmet,
    /// The last of the others that was told.
    latest: u32,
}

/// The middle one of the vertices that are not `NONE`.
fn middle(mut v: [u32; 3], otherwise: u32) -> u32 {
    v.sort_unstable();
    match v.iter().filter(|&&x| x != NONE).count() {
        0 => otherwise,
        n => v[n / 2],
    }
}

impl Vertices {
    fn new(own: u32, others: u32) -> Self {
        Self { own, others, unmet_own: Unmet::new(own), unmet_others: Unmet::new(others), latest: 0 }
    }

    /// Bits of a vertex number.
    fn bits(&self) -> u32 {
        (self.own + self.others).next_power_of_two().ilog2()
    }

    fn meet(&mut self, v: u32) {
        if v < self.own { self.unmet_own.meet(v) } else { self.unmet_others.meet(v - self.own) }
    }

    fn is_unmet(&self, v: u32) -> bool {
        if v < self.own { self.unmet_own.has(v) } else { self.unmet_others.has(v - self.own) }
    }

    /// Tells an apex that no guess was.
    fn tell<E: End>(&mut self, end: &mut E, face: [u32; 3], context: usize, truth: u32) -> Option<u32> {
        let own = self.own;
        let new = end.bit(NEW + context, truth != NONE && self.is_unmet(truth));
        let is_own = end.bit(OWN + 16 * usize::from(!new) + context, truth < own);
        let base = RANK + (usize::from(new) * 2 + usize::from(is_own)) * (2 * GAMMA + 1);
        if is_own {
            let near = middle(face.map(|v| if v < own { v } else { NONE }), 0);
            return self.unmet_own.tell(end, !new, base, near, truth);
        }
        let near = middle(face.map(|v| if v < own { NONE } else { v - own }), self.latest);
        let truth = if truth == NONE { NONE } else { truth - own };
        self.latest = self.unmet_others.tell(end, !new, base, near, truth)?;
        Some(self.latest + own)
    }
}

/// Tells a block of `tets` tetrahedra. `None` if what is read cannot be one.
fn tell<E: End>(end: &mut E, tets: usize, own: u32, others: u32, out: &mut Vec<Tet>) -> Option<()> {
    let mut front = Front::new(tets);
    let mut vertices = Vertices::new(own, others);
    out.reserve(tets);
    let all = out.len() + tets;
    while out.len() < all {
        if end.overrun() {
            return None;
        }
        let Some(face) = front.pop() else {
            let tet = tell_seed(end, &mut vertices)?;
            front.seed(tet);
            out.push(tet);
            continue;
        };
        let f = front.faces[face as usize];
        match tell_apex(end, &front, &f, &mut vertices)? {
            NONE => front.faces[face as usize].state = State::Border,
            apex => {
                front.attach(face, apex);
                out.push([f.v[0], f.v[1], f.v[2], apex]);
            }
        }
    }
    Some(())
}

fn tell_seed<E: End>(end: &mut E, vertices: &mut Vertices) -> Option<Tet> {
    let truth = end.seed();
    let tet = truth.map(|v| end.raw(v, vertices.bits()));
    let distinct = (0..4).all(|i| !tet[..i].contains(&tet[i]));
    if !distinct || tet.iter().any(|&v| v >= vertices.own + vertices.others) {
        return None;
    }
    tet.iter().for_each(|&v| vertices.meet(v));
    Some(tet)
}

/// Tells the apex beyond a face, `NONE` for a border.
#[inline]
fn tell_apex<E: End>(end: &mut E, front: &Front, f: &Face, vertices: &mut Vertices) -> Option<u32> {
    let truth = end.apex(f.v);
    let ([best, second, third], borders) = front.guesses(f);
    let own = vertices.own;
    let owned = f.v.iter().filter(|&&v| v < own).count();
    if best.weight > 0 {
        let votes = best.weight as usize / 8 - 1;
        let context = (votes * 64 + best.context(owned, own)) * 3 + borders.min(2);
        if end.bit(BEST + context, truth == best.vertex) {
            return Some(best.vertex);
        }
    }
    let fan = best.weight as usize & 7;
    if end.bit(BORDER + (owned * 8 + fan) * 4 + borders, truth == NONE) {
        return Some(NONE);
    }
    for (guess, base) in [(second, SECOND), (third, THIRD)] {
        if guess.weight > 0 && end.bit(base + guess.context(owned, own), truth == guess.vertex) {
            return Some(guess.vertex);
        }
    }
    vertices.tell(end, f.v, owned * 4 + borders, truth).filter(|v| !f.v.contains(v))
}

/// How large the difference before was.
fn gap_class(gap: u32) -> usize {
    match gap {
        0..4 => 0,
        4..40 => 1,
        _ => 2,
    }
}

/// The others, ascending, each at least `first` and below `end_of_ids`.
fn tell_others<E: End>(end: &mut E, first: u32, n: u32, truth: &[u32], end_of_ids: u32) -> Option<Vec<u32>> {
    let mut list = Vec::with_capacity(n as usize);
    let (mut least, mut class) = (first, 2);
    for i in 0..n as usize {
        let gap = gamma(end, GAP + GAMMA * class, truth.get(i).map_or(0, |v| v - least));
        class = gap_class(gap);
        let v = least.checked_add(gap).filter(|&v| v < end_of_ids)?;
        list.push(v);
        least = v + 1;
    }
    Some(list)
}

/// Encodes canonical, sorted tetrahedra; false, with nothing written, if the block is none for this coder: empty, too
/// large, or of vertices too far apart.
pub(crate) fn encode(tets: &[Tet], vertices: u32, out: &mut Vec<u8>) -> bool {
    let list = super::tuples::vertex_list(tets);
    let (Some(first), Some(last)) = (tets.first(), tets.last()) else { return false };
    let (first, own) = (first[0], last[0] - first[0] + 1);
    let others = &list[list.partition_point(|&v| v < first + own)..];
    if tets.len() > LARGEST_GROWN || own.max(others.len() as u32) > LARGEST_LIST {
        return false;
    }
    // A difference of 2^24 and more is no number for `gamma`.
    if others
        .iter()
        .scan(first + own, |least, &v| Some(v - std::mem::replace(least, v + 1)))
        .any(|g| g >= 1 << 24)
    {
        return false;
    }
    let local = |v: u32| match v.checked_sub(first + own) {
        None => v - first,
        Some(_) => own + others.binary_search(&v).expect("the list has every vertex") as u32,
    };
    let local: Vec<Tet> = tets.iter().map(|t| t.map(local)).collect();
    for number in [first, own, others.len() as u32, tets.len() as u32] {
        put_varint(out, u64::from(number));
    }
    let mut end = Writing::new(&local);
    tell_others(&mut end, first + own, others.len() as u32, others, vertices)
        .and_then(|_| tell(&mut end, local.len(), own, others.len() as u32, &mut vec![]))
        .expect("the truth is a block");
    out.extend(end.coder.finish());
    true
}

/// Decodes what [`encode`] wrote; every vertex is below `vertices`.
pub(crate) fn decode(bytes: &[u8], vertices: u32, out: &mut Vec<Tet>) -> Result<(), Malformed> {
    let mut c = Cursor::new(bytes);
    let (first, own) = (c.varint32("first vertex")?, c.varint32("own vertices")?);
    let (others, tets) = (c.varint32("other vertices")?, c.varint32("tetrahedra")?);
    let bad = || Malformed::new("tetrahedra", "a region of tetrahedra", "something else");
    let fits = first.checked_add(own).is_some_and(|end| end <= vertices);
    if tets as usize > LARGEST_GROWN || own.max(others) > LARGEST_LIST || !fits {
        return Err(bad());
    }
    let mut end = Reading { coder: Decoder::new(c.rest()), odds: initial_odds() };
    let list = tell_others(&mut end, first + own, others, &[], vertices).ok_or_else(bad)?;
    let start = out.len();
    tell(&mut end, tets as usize, own, others, out).ok_or_else(bad)?;
    for t in &mut out[start..] {
        *t = t.map(|v| if v < own { first + v } else { list[(v - own) as usize] });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::chunk::tests::{cubes, sorted};

    fn round_trip(tets: &[Tet], vertices: u32) -> usize {
        let tets = sorted(tets);
        let mut bytes = vec![];
        assert!(encode(&tets, vertices, &mut bytes));
        let mut back = vec![[9; 4]];
        decode(&bytes, vertices, &mut back).unwrap();
        assert_eq!(back.remove(0), [9; 4], "appended");
        assert_eq!(sorted(&back), tets);
        bytes.len()
    }

    #[test]
    fn regions_come_back() {
        round_trip(&[[0, 1, 2, 3]], 4);
        round_trip(&[[3, 1, 70_000, 900]], 70_001);
        for n in [[1, 1, 1], [4, 1, 1], [3, 3, 3], [12, 11, 7]] {
            let tets = cubes(n);
            let vertices = n.iter().map(|k| k + 1).product();
            let bytes = round_trip(&tets, vertices);
            assert!(tets.len() < 500 || bytes * 8 < tets.len() * 4, "{bytes} bytes for {}", tets.len());
            // With holes, and in pieces.
            let holes: Vec<Tet> = (0..).zip(&tets).filter(|(i, _)| i * 7 % 5 != 0).map(|(_, &t)| t).collect();
            if !holes.is_empty() {
                round_trip(&holes, vertices);
            }
        }
    }

    #[test]
    fn tetrahedra_that_are_no_mesh_come_back_too() {
        let any: Vec<Tet> =
            (0..400u32).map(|i| [i % 7, 7 + i * i % 11, 18 + i % 13, 31 + i * 5 % 17]).collect();
        round_trip(&any, 48);
        let both: Vec<Tet> =
            cubes([2, 2, 2]).iter().flat_map(|&[a, b, c, d]| [[a, b, c, d], [b, a, c, d]]).collect();
        round_trip(&both, 27);
        round_trip(&[[0, 1, 2, 3]; 3], 4);
    }

    #[test]
    fn what_does_not_fit_is_left_to_another_coder() {
        let mut out = vec![];
        assert!(!encode(&[], 10, &mut out));
        assert!(!encode(&[[0, 1, 2, 3], [100_000, 100_001, 100_002, 100_003]], 100_004, &mut out));
        assert!(!encode(&[[0, 1, 2, 1 << 25]], 1 << 26, &mut out));
        assert!(out.is_empty());
    }

    #[test]
    fn no_damage_panics_or_gives_a_vertex_that_is_not_there() {
        let tets = sorted(&cubes([4, 3, 3]));
        let mut good = vec![];
        assert!(encode(&tets, 80, &mut good));
        assert!(decode(&good, 79, &mut vec![]).is_err(), "vertex 79 is in use");
        for i in 0..good.len() {
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[i] ^= 1 << bit;
                for bytes in [&bad[..], &good[..i], &[&bad[..4], &[0x55; 90]].concat()] {
                    let mut out = vec![];
                    if decode(bytes, 80, &mut out).is_ok() {
                        assert!(out.iter().flatten().all(|&v| v < 80));
                    }
                }
            }
        }
    }
}
