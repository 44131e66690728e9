//! The search of [`simd`](super::simd) with AVX-512: four points at a time for four gates. The
//! operations are the same, so the bits are the same. The least of all keys is one number, in any
//! order in which they are looked at.
#![allow(unsafe_code)]

use super::link::{Cloud, Gates, LANES, Link, MOST, MOST_NEAR, PLACE, Path, Point, ends};
use super::simd::Vectors;
use isospan_mesh::simd::{Avx512, may_use_all};
use std::arch::x86_64::*;

/// The proof that this machine can.
#[derive(Clone, Copy)]
pub(super) struct Wide(Vectors);

impl Wide {
    /// Only where this machine can.
    pub(super) fn find() -> Option<Self> {
        let can = Avx512::found().is_some() && may_use_all!("AVX512DQ" = "avx512dq");
        Vectors::find().filter(|_| can).map(Self)
    }

    /// As [`Vectors::run`].
    #[inline]
    pub(super) fn run<T>(self, f: impl FnOnce() -> T) -> T {
        self.0.run(f)
    }
}

impl Path for Wide {
    #[inline(always)]
    fn near(self, cloud: &Cloud, v: usize, link: &mut Link) {
        // SAFETY: the features were found when this was made.
        unsafe { near_avx512(cloud, v, link) }
    }

    #[inline(always)]
    fn invert(self, cloud: &Cloud, link: &mut Link) {
        // SAFETY: the features were found when this was made.
        unsafe { invert_avx512(cloud, link) }
    }

    #[inline(always)]
    fn search(self, link: &Link, gates: &mut Gates) {
        // SAFETY: the features were found when this was made.
        unsafe { search_avx512(link, gates) }
    }

    #[inline(always)]
    fn apart<T>(self, f: impl FnOnce() -> T) -> T {
        self.0.apart(f)
    }
}

/// The squares of the lengths of sixteen vectors.
#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn squares([x, y, z]: [__m512; 3]) -> __m512 {
    _mm512_fmadd_ps(z, z, _mm512_fmadd_ps(y, y, _mm512_mul_ps(x, x)))
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn near_avx512(cloud: &Cloud, v: usize, link: &mut Link) {
    let at = cloud.point(v);
    let radius2 = _mm512_set1_ps(cloud.radius2);
    let axis = |k: usize| &cloud.axes[k].as_chunks::<16>().0[v / 16..];
    // The vertices that are larger than v.
    let (mut n, mut larger) = (0, (0xffff_u32 << (v % 16) << 1) as u16);
    let mut places = _mm512_add_epi32(
        _mm512_set1_epi32((v / 16 * 16) as i32),
        _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15),
    );
    for ((x, y), z) in axis(0).iter().zip(axis(1)).zip(axis(2)) {
        let minus = |sixteen: &[f32; 16], from: f32| {
            // SAFETY: the array has 64 bytes; the load need not be aligned.
            let sixteen = unsafe { _mm512_loadu_ps(sixteen.as_ptr()) };
            _mm512_sub_ps(sixteen, _mm512_set1_ps(from))
        };
        let d = [minus(x, at[0]), minus(y, at[1]), minus(z, at[2])];
        let near = _mm512_cmp_ps_mask::<_CMP_LE_OQ>(squares(d), radius2) & larger;
        larger = 0xffff;
        let room: &mut [u16; 16] =
            link.id[n..].first_chunk_mut().expect("there is more room than for those nearby");
        let found = _mm512_cvtepi32_epi16(_mm512_maskz_compress_epi32(near, places));
        // SAFETY: the array has 32 bytes; the store need not be aligned.
        unsafe { _mm256_storeu_si256(room.as_mut_ptr().cast(), found) };
        n = (n + near.count_ones() as usize).min(MOST_NEAR);
        places = _mm512_add_epi32(places, _mm512_set1_epi32(16));
    }
    link.len = n;
}

/// Four rows of four points each become four columns of sixteen numbers, and the other way round.
#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn turned([a, b, c, d]: [__m512; 4]) -> [__m512; 4] {
    let (ab, cd) = (_mm512_unpacklo_ps(a, b), _mm512_unpacklo_ps(c, d));
    let (ab_high, cd_high) = (_mm512_unpackhi_ps(a, b), _mm512_unpackhi_ps(c, d));
    [
        _mm512_shuffle_ps::<0x44>(ab, cd),
        _mm512_shuffle_ps::<0xee>(ab, cd),
        _mm512_shuffle_ps::<0x44>(ab_high, cd_high),
        _mm512_shuffle_ps::<0xee>(ab_high, cd_high),
    ]
}

/// What is stored is what the search loads, four points at a time: else it would wait for the
/// stores.
#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn invert_avx512(cloud: &Cloud, link: &mut Link) {
    let from = link.from;
    let (ids, points) = (link.id.as_chunks::<16>().0, link.points.as_chunks_mut::<16>().0);
    for (ids, points) in ids.iter().zip(points).take(link.len.div_ceil(16)) {
        let mut rows = [_mm512_setzero_ps(); 4];
        for (row, ids) in rows.iter_mut().zip(ids.as_chunks::<4>().0) {
            // Behind the last one are ids of other links and blocks.
            // SAFETY: a point has 16 bytes; the loads need not be aligned.
            let [a, b, c, d] = ids.map(|w| unsafe { _mm_loadu_ps(cloud.point(w.into()).as_ptr()) });
            let (ab, cd) = (_mm256_set_m128(b, a), _mm256_set_m128(d, c));
            *row = _mm512_insertf32x8::<1>(_mm512_castps256_ps512(ab), cd);
        }
        let [x, y, z, _] = turned(rows);
        let minus = |a, k: usize| _mm512_sub_ps(a, _mm512_set1_ps(from[k]));
        let d = [minus(x, 0), minus(y, 1), minus(z, 2)];
        let q = _mm512_div_ps(_mm512_set1_ps(1.0), squares(d));
        let [x, y, z] = d.map(|d| _mm512_mul_ps(d, q));
        let sum = _mm512_add_ps(_mm512_add_ps(_mm512_abs_ps(x), _mm512_abs_ps(y)), _mm512_abs_ps(z));
        for (four, row) in points.as_chunks_mut::<4>().0.iter_mut().zip(turned([x, y, z, sum])) {
            // SAFETY: four points have 64 bytes; the store need not be aligned.
            unsafe { _mm512_storeu_ps(four.as_mut_ptr().cast(), row) };
        }
    }
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn dot(a: [__m128; 3], b: [__m128; 3]) -> __m128 {
    _mm_fmadd_ps(a[2], b[2], _mm_fmadd_ps(a[1], b[1], _mm_mul_ps(a[0], b[0])))
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn minor(a: __m128, b: __m128, c: __m128, d: __m128) -> __m128 {
    _mm_fmsub_ps(a, b, _mm_mul_ps(c, d))
}

/// A coordinate of four points each: x, y, z, and the number that goes with them.
#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn columns(points: [&Point; 4]) -> [__m128; 4] {
    // SAFETY: a point has 16 bytes; the loads need not be aligned.
    let [a, b, c, d] = points.map(|p| unsafe { _mm_loadu_ps(p.as_ptr()) });
    let (ab, cd) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
    let (ab_high, cd_high) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
    [
        _mm_movelh_ps(ab, cd),
        _mm_movehl_ps(cd, ab),
        _mm_movelh_ps(ab_high, cd_high),
        _mm_movehl_ps(cd_high, ab_high),
    ]
}

/// What the search needs of four gates, in each quarter of a register.
struct Hinges {
    n: [__m512; 3],
    u: [__m512; 3],
    nn: __m512,
    least: __m512,
}

impl Hinges {
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
    fn of(link: &Link, gates: &Gates) -> Self {
        let (mut c, mut d) = ([&link.points[0]; LANES], [&link.points[0]; LANES]);
        for l in 0..LANES {
            let [from, to] = ends(gates.gates[l]);
            (c[l], d[l]) = (&link.points[from], &link.points[to]);
        }
        let ([cx, cy, cz, sc], [dx, dy, dz, sd]) = (columns(c), columns(d));
        let (c, d) = ([cx, cy, cz], [dx, dy, dz]);
        let n = [minor(c[1], d[2], c[2], d[1]), minor(c[2], d[0], c[0], d[2]), minor(c[0], d[1], c[1], d[0])];
        let (cc, cd, dd) = (dot(c, c), dot(c, d), dot(d, d));
        let (p, q) = (_mm_sub_ps(dd, cd), _mm_sub_ps(cc, cd));
        let u = |k: usize| _mm_fmadd_ps(p, c[k], _mm_mul_ps(q, d[k]));
        let tiny = _mm_set1_ps(1.0 / (1 << 21) as f32);
        let least = _mm_mul_ps(_mm_mul_ps(_mm_mul_ps(sc, sd), _mm_add_ps(sc, sd)), tiny);
        let all = |x| _mm512_broadcast_f32x4(x);
        Self {
            n: [all(n[0]), all(n[1]), all(n[2])],
            u: [all(u(0)), all(u(1)), all(u(2))],
            nn: all(dot(n, n)),
            least: all(least),
        }
    }

    /// The lesser of what is known and the keys of four points, whose places `place` gives.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
    fn least(&self, best: __m512, four: &[Point; 4], place: __m512i) -> __m512 {
        // SAFETY: four points have 64 bytes; the load need not be aligned.
        let four = unsafe { _mm512_loadu_ps(four.as_ptr().cast()) };
        let (x, y) = (_mm512_permute_ps::<0x00>(four), _mm512_permute_ps::<0x55>(four));
        let z = _mm512_permute_ps::<0xaa>(four);
        let (n, u) = (self.n, self.u);
        let h = _mm512_fmadd_ps(n[2], z, _mm512_fmadd_ps(n[1], y, _mm512_mul_ps(n[0], x)));
        let over = _mm512_fnmadd_ps(u[1], y, _mm512_fnmadd_ps(u[0], x, self.nn));
        let s = _mm512_castps_si512(_mm512_div_ps(_mm512_fnmadd_ps(u[2], z, over), h));
        // The bits of the place, or else those of the quotient: `place & PLACE | s & !PLACE`.
        let key = _mm512_ternarylogic_epi32::<0xca>(_mm512_set1_epi32(PLACE as i32), place, s);
        let in_front = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(h, self.least);
        // If the key is no number, the best stays.
        _mm512_mask_min_ps(best, in_front, _mm512_castsi512_ps(key), best)
    }
}

#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn search_avx512(link: &Link, gates: &mut Gates) {
    let hinges = Hinges::of(link, gates);
    let none = _mm512_set1_ps(f32::INFINITY);
    let (mut best, mut other) = (none, none);
    let mut place = _mm512_set_epi32(3, 3, 3, 3, 2, 2, 2, 2, 1, 1, 1, 1, 0, 0, 0, 0);
    let step = _mm512_set1_epi32(4);
    let fours = &link.points.as_chunks::<4>().0[..link.len.div_ceil(4).min(MOST / 4)];
    let (pairs, last) = fours.as_chunks::<2>();
    for [first, second] in pairs {
        best = hinges.least(best, first, place);
        place = _mm512_add_epi32(place, step);
        other = hinges.least(other, second, place);
        place = _mm512_add_epi32(place, step);
    }
    for four in last {
        best = hinges.least(best, four, place);
    }
    best = _mm512_min_ps(other, best);
    let half = _mm256_min_ps(_mm512_castps512_ps256(best), _mm512_extractf32x8_ps::<1>(best));
    let keys = _mm_min_ps(_mm256_castps256_ps128(half), _mm256_extractf128_ps::<1>(half));
    // SAFETY: the array has 16 bytes; the store need not be aligned.
    unsafe { _mm_storeu_ps(gates.keys.as_mut_ptr(), keys) };
}
