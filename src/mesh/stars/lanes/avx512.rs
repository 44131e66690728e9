//! Sixteen lanes of AVX-512.
#![allow(unsafe_code)]

use super::{Batch, Machine};
use crate::mesh::stars::wide::{Neighbourhood, View};
use crate::mesh::stars::{Grid, Star};
use crate::simd::{Avx512, F64s as _, F64x8, Lanes as _, may_use};
use std::arch::x86_64::*;

/// Proof that this machine has AVX-512 and what else the code is compiled for.
#[derive(Clone, Copy, Debug)]
pub(in crate::mesh::stars) struct Wide(Avx512);

impl Wide {
    /// Looks for it.
    pub(in crate::mesh::stars) fn found() -> Option<Self> {
        let also = may_use(&["LZCNT", "POPCNT", "AVX512DQ"])
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt")
            && is_x86_feature_detected!("avx512dq");
        Avx512::found().filter(|_| also).map(Self)
    }
}

impl Machine for Wide {
    type Batch = Sixteen;
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

#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
fn gather(
    proof: Wide,
    near: &mut Neighbourhood,
    grid: &Grid,
    rows: &[[u32; 2]],
    p: [f32; 3],
    reach: f32,
) -> bool {
    near.gather::<Sixteen>(proof, grid, rows, p, reach)
}

#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
fn close<const N: usize>(
    proof: Wide,
    near: &mut Neighbourhood,
    view: &View,
    is_outer: impl Fn([u32; 3]) -> bool,
) -> Star {
    near.close::<N, Sixteen>(proof, view, is_outer)
}

/// Sixteen lanes, made with a proof only, so the machine has the instructions.
#[derive(Clone, Copy, Debug)]
pub(in crate::mesh::stars) struct Sixteen(__m512);

impl Batch for Sixteen {
    type Proof = Wide;
    type Mask = __mmask16;
    type Packing = __mmask16;
    type Doubles = F64x8;
    const LANES: usize = 16;
    const HOLDS: bool = true;
    #[inline(always)]
    fn load(_: Wide, list: &[f32], place: usize) -> Self {
        let sixteen = &list[place..place + 16];
        // SAFETY: AVX-512 was found, and so many are there.
        Self(unsafe { _mm512_loadu_ps(sixteen.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, list: &mut [f32], place: usize) {
        let to = &mut list[place..place + 16];
        // SAFETY: AVX-512 was found, and there is room for so many.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) };
    }
    #[inline(always)]
    fn splat(_: Wide, x: f32) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_set1_ps(x) })
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_sub_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_mul_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn times_plus(self, factor: Self, more: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_fmadd_ps(self.0, factor.0, more.0) })
    }
    #[inline(always)]
    fn less_product(self, a: Self, b: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_fnmadd_ps(a.0, b.0, self.0) })
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_div_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn least(self) -> (f32, Self) {
        // SAFETY: AVX-512 was found.
        unsafe {
            let least = _mm512_reduce_min_ps(self.0);
            (least, Self(_mm512_set1_ps(least)))
        }
    }
    #[inline(always)]
    fn below(self, other: Self) -> __mmask16 {
        // SAFETY: AVX-512 was found.
        unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn below_in(self, other: Self, lanes: u32) -> u32 {
        // SAFETY: AVX-512 was found.
        u32::from(unsafe { _mm512_mask_cmp_ps_mask::<_CMP_LT_OQ>(lanes as u16, self.0, other.0) })
    }
    #[inline(always)]
    fn equals(self, other: Self) -> __mmask16 {
        // SAFETY: AVX-512 was found.
        unsafe { _mm512_cmp_ps_mask::<_CMP_EQ_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn pick(mask: __mmask16, set: Self, unset: Self) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_mask_blend_ps(mask, unset.0, set.0) })
    }
    #[inline(always)]
    fn bits(mask: __mmask16) -> u32 {
        u32::from(mask)
    }
    #[inline(always)]
    fn find(_: Wide, list: &[u32], place: usize, number: u32) -> u32 {
        let sixteen = &list[place..place + 16];
        // SAFETY: AVX-512 was found, and so many are there.
        let numbers = unsafe { _mm512_loadu_epi32(sixteen.as_ptr().cast()) };
        // SAFETY: as above.
        u32::from(unsafe { _mm512_cmpeq_epi32_mask(numbers, _mm512_set1_epi32(number as i32)) })
    }
    #[inline(always)]
    fn packing(_: Wide, bits: u32) -> __mmask16 {
        bits as u16
    }
    #[inline(always)]
    fn packed(self, packing: __mmask16) -> Self {
        // SAFETY: AVX-512 was found.
        Self(unsafe { _mm512_maskz_compress_ps(packing, self.0) })
    }
    #[inline(always)]
    fn doubles(proof: Wide, x: f64) -> F64x8 {
        F64x8::splat(proof.0, x)
    }
    #[inline(always)]
    fn load_doubles(proof: Wide, list: &[f32], place: usize) -> F64x8 {
        F64x8::from_f32(proof.0, &list[place..])
    }
    #[inline(always)]
    fn store_doubles(doubles: F64x8, list: &mut [f32], place: usize) {
        list[place..place + 8].copy_from_slice(&doubles.to_f32());
    }
}
