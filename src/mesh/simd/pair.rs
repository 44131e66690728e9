//! Two vectors as one.

use super::lanes::{Floats, Lanes};
use std::ops::{Add, BitAnd, Div, Mul, Shl, Shr, Sub};

/// Twice as many lanes.
#[derive(Clone, Copy)]
pub struct Pair<V>(pub(super) V, pub(super) V);

/// The lanes of a pair as an array.
pub trait Half: Lanes {
    type Double: bytemuck::Pod + AsRef<[Self::Element]>;
}

macro_rules! operators {
    ($($trait:ident::$name:ident),*) => {
        $(impl<V: $trait<Output = V>> $trait for Pair<V> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(self.0.$name(other.0), self.1.$name(other.1))
            }
        })*
    };
}
operators!(Add::add, Sub::sub, Mul::mul, Div::div, BitAnd::bitand);

impl<V: Shl<u32, Output = V>> Shl<u32> for Pair<V> {
    type Output = Self;
    #[inline(always)]
    fn shl(self, bits: u32) -> Self {
        Self(self.0 << bits, self.1 << bits)
    }
}

impl<V: Shr<u32, Output = V>> Shr<u32> for Pair<V> {
    type Output = Self;
    #[inline(always)]
    fn shr(self, bits: u32) -> Self {
        Self(self.0 >> bits, self.1 >> bits)
    }
}

impl<V: Half> Lanes for Pair<V> {
    type Token = V::Token;
    type Element = V::Element;
    type Array = V::Double;
    type Mask = (V::Mask, V::Mask);
    const LANES: usize = 2 * V::LANES;
    #[inline(always)]
    fn load(token: V::Token, list: &[V::Element]) -> Self {
        Self(V::load(token, list), V::load(token, &list[V::LANES..]))
    }
    #[inline(always)]
    fn splat(token: V::Token, x: V::Element) -> Self {
        let all = V::splat(token, x);
        Self(all, all)
    }
    #[inline(always)]
    fn to_array(self) -> V::Double {
        bytemuck::cast([self.0.to_array(), self.1.to_array()])
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0), self.1.min(other.1))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0), self.1.max(other.1))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self::Mask {
        (self.0.lt(other.0), self.1.lt(other.1))
    }
    #[inline(always)]
    fn eq(self, other: Self) -> Self::Mask {
        (self.0.eq(other.0), self.1.eq(other.1))
    }
    #[inline(always)]
    fn bitmask(mask: Self::Mask) -> u32 {
        V::bitmask(mask.0) | V::bitmask(mask.1) << V::LANES
    }
}

impl<V: Half + Floats> Floats for Pair<V> {
    #[inline(always)]
    fn mul_add(self, factor: Self, more: Self) -> Self {
        Self(self.0.mul_add(factor.0, more.0), self.1.mul_add(factor.1, more.1))
    }
    #[inline(always)]
    fn select(mask: Self::Mask, set: Self, unset: Self) -> Self {
        Self(V::select(mask.0, set.0, unset.0), V::select(mask.1, set.1, unset.1))
    }
}
