//! A tetrahedron as four vertex numbers, and the one rule that says when it is active.

/// Four vertex numbers, positively oriented: `det(b - a, c - a, d - a) > 0`.
pub type Tet = [u32; 4];

/// The value range of four corner values; `None` for a void tetrahedron (a corner is NaN).
#[inline]
pub fn range(values: [f32; 4]) -> Option<(f32, f32)> {
    if values.iter().any(|v| v.is_nan()) {
        return None;
    }
    let lo = values[0].min(values[1]).min(values[2].min(values[3]));
    let hi = values[0].max(values[1]).max(values[2].max(values[3]));
    Some((lo, hi))
}

/// Whether a cell of value range `(lo, hi)` is crossed by the isosurface: some corner is outside (`< isovalue`) and some
/// corner is inside (`>= isovalue`). The index, the count and the extraction all use this rule.
#[inline]
pub fn is_active(lo: f32, hi: f32, isovalue: f32) -> bool {
    lo < isovalue && isovalue <= hi
}
