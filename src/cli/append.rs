//! `isospan append`: further steps for an archive.

use super::input::InputArgs;
use super::machine::{InputScratch, Machine};
use super::progress::Talk;
use super::step::StepInputs;
use isospan::Result;
use isospan::pipeline::{AppendSettings, RunSettings, append};
use std::path::PathBuf;

/// Add time steps to an archive, on its mesh.
///
/// Points, interpolation, rounding, field, keyframes, and what is no data, are as for the last step that is there. The archive stays what it was until the new steps are
/// complete; when the run is killed, the same command continues it.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The archive.
    archive: PathBuf,
    #[command(flatten)]
    steps: StepInputs,
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

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let run = RunSettings { keep_going: args.steps.keep_going, ..args.machine.run(&args.scratch, talk) };
    let steps = args.steps.all(&args.read, talk)?;
    let settings =
        AppendSettings { missing: args.missing, keyframes: args.keyframes, measure: !args.no_measure };
    let bar = talk.progress();
    let report = append(&steps, &settings, &args.archive, &run, &*bar);
    bar.end();
    super::reduce::tell(&args.archive, &report?, args.json, talk)
}
