//! Vectors of AVX2 and AVX-512.
//!
//! **Safety.** A vector of a type below is made from a token, or from other such vectors. So
//! wherever there is one, the machine has the instructions. That is why each operation may call
//! its intrinsic; `load` and `store` also have as many numbers in memory as there are lanes.
#![allow(unsafe_code)]

use super::lanes::{Compress, F32s, F32x16s, F64s, F64x4s, Floats, Lanes, U32x16s};
use super::pair::{Half, Pair};
use super::{Avx2, Avx512, PLACES, four};
use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, Div, Mul, Shl, Shr, Sub};

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
        pub struct $name($register);

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
    ($name:ident: $narrow:ty; load = $load:path, widen = $widen:path, narrow = $to:path, min = $min:path, max = $max:path, sqrt = $sqrt:path, floor = $floor:path) => {
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
            fn min_f32(_: Self::Token, a: &$narrow, b: &$narrow) -> $narrow {
                // SAFETY: the machine has the instructions, and the arrays have all lanes.
                bytemuck::cast(unsafe { $min($load(a.as_ptr()), $load(b.as_ptr())) })
            }
            #[inline(always)]
            fn max_f32(_: Self::Token, a: &$narrow, b: &$narrow) -> $narrow {
                // SAFETY: the machine has the instructions, and the arrays have all lanes.
                bytemuck::cast(unsafe { $max($load(a.as_ptr()), $load(b.as_ptr())) })
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
    load = _mm_loadu_ps, widen = _mm256_cvtps_pd, narrow = _mm256_cvtpd_ps, min = _mm_min_ps, max = _mm_max_ps,
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
    load = _mm256_loadu_ps, widen = _mm512_cvtps_pd, narrow = _mm512_cvtpd_ps, min = _mm256_min_ps, max = _mm256_max_ps,
    sqrt = _mm512_sqrt_pd, floor = _mm512_roundscale_pd::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>
}

macro_rules! compress {
    ($name:ident($all:ident, $bits:ident) = $compress:expr) => {
        impl Compress for $name {
            #[inline(always)]
            fn compress(self, $bits: u32) -> Self::Array {
                let $all = self.0;
                // SAFETY: the machine has the instructions.
                Self(unsafe { $compress }).to_array()
            }
        }
    };
}

macro_rules! shifts {
    ($name:ident: $($trait:ident::$operator:ident = $op:path),*) => {
        $(impl $trait<u32> for $name {
            type Output = Self;
            #[inline(always)]
            fn $operator(self, bits: u32) -> Self {
                // SAFETY: the machine has the instruction.
                Self(unsafe { $op(self.0, _mm_cvtsi32_si128(bits as i32)) })
            }
        })*
    };
}

lanes! {
    /// Eight `f32` of AVX2.
    F32x8: [f32; 8], __m256, Avx2, __m256;
    load(from) = _mm256_loadu_ps(from);
    store(to, all) = _mm256_storeu_ps(to, all);
    splat(x) = _mm256_set1_ps(x);
    operators: Add::add = _mm256_add_ps, Sub::sub = _mm256_sub_ps, Mul::mul = _mm256_mul_ps, Div::div = _mm256_div_ps;
    min = _mm256_min_ps, max = _mm256_max_ps;
    lt(a, b) = _mm256_cmp_ps::<_CMP_LT_OQ>(a, b);
    eq(a, b) = _mm256_cmp_ps::<_CMP_EQ_OQ>(a, b);
    bitmask(mask) = _mm256_movemask_ps(mask) as u32;
}
floats! {
    F32x8: mul_add = _mm256_fmadd_ps;
    select(mask, set, unset) = _mm256_blendv_ps(unset, set, mask);
}
compress!(F32x8(all, bits) = _mm256_permutevar8x32_ps(all, places(bits)));

lanes! {
    /// Eight `u32` of AVX2.
    U32x8: [u32; 8], __m256i, Avx2, __m256i;
    load(from) = _mm256_loadu_si256(from.cast());
    store(to, all) = _mm256_storeu_si256(to.cast(), all);
    splat(x) = _mm256_set1_epi32(x as i32);
    operators: Add::add = _mm256_add_epi32, Sub::sub = _mm256_sub_epi32, Mul::mul = _mm256_mullo_epi32, BitAnd::bitand = _mm256_and_si256;
    min = _mm256_min_epu32, max = _mm256_max_epu32;
    // Not less is to be the greater one.
    lt(a, b) = _mm256_xor_si256(_mm256_cmpeq_epi32(_mm256_max_epu32(a, b), a), _mm256_set1_epi32(-1));
    eq(a, b) = _mm256_cmpeq_epi32(a, b);
    bitmask(mask) = _mm256_movemask_ps(_mm256_castsi256_ps(mask)) as u32;
}
compress!(U32x8(all, bits) = _mm256_permutevar8x32_epi32(all, places(bits)));
shifts!(U32x8: Shl::shl = _mm256_sll_epi32, Shr::shr = _mm256_srl_epi32);

lanes! {
    /// Sixteen `f32` of AVX-512.
    F32x16: [f32; 16], __m512, Avx512, __mmask16;
    load(from) = _mm512_loadu_ps(from);
    store(to, all) = _mm512_storeu_ps(to, all);
    splat(x) = _mm512_set1_ps(x);
    operators: Add::add = _mm512_add_ps, Sub::sub = _mm512_sub_ps, Mul::mul = _mm512_mul_ps, Div::div = _mm512_div_ps;
    min = _mm512_min_ps, max = _mm512_max_ps;
    lt(a, b) = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b);
    eq(a, b) = _mm512_cmp_ps_mask::<_CMP_EQ_OQ>(a, b);
    bitmask(mask) = mask.into();
}
floats! {
    F32x16: mul_add = _mm512_fmadd_ps;
    select(mask, set, unset) = _mm512_mask_blend_ps(mask, unset, set);
}
compress!(F32x16(all, bits) = _mm512_maskz_compress_ps(bits as u16, all));

lanes! {
    /// Sixteen `u32` of AVX-512.
    U32x16: [u32; 16], __m512i, Avx512, __mmask16;
    load(from) = _mm512_loadu_si512(from.cast());
    store(to, all) = _mm512_storeu_si512(to.cast(), all);
    splat(x) = _mm512_set1_epi32(x as i32);
    operators: Add::add = _mm512_add_epi32, Sub::sub = _mm512_sub_epi32, Mul::mul = _mm512_mullo_epi32, BitAnd::bitand = _mm512_and_si512;
    min = _mm512_min_epu32, max = _mm512_max_epu32;
    lt(a, b) = _mm512_cmplt_epu32_mask(a, b);
    eq(a, b) = _mm512_cmpeq_epi32_mask(a, b);
    bitmask(mask) = mask.into();
}
compress!(U32x16(all, bits) = _mm512_maskz_compress_epi32(bits as u16, all));
shifts!(U32x16: Shl::shl = _mm512_sll_epi32, Shr::shr = _mm512_srl_epi32);

impl F32s for F32x8 {
    type U32s = U32x8;
    #[inline(always)]
    fn neg_mul_add(self, factor: Self, more: Self) -> Self {
        // SAFETY: the machine has FMA.
        Self(unsafe { _mm256_fnmadd_ps(self.0, factor.0, more.0) })
    }
    #[inline(always)]
    fn reduce_min(self) -> Self {
        // SAFETY: the machine has AVX2.
        unsafe {
            let two = _mm256_min_ps(self.0, _mm256_permute2f128_ps::<0x01>(self.0, self.0));
            let four = _mm256_min_ps(two, _mm256_permute_ps::<0x4e>(two));
            Self(_mm256_min_ps(four, _mm256_permute_ps::<0xb1>(four)))
        }
    }
}

impl F32s for F32x16 {
    type U32s = U32x16;
    #[inline(always)]
    fn neg_mul_add(self, factor: Self, more: Self) -> Self {
        // SAFETY: the machine has AVX-512.
        Self(unsafe { _mm512_fnmadd_ps(self.0, factor.0, more.0) })
    }
    #[inline(always)]
    fn reduce_min(self) -> Self {
        // SAFETY: the machine has AVX-512.
        Self(unsafe { _mm512_set1_ps(_mm512_reduce_min_ps(self.0)) })
    }
}

impl Half for F32x8 {
    type Double = [f32; 16];
}

impl Half for U32x8 {
    type Double = [u32; 16];
}

impl Pair<F32x8> {
    /// Those of the sixteen lanes that eight numbers name.
    #[inline(always)]
    fn pick(self, U32x8(numbers): U32x8) -> F32x8 {
        // SAFETY: the machine has AVX2.
        F32x8(unsafe {
            let low = _mm256_permutevar8x32_ps(self.0.0, numbers);
            let high = _mm256_permutevar8x32_ps(self.1.0, numbers);
            // Bit 3 selects the half.
            _mm256_blendv_ps(low, high, _mm256_castsi256_ps(_mm256_slli_epi32::<28>(numbers)))
        })
    }
}

impl F32x16s for Pair<F32x8> {
    type U32s = Pair<U32x8>;
    #[inline(always)]
    fn permute(self, numbers: Pair<U32x8>) -> Self {
        Self(self.pick(numbers.0), self.pick(numbers.1))
    }
    #[inline(always)]
    fn from_i32(numbers: Pair<U32x8>) -> Self {
        // SAFETY: the machine has AVX2.
        unsafe { Self(F32x8(_mm256_cvtepi32_ps(numbers.0.0)), F32x8(_mm256_cvtepi32_ps(numbers.1.0))) }
    }
    #[inline(always)]
    fn to_i32(self) -> Pair<U32x8> {
        // SAFETY: the machine has AVX2.
        unsafe { Pair(U32x8(_mm256_cvttps_epi32(self.0.0)), U32x8(_mm256_cvttps_epi32(self.1.0))) }
    }
}

impl F32x16s for F32x16 {
    type U32s = U32x16;
    #[inline(always)]
    fn permute(self, numbers: U32x16) -> Self {
        // SAFETY: the machine has AVX-512.
        Self(unsafe { _mm512_permutexvar_ps(numbers.0, self.0) })
    }
    #[inline(always)]
    fn from_i32(numbers: U32x16) -> Self {
        // SAFETY: the machine has AVX-512.
        Self(unsafe { _mm512_cvtepi32_ps(numbers.0) })
    }
    #[inline(always)]
    fn to_i32(self) -> U32x16 {
        // SAFETY: the machine has AVX-512.
        U32x16(unsafe { _mm512_cvttps_epi32(self.0) })
    }
}

impl Compress for Pair<U32x8> {
    #[inline(always)]
    fn compress(self, bits: u32) -> [u32; 16] {
        let mut out = [0; 16];
        let first = (bits as u8).count_ones() as usize;
        out[..8].copy_from_slice(&self.0.compress(bits));
        out[first..first + 8].copy_from_slice(&self.1.compress(bits >> 8));
        out
    }
}

impl U32x16s for Pair<U32x8> {
    #[inline(always)]
    fn from_rows(_: Avx2, mut row: impl FnMut(usize) -> [u32; 3]) -> [Self; 3] {
        let low = [row(0), row(1), row(2), row(3), row(4), row(5), row(6), row(7)];
        let high = [row(8), row(9), row(10), row(11), row(12), row(13), row(14), row(15)];
        // SAFETY: the machine has AVX2.
        let ([x, y, z], [u, v, w]) = unsafe { (columns(low), columns(high)) };
        [Self(U32x8(x), U32x8(u)), Self(U32x8(y), U32x8(v)), Self(U32x8(z), U32x8(w))]
    }
    #[inline(always)]
    fn permute(self, numbers: Self) -> Self {
        // SAFETY: the machine has AVX2. Bits are moved, and nothing else.
        unsafe {
            let (low, high) = (_mm256_castsi256_ps(self.0.0), _mm256_castsi256_ps(self.1.0));
            let all = Pair(F32x8(low), F32x8(high)).permute(numbers);
            Self(U32x8(_mm256_castps_si256(all.0.0)), U32x8(_mm256_castps_si256(all.1.0)))
        }
    }
}

impl U32x16s for U32x16 {
    #[inline(always)]
    fn from_rows(_: Avx512, mut row: impl FnMut(usize) -> [u32; 3]) -> [Self; 3] {
        // Lane k of four lanes is row 4·lane + k: then columns have them in order.
        let [a, b, c, d] = four(
            #[inline(always)]
            |k| {
                // SAFETY: the machine has AVX-512 and AVX2.
                unsafe {
                    let (low, high) = (two(row(k), row(k + 4)), two(row(k + 8), row(k + 12)));
                    _mm512_inserti64x4::<1>(_mm512_castsi256_si512(low), high)
                }
            },
        );
        // SAFETY: the machine has AVX-512.
        unsafe {
            let (ab, cd) = (_mm512_unpacklo_epi32(a, b), _mm512_unpacklo_epi32(c, d));
            let (ab_high, cd_high) = (_mm512_unpackhi_epi32(a, b), _mm512_unpackhi_epi32(c, d));
            [
                Self(_mm512_unpacklo_epi64(ab, cd)),
                Self(_mm512_unpackhi_epi64(ab, cd)),
                Self(_mm512_unpacklo_epi64(ab_high, cd_high)),
            ]
        }
    }
    #[inline(always)]
    fn permute(self, numbers: Self) -> Self {
        // SAFETY: the machine has AVX-512.
        Self(unsafe { _mm512_permutexvar_epi32(numbers.0, self.0) })
    }
}

/// The places of the bits that are set in the lowest byte.
#[inline]
#[target_feature(enable = "avx2")]
fn places(bits: u32) -> __m256i {
    let places = &PLACES[bits as usize & 0xff];
    // SAFETY: there are eight bytes.
    _mm256_cvtepu8_epi32(unsafe { _mm_loadl_epi64(places.as_ptr().cast()) })
}

/// Two rows, each with a 0 behind it.
#[inline]
#[target_feature(enable = "avx2")]
fn two(a: [u32; 3], b: [u32; 3]) -> __m256i {
    let one = |[x, y, z]: [u32; 3]| {
        let xy = _mm_cvtsi64_si128((u64::from(x) | u64::from(y) << 32) as i64);
        _mm_insert_epi32::<2>(xy, z as i32)
    };
    _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(one(a)), one(b))
}

/// Eight rows as columns.
#[inline]
#[target_feature(enable = "avx2")]
fn columns(rows: [[u32; 3]; 8]) -> [__m256i; 3] {
    let (a, b) = (two(rows[0], rows[4]), two(rows[1], rows[5]));
    let (c, d) = (two(rows[2], rows[6]), two(rows[3], rows[7]));
    let (ab, cd) = (_mm256_unpacklo_epi32(a, b), _mm256_unpacklo_epi32(c, d));
    let (ab_high, cd_high) = (_mm256_unpackhi_epi32(a, b), _mm256_unpackhi_epi32(c, d));
    [_mm256_unpacklo_epi64(ab, cd), _mm256_unpackhi_epi64(ab, cd), _mm256_unpacklo_epi64(ab_high, cd_high)]
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
    fn min_f32(token: Avx2, a: &[f32; 8], b: &[f32; 8]) -> [f32; 8] {
        F32x8::load(token, a).min(F32x8::load(token, b)).to_array()
    }
    #[inline(always)]
    fn max_f32(token: Avx2, a: &[f32; 8], b: &[f32; 8]) -> [f32; 8] {
        F32x8::load(token, a).max(F32x8::load(token, b)).to_array()
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
pub fn transpose_f32x8(_: Avx2, rows: [&[f32; 8]; 8]) -> [[f32; 8]; 8] {
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

/// The places of a number among eight, as bits: a few instructions of SSE2 that no compiler finds.
#[inline(always)]
pub(super) fn places_among_eight(eight: &[u32; 8], wanted: u32) -> u32 {
    let [low, high]: [__m128i; 2] = bytemuck::cast(*eight);
    // SAFETY: SSE2 is part of x86-64.
    unsafe {
        let wanted = _mm_set1_epi32(wanted as i32);
        let (low, high) = (_mm_cmpeq_epi32(low, wanted), _mm_cmpeq_epi32(high, wanted));
        let bytes = _mm_packs_epi16(_mm_packs_epi32(low, high), _mm_setzero_si128());
        _mm_movemask_epi8(bytes) as u32
    }
}
