//! A tetrahedron as four vertex numbers, the form in which each has one order of them, and the one
//! rule that says when it is active.

/// Four vertex numbers, positively oriented: `det(b - a, c - a, d - a) > 0`.
pub type Tet = [u32; 4];

/// The same tetrahedron, its smallest vertex first, the smallest of the others second, the
/// orientation kept.
#[inline]
pub fn canonical(t: Tet) -> Tet {
    // The place of the least by comparing (vertex, place): no branch, for none could be predicted.
    // Two swaps at once are an even permutation.
    const EVEN: [[u8; 4]; 4] = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]];
    const TURNS: [[u8; 3]; 4] = [[0; 3], [1, 2, 3], [2, 3, 1], [3, 1, 2]];
    let placed = |t: Tet, i: usize| u64::from(t[i]) << 2 | i as u64;
    let least = placed(t, 0).min(placed(t, 1)).min(placed(t, 2).min(placed(t, 3)));
    let [a, b, c, d] = EVEN[(least & 3) as usize].map(|i| t[usize::from(i)]);
    let t = [a, b, c, d];
    let second = placed(t, 1).min(placed(t, 2)).min(placed(t, 3));
    let [b, c, d] = TURNS[(second & 3) as usize].map(|i| t[usize::from(i)]);
    [a, b, c, d]
}

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

/// Whether a cell of value range `(lo, hi)` is crossed by the isosurface: some corner is outside
/// (`< isovalue`) and some corner is inside (`>= isovalue`). The index, the count and the
/// extraction all use this rule.
#[inline]
pub fn is_active(lo: f32, hi: f32, isovalue: f32) -> bool {
    lo < isovalue && isovalue <= hi
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sign of a permutation of distinct numbers.
    fn parity(t: Tet) -> bool {
        let mut odd = false;
        for i in 0..4 {
            for j in i + 1..4 {
                odd ^= t[i] > t[j];
            }
        }
        odd
    }

    #[test]
    fn canonical_keeps_the_orientation() {
        for code in 0..256u32 {
            let t: Tet = std::array::from_fn(|i| code >> (2 * i) & 3);
            if (0..4).all(|v| t.contains(&v)) {
                let c = canonical(t);
                assert_eq!((c[0], c[1], parity(c)), (0, 1, parity(t)), "{t:?}");
            }
        }
    }
}
