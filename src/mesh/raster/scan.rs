//! Scan conversion of a tetrahedron on a grid of samples.
//!
//! Two steps. A **filter** in `f32`, four samples at a time, says which samples of a row can be
//! inside: each λ is raised by more than its error, so no sample inside is lost, and few others
//! stay. Then exact integers decide, and give the weights.

use super::planes::{Int, LONGEST_64, Planes};
use super::{Axis, SampleGrid};
use glam::{Mat4, Vec4, Vec4Swizzles};
use isospan_io::geom::LatticePos;
use isospan_io::grid::IndexBox;

/// Calls `each` for every sample of the window that belongs to a positively oriented tetrahedron,
/// with its place in an x-fastest array of the window, and the weights of the corners. See the
/// module for the rule for ties.
///
/// # Panics
/// When the window is not one of the grid.
#[inline]
pub fn each_sample(
    grid: &SampleGrid,
    window: &IndexBox,
    corners: [LatticePos; 4],
    mut each: impl FnMut(usize, [f64; 4]),
) {
    Scanner::new(grid, window).each_sample(corners, &mut each);
}

/// Samples handed on at a time.
const RUN: usize = 8;

/// Scans many tetrahedra on a window of a grid.
#[derive(Clone, Copy, Debug)]
pub struct Scanner<'a> {
    axes: &'a [Axis; 3],
    far: LatticePos,
    lo: [usize; 3],
    hi: [usize; 3],
    /// Samples of a row of the window, of a layer.
    strides: [usize; 2],
    /// The distance of neighbours along each axis, if all axes are even.
    pitch: Option<[f32; 3]>,
}

/// A tetrahedron, and the samples of the window in its bounding box.
struct FoundSamples {
    corners: [LatticePos; 4],
    lo: [usize; 3],
    hi: [usize; 3],
    /// Position of the first.
    first: LatticePos,
    /// Place of the first in the window.
    place: usize,
    filter: Filter,
}

impl<'a> Scanner<'a> {
    /// A scanner of a window of a grid.
    ///
    /// # Panics
    /// When the window is not one of the grid.
    pub fn new(grid: &'a SampleGrid, window: &IndexBox) -> Self {
        let whole = IndexBox::whole(grid.dims());
        assert!(window.is_empty() || window.intersect(&whole) == *window, "the window is one of the grid");
        let (lo, hi) = (window.lo.map(|n| n as usize), window.hi.map(|n| n as usize));
        let row = hi[0].saturating_sub(lo[0]);
        let strides = [row, row * hi[1].saturating_sub(lo[1])];
        let axes = grid.axes();
        let pitch = match [axes[0].pitch(), axes[1].pitch(), axes[2].pitch()] {
            [Some(x), Some(y), Some(z)] => Some([x, y, z]),
            _ => None,
        };
        Self { axes, far: grid.far(), lo, hi, strides, pitch }
    }

    /// log2 of the distance of samples along each axis, where it is the same for all of them, and
    /// the first sample is at 0.
    pub(super) fn even_shifts(&self) -> Option<[u32; 3]> {
        let [x, y, z] = [0, 1, 2].map(|k| self.axes[k].shift_from_zero());
        Some([x?, y?, z?])
    }

    /// Samples of the window.
    pub(super) fn len(&self) -> u64 {
        self.strides[1] as u64 * self.hi[2].saturating_sub(self.lo[2]) as u64
    }

    /// First and end of the window.
    pub(super) fn window(&self) -> ([u32; 3], [u32; 3]) {
        (self.lo.map(|n| n as u32), self.hi.map(|n| n as u32))
    }

    /// Samples of a row of the window, of a layer.
    pub(super) fn strides(&self) -> [u32; 2] {
        self.strides.map(|n| n as u32)
    }

    /// The largest position of the domain.
    pub(super) fn far(&self) -> LatticePos {
        self.far
    }

    /// Calls `each` with the samples of the window that belong to a positively oriented
    /// tetrahedron, in runs along x: the place of a run's first sample in an x-fastest array of the
    /// window, and the weights of the corners at each of its samples. Runs come in the order of
    /// their places.
    #[inline(always)]
    pub fn each_run(&self, corners: [LatticePos; 4], each: impl FnMut(usize, &[[f64; 4]])) {
        let [a, b, c, d] = corners;
        let [fa, fb, fc, fd] = [vector(a), vector(b), vector(c), vector(d)];
        let lo = fa.min(fb).min(fc.min(fd));
        let hi = fa.max(fb).max(fc.max(fd));
        let ([lx, ly, lz, _], [hx, hy, hz, _]) = (lo.to_array(), hi.to_array());
        let from = |k: usize, c: f32| self.axes[k].below(c as i32 as u32).max(self.lo[k]);
        let to = |k: usize, c: f32| self.axes[k].up_to(c as i32 as u32).min(self.hi[k]);
        let (from, to) = ([from(0, lx), from(1, ly), from(2, lz)], [to(0, hx), to(1, hy), to(2, hz)]);
        if from[0] >= to[0] || from[1] >= to[1] || from[2] >= to[2] {
            return;
        }
        let position = |k: usize| self.axes[k].position(from[k]);
        let first = [position(0), position(1), position(2)];
        let [x, y, z, _] = (hi - lo).to_array();
        let longest = if x > y { x } else { y };
        let longest = if longest > z { longest } else { z };
        let edges = Mat4::from_cols(fb - fa, fc - fa, fd - fa, Vec4::ZERO).transpose();
        let found = FoundSamples {
            corners,
            lo: from,
            hi: to,
            first,
            place: (from[2] - self.lo[2]) * self.strides[1]
                + (from[1] - self.lo[1]) * self.strides[0]
                + (from[0] - self.lo[0]),
            filter: Filter::new(edges, vector(first) - fa, longest),
        };
        if longest <= LONGEST_64 as f32 {
            self.scan::<i64>(&found, each);
        } else {
            self.scan::<i128>(&found, each);
        }
    }

    /// As [`Scanner::each_run`], sample by sample.
    #[inline]
    pub fn each_sample(&self, corners: [LatticePos; 4], mut each: impl FnMut(usize, [f64; 4])) {
        self.each_run(corners, |place, run| {
            for (i, &weights) in run.iter().enumerate() {
                each(place + i, weights);
            }
        });
    }

    #[inline(always)]
    fn scan<I: Int>(&self, found: &FoundSamples, each: impl FnMut(usize, &[[f64; 4]])) {
        let (width, height) = (found.hi[0] - found.lo[0], found.hi[1] - found.lo[1]);
        let exact = Exact::<I, _> { scanner: self, found, planes: None, weights: [[0.0; 4]; RUN], each };
        if width <= 4 && height <= 4 {
            self.tiles(found, exact);
        } else if width <= 8 {
            self.rows(found, exact);
        } else {
            self.long_rows(found, exact);
        }
    }

    /// How far four samples of an axis are from its first in the box. Those behind the last one are
    /// anywhere.
    #[inline(always)]
    fn offsets(&self, found: &FoundSamples, axis: usize, from: usize) -> Vec4 {
        if let Some(pitch) = self.pitch {
            let from = from as f32;
            return Vec4::from_array([from, from + 1.0, from + 2.0, from + 3.0]) * pitch[axis];
        }
        let at = |i: usize| self.offset(found, axis, (found.lo[axis] + from + i).min(found.hi[axis] - 1));
        Vec4::from_array([at(0), at(1), at(2), at(3)])
    }

    #[inline(always)]
    fn offset(&self, found: &FoundSamples, axis: usize, sample: usize) -> f32 {
        match self.pitch {
            Some(pitch) => (sample - found.lo[axis]) as i32 as f32 * pitch[axis],
            None => (self.axes[axis].position(sample) - found.first[axis]) as f32,
        }
    }

    /// Boxes of up to 4 by 4 samples a layer: sixteen tests at a time.
    #[inline(always)]
    fn tiles<I: Int, F: FnMut(usize, &[[f64; 4]])>(&self, found: &FoundSamples, mut exact: Exact<'_, I, F>) {
        let (width, height) = (found.hi[0] - found.lo[0], found.hi[1] - found.lo[1]);
        let filter = &found.filter;
        let along_x = filter.growth(self.offsets(found, 0, 0));
        let ys = spread(self.offsets(found, 1, 0));
        let y = spread(filter.y);
        let grown = |k: usize, j: usize| along_x[k] + y[k] * ys[j];
        let row = |j: usize| [grown(0, j), grown(1, j), grown(2, j), grown(3, j)];
        let rows = [row(0), row(1), row(2), row(3)];
        // A row has four bits; `width` of them count.
        let wanted = (0x1111 * ((1 << width) - 1)) & ((1u32 << (4 * height)) - 1);
        for iz in found.lo[2]..found.hi[2] {
            let dz = self.offset(found, 2, iz);
            let layer = spread(filter.first + filter.z * dz);
            let mut mask = candidates(&layer, &rows[0])
                | candidates(&layer, &rows[1]) << 4
                | candidates(&layer, &rows[2]) << 8
                | candidates(&layer, &rows[3]) << 12;
            mask &= wanted;
            while mask != 0 {
                let row = mask.trailing_zeros() / 4;
                exact.row(iz, found.lo[1] + row as usize, mask >> (4 * row) & 15);
                mask &= !(15 << (4 * row));
            }
        }
    }

    /// Rows of up to 8 samples.
    #[inline(always)]
    fn rows<I: Int, F: FnMut(usize, &[[f64; 4]])>(&self, found: &FoundSamples, mut exact: Exact<'_, I, F>) {
        let filter = &found.filter;
        let near = filter.growth(self.offsets(found, 0, 0));
        let beyond = filter.growth(self.offsets(found, 0, 4));
        let wanted = (1u32 << (found.hi[0] - found.lo[0])) - 1;
        for iz in found.lo[2]..found.hi[2] {
            let layer = filter.first + filter.z * self.offset(found, 2, iz);
            for iy in found.lo[1]..found.hi[1] {
                let dy = self.offset(found, 1, iy);
                let row = spread(layer + filter.y * dy);
                let mask = (candidates(&row, &near) | candidates(&row, &beyond) << 4) & wanted;
                if mask != 0 {
                    exact.row(iz, iy, mask);
                }
            }
        }
    }

    /// Rows of any length: the ends of the run that can be inside are computed.
    #[inline(never)]
    fn long_rows<I: Int, F: FnMut(usize, &[[f64; 4]])>(
        &self,
        found: &FoundSamples,
        mut exact: Exact<'_, I, F>,
    ) {
        let filter = &found.filter;
        let inverse = filter.x.to_array().map(|g| -1.0 / f64::from(g));
        for iz in found.lo[2]..found.hi[2] {
            let layer = filter.first + filter.z * self.offset(found, 2, iz);
            for iy in found.lo[1]..found.hi[1] {
                let row = layer + filter.y * self.offset(found, 1, iy);
                let (start, end) = self.span(found, row.to_array(), filter.x.to_array(), &inverse);
                if start < end {
                    exact.run(iz, iy, start, end);
                }
            }
        }
    }

    /// The samples of a long row that can be inside.
    #[inline(always)]
    fn span(
        &self,
        found: &FoundSamples,
        lambda: [f32; 4],
        growth: [f32; 4],
        inverse: &[f64; 4],
    ) -> (usize, usize) {
        let (xs, lo, hi) = (&self.axes[0], found.lo[0], found.hi[0]);
        let x = found.first[0];
        let (mut from, mut to) = (0.0f64, f64::from(xs.position(hi - 1) - x));
        for k in 0..4 {
            let crossing = f64::from(lambda[k]) * inverse[k];
            if growth[k] > 0.0 {
                from = if crossing > from { crossing } else { from };
            } else if growth[k] < 0.0 {
                to = if crossing < to { crossing } else { to };
            } else if lambda[k] < 0.0 {
                return (0, 0);
            }
        }
        if from > to + SLACK {
            return (0, 0);
        }
        // Casts cut fractions off and saturate; what they lose is outside of the row.
        let start = xs.below(x.saturating_add((from - SLACK) as u32)).clamp(lo, hi);
        let end = xs.up_to(x.saturating_add((to + SLACK) as u32)).clamp(lo, hi);
        (start, end)
    }
}

/// The most that a computed end of a span may be wrong by, in lattice steps: far more than it is
/// (2^24 · 2^-51).
const SLACK: f64 = 1e-6;

/// λ of the four corners in `f32`, lanes in the order b, c, d, a, at the first sample of the box,
/// and what they grow by a lattice step; raised by the error.
///
/// With M the longest edge of the bounding box and u = 2^-24: differences of positions are exact; a
/// component of a cross product is off by at most 4·M²u, their sum (the gradient of a) by 22·M²u;
/// the products with differences of up to M and the sums add up to less than 200·M³u for any sample
/// of the box.
struct Filter {
    first: Vec4,
    x: Vec4,
    y: Vec4,
    z: Vec4,
}

const ERROR: f32 = 256.0 / (1u32 << 24) as f32;

impl Filter {
    /// The filter from the edges from a to the other corners, coordinate by coordinate, and the
    /// place of the first sample relative to a.
    #[inline(always)]
    fn new(edges: Mat4, first_from_a: Vec4, longest: f32) -> Self {
        let (x, y, z) = (edges.x_axis, edges.y_axis, edges.z_axis);
        let (ux, uy, uz) = (x.yzxw(), y.yzxw(), z.yzxw());
        let (vx, vy, vz) = (ux.yzxw(), uy.yzxw(), uz.yzxw());
        let gx = uy * vz - uz * vy;
        let gy = uz * vx - ux * vz;
        let gz = ux * vy - uy * vx;
        let volume = (x * gx + y * gy + z * gz).x;
        // Lane 3 is 0 so far.
        let with_a = |g: Vec4| {
            let [b, c, d, _] = g.to_array();
            g - Vec4::from_array([0.0, 0.0, 0.0, b + c + d])
        };
        let (gx, gy, gz) = (with_a(gx), with_a(gy), with_a(gz));
        let error = ERROR * longest * longest * longest;
        let [rx, ry, rz, _] = spread(first_from_a);
        let at_first = gx * rx + gy * ry + gz * rz;
        let first = at_first + Vec4::from_array([error, error, error, volume + error]);
        Self { first, x: gx, y: gy, z: gz }
    }

    /// The growth of each λ at some offsets along x.
    #[inline(always)]
    fn growth(&self, offsets: Vec4) -> [Vec4; 4] {
        let [b, c, d, a] = spread(self.x);
        [b * offsets, c * offsets, d * offsets, a * offsets]
    }
}

/// A position and 0; coordinates of at most 24 bits, and 2^24, are exact.
#[inline(always)]
fn vector(p: LatticePos) -> Vec4 {
    let [x, y, z] = p.map(|c| c as i32 as f32);
    Vec4::new(x, y, z, 0.0)
}

/// Each lane in all four.
#[inline(always)]
fn spread(x: Vec4) -> [Vec4; 4] {
    [x.xxxx(), x.yyyy(), x.zzzz(), x.wwww()]
}

/// Bit i is set where sample i can be inside.
#[inline(always)]
fn candidates(row: &[Vec4; 4], growth: &[Vec4; 4]) -> u32 {
    let at = |k: usize| row[k] + growth[k];
    at(0).min(at(1)).min(at(2).min(at(3))).is_negative_bitmask() ^ 15
}

/// The exact part: planes are made when a sample first asks for them.
struct Exact<'a, I, F> {
    scanner: &'a Scanner<'a>,
    found: &'a FoundSamples,
    planes: Option<(Planes<I>, f64)>,
    weights: [[f64; 4]; RUN],
    each: F,
}

impl<I: Int, F: FnMut(usize, &[[f64; 4]])> Exact<'_, I, F> {
    /// A row in which the samples of some bits can be inside.
    #[inline(always)]
    fn row(&mut self, iz: usize, iy: usize, mask: u32) {
        let first = self.found.lo[0];
        let (start, end) = (mask.trailing_zeros() as usize, 32 - mask.leading_zeros() as usize);
        self.run(iz, iy, first + start, first + end);
    }

    /// Hands on the samples among `start..end` of a row that are inside. They follow each other:
    /// samples that only the filter let through lie at the ends.
    #[inline(always)]
    fn run(&mut self, iz: usize, iy: usize, start: usize, end: usize) {
        let (axes, found) = (self.scanner.axes, self.found);
        let (planes, unit) = self.planes.get_or_insert_with(|| {
            let planes = Planes::<I>::new(found.corners);
            let unit = 1.0 / planes.volume.float();
            (planes, unit)
        });
        let unit = *unit;
        let (y, z) = (axes[1].position(iy), axes[2].position(iz));
        let xs = &axes[0].positions()[start..end];
        let row = found.place
            + (iz - found.lo[2]) * self.scanner.strides[1]
            + (iy - found.lo[1]) * self.scanner.strides[0];
        let mut place = row + (start - found.lo[0]);
        let [ga, gb, gc, gd] = [0, 1, 2, 3].map(|k| planes.gradient[k][0]);
        let [la, lb, lc, ld] = planes.at([xs[0], y, z]);
        let mut n = 0;
        for &x in xs {
            let step = I::of((x - xs[0]) as i32);
            let lambda = [
                ga.times(step).plus(la),
                gb.times(step).plus(lb),
                gc.times(step).plus(lc),
                gd.times(step).plus(ld),
            ];
            if !planes.has(lambda, [x, y, z], self.scanner.far) {
                place += usize::from(n == 0);
                continue;
            }
            let [a, b, c, d] = lambda;
            self.weights[n] = [a.float() * unit, b.float() * unit, c.float() * unit, d.float() * unit];
            n += 1;
            if n == RUN {
                (self.each)(place, &self.weights);
                (place, n) = (place + RUN, 0);
            }
        }
        if n > 0 {
            (self.each)(place, &self.weights[..n]);
        }
    }
}
