//! Which part of a reduction a worker does.

use isospan_io::error::{Error, Result};
use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// A part of the work: the `index`-th of `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: u64,
    count: u64,
}

impl Shard {
    /// All of the work.
    pub const ALL: Self = Self { index: 0, count: 1 };

    /// # Errors
    /// [`Error::Usage`] unless `index < count`.
    pub fn new(index: u64, count: u64) -> Result<Self> {
        if index < count {
            return Ok(Self { index, count });
        }
        Err(Error::usage(format!("there is no shard {index} of {count}: they count from 0")))
    }

    /// Its run of `segments`; empty for some when there are fewer segments than shards.
    pub(in crate::pipeline) fn range(self, segments: u64) -> Range<u64> {
        let at = |i: u64| (u128::from(segments) * u128::from(i) / u128::from(self.count)) as u64;
        at(self.index)..at(self.index + 1)
    }

    /// The number of the shard, of `count`, that has a segment: the first one that ends after it.
    pub(in crate::pipeline) fn with_segment(segment: u64, segments: u64, count: u64) -> u64 {
        let end = (u128::from(segment + 1) * u128::from(count)).div_ceil(u128::from(segments));
        end as u64 - 1
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let number = |s: &str| s.trim().parse().ok();
        let parts = text.split_once('/').and_then(|(i, n)| Some((number(i)?, number(n)?)));
        let (index, count) =
            parts.ok_or_else(|| Error::usage(format!("'{text}' is no shard; write I/N, as in 0/4")))?;
        Self::new(index, count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_cover_all_segments_once() {
        for segments in [0, 1, 2, 7, 16, 1000] {
            for count in [1, 2, 3, 16, 1001] {
                let mut next = 0;
                for index in 0..count {
                    let range = Shard::new(index, count).unwrap().range(segments);
                    assert_eq!(range.start, next);
                    assert!(range.end - range.start <= segments.div_ceil(count));
                    assert!(range.clone().all(|s| Shard::with_segment(s, segments, count) == index));
                    next = range.end;
                }
                assert_eq!(next, segments);
            }
        }
    }

    #[test]
    fn shards_are_written_as_fractions() {
        assert_eq!("3/16".parse::<Shard>().unwrap(), Shard::new(3, 16).unwrap());
        assert_eq!(Shard::new(3, 16).unwrap().to_string(), "3/16");
        for bad in ["", "1", "/", "4/4", "-1/4", "1/0", "x/2", "1/2/3"] {
            assert_eq!(bad.parse::<Shard>().unwrap_err().exit_code(), 2, "{bad}");
        }
    }
}
