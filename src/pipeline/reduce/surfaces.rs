//! How wrong are the surfaces of an archive that was just made?
//!
//! They are measured as [`Measurement`](crate::Measurement) does it, at every step.

use super::job::Job;
use super::kept_search::forget_search;
use super::planned::first_that_opens;
use super::report::{ReduceReport, range_of};
use crate::archive::manifest::StoredStep;
#[cfg(feature = "compare")]
use crate::pipeline::field::with_samples;
use crate::pipeline::field::{SurfaceErrors, no_samples};
use crate::pipeline::read::OpenArchive;
#[cfg(feature = "compare")]
use crate::pipeline::read::StepChoice;
use crate::pipeline::settings::{FieldValue, Length, RunSettings, SurfaceTarget, Target};
use crate::pipeline::stage::Stage;
#[cfg(feature = "compare")]
use crate::pipeline::surface::surface_errors;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Resources};
use isospan_io::formats::{Input, StepSource};
use isospan_io::setting::Setting;
use isospan_io::volume::units::Units;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// A report with how wrong the surfaces of the archive are; of each isovalue the step whose surface
/// is farthest from that of its samples.
///
/// # Errors
/// Those of reading the archive and the sources; [`Error::Budget`]; [`Error::Cancelled`].
pub(in crate::pipeline) fn with_surfaces(
    mut report: ReduceReport,
    archive: &Path,
    sources: &[(u64, StepSource)],
    isovalues: &[FieldValue],
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<ReduceReport> {
    let start = Instant::now();
    let archive = OpenArchive::open(archive)?;
    let source_of = |step: &StoredStep| sources.iter().find(|source| source.0 == step.plan.number);
    let steps = archive.manifest.steps.iter().filter_map(|step| Some((step, &source_of(step)?.1)));
    // One value for all steps, and for all tries: the samples do not change.
    let range = report.source_range.or_else(|| range_of(steps.clone().map(|(step, _)| step)));
    let values = isovalues.iter().map(|value| value.of(range)).collect::<Result<Vec<_>>>()?;
    let mut worst: Vec<SurfaceErrors> = vec![];
    for (step, source) in steps {
        let found = of_step(&archive, step.number(), source, &values, resources, progress)?;
        report.has_surface |= found.iter().any(|found| found.source.triangles > 0);
        if worst.is_empty() {
            worst = found;
            continue;
        }
        for (worst, found) in worst.iter_mut().zip(found) {
            if found.distance() > worst.distance() {
                *worst = found;
            }
        }
    }
    report.surfaces = worst;
    let (taken, all) = (start.elapsed().as_secs_f64(), &mut report.seconds);
    let total = all.iter().position(|(stage, _)| *stage == Stage::Total).unwrap_or(all.len());
    if let Some((_, total)) = all.get_mut(total) {
        *total += taken;
    }
    all.insert(total, (Stage::Surfaces, taken));
    Ok(report)
}

#[cfg(feature = "compare")]
fn of_step(
    archive: &Arc<OpenArchive>,
    number: u64,
    source: &StepSource,
    isovalues: &[f64],
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<Vec<SurfaceErrors>> {
    let (view, mut found) = (archive.at(StepChoice::Number(number))?, vec![]);
    with_samples(&view, source, resources, progress, &mut |view, samples| {
        found = surface_errors(view, samples, isovalues, None, progress)?;
        Ok(())
    })?;
    Ok(found)
}

#[cfg(not(feature = "compare"))]
fn of_step(
    _: &Arc<OpenArchive>,
    _: u64,
    _: &StepSource,
    _: &[f64],
    _: &Resources,
    _: &dyn Progress,
) -> Result<Vec<SurfaceErrors>> {
    Err(Error::usage("this build does not measure surfaces: it lacks the feature compare"))
}

/// A report with the surface that a target is about, if it is about one.
pub(in crate::pipeline) fn with_surface_of(
    target: Target,
    report: ReduceReport,
    archive: &Path,
    job: &Job<'_>,
) -> Result<ReduceReport> {
    let Target::Surface(SurfaceTarget { isovalue, .. }) = target else { return Ok(report) };
    let resources = &job.run.resources;
    let report = with_surfaces(report, archive, job.sources, &[isovalue], resources, job.progress)?;
    match report.surfaces.first().filter(|_| !report.has_surface) {
        None => Ok(report),
        Some(found) => {
            forget_search(job.out)?;
            let range = report.source_range.map_or("no value".into(), |[lo, hi]| format!("{lo} .. {hi}"));
            Err(Error::usage(format!(
                "the samples have no surface at {}: their range is {range}",
                found.isovalue
            )))
        }
    }
}

/// The isovalues whose surfaces are measured: that of a target, if no other is asked for.
pub(in crate::pipeline) fn measured_isovalues(
    isovalues: &[FieldValue],
    target: Option<Target>,
) -> Vec<FieldValue> {
    match target {
        Some(Target::Surface(target)) if isovalues.is_empty() => vec![target.isovalue],
        _ => isovalues.to_vec(),
    }
}

/// Refuses sources whose surfaces cannot be measured, before anything is made of them. What is made
/// may be known to be labels, or none; else the first source says so.
///
/// # Errors
/// [`Error::Usage`] for a mesh, labels, and several fields; those of opening the first source.
pub(in crate::pipeline) fn expect_surfaces(
    sources: &[StepSource],
    are_labels: Option<bool>,
    run: &RunSettings,
) -> Result<()> {
    if !cfg!(feature = "compare") {
        return Err(Error::usage("this build does not measure surfaces: it lacks the feature compare"));
    }
    if sources.iter().any(|source| source.part().is_some()) {
        return Err(Error::usage(format!(
            "an {} is of one field, and there are several: reduce each by itself",
            Setting::Isovalue
        )));
    }
    let numbered: Vec<_> = (0..).zip(sources.iter().cloned()).collect();
    let volume = match first_that_opens(&numbered, run.keep_going, StepSource::open)? {
        Input::Volume(volume) => volume,
        Input::Mesh(_) => return Err(no_samples()),
    };
    match are_labels.unwrap_or(volume.info().is_labels) {
        true => Err(Error::usage(format!(
            "labels are names, of which none is above another: they have no {}",
            Setting::Isovalue
        ))),
        false => Ok(()),
    }
}

/// A target whose lengths are in world units, of a source of which the first that opens is this.
/// `known`: units where the source has none.
pub(super) fn in_world(target: Target, first: &Input, source: &StepSource, known: &Units) -> Result<Target> {
    let (Target::Surface(surface), Input::Volume(volume)) = (target, first) else {
        return Ok(target);
    };
    let info = volume.info();
    let units = source.options.units.clone().or(info.units.clone()).or(known.clone());
    let diagonal = match surface.distance {
        Length::OfDiagonal(_) if source.coordinates()?.is_none() => Some(info.geometry.diagonal(info.dims)),
        _ => None,
    };
    let distance = Length::World(surface.distance.in_world(units.length.as_ref(), diagonal)?);
    Ok(Target::Surface(SurfaceTarget { distance, ..surface }))
}
