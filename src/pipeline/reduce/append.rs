//! Adds further steps to an existing archive.
//!
//! New files are written next to the old ones. In the end the manifest that names them is renamed
//! over the old one: until then the archive is the old one. The same call continues a run that was
//! killed; what that run left is in the folders of the new steps, which no manifest names.
//!
//! A tetrahedral mesh is laid out on disk again, from the first of the new files that has it,
//! because the points are located in it. The archive has hashes of its points and cells, by which
//! other meshes are refused. It also has the vertices that were merged at the first step, so the
//! samples of its boundary are the same.

use super::advice::look;
use super::existing::{expect_files, lock_for_writing, sweep};
use super::job::{Basis, Job};
use super::order::{next_files, number_there};
use super::planned::{first_that_opens, plan, publish, run as run_plan};
use super::report::{ReduceReport, SourceChunks};
use super::surfaces::{expect_surfaces, in_world, measured_isovalues, with_surfaces};
use crate::archive::manifest::{MANIFEST_NAME, Manifest, StepPlan};
use crate::pipeline::read::OpenArchive;
use crate::pipeline::settings::{
    Amount, CompleteSettings, FieldValue, NanPolicy, ReduceSettings, RunSettings, Target,
};
use isospan_io::error::{Error, Result};
use isospan_io::exec::Progress;
use isospan_io::formats::{OpenOptions, StepSource, counted_from, without_frame};
use isospan_io::setting::Setting;
use isospan_io::volume::units::Units;
use isospan_mesh::points::SetSettings;
use std::path::Path;
use std::time::Instant;

/// What the user chooses for further steps; all else is as it was for the last one.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::pipeline) struct AppendSettings {
    /// A value that means "no data", besides what the file declares; that of the last step if not
    /// given.
    pub(in crate::pipeline) missing: Option<f64>,
    /// Steps from one keyframe to the next, by number; as for the last step if not given.
    pub(in crate::pipeline) keyframes: Option<u64>,
    /// Whether the field is measured at every sample of the source.
    pub(in crate::pipeline) measure: bool,
    /// Whether a step that the archive has at the same time, or else of the same file, is replaced.
    pub(in crate::pipeline) replace: bool,
    /// Whose surfaces are measured at the new steps.
    pub(in crate::pipeline) isovalues: Vec<FieldValue>,
    /// What the new steps are judged by; it decides nothing about them.
    pub(in crate::pipeline) target: Option<Target>,
}

impl Default for AppendSettings {
    fn default() -> Self {
        let (missing, keyframes, isovalues, target) = (None, None, vec![], None);
        Self { missing, keyframes, measure: true, replace: false, isovalues, target }
    }
}

/// Adds steps to the archive `out`: see
/// [`Addition::append_to`](crate::pipeline::Addition::append_to).
pub(in crate::pipeline) fn append(
    sources: &[StepSource],
    asked: &AppendSettings,
    out: &Path,
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<ReduceReport> {
    let started = Instant::now();
    let _lock = lock_for_writing(out)?;
    let archive = OpenArchive::open(out)?;
    expect_files(out, &archive.manifest)?;
    let last = archive.manifest.steps.last().expect("an archive that was opened has a step");
    let field = &last.plan.source.field;
    let sources = with_fields(sources, &archive.manifest, field)?;
    // Each night's file may count from a date of its own.
    let sources = match &last.plan.source.units.time {
        Some(unit) => counted_from(sources, unit),
        None => sources,
    };
    if !measured_isovalues(&asked.isovalues, asked.target).is_empty() {
        expect_surfaces(&sources, Some(archive.manifest.plan.has_labels()), run)?;
    }
    let sources: Vec<_> = (next_files(&archive.manifest)..).zip(sources).collect();
    let asked = &asked.in_world(&sources, &last.plan.source.units, run)?;
    let run = &RunSettings { replace: asked.replace, ..run.clone() };
    let settings = settings_like(&archive.manifest, asked)?;
    let basis = Basis::Archive(&archive);
    let job = Job { sources: &sources, settings: &settings, out, run, progress, basis, keeps_sums: false };
    let notices = look(&job)?.notices;
    let (report, added) = add(&job, &archive)?;
    let report = ReduceReport { notices, source_chunks: SourceChunks::of(&sources), ..report };
    judged(report.finished(started), asked, &Job { sources: &added, ..job })
}

/// The report of further steps with the surfaces that are asked for, and what is said of a target.
fn judged(report: ReduceReport, asked: &AppendSettings, job: &Job<'_>) -> Result<ReduceReport> {
    let Job { sources, out, run, progress, .. } = *job;
    let measured = |report, isovalues: &[FieldValue]| match isovalues {
        [] => Ok(report),
        _ => with_surfaces(report, out, sources, isovalues, &run.resources, progress),
    };
    match asked.target {
        None => measured(report, &asked.isovalues),
        Some(target) => {
            let report = measured(report, &measured_isovalues(&[], asked.target))?.judged_by(target)?;
            match (target, &asked.isovalues[..]) {
                (Target::Surface(target), [value]) if *value == target.isovalue => Ok(report),
                (_, isovalues) => measured(report, isovalues),
            }
        }
    }
}

impl AppendSettings {
    /// With a distance in world units; `known` are those of the archive.
    fn in_world(&self, sources: &[(u64, StepSource)], known: &Units, run: &RunSettings) -> Result<Self> {
        let Some(target @ Target::Surface(_)) = self.target else { return Ok(self.clone()) };
        let open = |source: &StepSource| in_world(target, &source.open()?, source, known);
        let target = Some(first_that_opens(sources, run.keep_going, open)?);
        Ok(Self { target, ..self.clone() })
    }
}

/// Steps with the numbers of their files.
type Numbered = Vec<(u64, StepSource)>;

/// Adds the steps of a job to an archive, or what is missing of them; they come with the report.
fn add(job: &Job<'_>, archive: &OpenArchive) -> Result<(ReduceReport, Numbered)> {
    let planned = plan(job, false)?;
    let series = &planned.series;
    let number = |step: &StepPlan| match series.is_there {
        false => Some(step.number),
        true => number_there(&archive.manifest, step),
    };
    let pairs = series.plan.steps.iter().zip(&series.sources);
    let added = pairs.filter_map(|(step, from)| Some((number(step)?, from.source.clone()))).collect();
    if series.is_there {
        return Ok((ReduceReport::of_added(archive, &planned.series)?, added));
    }
    planned.check()?;
    let layout = planned.layout(job.out);
    let built = run_plan(planned, job, &layout, 0..layout.segment_count())?;
    let report = publish(built, job, &layout)?;
    sweep(&layout);
    Ok((report, added))
}

/// Further steps. Where those of the archive have several fields, so do these: field after field.
fn with_fields(sources: &[StepSource], manifest: &Manifest, field: &str) -> Result<Vec<StepSource>> {
    let series: Vec<&String> = manifest.runs().filter_map(|run| run[0].series.as_ref()).collect();
    let is_part = |source: &StepSource| source.part().is_some();
    if series.is_empty() || sources.iter().all(is_part) {
        return Ok(sources.iter().map(|source| with_field(source, field)).collect());
    }
    let mut all = vec![];
    for name in series {
        for (moment, source) in (0..).zip(sources) {
            let asked = source.options.field.as_deref().map_or(&**name, without_frame);
            if asked == name {
                all.push(with_field(source, name).as_field(name, Some(moment)));
            }
        }
    }
    match all.is_empty() {
        true => Err(Error::usage("the steps of the archive have other fields: name these with `fields`")),
        false => Ok(all),
    }
}

/// A further step. Where no field is named, it has the field of the archive, if the file has that.
fn with_field(source: &StepSource, field: &str) -> StepSource {
    let options = OpenOptions { field: Some(field.to_owned()), ..source.options.clone() };
    // In a format without names the reader chooses. Another name is refused when the step is
    // planned.
    let is_named = source.options.field.is_some() || source.is_given();
    match !is_named && source.with_options(&options).open().is_ok() {
        true => source.in_field(&options),
        false => source.clone(),
    }
}

/// The settings with which the last step of an archive was made; where points are was decided then.
fn settings_like(manifest: &Manifest, settings: &AppendSettings) -> Result<CompleteSettings> {
    let plan = &manifest.steps.last().expect("an archive that was opened has a step").plan;
    if manifest.plan.has_labels() && settings.keyframes.is_some() {
        let keyframes = Setting::Keyframes;
        return Err(Error::usage(format!("{keyframes} does not go with labels: each step of them is one")));
    }
    Ok(CompleteSettings {
        points: manifest.plan.points.kind(),
        interpolation: plan.interpolation,
        values: plan.values,
        nan: NanPolicy::parse(&plan.nan).ok_or_else(|| {
            let expected = "error, mask or a number";
            Error::bad_input(MANIFEST_NAME, format!("nan of step {}", plan.number), expected, &plan.nan)
        })?,
        missing: settings.missing.or(plan.missing),
        value_bits: plan.quantiser.map(|q| q.bits),
        keyframes: settings.keyframes.unwrap_or(plan.keyframes),
        measure: settings.measure,
        set: SetSettings::default(),
        amount: Amount::Usual,
        adapt: None,
        target: None,
        chunk_points: ReduceSettings::CHUNK_POINTS,
        step_factor: 1.0,
    })
}
