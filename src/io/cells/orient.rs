//! Which way a tetrahedron is turned, once the positions of its vertices are known.
//!
//! The sign of six times the volume, by exact-enough arithmetic: a determinant of differences in
//! `f64`, against a bound of its rounding error (Shewchuk's static filter for `orient3d`). A
//! tetrahedron within the bound is *degenerate*: its volume may be none, and no point can be
//! located in it.

/// How a tetrahedron is turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orientation {
    /// Positive: `det(b - a, c - a, d - a) > 0`.
    Positive,
    /// Negative: swapping two vertices makes it positive.
    Inverted,
    /// Flat, as far as `f64` can tell.
    Degenerate,
}

/// Shewchuk's bound for `orient3d`: (7 + 56 ε) ε, with ε = 2^-53.
const ERROR: f64 = 7.771_561_172_376_103e-16;

/// How the tetrahedron of four positions is turned.
pub fn orient(p: [[f64; 3]; 4]) -> Orientation {
    let d: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|a| p[i + 1][a] - p[0][a]));
    let product = |i: usize, j: usize, k: usize| d[0][i] * d[1][j] * d[2][k];
    let plus = [product(0, 1, 2), product(1, 2, 0), product(2, 0, 1)];
    let minus = [product(0, 2, 1), product(1, 0, 2), product(2, 1, 0)];
    let det: f64 = plus.iter().sum::<f64>() - minus.iter().sum::<f64>();
    let size: f64 = plus.iter().chain(&minus).map(|x| x.abs()).sum();
    if det.abs() <= ERROR * size {
        Orientation::Degenerate
    } else if det > 0.0 {
        Orientation::Positive
    } else {
        Orientation::Inverted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNER: [[f64; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    #[test]
    fn signs() {
        assert_eq!(orient(CORNER), Orientation::Positive);
        let [a, b, c, d] = CORNER;
        assert_eq!(orient([a, c, b, d]), Orientation::Inverted);
        assert_eq!(orient([a, b, c, [0.3, 0.3, 0.0]]), Orientation::Degenerate);
        assert_eq!(orient([a, b, b, d]), Orientation::Degenerate);
    }

    #[test]
    fn small_is_not_flat() {
        let shrink = |p: [f64; 3]| p.map(|x| 100.0 + x * 1e-9);
        assert_eq!(orient(CORNER.map(shrink)), Orientation::Positive);
        // Four points of a plane in general position: rounding alone decides, and is not believed.
        let on = |u: f64, v: f64| [0.1 + u * 0.7 + v * 0.3, 0.2 - u * 0.9, 0.3 + v * 1.1];
        let flat = [on(0.0, 0.0), on(1.3, 0.1), on(0.4, 0.9), on(0.77, 0.31)];
        assert_eq!(orient(flat), Orientation::Degenerate);
    }
}
