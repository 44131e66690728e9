//! A binary range coder with odds that learn.
//!
//! The coder is the carry-propagating one of LZMA (Martin 1979, "Range encoding"; Pavlov's LZMA
//! specification): the interval [low, low + range) shrinks with each bit in proportion to the bit's
//! probability, and whole bytes leave at its top.

use crate::error::{Error, Result};

const TOP: u32 = 1 << 24;
/// Parts of its distance to a bit by which each half of odds moves, as shifts.
const FAST: u32 = 4;
const SLOW: u32 = 7;

/// The probability that a bit is set: the mean of two halves, one of which learns faster. Each
/// half stays between 2^SLOW and 2^16 - 2^SLOW at least, so odds are never certain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Odds {
    fast: u16,
    slow: u16,
}

impl Odds {
    /// Least and largest odds to begin with, in 1/65536.
    pub(crate) const LIMITS: [u16; 2] = [128, 65_408];

    /// Odds to begin with, in 1/65536, moved within the limits.
    pub(crate) const fn new(set: u16) -> Self {
        let [least, most] = Self::LIMITS;
        let set = if set < least {
            least
        } else if set > most {
            most
        } else {
            set
        };
        Self { fast: set, slow: set }
    }

    /// No odds, but the number of a decision, which [`Odds::set`] returns.
    pub(crate) fn numbered(number: u16) -> Self {
        Self { fast: number, slow: number }
    }

    /// The probability that the bit is set, in 1/65536.
    #[inline(always)]
    pub(crate) fn set(self) -> u32 {
        (u32::from(self.fast) + u32::from(self.slow)) >> 1
    }

    /// Learns a bit.
    #[inline(always)]
    fn learn(&mut self, bit: bool) {
        if bit {
            self.fast += ((65_536 - u32::from(self.fast)) >> FAST) as u16;
            self.slow += ((65_536 - u32::from(self.slow)) >> SLOW) as u16;
        } else {
            self.fast -= self.fast >> FAST;
            self.slow -= self.slow >> SLOW;
        }
    }
}

/// What writes or reads bits. An encoder returns the bit that it is given; a decoder ignores it and
/// returns the one that it reads. So one walk does both.
pub(crate) trait Coder {
    /// Whether bits are given.
    const ENCODES: bool;

    /// A bit with odds, which learn it.
    fn bit(&mut self, odds: &mut Odds, bit: bool) -> bool;

    /// A bit of even odds.
    fn even(&mut self, bit: bool) -> bool;
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
            for byte in self.bytes.iter_mut().rev() {
                *byte = byte.wrapping_add(1);
                if *byte != 0 {
                    break;
                }
            }
        }
        self.bytes.push((self.low >> 24) as u8);
        self.low = self.low << 8 & 0xffff_ffff;
    }

    /// The bytes. The interval is at least 2^24 wide, so one more byte identifies a number in it.
    /// Zeros at the end need not be written: a decoder finds them.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        self.low += u64::from(TOP - 1);
        self.push();
        while self.bytes.last() == Some(&0) {
            self.bytes.pop();
        }
        self.bytes
    }
}

impl Coder for Encoder {
    const ENCODES: bool = true;

    #[inline(always)]
    fn bit(&mut self, odds: &mut Odds, bit: bool) -> bool {
        let bound = (self.range >> 16) * odds.set();
        if bit {
            self.range = bound;
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
        }
        odds.learn(bit);
        if self.range < TOP {
            self.shift();
        }
        bit
    }

    #[inline(always)]
    fn even(&mut self, bit: bool) -> bool {
        self.range >>= 1;
        if !bit {
            self.low += u64::from(self.range);
        }
        if self.range < TOP {
            self.shift();
        }
        bit
    }
}

/// Reads what [`Encoder`] wrote.
#[derive(Debug)]
pub(crate) struct Decoder<'a> {
    /// The number in the interval, less its lower end.
    code: u32,
    range: u32,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Decoder<'a> {
    /// Starts to read.
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

    /// An error if bytes are left that no encoder would have written.
    pub(crate) fn finish(self) -> Result<()> {
        match self.at < self.bytes.len() {
            true => Err(Error::Damaged("bytes behind the end of a tile")),
            false => Ok(()),
        }
    }
}

impl Coder for Decoder<'_> {
    const ENCODES: bool = false;

    #[inline(always)]
    fn bit(&mut self, odds: &mut Odds, _: bool) -> bool {
        let bound = (self.range >> 16) * odds.set();
        let bit = self.code < bound;
        if bit {
            self.range = bound;
        } else {
            self.code -= bound;
            self.range -= bound;
        }
        odds.learn(bit);
        if self.range < TOP {
            self.shift();
        }
        bit
    }

    #[inline(always)]
    fn even(&mut self, _: bool) -> bool {
        self.range >>= 1;
        let bit = self.code < self.range;
        if !bit {
            self.code -= self.range;
        }
        if self.range < TOP {
            self.shift();
        }
        bit
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
            encoder.even(bit);
        }
        let bytes = encoder.finish();
        let (mut decoder, mut odds) = (Decoder::new(&bytes), fresh);
        for &(at, bit) in &bits {
            assert_eq!(decoder.bit(&mut odds[at], !bit), bit);
            assert_eq!(decoder.even(!bit), bit);
        }
        decoder.finish().unwrap();
        // 0.012, 0.544 and 1 bit, three of even odds, and something for learning.
        let entropy = 10_000.0 * (0.012 + 0.544 + 1.0 + 3.0);
        let spent = (bytes.len() * 8) as f64;
        assert!(spent < entropy * 1.02, "{spent} bits for {entropy}");
    }

    #[test]
    fn carries_and_zeros_at_the_end_are_right() {
        // Bits against all odds make carries.
        for seed in 0..300u32 {
            let (mut encoder, mut odds) = (Encoder::default(), Odds::new(65_535));
            let value = |i: u32| (seed + i).wrapping_mul(2_654_435_761) >> 28;
            for i in 0..seed {
                encoder.bit(&mut odds, value(i) > 12);
                encoder.even(value(i) == 3);
            }
            let bytes = encoder.finish();
            let (mut decoder, mut odds) = (Decoder::new(&bytes), Odds::new(65_535));
            for i in 0..seed {
                assert_eq!(decoder.bit(&mut odds, false), value(i) > 12);
                assert_eq!(decoder.even(false), value(i) == 3);
            }
            decoder.finish().unwrap();
        }
    }

    #[test]
    fn odds_are_never_certain() {
        for bit in [false, true] {
            let mut odds = Odds::new(1 << 15);
            (0..10_000).for_each(|_| odds.learn(bit));
            let least = odds.set().min(65_536 - odds.set());
            assert!(least >= 16, "{odds:?}");
        }
    }
}
