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

use super::contents::ArchiveContents;
use super::job::Job;
use super::series::{SeriesPlan, is_of_data};
use crate::archive::manifest::{BaseStep, Manifest, Step, StepPlan};
use crate::error::{Error, Result};
use crate::formats::{StepSource, without_frame};
use crate::pipeline::read::OpenArchive;
use std::collections::{BTreeMap, BTreeSet};

/// What the order of further steps is decided by.
#[derive(Clone, Debug, Default)]
pub(super) struct Order {
    /// The last step of each field of the archive, which steps behind it may refer to.
    lasts: Vec<(Option<String>, BaseStep)>,
    /// Further steps that are not behind those of the archive, by the numbers of their files.
    between: BTreeSet<u64>,
    /// The steps whose place further ones take, by the numbers of their files.
    replaced: BTreeMap<u64, u64>,
}

impl Order {
    /// Whether there are steps of an archive already.
    pub(super) fn is_continued(&self) -> bool {
        !self.lasts.is_empty() || !self.replaced.is_empty()
    }
}

/// The name of the field of which a source is one step, where each step has several.
fn series_of(source: &StepSource) -> Option<&str> {
    source.part().filter(|part| part.moment.is_some()).map(|part| &*part.name)
}

/// The name of the field of a step of an archive, as steps with several fields have it.
fn series_in(manifest: &Manifest, step: &Step) -> String {
    match &step.series {
        Some(series) => series.clone(),
        None if is_of_fields(manifest) => step.plan.source.field.clone(),
        None => without_frame(&step.plan.source.field).to_owned(),
    }
}

/// Whether the steps of an archive are the fields of one moment.
fn is_of_fields(manifest: &Manifest) -> bool {
    let steps = &manifest.steps;
    let names: BTreeSet<&str> = steps.iter().map(|s| &*s.plan.source.field).collect();
    let has_frames = || steps.iter().any(|s| without_frame(&s.plan.source.field) != s.plan.source.field);
    let are_plain = steps.iter().all(|s| s.series.is_none() && s.plan.time.is_none());
    steps.len() > 1 && names.len() == steps.len() && are_plain && !has_frames()
}

/// Whether a step of an archive is one of a field that further steps have.
fn is_of_series(manifest: &Manifest, step: &Step, series: Option<&str>) -> bool {
    series.is_none_or(|name| series_in(manifest, step) == name)
}

/// The time of a step of an archive among further ones.
fn time_in(manifest: &Manifest, step: &Step, series: Option<&str>) -> f64 {
    // Fields of one moment become the first step of several fields.
    if series.is_some() && is_of_fields(manifest) { 0.0 } else { step.time_or_number() }
}

/// The file and field of a step, for a person.
fn name_of(plan: &StepPlan) -> String {
    format!("{} ({})", plan.source.path, plan.source.field)
}

/// Whether a step is of the same contents, at the same time.
fn is_same(a: &StepPlan, b: &StepPlan) -> bool {
    a.source == b.source && a.time == b.time && a.missing == b.missing
}

fn is_there(manifest: &Manifest, plan: &StepPlan) -> bool {
    manifest.steps.iter().any(|step| is_same(&step.plan, plan))
}

/// Whether an archive ends with these very steps: a run that was killed after it had added them is
/// asked to continue.
fn ends_with(manifest: &Manifest, steps: &[StepPlan]) -> bool {
    let mut pairs = manifest.steps.iter().rev().zip(steps.iter().rev());
    steps.len() <= manifest.steps.len() && pairs.all(|(a, b)| is_same(&a.plan, b))
}

impl SeriesPlan {
    /// Finds the place of each step: in the order of times, or where an archive has the step
    /// already.
    ///
    /// # Errors
    /// [`Error::Usage`] for a step whose time, or whose file, the archive has; where steps may be
    /// left out, these are.
    pub(super) fn arrange(&mut self, job: &Job<'_>) -> Result<()> {
        match job.basis.archive() {
            None => self.expect_ascending(job)?,
            Some(archive) => {
                self.drop_those_there(&archive.manifest, job.run.replace);
                if self.is_there {
                    return Ok(());
                }
                self.place_among(archive, job)?;
            }
        }
        self.connect();
        Ok(())
    }

    /// Refuses a step, or leaves it out.
    pub(super) fn refuse(&mut self, n: usize, job: &Job<'_>, error: Error) -> Result<()> {
        let (number, is_last) = (self.plan.steps[n].number, self.plan.steps.len() == 1);
        if !job.run.keep_going || is_last || !is_of_data(&error) {
            return Err(error);
        }
        let source = self.take(n).1;
        self.skip(number, &source, error.to_string());
        Ok(())
    }

    fn take(&mut self, n: usize) -> (StepPlan, StepSource) {
        (self.plan.steps.remove(n), self.sources.remove(n).source)
    }

    /// Checks that the times of each field ascend.
    fn expect_ascending(&mut self, job: &Job<'_>) -> Result<()> {
        let mut n = 1;
        while n < self.plan.steps.len() {
            let series = [n - 1, n].map(|n| series_of(&self.sources[n].source));
            let [a, b] = [n - 1, n].map(|n| self.own_time(n));
            if series[0] != series[1] || a < b && b.is_finite() {
                n += 1;
                continue;
            }
            let numbers = [n - 1, n].map(|n| self.plan.steps[n].number);
            let error = Error::usage(format!(
                "times must ascend: step {} is at {a}, step {} at {b} (give them with --times)",
                numbers[0], numbers[1]
            ));
            self.refuse(n, job, error)?;
        }
        Ok(())
    }

    /// The time of the `n`-th step of a new archive: its own, or its number.
    fn own_time(&self, n: usize) -> f64 {
        let moment = self.sources[n].source.part().and_then(|part| part.moment);
        self.plan.steps[n].time.unwrap_or_else(|| moment.unwrap_or(self.plan.steps[n].number) as f64)
    }

    /// Forgets the steps that an archive has already, unless it has all.
    fn drop_those_there(&mut self, manifest: &Manifest, replaces: bool) {
        let ends = ends_with(manifest, &self.plan.steps);
        // A state without a time may come again.
        let is_known = |plan: &StepPlan, source: &StepSource| {
            ends || (plan.time.is_some() || replaces || series_of(source).is_some())
                && is_there(manifest, plan)
        };
        let pairs = self.plan.steps.iter().zip(&self.sources);
        let there: Vec<bool> = pairs.map(|(plan, from)| is_known(plan, &from.source)).collect();
        self.is_there = there.iter().all(|is_there| *is_there);
        if self.is_there {
            return;
        }
        let numbers: Vec<u64> = self.plan.steps.iter().map(|step| step.number).collect();
        let left = there.into_iter().enumerate().rev().filter(|(_, is_there)| *is_there);
        left.for_each(|(n, _)| _ = self.take(n));
        // Their numbers are free for others.
        self.plan.steps.iter_mut().zip(numbers).for_each(|(step, number)| step.number = number);
    }

    /// Finds the places of further steps among those of an archive.
    fn place_among(&mut self, archive: &OpenArchive, job: &Job<'_>) -> Result<()> {
        let manifest = &archive.manifest;
        let mut n = 0;
        let (mut replaced, mut times) = (vec![], vec![]);
        while n < self.plan.steps.len() {
            match self.place_of(n, manifest, &times, job.run.replace) {
                Ok((old, time)) => {
                    replaced.push(old);
                    times.push((series_of(&self.sources[n].source).map(str::to_owned), time));
                    n += 1;
                }
                Err(e) => self.refuse(n, job, e)?,
            }
        }
        self.sort(manifest, &replaced, &times);
        let is_replaced = |files: u64| self.order.replaced.values().any(|old| *old == files);
        let mut lasts: Vec<(Option<String>, BaseStep)> = vec![];
        for step in &manifest.steps {
            let has_series = times.first().is_some_and(|(series, _)| series.is_some());
            let series = has_series.then(|| series_in(manifest, step));
            lasts.retain(|(other, _)| *other != series);
            if !is_replaced(step.plan.number) {
                let hash = step.plan.hash(manifest.plan_hash);
                lasts.push((series, BaseStep { number: step.plan.number, hash }));
            }
        }
        self.order.lasts = lasts;
        Ok(())
    }

    /// The step of an archive whose place the `n`-th one takes, by its files, and its time.
    /// `before`: the times of the further steps before.
    fn place_of(
        &self,
        n: usize,
        manifest: &Manifest,
        before: &[(Option<String>, f64)],
        replaces: bool,
    ) -> Result<(Option<u64>, f64)> {
        let (plan, source) = (&self.plan.steps[n], &self.sources[n].source);
        let series = series_of(source);
        let path = source.path.display();
        let old: Vec<&Step> = manifest.steps.iter().filter(|s| is_of_series(manifest, s, series)).collect();
        let at_time = |t: f64| old.iter().find(|s| time_in(manifest, s, series) == t).copied();
        let is_same_file = |s: &&&Step| {
            (&s.plan.source.path, &s.plan.source.field) == (&plan.source.path, &plan.source.field)
        };
        let of_file = old.iter().find(is_same_file).copied();
        // A program may give every step a file of the same name.
        let found = plan.time.and_then(at_time).or(of_file.filter(|_| replaces));
        if let Some(found) = found {
            let time = plan.time.unwrap_or_else(|| time_in(manifest, found, series));
            if !replaces {
                return Err(Error::usage(format!(
                    "{path}: its time, {time}, is that of step {} already, {}: --replace puts it in its place",
                    found.number(),
                    name_of(&found.plan)
                )));
            }
            return self.alone(n, time, before).map(|time| (Some(found.plan.number), time));
        }
        let last = old.iter().map(|s| time_in(manifest, s, series)).fold(f64::NEG_INFINITY, f64::max);
        let time = plan.time.unwrap_or_else(|| self.next_time(n, manifest));
        if time < last || !time.is_finite() {
            // A number says nothing of the place between others.
            let behind = old.iter().find(|s| time_in(manifest, s, series) > time && s.plan.time.is_none());
            if plan.time.is_none() || behind.is_some() || !time.is_finite() {
                return Err(Error::usage(format!(
                    "{path}: times must ascend: the last step is at {last}, this one at {time}, \
                     and not all of these steps have times of their own (give them with --times)"
                )));
            }
        }
        self.alone(n, time, before).map(|time| (None, time))
    }

    /// The time of a further step that has none: its number.
    fn next_time(&self, n: usize, manifest: &Manifest) -> f64 {
        let (base, first) = next_numbers(manifest);
        let moment = self.sources[n].source.part().and_then(|part| part.moment);
        let next = if is_of_fields(manifest) && moment.is_some() { 1 } else { base };
        (next + moment.unwrap_or_else(|| self.plan.steps[n].number.saturating_sub(first))) as f64
    }

    /// A time that no further step of the field before has.
    fn alone(&self, n: usize, time: f64, before: &[(Option<String>, f64)]) -> Result<f64> {
        let source = &self.sources[n].source;
        let is_same =
            |(series, t): &(Option<String>, f64)| series.as_deref() == series_of(source) && *t == time;
        match before.iter().position(is_same) {
            None => Ok(time),
            Some(other) => Err(Error::usage(format!(
                "{}: its time, {time}, is that of {} too: choose one of them",
                source.path.display(),
                self.sources[other].source.path.display()
            ))),
        }
    }

    /// Sorts further steps: those behind the archive's first, field after field by time, then the
    /// others. The files have numbers in this order.
    fn sort(&mut self, manifest: &Manifest, replaced: &[Option<u64>], times: &[(Option<String>, f64)]) {
        let is_behind = |n: usize| {
            let (series, time) = &times[n];
            let old = manifest.steps.iter().filter(|s| is_of_series(manifest, s, series.as_deref()));
            replaced[n].is_none() && old.clone().all(|s| time_in(manifest, s, series.as_deref()) < *time)
        };
        let mut fields: Vec<&Option<String>> = vec![];
        for (series, _) in times {
            if !fields.contains(&series) {
                fields.push(series);
            }
        }
        let field = |n: usize| fields.iter().position(|series| **series == times[n].0);
        let mut order: Vec<usize> = (0..times.len()).collect();
        order.sort_by(|&a, &b| {
            let key = |n| (!is_behind(n), field(n));
            key(a).cmp(&key(b)).then(times[a].1.total_cmp(&times[b].1))
        });
        let mut numbers: Vec<u64> = self.plan.steps.iter().map(|step| step.number).collect();
        numbers.sort_unstable();
        let steps: Vec<_> = order.iter().map(|&n| self.plan.steps[n].clone()).collect();
        self.sources = order.iter().map(|&n| self.sources[n].clone()).collect();
        self.plan.steps = steps;
        for ((&n, step), number) in order.iter().zip(&mut self.plan.steps).zip(numbers) {
            step.number = number;
            if !is_behind(n) {
                self.order.between.insert(number);
            }
            if let Some(old) = replaced[n] {
                self.order.replaced.insert(number, old);
            }
        }
    }

    /// Gives each step its base: the one of its field before it, unless a keyframe is due.
    ///
    /// Steps of the same `number / keyframes` belong together. So a step that is left out changes
    /// the hashes of its own group alone.
    pub(super) fn connect(&mut self) {
        let (mesh, mut lasts) = (self.plan.mesh_hash(), self.order.lasts.clone());
        for (step, from) in self.plan.steps.iter_mut().zip(&self.sources) {
            step.base = None;
            if self.order.between.contains(&step.number) {
                continue;
            }
            let series = series_of(&from.source);
            let last = lasts.iter().position(|(name, _)| name.as_deref() == series);
            let last = last.map(|n| lasts.swap_remove(n).1);
            step.base = last.filter(|l| l.number / self.keyframes == step.number / self.keyframes);
            let own = BaseStep { number: step.number, hash: step.hash(mesh) };
            lasts.push((series.map(str::to_owned), own));
        }
    }

    /// The numbers that the steps had that these replace.
    pub(super) fn replaced(&self, old: Option<&Manifest>) -> Vec<u64> {
        let files: BTreeSet<u64> = self.order.replaced.values().copied().collect();
        let old = old.into_iter().flat_map(|old| &old.steps);
        old.filter(|step| files.contains(&step.plan.number)).map(Step::number).collect()
    }

    /// Puts the finished steps of an archive in order: those of an older one, then those of the
    /// plan.
    pub(super) fn put_in_order(&self, old: Option<&Manifest>, contents: &mut ArchiveContents) {
        let none = Manifest::new(self.plan.mesh.clone(), contents.counts, vec![], vec![]);
        let old = old.unwrap_or(&none);
        let mut steps = std::mem::take(&mut contents.steps);
        let new = steps.split_off(old.steps.len());
        let mut bases = std::mem::take(&mut contents.bases);
        let is_replaced = |step: &Step| self.order.replaced.values().any(|files| *files == step.plan.number);
        let mut entries = vec![];
        let has_series = self.sources.iter().any(|from| series_of(&from.source).is_some());
        for step in steps {
            let series = has_series.then(|| series_in(old, &step)).or(step.series.clone());
            let time = time_in(old, &step, series.as_deref());
            let number = if has_series && is_of_fields(old) { 0 } else { step.number() };
            match is_replaced(&step) {
                true => bases.push(step),
                false => entries.push(Entry { time, wish: Some(number), step: Step { series, ..step } }),
            }
        }
        for (n, step) in new.into_iter().enumerate() {
            entries.push(self.entry(n, old, step));
        }
        contents.steps = numbered(entries);
        contents.bases = needed(&contents.steps, bases);
    }

    /// The entry of the `n`-th step of the plan.
    fn entry(&self, n: usize, old: &Manifest, step: Step) -> Entry {
        let (number, series) = (step.plan.number, series_of(&self.sources[n].source));
        let replaced = self.order.replaced.get(&number);
        let replaced = replaced.and_then(|files| old.steps.iter().find(|s| s.plan.number == *files));
        let (wish, time) = match replaced {
            Some(replaced) => {
                let time = time_in(old, replaced, series);
                let is_moved = step.plan.time.is_some_and(|own| own != time);
                let wish = if series.is_some() && is_of_fields(old) { 0 } else { replaced.number() };
                (Some(wish).filter(|_| !is_moved), step.plan.time.unwrap_or(time))
            }
            None if self.order.between.contains(&number) => (None, step.plan.time.unwrap_or_default()),
            None => {
                let wish = self.next_time(n, old);
                (Some(wish as u64), step.plan.time.unwrap_or(wish))
            }
        };
        Entry { time, wish, step: Step { series: series.map(str::to_owned), ..step } }
    }
}

/// A step that gets its place.
struct Entry {
    time: f64,
    /// The number that it had, or is to have.
    wish: Option<u64>,
    step: Step,
}

/// The number of the step behind all of an archive, and that of its files.
fn next_numbers(manifest: &Manifest) -> (u64, u64) {
    let next = manifest.steps.iter().map(|step| step.number() + 1).max().unwrap_or(0);
    (next, next_files(manifest))
}

/// The number of the files of a further step.
pub(super) fn next_files(manifest: &Manifest) -> u64 {
    manifest.all_steps().map(|step| step.plan.number + 1).max().unwrap_or(0)
}

/// Steps field after field, by time; fields of the same time have the same number.
fn numbered(mut entries: Vec<Entry>) -> Vec<Step> {
    let mut times: Vec<f64> = entries.iter().map(|e| e.time).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let (mut numbers, mut next) = (vec![], 0);
    for time in &times {
        let wish = entries.iter().filter(|e| e.time == *time).filter_map(|e| e.wish).min();
        let number = wish.unwrap_or(next).max(next);
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
        Step { place: Some(number).filter(|n| *n != entry.step.plan.number), ..entry.step }
    };
    entries.into_iter().map(place).collect()
}

/// The steps that others have replaced, as far as their values or coordinates are referred to.
fn needed(steps: &[Step], mut bases: Vec<Step>) -> Vec<Step> {
    let mut wanted: BTreeSet<u64> =
        steps.iter().filter_map(|step| step.plan.base).map(|b| b.number).collect();
    // A base has a lower number than those that refer to it.
    bases.sort_by_key(|step| std::cmp::Reverse(step.plan.number));
    let mut kept = vec![];
    for step in bases {
        if wanted.contains(&step.plan.number) || step.coordinates.is_some() {
            wanted.extend(step.plan.base.map(|base| base.number));
            let (level_errors, place, series) = (vec![], None, None);
            kept.push(Step { index: None, spectrum: None, error: None, level_errors, place, series, ..step });
        }
    }
    kept.reverse();
    kept
}
