//! `isospan measure`: how far is the reduced field from its source?

use super::grammar::{self, Value};
use super::input::InputArgs;
use super::level::LevelArgs;
use super::machine::{InputScratch, Machine};
use super::output::{Force, files_of};
use super::progress::Talk;
use super::text;
use isospan::formats::StepSource;
use isospan::measure::FieldError;
use isospan::pipeline::{MeasureReport, SurfaceDistance, SurfaceErrors};
use isospan::volume::units::Units;
use isospan::{Archive, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Measure the error of an archive against its source.
///
/// That is at every sample of a volume, or vertex of a mesh.
/// An error is the reduced value less the original one. Percentiles are at most 1/16 too large; all
/// other figures are exact. If f32 cannot hold the samples exactly (see `isospan info`), the
/// figures include that loss and are upper bounds. With --isovalue surfaces are measured, too:
/// how far each is from marching cubes of the samples.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan measure scan.isospan --against scan.nrrd\n  isospan measure scan.isospan --against scan.nrrd --map error.vti\n  isospan measure scan.isospan --against scan.nrrd --isovalue 600"
)]
pub struct Args {
    /// The archive: a folder, or its address, s3://... or https://...
    pub archive: PathBuf,
    /// The source volume or mesh; a volume also by address.
    #[arg(long, value_name = "INPUT")]
    against: PathBuf,
    /// Also measure the surfaces of these isovalues against those of the samples, of a volume: area
    /// and pieces of both; distances of the vertices of each from the other, in world units, and
    /// where the largest is.
    #[arg(long, short = 'i', value_name = "VALUE", value_delimiter = ',', allow_hyphen_values = true, value_parser = grammar::value)]
    isovalue: Vec<Value>,
    /// Also write an image with a cell for each brick of samples, as .vti: the arrays rms (RMS
    /// error), max (largest error) and samples (how many were measured).
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Number of the time step [default: the first].
    #[arg(help_heading = "Series", long, value_name = "N", value_parser = grammar::whole::<u64>, allow_negative_numbers = true)]
    step: Option<u64>,
    #[command(flatten)]
    level: LevelArgs,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: InputScratch,
    #[command(flatten)]
    force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let options = args.read.options()?;
    if let Some(map) = &args.map {
        let inputs = files_of(&args.against, &options);
        args.force.check(map, inputs.iter().chain([&args.archive]))?;
    }
    let archive = Archive::open(&args.archive)?;
    let measurement = archive.measure(StepSource::new(&args.against, &options)).step(args.step);
    let measurement = measurement.level(args.level.choice()).map(args.map.clone());
    let range = args.step.map_or(Ok(archive.value_range()), |n| Ok(archive.step(n)?.value_range()))?;
    let isovalues = args.isovalue.iter().map(|v| v.of(range)).collect::<Result<Vec<_>>>()?;
    let measurement = measurement.isovalues(isovalues);
    let resources = args.machine.resources(args.scratch.scratch.clone(), talk);
    let bar = talk.progress();
    let report = measurement.resources(resources).progress(&*bar).run();
    bar.end();
    let report = report?;
    if !report.same_source {
        talk.note(&format!("{} is not the file that the archive was made from", args.against.display()));
    }
    if args.json {
        super::print_json("measure", &report)
    } else {
        let mut out = report_text(&args.archive, &report);
        report.surfaces.iter().for_each(|found| out += &surface_text(found, archive.units(), ""));
        super::print(&out)
    }
}

/// The errors of a surface in words; `of` says which, besides.
pub(super) fn surface_text(found: &SurfaceErrors, units: &Units, of: &str) -> String {
    let mut out = format!("surface at {}{}{of}\n", found.isovalue, text::unit(units.value.as_ref()));
    let value = |v: f64| text::value(text::figures(v, 6));
    let unit = text::unit(units.length.as_ref());
    let square = text::unit_to_the(2, units.length.as_ref());
    for (name, size) in [("archive", &found.archive), ("samples", &found.source)] {
        let pieces = text::plural(size.pieces, "piece");
        let closed = text::count(size.closed_pieces);
        let (area, triangles) = (value(size.area), text::count(size.triangles));
        let _ = writeln!(
            out,
            "  {name:<11} area {area}{square}, {pieces} ({closed} closed), {triangles} triangles"
        );
    }
    let more = 100.0 * (found.archive.area / found.source.area - 1.0);
    if more.is_finite() {
        let _ = writeln!(out, "  area        {:+} % of that of the samples", text::figures(more, 3));
    }
    let mut line = |name: &str, distance: &Option<SurfaceDistance>| match distance {
        Some(d) => {
            let [x, y, z] = d.max_at.map(value);
            let [mean, most, max] = [d.mean, d.p99, d.max].map(value);
            let _ = writeln!(
                out,
                "  {name:<11} mean {mean}{unit}, 99 % within {most}{unit}, largest {max}{unit} at {x}, {y}, {z}"
            );
        }
        None => {
            let _ = writeln!(out, "  {name:<11} none: one of the two is empty");
        }
    };
    line("to samples", &found.to_source);
    line("from them", &found.to_archive);
    out
}

/// The figures as a line of a report on an archive.
pub(crate) fn line(e: &FieldError) -> String {
    let figure = |v: f64| text::value(text::figures(v, 4)) + &text::share_of(v, e.source_range);
    let [rms, max] = [e.rms, e.max].map(figure);
    let of_range = if e.source_range.is_some() { "; % of the source's range" } else { "" };
    let beyond = beyond(e).map_or(String::new(), |line| format!("\n  outside     {line}"));
    format!(
        "  error       RMS {rms}, at most {max}, at {} samples{of_range}{beyond}",
        text::count(e.measured)
    )
}

/// How many vertices of a mesh the reduced domain leaves out.
fn beyond(e: &FieldError) -> Option<String> {
    let share = 100.0 * e.beyond as f64 / e.samples.max(1) as f64;
    (e.beyond > 0).then(|| {
        format!(
            "{} vertices ({share:.1} %) lie outside of the reduced domain: measured against its nearest value",
            text::count(e.beyond)
        )
    })
}

fn report_text(archive: &Path, report: &MeasureReport) -> String {
    let e = &report.error;
    let value = |v: f64| text::value(text::figures(v, 6));
    let range = e.source_range.map(|[lo, hi]| hi - lo).filter(|r| *r > 0.0);
    let share =
        |v: f64| range.map_or(String::new(), |r| format!("  ({:.3} % of the source's range)", 100.0 * v / r));
    let mut out = format!(
        "{}: measured at {} of {} samples\n",
        archive.display(),
        text::count(e.measured),
        text::count(e.samples)
    );
    let (void, outside) = match report.level {
        None => ("in void tetrahedra", "outside of all tetrahedra".to_owned()),
        Some(level) => ("between nodes without a value", format!("beyond the last nodes of level {level}")),
    };
    for (count, why) in [(e.missing, "without a value in the source"), (e.void, void), (e.outside, &outside)]
    {
        if count > 0 {
            let _ = writeln!(out, "  not         {} {why}", text::count(count));
        }
    }
    if let Some(line) = beyond(e) {
        let _ = writeln!(out, "  outside     {line}");
    }
    if e.measured == 0 {
        return out;
    }
    let _ = writeln!(out, "  RMS         {}{}", value(e.rms), share(e.rms));
    let _ = writeln!(out, "  mean        {}{}, with sign {}", value(e.mean), share(e.mean), value(e.bias));
    for p in &e.percentiles {
        let _ = writeln!(out, "  {:<11} {}{}", format!("{} %", p.percent), value(p.error), share(p.error));
    }
    let _ = writeln!(out, "  largest     {}{}", value(e.max), share(e.max));
    if let Some(w) = &e.worst {
        let at = w.index.map_or(format!("vertex {}", w.sample), |[i, j, k]| format!("sample {i}, {j}, {k}"));
        let [x, y, z] = w.world.map(value);
        let _ = writeln!(
            out,
            "    at        {at}, in the world {x}, {y}, {z}: {} where {} was",
            text::number(w.reduced),
            text::number(w.original)
        );
    }
    if let Some([x, y, z]) = report.map_bricks {
        let _ = writeln!(out, "  map         {x} x {y} x {z} bricks");
    }
    out
}
