//! The only place that knows the order of the stages.
//!
//! ```text
//!  plan ──▶ for each chunk: points ▶ mesh ▶ sample ▶ encode ──▶ segments ──▶ commit: index, manifest
//!  open ──▶ index ▶ active blocks ▶ decode ▶ marching tetrahedra ▶ weld ──▶ surface file
//! ```
//!
//! [`reduce`] makes an archive, [`extract_surface`] and [`count_active`] ask it, [`check_archive`] proves it whole.

mod adapt;
mod adapt_mesh;
mod append;
mod bend_blocks;
mod beside;
mod block;
mod cached;
mod cell_field;
mod chunk;
mod commit;
mod export;
mod extract;
mod extract_steps;
mod field;
mod fingerprint;
mod fitted;
mod gauge;
mod grid_field;
mod groups;
mod handle;
mod horizon;
mod inspect;
mod job;
mod kept;
mod layout;
mod line;
mod make;
mod measure;
mod mesh_series;
mod nearest;
mod need;
mod notice;
mod open;
mod own;
mod own_errors;
mod placed;
mod plan;
mod plan_file;
mod probe;
mod probe_points;
mod query;
mod reader;
mod reduce;
mod reduce_mesh;
mod refine;
mod repair;
mod roi;
mod rounds;
mod scan;
mod series;
mod shard;
mod shift;
mod side_errors;
mod side_samples;
mod sides;
mod sink;
mod spare;
mod spectrum;
mod status;
mod steps;
mod surface_series;
mod survey;
mod target;
mod target_max;
mod unpack;
mod unpacked;
mod verify;
mod visit;
mod volume_series;
mod work;

pub use crate::domain::store::MeshCensus;
pub use adapt::Adapt;
pub use append::{AppendSettings, append};
pub use export::{Corners, ExportReport, ExportSettings};
pub use field::NanPolicy;
pub use fingerprint::fingerprint;
pub use handle::{Archive, Tetrahedra};
pub use job::{ReduceReport, RunSettings};
pub use measure::{MeasureReport, MeasureSettings, measure};
pub use need::Estimate;
pub use notice::{Finding, Notice, mesh_notices, scan_with_notices};
pub use open::{ArchiveSummary, LevelSummary, StepSummary, is_archive, summarize, summarize_at};
pub use plan::{Amount, Plan, ReduceSettings, ValueBits};
pub use plan_file::{plan_path, work_folder};
pub use probe::{ProbeReport, ProbeSettings};
pub use query::{
    CountReport, OneSurface, SurfaceReport, SurfaceSettings, count_active, count_active_at, extract_surface,
};
pub use reduce::{brick, estimate, estimate_series, is_bricked, reduce, reduce_series};
pub use refine::{Refine, RefineReport};
pub use roi::{Roi, RoiSpace};
pub use scan::{Scan, scan};
pub use series::SkippedStep;
pub use shard::{PlanReport, Planned, Shard, WorkReport, commit_shards, plan_shards, planned, work_shard};
pub use spectrum::{
    Knot, SpectrumReport, StepSpectrum, Suggestion, contour_spectrum, contour_spectrum_at, spectra,
};
pub use status::{GcReport, StatusReport, collect_garbage, shard_status};
pub use steps::{StepChoice, StepRange};
pub use surface_series::{SeriesReport, StepSurfaces, extract_series};
pub use target::{Bound, Target, TargetReport};
pub use unpack::{
    UnpackNeed, UnpackReport, UnpackSettings, UnpackedFile, remove_unpacked, unpack, unpack_need,
};
pub use verify::{ArchiveCheck, check_archive};
