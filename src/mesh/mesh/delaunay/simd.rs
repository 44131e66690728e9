//! An insertion with AVX2 and FMA: what `plain.rs` does, four neighbours and four facets at a time.
//!
//! The records of four neighbours are tested at once, a whole level of the breadth-first search
//! before any is sorted into "cavity" or "boundary", so that neither loop has a branch that depends
//! on geometry. The spheres of four new tetrahedra are made at once and, still in registers, tested
//! against the next point.
//!
//! The powers differ from the plain path's in their last bits. That does not change the result: a
//! power only decides where its error bound lets it, and the bound covers any order of summation,
//! fused or not (see `Margin`).
#![allow(unsafe_code)]

use super::arena::{Arena, DEAD, FACE_FROM_BEYOND, FIRST_TAG, INFINITE, LAST_TAG, Margin, Tetra};
use crate::simd::may_use_all;
use std::arch::x86_64::*;
use std::sync::LazyLock;

/// Vertices on a cavity up to which the edge table has rows of 64.
const SMALL: u32 = 64;
const LOG2_SMALL: u32 = 6;

/// Whether this machine can run [`Arena::insert_avx2`].
pub(super) fn is_available() -> bool {
    static FOUND: LazyLock<bool> = LazyLock::new(|| may_use_all!("AVX2" = "avx2", "FMA" = "fma"));
    *FOUND
}

/// [`Arena::insert_plain`] in vector code.
///
/// # Panics
/// Where the machine has no AVX2 and FMA; detection is one cached load.
#[inline]
pub(super) fn insert(arena: &mut Arena, vertex: u32, next: Option<u32>) {
    assert!(is_available(), "the vector path is chosen only where it runs");
    // SAFETY: the features that the function needs have just been found.
    unsafe { arena.insert_avx2(vertex, next) }
}

/// The neighbour codes, one load each. The codes of a fresh record were stored one by one a moment
/// ago, and a single wide load would wait for all of those stores to leave the store buffer (a
/// sixth of the whole time).
///
/// # Safety
/// `record` can be read.
#[inline]
pub(super) unsafe fn codes(record: *const Tetra) -> [u32; 4] {
    // SAFETY: the caller's promise.
    std::array::from_fn(|i| unsafe { (&raw const (*record).n[i]).read_volatile() })
}

/// Rows to columns.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn transpose([a, b, c, d]: [__m256d; 4]) -> [__m256d; 4] {
    let (ab_lo, ab_hi) = (_mm256_unpacklo_pd(a, b), _mm256_unpackhi_pd(a, b));
    let (cd_lo, cd_hi) = (_mm256_unpacklo_pd(c, d), _mm256_unpackhi_pd(c, d));
    [
        _mm256_permute2f128_pd::<0x20>(ab_lo, cd_lo),
        _mm256_permute2f128_pd::<0x20>(ab_hi, cd_hi),
        _mm256_permute2f128_pd::<0x31>(ab_lo, cd_lo),
        _mm256_permute2f128_pd::<0x31>(ab_hi, cd_hi),
    ]
}

/// `a·b - c·d`; exact for differences of lattice coordinates.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn minor(a: __m256d, b: __m256d, c: __m256d, d: __m256d) -> __m256d {
    _mm256_fmsub_pd(a, b, _mm256_mul_pd(c, d))
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn dot(a: [__m256d; 3], b: [__m256d; 3]) -> __m256d {
    _mm256_fmadd_pd(a[2], b[2], _mm256_fmadd_pd(a[1], b[1], _mm256_mul_pd(a[0], b[0])))
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn cross(a: [__m256d; 4], b: [__m256d; 4]) -> [__m256d; 3] {
    [minor(a[1], b[2], a[2], b[1]), minor(a[2], b[0], a[0], b[2]), minor(a[0], b[1], a[1], b[0])]
}

impl Margin {
    /// [`Margin::sphere`] of four tetrahedra with the last vertex p: centres relative to p, and r²
    /// (all NaN where not trusted).
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn four_spheres(&self, u: [__m256d; 4], v: [__m256d; 4], w: [__m256d; 4]) -> ([__m256d; 3], __m256d) {
        let (vw, wu, uv) = (cross(v, w), cross(w, u), cross(u, v));
        let d = dot([u[0], u[1], u[2]], vw);
        let inverse = _mm256_div_pd(_mm256_set1_pd(0.5), d);
        let weights = [u[3], v[3], w[3]];
        let h = [0, 1, 2].map(|k| _mm256_mul_pd(dot(weights, [vw[k], wu[k], uv[k]]), inverse));
        let r2 = dot(h, h);
        let m2 = _mm256_max_pd(u[3], _mm256_max_pd(v[3], w[3]));
        let scale = _mm256_max_pd(r2, _mm256_set1_pd(self.e));
        let m6 = _mm256_mul_pd(m2, _mm256_mul_pd(m2, m2));
        let left = _mm256_mul_pd(m6, _mm256_mul_pd(scale, scale));
        let right = _mm256_mul_pd(_mm256_set1_pd(self.most_kappa), _mm256_mul_pd(d, d));
        let trusted = _mm256_and_pd(
            _mm256_cmp_pd::<_CMP_LE_OQ>(left, right),
            _mm256_cmp_pd::<_CMP_LE_OQ>(r2, _mm256_set1_pd(self.most_r2)),
        );
        let nan = _mm256_set1_pd(f64::NAN);
        let only_trusted = |x| _mm256_blendv_pd(nan, x, trusted);
        if self.half_lattice {
            let (h, r2) = self.exact_where_possible(h, r2, [u, v, w]);
            return (h.map(only_trusted), only_trusted(r2));
        }
        (h.map(only_trusted), only_trusted(r2))
    }

    /// Replaces spheres whose centre is proven to lie on the half-lattice by the exact ones,
    /// lowered.
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn exact_where_possible(
        &self,
        h: [__m256d; 3],
        r2: __m256d,
        legs: [[__m256d; 4]; 3],
    ) -> ([__m256d; 3], __m256d) {
        let twice = h.map(|c| {
            _mm256_round_pd::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(_mm256_add_pd(c, c))
        });
        let sign = _mm256_set1_pd(-0.0);
        let most = _mm256_set1_pd(Self::MOST_EXACT);
        let mut exact = _mm256_castsi256_pd(_mm256_set1_epi64x(-1));
        for c in twice {
            exact = _mm256_and_pd(exact, _mm256_cmp_pd::<_CMP_LE_OQ>(_mm256_andnot_pd(sign, c), most));
        }
        for l in legs {
            let meets = _mm256_cmp_pd::<_CMP_EQ_OQ>(dot(twice, [l[0], l[1], l[2]]), l[3]);
            exact = _mm256_and_pd(exact, meets);
        }
        let half = _mm256_set1_pd(0.5);
        let centre = twice.map(|c| _mm256_mul_pd(c, half));
        let lowered = _mm256_sub_pd(dot(centre, centre), _mm256_set1_pd(self.e + 0.5));
        let chosen: [__m256d; 3] = [0, 1, 2].map(|k| _mm256_blendv_pd(h[k], centre[k], exact));
        (chosen, _mm256_blendv_pd(r2, lowered, exact))
    }
}

impl Arena {
    /// [`Arena::insert_plain`] for machines where [`is_available`]; called by [`insert`].
    #[target_feature(enable = "avx2,fma")]
    fn insert_avx2(&mut self, vertex: u32, next: Option<u32>) {
        if self.cavity.is_empty() {
            let tet = self.locate(vertex);
            self.cavity.push(tet);
        }
        self.grow_cavity_avx2(vertex);
        self.allocate();
        self.finish_avx2(vertex, next);
    }

    /// Fills a cavity whose boundary is known.
    #[target_feature(enable = "avx2,fma")]
    pub(super) fn finish_avx2(&mut self, vertex: u32, next: Option<u32>) {
        self.number_avx2(vertex);
        self.write_avx2(vertex, next);
        if self.local.len() > SMALL as usize {
            self.join_edges();
        }
    }

    /// The point in the first three lanes, 0 in the last.
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn lanes(&self, vertex: u32) -> __m256d {
        let [x, y, z] = self.points[vertex as usize].f64s();
        _mm256_set_pd(0.0, z, y, x)
    }

    /// Completes the cavity level by level, and lists its boundary.
    #[target_feature(enable = "avx2,fma")]
    fn grow_cavity_avx2(&mut self, vertex: u32) {
        for &tet in &self.cavity {
            self.tets[tet as usize].v[0] |= DEAD;
        }
        self.boundary.clear();
        let p = self.lanes(vertex);
        let mut start = 0;
        while start < self.cavity.len() {
            let end = self.cavity.len();
            self.test_level(vertex, p, start, end);
            self.sort_level(start, end);
            start = end;
        }
    }

    /// Tests the neighbours of a level: four bits for each of its tetrahedra.
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn test_level(&mut self, vertex: u32, p: __m256d, start: usize, end: usize) {
        let (above, below) = (_mm256_set1_pd(self.margin.above), _mm256_set1_pd(-self.margin.e));
        let minus_one = _mm256_set1_pd(-1.0);
        self.masks.clear();
        for at in start..end {
            // SAFETY: `at` is below the length of `cavity`, whose entries are record numbers below
            // the length of `tets`; so are the neighbour codes divided by four.
            let rows = unsafe {
                let tets = self.tets.as_ptr();
                let n = codes(tets.add(*self.cavity.get_unchecked(at) as usize));
                n.map(|code| _mm256_load_pd((*tets.add((code >> 2) as usize)).sphere.as_ptr()))
            };
            // (dx², dy², dz², -r²) of each, summed across.
            let [a, b, c, d] = rows.map(|row| {
                let d = _mm256_sub_pd(row, p);
                _mm256_mul_pd(d, _mm256_blend_pd::<0b1000>(d, minus_one))
            });
            let (ab, cd) = (_mm256_hadd_pd(a, b), _mm256_hadd_pd(c, d));
            let power =
                _mm256_add_pd(_mm256_permute2f128_pd::<0x20>(ab, cd), _mm256_permute2f128_pd::<0x31>(ab, cd));
            let mut inside = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LT_OQ>(power, below)) as u8;
            let outside = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_GT_OQ>(power, above)) as u8;
            if inside | outside != 15 {
                inside |= self.ask_the_integers(vertex, at, 15 & !(inside | outside));
            }
            self.masks.push(inside);
        }
    }

    #[cold]
    fn ask_the_integers(&self, vertex: u32, at: usize, unsure: u8) -> u8 {
        let n = self.tets[self.cavity[at] as usize].n;
        (0..4)
            .filter(|i| unsure >> i & 1 == 1)
            .fold(0, |inside, i| inside | u8::from(self.conflicts_exactly(n[i as usize] >> 2, vertex)) << i)
    }

    /// Sorts the neighbours of a level into the cavity, where they are not yet in it, or the
    /// boundary.
    #[inline]
    fn sort_level(&mut self, start: usize, end: usize) {
        let width = end - start;
        self.cavity.reserve(4 * width + 1);
        self.boundary.reserve(4 * width + 1);
        let (mut cavity_len, mut boundary_len) = (self.cavity.len(), self.boundary.len());
        let (tets, cavity, boundary) =
            (self.tets.as_mut_ptr(), self.cavity.as_mut_ptr(), self.boundary.as_mut_ptr());
        // SAFETY: entries of `cavity` and neighbour codes divided by four are below the length of
        // `tets`; the two lists have room for the four entries that each of `width` tetrahedra adds
        // at most and for the one written and not counted; all entries below the new lengths have
        // been written.
        unsafe {
            for (at, &mask) in (start..end).zip(&self.masks) {
                let tet = *cavity.add(at);
                let n = codes(tets.add(tet as usize));
                for (i, code) in n.into_iter().enumerate() {
                    let there = code >> 2;
                    let inside = u32::from(mask >> i & 1);
                    let first = &mut (*tets.add(there as usize)).v[0];
                    let fresh = inside & !(*first >> 31);
                    *first |= inside << 31;
                    *cavity.add(cavity_len) = there;
                    cavity_len += fresh as usize;
                    *boundary.add(boundary_len) = code;
                    boundary_len += 1 - inside as usize;
                }
            }
            self.cavity.set_len(cavity_len);
            self.boundary.set_len(boundary_len);
        }
    }

    /// Numbers the vertices of the boundary, enters its edges in the table, copies what records are
    /// about to lose, and makes the vertices relative to the new point.
    #[target_feature(enable = "avx2,fma")]
    fn number_avx2(&mut self, vertex: u32) {
        if self.tag > LAST_TAG {
            self.points.iter_mut().for_each(|p| p.tag = 0);
            self.tag = FIRST_TAG;
        }
        let count = self.boundary.len();
        // Whole groups of four are worked on later.
        let room = count.next_multiple_of(4);
        let star = &mut self.star;
        star.facet.resize(room.max(star.facet.len()), [0; 4]);
        star.local.resize(room.max(star.local.len()), [0; 4]);
        star.vertices.resize((3 * count + 1).max(star.vertices.len()), 0);
        star.edges.resize(star.edges.len().max(1 << (2 * LOG2_SMALL)), 0);
        let (tets, points, base) = (self.tets.as_ptr(), self.points.as_mut_ptr(), self.tag);
        let mut known = 0u32;
        for (k, &code) in self.boundary.iter().enumerate() {
            // SAFETY: codes divided by four are below the length of `tets`, vertices below that of
            // `points`; `k` is below the lengths of `facet` and `local`, `known` at most 3·k, below
            // that of `vertices`; table indices are below 64².
            unsafe {
                let beyond = &*tets.add((code >> 2) as usize);
                let corners = FACE_FROM_BEYOND[(code & 3) as usize].map(|i| *beyond.v.get_unchecked(i));
                let numbers = corners.map(|v| {
                    let tag = &mut (*points.add(v as usize)).tag;
                    let number = tag.wrapping_sub(base).min(known);
                    *tag = base + number;
                    *star.vertices.get_unchecked_mut(known as usize) = v;
                    known += u32::from(number == known);
                    number
                });
                *star.facet.get_unchecked_mut(k) = [corners[0], corners[1], corners[2], code];
                *star.local.get_unchecked_mut(k) = [numbers[0], numbers[1], numbers[2], 0];
                let [a, b, c] = numbers;
                for (face, (from, to)) in [(b, c), (c, a), (a, b)].into_iter().enumerate() {
                    let at = ((from % SMALL) << LOG2_SMALL) | (to % SMALL);
                    *star.edges.get_unchecked_mut(at as usize) = (4 * k + face) as u16;
                }
            }
        }
        for k in count..room {
            (star.facet[k], star.local[k]) = (star.facet[count - 1], star.local[count - 1]);
        }
        self.tag += known;
        self.relative_avx2(vertex, known as usize);
    }

    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn relative_avx2(&mut self, vertex: u32, count: usize) {
        let p = self.lanes(vertex);
        self.local.resize(count, [0.0; 4]);
        for (&v, local) in self.star.vertices[..count].iter().zip(&mut self.local) {
            // SAFETY: vertices are below the length of `points`; a point is 16 aligned bytes, a
            // local row 32 bytes.
            unsafe {
                let row = _mm_load_ps((&raw const *self.points.get_unchecked(v as usize)).cast());
                let d = _mm256_sub_pd(_mm256_cvtps_pd(row), p);
                let squares = _mm256_blend_pd::<0b1000>(_mm256_mul_pd(d, d), _mm256_setzero_pd());
                let halves = _mm256_add_pd(squares, _mm256_permute4x64_pd::<0b01_00_11_10>(squares));
                let sum = _mm256_hadd_pd(halves, halves);
                _mm256_storeu_pd(local.as_mut_ptr(), _mm256_blend_pd::<0b1000>(d, sum));
            }
        }
    }

    /// Writes the new tetrahedra, linked to the outside and (up to 64 vertices) among themselves;
    /// those in conflict with the next point become the next cavity's seeds.
    #[target_feature(enable = "avx2,fma")]
    fn write_avx2(&mut self, vertex: u32, next: Option<u32>) {
        let p = self.points[vertex as usize].f64s().map(|c| _mm256_set1_pd(c));
        let q =
            next.map_or([f64::NAN; 3], |next| self.points[next as usize].f64s()).map(|c| _mm256_set1_pd(c));
        let below = _mm256_set1_pd(-self.margin.e);
        let (mut least, mut least_at) = (_mm256_set1_pd(f64::INFINITY), _mm256_setzero_pd());
        let mut group = _mm256_set_pd(3.0, 2.0, 1.0, 0.0);
        let count = self.star.id.len();
        self.cavity.reserve(count + 1);
        let (seeds_at, mut seeds_len) = (self.cavity.as_mut_ptr(), 0);
        for start in (0..count).step_by(4) {
            // SAFETY: `local` of the star has whole groups of four (see `number_avx2`) of numbers
            // below the length of `local` of the arena.
            let [u, v, w] = [0, 1, 2].map(|corner| {
                let row = |k: usize| unsafe {
                    let number = self.star.local.get_unchecked(start + k)[corner];
                    _mm256_loadu_pd(self.local.get_unchecked(number as usize).as_ptr())
                };
                transpose([row(0), row(1), row(2), row(3)])
            });
            let (h, r2) = self.margin.four_spheres(u, v, w);
            let c = [0, 1, 2].map(|k| _mm256_add_pd(p[k], h[k]));
            let d = [0, 1, 2].map(|k| _mm256_sub_pd(q[k], c[k]));
            let power = _mm256_sub_pd(dot(d, d), r2);
            let less = _mm256_cmp_pd::<_CMP_LT_OQ>(power, least);
            least = _mm256_blendv_pd(least, power, less);
            least_at = _mm256_blendv_pd(least_at, group, less);
            group = _mm256_add_pd(group, _mm256_set1_pd(4.0));
            let seeds = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LT_OQ>(power, below));
            let rows = transpose([c[0], c[1], c[2], r2]);
            for (k, sphere) in (start..count.min(start + 4)).zip(rows) {
                self.write_one(k, vertex, sphere);
                // SAFETY: there is room for all `count` and one more. Without a branch: it would be
                // taken at random.
                unsafe { *seeds_at.add(seeds_len) = self.star.id[k] };
                seeds_len += (seeds >> (k - start) & 1) as usize;
            }
        }
        // SAFETY: that many were written.
        unsafe { self.cavity.set_len(seeds_len) };
        self.hint = self.star.id[first_least(least, least_at).min(count - 1)];
    }

    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn write_one(&mut self, k: usize, vertex: u32, sphere: __m256d) {
        let star = &self.star;
        // SAFETY: `k` is below the length of `id`, at most that of `facet` and `local`; ids and
        // codes divided by four are below the length of `tets`; table indices are below 64², and
        // what a table entry names was written in this insertion (or, for cavities above 64
        // vertices, is replaced afterwards: `min` keeps it in range).
        unsafe {
            let id = *star.id.get_unchecked(k);
            let [a, b, c, out] = *star.facet.get_unchecked(k);
            let [i, j, l, _] = star.local.get_unchecked(k).map(|n| n % SMALL);
            let across = |from: u32, to: u32| {
                let code = *star.edges.get_unchecked((to << LOG2_SMALL | from) as usize);
                let entry = usize::from(code >> 2).min(star.id.len() - 1);
                *star.id.get_unchecked(entry) << 2 | u32::from(code & 3)
            };
            let n = [across(j, l), across(l, i), across(i, j), out];
            let tets = self.tets.as_mut_ptr();
            let record: *mut Tetra = tets.add(id as usize);
            _mm256_store_pd((*record).sphere.as_mut_ptr(), sphere);
            (*record).v = [a, b, c, vertex];
            (*record).n = n;
            (*tets.add((out >> 2) as usize)).n[(out & 3) as usize] = id << 2 | 3;
        }
        debug_assert!(vertex != INFINITE);
    }
}

/// The place of the least power of the four lanes.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn first_least(least: __m256d, at: __m256d) -> usize {
    let (mut powers, mut places) = ([0.0; 4], [0.0; 4]);
    // SAFETY: four doubles each.
    unsafe {
        _mm256_storeu_pd(powers.as_mut_ptr(), least);
        _mm256_storeu_pd(places.as_mut_ptr(), at);
    }
    let best = (1..4).fold(0, |best, k| if powers[k] < powers[best] { k } else { best });
    places[best] as usize
}
