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

mod search;
mod status;

use crate::archive::manifest::{MANIFEST_NAME, Manifest};
use crate::pipeline::plan::{
    Attachments, Estimate, Held, Layout, MeshParts, Need, Plan, Shard, Watch, estimate, parts,
};
use crate::pipeline::read::{Depth, SegmentState};
use crate::pipeline::reduce;
use crate::pipeline::reduce::{
    Basis, Built, Cut, Existing, Job, PLANNED_TRY, PlanFile, Planned as PlannedReduction, PlannedSearch,
    ReduceReport, SourceChunks, TargetReport, TargetSearch, look, numbered, plan_path,
};
use crate::pipeline::settings::{CompleteSettings, FieldValue, ReduceSettings, RunSettings, Target};
use crate::pipeline::stage::{Stage, StageSeconds};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Resources, Silent};
use isospan_io::formats::StepSource;
use serde::Serialize;
pub use status::{GcReport, StatusReport, collect_garbage};
use status::{Inventory, shard_status};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A reduction that was planned in shards, at the path of its archive:
/// [`Reduction::plan_shards`](crate::Reduction::plan_shards) plans one.
///
/// ```
/// use isospan::pipeline::{Committed, Shard, Shards};
/// use isospan::{Archive, Reduction};
/// # fn main() -> isospan::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("protein.isospan");
/// let plan = Reduction::of("datasets/ironprot.vtk").plan_shards(&path, 2)?;
///
/// // Each may be a process of its own, on any machine, in any order, and may be started again.
/// let shards = Shards::at(&path);
/// for n in 0..plan.shards {
///     shards.work(Shard::new(n, plan.shards)?)?;
/// }
/// let mut committed = shards.commit()?;
///
/// // An error that is not to be exceeded may take several tries.
/// while let Committed::NextTry(_) = committed {
///     shards.work(Shard::ALL)?;
///     committed = shards.commit()?;
/// }
/// assert!(Archive::open(&path).is_ok());
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
pub struct Shards<'a> {
    archive: PathBuf,
    run: RunSettings,
    progress: &'a dyn Progress,
    cut_into: Option<u64>,
    quick: bool,
}

impl Shards<'static> {
    /// The reduction that was planned for the archive of this path.
    pub fn at(archive: impl AsRef<Path>) -> Self {
        let archive = archive.as_ref().to_path_buf();
        Self { archive, run: RunSettings::default(), progress: &Silent, cut_into: None, quick: false }
    }
}

impl Shards<'_> {
    /// What a run may use of the machine.
    pub fn resources(mut self, resources: Resources) -> Self {
        self.run.resources = resources;
        self
    }

    /// How many shards [`Shards::status`] cuts the work into; as many as were planned if none.
    pub fn cut_into(mut self, shards: impl Into<Option<u64>>) -> Self {
        self.cut_into = shards.into();
        self
    }

    /// [`Shards::status`] believes headers, lengths and footers, and does not read the blocks.
    pub fn quick(mut self, quick: bool) -> Self {
        self.quick = quick;
        self
    }

    /// Shows how far it is.
    pub fn progress(self, progress: &dyn Progress) -> Shards<'_> {
        let Self { archive, run, cut_into, quick, .. } = self;
        Shards { archive, run, progress, cut_into, quick }
    }

    /// Makes the segments of a shard that are not done yet.
    ///
    /// # Errors
    /// [`Error::BadInput`] when there is no plan, or the input is not that of the plan; else as
    /// [`Reduction::write`](crate::Reduction::write).
    pub fn work(&self, shard: Shard) -> Result<WorkReport> {
        work_shard(&self.archive, shard, &self.run, self.progress)
    }

    /// Verifies every segment of the plan and publishes the archive: index, then manifest. Deletes
    /// nothing but what dead processes of this machine have left unfinished. Where a target is
    /// searched for, it may plan the next try instead. Surfaces that the plan asks for are measured
    /// against the source.
    ///
    /// # Errors
    /// [`Error::Incomplete`] with each segment that is missing, damaged or of another plan.
    pub fn commit(&self) -> Result<Committed> {
        commit_shards(&self.archive, &self.run, self.progress)
    }

    /// Looks at all segments of the plan.
    ///
    /// # Errors
    /// [`Error::BadInput`] when there is no plan, and for a damaged manifest;
    /// [`Error::Cancelled`].
    pub fn status(&self) -> Result<StatusReport> {
        shard_status(&self.archive, self.cut_into, self.quick, &self.run.resources.cancel)
    }

    /// What a job script needs of the plan, for workers of `threads` threads.
    ///
    /// # Errors
    /// [`Error::BadInput`] when there is no plan.
    pub fn needs(&self, threads: usize) -> Result<ShardNeeds> {
        shard_needs(&self.archive, threads)
    }
}

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

/// Plans a reduction: see [`Reduction::plan_shards`](crate::Reduction::plan_shards).
pub(in crate::pipeline) fn plan_shards(
    sources: &[StepSource],
    settings: &ReduceSettings,
    isovalues: &[FieldValue],
    out: &Path,
    shards: u64,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<PlanReport> {
    if shards == 0 {
        return Err(Error::usage("at least one shard"));
    }
    let _lock = reduce::lock_for_writing(out)?;
    let existing = Existing::at(out)?;
    existing.refuse_overwriting(out, run.replace)?;
    let sources = &numbered(sources);
    let settings = &reduce::complete_settings(sources, settings, run)?;
    let job = Job { sources, settings, out, run, progress, basis: Basis::New, keeps_sums: false };
    let looked = look(&job)?;
    let search = search::begin_search(settings, looked.size.map(|size| size.bytes))?;
    let settings = &search.as_ref().map_or_else(|| settings.clone(), TargetSearch::next_settings);
    let planned = reduce::plan(&Job { settings, ..job }, false)?;
    let search = search.map(|search| PlannedSearch::new(search, shards, &planned.report));
    let asked = Asked { shards, isovalues: isovalues.to_vec(), replaces: existing.is_finished() };
    let file = plan_file(settings, &planned, asked, search)?;
    let mut report = PlanReport::of(&file, &planned, out);
    looked.add_to(&mut report.needs);
    if file.search.is_some() && !run.replace && PlanFile::read(out).is_ok_and(|there| file.is_alike(&there)) {
        // The search may be at a later try.
        return Ok(report);
    }
    reduce::remove_tries(out, PLANNED_TRY, &[])?;
    begin(&file, &planned, out, run)?;
    Ok(report)
}

/// What is asked of a plan.
struct Asked {
    /// The most shards.
    shards: u64,
    /// Whose surfaces are measured when the archive is there.
    isovalues: Vec<FieldValue>,
    /// Whether a finished archive is there.
    replaces: bool,
}

/// The plan of a reduction in parts.
fn plan_file(
    settings: &CompleteSettings,
    planned: &PlannedReduction,
    asked: Asked,
    search: Option<PlannedSearch>,
) -> Result<PlanFile> {
    let Asked { shards, isovalues, replaces } = asked;
    let cut = Cut {
        chunks: planned.parts.chunks.len(),
        // A shard has whole segments: more shards than segments would have nothing to do.
        shards: shards.min(planned.layout(Path::new("")).segment_count()),
        memory_least: planned.estimate.memory_least,
        replaces,
        search,
        isovalues,
    };
    PlanFile::new(settings, &planned.series, cut)
}

/// Makes the place of an archive that is planned, and writes the plan.
fn begin(file: &PlanFile, planned: &PlannedReduction, out: &Path, run: &RunSettings) -> Result<()> {
    let root = file.root(out);
    let layout = planned.layout(&root);
    // Before the plan is there: a worker finds no work of another one.
    Existing::at(&root)?.compare(&root, &file.plan, run)?.make_place(&layout)?;
    file.write(out, run.replace)?;
    planned.begin(&layout)
}

impl PlanReport {
    fn of(file: &PlanFile, planned: &PlannedReduction, out: &Path) -> Self {
        let (needs, segments) = (planned.estimate.clone(), planned.layout(out).segment_count());
        let shard_segments = segments.div_ceil(file.shards);
        Self {
            plan: plan_path(out),
            hash: [file.mesh_hash, file.steps_hash].map(|h| h.to_string()),
            shards: file.shards,
            segments,
            shard_segments,
            shard_seconds: needs.seconds * shard_segments as f64 / segments.max(1) as f64,
            needs,
        }
    }
}

/// What of a plan a job script needs.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct ShardNeeds {
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

/// See [`Shards::needs`].
fn shard_needs(out: &Path, threads: usize) -> Result<ShardNeeds> {
    let file = PlanFile::read(out)?;
    let mesh = mesh_parts(&file.root(out), &file.plan)?;
    let steps = file.plan.steps.len();
    let resources = Resources::default().with_threads(threads);
    let run = RunSettings { resources, ..RunSettings::default() };
    let need = estimate::need_of(&mesh, Held::default(), steps, u64::MAX, &run);
    Ok(ShardNeeds {
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

/// See [`Shards::work`].
fn work_shard(out: &Path, shard: Shard, run: &RunSettings, progress: &dyn Progress) -> Result<WorkReport> {
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
    let job = Job { sources, settings, out, run: &run, progress, basis, keeps_sums: false };
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
    let text =
        "holds an archive that was not made by this plan; plan again with `replace=true` to replace it";
    Err(Error::usage(format!("{} {text}", out.display())))
}

/// What a commit came to.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Committed {
    /// The archive is there.
    Archive(Box<ReduceReport>),
    /// A try of a search for a target is complete, and the next one is planned: it takes workers
    /// and a commit again.
    NextTry(Box<NextTry>),
}

/// A try of a search for a target, and the one after it.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct NextTry {
    /// What the try came to.
    pub target: TargetReport,
    /// The plan of the next one.
    pub next: PlanReport,
}

/// See [`Shards::commit`].
fn commit_shards(out: &Path, run: &RunSettings, progress: &dyn Progress) -> Result<Committed> {
    let _lock = reduce::lock_for_writing(out)?;
    let file = PlanFile::read(out)?;
    expect_no_other_archive(out, &file)?;
    match (commit_plan(&file, out, run, progress)?, file.isovalues.is_empty()) {
        (Committed::Archive(report), false) if !is_measured(&file, &report) => {
            // Workers and tries have looked at them, but not all have looked now.
            file.expect_same_inputs(run)?.check()?;
            let (sources, resources) = (file.numbered(), &run.resources);
            let measured =
                reduce::with_surfaces(*report, out, &sources, &file.isovalues, resources, progress)?;
            Ok(Committed::Archive(Box::new(measured)))
        }
        (committed, _) => Ok(committed),
    }
}

/// Whether the try of a target has measured all surfaces that are asked for.
fn is_measured(file: &PlanFile, report: &ReduceReport) -> bool {
    let target = file.search.as_ref().and_then(|planned| planned.search.settings().target);
    match (target, &file.isovalues[..]) {
        (Some(Target::Surface(target)), [value]) => *value == target.isovalue && !report.surfaces.is_empty(),
        _ => false,
    }
}

/// Makes what workers have left an archive, or plans the next try.
fn commit_plan(file: &PlanFile, out: &Path, run: &RunSettings, progress: &dyn Progress) -> Result<Committed> {
    let started = Instant::now();
    if let Some(planned) = file.search.as_ref().filter(|planned| planned.search.is_over()) {
        let report = search::finish(file, planned, None, out)?;
        return Ok(Committed::Archive(Box::new(report.finished(started))));
    }
    let root = file.root(out);
    let report = publish(file, &root, run, progress, started)?;
    if let Some(planned) = &file.search {
        return search::next(file, planned, report.finished(started), &search::Commit { out, run, progress });
    }
    if root != out {
        reduce::replace_archive(&root, out)?;
    }
    Ok(Committed::Archive(Box::new(report.finished(started))))
}

/// Makes the segments in the folder `root` an archive.
fn publish(
    file: &PlanFile,
    root: &Path,
    run: &RunSettings,
    progress: &dyn Progress,
    started: Instant,
) -> Result<ReduceReport> {
    Inventory::new(root, file).expect_whole(run, progress)?;
    let verified = started.elapsed().as_secs_f64();
    if file.plan.mesh.is_pyramid() {
        return publish_pyramid(file, root, run, progress, verified);
    }
    let parts = mesh_parts(root, &file.plan)?;
    let shares = Need::of(&parts).shares(run.resources.memory, run.resources.worker_threads())?;
    let layout = Layout::new(root, parts.chunks.len(), 0);
    let report = ReduceReport { seconds: vec![(Stage::Verify, verified)], ..planned_report(file) };
    // The vertices of a mesh are read once more, to measure; for a volume, workers have done that.
    let is_read = file.settings.measure && file.plan.first().source.mesh.is_some();
    let watch = if is_read { file.expect_same_inputs(run)? } else { Watch::default() };
    let series = file.series(watch);
    let (sources, settings, basis) = (&file.numbered(), &file.settings, Basis::Plan(file));
    let job = Job { sources, settings, out: root, run, progress, basis, keeps_sums: false };
    let built = Built::of_shards(series, parts, shares, &layout, report)?;
    // What commits and workers of this machine have left that were killed is no part of the
    // archive's bytes.
    reduce::sweep(&layout);
    reduce::publish(built, &job, &layout)
}

/// Makes the coarse levels of a pyramid of what all workers have left, then its ranges.
fn publish_pyramid(
    file: &PlanFile,
    root: &Path,
    run: &RunSettings,
    progress: &dyn Progress,
    verified: f64,
) -> Result<ReduceReport> {
    let run = &RunSettings { replace: false, keep_going: false, ..run.clone() };
    let (sources, settings, basis) = (&file.numbered(), &file.settings, Basis::Plan(file));
    let job = Job { sources, settings, out: root, run, progress, basis, keeps_sums: false };
    let planned = reduce::plan(&job, false)?;
    planned.check()?;
    let layout = planned.layout(root);
    let all = 0..layout.segment_count();
    let mut built = reduce::run(planned, &job, &layout, all)?;
    built.report.seconds.insert(0, (Stage::Verify, verified));
    reduce::sweep(&layout);
    reduce::publish(built, &job, &layout)
}

/// What a plan says for the report of its archive.
fn planned_report(file: &PlanFile) -> ReduceReport {
    let samples = match &file.plan.first().source.mesh {
        Some(mesh) => mesh.vertices,
        None => file.plan.first().source.dims.iter().product(),
    };
    let inner_points = file.search.as_ref().map_or(0, |search| search.inner_points);
    let of_fields = file.numbered().iter().any(|(_, source)| source.part().is_some());
    ReduceReport { samples, inner_points, of_fields, ..ReduceReport::default() }
}

/// The parts of a plan, with what is stored in the archive.
fn mesh_parts(out: &Path, plan: &Plan) -> Result<MeshParts> {
    parts(&plan.mesh, Attachments::read(out, &plan.mesh)?)
}
