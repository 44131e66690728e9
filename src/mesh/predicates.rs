//! Exact geometric predicates on lattice positions, and the rule that breaks their ties.
//!
//! Coordinates are integers of at most 2^24, so every answer is a sign of an integer that fits
//! `i128`; a floating-point evaluation with a proven bound comes first and settles all but the
//! near-ties.
//!
//! # Sizes
//! Differences of coordinates are at most R = 2^24 in absolute value. For points of a cube of edge
//! R the 3×3 determinant of differences is at most 2R³ = 2^73 (a parallelepiped with its corner and
//! three neighbours in the cube), and squared lengths are at most 3R² < 2^50. `insphere` is a sum
//! of four products of the two: at most 4·2^50·2^73 = 2^125 < 2^126.
//!
//! # The floating-point filters
//! Let u = 2^-53. Coordinates, their differences (≤ 2^24), 2×2 minors of differences (two products
//! ≤ 2^48 and a difference ≤ 2^49) and squared lengths (< 2^50) are integers below 2^53: **exact**
//! in `f64`. With mx, my, mz the largest absolute differences by axis, a 2×2 minor in x and y is at
//! most 2·mx·my, so
//!
//! * a 3×3 minor is a sum of three products, each at most P = 2·mx·my·mz; three roundings give an
//!   error of at most 3u'·3P = 18u'·mx·my·mz, where u' = u/(1 - 3u). [`orient3d`] uses
//!   20u·mx·my·mz, which also covers the roundings of the bound itself;
//! * `insphere` is a sum of four terms |d|²·minor; the minor has three roundings, the product one,
//!   the sum three, so the error is at most 7u'·4·m²·3P = 168u'·m²·mx·my·mz, m² the largest squared
//!   length. [`insphere`] uses 192u·m²·mx·my·mz.
//!
//! A fused multiply-add has fewer roundings, so the bounds hold with and without.
//!
//! # Ties
//! Five cospherical points are normal on a lattice. The tie is broken by lifting: a point p lies on
//! the paraboloid at height |p|²; each height is raised by its own infinitesimal, that of a later
//! point infinitely larger than that of an earlier one (Devillers and Teillaud, "Perturbations for
//! Delaunay and weighted Delaunay 3D triangulations", 2011). The points do not move, so
//! orientations keep their meaning and no flat tetrahedron appears. [`insphere_perturbed`] is the
//! sign of the perturbed determinant: of the five points, from the latest to the earliest, the
//! first whose height has a nonzero coefficient decides, and the coefficient is the orientation of
//! the other four. When the new point is the latest its coefficient is that of the (positively
//! oriented) tetrahedron: a tie then simply means "not in conflict".

use isospan_io::geom::LatticePos;

/// The unit roundoff of `f64`.
const U: f64 = 1.0 / (1u64 << 53) as f64;

fn minus(a: LatticePos, b: LatticePos) -> [i64; 3] {
    std::array::from_fn(|k| i64::from(a[k]) - i64::from(b[k]))
}

fn float(d: [i64; 3]) -> [f64; 3] {
    d.map(|c| c as f64)
}

/// The largest absolute values by axis.
fn extents<const N: usize>(d: &[[f64; 3]; N]) -> [f64; 3] {
    std::array::from_fn(|k| d.iter().fold(0.0, |m: f64, row| m.max(row[k].abs())))
}

fn sign(x: i128) -> i32 {
    x.signum() as i32
}

/// Six times the volume of the tetrahedron, exactly: `det(b - a, c - a, d - a)`, positive for a
/// positively oriented one.
#[inline]
pub fn signed_volume6(a: LatticePos, b: LatticePos, c: LatticePos, d: LatticePos) -> i128 {
    det3(minus(b, a), minus(c, a), minus(d, a))
}

#[inline]
fn det3(u: [i64; 3], v: [i64; 3], w: [i64; 3]) -> i128 {
    let minor = |p: [i64; 3], q: [i64; 3]| i128::from(p[0] * q[1] - p[1] * q[0]);
    i128::from(u[2]) * minor(v, w) - i128::from(v[2]) * minor(u, w) + i128::from(w[2]) * minor(u, v)
}

/// The orientation of four points: 1 when `d` sees a, b, c counterclockwise
/// (`det(b - a, c - a, d - a) > 0`), -1 when it sees them the other way round, 0 when the four are
/// coplanar.
#[inline]
pub fn orient3d(a: LatticePos, b: LatticePos, c: LatticePos, d: LatticePos) -> i32 {
    let rows = [minus(b, a), minus(c, a), minus(d, a)];
    let [u, v, w] = rows.map(float);
    let minor = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
    let det = u[2] * minor(v, w) - v[2] * minor(u, w) + w[2] * minor(u, v);
    let [mx, my, mz] = extents(&[u, v, w]);
    let bound = 20.0 * U * mx * my * mz;
    if det > bound {
        1
    } else if det < -bound {
        -1
    } else {
        sign(det3(rows[0], rows[1], rows[2]))
    }
}

/// Whether `e` lies inside (1), on (0) or outside (-1) the sphere through the positively oriented
/// a, b, c, d; the signs are exchanged for a negatively oriented tetrahedron.
#[inline]
pub fn insphere(a: LatticePos, b: LatticePos, c: LatticePos, d: LatticePos, e: LatticePos) -> i32 {
    let rows = [a, b, c, d].map(|p| minus(p, e));
    insphere_filter(rows.map(float)).unwrap_or_else(|| sign(insphere_exact(rows)))
}

fn insphere_filter([a, b, c, d]: [[f64; 3]; 4]) -> Option<i32> {
    let minor = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
    let square = |p: [f64; 3]| p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
    let (ab, ac, ad) = (minor(a, b), minor(a, c), minor(a, d));
    let (bc, bd, cd) = (minor(b, c), minor(b, d), minor(c, d));
    let bcd = b[2] * cd - c[2] * bd + d[2] * bc;
    let acd = a[2] * cd - c[2] * ad + d[2] * ac;
    let abd = a[2] * bd - b[2] * ad + d[2] * ab;
    let abc = a[2] * bc - b[2] * ac + c[2] * ab;
    let (sa, sb, sc, sd) = (square(a), square(b), square(c), square(d));
    let det = (sa * bcd - sb * acd) + (sc * abd - sd * abc);
    let [mx, my, mz] = extents(&[a, b, c, d]);
    let bound = 192.0 * U * sa.max(sb).max(sc.max(sd)) * mx * my * mz;
    if det > bound {
        Some(1)
    } else if det < -bound {
        Some(-1)
    } else {
        None
    }
}

/// The in-sphere determinant of differences to the fifth point; below 2^125 in absolute value.
fn insphere_exact([a, b, c, d]: [[i64; 3]; 4]) -> i128 {
    let minor = |p: [i64; 3], q: [i64; 3]| p[0] * q[1] - p[1] * q[0];
    let square = |p: [i64; 3]| i128::from(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    let (ab, ac, ad) = (minor(a, b), minor(a, c), minor(a, d));
    let (bc, bd, cd) = (minor(b, c), minor(b, d), minor(c, d));
    let largest = [a, b, c, d].iter().flatten().fold(0, |m, &x| m | x.unsigned_abs());
    let triple = |p: i64, pm: i64, q: i64, qm: i64, r: i64, rm: i64| {
        if largest < 1 << 20 {
            // Each product is below 2^20 · 2^41, the sum of three below 2^63.
            i128::from(p * pm - q * qm + r * rm)
        } else {
            i128::from(p) * i128::from(pm) - i128::from(q) * i128::from(qm) + i128::from(r) * i128::from(rm)
        }
    };
    square(a) * triple(b[2], cd, c[2], bd, d[2], bc) - square(b) * triple(a[2], cd, c[2], ad, d[2], ac)
        + square(c) * triple(a[2], bd, b[2], ad, d[2], ab)
        - square(d) * triple(a[2], bc, b[2], ac, c[2], ab)
}

/// [`insphere`] of a positively oriented a, b, c, d and e with ties broken; never 0.
///
/// `rank[i]` is the place of `points[i]` in the insertion order; the five ranks differ.
pub fn insphere_perturbed(points: &[LatticePos; 5], rank: &[u32; 5]) -> i32 {
    let [a, b, c, d, e] = *points;
    let plain = insphere(a, b, c, d, e);
    if plain != 0 {
        return plain;
    }
    let mut latest_first = [0, 1, 2, 3, 4];
    latest_first.sort_unstable_by_key(|&i| std::cmp::Reverse(rank[i]));
    for i in latest_first {
        // The determinant is linear in the heights: this is the coefficient of the height of point
        // i.
        let coefficient = match i {
            4 => -orient3d(a, b, c, d),
            _ => {
                let mut others = [a, b, c, d];
                others[i] = e;
                orient3d(others[0], others[1], others[2], others[3])
            }
        };
        if coefficient != 0 {
            return coefficient;
        }
    }
    unreachable!("the tetrahedron has a volume, so the coefficient of e is not zero")
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Lcg(u64);

    impl Lcg {
        fn below(&mut self, n: u64) -> u32 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((self.0 >> 33) % n) as u32
        }
        fn pos(&mut self, n: u64) -> LatticePos {
            [self.below(n), self.below(n), self.below(n)]
        }
    }

    fn coord(p: LatticePos) -> robust::Coord3D<f64> {
        robust::Coord3D { x: f64::from(p[0]), y: f64::from(p[1]), z: f64::from(p[2]) }
    }

    fn sign_of(x: f64) -> i32 {
        i32::from(x > 0.0) - i32::from(x < 0.0)
    }

    // `robust` follows Shewchuk's orientation, the opposite of ours.
    fn oracle(p: &[LatticePos; 5]) -> (i32, i32) {
        let [a, b, c, d, e] = p.map(coord);
        (-sign_of(robust::orient3d(a, b, c, d)), -sign_of(robust::insphere(a, b, c, d, e)))
    }

    #[test]
    fn agrees_with_the_oracle_at_every_scale() {
        let mut r = Lcg(7);
        let mut zeros = [0; 2];
        for i in 0..60_000 {
            let n = [2, 3, 5, 17, 1000, 1 << 16, (1 << 24) + 1][i % 7];
            let offset = r.pos((1 << 24) + 2 - n);
            let p: [LatticePos; 5] = std::array::from_fn(|_| {
                let q = r.pos(n);
                std::array::from_fn(|k| q[k] + offset[k])
            });
            let (o, s) = oracle(&p);
            assert_eq!(orient3d(p[0], p[1], p[2], p[3]), o, "{p:?}");
            assert_eq!(insphere(p[0], p[1], p[2], p[3], p[4]), s, "{p:?}");
            assert_eq!(signed_volume6(p[0], p[1], p[2], p[3]).signum() as i32, o);
            zeros[0] += usize::from(o == 0);
            zeros[1] += usize::from(s == 0);
        }
        assert!(zeros[0] > 3000 && zeros[1] > 3000, "{zeros:?}");
    }

    #[test]
    fn the_largest_values_do_not_overflow() {
        // Of 64-bit determinants too.
        for m in [1u32 << 24, 1 << 20, (1 << 20) - 1] {
            let corners: Vec<LatticePos> =
                (0..8u32).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|b| b * m)).collect();
            for i in 0..8usize.pow(5) {
                let p: [LatticePos; 5] = std::array::from_fn(|k| corners[i / 8usize.pow(k as u32) % 8]);
                let (o, s) = oracle(&p);
                assert_eq!(orient3d(p[0], p[1], p[2], p[3]), o);
                assert_eq!(insphere(p[0], p[1], p[2], p[3], p[4]), s);
                let (volume, cube) = (signed_volume6(p[0], p[1], p[2], p[3]), i128::from(m).pow(3));
                assert_eq!(volume.signum() as i32, o);
                assert!(volume % cube == 0 && volume.abs() <= 2 * cube, "{volume} {m}");
            }
        }
    }

    #[test]
    fn near_ties_at_full_range_go_to_the_integers_and_come_back_right() {
        let mut r = Lcg(3);
        for _ in 0..4000 {
            // Five corners of a box, one of them moved by a step: nearly cospherical.
            let (lo, hi) = (r.pos(1 << 10), r.pos(1 << 10).map(|c| (1 << 24) - 1 - c));
            let corner = |i: u32| -> LatticePos {
                std::array::from_fn(|k| if i >> k & 1 == 1 { hi[k] } else { lo[k] })
            };
            let mut p: [LatticePos; 5] = [corner(0), corner(1), corner(2), corner(4), corner(7)];
            let (which, axis) = (r.below(5) as usize, r.below(3) as usize);
            p[which][axis] = (p[which][axis] + r.below(3)).saturating_sub(1);
            assert_eq!(insphere(p[0], p[1], p[2], p[3], p[4]), oracle(&p).1, "{p:?}");
        }
    }

    #[test]
    fn perturbation_is_antisymmetric_consistent_and_total() {
        let mut r = Lcg(11);
        let mut ties = 0;
        for _ in 0..40_000 {
            let p: [LatticePos; 5] = std::array::from_fn(|_| r.pos(3));
            let rank: [u32; 5] = [0, 1, 2, 3, 4].map(|i| (i * 3 + 1) % 5);
            if (0..5).any(|i| (0..i).any(|j| p[i] == p[j])) || orient3d(p[0], p[1], p[2], p[3]) == 0 {
                continue;
            }
            let (mut q, mut rank_q) = (p, rank);
            if orient3d(p[0], p[1], p[2], p[3]) < 0 {
                q.swap(0, 1);
                rank_q.swap(0, 1);
            }
            let s = insphere_perturbed(&q, &rank_q);
            assert!(s != 0);
            ties += usize::from(insphere(q[0], q[1], q[2], q[3], q[4]) == 0);
            // An even permutation of the tetrahedron changes nothing.
            let even = [q[1], q[2], q[0], q[3], q[4]];
            let rank_even = [rank_q[1], rank_q[2], rank_q[0], rank_q[3], rank_q[4]];
            assert_eq!(insphere_perturbed(&even, &rank_even), s);
            // Across a facet: d is in conflict with (a, c, b, e) exactly if e is with (a, b, c, d).
            if orient3d(q[0], q[2], q[1], q[4]) > 0 {
                let swapped = [q[0], q[2], q[1], q[4], q[3]];
                let rank_swapped = [rank_q[0], rank_q[2], rank_q[1], rank_q[4], rank_q[3]];
                assert_eq!(insphere_perturbed(&swapped, &rank_swapped), s, "{q:?}");
            }
        }
        assert!(ties > 2000, "{ties}");
    }

    #[test]
    fn the_latest_point_is_outside_on_a_tie() {
        let p = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]];
        assert_eq!(orient3d(p[0], p[1], p[2], p[3]), 1);
        assert_eq!(insphere_perturbed(&p, &[0, 1, 2, 3, 4]), -1);
        assert_eq!(insphere(p[0], p[1], p[2], p[3], [0, 1, 1]), 0);
    }
}
