//! Which local tetrahedra are global ones: no point that a chunk cannot see lies in or on the
//! circumsphere.
//!
//! A chunk sees the points of its region (core and halo). The unseen points are lattice points of
//! the domain outside the region, that is, of at most six **slabs**: beyond each face of the region
//! that is not a face of the domain.
//!
//! ```text
//!  domain ┌──────────────────────────┐
//!         │       slab above         │      A tetrahedron is certified when no lattice point of a slab lies in its
//!         │ ┌──────────────────────┐ │      closed circumsphere. Where the region reaches the domain's face
//!         │ │ region   ┌────────┐  │ │      there is no slab: big shallow spheres poking through that face
//!         │s│          │  core  │  │s│      are harmless unless they also reach a slab sideways.
//!         │l│          └────────┘  │l│
//! ```
//!
//! Points of the outer halo are seen but not all inserted (`late.rs`): there, "unseen" reads "not
//! inserted", for the same proof.
//!
//! First the kernel's stored sphere, grown by its proven error, is compared with the region: that
//! settles nearly all. The rest is decided exactly. With p a vertex, u, v, w the others minus p,
//! D = u·(v×w), N = |u|² v×w + |v|² w×u + |w|² u×v, the power of q = p + t times D is the sum over
//! the axes of D·t² - N·t, so its least value over the lattice points of a slab is found axis by
//! axis, at the integers next to N/2D, clamped to the slab. |D| ≤ 2^73 and |N| < 2^101, so D·t² <
//! 2^122, N·t < 2^126/3, and the sum fits `i128`.
//!
//! # Why certified chunks make up the global tetrahedralization
//! Let L be the local tetrahedralization of the points of the region, G the global one; both are
//! unique, ties included. The chunk owns the tetrahedra whose least vertex (x, then y, then z) lies
//! in the core. It is done when
//!
//! 1. every tetrahedron of L with a vertex in the core is certified, and
//! 2. no slab point lies strictly beyond the hull facets of L with a vertex in the core.
//!
//! *Nothing wrong is emitted.* A certified tetrahedron is empty of all points, seen and unseen (the
//! closed sphere excludes even ties), so it is in G.
//!
//! *Nothing is missing.* Let T be in G with a vertex v in the core. By 2 the hull of L near v is
//! the hull of G near v (every point, unseen too, is on the inner side of each facet of L's hull at
//! v), so around v the tetrahedra of L at v fill what those of G fill; by 1 they are in G, whose
//! tetrahedra do not overlap: T is one of them. So all tetrahedra at the core's points are known,
//! those that are owned and those that show which points are shared. It would not suffice to check
//! owned tetrahedra alone: a wrong one whose least vertex lies outside the core can hide T.

use crate::predicates::signed_volume6;
use isospan_io::geom::vec3::{cross, dot};
use isospan_io::geom::{LatticeBox, LatticePos};

/// The unseen part of the domain.
#[derive(Debug)]
pub(super) struct Unseen {
    domain: LatticeBox,
    /// Boxes of lattice positions, half-open, that cover the unseen part.
    slabs: Vec<LatticeBox>,
    /// The region in the kernel's coordinates, infinite where it reaches the domain's face.
    lo: [f64; 3],
    hi: [f64; 3],
    /// The amounts to add to a squared radius, and then to the radius, to cover the sphere's error.
    grow_r2: f64,
    grow_r: f64,
}

/// The kernel's coordinates: `(position - origin) / 2^shift`, and its error margin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Local {
    pub(super) origin: LatticePos,
    pub(super) shift: u32,
    pub(super) margin: f64,
}

impl Local {
    /// A lattice position in the kernel's coordinates, exactly if it is a multiple of 2^shift
    /// beyond the origin.
    #[inline]
    pub(super) fn coordinates(&self, at: LatticePos) -> [f64; 3] {
        let scale = 1.0 / f64::from(1u32 << self.shift);
        std::array::from_fn(|k| (f64::from(at[k]) - f64::from(self.origin[k])) * scale)
    }
}

impl Unseen {
    /// What lies in the domain and outside `region`.
    pub(super) fn new(region: LatticeBox, domain: LatticeBox, local: Local) -> Self {
        let mut slabs = vec![];
        let (mut lo, mut hi) = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
        for a in 0..3 {
            let at = |c: u32| local.coordinates([c; 3])[a];
            if region.lo[a] > domain.lo[a] {
                let mut slab = domain;
                slab.hi[a] = region.lo[a];
                slabs.push(slab);
                lo[a] = at(region.lo[a]);
            }
            if region.hi[a] < domain.hi[a] {
                let mut slab = domain;
                slab.lo[a] = region.hi[a];
                slabs.push(slab);
                hi[a] = at(region.hi[a] - 1);
            }
        }
        // A stored centre is off by at most √e/64 + 1.75εR and the radius by √e/64 (from the bounds
        // of the kernel's margin); an exact sphere's r² is lowered by e + ½. The rest covers the
        // roundings of `quickly`.
        let grow_r = local.margin.sqrt() / 16.0 + 1.0 / 1024.0;
        Self { domain, slabs, lo, hi, grow_r2: local.margin + 0.5, grow_r }
    }

    /// Whether a positively oriented tetrahedron is certified; `sphere` as the kernel stored it.
    #[inline]
    pub(super) fn spares(&self, tet: impl FnOnce() -> [LatticePos; 4], sphere: &[f64; 4]) -> bool {
        self.quickly(sphere) || self.spares_exactly(tet())
    }

    /// The radius that certainly reaches around the closed circumsphere from the stored centre;
    /// `None` for one that is not trusted.
    pub(super) fn radius(&self, sphere: &[f64; 4]) -> Option<f64> {
        let r = self.grown(sphere);
        (!r.is_nan()).then_some(r)
    }

    #[inline]
    fn grown(&self, sphere: &[f64; 4]) -> f64 {
        (sphere[3] + self.grow_r2).sqrt() * (1.0 + 1.0 / 1_048_576.0) + self.grow_r
    }

    /// Whether the stored sphere alone certifies its tetrahedron.
    #[inline]
    pub(super) fn quickly(&self, sphere: &[f64; 4]) -> bool {
        let r = self.grown(sphere);
        // False for the NaN of a sphere that is not trusted. Without branches.
        let within = |a: usize| (sphere[a] - r >= self.lo[a]) & (sphere[a] + r <= self.hi[a]);
        within(0) & within(1) & within(2)
    }

    fn spares_exactly(&self, [a, b, c, p]: [LatticePos; 4]) -> bool {
        let [u, v, w] =
            [a, b, c].map(|q| -> [i64; 3] { std::array::from_fn(|k| i64::from(q[k]) - i64::from(p[k])) });
        let square = |a: [i64; 3]| i128::from(dot(a, a));
        let [vw, wu, uv] = [cross(v, w), cross(w, u), cross(u, v)].map(|n| n.map(i128::from));
        let d: i128 = (0..3).map(|k| i128::from(u[k]) * vw[k]).sum();
        let n: [i128; 3] =
            std::array::from_fn(|k| (square(u) * vw[k] + square(v) * wu[k] + square(w) * uv[k]) * d.signum());
        let d = d.abs();
        let least = |k: usize, slab: &LatticeBox| {
            let (lo, hi) = (i128::from(slab.lo[k]), i128::from(slab.hi[k]) - 1);
            let middle = n[k].div_euclid(2 * d) + i128::from(p[k]);
            let power = |q: i128| {
                let t = q.clamp(lo, hi) - i128::from(p[k]);
                d * t * t - n[k] * t
            };
            power(middle).min(power(middle + 1))
        };
        self.slabs.iter().all(|slab| (0..3).map(|k| least(k, slab)).sum::<i128>() > 0)
    }

    /// Whether no unseen point is strictly beyond a hull facet (a point q is beyond when a, b, c, q
    /// is positively oriented).
    pub(super) fn spares_beyond(&self, [a, b, c]: [LatticePos; 3]) -> bool {
        // The usual case: a facet in a face of the domain, nothing of the domain is beyond it.
        let in_face = (0..3).any(|k| {
            a[k] == b[k] && a[k] == c[k] && (a[k] == self.domain.lo[k] || a[k] + 1 == self.domain.hi[k])
        });
        in_face
            || self.slabs.iter().all(|slab| {
                (0..8u32).all(|i| {
                    let corner =
                        std::array::from_fn(|k| if i >> k & 1 == 0 { slab.lo[k] } else { slab.hi[k] - 1 });
                    signed_volume6(a, b, c, corner) <= 0
                })
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unseen() -> Unseen {
        let domain = LatticeBox { lo: [0; 3], hi: [101; 3] };
        let region = LatticeBox { lo: [0; 3], hi: [101, 101, 51] };
        Unseen::new(region, domain, Local { origin: [0; 3], shift: 0, margin: 1.0 / 16.0 })
    }

    /// Positively oriented, its circumsphere centred at (50, 50, `z`) with radius 10.
    fn tet(z: u32) -> [LatticePos; 4] {
        [[50, 50, z - 10], [60, 50, z], [50, 60, z], [40, 50, z]]
    }

    #[test]
    fn a_sphere_that_touches_an_unseen_position_is_not_certified() {
        let u = unseen();
        let nan = [f64::NAN; 4];
        for z in 20..50 {
            // The highest position of the sphere is (50, 50, z + 10); the first unseen ones have
            // z = 51.
            assert_eq!(u.spares(|| tet(z), &nan), z + 10 < 51, "{z}");
            let quick = u.quickly(&[50.0, 50.0, f64::from(z), 100.0]);
            assert!(!quick || z + 10 < 51, "{z}");
            assert!(quick || z + 12 > 50, "{z}");
        }
    }

    #[test]
    fn a_shallow_cap_through_a_face_of_the_domain_is_certified() {
        let u = unseen();
        // Three positions on the face x = 0 and one just above: centre far outside, at x < -100.
        let cap = [[1, 50, 20], [0, 40, 10], [0, 60, 10], [0, 50, 35]];
        let oriented = if signed_volume6(cap[0], cap[1], cap[2], cap[3]) > 0 {
            cap
        } else {
            [cap[1], cap[0], cap[2], cap[3]]
        };
        assert!(u.spares(|| oriented, &[f64::NAN; 4]));
        assert!(!u.quickly(&[-120.0, 50.0, 20.0, 121.0 * 121.0]));
    }

    #[test]
    fn hull_facets_are_harmless_in_a_face_of_the_domain_or_facing_away() {
        let u = unseen();
        let away = [[10, 10, 0], [10, 20, 0], [20, 10, 0]];
        assert!(u.spares_beyond(away));
        let below = [[10, 10, 5], [10, 20, 5], [20, 10, 5]];
        assert!(signed_volume6(below[0], below[1], below[2], [10, 10, 0]) > 0);
        assert!(u.spares_beyond(below));
        let above = [[10, 10, 45], [20, 10, 45], [10, 20, 45]];
        assert!(!u.spares_beyond(above));
    }
}
