//! The order of steps: by time, field after field, whatever the order of their files.
//!
//! ```text
//!  time       0     1     1.5   2          0     1     2
//!  step       0     1     2     3          0     1     2
//!  files      0     1     3     2          0     1     3      2: replaced, kept as the base of others
//! ```
//!
//! A step that is inserted, or that replaces another, has files of new numbers: so the archive
//! stays whole until a manifest names them.

use super::{CoordinateRecord, LONGEST_CHAIN, Manifest, StepPlan, StoredStep};
use crate::archive::segment::{LABELS_FORMAT, ORDERED_FORMAT};
use isospan_io::error::{Error, Result};
use std::path::Path;

impl StoredStep {
    /// Number of the step in the archive.
    pub fn number(&self) -> u64 {
        self.place.unwrap_or(self.plan.number)
    }

    /// The time of the step as the input gives it, else its number.
    pub fn time_or_number(&self) -> f64 {
        self.plan.time.unwrap_or(self.number() as f64)
    }

    /// The name of its field: that of several of its step, else that of the source.
    pub fn field(&self) -> &str {
        self.series.as_deref().unwrap_or(&self.plan.source.field)
    }
}

impl Manifest {
    /// With the version of the format that its members ask for.
    pub(super) fn of_its_format(mut self) -> Self {
        let is_ordered = self.all_steps().any(|step| step.place.is_some() || step.series.is_some());
        if is_ordered || !self.bases.is_empty() {
            (self.format_version, self.oldest_reader) = (ORDERED_FORMAT, None);
        }
        if self.plan.has_labels() {
            (self.format_version, self.oldest_reader) = (LABELS_FORMAT, None);
        }
        self
    }

    /// All steps, and those that others have replaced behind them.
    pub fn all_steps(&self) -> impl Iterator<Item = &StoredStep> {
        self.steps.iter().chain(&self.bases)
    }

    /// The step at a position among [`Manifest::all_steps`].
    ///
    /// # Panics
    /// When there is none.
    pub fn step_at(&self, position: usize) -> &StoredStep {
        self.steps.get(position).unwrap_or_else(|| &self.bases[position - self.steps.len()])
    }

    /// The position of the step whose files have a number.
    pub fn position(&self, files: u64) -> Option<usize> {
        self.all_steps().position(|step| step.plan.number == files)
    }

    /// The position of the step to which the values of another one may refer; `None` of a keyframe.
    pub fn base_of(&self, position: usize) -> Option<usize> {
        let base = self.step_at(position).plan.base?;
        let is_it = |n: &usize| self.step_at(*n).plan.number == base.number;
        // Nearly always the step before.
        let before = position.checked_sub(1).filter(is_it);
        before.or_else(|| (0..self.steps.len() + self.bases.len()).find(is_it))
    }

    /// The steps of each field, by their positions; of all steps where each has one field.
    pub fn runs(&self) -> impl Iterator<Item = &[StoredStep]> {
        self.steps.chunk_by(|a, b| a.series == b.series)
    }

    /// The coordinates of a grid that has its own, and the step with whose files they are.
    pub fn coordinates(&self) -> Option<(&StepPlan, CoordinateRecord)> {
        self.all_steps().find_map(|step| Some((&step.plan, step.coordinates?)))
    }

    /// Steps of a field ascend, and no two fields have the same name.
    pub(super) fn check_order(&self, path: &Path) -> Result<()> {
        let bad = |what: &str| Err(Error::bad_input(path, "steps", what, "others"));
        for run in self.runs() {
            if !run.is_sorted_by(|a, b| a.number() < b.number()) {
                return bad("ascending numbers");
            }
            if !run.is_sorted_by(|a, b| a.time_or_number() < b.time_or_number()) {
                return bad("ascending times");
            }
        }
        let mut fields: Vec<_> = self.runs().map(|run| &run[0].series).collect();
        fields.sort();
        if !fields.is_sorted_by(|a, b| a < b) {
            return bad("all steps of a field together");
        }
        Ok(())
    }

    /// A base is a step that was made before, and a keyframe is not far: any step is decoded in
    /// bounded time.
    pub(super) fn check_bases(&self, path: &Path) -> Result<()> {
        let mut all: Vec<&StepPlan> = self.all_steps().map(|step| &step.plan).collect();
        all.sort_by_key(|plan| plan.number);
        if !all.is_sorted_by(|a, b| a.number < b.number) {
            return Err(Error::bad_input(path, "steps", "files of their own", "the same twice"));
        }
        let mut lengths = Vec::with_capacity(all.len());
        for (n, plan) in all.iter().enumerate() {
            let Some(base) = &plan.base else {
                lengths.push(0);
                continue;
            };
            let found = all[..n].binary_search_by_key(&base.number, |before| before.number).ok();
            let step = |plan: &StepPlan| plan.wavelet.map(|wavelet| wavelet.step);
            let is_it =
                |at: &usize| all[*at].hash(self.plan_hash) == base.hash && step(all[*at]) == step(plan);
            let found = found.filter(is_it);
            let length = found.map(|at: usize| lengths[at] + 1).filter(|length| *length <= LONGEST_CHAIN);
            let Some(length) = length else {
                return Err(Error::bad_input(
                    path,
                    format!("base of step {}", plan.number),
                    format!(
                        "a step made before it, as fine as it is, and a keyframe at most \
                         {LONGEST_CHAIN} steps ago"
                    ),
                    format!("step {}", base.number),
                ));
            };
            lengths.push(length);
        }
        Ok(())
    }
}
