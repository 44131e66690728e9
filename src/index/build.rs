//! Builds an index: kd-splits in memory, pages depth first.

use super::Entry;
use super::page::{Bounds, LEAF_ENTRIES, PAGE_LEVELS, child_sizes, encode_inner, encode_leaf};
use crate::archive::segment::{PlanHash, SegmentInfo, SegmentKind, SegmentWriter};
use crate::error::Result;
use std::cmp::Ordering;
use std::path::Path;

/// Collects the blocks of a step. The file depends on the set of entries, not on the order in which they come.
#[derive(Debug, Default)]
pub struct IndexBuilder {
    entries: Vec<Entry>,
}

impl IndexBuilder {
    /// No entries.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a block. A void block (no finite tetrahedron) has no range and is not added.
    ///
    /// # Panics
    /// When the range is not a range: `min <= max` and neither NaN.
    pub fn push(&mut self, entry: Entry) {
        assert!(entry.min <= entry.max, "block {:?} of range {}..{}", entry.place(), entry.min, entry.max);
        self.entries.push(entry);
    }

    /// Number of entries.
    pub fn len(&self) -> u64 {
        self.entries.len() as u64
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Writes the index and publishes it.
    ///
    /// # Errors
    /// When the file cannot be written.
    ///
    /// # Panics
    /// When a block was added twice.
    pub fn finish(mut self, path: impl AsRef<Path>, plan: PlanHash) -> Result<SegmentInfo> {
        self.entries.sort_unstable_by_key(Entry::place);
        assert!(self.entries.is_sorted_by(|a, b| a.place() < b.place()), "each block is added once");
        let mut out = SegmentWriter::create(path, SegmentKind::Index, plan)?;
        out.push_block(&root_block(&self.entries))?;
        if !self.entries.is_empty() {
            write_subtree(&mut self.entries, Axis::Min, &mut out)?;
        }
        out.finish()
    }
}

/// Block 0: number of entries, lowest min, highest max, shape of the tree.
fn root_block(entries: &[Entry]) -> Vec<u8> {
    let bounds = bounds(entries);
    let mut out = (entries.len() as u64).to_le_bytes().to_vec();
    out.extend(bounds.lowest.to_le_bytes());
    out.extend(bounds.highest.to_le_bytes());
    out.extend((LEAF_ENTRIES as u32).to_le_bytes());
    out.extend(PAGE_LEVELS.to_le_bytes());
    out
}

/// By the total order of bits: which of two zeros is the lowest must not depend on who comes first.
fn bounds(entries: &[Entry]) -> Bounds {
    Bounds {
        lowest: entries.iter().map(|e| e.min).min_by(f32::total_cmp).unwrap_or(0.0),
        highest: entries.iter().map(|e| e.max).max_by(f32::total_cmp).unwrap_or(0.0),
    }
}

#[derive(Clone, Copy)]
enum Axis {
    Min,
    Max,
}

impl Axis {
    fn other(self) -> Self {
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
}

/// Moves the smaller half by `axis` to the front, then goes on in both halves by the other axis.
fn split(entries: &mut [Entry], axis: Axis, levels: u32) {
    if levels == 0 || entries.len() as u64 <= LEAF_ENTRIES {
        return;
    }
    let middle = entries.len() / 2;
    entries.select_nth_unstable_by(middle, |a, b| axis.compare(a, b));
    let (left, right) = entries.split_at_mut(middle);
    split(left, axis.other(), levels - 1);
    split(right, axis.other(), levels - 1);
}

/// Writes the page of `entries` and all pages below it. The depth of the recursion is the tree's: 8 bits of n a level.
fn write_subtree(entries: &mut [Entry], axis: Axis, out: &mut SegmentWriter) -> Result<()> {
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
        children.push(bounds(child));
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
