//! `isospan append`: further steps for an archive.

use super::grammar;
use super::input::InputArgs;
use super::machine::{InputScratch, Machine};
use super::progress::Talk;
use super::signals;
use super::step::StepInputs;
use isospan::exec::CancelToken;
use isospan::formats::StepSource;
use isospan::pipeline::RunSettings;
use isospan::{Addition, Result};
use std::path::PathBuf;

/// Add time steps to an archive, on its mesh.
///
/// A step is put where its time lies among those of the archive. Steps behind it have new numbers.
///
/// The settings are those of the archive's last step: points, interpolation, rounding, field,
/// keyframes, missing values. The archive stays unchanged until the new steps are complete. If the
/// run is killed, the same command continues it.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan append run.isospan step_0101.vti\n  isospan append run.isospan 'new_*.vti' --times 10,10.5,..."
)]
pub struct Args {
    /// The archive, a folder on this machine.
    pub archive: PathBuf,
    #[command(flatten)]
    pub steps: StepInputs,
    /// A value that means "no data here" [default: that of the archive's last step].
    #[arg(help_heading = "Values", long, value_name = "VALUE", allow_negative_numbers = true, value_parser = grammar::number)]
    missing: Option<f64>,
    /// Store every N-th step without reference to the step before [default: as for the archive's
    /// last step].
    #[arg(help_heading = "Series", long, value_name = "N", value_parser = grammar::natural, allow_negative_numbers = true)]
    keyframes: Option<u64>,
    /// Skip the measurement of the error at the samples of the source.
    #[arg(help_heading = "Error and size", long)]
    no_measure: bool,
    /// Also measure the surfaces of these isovalues at the new steps against those of their
    /// samples, as `measure` does; the worst step is told. N% is a place in the range of these
    /// samples.
    #[arg(help_heading = "Error and size", long, short = 'i', value_name = "VALUE", value_delimiter = ',', allow_hyphen_values = true, value_parser = grammar::value)]
    isovalue: Vec<grammar::Value>,
    /// Replace a step that the archive has at the same time, or else of the same file and field.
    #[arg(help_heading = "Series", long)]
    replace: bool,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: InputScratch,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
}

impl Args {
    /// How the machine is used, until a token stops the run.
    pub fn run_settings(&self, talk: &Talk, cancel: CancelToken) -> RunSettings {
        let run = self.machine.run_until(&self.scratch, talk, cancel);
        RunSettings { keep_going: self.steps.keep_going, ..run }
    }

    /// The files that are added.
    pub fn sources(&self, talk: &Talk) -> Result<Vec<StepSource>> {
        self.steps.further(&self.read, talk)
    }

    /// The steps, and how they are added.
    pub fn addition(&self, steps: Vec<StepSource>, run: RunSettings) -> Addition<'static> {
        let addition = Addition::of_steps(steps).missing(self.missing).keyframes(self.keyframes);
        let addition = addition.measure(!self.no_measure).replace(self.replace);
        let addition = addition.isovalues(self.isovalue.iter().copied());
        addition.keep_going(run.keep_going).resources(run.resources)
    }
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let run = args.run_settings(talk, signals::cancel_token());
    let addition = args.addition(args.sources(talk)?, run);
    let bar = talk.progress();
    let report = addition.progress(&*bar).append_to(&args.archive);
    bar.end();
    super::reduce::tell("append", &args.archive, &report?, args.json, talk)
}
