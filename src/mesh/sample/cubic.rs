//! Tricubic interpolation (thesis, section 3.2.3): along each axis
//!
//! ```text
//!   s₃ = a·y_i + b·y_{i+1} + c·y″_i + d·y″_{i+1},      c = (a³ - a)·h²/6,   d = (b³ - b)·h²/6
//! ```
//!
//! **Corrected** (`cubic`): y″_i = (y_{i+1} - 2y_i + y_{i-1})/h². That difference is exact for
//! cubic polynomials, so the rule is too; and since a cubic through four values is unique, the
//! rule **is** Lagrange's cubic through y_{i-1} … y_{i+2}: fourth order, continuous, with first
//! derivatives that jump at the voxels. Next to a border y″ is extrapolated linearly from the two
//! nearest voxels that have one, y″_0 = 2y″_1 - y″_2, which is Lagrange's cubic through the four
//! voxels nearest the border: cubics stay exact up to it. With 3 voxels on the axis y″ is constant
//! (exact for quadratics), with 2 there is none (linear).
//!
//! **As printed** (`cubic-thesis`): y″_i = (y_{i+2} - 4y_{i+1} + 6y_i - 4y_{i-1} + y_{i-2})/4h², a
//! fourth difference. On a smooth field it is h²y⁗/4, nearly nothing, so the rule is linear
//! interpolation, on noise linear and more noise. Next to a border, the difference of the nearest
//! voxel that has one; with fewer than 5 voxels none.
//!
//! h cancels: differences are taken in voxel units. All weights of an axis are gathered first, one
//! a voxel of the stencil. On a voxel all weights are zero but its own, which is 1.

use super::{SampledAxis, VoxelBlock, to_f32};
use isospan_io::geom::{Lattice, LatticePos};

/// Voxels an axis of the corrected rule.
pub(super) const CUBIC: usize = 4;
/// Voxels an axis of the printed rule.
pub(super) const THESIS: usize = 6;

/// The weights of a point on one axis.
struct Stencil<const N: usize> {
    /// Its first voxel in the volume.
    first: u64,
    /// Voxels of it: `N`, or all that the axis has.
    len: usize,
    /// A weight a voxel; zero beyond `len`.
    weights: [f64; N],
}

/// See [`super::sample`].
pub(super) fn sample(
    lattice: &Lattice,
    block: &VoxelBlock<'_>,
    positions: &[LatticePos],
    out: &mut Vec<f32>,
) {
    let axes = SampledAxis::of(lattice);
    out.extend(positions.iter().map(|p| value(block, std::array::from_fn(|a| corrected(&axes[a], p[a])))));
}

/// See [`super::sample`].
pub(super) fn sample_thesis(
    lattice: &Lattice,
    block: &VoxelBlock<'_>,
    positions: &[LatticePos],
    out: &mut Vec<f32>,
) {
    let axes = SampledAxis::of(lattice);
    out.extend(positions.iter().map(|p| value(block, std::array::from_fn(|a| printed(&axes[a], p[a])))));
}

/// The stencil around a coordinate with the linear weights in it; the cell's place in the stencil;
/// c and d.
#[inline]
fn linear_part<const N: usize>(axis: &SampledAxis, p: u32) -> (Stencil<N>, usize, [f64; 2]) {
    let cell = axis.cell(p);
    let (first, end) = axis.stencil(cell, N);
    let at = (u64::from(cell) - first) as usize;
    let b = axis.fraction(p, cell);
    let a = 1.0 - b;
    let mut weights = [0.0; N];
    weights[at] = a;
    weights[at + 1] = b;
    let cubed_less = |t: f64| (t * t * t - t) / 6.0;
    (Stencil { first, len: (end - first) as usize, weights }, at, [cubed_less(a), cubed_less(b)])
}

/// The rule with second differences.
#[inline]
fn corrected(axis: &SampledAxis, p: u32) -> Stencil<CUBIC> {
    let (mut s, at, [c, d]) = linear_part(axis, p);
    let mut add = |i: usize, w: [f64; 4]| (0..4).for_each(|k| s.weights[k] += [c, d][i] * w[k]);
    match (s.len, at) {
        (4, 1) => {
            add(0, [1.0, -2.0, 1.0, 0.0]);
            add(1, [0.0, 1.0, -2.0, 1.0]);
        }
        // At the lower border y″_0 = 2y″_1 - y″_2, at the upper one its mirror image.
        (4, 0) => {
            add(0, [2.0, -5.0, 4.0, -1.0]);
            add(1, [1.0, -2.0, 1.0, 0.0]);
        }
        (4, _) => {
            add(0, [0.0, 1.0, -2.0, 1.0]);
            add(1, [-1.0, 4.0, -5.0, 2.0]);
        }
        (3, _) => (0..2).for_each(|i| add(i, [1.0, -2.0, 1.0, 0.0])),
        _ => {}
    }
    s
}

/// The rule as printed.
fn printed(axis: &SampledAxis, p: u32) -> Stencil<THESIS> {
    const FOURTH: [f64; 5] = [0.25, -1.0, 1.5, -1.0, 0.25];
    let (mut s, at, cd) = linear_part::<THESIS>(axis, p);
    if s.len >= 5 {
        for (i, t) in cd.into_iter().enumerate() {
            let start = (at + i).clamp(2, s.len - 3) - 2;
            FOURTH.iter().enumerate().for_each(|(k, w)| s.weights[start + k] += t * w);
        }
    }
    s
}

/// The weighted sum: along x, then y, then z.
#[inline]
fn value<const N: usize>(block: &VoxelBlock<'_>, [x, y, z]: [Stencil<N>; 3]) -> f32 {
    let d = block.voxels.dims().map(|n| n as usize);
    let (row, layer) = (d[0], d[0] * d[1]);
    let first = block.voxels.offset([x.first, y.first, z.first]);
    if x.len == N && y.len == N && z.len == N {
        let mut sum = 0.0;
        for k in 0..N {
            let mut in_layer = 0.0;
            for j in 0..N {
                let start = first + k * layer + j * row;
                let v = &block.values[start..start + N];
                let in_row = (0..N).fold(0.0, |s, i| s + x.weights[i] * f64::from(v[i]));
                in_layer += y.weights[j] * in_row;
            }
            sum += z.weights[k] * in_layer;
        }
        if sum.is_finite() {
            return to_f32(sum);
        }
    }
    value_of_present(block, first, [row, layer], [&x, &y, &z])
}

/// The same for thin volumes and where a voxel is not finite: voxels of weight zero do not count.
#[cold]
fn value_of_present<const N: usize>(
    block: &VoxelBlock<'_>,
    first: usize,
    [row, layer]: [usize; 2],
    [x, y, z]: [&Stencil<N>; 3],
) -> f32 {
    let present = |s: &Stencil<N>| (0..s.len).filter(|&k| s.weights[k] != 0.0).collect::<Vec<_>>();
    let (px, py) = (present(x), present(y));
    to_f32(present(z).iter().fold(0.0, |sum, &k| {
        let in_layer = py.iter().fold(0.0, |sum, &j| {
            let start = first + k * layer + j * row;
            let in_row = px.iter().fold(0.0, |s, &i| s + x.weights[i] * f64::from(block.values[start + i]));
            sum + y.weights[j] * in_row
        });
        sum + z.weights[k] * in_layer
    }))
}
