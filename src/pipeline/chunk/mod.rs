//! One chunk: from its number to its mesh, the values at its vertices, and their errors.
//!
//! ```text
//!  mesher: points ─▶ mesh ─▶ field: values at its vertices ─▶ fit: fitted values
//!                     └────────▶ errors: the field of these values against every sample
//! ```
//!
//! No chunk sees another. The steps of a series are made together, with their values interleaved.

mod cell_locator;
pub(super) mod errors;
mod field;
mod fit;
mod groups;
mod mesh_field;
mod mesher;
mod own_field;
mod placement;
mod recipe;
mod step_errors;
pub(super) mod step_lanes;
mod step_samples;
mod volume_field;

pub(super) use cell_locator::CellLocator;
pub(super) use errors::{ChunkTets, Originals, SampleErrors, Samples, field_error_of, field_error_within};
pub(super) use field::{Field, interpolated};
pub(super) use fit::fitted;
pub(super) use mesh_field::CellField;
pub(super) use mesher::{ChunkMesher, Meshing};
pub(super) use own_field::OwnField;
pub(super) use placement::{NO_BODY, Placement};
pub(super) use recipe::{OwnMesh, Recipe};
pub(super) use step_lanes::StepLanes;
pub(super) use volume_field::GridField;
