//! `isospan append`: further steps for an archive.

use super::input::InputArgs;
use super::machine::{InputScratch, Machine};
use super::progress::Talk;
use super::signals;
use super::step::StepInputs;
use isospan::Result;
use isospan::exec::CancelToken;
use isospan::formats::StepSource;
use isospan::pipeline::{AppendSettings, RunSettings, append};
use std::path::PathBuf;

/// Add time steps to an archive, on its mesh.
///
/// Points, interpolation, rounding, field, keyframes, and what is no data, are as for the last step that is there. The archive stays what it was until the new steps are
/// complete; when the run is killed, the same command continues it.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The archive.
    pub(crate) archive: PathBuf,
    #[command(flatten)]
    pub(crate) steps: StepInputs,
    /// A value that means "no data here" [default: that of the archive's last step].
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    missing: Option<f64>,
    /// Store every N-th step without reference to the one before [default: as for the archive's last step].
    #[arg(long, value_name = "N")]
    keyframes: Option<u64>,
    /// Do not measure the field against the samples of the source in the end.
    #[arg(long)]
    no_measure: bool,
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
    pub(crate) fn run_settings(&self, talk: &Talk, cancel: CancelToken) -> RunSettings {
        let run = self.machine.run_until(&self.scratch, talk, cancel);
        RunSettings { keep_going: self.steps.keep_going, ..run }
    }

    /// The files that are added.
    pub(crate) fn sources(&self, talk: &Talk) -> Result<Vec<StepSource>> {
        self.steps.all(&self.read, talk)
    }

    /// How they are added.
    pub(crate) fn settings(&self) -> AppendSettings {
        AppendSettings { missing: self.missing, keyframes: self.keyframes, measure: !self.no_measure }
    }
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let run = args.run_settings(talk, signals::cancel_token());
    let (steps, settings) = (args.sources(talk)?, args.settings());
    let bar = talk.progress();
    let report = append(&steps, &settings, &args.archive, &run, &*bar);
    bar.end();
    super::reduce::tell(&args.archive, &report?, args.json, talk)
}
