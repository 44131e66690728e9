//! Samples of the boundary of a mesh, and what they clear around them.
//!
//! Samples keep their distance from each other, corners and edges first
//! ([`scatter`](super::scatter)), about as far apart as points inside. Positions are rounded to the
//! lattice. A sample is a point of the mesh even where rounding has pushed it outside: then its
//! value is interpolated in its triangle.
//!
//! # The boundary becomes faces
//!
//! Samples alone do not make the boundary a part of the tetrahedralization. A point outside that is
//! nearer to the wall than samples are to each other has tetrahedra that reach deep inside. If
//! these are kept, the wall sticks out; if they are left out, it has dents. So no point of the set
//! lies near a sample, on either side: within [`CLEAR`] mean distances. That is √2 times the radius
//! of the circles between samples and more, as spheres reach further out where a body is thin.
//!
//! ```text
//!      p                A sphere through three samples whose circle has the radius r reaches a
//!    ·╱ ╲·    a         above the wall and b below, a·b = r². Let p above and q below be at least
//!  ──s───s──            √2·r from each sample: then both are at least r from the wall near the
//!    ·╲ ╱·    b         circle's middle, and no sphere through s and p holds q. So the triangle is
//!      q                a face of the Delaunay tetrahedralization: a flat wall is made of faces.
//! ```
//!
//! Then each tetrahedron lies on one side, and its centroid shows which. Four samples of a flat
//! wall form a tetrahedron whose only thickness comes from rounding; it is left out.
//!
//! # Bodies that touch
//!
//! A point has one value. So where two bodies touch, each sample becomes two, one a little inside
//! of each body: see [`contact`](super::contact).

use super::contact::Contacts;
use super::nearest::nearest;
use super::scatter::scattered;
use super::store::CellStore;
use isospan_io::error::{Error, Result};
use isospan_io::geom::vec3::{cross, dot};
use isospan_io::geom::{Lattice, LatticeBox, LatticePos};
use isospan_mesh::locate::{FINE_BITS, FinePos, fine};
use isospan_mesh::points::{ExplicitPoints, Levels, PointSet, PointSpec, radical_inverse};
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
    /// On the boundary.
    On(OnBoundary),
    /// Inside of a body, next to the boundary of an earlier one.
    Beside,
}

/// All samples, in the order of the list of their positions.
pub(crate) struct BoundarySamples {
    pub(crate) points: Arc<ExplicitPoints>,
    samples: Vec<Sample>,
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
    /// For each level; for one, if there are no levels.
    pub(super) by_level: Vec<u32>,
    levels: Option<Arc<Levels>>,
}

impl Spacing {
    /// The spacing of a set of points, or of each level where its density differs from place to
    /// place.
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
        Ok(Self { by_level: (0..=top).map(of).collect::<Result<_>>()?, levels })
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
/// The triangle nearest to a point has a sample within this many mean distances of its nearest
/// place, mostly.
const AROUND: f64 = 0.75;
/// No point that follows a formula lies within this many mean distances of a sample.
const CLEAR: f64 = 1.2;

impl BoundarySamples {
    /// Samples the boundary of a mesh whose inside has points at this mean distance.
    ///
    /// # Errors
    /// [`Error::Budget`] when `memory` does not hold them.
    pub(crate) fn new(store: &CellStore, spacing: &Spacing, memory: u64, path: &Path) -> Result<Self> {
        let step = f64::from(spacing.by_level[0]) * f64::from(1u32 << FINE_BITS);
        let near_each = step * step / NEAR_DENSITY;
        let (positions, triangles) = (store.positions.get()?, store.boundary.get()?);
        let surface = Surface { positions, triangles, spacing };
        let count = surface.area() / near_each;
        // The list, its neighbourhoods, sorted; of several bodies pairs, places by which neighbours
        // are found, and while they are located.
        let lists = if store.census.bodies > 1 { 8.0 } else { 4.0 };
        let bytes = (count * lists * size_of::<(LatticePos, Sample)>() as f64) as u64;
        if bytes > memory || count > ExplicitPoints::MOST as f64 {
            let purpose = format!("for {count:.0} samples of the boundary of {}", path.display());
            return Err(Error::memory(purpose, bytes, memory));
        }
        let lattice = store.frame.lattice;
        let samples = scattered(store, &surface)?;
        let samples: Vec<(LatticePos, Sample)> = if store.census.bodies > 1 {
            let near = Near::new(lattice, spacing.clone(), surface.sampled(near_each));
            Contacts { near: &near, store, lattice, spacing }.split(&samples)?
        } else {
            samples.into_iter().map(|(p, s)| (p, Sample::On(s))).collect()
        };
        let (points, samples) = sorted(lattice, &samples);
        let clear = (CLEAR * f64::from(spacing.by_level[0])).round() as u32;
        Ok(Self { points: Arc::new(points.clearing(clear)), samples })
    }

    /// The sample at a position.
    pub(crate) fn at(&self, pos: LatticePos) -> Option<&Sample> {
        self.points.find(pos).map(|i| &self.samples[i])
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
pub(super) struct Surface<'a> {
    pub(super) positions: &'a [FinePos],
    pub(super) triangles: &'a [[u64; 4]],
    pub(super) spacing: &'a Spacing,
}

impl Surface<'_> {
    pub(super) fn corners(&self, [a, b, c, _]: [u64; 4]) -> [FinePos; 3] {
        [a, b, c].map(|v| self.positions[v as usize])
    }

    /// A triangle's share of the samples: where points are denser than at level 0, as if it were
    /// larger.
    fn share(&self, corners: [FinePos; 3]) -> f64 {
        area(corners) * self.spacing.denser(rounded(mean(corners, [1.0 / 3.0; 3])))
    }

    fn area(&self) -> f64 {
        self.triangles.iter().map(|&t| self.share(self.corners(t))).sum()
    }

    /// Calls `visit` with a place for so much area each, and the corners of its triangle.
    pub(super) fn each_place(&self, each: f64, mut visit: impl FnMut(FinePos, OnBoundary, [FinePos; 3])) {
        let (mut before, mut k) = (0.0, 0u64);
        for &[a, b, c, body] in self.triangles {
            let p = self.corners([a, b, c, body]);
            let area = self.share(p);
            while (k as f64 + 0.5) * each < before + area {
                let u = (((k as f64 + 0.5) * each - before) / area).clamp(0.0, 1.0).sqrt();
                let v = radical_inverse(2, k + 1).to_f64();
                let weights = [1.0 - u, u * (1.0 - v), u * v];
                visit(mean(p, weights), OnBoundary { triangle: [a, b, c], body, weights }, p);
                k += 1;
            }
            before += area;
        }
    }

    /// A place for so much area each.
    fn sampled(&self, each: f64) -> Vec<(LatticePos, OnBoundary)> {
        let mut samples = vec![];
        self.each_place(each, |p, place, _| samples.push((rounded(p), place)));
        samples
    }
}

impl Near {
    fn new(lattice: Lattice, spacing: Spacing, samples: Vec<(LatticePos, OnBoundary)>) -> Self {
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

/// `a - b`, exactly.
pub(super) fn difference(a: FinePos, b: FinePos) -> [f64; 3] {
    std::array::from_fn(|k| (a[k] - b[k]) as f64)
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
