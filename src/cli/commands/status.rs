//! `isospan status`: how far a planned reduction is.

use super::{grammar, text};
use clap::ValueEnum;
use isospan::pipeline::{Shards, StatusReport};
use isospan::{Resources, Result};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Show how far a planned reduction is.
///
/// Reads and verifies every segment, and changes nothing.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan status scan.isospan --quick\n  isospan status scan.isospan --missing --as slurm-array"
)]
pub struct Args {
    /// The planned archive.
    pub archive: PathBuf,
    /// Print only the numbers of missing shards, one per line; nothing if all are there.
    #[arg(long)]
    missing: bool,
    /// The form of that list.
    #[arg(long = "as", value_enum, value_name = "FORM", requires = "missing", default_value_t = Form::Lines)]
    form: Form,
    /// Number of shards that the work is divided into [default: as planned].
    #[arg(long, value_name = "N", value_parser = grammar::natural, allow_negative_numbers = true)]
    shards: Option<u64>,
    /// Check headers, lengths and footers only: finds files that are missing, cut short or of
    /// another plan, but not flipped bits.
    #[arg(long)]
    quick: bool,
    /// Print the result as JSON.
    #[arg(long, conflicts_with = "missing")]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Form {
    /// One number per line.
    Lines,
    /// For sbatch --array: 0,3,7-9.
    SlurmArray,
    /// The segments' files, and what is wrong with each.
    Files,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    super::expect_planned(&args.archive)?;
    let resources = Resources::default().with_cancel(super::signals::cancel_token());
    let shards = Shards::at(&args.archive).cut_into(args.shards).quick(args.quick);
    let report = shards.resources(resources).status()?;
    if args.json {
        return super::print_json("status", &report);
    }
    super::print(&match (args.missing, args.form) {
        (false, _) => in_words(&report),
        (true, _) if report.missing_shards.is_empty() => String::new(),
        (true, Form::Lines) => report.missing_shards.iter().map(|n| format!("{n}\n")).collect(),
        (true, Form::SlurmArray) => format!("{}\n", ranges(&report.missing_shards)),
        (true, Form::Files) => report.missing.iter().map(|f| format!("{f}\n")).collect(),
    })
}

/// Ascending numbers as ranges: `0,3,7-9`.
fn ranges(numbers: &[u64]) -> String {
    let runs = numbers.chunk_by(|a, b| a + 1 == *b).map(|run| match run {
        [one] => one.to_string(),
        _ => format!("{}-{}", run[0], run[run.len() - 1]),
    });
    runs.collect::<Vec<_>>().join(",")
}

fn in_words(r: &StatusReport) -> String {
    let mut out = format!("{}\n", r.archive.display());
    let state = match (r.committed, r.missing.is_empty()) {
        (true, true) => "committed",
        (true, false) => "committed, and damaged since",
        (false, true) => "all segments are there: commit it",
        (false, false) => "not finished",
    };
    let _ = writeln!(out, "  state      {state}");
    if let Some(number) = r.try_number {
        let _ = writeln!(out, "  try        {number}, for a target");
    }
    let _ = writeln!(out, "  segments   {} of {} whole", text::count(r.done), text::count(r.segments));
    if !r.missing_shards.is_empty() {
        let (n, list) = (text::count(r.missing_shards.len() as u64), ranges(&r.missing_shards));
        let _ = writeln!(out, "  shards     {n} of {} not done: {list}", text::count(r.shards));
    }
    if r.temporaries > 0 {
        let (n, size) = (text::plural(r.temporaries, "file"), text::bytes(r.temporary_bytes));
        let _ = writeln!(out, "  temporary  {n}, {size}, of workers that run or were killed");
    }
    out
}

#[cfg(test)]
mod tests {
    #[test]
    fn runs_of_numbers_are_ranges() {
        assert_eq!(super::ranges(&[0, 3, 7, 8, 9, 11, 12]), "0,3,7-9,11-12");
        assert_eq!(super::ranges(&[]), "");
    }
}
