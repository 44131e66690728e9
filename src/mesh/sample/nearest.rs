//! The nearest voxel: no arithmetic on values at all (thesis, section 3.3.2: subsampling).
//!
//! Half-way between two voxels the higher index is taken, on each axis.

use super::{SampledAxis, VoxelBlock};
use isospan_io::geom::{Lattice, LatticePos};

/// The voxel nearest to a coordinate.
#[inline]
fn voxel(axis: &SampledAxis, p: u32) -> u64 {
    let half = (1 << axis.log2_steps) >> 1;
    u64::from((p + half) >> axis.log2_steps)
}

/// The voxels needed on one axis: that one.
pub(super) fn span(axis: &SampledAxis, p: u32) -> (u64, u64) {
    let i = voxel(axis, p);
    (i, i + 1)
}

/// See [`super::sample`].
pub(super) fn sample(
    lattice: &Lattice,
    block: &VoxelBlock<'_>,
    positions: &[LatticePos],
    out: &mut Vec<f32>,
) {
    let axes = SampledAxis::of(lattice);
    out.extend(positions.iter().map(|p| {
        let ijk = std::array::from_fn(|a| voxel(&axes[a], p[a]));
        block.values[block.voxels.offset(ijk)]
    }));
}
