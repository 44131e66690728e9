//! Points of a surface, evenly by area, always the same.

use super::nearest::Triangles;
use glam::DVec3;
use isospan_io::error::{Error, Result};
use isospan_mesh::points::radical_inverse;

/// Samples of a surface: any of them, without those before.
pub(super) struct AreaSamples<'a> {
    surface: &'a Triangles,
    /// Area of the triangles up to each one.
    sums: Vec<f64>,
    len: u64,
}

impl<'a> AreaSamples<'a> {
    pub(super) fn new(surface: &'a Triangles, len: u64) -> Result<Self> {
        let mut sum = 0.0;
        let area = |t: usize| surface.area_vector(t as u32).length() / 2.0;
        let sums: Vec<f64> = (0..surface.triangles.len())
            .map(|t| {
                sum += area(t);
                sum
            })
            .collect();
        if !(sum > 0.0 && sum.is_finite()) {
            return Err(Error::usage(format!("a surface of area {sum} cannot be compared with another")));
        }
        Ok(Self { surface, sums, len })
    }

    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// A sample, and the unit normal of its triangle.
    pub(super) fn get(&self, k: u64) -> ([f64; 3], DVec3) {
        let whole = self.sums[self.sums.len() - 1];
        let wanted = (k as f64 + 0.5) / self.len as f64 * whole;
        // Triangles without area are passed over: their sum is that of the one before.
        let t = self.sums.partition_point(|&s| s <= wanted).min(self.sums.len() - 1);
        let (u, v) = (radical_inverse(2, k).to_f64(), radical_inverse(3, k).to_f64());
        let s = u.sqrt();
        let [a, b, c] = self.surface.corners(t as u32);
        let at = a * (1.0 - s) + b * (s * (1.0 - v)) + c * (s * v);
        (at.to_array(), self.surface.area_vector(t as u32).normalize_or_zero())
    }
}
