//! The encoder's end of the star coder.

pub(super) mod even;

use super::bits::BitWriter;
use super::link::{GATES, Gate, Gates, LANES, Link, MOST, NOBODY, Path, ends, gate};
use super::odds::first_odds;
use super::{DECISIONS, End, LARGEST_LIST, LARGEST_STARS, Local, NONE, Stars};
use crate::archive::range_coder::{Encoder, Odds};
use crate::archive::wire::put_varint;
use even::{FoundGate, Luck};
use isospan_io::geom::LatticePos;
use isospan_mesh::mesh::tet::Tet;
use std::ops::Range;

/// Encodes blocks of one chunk.
#[derive(Default)]
pub(crate) struct Writer {
    pub(super) stars: Stars,
    pub(super) truth: Truth,
    /// For each vertex of the chunk its local number in the last block that has it, and 2^16 times
    /// that block's number.
    numbers: Vec<u32>,
    block: u16,
    others: Vec<u32>,
    positions: Vec<LatticePos>,
}

/// The encoder's end: what it knows, and what it writes.
pub(super) struct Truth {
    coder: Encoder,
    pub(super) bits: BitWriter,
    /// For each look at gates of the star: their number, and their hits. Then, whether there is
    /// more to the star.
    hits: Vec<(u8, u8)>,
    is_odd: bool,
    pub(super) tets: Vec<[Local; 4]>,
    /// Where the tetrahedra of the stars to come begin.
    pub(super) rest: usize,
    star: Range<usize>,
    /// Triangles of the star that are not coded.
    uncoded: usize,
    /// For each directed edge between places of the link the third place of the triangle that has
    /// it and is not coded.
    thirds: Box<[u8; GATES]>,
    /// Triangles that are not coded and had a vertex without a place when the star began.
    loose: Vec<[Local; 3]>,
    /// The vertices by local number, and the tetrahedra as they are coded: as they will be decoded.
    pub(super) ids: Vec<u32>,
    pub(super) coded: Vec<Tet>,
    /// How many are coded.
    pub(super) at: usize,
    /// What was found about the star that was tried last.
    pub(super) found: FoundGate,
    pub(super) luck: Luck,
    /// For the test that makes `odds.rs`: of each decision how often, and how often so.
    #[cfg(test)]
    pub(super) counts: std::collections::BTreeMap<usize, [f64; 2]>,
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
            uncoded: 0,
            thirds: Box::new([TOLD; GATES]),
            loose: vec![],
            ids: vec![],
            coded: vec![],
            at: 0,
            found: FoundGate::default(),
            luck: Luck::default(),
            #[cfg(test)]
            counts: Default::default(),
        }
    }
}

/// So many edges in a hundred have their far end within the radius of a neighbourhood.
const WITHIN: usize = 99;

impl Writer {
    /// Encodes canonical tetrahedra, ascending by their first vertices, of which own ones begin at
    /// `own_from`, given where all vertices are; false, with nothing written, if the block is none
    /// for this coder: empty, too large, no mesh, or with too large a star.
    pub(crate) fn encode(
        &mut self,
        tets: &[Tet],
        own_from: u32,
        positions: &[LatticePos],
        out: &mut Vec<u8>,
    ) -> bool {
        let Some(last) = tets.last() else { return false };
        let (first, own) = (own_from, last[0] - own_from + 1);
        if tets.len() > LARGEST_STARS
            || own >= LARGEST_LIST
            || !self.localise(tets, first, own, positions.len())
        {
            return false;
        }
        let ids = (first..first + own).chain(self.others.iter().copied());
        self.truth.ids.clear();
        self.truth.ids.extend(ids);
        self.truth.coded.resize(tets.len(), [0; 4]);
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
        out.push(size);
        put_varint(out, u64::from(n));
        self.truth.bits.finish(out);
        self.truth.coder.finish(out);
        true
    }

    /// The tetrahedra of the block that was just encoded, as they will be decoded.
    pub(crate) fn decoded(&self) -> &[Tet] {
        &self.truth.coded
    }

    /// Lists the others and numbers the vertices; false if there are too many, or a tetrahedron has
    /// a vertex twice.
    fn localise(&mut self, tets: &[Tet], first: u32, own: u32, vertices: usize) -> bool {
        self.block = self.block.wrapping_add(1);
        if self.block == 0 || self.numbers.len() != vertices {
            self.numbers.clear();
            self.numbers.resize(vertices, 0);
            self.block = 1;
        }
        let stamp = u32::from(self.block) << 16;
        let numbers = &mut self.numbers[..];
        numbers[first as usize..(first + own) as usize].fill(stamp);
        // What is not new is overwritten: no branch, for none could be predicted.
        self.others.resize(3 * tets.len() + 1, 0);
        let (mut n, others) = (0, &mut self.others[..]);
        for t in tets {
            for &v in &t[1..] {
                others[n] = v;
                n += usize::from(std::mem::replace(&mut numbers[v as usize], stamp) < stamp);
            }
        }
        self.others.truncate(n);
        if n >= LARGEST_LIST as usize {
            return false;
        }
        self.others.sort_unstable();
        (stamp..).zip(&mut numbers[first as usize..(first + own) as usize]).for_each(|(n, to)| *to = n);
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

    /// The radius of a neighbourhood, as [`Cloud::set`] takes it: from the edges of all tetrahedra
    /// to their largest vertices. (From some edges only, it would depend on the order in which the
    /// mesher gives them.)
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
        (self.rest, self.star, self.uncoded, self.at) = (0, 0..0, 0, 0);
    }

    /// Forgets what remains of a block that cannot be coded.
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

    /// Codes the triangle behind a gate if it has a certain apex, and says whether it does. There
    /// is no branch, for none could be predicted.
    #[inline(always)]
    fn take_if(&mut self, on: Gate, apex: usize) -> bool {
        let hit = (self.third(on) == apex) & (apex != NOBODY);
        let [c, d] = ends(on);
        // All bits of a place set are no place.
        let mark = TOLD * u8::from(hit);
        for edge in [on, gate(d, apex), gate(apex, c)] {
            self.thirds[usize::from(edge) % GATES] |= mark;
        }
        self.uncoded -= usize::from(hit);
        hit
    }

    /// The triangle is now coded.
    #[inline(always)]
    fn take(&mut self, on: Gate, third: usize) {
        let [c, d] = ends(on);
        for edge in [on, gate(d, third), gate(third, c)] {
            self.thirds[usize::from(edge) % GATES] = TOLD;
        }
        self.uncoded -= 1;
    }

    /// Which of the loose triangles is behind a gate, and its apex.
    #[cold]
    fn find_loose(&self, link: &Link, on: Gate) -> Option<(usize, Local)> {
        let [c, d] = ends(on).map(|i| link.id[i]);
        let apex =
            |t: &[Local; 3]| (0..3).find(|&k| t[k] == c && t[(k + 1) % 3] == d).map(|k| t[(k + 2) % 3]);
        self.loose.iter().enumerate().find_map(|(i, t)| Some((i, apex(t)?)))
    }

    /// Codes the loose triangles that are predicted.
    #[cold]
    fn loose_hits(&mut self, link: &Link, gates: &Gates) -> u32 {
        let mut hits = 0;
        for lane in 0..gates.len {
            let (on, apex) = (gates.gates[lane % LANES], gates.apex(lane));
            if let Some((i, w)) = self.find_loose(link, on)
                && apex != NOBODY
                && w == link.id[apex]
            {
                self.loose.swap_remove(i);
                self.uncoded -= 1;
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

    /// Codes the loose triangle behind a gate: its apex, or [`NONE`] if there is none.
    #[cold]
    fn take_loose(&mut self, link: &Link, on: Gate) -> Local {
        let Some((i, w)) = self.find_loose(link, on) else { return NONE };
        self.loose.swap_remove(i);
        self.uncoded -= 1;
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
        self.uncoded = n;
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
        self.is_odd |= self.uncoded > 0;
        self.is_odd
    }

    #[inline(always)]
    fn has_uncoded(&self) -> bool {
        self.uncoded > 0
    }

    #[inline(always)]
    fn end_star(&mut self) {
        self.write_star();
    }

    fn uncoded(&self, link: &Link, to: &mut Vec<[Local; 3]>) {
        let is_coded = |t: &[Local; 3]| match [t[0], t[1], t[2]].map(|w| link.find(w)) {
            [Some(a), Some(b), Some(c)] => self.third(gate(a, b)) != c,
            _ => true,
        };
        let star = self.tets[self.star.clone()].iter().map(|&[_, t @ ..]| t);
        to.extend(star.filter(|t| !is_coded(t)));
        to.extend(&self.loose);
    }

    #[inline(always)]
    fn tell(&mut self, tet: [Local; 4]) {
        let id = |v: Local| self.ids[usize::from(v)];
        // If the input is no mesh, more may be coded than there is: it is refused when the star
        // ends.
        if let Some(place) = self.coded.get_mut(self.at) {
            *place = [id(tet[0]), id(tet[1]), id(tet[2]), id(tet[3])];
        }
        self.at += 1;
    }

    #[inline(always)]
    fn even(&mut self, path: impl Path, stars: &mut Stars) -> Option<usize> {
        self.tell_even(path, stars)
    }
}
