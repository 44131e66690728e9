//! The triangles of a boundary, and places on them.

use super::spacing::Spacing;
use isospan_io::geom::LatticePos;
use isospan_io::geom::vec3::{cross, difference, dot};
use isospan_mesh::locate::{FinePos, rounded};
use isospan_mesh::points::radical_inverse;

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

    pub(super) fn area(&self) -> f64 {
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
    pub(super) fn sampled(&self, each: f64) -> Vec<(LatticePos, OnBoundary)> {
        let mut samples = vec![];
        self.each_place(each, |p, place, _| samples.push((rounded(p), place)));
        samples
    }
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
