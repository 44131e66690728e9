//! The points near one, and its star closed among them, with AVX-512.
//!
//! Coordinates are relative to the point: differences of integers, below 2^24, times a power of two, hence exact in `f32`. A gate's apex is guessed in `f32`;
//! the spheres of all new tetrahedra are made in `f64` and held against all points nearby in `f32`, and against what comes close in `f64`.
//!
//! # Error bounds
//! Let u = 2^-24, v = 2^-53, and 0, a, b, c a tetrahedron relative to its point, |a|, |b|, |c| ≤ D; det = a·(b×c), and
//! k = (|a|² b×c + |b|² c×a + |c|² a×b) / det twice the centre of its sphere; K the larger of |k| and D. A point q lies outside when S(q) = |q|² - k·q > 0.
//!
//! *The sphere.* Coordinates of the cross products are integers below 2^50, squared lengths too: exact in `f64`. det is a sum of three products, by fused steps: its
//! error is below 4v·D³. We take only det ≥ 2^-26·D³; so orientations are certain. A coordinate of k is a sum of three terms, each at most D⁴/det and with
//! seven roundings at most, and has the relative error of det besides: it is off by less than e = 32v·D³K/det ≤ 2^-22·K.
//!
//! *In `f32`.* For |q| ≤ D, |q|² is off by 3u·D², rounding k costs u·KD, the three fused steps 9u·KD, and e at most √3·2^-22·KD: in all less than 2^-19.6·KD.
//! What is 2^-19·KD or more lies outside.
//!
//! *In `f64`.* |q|² is exact, the steps cost 9v·KD, e at most 56v·D⁴K/det; KD ≤ D⁴K/det. What is more than 128v·D⁴K/det lies outside.
//!
//! *How far a sphere reaches.* No point lies outside of the domain, a box. Let k' be k, each coordinate moved into twice the box (seen from the point). A point x of the
//! box has |x - k/2|² ≥ |x - k'/2|² + |k/2 - k'/2|²; so what the sphere holds of the box lies in a ball around k'/2 of radius r, 4r² = |k|² - |k - k'|², which is the sum of k'(2k - k') over the axes.
//! The point is in it, so nothing in it is further than 2r from it; and |k'| ≤ 2r. We take only 4r² ≤ (1 - 2^-12)·D², as it is computed: with an error of at most
//! 2√3·D·e ≤ 2^-13·D², where KD² ≤ 2^33·det. The list has all points with |q| ≤ (1 - 2^-21)·D.
#![allow(unsafe_code)]

use super::{Grid, LANES, Star};
use crate::cpu::may_use;
use crate::mesh::tet::Tet;
use glam::DVec3;
use std::arch::x86_64::*;
use std::sync::LazyLock;

/// The most points that are looked at, the one itself included.
const MOST: usize = 128;
const LOG2_MOST: u32 = MOST.trailing_zeros();
const PLACE: usize = MOST - 1;
/// With room for a batch more.
const ROOM: usize = MOST + LANES;
/// A link of V vertices has 2V - 4 triangles.
const TRIANGLES: usize = 2 * MOST;
/// A triangle opens two gates at most, and others wait from before.
const GATES: usize = 4 * TRIANGLES;
/// The most faces that may wait for a point.
const WAITING: usize = TRIANGLES;
/// No place in a list.
const NOWHERE: usize = MOST;

const LEAST_VOLUME: f64 = 1.0 / (1u64 << 26) as f64;
const WITHIN: f64 = 1.0 - 1.0 / (1u64 << 12) as f64;
const LARGEST: f64 = (1u64 << 33) as f64;
const OUTSIDE: f64 = 1.001 / (1u64 << 19) as f64;
const OUTSIDE_F64: f64 = 128.0 / (1u64 << 53) as f64;

/// Proof that this machine has the instructions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wide(());

impl Wide {
    /// Looks for them.
    pub(super) fn found() -> Option<Self> {
        static FOUND: LazyLock<bool> = LazyLock::new(is_available);
        FOUND.then_some(Self(()))
    }
}

fn is_available() -> bool {
    may_use(&["AVX2", "BMI1", "BMI2", "FMA", "LZCNT", "POPCNT", "AVX512F", "AVX512VL", "AVX512DQ"])
        && is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("fma")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt")
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq")
}

/// How a point looks around.
pub(super) struct View {
    pub(super) p: u32,
    /// Its coordinates, as those of the grid.
    pub(super) at: [f32; 3],
    /// Whether no tetrahedron at it is known.
    pub(super) is_new: bool,
    /// How far: D.
    pub(super) reach: f32,
    /// The domain's ends on each axis, relative to the point.
    pub(super) domain: [[f64; 2]; 3],
}

/// The points near one, and what is known of its link. A place is where a point is in the lists.
#[derive(Debug)]
#[repr(C, align(64))]
pub(super) struct Neighbourhood {
    /// Coordinates relative to the point, and squared lengths.
    at: [[f32; ROOM]; 4],
    ids: [u32; ROOM],
    /// `[a << LOG2_MOST | b]`: whether the edge ab of a triangle that is known has none on its other side.
    open: [u8; MOST * MOST],
    /// Edges that were opened, as such indices, in that order.
    queue: [u16; GATES],
    /// The new triangles, by places, and the coordinates of their corners: three of each.
    found: [[u32; 3]; TRIANGLES],
    corners: [[f32; TRIANGLES]; 9],
    /// Twice the centres of their spheres, and from which power on a point is outside.
    centres: [[f32; TRIANGLES]; 4],
    count: usize,
    triangles: usize,
    /// The faces that wait for the point: ids of the other two, as they follow each other in a known triangle.
    pub(super) gates: Vec<[u32; 2]>,
}

impl Default for Box<Neighbourhood> {
    fn default() -> Self {
        Box::new(Neighbourhood {
            at: [[0.0; ROOM]; 4],
            ids: [0; ROOM],
            open: [0; MOST * MOST],
            queue: [0; GATES],
            found: [[0; 3]; TRIANGLES],
            corners: [[0.0; TRIANGLES]; 9],
            centres: [[0.0; TRIANGLES]; 4],
            count: 0,
            triangles: 0,
            gates: vec![],
        })
    }
}

impl Neighbourhood {
    /// Closes the star of point `p` among those within the reach.
    pub(super) fn star(
        &mut self,
        _: Wide,
        grid: &Grid,
        rows: &[[u32; 2]],
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star {
        // SAFETY: there is a proof that the instructions were found.
        unsafe {
            if self.gather(&grid.at, &grid.ids, rows, view.at, view.reach) {
                self.close(view, is_outer)
            } else {
                Star::Doubtful
            }
        }
    }

    /// Lists the points within `reach` of `p`, itself included; false if they are too many. `rows` are ranges of places in `at` and `ids`, behind which those go
    /// on for [`LANES`] more.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn gather(
        &mut self,
        at: &[Vec<f32>; 3],
        ids: &[u32],
        rows: &[[u32; 2]],
        p: [f32; 3],
        reach: f32,
    ) -> bool {
        let end = rows.iter().map(|row| row[1] as usize).max().unwrap_or(0);
        assert!(
            at.iter().map(Vec::len).chain([ids.len()]).all(|n| n >= end + LANES),
            "room behind the lists"
        );
        let [x, y, z] = [0, 1, 2].map(|a| at[a].as_ptr());
        let [px, py, pz] = p.map(|c| _mm512_set1_ps(c));
        let within = _mm512_set1_ps(reach * reach);
        let mut count = 0;
        for &[start, end] in rows {
            let mut i = start as usize;
            while i < end as usize {
                // SAFETY: the lists go on for LANES beyond `end`, as asserted; ours for LANES beyond MOST, and `count` is at most that.
                unsafe {
                    let dx = _mm512_sub_ps(_mm512_loadu_ps(x.add(i)), px);
                    let dy = _mm512_sub_ps(_mm512_loadu_ps(y.add(i)), py);
                    let dz = _mm512_sub_ps(_mm512_loadu_ps(z.add(i)), pz);
                    let id = _mm512_loadu_epi32(ids.as_ptr().add(i).cast());
                    let square = _mm512_fmadd_ps(dx, dx, _mm512_fmadd_ps(dy, dy, _mm512_mul_ps(dz, dz)));
                    let lanes = _bzhi_u32(0xffff, (end - i as u32).min(LANES as u32)) as u16;
                    let near = _mm512_mask_cmp_ps_mask::<_CMP_LE_OQ>(lanes, square, within);
                    let mut list = |a: usize| self.at[a].as_mut_ptr().wrapping_add(count);
                    _mm512_storeu_ps(list(0), _mm512_maskz_compress_ps(near, dx));
                    _mm512_storeu_ps(list(1), _mm512_maskz_compress_ps(near, dy));
                    _mm512_storeu_ps(list(2), _mm512_maskz_compress_ps(near, dz));
                    _mm512_storeu_epi32(
                        self.ids.as_mut_ptr().add(count).cast(),
                        _mm512_maskz_compress_epi32(near, id),
                    );
                    count += near.count_ones() as usize;
                }
                if count > MOST {
                    return false;
                }
                i += LANES;
            }
        }
        self.count = count;
        true
    }

    /// Closes the star among the points that are listed. `is_outer` tells of three points a, b, c whether nothing of the domain can lie beyond them, where (a, b, c, x)
    /// is negatively oriented.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn close(&mut self, view: &View, is_outer: impl Fn([u32; 3]) -> bool) -> Star {
        let star = match self.count.div_ceil(LANES) {
            0..=2 => self.close_among::<2>(view, is_outer),
            3 => self.close_among::<3>(view, is_outer),
            4 => self.close_among::<4>(view, is_outer),
            5 | 6 => self.close_among::<6>(view, is_outer),
            _ => self.close_among::<8>(view, is_outer),
        };
        if !matches!(star, Star::Whole) {
            self.open.fill(0);
        }
        star
    }

    /// As [`Neighbourhood::close`], among so many batches of points.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn close_among<const N: usize>(&mut self, view: &View, is_outer: impl Fn([u32; 3]) -> bool) -> Star {
        self.pad::<N>();
        let Some(gates) = (if view.is_new { self.begin() } else { self.open_waiting::<N>() }) else {
            return Star::TooNear;
        };
        if !self.follow::<N>(gates, view, is_outer) {
            return Star::TooNear;
        }
        match self.spheres(view) {
            Star::Whole if self.are_empty::<N>(view.reach) => Star::Whole,
            Star::Whole => Star::Doubtful,
            other => other,
        }
    }

    /// Fills up the batches with points that are nowhere, and squares the lengths.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn pad<const N: usize>(&mut self) {
        let [x, y, z, square] = &mut self.at;
        for place in (self.count..N * LANES).step_by(LANES) {
            store(x, place, _mm512_set1_ps(f32::NAN));
            self.ids[place..place + LANES].fill(u32::MAX);
        }
        for place in (0..N * LANES).step_by(LANES) {
            let [x, y, z] = [load(x, place), load(y, place), load(z, place)];
            store(square, place, _mm512_fmadd_ps(x, x, _mm512_fmadd_ps(y, y, _mm512_mul_ps(z, z))));
        }
    }

    /// Opens the first gate of a star of which nothing is known: of the nearest point and the one that makes the smallest circle with it.
    fn begin(&mut self) -> Option<usize> {
        let squares = &self.at[3][..self.count];
        let others = || (0..squares.len()).filter(|&i| squares[i] > 0.0);
        let a = others().min_by(|&i, &j| squares[i].total_cmp(&squares[j]))?;
        let circle = |b: usize| {
            let (u, v) = (self.relative(a), self.relative(b));
            let n = u.cross(v);
            let m = u.length_squared() * v.cross(n) + v.length_squared() * n.cross(u);
            let squared = m.length_squared() / n.length_squared().powi(2);
            if squared.is_nan() { f64::INFINITY } else { squared }
        };
        let b = others().filter(|&b| b != a).min_by(|&b, &c| circle(b).total_cmp(&circle(c)))?;
        // Both sides of the face: the second closes by itself, or is the domain's boundary.
        for (n, (a, b)) in [(a, b), (b, a)].into_iter().enumerate() {
            let edge = a << LOG2_MOST | b;
            self.open[edge] = 1;
            self.queue[n] = edge as u16;
        }
        Some(2)
    }

    /// Opens the gates that wait, as many as are left when those with two sides are gone; `None` if a corner is not in the list.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn open_waiting<const N: usize>(&mut self) -> Option<usize> {
        if self.gates.len() > WAITING {
            return None;
        }
        let mut tail = 0;
        for gate in 0..self.gates.len() {
            let [a, b] = self.gates[gate].map(|id| self.place::<N>(id));
            if a.max(b) == NOWHERE {
                return None;
            }
            self.toggle(a, b, &mut tail);
        }
        Some(tail)
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn place<const N: usize>(&self, id: u32) -> usize {
        let id = _mm512_set1_epi32(id as i32);
        let mut found = 0u128;
        for batch in 0..N {
            // SAFETY: a batch of the list.
            let ids = unsafe { _mm512_loadu_epi32(self.ids.as_ptr().add(batch * LANES).cast()) };
            found |= u128::from(_mm512_cmpeq_epi32_mask(ids, id)) << (batch * LANES);
        }
        found.trailing_zeros() as usize
    }

    /// Notes the edge ab of a triangle: it closes the gate ba, or is one.
    #[inline(always)]
    fn toggle(&mut self, a: usize, b: usize, tail: &mut usize) {
        let (a, b) = (a & PLACE, b & PLACE);
        let (edge, back) = (a << LOG2_MOST | b, b << LOG2_MOST | a);
        let closes = std::mem::take(&mut self.open[back]);
        self.open[edge] = closes ^ 1;
        self.queue[*tail] = edge as u16;
        *tail += usize::from(closes ^ 1);
    }

    /// Follows gates until none is open; false where nothing is found behind one that is not in the domain's boundary.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn follow<const N: usize>(
        &mut self,
        mut tail: usize,
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> bool {
        let [x, y, z, square] =
            [0, 1, 2, 3].map(|k| std::array::from_fn::<_, N, _>(|batch| load(&self.at[k], batch * LANES)));
        let infinite = _mm512_set1_ps(f32::INFINITY);
        let (mut head, mut count) = (0, 0);
        while head != tail {
            let gate = usize::from(self.queue[head]);
            head += 1;
            if self.open[gate & (MOST * MOST - 1)] == 0 {
                continue;
            }
            let (a, b) = (gate >> LOG2_MOST & PLACE, gate & PLACE);
            let [ax, ay, az, aa] = [0, 1, 2, 3].map(|k| self.at[k][a]);
            let [bx, by, bz, bb] = [0, 1, 2, 3].map(|k| self.at[k][b]);
            // n = b×a points to where the apex is; the circle's centre is m/2|n|².
            let [nx, ny, nz] = [by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax];
            let nn = nx * nx + ny * ny + nz * nz;
            let [cx, cy, cz] = [ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx];
            let [ex, ey, ez] = [ny * bz - nz * by, nz * bx - nx * bz, nx * by - ny * bx];
            let [mx, my, mz] =
                [bb * cx + aa * ex, bb * cy + aa * ey, bb * cz + aa * ez].map(|c| _mm512_set1_ps(c));
            let [nx, ny, nz, nn] = [nx, ny, nz, nn].map(|c| _mm512_set1_ps(c));
            // What rounding may make of 0.
            let least = _mm512_set1_ps(5e-7 * view.reach * (aa * bb).sqrt());
            let (mut best, mut all) = (infinite, [infinite; N]);
            for (i, all) in all.iter_mut().enumerate() {
                let height = _mm512_fmadd_ps(x[i], nx, _mm512_fmadd_ps(y[i], ny, _mm512_mul_ps(z[i], nz)));
                let power = _mm512_fmsub_ps(square[i], nn, _mm512_mul_ps(z[i], mz));
                let power = _mm512_fnmadd_ps(x[i], mx, _mm512_fnmadd_ps(y[i], my, power));
                let in_front = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(height, least);
                *all = _mm512_mask_div_ps(infinite, in_front, power, height);
                best = _mm512_min_ps(best, *all);
            }
            let best = _mm512_reduce_min_ps(best);
            let mut found = 0u128;
            for (i, all) in all.into_iter().enumerate() {
                let equal = _mm512_cmp_ps_mask::<_CMP_EQ_OQ>(all, _mm512_set1_ps(best));
                found |= u128::from(equal) << (i * LANES);
            }
            self.open[gate & (MOST * MOST - 1)] = 0;
            if best == f32::INFINITY {
                if is_outer([view.p, self.ids[a], self.ids[b]]) {
                    continue;
                }
                return false;
            }
            let c = found.trailing_zeros() as usize & PLACE;
            if count == TRIANGLES || tail + 2 > GATES {
                return false;
            }
            self.toggle(a, c, &mut tail);
            self.toggle(c, b, &mut tail);
            self.found[count] = [b as u32, a as u32, c as u32];
            let apex = [0, 1, 2].map(|k| self.at[k][c]);
            for (corner, at) in self.corners.iter_mut().zip([[bx, by, bz], [ax, ay, az], apex].as_flattened())
            {
                corner[count] = *at;
            }
            count += 1;
        }
        self.triangles = count;
        true
    }

    /// Makes the spheres of the new tetrahedra.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn spheres(&mut self, view: &View) -> Star {
        let d = f64::from(view.reach);
        let (largest, least) = (_mm512_set1_pd(d * d * WITHIN), _mm512_set1_pd(d * d * d * LEAST_VOLUME));
        let outside = _mm512_set1_pd(OUTSIDE * d);
        let far = _mm512_set1_pd(LARGEST / (d * d));
        let domain = view.domain.map(|ends| ends.map(|c| _mm512_set1_pd(2.0 * c)));
        let (mut large, mut flat) = (0u8, 0u8);
        for first in (0..self.triangles).step_by(8) {
            let lanes = _bzhi_u32(0xff, (self.triangles - first).min(8) as u32) as u8;
            let coordinates = |k: usize| {
                let eight = &self.corners[k][first..first + 8];
                // SAFETY: eight of them.
                _mm512_cvtps_pd(unsafe { _mm256_loadu_ps(eight.as_ptr()) })
            };
            let [u, v, w] = [0, 3, 6].map(|k| [k, k + 1, k + 2].map(coordinates));
            let mul = |a, b| _mm512_mul_pd(a, b);
            let minor = |a: [__m512d; 3], b: [__m512d; 3], i: usize, j: usize| {
                _mm512_fmsub_pd(a[i], b[j], _mm512_mul_pd(a[j], b[i]))
            };
            let cross = |a, b| [minor(a, b, 1, 2), minor(a, b, 2, 0), minor(a, b, 0, 1)];
            let dot = |a: [__m512d; 3], b: [__m512d; 3]| {
                _mm512_fmadd_pd(a[0], b[0], _mm512_fmadd_pd(a[1], b[1], _mm512_mul_pd(a[2], b[2])))
            };
            let (vw, wu, uv) = (cross(v, w), cross(w, u), cross(u, v));
            let det = dot(u, vw);
            let by_det = _mm512_div_pd(_mm512_set1_pd(1.0), det);
            let [uu, vv, ww] = [u, v, w].map(|a| mul(dot(a, a), by_det));
            let k: [__m512d; 3] = std::array::from_fn(|a| {
                _mm512_fmadd_pd(vw[a], uu, _mm512_fmadd_pd(wu[a], vv, mul(uv[a], ww)))
            });
            flat |= lanes & _mm512_cmp_pd_mask::<_CMP_NGE_UQ>(det, least);
            let within: [__m512d; 3] =
                std::array::from_fn(|a| _mm512_min_pd(_mm512_max_pd(k[a], domain[a][0]), domain[a][1]));
            let beyond = std::array::from_fn(|a| _mm512_sub_pd(_mm512_add_pd(k[a], k[a]), within[a]));
            large |= lanes & _mm512_cmp_pd_mask::<_CMP_NLE_UQ>(dot(within, beyond), largest);
            let kk = dot(k, k);
            let far = mul(det, far);
            flat |= lanes & _mm512_cmp_pd_mask::<_CMP_NLE_UQ>(kk, mul(far, far));
            let outside = mul(_mm512_sqrt_pd(_mm512_max_pd(kk, _mm512_set1_pd(d * d))), outside);
            for (a, k) in k.into_iter().chain([outside]).enumerate() {
                let centres = self.centres[a][first..first + 8].as_mut_ptr();
                // SAFETY: eight of them.
                unsafe { _mm256_storeu_ps(centres, _mm512_cvtpd_ps(k)) };
            }
        }
        match (large, flat) {
            (0, 0) => Star::Whole,
            (0, _) => Star::Doubtful,
            _ => Star::TooNear,
        }
    }

    /// Whether the spheres are proven to leave out all points but their own.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2,popcnt,lzcnt")]
    fn are_empty<const N: usize>(&self, reach: f32) -> bool {
        let [x, y, z, square] =
            [0, 1, 2, 3].map(|k| std::array::from_fn::<_, N, _>(|batch| load(&self.at[k], batch * LANES)));
        let (mut doubtful, mut which) = (0, [0u16; 8]);
        for triangle in 0..self.triangles {
            let [kx, ky, kz, outside] = self.centres.each_ref().map(|of| _mm512_set1_ps(of[triangle]));
            let mut near = 0u128;
            for i in 0..N {
                let power = _mm512_fnmadd_ps(z[i], kz, square[i]);
                let power = _mm512_fnmadd_ps(x[i], kx, _mm512_fnmadd_ps(y[i], ky, power));
                near |= u128::from(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(power, outside)) << (i * LANES);
            }
            // The tetrahedron's own are always near.
            which[doubtful & 7] = triangle as u16;
            doubtful += usize::from(near.count_ones() != 4);
        }
        doubtful <= which.len() && which[..doubtful].iter().all(|&t| self.is_empty(usize::from(t), reach))
    }

    /// Where a listed point is, seen from the one.
    fn relative(&self, place: usize) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|a| f64::from(self.at[a][place])))
    }

    /// Whether the sphere of a new tetrahedron is proven to leave out all points but its own.
    fn is_empty(&self, triangle: usize, reach: f32) -> bool {
        let [i, j, k] = self.found[triangle].map(|place| place as usize);
        let [u, v, w] = [i, j, k].map(|place| self.relative(place));
        let (vw, wu, uv) = (v.cross(w), w.cross(u), u.cross(v));
        let det = u.dot(vw);
        let [uu, vv, ww] = [u, v, w].map(|a| a.length_squared() / det);
        let centre = vw * uu + (wu * vv + uv * ww);
        let d = f64::from(reach);
        let outside = OUTSIDE_F64 * d.powi(4) * centre.length().max(d) / det;
        let mut zeros = 0;
        let spares = |place: usize| {
            let q = self.relative(place);
            let square = q.length_squared();
            zeros += usize::from(square == 0.0);
            square == 0.0 || [i, j, k].contains(&place) || square - centre.dot(q) > outside
        };
        (0..self.count).all(spares) && zeros == 1
    }

    /// Lists the new tetrahedra of the point, itself first.
    pub(super) fn tets(&self, p: u32, out: &mut Vec<Tet>) {
        out.extend(self.found[..self.triangles].iter().map(|triangle| {
            let [b, a, c] = triangle.map(|place| self.ids[place as usize & PLACE]);
            [p, b, a, c]
        }));
    }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn load(list: &[f32; ROOM], place: usize) -> __m512 {
    let batch = &list[place..place + LANES];
    // SAFETY: so many are there.
    unsafe { _mm512_loadu_ps(batch.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn store(list: &mut [f32; ROOM], place: usize, batch: __m512) {
    let to = &mut list[place..place + LANES];
    // SAFETY: so many are there.
    unsafe { _mm512_storeu_ps(to.as_mut_ptr(), batch) };
}
