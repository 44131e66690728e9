//! The squares of errors alone, added up fast: for fields of which no more is told than their RMS
//! error.
//!
//! Samples come in runs that do not depend on how work is cut. The squares of a run are added up in
//! `f64` in a fixed order, and the sum becomes a whole number. Whole numbers are added in any order.

use super::BrickErrors;
use super::sums::error_of;

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
    /// Samples of a run: the first of each is at a multiple of this.
    pub(crate) const RUN: usize = 64;

    /// None yet, of samples whose largest and least differ by so much.
    pub(crate) fn of_range(range: f64) -> Self {
        // A square of the range is 2^80: errors of a millionth of it still have 40 bits, and 2^40
        // samples that are off by 16 times as much have room.
        let unit = (range * range).max(f64::MIN_POSITIVE);
        Self { scale: 2f64.powi(80) / unit, samples: 0, sum: 0, max: 0.0 }
    }

    /// Adds a row of samples, of which the first is at the beginning of a run.
    pub(crate) fn add_row(&mut self, originals: &[f32], reduced: &[f32]) {
        for (originals, reduced) in originals.chunks(Self::RUN).zip(reduced.chunks(Self::RUN)) {
            let mut run = Run::default();
            let ([some, rest], [found, last]) = (lanes(originals), lanes(reduced));
            run.add_all(some.as_chunks().0, found.as_chunks().0);
            if !rest.is_empty() {
                let [mut a, mut b] = [[f32::NAN; LANES]; 2];
                a[..rest.len()].copy_from_slice(rest);
                b[..last.len()].copy_from_slice(last);
                run.add_all(&[a], &[b]);
            }
            self.samples += u64::from(run.samples.iter().sum::<u32>());
            self.sum += (run.squares.iter().sum::<f64>() * self.scale) as u128;
            self.max = run.max.iter().copied().fold(self.max, f32::max);
        }
    }

    /// What is known of the samples.
    pub(crate) fn errors(&self) -> BrickErrors {
        let squares = self.sum as f64 / self.scale;
        BrickErrors { samples: self.samples, squares, max: f64::from(self.max) }
    }
}

/// As many as fill all lanes, and the rest.
fn lanes(values: &[f32]) -> [&[f32]; 2] {
    let (some, rest) = values.split_at(values.len() / LANES * LANES);
    [some, rest]
}

#[derive(Default)]
struct Run {
    samples: [u32; LANES],
    squares: [f64; LANES],
    max: [f32; LANES],
}

impl Run {
    #[inline(always)]
    fn add_all(&mut self, originals: &[[f32; LANES]], reduced: &[[f32; LANES]]) {
        for (originals, reduced) in originals.iter().zip(reduced) {
            for k in 0..LANES {
                let is_there = originals[k].is_finite() & !reduced[k].is_nan();
                let error = if is_there { error_of(originals[k], reduced[k]).abs() } else { 0.0 };
                self.samples[k] += u32::from(is_there);
                self.squares[k] += f64::from(error) * f64::from(error);
                self.max[k] = if error > self.max[k] { error } else { self.max[k] };
            }
        }
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
