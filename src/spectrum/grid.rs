//! Evenly spaced isovalues, on grids that nest: every grid is part of each finer one of its family.
//!
//! ```text
//!  rung 2   0.1 ·                   1                   (decimal: steps 1 and 2 times a power of ten)
//!  rung 1  0.02 ·   1   2   3   4   5
//!  rung 0  0.01 · 1 2 3 4 5 6 7 8 9 10
//! ```
//!
//! So what was measured of a chunk, on a grid chosen for its own values, can later be added up on
//! the coarser grid of all values. That has no error and needs no second look at the chunk. The
//! range of all holds the range of each, and the finest grid with at most so many isovalues in a
//! range is never finer than that of a part of the range.
//!
//! A multiple is rounded to `f32` from the number itself, its factors of ten taken out, so it is
//! the same `f32` on each rung.

use serde::Serialize;

/// Which steps there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Family {
    /// Powers of two: neighbouring rungs differ by a factor of 2 only.
    Binary,
    /// 1 and 2 times powers of ten: isovalues as people write them.
    Decimal,
}

impl Family {
    /// Rungs between which all steps between `f32` values lie.
    fn rungs(self) -> std::ops::RangeInclusive<i32> {
        match self {
            Self::Binary => -149..=127,
            Self::Decimal => 2 * -46..=2 * 38 + 1,
        }
    }
}

/// A step of a family.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LevelStep {
    /// The family.
    pub family: Family,
    /// Which of its steps: 2^rung, or 10^⌊rung/2⌋, twice that where the rung is odd.
    pub rung: i32,
}

impl LevelStep {
    /// The step of a rung; `None` where that is no step between `f32` values.
    pub fn new(family: Family, rung: i32) -> Option<Self> {
        family.rungs().contains(&rung).then_some(Self { family, rung })
    }

    /// Its digit and its power of ten.
    fn decimal(self) -> (i64, i32) {
        (1 + i64::from(self.rung.rem_euclid(2)), self.rung.div_euclid(2))
    }

    /// About how large it is.
    pub(super) fn size(self) -> f64 {
        match (self.family, self.decimal()) {
            (Family::Binary, _) => power_of_two(self.rung),
            (_, (digit, exponent @ 0..)) => digit as f64 * power_of_ten(exponent),
            (_, (digit, exponent)) => digit as f64 / power_of_ten(-exponent),
        }
    }

    /// The steps of a family, the largest first.
    pub(super) fn descending(family: Family) -> impl Iterator<Item = Self> {
        family.rungs().rev().map(move |rung| Self { family, rung })
    }

    /// The n-th multiple, rounded to `f32`.
    pub fn multiple(self, n: i64) -> f32 {
        if self.family == Family::Binary {
            return (n as f64 * power_of_two(self.rung)) as f32;
        }
        let (digit, mut exponent) = self.decimal();
        let mut n = n * digit;
        while n != 0 && n % 10 == 0 {
            (n, exponent) = (n / 10, exponent + 1);
        }
        let n = n as f64;
        (if exponent < 0 { n / power_of_ten(-exponent) } else { n * power_of_ten(exponent) }) as f32
    }

    /// The number of the least multiple above `x`. It grows with `x`.
    fn above(self, x: f32) -> i64 {
        // Rounding moves a multiple by less than a step.
        let mut n = (f64::from(x) / self.size()) as i64;
        while self.multiple(n) > x {
            n -= 1;
        }
        while self.multiple(n) <= x {
            n += 1;
        }
        n
    }

    /// How many of these steps make one of `coarser`, which is of the same family and not finer; at
    /// most 2^63 - 1.
    fn steps_in(self, coarser: Self) -> i64 {
        let up = (coarser.rung - self.rung).unsigned_abs();
        match self.family {
            Family::Binary => 1i64.checked_shl(up).filter(|n| *n > 0).unwrap_or(i64::MAX),
            Family::Decimal => {
                let ((fine, low), (coarse, high)) = (self.decimal(), coarser.decimal());
                let tens = 10i64.checked_pow((high - low).unsigned_abs());
                tens.and_then(|t| t.checked_mul(coarse)).map_or(i64::MAX, |n| n / fine)
            }
        }
    }
}

fn power_of_two(n: i32) -> f64 {
    f64::from_bits(((1023 + n) as u64) << 52)
}

/// Correctly rounded, as parsing is on every machine; `powi` need not be. For 0 to 46.
fn power_of_ten(n: i32) -> f64 {
    const POWERS: [f64; 47] = [
        1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17,
        1e18, 1e19, 1e20, 1e21, 1e22, 1e23, 1e24, 1e25, 1e26, 1e27, 1e28, 1e29, 1e30, 1e31, 1e32, 1e33, 1e34,
        1e35, 1e36, 1e37, 1e38, 1e39, 1e40, 1e41, 1e42, 1e43, 1e44, 1e45, 1e46,
    ];
    // Multiples may have factors of ten more than any step: those are beyond all `f32`.
    POWERS.get(n.unsigned_abs() as usize).copied().unwrap_or(f64::INFINITY)
}

/// All multiples of a step above the least value, up to the largest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct IsovalueGrid {
    /// The step.
    pub step: LevelStep,
    /// Which multiple is the first isovalue.
    pub first: i64,
    /// Number of isovalues.
    pub count: u32,
}

impl IsovalueGrid {
    /// The isovalues of the finest step that gives at most `most` of them in `lo < v <= hi`, and is
    /// not below the spacing of `f32` there.
    pub(super) fn new(family: Family, [lo, hi]: [f32; 2], most: u32) -> Self {
        let spacing = f64::from(lo.abs().max(hi.abs())) / f64::from(1u32 << 23);
        let least = ((f64::from(hi) - f64::from(lo)) / f64::from(most.max(1))).max(spacing);
        for rung in family.rungs() {
            let step = LevelStep { family, rung };
            // A little less, for the size is rounded.
            if step.size() < least * (1.0 - 1e-12) {
                continue;
            }
            let (first, end) = (step.above(lo), step.above(hi));
            if (end - first) as u64 <= u64::from(most) {
                return Self { step, first, count: (end - first) as u32 };
            }
        }
        Self { step: LevelStep { family, rung: *family.rungs().end() }, first: 1, count: 0 }
    }

    /// The n-th isovalue.
    pub fn value(&self, n: u32) -> f32 {
        self.step.multiple(self.first + i64::from(n))
    }

    /// All isovalues, ascending.
    pub fn values(&self) -> Vec<f32> {
        (0..self.count).map(|n| self.value(n)).collect()
    }

    /// The number of the one that is this isovalue, if one is.
    pub fn find(&self, isovalue: f32) -> Option<u32> {
        let last = self.count.checked_sub(1)?;
        if !(self.value(0) <= isovalue && isovalue <= self.value(last)) {
            return None;
        }
        // Any of several equal isovalues will do.
        let n = (self.step.above(isovalue) - 1 - self.first).clamp(0, i64::from(last)) as u32;
        (self.value(n) == isovalue).then_some(n)
    }

    /// The number in this grid of the `n`-th isovalue of a coarser grid; `None` if it is not in the
    /// range of this one.
    pub(super) fn number_of(&self, coarser: &Self, n: u32) -> Option<u32> {
        let steps = i128::from(self.step.steps_in(coarser.step));
        let here = (i128::from(coarser.first) + i128::from(n)) * steps - i128::from(self.first);
        u32::try_from(here).ok().filter(|h| *h < self.count)
    }
}

/// Finds places in a grid, often.
pub(super) struct Places {
    values: Vec<f32>,
    scale: f64,
    first: f64,
}

impl Places {
    pub(super) fn new(grid: &IsovalueGrid) -> Self {
        Self { values: grid.values(), scale: 1.0 / grid.step.size(), first: grid.first as f64 - 1.0 }
    }

    /// How many isovalues are at or below `x`, which is in the grid's range.
    #[inline]
    pub(super) fn of(&self, x: f32) -> u32 {
        // A cast makes 0 of what is below and of NaN.
        let mut n = ((f64::from(x) * self.scale - self.first) as u32 as usize).min(self.values.len());
        while n < self.values.len() && self.values[n] <= x {
            n += 1;
        }
        while n > 0 && self.values[n - 1] > x {
            n -= 1;
        }
        n as u32
    }
}

/// The same of a binary grid, without looking at its isovalues: they are exact multiples of the
/// step, and so are, in `f64`, values divided by it.
pub(super) struct BinaryPlaces {
    scale: f64,
    /// The multiple before the first.
    before: f64,
    count: f64,
}

impl BinaryPlaces {
    pub(super) fn new(grid: &IsovalueGrid) -> Self {
        assert_eq!(grid.step.family, Family::Binary, "only its steps are powers of two");
        let scale = 1.0 / grid.step.size();
        Self { scale, before: grid.first as f64 - 1.0, count: f64::from(grid.count) }
    }

    /// How many isovalues are at or below `x`, which is not NaN.
    #[inline(always)]
    pub(super) fn of(&self, x: f32) -> u32 {
        let place = ((f64::from(x) * self.scale).floor() - self.before).max(0.0).min(self.count);
        // The last bits are those of the integer: a sum is made in vectors, a cast is not.
        (place + (1u64 << 52) as f64).to_bits() as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FAMILIES: [Family; 2] = [Family::Binary, Family::Decimal];

    #[test]
    fn levels_are_what_people_write() {
        let levels = IsovalueGrid::new(Family::Decimal, [0.0, 1300.0], 8192);
        assert_eq!((levels.step.decimal(), levels.count), ((2, -1), 6500));
        for text in ["600", "0.2", "1299.8", "1300", "17.4"] {
            let v: f32 = text.parse().unwrap();
            assert_eq!(levels.value(levels.find(v).unwrap()), v, "{text}");
        }
        for v in [0.0, -5.0, 1300.2, 0.01, 600.001] {
            assert_eq!(levels.find(v), None, "{v}");
        }
        // Not finer than the values are.
        let levels = IsovalueGrid::new(Family::Decimal, [1e6, 1e6 + 1.0], 8192);
        assert_eq!((levels.step.decimal(), levels.count), ((2, -1), 5));
        assert_eq!(IsovalueGrid::new(Family::Decimal, [3.5, 3.5], 1000).count, 0);
        let knots = IsovalueGrid::new(Family::Binary, [0.0, 255.0], 128);
        assert_eq!((knots.step.rung, knots.count, knots.value(0)), (1, 127, 2.0));
    }

    proptest! {
        #[test]
        fn a_grid_ascends_in_its_range_and_is_part_of_that_of_a_smaller_range(
            a in prop::num::f32::NORMAL, b in prop::num::f32::ANY, c in 0f64..=1.0, d in 0f64..=1.0, most in 1u32..3000,
        ) {
            let b = if b.is_finite() { b } else { a };
            let (lo, hi) = (a.min(b), a.max(b));
            let within = |t: f64| ((f64::from(lo) + t * (f64::from(hi) - f64::from(lo))) as f32).clamp(lo, hi);
            let part = [within(c.min(d)), within(c.max(d))];
            for family in FAMILIES {
                let (all, fine) = (IsovalueGrid::new(family, [lo, hi], most), IsovalueGrid::new(family, part, most));
                prop_assert!(all.count <= most && fine.step.rung <= all.step.rung);
                let places = Places::new(&fine);
                if family == Family::Binary {
                    let (binary, values) = (BinaryPlaces::new(&fine), fine.values());
                    let between = within(0.5 * (c + d));
                    for x in [part[0], part[1], between, between.next_up(), lo, hi, f32::MIN, f32::MAX, 0.0, -1e-45] {
                        prop_assert_eq!(binary.of(x) as usize, values.partition_point(|&w| w <= x), "{}", x);
                    }
                }
                for n in 0..all.count {
                    let v = all.value(n);
                    prop_assert!(lo < v && v <= hi, "{lo} < {v} <= {hi}");
                    prop_assert!(n == 0 || all.value(n - 1) <= v);
                    prop_assert!(all.find(v).is_some());
                    let here = fine.number_of(&all, n);
                    prop_assert_eq!(here.is_some(), part[0] < v && v <= part[1]);
                    if let Some(m) = here {
                        prop_assert_eq!(fine.value(m).to_bits(), v.to_bits());
                        prop_assert_eq!(places.of(v) as usize, fine.values().partition_point(|&w| w <= v));
                    }
                }
            }
        }
    }
}
