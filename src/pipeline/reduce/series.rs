//! The plan of a series of steps, and where each step comes from.

use super::order::Order;
use crate::archive::manifest::StepPlan;
use crate::pipeline::plan::{Attachments, Layout, Plan, Watch};
use isospan_io::error::{Error, Result};
use isospan_io::formats::{StepSource, without_frame};
use isospan_io::volume::chunked::ChunkShape;
use isospan_io::volume::units::Unit;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};

/// A step that was left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SkippedStep {
    /// The number that it would have had.
    pub number: u64,
    /// Its file.
    pub source: String,
    /// What is wrong with it.
    pub reason: String,
}

/// What copies of inputs take.
pub(super) struct Copies {
    /// Bytes on disk.
    pub(super) scratch: u64,
    /// Memory while one is made.
    pub(super) memory: u64,
}

/// Where a step comes from.
#[derive(Clone)]
pub(in crate::pipeline) struct PlannedSource {
    pub(super) source: StepSource,
    /// The chunks of a source that is read by chunks.
    pub(super) chunks: Option<ChunkShape>,
    /// Bytes of decoded chunks in its cache, where it is read through one.
    pub(super) cached: Option<u64>,
    /// Bytes of the copy that is made of it alone; 0 where none is needed.
    pub(super) copied: u64,
    /// Bytes of a copy that is made of its file, once for all steps in that; 0 where none is
    /// needed.
    pub(super) shared_copy: u64,
    /// Memory to make that copy in, or to read its chunks one after another.
    pub(super) copying: u64,
}

/// Bytes of a copy that is made in memory, at most, where there is enough of that.
const SMALL_COPY: u64 = 4 << 20;
/// Bytes of copies that are on the disk at a time, where there is more than one.
const COPIES_TOGETHER: u64 = 256 << 20;

impl PlannedSource {
    /// One that is read where it lies.
    pub(super) fn in_place(source: StepSource) -> Self {
        Self { source, chunks: None, cached: None, copied: 0, shared_copy: 0, copying: 0 }
    }

    /// Whether these may be made in one pass.
    pub(super) fn fit_together(sources: &[Self]) -> bool {
        sources.len() == 1 || sources.iter().map(|s| s.copied).fold(0, u64::saturating_add) <= COPIES_TOGETHER
    }

    /// Whether its copy is small.
    pub(super) fn is_small(&self) -> bool {
        self.copied <= SMALL_COPY
    }

    /// The most bytes of the small copies of `at_once` steps at a time.
    pub(super) fn small_copies(sources: &[Self], at_once: usize) -> u64 {
        let largest = sources.iter().filter(|s| s.is_small()).map(|s| s.copied).max().unwrap_or(0);
        largest * at_once.min(sources.len()) as u64
    }

    /// What copies of these take at a time.
    pub(super) fn copies(sources: &[Self]) -> Copies {
        let memory = sources.iter().map(|s| s.copying).max().unwrap_or(0);
        Copies { scratch: Self::copied_at_a_time(sources), memory }
    }

    /// Bytes of the copies that are on the disk at a time, at most.
    fn copied_at_a_time(sources: &[Self]) -> u64 {
        let all = sources.iter().map(|s| s.copied).fold(0, u64::saturating_add);
        let largest = sources.iter().map(|s| s.copied.max(s.shared_copy)).max().unwrap_or(0);
        largest.max(all.min(COPIES_TOGETHER))
    }
}

/// The plan of a series, and where its steps come from.
pub(in crate::pipeline) struct SeriesPlan {
    pub(in crate::pipeline) plan: Plan,
    /// The source of each step of the plan.
    pub(in crate::pipeline) sources: Vec<PlannedSource>,
    pub(in crate::pipeline) skipped: Vec<SkippedStep>,
    /// Where the steps go among those that the archive has already.
    pub(super) order: Order,
    /// Whether the archive has all of these steps already.
    pub(super) is_there: bool,
    pub(in crate::pipeline) keyframes: u64,
    /// What is stored with the plan.
    pub(in crate::pipeline) attachments: Attachments,
    /// The files of all steps, which must not change until all is made.
    pub(in crate::pipeline) watch: Watch,
}

impl SeriesPlan {
    /// Whether the `n`-th step may be made with the one before it: where it refers to one, to that.
    pub(super) fn follows(&self, n: usize) -> bool {
        let base = self.plan.steps[n].base;
        base.is_none_or(|base| base.number == self.plan.steps[n - 1].number)
    }

    /// Whether errors name the step.
    pub(super) fn is_several(&self) -> bool {
        self.plan.steps.len() + self.skipped.len() > 1 || self.order.is_continued()
    }

    /// Notes that a step is not made.
    pub(super) fn skip(&mut self, number: u64, source: &StepSource, reason: String) {
        let source = source.path.display().to_string();
        self.skipped.push(SkippedStep { number, source, reason });
        self.skipped.sort_by_key(|s| s.number);
    }

    /// Goes on without the steps at these positions of the plan, which cannot be used, and why.
    pub(super) fn leave_out(&mut self, bad: BTreeMap<usize, String>, layout: &Layout) -> Result<()> {
        for (n, reason) in bad.into_iter().rev() {
            let (step, source) = (self.plan.steps.remove(n), self.sources.remove(n));
            self.skip(step.number, &source.source, reason);
            layout.at(step.number).remove_step()?;
        }
        self.connect();
        Ok(())
    }
}

/// The units of the steps so far, and which step has each.
#[derive(Default)]
pub(super) struct KnownUnits {
    length: Option<(Unit, u64)>,
    time: Option<(Unit, u64)>,
    values: HashMap<String, (Unit, u64)>,
}

impl KnownUnits {
    pub(super) fn learn(&mut self, step: &StepPlan) {
        let (units, number) = (&step.source.units, step.number);
        let with_step = |unit: &Option<Unit>| unit.clone().map(|unit| (unit, number));
        self.length = self.length.take().or(with_step(&units.length));
        self.time = self.time.take().or(with_step(&units.time));
        if let Some(value) = with_step(&units.value) {
            self.values.entry(without_frame(&step.source.field).to_owned()).or_insert(value);
        }
    }

    pub(super) fn agree(&self, step: &mut StepPlan, from: &StepSource) -> Result<()> {
        let units = &mut step.source.units;
        let same = |own: &mut Option<Unit>, known: Option<&(Unit, u64)>, of: &str, flag: &str| {
            let Some((known, number)) = known else { return Ok(()) };
            match own {
                Some(unit) if unit != known => Err(Error::usage(format!(
                    "{}: the unit of its {of} is {unit}, that of step {number} is {known}: \
                     convert the file, or name the unit with {flag} if both mean the same",
                    from.path.display()
                ))),
                _ => {
                    *own = Some(known.clone());
                    Ok(())
                }
            }
        };
        same(&mut units.length, self.length.as_ref(), "lengths", "`length_unit`")?;
        if step.time.is_some() {
            same(&mut units.time, self.time.as_ref(), "times", "`time_unit`")?;
        }
        let value = self.values.get(without_frame(&step.source.field));
        same(&mut units.value, value, "values", "`unit`")
    }
}

/// The field of the first step of a series. Files whose only field has another name need a choice.
pub(super) struct FieldOfSeries {
    step: u64,
    name: String,
}

/// The name that readers give to the field of a format without names.
const NAMELESS: &str = "data";

impl FieldOfSeries {
    pub(super) fn new(step: u64, name: &str) -> Self {
        Self { step, name: name.to_owned() }
    }

    /// Whether the field that a reader chose is the one of the series.
    ///
    /// # Errors
    /// [`Error::Usage`] if its name is another one and no `field` asked for it, or is not that of
    /// one of several fields.
    pub(super) fn check(&self, source: &StepSource, name: &str) -> Result<()> {
        if let Some(part) = source.part().filter(|part| name != part.name && without_frame(name) != part.name)
        {
            let path = source.path.display();
            return Err(Error::no_such(format!("{path}: no field {}; it has {name}", part.name)));
        }
        let is_chosen = source.options.field.is_some();
        if is_chosen || name == self.name || [name, &self.name[..]].contains(&NAMELESS) {
            return Ok(());
        }
        Err(Error::usage(format!(
            "{}: its field is {name}, the field of step {} is {}; if both are meant, say so with `field=PATTERN`",
            source.path.display(),
            self.step,
            self.name
        )))
    }
}

/// Whether an error is one of a step's data, and other steps may be better.
pub(super) fn is_of_data(error: &Error) -> bool {
    matches!(error, Error::BadInput(_) | Error::Io { .. } | Error::Usage(_) | Error::NoSuch(_))
        && error.exit_code() != 4
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan_io::formats::OpenOptions;

    #[test]
    fn small_copies_are_on_the_disk_together_and_large_ones_alone() {
        let step = StepSource::new(std::path::Path::new("a"), &OpenOptions::default());
        let source = |copied: u64| PlannedSource { copied, ..PlannedSource::in_place(step.clone()) };
        let all: Vec<PlannedSource> = [0, 200 << 20, 56 << 20, 1, 300 << 20].map(source).into();
        assert!(PlannedSource::fit_together(&all[..3]) && !PlannedSource::fit_together(&all[..4]));
        assert!(PlannedSource::fit_together(&all[4..]) && !PlannedSource::fit_together(&all[3..]));
        assert_eq!(PlannedSource::copied_at_a_time(&all), 300 << 20);
        assert_eq!(PlannedSource::copied_at_a_time(&all[..4]), 256 << 20);
        assert_eq!(PlannedSource::copied_at_a_time(&all[..2]), 200 << 20);
    }
}
