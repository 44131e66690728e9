//! The four weights of a tetrahedron as integer functions of the position.

use crate::mesh::tet::Tet;
use isospan_io::geom::LatticePos;

/// The integers that weights are computed in. A trait, because one width is fast and the other
/// always suffices.
pub(super) trait Int: Copy + Ord {
    const ZERO: Self;
    const ONE: Self;
    fn of(x: i32) -> Self;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    fn float(self) -> f64;
}

macro_rules! int {
    ($t:ty) => {
        // Wrapping: sums of what is inside the range may leave it on the way.
        impl Int for $t {
            const ZERO: Self = 0;
            const ONE: Self = 1;
            #[inline(always)]
            fn of(x: i32) -> Self {
                x.into()
            }
            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self.wrapping_add(other)
            }
            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                self.wrapping_sub(other)
            }
            #[inline(always)]
            fn times(self, other: Self) -> Self {
                self.wrapping_mul(other)
            }
            #[inline(always)]
            fn float(self) -> f64 {
                self as f64
            }
        }
    };
}
int!(i64);
int!(i128);

/// The longest edge of a bounding box for which 64 bits suffice: λ is a sum of three products of a
/// length and a component of a cross product (at most 2·m²), so at most 6·m³ < 2^63.
pub(super) const LONGEST_64: u32 = 1 << 20;

/// The least and the greatest coordinates of a tetrahedron's corners, and a 0.
#[inline(always)]
pub fn corner_box(positions: &[LatticePos], tet: &Tet) -> ([u32; 4], [u32; 4]) {
    let corner = |k: usize| {
        let [x, y, z] = positions[tet[k] as usize];
        [x, y, z, 0]
    };
    let (a, b, c, d) = (corner(0), corner(1), corner(2), corner(3));
    (lesser(lesser(a, b), lesser(c, d)), greater(greater(a, b), greater(c, d)))
}

/// The lesser of each coordinate; four are a vector.
#[inline(always)]
pub fn lesser(a: [u32; 4], b: [u32; 4]) -> [u32; 4] {
    [0, 1, 2, 3].map(|k| a[k].min(b[k]))
}

/// The greater of each coordinate.
#[inline(always)]
pub fn greater(a: [u32; 4], b: [u32; 4]) -> [u32; 4] {
    [0, 1, 2, 3].map(|k| a[k].max(b[k]))
}

/// A tetrahedron's bounding box, both ends included.
#[inline]
pub(super) fn bounds(corners: &[LatticePos; 4]) -> (LatticePos, LatticePos) {
    let [a, b, c, d] = corners;
    (
        std::array::from_fn(|k| a[k].min(b[k]).min(c[k].min(d[k]))),
        std::array::from_fn(|k| a[k].max(b[k]).max(c[k].max(d[k]))),
    )
}

/// λ of each corner: `gradient[k] · (p - origin) + constant[k]`.
pub(super) struct Planes<I> {
    pub(super) gradient: [[I; 3]; 4],
    /// Six times the volume; the constant of corner 0, that of the others is 0.
    pub(super) volume: I,
    pub(super) origin: LatticePos,
}

#[inline(always)]
fn difference<I: Int>(p: LatticePos, q: LatticePos) -> [I; 3] {
    // Lattice coordinates have at most 25 bits.
    std::array::from_fn(|k| I::of(p[k] as i32 - q[k] as i32))
}

#[inline(always)]
fn cross<I: Int>(u: [I; 3], v: [I; 3]) -> [I; 3] {
    let minor = |i: usize, j: usize| u[i].times(v[j]).minus(u[j].times(v[i]));
    [minor(1, 2), minor(2, 0), minor(0, 1)]
}

#[inline(always)]
fn dot<I: Int>(u: [I; 3], v: [I; 3]) -> I {
    u[0].times(v[0]).plus(u[1].times(v[1])).plus(u[2].times(v[2]))
}

impl<I: Int> Planes<I> {
    /// The planes of a positively oriented tetrahedron.
    #[inline(always)]
    pub(super) fn new([a, b, c, d]: [LatticePos; 4]) -> Self {
        let (ab, ac, ad) = (difference::<I>(b, a), difference(c, a), difference(d, a));
        let (gb, gc, gd) = (cross(ac, ad), cross(ad, ab), cross(ab, ac));
        let ga = std::array::from_fn(|k| I::ZERO.minus(gb[k].plus(gc[k]).plus(gd[k])));
        Self { gradient: [ga, gb, gc, gd], volume: dot(ab, gb), origin: a }
    }

    /// The four λ at a position.
    #[inline(always)]
    pub(super) fn at(&self, p: LatticePos) -> [I; 4] {
        let r = difference(p, self.origin);
        let [_, gb, gc, gd] = self.gradient;
        let (b, c, d) = (dot(gb, r), dot(gc, r), dot(gd, r));
        [self.volume.minus(b.plus(c).plus(d)), b, c, d]
    }

    /// For each λ, what added to it makes 0 negative where the tie rule says "outside": 0 or -1.
    fn bias(&self, toward_lower: [bool; 3]) -> [I; 4] {
        self.gradient.map(|g| {
            let first = (0..3).find(|&k| g[k] != I::ZERO);
            // The gradient of a λ is never 0: the volume is not.
            let positive = first.is_some_and(|k| (g[k] > I::ZERO) != toward_lower[k]);
            if positive { I::ZERO } else { I::ZERO.minus(I::ONE) }
        })
    }

    /// Whether a position with these λ is inside by the tie rule. `far` is the largest position of
    /// the domain.
    #[inline(always)]
    pub(super) fn has(&self, lambda: [I; 4], p: LatticePos, far: LatticePos) -> bool {
        let least = lambda[0].min(lambda[1]).min(lambda[2].min(lambda[3]));
        least > I::ZERO || (least == I::ZERO && self.wins_tie(lambda, p, far))
    }

    #[inline(never)]
    fn wins_tie(&self, lambda: [I; 4], p: LatticePos, far: LatticePos) -> bool {
        let bias = self.bias(std::array::from_fn(|k| p[k] == far[k]));
        (0..4).all(|k| lambda[k].plus(bias[k]) >= I::ZERO)
    }

    /// Weights of a position, if it is inside by the tie rule.
    pub(super) fn weights(&self, p: LatticePos, far: LatticePos) -> Option<[f64; 4]> {
        let lambda = self.at(p);
        if !self.has(lambda, p, far) {
            return None;
        }
        let unit = 1.0 / self.volume.float();
        Some(lambda.map(|l| l.float() * unit))
    }
}
