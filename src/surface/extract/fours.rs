//! The arithmetic of a surface, four tetrahedra or edges at a time: vectors where the machine has
//! them, and the same bits elsewhere.
//!
//! The formulas are those of [`super::marching_tets`]; each is evaluated in one order.

use crate::surface::world_map::WorldMap;
use isospan_mesh::simd::F64x4s;

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
pub(super) fn gradients<W: F64x4s>(
    token: W::Token,
    tets: [[&Corner; 4]; 4],
    signs: &[f64; 4],
) -> [Gradient; 4] {
    let [p, q, r, s] = tets;
    let (a, b, c) = (
        edges::<W>(token, [[p[0], p[1]], [q[0], q[1]], [r[0], r[1]], [s[0], s[1]]]),
        edges::<W>(token, [[p[0], p[2]], [q[0], q[2]], [r[0], r[2]], [s[0], s[2]]]),
        edges::<W>(token, [[p[0], p[3]], [q[0], q[3]], [r[0], r[3]], [s[0], s[3]]]),
    );
    let (n1, n2, n3) = (cross(b, c), cross(c, a), cross(a, b));
    let sign = W::load(token, signs);
    let mut along = [sign; 3];
    for k in 0..3 {
        let sum = a[3] * n1[k] + b[3] * n2[k] + c[3] * n3[k];
        along[k] = sign * sum;
    }
    let [x, y, z] = sizes(token, along);
    // Nothing is added but where a component is infinite or NaN.
    let largest = largest([x, y, z]) + (x + y + z) * W::splat(token, 0.0);
    let [a, b, c, d] = W::transpose([along[0], along[1], along[2], largest]);
    [a.to_array(), b.to_array(), c.to_array(), d.to_array()]
}

/// From the first to the second end of four edges, as columns.
#[inline(always)]
fn edges<W: F64x4s>(token: W::Token, [a, b, c, d]: [[&Corner; 2]; 4]) -> [W; 4] {
    W::transpose([
        W::from_f32(token, a[1]) - W::from_f32(token, a[0]),
        W::from_f32(token, b[1]) - W::from_f32(token, b[0]),
        W::from_f32(token, c[1]) - W::from_f32(token, c[0]),
        W::from_f32(token, d[1]) - W::from_f32(token, d[0]),
    ])
}

#[inline(always)]
fn cross<W: F64x4s>(a: [W; 4], b: [W; 4]) -> [W; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
fn sizes<W: F64x4s>(token: W::Token, [x, y, z]: [W; 3]) -> [W; 3] {
    let zero = W::splat(token, 0.0);
    [x.max(zero - x), y.max(zero - y), z.max(zero - z)]
}

#[inline(always)]
fn largest<W: F64x4s>([x, y, z]: [W; 3]) -> W {
    x.max(y).max(z)
}

/// The powers of two that take |df| |b - a|² of edges to 2^28 … 2^29 (exactly so: only the
/// exponents' bits are looked at).
#[inline(always)]
pub(super) fn units<W: F64x4s>(token: W::Token, ends: [[&Corner; 2]; 4]) -> [f64; 4] {
    let d = edges::<W>(token, ends);
    let length2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    let mut units = (d[3] * length2).to_array();
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
pub(super) fn crossings<W: F64x4s>(
    token: W::Token,
    ends: [[&Corner; 2]; 4],
    isovalue: f32,
    world: &WorldMap,
) -> [[f32; 3]; 4] {
    let [a, b, c, d] = ends;
    let p = W::transpose([
        W::from_f32(token, a[0]),
        W::from_f32(token, b[0]),
        W::from_f32(token, c[0]),
        W::from_f32(token, d[0]),
    ]);
    let edge = edges::<W>(token, ends);
    let t = parameter(token, (W::splat(token, f64::from(isovalue)) - p[3]) / edge[3], world.least);
    let mut index = [t; 3];
    for k in 0..3 {
        index[k] = (p[k] + t * edge[k]) * W::splat(token, world.steps[k]);
    }
    let mut positions = [[0.0; 3]; 4];
    for (k, &origin) in world.geometry.origin.iter().enumerate() {
        let x = W::splat(token, world.axes[0][k]) * index[0];
        let y = W::splat(token, world.axes[1][k]) * index[1];
        let z = W::splat(token, world.axes[2][k]) * index[2];
        let column = (x + y + z + W::splat(token, origin)).to_f32();
        for (position, x) in positions.iter_mut().zip(column) {
            position[k] = x;
        }
    }
    positions
}

/// The part of an edge at which the surface crosses it, at least `least` from its ends.
#[inline(always)]
fn parameter<W: F64x4s>(token: W::Token, t: W, least: f64) -> W {
    let (least, most) = (W::splat(token, least), W::splat(token, 1.0 - least));
    // Two infinities leave no number; the middle is as good as any point.
    let t = W::select(t.is_number(), t, W::splat(token, 0.5));
    most.min(least.max(t))
}

/// The unit world vectors of minus four lattice covectors; `None` of those that have no direction.
#[inline(always)]
pub(super) fn normals<W: F64x4s>(
    token: W::Token,
    gradients: &[[i64; 3]; 4],
    world: &WorldMap,
) -> [Option<[f32; 3]>; 4] {
    let mut g = [[0.0; 4]; 3];
    for k in 0..3 {
        for v in 0..4 {
            g[k][v] = gradients[v][k] as f64;
        }
    }
    let [g0, g1, g2] = [W::load(token, &g[0]), W::load(token, &g[1]), W::load(token, &g[2])];
    let c = &world.covectors;
    let mut along = [g0; 3];
    for k in 0..3 {
        let x = g0 * W::splat(token, c[0][k]);
        let y = g1 * W::splat(token, c[1][k]);
        let z = g2 * W::splat(token, c[2][k]);
        along[k] = (x + y + z) * W::splat(token, -1.0);
    }
    let largest = largest(sizes(token, along)).to_array();
    let mut scale = largest;
    for x in &mut scale {
        *x = WorldMap::scale_of(*x);
    }
    let scale = W::load(token, &scale);
    let [x, y, z] = [along[0] * scale, along[1] * scale, along[2] * scale];
    let inverse = W::splat(token, 1.0) / (x * x + y * y + z * z).sqrt();
    let [x, y, z] = [(x * inverse).to_f32(), (y * inverse).to_f32(), (z * inverse).to_f32()];
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
    use crate::surface::testing::mirrored;
    use isospan_io::geom::Lattice;
    use isospan_mesh::simd::{Avx2, F64x4, Plain};
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
            if let Some(token) = Avx2::found() {
                let world = WorldMap::new(&Lattice::new([9, 9, 9]).unwrap(), &mirrored());
                let tets: [[&Corner; 4]; 4] = std::array::from_fn(|t| std::array::from_fn(|i| &corners[4 * t + i]));
                let edges = tets.map(|t| [t[0], t[1]]);
                let signs = [1.0, -1.0, 1.0, -1.0];
                prop_assert_eq!(
                    bits(gradients::<F64x4>(token, tets, &signs)),
                    bits(gradients::<Plain<f64, 4>>((), tets, &signs))
                );
                prop_assert_eq!(units::<F64x4>(token, edges), units::<Plain<f64, 4>>((), edges));
                prop_assert_eq!(
                    crossings::<F64x4>(token, edges, 0.1, &world),
                    crossings::<Plain<f64, 4>>((), edges, 0.1, &world)
                );
                let here = normals::<Plain<f64, 4>>((), &sums, &world);
                prop_assert_eq!(normals::<F64x4>(token, &sums, &world), here);
                let one_by_one = sums.map(|g| world.unit_normal(g.map(|x| x as f64)));
                prop_assert_eq!(one_by_one, here);
            }
        }
    }
}
