//! The flags that choose a step of an archive, and those that give the times of steps.

use super::grammar;
use super::input::InputArgs;
use super::progress::Talk;
use isospan::formats::{OpenOptions, StepSource, order_in_doubt, steps_of};
use isospan::pipeline::{Step, StepChoice, StepRange, is_archive};
use isospan::volume::units::{Unit, Units};
use isospan::{Archive, Error, Result};
use std::path::{Path, PathBuf};

/// The steps that are made.
#[derive(clap::Args, Debug)]
pub(crate) struct StepInputs {
    /// The volume or mesh, in any format that isospan reads; a volume also by address (s3://... or
    /// https://...). Several inputs are the steps of a series. So are a quoted pattern
    /// ("step_*.vti"), a .pvd or .series file, a file with frames, and the fields that match
    /// --field PATTERN.
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// Times of the steps: 0,0.5,2, or 0,0.5,... which goes on like that [default: those in the
    /// files, else the step numbers].
    #[arg(help_heading = "Series", long, value_name = "TIMES", value_parser = grammar::times, allow_hyphen_values = true)]
    times: Option<Times>,
    /// Fields of the input to reduce on the same points, by their names. Each is a step of the
    /// archive; --step NAME asks for one.
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
    /// All steps, in order.
    pub(crate) fn all(&self, read: &InputArgs, talk: &Talk) -> Result<Vec<StepSource>> {
        let options = read.options()?;
        let mut steps = match &self.fields[..] {
            [] => steps_of(&self.inputs, &options)?,
            fields => self.of_fields(fields, &options)?,
        };
        if let (None, Some(doubt)) = (&self.times, order_in_doubt(&self.inputs, &steps)) {
            let help = "a quoted pattern (\"step_*.vti\") takes files in the order of their numbers, --times tells the times";
            talk.note(&format!("warning: {doubt}: {help}"));
        }
        self.tell(&mut steps)?;
        Ok(steps)
    }

    /// A step for each field of the input.
    fn of_fields(&self, fields: &[String], options: &OpenOptions) -> Result<Vec<StepSource>> {
        let [input] = &self.inputs[..] else {
            return Err(Error::usage("--fields names fields of one input: give one"));
        };
        if let Some(twice) = (1..fields.len()).find(|&n| fields[..n].contains(&fields[n])) {
            return Err(Error::usage(format!("--fields names {} twice", fields[twice])));
        }
        let step = |name: &String| {
            let steps = steps_of(
                std::slice::from_ref(input),
                &OpenOptions { field: Some(name.clone()), ..options.clone() },
            )?;
            let [step] = &steps[..] else {
                let (path, count) = (input.display(), steps.len());
                return Err(Error::usage(format!(
                    "{path}: {name} stands for {count} steps: --field takes them"
                )));
            };
            // Fields of one moment are no series in time.
            Ok(step.clone().at(None))
        };
        fields.iter().map(step).collect()
    }

    /// Gives steps the units and the times that the user gave.
    pub(crate) fn tell(&self, steps: &mut [StepSource]) -> Result<()> {
        let units = Units {
            value: self.unit.clone(),
            length: self.length_unit.clone(),
            time: self.time_unit.clone(),
        };
        steps.iter_mut().for_each(|step| step.options.units.clone_from(&units));
        self.times.as_ref().map_or(Ok(()), |times| times.apply(steps))
    }
}

/// Which step of a series is asked.
#[derive(clap::Args, Debug)]
pub(crate) struct StepArgs {
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

impl StepArgs {
    /// Whether one is asked.
    pub(crate) fn is_given(&self) -> bool {
        self.step.is_some() || self.time.is_some()
    }

    /// Least and largest value of the step that is asked, or of a range of steps together; none
    /// where no point has a value.
    pub(crate) fn value_range(
        &self,
        archive: &Archive,
        steps: Option<StepRange>,
    ) -> Result<Option<[f64; 2]>> {
        let Some(steps) = steps else { return Ok(archive.at(self.choice())?.value_range()) };
        let ranges = archive.info()?.steps.into_iter().filter(|s| steps.contains(s.number));
        Ok(ranges.filter_map(|s| s.range).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]))
    }

    pub(crate) fn choice(&self) -> StepChoice {
        match (&self.step, self.time) {
            (Some(step), _) => {
                step.parse().map_or_else(|_| StepChoice::Field(step.clone()), StepChoice::Number)
            }
            (None, Some(time)) => StepChoice::Time(time),
            (None, None) => StepChoice::First,
        }
    }
}

/// The field that `--colour-by` names, for each of some steps of an archive: one of the archive
/// itself, or that of another archive, at the same step where it has several.
pub(crate) fn colour_fields(
    by: &Path,
    archive: &Archive,
    steps: impl IntoIterator<Item = StepChoice>,
) -> Result<Vec<Step>> {
    let steps = steps.into_iter();
    if !is_archive(by) {
        let name = by.display().to_string();
        return steps.map(|_| archive.at(StepChoice::Field(name.clone()))).collect();
    }
    let other = Archive::open(by)?;
    let is_one = other.info()?.steps.len() <= 1;
    steps.map(|step| other.at(if is_one { StepChoice::First } else { step })).collect()
}

/// The times of steps.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Times {
    List(Vec<f64>),
    /// From a time on, so much later each.
    Regular {
        start: f64,
        step: f64,
    },
}

impl Times {
    /// Gives steps their times, in place of those in their files.
    pub(crate) fn apply(&self, steps: &mut [StepSource]) -> Result<()> {
        let count = steps.len();
        for (n, step) in steps.iter_mut().enumerate() {
            step.time = Some(match self {
                Self::Regular { start, step } => start + step * n as f64,
                Self::List(times) if times.len() == count => times[n],
                Self::List(times) => {
                    return Err(Error::usage(format!("--times has {} times for {count} steps", times.len())));
                }
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::grammar::times;
    use super::*;
    use std::path::Path;

    #[test]
    fn steps_get_the_times_that_were_told() {
        let mut steps = vec![StepSource::new(Path::new("a"), &Default::default()); 3];
        times("10,10.5,...").unwrap().apply(&mut steps).unwrap();
        assert_eq!(steps[2].time, Some(11.0));
        let error = times("1,2").unwrap().apply(&mut steps).unwrap_err();
        assert_eq!(error.to_string(), "--times has 2 times for 3 steps");
    }
}
