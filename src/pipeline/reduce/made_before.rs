//! An archive that meets a target, where the same call has made it before.

use super::existing::{exists, lacks_files};
use super::job::Job;
use super::kept_search::StepInput;
use super::report::ReduceReport;
use super::surfaces::with_surface_of;
use super::tries::full_cells;
use crate::archive::manifest::{Manifest, StoredStep};
use crate::pipeline::plan::Inputs;
use crate::pipeline::settings::Target;
use isospan_io::error::Result;
use isospan_io::formats::StepSource;

/// The report of an archive that a search has published which was stopped right after.
pub(super) fn published_before(job: &Job<'_>, target: Target, source: Option<u64>) -> Option<ReduceReport> {
    made_before(job, &Manifest::read(job.out).ok()?, target, source).ok()?
}

/// The report of an archive that this very call has made before: with the same settings, of the
/// same files. None where it has lost files, or has other units than the user names: then it is to
/// be made again, to the same bytes but for these.
///
/// # Errors
/// [`Usage`](crate::Error::Usage) when it is another one.
pub(super) fn made_before(
    job: &Job<'_>,
    manifest: &Manifest,
    target: Target,
    source: Option<u64>,
) -> Result<Option<ReduceReport>> {
    let mut inputs = Inputs::default();
    let mut is_same =
        manifest.target == Some(job.settings.hash()) && manifest.steps.len() == job.sources.len();
    for (step, source) in manifest.steps.iter().zip(job.sources) {
        if !is_same {
            break;
        }
        let found = StepInput::of(source, &mut inputs, &job.run.resources.cancel)?;
        let (plan, of_source) = (&step.plan, &step.plan.source);
        let (field, fingerprint) = (of_source.field.clone(), of_source.fingerprint.clone());
        is_same &= found == StepInput { number: plan.number, time: plan.time, field, fingerprint };
    }
    if !is_same {
        return Err(exists(job.out));
    }
    let has_units = |(step, (_, source)): (&StoredStep, &(u64, StepSource))| {
        let units = &step.plan.source.units;
        let mut named = source.options.units.clone().or(units.clone());
        named.time = named.time.filter(|_| step.plan.time.is_some());
        named == *units
    };
    if lacks_files(job.out, manifest) || !manifest.steps.iter().zip(job.sources).all(has_units) {
        return Ok(None);
    }
    let samples = manifest.steps[0].plan.source.samples();
    let of_fields = job.has_fields();
    let report = ReduceReport { samples, of_fields, made_before: true, ..ReduceReport::default() };
    let report = report.of_archive(job.out, manifest, 0)?;
    let report = with_surface_of(target, report, job.out, job)?;
    let full_cells = if job.settings.adapt.is_some() { Some(full_cells(job.out)?) } else { None };
    let target = target.report_of(&report, source, full_cells)?;
    Ok(Some(ReduceReport { target: Some(target), ..report }))
}
