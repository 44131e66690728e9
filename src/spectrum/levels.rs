//! Isovalues as people write them: the multiples of 1, 2 or 5 times a power of ten.

use serde::Serialize;

/// The most levels: a page or two of bytes for each thousand points of a small archive, a megabyte or so for a large one.
pub(crate) const MOST_LEVELS: u64 = 1 << 20;
/// Powers of ten between which all `f32` steps lie.
pub(super) const EXPONENTS: std::ops::RangeInclusive<i32> = -46..=38;

/// A round number: `digit · 10^exponent`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Step {
    /// 1, 2 or 5.
    pub digit: u8,
    /// The power of ten.
    pub exponent: i32,
    /// 10 to the power of |exponent|.
    #[serde(skip)]
    power: f64,
}

impl Step {
    /// `digit · 10^exponent`; `None` where that is no step between `f32` values.
    pub fn new(digit: u8, exponent: i32) -> Option<Self> {
        if !matches!(digit, 1 | 2 | 5) || !EXPONENTS.contains(&exponent) {
            return None;
        }
        // Parsing rounds correctly on every machine; `powi` need not.
        let power = format!("1e{}", exponent.unsigned_abs()).parse().expect("digits are a number");
        Some(Self { digit, exponent, power })
    }

    /// The n-th multiple, rounded to `f32`.
    pub fn multiple(&self, n: i64) -> f32 {
        let n = (n * i64::from(self.digit)) as f64;
        (if self.exponent < 0 { n / self.power } else { n * self.power }) as f32
    }

    /// The number of the least multiple above `x`. It grows with `x`.
    fn above(&self, x: f32) -> i64 {
        let digit = f64::from(self.digit);
        let x64 = f64::from(x);
        let about = if self.exponent < 0 { x64 / digit * self.power } else { x64 / digit / self.power };
        // Rounding moves a multiple by less than a step.
        let mut n = about as i64;
        while self.multiple(n) > x {
            n -= 1;
        }
        while self.multiple(n) <= x {
            n += 1;
        }
        n
    }
}

/// All multiples of a step above the least value, up to the largest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Levels {
    /// The step.
    pub step: Step,
    /// Which multiple is the first level.
    pub first: i64,
    /// Number of levels.
    pub count: u32,
}

impl Levels {
    /// Those of the least round step that gives at most `most` of them in `lo < v <= hi`, and is not below the spacing of `f32` there.
    pub(super) fn new([lo, hi]: [f32; 2], most: u64) -> Self {
        let most = most.min(MOST_LEVELS);
        let spacing = f64::from(lo.abs().max(hi.abs())) / f64::from(1u32 << 23);
        let least = ((f64::from(hi) - f64::from(lo)) / most.max(1) as f64).max(spacing);
        let steps =
            EXPONENTS.flat_map(|e| [1, 2, 5].map(|d| Step::new(d, e).expect("a digit and an exponent")));
        for step in steps {
            let size = f64::from(step.digit);
            let size = if step.exponent < 0 { size / step.power } else { size * step.power };
            if size < least {
                continue;
            }
            let (first, end) = (step.above(lo), step.above(hi));
            if (end - first) as u64 <= most {
                return Self { step, first, count: (end - first) as u32 };
            }
        }
        let step = Step::new(1, *EXPONENTS.end()).expect("the largest exponent is one");
        Self { step, first: 1, count: 0 }
    }

    /// The n-th level.
    pub fn level(&self, n: u32) -> f32 {
        self.step.multiple(self.first + i64::from(n))
    }

    /// The number of the level that is this isovalue, if one is.
    pub fn find(&self, isovalue: f32) -> Option<u32> {
        let n = self.place(isovalue).checked_sub(1)?;
        // Of equal levels any will do.
        (self.level(n) == isovalue).then_some(n)
    }

    /// How many levels are at or below `x`.
    pub(super) fn place(&self, x: f32) -> u32 {
        (self.step.above(x) - self.first).clamp(0, i64::from(self.count)) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn steps_are_round_and_levels_are_what_people_write() {
        let levels = Levels::new([0.0, 1300.0], 49_000);
        assert_eq!((levels.step.digit, levels.step.exponent, levels.count), (5, -2, 26_000));
        for text in ["600", "0.05", "1299.95", "1300", "17.35"] {
            let v: f32 = text.parse().unwrap();
            assert_eq!(levels.level(levels.find(v).unwrap()), v, "{text}");
        }
        for v in [0.0, -5.0, 1300.05, 0.01, 600.001] {
            assert_eq!(levels.find(v), None, "{v}");
        }
        // Not finer than the values are.
        let levels = Levels::new([1e6, 1e6 + 1.0], 1 << 20);
        assert_eq!((levels.step.digit, levels.step.exponent, levels.count), (2, -1, 5));
        assert_eq!(Levels::new([3.5, 3.5], 1000).count, 0);
    }

    proptest! {
        #[test]
        fn levels_ascend_inside_the_range(lo in prop::num::f32::NORMAL, other in prop::num::f32::ANY, most in 1u64..3000) {
            let hi = if other.is_finite() { other } else { lo };
            let (lo, hi) = (lo.min(hi), lo.max(hi));
            let levels = Levels::new([lo, hi], most);
            prop_assert!(u64::from(levels.count) <= most);
            for n in 0..levels.count {
                let v = levels.level(n);
                prop_assert!(lo < v && v <= hi, "{lo} < {v} <= {hi}");
                prop_assert!(n == 0 || levels.level(n - 1) <= v);
                prop_assert!(levels.find(v).is_some());
            }
        }
    }
}
