//! The active list (Giles and Haines, "Advanced interactive visualization for CFD", 1990).
//!
//! Cells are sorted by minimum and, a second time, by maximum; Δ is the widest range of a cell. The
//! first answer is looked for among the cells whose minimum is less than Δ below the isovalue. The
//! list of active cells is kept: when the isovalue moves by less than Δ, only cells between the old
//! and the new one are added, from one of the lists, and those that are no longer active are taken
//! out.
//!
//! O(n) in the worst case: one wide cell makes Δ useless.

use super::{Cells, Method};
use isospan::Result;

/// Both lists, and the answer to the last question.
pub(crate) struct ActiveList {
    by_min: Vec<(f32, u32)>,
    by_max: Vec<(f32, u32)>,
    /// No range is wider.
    delta: f64,
    last: Option<f32>,
    /// Minimum, maximum and number of those that were active.
    list: Vec<(f32, f32, u32)>,
}

impl ActiveList {
    pub(crate) fn new(cells: &Cells<'_>) -> Self {
        let sorted = |of: fn((f32, f32)) -> f32| {
            let mut all: Vec<(f32, u32)> = cells.ranges().map(of).zip(0..).collect();
            all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            all
        };
        let (by_min, by_max) = (sorted(|r| r.0), sorted(|r| r.1));
        let widest = cells.ranges().map(|(lo, hi)| f64::from(hi) - f64::from(lo)).fold(0.0, f64::max);
        // The next larger number, as the difference may have been rounded down.
        Self { by_min, by_max, delta: widest.next_up(), last: None, list: vec![] }
    }

    /// Cells of a sorted list from one value to before another.
    fn between(sorted: &[(f32, u32)], from: f64, to: f32) -> &[(f32, u32)] {
        let begin = sorted.partition_point(|e| f64::from(e.0) < from);
        let end = sorted.partition_point(|e| e.0 < to);
        &sorted[begin..end.max(begin)]
    }
}

impl Method for ActiveList {
    fn bytes(&self) -> u64 {
        let lists = size_of_val(&self.by_min[..]) + size_of_val(&self.by_max[..]);
        (lists + self.list.capacity() * size_of::<(f32, f32, u32)>()) as u64
    }

    fn active(&mut self, cells: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()> {
        let v = f64::from(isovalue);
        let near = self.last.filter(|&last| (v - f64::from(last)).abs() < self.delta);
        let added = match near {
            None => {
                self.list.clear();
                Self::between(&self.by_min, v - self.delta, isovalue)
            }
            Some(last) if last <= isovalue => Self::between(&self.by_min, f64::from(last), isovalue),
            Some(last) => Self::between(&self.by_max, v, last),
        };
        self.list.retain(|&(lo, hi, _)| lo < isovalue && isovalue <= hi);
        for &(_, id) in added {
            let (lo, hi) = cells.range(id as usize);
            if lo < isovalue && isovalue <= hi {
                self.list.push((lo, hi, id));
            }
        }
        self.last = Some(isovalue);
        found.extend(self.list.iter().map(|e| e.2));
        Ok(())
    }
}
