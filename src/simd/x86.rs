//! Vectors of AVX2 and AVX-512.
//!
//! **Safety.** A vector of a type below is made from a token, or from other such vectors. So
//! wherever there is one, the machine has the instructions. That is why each operation may call
//! its intrinsic; `load` and `store` also have as many numbers in memory as there are lanes.
#![allow(unsafe_code)]

use super::lanes::{F64s, F64x4s, Floats, Lanes};
use super::pair::{Half, Pair};
use super::{Avx2, Avx512};
use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Sub};

/// One vector type: each operation is one intrinsic.
macro_rules! lanes {
    (
        $(#[$doc:meta])*
        $name:ident: $array:ty, $register:ty, $token:ty, $mask:ty;
        load($from:ident) = $load:expr;
        store($to:ident, $all:ident) = $store:expr;
        splat($one:ident) = $splat:expr;
        operators: $($trait:ident::$operator:ident = $op:path),*;
        min = $min:path, max = $max:path;
        lt($a:ident, $b:ident) = $lt:expr;
        eq($c:ident, $d:ident) = $eq:expr;
        bitmask($bits:ident) = $bitmask:expr;
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct $name($register);

        $(impl $trait for $name {
            type Output = Self;
            #[inline(always)]
            fn $operator(self, other: Self) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $op(self.0, other.0) })
            }
        })*

        impl Lanes for $name {
            type Token = $token;
            type Element = <$array as IntoIterator>::Item;
            type Array = $array;
            type Mask = $mask;
            const LANES: usize = size_of::<$array>() / size_of::<Self::Element>();
            #[inline(always)]
            fn load(_: $token, list: &[Self::Element]) -> Self {
                let all: &$array = list.first_chunk().expect("so many are there");
                let $from = all.as_ptr();
                // SAFETY: the machine has the instruction, and the array has all lanes.
                Self(unsafe { $load })
            }
            #[inline(always)]
            fn splat(_: $token, $one: Self::Element) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $splat })
            }
            #[inline(always)]
            fn to_array(self) -> $array {
                let mut out: $array = bytemuck::Zeroable::zeroed();
                let ($to, $all) = (out.as_mut_ptr(), self.0);
                // SAFETY: the machine has the instruction, and the array has room for all lanes.
                unsafe { $store };
                out
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $min(self.0, other.0) })
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $max(self.0, other.0) })
            }
            #[inline(always)]
            fn lt(self, other: Self) -> $mask {
                let ($a, $b) = (self.0, other.0);
                // SAFETY: the machine has the instruction.
                unsafe { $lt }
            }
            #[inline(always)]
            fn eq(self, other: Self) -> $mask {
                let ($c, $d) = (self.0, other.0);
                // SAFETY: the machine has the instruction.
                unsafe { $eq }
            }
            #[inline(always)]
            #[allow(unused_unsafe, reason = "masks of AVX-512 are numbers")]
            fn bitmask($bits: $mask) -> u32 {
                // SAFETY: the mask was made of vectors, so the machine has the instruction.
                unsafe { $bitmask }
            }
        }
    };
}

macro_rules! floats {
    ($name:ident: mul_add = $mul_add:path; select($mask:ident, $set:ident, $unset:ident) = $select:expr;) => {
        impl Floats for $name {
            #[inline(always)]
            fn mul_add(self, factor: Self, more: Self) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $mul_add(self.0, factor.0, more.0) })
            }
            #[inline(always)]
            fn select($mask: Self::Mask, Self($set): Self, Self($unset): Self) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $select })
            }
        }
    };
}

macro_rules! f64s {
    ($name:ident: $narrow:ty; load = $load:path, widen = $widen:path, narrow = $to:path, sqrt = $sqrt:path, floor = $floor:path) => {
        impl F64s for $name {
            type Narrow = $narrow;
            #[inline(always)]
            fn from_f32(_: Self::Token, list: &[f32]) -> Self {
                let narrow: &$narrow = list.first_chunk().expect("so many are there");
                // SAFETY: the machine has the instructions, and the array has all lanes.
                Self(unsafe { $widen($load(narrow.as_ptr())) })
            }
            #[inline(always)]
            fn to_f32(self) -> $narrow {
                // SAFETY: the machine has the instruction.
                bytemuck::cast(unsafe { $to(self.0) })
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $sqrt(self.0) })
            }
            #[inline(always)]
            fn floor(self) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $floor(self.0) })
            }
        }
    };
}

lanes! {
    /// Four `f64` of AVX2.
    F64x4: [f64; 4], __m256d, Avx2, __m256d;
    load(from) = _mm256_loadu_pd(from);
    store(to, all) = _mm256_storeu_pd(to, all);
    splat(x) = _mm256_set1_pd(x);
    operators: Add::add = _mm256_add_pd, Sub::sub = _mm256_sub_pd, Mul::mul = _mm256_mul_pd, Div::div = _mm256_div_pd;
    min = _mm256_min_pd, max = _mm256_max_pd;
    lt(a, b) = _mm256_cmp_pd::<_CMP_LT_OQ>(a, b);
    eq(a, b) = _mm256_cmp_pd::<_CMP_EQ_OQ>(a, b);
    bitmask(mask) = _mm256_movemask_pd(mask) as u32;
}
floats! {
    F64x4: mul_add = _mm256_fmadd_pd;
    select(mask, set, unset) = _mm256_blendv_pd(unset, set, mask);
}
f64s! {
    F64x4: [f32; 4];
    load = _mm_loadu_ps, widen = _mm256_cvtps_pd, narrow = _mm256_cvtpd_ps,
    sqrt = _mm256_sqrt_pd, floor = _mm256_floor_pd
}

lanes! {
    /// Eight `f64` of AVX-512.
    F64x8: [f64; 8], __m512d, Avx512, __mmask8;
    load(from) = _mm512_loadu_pd(from);
    store(to, all) = _mm512_storeu_pd(to, all);
    splat(x) = _mm512_set1_pd(x);
    operators: Add::add = _mm512_add_pd, Sub::sub = _mm512_sub_pd, Mul::mul = _mm512_mul_pd, Div::div = _mm512_div_pd;
    min = _mm512_min_pd, max = _mm512_max_pd;
    lt(a, b) = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b);
    eq(a, b) = _mm512_cmp_pd_mask::<_CMP_EQ_OQ>(a, b);
    bitmask(mask) = mask.into();
}
floats! {
    F64x8: mul_add = _mm512_fmadd_pd;
    select(mask, set, unset) = _mm512_mask_blend_pd(mask, unset, set);
}
f64s! {
    F64x8: [f32; 8];
    load = _mm256_loadu_ps, widen = _mm512_cvtps_pd, narrow = _mm512_cvtpd_ps,
    sqrt = _mm512_sqrt_pd, floor = _mm512_roundscale_pd::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>
}

impl F64x4s for F64x4 {
    #[inline(always)]
    fn transpose([a, b, c, d]: [Self; 4]) -> [Self; 4] {
        // SAFETY: the machine has AVX2.
        unsafe {
            let (ab, cd) = (_mm256_unpacklo_pd(a.0, b.0), _mm256_unpacklo_pd(c.0, d.0));
            let (ab_odd, cd_odd) = (_mm256_unpackhi_pd(a.0, b.0), _mm256_unpackhi_pd(c.0, d.0));
            [
                Self(_mm256_permute2f128_pd::<0x20>(ab, cd)),
                Self(_mm256_permute2f128_pd::<0x20>(ab_odd, cd_odd)),
                Self(_mm256_permute2f128_pd::<0x31>(ab, cd)),
                Self(_mm256_permute2f128_pd::<0x31>(ab_odd, cd_odd)),
            ]
        }
    }
}

impl Half for F64x4 {
    type Double = [f64; 8];
}

impl F64s for Pair<F64x4> {
    type Narrow = [f32; 8];
    #[inline(always)]
    fn from_f32(token: Avx2, list: &[f32]) -> Self {
        Self(F64x4::from_f32(token, list), F64x4::from_f32(token, &list[4..]))
    }
    #[inline(always)]
    fn to_f32(self) -> [f32; 8] {
        bytemuck::cast([self.0.to_f32(), self.1.to_f32()])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt(), self.1.sqrt())
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(self.0.floor(), self.1.floor())
    }
}

/// Eight rows as eight columns: bits are moved, and nothing else. The compiler would make gathers
/// of a loop over such.
#[inline(always)]
pub(crate) fn transpose_f32x8(_: Avx2, rows: [&[f32; 8]; 8]) -> [[f32; 8]; 8] {
    // SAFETY: the machine has AVX2, and each row has eight numbers.
    unsafe {
        let [a, b, c, d, e, f, g, h] = [
            _mm256_loadu_ps(rows[0].as_ptr()),
            _mm256_loadu_ps(rows[1].as_ptr()),
            _mm256_loadu_ps(rows[2].as_ptr()),
            _mm256_loadu_ps(rows[3].as_ptr()),
            _mm256_loadu_ps(rows[4].as_ptr()),
            _mm256_loadu_ps(rows[5].as_ptr()),
            _mm256_loadu_ps(rows[6].as_ptr()),
            _mm256_loadu_ps(rows[7].as_ptr()),
        ];
        let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
        let (ef, gh) = (_mm256_unpacklo_ps(e, f), _mm256_unpacklo_ps(g, h));
        let (ab_high, cd_high) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
        let (ef_high, gh_high) = (_mm256_unpackhi_ps(e, f), _mm256_unpackhi_ps(g, h));
        // Columns 0 and 4, 1 and 5, 2 and 6, 3 and 7: of the first four rows, of the last four.
        let (x0, y0) = (_mm256_shuffle_ps::<0x44>(ab, cd), _mm256_shuffle_ps::<0x44>(ef, gh));
        let (x1, y1) = (_mm256_shuffle_ps::<0xee>(ab, cd), _mm256_shuffle_ps::<0xee>(ef, gh));
        let (x2, y2) =
            (_mm256_shuffle_ps::<0x44>(ab_high, cd_high), _mm256_shuffle_ps::<0x44>(ef_high, gh_high));
        let (x3, y3) =
            (_mm256_shuffle_ps::<0xee>(ab_high, cd_high), _mm256_shuffle_ps::<0xee>(ef_high, gh_high));
        [
            bytemuck::cast(_mm256_permute2f128_ps::<0x20>(x0, y0)),
            bytemuck::cast(_mm256_permute2f128_ps::<0x20>(x1, y1)),
            bytemuck::cast(_mm256_permute2f128_ps::<0x20>(x2, y2)),
            bytemuck::cast(_mm256_permute2f128_ps::<0x20>(x3, y3)),
            bytemuck::cast(_mm256_permute2f128_ps::<0x31>(x0, y0)),
            bytemuck::cast(_mm256_permute2f128_ps::<0x31>(x1, y1)),
            bytemuck::cast(_mm256_permute2f128_ps::<0x31>(x2, y2)),
            bytemuck::cast(_mm256_permute2f128_ps::<0x31>(x3, y3)),
        ]
    }
}
