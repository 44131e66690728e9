//! The nearest point of a surface.

use crate::surface::{SurfaceSource, closest, vertices_from};
use glam::DVec3;
use isospan_io::error::{Error, Result};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::{Boundable, BvhBuildParams};
use std::time::Duration;

/// Coordinates beyond this are refused: the boxes of the hierarchy are measured in `f32`.
const LARGEST: f32 = 1e15;

/// The triangles of a surface, in memory: 12 bytes a vertex and 12 a triangle.
#[derive(Clone, Debug, Default)]
pub struct Triangles {
    /// Positions of the vertices, less `origin`.
    pub positions: Vec<[f32; 3]>,
    /// Corners: numbers into `positions`. Triangles that named other vertices were left out.
    pub triangles: Vec<[u32; 3]>,
    /// The place in the world that positions are counted from.
    pub origin: [f64; 3],
}

impl Triangles {
    /// Reads a surface.
    ///
    /// # Errors
    /// [`Error::Usage`] for one without triangles, or with coordinates beyond 10^15; those of the
    /// source.
    pub fn read(source: &dyn SurfaceSource) -> Result<Self> {
        Self::read_from(source, source.origin())
    }

    /// Reads a surface, with positions that are counted from a place of the world.
    pub(super) fn read_from(source: &dyn SurfaceSource, origin: [f64; 3]) -> Result<Self> {
        let mut all = Self { origin, ..Self::default() };
        vertices_from(source, origin, &mut |batch| {
            all.positions.extend(batch.iter().map(|v| v.position));
            Ok(())
        })?;
        let count = all.positions.len();
        source.triangles(&mut |batch| {
            all.triangles.extend(batch.iter().filter(|t| t.iter().all(|&v| (v as usize) < count)));
            Ok(())
        })?;
        if all.triangles.is_empty() {
            return Err(Error::usage("a surface without triangles cannot be compared with another"));
        }
        all.check()?;
        Ok(all)
    }

    /// Refuses coordinates that the boxes of a hierarchy do not hold.
    pub(super) fn check(&self) -> Result<()> {
        // False for NaN too.
        if self.positions.iter().flatten().all(|c| c.abs() <= LARGEST) {
            return Ok(());
        }
        Err(Error::usage(format!("a surface with coordinates beyond {LARGEST} cannot be compared: scale it")))
    }

    /// The corners of a triangle.
    #[inline]
    pub(super) fn corners(&self, t: u32) -> [DVec3; 3] {
        self.triangles[t as usize].map(|v| DVec3::from_array(self.positions[v as usize].map(f64::from)))
    }

    /// Normal of a triangle, twice as long as its area.
    #[inline]
    pub(super) fn area_vector(&self, t: u32) -> DVec3 {
        let [a, b, c] = self.corners(t);
        (b - a).cross(c - a)
    }

    /// Which vertices some triangle has.
    pub(super) fn used_vertices(&self) -> Vec<bool> {
        let mut used = vec![false; self.positions.len()];
        self.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        used
    }

    /// Diagonal of the box around two surfaces.
    pub(super) fn diagonal_with(&self, other: &Self) -> f64 {
        let all =
            || self.positions.iter().chain(&other.positions).map(|p| DVec3::from_array(p.map(f64::from)));
        let (lo, hi) = (all().reduce(DVec3::min), all().reduce(DVec3::max));
        lo.zip(hi).map_or(0.0, |(lo, hi)| (hi - lo).length())
    }
}

/// The box of a triangle, for the hierarchy.
struct Boxed([[f32; 3]; 3]);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        let [a, b, c] = self.0;
        let min = std::array::from_fn(|k| a[k].min(b[k]).min(c[k]));
        let max: [f32; 3] = std::array::from_fn(|k| a[k].max(b[k]).max(c[k]));
        Aabb::new(<[f32; 3]>::into(min), max.into())
    }
}

/// The nearest point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestPoint {
    /// Its distance.
    pub distance: f64,
    /// The triangle that it is on.
    pub triangle: u32,
}

/// Nodes still to be looked at, kept between walks for their memory.
#[derive(Default)]
pub struct Walk {
    stack: Vec<(f64, u32)>,
}

/// A surface, prepared for finding what is nearest to a point.
pub struct Nearest<'a> {
    surface: &'a Triangles,
    hierarchy: Bvh2,
    /// Square of the distance that counts as none.
    zero: f64,
}

impl<'a> Nearest<'a> {
    /// Builds the hierarchy of a surface; distances up to `zero` are reported as 0.
    pub fn new(surface: &'a Triangles, zero: f64) -> Self {
        let boxed = |t: &[u32; 3]| Boxed(t.map(|v| surface.positions[v as usize]));
        let boxes: Vec<Boxed> = surface.triangles.iter().map(boxed).collect();
        let hierarchy = build_bvh2(&boxes, BvhBuildParams::fast_build(), &mut Duration::default());
        Self { surface, hierarchy, zero: zero * zero }
    }

    /// The point of the surface nearest to `p`, which counts from its origin; of several triangles
    /// it may lie on, any, but always the same.
    pub fn nearest(&self, p: [f64; 3], walk: &mut Walk) -> NearestPoint {
        self.nearest_aligned(p, DVec3::ZERO, walk)
    }

    /// As [`Nearest::nearest`], on the triangle whose plane deviates least from that of a normal.
    pub(super) fn nearest_aligned(&self, p: [f64; 3], normal: DVec3, walk: &mut Walk) -> NearestPoint {
        let p = DVec3::from_array(p);
        let (nodes, order) = (&self.hierarchy.nodes, &self.hierarchy.primitive_indices);
        let (mut best, mut found, mut deviation) = (f64::INFINITY, 0, f64::INFINITY);
        walk.stack.clear();
        walk.stack.push((0.0, 0));
        while let Some((least, at)) = walk.stack.pop() {
            if least > self.nearly(best) {
                continue;
            }
            let node = &nodes[at as usize];
            if node.is_leaf() {
                let first = node.first_index as usize;
                for &t in &order[first..first + node.prim_count as usize] {
                    let d = (closest(p, self.surface.corners(t)) - p).length_squared();
                    if d > self.nearly(best) {
                        continue;
                    }
                    let turned = if normal == DVec3::ZERO { 0.0 } else { self.angle(t, normal) };
                    if self.nearly(d) < best || turned < deviation {
                        (best, found, deviation) = (best.min(d), t, turned);
                    }
                }
                continue;
            }
            let child = |n: u32| (box_distance(nodes[n as usize].aabb(), p), n);
            let (a, b) = (child(node.first_index), child(node.first_index + 1));
            // The nearer one is looked at first.
            let (near, far) = if b.0 < a.0 { (b, a) } else { (a, b) };
            walk.stack.extend([far, near]);
        }
        NearestPoint { distance: if best <= self.zero { 0.0 } else { best.sqrt() }, triangle: found }
    }

    /// The largest squared distance that counts as equal to the best, but for rounding.
    #[inline]
    fn nearly(&self, squared: f64) -> f64 {
        squared * (1.0 + 1e-12) + self.zero
    }

    /// The angle between the plane of a triangle and that of a normal, 0 to π/2; 0 where one of
    /// them has no direction.
    pub(super) fn angle(&self, triangle: u32, normal: DVec3) -> f64 {
        let own = self.surface.area_vector(triangle);
        libm::atan2(own.cross(normal).length(), own.dot(normal).abs())
    }
}

/// Square of the distance of a point from a box.
#[inline]
fn box_distance(b: &Aabb, p: DVec3) -> f64 {
    let side = |corner: [f32; 3]| DVec3::from_array(corner.map(f64::from));
    let (min, max) = (side(b.min.to_array()), side(b.max.to_array()));
    (min - p).max(p - max).max(DVec3::ZERO).length_squared()
}
