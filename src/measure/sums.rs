//! Errors of samples, added up as integers.

use super::{FieldError, LevelError, PERCENTILES, Percentile};

/// Bins of absolute errors: the upper bits of a float without its sign.
pub(super) const BIN_SHIFT: u32 = 19;
pub(crate) const BINS: usize = 1 << (31 - BIN_SHIFT);
/// All bits of a float but the sign, which have the order of its absolute value.
pub(super) const ABSOLUTE: u32 = 0x7fff_ffff;
/// Exponents of floats.
pub(crate) const EXPONENTS: usize = 256;

/// Bits of a digit of the sums.
const DIGIT_BITS: usize = 24;
/// The exponent of the last digit, which has all that is left.
pub(crate) const LAST_DIGIT: usize = (EXPONENTS - 2) / DIGIT_BITS * DIGIT_BITS + 1;

/// Mantissas of errors of one exponent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Mantissas {
    pub(crate) sum: u128,
    pub(crate) signed: i128,
    pub(crate) squares: u128,
}

/// The sample of the largest error so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Largest {
    /// Bits of the absolute error, which have the order of the errors.
    bits: u32,
    pub(crate) sample: u64,
    pub(crate) original: f32,
    pub(crate) reduced: f32,
}

impl Largest {
    pub(crate) fn new(sample: u64, original: f32, reduced: f32) -> Self {
        let bits = error_of(original, reduced).to_bits() & ABSOLUTE;
        Self { bits, sample, original, reduced }
    }

    fn is_before(&self, other: &Self) -> bool {
        (self.bits, other.sample) > (other.bits, self.sample)
    }
}

/// What is known of the errors of some samples. Sums of parts are the sums of the whole, in any
/// order.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorSums {
    pub(crate) measured: u64,
    pub(crate) missing: u64,
    pub(crate) void: u64,
    /// Errors of exactly 0, which are in no bin.
    pub(crate) zeros: u64,
    pub(crate) bins: Vec<u64>,
    pub(crate) mantissas: Vec<Mantissas>,
    pub(crate) largest: Option<Largest>,
    /// Least and largest original value; more than less where there is none.
    pub(crate) range: [f32; 2],
}

impl Default for ErrorSums {
    fn default() -> Self {
        Self {
            measured: 0,
            missing: 0,
            void: 0,
            zeros: 0,
            bins: vec![0; BINS],
            mantissas: vec![Mantissas::default(); EXPONENTS],
            largest: None,
            range: [f32::INFINITY, f32::NEG_INFINITY],
        }
    }
}

/// Reduced less original, rounded to `f32` once: the largest one where there is none.
#[inline(always)]
pub(crate) fn error_of(original: f32, reduced: f32) -> f32 {
    (reduced - original).clamp(f32::MIN, f32::MAX)
}

impl ErrorSums {
    /// Bytes that they take.
    pub(crate) const BYTES: u64 = (BINS * size_of::<u64>() + EXPONENTS * size_of::<Mantissas>()) as u64 + 128;

    /// The same sums of mantissas, as few of them as possible: of every 24th exponent, each below
    /// 2^24, and squares below 2^48. Equal sums have equal ones, however they were added up.
    pub(crate) fn digits(&self) -> Vec<Mantissas> {
        const BITS: usize = DIGIT_BITS;
        const COUNT: usize = LAST_DIGIT / BITS + 1;
        let (mut parts, mut squares) = ([[0u128; 2]; COUNT], [0u128; COUNT + 2]);
        for (e, m) in self.mantissas.iter().enumerate() {
            // Denormal floats have the exponent of the least normal ones.
            let (k, shift) = ((e.max(1) - 1) / BITS, (e.max(1) - 1) % BITS);
            let negative = m.sum.wrapping_sub(m.signed as u128) / 2;
            parts[k][0] += (m.sum - negative) << shift;
            parts[k][1] += negative << shift;
            for (n, digit) in squares[k..k + 3].iter_mut().enumerate() {
                *digit += (m.squares >> (2 * BITS * n) & ((1 << (2 * BITS)) - 1)) << (2 * shift);
            }
        }
        let mut digits = vec![Mantissas::default(); EXPONENTS];
        let (mut carry, mut carried) = ([0u128; 2], 0u128);
        for k in 0..COUNT {
            let mut of = [parts[k][0] + carry[0], parts[k][1] + carry[1]];
            let mut square = squares[k] + carried;
            if k + 1 < COUNT {
                carry = of.map(|v| v >> BITS);
                of = of.map(|v| v & ((1 << BITS) - 1));
                carried = square >> (2 * BITS);
                square &= (1 << (2 * BITS)) - 1;
            } else {
                let [second, third] = [squares[k + 1] << (2 * BITS), squares[k + 2] << (4 * BITS)];
                square = square.saturating_add(second).saturating_add(third);
            }
            let signed = of[0] as i128 - of[1] as i128;
            digits[1 + BITS * k] = Mantissas { sum: of[0] + of[1], signed, squares: square };
        }
        digits
    }

    /// What is reported of the cells of a level.
    pub(crate) fn level_error(&self) -> LevelError {
        let rms = if self.measured == 0 { 0.0 } else { self.rms() };
        LevelError { samples: self.measured, rms, max: self.max() }
    }

    /// Adds a sample. An original that is no finite number counts as missing, a reduced value that
    /// is NaN as void; the number of the sample is asked for when its error is the largest so far.
    #[inline]
    pub fn add(&mut self, original: f32, reduced: f32, sample: impl FnOnce() -> u64) {
        if !original.is_finite() {
            self.missing += 1;
            return;
        }
        self.widen([original; 2]);
        if reduced.is_nan() {
            self.void += 1;
            return;
        }
        let error = error_of(original, reduced).to_bits();
        let bits = error & ABSOLUTE;
        self.measured += 1;
        if self.largest.is_none_or(|l| bits >= l.bits) {
            self.candidate(Largest { bits, sample: sample(), original, reduced });
        }
        self.add_error(error);
    }

    /// Whether an error of these bits, without its sign, is less than the largest so far.
    #[inline(always)]
    pub(super) fn is_less_than_largest(&self, bits: u32) -> bool {
        self.largest.is_some_and(|l| bits < l.bits)
    }

    /// Adds the bits of an error to the sums.
    #[inline(always)]
    fn add_error(&mut self, error: u32) {
        let bits = error & ABSOLUTE;
        if bits == 0 {
            self.zeros += 1;
            return;
        }
        self.bins[(bits >> BIN_SHIFT) as usize] += 1;
        let exponent = (bits >> 23) as usize;
        let mantissa = u64::from(bits & 0x7f_ffff | u32::from(exponent > 0) << 23);
        let sums = &mut self.mantissas[exponent];
        sums.sum += u128::from(mantissa);
        sums.signed += i128::from(if error > ABSOLUTE { -(mantissa as i64) } else { mantissa as i64 });
        sums.squares += u128::from(mantissa * mantissa);
    }

    /// Widens the range of the original values to that of some of them.
    #[inline(always)]
    pub(super) fn widen(&mut self, [least, largest]: [f32; 2]) {
        let [lo, hi] = &mut self.range;
        *lo = if least < *lo { least } else { *lo };
        *hi = if largest > *hi { largest } else { *hi };
    }

    #[cold]
    fn candidate(&mut self, new: Largest) {
        if self.largest.is_none_or(|old| new.is_before(&old)) {
            self.largest = Some(new);
        }
    }

    /// Adds what another part has.
    pub fn merge(&mut self, other: &Self) {
        self.measured += other.measured;
        self.missing += other.missing;
        self.void += other.void;
        self.zeros += other.zeros;
        self.widen(other.range);
        self.bins.iter_mut().zip(&other.bins).for_each(|(a, b)| *a += b);
        for (a, b) in self.mantissas.iter_mut().zip(&other.mantissas) {
            // Only forged sums are that large.
            a.sum = a.sum.saturating_add(b.sum);
            a.signed = a.signed.saturating_add(b.signed);
            a.squares = a.squares.saturating_add(b.squares);
        }
        if let Some(largest) = other.largest {
            self.candidate(largest);
        }
    }

    /// Samples that were added, with and without an error.
    pub fn samples(&self) -> u64 {
        self.measured + self.missing + self.void
    }

    /// The largest absolute error; 0 of no sample.
    pub fn max(&self) -> f64 {
        self.largest.map_or(0.0, |l| f64::from(f32::from_bits(l.bits)))
    }

    pub(crate) fn largest(&self) -> Option<Largest> {
        self.largest
    }

    /// Sum over exponents, the largest first, of an integer times a power of two: the same bits
    /// for equal sums, however they were added up.
    fn total(&self, of: impl Fn(&Mantissas) -> f64, power: impl Fn(i32) -> i32) -> f64 {
        // Denormal floats have the exponent of the least normal ones.
        let exponent = |e: usize| e.max(1) as i32 - 150;
        let digits = self.digits();
        let terms = digits.iter().enumerate().rev();
        terms.map(|(e, m)| of(m) * power_of_two(power(exponent(e)))).sum()
    }

    fn per_sample(&self, sum: f64) -> f64 {
        if self.measured == 0 { 0.0 } else { sum / self.measured as f64 }
    }

    /// The mean absolute error.
    pub fn mean(&self) -> f64 {
        self.per_sample(self.total(|m| m.sum as f64, |e| e))
    }

    /// The mean of reduced less original.
    pub fn bias(&self) -> f64 {
        self.per_sample(self.total(|m| m.signed as f64, |e| e))
    }

    /// The root of the mean square error.
    pub fn rms(&self) -> f64 {
        self.per_sample(self.total(|m| m.squares as f64, |e| 2 * e)).sqrt()
    }

    /// An error that `percent` percent of the measured samples do not exceed: see the module for
    /// how near it is.
    pub fn percentile(&self, percent: f64) -> f64 {
        let wanted = (percent / 100.0 * self.measured as f64).ceil() as u64;
        let mut seen = self.zeros;
        if seen >= wanted {
            return 0.0;
        }
        for (bin, &count) in self.bins.iter().enumerate() {
            seen += count;
            if seen >= wanted {
                let bound = |bits: u32| f64::from(f32::from_bits(bits));
                let first = (bin as u32) << BIN_SHIFT;
                let last = bound(first + (1 << BIN_SHIFT) - 1);
                // Among denormalised numbers bins are wider.
                let most = (bound(first) * (1.0 + 1.0 / 16.0)).max(last);
                return shortest_between(last, most).min(self.max());
            }
        }
        self.max()
    }

    /// Least and largest original value, if there is any.
    pub(crate) fn source_range(&self) -> Option<[f32; 2]> {
        // A zero has no sign.
        (self.range[0] <= self.range[1]).then(|| self.range.map(|v| v + 0.0))
    }

    /// What is said of them. `samples` are all of the source; those that were not added lie
    /// outside. The worst place is to be filled in.
    pub(crate) fn field_error(&self, samples: u64) -> FieldError {
        FieldError {
            samples,
            measured: self.measured,
            missing: self.missing,
            void: self.void,
            outside: samples - self.samples(),
            source_range: self.source_range().map(|range| range.map(f64::from)),
            beyond: 0,
            max: self.max(),
            rms: self.rms(),
            mean: self.mean(),
            bias: self.bias(),
            percentiles: PERCENTILES
                .map(|percent| Percentile { percent, error: self.percentile(percent) })
                .to_vec(),
            worst: None,
        }
    }
}

/// The number of fewest digits from a positive one to another.
pub(crate) fn shortest_between(low: f64, high: f64) -> f64 {
    let of_digits = |digits: usize| {
        let text = format!("{low:.*e}", digits - 1);
        let (mantissa, exponent) = text.split_once('e')?;
        let mantissa: u64 = mantissa.replace('.', "").parse().ok()?;
        let exponent = exponent.parse::<i32>().ok()? + 1 - digits as i32;
        let numbers = [mantissa, mantissa + 1].map(|m| format!("{m}e{exponent}").parse::<f64>());
        numbers.into_iter().flatten().find(|v| (low..=high).contains(v))
    };
    (1..=17).find_map(of_digits).unwrap_or(low)
}

/// 2^n, for n of normal numbers.
fn power_of_two(n: i32) -> f64 {
    f64::from_bits(((n + 1023) as u64) << 52)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Values of all sizes, in no order.
    pub(in super::super) fn pairs(n: u32) -> Vec<(f32, f32)> {
        let mut state = 12345u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 31)
        };
        (0..n).map(|_| (((next() - 0.5) * 100.0) as f32, ((next() - 0.5) * next() * 100.0) as f32)).collect()
    }

    pub(in super::super) fn sums(pairs: &[(f32, f32)], first: u64) -> ErrorSums {
        let mut sums = ErrorSums::default();
        for (i, &(a, b)) in (first..).zip(pairs) {
            sums.add(a, b, || i);
        }
        sums
    }

    #[test]
    fn the_figures_are_those_of_plain_sums() {
        let pairs = pairs(10_000);
        let found = sums(&pairs, 0);
        let errors: Vec<f64> = pairs.iter().map(|&(a, b)| f64::from(error_of(a, b))).collect();
        let n = errors.len() as f64;
        let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-12 * b.abs(), "{a} {b}");
        near(found.mean(), errors.iter().map(|e| e.abs()).sum::<f64>() / n);
        near(found.rms(), (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt());
        assert!((found.bias() - errors.iter().sum::<f64>() / n).abs() < 1e-10);
        let mut sorted: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        assert_eq!(found.max(), sorted[9_999]);
        for percent in PERCENTILES {
            let exact = sorted[(percent / 100.0 * n).ceil() as usize - 1];
            let value = found.percentile(percent);
            assert!(value >= exact && value <= exact * (1.0 + 1.0 / 16.0), "{percent}: {value} {exact}");
        }
    }

    #[test]
    fn parts_in_any_order_are_the_whole_bit_by_bit() {
        let pairs = pairs(3_000);
        let whole = sums(&pairs, 0);
        let parts: Vec<ErrorSums> =
            pairs.chunks(700).zip((0..).step_by(700)).map(|(part, first)| sums(part, first)).collect();
        for order in [[0, 1, 2, 3, 4], [4, 2, 0, 3, 1]] {
            let mut merged = ErrorSums::default();
            order.iter().for_each(|&i: &usize| merged.merge(&parts[i]));
            assert_eq!(merged, whole);
        }
    }

    #[test]
    fn digits_are_the_same_sums() {
        let mut whole = sums(&pairs(3_000), 0);
        whole.add(0.0, f32::MAX, || 3_000);
        whole.add(0.0, -f32::MAX, || 3_001);
        whole.add(0.0, f32::from_bits(1), || 3_002);
        for _ in 0..36 {
            // As of more samples than there ever are.
            whole.merge(&whole.clone());
        }
        let digits = ErrorSums { mantissas: whole.digits(), ..whole.clone() };
        let filled = digits.mantissas.iter().filter(|m| m.sum > 0).count();
        assert!(filled <= 11 && digits.digits() == digits.mantissas, "{filled}");
        assert_eq!([digits.mean(), digits.rms(), digits.bias()], [whole.mean(), whole.rms(), whole.bias()]);
        let plain = |of: fn(&Mantissas) -> f64, power: i32| {
            let terms = whole.mantissas.iter().enumerate();
            let exponent = |e: usize| power * (e.max(1) as i32 - 150);
            terms.map(|(e, m)| of(m) * 2f64.powi(exponent(e))).sum::<f64>() / whole.measured as f64
        };
        assert!((digits.mean() / plain(|m| m.sum as f64, 1) - 1.0).abs() < 1e-12);
        assert!((digits.rms() / plain(|m| m.squares as f64, 2).sqrt() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn extremes_are_counted_apart_and_ties_go_to_the_lowest_number() {
        let mut s = ErrorSums::default();
        s.add(f32::NAN, 1.0, || 0);
        s.add(f32::INFINITY, 1.0, || 1);
        s.add(1.0, f32::NAN, || 2);
        s.add(7.0, 7.0, || 3);
        assert_eq!((s.samples(), s.max(), s.percentile(99.0), s.rms()), (4, 0.0, 0.0, 0.0));
        s.add(2.0, -1.0, || 9);
        s.add(-1.0, 2.0, || 5);
        s.add(4.0, 1.0, || 7);
        assert_eq!(s.largest().map(|l| (l.sample, l.original, l.reduced)), Some((5, -1.0, 2.0)));
        s.add(f32::MIN, f32::MAX, || 10);
        assert_eq!(s.max(), f64::from(f32::MAX), "no infinity");
        s.add(0.0, 1e-45, || 11);
        let e = s.field_error(20);
        assert_eq!((e.samples, e.measured, e.missing, e.void, e.outside), (20, 6, 2, 1, 11));
        assert!(e.rms.is_finite() && e.mean.is_finite());
        assert_eq!(ErrorSums::default().field_error(0).rms, 0.0);
    }

    #[test]
    fn the_least_numbers_are_not_lost() {
        let mut s = ErrorSums::default();
        let least = f32::from_bits(1);
        s.add(0.0, least, || 0);
        s.add(0.0, -least, || 0);
        assert_eq!((s.mean(), s.rms(), s.bias()), (f64::from(least), f64::from(least), 0.0));
    }
}
