//! The lengths of tiles, as bytes.

use crate::error::{Error, Result};
use crate::range_coder::{Coder, Decoder, Encoder, Odds};

/// Odds of the number of bits of a length: after no bytes, and after some.
pub(crate) type LengthOdds = [[Odds; 33]; 2];

/// Those to begin with.
pub(crate) fn new_odds() -> LengthOdds {
    [[Odds::new(1 << 15); 33]; 2]
}

pub(crate) fn length<C: Coder>(
    wanted: u32,
    before: usize,
    odds: &mut LengthOdds,
    coder: &mut C,
) -> Result<u32> {
    let bits = 32 - wanted.leading_zeros() as usize;
    let mut read = 0;
    while coder.bit(&mut odds[before.min(1)][read], bits > read) {
        read += 1;
        if read > 32 {
            return Err(Error::Damaged("a length is too large"));
        }
    }
    let mut value = u32::from(read > 0);
    for bit in (0..read.saturating_sub(1)).rev() {
        value = value << 1 | u32::from(coder.even(wanted >> bit & 1 == 1));
    }
    Ok(value)
}

/// The lengths as bytes.
pub(crate) fn encode_lengths(lengths: &[u32]) -> Vec<u8> {
    let (mut coder, mut odds, mut before) = (Encoder::default(), new_odds(), 0);
    for wanted in lengths {
        length(*wanted, before, &mut odds, &mut coder).unwrap_or_else(|_| unreachable!());
        before = *wanted as usize;
    }
    coder.finish()
}

/// Reads what [`encode_lengths`] wrote, one by one.
pub(crate) struct Lengths<'a> {
    decoder: Decoder<'a>,
    odds: LengthOdds,
    before: usize,
}

impl<'a> Lengths<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { decoder: Decoder::new(bytes), odds: new_odds(), before: 0 }
    }

    pub(crate) fn next(&mut self) -> Result<u32> {
        let length = length(0, self.before, &mut self.odds, &mut self.decoder)?;
        self.before = length as usize;
        Ok(length)
    }

    /// An error if bytes are left.
    pub(crate) fn finish(self) -> Result<()> {
        self.decoder.finish()
    }
}
