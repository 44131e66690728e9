//! The nearest place of a boundary, found by places that are spread over it.

use super::nearest::nearest;
use super::spacing::Spacing;
use super::store::CellStore;
use super::wall::OnBoundary;
use isospan_io::error::Result;
use isospan_io::geom::{Lattice, LatticeBox, LatticePos};
use isospan_mesh::locate::{FINE_BITS, FinePos, fine};
use isospan_mesh::points::ExplicitPoints;

/// The triangle nearest to a point has a sample within this many mean distances of its nearest
/// place, mostly.
const AROUND: f64 = 0.75;

/// Finds the nearest place of the boundary.
pub(super) struct Near {
    points: ExplicitPoints,
    samples: Vec<OnBoundary>,
    lattice: Lattice,
    spacing: Spacing,
}

impl Near {
    pub(super) fn new(lattice: Lattice, spacing: Spacing, samples: Vec<(LatticePos, OnBoundary)>) -> Self {
        let (points, samples) = sorted(lattice, &samples);
        Self { points, samples, lattice, spacing }
    }

    /// The place on some triangles (three positions) of bodies that is nearest to a position,
    /// within the given number of mean distances. Only triangles with a sample in the neighbourhood
    /// are examined.
    pub(super) fn nearest_of(
        &self,
        store: &CellStore,
        pos: LatticePos,
        within: f64,
        accept: impl Fn(u64, [FinePos; 3]) -> bool,
    ) -> Result<Option<OnBoundary>> {
        let spacing = f64::from(self.spacing.at(pos));
        let around = LatticeBox { lo: pos, hi: pos.map(|c| c + 1) }.grow_within(
            [((within + AROUND * self.spacing.unevenness()) * spacing) as u32; 3],
            &self.lattice.domain(),
        );
        let mut triangles = vec![];
        self.points.each_in(&around, |i| {
            triangles.push((self.samples[i].body, self.samples[i].triangle));
        });
        triangles.sort_unstable();
        triangles.dedup();
        let positions = store.positions.get()?;
        let reach = within * spacing * f64::from(1u32 << FINE_BITS);
        let mut best: Option<(f64, OnBoundary)> = None;
        for (body, triangle) in triangles {
            let corners = triangle.map(|v| positions[v as usize]);
            if !accept(body, corners) {
                continue;
            }
            let (weights, distance2) = nearest(corners, fine(pos));
            if distance2 <= reach * reach && best.is_none_or(|(least, _)| distance2 < least) {
                best = Some((distance2, OnBoundary { triangle, body, weights }));
            }
        }
        Ok(best.map(|(_, place)| place))
    }
}

/// Positions in canonical order, each once, with the first sample of each.
pub(super) fn sorted<T: Copy>(lattice: Lattice, samples: &[(LatticePos, T)]) -> (ExplicitPoints, Vec<T>) {
    let points = ExplicitPoints::new(&lattice, samples.iter().map(|s| s.0).collect());
    let mut first = vec![u32::MAX; points.positions().len()];
    for (i, sample) in samples.iter().enumerate() {
        let at = &mut first[points.find(sample.0).expect("the list has each position")];
        *at = (*at).min(i as u32);
    }
    let samples = first.iter().map(|&i| samples[i as usize].1).collect();
    (points, samples)
}
