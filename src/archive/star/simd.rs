//! What [`link`](super::link) does most, with AVX2: the same operations in the same order, eight at a time, so the same bits.
#![allow(unsafe_code)]

use super::link::{Cloud, Gates, LANES, Link, MOST, NOBODY, Path, Point};
use crate::cpu::may_use;
use std::arch::x86_64::*;

/// The proof that this machine can.
#[derive(Clone, Copy)]
pub(super) struct Vectors(());

impl Vectors {
    /// Only where this machine can.
    pub(super) fn find() -> Option<Self> {
        let can = may_use(&["AVX2", "BMI1", "BMI2", "POPCNT"])
            && is_x86_feature_detected!("avx2")
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

#[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
fn run<T>(f: impl FnOnce() -> T) -> T {
    f()
}

impl Path for Vectors {
    #[inline(always)]
    fn near(self, cloud: &Cloud, v: usize, words: &mut [u64]) {
        // SAFETY: the features were found when this was made.
        unsafe { near_avx2(cloud, v, words) }
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
#[target_feature(enable = "avx2")]
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
#[target_feature(enable = "avx2")]
fn load(eight: &[f32; 8]) -> __m256 {
    // SAFETY: the array has 32 bytes; the load need not be aligned.
    unsafe { _mm256_loadu_ps(eight.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn near_avx2(cloud: &Cloud, v: usize, words: &mut [u64]) {
    let [x, y, z] = [cloud.x[v], cloud.y[v], cloud.z[v]].map(|c| _mm256_set1_ps(c));
    let radius2 = _mm256_set1_ps(cloud.radius2);
    let first = v / 64 * 8;
    let eights = |axis| <[f32]>::as_chunks::<8>(axis).0.get(first..).unwrap_or_default();
    let (xs, ys, zs) = (eights(&cloud.x), eights(&cloud.y), eights(&cloud.z));
    let eights = xs.as_chunks::<8>().0.iter().zip(ys.as_chunks::<8>().0).zip(zs.as_chunks::<8>().0);
    for (word, ((xs, ys), zs)) in words.iter_mut().zip(eights) {
        let mut bits = 0;
        for k in 0..8 {
            let dx = _mm256_sub_ps(load(&xs[k]), x);
            let dy = _mm256_sub_ps(load(&ys[k]), y);
            let dz = _mm256_sub_ps(load(&zs[k]), z);
            let xy = _mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy));
            let square = _mm256_add_ps(xy, _mm256_mul_ps(dz, dz));
            let near = _mm256_cmp_ps::<_CMP_LE_OQ>(square, radius2);
            bits |= u64::from(_mm256_movemask_ps(near) as u8) << (8 * k);
        }
        *word = bits;
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn dot(a: [__m256; 3], b: [__m256; 3]) -> __m256 {
    let xy = _mm256_add_ps(_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1]));
    _mm256_add_ps(xy, _mm256_mul_ps(a[2], b[2]))
}

#[inline]
#[target_feature(enable = "avx2")]
fn minor(a: __m256, b: __m256, c: __m256, d: __m256) -> __m256 {
    _mm256_sub_ps(_mm256_mul_ps(a, b), _mm256_mul_ps(c, d))
}

#[inline]
#[target_feature(enable = "avx2")]
fn sum(a: [__m256; 3]) -> __m256 {
    let sign = _mm256_set1_ps(-0.0);
    let [a, b, c] = a.map(|x| _mm256_andnot_ps(sign, x));
    _mm256_add_ps(_mm256_add_ps(a, b), c)
}

/// All x, all y, all z of eight points.
#[inline]
#[target_feature(enable = "avx2")]
fn columns(points: [&Point; 8]) -> [__m256; 3] {
    // SAFETY: a point has 16 bytes; the loads need not be aligned.
    let four = |k: usize| unsafe { _mm256_loadu2_m128(points[k + 4].as_ptr(), points[k].as_ptr()) };
    let (a, b, c, d) = (four(0), four(1), four(2), four(3));
    let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
    let (ab_z, cd_z) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
    let x = _mm256_shuffle_ps::<0x44>(ab, cd);
    let y = _mm256_shuffle_ps::<0xee>(ab, cd);
    [x, y, _mm256_shuffle_ps::<0x44>(ab_z, cd_z)]
}

#[inline]
#[target_feature(enable = "avx2")]
fn search_avx2(link: &Link, radius2: f32, gates: &mut Gates) {
    let ends = |at: &[u8; LANES]| columns(at.map(|i| &link.points[usize::from(i) % MOST]));
    let (c, d) = (ends(&gates.c), ends(&gates.d));
    let n = [minor(c[1], d[2], c[2], d[1]), minor(c[2], d[0], c[0], d[2]), minor(c[0], d[1], c[1], d[0])];
    let (cc, cd, dd) = (dot(c, c), dot(c, d), dot(d, d));
    let (p, q) = (_mm256_sub_ps(dd, cd), _mm256_sub_ps(cc, cd));
    let u: [__m256; 3] =
        [0, 1, 2].map(|k: usize| _mm256_add_ps(_mm256_mul_ps(p, c[k]), _mm256_mul_ps(q, d[k])));
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
        let s = _mm256_div_ps(_mm256_sub_ps(nn, dot(u, w)), h);
        let front = _mm256_cmp_ps::<_CMP_GT_OQ>(h, least);
        let better = _mm256_and_ps(front, _mm256_cmp_ps::<_CMP_LT_OQ>(s, best));
        best = _mm256_blendv_ps(best, s, better);
        apex = _mm256_blendv_ps(apex, _mm256_castsi256_ps(place), better);
        place = _mm256_add_epi32(place, one);
    }
    // Size of the spheres, as `Hinge::size`.
    let over = _mm256_add_ps(dot(u, u), _mm256_mul_ps(_mm256_mul_ps(best, best), nn));
    let under = _mm256_mul_ps(_mm256_mul_ps(nn, nn), _mm256_set1_ps(4.0 * radius2));
    let size = _mm256_srai_epi32::<22>(_mm256_castps_si256(_mm256_div_ps(over, under)));
    let mut out = [[0i32; 8]; 2];
    // SAFETY: each array has 32 bytes; the stores need not be aligned.
    unsafe {
        _mm256_storeu_si256(out[0].as_mut_ptr().cast(), _mm256_castps_si256(apex));
        _mm256_storeu_si256(out[1].as_mut_ptr().cast(), size);
    }
    for (lane, (&apex, &size)) in out[0].iter().zip(&out[1]).enumerate() {
        gates.note(lane, apex, size);
    }
}
