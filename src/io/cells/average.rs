//! Cell data to points: the mean over the cells that use a point.
//!
//! Sums and counts of all points need 12 bytes a point, which may be more than there is. So points
//! are gone through in *windows* of as many as fit, and the cells once for each window: 100 million
//! points in 256 MiB take 5 passes. A sum adds up in the order of the cells, so that the result
//! does not depend on the window.
//!
//! A cell whose value is NaN makes its points NaN: nothing is invented. Cells without a volume do
//! not count. Where several points lie in one place, as those of pieces do at their common border,
//! the first of them stands for all, and the others have no mean of their own.

use super::blocks::{CellBlocks, Part, Tuples};
use super::polyhedron::{Faces, distinct};
use super::{BLOCK, CellBlock, CellFile, CellKind};
use crate::error::Result;
use std::sync::Arc;

/// Bytes for a point of a window.
const POINT_BYTES: u64 = 12;

/// Puts the first point of its place in the place of each.
pub type Replace = Box<dyn Fn(&mut [u64]) -> Result<()>>;

/// Means at points 0, 1, 2, …
pub(super) struct Averages {
    file: Arc<dyn CellFile>,
    field: usize,
    part: Part,
    /// Whether a cell with a value has none: then it counts as NaN.
    is_missing: Box<dyn Fn(f64) -> bool>,
    replace: Option<Replace>,
    /// Points of a window, at most.
    window: u64,
    /// The first point of the window that comes next.
    next: u64,
    sums: Vec<f64>,
    counts: Vec<u32>,
    /// Points of this window handed out.
    used: usize,
}

impl Averages {
    pub(super) fn new(
        file: Arc<dyn CellFile>,
        field: usize,
        part: Part,
        memory: u64,
        is_missing: Box<dyn Fn(f64) -> bool>,
        replace: Option<Replace>,
    ) -> Self {
        let window = (memory / POINT_BYTES).max(BLOCK as u64);
        let (sums, counts) = (vec![], vec![]);
        Self { file, field, part, is_missing, replace, window, next: 0, sums, counts, used: 0 }
    }

    pub(super) fn next_block(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        out.clear();
        if self.used == self.sums.len() {
            let points = self.file.info().points;
            let n = (points - self.next).min(self.window) as usize;
            if n == 0 {
                return Ok(false);
            }
            self.fill_window(n)?;
        }
        let end = self.sums.len().min(self.used + BLOCK);
        let mean = |i: usize| match self.counts[i] {
            0 => f64::NAN,
            count => self.sums[i] / f64::from(count),
        };
        out.extend((self.used..end).map(mean));
        self.used = end;
        Ok(true)
    }

    /// One pass over the cells for the next `n` points.
    fn fill_window(&mut self, n: usize) -> Result<()> {
        let first = self.next;
        self.sums.clear();
        self.sums.resize(n, 0.0);
        self.counts.clear();
        self.counts.resize(n, 0);
        let info = self.file.info();
        let components = info.fields[self.field].components as usize;
        let mut values = Tuples::new(self.file.field(self.field)?, components, self.part, info.cells);
        let (mut cells, mut block) = (CellBlocks::new(&*self.file)?, CellBlock::default());
        let (mut some, mut used, mut points) = (vec![], 0, vec![]);
        while cells.next_block(&mut block)? {
            for (kind, vertices) in block.iter() {
                if used == some.len() {
                    values.next_block(&mut some, |v| v)?;
                    used = 0;
                }
                let value = if (self.is_missing)(some[used]) { f64::NAN } else { some[used] };
                used += 1;
                match kind {
                    CellKind::Flat => continue,
                    CellKind::Polyhedron => distinct(Faces::new(vertices), &mut points),
                    _ => {
                        points.clear();
                        points.extend_from_slice(vertices);
                    }
                }
                if let Some(replace) = &self.replace {
                    replace(&mut points)?;
                }
                self.add(first, value, &points);
            }
        }
        (self.next, self.used) = (first + n as u64, 0);
        Ok(())
    }

    fn add(&mut self, first: u64, value: f64, vertices: &[u64]) {
        for (i, &v) in vertices.iter().enumerate() {
            let at = v.wrapping_sub(first) as usize;
            if at < self.sums.len() && !vertices[..i].contains(&v) {
                self.sums[at] += value;
                self.counts[at] += 1;
            }
        }
    }
}
