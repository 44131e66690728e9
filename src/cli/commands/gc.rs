//! `isospan gc`: what killed workers have left.

use super::{grammar, text};
use isospan::Result;
use isospan::pipeline::collect_garbage;
use std::path::PathBuf;
use std::time::Duration;

/// Remove what killed workers have left in an archive.
///
/// Removes temporary files that were not written to for the given time and that no process holds. A
/// worker writes after each chunk, so an hour is long. Removes segments of steps that were replaced
/// (append --replace), where the archive has been as it is for that time. No other segment is
/// removed, and nothing in a folder that is no archive.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan gc scan.isospan --older-than 1d\n  isospan gc scan.isospan --older-than 12h --dry-run"
)]
pub struct Args {
    /// The archive, finished or not.
    pub archive: PathBuf,
    /// Remove files at least this old: 2d, 12h, 30m, 90s.
    #[arg(long, value_name = "AGE", value_parser = grammar::span, allow_hyphen_values = true)]
    older_than: Duration,
    /// Only print what would be removed.
    #[arg(long)]
    dry_run: bool,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let report = collect_garbage(&args.archive, args.older_than, args.dry_run)?;
    if args.json {
        return super::print_json("gc", &report);
    }
    let mut out: String = report.files.iter().map(|f| format!("{}\n", f.display())).collect();
    let verb = if args.dry_run { "would be removed" } else { "removed" };
    out += &format!(
        "{}, {} {verb}\n",
        text::plural(report.files.len() as u64, "file"),
        text::bytes(report.bytes)
    );
    super::print(&out)
}
