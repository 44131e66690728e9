//! `isospan export`: the tetrahedra of an archive, or the samples of a pyramid, for other programs.

mod args;
mod grid;

pub(super) use args::Args;

use super::progress::Talk;
use super::text;
use isospan::pipeline::{Corners, ExportSettings};
use isospan::{Archive, Result};
use std::fmt::Write as _;

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    if !args.is_zarr() {
        args.force.check(&args.output, [&args.archive])?;
    }
    let archive = Archive::open(&args.archive)?;
    args.expect_of(&archive)?;
    if archive.is_pyramid() {
        return grid::run(args, &archive, talk);
    }
    let archive = archive.at(args.step.choice_among(&args.fields, &archive)?)?;
    let fields = args.fields(&archive)?;
    let settings = ExportSettings {
        fields,
        resources: args.machine.resources(args.scratch.scratch.clone(), talk),
        range: args.range.map(|range| range.of(archive.value_range())).transpose()?,
        corners: if args.any_corner { Corners::Any } else { Corners::All },
        roi: args.roi,
        every: args.every.unwrap_or(1),
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
