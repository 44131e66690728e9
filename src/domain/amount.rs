//! How many points of a set have a value on a mesh: those inside, and those outside that are near
//! the boundary.
//!
//! Of `n` points in the box, those inside are `a·n`, `a` the part of the box that the mesh fills.
//! Samples of the boundary, less the points that they clear away, are about `b·n^(2/3)`. So a count
//! at one `n` gives `b`, and with it the next `n`.

use super::boundary::BoundarySamples;
use super::buckets::BATCH;
use super::store::CellStore;
use isospan_io::error::Result;
use isospan_io::geom::{LatticePos, Site};
use isospan_mesh::locate::{CellBatch, CellHit, PointGrid, fine};
use isospan_mesh::points::PointSet;
use std::sync::Arc;

/// The most points that are counted one by one, in some 40 MB. The same for any memory that a run
/// has: it decides bytes.
pub(crate) const COUNTABLE: u64 = 1 << 18;

/// The number of points of a set, and samples of the boundary, that have a value.
///
/// # Errors
/// When the mesh's files cannot be read.
pub(crate) fn valued(store: &CellStore, points: &PointSet, boundary: &BoundarySamples) -> Result<u64> {
    let mut sites: Vec<Site> = vec![];
    let points = points.clone().with_explicit(Arc::clone(&boundary.points));
    points.sites_in(&points.lattice().domain(), &mut sites);
    let positions: Vec<LatticePos> = sites.iter().map(|s| s.pos).collect();
    drop(sites);
    let grid = PointGrid::new(&positions.iter().map(|&p| fine(p)).collect::<Vec<_>>());
    let mut found = vec![CellHit::default(); positions.len()];
    let (tets, mut batch) = (store.tets.get()?.len() as u64, CellBatch::default());
    for first in (0..tets).step_by(BATCH) {
        store.fill(&mut batch, first..tets.min(first + BATCH as u64))?;
        grid.locate(&batch, &mut found);
    }
    let of_the_set = found.iter().zip(&positions).filter(|(_, pos)| boundary.at(**pos).is_none());
    let inside = of_the_set.filter(|(found, _)| found.id != CellHit::NOWHERE).count();
    Ok(boundary.points.len() + inside as u64)
}

/// The number of points in the box for which `wanted` of them have a value, given that `made` of
/// `n` points have one; `filled` is the part of the box inside.
pub(crate) fn next_amount(wanted: f64, n: f64, made: f64, filled: f64) -> f64 {
    let b = (made - filled * n) / libm::cbrt(n * n);
    let of = |n: f64| filled * n + b * libm::cbrt(n * n);
    // Growing in n from where the second part, if it is negative, no longer outweighs the first.
    let least = -b.min(0.0) / filled;
    let grown = least * least * least;
    let (mut low, mut high) = (grown, grown.max(1.0));
    while of(high) < wanted {
        high *= 2.0;
    }
    // Halves the interval.
    for _ in 0..64 {
        let mid = (low + high) / 2.0;
        if of(mid) < wanted { low = mid } else { high = mid }
    }
    high.max(1.0)
}

/// The next number to try, between one that gave too few points and one that gave too many; each
/// with the points it gave.
pub(crate) fn amount_between(wanted: f64, few: (f64, f64), many: (f64, f64)) -> f64 {
    let part = libm::log(wanted / few.1) / libm::log(many.1 / few.1);
    // Not so near to an end that little is gained.
    few.0 * libm::pow(many.0 / few.0, part.clamp(0.1, 0.9))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_amount_is_that_of_the_model() {
        // More on the boundary than are cleared away, or fewer.
        for b in [7.0, -1.5] {
            let made = |n: f64| 0.25 * n + b * libm::cbrt(n * n);
            for n in [10_000.0, 50_000.0, 2e6] {
                let next = next_amount(made(400_000.0), n, made(n), 0.25);
                assert!((next / 400_000.0 - 1.0).abs() < 1e-9, "{n}: {next}");
            }
        }
        assert_eq!(next_amount(0.0, 8.0, 2.0, 0.25), 1.0);
        let between = amount_between(50.0, (10.0, 20.0), (1000.0, 125.0));
        assert!((between - 100.0).abs() < 1e-9, "{between}");
    }
}
