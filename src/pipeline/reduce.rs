//! From a volume to an archive: plan, work, commit.
//!
//! The archive's folder is filled segment by segment; the manifest comes last. A folder without a manifest is no
//! archive: it is work that the same command continues. A folder with one is never touched unless asked to.

use super::cached::need_with_cache;
use super::commit::Made;
use super::gauge::stored_error;
use super::job::{
    Job, Part, ReduceReport, RunSettings, added_before, finished, push_times, scratch_folder, threads,
};
use super::layout::Layout;
use super::measure::{MeasureSettings, reopened_errors};
use super::need::{self, Estimate, Need, Question};
use super::notice::look;
use super::open::{OpenArchive, StepSummary};
use super::placed::write_coordinates;
use super::plan::{MeshParts, Plan, ReduceSettings, parts};
use super::plan_file::{new_archive, old_archive, work_folder};
use super::reduce_mesh;
use super::repair;
use super::series::{Making, Means, Outcome, PlannedSource, SeriesPlan};
use super::steps::StepChoice;
use super::target::reduce_to_target;
use super::volume_series::{Known, VolumeFields, plan_volumes};
use crate::archive::lock::WriterLock;
use crate::archive::manifest::{CoordinateRecord, MANIFEST_NAME, Manifest, Step, unpacked_step};
use crate::archive::{TEMPORARY_MARK, publish};
use crate::bytes::remote::is_remote;
use crate::error::{Error, Result};
use crate::exec::{CancelToken, Progress, Silent};
use crate::formats::{Input, OpenOptions, StepSource};
use crate::grid::IndexBox;
use crate::volume::bricked::BrickedVolume;
use crate::volume::{SlabStream, VolumeInfo, VolumeReader, VolumeSource};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Copies a volume into bricks at `out`, using about `memory` bytes.
///
/// # Errors
/// Those of reading the volume and of writing the file; nothing is left under the name then.
pub fn brick(
    source: VolumeSource,
    out: &Path,
    memory: u64,
    cancel: &CancelToken,
    progress: &dyn Progress,
) -> Result<()> {
    brick_with(BrickedVolume::build, source, out, memory, cancel, progress)
}

/// Whether the file at `out` is the bricked copy of a volume, sample by sample.
///
/// # Errors
/// Those of reading the volume; a file that holds no bricks is none.
pub fn is_bricked(
    source: VolumeSource,
    out: &Path,
    cancel: &CancelToken,
    progress: &dyn Progress,
) -> Result<bool> {
    let Ok(bricks) = BrickedVolume::open(out) else { return Ok(false) };
    progress.begin("compare", source.info().dims.iter().product(), "samples");
    let mut before = 0;
    let stream = Box::new(Stoppable { stream: source.into_stream(), cancel: cancel.clone() });
    bricks.is_copy_of(stream, &mut |done| {
        progress.advance(done - before);
        before = done;
    })
}

/// A function that copies a stream to a file, in so much memory, telling the samples done.
type BuildBricks = fn(Box<dyn SlabStream>, &Path, usize, &mut dyn FnMut(u64)) -> Result<()>;

fn brick_with(
    build: BuildBricks,
    source: VolumeSource,
    out: &Path,
    memory: u64,
    cancel: &CancelToken,
    progress: &dyn Progress,
) -> Result<()> {
    let dims = source.info().dims;
    progress.begin("brick", dims.iter().product(), "samples");
    let mut before = 0;
    let memory = usize::try_from(memory).unwrap_or(usize::MAX);
    let stream = Box::new(Stoppable { stream: source.into_stream(), cancel: cancel.clone() });
    build(stream, out, memory, &mut |done| {
        progress.advance(done - before);
        before = done;
    })
}

/// A stream that ends with [`Error::Cancelled`] when somebody asks to stop.
struct Stoppable {
    stream: Box<dyn SlabStream>,
    cancel: CancelToken,
}

impl SlabStream for Stoppable {
    fn info(&self) -> &VolumeInfo {
        self.stream.info()
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        self.cancel.check()?;
        self.stream.next_slab(out)
    }
}

/// Reduces the volume or mesh `input` to the archive `out`.
///
/// # Errors
/// [`Error::Usage`] when there is another archive already, [`Error::BadInput`] for a volume that cannot be used,
/// [`Error::Budget`] when the memory does not suffice for one chunk, [`Error::Cancelled`] when stopped: the same call continues.
pub fn reduce(
    input: &Path,
    options: &OpenOptions,
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<ReduceReport> {
    reduce_series(&[StepSource::new(input, options)], settings, out, run, progress)
}

/// Reduces a series of steps to the archive `out`: one mesh, and the values of each step.
///
/// Steps are numbered from 0. With [`RunSettings::keep_going`] one that cannot be used is left out, its number too.
///
/// Where this very archive is there already, nothing is made but what it has lost: so the same call continues a run that was killed at any moment.
///
/// # Errors
/// Those of [`reduce`]; [`Error::BadInput`], naming the step, where dimensions or geometry are not those of the first.
pub fn reduce_series(
    sources: &[StepSource],
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<ReduceReport> {
    let started = Instant::now();
    let _lock = lock_for_writing(out)?;
    refuse_finished(out, sources, settings, run)?;
    let sources = &numbered(sources);
    let job = Job { sources, settings, out, run, progress, started, part: Part::Whole, round: None };
    let looked = look(&job, false)?;
    let report = match settings.target {
        Some(target) => reduce_to_target(&job, target, looked.size.map(|s| s.bytes)),
        None if run.replace && is_finished(out) => replace(&job),
        None => make(&job),
    }?;
    Ok(looked.complete(&sources[0].1.path, report, &job))
}

/// Makes an archive beside the finished one of its name, which is whole until then, and puts it there.
fn replace(job: &Job<'_>) -> Result<ReduceReport> {
    let new = new_archive(job.out);
    let report = make(&Job { out: &new, ..*job })?;
    replace_archive(&new, job.out)?;
    Ok(ReduceReport { made_before: false, ..report })
}

/// Locks an archive that is to be written. One that was being replaced when a run was killed is there again.
pub(super) fn lock_for_writing(out: &Path) -> Result<WriterLock> {
    refuse_remote(out)?;
    refuse_name(out)?;
    let lock = WriterLock::acquire(out)?;
    publish::restore_folder(out, &old_archive(out))?;
    Ok(lock)
}

/// Whether there is a finished archive of this name on this machine.
pub(super) fn is_finished(out: &Path) -> bool {
    !is_remote(out) && out.join(MANIFEST_NAME).exists()
}

/// Puts a new archive in the place of the one of its name, which was whole until then.
pub(super) fn replace_archive(new: &Path, out: &Path) -> Result<()> {
    publish::replace_folder(new, out, &old_archive(out))?;
    // There may be a plan, or logs.
    let _ = fs::remove_dir(work_folder(out));
    Ok(())
}

/// Steps with their numbers.
pub(super) fn numbered(sources: &[StepSource]) -> Vec<(u64, StepSource)> {
    (0..).zip(sources.iter().cloned()).collect()
}

/// Opens the input of a job and does its part.
pub(super) fn make(job: &Job<'_>) -> Result<ReduceReport> {
    match first_input(job.sources, job.run)? {
        Input::Volume(_) => reduce_volumes(job),
        Input::Mesh(_) => reduce_mesh::reduce_mesh(job),
    }
}

/// The first source that can be opened: it tells whether the series is one of volumes or of meshes.
fn first_input(sources: &[(u64, StepSource)], run: &RunSettings) -> Result<Input> {
    let mut first_error = None;
    for (_, source) in sources {
        match source.open() {
            Err(e) if run.keep_going => _ = first_error.get_or_insert(e),
            other => return other,
        }
    }
    Err(first_error.unwrap_or_else(|| Error::usage("there is no step to reduce")))
}

/// Makes the plan of a job, and of the mesh what follows from it; tells what the job needs. Makes no segment.
pub(super) fn make_plan(job: &Job<'_>, only_estimates: bool) -> Result<(SeriesPlan, MeshParts, Estimate)> {
    if let Input::Mesh(_) = first_input(job.sources, job.run)? {
        return reduce_mesh::plan_mesh(job);
    }
    let known = Known { out: Some(job.out), only_estimates, ..Known::default() };
    let mut series = plan_volumes(job.sources, job.settings, job.run, known)?;
    let mesh = parts(&series.plan.mesh, series.beside.clone())?;
    let (need, _) = need_with_cache(&mut series, &mesh, job.run)?;
    let estimate = estimate_of(&series.plan, &series.sources, &need, job.out, job.run)?;
    Ok((series, mesh, estimate))
}

pub(super) fn reduce_volumes(job: &Job<'_>) -> Result<ReduceReport> {
    let planning = Instant::now();
    let known = Known {
        planned: job.part.planned(),
        archive: job.part.archive(),
        out: Some(job.out),
        round: job.round,
        files: job.part.planned_files(),
        only_estimates: false,
    };
    let mut series = plan_volumes(job.sources, job.settings, job.run, known)?;
    job.part.expect_planned(&series)?;
    let mesh = parts(&series.plan.mesh, series.beside.clone())?;
    let inner_points = mesh.points.interior_len();
    if let Some(report) = made_before(job, &series, inner_points)? {
        return Ok(finished(report, job.started));
    }
    let samples = series.plan.first().source.samples();
    let seconds = vec![("plan".to_owned(), planning.elapsed().as_secs_f64())];
    let (need, cached) = need_with_cache(&mut series, &mesh, job.run)?;
    estimate_of(&series.plan, &series.sources, &need, job.out, job.run)?.check()?;
    // Small copies of inputs are made in memory where that leaves as many threads at work.
    let (memory, workers) = (job.run.memory, threads(job.run));
    let rest = memory - PlannedSource::small_copies(&series.sources, need.steps()).min(memory);
    let all = need.shares(memory, workers)?;
    let copied = need.shares(rest, workers).ok().filter(|shares| shares.workers == all.workers);
    let (in_memory, shares) = (copied.is_some(), copied.unwrap_or(all));
    let fields = VolumeFields::new(job.settings, job.run, job.progress, in_memory, cached);
    let bound = series.bound;
    let report = ReduceReport { samples, seconds, inner_points, bound, ..ReduceReport::default() };
    produce(job, series, &Means { parts: &mesh, fields: &fields, shares, at_once: need.steps() }, report)
}

/// What there is to report when all that a job is to make is there already.
pub(super) fn made_before(
    job: &Job<'_>,
    series: &SeriesPlan,
    inner_points: u64,
) -> Result<Option<ReduceReport>> {
    match job.part {
        Part::Further(archive) => added_before(archive, series),
        Part::Whole => {
            let found = match repair::finished(job.out, &series.plan) {
                // Another one is removed before this one is made.
                Err(_) if job.run.replace => None,
                found => found?,
            };
            let Some(manifest) = found else { return Ok(None) };
            if repair::lacks_files(job.out, &manifest) {
                return Ok(None);
            }
            let layout = Layout::new(job.out, manifest.counts.chunks, 0);
            sweep(&layout);
            let samples = series.plan.first().source.samples();
            let report = ReduceReport { samples, inner_points, made_before: true, ..ReduceReport::default() };
            completed(&Made::of(&manifest), 0, series, &layout, report).map(Some)
        }
        Part::Shard(..) => Ok(None),
    }
}

/// Steps whose files are open, and whose values are made, at a time.
pub(super) const MOST_STEPS_AT_ONCE: u64 = 32;
/// The same where there are no more points than this: to make their mesh again, or to decode it, is then a large part of the cost.
pub(super) const MOST_SMALL_STEPS_AT_ONCE: u64 = 64;
const FEW_POINTS: u64 = 1 << 16;

/// What the chunks need beside `held` bytes, with as many steps at a time as the memory allows.
pub(super) fn need_of(parts: &MeshParts, held: u64, steps: usize, memory: u64, run: &RunSettings) -> Need {
    let few = parts.points.len() <= FEW_POINTS;
    let most = if few { MOST_SMALL_STEPS_AT_ONCE } else { MOST_STEPS_AT_ONCE };
    Need::of(parts).holding(held).with_steps(steps as u64, most, memory, threads(run))
}

/// Makes the archive of a series, or the job's part of it: its segments, then the manifest. Completes the report.
pub(super) fn produce(
    job: &Job<'_>,
    mut series: SeriesPlan,
    means: &Means<'_>,
    mut report: ReduceReport,
) -> Result<ReduceReport> {
    let layout = Layout::new(job.out, means.parts.chunks.len(), 0);
    let old = job.part.archive().map(|archive| &archive.manifest);
    if old.is_none() {
        if matches!(job.part, Part::Whole) {
            prepare_folder(&layout, &series.plan, job.run)?;
        }
        layout.make_folders()?;
        series.beside.write(job.out, series.plan.mesh_hash())?;
    }
    let making = Making {
        means,
        layout: &layout,
        segments: job.part.segments(&layout),
        old,
        before: job.round.map(|round| &round.before),
        measure: job.settings.measure && !matches!(job.part, Part::Shard(..)),
        run: job.run,
        progress: job.progress,
    };
    let made = making.make(&mut series)?;
    push_times(&mut report.seconds, &made);
    report.taken_chunks = made.taken;
    if let Part::Shard(..) = job.part {
        layout.sync()?;
        return Ok(ReduceReport { points: making.points(), ..report });
    }
    let publishing = Publishing {
        parts: means.parts,
        layout: &layout,
        old,
        measure: job.settings.measure,
        workers: means.shares.workers,
        run: job.run,
        progress: job.progress,
    };
    let report = publishing.publish(&series, made, report)?;
    // What earlier runs that were killed have left. Where others may be at work, gc removes it.
    sweep(&layout);
    Ok(finished(report, job.started))
}

/// Copies the coordinates that a grid has of its own into the archive; a mesh has its positions in the world by itself.
pub(super) fn grid_coordinates(series: &SeriesPlan, layout: &Layout) -> Result<Option<CoordinateRecord>> {
    let (source, step) = (&series.sources[0].source, series.plan.first());
    if step.source.mesh.is_some() {
        return Ok(None);
    }
    write_coordinates(source, &series.plan, layout)
}

/// How an archive is made of segments that are all there.
pub(super) struct Publishing<'a> {
    pub(super) parts: &'a MeshParts,
    pub(super) layout: &'a Layout,
    /// The archive that steps are added to.
    pub(super) old: Option<&'a Manifest>,
    /// Whether steps are measured against their sources, which are opened again for those that were not yet.
    pub(super) measure: bool,
    pub(super) workers: usize,
    pub(super) run: &'a RunSettings,
    pub(super) progress: &'a dyn Progress,
}

impl Publishing<'_> {
    /// Index, spectrum and error of each step, then the manifest. Completes the report.
    pub(super) fn publish(
        &self,
        series: &SeriesPlan,
        mut outcome: Outcome,
        mut report: ReduceReport,
    ) -> Result<ReduceReport> {
        let (plan, layout, committing) = (&series.plan, self.layout, Instant::now());
        let mut made = match self.old {
            Some(manifest) => Made::of(manifest),
            None => Made::of_segments(plan, self.parts, layout)?,
        };
        let before = made.steps.len();
        for n in 0..plan.steps.len() {
            self.run.cancel.check()?;
            let coordinates = outcome.coordinates.filter(|_| made.steps.is_empty());
            made.add_step(plan, n, layout, self.parts, coordinates, self.run)?;
        }
        report.seconds.push(("commit".into(), committing.elapsed().as_secs_f64()));
        if self.measure {
            let measuring = Instant::now();
            self.measure(series, &mut outcome, &mut made, before)?;
            let seconds = (measuring.elapsed() + outcome.measuring + outcome.times.measure).as_secs_f64();
            report.seconds.push(("measure".into(), seconds));
        }
        if self.old.is_some_and(|old| Manifest::read(layout.root()).ok().as_ref() != Some(old)) {
            let text = "another run has changed the archive meanwhile: run the same command again";
            return Err(Error::io("add steps to", layout.root(), std::io::Error::other(text)));
        }
        layout.sync()?;
        series.watch.check()?;
        let manifest = made.manifest(plan);
        if repair::lacks_files(layout.root(), &manifest) {
            let text = "another run has removed files meanwhile: run the same command again";
            return Err(Error::io("finish", layout.root(), std::io::Error::other(text)));
        }
        manifest.write(layout.root())?;
        repair::remove_strays(layout.root(), &manifest);
        completed(&made, before, series, layout, report)
    }

    /// Notes the errors of the steps from position `before` on: adds up what chunks have stored; measures the steps of a mesh that were
    /// made by an earlier run.
    fn measure(
        &self,
        series: &SeriesPlan,
        outcome: &mut Outcome,
        made: &mut Made,
        before: usize,
    ) -> Result<()> {
        let settings = MeasureSettings::of_run(self.run, self.workers);
        let mut archive =
            OpenArchive::of(self.layout.root(), made.manifest(&series.plan), StepChoice::First)?;
        let mut missing = vec![];
        for (position, source) in (before..).zip(&series.sources) {
            let step = &mut made.steps[position];
            match outcome.errors.remove(&step.plan.number) {
                Some((error, levels)) => (step.error, step.level_errors) = (Some(error), levels),
                None if step.plan.measured => {
                    archive.turn_to(position);
                    let (error, levels) = stored_error(&archive)?;
                    (step.error, step.level_errors) = (Some(error), levels);
                }
                None => missing.push((position, &source.source)),
            }
        }
        let errors = reopened_errors(&mut archive, &missing, &settings, self.progress)?;
        for ((position, _), (error, levels)) in missing.into_iter().zip(errors) {
            (made.steps[position].error, made.steps[position].level_errors) = (Some(error), levels);
        }
        Ok(())
    }
}

/// Completes the report of an archive whose steps from position `before` on are new.
fn completed(
    made: &Made,
    before: usize,
    series: &SeriesPlan,
    layout: &Layout,
    report: ReduceReport,
) -> Result<ReduceReport> {
    let steps = &made.steps[before..];
    let ranges = steps.iter().filter_map(Step::told_range);
    let own = series.plan.mesh.own.is_some();
    Ok(ReduceReport {
        own,
        points: made.counts.points,
        void_points: steps.iter().map(|s| s.void_points).sum(),
        tetrahedra: made.counts.tetrahedra,
        chunks: made.counts.chunks,
        blocks: made.counts.blocks,
        // No halo was made of a mesh's own tetrahedra.
        halo_retries: if own { 0 } else { made.halo_retries },
        grid_cells: made.steps[0].coordinates.map(|c| c.cells),
        range: ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]),
        quantiser: series.plan.first().told_quantiser(),
        error: steps[0].error.clone(),
        steps: steps.iter().map(StepSummary::of).collect(),
        skipped: series.skipped.clone(),
        archive_bytes: folder_bytes(layout.root())?,
        ..report
    })
}

/// Removes what earlier runs that were killed have left.
pub(super) fn sweep(layout: &Layout) {
    let folders = [layout.root().to_path_buf(), layout.mesh_folder(), layout.steps_folder()];
    folders.iter().for_each(|folder| publish::sweep(folder));
}

/// Tells what a reduction would need, without beginning it.
///
/// # Errors
/// As [`reduce`], but a budget that does not suffice is only told of: see [`Estimate::check`].
pub fn estimate(
    input: &Path,
    options: &OpenOptions,
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
) -> Result<Estimate> {
    estimate_series(&[StepSource::new(input, options)], settings, out, run)
}

/// As [`estimate`], of a series.
///
/// # Errors
/// As [`estimate`].
pub fn estimate_series(
    sources: &[StepSource],
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
) -> Result<Estimate> {
    refuse_finished(out, sources, settings, run)?;
    if settings.target.is_some_and(|t| t.bound().is_none() || settings.adapt.is_none()) {
        let what = "how many points meet this target is found by trying: estimate a count or a fraction";
        return Err(Error::usage(what));
    }
    let (sources, progress, started) = (&numbered(sources), &Silent, Instant::now());
    let job = Job { sources, settings, out, run, progress, started, part: Part::Whole, round: None };
    let notices = look(&job, false)?.notices;
    // One that is there is compared with, in all that decides its bytes.
    let is_compared = !run.replace && is_finished(out);
    let (series, _, mut estimate) = make_plan(&job, !is_compared)?;
    if is_compared {
        repair::finished(out, &series.plan)?;
    }
    estimate.notices = notices;
    Ok(estimate)
}

pub(super) fn estimate_of(
    plan: &Plan,
    sources: &[PlannedSource],
    need: &Need,
    out: &Path,
    run: &RunSettings,
) -> Result<Estimate> {
    let largest = |of: fn(&PlannedSource) -> u64| sources.iter().map(of).max().unwrap_or(0);
    let scratch = scratch_folder(run);
    Ok(Estimate::new(&Question {
        plan,
        need,
        memory: run.memory,
        threads: threads(run),
        out,
        there: if out.is_dir() { folder_bytes(out)? } else { 0 },
        scratch: (&scratch, PlannedSource::copied_at_a_time(sources)),
        copying: largest(|s| s.copying),
    }))
}

/// Bytes of the copy that is made of a volume without random access, and memory to make it in; 0 of others.
pub(super) fn copy_bytes(source: &VolumeSource) -> (u64, u64) {
    match source {
        VolumeSource::Random(_) => (0, 0),
        VolumeSource::Stream(stream) => {
            let info = stream.info();
            // Bricks at the border are padded, and each has a checksum.
            let samples = info.dims.iter().map(|&d| d as f64).product::<f64>();
            let bytes = (samples * info.field.scalar.bytes() as f64 * 1.1) as u64 + (1 << 20);
            (bytes, copying_bytes(&**stream) + COPY_BUFFER)
        }
    }
}

/// The least that slices are collected in while a stream is copied into bricks.
const COPY_BUFFER: u64 = 8 << 20;

/// Memory that copying a stream into bricks takes, beside the slices that are collected: the decoder, a checksum a brick.
fn copying_bytes(stream: &dyn SlabStream) -> u64 {
    let bricks = stream.info().dims.iter().map(|d| d.div_ceil(32)).fold(1, u64::saturating_mul);
    need::BASE.saturating_add(stream.working_bytes()).saturating_add(bricks.saturating_mul(8))
}

/// Object stores and web servers are read only.
pub(super) fn refuse_remote(out: &Path) -> Result<()> {
    if is_remote(out) {
        let text = "archives are written on disk; copy the folder to the server afterwards";
        return Err(Error::usage(format!("{}: {text}", out.display())));
    }
    Ok(())
}

/// Refuses a name that no archive has.
fn refuse_name(out: &Path) -> Result<()> {
    if out.extension().is_none_or(|e| e != "isospan") {
        return Err(Error::usage(format!("{}: an archive's name ends in .isospan", out.display())));
    }
    match fs::metadata(out) {
        Ok(m) if !m.is_dir() => {
            Err(Error::usage(format!("{} exists and is not an archive; choose another name", out.display())))
        }
        _ => Ok(()),
    }
}

/// As [`refuse_overwriting`], but for an archive that may be the one that is to be made: the plan will tell.
fn refuse_finished(
    out: &Path,
    sources: &[StepSource],
    settings: &ReduceSettings,
    run: &RunSettings,
) -> Result<()> {
    match refuse_overwriting(out, run) {
        Err(_) if is_finished(out) && repair::may_be_of(out, sources, settings) && is_ours(out)? => Ok(()),
        other => other,
    }
}

/// Folders and files that are not ours are never touched; an archive only when asked to.
pub(super) fn refuse_overwriting(out: &Path, run: &RunSettings) -> Result<()> {
    refuse_remote(out)?;
    refuse_name(out)?;
    let shown = out.display();
    match fs::metadata(out) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(Error::io("look at", out, e)),
        Ok(_) if out.join(MANIFEST_NAME).exists() && !run.replace => Err(repair::exists(out)),
        Ok(_) if !is_ours(out)? => {
            Err(Error::usage(format!("{shown} exists and holds other files; choose another name")))
        }
        Ok(_) => Ok(()),
    }
}

/// Whether a folder holds nothing but what archives have.
pub(super) fn is_ours(out: &Path) -> Result<bool> {
    let ours = ["mesh", "steps", MANIFEST_NAME];
    for entry in fs::read_dir(out).map_err(|e| Error::io("list", out, e))? {
        let name = entry.map_err(|e| Error::io("list", out, e))?.file_name();
        let name = name.to_string_lossy();
        if !ours.contains(&&*name) && !name.contains(TEMPORARY_MARK) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Empties the folder of an archive that is to be made, where it holds another one, or the work on another one;
/// segments of this plan stay.
///
/// # Errors
/// [`Error::Usage`] where that was not asked for.
pub(super) fn prepare_folder(layout: &Layout, plan: &Plan, run: &RunSettings) -> Result<()> {
    let root = layout.root();
    match repair::finished(root, plan) {
        Err(e) if !run.replace => Err(e),
        Err(_) => empty(layout),
        Ok(Some(_)) => Ok(()),
        Ok(None) => match repair::other_work(root, plan, run.keep_going) {
            Some(_) if run.replace => empty(layout),
            Some(file) => Err(repair::is_unfinished(root, &file)),
            None => Ok(()),
        },
    }
}

/// Removes what an archive consists of, its manifest first.
fn empty(layout: &Layout) -> Result<()> {
    let manifest = layout.root().join(MANIFEST_NAME);
    match fs::remove_file(&manifest) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            return Err(Error::io("remove", &manifest, e));
        }
        _ => {}
    }
    [layout.mesh_folder(), layout.steps_folder()].iter().try_for_each(|f| publish::remove_folder(f))
}

/// A stream is copied into bricks first; the copy is removed when the second value is dropped.
pub(super) fn random_access(
    source: VolumeSource,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<(Box<dyn VolumeReader>, Option<Scratch>)> {
    let room = match source {
        VolumeSource::Random(reader) => return Ok((reader, None)),
        VolumeSource::Stream(ref stream) => run.memory.saturating_sub(copying_bytes(&**stream)),
    };
    let folder = scratch_folder(run);
    // What runs that were killed while they copied have left.
    publish::sweep(&folder);
    let scratch = Scratch::new(&folder);
    brick_with(BrickedVolume::build_scratch, source, &scratch.0, room / 2, &run.cancel, progress)?;
    let reader = BrickedVolume::open(&scratch.0)?;
    // An open file without a name is gone with the process, however that ends.
    #[cfg(unix)]
    scratch.remove();
    Ok((Box::new(reader), Some(scratch)))
}

/// A file that is removed in the end.
pub(super) struct Scratch(PathBuf);

impl Scratch {
    fn new(folder: &Path) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Self(folder.join(format!(
            "isospan-scratch-{}-{}-{number}.bricks",
            publish::host(),
            std::process::id()
        )))
    }

    fn remove(&self) {
        // Not there: removed before, or never made.
        let _ = fs::remove_file(&self.0);
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        self.remove();
    }
}

/// Bytes of all files below a folder, but for unpacked blocks, which are no part of an archive.
pub(super) fn folder_bytes(folder: &Path) -> Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder).map_err(|e| Error::io("list", folder, e))? {
        let entry = entry.map_err(|e| Error::io("list", folder, e))?;
        let meta = entry.metadata().map_err(|e| Error::io("look at", entry.path(), e))?;
        bytes += match meta.is_dir() {
            true => folder_bytes(&entry.path())?,
            false if unpacked_step(&entry.file_name().to_string_lossy()).is_some() => 0,
            false => meta.len(),
        };
    }
    Ok(bytes)
}
