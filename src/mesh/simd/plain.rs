//! Lanes everywhere.

use super::HAS_FMA;
use super::lanes::{Compress, F32x16s, F64s, F64x4s, Floats, Lanes, U32x16s};
use std::ops::{Add, BitAnd, Div, Mul, Shl, Shr, Sub};

/// Any number of lanes, as an array.
#[derive(Clone, Copy)]
pub struct Plain<T, const N: usize>([T; N]);

// Loops over arrays in place: these the compiler turns into what vectors there are.
impl<T: Copy, const N: usize> Plain<T, N> {
    #[inline(always)]
    fn each<U: Copy + Default>(self, f: impl Fn(T) -> U) -> Plain<U, N> {
        let mut out = [U::default(); N];
        out.iter_mut().zip(self.0).for_each(|(out, x)| *out = f(x));
        Plain(out)
    }
    #[inline(always)]
    fn pairs(mut self, other: Self, f: impl Fn(T, T) -> T) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a = f(*a, b));
        self
    }
}

macro_rules! plain {
    ($t:ty, $bits:ty, add $add:expr, sub $sub:expr, mul $mul:expr) => {
        plain!(@operator $t, Add::add, $add);
        plain!(@operator $t, Sub::sub, $sub);
        plain!(@operator $t, Mul::mul, $mul);

        impl<const N: usize> Plain<$t, N> {
            /// All bits where it holds, else none.
            #[inline(always)]
            fn mask(self, other: Self, f: impl Fn($t, $t) -> bool) -> [$bits; N] {
                let mut out = [0; N];
                for (out, (a, b)) in out.iter_mut().zip(self.0.into_iter().zip(other.0)) {
                    *out = <$bits>::MIN.wrapping_sub(<$bits>::from(f(a, b)));
                }
                out
            }
        }

        impl<const N: usize> Lanes for Plain<$t, N> {
            type Token = ();
            type Element = $t;
            type Array = [$t; N];
            type Mask = [$bits; N];
            const LANES: usize = N;
            #[inline(always)]
            fn load((): (), list: &[$t]) -> Self {
                Self(*list.first_chunk().expect("so many are there"))
            }
            #[inline(always)]
            fn splat((): (), x: $t) -> Self {
                Self([x; N])
            }
            #[inline(always)]
            fn to_array(self) -> [$t; N] {
                self.0
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                self.pairs(other, |a, b| if a < b { a } else { b })
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                self.pairs(other, |a, b| if a > b { a } else { b })
            }
            #[inline(always)]
            fn lt(self, other: Self) -> Self::Mask {
                self.mask(other, |a, b| a < b)
            }
            #[inline(always)]
            fn eq(self, other: Self) -> Self::Mask {
                self.mask(other, |a, b| a == b)
            }
            #[inline(always)]
            fn bitmask(mask: Self::Mask) -> u32 {
                mask.into_iter().enumerate().fold(0, |bits, (k, lane)| bits | lane as u32 & 1 << k)
            }
        }
    };
    (@operator $t:ty, $trait:ident::$name:ident, $f:expr) => {
        impl<const N: usize> $trait for Plain<$t, N> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.pairs(other, $f)
            }
        }
    };
}

macro_rules! floats {
    ($t:ty, $bits:ty) => {
        plain!($t, $bits, add |a, b| a + b, sub |a, b| a - b, mul |a, b| a * b);
        plain!(@operator $t, Div::div, |a, b| a / b);

        impl<const N: usize> Floats for Plain<$t, N> {
            #[inline(always)]
            fn mul_add(mut self, factor: Self, more: Self) -> Self {
                for (a, (b, c)) in self.0.iter_mut().zip(factor.0.into_iter().zip(more.0)) {
                    *a = a.mul_add(b, c);
                }
                self
            }
            #[inline(always)]
            fn fast_mul_add(self, factor: Self, more: Self) -> Self {
                if HAS_FMA { self.mul_add(factor, more) } else { self * factor + more }
            }
            #[inline(always)]
            fn select(mask: Self::Mask, set: Self, mut unset: Self) -> Self {
                for (x, (set, mask)) in unset.0.iter_mut().zip(set.0.into_iter().zip(mask)) {
                    *x = <$t>::from_bits(set.to_bits() & mask | x.to_bits() & !mask);
                }
                unset
            }
        }
    };
}

floats!(f32, u32);
floats!(f64, u64);
plain!(u32, u32, add u32::wrapping_add, sub u32::wrapping_sub, mul u32::wrapping_mul);
plain!(@operator u32, BitAnd::bitand, |a, b| a & b);

impl<const N: usize> F64s for Plain<f64, N> {
    type Narrow = [f32; N];
    #[inline(always)]
    fn from_f32((): (), list: &[f32]) -> Self {
        let narrow: &[f32; N] = list.first_chunk().expect("so many are there");
        Self(narrow.map(f64::from))
    }
    #[inline(always)]
    fn to_f32(self) -> [f32; N] {
        self.0.map(|x| x as f32)
    }
    #[inline(always)]
    fn min_f32((): (), a: &[f32; N], b: &[f32; N]) -> [f32; N] {
        Plain(*a).min(Plain(*b)).0
    }
    #[inline(always)]
    fn max_f32((): (), a: &[f32; N], b: &[f32; N]) -> [f32; N] {
        Plain(*a).max(Plain(*b)).0
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.each(f64::sqrt)
    }
    #[inline(always)]
    fn floor(self) -> Self {
        self.each(f64::floor)
    }
}

impl F64x4s for Plain<f64, 4> {
    #[inline(always)]
    fn transpose(rows: [Self; 4]) -> [Self; 4] {
        [0, 1, 2, 3].map(|k| Self(rows.map(|r| r.0[k])))
    }
}

impl<T: Copy + Default, const N: usize> Compress for Plain<T, N>
where
    Self: Lanes<Array = [T; N]>,
{
    #[inline(always)]
    fn compress(self, mut bits: u32) -> [T; N] {
        let (mut out, mut len) = ([T::default(); N], 0);
        while bits != 0 {
            out[len % N] = self.0[bits.trailing_zeros() as usize % N];
            len += 1;
            bits &= bits - 1;
        }
        out
    }
}

impl<const N: usize> Shl<u32> for Plain<u32, N> {
    type Output = Self;
    #[inline(always)]
    fn shl(self, bits: u32) -> Self {
        self.each(|x| x << bits)
    }
}

impl<const N: usize> Shr<u32> for Plain<u32, N> {
    type Output = Self;
    #[inline(always)]
    fn shr(self, bits: u32) -> Self {
        self.each(|x| x >> bits)
    }
}

impl F32x16s for Plain<f32, 16> {
    type U32s = Plain<u32, 16>;
    #[inline(always)]
    fn permute(self, numbers: Plain<u32, 16>) -> Self {
        numbers.each(|n| self.0[n as usize % 16])
    }
    #[inline(always)]
    fn from_i32(numbers: Plain<u32, 16>) -> Self {
        numbers.each(|x| x as i32 as f32)
    }
    #[inline(always)]
    fn to_i32(self) -> Plain<u32, 16> {
        self.each(|x| x as i32 as u32)
    }
}

impl U32x16s for Plain<u32, 16> {
    #[inline(always)]
    fn from_rows((): (), mut row: impl FnMut(usize) -> [u32; 3]) -> [Self; 3] {
        let [mut x, mut y, mut z] = [[0; 16]; 3];
        for (n, ((x, y), z)) in x.iter_mut().zip(&mut y).zip(&mut z).enumerate() {
            [*x, *y, *z] = row(n);
        }
        [x, y, z].map(Self)
    }
    #[inline(always)]
    fn permute(self, numbers: Self) -> Self {
        numbers.each(|n| self.0[n as usize % 16])
    }
}
