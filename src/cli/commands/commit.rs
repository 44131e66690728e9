//! `isospan commit`: the segments of a planned reduction become an archive.

use super::machine::{InputScratch, Machine};
use super::progress::Talk;
use super::text;
use isospan::Result;
use isospan::pipeline::{Committed, NextTry, Shards, work_folder};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Put a planned reduction together.
///
/// Every segment is verified, the index is made, the manifest is published. Surfaces that the plan
/// asks for are measured, which reads the source.
/// Exit code 3, with a list, if segments are missing, damaged or of another plan. Only unfinished
/// files of dead processes on this machine are deleted. Where the plan has a target, several tries
/// may be needed: exit code 7 says that the next one is planned, and takes `work` and `commit`
/// again.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan commit scan.isospan\n  isospan commit scan.isospan --memory 2GiB --json"
)]
pub struct Args {
    /// The planned archive.
    pub archive: PathBuf,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: InputScratch,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<u8> {
    super::expect_planned(&args.archive)?;
    let run = args.machine.run(&args.scratch, talk);
    let bar = talk.progress();
    let committed = Shards::at(&args.archive).resources(run.resources).progress(&*bar).commit();
    bar.end();
    let report = match committed? {
        Committed::Archive(report) => report,
        Committed::NextTry(next) if args.json => {
            return super::print_json("next_try", &next).map(|()| super::NEXT_TRY);
        }
        Committed::NextTry(next) => {
            return super::print(&in_words(args, &next)).map(|()| super::NEXT_TRY);
        }
    };
    super::reduce::tell("commit", &args.archive, &report, args.json, talk)?;
    if !args.json {
        let folder = text::shell(&work_folder(&args.archive));
        super::print(&format!("{folder} (plan, scripts, logs) is no longer needed\n"))?;
    }
    Ok(super::reduce::code_of(&args.archive, &report))
}

fn in_words(args: &Args, next: &NextTry) -> String {
    let (made, plan) = (&next.target, &next.next);
    let mut out = format!("{}\n", plan.plan.display());
    let came = super::reduce::reached_text(made);
    let _ = writeln!(out, "  try {:<6} {came}", made.tries);
    let (points, chunks) = (text::count(plan.needs.points), text::plural(plan.needs.chunks, "chunk"));
    let shards = text::plural(plan.shards, "shard");
    let _ = writeln!(out, "  try {:<6} planned: {points} points in {chunks}, {shards}", made.tries + 1);
    out + &super::plan::next_commands(&args.archive, plan.shards)
}
