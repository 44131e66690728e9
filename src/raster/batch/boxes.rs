//! Sixteen tetrahedra side by side: their boxes, their planes in `f32`.

use super::LANES;
use crate::geom::LatticePos;
use crate::mesh::tet::Tet;
use crate::raster::Scanner;
use crate::raster::sixteen::{Bits, Floats, Ints};
use crate::simd::{four, three};

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

impl<I: Ints> Boxes<I> {
    #[inline(always)]
    pub(super) fn new(proof: I::Proof, scene: &Scene<'_>, tet: impl Fn(usize) -> u32) -> Self {
        let tets: [Tet; LANES] = std::array::from_fn(|n| scene.tets[tet(n) as usize]);
        let corners = four(
            #[inline(always)]
            |k| {
                I::columns(
                    proof,
                    #[inline(always)]
                    |n| scene.positions[tets[n][k] as usize],
                )
            },
        );
        let [a, b, c, d] = &corners;
        let (lo, hi) = scene.scanner.window();
        let mut longest = I::splat(proof, 0);
        let ranges = three(
            #[inline(always)]
            |k| {
                let least = a[k].min(b[k]).min(c[k].min(d[k]));
                let most = a[k].max(b[k]).max(c[k].max(d[k]));
                let shift = scene.shifts[k];
                let before = I::splat(proof, (1 << shift) - 1);
                let from = least.plus(before).shifted_right(shift).max(I::splat(proof, lo[k]));
                let to = most.shifted_right(shift).plus(I::splat(proof, 1)).min(I::splat(proof, hi[k]));
                longest = longest.max(most.minus(least));
                (from, to)
            },
        );
        let [x, y, z] = ranges;
        Self { corners, from: [x.0, y.0, z.0], to: [x.1, y.1, z.1], longest }
    }

    /// Samples along each axis; no number of any where there are none.
    #[inline(always)]
    pub(super) fn samples(&self) -> [I; 3] {
        let [x, y, z] = &self.to;
        [x.minus(self.from[0]), y.minus(self.from[1]), z.minus(self.from[2])]
    }

    /// The boxes that have samples.
    #[inline(always)]
    pub(super) fn with_samples(&self) -> Bits {
        let ([x, y, z], [u, v, w]) = (&self.from, &self.to);
        x.below(*u) & y.below(*v) & z.below(*w)
    }
}

/// What is noted of sixteen tetrahedra.
pub(super) struct Columns<F: Floats> {
    pub(super) tets: F::Ints,
    /// The place of the first sample in the window.
    pub(super) places: F::Ints,
    pub(super) edges: [[F; 3]; 3],
    pub(super) first: [F; 3],
}

impl<F: Floats> Columns<F> {
    #[inline(always)]
    pub(super) fn new(
        proof: F::Proof,
        scene: &Scene<'_>,
        boxes: &Boxes<F::Ints>,
        filter: &Filter<F>,
        tets: F::Ints,
    ) -> Self {
        let (lo, strides) = (scene.scanner.window().0, scene.scanner.strides());
        let [x, y, z] = three(
            #[inline(always)]
            |k| boxes.from[k].minus(F::Ints::splat(proof, lo[k])),
        );
        let [row, layer] = [F::Ints::splat(proof, strides[0]), F::Ints::splat(proof, strides[1])];
        let places = z.times(layer).plus(y.times(row)).plus(x);
        Self { tets, places, edges: filter.edges, first: filter.first }
    }
}

/// The four planes of sixteen tetrahedra, in samples; of corners b, c, d, a.
pub(super) struct Filter<F: Floats> {
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

impl<F: Floats> Filter<F> {
    #[inline(always)]
    pub(super) fn new(proof: F::Proof, boxes: &Boxes<F::Ints>, shifts: [u32; 3]) -> Self {
        let [a, b, c, d] = &boxes.corners;
        let edges = [between::<F>(a, b), between::<F>(a, c), between::<F>(a, d)];
        let first = three(
            #[inline(always)]
            |k| boxes.from[k].shifted_left(shifts[k]).minus(a[k]).floats(),
        );
        let [b, c, d] = edges;
        let (gb, gc, gd) = (cross(c, d), cross(d, b), cross(b, c));
        let zero = F::splat(proof, 0.0);
        let ga = three(
            #[inline(always)]
            |k| zero.minus(gb[k].plus(gc[k]).plus(gd[k])),
        );
        let m = boxes.longest.floats();
        let error = F::splat(proof, ERROR).times(m).times(m).times(m);
        let planes = [gb, gc, gd, ga];
        let raised = [error, error, error, dot(b, gb).plus(error)];
        let lambda = four(
            #[inline(always)]
            |k| dot(planes[k], first).plus(raised[k]),
        );
        let growth = three(
            #[inline(always)]
            |axis| {
                let pitch = F::splat(proof, (1u32 << shifts[axis]) as f32);
                four(
                    #[inline(always)]
                    |k| planes[k][axis].times(pitch),
                )
            },
        );
        let along = growth[0];
        let rises = four(
            #[inline(always)]
            |k| zero.below(along[k]),
        );
        let (minus_one, none) = (F::splat(proof, -1.0), F::splat(proof, -NO_GROWTH));
        let slopes = four(
            #[inline(always)]
            |k| F::pick(rises[k], along[k], F::pick(along[k].below(zero), along[k], none)),
        );
        let falls = four(
            #[inline(always)]
            |k| slopes[k].below(zero),
        );
        let crossing = four(
            #[inline(always)]
            |k| minus_one.over(slopes[k]),
        );
        Self { edges, first, lambda, growth, crossing, rises, falls }
    }
}

/// From one position to another.
#[inline(always)]
fn between<F: Floats>(a: &[F::Ints; 3], b: &[F::Ints; 3]) -> [F; 3] {
    three(
        #[inline(always)]
        |k| b[k].minus(a[k]).floats(),
    )
}

#[inline(always)]
fn cross<F: Floats>(u: [F; 3], v: [F; 3]) -> [F; 3] {
    let ([a, b, c], [x, y, z]) = (u, v);
    [b.times(z).minus(c.times(y)), c.times(x).minus(a.times(z)), a.times(y).minus(b.times(x))]
}

#[inline(always)]
fn dot<F: Floats>(u: [F; 3], v: [F; 3]) -> F {
    u[0].times(v[0]).plus(u[1].times(v[1])).plus(u[2].times(v[2]))
}
