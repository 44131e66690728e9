//! Samples of the boundary of a mesh, by area.
//!
//! The boundary's triangles are put behind one another along a space-filling curve; sample k sits where the area before it is
//! (k + ½)·h², h the mean distance of the points inside: as dense as those. So each stretch of the boundary has its share, and neighbours on the
//! curve are neighbours in space. Within its triangle (corners a, b, c) the place is
//!
//! ```text
//! (1 - √u)·a + √u·(1 - v)·b + √u·v·c      u: how far into the triangle's area, v = Φ2(k + 1)
//! ```
//!
//! which spreads points evenly over a triangle. Positions are rounded to the lattice. A sample is a point of the mesh even where rounding has
//! pushed it outside: then its value is interpolated in its triangle.
//!
//! Where that would be more samples than the boundary has vertices, the vertices are the samples; of several bodies, as many samples. Triangles in a side of the box have none: points
//! of the set lie there already, as densely. Places of the boundary are looked for among denser samples, which are no points of the archive.
//!
//! # Points outside, near the boundary
//!
//! The samples alone do not make the boundary a part of the tetrahedralization: a tetrahedron with a corner a little outside may
//! reach deep inside, and to leave it out would gnaw at the mesh everywhere. So a point outside that is near the boundary gets the
//! value of the nearest place of the boundary, and counts as a point of that body; of the tetrahedra at such points those are kept whose
//! centroid is in the body. What is left out inside and what is kept outside then balance. Without it up to 14 % of a mesh's volume were missing.
//!
//! # Bodies that touch
//!
//! A point has one value. So where two bodies touch, each sample is two, one a little inside of either: see [`contact`](super::contact).

use super::contact::Contacts;
use super::nearest::nearest;
use super::store::CellStore;
use crate::error::{Error, Result};
use crate::geom::{Lattice, LatticeBox, LatticePos};
use crate::locate::{FINE_BITS, FinePos, fine};
use crate::points::{ExplicitPoints, Levels, PointSet, PointSpec, radical_inverse};
use std::path::Path;
use std::sync::Arc;

/// A place on the boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OnBoundary {
    /// Vertices of its triangle, counter-clockwise seen from outside.
    pub(crate) triangle: [u64; 3],
    /// The body that the triangle bounds.
    pub(crate) body: u64,
    /// Weights of the vertices.
    pub(crate) weights: [f64; 3],
}

/// A sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Sample {
    /// Of the boundary.
    On(OnBoundary),
    /// Inside of a body, beside the boundary of an earlier one.
    Beside,
}

/// All samples, in the order of the list of their positions.
pub(crate) struct BoundarySamples {
    pub(crate) points: Arc<ExplicitPoints>,
    samples: Vec<Sample>,
    /// Samples of all triangles, by which the nearest place of the boundary is found.
    near: Near,
}

/// Finds the nearest place of the boundary.
pub(super) struct Near {
    points: ExplicitPoints,
    samples: Vec<OnBoundary>,
    lattice: Lattice,
    spacing: Spacing,
}

/// Mean distance of the points inside, in lattice steps.
#[derive(Clone, Debug)]
pub(crate) struct Spacing {
    /// Of each level; of one, where there are no levels.
    by_level: Vec<u32>,
    levels: Option<Arc<Levels>>,
    /// Whether the set has points on the sides of the box.
    has_sides: bool,
}

impl Spacing {
    /// That of a set of points: where its density differs from place to place, that of each level.
    ///
    /// # Errors
    /// As [`PointSet::new`].
    pub(crate) fn of(points: PointSpec, lattice: Lattice, levels: Option<Arc<Levels>>) -> Result<Self> {
        let top = levels.as_ref().map_or(0, |levels| levels.top());
        let of = |level: u8| {
            let spec = match points {
                PointSpec::Halton { n } => PointSpec::Halton { n: n << level },
                other => other,
            };
            let spacing = PointSet::new(spec, lattice)?.mean_spacing();
            Ok(spacing.into_iter().max().expect("three axes"))
        };
        let set = PointSet::new(points, lattice)?;
        let has_sides = set.len() > set.interior_len();
        Ok(Self { by_level: (0..=top).map(of).collect::<Result<_>>()?, levels, has_sides })
    }

    /// The mean distance around a position of the domain.
    pub(super) fn at(&self, pos: LatticePos) -> u32 {
        let level = self.levels.as_ref().map_or(0, |levels| levels.at(pos));
        self.by_level[usize::from(level)]
    }

    /// How many times as many samples a place of the boundary has as one of level 0.
    fn denser(&self, pos: LatticePos) -> f64 {
        let ratio = f64::from(self.by_level[0]) / f64::from(self.at(pos));
        ratio * ratio
    }

    /// How many times as far apart as here points may lie in the neighbourhood.
    fn unevenness(&self) -> f64 {
        // Two levels.
        if self.levels.is_some() { 1.6 } else { 1.0 }
    }
}

/// Samples per square of the mean distance by which places of the boundary are found.
const NEAR_DENSITY: f64 = 2.0;
/// Where bodies touch there are so many times as many, a whole number: see [`contact`](super::contact).
pub(super) const DENSER: u64 = 4;
/// A point outside of the mesh is near its boundary within so many mean distances.
const NEAR: f64 = 0.75;
/// The triangle nearest to a point has a sample within so many mean distances of its nearest place, mostly.
const AROUND: f64 = 0.75;

impl BoundarySamples {
    /// Samples the boundary of a mesh whose inside has points at this mean distance.
    ///
    /// # Errors
    /// [`Error::Budget`] when `memory` does not hold them.
    pub(crate) fn new(store: &CellStore, spacing: &Spacing, memory: u64, path: &Path) -> Result<Self> {
        let step = f64::from(spacing.by_level[0]) * f64::from(1u32 << FINE_BITS);
        let (each, near_each) = (step * step, step * step / NEAR_DENSITY);
        let positions = store.positions.get()?;
        let triangles = store.boundary.get()?;
        let surface = Surface { positions, triangles, spacing };
        let everywhere = |_: [FinePos; 3]| true;
        let near_count = surface.area(everywhere) / near_each;
        let several = store.census.bodies > 1;
        // In the list, sorted, and while both are there; of several bodies as pairs too, and while they are located.
        let lists = if several { 8.0 } else { 3.0 };
        let bytes = (near_count * lists * size_of::<(LatticePos, Sample)>() as f64) as u64;
        if bytes > memory || near_count > ExplicitPoints::MOST as f64 {
            let what = format!("memory for {near_count:.0} samples of the boundary of {}", path.display());
            return Err(Error::Budget { what, needed: bytes, available: memory });
        }
        let lattice = store.frame.lattice;
        let near = Near::new(
            lattice,
            spacing.clone(),
            surface.sampled(near_each, everywhere, |k| radical_inverse(2, k + 1).to_f64()),
        );
        let most = fine(lattice.max());
        let in_side = |p: [FinePos; 3]| {
            (0..3).any(|a| p.iter().all(|p| p[a] == 0) || p.iter().all(|p| p[a] == most[a]))
        };
        let is_sampled = |p: [FinePos; 3]| !(spacing.has_sides && in_side(p));
        let (vertices, sampled_area) = (surface.vertices(is_sampled), surface.area(is_sampled));
        // Not more than the boundary's own vertices, but where bodies touch: there samples are denser, and of those elsewhere only some stay.
        let (samples, every) = if several {
            let each = each.max(sampled_area / vertices.len().max(1) as f64);
            (surface.sampled(each / DENSER as f64, is_sampled, turned), DENSER as usize)
        } else if sampled_area / each > vertices.len() as f64 {
            (vertices, 1)
        } else {
            (surface.sampled(each, is_sampled, |k| radical_inverse(2, k + 1).to_f64()), 1)
        };
        let samples = if several {
            Contacts { near: &near, store, lattice, spacing }.split(&samples, every)?
        } else {
            samples.into_iter().map(|(p, s)| (p, Sample::On(s))).collect()
        };
        let (points, samples) = sorted(lattice, &samples);
        Ok(Self { points: Arc::new(points), samples, near })
    }

    /// The sample at a position.
    pub(crate) fn at(&self, pos: LatticePos) -> Option<&Sample> {
        self.points.find(pos).map(|i| &self.samples[i])
    }

    /// How many samples places of the boundary are found by.
    pub(crate) fn held(&self) -> u64 {
        self.points.len() + self.near.points.len()
    }

    /// The place of the boundary that is nearest to a position, if it is near: within [`NEAR`] of the mean distance.
    pub(crate) fn near(&self, store: &CellStore, pos: LatticePos) -> Result<Option<OnBoundary>> {
        self.near.nearest_of(store, pos, NEAR, |_, _| true)
    }
}

/// Positions in canonical order, each once, with the first sample of each.
fn sorted<T: Copy>(lattice: Lattice, samples: &[(LatticePos, T)]) -> (ExplicitPoints, Vec<T>) {
    let points = ExplicitPoints::new(&lattice, samples.iter().map(|s| s.0).collect());
    let mut first = vec![u32::MAX; points.positions().len()];
    for (i, sample) in samples.iter().enumerate() {
        let at = &mut first[points.find(sample.0).expect("the list has each position")];
        *at = (*at).min(i as u32);
    }
    let samples = first.iter().map(|&i| samples[i as usize].1).collect();
    (points, samples)
}

/// The triangles of a boundary.
struct Surface<'a> {
    positions: &'a [FinePos],
    triangles: &'a [[u64; 4]],
    spacing: &'a Spacing,
}

impl Surface<'_> {
    /// Those that are accepted, with their corners and their shares: where points are denser than at level 0, as if the triangle were larger.
    fn each(
        &self,
        accept: impl Fn([FinePos; 3]) -> bool,
    ) -> impl Iterator<Item = ([u64; 4], [FinePos; 3], f64)> {
        let corners = |&[a, b, c, _]: &[u64; 4]| [a, b, c].map(|v| self.positions[v as usize]);
        let share = |p: [FinePos; 3]| area(p) * self.spacing.denser(rounded(mean(p, [1.0 / 3.0; 3])));
        let with_corners = self.triangles.iter().map(move |t| (*t, corners(t)));
        with_corners.filter(move |&(_, p)| accept(p)).map(move |(t, p)| (t, p, share(p)))
    }

    fn area(&self, accept: impl Fn([FinePos; 3]) -> bool) -> f64 {
        self.each(accept).map(|(_, _, share)| share).sum()
    }

    /// A sample for so much area each, at the place across its triangle that its number has.
    fn sampled(
        &self,
        each: f64,
        accept: impl Fn([FinePos; 3]) -> bool,
        across: impl Fn(u64) -> f64,
    ) -> Vec<(LatticePos, OnBoundary)> {
        let (mut samples, mut before, mut k) = (vec![], 0.0, 0u64);
        for ([a, b, c, body], p, area) in self.each(accept) {
            while (k as f64 + 0.5) * each < before + area {
                let u = (((k as f64 + 0.5) * each - before) / area).clamp(0.0, 1.0).sqrt();
                let v = across(k);
                let weights = [1.0 - u, u * (1.0 - v), u * v];
                samples.push((rounded(mean(p, weights)), OnBoundary { triangle: [a, b, c], body, weights }));
                k += 1;
            }
            before += area;
        }
        samples
    }

    /// A sample for each vertex of a body, in its first triangle.
    fn vertices(&self, accept: impl Fn([FinePos; 3]) -> bool) -> Vec<(LatticePos, OnBoundary)> {
        let (mut seen, mut samples) = (std::collections::HashSet::new(), vec![]);
        for ([a, b, c, body], p, _) in self.each(accept) {
            for (k, vertex) in [a, b, c].into_iter().enumerate() {
                if seen.insert((vertex, body)) {
                    let weights = std::array::from_fn(|i| f64::from(u8::from(i == k)));
                    samples.push((rounded(p[k]), OnBoundary { triangle: [a, b, c], body, weights }));
                }
            }
        }
        samples
    }
}

impl Near {
    fn new(lattice: Lattice, spacing: Spacing, samples: Vec<(LatticePos, OnBoundary)>) -> Self {
        let (points, samples) = sorted(lattice, &samples);
        Self { points, samples, lattice, spacing }
    }

    /// The place of some triangles (three positions) of bodies that is nearest to a position, within so many mean distances. Only
    /// triangles with a sample in the neighbourhood are looked at.
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

/// Radical inverses for one of [`DENSER`] samples, and parts of a turn from them for the others: each part is spread evenly.
fn turned(k: u64) -> f64 {
    (radical_inverse(2, k / DENSER + 1).to_f64() + (k % DENSER) as f64 / DENSER as f64) % 1.0
}

/// `a - b`, exactly.
pub(super) fn difference(a: FinePos, b: FinePos) -> [f64; 3] {
    std::array::from_fn(|k| (a[k] - b[k]) as f64)
}

pub(super) fn cross(u: [f64; 3], v: [f64; 3]) -> [f64; 3] {
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

pub(super) fn dot(u: [f64; 3], v: [f64; 3]) -> f64 {
    u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
}

fn area([a, b, c]: [FinePos; 3]) -> f64 {
    let n = cross(difference(b, a), difference(c, a));
    dot(n, n).sqrt() / 2.0
}

/// A weighted mean; it lies in the box as the corners do.
pub(super) fn mean(corners: [FinePos; 3], weights: [f64; 3]) -> FinePos {
    let [a, b, c] = corners;
    let (ab, ac) = (difference(b, a), difference(c, a));
    std::array::from_fn(|k| {
        let fine = a[k] as f64 + weights[1] * ab[k] + weights[2] * ac[k];
        let (lo, hi) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
        (fine.round() as i64).clamp(lo, hi)
    })
}

/// The nearest lattice position.
pub(crate) fn rounded(p: FinePos) -> LatticePos {
    p.map(|c| ((c + (1 << (FINE_BITS - 1))) >> FINE_BITS) as u32)
}
