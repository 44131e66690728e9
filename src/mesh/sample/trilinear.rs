//! Trilinear interpolation: s₁ = a·f_i + b·f_{i+1} along x, then y, then z (thesis, section 3.2.2,
//! weights put right).
//!
//! The form a·f + b·g is used, not f + b·(g - f): it gives f and g exactly at the ends, and, the
//! weights adding up to 1 exactly, no value leaves the range of the corners: the first products (24
//! by 24 bits) are exact and their rounded sum lies between its terms; the rounding errors of the
//! next two levels, some 2^-52, vanish in the rounding to `f32`, since the corners are `f32`
//! themselves.

use super::{SampledAxis, VoxelBlock, to_f32};
use isospan_io::geom::{Lattice, LatticePos};
use isospan_io::grid::IndexBox;

/// The voxels needed on one axis: the two of the cell.
pub(super) fn span(axis: &SampledAxis, p: u32) -> (u64, u64) {
    let i = u64::from(axis.cell(p));
    (i, i + 2)
}

/// Where a position lies among the samples of a box.
#[derive(Clone, Copy)]
pub(super) struct Spot {
    /// The first sample of its cell.
    first: usize,
    /// The fractions; exact, since a coordinate has 24 bits.
    b: [f32; 3],
}

/// Where positions lie among the samples of a box.
#[inline(always)]
pub(super) fn spots<'a>(
    lattice: &Lattice,
    voxels: &IndexBox,
    positions: &'a [LatticePos],
) -> impl ExactSizeIterator<Item = Spot> + use<'a> {
    let (axes, [_, row, layer]) = (SampledAxis::of(lattice), steps(voxels));
    let lo = voxels.lo.map(|l| l as usize);
    positions.iter().map(
        #[inline(always)]
        move |p| {
            let cell: [u32; 3] = std::array::from_fn(|a| axes[a].cell(p[a]));
            let b = std::array::from_fn(|a| axes[a].fraction(p[a], cell[a]) as f32);
            let ijk: [usize; 3] = std::array::from_fn(|a| cell[a] as usize - lo[a]);
            Spot { first: ijk[2] * layer + ijk[1] * row + ijk[0], b }
        },
    )
}

/// Steps along each axis of the samples of a box.
fn steps(voxels: &IndexBox) -> [usize; 3] {
    let d = voxels.dims().map(|n| n as usize);
    [1, d[0], d[0] * d[1]]
}

/// Appends the value at each spot.
#[inline(always)]
pub(super) fn sample(block: &VoxelBlock<'_>, spots: impl ExactSizeIterator<Item = Spot>, out: &mut Vec<f32>) {
    let [_, row, layer] = steps(&block.voxels);
    // From a cell's first voxel to its last, so that one check covers all eight.
    let reach = layer + row + 2;
    out.extend(spots.map(
        #[inline(always)]
        |spot| {
            let v = &block.values[spot.first..spot.first + reach];
            let corners = [
                [[v[0], v[1]], [v[row], v[row + 1]]],
                [[v[layer], v[layer + 1]], [v[layer + row], v[layer + row + 1]]],
            ];
            let b = spot.b.map(f64::from);
            let value = blend(&corners, b);
            if value.is_finite() { to_f32(value) } else { to_f32(blend_present(&corners, b)) }
        },
    ));
}

/// The value of finite corners, indexed `[z][y][x]`.
#[inline(always)]
fn blend(f: &[[[f32; 2]; 2]; 2], b: [f64; 3]) -> f64 {
    let a = b.map(|b| 1.0 - b);
    let x = |e: [f32; 2]| a[0] * f64::from(e[0]) + b[0] * f64::from(e[1]);
    let y = |q: [[f32; 2]; 2]| a[1] * x(q[0]) + b[1] * x(q[1]);
    a[2] * y(f[0]) + b[2] * y(f[1])
}

/// The same where some corner is not finite: corners of weight zero do not count (0 · NaN would be
/// NaN).
#[cold]
fn blend_present(f: &[[[f32; 2]; 2]; 2], b: [f64; 3]) -> f64 {
    let mix = |b: f64, lower: &dyn Fn() -> f64, upper: &dyn Fn() -> f64| match b {
        0.0 => lower(),
        1.0 => upper(),
        _ => (1.0 - b) * lower() + b * upper(),
    };
    let x = |e: [f32; 2]| mix(b[0], &|| f64::from(e[0]), &|| f64::from(e[1]));
    let y = |q: [[f32; 2]; 2]| mix(b[1], &|| x(q[0]), &|| x(q[1]));
    mix(b[2], &|| y(f[0]), &|| y(f[1]))
}
