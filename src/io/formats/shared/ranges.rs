//! Reads numbers of one type that lie one after another in a range of a file, as text or binary,
//! front to back.

use super::numbers::{push_ids, to_f64};
use super::text::TextNumbers;
use crate::bytes::ByteSource;
use crate::cells::NumberStream;
use crate::error::{Error, Result};
use crate::volume::ScalarType;
use std::ops::Range;
use std::sync::Arc;

/// Numbers in a range of a file.
pub(in crate::formats) struct RangeNumbers {
    scalar: ScalarType,
    place: NumberSource,
    bytes: Vec<u8>,
}

enum NumberSource {
    Text(TextNumbers),
    Binary { source: Arc<ByteSource>, range: Range<u64>, big_endian: bool },
}

impl RangeNumbers {
    /// Numbers written as words.
    pub(in crate::formats) fn text(source: &Arc<ByteSource>, range: Range<u64>, scalar: ScalarType) -> Self {
        Self::words(TextNumbers::new(source, range), scalar)
    }

    /// Numbers written as words of any kind.
    pub(in crate::formats) fn words(words: TextNumbers, scalar: ScalarType) -> Self {
        Self { scalar, place: NumberSource::Text(words), bytes: vec![] }
    }

    /// Numbers as bytes.
    pub(in crate::formats) fn binary(
        source: &Arc<ByteSource>,
        range: Range<u64>,
        scalar: ScalarType,
        big_endian: bool,
    ) -> Self {
        let place = NumberSource::Binary { source: Arc::clone(source), range, big_endian };
        Self { scalar, place, bytes: vec![] }
    }

    /// Reads the next `n` numbers into `bytes`, little-endian.
    fn load(&mut self, n: usize) -> Result<()> {
        self.bytes.resize(n * self.scalar.bytes(), 0);
        match &mut self.place {
            NumberSource::Text(words) => words.fill(self.scalar, &mut self.bytes),
            NumberSource::Binary { source, range, big_endian } => {
                if self.bytes.len() as u64 > range.end.saturating_sub(range.start) {
                    let at = crate::error::Place::byte(range.start);
                    return Err(Error::bad_input(source.path(), at, "more numbers", "the end of the array"));
                }
                source.read_at(range.start, &mut self.bytes)?;
                range.start += self.bytes.len() as u64;
                if *big_endian {
                    self.bytes.chunks_exact_mut(self.scalar.bytes()).for_each(<[u8]>::reverse);
                }
                Ok(())
            }
        }
    }

    /// Appends the next `n` numbers, integers, to `out`; see [`push_ids`].
    pub(in crate::formats) fn read_ids(&mut self, n: usize, out: &mut Vec<u64>) -> Result<()> {
        self.load(n)?;
        push_ids(self.scalar, &self.bytes, out);
        Ok(())
    }
}

impl NumberStream for RangeNumbers {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        self.load(out.len())?;
        to_f64(self.scalar, &self.bytes, out);
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        match &self.place {
            NumberSource::Text(words) => words.finish(),
            NumberSource::Binary { source, range, .. } if !range.is_empty() => {
                let at = crate::error::Place::byte(range.start);
                Err(Error::bad_input(source.path(), at, "the end of the array", "more numbers"))
            }
            NumberSource::Binary { .. } => Ok(()),
        }
    }
}

/// A known number of integers, one at a time.
pub(in crate::formats) struct Ids {
    numbers: RangeNumbers,
    /// Numbers not loaded yet.
    left: u64,
    loaded: Vec<u64>,
    used: usize,
}

impl Ids {
    const AT_A_TIME: u64 = 8192;

    pub(in crate::formats) fn new(numbers: RangeNumbers, count: u64) -> Self {
        Self { numbers, left: count, loaded: vec![], used: 0 }
    }

    /// The next one; `None` after the last.
    pub(in crate::formats) fn next(&mut self) -> Result<Option<u64>> {
        if self.used == self.loaded.len() {
            let n = self.left.min(Self::AT_A_TIME);
            self.left -= n;
            self.used = 0;
            self.loaded.clear();
            self.numbers.read_ids(n as usize, &mut self.loaded)?;
            if n == 0 {
                return Ok(None);
            }
        }
        self.used += 1;
        Ok(Some(self.loaded[self.used - 1]))
    }
}
