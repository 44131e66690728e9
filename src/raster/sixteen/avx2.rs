//! Twice eight lanes of AVX2. To be had with a proof only: so each has been made on a machine that
//! has the instructions. Of use in code that is compiled for them.
#![allow(unsafe_code)]

use super::{Bits, Floats, Ints};
use crate::geom::LatticePos;
use crate::simd::Avx2;
use std::arch::x86_64::*;

/// Lanes 0 to 7 and 8 to 15.
#[derive(Clone, Copy)]
pub(in crate::raster) struct FloatPair(__m256, __m256);
#[derive(Clone, Copy)]
pub(in crate::raster) struct IntPair(__m256i, __m256i);

/// The same of both halves.
macro_rules! halves {
    ($($name:ident = $vector:ident),*) => {
        $(
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                // SAFETY: AVX2 was found.
                unsafe { Self($vector(self.0, other.0), $vector(self.1, other.1)) }
            }
        )*
    };
}

impl Floats for FloatPair {
    type Proof = Avx2;
    type Mask = (__m256, __m256);
    type Ints = IntPair;
    halves!(plus = _mm256_add_ps, minus = _mm256_sub_ps, times = _mm256_mul_ps, over = _mm256_div_ps);
    #[inline(always)]
    fn splat(_: Avx2, x: f32) -> Self {
        // SAFETY: AVX2 was found.
        let all = unsafe { _mm256_set1_ps(x) };
        Self(all, all)
    }
    #[inline(always)]
    fn lanes(self) -> [f32; 16] {
        let mut out = [0.0; 16];
        // SAFETY: AVX2 was found, and there is room for twice eight numbers.
        unsafe {
            _mm256_storeu_ps(out.as_mut_ptr(), self.0);
            _mm256_storeu_ps(out[8..].as_mut_ptr(), self.1);
        }
        out
    }
    #[inline(always)]
    fn at(self, numbers: IntPair) -> Self {
        Self(picked(self, numbers.0), picked(self, numbers.1))
    }
    #[inline(always)]
    fn below(self, other: Self) -> Self::Mask {
        // SAFETY: AVX2 was found.
        unsafe {
            (_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0), _mm256_cmp_ps::<_CMP_LT_OQ>(self.1, other.1))
        }
    }
    #[inline(always)]
    fn bits(mask: Self::Mask) -> Bits {
        // SAFETY: AVX2 was found.
        unsafe { (_mm256_movemask_ps(mask.0) | _mm256_movemask_ps(mask.1) << 8) as Bits }
    }
    #[inline(always)]
    fn pick(mask: Self::Mask, set: Self, unset: Self) -> Self {
        // SAFETY: AVX2 was found.
        unsafe { Self(_mm256_blendv_ps(unset.0, set.0, mask.0), _mm256_blendv_ps(unset.1, set.1, mask.1)) }
    }
    #[inline(always)]
    fn lesser_where(self, mask: Self::Mask, other: Self) -> Self {
        // SAFETY: AVX2 was found.
        let lesser = unsafe { Self(_mm256_min_ps(other.0, self.0), _mm256_min_ps(other.1, self.1)) };
        Self::pick(mask, lesser, self)
    }
    #[inline(always)]
    fn greater_where(self, mask: Self::Mask, other: Self) -> Self {
        // SAFETY: AVX2 was found.
        let greater = unsafe { Self(_mm256_max_ps(other.0, self.0), _mm256_max_ps(other.1, self.1)) };
        Self::pick(mask, greater, self)
    }
    #[inline(always)]
    fn cut(self) -> IntPair {
        // SAFETY: AVX2 was found.
        unsafe { IntPair(_mm256_cvttps_epi32(self.0), _mm256_cvttps_epi32(self.1)) }
    }
}

/// Those of the sixteen lanes that eight numbers name. Of use as [`FloatPair`] is.
#[inline(always)]
fn picked(from: FloatPair, numbers: __m256i) -> __m256 {
    // SAFETY: there is a pair, so AVX2 was found.
    unsafe {
        let (low, high) =
            (_mm256_permutevar8x32_ps(from.0, numbers), _mm256_permutevar8x32_ps(from.1, numbers));
        // Bit 3 selects the half.
        _mm256_blendv_ps(low, high, _mm256_castsi256_ps(_mm256_slli_epi32::<28>(numbers)))
    }
}

/// The lanes whose bits are set come first.
#[inline(always)]
fn packed(lanes: __m256i, bits: u8) -> __m256i {
    // SAFETY: the one caller has a pair, so AVX2 was found, and BMI2 with it.
    unsafe {
        let bytes = _pdep_u64(u64::from(bits), 0x0101_0101_0101_0101) * 0xff;
        let numbers = _pext_u64(0x0706_0504_0302_0100, bytes);
        let numbers = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(numbers as i64));
        _mm256_permutevar8x32_epi32(lanes, numbers)
    }
}

/// Two positions in a vector.
#[inline(always)]
fn two(a: LatticePos, b: LatticePos) -> __m256i {
    // SAFETY: the one caller has a proof of AVX2.
    unsafe { _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(quarter(a)), quarter(b)) }
}

/// Rows 0 to 3 and 4 to 7, the latter in the upper halves, as columns.
#[inline(always)]
fn columns_of([a, b, c, d]: [__m256i; 4]) -> [__m256i; 3] {
    // SAFETY: the one caller has a proof of AVX2.
    unsafe {
        let (ab, cd) = (_mm256_unpacklo_epi32(a, b), _mm256_unpacklo_epi32(c, d));
        let (ab_high, cd_high) = (_mm256_unpackhi_epi32(a, b), _mm256_unpackhi_epi32(c, d));
        [
            _mm256_unpacklo_epi64(ab, cd),
            _mm256_unpackhi_epi64(ab, cd),
            _mm256_unpacklo_epi64(ab_high, cd_high),
        ]
    }
}

impl Ints for IntPair {
    type Proof = Avx2;
    type Floats = FloatPair;
    halves!(
        and = _mm256_and_si256,
        plus = _mm256_add_epi32,
        minus = _mm256_sub_epi32,
        times = _mm256_mullo_epi32,
        min = _mm256_min_epu32,
        max = _mm256_max_epu32
    );
    #[inline(always)]
    fn of(_: Avx2, lanes: &[u32; 16]) -> Self {
        // SAFETY: AVX2 was found, and there are twice eight numbers to be read.
        unsafe {
            Self(_mm256_loadu_si256(lanes.as_ptr().cast()), _mm256_loadu_si256(lanes[8..].as_ptr().cast()))
        }
    }
    #[inline(always)]
    fn splat(_: Avx2, x: u32) -> Self {
        // SAFETY: AVX2 was found.
        let all = unsafe { _mm256_set1_epi32(x as i32) };
        Self(all, all)
    }
    #[inline(always)]
    fn columns(_: Avx2, mut row: impl FnMut(usize) -> LatticePos) -> [Self; 3] {
        let low = [two(row(0), row(4)), two(row(1), row(5)), two(row(2), row(6)), two(row(3), row(7))];
        let high = [two(row(8), row(12)), two(row(9), row(13)), two(row(10), row(14)), two(row(11), row(15))];
        let ([x, y, z], [u, v, w]) = (columns_of(low), columns_of(high));
        [Self(x, u), Self(y, v), Self(z, w)]
    }
    #[inline(always)]
    fn lanes(self) -> [u32; 16] {
        let mut out = [0; 16];
        // SAFETY: AVX2 was found, and there is room for twice eight numbers.
        unsafe {
            _mm256_storeu_si256(out.as_mut_ptr().cast(), self.0);
            _mm256_storeu_si256(out[8..].as_mut_ptr().cast(), self.1);
        }
        out
    }
    #[inline(always)]
    fn at(self, numbers: Self) -> Self {
        // SAFETY: AVX2 was found. The bits stay what they are.
        unsafe {
            let all = FloatPair(_mm256_castsi256_ps(self.0), _mm256_castsi256_ps(self.1)).at(numbers);
            Self(_mm256_castps_si256(all.0), _mm256_castps_si256(all.1))
        }
    }
    #[inline(always)]
    fn packed(self, bits: Bits) -> [u32; 16] {
        let mut out = [0u32; 16];
        let (low, high) = (packed(self.0, bits as u8), packed(self.1, (bits >> 8) as u8));
        let first = (bits as u8).count_ones() as usize;
        // SAFETY: AVX2 was found, and there is room for eight numbers behind each of the first nine
        // places.
        unsafe {
            _mm256_storeu_si256(out.as_mut_ptr().cast(), low);
            _mm256_storeu_si256(out[first..first + 8].as_mut_ptr().cast(), high);
        }
        out
    }
    #[inline(always)]
    fn shifted_left(self, bits: u32) -> Self {
        // SAFETY: AVX2 was found.
        unsafe {
            let bits = _mm_cvtsi32_si128(bits as i32);
            Self(_mm256_sll_epi32(self.0, bits), _mm256_sll_epi32(self.1, bits))
        }
    }
    #[inline(always)]
    fn shifted_right(self, bits: u32) -> Self {
        // SAFETY: AVX2 was found.
        unsafe {
            let bits = _mm_cvtsi32_si128(bits as i32);
            Self(_mm256_srl_epi32(self.0, bits), _mm256_srl_epi32(self.1, bits))
        }
    }
    #[inline(always)]
    fn below(self, other: Self) -> Bits {
        // Not less is to be the greater one.
        let greater = self.max(other);
        // SAFETY: AVX2 was found.
        let not_less =
            unsafe { (_mm256_cmpeq_epi32(greater.0, self.0), _mm256_cmpeq_epi32(greater.1, self.1)) };
        // SAFETY: as above.
        !unsafe { FloatPair::bits((_mm256_castsi256_ps(not_less.0), _mm256_castsi256_ps(not_less.1))) }
    }
    #[inline(always)]
    fn greatest(self) -> u32 {
        self.lanes().into_iter().fold(0, u32::max)
    }
    #[inline(always)]
    fn floats(self) -> FloatPair {
        // SAFETY: AVX2 was found.
        unsafe { FloatPair(_mm256_cvtepi32_ps(self.0), _mm256_cvtepi32_ps(self.1)) }
    }
}

/// A position, and 0. Of use where AVX2 was found.
#[inline(always)]
pub(super) fn quarter([x, y, z]: LatticePos) -> __m128i {
    // SAFETY: AVX2 was found, and with it SSE4.1.
    unsafe {
        let xy = _mm_cvtsi64_si128((u64::from(x) | u64::from(y) << 32) as i64);
        _mm_insert_epi32::<2>(xy, z as i32)
    }
}
