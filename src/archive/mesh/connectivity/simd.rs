//! The most frequent operations of [`link`](super::link), with AVX2 and FMA. They are the same
//! operations in the same order, eight at a time, so the bits are the same.
#![allow(unsafe_code)]

use super::link::{Cloud, Gates, LANES, Link, MOST, MOST_NEAR, PLACE, Path, Point, ends};
use isospan_mesh::simd::{Avx2, PLACES, may_use_all};
use std::arch::x86_64::*;

/// The proof that this machine can.
#[derive(Clone, Copy)]
pub(super) struct Vectors(Avx2);

impl Vectors {
    /// Only where this machine can.
    pub(super) fn find() -> Option<Self> {
        let can = may_use_all!("POPCNT" = "popcnt");
        Avx2::found().filter(|_| can).map(Self)
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

#[inline(never)]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,popcnt")]
fn apart<T>(f: impl FnOnce() -> T) -> T {
    f()
}

impl Path for Vectors {
    #[inline(always)]
    fn near(self, cloud: &Cloud, v: usize, link: &mut Link) {
        // SAFETY: the features were found when this was made.
        unsafe { near_avx2(cloud, v, link) }
    }

    #[inline(always)]
    fn invert(self, cloud: &Cloud, link: &mut Link) {
        // SAFETY: the features were found when this was made.
        unsafe { invert_avx2(cloud, link) }
    }

    #[inline(always)]
    fn search(self, link: &Link, gates: &mut Gates) {
        // SAFETY: the features were found when this was made.
        unsafe { search_avx2(link, gates) }
    }

    #[inline(always)]
    fn apart<T>(self, f: impl FnOnce() -> T) -> T {
        // SAFETY: the features were found when this was made.
        unsafe { apart(f) }
    }
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
fn near_avx2(cloud: &Cloud, v: usize, link: &mut Link) {
    let (at, radius2) = (splat(*cloud.point(v)), _mm256_set1_ps(cloud.radius2));
    let [x, y, z] = &cloud.axes;
    let (x, y, z) = (x.as_chunks::<8>().0, y.as_chunks::<8>().0, z.as_chunks::<8>().0);
    let (x, y, z) = (&x[v / 8..], &y[v / 8..], &z[v / 8..]);
    // The vertices that are larger than v.
    let (mut n, mut larger) = (0, 0xff << (v % 8) << 1);
    let mut first = _mm_set1_epi16((v / 8 * 8) as i16);
    for ((x, y), z) in x.iter().zip(y).zip(z) {
        let d = minus([load(x), load(y), load(z)], at);
        let near = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(dot(d, d), radius2)) & larger;
        larger = 0xff;
        let room: &mut [u16; 8] =
            link.id[n..].first_chunk_mut().expect("there is more room than for those nearby");
        // SAFETY: the one array has 8 bytes, the other 16; load and store need not be aligned.
        unsafe {
            let places = _mm_cvtepu8_epi16(_mm_loadl_epi64(PLACES[near as usize & 0xff].as_ptr().cast()));
            _mm_storeu_si128(room.as_mut_ptr().cast(), _mm_add_epi16(places, first));
        }
        n = (n + near.count_ones() as usize).min(MOST_NEAR);
        first = _mm_add_epi16(first, _mm_set1_epi16(8));
    }
    link.len = n;
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn invert_avx2(cloud: &Cloud, link: &mut Link) {
    let (from, one) = (splat(link.from), _mm256_set1_ps(1.0));
    let eights = link.len.div_ceil(8);
    for (ids, points) in
        link.id.as_chunks::<8>().0.iter().zip(link.points.as_chunks_mut::<8>().0).take(eights)
    {
        let mut at = [cloud.point(0); 8];
        for (at, &w) in at.iter_mut().zip(ids) {
            // Behind the last one are ids of other links and blocks.
            *at = cloud.point(w.into());
        }
        let d = minus(columns(at), from);
        let q = _mm256_div_ps(one, dot(d, d));
        let (x, y, z) = (_mm256_mul_ps(d[0], q), _mm256_mul_ps(d[1], q), _mm256_mul_ps(d[2], q));
        // Back to rows: pairs (x, y) and (z, sum), then points; the low half has the first four.
        let sum = sum([x, y, z]);
        let (xy, zs) = (_mm256_unpacklo_ps(x, y), _mm256_unpacklo_ps(z, sum));
        let (xy_high, zs_high) = (_mm256_unpackhi_ps(x, y), _mm256_unpackhi_ps(z, sum));
        let rows = [
            _mm256_shuffle_ps::<0x44>(xy, zs),
            _mm256_shuffle_ps::<0xee>(xy, zs),
            _mm256_shuffle_ps::<0x44>(xy_high, zs_high),
            _mm256_shuffle_ps::<0xee>(xy_high, zs_high),
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

/// A coordinate of four points each: x, y, z, and the number that goes with them; the same in both
/// halves.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn four(points: [&Point; 4]) -> [__m256; 4] {
    // SAFETY: a point has 16 bytes; the loads need not be aligned.
    let row = |p: &Point| unsafe { _mm256_loadu2_m128(p.as_ptr(), p.as_ptr()) };
    let (a, b, c, d) = (row(points[0]), row(points[1]), row(points[2]), row(points[3]));
    let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
    let (ab_high, cd_high) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
    [
        _mm256_shuffle_ps::<0x44>(ab, cd),
        _mm256_shuffle_ps::<0xee>(ab, cd),
        _mm256_shuffle_ps::<0x44>(ab_high, cd_high),
        _mm256_shuffle_ps::<0xee>(ab_high, cd_high),
    ]
}

/// Two points at a time, one in each half, for four gates.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn search_avx2(link: &Link, gates: &mut Gates) {
    let (mut c, mut d) = ([&link.points[0]; LANES], [&link.points[0]; LANES]);
    for l in 0..LANES {
        let [from, to] = ends(gates.gates[l]);
        (c[l], d[l]) = (&link.points[from], &link.points[to]);
    }
    let ([cx, cy, cz, sc], [dx, dy, dz, sd]) = (four(c), four(d));
    let (c, d) = ([cx, cy, cz], [dx, dy, dz]);
    let n = [minor(c[1], d[2], c[2], d[1]), minor(c[2], d[0], c[0], d[2]), minor(c[0], d[1], c[1], d[0])];
    let (cc, cd, dd) = (dot(c, c), dot(c, d), dot(d, d));
    let (p, q) = (_mm256_sub_ps(dd, cd), _mm256_sub_ps(cc, cd));
    let mut u = c;
    for k in 0..3 {
        u[k] = _mm256_fmadd_ps(p, c[k], _mm256_mul_ps(q, d[k]));
    }
    let nn = dot(n, n);
    let tiny = _mm256_set1_ps(1.0 / (1 << 21) as f32);
    let least = _mm256_mul_ps(_mm256_mul_ps(_mm256_mul_ps(sc, sd), _mm256_add_ps(sc, sd)), tiny);
    let none = _mm256_set1_ps(f32::INFINITY);
    let (mut best, mut other) = (none, none);
    let mut place = _mm256_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1);
    let (two, of_where) = (_mm256_set1_epi32(2), _mm256_set1_ps(f32::from_bits(!PLACE)));
    let key = |pair: &[Point], place: __m256i| {
        // SAFETY: two points have 32 bytes; the load need not be aligned.
        let pair = unsafe { _mm256_loadu_ps(pair[..2].as_ptr().cast()) };
        let w = [
            _mm256_permute_ps::<0x00>(pair),
            _mm256_permute_ps::<0x55>(pair),
            _mm256_permute_ps::<0xaa>(pair),
        ];
        let h = dot(n, w);
        let over = _mm256_fnmadd_ps(u[1], w[1], _mm256_fnmadd_ps(u[0], w[0], nn));
        let s = _mm256_div_ps(_mm256_fnmadd_ps(u[2], w[2], over), h);
        let key = _mm256_or_ps(_mm256_and_ps(s, of_where), _mm256_castsi256_ps(place));
        // All bits where it is not in front: no number, which is never the least.
        _mm256_or_ps(key, _mm256_cmp_ps::<_CMP_NGT_UQ>(h, least))
    };
    for points in &link.points.as_chunks::<4>().0[..link.len.div_ceil(4).min(MOST / 4)] {
        best = _mm256_min_ps(key(&points[..2], place), best);
        place = _mm256_add_epi32(place, two);
        other = _mm256_min_ps(key(&points[2..], place), other);
        place = _mm256_add_epi32(place, two);
    }
    best = _mm256_min_ps(other, best);
    let keys = _mm_min_ps(_mm256_castps256_ps128(best), _mm256_extractf128_ps::<1>(best));
    // SAFETY: the array has 16 bytes; the store need not be aligned.
    unsafe { _mm_storeu_ps(gates.keys.as_mut_ptr(), keys) };
}
