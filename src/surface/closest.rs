//! Which point of a triangle is nearest to a place?

use glam::DVec3;

/// The point of a triangle nearest to `p`: in the region of a corner, of an edge, or inside.
pub(crate) fn closest(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    if ab.cross(ac) == DVec3::ZERO {
        return closest_of_edges(p, [a, b, c]);
    }
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}

/// The point nearest to `p` on the edges of a triangle without area.
fn closest_of_edges(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let on = |u: DVec3, v: DVec3| {
        let along = v - u;
        let length = along.length_squared();
        if length == 0.0 { u } else { u + along * ((p - u).dot(along) / length).clamp(0.0, 1.0) }
    };
    let candidates = [on(a, b), on(b, c), on(c, a)];
    let distance = |q: &DVec3| (*q - p).length_squared();
    candidates.into_iter().min_by(|x, y| distance(x).total_cmp(&distance(y))).expect("three edges")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closest_point_is_never_beaten() {
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        };
        for round in 0..300 {
            let mut corners: [DVec3; 3] = std::array::from_fn(|_| DVec3::new(next(), next(), next()));
            if round % 10 == 0 {
                corners[2] = corners[0] + (corners[1] - corners[0]) * 0.5;
            }
            let p = DVec3::new(next(), next(), next()) * 2.0;
            let found = (closest(p, corners) - p).length();
            let mut best = f64::INFINITY;
            for i in 0..=60 {
                for j in 0..=60 - i {
                    let (u, v) = (f64::from(i) / 60.0, f64::from(j) / 60.0);
                    let q = corners[0] * (1.0 - u - v) + corners[1] * u + corners[2] * v;
                    best = best.min((q - p).length());
                }
            }
            assert!(found <= best + 1e-12 && best <= found + 0.1, "{found} {best}");
        }
    }
}
