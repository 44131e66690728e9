//! Sweeping simplices (Shen and Johnson, "Sweeping simplices: a fast iso-surface extraction
//! algorithm for unstructured grids", 1995).
//!
//! A group has two lists of cells: the *sweep list*, by maximum, with a flag each, and the *min
//! list*, by minimum, of places in the sweep list. A flag says that the cell's minimum is below the
//! isovalue; when the isovalue moves, only the flags of what lies between are changed. The active
//! cells are those with a flag, from the first maximum that is not below the isovalue.
//!
//! So that the sweep does not run over all cells above, there is a hierarchy: the range of values
//! is one group, its halves are two, and so on. A cell belongs to the smallest group that holds its
//! range; a query asks one group of each level.
//!
//! ```text
//!  level 0  ├───────────────────────────────┤   cells over the middle of the range
//!  level 1  ├───────────────┼───────────────┤
//!  level 2  ├───────┼───────┼───────┼───────┤   an isovalue is in one group of each level
//! ```
//!
//! O(n) in the worst case, and two sorted lists of memory.

use super::{Cells, Method};
use isospan::Result;

const LEVELS: u32 = 10;
/// Groups of the lowest level.
const LOWEST: usize = 1 << (LEVELS - 1);

/// A group of cells.
#[derive(Default)]
struct Group {
    /// Maximum and number of each cell, by maximum.
    sweep: Vec<(f32, u32)>,
    flags: Vec<bool>,
    /// Minimum, and place in the sweep list, by minimum.
    min_list: Vec<(f32, u32)>,
    /// How many of the min list have a flag.
    flagged: usize,
}

/// All groups: of level l, numbers 2^l - 1 to 2^(l+1) - 2.
pub(crate) struct SweepingSimplices {
    lowest: f64,
    scale: f64,
    groups: Vec<Group>,
}

impl SweepingSimplices {
    pub(crate) fn new(cells: &Cells<'_>) -> Self {
        let (lo, hi) = cells.bounds();
        let scale = LOWEST as f64 / (f64::from(hi) - f64::from(lo));
        let mut all = Self { lowest: f64::from(lo), scale, groups: vec![] };
        let mut members = vec![vec![]; 2 * LOWEST - 1];
        for ((lo, hi), id) in cells.ranges().zip(0u32..) {
            let [first, last] = [lo, hi].map(|v| all.lowest_group(v));
            // The level at which both ends are in one group.
            let up = usize::BITS - (first ^ last).leading_zeros();
            members[group(LEVELS - 1 - up, first)].push((lo, hi, id));
        }
        all.groups = members.into_iter().map(Group::new).collect();
        all
    }

    /// The group of the lowest level that holds a value; a larger value has no smaller one.
    fn lowest_group(&self, value: f32) -> usize {
        (((f64::from(value) - self.lowest) * self.scale) as usize).min(LOWEST - 1)
    }
}

/// The group of a level that holds a group of the lowest one.
fn group(level: u32, lowest: usize) -> usize {
    (1 << level) - 1 + (lowest >> (LEVELS - 1 - level))
}

impl Group {
    fn new(mut members: Vec<(f32, f32, u32)>) -> Self {
        members.sort_unstable_by(|a, b| a.1.total_cmp(&b.1));
        let mut min_list: Vec<(f32, u32)> = members.iter().map(|m| m.0).zip(0..).collect();
        min_list.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let sweep: Vec<(f32, u32)> = members.iter().map(|m| (m.1, m.2)).collect();
        Self { flags: vec![false; sweep.len()], sweep, min_list, flagged: 0 }
    }

    fn active(&mut self, isovalue: f32, found: &mut Vec<u32>) {
        let below = self.min_list.partition_point(|e| e.0 < isovalue);
        let (between, flag) = match below >= self.flagged {
            true => (self.flagged..below, true),
            false => (below..self.flagged, false),
        };
        self.min_list[between].iter().for_each(|e| self.flags[e.1 as usize] = flag);
        self.flagged = below;
        let first = self.sweep.partition_point(|e| e.0 < isovalue);
        let with_flags = self.sweep[first..].iter().zip(&self.flags[first..]);
        found.extend(with_flags.filter(|(_, flag)| **flag).map(|(e, _)| e.1));
    }
}

impl Method for SweepingSimplices {
    fn bytes(&self) -> u64 {
        let of = |g: &Group| size_of_val(&g.sweep[..]) + size_of_val(&g.min_list[..]) + g.flags.len();
        self.groups.iter().map(|g| (of(g) + size_of::<Group>()) as u64).sum()
    }

    fn active(&mut self, _: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()> {
        let lowest = self.lowest_group(isovalue);
        (0..LEVELS).for_each(|level| self.groups[group(level, lowest)].active(isovalue, found));
        Ok(())
    }
}
