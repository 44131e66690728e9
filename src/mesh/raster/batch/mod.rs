//! Scan conversion of many tetrahedra together, column by column.
//!
//! A tetrahedron of a mesh of about a point for eight samples has one sample or two, in a box of
//! some ten. There, a scan by itself ([`super::scan`]) spends its time on branches that cannot be
//! predicted: how many rows, how many samples, which of them. So tetrahedra are sorted by the rows
//! of their box first; sixteen of like boxes are looked at side by side, a lane each:
//!
//! ```text
//!  tetrahedra ─▶ boxes ─▶ sorted by rows ─▶ planes in f32 ─▶ where each row enters and leaves ─▶ candidates ─▶ exact λ ─▶ members
//!     2048      16 each                       16 each                  16 each                              128 at a time
//! ```
//!
//! The **filter** is that of `scan.rs`, in `f32`; only its last steps differ. From row to row λ
//! grows by additions, at most 30 from the first row of a box to its last. Each rounds by at most
//! 18·M³u, which makes 540·M³u more than the 200·M³u there. Along a row, λ + g·x >= 0 for a sample
//! x that is inside, `g` as computed: where g > 0, x is not less than -λ/g, where g < 0 not
//! greater. The quotient is wrong by 3u of itself; if it is one that matters, it is less than 16,
//! and [`SLACK`] is more than its error.
//!
//! **Exact λ in `f64`.** With corners at most M = 2^20 lattice steps apart along each axis, a
//! component of a plane's gradient (twice the area of a triangle in a square of edge M) is an
//! integer of at most M² = 2^40, and exact. A difference of positions is cut in two,
//! `r = 1024·h + l` with `|l| <= 512` and `|h| <= 2^10`: products and sums of three are exact,
//! those with l below 2^51, those with h below 2^52. A λ is at most 2·M³ = 2^61 (the largest
//! tetrahedron in a cube takes a third of it), so its part H in `λ = 1024·H + L` is less than
//! 2^51 + 2^42. So sums of up to three such parts, and their difference from a fourth, stay below
//! 2^53, exact too. Only `1024·H + L` is rounded, once: it is the `f64` that is nearest to the
//! integer λ, which is what `scan.rs` makes of its 64 bits. Weights are the same bits. Where a λ is
//! 0, the tie rule is asked, in integers.
//!
//! Larger boxes and tetrahedra go through `scan.rs`, and all do on grids that are no voxels.
//! Memory: [`BatchScan::BYTES`].

mod boxes;
mod exact;

use self::boxes::{Boxes, Columns, Filter, Scene};
use self::exact::{Candidates, wins_tie};
use super::planes::LONGEST_64;
use super::scan::Scanner;
use crate::mesh::tet::Tet;
#[cfg(test)]
use crate::simd::Avx2;
use crate::simd::{Avx512, Compress, F32x16s, Lanes, Plain, U32x16s, on_widest, with_avx512};
#[cfg(all(test, target_arch = "x86_64"))]
use crate::simd::{F32x8, Pair};
use isospan_io::geom::LatticePos;

/// Members handed on at a time, at most.
pub const MEMBERS: usize = 128;
/// Tetrahedra that are sorted together.
const SORTED: usize = 2048;
/// Tetrahedra that are looked at side by side.
const LANES: usize = 16;
/// Candidates of a row are noted while there is room for one of each lane.
const FOUND: usize = 64 + LANES;
/// Samples along each edge of a box, at most.
const EDGE: u32 = 16;
/// How many boxes there are, by their rows and layers.
const SIZES: usize = (EDGE * EDGE) as usize;
/// The longest edge of a box, in lattice steps: see above.
const LONGEST: u32 = 1 << 20;
const _: () = assert!(LONGEST <= LONGEST_64);
/// The most that an end of a row may be wrong by, in samples: far more than it is (2^-17).
const SLACK: f32 = 1.0 / 4096.0;
/// The lanes.
const NUMBERS: [u32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
/// The bits of all lanes.
const ALL: u32 = (1 << LANES) - 1;

/// Samples, each in the tetrahedron that it belongs to.
pub struct Members {
    len: usize,
    tets: [u32; MEMBERS],
    places: [u32; MEMBERS],
    weights: [[f64; MEMBERS]; 4],
}

impl Members {
    fn none() -> Box<Self> {
        let (numbers, weights) = ([0; MEMBERS], [[0.0; MEMBERS]; 4]);
        Box::new(Self { len: 0, tets: numbers, places: numbers, weights })
    }

    /// Hands all of them on, if there are some.
    fn hand_on(&mut self, each: &mut impl FnMut(&Self)) {
        if self.len > 0 {
            each(self);
        }
        self.len = 0;
    }

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

/// The memory in which tetrahedra are scanned together; kept from one call to the next.
pub struct BatchScan {
    /// Tetrahedra with small boxes, and the sizes of these.
    small: Box<[u32; SORTED + LANES]>,
    sizes: Box<[u32; SORTED + LANES]>,
    sorted: Box<[u32; SORTED]>,
    /// Candidates of some rows of sixteen tetrahedra: lane, and x, y and z in the box, four bits
    /// each but the last.
    found: Box<[u32; FOUND]>,
    candidates: Box<Candidates>,
    members: Box<Members>,
    /// Members of tetrahedra that are scanned by themselves, until they are many.
    alone: Box<Members>,
}

impl Default for BatchScan {
    fn default() -> Self {
        let many = [0.0; MEMBERS];
        Self {
            small: Box::new([0; SORTED + LANES]),
            sizes: Box::new([0; SORTED + LANES]),
            sorted: Box::new([0; SORTED]),
            found: Box::new([0; FOUND]),
            candidates: Box::new(Candidates { edges: [[many; 3]; 3], at: [many; 3], least: [0.0; MEMBERS] }),
            members: Members::none(),
            alone: Members::none(),
        }
    }
}

const _: () = assert!(
    size_of::<([[u32; SORTED + LANES]; 2], [u32; SORTED], [u32; FOUND])>() as u64
        + size_of::<(Candidates, [Members; 2])>() as u64
        <= BatchScan::BYTES
);

impl BatchScan {
    /// Bytes that it takes, at most.
    pub const BYTES: u64 = 64 << 10;

    /// Calls `each` with the samples of the scanner's window that belong to positively oriented
    /// tetrahedra, some at a time: each sample as often as [`Scanner::each_run`] hands it on, with
    /// the same weights, in an order that follows from the tetrahedra and their order.
    ///
    /// # Panics
    /// For a window of 2^32 samples or more.
    pub fn each_member(
        &mut self,
        scanner: &Scanner<'_>,
        positions: &[LatticePos],
        tets: &[Tet],
        mut each: impl FnMut(&Members),
    ) {
        assert!(scanner.len() <= u64::from(u32::MAX), "places are numbers of 32 bits");
        let Some(shifts) = scanner.even_shifts() else {
            // Without an even grid nothing is small.
            let scene = Scene { scanner, positions, tets, shifts: [0; 3] };
            (0..tets.len()).for_each(|tet| self.alone(&scene, tet as u32, &mut each));
            return self.alone.hand_on(&mut each);
        };
        let scene = Scene { scanner, positions, tets, shifts };
        on_widest!(F32x16, F32x8, Plain<f32, 16>, |F, token| self.run::<F>(token, &scene, &mut each));
    }

    /// As [`BatchScan::each_member`] with AVX2, or where there are no vectors; of voxels.
    #[cfg(test)]
    pub(super) fn each_member_with(
        &mut self,
        avx2: Option<Avx2>,
        scanner: &Scanner<'_>,
        positions: &[LatticePos],
        tets: &[Tet],
        mut each: impl FnMut(&Members),
    ) {
        let shifts = scanner.even_shifts().expect("voxels");
        let scene = Scene { scanner, positions, tets, shifts };
        match avx2 {
            #[cfg(target_arch = "x86_64")]
            Some(token) => self.run::<Pair<F32x8>>(token, &scene, &mut each),
            _ => self.run::<Plain<f32, 16>>((), &scene, &mut each),
        }
    }

    #[inline(always)]
    fn run<F: F32x16s>(&mut self, token: F::Token, scene: &Scene<'_>, each: &mut impl FnMut(&Members)) {
        for from in (0..scene.tets.len()).step_by(SORTED) {
            let to = scene.tets.len().min(from + SORTED);
            let small = self.boxes::<F::U32s>(token, scene, from..to, each);
            self.sort(small);
            for start in (0..small).step_by(LANES) {
                self.look::<F>(token, scene, start, LANES.min(small - start), each);
            }
        }
        self.hand_on(scene, each);
        self.alone.hand_on(each);
    }

    /// Notes the sizes of boxes that have samples in them; returns how many are small. The others
    /// are scanned at once.
    #[inline(always)]
    fn boxes<I: U32x16s>(
        &mut self,
        token: I::Token,
        scene: &Scene<'_>,
        range: std::ops::Range<usize>,
        each: &mut impl FnMut(&Members),
    ) -> usize {
        let (one, edge) = (I::splat(token, 1), I::splat(token, EDGE));
        let numbers = I::load(token, &NUMBERS);
        let mut len = 0;
        for start in range.clone().step_by(LANES) {
            let count = LANES.min(range.end - start);
            // Of less than sixteen, the last one again.
            let boxes = Boxes::<I>::new(token, scene, |n| (start + n.min(count - 1)) as u32);
            let [x, y, z] = boxes.samples().map(|n| n - one);
            let sizes = y + z * edge;
            let found = boxes.with_samples() & (ALL >> (LANES - count));
            let fits = I::bitmask(x.max(y).max(z).lt(edge))
                & I::bitmask(boxes.longest.lt(I::splat(token, LONGEST + 1)));
            let small = found & fits;
            put(&mut *self.small, len, (numbers + I::splat(token, start as u32)).compress(small));
            put(&mut *self.sizes, len, sizes.compress(small));
            len += small.count_ones() as usize;
            let mut large = found & !fits;
            while large != 0 {
                self.alone(scene, start as u32 + large.trailing_zeros(), each);
                large &= large - 1;
            }
        }
        len
    }

    /// Puts the small ones in the order of their sizes.
    #[inline(always)]
    fn sort(&mut self, count: usize) {
        let mut ends = [0u32; SIZES];
        let (small, sizes) = (&self.small[..count], &self.sizes[..count]);
        for &size in sizes {
            ends[size as usize % SIZES] += 1;
        }
        let mut sum = 0;
        for n in &mut ends {
            sum += std::mem::replace(n, sum);
        }
        for (&tet, &size) in small.iter().zip(sizes) {
            let at = &mut ends[size as usize % SIZES];
            self.sorted[*at as usize % SORTED] = tet;
            *at += 1;
        }
    }

    /// Finds the samples that can be members of some tetrahedra of like boxes.
    #[inline(always)]
    fn look<F: F32x16s>(
        &mut self,
        token: F::Token,
        scene: &Scene<'_>,
        start: usize,
        count: usize,
        each: &mut impl FnMut(&Members),
    ) {
        // Of less than sixteen, the last one again.
        let tets: [u32; LANES] = std::array::from_fn(|n| self.sorted[(start + n.min(count - 1)) % SORTED]);
        let boxes = Boxes::<F::U32s>::new(token, scene, |n| tets[n]);
        let filter = Filter::<F>::new(token, &boxes, scene.shifts);
        let columns = Columns::new(token, scene, &boxes, &filter, F::U32s::load(token, &tets));
        let [nx, ny, nz] = boxes.samples();
        let (one, numbers) = (F::U32s::splat(token, 1), F::U32s::load(token, &NUMBERS));
        let (zero, slack) = (F::splat(token, 0.0), F::splat(token, SLACK));
        // Cut off, it is rounded up, but for what is less than SLACK above an integer.
        let up = F::splat(token, 1.0 - SLACK);
        let last = F::from_i32(nx - one);
        let live = ALL >> (LANES - count);
        let mut noted = 0;
        let mut layer = filter.lambda;
        for z in 0..nz.reduce_max() {
            let live = F::U32s::bitmask(F::U32s::splat(token, z).lt(nz)) & live;
            let mut row = layer;
            for y in 0..ny.reduce_max() {
                let (mut enter, mut leave) = (zero, last);
                for (k, lambda) in row.iter_mut().enumerate() {
                    let at = *lambda * filter.crossing[k];
                    enter = enter.max_where(filter.rises[k], at);
                    leave = leave.min_where(filter.falls[k], at);
                    *lambda = *lambda + filter.growth[1][k];
                }
                let leave = leave + slack;
                let mut x = (enter + up).to_i32();
                let end = leave.to_i32() + one;
                let at = numbers + F::U32s::splat(token, y << 8 | z << 12);
                let mut found = F::U32s::bitmask(F::U32s::splat(token, y).lt(ny))
                    & live
                    & !F::bitmask(leave.lt(enter))
                    & F::U32s::bitmask(x.lt(end));
                while found != 0 {
                    put(&mut *self.found, noted, (at + (x << 4)).compress(found));
                    noted += found.count_ones() as usize;
                    x = x + one;
                    found &= F::U32s::bitmask(x.lt(end));
                    if noted > FOUND - LANES {
                        self.note(token, scene, &columns, noted, each);
                        noted = 0;
                    }
                }
            }
            for (lambda, &by) in layer.iter_mut().zip(&filter.growth[2]) {
                *lambda = *lambda + by;
            }
        }
        self.note(token, scene, &columns, noted, each);
    }

    /// Notes the candidates found so far.
    #[inline(always)]
    fn note<F: F32x16s>(
        &mut self,
        token: F::Token,
        scene: &Scene<'_>,
        columns: &Columns<F>,
        count: usize,
        each: &mut impl FnMut(&Members),
    ) {
        let fifteen = F::U32s::splat(token, 15);
        let strides = scene.scanner.strides();
        for from in (0..count).step_by(LANES) {
            let found = F::U32s::load(token, &self.found[from..]);
            let number = |bits| (found >> bits) & fifteen;
            let xyz = [number(4), number(8), number(12)];
            let (candidates, members) = (&mut *self.candidates, &mut *self.members);
            let n = members.len;
            for (to, edge) in candidates.edges.iter_mut().zip(&columns.edges) {
                for (to, edge) in to.iter_mut().zip(edge) {
                    edge.permute(found).store(&mut to[n..]);
                }
            }
            for (axis, to) in candidates.at.iter_mut().enumerate() {
                let offset = F::from_i32(xyz[axis] << scene.shifts[axis]);
                (columns.first[axis].permute(found) + offset).store(&mut to[n..]);
            }
            let [x, y, z] = xyz;
            let place = z * F::U32s::splat(token, strides[1]) + y * F::U32s::splat(token, strides[0]) + x;
            (columns.places.permute(found) + place).store(&mut members.places[n..]);
            columns.tets.permute(found).store(&mut members.tets[n..]);
            members.len += LANES.min(count - from);
            if members.len > MEMBERS - LANES {
                self.hand_on(scene, each);
            }
        }
    }

    /// Decides on the candidates, and hands on those that are members.
    #[inline(never)]
    fn hand_on(&mut self, scene: &Scene<'_>, each: &mut impl FnMut(&Members)) {
        let (candidates, members) = (&mut *self.candidates, &mut *self.members);
        let count = members.len.min(MEMBERS);
        let weights = &mut members.weights;
        match Avx512::found() {
            Some(token) => with_avx512(
                token,
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
        // The last ones first: the candidate that takes the place of another has been examined.
        for &i in others[..len].iter().rev() {
            members.remove(usize::from(i) % MEMBERS);
        }
        members.hand_on(each);
    }

    /// Scans a tetrahedron by itself.
    #[inline(never)]
    fn alone(&mut self, scene: &Scene<'_>, tet: u32, each: &mut impl FnMut(&Members)) {
        let alone = &mut *self.alone;
        scene.scanner.each_run(scene.corners(tet), |place, run| {
            if alone.len + run.len() > MEMBERS {
                alone.hand_on(each);
            }
            for (i, weights) in run.iter().enumerate() {
                let n = alone.len % MEMBERS;
                (alone.tets[n], alone.places[n]) = (tet, (place + i) as u32);
                (0..4).for_each(|k| alone.weights[k][n] = weights[k]);
                alone.len = n + 1;
            }
        });
    }
}

/// Puts some numbers into a list, at a place that has room for all of them.
#[inline(always)]
fn put<T: Copy>(list: &mut [T], at: usize, numbers: [T; LANES]) {
    list[at..at + LANES].copy_from_slice(&numbers);
}
