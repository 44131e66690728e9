//! From a volume to an archive: plan, work, commit.
//!
//! The archive's folder is filled segment by segment; the manifest comes last. A folder without a manifest is no
//! archive: it is work that the same command continues. A folder with one is never touched unless asked to.

mod advice;
mod append;
mod cached;
mod commit;
mod encode;
pub(super) mod existing;
mod job;
mod mesh;
mod meshes;
mod passes;
mod plan_file;
mod reuse;
mod sink;
mod target;
mod target_max;
mod volumes;
mod workers;

use crate::archive::lock::WriterLock;
use crate::archive::manifest::{MANIFEST_NAME, Manifest, Step};
use crate::archive::{TEMPORARY_MARK, publish};
use crate::bytes::remote::is_remote;
use crate::error::{Error, Result};
use crate::exec::{Progress, Silent};
use crate::formats::{Input, StepSource};
use crate::pipeline::chunk::stored_error;
use crate::pipeline::field::{MeasureSettings, reopened_errors};
use crate::pipeline::plan::{Estimate, Layout, MeshParts, Need, Plan, Question, folder_bytes, parts};
use crate::pipeline::read::{OpenArchive, StepSummary};
use crate::pipeline::settings::{ReduceSettings, RunSettings};
use crate::pipeline::stage::Stage;
pub(super) use advice::look;
pub use advice::{mesh_notices, scan_with_notices};
pub use append::{AppendSettings, append};
use cached::need_with_caches;
use commit::Made;
pub(super) use existing::strays;
pub(super) use job::{Job, Part, finished};
pub use job::{ReduceReport, SourceChunks};
use job::{added_before, push_times};
pub use passes::SkippedStep;
use passes::{Making, Means, PlannedSource};
pub(super) use passes::{Outcome, SeriesPlan, grid_coordinates};
pub(super) use plan_file::{Cut, PlanFile};
use plan_file::{new_archive, old_archive};
pub use plan_file::{plan_path, work_folder};
use std::fs;
use std::path::Path;
use std::time::Instant;
pub use target::TargetReport;
use target::reduce_to_target;
use volumes::{Known, VolumeFields, plan_volumes};

/// Reduces a series of steps to the archive `out`: one mesh, and the values of each step.
///
/// Steps are numbered from 0. With [`RunSettings::keep_going`] one that cannot be used is left out, its number too.
///
/// Where this very archive is there already, nothing is made but what it has lost: so the same call continues a run that was killed at any moment.
///
/// # Errors
/// Those of [`Reduction::write`](crate::Reduction::write); [`Error::BadInput`], naming the step, where dimensions or geometry
/// are not those of the first.
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
    let report = ReduceReport { source_chunks: SourceChunks::of(sources), ..report };
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
        Input::Mesh(_) => mesh::reduce_mesh(job),
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
        return mesh::plan_mesh(job);
    }
    let known = Known { out: Some(job.out), only_estimates, ..Known::default() };
    let mut series = plan_volumes(job.sources, job.settings, job.run, known)?;
    let mesh = parts(&series.plan.mesh, series.attachments.clone())?;
    let need = need_with_caches(&mut series.sources, &mesh, job.run);
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
    let mesh = parts(&series.plan.mesh, series.attachments.clone())?;
    let inner_points = mesh.points.interior_len();
    if let Some(report) = made_before(job, &series, inner_points)? {
        return Ok(finished(report, job.started));
    }
    let samples = series.plan.first().source.samples();
    let seconds = vec![(Stage::Plan, planning.elapsed().as_secs_f64())];
    let need = need_with_caches(&mut series.sources, &mesh, job.run);
    estimate_of(&series.plan, &series.sources, &need, job.out, job.run)?.check()?;
    // Small copies of inputs are made in memory where that leaves as many threads at work.
    let (memory, workers) = (job.run.resources.memory, job.run.resources.worker_threads());
    let rest = memory - PlannedSource::small_copies(&series.sources, need.steps()).min(memory);
    let all = need.shares(memory, workers)?;
    let copied = need.shares(rest, workers).ok().filter(|shares| shares.workers == all.workers);
    let (in_memory, shares) = (copied.is_some(), copied.unwrap_or(all));
    let fields = VolumeFields::new(job.settings, job.run, job.progress, in_memory);
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
            let found = match existing::finished(job.out, &series.plan) {
                // Another one is removed before this one is made.
                Err(_) if job.run.replace => None,
                found => found?,
            };
            let Some(manifest) = found else { return Ok(None) };
            if existing::lacks_files(job.out, &manifest) {
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

/// Makes the archive of a series, or the job's part of it: its segments, then the manifest. Completes the report.
fn produce(
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
        series.attachments.write(job.out, series.plan.mesh_hash())?;
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
            self.run.resources.cancel.check()?;
            let coordinates = outcome.coordinates.filter(|_| made.steps.is_empty());
            made.add_step(plan, n, layout, self.parts, coordinates, self.run)?;
        }
        report.seconds.push((Stage::Commit, committing.elapsed().as_secs_f64()));
        if self.measure {
            let measuring = Instant::now();
            self.measure(series, &mut outcome, &mut made, before)?;
            let seconds = (measuring.elapsed() + outcome.measuring + outcome.times.measure).as_secs_f64();
            report.seconds.push((Stage::Measure, seconds));
        }
        if self.old.is_some_and(|old| Manifest::read(layout.root()).ok().as_ref() != Some(old)) {
            let text = "another run has changed the archive meanwhile: run the same command again";
            return Err(Error::io("add steps to", layout.root(), std::io::Error::other(text)));
        }
        layout.sync()?;
        series.watch.check()?;
        let manifest = made.manifest(plan);
        if existing::lacks_files(layout.root(), &manifest) {
            let text = "another run has removed files meanwhile: run the same command again";
            return Err(Error::io("finish", layout.root(), std::io::Error::other(text)));
        }
        manifest.write(layout.root())?;
        existing::remove_strays(layout.root(), &manifest);
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
        let archive = OpenArchive::of(self.layout.root(), made.manifest(&series.plan))?;
        let mut missing = vec![];
        for (position, source) in (before..).zip(&series.sources) {
            let step = &mut made.steps[position];
            match outcome.errors.remove(&step.plan.number) {
                Some((error, levels)) => (step.error, step.level_errors) = (Some(error), levels),
                None if step.plan.measured => {
                    let (error, levels) = stored_error(&archive.step_at(position))?;
                    (step.error, step.level_errors) = (Some(error), levels);
                }
                None => missing.push((position, &source.source)),
            }
        }
        let errors = reopened_errors(&archive, &missing, &settings, self.progress)?;
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

/// What a reduction would need, without beginning it.
///
/// # Errors
/// Those of [`reduce_series`], but a budget that does not suffice is only reported: see [`Estimate::check`].
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
        existing::finished(out, &series.plan)?;
    }
    estimate.notices = notices;
    Ok(estimate)
}

fn estimate_of(
    plan: &Plan,
    sources: &[PlannedSource],
    need: &Need,
    out: &Path,
    run: &RunSettings,
) -> Result<Estimate> {
    let largest = |of: fn(&PlannedSource) -> u64| sources.iter().map(of).max().unwrap_or(0);
    let scratch = run.resources.scratch_folder();
    Ok(Estimate::new(&Question {
        plan,
        need,
        memory: run.resources.memory,
        threads: run.resources.worker_threads(),
        out,
        there: if out.is_dir() { folder_bytes(out)? } else { 0 },
        scratch: (&scratch, PlannedSource::copied_at_a_time(sources)),
        copying: largest(|s| s.copying),
    }))
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
        Err(_) if is_finished(out) && existing::may_be_of(out, sources, settings) && is_ours(out)? => Ok(()),
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
        Ok(_) if out.join(MANIFEST_NAME).exists() && !run.replace => Err(existing::exists(out)),
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
    match existing::finished(root, plan) {
        Err(e) if !run.replace => Err(e),
        Err(_) => empty(layout),
        Ok(Some(_)) => Ok(()),
        Ok(None) => match existing::other_work(root, plan, run.keep_going) {
            Some(_) if run.replace => empty(layout),
            Some(file) => Err(existing::is_unfinished(root, &file)),
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
