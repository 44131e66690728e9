//! Arranges the steps of a plan: units, places among those of an archive, bases.

use super::contents::ArchiveContents;
use super::job::Job;
use super::order::{
    Entry, LastStep, ends_with, is_of_series, is_there, name_of, needed, next_numbers, numbered, series_in,
    series_of, time_in,
};
use super::series::{KnownUnits, SeriesPlan, is_of_data};
use crate::archive::manifest::{Manifest, StepPlan, StoredStep};
use crate::pipeline::read::{OpenArchive, is_of_fields};
use isospan_io::error::{Error, Result};
use isospan_io::formats::StepSource;
use std::collections::BTreeSet;

impl SeriesPlan {
    /// Gives steps whose files name no unit those of the steps before, also of an archive that they
    /// are added to: of lengths and times those of any step, of values those of the same field.
    ///
    /// # Errors
    /// [`Error::Usage`] where a step has another unit; where steps may be left out, it is.
    pub(super) fn share_units(&mut self, job: &Job<'_>) -> Result<()> {
        let mut known = KnownUnits::default();
        let old = job.basis.archive().into_iter().flat_map(|archive| &archive.manifest.steps);
        old.for_each(|step| known.learn(&step.plan));
        let mut n = 0;
        while n < self.plan.steps.len() {
            let step = &mut self.plan.steps[n];
            match known.agree(step, &self.sources[n].source) {
                Ok(()) => {
                    known.learn(step);
                    n += 1;
                }
                Err(e) => self.refuse(n, job, e)?,
            }
        }
        Ok(())
    }

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
            let is_number = self.plan.steps[n].time.is_none();
            let why = if is_number { ", its number, because it has no time" } else { "" };
            let error = Error::usage(format!(
                "times must ascend: step {} is at {a}, step {} at {b}{why} (give them with `times`)",
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
        let mut lasts: Vec<LastStep> = vec![];
        for step in &manifest.steps {
            let has_series = times.first().is_some_and(|(series, _)| series.is_some());
            let series = has_series.then(|| series_in(manifest, step));
            lasts.retain(|last| last.series != series);
            if !is_replaced(step.plan.number) {
                lasts.push(LastStep::new(series, &step.plan, manifest.plan_hash));
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
        let old: Vec<&StoredStep> =
            manifest.steps.iter().filter(|s| is_of_series(manifest, s, series)).collect();
        let at_time = |t: f64| old.iter().find(|s| time_in(manifest, s, series) == t).copied();
        let is_same_file = |s: &&&StoredStep| {
            (&s.plan.source.path, &s.plan.source.field) == (&plan.source.path, &plan.source.field)
        };
        let of_file = old.iter().find(is_same_file).copied();
        // A program may give every step a file of the same name.
        let found = plan.time.and_then(at_time).or(of_file.filter(|_| replaces));
        if let Some(found) = found {
            let time = plan.time.unwrap_or_else(|| time_in(manifest, found, series));
            if !replaces {
                return Err(Error::usage(format!(
                    "{path}: its time, {time}, is that of step {} already, {}: `replace_steps=true` puts it in its place",
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
                     and not all of these steps have times of their own (give them with `times`)"
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
            let mut old = manifest.steps.iter().filter(|s| is_of_series(manifest, s, series.as_deref()));
            replaced[n].is_none() && old.all(|s| time_in(manifest, s, series.as_deref()) < *time)
        };
        let behind: Vec<bool> = (0..times.len()).map(is_behind).collect();
        let mut fields: Vec<&Option<String>> = vec![];
        for (series, _) in times {
            if !fields.contains(&series) {
                fields.push(series);
            }
        }
        let field = |n: usize| fields.iter().position(|series| **series == times[n].0);
        let mut order: Vec<usize> = (0..times.len()).collect();
        order.sort_by(|&a, &b| {
            let key = |n: usize| (!behind[n], field(n));
            key(a).cmp(&key(b)).then(times[a].1.total_cmp(&times[b].1))
        });
        let mut numbers: Vec<u64> = self.plan.steps.iter().map(|step| step.number).collect();
        numbers.sort_unstable();
        let steps: Vec<_> = order.iter().map(|&n| self.plan.steps[n].clone()).collect();
        self.sources = order.iter().map(|&n| self.sources[n].clone()).collect();
        self.plan.steps = steps;
        for ((&n, step), number) in order.iter().zip(&mut self.plan.steps).zip(numbers) {
            step.number = number;
            if !behind[n] {
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
            if self.order.between.contains(&step.number) || self.plan.mesh.has_labels() {
                continue;
            }
            let series = series_of(&from.source);
            let last = lasts.iter().position(|last| last.series.as_deref() == series);
            let last = last.map(|n| lasts.swap_remove(n));
            step.base = last.and_then(|last| last.base_of(step, self.keyframes));
            lasts.push(LastStep::new(series.map(str::to_owned), step, mesh));
        }
    }

    /// The numbers that the steps had that these replace.
    pub(super) fn replaced(&self, old: Option<&Manifest>) -> Vec<u64> {
        let files: BTreeSet<u64> = self.order.replaced.values().copied().collect();
        let old = old.into_iter().flat_map(|old| &old.steps);
        old.filter(|step| files.contains(&step.plan.number)).map(StoredStep::number).collect()
    }

    /// Puts the finished steps of an archive in order: those of an older one, then those of the
    /// plan.
    pub(super) fn put_in_order(&self, old: Option<&Manifest>, contents: &mut ArchiveContents) {
        let none = Manifest::new(self.plan.mesh.clone(), contents.counts, vec![], vec![]);
        let old = old.unwrap_or(&none);
        let mut steps = std::mem::take(&mut contents.steps);
        let new = steps.split_off(old.steps.len());
        let mut bases = std::mem::take(&mut contents.bases);
        let is_replaced =
            |step: &StoredStep| self.order.replaced.values().any(|files| *files == step.plan.number);
        let mut entries = vec![];
        let has_series = self.sources.iter().any(|from| series_of(&from.source).is_some());
        for step in steps {
            let series = has_series.then(|| series_in(old, &step)).or(step.series.clone());
            let time = time_in(old, &step, series.as_deref());
            let number = if has_series && is_of_fields(old) { 0 } else { step.number() };
            match is_replaced(&step) {
                true => bases.push(step),
                false => {
                    entries.push(Entry { time, wish: Some(number), step: StoredStep { series, ..step } })
                }
            }
        }
        for (n, step) in new.into_iter().enumerate() {
            entries.push(self.entry(n, old, step));
        }
        contents.steps = numbered(entries);
        contents.bases = needed(&contents.steps, bases);
    }

    /// The entry of the `n`-th step of the plan.
    fn entry(&self, n: usize, old: &Manifest, step: StoredStep) -> Entry {
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
        Entry { time, wish, step: StoredStep { series: series.map(str::to_owned), ..step } }
    }
}
