//! Where the vertices of a chunk lie in the data, and their order by bricks.

use super::groups::Groups;
use crate::domain::wall::OnBoundary;
use crate::pipeline::read::MeshedChunk;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::grid::{BrickGrid, BrickId};
use isospan_mesh::locate::CellHit;

/// Where the vertices of a chunk lie in the data: the same for all steps of a series.
#[derive(Clone, Debug, Default)]
pub(in crate::pipeline) struct Placement {
    /// For a tetrahedral mesh: where each vertex lies, those around the chunk last.
    pub(in crate::pipeline) spots: Vec<Spot>,
    /// For each tetrahedron, those around the chunk last, whether it lies outside of the data;
    /// empty where none does.
    pub(in crate::pipeline) outside: Vec<bool>,
    /// For a volume: which vertices are sampled together.
    pub(super) groups: Groups,
    /// For a mesh that is stored unchanged: which of its vertices each one is.
    pub(super) vertices: Vec<u64>,
}

/// Where a vertex of a chunk lies in a tetrahedral mesh; by default nowhere.
#[derive(Clone, Copy, Debug)]
pub(in crate::pipeline) struct Spot {
    pub(super) at: ValueSource,
    /// The body that it belongs to.
    pub(super) body: u64,
    /// On the boundary: tetrahedra there may be outside.
    pub(super) rim: bool,
}

/// The data that a value in a mesh is made from.
#[derive(Clone, Copy, Debug)]
pub(super) enum ValueSource {
    Nowhere,
    Cell(CellHit),
    Boundary(OnBoundary),
}

/// The body of a point outside of the mesh.
pub(in crate::pipeline) const NO_BODY: u64 = u64::MAX;

impl Default for Spot {
    fn default() -> Self {
        Self { at: ValueSource::Nowhere, body: NO_BODY, rim: false }
    }
}

/// Calls `sample` with the positions of each brick that has some of the chunk's vertices, and puts
/// its answers in the order of the vertices. Core vertices come brick by brick; halo vertices are
/// few and lie in many bricks.
pub(super) fn by_brick<T: Clone + Default>(
    bricks: &BrickGrid,
    mesh: &MeshedChunk,
    mut sample: impl FnMut(BrickId, &[LatticePos], &mut Vec<T>) -> Result<()>,
) -> Result<Vec<T>> {
    let mut out = Vec::with_capacity(mesh.vertices());
    let mut start = 0;
    for &count in &mesh.core_counts {
        let group = &mesh.positions()[start..start + count as usize];
        if let Some(&first) = group.first() {
            sample(bricks.id(bricks.brick_at(first)), group, &mut out)?;
        }
        start += count as usize;
    }
    let halo = in_bricks(bricks, &mesh.positions()[start..], sample)?;
    out.extend(halo);
    Ok(out)
}

/// The numbers of positions with their bricks, in order of bricks.
pub(super) fn brick_order(bricks: &BrickGrid, positions: &[LatticePos]) -> Vec<(BrickId, u32)> {
    let mut order: Vec<(BrickId, u32)> =
        positions.iter().enumerate().map(|(i, &p)| (bricks.id(bricks.brick_at(p)), i as u32)).collect();
    order.sort_unstable();
    order
}

/// As [`by_brick`], of positions in any order.
pub(super) fn in_bricks<T: Clone + Default>(
    bricks: &BrickGrid,
    positions: &[LatticePos],
    mut sample: impl FnMut(BrickId, &[LatticePos], &mut Vec<T>) -> Result<()>,
) -> Result<Vec<T>> {
    let mut out = vec![T::default(); positions.len()];
    let (mut group, mut found) = (vec![], vec![]);
    for run in brick_order(bricks, positions).chunk_by(|a, b| a.0 == b.0) {
        group.clear();
        group.extend(run.iter().map(|&(_, i)| positions[i as usize]));
        found.clear();
        sample(run[0].0, &group, &mut found)?;
        for (&(_, i), value) in run.iter().zip(found.drain(..)) {
            out[i as usize] = value;
        }
    }
    Ok(out)
}
