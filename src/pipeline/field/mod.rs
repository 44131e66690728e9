//! Questions about the field itself: its values on a grid or at points, its mesh, its error against
//! the source.

mod archive_volume;
mod at_vertices;
mod error_map;
mod export;
mod export_grid;
mod export_zarr;
mod levels;
mod measure;
mod nearest;
mod own_errors;
mod point_search;
mod probe_grid;
mod probe_points;
mod source_samples;
mod vertex_errors;

pub(super) use archive_volume::archive_sources;
pub(super) use at_vertices::AtVertices;
pub(super) use export::export;
pub use export::{Corners, ExportReport, ExportSettings};
pub(super) use export_grid::export_grid;
pub use export_grid::{GridReport, GridSettings};
pub(super) use export_zarr::{Moments, export_zarr};
pub use measure::MeasureReport;
#[cfg(feature = "compare")]
pub(super) use measure::with_samples;
pub(in crate::pipeline) use measure::{MeasureSettings, measure};
pub(super) use measure::{field_errors, no_samples, reopened_errors, reopened_values, store_settings};
pub use probe_grid::{ProbeReport, ProbeSettings};
pub(super) use probe_grid::{probe_grid, sample_grid};
pub(super) use probe_points::{edges_at_missing, probe_table, values_at, values_on_surface};
#[cfg(feature = "compare")]
pub(super) use source_samples::SourceSamples;
pub use source_samples::{SurfaceErrors, SurfaceSize};
pub(super) use vertex_errors::StepErrors;
