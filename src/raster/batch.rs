//! Scan conversion of many tetrahedra together, column by column.
//!
//! A tetrahedron of a mesh of about a point for eight samples has one sample or two, in a box of some ten. What a scan by itself
//! ([`super::scan`]) costs there are branches that nobody can foretell: how many rows, how many samples, which of them. So tetrahedra are sorted by the
//! size of their box first; those of one size are looked at side by side, in loops without branches that the compiler turns into vector code:
//!
//! ```text
//!  tetrahedra ─▶ boxes ─▶ sorted by size ─▶ planes in f32 ─▶ least λ at each sample of the box ─▶ candidates ─▶ exact λ ─▶ members
//!     2048       16 each    64 sizes          64 at a time      a bit each                           128 at a time
//! ```
//!
//! The **filter** is that of `scan.rs`, in `f32`; only its last step differs: λ grows by additions, at most 9 from the first sample of a box to
//! its last. Each rounds by at most 18·M³u, which makes 162·M³u more than the 200·M³u there.
//!
//! **Exact λ in `f64`.** With corners less than 2^19 lattice steps apart along each axis, a component of a plane's gradient is an integer of at most 2^39, and exact.
//! A difference of positions is cut in two, `r = 1024·h + l` with `|l| <= 512` and `|h| <= 2^9`: so all products and the sums of up to twelve of them stay below 2^53, exact too.
//! Only `1024·H + L` is rounded, once: it is the `f64` that is nearest to the integer λ, which is what `scan.rs` makes
//! of its 64 bits. Weights are the same bits. Where a λ is 0, the tie rule is asked, in integers.
//!
//! Larger boxes and tetrahedra go through `scan.rs`, and all do on grids that are no voxels. Memory: [`BatchScan::BYTES`].

use super::lanes::Four;
use super::planes::Planes;
use super::scan::Scanner;
use crate::exec::{Avx512, with_avx512};
use crate::geom::LatticePos;
use crate::mesh::tet::Tet;

/// Members handed on at a time, at most.
pub const MEMBERS: usize = 128;
/// Tetrahedra that are sorted together.
const SORTED: usize = 2048;
/// Tetrahedra of one size that are looked at side by side, a bit of a word each.
const SIDE_BY_SIDE: usize = 64;
/// Samples along each edge of a box, at most, and how many sizes that makes.
const EDGE: u32 = 4;
const SIZES: usize = (EDGE * EDGE * EDGE) as usize;
/// The longest edge of a box, in lattice steps: see above.
const LONGEST: u32 = 1 << 19;
/// The error of the filter, in M³: see above.
const ERROR: f32 = 512.0 / (1u32 << 24) as f32;
/// What positions are cut at.
const CUT: f64 = 1024.0;
/// Added to a number below 2^51 and taken away, it rounds to an integer.
const ROUND: f64 = 1.5 * (1u64 << 52) as f64;

/// Samples, each in the tetrahedron that it belongs to.
pub struct Members {
    len: usize,
    tets: [u32; MEMBERS],
    places: [u32; MEMBERS],
    weights: [[f64; MEMBERS]; 4],
}

impl Members {
    /// For each sample, which of the tetrahedra that were given it belongs to.
    #[inline(always)]
    pub fn tets(&self) -> &[u32] {
        &self.tets[..self.len]
    }

    /// The place of each in an x-fastest array of the window.
    #[inline(always)]
    pub fn places(&self) -> &[u32] {
        &self.places[..self.len]
    }

    /// The weight of each corner at each sample.
    #[inline(always)]
    pub fn weights(&self) -> [&[f64]; 4] {
        [0, 1, 2, 3].map(|k| &self.weights[k][..self.len])
    }

    /// Removes one; the last takes its place.
    #[inline(always)]
    fn remove(&mut self, i: usize) {
        let last = (self.len - 1) % MEMBERS;
        self.tets[i] = self.tets[last];
        self.places[i] = self.places[last];
        self.weights.iter_mut().for_each(|w| w[i] = w[last]);
        self.len = last;
    }
}

/// A tetrahedron with a small box.
#[derive(Clone, Copy, Default)]
struct Small {
    tet: u32,
    /// Its first sample: in the grid, and its place in the window.
    first: [u32; 3],
    place: u32,
    /// The longest edge of its box.
    longest: u32,
}

type Lanes = [f32; SIDE_BY_SIDE];

/// Tetrahedra of one size, column by column.
struct Columns {
    /// From corner a to the others, and to the first sample: exact.
    edges: [[Lanes; 3]; 3],
    first: [Lanes; 3],
    longest: Lanes,
    /// Four by four: λ of b, c, d, a at the first sample, raised by the error; what it grows by along each axis, from sample to sample.
    lambda: [[[f32; 4]; 4]; SIDE_BY_SIDE / 4],
    growth: [[[[f32; 4]; 4]; 3]; SIDE_BY_SIDE / 4],
    /// For each sample of a box, a bit for each tetrahedron that can have it: four bits a byte.
    inside: [[u8; SIDE_BY_SIDE / 4]; SIZES],
}

/// Samples that may be members: what decides it.
struct Candidates {
    edges: [[[f32; MEMBERS]; 3]; 3],
    /// From corner a.
    at: [[f32; MEMBERS]; 3],
    /// The least of the four exact λ.
    least: [f64; MEMBERS],
}

/// The memory in which tetrahedra are scanned together; kept from one call to the next.
pub struct BatchScan {
    small: Box<[Small; SORTED]>,
    sizes: Box<[u8; SORTED]>,
    order: Box<[u16; SORTED]>,
    columns: Box<Columns>,
    candidates: Box<Candidates>,
    members: Box<Members>,
}

impl Default for BatchScan {
    fn default() -> Self {
        let (lanes, many) = ([0.0; SIDE_BY_SIDE], [0.0; MEMBERS]);
        Self {
            small: Box::new([Small::default(); SORTED]),
            sizes: Box::new([0; SORTED]),
            order: Box::new([0; SORTED]),
            columns: Box::new(Columns {
                edges: [[lanes; 3]; 3],
                first: [lanes; 3],
                longest: lanes,
                lambda: [[[0.0; 4]; 4]; SIDE_BY_SIDE / 4],
                growth: [[[[0.0; 4]; 4]; 3]; SIDE_BY_SIDE / 4],
                inside: [[0; SIDE_BY_SIDE / 4]; SIZES],
            }),
            candidates: Box::new(Candidates { edges: [[many; 3]; 3], at: [many; 3], least: [0.0; MEMBERS] }),
            members: Box::new(Members {
                len: 0,
                tets: [0; MEMBERS],
                places: [0; MEMBERS],
                weights: [[0.0; MEMBERS]; 4],
            }),
        }
    }
}

const _: () = assert!(
    size_of::<([Small; SORTED], [u8; SORTED], [u16; SORTED])>() as u64
        + size_of::<(Columns, Candidates, Members)>() as u64
        <= BatchScan::BYTES
);

/// What a scan is of.
struct Scene<'a> {
    scanner: &'a Scanner<'a>,
    positions: &'a [LatticePos],
    tets: &'a [Tet],
    /// log2 of the distance of samples along each axis, and a 0.
    shifts: [u32; 4],
}

impl Scene<'_> {
    /// The distance of samples along each axis, in lattice steps.
    #[inline(always)]
    fn pitch(&self) -> [f32; 3] {
        [0, 1, 2].map(|k| (1u32 << self.shifts[k]) as f32)
    }

    fn corners(&self, tet: u32) -> [LatticePos; 4] {
        self.tets[tet as usize].map(|v| self.positions[v as usize])
    }
}

impl BatchScan {
    /// Bytes that it takes, at most.
    pub const BYTES: u64 = 96 << 10;

    /// Calls `each` with the samples of the scanner's window that belong to positively oriented tetrahedra, some at a time: each sample
    /// as often as [`Scanner::each_run`] hands it on, with the same weights, in an order that follows from the tetrahedra and their order.
    ///
    /// # Panics
    /// For a window of 2^32 samples or more.
    #[inline(always)]
    pub fn each_member(
        &mut self,
        scanner: &Scanner<'_>,
        positions: &[LatticePos],
        tets: &[Tet],
        mut each: impl FnMut(&Members),
    ) {
        assert!(scanner.len() <= u64::from(u32::MAX), "places are numbers of 32 bits");
        // Without an even grid nothing is small.
        let shifts = scanner.even_shifts();
        let scene = Scene { scanner, positions, tets, shifts: shifts.unwrap_or_default() };
        for from in (0..tets.len()).step_by(SORTED) {
            let to = tets.len().min(from + SORTED);
            let small = if shifts.is_some() { self.boxes(&scene, from..to, &mut each) } else { 0 };
            if shifts.is_none() {
                (from..to).for_each(|tet| self.alone(&scene, tet, &mut each));
            }
            let ends = self.sort(small);
            let mut start = 0;
            for (size, end) in ends.into_iter().enumerate() {
                while start < end {
                    let count = (end - start).min(SIDE_BY_SIDE);
                    self.gather(&scene, start, count);
                    self.columns.planes(count, scene.pitch());
                    self.scan(&scene, start, count, size, &mut each);
                    start += count;
                }
            }
        }
        self.hand_on(&scene, &mut each);
    }

    /// Notes the boxes of tetrahedra that have samples in them; returns how many are small. The others are scanned at once.
    #[inline(always)]
    fn boxes(
        &mut self,
        scene: &Scene<'_>,
        range: std::ops::Range<usize>,
        each: &mut impl FnMut(&Members),
    ) -> usize {
        let (lo, hi) = scene.scanner.window();
        let strides = scene.scanner.strides();
        let shifts = scene.shifts;
        let before = shifts.map(|s| (1 << s) - 1);
        let mut len = 0;
        for t in range {
            let (least, most) = corner_box(scene.positions, &scene.tets[t]);
            let from = greater([0, 1, 2, 3].map(|k| (least[k] + before[k]) >> shifts[k]), lo);
            let to = lesser([0, 1, 2, 3].map(|k| (most[k] >> shifts[k]) + 1), hi);
            // One less than there are samples; of none a number that is no small one.
            let [x, y, z, _] = [0, 1, 2, 3].map(|k| to[k].wrapping_sub(from[k]).wrapping_sub(1));
            let longest = (most[0] - least[0]).max(most[1] - least[1]).max(most[2] - least[2]);
            let small = ((x | y | z) < EDGE) & (longest <= LONGEST);
            let place = (from[2].wrapping_sub(lo[2]))
                .wrapping_mul(strides[1])
                .wrapping_add(from[1].wrapping_sub(lo[1]).wrapping_mul(strides[0]))
                .wrapping_add(from[0].wrapping_sub(lo[0]));
            self.small[len % SORTED] =
                Small { tet: t as u32, first: [from[0], from[1], from[2]], place, longest };
            self.sizes[len % SORTED] = (x | y << 2 | z << 4) as u8;
            len += usize::from(small);
            if !small && (from[0] < to[0]) & (from[1] < to[1]) & (from[2] < to[2]) {
                self.alone(scene, t, each);
            }
        }
        len
    }

    /// Puts the small ones in the order of their sizes; returns the end of each size.
    #[inline(always)]
    fn sort(&mut self, count: usize) -> [usize; SIZES] {
        let mut ends = [0; SIZES];
        let sizes = &self.sizes[..count];
        for &size in sizes {
            ends[usize::from(size) % SIZES] += 1;
        }
        let mut sum = 0;
        for n in &mut ends {
            sum += std::mem::replace(n, sum);
        }
        for (i, &size) in sizes.iter().enumerate() {
            let at = &mut ends[usize::from(size) % SIZES];
            self.order[*at % SORTED] = i as u16;
            *at += 1;
        }
        ends
    }

    /// Takes tetrahedra of one size into the columns.
    #[inline(always)]
    fn gather(&mut self, scene: &Scene<'_>, start: usize, count: usize) {
        let columns = &mut *self.columns;
        let order = &self.order[start..start + count];
        // Of less than four, the last one again.
        for (n, four) in order.chunks(4).enumerate() {
            let small = [0, 1, 2, 3].map(|k| &self.small[usize::from(four[k.min(four.len() - 1)]) % SORTED]);
            let corners = small.map(|s| scene.tets[s.tet as usize]);
            let corner =
                |k: usize| Four::columns(corners.map(|tet| Four::position(scene.positions[tet[k] as usize])));
            let a = corner(0);
            let put = |column: &mut [Lanes; 3], p: [Four; 3]| {
                for ((column, p), a) in column.iter_mut().zip(p).zip(a) {
                    column[4 * n..4 * n + 4].copy_from_slice(&p.minus(a).lanes());
                }
            };
            for (k, column) in columns.edges.iter_mut().enumerate() {
                put(column, corner(k + 1));
            }
            put(
                &mut columns.first,
                Four::columns(
                    small.map(|s| Four::position([0, 1, 2].map(|k| s.first[k] << scene.shifts[k]))),
                ),
            );
            let longest = small.map(|s| s.longest as f32);
            columns.longest[4 * n..4 * n + 4].copy_from_slice(&longest);
        }
    }

    /// Finds the samples of boxes that can be members.
    #[inline(always)]
    fn scan(
        &mut self,
        scene: &Scene<'_>,
        start: usize,
        count: usize,
        size: usize,
        each: &mut impl FnMut(&Members),
    ) {
        let [nx, ny, nz] = [size & 3, size >> 2 & 3, size >> 4 & 3].map(|n| n as u32 + 1);
        let strides = scene.scanner.strides();
        let pitch = scene.pitch();
        let wanted = u64::MAX >> (SIDE_BY_SIDE - count);
        self.columns.look(count, [nx, ny, nz]);
        let mut seen = 0;
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    let mut found = joined(&self.columns.inside[seen % SIZES]) & wanted;
                    seen += 1;
                    let place = z * strides[1] + y * strides[0] + x;
                    let offset = [x as f32 * pitch[0], y as f32 * pitch[1], z as f32 * pitch[2]];
                    while found != 0 {
                        let i = found.trailing_zeros() as usize;
                        found &= found - 1;
                        self.note(i, self.order[(start + i) % SORTED], place, offset);
                        if self.members.len == MEMBERS {
                            self.hand_on(scene, each);
                        }
                    }
                }
            }
        }
    }

    /// Notes a candidate: a sample of the i-th tetrahedron of the columns.
    #[inline(always)]
    fn note(&mut self, i: usize, small: u16, place: u32, offset: [f32; 3]) {
        let (columns, candidates) = (&*self.columns, &mut *self.candidates);
        let (i, n) = (i % SIDE_BY_SIDE, self.members.len % MEMBERS);
        for (to, from) in candidates.edges.iter_mut().zip(&columns.edges) {
            (0..3).for_each(|k| to[k][n] = from[k][i]);
        }
        (0..3).for_each(|k| candidates.at[k][n] = columns.first[k][i] + offset[k]);
        let small = &self.small[usize::from(small) % SORTED];
        (self.members.tets[n], self.members.places[n]) = (small.tet, small.place + place);
        self.members.len = n + 1;
    }

    /// Decides on the candidates, and hands on those that are members.
    #[inline(always)]
    fn hand_on(&mut self, scene: &Scene<'_>, each: &mut impl FnMut(&Members)) {
        let (candidates, members) = (&mut *self.candidates, &mut *self.members);
        let count = members.len.min(MEMBERS);
        let weights = &mut members.weights;
        match Avx512::found() {
            Some(proof) => with_avx512(
                proof,
                #[inline(always)]
                || candidates.decide(weights, count),
            ),
            None => candidates.decide(weights, count),
        }
        let (mut others, mut len) = ([0; MEMBERS], 0);
        for (i, &least) in candidates.least[..count].iter().enumerate() {
            others[len % MEMBERS] = i as u8;
            let inside =
                least > 0.0 || (least == 0.0 && wins_tie(scene, members.tets[i], candidates.place(i)));
            len += usize::from(!inside);
        }
        // The last ones first: what takes the place of one that is none has been looked at.
        for &i in others[..len].iter().rev() {
            members.remove(usize::from(i) % MEMBERS);
        }
        each(members);
        members.len = 0;
    }

    /// Hands on the samples of a tetrahedron that is scanned by itself.
    #[inline(never)]
    fn alone(&mut self, scene: &Scene<'_>, tet: usize, each: &mut impl FnMut(&Members)) {
        self.hand_on(scene, each);
        let members = &mut *self.members;
        scene.scanner.each_run(scene.corners(tet as u32), |place, run| {
            for (i, weights) in run.iter().enumerate() {
                members.tets[i] = tet as u32;
                members.places[i] = (place + i) as u32;
                (0..4).for_each(|k| members.weights[k][i] = weights[k]);
            }
            members.len = run.len();
            each(members);
        });
        members.len = 0;
    }
}

impl Columns {
    /// The four planes of each, in samples.
    #[inline(always)]
    fn planes(&mut self, count: usize, pitch: [f32; 3]) {
        let (error, pitch) = (Four::splat(ERROR), pitch.map(Four::splat));
        for n in 0..count.div_ceil(4) {
            let [b, c, d] = [0, 1, 2].map(|e| [0, 1, 2].map(|k| four(&self.edges[e][k], n)));
            let (gb, gc, gd) = (cross(c, d), cross(d, b), cross(b, c));
            let ga = [0, 1, 2].map(|k| Four::splat(0.0).minus(gb[k].plus(gc[k]).plus(gd[k])));
            let first = [0, 1, 2].map(|k| four(&self.first[k], n));
            let m = four(&self.longest, n);
            let error = error.times(m).times(m).times(m);
            let planes = [gb, gc, gd, ga];
            let raised = [error, error, error, dot(b, gb).plus(error)];
            self.lambda[n] = [0, 1, 2, 3].map(|k| dot(planes[k], first).plus(raised[k]).lanes());
            self.growth[n] = [0, 1, 2].map(|axis| planes.map(|g| g[axis].times(pitch[axis]).lanes()));
        }
    }

    /// Finds out which of the first tetrahedra can hold which samples of their boxes, all of one size.
    #[inline(always)]
    fn look(&mut self, count: usize, [nx, ny, nz]: [u32; 3]) {
        for n in 0..count.div_ceil(4) {
            let mut seen = 0;
            let [x, y, z] = self.growth[n].map(|g| g.map(Four::new));
            let mut layer = self.lambda[n].map(Four::new);
            for _ in 0..nz {
                let mut row = layer;
                for _ in 0..ny {
                    let mut at = row;
                    for _ in 0..nx {
                        let [b, c, d, a] = at;
                        self.inside[seen % SIZES][n] = b.min(c).min(d.min(a)).signs() as u8 ^ 15;
                        seen += 1;
                        at = grown(at, x);
                    }
                    row = grown(row, y);
                }
                layer = grown(layer, z);
            }
        }
    }
}

impl Candidates {
    /// Computes the weights of the first ones, and the least λ of each.
    #[inline(always)]
    fn decide(&mut self, weights: &mut [[f64; MEMBERS]; 4], count: usize) {
        let [b, c, d] = &self.edges;
        for i in 0..count.next_multiple_of(8).min(MEMBERS) {
            let [b, c, d] = [b, c, d].map(|e| [0, 1, 2].map(|k| f64::from(e[k][i])));
            let r = [0, 1, 2].map(|k| f64::from(self.at[k][i]));
            let (gb, gc, gd) = (cross_of(c, d), cross_of(d, b), cross_of(b, c));
            let cut = |p: [f64; 3]| {
                let high = p.map(|x| (x * (1.0 / CUT) + ROUND) - ROUND);
                (high, [0, 1, 2].map(|k| p[k] - high[k] * CUT))
            };
            let ((rh, rl), (eh, el)) = (cut(r), cut(b));
            let parts = |g: [f64; 3]| (dot_of(g, rh), dot_of(g, rl));
            let (pb, pc, pd) = (parts(gb), parts(gc), parts(gd));
            let whole = (dot_of(gb, eh), dot_of(gb, el));
            let pa = (whole.0 - (pb.0 + pc.0 + pd.0), whole.1 - (pb.1 + pc.1 + pd.1));
            let joined = |(high, low): (f64, f64)| high * CUT + low;
            let unit = 1.0 / joined(whole);
            let lambda = [joined(pa), joined(pb), joined(pc), joined(pd)];
            for (weights, lambda) in weights.iter_mut().zip(lambda) {
                weights[i] = lambda * unit;
            }
            let [la, lb, lc, ld] = lambda;
            let order = |x: f64, y: f64| if x < y { x } else { y };
            self.least[i] = order(order(la, lb), order(lc, ld));
        }
    }

    /// Where a candidate is from corner a, in lattice steps.
    fn place(&self, i: usize) -> [i32; 3] {
        [0, 1, 2].map(|k| self.at[k][i] as i32)
    }
}

/// The tie rule, in integers.
#[inline(never)]
fn wins_tie(scene: &Scene<'_>, tet: u32, from_a: [i32; 3]) -> bool {
    let corners = scene.corners(tet);
    let p = std::array::from_fn(|k| (corners[0][k] as i32 + from_a[k]) as u32);
    let planes = Planes::<i64>::new(corners);
    planes.has(planes.at(p), p, scene.scanner.far())
}

/// Four bits of each byte, as the bits of a word.
#[inline(always)]
fn joined(bits: &[u8; SIDE_BY_SIDE / 4]) -> u64 {
    let (low, high) = bits.split_at(8);
    let word = |half: &[u8]| {
        let x = half.iter().rev().fold(0, |x, &b| x << 8 | u64::from(b));
        let x = (x | x >> 4) & 0x00ff_00ff_00ff_00ff;
        let x = (x | x >> 8) & 0x0000_ffff_0000_ffff;
        (x | x >> 16) & 0xffff_ffff
    };
    word(low) | word(high) << 32
}

#[inline(always)]
fn grown(lambda: [Four; 4], by: [Four; 4]) -> [Four; 4] {
    [0, 1, 2, 3].map(|k| lambda[k].plus(by[k]))
}

/// The least and the greatest coordinates of a tetrahedron's corners, and a 0.
#[inline(always)]
pub(crate) fn corner_box(positions: &[LatticePos], tet: &Tet) -> ([u32; 4], [u32; 4]) {
    let corner = |k: usize| {
        let [x, y, z] = positions[tet[k] as usize];
        [x, y, z, 0]
    };
    let (a, b, c, d) = (corner(0), corner(1), corner(2), corner(3));
    (lesser(lesser(a, b), lesser(c, d)), greater(greater(a, b), greater(c, d)))
}

/// The lesser of each coordinate; four are a vector.
#[inline(always)]
pub(crate) fn lesser(a: [u32; 4], b: [u32; 4]) -> [u32; 4] {
    [0, 1, 2, 3].map(|k| a[k].min(b[k]))
}

/// The greater of each coordinate.
#[inline(always)]
pub(crate) fn greater(a: [u32; 4], b: [u32; 4]) -> [u32; 4] {
    [0, 1, 2, 3].map(|k| a[k].max(b[k]))
}

/// The n-th four of a column.
#[inline(always)]
fn four(column: &Lanes, n: usize) -> Four {
    Four::new(column.as_chunks().0[n])
}

#[inline(always)]
fn cross(u: [Four; 3], v: [Four; 3]) -> [Four; 3] {
    [(1, 2), (2, 0), (0, 1)].map(|(i, j)| u[i].times(v[j]).minus(u[j].times(v[i])))
}

#[inline(always)]
fn dot(u: [Four; 3], v: [Four; 3]) -> Four {
    u[0].times(v[0]).plus(u[1].times(v[1])).plus(u[2].times(v[2]))
}

#[inline(always)]
fn cross_of(u: [f64; 3], v: [f64; 3]) -> [f64; 3] {
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

#[inline(always)]
fn dot_of(u: [f64; 3], v: [f64; 3]) -> f64 {
    u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
}
