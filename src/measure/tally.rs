//! Errors of many samples, added up quickly.

use super::sums::{BIN_SHIFT, ErrorSums, error_of};

/// All bits of a float but the sign, which have the order of its absolute value.
const ABSOLUTE: u32 = 0x7fff_ffff;
/// NaN, in place of an error's bits where there is none: more than all that are.
const NONE: u32 = 0x7fc0_0000;
/// Samples whose errors are computed together.
const TOGETHER: usize = 64;
/// Sums of so many mantissas, and of their squares, have room in 64 bits.
const MOST_WAITING: usize = 1 << 14;

/// Sums of mantissas, and of their squares, of one sign and exponent.
#[derive(Clone, Copy, Default)]
struct Recent {
    sum: u64,
    squares: u64,
}

/// An [`ErrorSums`] in the making: what was added last waits in 64 bits.
pub(crate) struct Tally {
    sums: ErrorSums,
    /// By the upper nine bits of an error: its sign and its exponent.
    recent: Box<[Recent; 512]>,
    waiting: usize,
}

impl Default for Tally {
    fn default() -> Self {
        Self { sums: ErrorSums::default(), recent: Box::new([Recent::default(); 512]), waiting: 0 }
    }
}

impl Tally {
    /// Adds many samples, as [`ErrorSums::add`] does one; the number is asked for of the n-th.
    ///
    /// # Panics
    /// When there is not a reduced value for each original one.
    #[inline(always)]
    pub(crate) fn add_all(&mut self, originals: &[f32], reduced: &[f32], sample: impl Fn(usize) -> u64) {
        assert_eq!(originals.len(), reduced.len(), "values in pairs");
        let mut errors = [0; TOGETHER];
        for (part, (originals, reduced)) in
            originals.chunks(TOGETHER).zip(reduced.chunks(TOGETHER)).enumerate()
        {
            let errors = &mut errors[..originals.len()];
            let (mut most, mut zeros) = (0, 0);
            for ((error, &original), &reduced) in errors.iter_mut().zip(originals).zip(reduced) {
                let found = error_of(original, reduced).to_bits();
                *error = if original.is_finite() & !reduced.is_nan() { found } else { NONE };
                most = most.max(*error & ABSOLUTE);
                zeros += u32::from(*error & ABSOLUTE == 0);
            }
            if self.sums.is_less_than_largest(most) {
                self.add_errors(errors, zeros);
                continue;
            }
            for (n, (&original, &reduced)) in originals.iter().zip(reduced).enumerate() {
                self.sums.add(original, reduced, || sample(part * TOGETHER + n));
            }
        }
    }

    /// Adds the bits of errors, none of them the largest; so many are 0.
    #[inline(always)]
    fn add_errors(&mut self, errors: &[u32], zeros: u32) {
        let bins: &mut [u64; 1 << (31 - BIN_SHIFT)] = (&mut self.sums.bins[..]).try_into().expect("all bins");
        for &error in errors {
            bins[((error & ABSOLUTE) >> BIN_SHIFT) as usize] += 1;
            let normal = error & 0x7f80_0000 != 0;
            let mantissa = u64::from(error & 0x7f_ffff | u32::from(normal) << 23);
            let recent = &mut self.recent[(error >> 23) as usize];
            recent.sum += mantissa;
            recent.squares += mantissa * mantissa;
        }
        // Those of exactly 0 are in no bin.
        bins[0] -= u64::from(zeros);
        self.sums.zeros += u64::from(zeros);
        self.sums.measured += errors.len() as u64;
        self.waiting += errors.len();
        if self.waiting >= MOST_WAITING - TOGETHER {
            self.flush();
        }
    }

    #[cold]
    fn flush(&mut self) {
        let (positive, negative) = self.recent.split_at(256);
        for (all, (plus, minus)) in self.sums.mantissas.iter_mut().zip(positive.iter().zip(negative)) {
            all.sum += u128::from(plus.sum + minus.sum);
            all.signed += i128::from(plus.sum) - i128::from(minus.sum);
            all.squares += u128::from(plus.squares) + u128::from(minus.squares);
        }
        self.recent.fill(Recent::default());
        self.waiting = 0;
    }

    /// What all samples make.
    pub(crate) fn finish(mut self) -> ErrorSums {
        self.flush();
        self.sums
    }
}

#[cfg(test)]
mod tests {
    use super::super::sums::tests::{pairs, sums};
    use super::*;

    #[test]
    fn many_samples_are_added_as_one_by_one() {
        let mut pairs = pairs(700);
        // The largest errors come late, some samples have none, some errors are 0.
        pairs.sort_by(|a, b| error_of(a.0, a.1).abs().total_cmp(&error_of(b.0, b.1).abs()));
        let (void, missing) = ((1.0, f32::NAN), (f32::INFINITY, 1.0));
        let least = f32::from_bits(1);
        pairs.splice(
            300..300,
            [
                void,
                missing,
                (3.0, 3.0),
                (-0.0, 0.0),
                (f32::MAX, f32::MIN),
                (f32::MIN, f32::MAX),
                (least, 0.0),
                (0.0, least),
            ],
        );
        let (originals, reduced): (Vec<f32>, Vec<f32>) = pairs.iter().copied().unzip();
        for (from, to) in [(0, 708), (0, 64), (5, 5), (100, 165), (290, 320), (400, 708)] {
            let mut found = Tally::default();
            found.add_all(&originals[from..to], &reduced[from..to], |n| (from + n) as u64);
            assert_eq!(found.finish(), sums(&pairs[from..to], from as u64), "{from}..{to}");
        }
    }

    #[test]
    fn more_samples_than_wait_are_added_as_one_by_one() {
        let mut pairs = pairs(100);
        pairs.sort_by(|a, b| error_of(b.0, b.1).abs().total_cmp(&error_of(a.0, a.1).abs()));
        let pairs: Vec<_> =
            pairs[..1].iter().chain(pairs.iter().cycle().take(3 * MOST_WAITING)).copied().collect();
        let (originals, reduced): (Vec<f32>, Vec<f32>) = pairs.iter().copied().unzip();
        let mut found = Tally::default();
        found.add_all(&originals, &reduced, |n| n as u64);
        assert_eq!(found.finish(), sums(&pairs, 0));
    }
}
