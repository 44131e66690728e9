//! What [`link`](super::link) does most, with AVX2 and FMA: the same operations in the same order, eight at a time, so the same bits.
#![allow(unsafe_code)]

use super::link::{Cloud, GROUP, Gates, LANES, LEAST_SIZE, Link, MOST, NOBODY, Path, Point, SIZES};
use crate::cpu::may_use;
use std::arch::x86_64::*;

/// The proof that this machine can.
#[derive(Clone, Copy)]
pub(super) struct Vectors(());

impl Vectors {
    /// Only where this machine can.
    pub(super) fn find() -> Option<Self> {
        let can = may_use(&["AVX2", "FMA", "BMI1", "BMI2", "POPCNT"])
            && is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("popcnt");
        can.then_some(Self(()))
    }

    /// Runs a function that is compiled for this machine as far as it is inlined.
    #[inline]
    pub(super) fn run<T>(self, f: impl FnOnce() -> T) -> T {
        // SAFETY: the features were found when this was made.
        unsafe { run(f) }
    }
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2,popcnt")]
fn run<T>(f: impl FnOnce() -> T) -> T {
    f()
}

impl Path for Vectors {
    #[inline(always)]
    fn near_groups(self, cloud: &Cloud, from: Point, first: usize) -> u64 {
        // SAFETY: the features were found when this was made.
        unsafe { near_groups_avx2(cloud, from, first) }
    }

    #[inline(always)]
    fn near(self, cloud: &Cloud, from: Point, group: usize) -> u32 {
        // SAFETY: the features were found when this was made.
        unsafe { near_avx2(cloud, from, group) }
    }

    #[inline(always)]
    fn invert(self, cloud: &Cloud, link: &mut Link) {
        // SAFETY: the features were found when this was made.
        unsafe { invert_avx2(cloud, link) }
    }

    #[inline(always)]
    fn active(self, link: &Link) -> u64 {
        // SAFETY: the features were found when this was made.
        unsafe { active_avx2(link) }
    }

    #[inline(always)]
    fn search(self, link: &Link, radius2: f32, gates: &mut Gates) {
        // SAFETY: the features were found when this was made.
        unsafe { search_avx2(link, radius2, gates) }
    }
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn active_avx2(link: &Link) -> u64 {
    let mut set = 0;
    for (k, four) in link.out[..link.len.min(MOST).next_multiple_of(4)].as_chunks::<4>().0.iter().enumerate()
    {
        // SAFETY: four words are 32 bytes; the load need not be aligned.
        let four = unsafe { _mm256_loadu_si256(four.as_ptr().cast()) };
        let none = _mm256_castsi256_pd(_mm256_cmpeq_epi64(four, _mm256_setzero_si256()));
        set |= u64::from(!_mm256_movemask_pd(none) as u8 & 15) << (4 * k);
    }
    set
}

/// Eight lanes of an array.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn load(eight: &[f32; 8]) -> __m256 {
    // SAFETY: the array has 32 bytes; the load need not be aligned.
    unsafe { _mm256_loadu_ps(eight.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn splat(p: Point) -> [__m256; 3] {
    [_mm256_set1_ps(p[0]), _mm256_set1_ps(p[1]), _mm256_set1_ps(p[2])]
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn minus(a: [__m256; 3], b: [__m256; 3]) -> [__m256; 3] {
    [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1]), _mm256_sub_ps(a[2], b[2])]
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn near_groups_avx2(cloud: &Cloud, from: Point, first: usize) -> u64 {
    let (at, radius2) = (splat(from), _mm256_set1_ps(cloud.radius2));
    let count = (cloud.boxes[0][0].len() / 8 - first).min(8);
    let mut bits = 0;
    for i in 0..count {
        let mut out = at;
        for (k, [lo, hi]) in cloud.boxes.iter().enumerate() {
            let lo = _mm256_sub_ps(load(&lo.as_chunks::<8>().0[first + i]), at[k]);
            let hi = _mm256_sub_ps(at[k], load(&hi.as_chunks::<8>().0[first + i]));
            out[k] = _mm256_max_ps(_mm256_max_ps(lo, hi), _mm256_setzero_ps());
        }
        let near = _mm256_cmp_ps::<_CMP_LE_OQ>(dot(out, out), radius2);
        bits |= u64::from(_mm256_movemask_ps(near) as u8) << (8 * i);
    }
    bits
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn near_avx2(cloud: &Cloud, from: Point, group: usize) -> u32 {
    let (at, radius2) = (splat(from), _mm256_set1_ps(cloud.radius2));
    let [x, y, z] = &cloud.axes;
    let x = x.as_chunks::<GROUP>().0[group].as_chunks::<8>().0;
    let y = y.as_chunks::<GROUP>().0[group].as_chunks::<8>().0;
    let z = z.as_chunks::<GROUP>().0[group].as_chunks::<8>().0;
    let mut bits = 0;
    for i in 0..GROUP / 8 {
        let d = minus([load(&x[i]), load(&y[i]), load(&z[i])], at);
        let near = _mm256_cmp_ps::<_CMP_LE_OQ>(dot(d, d), radius2);
        bits |= u32::from(_mm256_movemask_ps(near) as u8) << (8 * i);
    }
    bits
}

/// Eight points at a time.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn invert_avx2(cloud: &Cloud, link: &mut Link) {
    let (from, one) = (splat(link.from), _mm256_set1_ps(1.0));
    let last = cloud.points.len() - 1;
    let eights = link.len.div_ceil(8);
    for (ids, points) in
        link.id.as_chunks::<8>().0.iter().zip(link.points.as_chunks_mut::<8>().0).take(eights)
    {
        let mut at = [&cloud.points[0]; 8];
        for (at, &w) in at.iter_mut().zip(ids) {
            // Behind the last one are ids of other links and blocks.
            *at = &cloud.points[usize::from(w).min(last)];
        }
        let d = minus(columns(at), from);
        let q = _mm256_div_ps(one, dot(d, d));
        let (x, y, z) = (_mm256_mul_ps(d[0], q), _mm256_mul_ps(d[1], q), _mm256_mul_ps(d[2], q));
        // Back to rows: pairs (x, y) and (z, 0), then points; the low half has the first four.
        let zero = _mm256_setzero_ps();
        let (xy, z0) = (_mm256_unpacklo_ps(x, y), _mm256_unpacklo_ps(z, zero));
        let (xy_high, z0_high) = (_mm256_unpackhi_ps(x, y), _mm256_unpackhi_ps(z, zero));
        let rows = [
            _mm256_shuffle_ps::<0x44>(xy, z0),
            _mm256_shuffle_ps::<0xee>(xy, z0),
            _mm256_shuffle_ps::<0x44>(xy_high, z0_high),
            _mm256_shuffle_ps::<0xee>(xy_high, z0_high),
        ];
        for k in 0..4 {
            // SAFETY: a point has 16 bytes; the stores need not be aligned.
            unsafe { _mm256_storeu2_m128(points[k + 4].as_mut_ptr(), points[k].as_mut_ptr(), rows[k]) };
        }
    }
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn dot(a: [__m256; 3], b: [__m256; 3]) -> __m256 {
    _mm256_fmadd_ps(a[2], b[2], _mm256_fmadd_ps(a[1], b[1], _mm256_mul_ps(a[0], b[0])))
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn minor(a: __m256, b: __m256, c: __m256, d: __m256) -> __m256 {
    _mm256_fmsub_ps(a, b, _mm256_mul_ps(c, d))
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn sum(a: [__m256; 3]) -> __m256 {
    let sign = _mm256_set1_ps(-0.0);
    let xy = _mm256_add_ps(_mm256_andnot_ps(sign, a[0]), _mm256_andnot_ps(sign, a[1]));
    _mm256_add_ps(xy, _mm256_andnot_ps(sign, a[2]))
}

/// Two points.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn pair(low: &Point, high: &Point) -> __m256 {
    // SAFETY: a point has 16 bytes; the loads need not be aligned.
    unsafe { _mm256_loadu2_m128(high.as_ptr(), low.as_ptr()) }
}

/// All x, all y, all z of eight points.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn columns(points: [&Point; 8]) -> [__m256; 3] {
    let (a, b) = (pair(points[0], points[4]), pair(points[1], points[5]));
    let (c, d) = (pair(points[2], points[6]), pair(points[3], points[7]));
    let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
    let (ab_z, cd_z) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
    let x = _mm256_shuffle_ps::<0x44>(ab, cd);
    let y = _mm256_shuffle_ps::<0xee>(ab, cd);
    [x, y, _mm256_shuffle_ps::<0x44>(ab_z, cd_z)]
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn search_avx2(link: &Link, radius2: f32, gates: &mut Gates) {
    let (mut c, mut d) = ([&link.points[0]; LANES], [&link.points[0]; LANES]);
    for l in 0..LANES {
        (c[l], d[l]) =
            (&link.points[usize::from(gates.c[l]) % MOST], &link.points[usize::from(gates.d[l]) % MOST]);
    }
    let (c, d) = (columns(c), columns(d));
    let n = [minor(c[1], d[2], c[2], d[1]), minor(c[2], d[0], c[0], d[2]), minor(c[0], d[1], c[1], d[0])];
    let (cc, cd, dd) = (dot(c, c), dot(c, d), dot(d, d));
    let (p, q) = (_mm256_sub_ps(dd, cd), _mm256_sub_ps(cc, cd));
    let mut u = c;
    for k in 0..3 {
        u[k] = _mm256_fmadd_ps(p, c[k], _mm256_mul_ps(q, d[k]));
    }
    let nn = dot(n, n);
    let (sc, sd) = (sum(c), sum(d));
    let tiny = _mm256_set1_ps(1.0 / (1 << 21) as f32);
    let least = _mm256_mul_ps(_mm256_mul_ps(_mm256_mul_ps(sc, sd), _mm256_add_ps(sc, sd)), tiny);
    let mut best = _mm256_set1_ps(f32::INFINITY);
    let mut apex = _mm256_castsi256_ps(_mm256_set1_epi32(NOBODY as i32));
    let mut place = _mm256_setzero_si256();
    let one = _mm256_set1_epi32(1);
    let count = link.len.min(MOST);
    for [x, y, z, _] in &link.points[..count] {
        let w = [_mm256_broadcast_ss(x), _mm256_broadcast_ss(y), _mm256_broadcast_ss(z)];
        let h = dot(n, w);
        let over = _mm256_fnmadd_ps(u[1], w[1], _mm256_fnmadd_ps(u[0], w[0], nn));
        let s = _mm256_div_ps(_mm256_fnmadd_ps(u[2], w[2], over), h);
        let front = _mm256_cmp_ps::<_CMP_GT_OQ>(h, least);
        let better = _mm256_and_ps(front, _mm256_cmp_ps::<_CMP_LT_OQ>(s, best));
        best = _mm256_blendv_ps(best, s, better);
        apex = _mm256_blendv_ps(apex, _mm256_castsi256_ps(place), better);
        place = _mm256_add_epi32(place, one);
    }
    // Size of the spheres, as `Hinge::size`.
    let over = _mm256_fmadd_ps(_mm256_mul_ps(best, best), nn, dot(u, u));
    let under = _mm256_mul_ps(_mm256_mul_ps(nn, nn), _mm256_set1_ps(4.0 * radius2));
    let size = _mm256_srai_epi32::<22>(_mm256_castps_si256(_mm256_div_ps(over, under)));
    let size = _mm256_sub_epi32(size, _mm256_set1_epi32(LEAST_SIZE));
    let size = _mm256_max_epi32(size, _mm256_setzero_si256());
    let size = _mm256_min_epi32(size, _mm256_set1_epi32(SIZES as i32 - 2));
    let apex = _mm256_castps_si256(apex);
    let nobody = _mm256_cmpeq_epi32(apex, _mm256_set1_epi32(NOBODY as i32));
    let size = _mm256_blendv_epi8(size, _mm256_set1_epi32(SIZES as i32 - 1), nobody);
    let told = _mm256_or_si256(apex, _mm256_slli_epi32::<8>(size));
    let told = _mm_packus_epi32(_mm256_castsi256_si128(told), _mm256_extracti128_si256::<1>(told));
    // SAFETY: the array has 16 bytes; the store need not be aligned.
    unsafe { _mm_storeu_si128(gates.told.as_mut_ptr().cast(), told) };
}
