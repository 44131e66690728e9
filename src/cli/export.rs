//! `isospan export`: the tetrahedra of an archive for other programs.

use super::grammar::{self, Range};
use super::machine::{Machine, OutputScratch};
use super::output::Force;
use super::progress::Talk;
use super::step::StepArgs;
use super::text;
use isospan::pipeline::{Corners, ExportSettings, Roi, Step};
use isospan::{Archive, Error, Result};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Write the tetrahedra of an archive as a VTU or VTKHDF file.
///
/// That is an unstructured grid, with the values of each field at the points.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan export scan.isospan -o scan.vtu --compress\n  isospan export scan.isospan -o skin.vtu --range 300:500\n  isospan export flow.isospan -o flow3.vtu --step 3 --fields T,p"
)]
pub(crate) struct Args {
    /// The archive: a folder, or its address, s3://... or https://...
    archive: PathBuf,
    /// The file to write: .vtu or .vtkhdf.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The fields to write, where the archive has several [default: all; that of --field or of
    /// --step FIELD].
    #[arg(
        help_heading = "Series",
        long,
        value_name = "NAME[,NAME..]",
        value_delimiter = ',',
        conflicts_with = "field"
    )]
    fields: Vec<String>,
    /// Only tetrahedra whose corners all have values from LO to HI; either end may be omitted. 100%
    /// is the range of the values of the step. Of several fields, the first of --fields. Only
    /// blocks that can hold such tetrahedra are read.
    #[arg(long, value_name = "LO:HI", value_parser = grammar::range, allow_hyphen_values = true)]
    range: Option<Range>,
    /// With --range: tetrahedra with at least one corner in the range.
    #[arg(long, requires = "range")]
    any_corner: bool,
    /// Only tetrahedra whose bounding box touches a box: I0:I1,J0:J1,K0:K1 in sample indices, or
    /// world:X0:X1,Y0:Y1,Z0:Z1. An omitted end is that of the volume. Only chunks that touch the
    /// box are read.
    #[arg(long, value_name = "BOX", allow_hyphen_values = true, value_parser = grammar::region)]
    roi: Option<Roi>,
    /// Of the remaining tetrahedra, keep only every K-th.
    #[arg(long, value_name = "K", default_value = "1", value_parser = grammar::natural, allow_negative_numbers = true)]
    every: u64,
    /// Compress the arrays of the file with zlib, which VTK and ParaView read: less than a third of
    /// the bytes. Of HDF5, this needs version 1.10.
    #[arg(long)]
    compress: bool,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: OutputScratch,
    #[command(flatten)]
    step: StepArgs,
    #[command(flatten)]
    force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    /// The fields that are written, none for that of the step alone.
    fn fields(&self, step: &Step) -> Result<Vec<String>> {
        if !self.fields.is_empty() || self.step.names_field() {
            return Ok(self.fields.clone());
        }
        let fields = step.fields_here();
        if self.range.is_some() && fields.len() > 1 {
            return Err(Error::usage(format!(
                "--range is one of values of a field, and there are {}: name that field first in --fields",
                fields.join(", ")
            )));
        }
        let is_several = fields.len() > 1;
        Ok(fields.into_iter().filter(|_| is_several).map(str::to_owned).collect())
    }
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    args.force.check(&args.output, [&args.archive])?;
    let archive = Archive::open(&args.archive)?;
    let archive = archive.at(args.step.choice_among(&args.fields, &archive)?)?;
    let fields = args.fields(&archive)?;
    let settings = ExportSettings {
        fields,
        resources: args.machine.resources(args.scratch.scratch.clone(), talk),
        range: args.range.map(|range| range.of(archive.value_range())).transpose()?,
        corners: if args.any_corner { Corners::Any } else { Corners::All },
        roi: args.roi,
        every: args.every,
        compress: args.compress,
    };
    let bar = talk.progress();
    let report = archive.write_tetrahedra(&settings, &args.output, &*bar);
    bar.end();
    let report = report?;
    talk.stages(&report.seconds);
    if args.json {
        return super::print_json("export", &report);
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
    if report.fields.len() > 1 {
        let _ = writeln!(out, "  fields: {}", report.fields.join(", "));
    }
    super::print(&out)
}
