//! `isospan spectrum`: how the isosurface changes with the isovalue.

use super::step::StepArgs;
use super::{figure, text};
use isospan::Result;
use isospan::pipeline::{SpectrumReport, contour_spectrum_at};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Tell active tetrahedra, area and enclosed volume as functions of the isovalue.
///
/// They are exact at each isovalue of the table; lengths are the volume's world units. Reads some ten thousand bytes.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The archive.
    archive: PathBuf,
    /// Also draw the curves: .svg or .png.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    step: StepArgs,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let format = args.plot.as_deref().map(figure::Format::of).transpose()?;
    let report = contour_spectrum_at(&args.archive, args.step.choice())?;
    if let Some((file, format)) = args.plot.as_deref().zip(format) {
        let name = args.archive.file_stem().unwrap_or_default().to_string_lossy();
        figure::write(&report, &name, file, format)?;
    }
    if args.json { super::print_json(&report) } else { super::print(&table(&report)) }
}

fn table(report: &SpectrumReport) -> String {
    let Some([lo, hi]) = report.range else { return "there is no value: every point is void\n".into() };
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{} tetrahedra, volume {}, values {lo} .. {hi}",
        text::count(report.tetrahedra),
        text::value(text::figures(report.volume, 7))
    );
    if !report.suggestions.is_empty() {
        let values: Vec<String> = report.suggestions.iter().map(|s| s.isovalue.to_string()).collect();
        let _ = writeln!(out, "worth a look: {}", values.join(", "));
    }
    let _ = writeln!(
        out,
        "{:>12} {:>14} {:>14} {:>14} {:>14}",
        "isovalue", "active", "area", "volume", "mean gradient"
    );
    for k in &report.knots {
        let mean = if k.area > 0.0 { k.gradient / k.area } else { 0.0 };
        let [area, volume, mean] = [k.area, k.volume, mean].map(|v| text::value(text::figures(v, 7)));
        let active = text::count(k.active_tetrahedra);
        let _ = writeln!(out, "{:>12} {active:>14} {area:>14} {volume:>14} {mean:>14}", k.isovalue);
    }
    out
}
