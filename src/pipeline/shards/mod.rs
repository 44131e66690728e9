//! A reduction in three commands: plan, work, commit; [`Reduction::write`](crate::Reduction::write)
//! is these three in one process.
//!
//! ```text
//!  plan INPUT ──▶ plan.json ──▶ work I/N  (any number of processes, on any machines, in any order, again at will)
//!                                  │ segments, each under a name of its own until it is done
//!                                  ▼
//!                               commit: every segment verified ──▶ index ──▶ manifest
//! ```
//!
//! A **shard** I of N is the I-th of N runs of whole segments. N is free: the segments, and so the
//! archive's bytes, are the same for any N, and workers of different N may run together. A shard
//! does all steps of its chunks. Workers lock nothing and do not communicate. A worker skips
//! segments that are done. Two workers that make the same one write the same bytes to temporary
//! files of different names, and the later rename replaces a file by its copy. So a task may be
//! started twice, or go on after its machine was thought to be dead.
//!
//! Every worker reads the input. Each copies a compressed input, which has no random access, into
//! bricks, and makes the structures of a tetrahedral mesh, in its own `scratch`: nothing is shared
//! between machines but the archive. Where a source has chunks, each worker decodes those that it
//! needs, if its memory holds them: see `inputs::access`.

mod status;

use crate::archive::manifest::{MANIFEST_NAME, Manifest};
use crate::error::{Error, Result};
use crate::exec::{Progress, Resources};
use crate::formats::StepSource;
use crate::pipeline::plan::{
    Attachments, Estimate, Held, Layout, MeshParts, Need, Plan, Shard, Watch, estimate, parts,
};
use crate::pipeline::read::{Depth, SegmentState};
use crate::pipeline::reduce;
use crate::pipeline::reduce::{
    Basis, Built, Cut, Existing, Job, PlanFile, ReduceReport, SourceChunks, look, numbered, plan_path,
};
use crate::pipeline::settings::{ReduceSettings, RunSettings};
use crate::pipeline::stage::{Stage, StageSeconds};
use serde::Serialize;
use status::Inventory;
pub use status::{GcReport, StatusReport, collect_garbage, shard_status};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What was planned, and what a shard of it needs.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct PlanReport {
    /// The plan's file.
    pub plan: PathBuf,
    /// The hashes of the plan: that of the mesh, and that of the values.
    pub hash: [String; 2],
    /// Shards.
    pub shards: u64,
    /// Segments of the archive; a shard has whole ones.
    pub segments: u64,
    /// Segments of the largest shard.
    pub shard_segments: u64,
    /// Seconds of the largest shard, roughly: from the speed of a machine of 2020.
    #[serde(rename = "estimated_shard_seconds")]
    pub shard_seconds: f64,
    /// What the whole needs; memory and scratch are those of each worker.
    #[serde(flatten)]
    pub needs: Estimate,
}

/// Plans the reduction of a series of steps, or of one, to the archive `out` in `shards` parts, and
/// writes the plan next to it. With [`RunSettings::replace`] an existing archive and plan are
/// replaced.
///
/// # Errors
/// As [`Reduction::write`](crate::Reduction::write); [`Error::Usage`] when there is another plan
/// already.
pub fn plan_shards(
    sources: &[StepSource],
    settings: &ReduceSettings,
    out: &Path,
    shards: u64,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<PlanReport> {
    if shards == 0 {
        return Err(Error::usage("at least one shard"));
    }
    if settings.target.is_some() {
        return Err(Error::usage(
            "a target is met by trying: reduce does that; a plan has a count or a fraction",
        ));
    }
    let _lock = reduce::lock_for_writing(out)?;
    let existing = Existing::at(out)?;
    existing.refuse_overwriting(out, run.replace)?;
    let sources = &numbered(sources);
    let job = Job { sources, settings, out, run, progress, basis: Basis::New };
    let notices = look(&job)?.notices;
    let planned = reduce::plan(&job, false)?;
    let mut needs = planned.estimate.clone();
    needs.notices = notices;
    let (memory_least, replaces) = (needs.memory_least, existing.is_finished());
    // A shard has whole segments: more shards than segments would have nothing to do.
    let shards = shards.min(planned.layout(out).segment_count());
    let cut = Cut { chunks: planned.parts.chunks.len(), shards, memory_least, replaces };
    let file = PlanFile::new(settings, &planned.series, cut)?;
    let root = file.root(out);
    let layout = planned.layout(&root);
    // Before the plan is there: a worker finds no work of another one.
    Existing::at(&root)?.compare(&root, &file.plan, run)?.make_place(&layout)?;
    file.write(out, run.replace)?;
    planned.begin(&layout)?;
    let segments = layout.segment_count();
    let shard_segments = segments.div_ceil(shards);
    Ok(PlanReport {
        plan: plan_path(out),
        hash: [file.mesh_hash, file.steps_hash].map(|h| h.to_string()),
        shards,
        segments,
        shard_segments,
        shard_seconds: needs.seconds * shard_segments as f64 / segments.max(1) as f64,
        needs,
    })
}

/// What of a plan a job script needs.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Planned {
    /// Shards.
    pub shards: u64,
    /// Segments.
    pub segments: u64,
    /// The least memory of a worker, in bytes.
    pub memory_least: u64,
    /// Memory with which all its threads work.
    pub memory: u64,
    /// Seconds of all shards one after another, on a machine of 2020, roughly.
    pub seconds: f64,
}

/// What was planned, for workers of `threads` threads.
///
/// # Errors
/// [`Error::BadInput`] when there is no plan.
pub fn planned(out: &Path, threads: usize) -> Result<Planned> {
    let file = PlanFile::read(out)?;
    let mesh = mesh_parts(&file.root(out), &file.plan)?;
    let steps = file.plan.steps.len();
    let resources = Resources::default().with_threads(threads);
    let run = RunSettings { resources, ..RunSettings::default() };
    let need = estimate::need_of(&mesh, Held::default(), steps, u64::MAX, &run);
    Ok(Planned {
        shards: file.shards,
        segments: Inventory::new(&file.root(out), &file).segments(),
        memory_least: file.memory_least,
        memory: need.comfortable(threads).max(file.memory_least),
        seconds: need.seconds(threads, steps),
    })
}

/// What a worker did.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct WorkReport {
    /// The shard.
    pub shard: String,
    /// Its segments.
    pub segments: u64,
    /// Points of its chunks; 0 when all was done before.
    pub points: u64,
    /// How often this worker decoded chunks, for sources that are read by chunks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source_chunks: Option<SourceChunks>,
    /// Seconds of each stage.
    #[serde(serialize_with = "crate::pipeline::stage::by_name")]
    pub seconds: StageSeconds,
}

/// Makes the segments of a shard that are not done yet.
///
/// # Errors
/// [`Error::BadInput`] when there is no plan, or the input is not that of the plan; else as
/// [`Reduction::write`](crate::Reduction::write).
pub fn work_shard(
    out: &Path,
    shard: Shard,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<WorkReport> {
    let started = Instant::now();
    let file = PlanFile::read(out)?;
    expect_no_other_archive(out, &file)?;
    let out = &file.root(out);
    let inventory = Inventory::new(out, &file);
    let segments = shard.range(inventory.segments());
    let report = |points, source_chunks, seconds| WorkReport {
        shard: shard.to_string(),
        segments: segments.end - segments.start,
        points,
        source_chunks,
        seconds,
    };
    // A task that is started again does not read its input for nothing.
    let mut done = segments.clone().flat_map(|s| inventory.files_of(s));
    if done.all(|f| inventory.look(&f, Depth::All) == SegmentState::Whole) {
        return Ok(report(0, None, vec![]));
    }
    // The plan says which steps there are: a worker leaves none out.
    let run = RunSettings { replace: false, keep_going: false, ..run.clone() };
    let (sources, settings, basis) = (&file.numbered(), &file.settings, Basis::Plan(&file));
    let job = Job { sources, settings, out, run: &run, progress, basis };
    let planned = reduce::plan(&job, false)?;
    planned.check()?;
    let layout = planned.layout(out);
    planned.begin(&layout)?;
    let made = reduce::run(planned, &job, &layout, segments.clone())?.report.finished(started);
    layout.sync()?;
    Ok(report(made.points, SourceChunks::of(sources), made.seconds))
}

/// A finished archive of another plan is not written into; the one that is to be replaced stays as
/// it is.
fn expect_no_other_archive(out: &Path, file: &PlanFile) -> Result<()> {
    if !out.join(MANIFEST_NAME).exists() || file.root(out) != out {
        return Ok(());
    }
    if file.plan.is_of(&Manifest::read(out)?) {
        return Ok(());
    }
    let text = "holds an archive that was not made by this plan; plan again with --force to replace it";
    Err(Error::usage(format!("{} {text}", out.display())))
}

/// Verifies every segment of a plan and publishes the archive: index, then manifest. Deletes
/// nothing but what dead processes of this machine have left unfinished.
///
/// # Errors
/// [`Error::Incomplete`] with each segment that is missing, damaged or of another plan.
pub fn commit_shards(out: &Path, run: &RunSettings, progress: &dyn Progress) -> Result<ReduceReport> {
    let started = Instant::now();
    let _lock = reduce::lock_for_writing(out)?;
    let file = PlanFile::read(out)?;
    expect_no_other_archive(out, &file)?;
    let root = file.root(out);
    Inventory::new(&root, &file).expect_whole(run, progress)?;
    let verified = started.elapsed().as_secs_f64();
    let parts = mesh_parts(&root, &file.plan)?;
    let shares = Need::of(&parts).shares(run.resources.memory, run.resources.worker_threads())?;
    let layout = Layout::new(&root, parts.chunks.len(), 0);
    let samples = match &file.plan.first().source.mesh {
        Some(mesh) => mesh.vertices,
        None => file.plan.first().source.dims.iter().product(),
    };
    let seconds = vec![(Stage::Verify, verified)];
    let report = ReduceReport { samples, seconds, ..ReduceReport::default() };
    // The vertices of a mesh are read once more, to measure; for a volume, workers have done that.
    let is_read = file.settings.measure && file.plan.first().source.mesh.is_some();
    let watch = if is_read { file.expect_same_inputs(run)? } else { Watch::default() };
    let series = file.series(watch);
    let (sources, settings, basis) = (&file.numbered(), &file.settings, Basis::Plan(&file));
    let job = Job { sources, settings, out: &root, run, progress, basis };
    let built = Built::of_shards(series, parts, shares, &layout, report)?;
    let report = reduce::publish(built, &job, &layout)?;
    // What commits and workers of this machine have left that were killed.
    reduce::sweep(&layout);
    if root != out {
        reduce::replace_archive(&root, out)?;
    }
    Ok(report.finished(started))
}

/// The parts of a plan, with what is stored in the archive.
fn mesh_parts(out: &Path, plan: &Plan) -> Result<MeshParts> {
    parts(&plan.mesh, Attachments::read(out, &plan.mesh)?)
}
