//! Where two bodies touch: samples of their boundaries, on both sides.
//!
//! A point of the reduction has one value, and a tetrahedron with corners in two bodies is left
//! out. Were the face at which bodies touch sampled like a free one, its samples would belong to
//! one body, and the other one would end at its last points inside. Were it sampled for each body
//! by itself, the samples of one would lie in the spheres of the other's tetrahedra, and many of
//! those would be lost. So samples there come **in pairs**, one over the other:
//!
//! ```text
//!            A        ╲ │ ╱           A sphere through three samples of A that is centred in A, or not too far beyond, holds
//!    ·───────·───────·───────·        no partner of theirs: the partners lie outside of the circle in which the sphere
//!    ·───────·───────·───────·        meets their sheet. What is left out is thin, but where a point inside is closer
//!            B        ╱ │ ╲           to the sheet than the samples to each other: so those are denser here.
//! ```
//!
//! # How does it work?
//!
//! Bodies need not share faces, and surfaces that are meant to be one differ by roundings, or as a
//! fine and a coarse approximation do. So for each sample the nearest place is looked for on
//! triangles of other bodies that **face** it (with normals on opposite sides), within half a mean
//! distance. If its body is a later one, the sample becomes a pair. The sample stays, a little
//! inside of its body. The place found, a little inside of the other body, is its partner. Where
//! the bodies overlap, the first of them keeps its boundary, and the partner lies just beyond. If
//! the body is an earlier one, the sample is dropped: the samples of that body bring partners.
//!
//! Where bodies overlap deeper, the first one ends at its boundary within the later one. For
//! samples without such a place, the question is which body has the point just beyond (all cells
//! stream past once, [`PointGrid`]). If it is a later one, it gets a partner there; if it is an
//! earlier one, the sample is dropped.

use super::buckets::BATCH;
use super::near::Near;
use super::spacing::Spacing;
use super::store::CellStore;
use super::wall::{OnBoundary, Sample, mean};
use isospan_io::error::Result;
use isospan_io::geom::vec3::{cross, difference, dot};
use isospan_io::geom::{Lattice, LatticePos};
use isospan_mesh::locate::{CellBatch, CellHit, FINE_BITS, FinePos, PointGrid, fine, rounded};

/// Boundaries touch within this many mean distances.
const TOUCH: f64 = 0.5;
/// How far a sample is moved into its body: this part of the mean distance, and at least this many
/// lattice steps, more than rounding moves it.
const INTO: (f64, f64) = (1.0 / 128.0, 4.0);

/// The boundary of several bodies.
pub(super) struct Contacts<'a> {
    /// Finds places near others.
    pub(super) near: &'a Near,
    pub(super) store: &'a CellStore,
    pub(super) lattice: Lattice,
    /// Mean distance of the points inside.
    pub(super) spacing: &'a Spacing,
}

/// A sample, as a place and a direction.
struct DirectedSample {
    sample: OnBoundary,
    at: FinePos,
    /// Out of the body.
    normal: [f64; 3],
}

impl Contacts<'_> {
    /// Makes pairs of samples at places where bodies touch or overlap; the others stay.
    pub(super) fn split(&self, samples: &[(LatticePos, OnBoundary)]) -> Result<Vec<(LatticePos, Sample)>> {
        let (mut split, mut alone, mut beyond) = (vec![], vec![], vec![]);
        for &(pos, sample) in samples {
            let placed = self.placed(sample)?;
            match self.facing(pos, &placed)? {
                Some(other) if other.body < sample.body => {}
                Some(other) => split.extend(self.pair(&placed, &self.placed(other)?)),
                None => {
                    beyond.push(fine(self.moved(&placed, 1.0)));
                    alone.push((pos, placed));
                }
            }
        }
        for ((pos, placed), found) in alone.iter().zip(self.locate(&beyond)?) {
            let body =
                if found.id == CellHit::NOWHERE { None } else { Some(self.store.bodies.of(found.id)?) };
            match body {
                Some(body) if body < placed.sample.body => {}
                Some(body) if body > placed.sample.body => {
                    split.push((self.moved(placed, -1.0), Sample::On(placed.sample)));
                    split.push((self.moved(placed, 1.0), Sample::Beside));
                }
                Some(_) => {}
                None => split.push((*pos, Sample::On(placed.sample))),
            }
        }
        Ok(split)
    }

    fn placed(&self, sample: OnBoundary) -> Result<DirectedSample> {
        let positions = self.store.positions.get()?;
        let corners = sample.triangle.map(|v| positions[v as usize]);
        Ok(DirectedSample { sample, at: mean(corners, sample.weights), normal: normal(corners) })
    }

    /// The nearest place of the boundary of another body that faces a sample.
    fn facing(&self, pos: LatticePos, of: &DirectedSample) -> Result<Option<OnBoundary>> {
        self.near.nearest_of(self.store, pos, TOUCH, |body, corners| {
            body != of.sample.body && dot(normal(corners), of.normal) < 0.0
        })
    }

    /// Two places that touch, each moved into its body; the second one beyond the first one at
    /// least.
    fn pair(&self, first: &DirectedSample, second: &DirectedSample) -> [(LatticePos, Sample); 2] {
        let overlap = dot(difference(second.at, first.at), first.normal) < 0.0;
        let partner = if overlap { self.moved(first, 1.0) } else { self.moved(second, -1.0) };
        [(self.moved(first, -1.0), Sample::On(first.sample)), (partner, Sample::On(second.sample))]
    }

    /// A place moved by `times` times [`INTO`] out of its body, within the box.
    fn moved(&self, from: &DirectedSample, times: f64) -> LatticePos {
        let steps = (INTO.0 * f64::from(self.spacing.at(rounded(from.at)))).max(INTO.1);
        let n = from.normal;
        let scale = times * steps * f64::from(1u32 << FINE_BITS) / dot(n, n).sqrt();
        let most = fine(self.lattice.max());
        rounded(std::array::from_fn(|k| (from.at[k] + (n[k] * scale) as i64).clamp(0, most[k])))
    }

    /// The cells of the lowest numbers that hold points, which may lie anywhere.
    fn locate(&self, points: &[FinePos]) -> Result<Vec<CellHit>> {
        let (grid, mut found) = (PointGrid::new(points), vec![CellHit::default(); points.len()]);
        let (tets, mut batch) = (self.store.tets.get()?.len() as u64, CellBatch::default());
        for first in (0..tets).step_by(BATCH) {
            self.store.fill(&mut batch, first..tets.min(first + BATCH as u64))?;
            grid.locate(&batch, &mut found);
        }
        Ok(found)
    }
}

/// A normal of a triangle that is counter-clockwise seen from outside: outwards, twice the area
/// long.
fn normal([a, b, c]: [FinePos; 3]) -> [f64; 3] {
    cross(difference(b, a), difference(c, a))
}
