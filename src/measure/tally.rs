//! Errors of many samples, added up quickly.
//!
//! ```text
//!  originals, reduced: samples × steps ─▶ errors, in vectors ─▶ step by step: bins, sums of mantissas
//! ```
//!
//! What a sample has at several steps lies side by side, so that one load has it.

use super::sums::{ABSOLUTE, BIN_SHIFT, ErrorSums, error_of};

/// NaN, in place of an error's bits where there is none: more than all that are.
const NONE: u32 = 0x7fc0_0000;
/// Samples whose errors are computed together.
pub(crate) const TOGETHER: usize = 128;
/// Sums of so many mantissas, and of their squares, have room in 64 bits.
const MOST_WAITING: usize = 1 << 14;

/// Some samples at `N` steps: a row each.
pub(crate) struct Compared<const N: usize> {
    pub(crate) originals: [[f32; N]; TOGETHER],
    pub(crate) reduced: [[f32; N]; TOGETHER],
    /// Bits of errors.
    errors: [[u32; N]; TOGETHER],
    mantissas: [[u32; N]; TOGETHER],
    /// Of each step: the bits of the largest absolute error, [`NONE`] where a sample has none; how many are 0.
    most: [u32; N],
    zeros: [u32; N],
}

impl<const N: usize> Compared<N> {
    /// In a box, for it is large.
    pub(crate) fn new() -> Box<Self> {
        let (values, bits) = ([[0.0; N]; TOGETHER], [[0; N]; TOGETHER]);
        let (most, zeros) = ([0; N], [0; N]);
        Box::new(Self { originals: values, reduced: values, errors: bits, mantissas: bits, most, zeros })
    }

    /// Computes the errors of the first samples, of which there are at most [`TOGETHER`].
    #[inline(always)]
    pub(crate) fn find_errors(&mut self, count: usize) {
        let count = count.min(TOGETHER);
        let values = self.originals[..count].as_flattened().iter().zip(self.reduced[..count].as_flattened());
        let bits = self.errors[..count].as_flattened_mut().iter_mut();
        let bits = bits.zip(self.mantissas[..count].as_flattened_mut());
        for ((error, mantissa), (&original, &reduced)) in bits.zip(values) {
            let found = error_of(original, reduced).to_bits();
            *error = if original.is_finite() & !reduced.is_nan() { found } else { NONE };
            let normal = *error & 0x7f80_0000 != 0;
            *mantissa = *error & 0x7f_ffff | u32::from(normal) << 23;
        }
        (self.most, self.zeros) = ([0; N], [0; N]);
        for row in &self.errors[..count] {
            for (k, error) in row.iter().enumerate() {
                self.most[k] = self.most[k].max(error & ABSOLUTE);
                self.zeros[k] += u32::from(error & ABSOLUTE == 0);
            }
        }
    }

    /// The first samples at one of the steps, at least one.
    pub(crate) fn at(&self, step: usize, count: usize) -> ComparedAt<'_> {
        assert!(step < N && count <= TOGETHER, "samples and steps that there are");
        ComparedAt {
            originals: &self.originals.as_flattened()[step..count * N],
            reduced: &self.reduced.as_flattened()[step..count * N],
            errors: &self.errors.as_flattened()[step..count * N],
            mantissas: &self.mantissas.as_flattened()[step..count * N],
            stride: N,
            count,
            most: self.most[step],
            zeros: self.zeros[step],
        }
    }
}

/// Some samples at a step. Numbers of a sample and of the next are `stride` apart.
#[derive(Clone, Copy)]
pub(crate) struct ComparedAt<'a> {
    originals: &'a [f32],
    reduced: &'a [f32],
    errors: &'a [u32],
    mantissas: &'a [u32],
    stride: usize,
    count: usize,
    most: u32,
    zeros: u32,
}

impl<'a> ComparedAt<'a> {
    /// The original value of each, and the reduced one.
    pub(crate) fn pairs(&self) -> impl Iterator<Item = (f32, f32)> + use<'a> {
        let reduced = self.reduced.iter().step_by(self.stride);
        self.originals
            .iter()
            .step_by(self.stride)
            .zip(reduced)
            .map(|(original, reduced)| (*original, *reduced))
    }
}

/// Sums of mantissas, and of their squares, of one sign and exponent.
#[derive(Clone, Copy, Default)]
struct Recent {
    sum: u64,
    squares: u64,
}

/// An [`ErrorSums`] in the making: what was added last waits in 64 bits.
pub(crate) struct Tally {
    sums: ErrorSums,
    /// By the upper nine bits of an error: its sign and its exponent. Two of each, in turns: many errors have the same exponent, and the next sum need
    /// not wait for the one before.
    recent: Box<[[Recent; 512]; 2]>,
    waiting: usize,
}

impl Default for Tally {
    fn default() -> Self {
        Self { sums: ErrorSums::default(), recent: Box::new([[Recent::default(); 512]; 2]), waiting: 0 }
    }
}

impl Tally {
    /// Adds some samples, as [`ErrorSums::add`] does one; the number is asked for of the n-th.
    #[inline(always)]
    pub(crate) fn add(&mut self, some: &ComparedAt<'_>, sample: impl Fn(usize) -> u64) {
        if self.sums.is_less_than_largest(some.most) {
            return self.add_errors(some);
        }
        for (n, (original, reduced)) in some.pairs().enumerate() {
            self.sums.add(original, reduced, || sample(n));
        }
    }

    /// Adds errors, none of them the largest.
    #[inline(always)]
    fn add_errors(&mut self, some: &ComparedAt<'_>) {
        let bins: &mut [u64; 1 << (31 - BIN_SHIFT)] = (&mut self.sums.bins[..]).try_into().expect("all bins");
        let mantissas = some.mantissas.iter().step_by(some.stride);
        let errors = some.errors.iter().step_by(some.stride).zip(mantissas);
        for (n, (&error, &mantissa)) in errors.enumerate() {
            bins[((error & ABSOLUTE) >> BIN_SHIFT) as usize] += 1;
            let (mantissa, recent) = (u64::from(mantissa), &mut self.recent[n % 2][(error >> 23) as usize]);
            recent.sum += mantissa;
            recent.squares += mantissa * mantissa;
        }
        // Those of exactly 0 are in no bin.
        bins[0] -= u64::from(some.zeros);
        self.sums.zeros += u64::from(some.zeros);
        self.sums.measured += some.count as u64;
        self.waiting += some.count;
        if self.waiting >= MOST_WAITING - TOGETHER {
            self.flush();
        }
    }

    #[cold]
    fn flush(&mut self) {
        for recent in self.recent.iter_mut() {
            let (positive, negative) = recent.split_at(256);
            for (all, (plus, minus)) in self.sums.mantissas.iter_mut().zip(positive.iter().zip(negative)) {
                all.sum += u128::from(plus.sum + minus.sum);
                all.signed += i128::from(plus.sum) - i128::from(minus.sum);
                all.squares += u128::from(plus.squares) + u128::from(minus.squares);
            }
            recent.fill(Recent::default());
        }
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

    /// Adds samples that have a number, as a step of several.
    fn added<const N: usize>(originals: &[f32], reduced: &[f32], first: u64, step: usize) -> ErrorSums {
        let (mut found, mut room) = (Tally::default(), Compared::<N>::new());
        let mut first = first;
        for (originals, reduced) in originals.chunks(TOGETHER).zip(reduced.chunks(TOGETHER)) {
            for (n, (&original, &reduced)) in originals.iter().zip(reduced).enumerate() {
                // At other steps all is otherwise.
                room.originals[n] = std::array::from_fn(|k| if k == step { original } else { 1e9 });
                room.reduced[n] = std::array::from_fn(|k| if k == step { reduced } else { k as f32 });
            }
            room.find_errors(originals.len());
            found.add(&room.at(step, originals.len()), |n| first + n as u64);
            first += originals.len() as u64;
        }
        found.finish()
    }

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
            let expected = sums(&pairs[from..to], from as u64);
            let (originals, reduced) = (&originals[from..to], &reduced[from..to]);
            assert_eq!(added::<1>(originals, reduced, from as u64, 0), expected, "{from}..{to}");
            assert_eq!(added::<4>(originals, reduced, from as u64, 3), expected, "{from}..{to}");
            assert_eq!(added::<8>(originals, reduced, from as u64, 5), expected, "{from}..{to}");
        }
    }

    #[test]
    fn more_samples_than_wait_are_added_as_one_by_one() {
        let mut pairs = pairs(100);
        pairs.sort_by(|a, b| error_of(b.0, b.1).abs().total_cmp(&error_of(a.0, a.1).abs()));
        let pairs: Vec<_> =
            pairs[..1].iter().chain(pairs.iter().cycle().take(3 * MOST_WAITING)).copied().collect();
        let (originals, reduced): (Vec<f32>, Vec<f32>) = pairs.iter().copied().unzip();
        assert_eq!(added::<1>(&originals, &reduced, 0, 0), sums(&pairs, 0));
    }
}
