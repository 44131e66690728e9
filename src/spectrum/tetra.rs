//! What a tetrahedron contributes at the knots in its range.
//!
//! With the corner values in order, f0 <= f1 <= f2 <= f3, and `d01 = 1 / (f1 - f0)` and so on, let
//! at an isovalue v be
//!
//! ```text
//!   a   = (v - f0)·d01, at most 1              t02 = (v - f0)·d02     t03 = (v - f0)·d03
//!   b   = (v - f1)·d12, from 0 to 1            s13 = (f3 - v)·d13
//!   c   = (f3 - v)·d23, from 0 to b            w   = t02·(a - b) + s13·c
//! ```
//!
//! Then the density of the volume over the values is `3·d03·w`, whichever of the three parabolas
//! holds: below f1 it is t02·a, for b and c are 0; above f2 it is s13·c, for a and b are 1;
//! between, t02·(1 - b) + s13·b. The share of the volume above v is `1 - b + s13·c - t03·w`: up to
//! f2 the wedge below is three tetrahedra. Where two values are equal, the one over their
//! difference is a number so large that the clamps do what the limit does, and no product
//! overflows: differences of `f32` are at least 2^-149. So there is no branch, no NaN, and above f3
//! all is 0.
//!
//! The six quotients of a tetrahedron cost one division: each is the product of what is not its own
//! over the product of all six, which is between 2^-894 and 2^774.

use super::design::Design;
use super::sums::VOID;
use crate::exec::lanes::{Floats, Four, Wide, four, sorted, three};
use crate::mesh::tet::Tet;

/// Tetrahedra that are looked at together: enough that the sums near their values, at some steps,
/// are fetched once for many of them.
pub(super) const BATCH: usize = 64;
/// Knots that are looked at together.
pub(super) const KNOTS: usize = 8;

/// Tetrahedra, column by column, four by four.
type Column = [[f64; 4]; BATCH / 4];

/// The properties of tetrahedra that do not depend on values.
#[derive(Default)]
pub(super) struct Shapes {
    /// The cross products of the edges from the first corner: those without the edge to the second,
    /// third, fourth corner.
    normals: [[Column; 3]; 3],
    /// Six times the volume, and one over that, or 0.
    six: Column,
    inverse: Column,
}

/// Those properties of some tetrahedra, or of one in all lanes.
#[derive(Clone, Copy)]
pub(super) struct Shape<W> {
    normals: [[W; 3]; 3],
    six: W,
    inverse: W,
}

impl Shapes {
    /// Computes them for at most [`BATCH`] tetrahedra.
    #[inline(always)]
    pub(super) fn look<W: Four>(&mut self, proof: W::Proof, places: &[[f64; 4]], tets: &[Tet]) {
        let (zero, one) = (W::splat(proof, 0.0), W::splat(proof, 1.0));
        for (n, four) in tets.chunks(4).enumerate() {
            // With fewer than four, the last one is repeated.
            let four = [0, 1, 2, 3].map(|k| four[k.min(four.len() - 1)]);
            let a = corners::<W>(proof, places, &four, 0);
            let b = edge(proof, places, &four, 1, &a);
            let c = edge(proof, places, &four, 2, &a);
            let d = edge(proof, places, &four, 3, &a);
            let six = dot(b, cross(c, d));
            let six = six.max(zero.minus(six));
            self.put(0, n, cross(c, d));
            self.put(1, n, cross(d, b));
            self.put(2, n, cross(b, c));
            self.six[n] = six.lanes();
            self.inverse[n] = W::pick(zero.below(six), one.over(six), zero).lanes();
        }
    }

    #[inline(always)]
    fn put<W: Four>(&mut self, normal: usize, n: usize, [x, y, z]: [W; 3]) {
        let [to_x, to_y, to_z] = &mut self.normals[normal];
        (to_x[n], to_y[n], to_z[n]) = (x.lanes(), y.lanes(), z.lanes());
    }

    /// The n-th eight.
    #[inline(always)]
    pub(super) fn eight<W: Floats<8>>(&self, proof: W::Proof, n: usize) -> Shape<W> {
        self.map(
            #[inline(always)]
            |column| W::of(proof, &column.as_flattened().as_chunks().0[n]),
        )
    }

    /// The i-th, in all lanes.
    #[inline(always)]
    pub(super) fn one<W: Wide>(&self, proof: W::Proof, i: usize) -> Shape<W> {
        self.map(
            #[inline(always)]
            |column| W::splat(proof, column[i / 4][i % 4]),
        )
    }

    #[inline(always)]
    fn map<W: Wide>(&self, of: impl Fn(&Column) -> W) -> Shape<W> {
        let [[a, b, c], [d, e, f], [g, h, i]] = &self.normals;
        Shape {
            normals: [[of(a), of(b), of(c)], [of(d), of(e), of(f)], [of(g), of(h), of(i)]],
            six: of(&self.six),
            inverse: of(&self.inverse),
        }
    }
}

/// A corner of each of four tetrahedra.
#[inline(always)]
fn corners<W: Four>(proof: W::Proof, places: &[[f64; 4]], tets: &[Tet; 4], corner: usize) -> [W; 4] {
    four(
        #[inline(always)]
        |i| W::of(proof, &places[tets[i][corner] as usize]),
    )
}

/// From corner a to another one.
#[inline(always)]
fn edge<W: Four>(
    proof: W::Proof,
    places: &[[f64; 4]],
    tets: &[Tet; 4],
    corner: usize,
    from: &[W; 4],
) -> [W; 3] {
    let to = corners::<W>(proof, places, tets, corner);
    let [x, y, z, _] = W::columns(four(
        #[inline(always)]
        |i| to[i].minus(from[i]),
    ));
    [x, y, z]
}

/// The numbers from which the sums at the knots are made, for some tetrahedra, or for one at some
/// steps; [`Pieces`] names them.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct PiecesOf {
    numbers: [[f64; 8]; 11],
    /// The volumes.
    pub(super) volume: [f64; 8],
    /// The number of knots at or below the least value, in the last byte.
    below: [f64; 8],
    /// The tetrahedra without a knot in their range, bit by bit; those with more than [`KNOTS`].
    pub(super) flat: u32,
    pub(super) steep: u32,
}

/// So large that the last bits of a number a little larger are those of an integer.
const WHOLE: f64 = (1u64 << 52) as f64;

/// Where knots lie, of a step in each lane: what takes a value to steps between knots, and a
/// multiple to a number whose last byte is that of the knots below it.
#[derive(Clone, Copy)]
pub(super) struct Ladder<W> {
    step: W,
    scale: W,
    first: W,
}

impl<W: Floats<8>> Ladder<W> {
    /// The ladder of some designs; a lane without a step has none.
    #[inline(always)]
    pub(super) fn new(proof: W::Proof, designs: [Option<&Design>; 8]) -> Self {
        let of = |f: fn(&Design) -> f64, none| W::of(proof, &designs.map(|design| design.map_or(none, f)));
        Self {
            step: of(|design| design.knots.step.size(), 1.0),
            scale: of(|design| 1.0 / design.knots.step.size(), 0.0),
            first: of(|design| WHOLE + 1.0 - design.knots.first as f64, WHOLE),
        }
    }
}

impl PiecesOf {
    pub(super) const NONE: Self =
        Self { numbers: [[0.0; 8]; 11], volume: [0.0; 8], below: [0.0; 8], flat: 0, steep: 0 };

    /// The largest value.
    #[inline(always)]
    pub(super) fn most(&self, lane: usize) -> f64 {
        self.numbers[2][lane]
    }

    /// How many knots are at or below the least value.
    #[inline(always)]
    pub(super) fn below(&self, lane: usize) -> u8 {
        self.below[lane].to_bits() as u8
    }
}

impl<W: Floats<8>> Shape<W> {
    /// The pieces of tetrahedra with these corner values, void ones bit by bit.
    #[inline(always)]
    pub(super) fn pieces(
        &self,
        proof: W::Proof,
        ladder: &Ladder<W>,
        values: [W; 4],
        void: u32,
        out: &mut PiecesOf,
    ) {
        let [a, b, c, d] = values;
        let d = [b.minus(a), c.minus(a), d.minus(a)];
        // Six times the volume times the gradient.
        let gradient = three(
            #[inline(always)]
            |k| dot(d, [self.normals[0][k], self.normals[1][k], self.normals[2][k]]),
        );
        let length = dot(gradient, gradient).root();
        let area = length.times(W::splat(proof, 0.5));
        let slope = area.times(length.times(self.inverse));
        let [f0, f1, f2, f3] = sorted(values);
        let multiple = f0.times(ladder.scale).floor();
        out.below = multiple.plus(ladder.first).lanes();
        let v = multiple.plus(W::splat(proof, 1.0)).times(ladder.step);
        let up = f3.minus(v);
        out.flat = W::bits(up.below(W::splat(proof, 0.0))) | void;
        out.steep = !W::bits(up.below(ladder.step.times(W::splat(proof, KNOTS as f64))));
        if void != 0 {
            for (lane, below) in out.below.iter_mut().enumerate() {
                *below = if void >> lane & 1 == 0 { *below } else { WHOLE + f64::from(VOID) };
            }
        }
        let least = W::splat(proof, LEAST);
        let (d01, d02, d03) = (f1.minus(f0).max(least), f2.minus(f0).max(least), f3.minus(f0).max(least));
        let (d12, d13, d23) = (f2.minus(f1).max(least), f3.minus(f1).max(least), f3.minus(f2).max(least));
        let (outer, low, high) = (d01.times(d23), d02.times(d03), d12.times(d13));
        let inner = low.times(high);
        let all = W::splat(proof, 1.0).over(outer.times(inner));
        let (of_outer, of_inner) = (all.times(inner), all.times(outer));
        let (of_low, of_high) = (of_inner.times(high), of_inner.times(low));
        // One over the difference of f0 and f3.
        let steep = of_low.times(d02);
        // One by one: an array of all would be made elsewhere, and copied.
        let to = &mut out.numbers;
        to[0] = f0.lanes();
        to[1] = f1.lanes();
        to[2] = f3.lanes();
        // A little more, lest a clamp miss 1 for rounding: what is 0 above f3 is so exactly.
        let more = W::splat(proof, 1.0 + 8.0 * f64::EPSILON);
        to[3] = of_outer.times(d23).times(more).lanes();
        to[4] = of_low.times(d03).lanes();
        to[5] = steep.lanes();
        to[6] = of_high.times(d13).times(more).lanes();
        to[7] = of_high.times(d12).lanes();
        to[8] = of_outer.times(d01).lanes();
        to[9] = area.times(steep).lanes();
        to[10] = slope.times(steep).lanes();
        out.volume = self.six.times(W::splat(proof, 1.0 / 6.0)).lanes();
    }
}

/// The least difference of two `f32`.
const LEAST: f64 = f64::from_bits((1023 - 149) << 52);

#[inline(always)]
fn cross<W: Wide>(u: [W; 3], v: [W; 3]) -> [W; 3] {
    let ([ux, uy, uz], [vx, vy, vz]) = (u, v);
    [uy.times(vz).minus(uz.times(vy)), uz.times(vx).minus(ux.times(vz)), ux.times(vy).minus(uy.times(vx))]
}

#[inline(always)]
fn dot<W: Wide>(u: [W; 3], v: [W; 3]) -> W {
    u[2].times_plus(v[2], u[1].times_plus(v[1], u[0].times(v[0])))
}

/// Sums at some knots that follow each other.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
pub(super) struct Cut {
    pub(super) area: [f64; KNOTS],
    /// Volume inside.
    pub(super) inside: [f64; KNOTS],
    /// Gradient times area.
    pub(super) slope: [f64; KNOTS],
}

/// The numbers of a tetrahedron from which the sums are made, in all lanes.
pub(super) struct Pieces<W> {
    f0: W,
    f1: W,
    f3: W,
    d01: W,
    d02: W,
    d03: W,
    d12: W,
    d13: W,
    d23: W,
    /// The density times the volume times the gradient; that times the gradient.
    area: W,
    slope: W,
}

impl<W: Wide> Pieces<W> {
    /// The pieces of one of them.
    #[inline(always)]
    pub(super) fn new(proof: W::Proof, of: &PiecesOf, lane: usize) -> Self {
        let [f0, f1, f3, d01, d02, d03, d12, d13, d23, area, slope] = &of.numbers;
        Self {
            f0: W::splat(proof, f0[lane]),
            f1: W::splat(proof, f1[lane]),
            f3: W::splat(proof, f3[lane]),
            d01: W::splat(proof, d01[lane]),
            d02: W::splat(proof, d02[lane]),
            d03: W::splat(proof, d03[lane]),
            d12: W::splat(proof, d12[lane]),
            d13: W::splat(proof, d13[lane]),
            d23: W::splat(proof, d23[lane]),
            area: W::splat(proof, area[lane]),
            slope: W::splat(proof, slope[lane]),
        }
    }

    /// Adds the contribution of the tetrahedron, of this volume and largest value, at some knots;
    /// the first of them is above its least value. At knots outside its range the contribution is
    /// 0.
    #[inline(always)]
    pub(super) fn add(&self, proof: W::Proof, volume: f64, most: f64, knots: &[f64; KNOTS], sums: &mut Cut) {
        let wide: &[W::Lanes] = bytemuck::cast_slice(knots);
        let area: &mut [W::Lanes] = bytemuck::cast_slice_mut(&mut sums.area);
        let inside: &mut [W::Lanes] = bytemuck::cast_slice_mut(&mut sums.inside);
        let slope: &mut [W::Lanes] = bytemuck::cast_slice_mut(&mut sums.slope);
        let (volume, lanes) = (W::splat(proof, volume), KNOTS / wide.len());
        for (n, wide) in wide.iter().enumerate() {
            if n > 0 && knots[n * lanes] > most {
                break;
            }
            let (density, above) = self.at(proof, W::of(proof, wide));
            area[n] = self.area.times_plus(density, W::of(proof, &area[n])).lanes();
            inside[n] = volume.times_plus(above, W::of(proof, &inside[n])).lanes();
            slope[n] = self.slope.times_plus(density, W::of(proof, &slope[n])).lanes();
        }
    }

    /// See the module: w, and the share of the volume above, at an isovalue.
    #[inline(always)]
    fn at(&self, proof: W::Proof, v: W) -> (W, W) {
        let (zero, one) = (W::splat(proof, 0.0), W::splat(proof, 1.0));
        let (t, s) = (v.minus(self.f0), self.f3.minus(v));
        let a = t.times(self.d01).min(one);
        let b = v.minus(self.f1).times(self.d12).max(zero).min(one);
        let right = s.times(self.d13).times(s.times(self.d23).max(zero).min(b));
        let w = t.times(self.d02).times_plus(a.minus(b), right);
        (w, one.minus(b).plus(right).minus(t.times(self.d03).times(w)))
    }
}
