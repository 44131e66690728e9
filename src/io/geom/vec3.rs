//! Products of vectors of three numbers. The order of operations is fixed, so the bits are the same
//! on every machine.

use std::ops::{Add, Mul, Sub};

/// `a - b`.
#[inline(always)]
pub fn minus<T: Copy + Sub<Output = T>>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a - b`, exactly where it is less than 2^53.
#[inline(always)]
pub fn difference(a: [i64; 3], b: [i64; 3]) -> [f64; 3] {
    minus(a, b).map(|c| c as f64)
}

/// `a · b`, summed from x to z.
#[inline(always)]
pub fn dot<T: Copy + Add<Output = T> + Mul<Output = T>>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`.
#[inline(always)]
pub fn cross<T: Copy + Sub<Output = T> + Mul<Output = T>>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
