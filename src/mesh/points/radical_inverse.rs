//! The radical inverse Φ_b, exactly, and rounded to the lattice fast.
//!
//! Φ_b(k) mirrors the digits of k in base b at the radix point: 6 = 110₂, so Φ₂(6) = 0.011₂ = 3/8
//! (van der Corput 1935; Halton 1960; Hammersley 1960). It is a rational number of denominator b^e,
//! e the number of digits of k, and [`radical_inverse`] gives it as two integers. A position on the
//! lattice is *defined* by that rational number:
//!
//! ```text
//! position = ⌊Φ·max + 1/2⌋ = ⌊(2·numerator·max + b^e) / (2·b^e)⌋
//! ```
//!
//! Dividing for each point would cost more than all the rest. [`Base::position`] evaluates Φ in
//! 64-bit fixed point instead, seven digits (base 3) or five (base 5) at a time by a table, base 2
//! by reversing bits. Such a fraction is never above the true one and less than [`ERROR`]·2^-64
//! below it; where that much could change the rounding, which is one time in 2^36, the exact
//! formula decides. So the answer is always that of the definition.

/// A radical inverse as an exact fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RadicalInverse {
    /// The digits of k, mirrored.
    pub numerator: u64,
    /// b^e, e the number of digits of k; 1 for k = 0.
    pub denominator: u64,
}

impl RadicalInverse {
    /// The nearest lattice position of `self · max`, halves up.
    pub fn round(self, max: u32) -> u32 {
        let (num, den) = (u128::from(self.numerator), u128::from(self.denominator));
        ((2 * num * u128::from(max) + den) / (2 * den)) as u32
    }

    /// The value as a floating-point number, for display and comparison.
    pub fn to_f64(self) -> f64 {
        self.numerator as f64 / self.denominator as f64
    }
}

/// Φ_base(k) for `2 <= base <= 5` and `k < 2^60`: then base^e < 2^63.
pub fn radical_inverse(base: u64, k: u64) -> RadicalInverse {
    debug_assert!((2..=5).contains(&base) && k < 1 << 60);
    let (mut rest, mut numerator, mut denominator) = (k, 0, 1);
    while rest > 0 {
        numerator = numerator * base + rest % base;
        denominator *= base;
        rest /= base;
    }
    RadicalInverse { numerator, denominator }
}

/// The last `digits` digits of `k` in `base`, mirrored as an integer.
pub(super) fn mirror(base: u64, digits: u32, mut k: u64) -> u64 {
    let mut mirrored = 0;
    for _ in 0..digits {
        mirrored = mirrored * base + k % base;
        k /= base;
    }
    mirrored
}

/// The bases of the three axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Base {
    Two,
    Three,
    Five,
}

impl Base {
    /// The base as a number.
    pub(super) fn get(self) -> u64 {
        match self {
            Self::Two => 2,
            Self::Three => 3,
            Self::Five => 5,
        }
    }

    /// The lattice position of Φ(k) on an axis that ends at `max`, exactly as
    /// [`RadicalInverse::round`] has it.
    #[inline]
    pub(super) fn position(self, k: u64, max: u32) -> u32 {
        match self {
            // Mirrored bits are Φ₂(k)·2^64 without error.
            Self::Two => ((u128::from(k.reverse_bits()) * u128::from(max) + (1 << 63)) >> 64) as u32,
            Self::Three => {
                round_fraction(THREE.fraction(k), ERROR, max).unwrap_or_else(|| self.exact(k, max))
            }
            Self::Five => round_fraction(FIVE.fraction(k), ERROR, max).unwrap_or_else(|| self.exact(k, max)),
        }
    }

    /// [`Base::position`] of many numbers. Without a branch for each, so that the compiler can take
    /// several at a time.
    #[inline(always)]
    pub(super) fn positions(self, numbers: &[u32], max: u32, out: &mut [u32]) {
        let is_sure = match self {
            Self::Two => {
                let position = |k: u32| (u64::from(k.reverse_bits()) * u64::from(max) + (1 << 31)) >> 32;
                out.iter_mut().zip(numbers).for_each(|(p, &k)| *p = position(k) as u32);
                true
            }
            Self::Three => FLOATS_OF_THREE.positions(numbers, max, out),
            Self::Five => FLOATS_OF_FIVE.positions(numbers, max, out),
        };
        if !is_sure {
            out.iter_mut().zip(numbers).for_each(|(p, &k)| *p = self.position(k.into(), max));
        }
    }

    /// Whether [`Base::positions`] takes all numbers up to this one.
    pub(super) fn takes(self, last: u64) -> bool {
        match self {
            Self::Two => last <= u64::from(u32::MAX),
            Self::Three => last < N_THREE * N_THREE,
            Self::Five => last < N_FIVE * N_FIVE,
        }
    }

    #[cold]
    fn exact(self, k: u64, max: u32) -> u32 {
        radical_inverse(self.get(), k).round(max)
    }
}

/// ⌊x·max + 1/2⌋ for an `x` with `fraction <= x·2^64 < fraction + error`; `None` where that does
/// not decide it.
#[inline]
pub(super) fn round_fraction(fraction: u64, error: u64, max: u32) -> Option<u32> {
    let scaled = u128::from(fraction) * u128::from(max) + (1 << 63);
    // The true value is below scaled + error·max: the same integer part, unless that carries.
    (scaled as u64).checked_add(error * u64::from(max))?;
    Some((scaled >> 64) as u32)
}

/// Bound of the error of [`DigitTable::fraction`], in 2^-64. There are six groups of digits; the
/// first is off by less than 1 and each other by less than 3 (table entry, scale and product are
/// each rounded down).
const ERROR: u64 = 16;

/// Fractions of all numbers below N = base^digits, and what a group of digits further up is worth.
struct DigitTable<const N: usize> {
    /// ⌊Φ(i)·2^64⌋.
    fraction: [u64; N],
    /// ⌊2^64 / N^(g+1)⌋.
    scale: [u64; 5],
}

static THREE: DigitTable<{ 3usize.pow(7) }> = DigitTable::new(3, 7);
static FIVE: DigitTable<{ 5usize.pow(5) }> = DigitTable::new(5, 5);

impl<const N: usize> DigitTable<N> {
    const fn new(base: u64, digits: u32) -> Self {
        let (mut fraction, mut scale) = ([0; N], [0; 5]);
        let mut i = 0;
        while i < N {
            let (mut rest, mut mirrored, mut digit) = (i as u64, 0, 0);
            while digit < digits {
                mirrored = mirrored * base + rest % base;
                rest /= base;
                digit += 1;
            }
            fraction[i] = (((mirrored as u128) << 64) / N as u128) as u64;
            i += 1;
        }
        let (mut g, mut power) = (0, 1u128);
        while g < 5 {
            power *= N as u128;
            scale[g] = ((1u128 << 64) / power) as u64;
            g += 1;
        }
        Self { fraction, scale }
    }

    /// Φ(k)·2^64 from below. Six groups of digits cover every 64-bit number.
    #[inline]
    fn fraction(&self, k: u64) -> u64 {
        let n = N as u64;
        let mut sum = self.fraction[(k % n) as usize];
        let (mut rest, mut group) = (k / n, 0);
        while rest > 0 {
            let part = u128::from(self.fraction[(rest % n) as usize]) * u128::from(self.scale[group]);
            sum += (part >> 64) as u64;
            rest /= n;
            group += 1;
        }
        sum
    }
}

/// Numbers that have as many digits as those of a [`DigitTable`], and room for them whose size is a
/// power of two.
const N_THREE: u64 = 3u64.pow(7);
const N_FIVE: u64 = 5u64.pow(5);
const ROOM: usize = 1 << 12;

/// Fractions in floating-point numbers, rounded to the nearest, for numbers of two groups of
/// digits: of the lower group, and of the upper one.
struct FloatTable<const N: u64> {
    low: [f64; ROOM],
    high: [f64; ROOM],
}

static FLOATS_OF_THREE: FloatTable<N_THREE> = FloatTable::new(3, 7);
static FLOATS_OF_FIVE: FloatTable<N_FIVE> = FloatTable::new(5, 5);

impl<const N: u64> FloatTable<N> {
    const fn new(base: u64, digits: u32) -> Self {
        let (mut low, mut high) = ([0.0; ROOM], [0.0; ROOM]);
        let mut i = 0;
        while i < N {
            let (mut rest, mut mirrored, mut digit) = (i, 0, 0);
            while digit < digits {
                mirrored = mirrored * base + rest % base;
                rest /= base;
                digit += 1;
            }
            low[i as usize] = mirrored as f64 / N as f64;
            high[i as usize] = mirrored as f64 / (N * N) as f64;
            i += 1;
        }
        Self { low, high }
    }

    /// The positions of numbers below N². False if rounding errors might change one of them.
    ///
    /// The two fractions are off by 2^-53 of themselves, their sum by as much again, and its
    /// product with up to 2^24 by 2^-53 of it: in all less than 2^-27.
    #[inline(always)]
    fn positions(&self, numbers: &[u32], max: u32, out: &mut [u32]) -> bool {
        /// Adding this rounds to the nearest integer, which is then in the lowest bits.
        const TO_INTEGER: f64 = (1u64 << 52) as f64;
        const SURE: f64 = 0.5 - 1.0 / (1 << 20) as f64;
        const LANES: usize = 32;
        let (max, mut doubts) = (f64::from(max), 0);
        for (out, numbers) in out.chunks_mut(LANES).zip(numbers.chunks(LANES)) {
            let (mut low, mut high, mut sum) = ([0u16; LANES], [0u16; LANES], [0.0; LANES]);
            for ((low, high), &k) in low.iter_mut().zip(&mut high).zip(numbers) {
                (*high, *low) = ((k / N as u32) as u16, (k % N as u32) as u16);
            }
            for ((sum, low), high) in sum.iter_mut().zip(low).zip(high) {
                *sum = self.low[usize::from(low) % ROOM] + self.high[usize::from(high) % ROOM];
            }
            for (out, sum) in out.iter_mut().zip(sum) {
                let exact = sum * max;
                let rounded = exact + TO_INTEGER;
                *out = rounded.to_bits() as u32;
                doubts |= u32::from((exact - (rounded - TO_INTEGER)).abs() > SURE);
            }
        }
        doubts == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrored_digits() {
        let f = |b, k| (radical_inverse(b, k).numerator, radical_inverse(b, k).denominator);
        assert_eq!((f(2, 0), f(2, 1), f(2, 6)), ((0, 1), (1, 2), (3, 8)));
        assert_eq!((f(3, 5), f(5, 7)), ((7, 9), (11, 25)));
        assert_eq!(radical_inverse(2, 6).to_f64(), 0.375);
        assert_eq!(mirror(3, 4, 5), 63);
    }

    #[test]
    fn the_fast_position_is_the_exact_one() {
        let numbers =
            (0..3000).chain((0..3000u64).map(|i| i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> (5 + i % 45)));
        for k in numbers.filter(|&k| k < 1 << 60) {
            for max in [1, 2, 3, 254, 255 << 16, 81 * 625, 1 << 24] {
                for base in [Base::Two, Base::Three, Base::Five] {
                    let exact = radical_inverse(base.get(), k).round(max);
                    assert_eq!(base.position(k, max), exact, "{base:?} {k} {max}");
                }
            }
        }
    }

    #[test]
    fn positions_side_by_side_are_the_same() {
        for base in [Base::Two, Base::Three, Base::Five] {
            let all = (1..=u32::MAX.ilog2())
                .flat_map(|bits| (0..2000u32).map(move |i| i.wrapping_mul(2_654_435_761) >> bits));
            let numbers: Vec<u32> = (0..9000).chain(all).filter(|&k| base.takes(k.into())).collect();
            for max in [1, 2, 254, 255 << 16, 81 * 625, 3u32.pow(14), 1 << 24] {
                let mut out = vec![0; numbers.len()];
                for (numbers, out) in numbers.chunks(77).zip(out.chunks_mut(77)) {
                    base.positions(numbers, max, out);
                }
                assert!(
                    out.iter().zip(&numbers).all(|(&p, &k)| p == base.position(k.into(), max)),
                    "{base:?} {max}"
                );
            }
        }
        assert!(!Base::Five.takes(N_FIVE * N_FIVE) && Base::Five.takes(N_FIVE * N_FIVE - 1));
    }

    #[test]
    fn fractions_keep_their_error_bound() {
        for i in 0..20_000u64 {
            let k = i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 4;
            for (base, fraction) in [(3, THREE.fraction(k)), (5, FIVE.fraction(k))] {
                let exact = radical_inverse(base, k);
                let (num, den) = (u128::from(exact.numerator), u128::from(exact.denominator));
                // num·2^64 needs up to 126 bits.
                let floor = ((num << 64) / den) as u64;
                assert!(fraction <= floor && floor - fraction < ERROR, "{base} {k}");
            }
        }
    }

    #[test]
    fn a_fraction_that_cannot_tell_says_so() {
        assert_eq!(round_fraction(1 << 63, 16, 1), Some(1));
        assert_eq!(round_fraction((1 << 63) - 1, 16, 1), None);
        assert_eq!(round_fraction((1 << 63) - 17, 16, 1), Some(0));
    }
}
