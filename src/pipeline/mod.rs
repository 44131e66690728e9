//! The only place that knows the order of the stages.
//!
//! ```text
//!  plan ──▶ for each chunk: points ▶ mesh ▶ sample ▶ encode ──▶ segments ──▶ commit: index, manifest
//!  open ──▶ index ▶ active blocks ▶ decode ▶ marching tetrahedra ▶ weld ──▶ surface file
//! ```
//!
//! A [`Reduction`] makes an archive; an [`Archive`] and its [`Step`]s answer questions. The rooms,
//! each of which uses those above it only:
//!
//! ```text
//!  settings   what a user chooses             stage     what took the time
//!  plan       what decides the bytes, where files are, what a run needs
//!  read       an archive being read           inputs    what is found out about inputs
//!  surface    questions for surfaces          chunk     one chunk: mesh, values, errors
//!  field      questions about the field
//!  reduce     inputs ─▶ plan ─▶ passes over chunks ─▶ commit
//!  shards     the same in several processes
//!  step       an archive at a moment          steps     at some of its steps
//!  query      which surfaces, and their ends  check     the proof that an archive is whole
//!  labels     surfaces of which labels, and their ends
//!  archive    the handle of users             reduction, addition, measurement: the orders of users
//! ```

mod addition;
mod archive;
mod check;
mod chunk;
mod field;
mod inputs;
mod labels;
mod measurement;
mod plan;
mod query;
mod read;
mod reduce;
mod reduction;
mod settings;
mod shards;
mod stage;
mod step;
mod steps;
mod surface;

pub use crate::domain::store::MeshCensus;
pub use crate::measure::SurfaceDistance;
pub use addition::Addition;
pub use archive::{Archive, Opening};
pub use check::ArchiveCheck;
pub use field::{
    Corners, ExportReport, ExportSettings, GridReport, GridSettings, MeasureReport, ProbeReport,
    ProbeSettings, SurfaceErrors, SurfaceSize,
};
pub use inputs::{Scan, brick, is_bricked, scan};
pub use labels::LabelQuery;
pub use measurement::Measurement;
pub use plan::{Estimate, Finding, Notice, Plan, SearchEstimate, Shard, fingerprint};
pub use query::{Isovalues, SurfaceQuery};
pub use read::{
    ArchiveSummary, Knot, LevelChoice, LevelSummary, PyramidLevel, Roi, RoiSpace, SpectrumReport, StepChoice,
    StepRange, StepSpectrum, StepSummary, Suggestion, is_archive,
};
pub use reduce::{
    CopiedFile, NO_SURFACE, ReduceReport, SkippedStep, SourceChunks, TargetReport, archive_files,
    copy_archive, header_notices, mesh_notices, plan_path, scan_with_notices, work_folder,
};
#[doc(hidden)]
pub use reduce::{changed_sources, estimate_series, reduce_series};
pub use reduction::Reduction;
pub use settings::{
    Adapt, Amount, Bound, CompleteSettings, FieldValue, Focus, InputFacts, Length, NanPolicy, ReduceSettings,
    RunSettings, SetChoice, SurfaceTarget, Target,
};
pub use shards::{
    Committed, GcReport, NextTry, PlanReport, ShardNeeds, Shards, StatusReport, WorkReport, collect_garbage,
};
pub use stage::{Stage, StageSeconds};
pub use step::{Step, Tetrahedra};
pub use steps::Steps;
pub use surface::{
    ColourBy, CountReport, InscribedBall, LabelMesh, LabelReport, Labels, NumbersReport, OneLabel,
    OneSurface, PhaseNumbers, Plateau, Refine, RefineReport, SeriesReport, StepSurfaces, StreamedPart,
    SurfaceReport, SurfaceSink,
};
