//! A subtree of the index, of entries in memory: kd-splits, and pages depth first.

use super::Entry;
use super::page::{Bounds, LEAF_ENTRIES, PAGE_LEVELS, child_sizes, encode_inner, encode_leaf};
use crate::archive::segment::SegmentWriter;
use isospan_io::error::Result;
use std::cmp::Ordering;

/// The value by which entries are split.
#[derive(Clone, Copy)]
pub(super) enum SplitAxis {
    Min,
    Max,
}

impl SplitAxis {
    pub(super) fn other(self) -> Self {
        match self {
            Self::Min => Self::Max,
            Self::Max => Self::Min,
        }
    }

    /// A total order, so that what falls in either half does not depend on the selection algorithm.
    fn compare(self, a: &Entry, b: &Entry) -> Ordering {
        let key = match self {
            Self::Min => a.min.total_cmp(&b.min),
            Self::Max => a.max.total_cmp(&b.max),
        };
        key.then(a.place().cmp(&b.place()))
    }

    /// The same order as numbers.
    pub(super) fn key(self, e: &Entry) -> u128 {
        let value = match self {
            Self::Min => e.min,
            Self::Max => e.max,
        };
        u128::from(super::ordered_key(value)) << 96 | u128::from(e.chunk) << 32 | u128::from(e.block)
    }
}

/// Moves the smaller half by `axis` to the front, then goes on in both halves by the other axis.
pub(super) fn split(entries: &mut [Entry], axis: SplitAxis, levels: u32) {
    if levels == 0 || entries.len() as u64 <= LEAF_ENTRIES {
        return;
    }
    let middle = entries.len() / 2;
    entries.select_nth_unstable_by(middle, |a, b| axis.compare(a, b));
    let (left, right) = entries.split_at_mut(middle);
    split(left, axis.other(), levels - 1);
    split(right, axis.other(), levels - 1);
}

/// Writes the page of `entries` and all pages below it. The depth of the recursion is the tree's: 8
/// bits of n a level.
pub(super) fn write_subtree(entries: &mut [Entry], axis: SplitAxis, out: &mut SegmentWriter) -> Result<()> {
    if entries.len() as u64 <= LEAF_ENTRIES {
        entries.sort_unstable_by_key(Entry::place);
        out.push_block(&encode_leaf(entries))?;
        return Ok(());
    }
    split(entries, axis, PAGE_LEVELS);
    let sizes = child_sizes(entries.len() as u64);
    let mut children = vec![];
    let mut rest = &*entries;
    for &n in &sizes {
        let (child, tail) = rest.split_at(n as usize);
        children.push(Bounds::of(child));
        rest = tail;
    }
    out.push_block(&encode_inner(&children))?;
    // After an even number of levels the axis is the same again.
    let mut rest = entries;
    for n in sizes {
        let (child, tail) = rest.split_at_mut(n as usize);
        write_subtree(child, axis, out)?;
        rest = tail;
    }
    Ok(())
}

const _: () = assert!(PAGE_LEVELS.is_multiple_of(2), "a child page begins with the same axis");
