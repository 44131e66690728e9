//! `isospan probe`: the reduced field on a grid, or at points.

use super::grammar;
use super::level::LevelArgs;
use super::machine::Machine;
use super::output::Force;
use super::progress::Talk;
use super::step::StepArgs;
use super::text;
use isospan::formats::samples::SampleFormat;
use isospan::pipeline::{ProbeReport, ProbeSettings};
use isospan::volume::units::Unit;
use isospan::{Archive, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Sample the field of an archive on a grid or at points.
///
/// The field is linear in each tetrahedron; that of a pyramid is trilinear between the nodes of a
/// level, and ends at the last ones.
#[derive(clap::Args, Debug)]
#[command(
    group = clap::ArgGroup::new("places").required(true).args(["grid", "at"]),
    after_help = "Examples:\n  isospan probe scan.isospan --grid 256,256,128 -o scan.vti\n  isospan probe scan.isospan --at points.csv -o values.csv\n  isospan probe scan.isospan --grid 64,64,32 --error 2% -o small.vti"
)]
pub struct Args {
    /// The archive: a folder, or its address, s3://... or https://...
    pub archive: PathBuf,
    /// Number of samples along x, y and z, from face to face of the domain.
    #[arg(long, value_name = "NX,NY,NZ", value_parser = grammar::whole_triple::<u64>, allow_hyphen_values = true)]
    grid: Option<[u64; 3]>,
    /// A table of points in world coordinates: the columns titled x, y and z, or the first three.
    #[arg(long, value_name = "CSV")]
    at: Option<PathBuf>,
    /// The file to write: for a grid .vti .nrrd .nii .nii.gz .mha .mhd (with .raw) .tif or
    /// .npy, for points .csv or .npy.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    #[command(flatten)]
    level: LevelArgs,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    step: StepArgs,
    #[command(flatten)]
    force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let settings =
        ProbeSettings { resources: args.machine.resources(None, talk), level: args.level.choice() };
    let inputs: Vec<&PathBuf> = args.at.iter().chain([&args.archive]).collect();
    let files = match (args.grid, SampleFormat::from_path(&args.output)) {
        (Some(_), Ok(format)) => format.files(&args.output),
        _ => vec![args.output.clone()],
    };
    args.force.check_all(&files, &inputs)?;
    let archive = Archive::open(&args.archive)?.at(args.step.choice()?)?;
    let bar = talk.progress();
    let report = match (args.grid, &args.at) {
        (Some(grid), _) => SampleFormat::from_path(&args.output)
            .and_then(|format| archive.write_samples(grid, &settings, &args.output, format, &*bar)),
        (None, Some(points)) => archive.write_probed(points, &settings, &args.output, &*bar),
        (None, None) => unreachable!("one of the two is required"),
    };
    bar.end();
    let report = report?;
    report.notices.iter().for_each(|line| talk.note(line));
    if args.json {
        return super::print_json("probe", &report);
    }
    super::print(&report_text(&args.output, &report, archive.units().value.as_ref()))
}

fn report_text(file: &Path, report: &ProbeReport, unit: Option<&Unit>) -> String {
    let (samples, size) = (text::count(report.samples), text::bytes(report.file_bytes));
    let unit = unit.map_or_else(String::new, |unit| format!(", values in {unit}"));
    let mut out = format!("{}: {samples} samples, {size}{unit}\n", file.display());
    let outside = match report.level {
        None | Some(0) => "outside the domain".to_owned(),
        Some(level) => format!("beyond the last nodes of level {level}, or outside the domain"),
    };
    for (count, why) in [(report.void, "where the source has no data"), (report.outside, &outside)] {
        if count > 0 {
            let _ = writeln!(out, "  NaN: {} {why}", text::count(count));
        }
    }
    out
}
