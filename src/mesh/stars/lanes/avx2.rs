//! Eight lanes of AVX2.
#![allow(unsafe_code)]

use super::{Batch, Machine};
use crate::mesh::stars::wide::{Neighbourhood, View};
use crate::mesh::stars::{Grid, Star};
use crate::simd::{Avx2, F64s as _, F64x4, Lanes as _, PLACES, may_use};
use std::arch::x86_64::*;

/// Proof that this machine has AVX2 and what else the code is compiled for.
#[derive(Clone, Copy, Debug)]
pub(in crate::mesh::stars) struct Narrow(Avx2);

impl Narrow {
    /// Looks for it.
    pub(in crate::mesh::stars) fn found() -> Option<Self> {
        let also = may_use(&["LZCNT", "POPCNT"])
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        Avx2::found().filter(|_| also).map(Self)
    }
}

impl Machine for Narrow {
    type Batch = Eight;
    fn gather(
        self,
        near: &mut Neighbourhood,
        grid: &Grid,
        rows: &[[u32; 2]],
        p: [f32; 3],
        reach: f32,
    ) -> bool {
        // SAFETY: there is a proof that the features were found.
        unsafe { gather(self, near, grid, rows, p, reach) }
    }
    fn close<const N: usize>(
        self,
        near: &mut Neighbourhood,
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star {
        // SAFETY: there is a proof that the features were found.
        unsafe { close::<N>(self, near, view, is_outer) }
    }
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
fn gather(
    proof: Narrow,
    near: &mut Neighbourhood,
    grid: &Grid,
    rows: &[[u32; 2]],
    p: [f32; 3],
    reach: f32,
) -> bool {
    near.gather::<Eight>(proof, grid, rows, p, reach)
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
fn close<const N: usize>(
    proof: Narrow,
    near: &mut Neighbourhood,
    view: &View,
    is_outer: impl Fn([u32; 3]) -> bool,
) -> Star {
    near.close::<N, Eight>(proof, view, is_outer)
}

/// Eight lanes, made with a proof only, so the machine has the instructions.
#[derive(Clone, Copy, Debug)]
pub(in crate::mesh::stars) struct Eight(__m256);

impl Batch for Eight {
    type Proof = Narrow;
    type Mask = __m256;
    type Packing = __m256i;
    type Doubles = F64x4;
    const LANES: usize = 8;
    const HOLDS: bool = false;
    #[inline(always)]
    fn load(_: Narrow, list: &[f32], place: usize) -> Self {
        let eight = &list[place..place + 8];
        // SAFETY: AVX2 was found, and so many are there.
        Self(unsafe { _mm256_loadu_ps(eight.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, list: &mut [f32], place: usize) {
        let to = &mut list[place..place + 8];
        // SAFETY: AVX2 was found, and there is room for so many.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) };
    }
    #[inline(always)]
    fn splat(_: Narrow, x: f32) -> Self {
        // SAFETY: AVX2 was found.
        Self(unsafe { _mm256_set1_ps(x) })
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        // SAFETY: AVX2 was found.
        Self(unsafe { _mm256_sub_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        // SAFETY: AVX2 was found.
        Self(unsafe { _mm256_mul_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn times_plus(self, factor: Self, more: Self) -> Self {
        // SAFETY: AVX2 was found, and FMA.
        Self(unsafe { _mm256_fmadd_ps(self.0, factor.0, more.0) })
    }
    #[inline(always)]
    fn less_product(self, a: Self, b: Self) -> Self {
        // SAFETY: AVX2 was found, and FMA.
        Self(unsafe { _mm256_fnmadd_ps(a.0, b.0, self.0) })
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        // SAFETY: AVX2 was found.
        Self(unsafe { _mm256_div_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: AVX2 was found.
        Self(unsafe { _mm256_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn least(self) -> (f32, Self) {
        // SAFETY: AVX2 was found.
        unsafe {
            let two = _mm256_min_ps(self.0, _mm256_permute2f128_ps::<0x01>(self.0, self.0));
            let four = _mm256_min_ps(two, _mm256_permute_ps::<0x4e>(two));
            let all = _mm256_min_ps(four, _mm256_permute_ps::<0xb1>(four));
            (_mm256_cvtss_f32(all), Self(all))
        }
    }
    #[inline(always)]
    fn below(self, other: Self) -> __m256 {
        // SAFETY: AVX2 was found.
        unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn below_in(self, other: Self, lanes: u32) -> u32 {
        Self::bits(self.below(other)) & lanes
    }
    #[inline(always)]
    fn equals(self, other: Self) -> __m256 {
        // SAFETY: AVX2 was found.
        unsafe { _mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn pick(mask: __m256, set: Self, unset: Self) -> Self {
        // SAFETY: AVX2 was found.
        Self(unsafe { _mm256_blendv_ps(unset.0, set.0, mask) })
    }
    #[inline(always)]
    fn bits(mask: __m256) -> u32 {
        // SAFETY: AVX2 was found.
        (unsafe { _mm256_movemask_ps(mask) }) as u32
    }
    #[inline(always)]
    fn find(_: Narrow, list: &[u32], place: usize, number: u32) -> u32 {
        let eight = &list[place..place + 8];
        // SAFETY: AVX2 was found, and so many are there.
        unsafe {
            let numbers = _mm256_loadu_si256(eight.as_ptr().cast());
            let equal = _mm256_cmpeq_epi32(numbers, _mm256_set1_epi32(number as i32));
            _mm256_movemask_ps(_mm256_castsi256_ps(equal)) as u32
        }
    }
    #[inline(always)]
    fn packing(_: Narrow, bits: u32) -> __m256i {
        let places = &PLACES[bits as usize & 0xff];
        // SAFETY: AVX2 was found, and there are eight bytes.
        unsafe { _mm256_cvtepu8_epi32(_mm_loadl_epi64(places.as_ptr().cast())) }
    }
    #[inline(always)]
    fn packed(self, packing: __m256i) -> Self {
        // SAFETY: AVX2 was found.
        Self(unsafe { _mm256_permutevar8x32_ps(self.0, packing) })
    }
    #[inline(always)]
    fn doubles(proof: Narrow, x: f64) -> F64x4 {
        F64x4::splat(proof.0, x)
    }
    #[inline(always)]
    fn load_doubles(proof: Narrow, list: &[f32], place: usize) -> F64x4 {
        F64x4::from_f32(proof.0, &list[place..])
    }
    #[inline(always)]
    fn store_doubles(doubles: F64x4, list: &mut [f32], place: usize) {
        list[place..place + 4].copy_from_slice(&doubles.to_f32());
    }
}
