//! The flags that choose a step of an archive, and those that give the times of steps.

use super::grammar;
use super::input::InputArgs;
use super::progress::Talk;
use super::text;
use super::times::Times;
use isospan::formats::{OpenOptions, StepSource, order_in_doubt, steps_of, steps_of_fields};
use isospan::pipeline::{Step, StepChoice, StepRange, StepSummary, is_archive};
use isospan::volume::units::{Unit, Units};
use isospan::{Archive, Error, Result};
use std::path::{Path, PathBuf};

/// The steps that are made.
#[derive(clap::Args, Debug)]
pub struct StepInputs {
    /// The volume or mesh, in any format that isospan reads; a volume also by address (s3://... or
    /// https://...); or an archive that is a pyramid, whose samples are taken. Several inputs are
    /// the steps of a series. So are a quoted pattern
    /// ("step_*.vti"), a .pvd or .series file, a file with frames, and the fields that match
    /// --field PATTERN.
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// Times of the steps: 0,0.5,2, or 0,0.5,... which goes on like that [default: those in the
    /// files, else the step numbers].
    #[arg(help_heading = "Series", long, value_name = "TIMES", value_parser = grammar::times, allow_hyphen_values = true)]
    times: Option<Times>,
    /// Fields of the input to reduce on the same points, by their names. Of one moment, each is a
    /// step of the archive, and --step NAME asks for one. Of many steps, in one file or in several,
    /// each step has all fields: --step N --field NAME asks for one.
    #[arg(
        help_heading = "Input",
        long,
        value_name = "NAME[,NAME..]",
        value_delimiter = ',',
        conflicts_with = "field"
    )]
    fields: Vec<String>,
    /// Unit of the values, as in K or kg/m3 [default: that in the file, if it has one].
    #[arg(help_heading = "Units", long, value_name = "UNIT", value_parser = grammar::unit, conflicts_with = "fields")]
    unit: Option<Unit>,
    /// Unit of lengths in the world, as in mm [default: that in the file, if it has one].
    #[arg(help_heading = "Units", long, value_name = "UNIT", value_parser = grammar::length_unit)]
    length_unit: Option<Unit>,
    /// Unit of the times of steps, as in s [default: that in the file, if it has one].
    #[arg(help_heading = "Units", long, value_name = "UNIT", value_parser = grammar::time_unit)]
    time_unit: Option<Unit>,
    /// Leave out steps that cannot be used, and report them.
    #[arg(help_heading = "Series", long)]
    pub(crate) keep_going: bool,
}

impl StepInputs {
    /// All steps of a new archive, in order.
    pub(crate) fn all(&self, read: &InputArgs, talk: &Talk) -> Result<Vec<StepSource>> {
        let mut steps = self.found(read, talk)?;
        if steps.len() == self.fields.len() {
            // Fields of one moment are no series in time.
            let of_one = |(name, step): (&String, StepSource)| step.at(None).as_field(name, None);
            steps = self.fields.iter().zip(steps).map(of_one).collect();
        }
        self.tell(&mut steps)?;
        Ok(steps)
    }

    /// Further steps of an archive, in order.
    pub(crate) fn further(&self, read: &InputArgs, talk: &Talk) -> Result<Vec<StepSource>> {
        let mut steps = self.found(read, talk)?;
        self.tell(&mut steps)?;
        Ok(steps)
    }

    /// The steps of archives, field after field where several are named.
    fn of_archives(&self, options: &OpenOptions) -> Result<Vec<StepSource>> {
        if let Some(other) = self.inputs.iter().find(|input| !is_archive(input)) {
            let other = other.display();
            return Err(Error::usage(format!(
                "{other} is no archive, as others of the inputs are: give one kind"
            )));
        }
        let (field, level) = (options.field.clone(), archive_level(options)?);
        let of = |field: Option<String>| -> Result<Vec<StepSource>> {
            let sources = self
                .inputs
                .iter()
                .map(|path| Archive::open(path)?.in_field(field.clone()).sources_of_level(level));
            Ok(sources.collect::<Result<Vec<_>>>()?.concat())
        };
        if self.fields.is_empty() {
            return of(field);
        }
        let mut all = vec![];
        for name in &self.fields {
            let steps = of(Some(name.clone()))?;
            all.extend((0..).zip(steps).map(|(moment, step)| step.as_field(name, Some(moment))));
        }
        Ok(all)
    }

    fn found(&self, read: &InputArgs, talk: &Talk) -> Result<Vec<StepSource>> {
        let options = read.options()?;
        if self.inputs.iter().any(|input| is_archive(input)) {
            return self.of_archives(&options);
        }
        let steps = match &self.fields[..] {
            [] => steps_of(&self.inputs, &options)?,
            fields => steps_of_fields(&self.inputs, fields, &options)?,
        };
        let doubt = if self.fields.is_empty() { order_in_doubt(&self.inputs, &steps) } else { None };
        if let (None, Some(doubt)) = (&self.times, doubt) {
            let help = "a quoted pattern (\"step_*.vti\") takes files in the order of their numbers, `times` tells the times";
            talk.note(&format!("warning: {doubt}: {help}"));
        }
        Ok(steps)
    }

    /// Gives steps the units and the times that the user gave.
    pub fn tell(&self, steps: &mut [StepSource]) -> Result<()> {
        let units = Units {
            value: self.unit.clone(),
            length: self.length_unit.clone(),
            time: self.time_unit.clone(),
        };
        steps.iter_mut().for_each(|step| step.options.units.clone_from(&units));
        self.times.as_ref().map_or(Ok(()), |times| times.apply(steps))
    }
}

/// Which step of a series is asked, and which of its fields.
#[derive(clap::Args, Debug)]
pub(crate) struct StepArgs {
    #[command(flatten)]
    moment: MomentArgs,
    /// The field, where each step has several.
    #[arg(help_heading = "Series", long, value_name = "NAME")]
    field: Option<String>,
}

/// Which step of a series is asked.
#[derive(clap::Args, Debug)]
pub(crate) struct MomentArgs {
    /// Number of the step, or the name of its field; `isospan info` lists them [default: the
    /// first].
    #[arg(help_heading = "Series", long, value_name = "N|FIELD")]
    step: Option<String>,
    /// A time; values between two steps are interpolated linearly.
    #[arg(
        help_heading = "Series",
        long,
        value_name = "T",
        value_parser = grammar::number,
        allow_negative_numbers = true,
        conflicts_with = "step"
    )]
    time: Option<f64>,
}

impl MomentArgs {
    /// Whether one is asked.
    pub(crate) fn is_given(&self) -> bool {
        self.step.is_some() || self.time.is_some()
    }

    /// The step, and the field of it.
    ///
    /// # Errors
    /// [`Error::Usage`] where the step is asked by the name of another field.
    pub(crate) fn choice(&self, field: Option<&str>) -> Result<StepChoice> {
        let field = field.map(str::to_owned);
        Ok(match (&self.step, self.time, field) {
            (Some(step), _, field) => match (step.parse(), field) {
                (Ok(number), None) => StepChoice::Number(number),
                (Ok(number), Some(field)) => StepChoice::NumberOf(number, field),
                (Err(_), Some(field)) if field != *step => {
                    return Err(Error::usage(format!(
                        "`step={step}` and `field={field}` are two fields: give one of them, or the step by its \
                         number"
                    )));
                }
                (Err(_), _) => StepChoice::Field(step.clone()),
            },
            (None, Some(time), None) => StepChoice::Time(time),
            (None, Some(time), Some(field)) => StepChoice::TimeOf(time, field),
            (None, None, Some(field)) => StepChoice::Field(field),
            (None, None, None) => StepChoice::First,
        })
    }

    /// Whether the step is asked by the name of its field.
    fn names_field(&self) -> bool {
        self.step.as_ref().is_some_and(|step| step.parse::<u64>().is_err())
    }
}

impl StepArgs {
    /// Whether one is asked.
    pub(crate) fn is_given(&self) -> bool {
        self.moment.is_given()
    }

    /// The field, where each step has several.
    pub(crate) fn field(&self) -> Option<String> {
        self.field.clone()
    }

    /// Least and largest value of the step that is asked, or of a range of steps together; none
    /// where no point has a value.
    pub(crate) fn value_range(
        &self,
        archive: &Archive,
        steps: Option<StepRange>,
    ) -> Result<Option<[f64; 2]>> {
        let Some(steps) = steps else { return Ok(archive.at(self.choice()?)?.value_range()) };
        let is_asked = |s: &StepSummary| {
            steps.contains(s.number) && self.field.as_ref().is_none_or(|field| *field == s.field)
        };
        let ranges = archive.info()?.steps.into_iter().filter(is_asked);
        Ok(ranges.filter_map(|s| s.range).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]))
    }

    /// The step, and the field of it.
    ///
    /// # Errors
    /// [`Error::Usage`] where two fields are named.
    pub(crate) fn choice(&self) -> Result<StepChoice> {
        self.moment.choice(self.field.as_deref())
    }

    /// Whether a field is named, as such or as a step.
    pub(crate) fn names_field(&self) -> bool {
        self.field.is_some() || self.moment.names_field()
    }

    /// The step of a question about some fields, or about all where none is named: that of the
    /// first.
    pub(crate) fn choice_among(&self, fields: &[String], archive: &Archive) -> Result<StepChoice> {
        if self.names_field() {
            return match fields {
                [] => self.choice(),
                _ => Err(Error::usage("`step=FIELD` is one field: with `fields`, give a step by its number")),
            };
        }
        let first = fields.first().map(String::as_str).or(archive.fields().first().copied());
        self.moment.choice(first)
    }
}

/// The field that `--colour-by` names, for each of some steps of an archive: one of the archive
/// itself, or that of another archive, at the same time where it has several steps.
pub(crate) fn colour_fields(
    by: &Path,
    archive: &Archive,
    steps: impl IntoIterator<Item = StepChoice>,
) -> Result<Vec<Step>> {
    let steps = steps.into_iter();
    if !is_archive(by) {
        let name = by.display().to_string();
        return steps.map(|step| archive.at(other_field(archive, step, &name)?)).collect();
    }
    let other = Archive::open(by)?;
    steps.map(|step| at_same_time(archive, step, &other)).collect()
}

/// A field of an archive at the moment of a step.
fn other_field(archive: &Archive, step: StepChoice, name: &str) -> Result<StepChoice> {
    let name = name.to_owned();
    if archive.fields().is_empty() {
        return Ok(StepChoice::Field(name));
    }
    Ok(match step {
        StepChoice::Time(time) | StepChoice::TimeOf(time, _) => StepChoice::TimeOf(time, name),
        step => StepChoice::NumberOf(archive.at(step)?.number(), name),
    })
}

/// The step of another archive at the time of a step.
///
/// # Errors
/// [`Error::Usage`] where it has none, or where the times cannot be compared.
fn at_same_time(archive: &Archive, step: StepChoice, other: &Archive) -> Result<Step> {
    if let StepChoice::Time(time) | StepChoice::TimeOf(time, _) = step {
        return other.at(StepChoice::Time(time));
    }
    let (step, steps) = (archive.at(step)?, other.info()?.steps);
    let refuse = |text: String| Err(Error::usage(format!("`colour_by` {}: {text}", other.path().display())));
    let Some(time) = step.time() else {
        return match steps.iter().find_map(|s| s.time.filter(|_| steps.len() > 1)) {
            Some(time) => refuse(format!(
                "its steps have times, as {time}, and step {} of {} has none: `time` chooses one",
                step.number(),
                archive.path().display()
            )),
            None if steps.len() <= 1 => other.at(StepChoice::First),
            None => other.at(StepChoice::Number(step.number())),
        };
    };
    let units = [&step, &**other].map(|s| s.units().time.clone());
    if let [Some(own), Some(of_other)] = &units
        && own != of_other
    {
        return refuse(format!(
            "its times are in {of_other}, those of {} in {own}",
            archive.path().display()
        ));
    }
    match steps.iter().find(|s| s.time == Some(time)) {
        Some(found) => other.at(StepChoice::Number(found.number)),
        // A field that does not change.
        None if steps.len() <= 1 && steps.iter().all(|s| s.time.is_none()) => other.at(StepChoice::First),
        None => {
            let times: Vec<String> = steps.iter().filter_map(|s| s.time).map(text::number).collect();
            let ends = times.first().zip(times.last());
            let has = ends.map_or("has no times".into(), |(a, b)| format!("has none, but {a} to {b}"));
            refuse(format!("step {} is at time {}, and it {has}", step.number(), text::number(time)))
        }
    }
}

/// The level of an archive that is read as a volume. What says how other files are read is refused.
pub(crate) fn archive_level(options: &OpenOptions) -> Result<u32> {
    let OpenOptions { field, scale, io, .. } = options.clone();
    if *options != (OpenOptions { field, scale, io, ..OpenOptions::default() }) {
        return Err(Error::usage(
            "an archive tells all of its samples itself: only `field`, `fields` and `scale` choose",
        ));
    }
    let Some(name) = &options.scale else { return Ok(0) };
    name.parse().map_err(|_| {
        Error::usage(format!("`scale={name}`: the levels of an archive are numbers, 0 is the finest"))
    })
}
