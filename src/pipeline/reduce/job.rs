//! The parameters and the reports of a reduction: the same for volumes and meshes, for a whole
//! archive, a shard, and further steps.

use super::passes::{Outcome, SeriesPlan, SkippedStep, are_there};
use super::plan_file::PlanFile;
use super::reuse::Round;
use super::target::TargetReport;
use super::workers::StageTimes;
use crate::archive::coordinates::CellCount;
use crate::archive::values::Quantiser;
use crate::domain::store::MeshCensus;
use crate::error::{Error, Result};
use crate::exec::Progress;
use crate::formats::StepSource;
use crate::measure::FieldError;
use crate::pipeline::plan::{Layout, Notice, Plan, RecordedFile, Shard};
use crate::pipeline::read::{OpenArchive, StepSummary};
use crate::pipeline::settings::{ReduceSettings, RunSettings};
use crate::pipeline::stage::{Stage, StageSeconds};
use crate::volume::chunked::DecodeCount;
use serde::Serialize;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;

/// What a reduction made.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct ReduceReport {
    /// Samples of the volume; vertices of a mesh.
    pub samples: u64,
    /// Of a mesh: what was found in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh: Option<MeshCensus>,
    /// Of a mesh: whether the archive has its own vertices and tetrahedra.
    pub own: bool,
    /// Points of the archive.
    pub points: u64,
    /// Of a volume: points that are no samples of the boundary, about. Of a mesh: points with a value that were asked for, boundary included.
    pub inner_points: u64,
    /// What came of looking for a wanted error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<TargetReport>,
    /// The error that is wanted, in units of the field.
    #[serde(skip)]
    pub(in crate::pipeline) bound: Option<f64>,
    /// Chunks that were taken over from an earlier try.
    #[serde(skip)]
    pub(in crate::pipeline) taken_chunks: u64,
    /// Of all points, those without a value.
    pub void_points: u64,
    /// Tetrahedra.
    pub tetrahedra: u64,
    /// Chunks.
    pub chunks: u64,
    /// Tetrahedron blocks.
    pub blocks: u64,
    /// How often a chunk's halo had to be widened.
    pub halo_retries: u64,
    /// Of a rectilinear or curvilinear grid: its bad cells.
    pub grid_cells: Option<CellCount>,
    /// Least and largest value.
    pub range: Option<[f64; 2]>,
    /// How values were rounded, if they were.
    pub quantiser: Option<Quantiser>,
    /// How far the reduced field is from the samples, if that was measured: of the first of the steps.
    pub error: Option<FieldError>,
    /// The steps that were made.
    pub steps: Vec<StepSummary>,
    /// Steps that could not be used, and were left out.
    pub skipped: Vec<SkippedStep>,
    /// Whether all was there already, and nothing was made.
    pub made_before: bool,
    /// Bytes of all files of the archive.
    pub archive_bytes: u64,
    /// Bytes of the source: of its files, or of its samples as they are stored, whichever is less. Where an archive was made as a whole.
    pub source_bytes: Option<u64>,
    /// Of sources that are read by chunks: how often these were decoded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source_chunks: Option<SourceChunks>,
    /// What the user should know: see [`Notice`].
    pub notices: Vec<Notice>,
    /// Seconds of each stage: the wall time of those that run alone; the sum over threads of those that run side by side.
    #[serde(serialize_with = "crate::pipeline::stage::by_name")]
    pub seconds: StageSeconds,
}

/// The chunks of the sources of a reduction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SourceChunks {
    /// How many there are, of all steps.
    pub chunks: u64,
    /// How often one was decoded, all in all: to plan, and to make chunks of the archive.
    pub decodes: u64,
}

impl SourceChunks {
    /// Those of some steps, as far as they were opened; `None` where none is read by chunks.
    pub(in crate::pipeline) fn of(sources: &[(u64, StepSource)]) -> Option<Self> {
        let sum = |of: fn(&DecodeCount) -> u64| sources.iter().map(|(_, s)| of(s.decodes())).sum();
        let (chunks, decodes) = (sum(DecodeCount::chunks), sum(DecodeCount::decodes));
        (chunks > 0).then_some(Self { chunks, decodes })
    }
}

/// What a reduction is told.
pub(in crate::pipeline) struct Job<'a> {
    /// The steps, by ascending numbers.
    pub(in crate::pipeline) sources: &'a [(u64, StepSource)],
    pub(in crate::pipeline) settings: &'a ReduceSettings,
    pub(in crate::pipeline) out: &'a Path,
    pub(in crate::pipeline) run: &'a RunSettings,
    pub(in crate::pipeline) progress: &'a dyn Progress,
    pub(in crate::pipeline) started: Instant,
    pub(in crate::pipeline) part: Part<'a>,
    /// Of a search that has made a try before: what it does now.
    pub(in crate::pipeline) round: Option<&'a Round>,
}

impl Job<'_> {
    /// Whether errors tell the step.
    pub(super) fn is_several(&self) -> bool {
        self.sources.len() > 1 || self.part.archive().is_some()
    }
}

/// What of a reduction a job does.
#[derive(Clone, Copy)]
pub(in crate::pipeline) enum Part<'a> {
    /// All of it: plan, segments, manifest.
    Whole,
    /// The segments of a shard, of the plan that was made before.
    Shard(&'a PlanFile, Shard),
    /// Further steps of an archive, and its new manifest.
    Further(&'a OpenArchive),
}

impl<'a> Part<'a> {
    /// The plan that was made before.
    pub(super) fn planned(&self) -> Option<&'a Plan> {
        match *self {
            Self::Whole | Self::Further(_) => None,
            Self::Shard(file, _) => Some(&file.plan),
        }
    }

    /// The files that the plan was made from.
    pub(super) fn planned_files(&self) -> &'a [RecordedFile] {
        match *self {
            Self::Whole | Self::Further(_) => &[],
            Self::Shard(file, _) => &file.files,
        }
    }

    /// The archive that steps are added to.
    pub(super) fn archive(&self) -> Option<&'a OpenArchive> {
        match *self {
            Self::Further(archive) => Some(archive),
            Self::Whole | Self::Shard(..) => None,
        }
    }

    /// Refuses sources that are not those that were planned for.
    pub(super) fn expect_planned(&self, series: &SeriesPlan) -> Result<()> {
        let Some(planned) = self.planned().filter(|p| **p != series.plan) else { return Ok(()) };
        let found = planned.steps.iter().zip(&series.plan.steps);
        let n = found.into_iter().position(|(a, b)| a != b).unwrap_or(0);
        let text = |p: &Plan| {
            let source = &p.steps[n].source;
            format!("{} {} {:?}, plan {}", source.format, source.fingerprint, source.dims, p.step_hash(n))
        };
        let path = &series.sources[n].source.path;
        Err(Error::bad_input(path, "fingerprint and header", text(planned), text(&series.plan)).with_help(
            "the file is not what it was when the plan was made: restore it, or plan again with --force",
        ))
    }

    pub(super) fn segments(&self, layout: &Layout) -> Range<u64> {
        match self {
            Self::Whole | Self::Further(_) => 0..layout.segment_count(),
            Self::Shard(_, shard) => shard.range(layout.segment_count()),
        }
    }
}

/// What there is to report when an archive ends with these very steps already.
pub(super) fn added_before(archive: &OpenArchive, series: &SeriesPlan) -> Result<Option<ReduceReport>> {
    if !are_there(archive, &series.plan.steps) {
        return Ok(None);
    }
    let counts = archive.manifest.counts;
    Ok(Some(ReduceReport {
        samples: archive.manifest.steps[0].plan.source.samples(),
        points: counts.points,
        tetrahedra: counts.tetrahedra,
        chunks: counts.chunks,
        blocks: counts.blocks,
        skipped: series.skipped.clone(),
        archive_bytes: archive.file_bytes()?,
        made_before: true,
        ..ReduceReport::default()
    }))
}

/// Notes the time of all.
pub(in crate::pipeline) fn finished(mut report: ReduceReport, started: Instant) -> ReduceReport {
    report.seconds.push((Stage::Total, started.elapsed().as_secs_f64()));
    report
}

pub(super) fn push_times(seconds: &mut StageSeconds, made: &Outcome) {
    // What measuring takes is told with that of the whole.
    let StageTimes { mesh, sample, fit, measure: _, encode, spectrum, write } = made.times;
    // Values that are not fitted take no time for it.
    let fit = Some((Stage::Fit, fit)).filter(|_| !fit.is_zero());
    let rows = [(Stage::Mesh, mesh), (Stage::Sample, sample)].into_iter().chain(fit);
    let rows = rows.chain([(Stage::Encode, encode), (Stage::Spectrum, spectrum), (Stage::Write, write)]);
    seconds.extend(rows.map(|(stage, time)| (stage, time.as_secs_f64())));
}
