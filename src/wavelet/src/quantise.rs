//! Samples as numbers near 1, and coefficients as whole numbers of steps.

use crate::error::{Error, Result};

/// What a decoded magnitude is larger than its number, in steps.
pub(crate) const BACK: f32 = 0.04;
/// Steps that a coefficient may have.
const MOST_STEPS: f32 = (1 << 29) as f32;
/// The least step: the transform keeps 22 bits of a sample, safely. And the largest: no number of
/// such steps overflows.
const STEPS: [f32; 2] = [1.0 / (1 << 22) as f32, (1_u64 << 60) as f32];

/// How samples become the numbers that are transformed: less the middle of their range, and times a
/// power of 2. So huge and tiny samples, and small differences of large ones, keep their digits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// The least and the largest sample. What is decoded is moved between them: a wavelet
    /// overshoots beside edges.
    pub range: [f64; 2],
    /// The power of 2 by which they are divided.
    pub exponent: i32,
    /// The step of coefficients, after that.
    pub step: f32,
}

impl Scale {
    /// For samples of a range, with a step in their units.
    pub fn new(range: [f64; 2], step: f64) -> Result<Self> {
        if !(range[0] <= range[1] && range.iter().all(|r| (*r as f32).is_finite())) {
            return Err(Error::Damaged("the range is none of f32"));
        }
        let half = (range[1] / 2.0 - range[0] / 2.0).max(0.0);
        let exponent = if half > 0.0 { exponent(half) } else { 0 };
        let scale = Self { range, exponent, step: 1.0 };
        if half == 0.0 && step > 0.0 {
            return Ok(scale);
        }
        let [least, most] = STEPS;
        let step_there = step * scale.factor();
        if !(f64::from(least)..f64::INFINITY).contains(&step_there) {
            return Err(Error::Step { step, least: f64::from(least) / scale.factor() });
        }
        // A step beyond all coefficients leaves none.
        Ok(Self { step: step_there.min(f64::from(most)) as f32, ..scale })
    }

    /// As [`Scale::new`], with the least step that works if that is larger.
    pub(crate) fn near(range: [f64; 2], step: f64) -> Result<Self> {
        match Self::new(range, step) {
            Err(Error::Step { step, least }) if step > 0.0 => Self::new(range, least),
            other => other,
        }
    }

    /// An error if no [`Scale::new`] made it.
    pub(crate) fn checked(self) -> Result<Self> {
        let step_is_one = (STEPS[0]..=STEPS[1]).contains(&self.step);
        let range_is_one = self.range[0] <= self.range[1] && self.range.iter().all(|r| r.is_finite());
        match range_is_one && (-1000..=1000).contains(&self.exponent) && step_is_one {
            true => Ok(self),
            false => Err(Error::Damaged("the range or the step is none")),
        }
    }

    /// The middle of the range, which is subtracted.
    #[inline(always)]
    fn offset(&self) -> f64 {
        self.range[0] / 2.0 + self.range[1] / 2.0
    }

    /// What samples less the offset are multiplied by.
    #[inline(always)]
    fn factor(&self) -> f64 {
        power_of_two(-self.exponent)
    }

    /// A sample as it is transformed.
    #[inline(always)]
    pub fn enter(&self, sample: f64) -> f32 {
        ((sample - self.offset()) * self.factor()) as f32
    }

    /// What [`Scale::enter`] was given, nearly.
    #[inline(always)]
    pub fn leave(&self, number: f32) -> f64 {
        let sample = f64::from(number) * power_of_two(self.exponent) + self.offset();
        sample.clamp(self.range[0], self.range[1])
    }

    /// A difference of transformed samples, in units of the samples.
    pub(crate) fn in_samples(&self, difference: f32) -> f64 {
        f64::from(difference) * power_of_two(self.exponent)
    }

    /// A coefficient in steps.
    #[inline(always)]
    pub fn in_steps(&self, coefficient: f32) -> f32 {
        coefficient * (1.0 / self.step)
    }

    /// An error with the least step that works if the step is too small for a coefficient.
    pub(crate) fn expect_numbers_of(&self, largest: f32) -> Result<()> {
        if in_bounds(self.in_steps(largest)) {
            return Ok(());
        }
        let least = 1.01 * f64::from(largest) / f64::from(MOST_STEPS) * power_of_two(self.exponent);
        Err(Error::Step { step: self.in_samples(self.step), least })
    }

    /// The coefficient that stands for a number of steps.
    #[inline(always)]
    pub fn restored(&self, number: i32) -> f32 {
        restored(number) * self.step
    }

    /// The nearest number of steps, or an error if that is out of bounds.
    pub fn nearest(&self, coefficient: f32) -> Result<i32> {
        let steps = self.in_steps(coefficient);
        match in_bounds(steps) {
            true => Ok(nearest(steps)),
            false => Err(Error::Damaged("a coefficient is out of bounds")),
        }
    }
}

/// The least e with `value` at most 2^e, as far as a factor of [`power_of_two`] can tell.
fn exponent(value: f64) -> i32 {
    let bits = (value.to_bits() >> 52 & 0x7ff) as i32 - 1022;
    bits.clamp(-1000, 1000)
}

/// 2^e, for e from -1022 to 1023.
#[inline(always)]
fn power_of_two(e: i32) -> f64 {
    f64::from_bits(((e + 1023) as u64) << 52)
}

/// Whether a coefficient in steps can be a number.
#[inline(always)]
pub(crate) fn in_bounds(steps: f32) -> bool {
    steps.abs() < MOST_STEPS
}

/// The nearest whole number; of two the one farther from zero.
#[inline(always)]
pub(crate) fn nearest(steps: f32) -> i32 {
    let magnitude = (steps.abs() + 0.5) as i32;
    if steps < 0.0 { -magnitude } else { magnitude }
}

/// The coefficient in steps that stands for a number.
#[inline(always)]
pub(crate) fn restored(number: i32) -> f32 {
    match number {
        0 => 0.0,
        _ => (number.unsigned_abs() as f32 + BACK).copysign(number as f32),
    }
}
