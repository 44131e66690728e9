//! Further steps for an archive that is there.
//!
//! New files come beside the old ones, and the manifest that names them is renamed over the old one in the end: until then the archive is the
//! old one. A run that was killed is continued by the same call; what it left is in the folders of the new steps, which no manifest names.

use super::beside::Beside;
use super::field::NanPolicy;
use super::layout::Layout;
use super::open::OpenArchive;
use super::plan::{ReduceSettings, parts};
use super::reduce::{
    Publishing, ReduceReport, RunSettings, estimate_of, finished, need_of, push_times, refuse_remote, sweep,
    threads,
};
use super::series::{Making, Means};
use super::volume_series::{Known, VolumeFields, are_there, plan_volumes};
use crate::archive::manifest::{MANIFEST_NAME, Step};
use crate::error::{Error, Result};
use crate::exec::Progress;
use crate::formats::StepSource;
use std::path::Path;
use std::time::Instant;

/// What the user chooses of further steps; all else is as it was for the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AppendSettings {
    /// A value that means "no data", besides what the file declares.
    pub missing: Option<f64>,
    /// Steps from one keyframe to the next, by number.
    pub keyframes: u64,
    /// Whether the field is measured at every sample of the source.
    pub measure: bool,
}

impl Default for AppendSettings {
    fn default() -> Self {
        Self { missing: None, keyframes: ReduceSettings::KEYFRAMES, measure: true }
    }
}

/// Adds steps to the archive `out`; the report is of them. They are numbered from the last one on.
///
/// When the archive ends with these very steps already (the same names, contents and fields), nothing is added, and the report has no steps: so the
/// same call continues a run that was killed at any moment.
///
/// The bytes are those that [`super::reduce_series`] would have made of all steps at once, with the same settings.
///
/// # Errors
/// Those of [`super::reduce_series`]; [`Error::BadInput`] for a damaged archive, and where dimensions or geometry are not the archive's;
/// [`Error::Io`] when another run has changed the archive meanwhile: the same call adds the steps behind.
pub fn append(
    sources: &[StepSource],
    settings: &AppendSettings,
    out: &Path,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<ReduceReport> {
    let started = Instant::now();
    refuse_remote(out)?;
    let archive = OpenArchive::open(out)?;
    let manifest = &archive.manifest;
    let last = manifest.steps.last().expect("an archive that was opened has a step");
    if last.plan.source.mesh.is_some() {
        let text = "of a tetrahedral mesh, to which steps cannot be added";
        return Err(Error::usage(format!("{}: {text}", out.display())));
    }
    let settings = settings_like(last, settings)?;
    let sources: Vec<_> = (last.plan.number + 1..).zip(sources.iter().cloned()).collect();
    let known = Known { archive: Some(&archive), ..Known::default() };
    let mut series = plan_volumes(&sources, &settings, run, known)?;
    if are_there(&archive, &series.plan.steps) {
        let counts = manifest.counts;
        let report = ReduceReport {
            samples: last.plan.source.dims.iter().product(),
            points: counts.points,
            tetrahedra: counts.tetrahedra,
            chunks: counts.chunks,
            blocks: counts.blocks,
            skipped: series.skipped,
            archive_bytes: archive.bytes()?,
            ..ReduceReport::default()
        };
        return Ok(finished(report, started));
    }
    let parts = parts(&manifest.plan, Beside::read(out, &manifest.plan)?)?;
    let need = need_of(&parts, series.plan.steps.len(), run.memory, run);
    estimate_of(&series, &need, out, run)?.check()?;
    let shares = need.shares(run.memory, threads(run))?;
    let fields = VolumeFields::new(&settings, run, progress);
    let means = Means { parts: &parts, fields: &fields, shares, at_once: need.steps() };
    let layout = Layout::new(out, parts.chunks.len(), 0);
    let segments = 0..layout.segment_count();
    let (old, measure) = (Some(manifest), settings.measure);
    let making = Making { means: &means, layout: &layout, segments, old, measure, run, progress };
    let made = making.make(&mut series)?;
    let samples = last.plan.source.dims.iter().product();
    let mut report = ReduceReport { samples, ..ReduceReport::default() };
    push_times(&mut report.seconds, &made);
    let publishing =
        Publishing { parts: &parts, layout: &layout, old, measure, workers: shares.workers, run, progress };
    let report = publishing.publish(&series, made, report)?;
    sweep(&layout, &series.plan);
    Ok(finished(report, started))
}

/// The settings with which a step was made.
fn settings_like(step: &Step, settings: &AppendSettings) -> Result<ReduceSettings> {
    let plan = &step.plan;
    Ok(ReduceSettings {
        interpolation: plan.interpolation,
        values: plan.values,
        nan: NanPolicy::parse(&plan.nan).ok_or_else(|| {
            let expected = "error, mask or a number";
            Error::bad_input(MANIFEST_NAME, format!("nan of step {}", plan.number), expected, &plan.nan)
        })?,
        missing: settings.missing,
        value_bits: plan.quantiser.map(|q| q.bits),
        keyframes: settings.keyframes,
        measure: settings.measure,
        ..ReduceSettings::default()
    })
}
