//! Which steps of a series a question is about: by number, by time, or a range of them.

use crate::archive::manifest::{Manifest, StoredStep};
use isospan_io::error::{Error, Result};
use isospan_io::formats::without_frame;
use std::collections::BTreeSet;
use std::ops::{Range, RangeFull, RangeInclusive};
use std::path::Path;
use std::str::FromStr;

/// Which step of an archive is asked.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum StepChoice {
    /// The first; of its first field.
    #[default]
    First,
    /// The one of a number.
    Number(u64),
    /// A time; between two steps values are linear.
    Time(f64),
    /// The one that has the field of this name, where the fields of a file are the steps; the first
    /// one where each step has several fields.
    Field(String),
    /// The one of a number, and the field of this name.
    NumberOf(u64, String),
    /// A time, and the field of this name.
    TimeOf(f64, String),
}

/// A range of steps, by their numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepRange {
    /// The first; the archive's first if not given.
    pub first: Option<u64>,
    /// The last, included; the archive's last if not given.
    pub last: Option<u64>,
}

impl From<RangeFull> for StepRange {
    fn from(_: RangeFull) -> Self {
        Self::default()
    }
}

impl From<RangeInclusive<u64>> for StepRange {
    fn from(numbers: RangeInclusive<u64>) -> Self {
        Self { first: Some(*numbers.start()), last: Some(*numbers.end()) }
    }
}

impl StepRange {
    /// Whether the step of a number is in the range.
    pub fn contains(self, number: u64) -> bool {
        self.first.is_none_or(|first| first <= number) && self.last.is_none_or(|last| number <= last)
    }

    /// The positions in a manifest of the steps in the range, of a field where each step has
    /// several.
    pub(in crate::pipeline) fn positions(
        self,
        manifest: &Manifest,
        field: Option<&str>,
        shown: &Path,
    ) -> Result<Range<usize>> {
        let run = run_of(manifest, field, shown)?;
        let steps = &manifest.steps[run.clone()];
        let from = steps.partition_point(|s| self.first.is_some_and(|first| s.number() < first));
        let to = steps.partition_point(|s| self.last.is_none_or(|last| s.number() <= last));
        if from < to {
            expect_field(&steps[from..to], field, "steps together are those of one field", shown)?;
            return Ok(run.start + from..run.start + to);
        }
        Err(Error::no_such(format!("{}: no step in that range; it has {}", shown.display(), numbers(steps))))
    }
}

impl FromStr for StepRange {
    type Err = Error;

    /// `3:8`, `3:`, `:8`, or `3`.
    fn from_str(text: &str) -> Result<Self> {
        let bad =
            || Error::usage(format!("'{text}' is no range of steps; write FIRST:LAST, as in 3:8 or 3:"));
        let number = |s: &str| match s.trim() {
            "" => Ok(None),
            s => s.parse().map(Some).map_err(|_| bad()),
        };
        let (first, last) = match text.split_once(':') {
            Some((first, last)) => (number(first)?, number(last)?),
            None if text.trim().is_empty() => return Err(bad()),
            None => (number(text)?, number(text)?),
        };
        if first.zip(last).is_some_and(|(first, last)| first > last) {
            return Err(bad());
        }
        Ok(Self { first, last })
    }
}

/// A step, or a moment between it and the next one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::pipeline) struct Moment {
    /// Position of the step in the manifest.
    pub(in crate::pipeline) step: usize,
    /// How far it is to the next step; above 0, below 1.
    pub(in crate::pipeline) beyond: Option<f64>,
}

impl Moment {
    /// # Errors
    /// [`Error::Usage`] that says which steps there are.
    pub(in crate::pipeline) fn of(manifest: &Manifest, choice: StepChoice, shown: &Path) -> Result<Self> {
        match choice {
            StepChoice::First => Ok(Self::default()),
            StepChoice::Number(number) => Self::of_number(manifest, number, None, shown),
            StepChoice::NumberOf(number, field) => Self::of_number(manifest, number, Some(&field), shown),
            StepChoice::Time(time) => Self::of_time(manifest, time, None, shown),
            StepChoice::TimeOf(time, field) => Self::of_time(manifest, time, Some(&field), shown),
            StepChoice::Field(name) if manifest.steps[0].series.is_some() => {
                let run = run_of(manifest, Some(&name), shown)?;
                Ok(Self { step: run.start, beyond: None })
            }
            StepChoice::Field(name) => {
                Ok(Self { step: position_of_field(&manifest.steps, &name, shown)?, beyond: None })
            }
        }
    }

    /// The names of all fields that a manifest has at this moment.
    pub(super) fn fields(self, manifest: &Manifest) -> Vec<&str> {
        let steps = &manifest.steps;
        if is_of_fields(manifest) {
            return steps.iter().map(StoredStep::field).collect();
        }
        let number = steps[self.step].number();
        let has_it = |run: &&[StoredStep]| run.iter().any(|step| step.number() == number);
        match steps[self.step].series {
            Some(_) => manifest.runs().filter(has_it).map(|run| run[0].field()).collect(),
            None => vec![steps[self.step].field()],
        }
    }

    /// The same moment, of another field.
    pub(super) fn in_field(self, manifest: &Manifest, field: &str, shown: &Path) -> Result<Self> {
        let steps = &manifest.steps;
        if steps[self.step].field() == field {
            return Ok(self);
        }
        if is_of_fields(manifest) {
            return Self::of(manifest, StepChoice::Field(field.to_owned()), shown);
        }
        let at = |n: usize| Self::of_number(manifest, steps[n].number(), Some(field), shown);
        let found = at(self.step)?;
        // Between two steps the field must have the same two.
        if self.beyond.is_some() && at(self.step + 1)?.step != found.step + 1 {
            return Err(Error::usage(format!(
                "{}: {field} has a step between steps {} and {}",
                shown.display(),
                steps[self.step].number(),
                steps[self.step + 1].number()
            )));
        }
        Ok(Self { beyond: self.beyond, ..found })
    }

    fn of_number(manifest: &Manifest, number: u64, field: Option<&str>, shown: &Path) -> Result<Self> {
        let run = run_of(manifest, field, shown)?;
        let steps = &manifest.steps[run.clone()];
        let Ok(n) = steps.binary_search_by_key(&number, StoredStep::number) else {
            let text = numbers(steps);
            return Err(Error::no_such(format!("{}: no step {number}; it has {text}", shown.display())));
        };
        match field.filter(|name| !has_field(&steps[n], name)) {
            Some(name) => Err(Error::no_such(format!(
                "{}: step {number} has the field {}, not {name}",
                shown.display(),
                steps[n].field()
            ))),
            None => Ok(Self { step: run.start + n, beyond: None }),
        }
    }

    fn of_time(manifest: &Manifest, t: f64, field: Option<&str>, shown: &Path) -> Result<Self> {
        let run = run_of(manifest, field, shown)?;
        let steps = &manifest.steps[run.clone()];
        expect_field(steps, field, "values at a time are those of one field", shown)?;
        let time = |n: usize| steps[n].time_or_number();
        let at = |n: usize, beyond| Ok(Self { step: run.start + n, beyond });
        match (0..steps.len()).position(|n| time(n) >= t) {
            Some(n) if time(n) == t => at(n, None),
            Some(n) if n > 0 => {
                let share = (t - time(n - 1)) / (time(n) - time(n - 1));
                // A share so small that it rounds to none is no share.
                let beyond = Some(share).filter(|s| *s > 0.0 && *s < 1.0);
                at(if share < 1.0 { n - 1 } else { n }, beyond)
            }
            _ => Err(Error::no_such(format!(
                "{}: the time {t} is not within {} .. {}",
                shown.display(),
                time(0),
                time(steps.len() - 1)
            ))),
        }
    }
}

/// Whether the steps of an archive are the fields of one moment.
pub(in crate::pipeline) fn is_of_fields(manifest: &Manifest) -> bool {
    let steps = &manifest.steps;
    let is_plain = |s: &StoredStep| {
        let field = &s.plan.source.field;
        s.series.is_none() && s.plan.time.is_none() && without_frame(field) == field
    };
    if steps.len() < 2 || !steps.iter().all(is_plain) {
        return false;
    }
    let names: BTreeSet<&str> = steps.iter().map(|s| &*s.plan.source.field).collect();
    names.len() == steps.len()
}

/// Whether a step has the field of a name, or a frame of it.
fn has_field(step: &StoredStep, name: &str) -> bool {
    step.field() == name || without_frame(step.field()) == name
}

/// Refuses steps of which one has not the field that is asked.
fn expect_field(steps: &[StoredStep], field: Option<&str>, why: &str, shown: &Path) -> Result<()> {
    let Some(name) = field else { return Ok(()) };
    match steps.iter().find(|step| !has_field(step, name)) {
        Some(other) => Err(Error::usage(format!(
            "{}: step {} has the field {}, not {name}: {why}",
            shown.display(),
            other.number(),
            other.field()
        ))),
        None => Ok(()),
    }
}

/// The positions of the steps of a field, where each step has several; else of all steps.
fn run_of(manifest: &Manifest, field: Option<&str>, shown: &Path) -> Result<Range<usize>> {
    let steps = &manifest.steps;
    if steps[0].series.is_none() {
        return Ok(0..steps.len());
    }
    let fields = || manifest.runs().map(|run| run[0].field()).collect::<Vec<_>>().join(", ");
    let Some(name) = field else {
        if manifest.runs().count() == 1 {
            return Ok(0..steps.len());
        }
        return Err(Error::usage(format!(
            "{}: each step has the fields {}: choose one with `field`",
            shown.display(),
            fields()
        )));
    };
    let Some(start) = steps.iter().position(|step| step.field() == name) else {
        return Err(Error::no_such(format!("{}: no field {name}; it has {}", shown.display(), fields())));
    };
    let end = steps[start..].iter().position(|step| step.field() != name);
    Ok(start..end.map_or(steps.len(), |n| start + n))
}

/// The position of the only step with a field of this name.
fn position_of_field(steps: &[StoredStep], name: &str, shown: &Path) -> Result<usize> {
    let mut found = (0..steps.len()).filter(|&n| steps[n].field() == name);
    match (found.next(), found.count()) {
        (Some(position), 0) => Ok(position),
        (Some(_), more) => Err(Error::usage(format!(
            "{}: {} steps have the field {name}: choose one by its number or time",
            shown.display(),
            more + 1
        ))),
        (None, _) => {
            let mut fields: Vec<&str> = steps.iter().map(StoredStep::field).collect();
            fields.sort_unstable();
            fields.dedup();
            fields.truncate(20);
            Err(Error::no_such(format!(
                "{}: no step has the field {name}; it has {}",
                shown.display(),
                fields.join(", ")
            )))
        }
    }
}

/// "steps 0 to 7", "steps 0, 2, 3".
fn numbers(steps: &[StoredStep]) -> String {
    let all: Vec<u64> = steps.iter().map(StoredStep::number).collect();
    let (first, last) = (all[0], all[all.len() - 1]);
    if all.len() == 1 {
        format!("step {first}")
    } else if last - first + 1 == all.len() as u64 {
        format!("steps {first} to {last}")
    } else {
        const MOST: usize = 20;
        let list: Vec<String> = all.iter().take(MOST).map(u64::to_string).collect();
        let more = if all.len() > MOST { ", …" } else { "" };
        format!("steps {}{more}", list.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_steps_are_written_as_two_numbers() {
        let range = |first, last| StepRange { first, last };
        let parse = |text: &str| text.parse::<StepRange>().unwrap();
        assert_eq!(parse("3:8"), range(Some(3), Some(8)));
        assert_eq!(parse(":8"), range(None, Some(8)));
        assert_eq!(parse("3:"), range(Some(3), None));
        assert_eq!(parse("4"), range(Some(4), Some(4)));
        for bad in ["", "8:3", "a", "1:2:3", "-1:"] {
            assert_eq!(bad.parse::<StepRange>().unwrap_err().exit_code(), 2, "{bad}");
        }
    }
}
