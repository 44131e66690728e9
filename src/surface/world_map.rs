//! From the lattice to the world.

use isospan_io::geom::Lattice;
use isospan_io::grid::Geometry;

/// From the lattice to the world: positions as points, gradients as covectors.
///
/// All of it is in `f64`; a surface vertex is rounded to `f32` once, at the end. That rounding
/// would take the area of small triangles far from the world's origin, so there positions are
/// counted from a place nearby: see [`nearby_origin`].
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
    /// The part of an edge that a surface stays away from its ends.
    pub(super) least: f64,
    /// The place that positions are counted from.
    origin: [f64; 3],
}

impl WorldMap {
    /// The map of a structured volume.
    pub fn new(lattice: &Lattice, geometry: &Geometry) -> Self {
        let finer = lattice.finer().map(|f| f64::from(1u32 << f));
        Self {
            steps: lattice.log2_steps.map(|s| 1.0 / f64::from(1u32 << s)),
            covectors: covectors(geometry, finer),
            ..Self::of_samples(geometry)
        }
    }

    /// The map of the samples of a structured volume: a step is from one sample to the next.
    pub fn of_samples(geometry: &Geometry) -> Self {
        Self {
            geometry: *geometry,
            steps: [1.0; 3],
            axes: geometry.axes(),
            covectors: covectors(geometry, [1.0; 3]),
            mirrors: geometry.mirrors(),
            least: LEAST,
            origin: [0.0; 3],
        }
    }

    /// The same map, of points that are `spacing` apart and whose positions reach `far`: where
    /// these are many spacings, a surface stays farther from the ends of edges, so that `f32` still
    /// tells its vertices apart.
    #[must_use]
    pub fn resolving(mut self, spacing: f64, far: f64) -> Self {
        let rounded = far * f64::from(f32::EPSILON) / spacing;
        if rounded.is_finite() {
            self.least = (ROUNDED_PARTS * rounded).clamp(LEAST, MOST);
        }
        self
    }

    /// The same map, with positions that are counted from a place of the world.
    #[must_use]
    pub fn counted_from(mut self, origin: [f64; 3]) -> Self {
        for (at, origin) in self.geometry.origin.iter_mut().zip(origin) {
            *at -= origin;
        }
        self.origin = origin;
        self
    }

    /// The place of the world that positions are counted from.
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// Whether the map mirrors, so that triangles must be turned over.
    pub fn mirrors(&self) -> bool {
        self.mirrors
    }

    /// The place of a position in index space, counted from the origin.
    #[inline(always)]
    pub(super) fn position(&self, index: [f64; 3]) -> [f32; 3] {
        std::array::from_fn(|k| {
            let [x, y, z] = std::array::from_fn(|a| self.axes[a][k] * index[a]);
            (x + y + z + self.geometry.origin[k]) as f32
        })
    }

    /// The part of an edge at which a surface crosses it, away from its ends.
    #[inline(always)]
    pub(super) fn part_of_edge(&self, t: f64) -> f64 {
        // Two infinities leave no number; the middle is as good as any point.
        if t.is_nan() { 0.5 } else { t.clamp(self.least, 1.0 - self.least) }
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

/// World covectors of covectors of index space along its axes, of these lengths.
fn covectors(geometry: &Geometry, lengths: [f64; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|a| {
        let mut along = [0.0; 3];
        along[a] = lengths[a];
        geometry.gradient_to_world(along)
    })
}

/// The part of an edge that a surface stays away from its ends, and the most that it does.
const LEAST: f64 = 1.0 / 1024.0;
const MOST: f64 = 1.0 / 16.0;
/// Steps of `f32` in that part: fewer could take the area of a triangle.
const ROUNDED_PARTS: f64 = 8.0;

/// Parts of a spacing that `f32` tells apart where positions are counted from 0: triangles may be
/// a thousandth of a spacing long.
const LEAST_PARTS: f64 = 8192.0;

/// The place that positions in a box of the world are counted from, so that `f32` tells them apart;
/// `spacing` is the distance of neighbouring points along each axis. A coordinate of 0 stands for
/// an axis on which `f32` does as well without, or on which a place nearby would change little.
pub fn nearby_origin([lo, hi]: [[f64; 3]; 2], spacing: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| {
        let (length, far) = (hi[k] - lo[k], lo[k].abs().max(hi[k].abs()));
        let is_coarse = far * f64::from(f32::EPSILON) * LEAST_PARTS > spacing[k];
        let is_far = far > 2.0 * length;
        if is_coarse && is_far && far.is_finite() { short_number(lo[k].midpoint(hi[k]), length) } else { 0.0 }
    })
}

/// A number of few digits that differs from `x` by at most a quarter of `length`.
fn short_number(x: f64, length: f64) -> f64 {
    if length == 0.0 {
        return x;
    }
    let digits = libm::floor(libm::log10(length / 2.0));
    // Of the two, the power that is a whole number is exact.
    let unit = libm::pow(10.0, digits.abs());
    let short = if digits < 0.0 { (x * unit).round() / unit } else { (x / unit).round() * unit };
    if short.is_finite() { short } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_stays_away_from_the_ends_of_edges_as_f32_wants_it() {
        let map = WorldMap::new(&Lattice::new([9; 3]).unwrap(), &Geometry::default());
        assert_eq!([map.resolving(1.0, 1000.0).least, map.resolving(0.0, 0.0).least], [LEAST; 2]);
        let [coarse, coarsest] = [8192.0, 1e9].map(|far| map.resolving(1.0, far).least);
        assert_eq!((coarse, coarsest), (1.0 / 128.0, MOST));
    }

    #[test]
    fn far_boxes_have_an_origin_nearby_and_others_have_none() {
        let of = |lo: f64, hi: f64, spacing: f64| nearby_origin([[lo; 3], [hi; 3]], [spacing; 3])[0];
        // A scan around 0, one beside it, and a large volume: f32 does.
        assert_eq!([of(-250.0, 250.0, 0.5), of(600.0, 664.0, 1.0), of(0.0, 4095.0, 1.0)], [0.0; 3]);
        assert_eq!(of(4_100_000.25, 4_100_001.25, 0.1), 4_100_000.8);
        assert_eq!(of(448_000.0, 449_000.0, 10.0), 448_500.0);
        assert_eq!(of(-449_000.0, -448_000.0, 10.0), -448_500.0);
        assert_eq!([of(7.0, 7.0, 1.0), of(9_000_000.3, 9_000_000.3, 1.0)], [0.0, 9_000_000.3]);
        let far = of(1e300, 1e300 + 1e290, 1e288);
        assert!((far - 1e300).abs() <= 1e290 && far.is_finite());
    }
}
