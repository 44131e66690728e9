//! Sixteen lanes of AVX-512. To be had with a proof only: so each has been made on a machine that
//! has the instructions. Of use in code that is compiled for them.
#![allow(unsafe_code)]

use super::avx2::quarter;
use super::{Bits, Floats, Ints};
use crate::geom::LatticePos;
use crate::simd::Avx512;
use std::arch::x86_64::*;

#[derive(Clone, Copy)]
pub(in crate::raster) struct FloatVector(__m512);
#[derive(Clone, Copy)]
pub(in crate::raster) struct IntVector(__m512i);

/// Operations of a pair, lane by lane.
macro_rules! pairs {
    ($($name:ident = $vector:ident),*) => {
        $(
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                // SAFETY: AVX-512 was found.
                Self(unsafe { $vector(self.0, other.0) })
            }
        )*
    };
}

impl Floats for FloatVector {
    type Proof = Avx512;
    type Mask = __mmask16;
    type Ints = IntVector;
    pairs!(plus = _mm512_add_ps, minus = _mm512_sub_ps, times = _mm512_mul_ps, over = _mm512_div_ps);
    #[inline(always)]
    fn splat(_: Avx512, x: f32) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_set1_ps(x) })
    }
    #[inline(always)]
    fn lanes(self) -> [f32; 16] {
        let mut out = [0.0; 16];
        // SAFETY: AVX-512 was found, and there is room for all numbers.
        unsafe { _mm512_storeu_ps(out.as_mut_ptr(), self.0) };
        out
    }
    #[inline(always)]
    fn at(self, numbers: IntVector) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_permutexvar_ps(numbers.0, self.0) })
    }
    #[inline(always)]
    fn below(self, other: Self) -> __mmask16 {
        // SAFETY: AVX-512 was found.
        unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn bits(mask: __mmask16) -> Bits {
        mask
    }
    #[inline(always)]
    fn pick(mask: __mmask16, set: Self, unset: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_mask_blend_ps(mask, unset.0, set.0) })
    }
    #[inline(always)]
    fn lesser_where(self, mask: __mmask16, other: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_mask_min_ps(self.0, mask, other.0, self.0) })
    }
    #[inline(always)]
    fn greater_where(self, mask: __mmask16, other: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_mask_max_ps(self.0, mask, other.0, self.0) })
    }
    #[inline(always)]
    fn cut(self) -> IntVector {
        // SAFETY: AVX-512 was found.
        IntVector(unsafe { _mm512_cvttps_epi32(self.0) })
    }
}

/// Of use as [`IntVector`] is.
#[inline(always)]
fn quarters(a: LatticePos, b: LatticePos, c: LatticePos, d: LatticePos) -> __m512i {
    // SAFETY: the one caller has a proof of AVX-512.
    unsafe {
        let low = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(quarter(a)), quarter(b));
        let high = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(quarter(c)), quarter(d));
        _mm512_inserti64x4::<1>(_mm512_castsi256_si512(low), high)
    }
}

impl Ints for IntVector {
    type Proof = Avx512;
    type Floats = FloatVector;
    #[inline(always)]
    fn of(_: Avx512, lanes: &[u32; 16]) -> Self {
        // SAFETY: AVX-512 was found, and there are sixteen numbers to be read.
        Self(unsafe { _mm512_loadu_si512(lanes.as_ptr().cast()) })
    }
    pairs!(
        and = _mm512_and_si512,
        plus = _mm512_add_epi32,
        minus = _mm512_sub_epi32,
        times = _mm512_mullo_epi32,
        min = _mm512_min_epu32,
        max = _mm512_max_epu32
    );
    #[inline(always)]
    fn splat(_: Avx512, x: u32) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_set1_epi32(x as i32) })
    }
    #[inline(always)]
    fn columns(_: Avx512, mut row: impl FnMut(usize) -> LatticePos) -> [Self; 3] {
        // Lane k of four lanes is row 4·lane + k: then columns have them in order.
        let a = quarters(row(0), row(4), row(8), row(12));
        let b = quarters(row(1), row(5), row(9), row(13));
        let c = quarters(row(2), row(6), row(10), row(14));
        let d = quarters(row(3), row(7), row(11), row(15));
        // SAFETY: AVX-512 was found.
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
    fn lanes(self) -> [u32; 16] {
        let mut out = [0u32; 16];
        // SAFETY: AVX-512 was found, and there is room for all numbers.
        unsafe { _mm512_storeu_si512(out.as_mut_ptr().cast(), self.0) };
        out
    }
    #[inline(always)]
    fn at(self, numbers: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_permutexvar_epi32(numbers.0, self.0) })
    }
    #[inline(always)]
    fn packed(self, bits: Bits) -> [u32; 16] {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_maskz_compress_epi32(bits, self.0) }).lanes()
    }
    #[inline(always)]
    fn shifted_left(self, bits: u32) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_sll_epi32(self.0, _mm_cvtsi32_si128(bits as i32)) })
    }
    #[inline(always)]
    fn shifted_right(self, bits: u32) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_srl_epi32(self.0, _mm_cvtsi32_si128(bits as i32)) })
    }
    #[inline(always)]
    fn below(self, other: Self) -> Bits {
        // SAFETY: AVX-512 was found.
        unsafe { _mm512_cmplt_epu32_mask(self.0, other.0) }
    }
    #[inline(always)]
    fn greatest(self) -> u32 {
        // SAFETY: AVX-512 was found.
        unsafe { _mm512_reduce_max_epu32(self.0) }
    }
    #[inline(always)]
    fn floats(self) -> FloatVector {
        // SAFETY: AVX-512 was found.
        FloatVector(unsafe { _mm512_cvtepi32_ps(self.0) })
    }
}
