//! `isospan count`: how large would the surface be?

use super::grammar::{self, Value};
use super::labels::{self, LabelArgs};
use super::level::LevelArgs;
use super::numbers::{self, MeasureFlags, With};
use super::progress::Talk;
use super::step::StepArgs;
use super::text;
use isospan::{Archive, Result};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Count the cells that isosurfaces cross.
///
/// Cells are the tetrahedra of points, and the cubes between the samples of a pyramid.
/// The numbers are exact, and the surfaces are not extracted.
/// Isovalues with few digits are looked up in the spectrum of a large archive, which takes a few
/// kilobytes of reading; the JSON output has the number of bytes. With --numbers the surface is
/// extracted and measured, and so are the parts of the domain on both sides of it. With --labels
/// the labels of a label image are listed, each with its voxels, volume and area.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan count scan.isospan --isovalue 600\n  isospan count scan.isospan -i 300,600,900 --json\n  isospan count scan.isospan -i 600 --level 2\n  isospan count scan.isospan -i 600 --numbers\n  isospan count atlas.isospan --labels all",
    mut_arg("labels", |arg| arg.conflicts_with_all(["isovalue", "numbers", "level", "triangles", "error"]))
)]
pub struct Args {
    /// The archive: a folder, or its address, s3://... or https://...
    pub archive: PathBuf,
    /// One isovalue, or several: 300,600. 50% is half-way from the least value of the step to its
    /// largest.
    #[arg(
        long,
        short = 'i',
        value_name = "VALUE",
        required_unless_present = "labels",
        value_delimiter = ',',
        allow_hyphen_values = true,
        value_parser = grammar::value
    )]
    isovalue: Vec<Value>,
    /// Also measure: area and pieces of the surface; of the parts at or above the isovalue and
    /// below it the volumes, the pieces, whether one reaches across the domain along x, y, z, and
    /// the largest ball in them. That takes a pass over the archive.
    #[arg(long)]
    numbers: bool,
    #[command(flatten)]
    labels: LabelArgs,
    #[command(flatten)]
    level: LevelArgs,
    #[command(flatten)]
    step: StepArgs,
    #[command(flatten)]
    means: MeasureFlags,
    /// Print the result as JSON, one object per line.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let step = Archive::open(&args.archive)?.at(args.step.choice()?)?;
    if args.labels.are_given() {
        return labels::tell(&args.labels, &step, args.means.resources(talk), args.json, talk);
    }
    args.isovalue.iter().try_for_each(|isovalue| {
        let range = step.value_range();
        let isovalue = isovalue.of(range)?;
        let (level, resources) = (args.level.choice(), args.means.resources(talk));
        let report = step.query(isovalue).level(level).resources(resources.clone()).count()?;
        let numbers =
            args.numbers.then(|| numbers::of(&step, isovalue, level, resources, talk)).transpose()?;
        if args.json {
            return super::print_json("count", &With { report: &report, numbers });
        }
        let mut out = String::new();
        let _ = writeln!(
            out,
            "isovalue {isovalue}: {} active {}{} ({} read)",
            text::count(report.active_cells),
            match report.tetrahedra {
                0 => "cells".to_owned(),
                all => format!("tetrahedra of {}", text::count(all)),
            },
            report
                .level
                .filter(|level| *level > 0)
                .map_or_else(String::new, |level| format!(" of level {level}")),
            text::bytes(report.bytes_read)
        );
        if let Some(range) = range.filter(|[lo, hi]| !(*lo..=*hi).contains(&isovalue)) {
            let _ = writeln!(out, "  the isovalue is outside the range {}", text::range(range));
        }
        if let Some(numbers) = &numbers {
            out += &numbers::in_words(numbers, step.units());
        }
        super::print(&out)
    })
}
