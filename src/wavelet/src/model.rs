//! The odds of a tile's decisions: which there are, and with what they begin.

use crate::range_coder::Odds;
use crate::tables::{CLASSES, KINDS, PER_SET, SETS, STEPS, TABLES};

/// Magnitudes up to this many more than 1 are coded in unary, larger ones as Exp-Golomb codes.
pub(crate) const UNARY: u32 = 14;

/// The odds of bands that are high along as many axes.
#[derive(Clone, Debug)]
#[repr(C)]
pub(crate) struct Odd {
    /// Whether a band has any coefficient but zeros: without and with a parent.
    pub band: [Odds; 2],
    /// Whether a group has any: by the parents' energy and by the bands before.
    pub group: [Odds; 4],
    /// Whether a coefficient is other than zero.
    pub other: [[Odds; CLASSES]; KINDS],
    /// Whether a magnitude is larger.
    pub larger: [[Odds; CLASSES]; STEPS],
}

/// The set of the tables that corrections of samples begin with, after those of tiles.
pub(crate) const CORRECTIONS: usize = SETS;

/// All odds of a tile.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub sets: [Odd; 3],
}

impl Model {
    /// The odds with which a tile of a level begins.
    pub(crate) fn of(level: usize) -> Self {
        let first = (level - 1) % 3 * 3;
        Self { sets: std::array::from_fn(|highs| Odd::from(&TABLES[first + highs])) }
    }
}

impl Odd {
    /// The odds with which corrections of samples begin.
    pub(crate) fn of_corrections() -> Self {
        Self::from(&TABLES[CORRECTIONS])
    }

    fn from(numbers: &[u16; PER_SET]) -> Self {
        let mut next = numbers.iter().map(|n| Odds::new(*n));
        Self::of(|| next.next().unwrap_or(Odds::new(1 << 15)))
    }

    /// Odds that are numbers of decisions instead: `first` and those that follow.
    pub(crate) fn numbered(first: u16) -> Self {
        let mut next = (first..).map(Odds::numbered);
        Self::of(|| next.next().unwrap_or(Odds::new(0)))
    }

    fn of(mut take: impl FnMut() -> Odds) -> Self {
        Self {
            band: [(); 2].map(|()| take()),
            group: [(); 4].map(|()| take()),
            other: [[(); CLASSES]; KINDS].map(|row| row.map(|()| take())),
            larger: [[(); CLASSES]; STEPS].map(|row| row.map(|()| take())),
        }
    }
}

/// The row of `larger` for a magnitude of at least `magnitude`.
#[inline(always)]
pub(crate) fn step(magnitude: u32) -> usize {
    const OF: [u8; 15] = [0, 0, 1, 2, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 5];
    usize::from(OF[(magnitude as usize).min(14)])
}

/// The class of an energy: 0 to 3 by themselves, then two classes for each doubling.
#[inline(always)]
pub(crate) fn class(energy: u32) -> usize {
    if energy < 4 {
        return energy as usize;
    }
    let log = 31 - energy.leading_zeros();
    let class = 2 * log + (energy >> (log - 1) & 1);
    (class as usize).min(CLASSES - 1)
}

/// What a bit costs, in bits, by the odds of what it is, in 1/256.
static COSTS: [f32; 257] = {
    let (mut costs, mut p) = ([16.0; 257], 1);
    while p < 257 {
        costs[p] = cost_of(p as u64);
        p += 1;
    }
    costs
};

/// Minus the base-2 logarithm of p / 256, from integers alone: the same on all machines.
const fn cost_of(p: u64) -> f32 {
    // x stays in [2^31, 2^32), a number in [1, 2) whose logarithm is told bit by bit.
    let whole = 63 - p.leading_zeros();
    let (mut x, mut fraction, mut bit) = (p << (31 - whole), 0u32, 0);
    while bit < 10 {
        x = (x * x) >> 31;
        fraction <<= 1;
        if x >= 1 << 32 {
            x >>= 1;
            fraction |= 1;
        }
        bit += 1;
    }
    8.0 - whole as f32 - fraction as f32 / 1024.0
}

/// Bits that a decision is going to take, nearly.
#[inline(always)]
pub(crate) fn cost(odds: Odds, bit: bool) -> f32 {
    let set = odds.set();
    let p = if bit { set } else { 65_536 - set };
    COSTS[((p + 128) >> 8) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_are_logarithms() {
        for (p, cost) in COSTS.iter().enumerate().skip(1) {
            let is = -(p as f64 / 256.0).log2();
            assert!((f64::from(*cost) - is).abs() < 0.002, "{p}: {cost} {is}");
        }
    }

    #[test]
    fn classes_ascend() {
        assert_eq!([0, 3, 4, 5, 6, 7, 8, 12, 16].map(class), [0, 3, 4, 4, 5, 5, 6, 7, 8]);
        assert!((1..4000).all(|e| class(e) - class(e - 1) <= 1));
        assert_eq!(class(u32::MAX), CLASSES - 1);
    }
}
