//! A binary range coder with probabilities that learn.
//!
//! The coder is the carry-propagating one of LZMA (Martin 1979, "Range encoding"; Pavlov's LZMA specification): the interval
//! [low, low + range) shrinks with each bit in proportion to the bit's probability, and whole bytes leave at its top.
//! A probability moves towards each bit that was seen by 1/(n + 1.5) of the distance, n being the number of bits seen so far but at most
//! [`SLOWEST`]: fast at first, steady later. So little is lost to learning in blocks of a few hundred bytes.

/// The most bits that count for the speed of learning.
const SLOWEST: usize = 63;
const TOP: u32 = 1 << 24;

/// 2^16 / (n + 1.5).
const RATES: [u16; SLOWEST + 1] = {
    let mut rates = [0; SLOWEST + 1];
    let mut n = 0;
    while n <= SLOWEST {
        rates[n] = ((1 << 17) / (2 * n + 3)) as u16;
        n += 1;
    }
    rates
};

/// The probability that a bit is set, in 1/65536, and how many bits it was learnt from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Odds {
    set: u16,
    seen: u8,
}

impl Odds {
    /// Odds as if some bits had been seen before, at most 63.
    pub(crate) const fn new(set: u16, seen: u8) -> Self {
        Self { set, seen }
    }

    /// The probability that is used: never certain.
    #[inline]
    fn width(self) -> u32 {
        u32::from(self.set).clamp(32, 65_536 - 32)
    }

    #[inline]
    fn learn(&mut self, bit: bool) {
        let target = if bit { 65_535 } else { 0 };
        let step = ((target - i32::from(self.set)) * i32::from(RATES[usize::from(self.seen)])) >> 16;
        self.set = (i32::from(self.set) + step) as u16;
        self.seen = (self.seen + 1).min(SLOWEST as u8);
    }
}

/// The bytes of an interval whose ends are fixed: appended as they become certain.
#[derive(Debug)]
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
    #[inline]
    pub(crate) fn bit(&mut self, odds: &mut Odds, bit: bool) {
        let bound = (self.range >> 16) * odds.width();
        if bit {
            self.range = bound;
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
        }
        odds.learn(bit);
        self.shift();
    }

    /// A number of at most 16 bits, all values equally likely.
    #[inline]
    pub(crate) fn raw(&mut self, bits: u32, value: u32) {
        self.range >>= bits;
        self.low += u64::from(value) * u64::from(self.range);
        self.shift();
    }

    #[inline]
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

    /// Appends the bytes, and forgets everything. The interval is at least 2^24 wide, so one byte more tells a number in it; the three
    /// bytes behind it are zeros that need not be written.
    pub(crate) fn finish(&mut self, out: &mut Vec<u8>) {
        self.low += u64::from(TOP - 1);
        self.push();
        out.extend_from_slice(&self.bytes);
        self.clear();
    }
}

/// Reads what [`Encoder`] wrote. Behind the last byte it finds zeros; [`Decoder::at_end`] tells whether it found too many.
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

    #[inline]
    fn shift(&mut self) {
        while self.range < TOP {
            self.range <<= 8;
            self.pull();
        }
    }

    #[inline]
    pub(crate) fn bit(&mut self, odds: &mut Odds) -> bool {
        let bound = (self.range >> 16) * odds.width();
        let bit = self.code < bound;
        if bit {
            self.range = bound;
        } else {
            self.code -= bound;
            self.range -= bound;
        }
        odds.learn(bit);
        self.shift();
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
        let fresh = [Odds::new(1 << 15, 0); 3];
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
        // 0.012, 0.544 and 1 bit, and a little for learning.
        let entropy = 10_000.0 * (0.012 + 0.544 + 1.0 + 33.0);
        let spent = (bytes.len() * 8) as f64;
        assert!(spent < entropy * 1.01, "{spent} bits for {entropy}");
    }

    #[test]
    fn carries_and_the_end_are_right() {
        // Bits against all odds, and numbers at the upper end, make carries.
        for seed in 0..200u32 {
            let (mut encoder, mut odds) = (Encoder::default(), Odds::new(65_535, 63));
            let value = |i: u32| (seed + i).wrapping_mul(2_654_435_761) >> 28;
            for i in 0..40 {
                encoder.bit(&mut odds, value(i) > 12);
                encoder.raw(16, 65_535 - value(i) / 8);
            }
            let mut bytes = vec![];
            encoder.finish(&mut bytes);
            for cut in 0..3 {
                let (mut decoder, mut odds) =
                    (Decoder::new(&bytes[..bytes.len() - cut]), Odds::new(65_535, 63));
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
