//! A binary range coder with probabilities that learn.
//!
//! The coder is the carry-propagating one of LZMA (Martin 1979, "Range encoding"; Pavlov's LZMA
//! specification): the interval [low, low + range) shrinks with each bit in proportion to the bit's
//! probability, and whole bytes leave at its top. A probability moves towards each bit seen, by
//! 1/32 of the distance. So it is never certain, and needs no clamp.

/// Part of the distance that a probability moves, as a shift.
const RATE: u32 = 5;
const TOP: u32 = 1 << 24;

/// The probability that a bit is set, in 1/65536.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Odds(u16);

impl Odds {
    /// Odds to begin with, less than certain.
    pub(crate) const fn new(set: u16) -> Self {
        const LEAST: u16 = 32;
        if set < LEAST {
            Self(LEAST)
        } else if set > u16::MAX - LEAST {
            Self(u16::MAX - LEAST)
        } else {
            Self(set)
        }
    }

    /// Learns a bit that is set.
    #[inline(always)]
    fn rise(&mut self) {
        self.0 += ((65_536 - u32::from(self.0)) >> RATE) as u16;
    }

    #[inline(always)]
    fn fall(&mut self) {
        self.0 -= self.0 >> RATE;
    }
}

/// The bytes of an interval whose ends are fixed: appended as they become certain.
#[derive(Clone, Debug)]
pub(crate) struct Encoder {
    low: u64,
    range: u32,
    bytes: Vec<u8>,
}

impl Default for Encoder {
    fn default() -> Self {
        Self { low: 0, range: u32::MAX, bytes: vec![] }
    }
}

impl Encoder {
    #[inline(always)]
    pub(crate) fn bit(&mut self, odds: &mut Odds, bit: bool) {
        let bound = (self.range >> 16) * u32::from(odds.0);
        if bit {
            self.range = bound;
            odds.rise();
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
            odds.fall();
        }
        if self.range < TOP {
            self.shift();
        }
    }

    /// A number of at most 16 bits, all values equally likely.
    #[inline]
    pub(crate) fn raw(&mut self, bits: u32, value: u32) {
        self.range >>= bits;
        self.low += u64::from(value) * u64::from(self.range);
        self.shift();
    }

    #[inline(never)]
    fn shift(&mut self) {
        while self.range < TOP {
            self.range <<= 8;
            self.push();
        }
    }

    /// The top byte leaves; a carry runs through those that left.
    fn push(&mut self) {
        if self.low >> 32 != 0 {
            self.carry();
        }
        self.bytes.push((self.low >> 24) as u8);
        self.low = self.low << 8 & 0xffff_ffff;
    }

    fn carry(&mut self) {
        for byte in self.bytes.iter_mut().rev() {
            *byte = byte.wrapping_add(1);
            if *byte != 0 {
                break;
            }
        }
        self.low &= 0xffff_ffff;
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        (self.low, self.range) = (0, u32::MAX);
        self.bytes.clear();
    }

    /// Appends the bytes, and forgets everything. The interval is at least 2^24 wide, so one more
    /// byte identifies a number in it; the three bytes behind it are zeros that need not be
    /// written.
    pub(crate) fn finish(&mut self, out: &mut Vec<u8>) {
        self.low += u64::from(TOP - 1);
        self.push();
        out.extend_from_slice(&self.bytes);
        self.clear();
    }
}

/// Reads what [`Encoder`] wrote. Behind the last byte it finds zeros; [`Decoder::at_end`] says
/// whether it found too many.
#[derive(Debug)]
pub(crate) struct Decoder<'a> {
    /// The number in the interval, less its lower end.
    code: u32,
    range: u32,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Decoder<'a> {
    /// Zeros that the encoder did not write.
    const UNWRITTEN: usize = 3;

    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self { code: 0, range: u32::MAX, bytes, at: 0 };
        (0..4).for_each(|_| decoder.pull());
        decoder
    }

    #[inline]
    fn pull(&mut self) {
        self.code = self.code << 8 | u32::from(self.bytes.get(self.at).copied().unwrap_or(0));
        self.at += 1;
    }

    #[inline(never)]
    fn shift(&mut self) {
        while self.range < TOP {
            self.range <<= 8;
            self.pull();
        }
    }

    #[inline(always)]
    pub(crate) fn bit(&mut self, odds: &mut Odds) -> bool {
        let bound = (self.range >> 16) * u32::from(odds.0);
        let bit = self.code < bound;
        if bit {
            self.range = bound;
            odds.rise();
        } else {
            self.code -= bound;
            self.range -= bound;
            odds.fall();
        }
        if self.range < TOP {
            self.shift();
        }
        bit
    }

    /// A number of at most 16 bits.
    #[inline]
    pub(crate) fn raw(&mut self, bits: u32) -> u32 {
        self.range >>= bits;
        // Bytes that no encoder wrote may lie behind the interval.
        let value = (self.code / self.range).min((1 << bits) - 1);
        self.code -= value * self.range;
        self.shift();
        value
    }

    /// Whether all was read, and nothing more.
    pub(crate) fn at_end(&self) -> bool {
        self.at == self.bytes.len() + Self::UNWRITTEN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(n: u32) -> Vec<(usize, bool)> {
        let bit = |i: u32| match i % 3 {
            0 => i.is_multiple_of(997),
            1 => i.wrapping_mul(2_654_435_761) >> 29 == 0,
            _ => i.wrapping_mul(2_654_435_761) >> 31 == 0,
        };
        (0..n).map(|i| (i as usize % 3, bit(i))).collect()
    }

    #[test]
    fn bits_come_back_at_about_their_entropy() {
        let bits = sample(30_000);
        let fresh = [Odds::new(1 << 15); 3];
        let (mut encoder, mut odds) = (Encoder::default(), fresh);
        for &(at, bit) in &bits {
            encoder.bit(&mut odds[at], bit);
            encoder.raw(11, at as u32 * 700);
        }
        let mut bytes = vec![7];
        encoder.finish(&mut bytes);
        let (mut decoder, mut odds) = (Decoder::new(&bytes[1..]), fresh);
        for &(at, bit) in &bits {
            assert_eq!(decoder.bit(&mut odds[at]), bit);
            assert_eq!(decoder.raw(11), at as u32 * 700);
        }
        assert!(decoder.at_end());
        // 0.012, 0.544 and 1 bit, and something for learning, more where the odds stay the same for
        // ever.
        let entropy = 10_000.0 * (0.012 + 0.544 + 1.0 + 33.0);
        let spent = (bytes.len() * 8) as f64;
        assert!(spent < entropy * 1.02, "{spent} bits for {entropy}");
    }

    #[test]
    fn carries_and_the_end_are_right() {
        // Bits against all odds, and numbers at the upper end, make carries.
        for seed in 0..200u32 {
            let (mut encoder, mut odds) = (Encoder::default(), Odds::new(65_535));
            let value = |i: u32| (seed + i).wrapping_mul(2_654_435_761) >> 28;
            for i in 0..40 {
                encoder.bit(&mut odds, value(i) > 12);
                encoder.raw(16, 65_535 - value(i) / 8);
            }
            let mut bytes = vec![];
            encoder.finish(&mut bytes);
            for cut in 0..3 {
                let (mut decoder, mut odds) = (Decoder::new(&bytes[..bytes.len() - cut]), Odds::new(65_535));
                let mut same = true;
                for i in 0..40 {
                    same &= decoder.bit(&mut odds) == (value(i) > 12);
                    same &= decoder.raw(16) == 65_535 - value(i) / 8;
                }
                assert_eq!(decoder.at_end(), cut == 0);
                assert!(same || cut > 0);
            }
        }
    }
}
