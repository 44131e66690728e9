//! Vectors that stars are closed with.

use crate::simd::{F32s, F64s, Plain, Vec4x2};
#[cfg(target_arch = "x86_64")]
use crate::simd::{F32x8, F32x16, F64x4, F64x8};

/// Lanes of `f32`, and half as many of `f64`.
pub(super) trait Batch: F32s {
    type Doubles: F64s<Token = Self::Token>;
    /// Whether there are registers for the points nearby.
    const HOLDS: bool;
}

impl Batch for Vec4x2 {
    type Doubles = Plain<f64, 4>;
    const HOLDS: bool = false;
}

#[cfg(target_arch = "x86_64")]
impl Batch for F32x8 {
    type Doubles = F64x4;
    const HOLDS: bool = false;
}

#[cfg(target_arch = "x86_64")]
impl Batch for F32x16 {
    type Doubles = F64x8;
    const HOLDS: bool = true;
}
