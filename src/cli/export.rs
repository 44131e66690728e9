//! `isospan export`: the tetrahedra of an archive for other programs.

use super::machine::{Machine, OutputScratch};
use super::output::expect_no_input;
use super::progress::Talk;
use super::step::StepArgs;
use super::text;
use isospan::pipeline::{Corners, ExportSettings, Roi};
use isospan::{Archive, Result};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Write the tetrahedra of an archive as an unstructured grid (VTU), with values at the points.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan export scan.isospan -o scan.vtu --compress\n  isospan export scan.isospan -o skin.vtu --range 300:500"
)]
pub(crate) struct Args {
    /// The archive.
    archive: PathBuf,
    /// The file to write: .vtu.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Only tetrahedra whose corners all have values from LO to HI; either end may be omitted. Only
    /// blocks that can hold such tetrahedra are read.
    #[arg(long, value_name = "LO:HI", value_parser = parse_range, allow_hyphen_values = true)]
    range: Option<[f64; 2]>,
    /// With --range: tetrahedra with at least one corner in the range.
    #[arg(long, requires = "range")]
    any_corner: bool,
    /// Only tetrahedra whose bounding box touches a box: I0:I1,J0:J1,K0:K1 in sample indices, or
    /// world:X0:X1,Y0:Y1,Z0:Z1. An omitted end is that of the volume. Only chunks that touch the
    /// box are read.
    #[arg(long, value_name = "BOX", allow_hyphen_values = true)]
    roi: Option<Roi>,
    /// Of the remaining tetrahedra, keep only every K-th.
    #[arg(long, value_name = "K", default_value_t = 1)]
    every: u64,
    /// Compress the arrays of the file with zlib, which VTK and ParaView read: less than a third of
    /// the bytes.
    #[arg(long)]
    compress: bool,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: OutputScratch,
    #[command(flatten)]
    step: StepArgs,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

fn parse_range(text: &str) -> std::result::Result<[f64; 2], String> {
    let end = |part: &str, open: f64| match part.trim() {
        "" => Some(open),
        number => number.parse().ok().filter(|v: &f64| !v.is_nan()),
    };
    text.split_once(':')
        .and_then(|(lo, hi)| Some([end(lo, f64::NEG_INFINITY)?, end(hi, f64::INFINITY)?]))
        .ok_or_else(|| format!("'{text}' is no range; write LO:HI, as in 100:200 or 100:"))
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let settings = ExportSettings {
        resources: args.machine.resources(args.scratch.scratch.clone(), talk),
        range: args.range,
        corners: if args.any_corner { Corners::Any } else { Corners::All },
        roi: args.roi,
        every: args.every,
        compress: args.compress,
    };
    expect_no_input(&args.output, [&args.archive])?;
    let archive = Archive::open(&args.archive)?.at(args.step.choice())?;
    let bar = talk.progress();
    let report = archive.write_tetrahedra(&settings, &args.output, &*bar);
    bar.end();
    let report = report?;
    talk.stages(&report.seconds);
    if args.json {
        return super::print_json(&report);
    }
    let mut out = format!(
        "{}: {} points, {} of {} tetrahedra, {}\n",
        args.output.display(),
        text::count(report.points),
        text::count(report.tetrahedra),
        text::count(report.archive_tetrahedra),
        text::bytes(report.file_bytes)
    );
    if report.void_tetrahedra > 0 {
        let void = text::count(report.void_tetrahedra);
        let _ = writeln!(out, "  left out: {void} tetrahedra with a corner that has no value");
    }
    super::print(&out)
}
