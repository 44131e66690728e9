//! A wanted error or size instead of a number of points: the fewest points that meet an error, the
//! most that fit a size.
//!
//! Every try is a whole reduction. For adapted points, the pass that finds where points are needed
//! ([`crate::density`]) also predicts the error, to about a third. So the first try has as many
//! points as that asks for. Its error is measured at every sample, and the next number follows from
//! it. Errors are nearly a power of the number of points. So two tries give the power, and a third
//! one is within a few percent:
//!
//! ```text
//!  log error │ ∘ first: as predicted
//!            │   ⟍
//!  wanted ───┼─────∘───────  third, and kept: met by at most 3 % more points than needed
//!            │       ⟍
//!            │         ∘ second: of the usual power
//!            └──────────────── log points
//! ```
//!
//! Other points begin with 1/8 of the samples. A size is searched for in the same way: bytes are a
//! power of the number of points per sample.
//!
//! Of a pyramid a try has another step of its coefficients, and the first one mostly does. For a
//! distance of a surface it has another error of each sample ([`super::share`]), and its surface is
//! measured.
//!
//! Tries lie in the folder `NAME.isospan.work` next to the archive, with a note of how far the
//! search is ([`super::kept_search`]): so a run that was stopped goes on at its try.
//!
//! The levels of all places follow from one number, so another number moves points nearly
//! everywhere: each level takes another piece of the sequence. The last step cannot be confined to
//! a few cells either, as [`target_max`](super::target_max) does: to lower a sum of squares by some
//! percent is not a matter of a few cells. Equal gain for every point means that cells near the
//! next level lie all over the volume, in every chunk. The published archive is a try that met the
//! target, with its measured error in the manifest. The limit is a point per sample. If that is not
//! enough, the try at the limit is published and the report says so. The largest error is a matter
//! of a few places: [`target_max`](super::target_max) makes those denser.
//!
//! The numbers of points follow from measured errors, which depend on nothing but the input. So the
//! archive is the same for any number of threads.

use super::existing::Existing;
use super::job::Job;
use super::kept_search::{KeptSearch, MadeTry};
use super::made_before::{made_before, published_before};
use super::planned::make;
use super::report::ReduceReport;
use super::search::TargetSearch;
use super::surfaces::with_surface_of;
use super::target_max::reduce_to_max;
use super::tries::{full_cells, publish, tidy};
use crate::pipeline::plan::folder_bytes;
use crate::pipeline::settings::{Bound, RunSettings, Target};
use isospan_io::error::{Error, Result};
use isospan_io::exec::Attempt;
use isospan_io::setting::Setting;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A search by numbers of points, between two tries.
#[derive(Serialize, Deserialize)]
struct PointSearch {
    search: TargetSearch,
    /// The best try so far.
    best: Option<MadeTry>,
}

impl PointSearch {
    /// Whether what was noted is there; the best try of a search that is over may be published.
    fn is_there(&self, kept: &KeptSearch<'_>) -> bool {
        self.search.best_try().is_none_or(|number| kept.has(number))
    }
}

/// Reduces to the archive `job.out` with the fewest points that meet the target of the settings, or
/// the most that do. `source` is the number of bytes of the source, if known. What a run has found
/// that was stopped is there again.
///
/// # Errors
/// As those of a reduction; [`Usage`](crate::Error::Usage) for a target that cannot be one.
pub(super) fn reduce_to_target(
    job: &Job<'_>,
    existing: &Existing,
    target: Target,
    source: Option<u64>,
) -> Result<ReduceReport> {
    expect_for_fields(job, target)?;
    let search = TargetSearch::new(job.settings, target, source)?;
    if let Existing::Finished(manifest) = existing
        && !job.run.replace
        && let Some(report) = made_before(job, manifest, target, source)?
    {
        return Ok(report);
    }
    if let (Target::Max(_), true) = (target, job.settings.adapt.is_some()) {
        return reduce_to_max(job, target, source);
    }
    search_for(job, search, target, source)
}

/// Makes try after try, and publishes the best.
fn search_for(job: &Job<'_>, new: TargetSearch, target: Target, source: Option<u64>) -> Result<ReduceReport> {
    let (kept, found) = KeptSearch::open::<PointSearch>(job, source)?;
    let is_published = |found: &PointSearch| found.search.is_over() && !found.is_there(&kept);
    if found.as_ref().is_some_and(is_published)
        && let Some(report) = published_before(job, target, source)
    {
        return Ok(report);
    }
    let found = found.filter(|found| found.is_there(&kept));
    let mut state = found.unwrap_or(PointSearch { search: new, best: None });
    kept.note(&state)?;
    let (mut of_best, mut seconds, mut last) = (None, vec![], None);
    while !state.search.is_over() {
        let number = state.search.next_try();
        kept.keep(&[state.search.best_try(), Some(number)])?;
        job.progress.attempt(&Attempt { number, about: state.search.about(), last });
        let (settings, out) = (&state.search.next_settings(), &kept.try_path(number));
        tidy(out);
        // What another plan has left there is no part of the search.
        let run = &RunSettings { replace: true, ..job.run.clone() };
        let report = make(&Job { settings, out, run, ..*job }, &Existing::at(out)?)?;
        let report = with_surface_of(target, report, out, job)?;
        seconds.extend_from_slice(&report.seconds);
        last = Some(state.search.note(&report)?.reached_of());
        if state.search.best_try() == Some(number) {
            state.best = Some(MadeTry::of(&report));
            of_best = Some(report);
        }
        kept.note(&state)?;
    }
    let best = state.search.best_try().map(|number| kept.try_path(number));
    let (Some(best), Some(made)) = (best, state.best) else {
        unreachable!("the last try is the best if no other is")
    };
    let report = match of_best {
        Some(report) => report,
        None => with_surface_of(target, made.report(&best)?, &best, job)?,
    };
    publish_best(&state.search, &best, job.out, ReduceReport { seconds, ..report })
}

/// Refuses an error that would be compared among fields of several units.
pub(in crate::pipeline) fn expect_for_fields(job: &Job<'_>, target: Target) -> Result<()> {
    if job.has_fields() && matches!(target, Target::Surface(_)) {
        return Err(Error::usage(format!(
            "{} is of one field, and there are several: reduce each by itself",
            Setting::TargetSurface
        )));
    }
    let Some(bound) = target.bound().filter(|_| job.has_fields()) else { return Ok(()) };
    if let Bound::Value(error) = bound {
        return Err(Error::usage(format!(
            "an error of {error} is in the units of one field, and there are several: \
             give a part of the range of each, as 1%"
        )));
    }
    match target {
        Target::Max(_) if job.settings.adapt.is_some() => Err(Error::usage(
            "a largest error of several fields does not go with points that adapt, as those of a mesh do: \
             choose `target_rms`, or reduce each field by itself",
        )),
        _ => Ok(()),
    }
}

/// Makes the best try of a search the archive `out`, and completes its report.
pub(in crate::pipeline) fn publish_best(
    search: &TargetSearch,
    best: &Path,
    out: &Path,
    report: ReduceReport,
) -> Result<ReduceReport> {
    publish(search.settings(), best, out)?;
    let archive_bytes = folder_bytes(out)?;
    with_target(search, ReduceReport { archive_bytes, ..report }, out)
}

/// The report of the archive that is the best try of a search, with what that came to.
pub(in crate::pipeline) fn with_target(
    search: &TargetSearch,
    mut report: ReduceReport,
    archive: &Path,
) -> Result<ReduceReport> {
    let full_cells = if search.adapts() { Some(full_cells(archive)?) } else { None };
    let mut found = search.best_report(full_cells);
    if found.target.is_of_bytes() {
        found.reached = report.archive_bytes as f64;
    }
    report.target = Some(found);
    Ok(report)
}
