//! From the lattice to the world.

use crate::geom::Lattice;
use crate::grid::Geometry;

/// From the lattice to the world: positions as points, gradients as covectors.
///
/// All of it is in `f64`; a surface vertex is rounded to `f32` once, at the end. Far from the
/// world's origin (more than about a million voxels) that rounding is coarser than 1/16 of a voxel,
/// and small triangles may lose their area; the connectivity is never touched.
#[derive(Clone, Copy, Debug)]
pub struct WorldMap {
    pub(super) geometry: Geometry,
    /// Voxels a lattice step along each axis, powers of two.
    pub(super) steps: [f64; 3],
    /// World vectors of the three unit vectors of index space.
    pub(super) axes: [[f64; 3]; 3],
    /// World covectors of the three unit covectors of the lattice, as long as those of index space
    /// where it has the fewest steps a voxel.
    pub(super) covectors: [[f64; 3]; 3],
    mirrors: bool,
}

impl WorldMap {
    /// The map of a structured volume.
    pub fn new(lattice: &Lattice, geometry: &Geometry) -> Self {
        let unit = |a: usize| std::array::from_fn(|b| if a == b { 1.0 } else { 0.0 });
        let finer = lattice.finer().map(|f| f64::from(1u32 << f));
        Self {
            geometry: *geometry,
            steps: lattice.log2_steps.map(|s| 1.0 / f64::from(1u32 << s)),
            axes: geometry.axes(),
            covectors: std::array::from_fn(|a| {
                geometry.gradient_to_world(unit(a).map(|x: f64| x * finer[a]))
            }),
            mirrors: geometry.mirrors(),
        }
    }

    /// Whether the map mirrors, so that triangles must be turned over.
    pub fn mirrors(&self) -> bool {
        self.mirrors
    }

    /// The unit world vector of minus the lattice covector `g`; `None` when that has no direction.
    #[inline]
    pub(super) fn unit_normal(&self, g: [f64; 3]) -> Option<[f32; 3]> {
        let c = &self.covectors;
        let w: [f64; 3] = std::array::from_fn(|k| -(g[0] * c[0][k] + g[1] * c[1][k] + g[2] * c[2][k]));
        // Scaled by the largest component first: spacings of 1e-200 are legal, and their squares
        // vanish.
        let [x, y, z] = w.map(f64::abs);
        let largest = if y < x { x } else { y };
        let largest = if z < largest { largest } else { z };
        if !Self::has_direction(largest) {
            return None;
        }
        let scale = Self::scale_of(largest);
        let w = w.map(|x| x * scale);
        let inverse = 1.0 / (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]).sqrt();
        Some(w.map(|x| (x * inverse) as f32))
    }

    /// Whether a vector with this largest component has a direction.
    #[inline(always)]
    pub(super) fn has_direction(largest: f64) -> bool {
        largest > 0.0 && largest.is_finite()
    }

    /// A power of two that makes the largest component about 1; for the smallest numbers there is
    /// none large enough, nor need be.
    #[inline(always)]
    pub(super) fn scale_of(largest: f64) -> f64 {
        f64::from_bits((2046 - (largest.to_bits() >> 52).min(2045)) << 52)
    }
}
