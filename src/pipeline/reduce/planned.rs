//! A reduction in three calls: [`plan`], [`run`], [`publish`].

use super::build::{Build, SegmentSource, Segments, grid_coordinates};
use super::cached::need_with_caches;
use super::existing::{Existing, State, sweep};
use super::fields::Fields;
use super::job::Job;
use super::mesh_fields::MeshInput;
use super::mesh_store::{scratch_bytes, store_settings};
use super::meshes::{offset_of, prepare};
use super::report::ReduceReport;
use super::series::{Copies, PlannedSource, SeriesPlan};
use super::volume_fields::VolumeFields;
use super::volumes::plan_volumes;
use crate::archive::manifest::Manifest;
use crate::pipeline::plan::{Estimate, Held, Layout, MeshParts, Need, Plan, Shares, need_of, parts};
use crate::pipeline::settings::RunSettings;
use crate::pipeline::stage::Stage;
use isospan_io::error::{Error, Result};
use isospan_io::exec::pool;
use isospan_io::formats::StepSource;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;

/// The archive to be made, and all that is known about it before its first chunk.
pub(in crate::pipeline) struct Planned {
    pub(in crate::pipeline) series: SeriesPlan,
    pub(in crate::pipeline) parts: MeshParts,
    pub(in crate::pipeline) estimate: Estimate,
    pub(super) need: Need,
    pub(super) input: PlannedInput,
    /// What there is to report so far.
    pub(in crate::pipeline) report: ReduceReport,
}

/// Where values come from.
pub(super) enum PlannedInput {
    /// Each step is a volume of its own.
    Volumes,
    /// All steps have one mesh, which was read for the plan.
    Mesh(Box<MeshInput>),
}

/// Segments that were made, and what they were made of.
pub(in crate::pipeline) struct Built {
    pub(in crate::pipeline) series: SeriesPlan,
    pub(in crate::pipeline) parts: MeshParts,
    pub(in crate::pipeline) shares: Shares,
    pub(in crate::pipeline) segments: Segments,
    pub(in crate::pipeline) report: ReduceReport,
}

impl Built {
    /// Segments that all shards have made.
    pub(in crate::pipeline) fn of_shards(
        series: SeriesPlan,
        parts: MeshParts,
        shares: Shares,
        layout: &Layout,
        report: ReduceReport,
    ) -> Result<Self> {
        let segments = Segments::stored(grid_coordinates(&series, layout)?);
        Ok(Self { series, parts, shares, segments, report })
    }
}

/// Plans a job: what decides each byte, and what the work needs. With `only_estimates` the samples
/// are not read for the range of values, so nothing can be made of the plan.
pub(in crate::pipeline) fn plan(job: &Job<'_>, only_estimates: bool) -> Result<Planned> {
    let planned = if is_mesh(job)? { of_meshes(job) } else { of_volumes(job, only_estimates) }?;
    if let Some(before) = job.basis.plan() {
        expect_same(before, &planned.series)?;
    }
    Ok(planned)
}

fn of_volumes(job: &Job<'_>, only_estimates: bool) -> Result<Planned> {
    let planning = Instant::now();
    let mut series = plan_volumes(job, only_estimates)?;
    let parts = parts(&series.plan.mesh, series.attachments.clone())?;
    let need = need_with_caches(&mut series.sources, &parts, job.run);
    let estimate = job.estimate(&series.plan, &need, &PlannedSource::copies(&series.sources))?;
    let report = ReduceReport {
        samples: series.plan.first().source.samples(),
        inner_points: parts.points.interior_len(),
        of_fields: job.has_fields(),
        seconds: vec![(Stage::Plan, planning.elapsed().as_secs_f64())],
        ..ReduceReport::default()
    };
    Ok(Planned { series, parts, estimate, need, input: PlannedInput::Volumes, report })
}

/// Reads the mesh of the first source.
fn of_meshes(job: &Job<'_>) -> Result<Planned> {
    let reading = Instant::now();
    job.progress.begin("read the mesh", 0, "points");
    let settings = store_settings(job, offset_of(job)?);
    let (input, series, wanted) = prepare(job, settings)?;
    let census = input.store.census;
    let parts = parts(&series.plan.mesh, series.attachments.clone())?;
    let held = Held { always: input.listed.bytes(), ..Held::default() };
    let need = need_of(&parts, held, series.plan.steps.len(), job.run.resources.memory, job.run);
    let copies = Copies {
        scratch: scratch_bytes([census.vertices + census.added, census.tetrahedra], job),
        memory: 0,
    };
    let estimate = job.estimate(&series.plan, &need, &copies)?;
    let report = ReduceReport {
        samples: census.vertices,
        inner_points: wanted,
        of_fields: job.has_fields(),
        mesh: Some(census),
        seconds: vec![(Stage::Read, reading.elapsed().as_secs_f64())],
        ..ReduceReport::default()
    };
    Ok(Planned { series, parts, estimate, need, input: PlannedInput::Mesh(Box::new(input)), report })
}

/// Whether a job is one of meshes: as the archive is, or the first source that can be opened.
pub(super) fn is_mesh(job: &Job<'_>) -> Result<bool> {
    if let Some(archive) = job.basis.archive() {
        return Ok(archive.manifest.steps[0].plan.source.mesh.is_some());
    }
    first_that_opens(job.sources, job.run.keep_going, StepSource::is_mesh)
}

/// What is found in the first source, or where a run keeps going, in the first that can be opened.
pub(super) fn first_that_opens<T>(
    sources: &[(u64, StepSource)],
    keep_going: bool,
    open: impl Fn(&StepSource) -> Result<T>,
) -> Result<T> {
    let mut first_error = None;
    for (_, source) in sources {
        match open(source) {
            Err(e) if keep_going => _ = first_error.get_or_insert(e),
            found => return found,
        }
    }
    Err(first_error.unwrap_or_else(|| Error::usage("there is no step to reduce")))
}

/// Refuses sources that are not those of the plan that was made before.
fn expect_same(planned: &Plan, series: &SeriesPlan) -> Result<()> {
    if *planned == series.plan {
        return Ok(());
    }
    let found = planned.steps.iter().zip(&series.plan.steps);
    let n = found.into_iter().position(|(a, b)| a != b).unwrap_or(0);
    let text = |p: &Plan| {
        let source = &p.steps[n].source;
        format!("{} {} {:?}, plan {}", source.format, source.fingerprint, source.dims, p.step_hash(n))
    };
    let path = &series.sources[n].source.path;
    Err(Error::bad_input(path, "fingerprint and header", text(planned), text(&series.plan)).with_help(
        "the file is not what it was when the plan was made: restore it, or plan again with `replace=true`",
    ))
}

impl Planned {
    /// Where the files of the archive `out` are.
    pub(in crate::pipeline) fn layout(&self, out: &Path) -> Layout {
        Layout::new(out, self.parts.chunks.len(), 0)
    }

    /// Refuses what memory or disk do not hold.
    pub(in crate::pipeline) fn check(&self) -> Result<()> {
        match self.input {
            PlannedInput::Volumes => self.estimate.check(),
            // Most of its scratch space is taken by now, and was asked for before.
            PlannedInput::Mesh(_) => {
                let mut rest = self.estimate.clone();
                rest.scratch_bytes = 0;
                rest.check()
            }
        }
    }

    /// Makes the folders of a new archive, and writes what the plan refers to.
    pub(in crate::pipeline) fn begin(&self, layout: &Layout) -> Result<()> {
        layout.make_folders()?;
        self.series.attachments.write(layout.root(), self.series.plan.mesh_hash())
    }

    /// The report of an archive that is complete already.
    pub(super) fn report_of(self, manifest: &Manifest, layout: &Layout) -> Result<ReduceReport> {
        let ReduceReport { samples, inner_points, of_fields, .. } = self.report;
        let (skipped, made_before) = (self.series.skipped, true);
        let report = ReduceReport { samples, inner_points, of_fields, ..ReduceReport::default() };
        let report = ReduceReport { skipped, made_before, ..report };
        report.of_archive(layout.root(), manifest, 0)
    }
}

/// Makes some segments of a plan: those that are not there yet.
pub(in crate::pipeline) fn run(
    planned: Planned,
    job: &Job<'_>,
    layout: &Layout,
    segments: Range<u64>,
) -> Result<Built> {
    let Planned { mut series, parts, need, input, mut report, .. } = planned;
    let (memory, workers) = (job.run.resources.memory, job.run.resources.worker_threads());
    let all = need.shares(memory, workers)?;
    let (fields, shares): (Box<dyn Fields + '_>, Shares) = match input {
        PlannedInput::Volumes => {
            let (in_memory, shares) = copies_in_memory(&series, &need, all, job.run);
            (Box::new(VolumeFields::new(job.settings, job.run, job.progress, in_memory)), shares)
        }
        PlannedInput::Mesh(input) => (Box::new(input.sorted(&series.plan, &mut report.seconds)?), all),
    };
    let mut build = Build::new(job, layout, &parts, shares);
    // The measurements of workers are added up when all are there.
    build.measure &= job.basis.plan().is_none();
    let before = job.basis.round().map(|round| &round.before);
    let pool = &pool(shares.workers)?;
    let source = SegmentSource { fields: &*fields, at_once: need.steps(), segments, before, pool };
    let made = build.run(&mut series, &source)?;
    let points = build.points(&source.segments);
    let report = ReduceReport { points, reused_chunks: made.reused_chunks, ..report };
    Ok(Built { report: report.with_times(&made.times), series, parts, shares, segments: made })
}

/// Whether small copies of inputs are made in memory: where that leaves as many threads at work as
/// `all` the memory does. Returns the shares of the rest, too.
fn copies_in_memory(series: &SeriesPlan, need: &Need, all: Shares, run: &RunSettings) -> (bool, Shares) {
    let memory = run.resources.memory;
    let rest = memory - PlannedSource::small_copies(&series.sources, need.steps()).min(memory);
    let shares = need.shares(rest, run.resources.worker_threads());
    let shares = shares.ok().filter(|shares| shares.workers == all.workers);
    (shares.is_some(), shares.unwrap_or(all))
}

/// Makes segments an archive: index, spectrum and error of each step, then the manifest.
pub(in crate::pipeline) fn publish(built: Built, job: &Job<'_>, layout: &Layout) -> Result<ReduceReport> {
    let Built { series, parts, shares, segments, report } = built;
    Build::new(job, layout, &parts, shares).publish(&series, segments, report)
}

/// Makes the archive of a job, or what is missing of it.
pub(super) fn make(job: &Job<'_>, existing: &Existing) -> Result<ReduceReport> {
    let planned = plan(job, false)?;
    let state = existing.compare(job.out, &planned.series.plan, job.run)?;
    let layout = planned.layout(job.out);
    if let State::Complete(manifest) = state {
        sweep(&layout);
        return planned.report_of(&manifest, &layout);
    }
    planned.check()?;
    state.make_place(&layout)?;
    planned.begin(&layout)?;
    let built = run(planned, job, &layout, 0..layout.segment_count())?;
    // What earlier runs have left that were killed is no part of the archive's bytes.
    sweep(&layout);
    publish(built, job, &layout)
}
