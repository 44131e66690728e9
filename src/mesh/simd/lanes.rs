//! What lanes can do.

use bytemuck::Pod;
use std::ops::{Add, BitAnd, Div, Mul, Shl, Shr, Sub};

/// Some numbers at a time. Each operation is that of each lane by itself, rounded once; sums,
/// differences and products of integers wrap around.
pub trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// What must be known before there are such lanes.
    type Token: Copy;
    /// The number of a lane.
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
    /// A number in every lane.
    fn splat(token: Self::Token, x: Self::Element) -> Self;
    /// The numbers, lane after lane.
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

    /// Overwrites the first numbers of a list.
    ///
    /// # Panics
    /// When the list is shorter.
    #[inline(always)]
    fn store(self, list: &mut [Self::Element]) {
        list[..Self::LANES].copy_from_slice(self.to_array().as_ref());
    }
}

/// Lanes of floating-point numbers.
pub trait Floats: Lanes + Div<Output = Self> {
    /// This times the factor, plus the other: rounded once.
    fn mul_add(self, factor: Self, more: Self) -> Self;
    /// As [`Floats::mul_add`], rounded once or twice, as is faster on this machine: for guesses,
    /// and for proofs whose error bounds hold for both.
    #[inline(always)]
    fn fast_mul_add(self, factor: Self, more: Self) -> Self {
        self.mul_add(factor, more)
    }
    /// The one number where a mask is set, else the other.
    fn select(mask: Self::Mask, set: Self, unset: Self) -> Self;
}

/// Lanes of `f64`, from `f32` and back.
pub trait F64s: Floats<Element = f64> {
    /// An array of as many `f32`.
    type Narrow: Pod + AsRef<[f32]>;
    /// The first numbers of a list, as many as there are lanes.
    fn from_f32(token: Self::Token, list: &[f32]) -> Self;
    /// Each rounded.
    fn to_f32(self) -> Self::Narrow;
    /// In each lane the first where it is less, else the second: a NaN that comes first changes
    /// nothing. (Of plain code with this result, compilers make masked stores, which are slow.)
    fn min_f32(token: Self::Token, a: &Self::Narrow, b: &Self::Narrow) -> Self::Narrow;
    /// In each lane the first where it is greater, else the second.
    fn max_f32(token: Self::Token, a: &Self::Narrow, b: &Self::Narrow) -> Self::Narrow;
    /// The square root of each lane.
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
pub trait F64xN<const N: usize>: F64s<Array = [f64; N], Narrow = [f32; N]> {}
impl<const N: usize, V: F64s<Array = [f64; N], Narrow = [f32; N]>> F64xN<N> for V {}

/// Four lanes of `f64`.
pub trait F64x4s: F64xN<4> {
    /// Four rows as four columns.
    fn transpose(rows: [Self; 4]) -> [Self; 4];
}

/// Lanes that can be packed.
pub trait Compress: Lanes {
    /// The lanes whose bits are set, in their order; then any numbers.
    fn compress(self, bits: u32) -> Self::Array;
}

/// Lanes of `f32`.
pub trait F32s: Floats<Element = f32> + Compress {
    /// As many `u32`.
    type U32s: Compress<Token = Self::Token, Element = u32>;
    /// The other, less this times the factor: rounded once.
    fn neg_mul_add(self, factor: Self, more: Self) -> Self;
    /// As [`F32s::neg_mul_add`], rounded once or twice, as [`Floats::fast_mul_add`].
    #[inline(always)]
    fn fast_neg_mul_add(self, factor: Self, more: Self) -> Self {
        self.neg_mul_add(factor, more)
    }
    /// The least lane, in all lanes.
    fn reduce_min(self) -> Self;
}

/// Sixteen lanes of `f32` that go together with sixteen of `u32`.
pub trait F32x16s: Floats<Element = f32, Array = [f32; 16]> {
    /// As many integers.
    type U32s: U32x16s<Token = Self::Token>;
    /// The lanes of these numbers; their lowest four bits count.
    fn permute(self, numbers: Self::U32s) -> Self;
    /// Numbers of `i32`, rounded.
    fn from_i32(numbers: Self::U32s) -> Self;
    /// As `i32`, fractions cut off. Numbers that are no `i32` give any one.
    fn to_i32(self) -> Self::U32s;

    /// This, but where the mask is set and the other is less, the other; of numbers.
    #[inline(always)]
    fn min_where(self, mask: Self::Mask, other: Self) -> Self {
        Self::select(mask, other.min(self), self)
    }
    /// This, but where the mask is set and the other is greater, the other; of numbers.
    #[inline(always)]
    fn max_where(self, mask: Self::Mask, other: Self) -> Self {
        Self::select(mask, other.max(self), self)
    }
}

/// Sixteen lanes of `u32`.
pub trait U32x16s:
    Compress<Element = u32, Array = [u32; 16]>
    + BitAnd<Output = Self>
    + Shl<u32, Output = Self>
    + Shr<u32, Output = Self>
{
    /// Sixteen rows as three columns.
    fn from_rows(token: Self::Token, row: impl FnMut(usize) -> [u32; 3]) -> [Self; 3];
    /// The lanes of these numbers; their lowest four bits count.
    fn permute(self, numbers: Self) -> Self;

    /// The greatest lane.
    #[inline(always)]
    fn reduce_max(self) -> u32 {
        self.to_array().into_iter().fold(0, u32::max)
    }
}
