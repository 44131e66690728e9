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
//! A lattice's values are rounded to a step of 1.4 times the RMS error, unless the settings
//! give the number of bits. So rounding costs a tenth of the error or less, and saves three bits
//! per value and more.
//!
//! Tries lie in the folder `NAME.isospan.work` next to the archive. The levels of all places follow
//! from one number, so another number moves points nearly everywhere: each level takes another
//! piece of the sequence. The last step cannot be confined to a few cells either, as
//! [`target_max`](super::target_max) does: to lower a sum of squares by some percent is not a
//! matter of a few cells. Equal gain for every point means that cells near the next level lie all
//! over the volume, in every chunk. The published archive is a try that met the target, with its
//! measured error in the manifest. The limit is a point per sample. If that is not enough, a
//! lattice takes nodes at all samples, which leave the error of rounding alone. Of other points the
//! try at the limit is published and the report says so. The largest error is a matter of a few
//! places: [`target_max`](super::target_max) makes those denser.
//!
//! The numbers of points follow from measured errors, which depend on nothing but the input. So the
//! archive is the same for any number of threads.

use super::existing::{Existing, exists, lacks_files};
use super::job::Job;
use super::plan_file::work_folder;
use super::planned::make;
use super::report::ReduceReport;
use super::search::TargetSearch;
use super::target_max::reduce_to_max;
use super::tries::{full_cells, publish, rename};
use crate::archive::manifest::Manifest;
use crate::bytes::publish::remove_folder;
use crate::error::{Error, Result};
use crate::formats::Input;
use crate::pipeline::plan::{Inputs, folder_bytes};
use crate::pipeline::settings::{RunSettings, Target};
use std::fs;
use std::path::Path;

/// Reduces to the archive `job.out` with the fewest points that meet the target of the settings, or
/// the most that do. `source` is the number of bytes of the source, if known.
///
/// # Errors
/// As those of a reduction; [`Error::Usage`] for a target that cannot be one.
pub(super) fn reduce_to_target(
    job: &Job<'_>,
    existing: &Existing,
    target: Target,
    source: Option<u64>,
) -> Result<ReduceReport> {
    let mut search = TargetSearch::new(job.settings, target, source)?;
    if let Existing::Finished(manifest) = existing
        && !job.run.replace
    {
        return made_before(job, manifest);
    }
    if let (Target::Max(_), true) = (target, job.settings.adapt.is_some()) {
        return reduce_to_max(job, target);
    }
    let work = work_folder(job.out);
    let [trying, best] = ["try.isospan", "best.isospan"].map(|name| work.join(name));
    [&trying, &best].into_iter().try_for_each(|f| remove_folder(f))?;
    let (mut found, mut seconds) = (None, vec![]);
    while !search.is_over() {
        fs::create_dir_all(&work).map_err(|e| Error::io("create the folder", &work, e))?;
        let run = RunSettings { replace: false, ..job.run.clone() };
        let (settings, number) = (&search.next_settings(), search.next_try());
        let report = make(&Job { settings, out: &trying, run: &run, ..*job }, &Existing::Nothing)?;
        seconds.extend_from_slice(&report.seconds);
        search.note(&report)?;
        if search.best_try() == Some(number) {
            remove_folder(&best)?;
            rename(&trying, &best)?;
            found = Some(report);
        } else {
            remove_folder(&trying)?;
        }
    }
    let report = found.expect("the last try is the best if no other is");
    publish_best(&search, &best, job.out, ReduceReport { seconds, ..report })
}

/// Makes the best try of a search the archive `out`, and completes its report.
pub(in crate::pipeline) fn publish_best(
    search: &TargetSearch,
    best: &Path,
    out: &Path,
    mut report: ReduceReport,
) -> Result<ReduceReport> {
    let full_cells = if search.adapts() { Some(full_cells(best)?) } else { None };
    let mut found = search.best_report(full_cells);
    publish(search.settings(), best, out)?;
    report.archive_bytes = folder_bytes(out)?;
    if found.target.bound().is_none() {
        found.reached = report.archive_bytes as f64;
    }
    report.target = Some(found);
    Ok(report)
}

/// The report of an archive that this very call has made before: with the same settings, of the
/// same files.
///
/// # Errors
/// [`Error::Usage`] when it is another one.
fn made_before(job: &Job<'_>, manifest: &Manifest) -> Result<ReduceReport> {
    let (mut inputs, mut is_same) = (Inputs::default(), manifest.target == Some(job.settings.hash()));
    is_same &= manifest.steps.len() == job.sources.len() && !lacks_files(job.out, manifest);
    for (step, (number, source)) in manifest.steps.iter().zip(job.sources) {
        if !is_same {
            break;
        }
        let (files, field) = match source.open()? {
            Input::Volume(volume) => (volume.info().files(), volume.info().field.name.clone()),
            Input::Mesh(mesh) => (mesh.info().files(), mesh.field()?.name.clone()),
        };
        let found = inputs.of_source(*number, source, &files, &job.run.resources.cancel)?;
        let (plan, of_source) = (&step.plan, &step.plan.source);
        is_same &= (plan.number, plan.time) == (*number, source.time)
            && (&of_source.fingerprint, &of_source.field) == (&found, &field);
    }
    if !is_same {
        return Err(exists(job.out));
    }
    let samples = manifest.steps[0].plan.source.samples();
    ReduceReport { samples, made_before: true, ..ReduceReport::default() }.of_archive(job.out, manifest, 0)
}
