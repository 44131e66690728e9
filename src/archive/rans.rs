//! Range asymmetric numeral systems (Duda 2013), with fixed probabilities of 12 bits.

/// Bits of a probability.
pub(crate) const PRECISION: u32 = 12;
const LOWEST: u32 = 1 << 16;

/// The encoder runs backwards, so the symbols are gathered first.
#[derive(Debug, Default)]
pub(crate) struct Encoder {
    /// Start and width of each symbol's part of 0..4096.
    steps: Vec<(u16, u16)>,
}

impl Encoder {
    #[inline]
    pub(crate) fn put(&mut self, start: u16, width: u16) {
        self.steps.push((start, width));
    }

    /// Forgets the symbols.
    pub(crate) fn clear(&mut self) {
        self.steps.clear();
    }

    /// Appends the bytes, and forgets the symbols.
    pub(crate) fn finish(&mut self, out: &mut Vec<u8>) {
        let mut x = LOWEST;
        let at = out.len();
        for &(start, width) in self.steps.iter().rev() {
            let (start, width) = (u32::from(start), u32::from(width));
            if x >> (32 - PRECISION) >= width {
                // Everything is reversed in the end.
                out.extend((x as u16).to_be_bytes());
                x >>= 16;
            }
            x = ((x / width) << PRECISION) + x % width + start;
        }
        out.extend(x.to_be_bytes());
        out[at..].reverse();
        self.steps.clear();
    }
}

#[derive(Debug)]
pub(crate) struct Decoder<'a> {
    x: u32,
    rest: &'a [u8],
}

impl<'a> Decoder<'a> {
    /// `None` if there are not even the bytes of the first state.
    pub(crate) fn new(bytes: &'a [u8]) -> Option<Self> {
        let (head, rest) = bytes.split_first_chunk()?;
        Some(Self { x: u32::from_le_bytes(*head), rest })
    }

    /// Where in 0..4096 the next symbol is.
    #[inline]
    pub(crate) fn slot(&self) -> u32 {
        self.x & ((1 << PRECISION) - 1)
    }

    /// The next of N symbols, given where each one's part starts.
    #[inline]
    pub(crate) fn symbol<const N: usize>(&mut self, starts: &[u16; N]) -> usize {
        let slot = self.slot() as u16;
        let symbol = starts.iter().map(|&s| u16::from(s <= slot)).sum::<u16>() as usize - 1;
        let start = starts[symbol];
        self.skip(start.into(), (starts.get(symbol + 1).map_or(1 << PRECISION, |&s| s) - start).into());
        symbol
    }

    /// Goes behind the symbol that has the slot.
    #[inline]
    pub(crate) fn skip(&mut self, start: u32, width: u32) {
        self.x = width * (self.x >> PRECISION) + self.slot() - start;
        if self.x < LOWEST
            && let Some((head, rest)) = self.rest.split_first_chunk()
        {
            self.x = self.x << 16 | u32::from(u16::from_le_bytes(*head));
            self.rest = rest;
        }
    }

    /// Whether all was read, and nothing more.
    pub(crate) fn at_end(&self) -> bool {
        self.x == LOWEST && self.rest.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_come_back_at_their_entropy() {
        const STARTS: [u16; 3] = [0, 3000, 4095];
        let mut encoder = Encoder::default();
        let symbols: Vec<usize> =
            (0..20_000usize).map(|i| usize::from(i % 4 == 1) + usize::from(i % 997 == 1)).collect();
        for &s in &symbols {
            encoder.put(STARTS[s], STARTS.get(s + 1).map_or(4096, |&n| n) - STARTS[s]);
            encoder.put(s as u16 * 2, 2);
        }
        let mut bytes = vec![7];
        encoder.finish(&mut bytes);
        let mut d = Decoder::new(&bytes[1..]).unwrap();
        for &s in &symbols {
            assert_eq!(d.symbol(&STARTS), s);
            assert_eq!(d.slot() / 2, s as u32);
            d.skip(s as u32 * 2, 2);
        }
        assert!(d.at_end());
        let bits = symbols.iter().map(|&s| 11.0 + [0.449, 1.903, 12.0][s]).sum::<f64>();
        assert!(((bytes.len() * 8) as f64) < bits + 64.0, "{} bytes for {bits} bits", bytes.len());
    }

    #[test]
    fn the_end_is_known() {
        let starts: [u16; 256] = std::array::from_fn(|i| i as u16 * 16);
        let mut encoder = Encoder::default();
        (0..100).for_each(|i| encoder.put(i * 16, 16));
        let mut bytes = vec![];
        encoder.finish(&mut bytes);
        for cut in [1, 2, 3, bytes.len() - 4] {
            let mut d = Decoder::new(&bytes[..bytes.len() - cut]).unwrap();
            for _ in 0..100 {
                d.symbol(&starts);
            }
            assert!(!d.at_end());
        }
        assert!(Decoder::new(&bytes[..3]).is_none());
    }
}
