//! The points near one, and its star closed among them, with vectors.
//!
//! Coordinates are relative to the point: differences of integers, below 2^24, times a power of
//! two, hence exact in `f32`. A gate's apex is guessed in `f32`; the spheres of all new tetrahedra
//! are made in `f64` and held against all points nearby in `f32`, and against what comes close in
//! `f64`.
//!
//! # Error bounds
//! They hold for all vectors, whether products that are added or taken away are rounded by
//! themselves or fused. (In spheres, cross products are never fused: they are exact.)
//!
//! Let u = 2^-24, v = 2^-53, and 0, a, b, c a tetrahedron relative to its point, |a|, |b|, |c| ≤ D;
//! det = a·(b×c), and k = (|a|² b×c + |b|² c×a + |c|² a×b) / det twice the centre of its sphere; K
//! the larger of |k| and D. A point q lies outside when S(q) = |q|² - k·q > 0.
//!
//! *The sphere.* Coordinates of the cross products are integers below 2^50, squared lengths too:
//! exact in `f64`. det is a sum of three products: its error is below 4v·D³, for those of the
//! products are at most v·D³ together, and each of two sums adds as much. We take only det >
//! 2^-26·D³; so orientations are certain. A coordinate of k is a sum of three terms, each at most
//! D⁴/det and with seven roundings at most, and has the relative error of det besides: it is off by
//! less than e = 32v·D³K/det ≤ 2^-22·K.
//!
//! *In `f32`.* For |q| ≤ D, |q|² is off by 4u·D², rounding k costs u·KD, three products u·KD, three
//! sums 9u·KD, and e at most √3·2^-22·KD: in all less than 2^-19.4·KD. What is 2^-19·KD or more
//! lies outside.
//!
//! *In `f64`.* |q|² is exact, the steps cost 10v·KD, e at most 56v·D⁴K/det; KD ≤ D⁴K/det. What is
//! more than 128v·D⁴K/det lies outside.
//!
//! *How far a sphere reaches.* No point lies outside of the domain, a box. Let k' be k, each
//! coordinate moved into twice the box (seen from the point). A point x of the box has |x - k/2|²
//! ≥ |x - k'/2|² + |k/2 - k'/2|²; so what the sphere holds of the box lies in a ball around k'/2 of
//! radius r, 4r² = |k|² - |k - k'|², which is the sum of k'(2k - k') over the axes. The point is in
//! it, so nothing in it is further than 2r from it; and |k'| ≤ 2r. We take only 4r² < (1 -
//! 2^-12)·D², as it is computed: with an error of at most 2√3·D·e ≤ 2^-13·D², where KD² < 2^33·det.
//! The list has all points with |q| ≤ (1 - 2^-21)·D.

use super::batch::Batch;
use super::{LANES, Star, StarGrid};
use crate::mesh::tet::Tet;
use crate::simd::{Compress, F64s, Floats, Lanes, four, three};
use glam::DVec3;
use isospan_io::geom::vec3::cross;

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
    /// `[a << LOG2_MOST | b]`: whether the edge ab of a triangle that is known has none on its
    /// other side.
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
    /// The faces that wait for the point: ids of the other two, as they follow each other in a
    /// known triangle.
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
    /// How many vectors of so many lanes the listed points fill.
    pub(super) fn batches(&self, lanes: usize) -> usize {
        self.count.div_ceil(lanes)
    }

    /// Closes all gates, where a star was given up.
    pub(super) fn close_gates(&mut self) {
        self.open.fill(0);
    }

    /// Lists the points within `reach` of `p`, itself included; false if they are too many. `rows`
    /// are ranges of places in `at` and `ids`; both go on for [`LANES`] more behind each range.
    #[inline(always)]
    pub(super) fn gather<B: Batch>(
        &mut self,
        token: B::Token,
        grid: &StarGrid,
        rows: &[[u32; 2]],
        p: [f32; 3],
        reach: f32,
    ) -> bool {
        let ([x, y, z], ids) = (&grid.at, &grid.ids);
        let [px, py, pz] = three(|a| B::splat(token, p[a]));
        let within = B::splat(token, reach * reach);
        let mut count = 0;
        for &[start, end] in rows {
            let (mut i, end) = (start as usize, end as usize);
            while i < end {
                let dx = B::load(token, &x[i..]) - px;
                let dy = B::load(token, &y[i..]) - py;
                let dz = B::load(token, &z[i..]) - pz;
                let id = B::U32s::load(token, &ids[i..]);
                let square = dx.fast_mul_add(dx, dy.fast_mul_add(dy, dz * dz));
                let lanes = (1u32 << (end - i).min(B::LANES)) - 1;
                let near = B::bitmask(square.lt(within)) & lanes;
                put(&mut self.at[0], count, dx.compress(near));
                put(&mut self.at[1], count, dy.compress(near));
                put(&mut self.at[2], count, dz.compress(near));
                put(&mut self.ids, count, id.compress(near));
                count += near.count_ones() as usize;
                if count > MOST {
                    return false;
                }
                i += B::LANES;
            }
        }
        self.count = count;
        true
    }

    /// Closes the star among the points that are listed, in so many batches. For three points a, b,
    /// c, `is_outer` says whether nothing of the domain can lie beyond them, where (a, b, c, x) is
    /// negatively oriented.
    #[inline(always)]
    pub(super) fn close<const N: usize, B: Batch>(
        &mut self,
        token: B::Token,
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> Star {
        self.pad::<N, B>(token);
        let Some(gates) = (if view.is_new { self.begin() } else { self.open_waiting::<N, B>(token) }) else {
            return Star::TooNear;
        };
        if !self.follow::<N, B>(token, gates, view, is_outer) {
            return Star::TooNear;
        }
        match self.spheres::<B>(token, view) {
            Star::Whole if self.are_empty::<N, B>(token, view.reach) => Star::Whole,
            Star::Whole => Star::Doubtful,
            other => other,
        }
    }

    /// Fills up the batches with points that are nowhere, and squares the lengths.
    #[inline(always)]
    fn pad<const N: usize, B: Batch>(&mut self, token: B::Token) {
        let [x, y, z, square] = &mut self.at;
        for place in (self.count..N * B::LANES).step_by(B::LANES) {
            B::splat(token, f32::NAN).store(&mut x[place..]);
            self.ids[place..place + B::LANES].fill(u32::MAX);
        }
        for place in (0..N * B::LANES).step_by(B::LANES) {
            let x = B::load(token, &x[place..]);
            let (y, z) = (B::load(token, &y[place..]), B::load(token, &z[place..]));
            x.fast_mul_add(x, y.fast_mul_add(y, z * z)).store(&mut square[place..]);
        }
    }

    /// Opens the first gate of a star that is entirely unknown: of the nearest point and the one
    /// that makes the smallest circle with it.
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

    /// Opens the gates that wait, as many as are left when those with two sides are gone; `None` if
    /// a corner is not in the list.
    #[inline(always)]
    fn open_waiting<const N: usize, B: Batch>(&mut self, token: B::Token) -> Option<usize> {
        if self.gates.len() > WAITING {
            return None;
        }
        let mut tail = 0;
        for gate in 0..self.gates.len() {
            let [a, b] = self.gates[gate];
            let (a, b) = (self.place::<N, B>(token, a), self.place::<N, B>(token, b));
            if a.max(b) == NOWHERE {
                return None;
            }
            self.toggle(a, b, &mut tail);
        }
        Some(tail)
    }

    #[inline(always)]
    fn place<const N: usize, B: Batch>(&self, token: B::Token, id: u32) -> usize {
        let mut found = 0u128;
        for batch in 0..N {
            let ids = B::U32s::load(token, &self.ids[batch * B::LANES..]);
            let here = B::U32s::bitmask(ids.eq(B::U32s::splat(token, id)));
            found |= u128::from(here) << (batch * B::LANES);
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

    /// Follows gates until none is open; false where nothing is found behind one that is not in the
    /// domain's boundary.
    #[inline(always)]
    fn follow<const N: usize, B: Batch>(
        &mut self,
        token: B::Token,
        mut tail: usize,
        view: &View,
        is_outer: impl Fn([u32; 3]) -> bool,
    ) -> bool {
        let held = self.hold::<N, B>(token);
        let infinite = B::splat(token, f32::INFINITY);
        let (mut head, mut count) = (0, 0);
        while head != tail {
            let gate = usize::from(self.queue[head]);
            head += 1;
            if self.open[gate & (MOST * MOST - 1)] == 0 {
                continue;
            }
            let (a, b) = (gate >> LOG2_MOST & PLACE, gate & PLACE);
            let [at_a, at_b] = [a, b].map(|place| [0, 1, 2, 3].map(|k| self.at[k][place]));
            let ([nx, ny, nz, nn], m) = circle(at_a, at_b);
            let [mx, my, mz] = three(|k| B::splat(token, m[k]));
            let [nx, ny, nz, nn] = four(|k| B::splat(token, [nx, ny, nz, nn][k]));
            // The largest value that rounding may make of 0.
            let least = B::splat(token, 5e-7 * view.reach * (at_a[3] * at_b[3]).sqrt());
            let (mut best, mut all) = (infinite, [infinite; N]);
            for (i, all) in all.iter_mut().enumerate() {
                let [x, y, z, square] = self.batch(token, &held, i);
                let height = x.fast_mul_add(nx, y.fast_mul_add(ny, z * nz));
                let power =
                    x.fast_neg_mul_add(mx, y.fast_neg_mul_add(my, z.fast_neg_mul_add(mz, square * nn)));
                *all = B::select(least.lt(height), power / height, infinite);
                best = best.min(*all);
            }
            let everywhere = best.reduce_min();
            let best = everywhere.to_array().as_ref()[0];
            let mut found = 0u128;
            for (i, all) in all.into_iter().enumerate() {
                found |= u128::from(B::bitmask(all.eq(everywhere))) << (i * B::LANES);
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
            self.note(count, [b, a, c]);
            count += 1;
        }
        self.triangles = count;
        true
    }

    /// Notes the n-th new triangle, by places.
    #[inline(always)]
    fn note(&mut self, n: usize, places: [usize; 3]) {
        self.found[n] = places.map(|place| place as u32);
        let at = places.map(|place| [0, 1, 2].map(|k| self.at[k][place]));
        for (corner, at) in self.corners.iter_mut().zip(at.as_flattened()) {
            corner[n] = *at;
        }
    }

    /// The points nearby, where there are registers for them.
    #[inline(always)]
    fn hold<const N: usize, B: Batch>(&self, token: B::Token) -> [[B; 4]; N] {
        let mut held = [[B::splat(token, 0.0); 4]; N];
        if B::HOLDS {
            for (i, held) in held.iter_mut().enumerate() {
                *held = self.load(token, i);
            }
        }
        held
    }

    #[inline(always)]
    fn load<B: Batch>(&self, token: B::Token, i: usize) -> [B; 4] {
        let [x, y, z, square] = &self.at;
        let place = i * B::LANES;
        [
            B::load(token, &x[place..]),
            B::load(token, &y[place..]),
            B::load(token, &z[place..]),
            B::load(token, &square[place..]),
        ]
    }

    /// Coordinates and squared lengths of a batch.
    #[inline(always)]
    fn batch<const N: usize, B: Batch>(&self, token: B::Token, held: &[[B; 4]; N], i: usize) -> [B; 4] {
        if B::HOLDS { held[i] } else { self.load(token, i) }
    }

    /// Makes the spheres of the new tetrahedra.
    #[inline(always)]
    fn spheres<B: Batch>(&mut self, token: B::Token, view: &View) -> Star {
        let d = f64::from(view.reach);
        let splat = |x| B::Doubles::splat(token, x);
        let (largest, least) = (splat(d * d * WITHIN), splat(d * d * d * LEAST_VOLUME));
        let (shortest, outside) = (splat(d * d), splat(OUTSIDE * d));
        let far = splat(LARGEST / (d * d));
        let domain = three(|a| [splat(2.0 * view.domain[a][0]), splat(2.0 * view.domain[a][1])]);
        let (mut whole, mut fat) = (u32::MAX, u32::MAX);
        for first in (0..self.triangles).step_by(B::LANES / 2) {
            let others = u32::MAX << (self.triangles - first).min(B::LANES / 2);
            let u = three(|a| B::Doubles::from_f32(token, &self.corners[a][first..]));
            let v = three(|a| B::Doubles::from_f32(token, &self.corners[3 + a][first..]));
            let w = three(|a| B::Doubles::from_f32(token, &self.corners[6 + a][first..]));
            let (vw, wu, uv) = (cross(v, w), cross(w, u), cross(u, v));
            let det = dot(u, vw);
            let by_det = splat(1.0) / det;
            let (uu, vv, ww) = (dot(u, u) * by_det, dot(v, v) * by_det, dot(w, w) * by_det);
            let k = three(|a| vw[a].fast_mul_add(uu, wu[a].fast_mul_add(vv, uv[a] * ww)));
            fat &= others | B::Doubles::bitmask(least.lt(det));
            let within = three(|a| k[a].max(domain[a][0]).min(domain[a][1]));
            let beyond = three(|a| k[a] + k[a] - within[a]);
            whole &= others | B::Doubles::bitmask(dot(within, beyond).lt(largest));
            let kk = dot(k, k);
            let far = det * far;
            fat &= others | B::Doubles::bitmask(kk.lt(far * far));
            let outside = kk.max(shortest).sqrt() * outside;
            for (a, k) in [k[0], k[1], k[2], outside].into_iter().enumerate() {
                put(&mut self.centres[a], first, k.to_f32());
            }
        }
        match (whole, fat) {
            (u32::MAX, u32::MAX) => Star::Whole,
            (u32::MAX, _) => Star::Doubtful,
            _ => Star::TooNear,
        }
    }

    /// Whether the spheres are proven to leave out all points but their own.
    #[inline(always)]
    fn are_empty<const N: usize, B: Batch>(&self, token: B::Token, reach: f32) -> bool {
        let held = self.hold::<N, B>(token);
        let (mut doubtful, mut which) = (0, [0u16; 8]);
        for triangle in 0..self.triangles {
            let [kx, ky, kz] = three(|a| B::splat(token, self.centres[a][triangle]));
            let outside = B::splat(token, self.centres[3][triangle]);
            let mut near = 0u128;
            for i in 0..N {
                let [x, y, z, square] = self.batch(token, &held, i);
                let power = x.fast_neg_mul_add(kx, y.fast_neg_mul_add(ky, z.fast_neg_mul_add(kz, square)));
                near |= u128::from(B::bitmask(power.lt(outside))) << (i * B::LANES);
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

/// The circle through the point and the corners a and b of a gate, given with their squared
/// lengths: its normal n = b×a, which points to where the apex is, with |n|²; and m, which over
/// 2|n|² is its centre.
#[inline(always)]
fn circle([ax, ay, az, aa]: [f32; 4], [bx, by, bz, bb]: [f32; 4]) -> ([f32; 4], [f32; 3]) {
    let [nx, ny, nz] = [by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax];
    let nn = nx * nx + ny * ny + nz * nz;
    let [cx, cy, cz] = [ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx];
    let [ex, ey, ez] = [ny * bz - nz * by, nz * bx - nx * bz, nx * by - ny * bx];
    ([nx, ny, nz, nn], [bb * cx + aa * ex, bb * cy + aa * ey, bb * cz + aa * ez])
}

#[inline(always)]
fn dot<W: F64s>(a: [W; 3], b: [W; 3]) -> W {
    a[0].fast_mul_add(b[0], a[1].fast_mul_add(b[1], a[2] * b[2]))
}

/// Overwrites numbers of a list from a place on.
#[inline(always)]
fn put<T: Copy>(list: &mut [T], place: usize, numbers: impl AsRef<[T]>) {
    let numbers = numbers.as_ref();
    list[place..place + numbers.len()].copy_from_slice(numbers);
}
