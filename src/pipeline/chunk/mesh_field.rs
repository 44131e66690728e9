//! The field of a tetrahedral mesh: each point is located among the cells of its brick.
//!
//! Values can be fitted to those at the mesh's vertices ([`super::fit`]).

use super::cell_locator::{CellLocator, centroid};
use super::placement::{NO_BODY, Placement, Spot, ValueSource, by_brick, in_bricks};
use crate::domain::boundary::BoundarySamples;
use crate::domain::column::Column;
use crate::domain::store::CellStore;
use crate::domain::vertices::Vertices;
use crate::domain::wall::{OnBoundary, Sample};
use crate::pipeline::read::MeshedChunk;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::geom::vec3::{cross, dot};
use isospan_io::grid::BrickId;
use isospan_mesh::locate::{
    CellBatch, CellHit, Corner, FINE_BITS, FinePos, fine, linear, quadratic, quadratic_thesis,
};
use isospan_mesh::predicates::signed_volume6;
use isospan_mesh::sample::Interpolation;

/// A mesh, and how it is sampled.
pub(in crate::pipeline) struct CellField<'a> {
    pub(in crate::pipeline) store: &'a CellStore,
    pub(in crate::pipeline) cells: CellLocator<'a>,
    pub(in crate::pipeline) boundary: &'a BoundarySamples,
    pub(in crate::pipeline) interpolation: Interpolation,
    /// The values of the step at the vertices.
    pub(in crate::pipeline) values: Column<f32>,
    /// Gradients at the vertices, where the interpolation needs them.
    pub(in crate::pipeline) gradients: Option<Column<[f64; 3]>>,
    /// Where the vertices lie, where values are fitted to those there.
    pub(in crate::pipeline) fitted_to: Option<&'a Vertices>,
}

impl CellField<'_> {
    /// Where the vertices of a chunk lie.
    pub(super) fn place(&self, mesh: &MeshedChunk) -> Result<Placement> {
        let mut batch = CellBatch::default();
        let mut find = |brick, positions: &[LatticePos], out: &mut Vec<Spot>| {
            self.spots(brick, positions, &mut batch, out)
        };
        let mut spots = by_brick(&self.cells.bricks, mesh, &mut find)?;
        spots.extend(in_bricks(&self.cells.bricks, mesh.positions_around(), &mut find)?);
        let outside = self.outside(mesh, &spots, &mut batch)?;
        Ok(Placement { spots, outside, ..Placement::default() })
    }

    /// The values at the vertices of a chunk, and at those around.
    pub(super) fn interpolated(&self, placement: &Placement) -> Result<Vec<f32>> {
        let at_hand = AtHand::of(self)?;
        Ok(placement.spots.iter().map(|spot| at_hand.value(&spot.at)).collect())
    }

    /// Finds what is known about positions of a brick.
    fn spots(
        &self,
        brick: BrickId,
        positions: &[LatticePos],
        batch: &mut CellBatch,
        out: &mut Vec<Spot>,
    ) -> Result<()> {
        let points: Vec<FinePos> = positions.iter().map(|&p| fine(p)).collect();
        let found = self.cells.locate(brick, &points, batch)?;
        for (found, &pos) in found.iter().zip(positions) {
            let sample = self.boundary.at(pos);
            let place = match sample {
                // Rounding puts a sample next to the boundary. Where bodies overlap, it belongs to
                // the first of them.
                Some(Sample::On(sample)) if sample.body < self.cells.body(found)? => Some(*sample),
                _ => None,
            };
            out.push(match place {
                Some(place) => Spot { at: ValueSource::Boundary(place), body: place.body, rim: true },
                None => self.spot(found, sample.is_some())?,
            });
        }
        Ok(())
    }

    fn spot(&self, found: &CellHit, rim: bool) -> Result<Spot> {
        if found.id == CellHit::NOWHERE {
            return Ok(Spot::default());
        }
        Ok(Spot { at: ValueSource::Cell(*found), body: self.cells.body(found)?, rim })
    }

    /// The tetrahedra that lie outside of the mesh: those whose corners are not all of one body,
    /// and those with a corner at the rim that are not in that body ([`Self::places_in`]).
    fn outside(&self, mesh: &MeshedChunk, spots: &[Spot], batch: &mut CellBatch) -> Result<Vec<bool>> {
        let (positions, tets) = (&mesh.all_positions, mesh.tets.whole());
        let corners = |t: usize| tets[t].map(|v| v as usize);
        let body_of = |t: usize| {
            let [a, b, c, d] = corners(t).map(|v| spots[v].body);
            (a != NO_BODY && a == b && a == c && a == d).then_some(a)
        };
        let mut outside: Vec<bool> = (0..tets.len()).map(|t| body_of(t).is_none()).collect();
        let (mut doubtful, mut places) = (vec![], vec![]);
        for (t, outside) in outside.iter_mut().enumerate() {
            let at_rim = corners(t).iter().filter(|&&v| spots[v].rim).count();
            if at_rim == 0 || *outside {
                continue;
            }
            match self.places_in(corners(t).map(|v| positions[v]), at_rim == 4) {
                Some(of_tet) => places.extend(of_tet),
                None => *outside = true,
            }
            doubtful.resize(places.len(), t);
        }
        for (t, found) in doubtful.into_iter().zip(self.cells.locate_anywhere(&places, batch)?) {
            outside[t] |= Some(self.cells.body(&found)?) != body_of(t);
        }
        Ok(outside)
    }

    /// The places that a body has if a tetrahedron is in it: its centroid. For a flat one on the
    /// rim, they are a place on either side, because it may be a part of a wall. `None` if one lies
    /// outside of the box.
    fn places_in(&self, corners: [LatticePos; 4], on_rim: bool) -> Option<Vec<FinePos>> {
        let centroid = centroid(corners);
        let Some(normal) = flat_normal(corners).filter(|_| on_rim) else { return Some(vec![centroid]) };
        let domain = fine(self.store.frame.lattice.domain().hi);
        let beside = |side: f64| -> FinePos {
            let far = side * BESIDE * f64::from(1u32 << FINE_BITS);
            std::array::from_fn(|a| centroid[a] + (far * normal[a]).round() as i64)
        };
        let sides = vec![beside(1.0), beside(-1.0)];
        let in_box = |p: &FinePos| (0..3).all(|a| (0..domain[a]).contains(&p[a]));
        sides.iter().all(in_box).then_some(sides)
    }
}

/// The most thickness that rounding gives a flat wall, in lattice steps.
const ROUNDED: f64 = 4.0;
/// The distance of a place next to a flat wall, in lattice steps: more than rounding moves it.
const BESIDE: f64 = 16.0;

/// The unit normal of a tetrahedron whose only thickness comes from rounding.
fn flat_normal(corners: [LatticePos; 4]) -> Option<[f64; 3]> {
    let [a, b, c, d] = corners;
    let edge = |p: LatticePos, q: LatticePos| -> [f64; 3] {
        std::array::from_fn(|k| f64::from(q[k]) - f64::from(p[k]))
    };
    let faces = [[b, c, d], [a, c, d], [a, b, d], [a, b, c]];
    let normals = faces.map(|[p, q, r]| cross(edge(p, q), edge(p, r)));
    let length = |n: &[f64; 3]| dot(*n, *n).sqrt();
    let largest = normals.iter().max_by(|m, n| length(m).total_cmp(&length(n))).expect("four faces");
    let is_flat = signed_volume6(a, b, c, d) as f64 <= ROUNDED * length(largest);
    is_flat.then(|| largest.map(|c| c / length(largest)))
}

/// The data that values are made from, in memory.
struct AtHand<'a> {
    interpolation: Interpolation,
    tets: &'a [[u64; 4]],
    positions: &'a [FinePos],
    values: &'a [f32],
    gradients: Option<&'a [[f64; 3]]>,
}

impl<'a> AtHand<'a> {
    fn of(field: &'a CellField<'_>) -> Result<Self> {
        Ok(Self {
            interpolation: field.interpolation,
            tets: field.store.tets.get()?,
            positions: field.store.positions.get()?,
            values: field.values.get()?,
            gradients: field.gradients.as_ref().map(Column::get).transpose()?,
        })
    }

    fn value(&self, place: &ValueSource) -> f32 {
        match place {
            ValueSource::Nowhere => f32::NAN,
            ValueSource::Cell(found) => self.in_cell(found),
            ValueSource::Boundary(place) => self.on_boundary(place),
        }
    }

    fn in_cell(&self, found: &CellHit) -> f32 {
        let tet = self.tets[found.id as usize];
        let at = tet.map(|v| f64::from(self.values[v as usize]));
        (match (self.interpolation, self.gradients) {
            (Interpolation::QuadraticThesis, _) => quadratic_thesis(&found.weights, &at),
            (Interpolation::Quadratic, Some(gradients)) => {
                quadratic(&found.weights, &self.corners(tet, gradients))
            }
            _ => linear(&found.weights, &at),
        }) as f32
    }

    fn corners<const N: usize>(&self, vertices: [u64; N], gradients: &[[f64; 3]]) -> [Corner; N] {
        vertices.map(|v| Corner {
            position: self.positions[v as usize].map(|c| c as f64),
            value: f64::from(self.values[v as usize]),
            gradient: gradients[v as usize],
        })
    }

    /// As in a tetrahedron with the triangle as one of its faces.
    fn on_boundary(&self, place: &OnBoundary) -> f32 {
        let [a, b, c] = place.triangle.map(|v| f64::from(self.values[v as usize]));
        let weights = [place.weights[0], place.weights[1], place.weights[2], 0.0];
        (match (self.interpolation, self.gradients) {
            (Interpolation::Quadratic, Some(gradients)) => {
                let [a, b, c] = self.corners(place.triangle, gradients);
                quadratic(&weights, &[a, b, c, Corner::default()])
            }
            _ => linear(&weights, &[a, b, c, 0.0]),
        }) as f32
    }
}
