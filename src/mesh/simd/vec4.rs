//! Vectors that all machines of a kind have: SSE's on x86-64, NEON's on aarch64.

use super::lanes::{Compress, F32s, Floats, Lanes};
use super::{HAS_FMA, PLACES, Plain};
use glam::{BVec4A, Vec4};
use std::ops::{Add, Div, Mul, Sub};

/// Eight lanes of `f32`, as two times four. The lesser or greater of two is that of numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vec4x2([Vec4; 2]);

impl Vec4x2 {
    #[inline(always)]
    fn each(self, other: Self, f: impl Fn(Vec4, Vec4) -> Vec4) -> Self {
        let ([a, b], [c, d]) = (self.0, other.0);
        Self([f(a, c), f(b, d)])
    }
}

macro_rules! operators {
    ($($trait:ident::$name:ident),*) => {
        $(impl $trait for Vec4x2 {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.each(other, Vec4::$name)
            }
        })*
    };
}
operators!(Add::add, Sub::sub, Mul::mul, Div::div);

impl Lanes for Vec4x2 {
    type Token = ();
    type Element = f32;
    type Array = [f32; 8];
    type Mask = [BVec4A; 2];
    const LANES: usize = 8;
    #[inline(always)]
    fn load((): (), list: &[f32]) -> Self {
        Self([Vec4::from_slice(&list[..4]), Vec4::from_slice(&list[4..8])])
    }
    #[inline(always)]
    fn splat((): (), x: f32) -> Self {
        Self([Vec4::splat(x); 2])
    }
    #[inline(always)]
    fn to_array(self) -> [f32; 8] {
        bytemuck::cast(self.0)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.each(other, Vec4::min)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.each(other, Vec4::max)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> [BVec4A; 2] {
        [self.0[0].cmplt(other.0[0]), self.0[1].cmplt(other.0[1])]
    }
    #[inline(always)]
    fn eq(self, other: Self) -> [BVec4A; 2] {
        [self.0[0].cmpeq(other.0[0]), self.0[1].cmpeq(other.0[1])]
    }
    #[inline(always)]
    fn bitmask(mask: [BVec4A; 2]) -> u32 {
        mask[0].bitmask() | mask[1].bitmask() << 4
    }
}

impl Floats for Vec4x2 {
    #[inline(always)]
    fn mul_add(self, factor: Self, more: Self) -> Self {
        let ([a, b], [c, d], [e, f]) = (self.0, factor.0, more.0);
        Self([a.mul_add(c, e), b.mul_add(d, f)])
    }
    #[inline(always)]
    fn fast_mul_add(self, factor: Self, more: Self) -> Self {
        if HAS_FMA { self.mul_add(factor, more) } else { self * factor + more }
    }
    #[inline(always)]
    fn select(mask: [BVec4A; 2], set: Self, unset: Self) -> Self {
        let ([a, b], [c, d]) = (set.0, unset.0);
        Self([Vec4::select(mask[0], a, c), Vec4::select(mask[1], b, d)])
    }
}

impl Compress for Vec4x2 {
    #[inline(always)]
    fn compress(self, bits: u32) -> [f32; 8] {
        let lanes = self.to_array();
        PLACES[bits as usize & 0xff].map(|place| lanes[usize::from(place) % 8])
    }
}

impl F32s for Vec4x2 {
    type U32s = Plain<u32, 8>;
    #[inline(always)]
    fn neg_mul_add(self, factor: Self, more: Self) -> Self {
        let [a, b] = self.0;
        Self([-a, -b]).mul_add(factor, more)
    }
    #[inline(always)]
    fn fast_neg_mul_add(self, factor: Self, more: Self) -> Self {
        if HAS_FMA { self.neg_mul_add(factor, more) } else { more - self * factor }
    }
    #[inline(always)]
    fn reduce_min(self) -> Self {
        Self([Vec4::splat(self.0[0].min(self.0[1]).min_element()); 2])
    }
}
