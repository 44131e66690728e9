//! Decisions in exact integers: conflicts that the spheres leave open, and the walk to a point.

use super::arena::{Arena, INFINITE};
use crate::predicates::{insphere, insphere_perturbed, orient3d};

/// Steps of the walk along falling powers before the exact walk takes over; either is correct.
const MOST_POWER_STEPS: u32 = 10_000;

impl Arena {
    /// Whether `vertex` is in conflict with a tetrahedron: inside its circumsphere, ties broken;
    /// for a ghost, beyond its hull facet, or in the facet's plane and inside its circle.
    pub(super) fn conflicts_exactly(&self, tet: u32, vertex: u32) -> bool {
        let record = &self.tets[tet as usize];
        let v = record.vertices();
        if let Some(k) = v.iter().position(|&v| v == INFINITE) {
            let at = self.position(vertex);
            let [a, b, c, d] = std::array::from_fn(|i| if i == k { at } else { self.position(v[i]) });
            // In the plane, the circle is that of the sphere of the tetrahedron below, which is
            // never a ghost. Points in a face of the domain are the usual case, and there the
            // determinant would be exact and slow.
            let in_a_face = (0..3).any(|k| a[k] == b[k] && a[k] == c[k] && a[k] == d[k]);
            return match if in_a_face { 0 } else { orient3d(a, b, c, d) } {
                0 => self.conflicts(record.n[k] >> 2, vertex, self.points[vertex as usize].f64s()),
                side => side > 0,
            };
        }
        let all = [v[0], v[1], v[2], v[3], vertex];
        let points = all.map(|v| self.position(v));
        if self.in_order {
            // The new point is the latest of the five: a tie is not a conflict.
            let [a, b, c, d, e] = points;
            insphere(a, b, c, d, e) > 0
        } else {
            match insphere(points[0], points[1], points[2], points[3], points[4]) {
                0 => insphere_perturbed(&points, &self.ranks(all)) > 0,
                side => side > 0,
            }
        }
    }

    /// Whether `vertex` at `p` is in conflict with a tetrahedron: the sphere if it knows, else the
    /// integers.
    #[inline]
    pub(super) fn conflicts(&self, tet: u32, vertex: u32, p: [f64; 3]) -> bool {
        let power = self.tets[tet as usize].power(p);
        if power < -self.margin.e {
            true
        } else if power > self.margin.above {
            false
        } else {
            self.conflicts_exactly(tet, vertex)
        }
    }

    /// A tetrahedron or ghost in conflict with `vertex`.
    ///
    /// First down the powers: crossing a face towards the point always lowers the power of a
    /// Delaunay sphere at the point, so stepping to the neighbour of least power is a walk towards
    /// it, without an orientation test. Where rounding or the hull stops that, an exact visibility
    /// walk goes on; it ends, since crossings lower the (perturbed) power.
    pub(super) fn locate(&self, vertex: u32) -> u32 {
        let p = self.points[vertex as usize].f64s();
        let mut tet = self.inner(self.hint);
        let mut power = self.tets[tet as usize].power(p);
        for _ in 0..MOST_POWER_STEPS {
            if power < -self.margin.e {
                return tet;
            }
            let mut best = (power, tet);
            for code in self.tets[tet as usize].n {
                let there = self.tets[(code >> 2) as usize].power(p);
                if there < best.0 {
                    best = (there, code >> 2);
                }
            }
            if best.1 == tet {
                break;
            }
            (power, tet) = best;
        }
        self.walk_exactly(tet, vertex)
    }

    /// The tetrahedron itself, or the one below a ghost.
    fn inner(&self, tet: u32) -> u32 {
        let record = &self.tets[tet as usize];
        match record.v.iter().position(|&v| v == INFINITE) {
            Some(k) => record.n[k] >> 2,
            None => tet,
        }
    }

    fn walk_exactly(&self, mut tet: u32, vertex: u32) -> u32 {
        let at = self.position(vertex);
        loop {
            let record = &self.tets[tet as usize];
            if record.v.contains(&INFINITE) {
                // Reached by crossing its hull facet: the point is strictly beyond.
                return tet;
            }
            let v = record.v.map(|v| self.position(v));
            let beyond = (0..4).find(|&i| {
                let [a, b, c, d] = std::array::from_fn(|k| if k == i { at } else { v[k] });
                orient3d(a, b, c, d) < 0
            });
            match beyond {
                Some(i) => tet = record.n[i] >> 2,
                // In the closed tetrahedron and not one of its corners: inside the sphere.
                None => return tet,
            }
        }
    }
}
