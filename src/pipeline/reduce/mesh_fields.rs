//! A mesh that was read for a plan, and the values of steps on it.
//!
//! ```text
//!  mesh ─▶ store (files) ─▶ plan: points of the box ─▶ boundary samples, cells by brick ─▶ values
//!                       └▶ plan: its own vertices ──▶ its own cells by brick ────────────┘
//! ```

use super::fields::Fields;
use super::mesh_store::open_mesh_of;
use super::series::SeriesPlan;
use crate::domain::boundary::BoundarySamples;
use crate::domain::buckets::Buckets;
use crate::domain::gradients::gradients;
use crate::domain::own::{OwnCells, OwnVertices};
use crate::domain::settings::StoreSettings;
use crate::domain::store::CellStore;
use crate::domain::vertices::Vertices;
use crate::pipeline::chunk::{CellField, CellLocator, Field, OwnField, OwnMesh};
use crate::pipeline::plan::Plan;
use crate::pipeline::stage::{Stage, StageSeconds};
use isospan_io::error::Result;
use isospan_io::grid::BrickGrid;
use isospan_mesh::points::ExplicitPoints;
use isospan_mesh::sample::{Interpolation, Values};
use std::sync::Arc;
use std::time::Instant;

/// The points of a mesh that are listed, and what is known of them.
pub(super) enum Listed {
    /// Samples of its boundary.
    Boundary(BoundarySamples),
    /// The mesh's own vertices: it is stored unchanged.
    Own(OwnVertices),
}

/// Bytes that a listed point takes all the time: its position, its part of the grid that finds it.
const OWN_BYTES: u64 = 16;
/// Of a sample of the boundary, and of those by which the nearest place is found.
const SAMPLE_BYTES: u64 = 100;

impl Listed {
    /// Their positions.
    pub(super) fn points(&self) -> &Arc<ExplicitPoints> {
        match self {
            Self::Boundary(boundary) => &boundary.points,
            Self::Own(vertices) => &vertices.points,
        }
    }

    /// The memory that they take.
    pub(super) fn bytes(&self) -> u64 {
        match self {
            Self::Boundary(boundary) => boundary.points.len().saturating_mul(SAMPLE_BYTES),
            Self::Own(vertices) => vertices.points.len().saturating_mul(OWN_BYTES),
        }
    }
}

/// A mesh that was read for the plan of a job.
pub(super) struct MeshInput {
    pub(super) store: CellStore,
    pub(super) listed: Listed,
    pub(super) settings: StoreSettings,
}

impl MeshInput {
    /// Its cells and points by brick, as the work needs them. Notes the time that takes.
    pub(super) fn sorted(self, plan: &Plan, seconds: &mut StageSeconds) -> Result<MeshFields> {
        let sorting = Instant::now();
        let Self { store, listed, settings } = self;
        let laid = Laid::new(listed, &store, plan, &settings)?;
        seconds.push((Stage::Sort, sorting.elapsed().as_secs_f64()));
        Ok(MeshFields { store, laid, bricks: plan.mesh.bricks(), settings })
    }
}

/// The data with which the values of a mesh are found, brick by brick.
enum Laid {
    Sampled { buckets: Buckets, boundary: BoundarySamples, fitted_to: Option<Vertices> },
    Own(OwnCells),
}

impl Laid {
    /// Lays out the cells of a mesh, and the vertices that values are fitted to.
    fn new(listed: Listed, store: &CellStore, plan: &Plan, settings: &StoreSettings) -> Result<Self> {
        let bricks = plan.mesh.bricks();
        Ok(match listed {
            Listed::Own(vertices) => Self::Own(OwnCells::new(vertices, store, &bricks, settings)?),
            Listed::Boundary(boundary) => {
                let is_fitted = plan.first().values == Values::Fit;
                let buckets = Buckets::new(store, &bricks, settings)?;
                let fitted_to = is_fitted.then(|| Vertices::new(store, &bricks, settings)).transpose()?;
                Self::Sampled { buckets, boundary, fitted_to }
            }
        })
    }
}

/// Opens the values of steps on a mesh.
pub(super) struct MeshFields {
    store: CellStore,
    laid: Laid,
    bricks: BrickGrid,
    settings: StoreSettings,
}

impl Fields for MeshFields {
    fn open<'a>(&'a self, series: &SeriesPlan, n: usize) -> Result<Field<'a>> {
        let mesh = open_mesh_of(&series.sources[n].source)?;
        let values = self.store.values_of(&mesh, &self.settings)?;
        let (buckets, boundary, fitted_to) = match &self.laid {
            Laid::Sampled { buckets, boundary, fitted_to } => (buckets, boundary, fitted_to.as_ref()),
            Laid::Own(cells) => {
                let mesh = OwnMesh { store: &self.store, cells };
                return Ok(Field::Own(OwnField { mesh, values }));
            }
        };
        let interpolation = series.plan.steps[n].interpolation;
        let gradients = match interpolation {
            Interpolation::Quadratic => Some(gradients(&self.store, &values, &self.settings)?),
            _ => None,
        };
        Ok(Field::Cells(CellField {
            store: &self.store,
            cells: CellLocator { store: &self.store, buckets, bricks: self.bricks },
            boundary,
            interpolation,
            values,
            gradients,
            fitted_to,
        }))
    }

    fn own(&self) -> Option<OwnMesh<'_>> {
        match &self.laid {
            Laid::Own(cells) => Some(OwnMesh { store: &self.store, cells }),
            Laid::Sampled { .. } => None,
        }
    }
}
