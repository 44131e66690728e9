//! Sixteen tetrahedra side by side: their boxes, their planes in `f32`.

use super::LANES;
use crate::mesh::tet::Tet;
use crate::raster::Scanner;
use crate::simd::{F32x16s, Lanes, U32x16s, four, three};
use isospan_io::geom::LatticePos;
use isospan_io::geom::vec3::{cross, dot};

/// The error of the filter, in M³: see the module above.
const ERROR: f32 = 1024.0 / (1u32 << 24) as f32;
/// Stands for no growth: λ does not change from -16 to 16.
const NO_GROWTH: f32 = 1e-30;

/// The grid, the positions and the tetrahedra of a scan.
pub(super) struct Scene<'a> {
    pub(super) scanner: &'a Scanner<'a>,
    pub(super) positions: &'a [LatticePos],
    pub(super) tets: &'a [Tet],
    /// log2 of the distance of samples along each axis.
    pub(super) shifts: [u32; 3],
}

impl Scene<'_> {
    pub(super) fn corners(&self, tet: u32) -> [LatticePos; 4] {
        self.tets[tet as usize].map(|v| self.positions[v as usize])
    }
}

/// Sixteen tetrahedra, coordinate by coordinate.
pub(super) struct Boxes<I> {
    pub(super) corners: [[I; 3]; 4],
    /// The first sample of the box and the end of it, in the window.
    pub(super) from: [I; 3],
    pub(super) to: [I; 3],
    /// The longest edge of the bounding box.
    pub(super) longest: I,
}

impl<I: U32x16s> Boxes<I> {
    #[inline(always)]
    pub(super) fn new(token: I::Token, scene: &Scene<'_>, tet: impl Fn(usize) -> u32) -> Self {
        let tets: [Tet; LANES] = std::array::from_fn(|n| scene.tets[tet(n) as usize]);
        let corners = four(
            #[inline(always)]
            |k| {
                I::from_rows(
                    token,
                    #[inline(always)]
                    |n| scene.positions[tets[n][k] as usize],
                )
            },
        );
        let [a, b, c, d] = &corners;
        let (lo, hi) = scene.scanner.window();
        let mut longest = I::splat(token, 0);
        let ranges = three(
            #[inline(always)]
            |k| {
                let least = a[k].min(b[k]).min(c[k].min(d[k]));
                let most = a[k].max(b[k]).max(c[k].max(d[k]));
                let shift = scene.shifts[k];
                let before = I::splat(token, (1 << shift) - 1);
                let from = ((least + before) >> shift).max(I::splat(token, lo[k]));
                let to = ((most >> shift) + I::splat(token, 1)).min(I::splat(token, hi[k]));
                longest = longest.max(most - least);
                (from, to)
            },
        );
        let [x, y, z] = ranges;
        Self { corners, from: [x.0, y.0, z.0], to: [x.1, y.1, z.1], longest }
    }

    /// Samples along each axis; no number of any where there are none.
    #[inline(always)]
    pub(super) fn samples(&self) -> [I; 3] {
        let [x, y, z] = self.to;
        [x - self.from[0], y - self.from[1], z - self.from[2]]
    }

    /// The boxes that have samples.
    #[inline(always)]
    pub(super) fn with_samples(&self) -> u32 {
        let ([x, y, z], [u, v, w]) = (&self.from, &self.to);
        I::bitmask(x.lt(*u)) & I::bitmask(y.lt(*v)) & I::bitmask(z.lt(*w))
    }
}

/// What is noted of sixteen tetrahedra.
pub(super) struct Columns<F: F32x16s> {
    pub(super) tets: F::U32s,
    /// The place of the first sample in the window.
    pub(super) places: F::U32s,
    pub(super) edges: [[F; 3]; 3],
    pub(super) first: [F; 3],
}

impl<F: F32x16s> Columns<F> {
    #[inline(always)]
    pub(super) fn new(
        token: F::Token,
        scene: &Scene<'_>,
        boxes: &Boxes<F::U32s>,
        filter: &Filter<F>,
        tets: F::U32s,
    ) -> Self {
        let (lo, strides) = (scene.scanner.window().0, scene.scanner.strides());
        let [x, y, z] = three(
            #[inline(always)]
            |k| boxes.from[k] - F::U32s::splat(token, lo[k]),
        );
        let [row, layer] = [F::U32s::splat(token, strides[0]), F::U32s::splat(token, strides[1])];
        let places = z * layer + y * row + x;
        Self { tets, places, edges: filter.edges, first: filter.first }
    }
}

/// The four planes of sixteen tetrahedra, in samples; of corners b, c, d, a.
pub(super) struct Filter<F: F32x16s> {
    /// From corner a to the others, and to the first sample: exact.
    pub(super) edges: [[F; 3]; 3],
    pub(super) first: [F; 3],
    /// λ at the first sample, raised by the error.
    pub(super) lambda: [F; 4],
    /// The growth of λ along each axis, from sample to sample.
    pub(super) growth: [[F; 4]; 3],
    /// Times λ, the sample of the row at which it is 0.
    pub(super) crossing: [F; 4],
    /// Where λ grows along a row, and where it does not.
    pub(super) rises: [F::Mask; 4],
    pub(super) falls: [F::Mask; 4],
}

impl<F: F32x16s> Filter<F> {
    #[inline(always)]
    pub(super) fn new(token: F::Token, boxes: &Boxes<F::U32s>, shifts: [u32; 3]) -> Self {
        let [a, b, c, d] = &boxes.corners;
        let edges = [between::<F>(a, b), between::<F>(a, c), between::<F>(a, d)];
        let first = three(
            #[inline(always)]
            |k| F::from_i32((boxes.from[k] << shifts[k]) - a[k]),
        );
        let [b, c, d] = edges;
        let (gb, gc, gd) = (cross(c, d), cross(d, b), cross(b, c));
        let zero = F::splat(token, 0.0);
        let ga = three(
            #[inline(always)]
            |k| zero - (gb[k] + gc[k] + gd[k]),
        );
        let m = F::from_i32(boxes.longest);
        let error = F::splat(token, ERROR) * m * m * m;
        let planes = [gb, gc, gd, ga];
        let raised = [error, error, error, dot(b, gb) + error];
        let lambda = four(
            #[inline(always)]
            |k| dot(planes[k], first) + raised[k],
        );
        let growth = three(
            #[inline(always)]
            |axis| {
                let pitch = F::splat(token, (1u32 << shifts[axis]) as f32);
                four(
                    #[inline(always)]
                    |k| planes[k][axis] * pitch,
                )
            },
        );
        let along = growth[0];
        let rises = four(
            #[inline(always)]
            |k| zero.lt(along[k]),
        );
        let (minus_one, none) = (F::splat(token, -1.0), F::splat(token, -NO_GROWTH));
        let slopes = four(
            #[inline(always)]
            |k| F::select(rises[k], along[k], F::select(along[k].lt(zero), along[k], none)),
        );
        let falls = four(
            #[inline(always)]
            |k| slopes[k].lt(zero),
        );
        let crossing = four(
            #[inline(always)]
            |k| minus_one / slopes[k],
        );
        Self { edges, first, lambda, growth, crossing, rises, falls }
    }
}

/// From one position to another.
#[inline(always)]
fn between<F: F32x16s>(a: &[F::U32s; 3], b: &[F::U32s; 3]) -> [F; 3] {
    three(
        #[inline(always)]
        |k| F::from_i32(b[k] - a[k]),
    )
}
