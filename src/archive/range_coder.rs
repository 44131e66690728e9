//! An adaptive binary range coder (as in LZMA; Martin 1979): decisions of known probability cost their entropy.

/// The probability that a decision is `false`, in 1/4096, and how often it was met: it learns fast at first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Odds {
    no: u16,
    seen: u8,
}

const ONE: u32 = 1 << 12;
/// After this many decisions an [`Odds`] learns at its slowest rate, 1/2^SLOWEST.
const SLOWEST: u8 = 6;

impl Odds {
    /// Nothing is known: half, learning fast.
    pub(crate) const UNKNOWN: Self = Self { no: 2048, seen: 2 };

    /// Known beforehand, in 1/256; learns slowly.
    pub(crate) const fn known(no: u8) -> Self {
        Self { no: no as u16 * 16 + 8, seen: 24 }
    }

    #[inline]
    fn learn(&mut self, bit: bool) {
        let rate = u32::from(RATES[self.seen as usize]);
        self.seen = (self.seen + 1).min(RATES.len() as u8 - 1);
        let no = u32::from(self.no);
        let no = if bit { no - (no >> rate) } else { no + ((ONE - no) >> rate) };
        self.no = no.clamp(32, ONE - 32) as u16;
    }
}

const RATES: [u8; 48] = {
    let mut rates = [SLOWEST; 48];
    let mut i = 0;
    while i < 24 {
        rates[i] = if i < 2 {
            2
        } else if i < 5 {
            3
        } else if i < 11 {
            4
        } else {
            5
        };
        i += 1;
    }
    rates
};

#[derive(Debug)]
pub(crate) struct Encoder {
    low: u64,
    range: u32,
    out: Vec<u8>,
}

impl Encoder {
    pub(crate) fn new() -> Self {
        Self { low: 0, range: u32::MAX, out: vec![] }
    }

    pub(crate) fn bit(&mut self, odds: &mut Odds, bit: bool) {
        let bound = (self.range >> 12) * u32::from(odds.no);
        if bit {
            self.low += u64::from(bound);
            self.range -= bound;
        } else {
            self.range = bound;
        }
        odds.learn(bit);
        self.normalise();
    }

    /// `count` bits of equal probability, at most 16.
    pub(crate) fn raw(&mut self, value: u32, count: u32) {
        self.range >>= count;
        self.low += u64::from(self.range) * u64::from(value);
        self.normalise();
    }

    fn normalise(&mut self) {
        self.carry();
        while self.range < 1 << 24 {
            self.out.push((self.low >> 24) as u8);
            self.low = self.low << 8 & 0xffff_ffff;
            self.range <<= 8;
        }
    }

    /// Moves what no longer fits 32 bits into what has been written.
    fn carry(&mut self) {
        if self.low >> 32 != 0 {
            for byte in self.out.iter_mut().rev() {
                *byte = byte.wrapping_add(1);
                if *byte != 0 {
                    break;
                }
            }
            self.low &= 0xffff_ffff;
        }
    }

    /// The bytes; trailing zeros are left out, the decoder reads zeros behind the end.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        // Any number in low .. low + range will do: the one with the most trailing zeros.
        let high = self.low + u64::from(self.range) - 1;
        let mut keep = 0;
        while keep < 32 && (high >> (32 - keep) << (32 - keep)) < self.low {
            keep += 8;
        }
        self.low = high >> (32 - keep) << (32 - keep);
        self.carry();
        self.out.extend((self.low as u32).to_be_bytes());
        while self.out.last() == Some(&0) {
            self.out.pop();
        }
        self.out
    }
}

#[derive(Debug)]
pub(crate) struct Decoder<'a> {
    code: u32,
    range: u32,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Decoder<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let mut d = Self { code: 0, range: u32::MAX, bytes, at: 0 };
        (0..4).for_each(|_| d.code = d.code << 8 | d.next());
        d
    }

    #[inline]
    fn next(&mut self) -> u32 {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        u32::from(byte)
    }

    /// Whether more was decoded than the bytes can hold: the bytes are damaged.
    #[inline]
    pub(crate) fn overrun(&self) -> bool {
        self.at > self.bytes.len() + 8
    }

    #[inline]
    pub(crate) fn bit(&mut self, odds: &mut Odds) -> bool {
        let bound = (self.range >> 12) * u32::from(odds.no);
        let bit = self.code >= bound;
        if bit {
            self.code -= bound;
            self.range -= bound;
        } else {
            self.range = bound;
        }
        odds.learn(bit);
        self.normalise();
        bit
    }

    pub(crate) fn raw(&mut self, count: u32) -> u32 {
        self.range >>= count;
        let value = (self.code / self.range).min((1 << count) - 1);
        self.code -= value * self.range;
        self.normalise();
        value
    }

    #[inline]
    fn normalise(&mut self) {
        while self.range < 1 << 24 {
            self.code = self.code << 8 | self.next();
            self.range <<= 8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decisions_come_back_at_their_entropy() {
        for (seed, one_in) in [(1u32, 2), (2, 3), (3, 10), (4, 300), (5, 100_000)] {
            let mut state = seed;
            let mut draw = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                state >> 8
            };
            let bits: Vec<(bool, u32)> = (0..5000).map(|_| (draw() % one_in == 0, draw() & 0x3f)).collect();
            let (mut e, mut odds) = (Encoder::new(), [Odds::UNKNOWN; 3]);
            for (i, &(bit, raw)) in bits.iter().enumerate() {
                e.bit(&mut odds[i % 3], bit);
                if i % 11 == 0 {
                    e.raw(raw, 6);
                }
            }
            let bytes = e.finish();
            let p = 1.0 / f64::from(one_in);
            let entropy = if one_in == 2 { 1.0 } else { -p * p.log2() - (1.0 - p) * (1.0 - p).log2() };
            let most = (5000.0 * (entropy * 1.03 + 0.02) + 5000.0 / 11.0 * 6.0) / 8.0 + 30.0;
            assert!((bytes.len() as f64) < most, "{} {most}", bytes.len());
            let (mut d, mut odds) = (Decoder::new(&bytes), [Odds::UNKNOWN; 3]);
            for (i, &(bit, raw)) in bits.iter().enumerate() {
                assert_eq!(d.bit(&mut odds[i % 3]), bit);
                if i % 11 == 0 {
                    assert_eq!(d.raw(6), raw);
                }
            }
            assert!(!d.overrun());
        }
    }
}
