//! A search for a target by shards: each try is a plan of its own. The commit of a try plans the
//! next one, or publishes the best of all.

use super::{Asked, Committed, NextTry, PlanReport, begin, plan_file, planned_report};
use crate::archive::manifest::Manifest;
use crate::pipeline::reduce::{
    self, Basis, Existing, Job, PLANNED_TRY, PlanFile, PlannedSearch, ReduceReport, TargetSearch, planned_try,
};
use crate::pipeline::settings::{CompleteSettings, RunSettings, Target};
use isospan_io::error::{Error, Result};
use isospan_io::exec::Progress;
use std::path::Path;

/// The search that some settings ask for, if they do. `source` is the number of bytes of the
/// source, if known.
///
/// # Errors
/// [`Error::Usage`] for a target that shards do not meet.
pub(super) fn begin_search(settings: &CompleteSettings, source: Option<u64>) -> Result<Option<TargetSearch>> {
    let Some(target) = settings.target else { return Ok(None) };
    if let (Target::Max(_), true) = (target, settings.adapt.is_some()) {
        return Err(Error::usage(
            "a largest error with points that adapt is met by one process: use isospan reduce",
        ));
    }
    if target.is_met_by_corrections(settings) {
        return target.check(settings).map(|()| None);
    }
    TargetSearch::new(settings, target, source).map(Some)
}

/// How a commit is made.
pub(super) struct Commit<'a> {
    pub(super) out: &'a Path,
    pub(super) run: &'a RunSettings,
    pub(super) progress: &'a dyn Progress,
}

/// Notes the report of a try that is complete. Plans the next one, or publishes the best.
pub(super) fn next(
    file: &PlanFile,
    planned: &PlannedSearch,
    report: ReduceReport,
    commit: &Commit<'_>,
) -> Result<Committed> {
    let &Commit { out, run, progress } = commit;
    let (mut search, made) = (planned.search.clone(), planned.search.next_try());
    let (sources, asked) = (&file.numbered(), search.settings().target);
    let basis = Basis::Try(file);
    let job = Job { sources, settings: &file.settings, out, run, progress, basis, keeps_sums: false };
    let report = match asked {
        Some(target) => reduce::with_surface_of(target, report, &planned_try(out, made), &job)?,
        None => report,
    };
    let target = search.note(&report)?;
    let best = search.best_try();
    if search.is_over() {
        let number = best.expect("the last try is the best if no other is");
        let manifest = Manifest::read(&planned_try(out, number))?;
        let settings = search.best_settings().expect("there is a best try").clone();
        let planned = PlannedSearch { search, ..planned.clone() };
        let file = file.of_best(planned.clone(), settings, &manifest);
        // From now on the same commit goes on here.
        file.write(out, true)?;
        let report = Some(report).filter(|_| number == made);
        return finish(&file, &planned, report, out).map(|report| Committed::Archive(Box::new(report)));
    }
    let settings = &search.next_settings();
    let run = &RunSettings { replace: true, keep_going: false, ..run.clone() };
    let root = &planned_try(out, search.next_try());
    let job = Job { settings, out: root, run, ..job };
    let reduction = reduce::plan(&job, false)?;
    let search = PlannedSearch::new(search, planned.shards, &reduction.report);
    let (isovalues, replaces) = (file.isovalues.clone(), file.replaces);
    let asked = Asked { shards: planned.shards, isovalues, replaces };
    let file = plan_file(settings, &reduction, asked, Some(search))?;
    let next = PlanReport::of(&file, &reduction, out);
    begin(&file, &reduction, out, run)?;
    reduce::remove_tries(out, PLANNED_TRY, &[Some(made + 1), best])?;
    Ok(Committed::NextTry(Box::new(NextTry { target, next })))
}

/// Makes the best try the archive. `report` is of that try, where it was the last.
pub(super) fn finish(
    file: &PlanFile,
    planned: &PlannedSearch,
    report: Option<ReduceReport>,
    out: &Path,
) -> Result<ReduceReport> {
    let number = planned.search.best_try().expect("the last try is the best if no other is");
    let best = planned_try(out, number);
    if !best.exists() {
        let manifest = Manifest::read(out)?;
        let report = ReduceReport { made_before: true, ..planned_report(file) };
        let report = report.of_archive(out, &manifest, 0)?;
        return reduce::with_target(&planned.search, report, out);
    }
    Existing::at(out)?.refuse_overwriting(out, file.replaces)?;
    let report = match report {
        Some(report) => report,
        None => planned_report(file).of_archive(&best, &Manifest::read(&best)?, 0)?,
    };
    let report = reduce::publish_best(&planned.search, &best, out, report)?;
    reduce::remove_tries(out, PLANNED_TRY, &[])?;
    Ok(report)
}
