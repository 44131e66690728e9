//! The star coder of a tetrahedron block: vertex after vertex, the tetrahedra of which it is the smallest vertex.
//!
//! The tetrahedra around a vertex v, seen from v, are the triangles of a sphere, the *link* of v. Those that have a vertex smaller
//! than v were told before; the coder tells the others, growing the known part of the link a triangle at a time as Edgebreaker
//! does (Rossignac 1999, "Edgebreaker: connectivity compression for triangle meshes"), so that the work on a block of
//! tetrahedra is work on some 150 little rings of triangles, which stay in the nearest cache.
//!
//! ```text
//!      p ─── c            The boundary of what is known runs p, c, d, n, m …; each of its edges is a *gate* to an unknown
//!      :  w   ╲           triangle. Behind the gate cd may be: d n (the *next* vertex of the boundary), p (the one before),
//!      :       ╲          m (the one after next), nothing in this block (a *border*), or a vertex that must be named.
//!      m ─ n ── d         An edge of a Delaunay mesh has about five tetrahedra: after so many triangles at d, n is likely.
//! ```
//!
//! A gate is chosen by the triangles known at its ends, most first (at most six count), the latest of equal ones. What is behind is a symbol of
//! eight, its probabilities those of a context: triangles at either end, and the length of the boundary (3, 4, 5, more). When a
//! link has no gate left, a symbol tells whether there is another piece of it; its first triangle is told by its vertices.
//!
//! A triangle (c, d, w) of the link of v is the tetrahedron (v, c, d, w). Its face (c, d, w) is a gate in the link of the smallest of them, which comes
//! later; two such gates of opposite direction are the two sides of one face and vanish.
//!
//! **Names.** A block has the tetrahedra whose smallest vertex is in a run of ids, its *own* vertices; the *others* have larger
//! ids and are listed in front, as differences. A named vertex is own or other, met or not met in this block before (the
//! symbol tells), and its rank among such, counted from the rank of a vertex near by.
//!
//! **Symbols** are coded by [`rans`](super::rans) with fixed probabilities ([`GATES`], [`NUMBERS`]): a block is too short to learn from.
//! A number n has the symbol n up to 3; above, one for each power of two and bit below the highest; the other bits follow as they are.

use super::rans::{Decoder, Encoder};
use super::star_odds::{GATES, NUMBERS};
use super::wire::{Cursor, Malformed, put_varint};
use crate::mesh::tet::Tet;

/// The most tetrahedra of a block of this codec.
pub(crate) const LARGEST_STARS: usize = 1 << 14;
/// Own vertices and others are fewer each.
pub(crate) const LARGEST_LIST: u32 = 1 << 11;
/// The most gates that a star may have had, and one.
pub(crate) const LARGEST_STAR: usize = 1 << 10;

/// A local vertex number; [`NONE`] is none, of which a link says that no gate is there.
type Local = u16;
const NONE: u16 = u16::MAX;
/// The gate that is none: closed, from and to no vertex.
const NO_GATE: u16 = 0;
/// Numbers of vertices are below: [`NONE`] modulo this is no vertex.
const VERTICES: usize = 2 * LARGEST_LIST as usize;

/// Symbols of a gate, and of a number.
pub(crate) const GATE_SYMBOLS: usize = 8;
pub(crate) const NUMBER_SYMBOLS: usize = 24;
/// The number symbol that 32 bits follow.
const ESCAPE: usize = NUMBER_SYMBOLS - 1;

// What is behind a gate: the next vertex of the boundary (0), the one before (1), the one after next (2), or
const BORDER: usize = 3;
/// The first of four: own and unmet, own and met, other and unmet, other and met.
const NAMED: usize = 4;

// Contexts of gate symbols: length of the boundary 5 x side 8 x side 8, then:
/// Whether there is another piece, without and with a gate before.
const MORE: usize = 320;
/// Of a piece's first triangle, the class of each vertex.
const SEED: usize = MORE + 2;
/// Number of contexts.
pub(crate) const GATE_CONTEXTS: usize = SEED + 3;
// Contexts of numbers: the class of the name, then:
/// The class of the difference before.
const GAP: usize = 4;
/// Number of contexts.
pub(crate) const NUMBER_CONTEXTS: usize = GAP + 3;

/// The two ends of the coder. The encoder writes the truth that it is given; the decoder ignores it and gives what it
/// reads. So one function is both.
trait End {
    fn gate(&mut self, context: usize, truth: usize) -> usize;
    fn number(&mut self, context: usize, truth: u32) -> u32;
    /// The stars of the next vertex begin.
    fn star(&mut self, v: Local);
    /// The apex of the triangle behind a gate; [`NONE`] for a border, and always to the decoder.
    fn apex(&mut self, c: Local, d: Local) -> Local;
    /// A triangle of the star not yet told.
    fn seed(&mut self) -> Option<[Local; 3]>;
    /// A tetrahedron that is told now.
    fn tell(&mut self, tet: [Local; 4]);
}

/// A vertex of the link at hand.
#[derive(Clone, Copy, Default)]
struct LinkVertex {
    /// One more than the vertex whose link this is about; else the rest is old.
    star: u16,
    /// The latest gate from here, and to here.
    out: u16,
    into: u16,
    /// Triangles known here.
    fan: u16,
}

/// A directed edge of the boundary; of a border, the vertices are [`NONE`].
#[derive(Clone, Copy)]
struct Gate {
    c: Local,
    d: Local,
    /// The gate before this one from c, and to d.
    older_out: u16,
    older_into: u16,
    /// What is known at c and at d: 0 no gate beside, 1 a border, else one more than the triangles.
    sides: [u8; 2],
}

/// A triangle that waits for its vertex to come: its gate, or (`b` is [`NONE`]) that there is one more at `a`.
#[derive(Clone, Copy)]
struct Waiting {
    a: Local,
    b: Local,
    next: u16,
}

struct Stars {
    own: Local,
    v: Local,
    /// Arrays of a fixed size need no check of an index modulo it.
    link: Box<[LinkVertex; VERTICES]>,
    gates: Box<[Gate; LARGEST_STAR]>,
    /// For each gate how promising it is, and its number; negative: closed.
    keys: Box<[i16; LARGEST_STAR]>,
    /// The number of gates that there were.
    used: usize,
    /// For each own vertex its first entry of `waiting`.
    heads: Vec<u16>,
    waiting: Vec<Waiting>,
    unmet: [Unmet; 2],
    /// The last of the others that was named.
    latest: Local,
}

/// An array of equal elements.
fn boxed<T: Copy, const N: usize>(each: T) -> Box<[T; N]> {
    vec![each; N].try_into().ok().expect("the length is N")
}

const fn at_gate(g: u16) -> usize {
    g as usize % LARGEST_STAR
}

const fn at_vertex(w: Local) -> usize {
    w as usize % VERTICES
}

impl Stars {
    fn new(own: Local, others: Local, tets: usize) -> Self {
        Self {
            own,
            v: 0,
            link: boxed(LinkVertex::default()),
            gates: boxed(Gate { c: NONE, d: NONE, older_out: 0, older_into: 0, sides: [0; 2] }),
            keys: boxed(-1),
            used: 1,
            heads: vec![NONE; usize::from(own)],
            waiting: Vec::with_capacity(2 * tets),
            unmet: [Unmet::new(own), Unmet::new(others)],
            latest: 0,
        }
    }

    /// Begins the star of the next vertex with what is known of its link.
    fn begin(&mut self, v: Local) -> Option<()> {
        self.v = v;
        self.unmet[0].meet(v);
        self.keys[..self.used].fill(-1);
        self.used = 1;
        let mut at = self.heads[usize::from(v)];
        while let Some(&Waiting { a, b, next }) = self.waiting.get(usize::from(at)) {
            self.touch(a);
            if b != NONE {
                self.touch(b);
                self.open(a, b)?;
            }
            at = next;
        }
        for g in 1..self.used as u16 {
            if self.keys[at_gate(g)] >= 0 {
                self.refresh(g);
            }
        }
        Some(())
    }

    /// One more triangle at a vertex.
    #[inline]
    fn touch(&mut self, w: Local) {
        let l = &mut self.link[at_vertex(w)];
        let fresh = LinkVertex { star: self.v + 1, ..LinkVertex::default() };
        let now = if l.star == fresh.star { *l } else { fresh };
        *l = LinkVertex { fan: now.fan + 1, ..now };
    }

    /// Opens a gate, or closes the one of opposite direction: the edge then has triangles on both sides. `None` if there
    /// were too many.
    #[inline]
    fn open(&mut self, c: Local, d: Local) -> Option<()> {
        let mut g = self.link[at_vertex(d)].out;
        while g != NO_GATE {
            let gate = self.gates[at_gate(g)];
            if gate.d == c {
                self.close(g);
                return Some(());
            }
            g = gate.older_out;
        }
        if self.used == LARGEST_STAR {
            return None;
        }
        let g = self.used as u16;
        self.used += 1;
        let older_out = std::mem::replace(&mut self.link[at_vertex(c)].out, g);
        let older_into = std::mem::replace(&mut self.link[at_vertex(d)].into, g);
        self.gates[at_gate(g)] = Gate { c, d, older_out, older_into, sides: [0; 2] };
        self.keys[at_gate(g)] = g as i16;
        Some(())
    }

    /// Closes a gate that is no border.
    #[inline]
    fn close(&mut self, g: u16) {
        let Gate { c, d, older_out, older_into, .. } = self.gates[at_gate(g)];
        self.keys[at_gate(g)] = -1;
        let mut at = self.link[at_vertex(c)].out;
        if at == g {
            self.link[at_vertex(c)].out = older_out;
        } else {
            while self.gates[at_gate(at)].older_out != g {
                at = self.gates[at_gate(at)].older_out;
            }
            self.gates[at_gate(at)].older_out = older_out;
        }
        let mut at = self.link[at_vertex(d)].into;
        if at == g {
            self.link[at_vertex(d)].into = older_into;
        } else {
            while self.gates[at_gate(at)].older_into != g {
                at = self.gates[at_gate(at)].older_into;
            }
            self.gates[at_gate(at)].older_into = older_into;
        }
    }

    /// What is known at a vertex of a gate, `beside` being the gate that follows or precedes there.
    #[inline]
    fn side(&self, beside: u16, fan: u16) -> u8 {
        if self.keys[at_gate(beside)] >= 0 { fan.min(6) as u8 + 1 } else { u8::from(beside != NO_GATE) }
    }

    /// Looks again at both ends of an open gate.
    #[inline]
    fn refresh(&mut self, g: u16) {
        let Gate { c, d, .. } = self.gates[at_gate(g)];
        let (from, to) = (self.link[at_vertex(c)], self.link[at_vertex(d)]);
        let sides = [self.side(from.into, from.fan), self.side(to.out, to.fan)];
        self.set_side(g, 0, sides[0]);
        self.set_side(g, 1, sides[1]);
    }

    /// Looks again at a vertex for the gates from it and to it.
    #[inline]
    fn refresh_at(&mut self, w: Local) {
        let LinkVertex { out, into, fan, .. } = self.link[at_vertex(w)];
        let (from, to) = (self.side(into, fan), self.side(out, fan));
        if to > 1 {
            self.set_side(out, 0, from);
        }
        if from > 1 {
            self.set_side(into, 1, to);
        }
    }

    /// Sets what is known at one end of an open gate.
    #[inline]
    fn set_side(&mut self, g: u16, end: usize, side: u8) {
        let sides = &mut self.gates[at_gate(g)].sides;
        sides[end] = side;
        self.keys[at_gate(g)] = i16::from(sides[0].max(1) + sides[1].max(1)) << 10 | g as i16;
    }

    /// The most promising gate.
    #[inline]
    fn pick(&self) -> Option<u16> {
        let mut best = [-1i16; 8];
        for eight in self.keys[..self.used.next_multiple_of(8).min(LARGEST_STAR)].chunks_exact(8) {
            for (b, &k) in best.iter_mut().zip(eight) {
                *b = k.max(*b);
            }
        }
        let best = best.iter().fold(-1, |b, &k| k.max(b));
        (best >= 0).then_some(best as u16 & (LARGEST_STAR as u16 - 1))
    }

    /// The vertices before and behind a gate and the one after next, and the context.
    #[inline]
    fn around(&self, gate: &Gate) -> ([Local; 3], usize) {
        let [at_c, at_d] = gate.sides.map(usize::from);
        let (before, next) = (self.before(gate.c), self.next(gate.d));
        let after = self.next(next);
        let length = if next != NONE && next == before {
            1
        } else if after == NONE || after == gate.c || after == gate.d {
            return ([next, before, NONE], at_c * 8 + at_d);
        } else if after == before {
            2
        } else if after == self.before(before) {
            3
        } else {
            4
        };
        ([next, before, after], (length * 8 + at_c) * 8 + at_d)
    }

    /// Where the latest gate from a vertex goes; [`NONE`] if it is a border or there is none.
    #[inline]
    fn next(&self, w: Local) -> Local {
        self.gates[at_gate(self.link[at_vertex(w)].out)].d
    }

    /// Where the latest gate to a vertex comes from.
    #[inline]
    fn before(&self, w: Local) -> Local {
        self.gates[at_gate(self.link[at_vertex(w)].into)].c
    }

    /// Tells what is behind a gate. `None` if what is read cannot be.
    #[inline]
    fn pass<E: End>(&mut self, end: &mut E, g: u16) -> Option<bool> {
        let gate = self.gates[at_gate(g)];
        let truth = end.apex(gate.c, gate.d);
        let (near, context) = self.around(&gate);
        let symbol = match truth {
            NONE => BORDER,
            t => near.iter().position(|&n| n == t).unwrap_or_else(|| NAMED + self.class(t)),
        };
        let symbol = end.gate(context, symbol);
        let w = match symbol {
            BORDER => {
                self.keys[at_gate(g)] = -1;
                (self.gates[at_gate(g)].c, self.gates[at_gate(g)].d) = (NONE, NONE);
                self.refresh_at(gate.c);
                self.refresh_at(gate.d);
                return Some(false);
            }
            NAMED.. => self.name(end, symbol - NAMED, truth, [gate.c, gate.d])?,
            _ => near[symbol],
        };
        if w == NONE || w <= self.v || w == gate.c || w == gate.d {
            return None;
        }
        self.close(g);
        self.attach(end, [gate.c, gate.d, w])?;
        Some(true)
    }

    /// A triangle on the (closed) gate from c to d.
    #[inline]
    fn attach<E: End>(&mut self, end: &mut E, [c, d, w]: [Local; 3]) -> Option<()> {
        self.touch(c);
        self.touch(d);
        self.touch(w);
        self.open(c, w)?;
        self.open(w, d)?;
        self.refresh_at(c);
        self.refresh_at(d);
        self.refresh_at(w);
        self.wait([c, d, w]);
        end.tell([self.v, c, d, w]);
        Some(())
    }

    /// Keeps the face opposite to v for the stars of its vertices.
    #[inline]
    fn wait(&mut self, [c, d, w]: [Local; 3]) {
        let (m, x, y) = match c.min(d).min(w) {
            m if m == c => (c, d, w),
            m if m == d => (d, w, c),
            _ => (w, c, d),
        };
        self.wait_for(m, x, y);
        self.wait_for(x.min(y), x.max(y), NONE);
    }

    #[inline]
    fn wait_for(&mut self, v: Local, a: Local, b: Local) {
        if let Some(head) = self.heads.get_mut(usize::from(v)) {
            let next = std::mem::replace(head, self.waiting.len() as u16);
            self.waiting.push(Waiting { a, b, next });
        }
    }

    /// Tells whether there is another piece, and its first triangle.
    fn piece<E: End>(&mut self, end: &mut E) -> Option<bool> {
        let truth = end.seed();
        let more = end.gate(MORE + usize::from(self.used > 1), usize::from(truth.is_some()));
        if more == 0 {
            return Some(false);
        }
        let truth = truth.unwrap_or([NONE; 3]);
        let mut seed = [NONE; 3];
        for i in 0..3 {
            let class = if truth[i] == NONE { 0 } else { self.class(truth[i]) };
            let class = end.gate(SEED + i, class);
            let w = self.name(end, class, truth[i], [self.v; 2])?;
            if w <= self.v || seed.contains(&w) {
                return None;
            }
            seed[i] = w;
        }
        self.attach(end, seed)?;
        self.open(seed[1], seed[0])?;
        self.refresh_at(seed[0]);
        self.refresh_at(seed[1]);
        Some(true)
    }

    /// Class of a vertex: own or other, met or not.
    #[inline]
    fn class(&self, w: Local) -> usize {
        match w.checked_sub(self.own) {
            None => usize::from(!self.unmet[0].has(w)),
            Some(other) => 2 + usize::from(!self.unmet[1].has(other)),
        }
    }

    /// Tells a vertex of a class, near others.
    fn name<E: End>(&mut self, end: &mut E, class: usize, truth: Local, near: [Local; 2]) -> Option<Local> {
        let [c, d] = near.map(|w| w.checked_sub(self.own));
        let near = match (class < 2, c, d) {
            (true, None, None) => near[0].max(near[1]),
            (true, None, Some(_)) => near[0],
            (true, Some(_), None) => near[1],
            (true, Some(_), Some(_)) => self.v,
            (false, Some(other), _) | (false, None, Some(other)) => other,
            (false, None, None) => self.latest,
        };
        if class < 2 {
            return self.unmet[0].name(end, class, near, truth);
        }
        let truth = if truth == NONE { NONE } else { truth - self.own };
        self.latest = self.unmet.get_mut(class / 2)?.name(end, class, near, truth)?;
        Some(self.latest + self.own)
    }
}

/// Which vertices of a list the block does not have yet: a bit each.
struct Unmet {
    words: Vec<u64>,
    len: u32,
    unmet: u32,
}

impl Unmet {
    fn new(len: Local) -> Self {
        let mut words = vec![u64::MAX; usize::from(len) / 64 + 1];
        words[usize::from(len) / 64] = (1 << (len % 64)) - 1;
        Self { words, len: len.into(), unmet: len.into() }
    }

    #[inline]
    fn has(&self, i: Local) -> bool {
        self.words[usize::from(i) / 64] >> (i % 64) & 1 == 1
    }

    #[inline]
    fn meet(&mut self, i: Local) {
        self.unmet -= u32::from(self.has(i));
        self.words[usize::from(i) / 64] &= !(1 << (i % 64));
    }

    /// The number of unmet (or met) ones before `i`.
    #[inline]
    fn rank(&self, i: Local, met: bool) -> u32 {
        let word = usize::from(i) / 64;
        let full: u32 = self.words[..word].iter().map(|w| w.count_ones()).sum();
        let unmet = full + (self.words[word] & ((1 << (i % 64)) - 1)).count_ones();
        if met { u32::from(i) - unmet } else { unmet }
    }

    /// The unmet (or met) one of a rank that is below their number.
    #[inline]
    fn select(&self, mut rank: u32, met: bool) -> Local {
        let flip = if met { u64::MAX } else { 0 };
        for (at, &word) in (0u16..).zip(&self.words) {
            let mut word = word ^ flip;
            let ones = word.count_ones();
            if rank < ones {
                // Halve the word down to the bit.
                let mut bit = 0;
                for half in [32, 16, 8, 4, 2, 1] {
                    let low = (word & ((1 << half) - 1)).count_ones();
                    if rank >= low {
                        rank -= low;
                        word >>= half;
                        bit += half as u16;
                    }
                }
                return at * 64 + bit;
            }
            rank -= ones;
        }
        unreachable!("the rank is below the number of ones")
    }

    /// Tells an unmet (or met) one by its rank, counted from that of `near`. `None` if what is read is none.
    fn name<E: End>(&mut self, end: &mut E, class: usize, near: Local, truth: Local) -> Option<Local> {
        let met = class % 2 == 1;
        let count = if met { self.len - self.unmet } else { self.unmet };
        let here = self.rank(near, met);
        let there = if truth == NONE { 0 } else { self.rank(truth, met) };
        let d = there.wrapping_sub(here);
        // Small differences of either sign become small numbers.
        let n = end.number(class, (d << 1) ^ ((d as i32 >> 31) as u32));
        let rank = here.wrapping_add((n >> 1) ^ (n & 1).wrapping_neg());
        if rank >= count {
            return None;
        }
        let found = self.select(rank, met);
        self.meet(found);
        Some(found)
    }
}

/// Tells all stars of a block of `tets` tetrahedra. `None` if what is read cannot be one, or a star is too large.
fn tell<E: End>(end: &mut E, own: Local, others: Local, tets: usize) -> Option<()> {
    let mut stars = Stars::new(own, others, tets);
    let mut left = tets;
    for v in 0..own {
        stars.begin(v)?;
        end.star(v);
        loop {
            while let Some(g) = stars.pick() {
                left = left.checked_sub(usize::from(stars.pass(end, g)?))?;
            }
            if !stars.piece(end)? {
                break;
            }
            left = left.checked_sub(1)?;
        }
    }
    (left == 0).then_some(())
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
fn tell_others<E: End>(
    end: &mut E,
    first: u32,
    n: u32,
    truth: &[u32],
    end_of_ids: u32,
    list: &mut Vec<u32>,
) -> Option<()> {
    let (mut least, mut class) = (first, 2);
    for i in 0..n as usize {
        let gap = end.number(GAP + class, truth.get(i).map_or(0, |v| v - least));
        class = gap_class(gap);
        let v = least.checked_add(gap).filter(|&v| v < end_of_ids)?;
        list.push(v);
        least = v + 1;
    }
    Some(())
}

/// Symbol of a number, and how many bits follow.
#[inline]
fn number_symbol(n: u32) -> (usize, u32) {
    if n < 4 {
        return (n as usize, 0);
    }
    let top = n.ilog2();
    let symbol = (2 * top + (n >> (top - 1) & 1)) as usize;
    if symbol < ESCAPE { (symbol, top - 1) } else { (ESCAPE, 32) }
}

/// Encodes blocks of one chunk.
#[derive(Default)]
pub(crate) struct Writer {
    coder: Encoder,
    /// For each vertex of the chunk, the block that has it as an other (one more than its number), and its local number.
    numbers: Vec<(u32, Local)>,
    block: u32,
    others: Vec<u32>,
    tets: Vec<[Local; 4]>,
    /// Where the tetrahedra of the stars to come begin.
    rest: usize,
    /// The directed edges of the star's triangles that are not told: three each; [`TOLD`] else.
    edges: Vec<u32>,
    star: std::ops::Range<usize>,
}

/// No edge.
const TOLD: u32 = u32::MAX;

impl Writer {
    /// Encodes canonical, sorted tetrahedra; false, with nothing written, if the block is none for
    /// this coder: empty, too large, or a tetrahedron has a vertex twice.
    pub(crate) fn encode(&mut self, tets: &[Tet], vertices: u32, out: &mut Vec<u8>) -> bool {
        let (Some(first), Some(last)) = (tets.first(), tets.last()) else { return false };
        let (first, own) = (first[0], last[0] - first[0] + 1);
        if tets.len() > LARGEST_STARS || own >= LARGEST_LIST || !self.localise(tets, first, own, vertices) {
            return false;
        }
        let others = std::mem::take(&mut self.others);
        let n = others.len() as u32;
        (self.rest, self.star) = (0, 0..0);
        let told = tell_others(self, first + own, n, &others, vertices, &mut vec![])
            .and_then(|()| tell(self, own as Local, n as Local, tets.len()));
        self.others = others;
        if told.is_none() {
            self.coder.clear();
            return false;
        }
        for number in [first, own, n, tets.len() as u32] {
            put_varint(out, u64::from(number));
        }
        self.coder.finish(out);
        true
    }

    /// Lists the others and numbers the vertices; false if there are too many, or a tetrahedron has a vertex twice.
    fn localise(&mut self, tets: &[Tet], first: u32, own: u32, vertices: u32) -> bool {
        self.numbers.resize(vertices as usize, (0, 0));
        self.block += 1;
        self.others.clear();
        for &v in tets.iter().flatten().filter(|&&v| v >= first + own) {
            if self.numbers[v as usize].0 != self.block {
                self.numbers[v as usize].0 = self.block;
                self.others.push(v);
            }
        }
        if self.others.len() >= LARGEST_LIST as usize {
            return false;
        }
        self.others.sort_unstable();
        for (&v, i) in self.others.iter().zip(own as Local..) {
            self.numbers[v as usize].1 = i;
        }
        let local = |v: u32| if v < first + own { (v - first) as Local } else { self.numbers[v as usize].1 };
        self.tets.clear();
        self.tets.extend(tets.iter().map(|t| [local(t[0]), local(t[1]), local(t[2]), local(t[3])]));
        self.tets.iter().all(|&[a, b, c, d]| a < b && a < c && a < d && b != c && c != d && d != b)
    }
}

impl End for Writer {
    #[inline]
    fn gate(&mut self, context: usize, truth: usize) -> usize {
        let starts = &GATES[context];
        let width = starts.get(truth + 1).map_or(4096, |&s| s) - starts[truth];
        self.coder.put(starts[truth], width);
        truth
    }

    #[inline]
    fn number(&mut self, context: usize, truth: u32) -> u32 {
        let (symbol, bits) = number_symbol(truth);
        let starts = &NUMBERS[context];
        self.coder.put(starts[symbol], starts.get(symbol + 1).map_or(4096, |&s| s) - starts[symbol]);
        let mut left = bits;
        while left > 0 {
            let take = left.min(11);
            left -= take;
            let shift = 12 - take;
            self.coder.put(((truth >> left & ((1 << take) - 1)) << shift) as u16, 1 << shift);
        }
        truth
    }

    #[inline]
    fn star(&mut self, v: Local) {
        let n = self.tets[self.rest..].iter().take_while(|t| t[0] == v).count();
        self.star = self.rest..self.rest + n;
        self.rest += n;
        self.edges.clear();
        let edge = |c: Local, d: Local| u32::from(c) << 16 | u32::from(d);
        for &[_, a, b, c] in &self.tets[self.star.clone()] {
            self.edges.extend([edge(a, b), edge(b, c), edge(c, a)]);
        }
        // Whole vectors are searched.
        self.edges.resize(self.edges.len().next_multiple_of(4), TOLD);
    }

    #[inline]
    fn apex(&mut self, c: Local, d: Local) -> Local {
        let wanted = u32::from(c) << 16 | u32::from(d);
        // A directed edge has one triangle; if not, the mesh is none, and the one taken here is told before the other.
        let mut hits = [0u32; 4];
        for (at, four) in (1..).zip(self.edges.chunks_exact(4)) {
            for (hit, &e) in hits.iter_mut().zip(four) {
                *hit = if e == wanted { at } else { *hit };
            }
        }
        for (lane, &hit) in hits.iter().enumerate() {
            if hit != 0 {
                let i = (hit as usize - 1) * 4 + lane;
                let [_, t @ ..] = self.tets[self.star.start + i / 3];
                self.edges[i / 3 * 3..i / 3 * 3 + 3].fill(TOLD);
                return t[(i % 3 + 2) % 3];
            }
        }
        NONE
    }

    #[inline]
    fn seed(&mut self) -> Option<[Local; 3]> {
        let untold = |i: &usize| self.edges[3 * (i - self.star.start)] != TOLD;
        let i = self.star.clone().find(untold)?;
        let at = 3 * (i - self.star.start);
        self.edges[at..at + 3].fill(TOLD);
        let [_, t @ ..] = self.tets[i];
        Some(t)
    }

    #[inline]
    fn tell(&mut self, _: [Local; 4]) {}
}

struct Reader<'a> {
    coder: Decoder<'a>,
    /// The vertices by local number.
    ids: Vec<u32>,
    out: &'a mut Vec<Tet>,
}

impl End for Reader<'_> {
    #[inline]
    fn gate(&mut self, context: usize, _: usize) -> usize {
        self.coder.symbol(&GATES[context])
    }

    #[inline]
    fn number(&mut self, context: usize, _: u32) -> u32 {
        let symbol = self.coder.symbol(&NUMBERS[context]);
        if symbol < 4 {
            return symbol as u32;
        }
        let top = symbol as u32 / 2;
        let (mut n, mut left) = if symbol < ESCAPE { (2 | (symbol as u32 % 2), top - 1) } else { (0, 32) };
        while left > 0 {
            let take = left.min(11);
            left -= take;
            let shift = 12 - take;
            let bits = self.coder.slot() >> shift;
            self.coder.skip(bits << shift, 1 << shift);
            n = n << take | bits;
        }
        n
    }

    #[inline]
    fn star(&mut self, _: Local) {}

    #[inline]
    fn apex(&mut self, _: Local, _: Local) -> Local {
        NONE
    }

    #[inline]
    fn seed(&mut self) -> Option<[Local; 3]> {
        None
    }

    #[inline]
    fn tell(&mut self, tet: [Local; 4]) {
        let id = |v: Local| self.ids[usize::from(v)];
        self.out.push([id(tet[0]), id(tet[1]), id(tet[2]), id(tet[3])]);
    }
}

/// Decodes what [`Writer::encode`] wrote; every vertex is below `vertices`.
pub(crate) fn decode(bytes: &[u8], vertices: u32, out: &mut Vec<Tet>) -> Result<(), Malformed> {
    let mut c = Cursor::new(bytes);
    let (first, own) = (c.varint32("first vertex")?, c.varint32("own vertices")?);
    let (others, tets) = (c.varint32("other vertices")?, c.varint32("tetrahedra")?);
    let bad = || Malformed::new("tetrahedra", "the stars of a run of vertices", "something else");
    let fits = first.checked_add(own).is_some_and(|end| end <= vertices);
    if tets as usize > LARGEST_STARS || own.max(others) >= LARGEST_LIST || !fits {
        return Err(bad());
    }
    let coder = Decoder::new(c.rest()).ok_or_else(bad)?;
    let mut ids = Vec::with_capacity((own + others) as usize);
    ids.extend(first..first + own);
    out.reserve(tets as usize);
    let mut end = Reader { coder, ids: vec![], out };
    tell_others(&mut end, first + own, others, &[], vertices, &mut ids).ok_or_else(bad)?;
    end.ids = ids;
    tell(&mut end, own as Local, others as Local, tets as usize).ok_or_else(bad)?;
    if end.coder.at_end() { Ok(()) } else { Err(bad()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::chunk::tests::{cubes, sorted};
    use crate::geom::curve::Order;
    use crate::mesh::delaunay::Mesher;

    fn round_trip(tets: &[Tet], vertices: u32) -> usize {
        let tets = sorted(tets);
        let mut bytes = vec![];
        assert!(Writer::default().encode(&tets, vertices, &mut bytes));
        let mut back = vec![[9; 4]];
        decode(&bytes, vertices, &mut back).unwrap();
        assert_eq!(back.remove(0), [9; 4], "appended");
        assert!(sorted(&back) == tets);
        bytes.len()
    }

    /// A fixed sequence without pattern.
    fn noise() -> impl FnMut(u32) -> u32 {
        let mut state = 1u64;
        move |below| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % u64::from(below)) as u32
        }
    }

    #[test]
    fn grids_come_back_whole_and_with_holes() {
        round_trip(&[[0, 1, 2, 3]], 4);
        round_trip(&[[3, 1, 70_000, 900]], 70_001);
        for n in [[1, 1, 1], [4, 1, 1], [3, 3, 3], [12, 11, 7]] {
            let tets = cubes(n);
            let vertices = n.iter().map(|k| k + 1).product();
            let bytes = round_trip(&tets, vertices);
            assert!(tets.len() < 500 || bytes * 8 < tets.len() * 6, "{bytes} bytes for {}", tets.len());
            let holes: Vec<Tet> = (0..).zip(&tets).filter(|(i, _)| i * 7 % 5 != 0).map(|(_, &t)| t).collect();
            if !holes.is_empty() {
                round_trip(&holes, vertices);
            }
        }
    }

    #[test]
    fn blocks_of_a_delaunay_mesh_are_small() {
        let mut next = noise();
        let mut positions: Vec<[u32; 3]> = (0..6000).map(|_| [0; 3].map(|_: u32| next(1 << 20))).collect();
        let order = Order::for_count(6000);
        positions.sort_by_cached_key(|&p| order.key(p));
        let mut mesher = Mesher::new();
        mesher.delaunay(&positions, &order).unwrap();
        let mut tets = vec![];
        mesher.for_each_tet(|t| tets.push(t));
        let tets = sorted(&tets);
        let mut bytes = 0;
        for run in tets.chunk_by(|a, b| a[0] / 150 == b[0] / 150) {
            bytes += round_trip(run, 6000);
        }
        // So few points are surface above all; in a large mesh it is 5.3 bits.
        assert!(bytes < tets.len(), "{bytes} bytes for {}", tets.len());
    }

    #[test]
    fn tetrahedra_that_are_no_mesh_come_back_too() {
        let mut next = noise();
        for n in [1, 2, 10, 500, 3000] {
            let any: Vec<Tet> = std::iter::repeat_with(|| [0; 4].map(|_: u32| next(40)))
                .filter(|t| (1..4).all(|i| !t[..i].contains(&t[i])))
                .take(n)
                .collect();
            round_trip(&any, 40);
        }
        let both: Vec<Tet> =
            cubes([2, 2, 2]).iter().flat_map(|&[a, b, c, d]| [[a, b, c, d], [b, a, c, d]]).collect();
        round_trip(&both, 27);
        round_trip(&[[0, 1, 2, 3]; 3], 4);
    }

    #[test]
    fn what_does_not_fit_is_left_to_another_coder() {
        let mut writer = Writer::default();
        let mut out = vec![];
        assert!(!writer.encode(&[], 10, &mut out));
        assert!(!writer.encode(&[[0, 1, 2, 3], [100_000, 100_001, 100_002, 100_003]], 100_004, &mut out));
        assert!(!writer.encode(&[[0, 1, 2, 2]], 3, &mut out));
        // A star of too many pieces.
        let many: Vec<Tet> = (0..1000).map(|i| [0, 3 * i + 1, 3 * i + 2, 3 * i + 3]).collect();
        assert!(!writer.encode(&many, 3001, &mut out));
        assert!(out.is_empty());
        assert!(writer.encode(&[[0, 1, 2, 3]], 4, &mut out), "what came before does no harm");
        decode(&out, 4, &mut vec![]).unwrap();
    }

    #[test]
    fn no_damage_panics_or_gives_a_vertex_that_is_not_there() {
        let tets = sorted(&cubes([4, 3, 3]));
        let mut good = vec![];
        assert!(Writer::default().encode(&tets, 80, &mut good));
        assert!(decode(&good, 79, &mut vec![]).is_err(), "vertex 79 is in use");
        for i in 0..good.len() {
            assert!(decode(&good[..i], 80, &mut vec![]).is_err());
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[i] ^= 1 << bit;
                for bytes in [&bad[..], &[&bad[..4], &[0x55; 90]].concat()] {
                    let mut out = vec![];
                    if decode(bytes, 80, &mut out).is_ok() {
                        assert!(out.iter().flatten().all(|&v| v < 80));
                    }
                }
            }
        }
    }
}
