//! Which corners can later chunks still use? An edge that none of them can have is finalized.
//!
//! A chunk meshes the points of its region (core and halo), so all corners of its tetrahedra lie in
//! there. An edge can occur in a later chunk only if both its ends lie in that chunk's region.
//! Chunks come row by row, layer by layer:
//!
//! ```text
//!   z ▲  │ · · · · │        regions of rows to come (halo included)
//!     │  ├─────────┤ ◀──    the chunk just welded
//!     │  │/////////│        below all of these: final
//! ```
//!
//! The regions of a row are replaced by their hull. That can only keep an edge open longer than
//! needed.

use super::step_view::StepView;
use crate::pipeline::plan::estimate;
use isospan_io::error::Result;
use isospan_io::geom::{LatticeBox, LatticePos};
use isospan_io::grid::ChunkId;

/// The rows of chunks of a query.
pub(in crate::pipeline) struct Frontier {
    rows: Vec<Row>,
}

struct Row {
    /// Chunks of the query up to the end of this row.
    end: usize,
    hull: LatticeBox,
    /// Lowest z of this row and all later ones.
    lowest: u32,
}

impl Frontier {
    /// The frontier of chunks in ascending order. Reads the summary of each, because a halo that
    /// was widened is wider here too.
    pub(in crate::pipeline) fn new(
        archive: &StepView,
        chunks: impl Iterator<Item = ChunkId>,
    ) -> Result<Self> {
        let domain = archive.chunks.bricks().lattice.domain();
        let halo = estimate::Halo::of(&archive.manifest.plan);
        let mut regions = vec![];
        for id in chunks {
            archive.close_before(id);
            let retries = archive.mesh_sizes(id)?.retries;
            let chunk = archive.chunks.chunk(id);
            let region = estimate::region(&archive.points, &chunk.core, &domain, halo, retries);
            regions.push(([chunk.brick_lo[1], chunk.brick_lo[2]], region));
        }
        Ok(Self::of_regions(&regions))
    }

    /// The frontier of regions, given with the place of their row.
    pub(in crate::pipeline) fn of_regions(regions: &[([u64; 2], LatticeBox)]) -> Self {
        let mut rows: Vec<Row> = vec![];
        let mut end = 0;
        for row in regions.chunk_by(|a, b| a.0 == b.0) {
            end += row.len();
            let hull = row.iter().map(|r| r.1).reduce(|a, b| hull(&a, &b)).expect("a run is not empty");
            rows.push(Row { end, hull, lowest: hull.lo[2] });
        }
        for i in (1..rows.len()).rev() {
            rows[i - 1].lowest = rows[i - 1].lowest.min(rows[i].lowest);
        }
        Self { rows }
    }

    /// The regions whose corners may still be used when the first `done` chunks are welded.
    pub(in crate::pipeline) fn after(&self, done: usize) -> Beyond<'_> {
        Beyond { rows: &self.rows[self.rows.partition_point(|r| r.end <= done)..] }
    }
}

fn hull(a: &LatticeBox, b: &LatticeBox) -> LatticeBox {
    LatticeBox {
        lo: std::array::from_fn(|k| a.lo[k].min(b.lo[k])),
        hi: std::array::from_fn(|k| a.hi[k].max(b.hi[k])),
    }
}

/// The rows that are not done.
pub(in crate::pipeline) struct Beyond<'a> {
    rows: &'a [Row],
}

impl Beyond<'_> {
    /// Whether a chunk to come can have the edge.
    pub(in crate::pipeline) fn can_have(&self, a: LatticePos, b: LatticePos) -> bool {
        let highest_end = a[2].min(b[2]);
        self.rows
            .iter()
            .take_while(|row| row.lowest <= highest_end)
            .any(|row| row.hull.contains(a) && row.hull.contains(b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_stays_open_while_a_region_to_come_holds_both_ends() {
        // 3 x 3 x 3 chunks of edge 10 with a halo of 2; the last row reaches far down.
        let at = |n: u32| (n % 3, n / 3 % 3, n / 9);
        let regions: Vec<_> = (0..27)
            .map(|n| {
                let (x, y, z) = at(n);
                let down = if n >= 24 { 7 } else { 2 };
                let lo = [x, y, z].map(|c| c * 10);
                let region = LatticeBox {
                    lo: [lo[0].saturating_sub(2), lo[1].saturating_sub(2), lo[2].saturating_sub(down)],
                    hi: lo.map(|c| c + 12),
                };
                ([u64::from(y), u64::from(z)], region)
            })
            .collect();
        let frontier = Frontier::of_regions(&regions);
        let (mut kept, mut closed) = (0, 0);
        for done in 0..=27 {
            let beyond = frontier.after(done);
            for n in 0..2000u32 {
                let a = [n * 7 % 32, n * 11 % 32, n * 13 % 32];
                let b = [(a[0] + n % 3).min(31), (a[1] + n % 2).min(31), (a[2] + n % 4).min(31)];
                let needed = regions[done..].iter().any(|(_, r)| r.contains(a) && r.contains(b));
                assert!(!needed || beyond.can_have(a, b), "{a:?} {b:?} after {done}");
                kept += u32::from(beyond.can_have(a, b) && !needed);
                closed += u32::from(!beyond.can_have(a, b));
            }
        }
        assert!(kept < closed && closed > 10_000, "{kept} kept in vain, {closed} closed");
    }
}
