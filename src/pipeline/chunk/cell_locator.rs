//! Finds the cells of a tetrahedral mesh that hold points, and so the bodies that these lie in.

use super::placement::{NO_BODY, brick_order};
use crate::domain::buckets::Buckets;
use crate::domain::store::CellStore;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::grid::{BrickGrid, BrickId};
use isospan_mesh::locate::{CellBatch, CellHit, FINE_BITS, FinePos, PointGrid, fine};
use isospan_mesh::mesh::tet::Tet;

/// A mesh, and the cells of each of its bricks.
pub(in crate::pipeline) struct CellLocator<'a> {
    pub(in crate::pipeline) store: &'a CellStore,
    pub(in crate::pipeline) buckets: &'a Buckets,
    pub(in crate::pipeline) bricks: BrickGrid,
}

impl CellLocator<'_> {
    /// The body of the cell found; [`NO_BODY`] of none.
    pub(super) fn body(&self, found: &CellHit) -> Result<u64> {
        if found.id == CellHit::NOWHERE { Ok(NO_BODY) } else { self.store.bodies.of(found.id) }
    }

    /// The cells of the lowest numbers that hold points of a brick.
    pub(super) fn locate(
        &self,
        brick: BrickId,
        points: &[FinePos],
        batch: &mut CellBatch,
    ) -> Result<Vec<CellHit>> {
        let mut found = vec![CellHit::default(); points.len()];
        if !points.is_empty() {
            let grid = PointGrid::new(points);
            self.buckets.each_batch(self.store, brick, batch, |cells| grid.locate(cells, &mut found))?;
        }
        Ok(found)
    }

    /// The cells of the lowest numbers that hold points, which may lie in any bricks.
    pub(super) fn locate_anywhere(&self, points: &[FinePos], batch: &mut CellBatch) -> Result<Vec<CellHit>> {
        let near: Vec<LatticePos> = points.iter().map(|p| p.map(|c| (c >> FINE_BITS) as u32)).collect();
        let mut all = vec![CellHit::default(); points.len()];
        let mut group = vec![];
        for run in brick_order(&self.bricks, &near).chunk_by(|a, b| a.0 == b.0) {
            group.clear();
            group.extend(run.iter().map(|&(_, i)| points[i as usize]));
            for (&(_, i), found) in run.iter().zip(self.locate(run[0].0, &group, batch)?) {
                all[i as usize] = found;
            }
        }
        Ok(all)
    }

    /// The body that each tetrahedron of a reduction is in; [`NO_BODY`] where that is not known.
    ///
    /// All its corners are in that body, but rounding may put one on the boundary into none. Where
    /// that leaves several bodies or none, the body that has the centroid counts.
    pub(in crate::pipeline) fn bodies_of(&self, positions: &[LatticePos], tets: &[Tet]) -> Result<Vec<u64>> {
        let mut batch = CellBatch::default();
        let points: Vec<FinePos> = positions.iter().map(|&p| fine(p)).collect();
        let at = self.locate_anywhere(&points, &mut batch)?;
        let at = at.iter().map(|found| self.body(found)).collect::<Result<Vec<_>>>()?;
        let (mut bodies, mut doubtful, mut places) = (vec![NO_BODY; tets.len()], vec![], vec![]);
        for ((t, tet), body) in tets.iter().enumerate().zip(&mut bodies) {
            let mut of_corners = tet.iter().map(|&v| at[v as usize]).filter(|&body| body != NO_BODY);
            match of_corners.next() {
                Some(first) if of_corners.all(|other| other == first) => *body = first,
                _ => {
                    doubtful.push(t);
                    places.push(centroid(tet.map(|v| positions[v as usize])));
                }
            }
        }
        for (t, found) in doubtful.into_iter().zip(self.locate_anywhere(&places, &mut batch)?) {
            bodies[t] = self.body(&found)?;
        }
        Ok(bodies)
    }
}

/// The centroid of a tetrahedron, exactly: four times it is whole in lattice steps.
pub(super) fn centroid(corners: [LatticePos; 4]) -> FinePos {
    std::array::from_fn(|a| corners.iter().map(|c| i64::from(c[a])).sum::<i64>() << (FINE_BITS - 2))
}
