//! Bits that are written as they are, a few at a time, lowest first. Small numbers are
//! [Elias gamma](https://en.wikipedia.org/wiki/Elias_gamma_coding) codes: the bits of n + 1 below
//! the highest, and before them as many zeros and a one.

use crate::archive::wire::put_varint;

/// Collects bits.
#[derive(Default)]
pub(super) struct BitWriter {
    bytes: Vec<u8>,
    /// Bits that do not fill a byte yet, from the lowest, and their number.
    rest: u64,
    bits: u32,
}

impl BitWriter {
    /// Appends at most 32 bits; those above are not set.
    #[inline(always)]
    pub(super) fn put(&mut self, value: u32, bits: u32) {
        debug_assert!(bits <= 32 && u64::from(value) >> bits == 0);
        self.rest |= u64::from(value) << self.bits;
        self.bits += bits;
        if self.bits >= 32 {
            self.bytes.extend_from_slice(&(self.rest as u32).to_le_bytes());
            self.rest >>= 32;
            self.bits -= 32;
        }
    }

    /// Appends a number below 2^32 - 1.
    #[inline(always)]
    pub(super) fn put_number(&mut self, number: u32) {
        let length = (number + 1).ilog2();
        self.put(1 << length, length + 1);
        self.put((number + 1) ^ 1 << length, length);
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        *self = Self { bytes: std::mem::take(&mut self.bytes), ..Self::default() };
        self.bytes.clear();
    }

    /// Appends the number of bytes and the bytes, the last filled with zeros, and forgets
    /// everything.
    pub(super) fn finish(&mut self, out: &mut Vec<u8>) {
        self.bytes.extend_from_slice(&self.rest.to_le_bytes()[..self.bits.div_ceil(8) as usize]);
        put_varint(out, self.bytes.len() as u64);
        out.extend_from_slice(&self.bytes);
        self.clear();
    }
}

/// Reads what [`BitWriter`] wrote. Behind the last byte it finds zeros; [`BitReader::at_end`] says
/// whether it found any.
#[derive(Debug)]
pub(super) struct BitReader<'a> {
    bytes: &'a [u8],
    /// Bits that were read.
    at: usize,
}

impl<'a> BitReader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// As many bits as are wanted, at most 32; above them may be anything.
    #[inline(always)]
    fn peek(&self) -> u32 {
        let (byte, bit) = (self.at / 8, self.at % 8);
        let eight = match self.bytes.get(byte..byte + 8) {
            Some(eight) => u64::from_le_bytes(eight.try_into().expect("they are eight")),
            None => self.last(byte),
        };
        (eight >> bit) as u32
    }

    /// The next bits, fewer than 32.
    #[inline(always)]
    pub(super) fn take(&mut self, bits: u32) -> u32 {
        let value = self.peek() & !(u32::MAX << bits);
        self.at += bits as usize;
        value
    }

    /// A number below 2^32 - 1; `None` if there is none.
    #[inline(always)]
    pub(super) fn take_number(&mut self) -> Option<u32> {
        let length = self.peek().trailing_zeros();
        if length >= 32 {
            return None;
        }
        self.at += length as usize + 1;
        Some((self.take(length) | 1 << length) - 1)
    }

    #[cold]
    fn last(&self, from: usize) -> u64 {
        let mut eight = [0; 8];
        let rest = self.bytes.get(from..).unwrap_or_default();
        eight[..rest.len()].copy_from_slice(rest);
        u64::from_le_bytes(eight)
    }

    /// Whether all was read, and nothing more.
    pub(super) fn at_end(&self) -> bool {
        self.at.div_ceil(8) == self.bytes.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_and_numbers_come_back() {
        let value = |i: u32| i.wrapping_mul(2_654_435_761);
        let number = |i: u32| (value(i) >> (i % 32)).min(u32::MAX - 1);
        let mut writer = BitWriter::default();
        writer.put(77, 20);
        writer.clear();
        for i in 0..500 {
            writer.put(value(i) >> (32 - i % 32).min(31) & !(u32::MAX << (i % 32)), i % 32);
            writer.put_number(number(i));
        }
        let mut bytes = vec![];
        writer.finish(&mut bytes);
        let bytes = &bytes[2..];
        for cut in 0..2 {
            let mut reader = BitReader::new(&bytes[..bytes.len() - cut]);
            let mut same = true;
            for i in 0..500 {
                same &= reader.take(i % 32) == value(i) >> (32 - i % 32).min(31) & !(u32::MAX << (i % 32));
                same &= reader.take_number() == Some(number(i));
            }
            assert_eq!((same, reader.at_end()), (cut == 0, cut == 0));
        }
        assert_eq!(BitReader::new(&[0; 9]).take_number(), None);
        assert_eq!(BitReader::new(&[]).take(5), 0);
        assert!(!BitReader::new(&[0]).at_end());
    }
}
