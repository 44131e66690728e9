//! The span filter (Gallagher, "Span filtering: an optimization scheme for volume visualization of
//! large finite element models", 1991).
//!
//! The range of values is cut into buckets. A cell is filed under its span (over how many buckets
//! its range goes) and the bucket in which it begins; long ones have one list in common. The
//! numbers of a list are stored as differences, of one byte mostly.
//!
//! ```text
//!  bucket   0   1   2   3   4         an isovalue in bucket 2 asks of span 1 the cells that begin in 2, of span 2
//!  span 1   ·   ·   x   ·   ·         those that begin in 1 and 2, of span 3 those of 0, 1 and 2, …; a cell that begins or
//!  span 2   ·   x   x   ·   ·         ends in bucket 2 itself must be looked at, one that passes through it
//!  span 3   x   x   x   ·   ·         is active
//! ```
//!
//! Small and quickly made. How good it is depends on the buckets, which are here of one width; O(n)
//! in the worst case.

use super::{Cells, Method};
use isospan::Result;
use isospan::mesh::tet::is_active;

const BUCKETS: usize = 256;
/// Cells of longer spans have one list.
const SPANS: usize = 16;

/// The lists, one after another: by span, then by first bucket; at last that of the long ones.
pub(crate) struct SpanFilter {
    lowest: f64,
    /// Buckets by value.
    scale: f64,
    bytes: Vec<u8>,
    starts: Vec<usize>,
}

impl SpanFilter {
    pub(crate) fn new(cells: &Cells<'_>) -> Self {
        let (lo, hi) = cells.bounds();
        let scale = BUCKETS as f64 / (f64::from(hi) - f64::from(lo));
        let mut filter = Self { lowest: f64::from(lo), scale, bytes: vec![], starts: vec![] };
        let mut lists = vec![vec![]; SPANS * BUCKETS + 1];
        let mut last = vec![0u32; lists.len()];
        for ((lo, hi), id) in cells.ranges().zip(0u32..) {
            let (first, end) = (filter.bucket(lo), filter.bucket(hi));
            let list = if end - first < SPANS { (end - first) * BUCKETS + first } else { SPANS * BUCKETS };
            push_difference(&mut lists[list], id - last[list]);
            last[list] = id;
        }
        for list in lists {
            filter.starts.push(filter.bytes.len());
            filter.bytes.extend(list);
        }
        filter.starts.push(filter.bytes.len());
        filter
    }

    /// A larger value has no smaller bucket.
    fn bucket(&self, value: f32) -> usize {
        // 0 for what is below all buckets, and where all values are equal (a NaN).
        (((f64::from(value) - self.lowest) * self.scale) as usize).min(BUCKETS - 1)
    }

    fn list(&self, number: usize) -> impl Iterator<Item = u32> + '_ {
        let mut rest = &self.bytes[self.starts[number]..self.starts[number + 1]];
        let mut id = 0;
        std::iter::from_fn(move || {
            id += pop_difference(&mut rest)?;
            Some(id)
        })
    }
}

impl Method for SpanFilter {
    fn bytes(&self) -> u64 {
        (self.bytes.len() + size_of_val(&self.starts[..])) as u64
    }

    fn active(&mut self, cells: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()> {
        let at = self.bucket(isovalue);
        let look = |&id: &u32| {
            let (lo, hi) = cells.range(id as usize);
            is_active(lo, hi, isovalue)
        };
        for span in 0..SPANS {
            for first in at.saturating_sub(span)..=at {
                let list = self.list(span * BUCKETS + first);
                match first < at && at < first + span {
                    true => found.extend(list),
                    false => found.extend(list.filter(look)),
                }
            }
        }
        found.extend(self.list(SPANS * BUCKETS).filter(look));
        Ok(())
    }
}

/// Seven bits a byte, the lowest first; the last byte has its highest bit clear.
fn push_difference(out: &mut Vec<u8>, mut n: u32) {
    while n >= 0x80 {
        out.push(n as u8 | 0x80);
        n >>= 7;
    }
    out.push(n as u8);
}

fn pop_difference(bytes: &mut &[u8]) -> Option<u32> {
    let (mut n, mut shift) = (0, 0);
    loop {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        n |= u32::from(byte & 0x7f) << shift;
        shift += 7;
        if byte < 0x80 {
            return Some(n);
        }
    }
}
