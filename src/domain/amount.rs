//! How many points of a set have a value on a mesh: those inside, and those outside that are near the boundary.
//!
//! Of `n` points in the box, those inside are `a·n`, `a` the part of the box that the mesh fills. Samples of the boundary, points near it, and those on
//! the sides of the box are about `b·n^(2/3)`. So a count at one `n` tells `b`, and with it the next `n`.

use super::boundary::BoundarySamples;
use super::buckets::BATCH;
use super::store::CellStore;
use crate::error::Result;
use crate::geom::{LatticePos, Site};
use crate::locate::{CellBatch, Found, PointGrid, fine};
use crate::points::PointSet;

/// The most points that are counted one by one, in some 10 MB. The same for any memory that a run has: it decides bytes.
pub(crate) const COUNTABLE: u64 = 1 << 16;

/// The number of points of a set, and samples of the boundary, that have a value. The set has no listed points.
///
/// # Errors
/// When the mesh's files cannot be read.
pub(crate) fn valued(store: &CellStore, points: &PointSet, boundary: &BoundarySamples) -> Result<u64> {
    let mut sites: Vec<Site> = vec![];
    points.sites_in(&points.lattice().domain(), &mut sites);
    let positions: Vec<LatticePos> = sites.iter().map(|s| s.pos).collect();
    drop(sites);
    let grid = PointGrid::new(&positions.iter().map(|&p| fine(p)).collect::<Vec<_>>());
    let mut found = vec![Found::default(); positions.len()];
    let (tets, mut batch) = (store.tets.get()?.len() as u64, CellBatch::default());
    for first in (0..tets).step_by(BATCH) {
        store.fill(&mut batch, first..tets.min(first + BATCH as u64))?;
        grid.locate(&batch, &mut found);
    }
    let mut count = boundary.points.len();
    for (found, &pos) in found.iter().zip(&positions) {
        let is_listed = boundary.at(pos).is_some();
        if !is_listed && (found.id != Found::NOWHERE || boundary.near(store, pos)?.is_some()) {
            count += 1;
        }
    }
    Ok(count)
}

/// The number of points in the box of which `wanted` have a value, when of `n` points `made` have; `filled` is the part of the box inside.
pub(crate) fn next_amount(wanted: f64, n: f64, made: f64, filled: f64) -> f64 {
    let b = ((made - filled * n) / libm::cbrt(n * n)).max(0.0);
    // Growing in n: halves the interval.
    let (mut low, mut high) = (0.0, wanted / filled + 1.0);
    for _ in 0..64 {
        let mid = (low + high) / 2.0;
        if filled * mid + b * libm::cbrt(mid * mid) < wanted { low = mid } else { high = mid }
    }
    high.max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_amount_is_that_of_the_model() {
        let made = |n: f64| 0.25 * n + 7.0 * libm::cbrt(n * n);
        for n in [100.0, 5_000.0, 2e6] {
            let next = next_amount(made(40_000.0), n, made(n), 0.25);
            assert!((next / 40_000.0 - 1.0).abs() < 1e-9, "{n}: {next}");
        }
        assert_eq!(next_amount(0.0, 8.0, 2.0, 0.25), 1.0);
    }
}
