//! The squares of errors alone, added up fast: for fields of which no more is told than their RMS
//! error.
//!
//! Samples come in runs that do not depend on how work is cut. The squares of a run are added up in
//! `f64` in a fixed order, and the sum becomes a whole number. These are added in any order.

use super::BrickErrors;
use super::sums::error_of;

/// Samples of a run: the first of each is at a multiple of this.
const RUN: usize = 64;
/// Errors that are added side by side.
const LANES: usize = 8;

/// The errors of some samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Squares {
    /// Whole numbers to one of the squares.
    scale: f64,
    samples: u64,
    sum: u128,
    max: f32,
}

impl Squares {
    /// None yet, of samples whose largest and least differ by so much.
    pub(crate) fn of_range(range: f64) -> Self {
        // A square of the range is 2^80: errors of a millionth of it still have 40 bits, and 2^40
        // samples that are off by 16 times as much have room.
        let unit = (range * range).max(f64::MIN_POSITIVE);
        Self { scale: 2f64.powi(80) / unit, samples: 0, sum: 0, max: 0.0 }
    }

    /// Adds a row of samples, of which the first is at the beginning of a run.
    pub(crate) fn add_row(&mut self, originals: &[f32], reduced: &[f32]) {
        let ((some, rest), (found, last)) = (originals.as_chunks(), reduced.as_chunks());
        some.iter().zip(found).for_each(|(a, b)| self.add_run(a, b, RUN));
        if !rest.is_empty() {
            let [mut a, mut b] = [[0.0; RUN]; 2];
            a[..rest.len()].copy_from_slice(rest);
            b[..last.len()].copy_from_slice(last);
            self.add_run(&a, &b, rest.len());
        }
    }

    /// Adds a run, of which the first so many samples are there, and others have no error.
    #[inline(always)]
    fn add_run(&mut self, originals: &[f32; RUN], reduced: &[f32; RUN], count: usize) {
        // Each loop is of vectors.
        let (mut errors, mut are_there, mut missing) = ([0.0f32; RUN], true, 0);
        for (error, (original, reduced)) in errors.iter_mut().zip(originals.iter().zip(reduced)) {
            *error = reduced - original;
            are_there &= error.abs() <= f32::MAX;
        }
        if !are_there {
            for (error, (original, reduced)) in errors.iter_mut().zip(originals.iter().zip(reduced)) {
                let is_there = original.is_finite() && !reduced.is_nan();
                *error = if is_there { error_of(*original, *reduced) } else { 0.0 };
                missing += usize::from(!is_there);
            }
        }
        let (mut squares, mut max) = ([0.0f64; LANES], [0.0f32; LANES]);
        for errors in errors.as_chunks::<LANES>().0 {
            for (square, error) in squares.iter_mut().zip(errors) {
                *square += f64::from(*error) * f64::from(*error);
            }
            for (max, error) in max.iter_mut().zip(errors) {
                *max = if error.abs() > *max { error.abs() } else { *max };
            }
        }
        self.samples += (count - missing) as u64;
        self.sum += (squares.iter().sum::<f64>() * self.scale) as u128;
        self.max = max.into_iter().fold(self.max, f32::max);
    }

    /// What is known of the samples.
    pub(crate) fn errors(&self) -> BrickErrors {
        let squares = self.sum as f64 / self.scale;
        BrickErrors { samples: self.samples, squares, max: f64::from(self.max) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sums::tests::pairs;
    use super::*;

    #[test]
    fn the_errors_are_those_of_samples_in_any_parts() {
        let (mut originals, reduced): (Vec<f32>, Vec<f32>) = pairs(1000).into_iter().unzip();
        originals[77] = f32::NAN;
        let mut plain = BrickErrors::default();
        originals.iter().zip(&reduced).for_each(|(a, b)| plain.add(*a, *b));
        let mut whole = Squares::of_range(100.0);
        whole.add_row(&originals, &reduced);
        let found = whole.errors();
        assert_eq!((found.samples, found.max), (999, plain.max));
        assert!((found.rms() / plain.rms() - 1.0).abs() < 1e-12);
        let mut parts = Squares::of_range(100.0);
        for part in [640..1000, 0..128, 128..640] {
            parts.add_row(&originals[part.clone()], &reduced[part]);
        }
        assert_eq!(parts, whole);
    }

    #[test]
    fn no_range_is_no_error() {
        let mut none = Squares::of_range(0.0);
        none.add_row(&[3.0; 100], &[3.0; 100]);
        assert_eq!(none.errors(), BrickErrors { samples: 100, squares: 0.0, max: 0.0 });
    }
}
