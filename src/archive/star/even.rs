//! Even stars, told by the encoder with half of the geometry.
//!
//! The coder looks at gates four at a time, foretells what is behind each, and compares that with the truth before it looks at the next. The encoder
//! need not: it knows the truth. If the star is even, each gate behind which is an untold triangle was a hit, and each other one was none; so
//! gates, hits and bits follow from the triangles alone. What remains to be found out is whether all hits are foretold, and that is asked
//! afterwards, of many gates at once, all lanes in use, and not at all of gates behind which is nothing (about two of five).
//!
//! If one is not, the star is told in the usual way: it is mostly odd. Where most stars are (many points on
//! one sphere) only few are tried.

use super::link::{GATES, Gate, Gates, LANES, Link, MOST, NOBODY, Path, ends, gate};
use super::write::{TOLD, Truth};
use super::{Even, Stars};

/// The most triangles of a star that is tried, and the most bits.
const MOST_HITS: usize = 60;
const MOST_BITS: u32 = 60;

/// More than a multiple of [`LANES`] behind them.
const ROOM: usize = 64;

/// The gates that are hits if all are foretold, the places of what is behind them, and their number.
pub(super) struct Found {
    gates: [Gate; ROOM],
    places: [u8; ROOM],
    len: usize,
}

impl Default for Found {
    fn default() -> Self {
        Self { gates: [gate(NOBODY, NOBODY); ROOM], places: [0; ROOM], len: 0 }
    }
}

/// Whether stars are worth a try.
#[derive(Default)]
pub(super) struct Luck {
    /// Stars to pass over, and how many they will be after the next that was in vain.
    pass: u32,
    then: u32,
}

impl Luck {
    /// Tries no star, for as long as a test takes.
    #[cfg(test)]
    pub(super) fn none() -> Self {
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
    /// Tells the star that has begun, if it is even.
    #[inline(always)]
    pub(super) fn tell_even(&mut self, path: impl Path, stars: &mut Stars) -> Even {
        let fits = self.untold <= MOST_HITS && self.loose.is_empty() && !stars.link.is_crowded();
        if !fits || !self.luck.tries() {
            return Even::Unknown;
        }
        let (bits, len) = self.follow(&mut stars.link);
        let is_even = self.found.len == self.untold && len <= MOST_BITS && self.are_foretold(path, stars);
        self.luck.learn(is_even);
        if !is_even {
            return Even::No;
        }
        let first = len.min(32);
        self.bits.put((bits & 0xffff_ffff) as u32, first);
        self.bits.put((bits >> first) as u32, len - first);
        Even::Told(self.tell_found(stars))
    }

    /// Finds out what is behind the gates as if all were foretold, and closes them. Gives the bits of the star and their number.
    #[inline(always)]
    fn follow(&mut self, link: &mut Link) -> (u64, u32) {
        // A star that is not odd begins with a zero.
        let (mut bits, mut len) = (0u64, 1u32);
        let (mut n, found, thirds) = (0, &mut self.found, &*self.thirds);
        // Of what is no mesh, triangles might be found again and again.
        while n <= self.untold
            && let Some(gates) = link.next_four()
        {
            for (on, was_open) in gates {
                let third = thirds[usize::from(on) % GATES];
                // One that a triangle before it has closed is no hit.
                let hit = u8::from(link.is_open(on) & (third != TOLD)) & was_open;
                // Of no triangle the third place is that of nobody, whose gates are always closed.
                let w = if hit == 1 { usize::from(third) } else { NOBODY };
                link.close(on);
                let [c, d] = ends(on);
                link.meet_new(gate(c, w), hit);
                link.meet_new(gate(w, d), hit);
                bits |= u64::from(hit).wrapping_shl(len);
                len += u32::from(was_open);
                (found.gates[n % ROOM], found.places[n % ROOM]) = (on, w as u8);
                n += usize::from(hit);
            }
        }
        found.len = n;
        while let Some(gates) = link.next_four() {
            gates.into_iter().for_each(|(gate, _)| link.close(gate));
        }
        (bits, len)
    }

    /// Whether all that was found is foretold.
    #[inline(always)]
    fn are_foretold(&self, path: impl Path, stars: &Stars) -> bool {
        let mut gates = Gates::default();
        let (found, mut good) = (&self.found, true);
        for first in (0..found.len).step_by(LANES) {
            gates.gates[..LANES].copy_from_slice(&found.gates[first..first + LANES]);
            path.search(&stars.link, &mut gates);
            for lane in 0..LANES {
                let is_told = gates.apex(lane) == usize::from(found.places[first + lane]);
                good &= is_told | (first + lane >= found.len);
            }
        }
        good
    }

    /// Tells the triangles that were found.
    #[inline(always)]
    fn tell_found(&mut self, stars: &mut Stars) -> usize {
        let (v, n) = (self.ids[stars.v], self.found.len);
        for k in 0..n {
            let [c, d] = ends(self.found.gates[k]);
            let w = usize::from(self.found.places[k]);
            for edge in [gate(c, d), gate(d, w), gate(w, c)] {
                self.thirds[usize::from(edge) % GATES] = TOLD;
            }
            let [c, d, w] = [c, d, w].map(|i| stars.link.id[i % MOST]);
            let id = |v: u16| self.ids[usize::from(v)];
            self.told.push([v, id(c), id(d), id(w)]);
            stars.wait(c, d, w).expect("there is room for a face of each tetrahedron");
        }
        self.untold = 0;
        n
    }
}
