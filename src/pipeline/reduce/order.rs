//! Where steps go in an archive: in the order of their times, field after field.
//!
//! ```text
//!  archive   0     1     2        further steps   1.5        3
//!                                                 between    behind: may refer to the last one
//!  files     0     1     2                        4          3
//! ```
//!
//! Steps behind those of the archive come first among further ones, so that their bytes are those
//! of one reduction. Between two steps, and in the place of one, there are keyframes alone.

use crate::archive::manifest::{BaseStep, Manifest, StepPlan, StoredStep};
use crate::archive::segment::PlanHash;
use crate::pipeline::read::is_of_fields;
use isospan_io::formats::{StepSource, without_frame};
use std::collections::{BTreeMap, BTreeSet};

/// What the order of further steps is decided by.
#[derive(Clone, Debug, Default)]
pub(super) struct Order {
    /// The last step of each field of the archive, which steps behind it may refer to.
    pub(super) lasts: Vec<LastStep>,
    /// Further steps that are not behind those of the archive, by the numbers of their files.
    pub(super) between: BTreeSet<u64>,
    /// The steps whose place further ones take, by the numbers of their files.
    pub(super) replaced: BTreeMap<u64, u64>,
}

/// The last step of a field so far.
#[derive(Clone, Debug)]
pub(super) struct LastStep {
    pub(super) series: Option<String>,
    base: BaseStep,
    /// How fine the coefficients of a pyramid are: others cannot refer to them.
    wavelet_step: Option<f64>,
}

impl LastStep {
    pub(super) fn new(series: Option<String>, plan: &StepPlan, mesh: PlanHash) -> Self {
        let base = BaseStep { number: plan.number, hash: plan.hash(mesh) };
        Self { series, base, wavelet_step: plan.wavelet.map(|wavelet| wavelet.step) }
    }

    /// What a step of the same field refers to, unless a keyframe is due.
    pub(super) fn base_of(&self, plan: &StepPlan, keyframes: u64) -> Option<BaseStep> {
        let is_as_fine = self.wavelet_step == plan.wavelet.map(|wavelet| wavelet.step);
        let is_near = self.base.number / keyframes == plan.number / keyframes;
        (is_as_fine && is_near).then_some(self.base)
    }
}

impl Order {
    /// Whether there are steps of an archive already.
    pub(super) fn is_continued(&self) -> bool {
        !self.lasts.is_empty() || !self.replaced.is_empty()
    }
}

/// The name of the field of which a source is one step, where each step has several.
pub(super) fn series_of(source: &StepSource) -> Option<&str> {
    source.part().filter(|part| part.moment.is_some()).map(|part| &*part.name)
}

/// The name of the field of a step of an archive, as steps with several fields have it.
pub(super) fn series_in(manifest: &Manifest, step: &StoredStep) -> String {
    match &step.series {
        Some(series) => series.clone(),
        None if is_of_fields(manifest) => step.plan.source.field.clone(),
        None => without_frame(&step.plan.source.field).to_owned(),
    }
}

/// Whether a step of an archive is one of a field that further steps have.
pub(super) fn is_of_series(manifest: &Manifest, step: &StoredStep, series: Option<&str>) -> bool {
    series.is_none_or(|name| series_in(manifest, step) == name)
}

/// The time of a step of an archive among further ones.
pub(super) fn time_in(manifest: &Manifest, step: &StoredStep, series: Option<&str>) -> f64 {
    // Fields of one moment become the first step of several fields.
    if series.is_some() && is_of_fields(manifest) { 0.0 } else { step.time_or_number() }
}

/// The file and field of a step, for a person.
pub(super) fn name_of(plan: &StepPlan) -> String {
    format!("{} ({})", plan.source.path, plan.source.field)
}

/// Whether a step is of the same contents, at the same time.
fn is_same(a: &StepPlan, b: &StepPlan) -> bool {
    a.source == b.source && a.time == b.time && a.missing == b.missing
}

pub(super) fn is_there(manifest: &Manifest, plan: &StepPlan) -> bool {
    manifest.steps.iter().any(|step| is_same(&step.plan, plan))
}

/// The number of the files of a step that is there: of several of the same contents, the last.
pub(super) fn number_there(manifest: &Manifest, plan: &StepPlan) -> Option<u64> {
    let same = manifest.steps.iter().rev().find(|step| is_same(&step.plan, plan));
    same.map(|step| step.plan.number)
}

/// Whether an archive ends with these very steps: a run that was killed after it had added them is
/// asked to continue.
pub(super) fn ends_with(manifest: &Manifest, steps: &[StepPlan]) -> bool {
    let mut pairs = manifest.steps.iter().rev().zip(steps.iter().rev());
    steps.len() <= manifest.steps.len() && pairs.all(|(a, b)| is_same(&a.plan, b))
}

/// A step that gets its place.
pub(super) struct Entry {
    pub(super) time: f64,
    /// The number that it had, or is to have.
    pub(super) wish: Option<u64>,
    pub(super) step: StoredStep,
}

/// The number of the step behind all of an archive, and that of its files.
pub(super) fn next_numbers(manifest: &Manifest) -> (u64, u64) {
    let next = manifest.steps.iter().map(|step| step.number() + 1).max().unwrap_or(0);
    (next, next_files(manifest))
}

/// The number of the files of a further step.
pub(super) fn next_files(manifest: &Manifest) -> u64 {
    manifest.all_steps().map(|step| step.plan.number + 1).max().unwrap_or(0)
}

/// Steps field after field, by time; fields of the same time have the same number.
pub(super) fn numbered(mut entries: Vec<Entry>) -> Vec<StoredStep> {
    let mut wishes: Vec<(f64, Option<u64>)> = entries.iter().map(|e| (e.time, e.wish)).collect();
    wishes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut times, mut numbers, mut next) = (vec![], vec![], 0);
    for same in wishes.chunk_by(|a, b| a.0 == b.0) {
        let wish = same.iter().filter_map(|(_, wish)| *wish).min();
        let number = wish.unwrap_or(next).max(next);
        times.push(same[0].0);
        numbers.push(number);
        next = number + 1;
    }
    let mut fields: Vec<Option<String>> = vec![];
    for entry in &entries {
        if !fields.contains(&entry.step.series) {
            fields.push(entry.step.series.clone());
        }
    }
    let field = |e: &Entry| fields.iter().position(|series| *series == e.step.series);
    entries.sort_by(|a, b| field(a).cmp(&field(b)).then(a.time.total_cmp(&b.time)));
    let place = |entry: Entry| {
        let at = times.partition_point(|time| *time < entry.time);
        let number = numbers[at];
        StoredStep { place: Some(number).filter(|n| *n != entry.step.plan.number), ..entry.step }
    };
    entries.into_iter().map(place).collect()
}

/// The steps that others have replaced, as far as their values or coordinates are referred to.
pub(super) fn needed(steps: &[StoredStep], mut bases: Vec<StoredStep>) -> Vec<StoredStep> {
    let mut wanted: BTreeSet<u64> =
        steps.iter().filter_map(|step| step.plan.base).map(|b| b.number).collect();
    // A base has a lower number than those that refer to it.
    bases.sort_by_key(|step| std::cmp::Reverse(step.plan.number));
    let mut kept = vec![];
    for step in bases {
        if wanted.contains(&step.plan.number) || step.coordinates.is_some() {
            wanted.extend(step.plan.base.map(|base| base.number));
            kept.push(StoredStep {
                index: None,
                spectrum: None,
                error: None,
                level_errors: vec![],
                level_rms: vec![],
                place: None,
                series: None,
                ..step
            });
        }
    }
    kept.reverse();
    kept
}
