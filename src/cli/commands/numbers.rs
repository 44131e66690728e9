//! Numbers at an isovalue: the flags, and the words, of the commands that say them.

use super::machine::Machine;
use super::progress::Talk;
use super::text;
use isospan::pipeline::{LevelChoice, NumbersReport, PhaseNumbers};
use isospan::volume::units::Units;
use isospan::{Resources, Result, Step};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// What measuring takes.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct MeasureFlags {
    #[command(flatten)]
    machine: Machine,
    /// Folder for what does not fit in memory [default: the system's temporary folder].
    #[arg(help_heading = "Resources", long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,
}

impl MeasureFlags {
    pub(crate) fn resources(&self, talk: &Talk) -> Resources {
        self.machine.resources(self.scratch.clone(), talk)
    }
}

/// A report, with numbers where they were asked for.
#[derive(Serialize)]
pub(crate) struct With<'a, R, N> {
    #[serde(flatten)]
    pub(crate) report: &'a R,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) numbers: Option<N>,
}

/// The numbers of a step at an isovalue.
pub(crate) fn of(
    step: &Step,
    isovalue: f64,
    level: Option<LevelChoice>,
    resources: Resources,
    talk: &Talk,
) -> Result<NumbersReport> {
    let bar = talk.progress();
    let found = step.query(isovalue).level(level).resources(resources).progress(&*bar).numbers();
    bar.end();
    found
}

/// The same in words, in lines that stand below the isovalue.
pub(crate) fn in_words(report: &NumbersReport, units: &Units) -> String {
    let mut out = String::new();
    let unit = |power| match &units.length {
        Some(unit) => text::unit_to_the(power, Some(unit)),
        None => String::new(),
    };
    let _ = writeln!(out, "  surface   area {}{}", text::number(report.area), unit(2));
    let closed = match (report.pieces, report.closed_pieces) {
        (pieces, closed) if pieces == closed => ", closed".to_owned(),
        (_, 0) => ", open".to_owned(),
        (_, closed) => format!(", {} of them closed", text::count(closed)),
    };
    let closed = if report.pieces == 0 { "" } else { &closed };
    let _ = writeln!(out, "            {}{closed}", text::plural(report.pieces, "piece"));
    let _ = writeln!(out, "  domain    volume {}{}", text::number(report.volume), unit(3));
    for (name, phase) in [("above", &report.above), ("below", &report.below)] {
        out += &phase_in_words(name, phase, units);
    }
    if report.above.pieces.is_none() {
        out += "  pieces of both sides, percolation and balls are for grids: this archive has tetrahedra\n";
    }
    out
}

fn phase_in_words(name: &str, phase: &PhaseNumbers, units: &Units) -> String {
    let unit = |power| text::unit_to_the(power, units.length.as_ref());
    let percent = text::value(text::figures(100.0 * phase.fraction, 4));
    let mut out =
        format!("  {name:<9} volume {}{}, {percent} % of the domain\n", text::number(phase.volume), unit(3));
    if let (Some(pieces), Some(percolates)) = (phase.pieces, phase.percolates) {
        let axes: Vec<&str> =
            ["x", "y", "z"].into_iter().zip(percolates).filter(|(_, joins)| *joins).map(|(a, _)| a).collect();
        let joins = match axes[..] {
            [] => "none reaches across the domain".to_owned(),
            _ => format!("reaches across the domain along {}", axes.join(", ")),
        };
        let _ = writeln!(out, "            {}, {joins}", text::plural(pieces, "piece"));
    }
    if let Some(ball) = &phase.ball {
        let [x, y, z] = ball.centre.map(text::number);
        let radius = text::number(ball.radius);
        let unit = text::unit(units.length.as_ref());
        let _ = writeln!(out, "            largest ball: radius {radius}{unit}, around {x}, {y}, {z}");
    }
    out
}
