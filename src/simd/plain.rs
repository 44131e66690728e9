//! Lanes everywhere.

use super::lanes::{F64s, F64x4s, Floats, Lanes};
use std::ops::{Add, Div, Mul, Sub};

/// Any number of lanes, as an array.
#[derive(Clone, Copy)]
pub(crate) struct Plain<T, const N: usize>([T; N]);

// Loops over arrays in place: these the compiler turns into what vectors there are.
impl<T: Copy, const N: usize> Plain<T, N> {
    #[inline(always)]
    fn each(mut self, f: impl Fn(T) -> T) -> Self {
        self.0.iter_mut().for_each(|x| *x = f(*x));
        self
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
            fn select(mask: Self::Mask, set: Self, mut unset: Self) -> Self {
                for (x, (set, mask)) in unset.0.iter_mut().zip(set.0.into_iter().zip(mask)) {
                    *x = <$t>::from_bits(set.to_bits() & mask | x.to_bits() & !mask);
                }
                unset
            }
        }
    };
}

floats!(f64, u64);

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
