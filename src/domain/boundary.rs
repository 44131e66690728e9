//! Samples of the boundary of a mesh, by area.
//!
//! The boundary's triangles are put behind one another along a space-filling curve; sample k sits where the area before it is
//! (k + ½)·h², h the mean distance of the points inside. So each stretch of the boundary has its share, and neighbours on the curve are neighbours in
//! space. Within its triangle (corners a, b, c) the place is
//!
//! ```text
//! (1 - √u)·a + √u·(1 - v)·b + √u·v·c      u: how far into the triangle's area, v = Φ2(k + 1)
//! ```
//!
//! which spreads points evenly over a triangle. Positions are rounded to the lattice. A sample is a point of the mesh even where rounding has
//! pushed it outside: then its value is interpolated in its triangle.

use super::store::CellStore;
use crate::error::{Error, Result};
use crate::geom::LatticePos;
use crate::locate::{FINE_BITS, FinePos};
use crate::points::{ExplicitPoints, radical_inverse};
use std::path::Path;

/// A sample of the boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BoundarySample {
    pub(crate) pos: LatticePos,
    /// Vertices of its triangle.
    pub(crate) triangle: [u64; 3],
    /// The body that the triangle bounds.
    pub(crate) body: u64,
    /// Their weights.
    pub(crate) weights: [f64; 3],
}

/// All samples, in the order of the list of their positions.
pub(crate) struct BoundarySamples {
    pub(crate) points: std::sync::Arc<ExplicitPoints>,
    samples: Vec<BoundarySample>,
}

/// Samples per square of the mean distance.
const DENSITY: f64 = 4.0;

impl BoundarySamples {
    /// Samples the boundary of a mesh whose inside has points at a mean distance of `spacing` lattice steps.
    ///
    /// # Errors
    /// [`Error::Budget`] when `memory` does not hold them.
    pub(crate) fn new(store: &CellStore, spacing: u32, memory: u64, path: &Path) -> Result<Self> {
        let step = f64::from(spacing) * f64::from(1u32 << FINE_BITS);
        let each = step * step / DENSITY;
        let positions = store.positions.get()?;
        let triangles = store.boundary.get()?;
        let corners = |&[a, b, c, _]: &[u64; 4]| [a, b, c].map(|v| positions[v as usize]);
        let total: f64 = triangles.iter().map(|t| area(corners(t))).sum();
        let count = total / each;
        // In the list, sorted, and while both are there.
        let bytes = (count * (3 * size_of::<BoundarySample>()) as f64) as u64;
        if bytes > memory || count > ExplicitPoints::MOST as f64 {
            let what = format!("memory for {count:.0} samples of the boundary of {}", path.display());
            return Err(Error::Budget { what, needed: bytes, available: memory });
        }
        let (mut samples, mut before, mut k) = (vec![], 0.0, 0u64);
        for triangle in triangles {
            let p = corners(triangle);
            let area = area(p);
            while (k as f64 + 0.5) * each < before + area {
                let u = (((k as f64 + 0.5) * each - before) / area).clamp(0.0, 1.0).sqrt();
                let v = radical_inverse(2, k + 1).to_f64();
                let weights = [1.0 - u, u * (1.0 - v), u * v];
                let [a, b, c, body] = *triangle;
                samples.push(BoundarySample { pos: place(p, weights), triangle: [a, b, c], body, weights });
                k += 1;
            }
            before += area;
        }
        Ok(Self::sorted(store, samples))
    }

    fn sorted(store: &CellStore, samples: Vec<BoundarySample>) -> Self {
        let points = ExplicitPoints::new(&store.frame.lattice, samples.iter().map(|s| s.pos).collect());
        let mut first = vec![u32::MAX; points.positions().len()];
        for (i, sample) in samples.iter().enumerate() {
            let at = &mut first[points.find(sample.pos).expect("the list has each position")];
            *at = (*at).min(i as u32);
        }
        let samples = first.iter().map(|&i| samples[i as usize]).collect();
        Self { points: std::sync::Arc::new(points), samples }
    }

    /// The sample at a position.
    pub(crate) fn at(&self, pos: LatticePos) -> Option<&BoundarySample> {
        self.points.find(pos).map(|i| &self.samples[i])
    }
}

fn difference(a: FinePos, b: FinePos) -> [f64; 3] {
    std::array::from_fn(|k| (a[k] - b[k]) as f64)
}

fn area([a, b, c]: [FinePos; 3]) -> f64 {
    let (u, v) = (difference(b, a), difference(c, a));
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt() / 2.0
}

/// The nearest lattice position of a weighted mean; it lies in the box as the corners do.
fn place(corners: [FinePos; 3], weights: [f64; 3]) -> LatticePos {
    let [a, b, c] = corners;
    let (ab, ac) = (difference(b, a), difference(c, a));
    std::array::from_fn(|k| {
        let fine = a[k] as f64 + weights[1] * ab[k] + weights[2] * ac[k];
        let (lo, hi) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
        let inside = (fine.round() as i64).clamp(lo, hi);
        ((inside + (1 << (FINE_BITS - 1))) >> FINE_BITS) as u32
    })
}
