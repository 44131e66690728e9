//! The arithmetic of a surface, four tetrahedra or edges at a time: vectors where the machine has
//! them, and the same bits elsewhere.
//!
//! The formulas are those of [`super::marching_tets`]; each is evaluated in one order.

use crate::exec::lanes::Four;
use crate::surface::world_map::WorldMap;

/// A corner: its position in lattice steps, at most 2^24, and so exact, and its value.
pub(super) type Corner = [f32; 4];

/// 6 V ∇f of a tetrahedron, and the largest component of that, in size; infinite or NaN if one of
/// them is.
pub(super) type Gradient = [f64; 4];

// Nothing here is a closure, nor calls one: what the compiler does not inline is not compiled for
// vectors.

/// The gradients of four tetrahedra, V > 0, whose corners are sorted; `signs` is -1 where that is
/// an odd order. Differences and cross products of lattice positions are exact; the rest is
/// rounded.
#[inline(always)]
pub(super) fn gradients<W: Four>(
    proof: W::Proof,
    tets: [[&Corner; 4]; 4],
    signs: &[f64; 4],
) -> [Gradient; 4] {
    let [p, q, r, s] = tets;
    let (a, b, c) = (
        edges::<W>(proof, [[p[0], p[1]], [q[0], q[1]], [r[0], r[1]], [s[0], s[1]]]),
        edges::<W>(proof, [[p[0], p[2]], [q[0], q[2]], [r[0], r[2]], [s[0], s[2]]]),
        edges::<W>(proof, [[p[0], p[3]], [q[0], q[3]], [r[0], r[3]], [s[0], s[3]]]),
    );
    let (n1, n2, n3) = (cross(b, c), cross(c, a), cross(a, b));
    let sign = W::of(proof, signs);
    let mut along = [sign; 3];
    for k in 0..3 {
        let sum = a[3].times(n1[k]).plus(b[3].times(n2[k])).plus(c[3].times(n3[k]));
        along[k] = sign.times(sum);
    }
    let [x, y, z] = sizes(proof, along);
    // Nothing is added but where a component is infinite or NaN.
    let largest = largest([x, y, z]).plus(x.plus(y).plus(z).times(W::splat(proof, 0.0)));
    let [a, b, c, d] = W::columns([along[0], along[1], along[2], largest]);
    [a.lanes(), b.lanes(), c.lanes(), d.lanes()]
}

/// From the first to the second end of four edges, as columns.
#[inline(always)]
fn edges<W: Four>(proof: W::Proof, [a, b, c, d]: [[&Corner; 2]; 4]) -> [W; 4] {
    W::columns([
        W::of_floats(proof, a[1]).minus(W::of_floats(proof, a[0])),
        W::of_floats(proof, b[1]).minus(W::of_floats(proof, b[0])),
        W::of_floats(proof, c[1]).minus(W::of_floats(proof, c[0])),
        W::of_floats(proof, d[1]).minus(W::of_floats(proof, d[0])),
    ])
}

#[inline(always)]
fn cross<W: Four>(a: [W; 4], b: [W; 4]) -> [W; 3] {
    [
        a[1].times(b[2]).minus(a[2].times(b[1])),
        a[2].times(b[0]).minus(a[0].times(b[2])),
        a[0].times(b[1]).minus(a[1].times(b[0])),
    ]
}

#[inline(always)]
fn sizes<W: Four>(proof: W::Proof, [x, y, z]: [W; 3]) -> [W; 3] {
    let zero = W::splat(proof, 0.0);
    [x.max(zero.minus(x)), y.max(zero.minus(y)), z.max(zero.minus(z))]
}

#[inline(always)]
fn largest<W: Four>([x, y, z]: [W; 3]) -> W {
    x.max(y).max(z)
}

/// The powers of two that take |df| |b - a|² of edges to 2^28 … 2^29 (exactly so: only the
/// exponents' bits are looked at).
#[inline(always)]
pub(super) fn units<W: Four>(proof: W::Proof, ends: [[&Corner; 2]; 4]) -> [f64; 4] {
    let d = edges::<W>(proof, ends);
    let length2 = d[0].times(d[0]).plus(d[1].times(d[1])).plus(d[2].times(d[2]));
    let mut units = d[3].times(length2).lanes();
    for unit in &mut units {
        // The product of an f32 difference (2^-149 … 2^129, or infinite) and a squared length (up
        // to 2^50) is a normal number or infinite, so the exponent below is that of a normal
        // number.
        let exponent = unit.to_bits() << 1 >> 53;
        *unit = f64::from_bits((2 * 1023 + 28 - exponent) << 52);
    }
    units
}

/// Where the surface crosses edges, in the world.
#[inline(always)]
pub(super) fn crossings<W: Four>(
    proof: W::Proof,
    ends: [[&Corner; 2]; 4],
    isovalue: f32,
    world: &WorldMap,
) -> [[f32; 3]; 4] {
    let [a, b, c, d] = ends;
    let p = W::columns([
        W::of_floats(proof, a[0]),
        W::of_floats(proof, b[0]),
        W::of_floats(proof, c[0]),
        W::of_floats(proof, d[0]),
    ]);
    let edge = edges::<W>(proof, ends);
    let t = parameter(proof, W::splat(proof, f64::from(isovalue)).minus(p[3]).over(edge[3]));
    let mut index = [t; 3];
    for k in 0..3 {
        index[k] = p[k].plus(t.times(edge[k])).times(W::splat(proof, world.steps[k]));
    }
    let mut positions = [[0.0; 3]; 4];
    for (k, &origin) in world.geometry.origin.iter().enumerate() {
        let x = W::splat(proof, world.axes[0][k]).times(index[0]);
        let y = W::splat(proof, world.axes[1][k]).times(index[1]);
        let z = W::splat(proof, world.axes[2][k]).times(index[2]);
        let column = x.plus(y).plus(z).plus(W::splat(proof, origin)).floats();
        for (position, x) in positions.iter_mut().zip(column) {
            position[k] = x;
        }
    }
    positions
}

/// The part of an edge at which the surface crosses it, not too close to its ends.
#[inline(always)]
fn parameter<W: Four>(proof: W::Proof, t: W) -> W {
    const LEAST: f64 = 1.0 / 1024.0;
    let (least, most) = (W::splat(proof, LEAST), W::splat(proof, 1.0 - LEAST));
    // Two infinities leave no number; the middle is as good as any point.
    let t = W::pick(t.is_number(), t, W::splat(proof, 0.5));
    most.min(least.max(t))
}

/// The unit world vectors of minus four lattice covectors; `None` of those that have no direction.
#[inline(always)]
pub(super) fn normals<W: Four>(
    proof: W::Proof,
    gradients: &[[i64; 3]; 4],
    world: &WorldMap,
) -> [Option<[f32; 3]>; 4] {
    let mut g = [[0.0; 4]; 3];
    for k in 0..3 {
        for v in 0..4 {
            g[k][v] = gradients[v][k] as f64;
        }
    }
    let [g0, g1, g2] = [W::of(proof, &g[0]), W::of(proof, &g[1]), W::of(proof, &g[2])];
    let c = &world.covectors;
    let mut along = [g0; 3];
    for k in 0..3 {
        let x = g0.times(W::splat(proof, c[0][k]));
        let y = g1.times(W::splat(proof, c[1][k]));
        let z = g2.times(W::splat(proof, c[2][k]));
        along[k] = x.plus(y).plus(z).times(W::splat(proof, -1.0));
    }
    let largest = largest(sizes(proof, along)).lanes();
    let mut scale = largest;
    for x in &mut scale {
        *x = WorldMap::scale_of(*x);
    }
    let scale = W::of(proof, &scale);
    let [x, y, z] = [along[0].times(scale), along[1].times(scale), along[2].times(scale)];
    let inverse = W::splat(proof, 1.0).over(x.times(x).plus(y.times(y)).plus(z.times(z)).root());
    let [x, y, z] = [x.times(inverse).floats(), y.times(inverse).floats(), z.times(inverse).floats()];
    let mut normals = [None; 4];
    for v in 0..4 {
        if WorldMap::has_direction(largest[v]) {
            normals[v] = Some([x[v], y[v], z[v]]);
        }
    }
    normals
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;
    use crate::exec::Avx2;
    use crate::exec::lanes::Plain;
    use crate::geom::Lattice;
    use crate::surface::testing::mirrored;
    use proptest::prelude::*;

    fn corner() -> impl Strategy<Value = Corner> {
        let value = prop_oneof![8 => -2.0f32..2.0, 1 => Just(f32::INFINITY), 1 => Just(f32::MIN), 1 => Just(1e-44f32)];
        (prop::array::uniform3(0u32..1 << 24), value)
            .prop_map(|(p, v)| [p[0] as f32, p[1] as f32, p[2] as f32, v])
    }

    fn bits<const N: usize>(all: [[f64; N]; 4]) -> [[Option<u64>; N]; 4] {
        all.map(|row| row.map(|x| (!x.is_nan()).then_some(x.to_bits())))
    }

    proptest! {
        #[test]
        fn vectors_and_plain_code_give_the_same_bits(
            corners in prop::array::uniform16(corner()),
            sums in prop::array::uniform4(prop::array::uniform3(-(1i64 << 50)..1 << 50)),
        ) {
            if let Some(proof) = Avx2::found() {
                use crate::exec::lanes::Vector;
                let world = WorldMap::new(&Lattice::new([9, 9, 9]).unwrap(), &mirrored());
                let tets: [[&Corner; 4]; 4] = std::array::from_fn(|t| std::array::from_fn(|i| &corners[4 * t + i]));
                let edges = tets.map(|t| [t[0], t[1]]);
                let signs = [1.0, -1.0, 1.0, -1.0];
                prop_assert_eq!(
                    bits(gradients::<Vector>(proof, tets, &signs)),
                    bits(gradients::<Plain>((), tets, &signs))
                );
                prop_assert_eq!(units::<Vector>(proof, edges), units::<Plain>((), edges));
                prop_assert_eq!(
                    crossings::<Vector>(proof, edges, 0.1, &world),
                    crossings::<Plain>((), edges, 0.1, &world)
                );
                let here = normals::<Plain>((), &sums, &world);
                prop_assert_eq!(normals::<Vector>(proof, &sums, &world), here);
                let one_by_one = sums.map(|g| world.unit_normal(g.map(|x| x as f64)));
                prop_assert_eq!(one_by_one, here);
            }
        }
    }
}
