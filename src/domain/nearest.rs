//! The point of a triangle that is nearest to a point.
//!
//! It is found by the regions of the triangle's plane beyond its corners, beyond its edges, and
//! inside (Ericson 2005, "Real-Time Collision Detection", section 5.1.5). All is in `f64` and in
//! one order of operations, so the bits are the same on every machine.

use isospan_io::geom::vec3::{cross, difference, dot};
use isospan_mesh::locate::FinePos;

/// Weights of the corners of a triangle at its point nearest to `p`, and the square of the distance
/// in fine steps.
pub(crate) fn nearest(corners: [FinePos; 3], p: FinePos) -> ([f64; 3], f64) {
    let [a, b, c] = corners;
    let weights = weights(a, b, c, p);
    let to: [f64; 3] = std::array::from_fn(|k| {
        (a[k] - p[k]) as f64 * weights[0]
            + (b[k] - p[k]) as f64 * weights[1]
            + (c[k] - p[k]) as f64 * weights[2]
    });
    (weights, dot(to, to))
}

fn weights(a: FinePos, b: FinePos, c: FinePos, p: FinePos) -> [f64; 3] {
    let (ab, ac, ap) = (difference(b, a), difference(c, a), difference(p, a));
    let (ab_p, ac_p) = (dot(ab, ap), dot(ac, ap));
    if ab_p <= 0.0 && ac_p <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = difference(p, b);
    let (ab_q, ac_q) = (dot(ab, bp), dot(ac, bp));
    if ab_q >= 0.0 && ac_q <= ab_q {
        return [0.0, 1.0, 0.0];
    }
    let cp = difference(p, c);
    let (ab_r, ac_r) = (dot(ab, cp), dot(ac, cp));
    if ac_r >= 0.0 && ab_r <= ac_r {
        return [0.0, 0.0, 1.0];
    }
    // The normal, and the areas that p spans with the edges: without cancellation, from differences
    // that are exact.
    let n = cross(ab, ac);
    let of_a = dot(n, cross(difference(c, b), bp));
    let of_b = dot(n, cross(difference(a, c), cp));
    let of_c = dot(n, cross(ab, ap));
    if of_c <= 0.0 && ab_p >= 0.0 && ab_q <= 0.0 {
        let t = along(ab_p, ab_p - ab_q);
        return [1.0 - t, t, 0.0];
    }
    if of_b <= 0.0 && ac_p >= 0.0 && ac_r <= 0.0 {
        let t = along(ac_p, ac_p - ac_r);
        return [1.0 - t, 0.0, t];
    }
    let (on_bc, from_c) = (ac_q - ab_q, ab_r - ac_r);
    if of_a <= 0.0 && on_bc >= 0.0 && from_c >= 0.0 {
        let t = along(on_bc, on_bc + from_c);
        return [0.0, 1.0 - t, t];
    }
    let sum = of_a + of_b + of_c;
    if sum > 0.0 { [of_a / sum, of_b / sum, of_c / sum] } else { [1.0, 0.0, 0.0] }
}

/// A part of an edge; its start for an edge without length.
fn along(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { (part / whole).clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn corners_edges_and_the_inside() {
        let triangle = [[0, 0, 0], [8, 0, 0], [0, 8, 0]];
        let cases = [
            ([-3, -4, 0], [1.0, 0.0, 0.0], 25.0),
            ([12, -3, 0], [0.0, 1.0, 0.0], 25.0),
            ([0, 9, 2], [0.0, 0.0, 1.0], 5.0),
            ([2, -5, 0], [0.75, 0.25, 0.0], 25.0),
            ([-1, 4, 0], [0.5, 0.0, 0.5], 1.0),
            ([6, 6, 1], [0.0, 0.5, 0.5], 9.0),
            ([2, 4, -7], [0.25, 0.25, 0.5], 49.0),
        ];
        for (p, weights, distance2) in cases {
            assert_eq!(nearest(triangle, p), (weights, distance2), "{p:?}");
        }
    }

    proptest! {
        #[test]
        fn no_other_point_of_the_triangle_is_nearer(
            corners in prop::array::uniform3(prop::array::uniform3(-50i64..50)),
            p in prop::array::uniform3(-80i64..80),
        ) {
            let (found, distance2) = nearest(corners, p);
            prop_assert!(found.iter().all(|w| (0.0..=1.0).contains(w)));
            for i in 0..=20 {
                for j in 0..=20 - i {
                    let w = [f64::from(20 - i - j), f64::from(i), f64::from(j)].map(|w| w / 20.0);
                    let other: f64 = (0..3)
                        .map(|k| (0..3).map(|c| w[c] * (corners[c][k] - p[k]) as f64).sum::<f64>())
                        .map(|d| d * d)
                        .sum();
                    prop_assert!(distance2 <= other + 1e-6, "{w:?}: {other} < {distance2}");
                }
            }
        }
    }
}
