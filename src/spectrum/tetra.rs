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

use super::design::{Design, VOID};
use isospan_io::geom::vec3::cross;
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::simd::{F64s, F64x4s, F64xN, four, sorted, three};

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
pub(super) struct TetShape<W> {
    normals: [[W; 3]; 3],
    six: W,
    inverse: W,
}

impl Shapes {
    /// Computes them for at most [`BATCH`] tetrahedra.
    #[inline(always)]
    pub(super) fn look<W: F64x4s>(&mut self, token: W::Token, places: &[[f64; 4]], tets: &[Tet]) {
        let (zero, one) = (W::splat(token, 0.0), W::splat(token, 1.0));
        for (n, four) in tets.chunks(4).enumerate() {
            // With fewer than four, the last one is repeated.
            let four = [0, 1, 2, 3].map(|k| four[k.min(four.len() - 1)]);
            let a = corners::<W>(token, places, &four, 0);
            let b = edge(token, places, &four, 1, &a);
            let c = edge(token, places, &four, 2, &a);
            let d = edge(token, places, &four, 3, &a);
            let six = dot(b, cross(c, d));
            let six = six.max(zero - six);
            self.put(0, n, cross(c, d));
            self.put(1, n, cross(d, b));
            self.put(2, n, cross(b, c));
            self.six[n] = six.to_array();
            self.inverse[n] = W::select(zero.lt(six), one / six, zero).to_array();
        }
    }

    #[inline(always)]
    fn put<W: F64x4s>(&mut self, normal: usize, n: usize, [x, y, z]: [W; 3]) {
        let [to_x, to_y, to_z] = &mut self.normals[normal];
        (to_x[n], to_y[n], to_z[n]) = (x.to_array(), y.to_array(), z.to_array());
    }

    /// The n-th eight.
    #[inline(always)]
    pub(super) fn eight<W: F64xN<8>>(&self, token: W::Token, n: usize) -> TetShape<W> {
        self.map(
            #[inline(always)]
            |column| W::load(token, &column.as_flattened()[8 * n..]),
        )
    }

    /// The i-th, in all lanes.
    #[inline(always)]
    pub(super) fn one<W: F64s>(&self, token: W::Token, i: usize) -> TetShape<W> {
        self.map(
            #[inline(always)]
            |column| W::splat(token, column[i / 4][i % 4]),
        )
    }

    #[inline(always)]
    fn map<W: F64s>(&self, of: impl Fn(&Column) -> W) -> TetShape<W> {
        let [[a, b, c], [d, e, f], [g, h, i]] = &self.normals;
        TetShape {
            normals: [[of(a), of(b), of(c)], [of(d), of(e), of(f)], [of(g), of(h), of(i)]],
            six: of(&self.six),
            inverse: of(&self.inverse),
        }
    }
}

/// A corner of each of four tetrahedra.
#[inline(always)]
fn corners<W: F64x4s>(token: W::Token, places: &[[f64; 4]], tets: &[Tet; 4], corner: usize) -> [W; 4] {
    four(
        #[inline(always)]
        |i| W::load(token, &places[tets[i][corner] as usize]),
    )
}

/// From corner a to another one.
#[inline(always)]
fn edge<W: F64x4s>(
    token: W::Token,
    places: &[[f64; 4]],
    tets: &[Tet; 4],
    corner: usize,
    from: &[W; 4],
) -> [W; 3] {
    let to = corners::<W>(token, places, tets, corner);
    let [x, y, z, _] = W::transpose(four(
        #[inline(always)]
        |i| to[i] - from[i],
    ));
    [x, y, z]
}

/// The numbers from which the sums at the knots are made, for some tetrahedra, or for one at some
/// steps; [`KnotPieces`] names them.
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

impl<W: F64xN<8>> Ladder<W> {
    /// The ladder of some designs; a lane without a step has none.
    #[inline(always)]
    pub(super) fn new(token: W::Token, designs: [Option<&Design>; 8]) -> Self {
        let of = |f: fn(&Design) -> f64, none| W::load(token, &designs.map(|design| design.map_or(none, f)));
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

impl<W: F64xN<8>> TetShape<W> {
    /// The pieces of tetrahedra with these corner values, void ones bit by bit.
    #[inline(always)]
    pub(super) fn pieces(
        &self,
        token: W::Token,
        ladder: &Ladder<W>,
        values: [W; 4],
        void: u32,
        out: &mut PiecesOf,
    ) {
        let [a, b, c, d] = values;
        let d = [b - a, c - a, d - a];
        // Six times the volume times the gradient.
        let gradient = three(
            #[inline(always)]
            |k| dot(d, [self.normals[0][k], self.normals[1][k], self.normals[2][k]]),
        );
        let length = dot(gradient, gradient).sqrt();
        let area = length * W::splat(token, 0.5);
        let slope = area * (length * self.inverse);
        let [f0, f1, f2, f3] = sorted(values);
        let multiple = (f0 * ladder.scale).floor();
        out.below = (multiple + ladder.first).to_array();
        let v = (multiple + W::splat(token, 1.0)) * ladder.step;
        let up = f3 - v;
        out.flat = W::bitmask(up.lt(W::splat(token, 0.0))) | void;
        out.steep = !W::bitmask(up.lt(ladder.step * W::splat(token, KNOTS as f64)));
        if void != 0 {
            for (lane, below) in out.below.iter_mut().enumerate() {
                *below = if void >> lane & 1 == 0 { *below } else { WHOLE + f64::from(VOID) };
            }
        }
        let least = W::splat(token, LEAST);
        let (d01, d02, d03) = ((f1 - f0).max(least), (f2 - f0).max(least), (f3 - f0).max(least));
        let (d12, d13, d23) = ((f2 - f1).max(least), (f3 - f1).max(least), (f3 - f2).max(least));
        let (outer, low, high) = (d01 * d23, d02 * d03, d12 * d13);
        let inner = low * high;
        let all = W::splat(token, 1.0) / (outer * inner);
        let (of_outer, of_inner) = (all * inner, all * outer);
        let (of_low, of_high) = (of_inner * high, of_inner * low);
        // One over the difference of f0 and f3.
        let steep = of_low * d02;
        // One by one: an array of all would be made elsewhere, and copied.
        let to = &mut out.numbers;
        to[0] = f0.to_array();
        to[1] = f1.to_array();
        to[2] = f3.to_array();
        // A little more, lest a clamp miss 1 for rounding: what is 0 above f3 is so exactly.
        let more = W::splat(token, 1.0 + 8.0 * f64::EPSILON);
        to[3] = (of_outer * d23 * more).to_array();
        to[4] = (of_low * d03).to_array();
        to[5] = steep.to_array();
        to[6] = (of_high * d13 * more).to_array();
        to[7] = (of_high * d12).to_array();
        to[8] = (of_outer * d01).to_array();
        to[9] = (area * steep).to_array();
        to[10] = (slope * steep).to_array();
        out.volume = (self.six * W::splat(token, 1.0 / 6.0)).to_array();
    }
}

/// The least difference of two `f32`.
const LEAST: f64 = f64::from_bits((1023 - 149) << 52);

#[inline(always)]
fn dot<W: F64s>(u: [W; 3], v: [W; 3]) -> W {
    u[2].mul_add(v[2], u[1].mul_add(v[1], u[0] * v[0]))
}

/// Sums at some knots that follow each other.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
pub(super) struct KnotSums {
    pub(super) area: [f64; KNOTS],
    /// Volume inside.
    pub(super) inside: [f64; KNOTS],
    /// Gradient times area.
    pub(super) slope: [f64; KNOTS],
}

/// The numbers of a tetrahedron from which the sums are made, in all lanes.
pub(super) struct KnotPieces<W> {
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

impl<W: F64s> KnotPieces<W> {
    /// The pieces of one of them.
    #[inline(always)]
    pub(super) fn new(token: W::Token, of: &PiecesOf, lane: usize) -> Self {
        let [f0, f1, f3, d01, d02, d03, d12, d13, d23, area, slope] = &of.numbers;
        Self {
            f0: W::splat(token, f0[lane]),
            f1: W::splat(token, f1[lane]),
            f3: W::splat(token, f3[lane]),
            d01: W::splat(token, d01[lane]),
            d02: W::splat(token, d02[lane]),
            d03: W::splat(token, d03[lane]),
            d12: W::splat(token, d12[lane]),
            d13: W::splat(token, d13[lane]),
            d23: W::splat(token, d23[lane]),
            area: W::splat(token, area[lane]),
            slope: W::splat(token, slope[lane]),
        }
    }

    /// Adds the contribution of the tetrahedron, of this volume and largest value, at some knots;
    /// the first of them is above its least value. At knots outside its range the contribution is
    /// 0.
    #[inline(always)]
    pub(super) fn add(
        &self,
        token: W::Token,
        volume: f64,
        most: f64,
        knots: &[f64; KNOTS],
        sums: &mut KnotSums,
    ) {
        let wide: &[W::Array] = bytemuck::cast_slice(knots);
        let area: &mut [W::Array] = bytemuck::cast_slice_mut(&mut sums.area);
        let inside: &mut [W::Array] = bytemuck::cast_slice_mut(&mut sums.inside);
        let slope: &mut [W::Array] = bytemuck::cast_slice_mut(&mut sums.slope);
        let (volume, lanes) = (W::splat(token, volume), KNOTS / wide.len());
        for (n, wide) in wide.iter().enumerate() {
            if n > 0 && knots[n * lanes] > most {
                break;
            }
            let (density, above) = self.at(token, W::load(token, wide.as_ref()));
            area[n] = self.area.mul_add(density, W::load(token, area[n].as_ref())).to_array();
            inside[n] = volume.mul_add(above, W::load(token, inside[n].as_ref())).to_array();
            slope[n] = self.slope.mul_add(density, W::load(token, slope[n].as_ref())).to_array();
        }
    }

    /// See the module: w, and the share of the volume above, at an isovalue.
    #[inline(always)]
    fn at(&self, token: W::Token, v: W) -> (W, W) {
        let (zero, one) = (W::splat(token, 0.0), W::splat(token, 1.0));
        let (t, s) = (v - self.f0, self.f3 - v);
        let a = (t * self.d01).min(one);
        let b = ((v - self.f1) * self.d12).max(zero).min(one);
        let right = s * self.d13 * (s * self.d23).max(zero).min(b);
        let w = (t * self.d02).mul_add(a - b, right);
        (w, one - b + right - t * self.d03 * w)
    }
}
