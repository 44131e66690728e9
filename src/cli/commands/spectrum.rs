//! `isospan spectrum`: how the isosurface changes with the isovalue.

use super::grammar::{self, Value};
use super::numbers::{self, MeasureFlags, With};
use super::output::Force;
use super::progress::Talk;
use super::step::StepArgs;
use super::{figure, text};
use isospan::pipeline::{SpectrumReport, StepRange, StepSpectrum};
use isospan::volume::units::Units;
use isospan::{Archive, Result};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Print how isosurfaces change with the isovalue.
///
/// That is the contour spectrum: active cells, area and enclosed volume over the isovalue. The
/// figures of tetrahedra are exact at each isovalue of the table, those of a pyramid within 1 %, in
/// the volume's world units. For rectilinear and curvilinear grids the edges of tetrahedra count as
/// straight; surfaces follow the bent grid, so their area and volume differ slightly. Some ten
/// kilobytes are read. The mean gradient is the mean length of the field's gradient over the
/// surface. Isovalues worth a look are those whose surface is steep and large. With --isovalue the
/// surfaces of some isovalues are extracted and measured besides.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan spectrum scan.isospan --plot scan.svg\n  isospan spectrum run.isospan --all-steps --plot run.png"
)]
pub struct Args {
    /// The archive: a folder, or its address, s3://... or https://...
    pub archive: PathBuf,
    /// The spectra of all steps: one line of the table per step. The figure is a map of the area
    /// over time and isovalue.
    #[arg(help_heading = "Series", long, conflicts_with_all = ["step", "time", "steps"])]
    all_steps: bool,
    /// As --all-steps, for the steps from one number to another; either end may be omitted.
    #[arg(help_heading = "Series", long, value_name = "FIRST:LAST", value_parser = grammar::steps, conflicts_with_all = ["step", "time"], allow_hyphen_values = true)]
    pub steps: Option<StepRange>,
    /// Also measure at these isovalues: area and pieces of the surface; volumes, pieces,
    /// percolation and the largest ball on both sides of it. That takes a pass over the archive
    /// for each.
    #[arg(long, short = 'i', value_name = "VALUE", value_delimiter = ',', allow_hyphen_values = true, value_parser = grammar::value, conflicts_with_all = ["all_steps", "steps"])]
    isovalue: Vec<Value>,
    /// Also draw the curves: .svg or .png.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    step: StepArgs,
    #[command(flatten)]
    force: Force,
    #[command(flatten)]
    means: MeasureFlags,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let format = args.plot.as_deref().map(figure::FigureFormat::of).transpose()?;
    args.plot.iter().try_for_each(|plot| args.force.check(plot, [&args.archive]))?;
    let name = args.archive.file_stem().unwrap_or_default().to_string_lossy();
    let archive = Archive::open(&args.archive)?.in_field(args.step.field());
    if let Some(steps) = args.steps.or(args.all_steps.then(StepRange::default)) {
        let steps = archive.steps(steps)?.spectra()?;
        if let Some((file, format)) = args.plot.as_deref().zip(format) {
            let units = archive.info()?.units;
            let drawn = figure::OverTime { steps: &steps, name: &name, units: &units };
            figure::write_figure(&drawn, file, format)?;
        }
        return if args.json {
            super::print_json("spectrum.series", &serde_json::json!({ "steps": steps }))
        } else {
            super::print(&lines(&steps))
        };
    }
    let step = archive.at(args.step.choice()?)?;
    let (report, units) = (step.spectrum()?, step.units());
    if let Some((file, format)) = args.plot.as_deref().zip(format) {
        figure::write(&report, &name, units, file, format)?;
    }
    let isovalues = args.isovalue.iter().map(|v| v.of(step.value_range())).collect::<Result<Vec<_>>>()?;
    let found = isovalues.into_iter().map(|v| numbers::of(&step, v, None, args.means.resources(talk), talk));
    let found = found.collect::<Result<Vec<_>>>()?;
    if args.json {
        let numbers = (!found.is_empty()).then_some(found);
        return super::print_json("spectrum", &With { report: &report, numbers });
    }
    let cells = if archive.is_pyramid() { "cells" } else { "tetrahedra" };
    let mut out = table(&report, cells, units);
    for numbers in &found {
        let _ = write!(out, "isovalue {}:\n{}", numbers.isovalue, numbers::in_words(numbers, units));
    }
    super::print(&out)
}

/// A line for each step: its range, the isovalue of the largest area, and what is worth a look.
fn lines(steps: &[StepSpectrum]) -> String {
    let mut out = format!(
        "{:>6} {:>12} {:>26} {:>14} {:>14}  worth a look\n",
        "step", "time", "range", "largest area", "at"
    );
    for StepSpectrum { step, time, spectrum } in steps {
        let range = spectrum.range.map_or("none".into(), text::range);
        let largest = spectrum.knots.iter().max_by(|a, b| a.area.total_cmp(&b.area));
        let [area, at] = largest.map_or(["-".into(), "-".into()], |k| {
            [text::number(k.area), isovalue_text(spectrum, k.isovalue)]
        });
        let look: Vec<String> =
            spectrum.suggestions.iter().map(|s| isovalue_text(spectrum, s.isovalue)).collect();
        let _ = writeln!(
            out,
            "{step:>6} {:>12} {range:>26} {area:>14} {at:>14}  {}",
            text::number(*time),
            look.join(", ")
        );
    }
    out
}

/// An isovalue of a spectrum.
fn isovalue_text(report: &SpectrumReport, isovalue: f64) -> String {
    report.range.map_or_else(|| text::number(isovalue), |range| text::in_range(isovalue, range))
}

fn table(report: &SpectrumReport, cells: &str, units: &Units) -> String {
    let Some(range) = report.range else { return "there is no value: every point is void\n".into() };
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{} {cells}, volume {}{}, values {}{}",
        text::count(report.cells),
        text::number(report.volume),
        match &units.length {
            Some(unit) => text::unit_to_the(3, Some(unit)),
            None => " cubic world units".into(),
        },
        text::range(range),
        text::unit(units.value.as_ref())
    );
    if report.straight_edges {
        let _ = writeln!(
            out,
            "area and volume of straight-edged tetrahedra: surfaces follow the grid where it is bent"
        );
    }
    if !report.suggestions.is_empty() {
        let values: Vec<String> =
            report.suggestions.iter().map(|s| isovalue_text(report, s.isovalue)).collect();
        let _ = writeln!(out, "worth a look: {}", values.join(", "));
    }
    let _ = writeln!(
        out,
        "{:>12} {:>14} {:>14} {:>14} {:>14}",
        "isovalue", "active", "area", "volume", "mean gradient"
    );
    for k in &report.knots {
        let mean = if k.area > 0.0 { k.gradient / k.area } else { 0.0 };
        let [area, volume, mean] = [k.area, k.volume, mean].map(text::number);
        let active = text::count(k.active_cells);
        let _ = writeln!(
            out,
            "{:>12} {active:>14} {area:>14} {volume:>14} {mean:>14}",
            isovalue_text(report, k.isovalue)
        );
    }
    out
}
