//! The field of a tetrahedral mesh: each point is located among the cells of its brick.

use super::chunk::MeshedChunk;
use super::field::{Field, Survey, brick_order, by_brick};
use super::measure::Originals;
use crate::domain::boundary::BoundarySamples;
use crate::domain::buckets::Buckets;
use crate::domain::column::Column;
use crate::domain::store::CellStore;
use crate::error::Result;
use crate::geom::LatticePos;
use crate::grid::{BrickGrid, BrickId, Chunk};
use crate::locate::{
    CellBatch, Corner, FINE_BITS, FinePos, Found, PointGrid, fine, linear, quadratic, quadratic_thesis,
};
use crate::sample::Interpolation;

/// A mesh, and how it is sampled.
pub(crate) struct CellField<'a> {
    pub(crate) store: &'a CellStore,
    pub(crate) buckets: &'a Buckets,
    pub(crate) boundary: &'a BoundarySamples,
    pub(crate) bricks: BrickGrid,
    pub(crate) interpolation: Interpolation,
    /// Gradients at the vertices, where the interpolation needs them.
    pub(crate) gradients: Option<Column<[f64; 3]>>,
}

/// What is known of a vertex of the chunk.
#[derive(Clone, Copy, Debug)]
struct Spot {
    value: f32,
    /// The body that it lies in, or on the boundary of; [`NO_BODY`] outside of the mesh.
    body: u64,
    /// A sample of the boundary.
    boundary: bool,
}

/// The body of a point outside of the mesh.
const NO_BODY: u64 = u64::MAX;

impl Default for Spot {
    fn default() -> Self {
        Self { value: f32::NAN, body: NO_BODY, boundary: false }
    }
}

impl Field for CellField<'_> {
    fn survey(&self, mesh: &MeshedChunk) -> Result<Survey> {
        let mut batch = CellBatch::default();
        let spots = by_brick(&self.bricks, mesh, |brick, positions, out| {
            self.spots(brick, positions, &mut batch, out)
        })?;
        let outside = self.outside(mesh, &spots, &mut batch)?;
        Ok(Survey { values: spots.iter().map(|s| s.value).collect(), outside })
    }

    fn originals(&self) -> Originals<'_> {
        Originals::Mesh(self.store)
    }

    fn will_need(&self, _chunk: &Chunk) {}

    fn pass(&self, _chunk: &Chunk) {}
}

impl CellField<'_> {
    fn spots(
        &self,
        brick: BrickId,
        positions: &[LatticePos],
        batch: &mut CellBatch,
        out: &mut Vec<Spot>,
    ) -> Result<()> {
        let points: Vec<FinePos> = positions.iter().map(|&p| fine(p)).collect();
        for (found, &pos) in self.locate(brick, &points, batch)?.iter().zip(positions) {
            let sample = self.boundary.at(pos);
            out.push(match (found.id, sample) {
                (Found::NOWHERE, None) => Spot::default(),
                // Rounded out of the mesh, by less than a lattice step.
                (Found::NOWHERE, Some(sample)) => Spot {
                    value: self.on_boundary(&sample.triangle, &sample.weights)?,
                    body: sample.body,
                    boundary: true,
                },
                // Where bodies overlap, the boundary of one lies inside of another: one rule for all points.
                _ => Spot {
                    value: self.value(found)?,
                    body: self.store.bodies.of(found.id)?,
                    boundary: sample.is_some(),
                },
            });
        }
        Ok(())
    }

    /// The cells of the lowest numbers that hold points of a brick.
    fn locate(&self, brick: BrickId, points: &[FinePos], batch: &mut CellBatch) -> Result<Vec<Found>> {
        let mut found = vec![Found::default(); points.len()];
        if !points.is_empty() {
            let grid = PointGrid::new(points);
            self.buckets.each_batch(self.store, brick, batch, |cells| grid.locate(cells, &mut found))?;
        }
        Ok(found)
    }

    /// Which tetrahedra lie outside of the mesh: those whose corners are not all in one body, and of those with a sample of the
    /// boundary for a corner the ones whose centroid is not in that body.
    fn outside(&self, mesh: &MeshedChunk, spots: &[Spot], batch: &mut CellBatch) -> Result<Vec<bool>> {
        let corners = |t: usize| mesh.tets[t].map(|v| v as usize);
        let body_of = |t: usize| {
            let [a, b, c, d] = corners(t).map(|v| spots[v].body);
            (a != NO_BODY && a == b && a == c && a == d).then_some(a)
        };
        let mut outside: Vec<bool> = (0..mesh.tets.len()).map(|t| body_of(t).is_none()).collect();
        let doubtful: Vec<usize> = (0..mesh.tets.len())
            .filter(|&t| !outside[t] && corners(t).iter().any(|&v| spots[v].boundary))
            .collect();
        // Four times the centroid, in lattice steps, is exact; so is the centroid in fine steps.
        let sum = |t: usize| -> [i64; 3] {
            let corners = corners(t).map(|v| mesh.positions[v]);
            std::array::from_fn(|a| corners.iter().map(|c| i64::from(c[a])).sum())
        };
        let near: Vec<LatticePos> = doubtful.iter().map(|&t| sum(t).map(|s| (s >> 2) as u32)).collect();
        let mut centroids = vec![];
        let order = brick_order(&self.bricks, &near);
        for run in order.chunk_by(|a, b| a.0 == b.0) {
            centroids.clear();
            centroids
                .extend(run.iter().map(|&(_, i)| sum(doubtful[i as usize]).map(|s| s << (FINE_BITS - 2))));
            let found = self.locate(run[0].0, &centroids, batch)?;
            for (&(_, i), found) in run.iter().zip(&found) {
                let t = doubtful[i as usize];
                let body =
                    if found.id == Found::NOWHERE { None } else { Some(self.store.bodies.of(found.id)?) };
                outside[t] = body != body_of(t);
            }
        }
        Ok(outside)
    }

    fn value(&self, found: &Found) -> Result<f32> {
        let tet = self.store.tets.get()?[found.id as usize];
        let values = self.store.values.get()?;
        let at = tet.map(|v| f64::from(values[v as usize]));
        Ok(match (self.interpolation, &self.gradients) {
            (Interpolation::QuadraticThesis, _) => quadratic_thesis(&found.weights, &at),
            (Interpolation::Quadratic, Some(gradients)) => {
                quadratic(&found.weights, &self.corners(tet, gradients.get()?)?)
            }
            _ => linear(&found.weights, &at),
        } as f32)
    }

    fn corners<const N: usize>(&self, vertices: [u64; N], gradients: &[[f64; 3]]) -> Result<[Corner; N]> {
        let (positions, values) = (self.store.positions.get()?, self.store.values.get()?);
        Ok(vertices.map(|v| Corner {
            position: positions[v as usize].map(|c| c as f64),
            value: f64::from(values[v as usize]),
            gradient: gradients[v as usize],
        }))
    }

    /// As in a tetrahedron with the triangle as one of its faces.
    fn on_boundary(&self, triangle: &[u64; 3], weights: &[f64; 3]) -> Result<f32> {
        let values = self.store.values.get()?;
        let [a, b, c] = triangle.map(|v| f64::from(values[v as usize]));
        let weights = [weights[0], weights[1], weights[2], 0.0];
        Ok(match (self.interpolation, &self.gradients) {
            (Interpolation::Quadratic, Some(gradients)) => {
                let [a, b, c] = self.corners(*triangle, gradients.get()?)?;
                quadratic(&weights, &[a, b, c, Corner::default()])
            }
            _ => linear(&weights, &[a, b, c, 0.0]),
        } as f32)
    }
}
