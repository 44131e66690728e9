//! Errors of many samples, added up quickly.
//!
//! ```text
//!  originals, reduced: samples × steps ─▶ errors, in vectors ─▶ step by step: bins ─▶ sums of mantissas
//! ```
//!
//! What a sample has at several steps lies side by side, so that one load has it.
//!
//! An error is put into one bin, of those with its sign, its exponent, and the upper five bits of
//! its mantissa. A bin has how many there are, and the sums of their lower bits and of the squares
//! of these: so the sums of mantissas and of their squares follow at the end, exactly. Errors of
//! one sign and exponent are many, those of one bin few: it is seldom that a sum must wait for what
//! was added to it just before.

use super::sums::{ABSOLUTE, BIN_SHIFT, BINS, ErrorSums, error_of};

/// NaN, in place of an error's bits where there is none: more than all that are.
const NONE: u32 = 0x7fc0_0000;
/// Samples whose errors are computed together.
pub(crate) const TOGETHER: usize = 128;
/// Bits of an error that do not decide its bin.
const LOWER: u32 = (1 << BIN_SHIFT) - 1;
/// How many errors a bin has is counted from this bit on, above the sum of their lower bits.
const COUNT_SHIFT: u32 = 44;
/// This many errors have room in a bin.
const MOST_WAITING: usize = 1 << 20;
const _: () = assert!(
    (MOST_WAITING as u64) << BIN_SHIFT <= 1 << COUNT_SHIFT && MOST_WAITING as u64 <= 1 << (64 - COUNT_SHIFT)
);

/// Some samples at `N` steps: a row each.
pub(crate) struct Compared<const N: usize> {
    pub(crate) originals: [[f32; N]; TOGETHER],
    pub(crate) reduced: [[f32; N]; TOGETHER],
    /// Bits of errors.
    errors: [[u32; N]; TOGETHER],
    /// For each step: the bits of the largest absolute error, [`NONE`] where a sample has none;
    /// those of the least that is not 0, less 1; how many are 0.
    most: [u32; N],
    least: [u32; N],
    zeros: [u32; N],
    /// For each step the least and the largest original value.
    range: [[f32; N]; 2],
}

impl<const N: usize> Compared<N> {
    /// In a box, for it is large.
    pub(crate) fn new() -> Box<Self> {
        let (values, bits) = ([[0.0; N]; TOGETHER], [[0; N]; TOGETHER]);
        let (most, zeros) = ([0; N], [0; N]);
        let range = [[0.0; N]; 2];
        Box::new(Self { originals: values, reduced: values, errors: bits, most, least: most, zeros, range })
    }

    /// Computes the errors of the first samples, of which there are at most [`TOGETHER`].
    #[inline(always)]
    pub(crate) fn find_errors(&mut self, count: usize) {
        let count = count.min(TOGETHER);
        let values = self.originals[..count].as_flattened().iter().zip(self.reduced[..count].as_flattened());
        for (error, (&original, &reduced)) in self.errors[..count].as_flattened_mut().iter_mut().zip(values) {
            let found = error_of(original, reduced).to_bits();
            *error = if original.is_finite() & !reduced.is_nan() { found } else { NONE };
        }
        let mut seen = ComparedLanes { most: [0; WIDTH], least: [u32::MAX; WIDTH], zeros: [0; WIDTH] };
        self.range = range_of(self.originals[..count].as_flattened());
        let (some, rest) = self.errors[..count].as_flattened().as_chunks::<WIDTH>();
        some.iter().for_each(|errors| seen.add(errors));
        seen.add(rest);
        (self.most, self.least, self.zeros) = ([0; N], [u32::MAX; N], [0; N]);
        let rows = seen.most.as_chunks().0.iter().zip(seen.least.as_chunks().0).zip(seen.zeros.as_chunks().0);
        for ((most, least), zeros) in rows {
            let (most, least, zeros): (&[u32; N], &[u32; N], &[u32; N]) = (most, least, zeros);
            for k in 0..N {
                self.most[k] = self.most[k].max(most[k]);
                self.least[k] = self.least[k].min(least[k]);
                self.zeros[k] += zeros[k];
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
            stride: N,
            count,
            most: self.most[step],
            least: self.least[step],
            zeros: self.zeros[step],
            range: self.range.map(|ends| ends[step]),
        }
    }
}

/// The least and the largest of each `N`-th number. Side by side, as in [`ComparedLanes`]: so many
/// that vectors have them.
#[inline(always)]
fn range_of<const N: usize>(values: &[f32]) -> [[f32; N]; 2] {
    let (mut least, mut largest) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
    for values in values.chunks(WIDTH) {
        for (value, (lo, hi)) in values.iter().zip(least.iter_mut().zip(&mut largest)) {
            *lo = if *value < *lo { *value } else { *lo };
            *hi = if *value > *hi { *value } else { *hi };
        }
    }
    let mut range = [[f32::INFINITY; N], [f32::NEG_INFINITY; N]];
    for (n, (lo, hi)) in least.iter().zip(&largest).enumerate() {
        let [least, largest] = &mut range;
        least[n % N] = if *lo < least[n % N] { *lo } else { least[n % N] };
        largest[n % N] = if *hi > largest[n % N] { *hi } else { largest[n % N] };
    }
    range
}

/// Errors that are looked at side by side: some samples, each at all steps. So many, for that the
/// compiler makes vectors of the loop over them, and not of that over samples.
const WIDTH: usize = 64;

/// As in [`Compared`], of each [`WIDTH`]-th error.
struct ComparedLanes {
    most: [u32; WIDTH],
    least: [u32; WIDTH],
    zeros: [u32; WIDTH],
}

impl ComparedLanes {
    #[inline(always)]
    fn add(&mut self, errors: &[u32]) {
        let seen = self.most.iter_mut().zip(&mut self.least).zip(&mut self.zeros);
        for (error, ((most, least), zeros)) in errors.iter().zip(seen) {
            let size = error & ABSOLUTE;
            *most = size.max(*most);
            *least = size.wrapping_sub(1).min(*least);
            *zeros += u32::from(size == 0);
        }
    }
}

/// Some samples at a step. Numbers of a sample and of the next are `stride` apart.
#[derive(Clone, Copy)]
pub(crate) struct ComparedAt<'a> {
    originals: &'a [f32],
    reduced: &'a [f32],
    errors: &'a [u32],
    stride: usize,
    count: usize,
    most: u32,
    least: u32,
    zeros: u32,
    range: [f32; 2],
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

/// Errors that share their upper bits: how many there are and the sum of their lower bits; the sum
/// of the squares of these.
type Bin = [u64; 2];

/// An [`ErrorSums`] in the making.
pub(crate) struct Tally {
    sums: ErrorSums,
    /// What was added last, by the upper bits of an error: first positive ones.
    bins: Box<[Bin; 2 * BINS]>,
    /// How many were added last; of these, such as are exactly 0.
    waiting: usize,
    zeros: u64,
    /// Bits of the least and the largest of the others, or less and more.
    least: u32,
    most: u32,
}

impl Default for Tally {
    fn default() -> Self {
        // Zeros that the system gives: of most bins not a page is touched.
        let bins = vec![[0; 2]; 2 * BINS].into_boxed_slice().try_into().expect("so many");
        Self { sums: ErrorSums::default(), bins, waiting: 0, zeros: 0, least: u32::MAX, most: 0 }
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
        for &error in some.errors.iter().step_by(some.stride) {
            let lower = u64::from(error & LOWER);
            let [counted, squares] = &mut self.bins[(error >> BIN_SHIFT) as usize];
            *counted += lower + (1 << COUNT_SHIFT);
            *squares += lower * lower;
        }
        (self.least, self.most) = (self.least.min(some.least), self.most.max(some.most));
        self.sums.widen(some.range);
        self.zeros += u64::from(some.zeros);
        self.sums.zeros += u64::from(some.zeros);
        self.sums.measured += some.count as u64;
        self.waiting += some.count;
        if self.waiting >= MOST_WAITING - TOGETHER {
            self.flush();
        }
    }

    #[cold]
    fn flush(&mut self) {
        let (positive, negative) = self.bins.split_at_mut(BINS);
        // Others have not been touched.
        let bins = (self.least >> BIN_SHIFT).max(1)..=self.most >> BIN_SHIFT;
        for n in std::iter::once(0).chain(bins).map(|n| n as usize) {
            let [plus, minus] = [&mut positive[n], &mut negative[n]].map(std::mem::take);
            if (plus[0] | minus[0]) == 0 {
                continue;
            }
            let first = (n as u32) << BIN_SHIFT;
            let all = &mut self.sums.mantissas[(first >> 23) as usize];
            let base = i128::from(first & 0x7f_ffff | u32::from(first >> 23 > 0) << 23);
            for ([counted, squares], sign) in [(plus, 1), (minus, -1)] {
                let (count, lower) = (counted >> COUNT_SHIFT, i128::from(counted & ((1 << COUNT_SHIFT) - 1)));
                self.sums.bins[n] += count;
                let (count, squares) = (i128::from(count), i128::from(squares));
                let sum = count * base + lower;
                all.sum += sum as u128;
                all.signed += sign * sum;
                all.squares += (count * base * base + 2 * base * lower + squares) as u128;
            }
        }
        // Those of exactly 0 are in no bin.
        self.sums.bins[0] -= std::mem::take(&mut self.zeros);
        (self.waiting, self.least, self.most) = (0, u32::MAX, 0);
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
