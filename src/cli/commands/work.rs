//! `isospan work`: a shard of a planned reduction.

use super::grammar;
use super::machine::{InputScratch, Machine};
use super::progress::Talk;
use super::text;
use isospan::Result;
use isospan::pipeline::{Shard, Shards};
use std::path::PathBuf;

/// Make a shard of a planned reduction.
///
/// Its segments that are not done yet are made.
/// A shard may be started again at any time, twice at once, or on another machine. A signal
/// (SIGTERM, SIGINT, SIGHUP, SIGUSR1, SIGXCPU) ends it with code 75; the same command then
/// continues.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan work scan.isospan --shard 3/16\n  isospan work scan.isospan --threads 8 --memory 16GiB"
)]
pub struct Args {
    /// The planned archive.
    pub archive: PathBuf,
    /// Which shard, counted from 0: 3/16. Any number of shards gives the same archive [default:
    /// all].
    #[arg(long, value_name = "I/N", value_parser = grammar::shard, allow_hyphen_values = true)]
    shard: Option<Shard>,
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
    let shards = Shards::at(&args.archive).resources(run.resources).progress(&*bar);
    let report = shards.work(args.shard.unwrap_or(Shard::ALL));
    bar.end();
    let report = report?;
    talk.stages(&report.seconds);
    report.source_chunks.iter().for_each(|found| talk.detail(&text::source_chunks(found)));
    if args.json {
        return super::print_json("work", &report);
    }
    let done = match report.points {
        0 => "nothing left to do".to_owned(),
        points => format!("{} points", text::count(points)),
    };
    super::print(&format!(
        "{}: shard {} ({}): {done}\n",
        args.archive.display(),
        report.shard,
        text::plural(report.segments, "segment")
    ))
}
