//! `isospan commit`: the segments of a planned reduction become an archive.

use super::machine::{InputScratch, Machine};
use super::progress::Talk;
use super::text;
use isospan::Result;
use isospan::pipeline::{commit_shards, work_folder};
use std::path::PathBuf;

/// Put a planned reduction together.
///
/// Every segment is verified, the index is made, the manifest is published.
/// Exit code 3, with a list, if segments are missing, damaged or of another plan. Only unfinished
/// files of dead processes on this machine are deleted.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan commit scan.isospan\n  isospan commit scan.isospan --memory 2GiB --json"
)]
pub(crate) struct Args {
    /// The planned archive.
    archive: PathBuf,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: InputScratch,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    super::expect_planned(&args.archive)?;
    let run = args.machine.run(&args.scratch, talk);
    let bar = talk.progress();
    let report = commit_shards(&args.archive, &run, &*bar);
    bar.end();
    super::reduce::tell("commit", &args.archive, &report?, args.json, talk)?;
    if args.json {
        return Ok(());
    }
    let folder = text::shell(&work_folder(&args.archive));
    super::print(&format!("{folder} (plan, scripts, logs) is no longer needed\n"))
}
