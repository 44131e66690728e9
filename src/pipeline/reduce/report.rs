//! What is reported about a reduction.

use super::order::next_files;
use super::series::{SeriesPlan, SkippedStep};
use crate::archive::manifest::{Manifest, StoredStep};
use crate::archive::tables::CellCount;
use crate::archive::values::Quantiser;
use crate::domain::store::MeshCensus;
use crate::measure::FieldError;
use crate::pipeline::field::SurfaceErrors;
use crate::pipeline::plan::{Notice, folder_bytes};
use crate::pipeline::read::{OpenArchive, StepSummary};
use crate::pipeline::settings::{NanPolicy, Target};
use crate::pipeline::stage::{Stage, StageSeconds, StageTimes, summed};
use isospan_io::error::Result;
use isospan_io::exec::Reached;
use isospan_io::formats::{StepSource, without_frame};
use isospan_io::volume::chunked::DecodeCount;
use isospan_io::volume::shifted::is_whole;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// What a reduction made.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct ReduceReport {
    /// Samples of the volume; vertices of a mesh.
    pub samples: u64,
    /// What was found in the mesh, if the source is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh: Option<MeshCensus>,
    /// Whether the archive has a mesh's own vertices and tetrahedra.
    pub own: bool,
    /// Points of the archive.
    pub points: u64,
    /// For a volume: about the number of points that are no samples of the boundary. For a mesh:
    /// points with a value that were asked for, boundary included.
    pub inner_points: u64,
    /// The result of the search for a wanted error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<TargetReport>,
    /// The range of the samples of all steps; where no error was measured, of their points.
    #[serde(skip)]
    pub(in crate::pipeline) source_range: Option<[f64; 2]>,
    /// Whether the sources are several fields of each step: an error is a part of the range of
    /// each.
    #[serde(skip)]
    pub of_fields: bool,
    /// The errors of each step, RMS and largest, as parts of the range of its field.
    #[serde(skip)]
    pub(in crate::pipeline) shares: Vec<[f64; 2]>,
    /// Steps that these have replaced, by their numbers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub replaced: Vec<u64>,
    /// Chunks that were copied from an earlier try.
    #[serde(skip)]
    pub(in crate::pipeline) reused_chunks: u64,
    /// Points without a value.
    pub void_points: u64,
    /// Tetrahedra.
    pub tetrahedra: u64,
    /// Chunks.
    pub chunks: u64,
    /// Tetrahedron blocks.
    pub blocks: u64,
    /// How often a chunk's halo had to be widened.
    pub halo_retries: u64,
    /// The bad cells of a rectilinear or curvilinear grid.
    pub grid_cells: Option<CellCount>,
    /// Least and largest value.
    pub range: Option<[f64; 2]>,
    /// How values were rounded, if they were.
    pub quantiser: Option<Quantiser>,
    /// The error of the reduced field against the samples at the first of the steps, if it was
    /// measured.
    pub error: Option<FieldError>,
    /// The error of the first step against another source, if one was given: see
    /// [`Reduction::against`](crate::Reduction::against).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub against: Option<FieldError>,
    /// Surfaces against those of the samples, in the order of the isovalues that were given: see
    /// [`Reduction::isovalues`](crate::Reduction::isovalues). Of several steps, the one whose
    /// surface is farthest away.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub surfaces: Vec<SurfaceErrors>,
    /// Whether the samples of a step have one of these surfaces.
    #[serde(skip)]
    pub(in crate::pipeline) has_surface: bool,
    /// The least error of each sample, as a part of the range that decides it, that `f32` holds at
    /// all steps.
    #[serde(skip)]
    pub(in crate::pipeline) least_share: f64,
    /// The length of the range of the samples, where all are whole numbers that can be kept
    /// without loss.
    #[serde(skip)]
    pub(in crate::pipeline) whole_range: Option<f64>,
    /// The steps that were made.
    pub steps: Vec<StepSummary>,
    /// Steps that could not be used, and were left out.
    pub skipped: Vec<SkippedStep>,
    /// Whether all was there already, and nothing was made.
    pub made_before: bool,
    /// Bytes of all files of the archive.
    pub archive_bytes: u64,
    /// Bytes of the source, where an archive was made as a whole: of its files, or of its samples
    /// as they are stored, whichever is less.
    pub source_bytes: Option<u64>,
    /// How often chunks were decoded, for sources that are read by chunks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source_chunks: Option<SourceChunks>,
    /// What the user should know: see [`Notice`].
    pub notices: Vec<Notice>,
    /// Seconds of each stage: the wall time of those that run alone; the sum over threads of those
    /// that run side by side. Of a target: those of all tries together.
    #[serde(serialize_with = "crate::pipeline::stage::by_name")]
    pub seconds: StageSeconds,
}

/// The result of the search for a target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct TargetReport {
    /// What was wanted.
    pub target: Target,
    /// The bound: in units of the field, of the world, or in bytes.
    pub bound: f64,
    /// The error, the distance or the size of the archive;
    /// [`NO_SURFACE`](crate::pipeline::NO_SURFACE) where one of two surfaces is missing.
    pub reached: f64,
    /// Whether that is within the bound.
    pub met: bool,
    /// Reductions that were made.
    pub tries: u32,
    /// Whether bound and error are parts of the range of each of several fields.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub of_ranges: bool,
    /// Chunks that were meshed in all these together, and chunks that these had together: those in
    /// which nothing changed are reused.
    pub meshed_chunks: [u64; 2],
    /// For adapted points: cells that have a point a sample or more, and all cells.
    pub full_cells: Option<[u64; 2]>,
}

impl TargetReport {
    /// What was reached, of what was wanted.
    pub(in crate::pipeline) fn reached_of(&self) -> Reached {
        let quantity = match self.target {
            Target::Rms(_) => "RMS error",
            Target::Max(_) | Target::Lossless | Target::Labels => "largest error",
            Target::Surface(_) => "distance",
            Target::Size(_) | Target::Ratio(_) => "bytes",
        };
        Reached { quantity, value: self.reached, wanted: self.bound }
    }
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
    /// The decodings of some steps, as far as they were opened; `None` where none is read by
    /// chunks.
    pub(in crate::pipeline) fn of(sources: &[(u64, StepSource)]) -> Option<Self> {
        let sum = |of: fn(&DecodeCount) -> u64| sources.iter().map(|(_, s)| of(s.decodes())).sum();
        let (chunks, decodes) = (sum(DecodeCount::chunks), sum(DecodeCount::decodes));
        (chunks > 0).then_some(Self { chunks, decodes })
    }
}

/// The range of the samples of some steps; where no error was measured, of their points.
pub(super) fn range_of<'a>(steps: impl Iterator<Item = &'a StoredStep>) -> Option<[f64; 2]> {
    let of_step = |step: &StoredStep| step.error.as_ref().and_then(|e| e.source_range).or(step.file_range());
    steps.filter_map(of_step).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

/// The length of the range of steps whose samples are all whole numbers that `f32` holds.
fn whole_range(steps: &[&StoredStep]) -> Option<f64> {
    /// Of magnitudes up to this, `f32` has each whole number.
    const MOST: f64 = 16_777_216.0;
    let is_kept = |step: &&StoredStep| {
        let source = &step.plan.source;
        let is_whole = is_whole(source.scalar, source.slope, source.intercept);
        let range = step.file_range().unwrap_or_default().map(|v| (v - source.offset).abs());
        // A value in the place of missing samples may be any.
        let nan = matches!(NanPolicy::parse(&step.plan.nan), Some(NanPolicy::Value(v)) if v.fract() != 0.0);
        is_whole
            && !nan
            && source.offset.fract() == 0.0
            && source.rounding == 0.0
            && range.iter().all(|v| *v < MOST)
    };
    let [lo, hi] = range_of(steps.iter().copied())?;
    steps.iter().all(is_kept).then_some(hi - lo).filter(|length| *length > 0.0)
}

/// The least error of each sample that `f32` holds at all steps of a pyramid, as a part of the
/// range of the first one that is not constant: that decides what all keep.
fn least_share(steps: &[&StoredStep]) -> f64 {
    let ranges = || steps.iter().filter_map(|step| step.plan.wavelet).map(|wavelet| wavelet.range);
    let decides = ranges().map(|[lo, hi]| hi - lo).find(|length| *length > 0.0);
    let largest = ranges().flatten().map(f64::abs).fold(0.0, f64::max);
    // As `Correction::within` asks, with room for rounding.
    decides.map_or(0.0, |length| 1.01 * largest * 0.5_f64.powi(22) / length)
}

/// The errors of each step as parts of the range of its field, in all steps that have this.
fn shares(manifest: &Manifest) -> Vec<[f64; 2]> {
    let of_field = |name: &str| {
        let same = manifest.steps.iter().filter(|s| without_frame(s.field()) == name);
        range_of(same).map_or(0.0, |[lo, hi]| hi - lo)
    };
    let mut known: BTreeMap<&str, f64> = BTreeMap::new();
    let mut all = vec![];
    for step in &manifest.steps {
        let Some(error) = &step.error else { continue };
        let name = without_frame(step.field());
        let range = *known.entry(name).or_insert_with(|| of_field(name));
        let share = |error: f64| if error == 0.0 { 0.0 } else { error / range };
        all.push([error.rms, error.max].map(share));
    }
    all
}

impl ReduceReport {
    /// What was reached of a target that was not met: the archive is there all the same. `None`
    /// where there was no target, and where it was met.
    pub fn unmet(&self) -> Option<&TargetReport> {
        self.target.as_ref().filter(|target| !target.met)
    }

    /// The report of the archive at `root`: all that its manifest says about the steps whose files
    /// have numbers from `first` on.
    pub(in crate::pipeline) fn of_archive(
        self,
        root: &Path,
        manifest: &Manifest,
        first: u64,
    ) -> Result<Self> {
        let is_meant = |n: &usize| manifest.steps[*n].plan.number >= first;
        let positions: Vec<usize> = (0..manifest.steps.len()).filter(is_meant).collect();
        let steps: Vec<&StoredStep> = positions.iter().map(|n| &manifest.steps[*n]).collect();
        let counts = manifest.counts;
        let ranges = steps.iter().filter_map(|step| step.file_range());
        Ok(Self {
            own: manifest.plan.own.is_some(),
            points: counts.points,
            void_points: steps.iter().map(|s| s.void_points).sum(),
            tetrahedra: counts.tetrahedra,
            chunks: counts.chunks,
            blocks: counts.blocks,
            grid_cells: manifest.coordinates().map(|(_, c)| c.cells),
            range: ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]),
            quantiser: steps.first().and_then(|step| step.plan.file_quantiser()),
            error: steps.first().and_then(|step| step.error.clone()),
            steps: positions.iter().map(|n| StepSummary::of(manifest, *n)).collect(),
            archive_bytes: folder_bytes(root)?,
            whole_range: whole_range(&steps),
            least_share: least_share(&steps),
            source_range: range_of(steps.into_iter()),
            shares: shares(manifest),
            ..self
        })
    }

    /// The report of an archive to which these very steps were added before.
    pub(super) fn of_added(archive: &OpenArchive, series: &SeriesPlan) -> Result<Self> {
        let samples = archive.manifest.steps[0].plan.source.samples();
        let report = Self { samples, skipped: series.skipped.clone(), made_before: true, ..Self::default() };
        report.of_archive(archive.path(), &archive.manifest, next_files(&archive.manifest))
    }

    /// With the time of all.
    pub(in crate::pipeline) fn finished(mut self, started: Instant) -> Self {
        self.seconds = summed(&self.seconds);
        self.seconds.push((Stage::Total, started.elapsed().as_secs_f64()));
        self
    }

    /// With the time of the stages that run side by side.
    pub(super) fn with_times(mut self, times: &StageTimes) -> Self {
        // Measuring is reported with that of the whole.
        let &StageTimes { mesh, sample, fit, measure: _, encode, spectrum, write } = times;
        // Values that are not fitted take no time for it.
        let fit = Some((Stage::Fit, fit)).filter(|_| !fit.is_zero());
        let rows = [(Stage::Mesh, mesh), (Stage::Sample, sample)].into_iter().chain(fit);
        let rows = rows.chain([(Stage::Encode, encode), (Stage::Spectrum, spectrum), (Stage::Write, write)]);
        self.seconds.extend(rows.map(|(stage, time)| (stage, time.as_secs_f64())));
        self
    }
}
