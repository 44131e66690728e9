//! What lanes can do.

use bytemuck::Pod;
use std::ops::{Add, Div, Mul, Sub};

/// Some numbers at a time. Each operation is that of each lane by itself, rounded once; sums,
/// differences and products of integers wrap around.
pub(crate) trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// What must be known before there are such lanes.
    type Token: Copy;
    type Element: Pod;
    /// The lanes as an array.
    type Array: Pod + AsRef<[Self::Element]>;
    /// A bit for each lane, in some form.
    type Mask: Copy;
    /// The number of lanes.
    const LANES: usize;
    /// The first numbers of a list, as many as there are lanes.
    ///
    /// # Panics
    /// When the list is shorter.
    fn load(token: Self::Token, list: &[Self::Element]) -> Self;
    fn splat(token: Self::Token, x: Self::Element) -> Self;
    fn to_array(self) -> Self::Array;
    /// This where it is less, else the other.
    fn min(self, other: Self) -> Self;
    /// This where it is greater, else the other.
    fn max(self, other: Self) -> Self;
    /// Where this is less.
    fn lt(self, other: Self) -> Self::Mask;
    /// Where they are equal.
    fn eq(self, other: Self) -> Self::Mask;
    /// A mask as a number: bit k is that of lane k.
    fn bitmask(mask: Self::Mask) -> u32;
}

/// Lanes of floating-point numbers.
pub(crate) trait Floats: Lanes + Div<Output = Self> {
    /// This times the factor, plus the other: rounded once.
    fn mul_add(self, factor: Self, more: Self) -> Self;
    /// The one number where a mask is set, else the other.
    fn select(mask: Self::Mask, set: Self, unset: Self) -> Self;
}

/// Lanes of `f64`, from `f32` and back.
pub(crate) trait F64s: Floats<Element = f64> {
    /// An array of as many `f32`.
    type Narrow: Pod + AsRef<[f32]>;
    /// The first numbers of a list, as many as there are lanes.
    fn from_f32(token: Self::Token, list: &[f32]) -> Self;
    /// Each rounded.
    fn to_f32(self) -> Self::Narrow;
    fn sqrt(self) -> Self;
    /// The largest integer that is not above.
    fn floor(self) -> Self;

    /// Where this is not NaN.
    #[inline(always)]
    fn is_number(self) -> Self::Mask {
        self.eq(self)
    }
}

/// `N` lanes of `f64`.
pub(crate) trait F64xN<const N: usize>: F64s<Array = [f64; N], Narrow = [f32; N]> {}
impl<const N: usize, V: F64s<Array = [f64; N], Narrow = [f32; N]>> F64xN<N> for V {}

/// Four lanes of `f64`.
pub(crate) trait F64x4s: F64xN<4> {
    /// Four rows as four columns.
    fn transpose(rows: [Self; 4]) -> [Self; 4];
}
