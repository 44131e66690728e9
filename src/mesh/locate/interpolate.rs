//! Values in a tetrahedron from its corners (thesis, section 4.4).
//!
//! * **Linear**: Σ λ_i f_i.
//! * **Quadratic**: Σ φ_i f_i + Σ φ_ij f_ij with φ_i = 2λ_i(λ_i - ½), φ_ij = 4λ_iλ_j and the value
//!   at the middle of an edge taken from the gradients at its ends, f_ij = (f_i + f_j)/2 + (g_i -
//!   g_j)·(x_j - x_i)/8: a cubic's value there. Exact for quadratic fields where the gradients are.
//!   The same on both sides of a face, so continuous.
//! * **Quadratic of the thesis**: f_ij = (f_i + f_j)/2. Then Σ φ_i f_i + Σ φ_ij f_ij = Σ λ_i
//!   f_i·(2λ_i - 1 + 2(1 - λ_i)) = Σ λ_i f_i: it **is** linear, so the thesis could find no gain.
//!   It is here for its tables.
//!
//! A corner of weight zero does not count, whatever its value: a NaN beyond a face does not leak
//! across it.

/// A corner of a tetrahedron: what interpolation needs of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Corner {
    /// Position, in any unit.
    pub position: [f64; 3],
    /// The field's value.
    pub value: f64,
    /// Its gradient, in the value's unit by the position's.
    pub gradient: [f64; 3],
}

/// The six edges of a tetrahedron.
const EDGES: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

/// Linear interpolation with weights λ.
pub fn linear(weights: &[f64; 4], values: &[f64; 4]) -> f64 {
    (0..4).filter(|&i| weights[i] != 0.0).map(|i| weights[i] * values[i]).sum()
}

/// Quadratic interpolation with weights λ and the gradients at the corners.
pub fn quadratic(weights: &[f64; 4], corners: &[Corner; 4]) -> f64 {
    with_middles(weights, &corners.map(|c| c.value), |i, j| {
        let (a, b) = (&corners[i], &corners[j]);
        let along: f64 =
            (0..3).map(|k| (a.gradient[k] - b.gradient[k]) * (b.position[k] - a.position[k])).sum();
        (a.value + b.value) / 2.0 + along / 8.0
    })
}

/// The thesis's quadratic interpolation, which is linear.
pub fn quadratic_thesis(weights: &[f64; 4], values: &[f64; 4]) -> f64 {
    with_middles(weights, values, |i, j| (values[i] + values[j]) / 2.0)
}

fn with_middles(weights: &[f64; 4], values: &[f64; 4], middle: impl Fn(usize, usize) -> f64) -> f64 {
    let corners =
        (0..4).filter(|&i| weights[i] != 0.0).map(|i| 2.0 * weights[i] * (weights[i] - 0.5) * values[i]);
    let middles = EDGES
        .into_iter()
        .filter(|&(i, j)| weights[i] != 0.0 && weights[j] != 0.0)
        .map(|(i, j)| 4.0 * weights[i] * weights[j] * middle(i, j));
    corners.sum::<f64>() + middles.sum::<f64>()
}
