//! From inputs to an archive: plan, run, publish.
//!
//! ```text
//!  reduce_series ─▶ Existing::at ─▶ plan(job) ─▶ Planned ─▶ run ─▶ Built ─▶ publish
//!  append                          what decides    segment by      index, spectrum,
//!  targets, shards                 the bytes       segment         then the manifest
//! ```
//!
//! All of these make an archive in the same three calls. A folder without a manifest is no archive:
//! it is work that the same command continues. A folder with one is never touched unless asked to.

mod advice;
mod append;
mod arrange;
mod build;
mod cached;
mod changed;
mod coarse;
mod contents;
mod copy;
mod encode;
mod encoded;
mod existing;
mod fields;
mod job;
mod kept_search;
mod labels;
mod made_before;
mod mesh_fields;
mod mesh_store;
mod meshes;
mod order;
mod plan_file;
mod planned;
mod publish;
mod pyramid;
mod report;
mod reuse;
mod search;
mod series;
mod share;
mod sink;
mod source;
mod sums;
mod surfaces;
mod target;
mod target_max;
mod tries;
mod volume_fields;
mod volumes;
mod workers;

use crate::pipeline::inputs::scan;
use crate::pipeline::plan::Estimate;
use crate::pipeline::settings::{CompleteSettings, Focus, InputFacts, ReduceSettings, RunSettings, Target};
pub(super) use advice::look;
pub use advice::{header_notices, mesh_notices, scan_with_notices};
pub(super) use append::{AppendSettings, append};
pub use changed::changed_sources;
pub use copy::{CopiedFile, copy_archive};
use existing::NewFolders;
pub use existing::archive_files;
pub(super) use existing::{Existing, lock_for_writing, replace_archive, strays, sweep};
use isospan_io::cells::scan::scan_field;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Silent};
use isospan_io::formats::{Input, StepSource};
use isospan_io::setting::Setting;
use isospan_io::volume::units::Units;
use isospan_mesh::points::SetKind;
pub(super) use job::{Basis, Job};
use kept_search::{forget_search, forget_unbegun};
use plan_file::new_archive;
pub(super) use plan_file::{Cut, PLANNED_TRY, PlanFile, PlannedSearch, planned_try};
pub use plan_file::{plan_path, work_folder};
pub(super) use planned::{Built, Planned, plan, publish, run};
use planned::{first_that_opens, make};
pub use report::{ReduceReport, SourceChunks, TargetReport};
pub use search::NO_SURFACE;
pub(super) use search::TargetSearch;
pub use series::SkippedStep;
use std::path::Path;
use std::time::Instant;
pub(super) use sums::FinishedSteps;
use surfaces::in_world;
pub(super) use surfaces::{expect_surfaces, measured_isovalues, with_surface_of, with_surfaces};
use target::reduce_to_target;
pub(super) use target::{publish_best, with_target};
pub(super) use tries::remove_tries;
use volumes::pyramid_bytes;

/// Reduces a series of steps to the archive `out`: one mesh, and the values of each step.
///
/// Steps are numbered from 0. With [`RunSettings::keep_going`] one that cannot be used is left out,
/// its number too.
///
/// Where this very archive is there already, nothing is made but what it has lost. So the same call
/// continues a run that was killed at any moment.
///
/// # Errors
/// Those of [`Reduction::write`](crate::Reduction::write); [`BadInput`](crate::Error::BadInput),
/// naming the step, where dimensions or geometry are not those of the first.
pub fn reduce_series(
    sources: &[StepSource],
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<ReduceReport> {
    let started = Instant::now();
    let _lock = lock_for_writing(out)?;
    let existing = Existing::at(out)?;
    let sources = &numbered(sources);
    let settings = &complete_settings(sources, settings, run)?;
    let job = Job { sources, settings, out, run, progress, basis: Basis::New, keeps_sums: false };
    existing.refuse_other(&job)?;
    let new_folders = NewFolders::of(out);
    let made = make_series(&job, &existing);
    if made.is_err() {
        forget_unbegun(out);
        new_folders.remove_empty();
    }
    Ok(made?.finished(started))
}

/// Looks at the sources of a job, and makes its archive.
fn make_series(job: &Job<'_>, existing: &Existing) -> Result<ReduceReport> {
    let Job { sources, settings, out, run, .. } = *job;
    let looked = look(job)?;
    let report = match settings.target {
        Some(target) if target.is_met_by_corrections(settings) => corrected(job, existing, target),
        Some(target) => reduce_to_target(job, existing, target, looked.size.map(|s| s.bytes)),
        None if run.replace && existing.is_finished() => replace(job),
        None => make(job, existing),
    }?;
    // The archive is there: a search for another one, which was stopped, is of no use.
    forget_search(out)?;
    let report = ReduceReport { source_chunks: SourceChunks::of(sources), ..report };
    Ok(looked.complete(&sources[0].1.path, report, job))
}

/// Makes a pyramid whose samples are corrected as a target asks for.
fn corrected(job: &Job<'_>, existing: &Existing, target: Target) -> Result<ReduceReport> {
    target.check(job.settings)?;
    target::expect_for_fields(job, target)?;
    let report = match job.run.replace && existing.is_finished() {
        true => replace(job),
        false => make(job, existing),
    }?;
    let found = target.report_of(&report, None, None)?;
    Ok(ReduceReport {
        target: Some(TargetReport { tries: u32::from(!report.made_before), ..found }),
        ..report
    })
}

/// The settings of a reduction with what they imply for its sources.
///
/// # Errors
/// Those of [`ReduceSettings::complete`], and of opening the first source, whose kind decides the
/// point set: one that is left out is followed by the next.
pub(super) fn complete_settings(
    sources: &[(u64, StepSource)],
    settings: &ReduceSettings,
    run: &RunSettings,
) -> Result<CompleteSettings> {
    let open = |source: &StepSource| Ok((source.open()?, source.clone()));
    let (first, source) = first_that_opens(sources, run.keep_going, open)?;
    let target =
        settings.target.map(|target| in_world(target, &first, &source, &Units::default())).transpose()?;
    let settings = &ReduceSettings { target, ..settings.clone() };
    let is_mesh = matches!(first, Input::Mesh(_));
    let is_labels = matches!(&first, Input::Volume(volume) if volume.info().is_labels);
    let range = if settings.focus.is_some_and(Focus::is_of_a_range) {
        if settings.missing.is_some() {
            return Err(Error::usage(format!(
                "a {} in % does not go with {}: give the values",
                Setting::Focus,
                Setting::Missing
            )));
        }
        range_of(first)?
    } else {
        None
    };
    settings.complete(&InputFacts { is_mesh, is_labels, range })
}

/// Least and largest value of an input.
fn range_of(input: Input) -> Result<Option<[f64; 2]>> {
    let (min, max) = match input {
        Input::Volume(volume) => {
            let (_, found) = scan(volume)?;
            (found.min, found.max)
        }
        Input::Mesh(mesh) => {
            let chosen = mesh.field()?;
            let field = mesh.info().fields.iter().position(|f| f.name == chosen.name).unwrap_or(0);
            let found = scan_field(&mesh, field)?;
            (found.min, found.max)
        }
    };
    Ok(min.zip(max).map(|(lo, hi)| [lo, hi]))
}

/// Makes an archive next to the finished one of its name, which is whole until then, and puts it
/// there.
fn replace(job: &Job<'_>) -> Result<ReduceReport> {
    let new = new_archive(job.out);
    let report = make(&Job { out: &new, ..*job }, &Existing::at(&new)?)?;
    replace_archive(&new, job.out)?;
    Ok(ReduceReport { made_before: false, ..report })
}

/// Steps with their numbers.
pub(super) fn numbered(sources: &[StepSource]) -> Vec<(u64, StepSource)> {
    (0..).zip(StepSource::holding_together(sources.to_vec())).collect()
}

/// What a reduction would need, without beginning it: of a search for a target, its first try, and
/// what is known of the others.
///
/// # Errors
/// Those of [`reduce_series`], but a budget that does not suffice is only reported: see
/// [`Estimate::check`].
pub fn estimate_series(
    sources: &[StepSource],
    settings: &ReduceSettings,
    out: &Path,
    run: &RunSettings,
) -> Result<Estimate> {
    let existing = Existing::at(out)?;
    let (sources, progress) = (&numbered(sources), &Silent);
    let settings = &complete_settings(sources, settings, run)?;
    let job = Job { sources, settings, out, run, progress, basis: Basis::New, keeps_sums: false };
    existing.refuse_other(&job)?;
    let looked = look(&job)?;
    let source = looked.size.map(|size| size.bytes);
    let is_pyramid = settings.points == SetKind::Pyramid;
    let is_searched = |target: &Target| !is_pyramid || matches!(target, Target::Surface(_));
    let searched = settings.target.filter(is_searched);
    let search = searched.map(|target| TargetSearch::new(settings, target, source)).transpose()?;
    // Of a search, the first try is estimated.
    let settings = &search.as_ref().map_or_else(|| settings.clone(), TargetSearch::next_settings);
    let job = Job { settings, ..job };
    // A finished archive is compared with, in all that decides its bytes.
    let is_compared = !run.replace && existing.is_finished() && settings.target.is_none();
    let mut planned = plan(&job, !is_compared)?;
    if is_compared {
        existing.compare(out, &planned.series.plan, run)?;
    }
    let samples = planned.report.samples;
    if is_pyramid {
        let wanted = match settings.target {
            Some(target @ (Target::Size(_) | Target::Ratio(_))) => target.bytes(source)? as u64,
            _ => pyramid_bytes(&job, &planned.series.plan)?,
        };
        planned.estimate.archive_bytes = wanted;
    }
    planned.estimate.search = search.map(|search| search.estimate(&planned.estimate, samples)).transpose()?;
    looked.add_to(&mut planned.estimate);
    Ok(planned.estimate)
}
