//! An insertion with AVX-512, for cavities of up to 32 vertices (all but one in a hundred);
//! `simd.rs` does the others.
//!
//! An insertion in `simd.rs` is bound by the number of instructions (9 500, at more than four a
//! cycle) and by some 35 jumps that cannot be predicted; misses of the nearest cache come after
//! that. So:
//!
//! * The cavity grows by **batches** of four tetrahedra, sixteen neighbours, of any level:
//!   one loop, few iterations. Their codes are sorted into "in conflict" and "boundary" by one
//!   compression each.
//! * A boundary with V vertices has 2V - 4 facets: the number of facets shows how many vertices
//!   there will be. For up to 32 the vertices' coordinates relative to the new point lie in four
//!   registers an axis, and a facet's corners are looked up by permutation.
//! * Eight new spheres are made, and tested against the next point, at once.
//! * New tetrahedra have their numbers before edges are joined, so that the table of edges holds
//!   final neighbour codes.
//!
//! Powers and spheres only filter here too, within the same bounds: the tetrahedra are the same.
#![allow(unsafe_code)]

use super::arena::{Arena, DEAD, FACE_FROM_BEYOND, FIRST_TAG, LAST_TAG, Margin, Tetra};
use super::scratch::{FACETS, FEW, LOG2_ROW, PADDED, VERTICES};
use super::simd::codes;
use crate::simd::may_use_all;
use std::arch::x86_64::*;
use std::sync::LazyLock;

/// Whether this machine can run [`insert`].
pub(super) fn is_available() -> bool {
    static FOUND: LazyLock<bool> = LazyLock::new(|| {
        super::simd::is_available()
            && may_use_all!(
                "AVX512F" = "avx512f",
                "AVX512VL" = "avx512vl",
                "AVX512DQ" = "avx512dq",
                "POPCNT" = "popcnt"
            )
    });
    *FOUND
}

/// [`Arena::insert_plain`] in wide vector code.
///
/// # Panics
/// Where the machine has no such instructions; detection is one cached load.
#[inline]
pub(super) fn insert(arena: &mut Arena, vertex: u32, next: Option<u32>) {
    assert!(is_available(), "the wide path is chosen only where it runs");
    // SAFETY: the features that the function needs have just been found.
    unsafe { arena.insert_wide(vertex, next) }
}

/// Rows to columns and back, of two times four rows.
#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
fn transpose([a, b, c, d]: [__m512d; 4]) -> [__m512d; 4] {
    let low = _mm512_set_epi64(13, 12, 5, 4, 9, 8, 1, 0);
    let high = _mm512_set_epi64(15, 14, 7, 6, 11, 10, 3, 2);
    let (ab_lo, ab_hi) = (_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
    let (cd_lo, cd_hi) = (_mm512_unpacklo_pd(c, d), _mm512_unpackhi_pd(c, d));
    [
        _mm512_permutex2var_pd(ab_lo, low, cd_lo),
        _mm512_permutex2var_pd(ab_hi, low, cd_hi),
        _mm512_permutex2var_pd(ab_lo, high, cd_lo),
        _mm512_permutex2var_pd(ab_hi, high, cd_hi),
    ]
}

/// The sums of two times four rows.
#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
fn sum_across([a, b, c, d]: [__m512d; 4]) -> __m512d {
    let low = _mm512_set_epi64(13, 12, 5, 4, 9, 8, 1, 0);
    let high = _mm512_set_epi64(15, 14, 7, 6, 11, 10, 3, 2);
    let ab = _mm512_add_pd(_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
    let cd = _mm512_add_pd(_mm512_unpacklo_pd(c, d), _mm512_unpackhi_pd(c, d));
    _mm512_add_pd(_mm512_permutex2var_pd(ab, low, cd), _mm512_permutex2var_pd(ab, high, cd))
}

/// Writes eight spheres, given as columns, to the records of these numbers.
///
/// # Safety
/// Eight numbers of records lie at `ids`, all of them at `tets`.
#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
unsafe fn store_spheres(tets: *mut Tetra, ids: *const u32, columns: [__m512d; 4]) {
    for (k, two) in transpose(columns).into_iter().enumerate() {
        // SAFETY: the caller's promise; a sphere is 32 aligned bytes.
        unsafe {
            let sphere = |k: usize| (*tets.add(*ids.add(k) as usize)).sphere.as_mut_ptr();
            _mm256_store_pd(sphere(k), _mm512_castpd512_pd256(two));
            _mm256_store_pd(sphere(k + 4), _mm512_extractf64x4_pd::<1>(two));
        }
    }
}

/// `a·b - c·d`; exact for differences of lattice coordinates.
#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
fn minor(a: __m512d, b: __m512d, c: __m512d, d: __m512d) -> __m512d {
    _mm512_fmsub_pd(a, b, _mm512_mul_pd(c, d))
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
fn dot(a: [__m512d; 3], b: [__m512d; 3]) -> __m512d {
    _mm512_fmadd_pd(a[2], b[2], _mm512_fmadd_pd(a[1], b[1], _mm512_mul_pd(a[0], b[0])))
}

#[inline]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
fn cross(a: [__m512d; 4], b: [__m512d; 4]) -> [__m512d; 3] {
    [minor(a[1], b[2], a[2], b[1]), minor(a[2], b[0], a[0], b[2]), minor(a[0], b[1], a[1], b[0])]
}

impl Margin {
    /// [`Margin::sphere`] of eight tetrahedra with the last vertex p: centres relative to p, and r²
    /// (all NaN where not trusted).
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn eight_spheres(&self, u: [__m512d; 4], v: [__m512d; 4], w: [__m512d; 4]) -> ([__m512d; 3], __m512d) {
        let (vw, wu, uv) = (cross(v, w), cross(w, u), cross(u, v));
        let d = dot([u[0], u[1], u[2]], vw);
        let inverse = _mm512_div_pd(_mm512_set1_pd(0.5), d);
        let weights = [u[3], v[3], w[3]];
        let h = [0, 1, 2].map(|k| _mm512_mul_pd(dot(weights, [vw[k], wu[k], uv[k]]), inverse));
        let r2 = dot(h, h);
        let m2 = _mm512_max_pd(u[3], _mm512_max_pd(v[3], w[3]));
        let scale = _mm512_max_pd(r2, _mm512_set1_pd(self.e));
        let m6 = _mm512_mul_pd(m2, _mm512_mul_pd(m2, m2));
        let left = _mm512_mul_pd(m6, _mm512_mul_pd(scale, scale));
        let right = _mm512_mul_pd(_mm512_set1_pd(self.most_kappa), _mm512_mul_pd(d, d));
        let refused = !(_mm512_cmp_pd_mask::<_CMP_LE_OQ>(left, right)
            & _mm512_cmp_pd_mask::<_CMP_LE_OQ>(r2, _mm512_set1_pd(self.most_r2)));
        let (h, r2) = if self.half_lattice { self.exact_of_eight(h, r2, [u, v, w]) } else { (h, r2) };
        let nan = _mm512_set1_pd(f64::NAN);
        let only_trusted = |x| _mm512_mask_mov_pd(x, refused, nan);
        (h.map(only_trusted), only_trusted(r2))
    }

    /// Replaces spheres whose centre is proven to lie on the half-lattice by the exact ones,
    /// lowered.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn exact_of_eight(
        &self,
        h: [__m512d; 3],
        r2: __m512d,
        legs: [[__m512d; 4]; 3],
    ) -> ([__m512d; 3], __m512d) {
        let twice = h.map(|c| {
            _mm512_roundscale_pd::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(_mm512_add_pd(c, c))
        });
        let most = _mm512_set1_pd(Self::MOST_EXACT);
        let mut exact = 0xff;
        for c in twice {
            exact &= _mm512_cmp_pd_mask::<_CMP_LE_OQ>(_mm512_abs_pd(c), most);
        }
        for l in legs {
            exact &= _mm512_cmp_pd_mask::<_CMP_EQ_OQ>(dot(twice, [l[0], l[1], l[2]]), l[3]);
        }
        let half = _mm512_set1_pd(0.5);
        let centre = twice.map(|c| _mm512_mul_pd(c, half));
        let lowered = _mm512_sub_pd(dot(centre, centre), _mm512_set1_pd(self.e + 0.5));
        let chosen: [__m512d; 3] = [0, 1, 2].map(|k| _mm512_mask_mov_pd(h[k], exact, centre[k]));
        (chosen, _mm512_mask_mov_pd(r2, exact, lowered))
    }
}

impl Arena {
    /// [`Arena::insert_plain`] for machines where [`is_available`]; called by [`insert`].
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn insert_wide(&mut self, vertex: u32, next: Option<u32>) {
        if self.cavity.is_empty() {
            let tet = self.locate(vertex);
            self.cavity.push(tet);
        }
        self.grow_cavity_wide(vertex);
        self.allocate();
        let facets = self.boundary.len();
        if facets > FACETS {
            return self.finish_avx2(vertex, next);
        }
        let vertices = self.number_wide();
        self.relative_wide(vertex, vertices);
        if vertices <= FEW {
            self.spheres_wide::<true>(vertex, next, facets);
        } else {
            self.spheres_wide::<false>(vertex, next, facets);
        }
        self.link_wide(vertex, facets);
    }

    /// Completes the cavity batch by batch, and lists its boundary.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn grow_cavity_wide(&mut self, vertex: u32) {
        for &tet in &self.cavity {
            self.tets[tet as usize].v[0] |= DEAD;
        }
        self.boundary.clear();
        let [x, y, z] = self.points[vertex as usize].f64s();
        let p = _mm512_set_pd(0.0, z, y, x, 0.0, z, y, x);
        let mut done = 0;
        while done < self.cavity.len() {
            self.cavity.reserve(16);
            self.boundary.reserve(16);
            done = self.grow_batch(vertex, p, done);
        }
    }

    /// Tests the neighbours of four tetrahedra of the cavity from place `done` on; returns the
    /// place after them. There is room for 16 more in `cavity` and `boundary`.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn grow_batch(&mut self, vertex: u32, p: __m512d, done: usize) -> usize {
        let len = self.cavity.len();
        let tets = self.tets.as_mut_ptr();
        // The last one stands in where there are not four. SAFETY: places are below the length of
        // `cavity`, whose entries are record numbers below the length of `tets`.
        let four = [0, 1, 2, 3]
            .map(|k| unsafe { tets.add(*self.cavity.get_unchecked((done + k).min(len - 1)) as usize) });
        // SAFETY: these are records.
        let n = four.map(|record| unsafe { codes(record) });
        let valid = ((1u32 << (4 * (len - done).min(4))) - 1) as u16;
        // SAFETY: neighbour codes divided by four are below the length of `tets`; spheres are 32
        // aligned bytes.
        let row = |code: u32| unsafe { _mm256_load_pd((*tets.add((code >> 2) as usize)).sphere.as_ptr()) };
        let (mut inside, mut outside) = (0, 0);
        let (above, below) = (_mm512_set1_pd(self.margin.above), _mm512_set1_pd(-self.margin.e));
        let minus_one = _mm512_set1_pd(-1.0);
        for half in [0, 1] {
            let (first, second) = (n[2 * half], n[2 * half + 1]);
            // (dx², dy², dz², -r²) of two records, summed across with three others.
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| {
                let both = _mm512_insertf64x4::<1>(_mm512_castpd256_pd512(row(first[k])), row(second[k]));
                let d = _mm512_sub_pd(both, p);
                _mm512_mul_pd(d, _mm512_mask_mov_pd(d, 0x88, minus_one))
            });
            let power = sum_across([a, b, c, d]);
            inside |= u16::from(_mm512_cmp_pd_mask::<_CMP_LT_OQ>(power, below)) << (8 * half);
            outside |= u16::from(_mm512_cmp_pd_mask::<_CMP_GT_OQ>(power, above)) << (8 * half);
        }
        inside &= valid;
        let unsure = valid & !(inside | outside);
        if unsure != 0 {
            inside |= self.ask_the_integers_wide(vertex, &n, unsure);
        }
        self.sort_batch(&n, inside, valid & !inside);
        (done + 4).min(len)
    }

    #[cold]
    fn ask_the_integers_wide(&self, vertex: u32, n: &[[u32; 4]; 4], unsure: u16) -> u16 {
        (0..16).filter(|i| unsure >> i & 1 == 1).fold(0, |inside, i| {
            inside | u16::from(self.conflicts_exactly(n[i / 4][i % 4] >> 2, vertex)) << i
        })
    }

    /// Adds the neighbours inside to the cavity, where they are not yet in it, and lists the
    /// others.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn sort_batch(&mut self, n: &[[u32; 4]; 4], inside: u16, outside: u16) {
        let lanes = n.map(|n| _mm_set_epi32(n[3] as i32, n[2] as i32, n[1] as i32, n[0] as i32));
        let low = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(lanes[0]), lanes[1]);
        let high = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(lanes[2]), lanes[3]);
        let all = _mm512_inserti64x4::<1>(_mm512_castsi256_si512(low), high);
        let mut found = [0u32; 16];
        let (boundary_len, mut cavity_len) = (self.boundary.len(), self.cavity.len());
        // SAFETY: both lists have room for 16 more, which is what is written; `found` is 64 bytes;
        // its entries are neighbour codes divided by four, below the length of `tets`.
        unsafe {
            let at = self.boundary.as_mut_ptr().add(boundary_len);
            _mm512_storeu_si512(at.cast(), _mm512_maskz_compress_epi32(outside, all));
            self.boundary.set_len(boundary_len + outside.count_ones() as usize);
            let ids = _mm512_srli_epi32::<2>(_mm512_maskz_compress_epi32(inside, all));
            _mm512_storeu_si512(found.as_mut_ptr().cast(), ids);
            let (tets, cavity) = (self.tets.as_mut_ptr(), self.cavity.as_mut_ptr());
            for &there in found.iter().take(inside.count_ones() as usize) {
                let first = &mut (*tets.add(there as usize)).v[0];
                *cavity.add(cavity_len) = there;
                cavity_len += (!*first >> 31) as usize;
                *first |= DEAD;
            }
            self.cavity.set_len(cavity_len);
        }
    }

    /// Numbers the vertices of the boundary, enters its edges in the table, and copies what records
    /// are about to lose. Returns the number of vertices.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn number_wide(&mut self) -> usize {
        if self.tag > LAST_TAG {
            self.points.iter_mut().for_each(|p| p.tag = 0);
            self.tag = FIRST_TAG;
        }
        let (tets, points, base) = (self.tets.as_ptr(), self.points.as_mut_ptr(), self.tag);
        let scratch = &mut *self.wide;
        let mut known = 0u32;
        let facets = self.boundary.iter().zip(&self.star.id).take(FACETS).enumerate();
        for (k, (&code, &id)) in facets {
            scratch.id[k] = id;
            // SAFETY: codes divided by four are below the length of `tets`, vertices below that of
            // `points`; `k` is below FACETS and `known` at most 3·k, for which `vertices` and
            // `edges` have room.
            unsafe {
                let v = _mm_load_si128((&raw const (*tets.add((code >> 2) as usize)).v).cast());
                let turn = _mm_load_si128(TURNS.0[(code & 3) as usize].as_ptr().cast());
                let turned = _mm_castps_si128(_mm_permutevar_ps(_mm_castsi128_ps(v), turn));
                let facet = _mm_insert_epi32::<3>(turned, code as i32);
                _mm_store_si128(scratch.facet.as_mut_ptr().add(k).cast(), facet);
                let corners = [
                    _mm_cvtsi128_si32(turned),
                    _mm_extract_epi32::<1>(turned),
                    _mm_extract_epi32::<2>(turned),
                ];
                let [a, b, c] = corners.map(|v| {
                    let tag = &mut (*points.add(v as u32 as usize)).tag;
                    let number = tag.wrapping_sub(base).min(known);
                    *tag = base + number;
                    *scratch.vertices.get_unchecked_mut(known as usize) = v as u32;
                    known += u32::from(number == known);
                    number
                });
                for (face, (from, to)) in [(b, c), (c, a), (a, b)].into_iter().enumerate() {
                    let at = (from << LOG2_ROW) as usize + to as usize;
                    *scratch.edges.get_unchecked_mut(at) = id << 2 | face as u32;
                }
                for (corner, number) in scratch.corner.iter_mut().zip([a, b, c]) {
                    *corner.get_unchecked_mut(k) = number;
                }
            }
        }
        self.tag += known;
        assert!(known as usize <= VERTICES, "a closed surface of so few facets has no more vertices");
        known as usize
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn relative_wide(&mut self, vertex: u32, count: usize) {
        let p = self.points[vertex as usize].f64s().map(|c| _mm512_set1_pd(c));
        let points = self.points.as_ptr();
        // Stale numbers beyond the last are not looked at: the last stands in.
        let last = count - 1;
        for start in (0..count).step_by(8) {
            let row = |k: usize| {
                let v = self.wide.vertices[(start + k).min(last)];
                // SAFETY: vertices are below the length of `points`. Loaded without the tag: it was
                // stored a moment ago, and a load that spans it would wait for the store.
                unsafe {
                    let at: *const f32 = (*points.add(v as usize)).at.as_ptr();
                    let xy = _mm_castpd_ps(_mm_load_sd(at.cast()));
                    _mm_insert_ps::<0b10_0000>(xy, _mm_load_ss(at.add(2)))
                }
            };
            let pair = |k| _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(row(k)), row(k + 4));
            let (a, b, c, d) = (pair(0), pair(1), pair(2), pair(3));
            let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
            let (ab_z, cd_z) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
            let both = |lo, hi| (_mm256_castps_pd(lo), _mm256_castps_pd(hi));
            let (lo, hi) = both(ab, cd);
            let (lo_z, hi_z) = both(ab_z, cd_z);
            let xyz =
                [_mm256_unpacklo_pd(lo, hi), _mm256_unpackhi_pd(lo, hi), _mm256_unpacklo_pd(lo_z, hi_z)];
            let d: [__m512d; 3] = std::array::from_fn(|axis| {
                _mm512_sub_pd(_mm512_cvtps_pd(_mm256_castpd_ps(xyz[axis])), p[axis])
            });
            for (axis, values) in [d[0], d[1], d[2], dot(d, d)].into_iter().enumerate() {
                // SAFETY: `start` is a multiple of 8 below 32: eight doubles of the row.
                unsafe { _mm512_store_pd(self.wide.relative[axis].as_mut_ptr().add(start), values) };
            }
        }
    }

    /// Makes the new spheres and writes them; those that hold the next point become the next
    /// cavity's seeds. `FIT`: the vertices fit in half the registers.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn spheres_wide<const FIT: bool>(&mut self, vertex: u32, next: Option<u32>, count: usize) {
        let p = self.points[vertex as usize].f64s().map(|c| _mm512_set1_pd(c));
        let q =
            next.map_or([f64::NAN; 3], |next| self.points[next as usize].f64s()).map(|c| _mm512_set1_pd(c));
        let below = _mm512_set1_pd(-self.margin.e);
        let scratch = &mut *self.wide;
        scratch.repeat_last(count);
        // SAFETY: four times eight doubles a row.
        let table = scratch
            .relative
            .each_ref()
            .map(|row| [0, 1, 2, 3].map(|k| unsafe { _mm512_load_pd(row.as_ptr().add(8 * k)) }));
        let (mut least, mut least_at) = (_mm512_set1_pd(f64::INFINITY), _mm512_setzero_pd());
        let mut places = _mm512_set_pd(7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.0);
        let tets = self.tets.as_mut_ptr();
        self.cavity.reserve(PADDED);
        let mut seeds_len = 0;
        for start in (0..count).step_by(8) {
            let [u, v, w] = scratch.corner.each_ref().map(|corner| {
                // SAFETY: `start + 8` is at most PADDED.
                let numbers = unsafe { _mm256_loadu_si256(corner.as_ptr().add(start).cast()) };
                let numbers = _mm512_cvtepu32_epi64(numbers);
                table.map(|row| {
                    let low = _mm512_permutex2var_pd(row[0], numbers, row[1]);
                    if FIT {
                        return low;
                    }
                    let high = _mm512_permutex2var_pd(row[2], numbers, row[3]);
                    _mm512_mask_mov_pd(low, _mm512_test_epi64_mask(numbers, _mm512_set1_epi64(16)), high)
                })
            });
            let (h, r2) = self.margin.eight_spheres(u, v, w);
            let c: [__m512d; 3] = std::array::from_fn(|k| _mm512_add_pd(p[k], h[k]));
            let d: [__m512d; 3] = std::array::from_fn(|k| _mm512_sub_pd(q[k], c[k]));
            let power = _mm512_sub_pd(dot(d, d), r2);
            let less = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(power, least);
            least = _mm512_mask_mov_pd(least, less, power);
            least_at = _mm512_mask_mov_pd(least_at, less, places);
            places = _mm512_add_pd(places, _mm512_set1_pd(8.0));
            let real = ((1u32 << (count - start).min(8)) - 1) as u8;
            let seeds = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(power, below) & real;
            // SAFETY: the cavity is empty and has room for PADDED; eight ids lie at `start`, record
            // numbers below the length of `tets`.
            unsafe {
                let ids = scratch.id.as_ptr().add(start);
                let at = self.cavity.as_mut_ptr().add(seeds_len);
                let packed = _mm256_maskz_compress_epi32(seeds, _mm256_loadu_si256(ids.cast()));
                _mm256_storeu_si256(at.cast(), packed);
                seeds_len += seeds.count_ones() as usize;
                store_spheres(tets, ids, [c[0], c[1], c[2], r2]);
            }
        }
        // SAFETY: that many were written.
        unsafe { self.cavity.set_len(seeds_len) };
        if seeds_len == 0 {
            self.hint = scratch.id[first_least(least, least_at).min(count - 1)];
        }
    }

    /// Writes the vertices and neighbours of the new tetrahedra, and their codes into what lies
    /// across.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
    fn link_wide(&mut self, vertex: u32, count: usize) {
        let scratch = &*self.wide;
        let tets = self.tets.as_mut_ptr();
        let apex = _mm_set1_epi32(vertex as i32);
        for k in 0..count {
            // SAFETY: `k` is below PADDED; ids and codes divided by four are below the length of
            // `tets`; local numbers are below 32, so table indices are in range.
            unsafe {
                let id = *scratch.id.get_unchecked(k);
                let [i, j, l] = scratch.corner.each_ref().map(|c| *c.get_unchecked(k) as usize);
                let facet = _mm_load_si128(scratch.facet.as_ptr().add(k).cast());
                let edge =
                    |from: usize, to: usize| *scratch.edges.get_unchecked((from << LOG2_ROW) + to) as i32;
                let n = _mm_set_epi32(0, edge(j, i), edge(i, l), edge(l, j));
                let record = tets.add(id as usize);
                _mm_store_si128((&raw mut (*record).v).cast(), _mm_blend_epi32::<0b1000>(facet, apex));
                _mm_store_si128((&raw mut (*record).n).cast(), _mm_blend_epi32::<0b1000>(n, facet));
                let out = scratch.facet.get_unchecked(k)[3];
                (*tets.add((out >> 2) as usize)).n[(out & 3) as usize] = id << 2 | 3;
            }
        }
    }
}

/// [`FACE_FROM_BEYOND`] as lanes; the fourth is not used.
#[repr(align(16))]
struct Turns([[u32; 4]; 4]);

static TURNS: Turns = {
    let mut turns = [[0; 4]; 4];
    let mut face = 0;
    while face < 4 {
        let [a, b, c] = FACE_FROM_BEYOND[face];
        turns[face] = [a as u32, b as u32, c as u32, 0];
        face += 1;
    }
    Turns(turns)
};

/// The place of the least power of the eight lanes.
#[cold]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,popcnt")]
fn first_least(least: __m512d, at: __m512d) -> usize {
    let (mut powers, mut places) = ([0.0; 8], [0.0; 8]);
    // SAFETY: eight doubles each.
    unsafe {
        _mm512_storeu_pd(powers.as_mut_ptr(), least);
        _mm512_storeu_pd(places.as_mut_ptr(), at);
    }
    let best = (1..8).fold(0, |best, k| if powers[k] < powers[best] { k } else { best });
    places[best] as usize
}
