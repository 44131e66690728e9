//! `isospan compare`: how far are two surfaces apart?

use super::grammar;
use super::machine::Machine;
use super::progress::Talk;
use super::text;
use isospan::Result;
use isospan::compare::{CompareReport, CompareSettings, compare};
use isospan::formats::surface::load_surface;
use isospan::surface::check::{CheckSettings, SurfaceReport};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Compare two surfaces.
///
/// That is distances, deviation of normals, area, volume, Euler number, components.
/// Both surfaces are sampled evenly by area, always at the same points, and nearest points are
/// exact. The largest distance also takes all vertices into account.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan compare full.ply reduced.ply\n  isospan compare a.stl b.stl --samples 1000000 --json"
)]
pub(crate) struct Args {
    /// A surface: .ply .stl .obj .vtp .vtkhdf .glb.
    a: PathBuf,
    /// The other surface.
    b: PathBuf,
    /// Number of samples on each surface.
    #[arg(long, value_name = "N", default_value = "200000", value_parser = grammar::natural, allow_negative_numbers = true)]
    samples: u64,
    #[command(flatten)]
    machine: Machine,
    /// Folder for what does not fit in memory [default: the system's temporary folder].
    #[arg(help_heading = "Resources", long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let settings = CompareSettings {
        resources: args.machine.resources(args.scratch.clone(), talk),
        samples: args.samples,
    };
    let scratch = args.scratch.clone().unwrap_or_else(std::env::temp_dir);
    let check = CheckSettings { memory: settings.resources.memory, scratch };
    let (a, b) = (load_surface(&args.a, &check)?, load_surface(&args.b, &check)?);
    let report = compare(&a, &b, &settings)?;
    if args.json { super::print_json("compare", &report) } else { super::print(&in_words(args, &report)) }
}

fn value(v: f64) -> String {
    text::value(text::figures(v, 6))
}

fn in_words(args: &Args, r: &CompareReport) -> String {
    let mut out = format!("A  {}\nB  {}\n", args.a.display(), args.b.display());
    let mut row = |name: &str, cells: [String; 3]| {
        let [a, b, c] = cells;
        let _ = writeln!(out, "  {name:<18} {a:>14} {b:>14} {c:>14}");
    };
    row("", ["A".into(), "B".into(), String::new()]);
    let of = |f: &dyn Fn(&SurfaceReport) -> String| [f(&r.a), f(&r.b), String::new()];
    row("triangles", of(&|s| text::count(s.triangles)));
    row("area", of(&|s| value(s.area)));
    row("volume", of(&|s| s.volume.map_or("open".into(), value)));
    row("Euler number", of(&|s| s.euler.to_string()));
    row("components", of(&|s| text::count(s.components)));
    row("", ["A to B".into(), "B to A".into(), "both".into()]);
    row("largest distance", [r.a_to_b.max, r.b_to_a.max, r.hausdorff].map(value));
    row("mean distance", [r.a_to_b.mean, r.b_to_a.mean, r.mean].map(value));
    row("RMS distance", [r.a_to_b.rms, r.b_to_a.rms, r.rms].map(value));
    let angles = [r.a_to_b.rms_normal_degrees, r.b_to_a.rms_normal_degrees, r.rms_normal_degrees];
    row("RMS normal angle", angles.map(|v| format!("{}°", value(v))));
    let percent = 100.0 * r.hausdorff / r.diagonal;
    let _ = writeln!(
        out,
        "  in world units; the largest distance is {} % of the diagonal {}; {} samples each",
        value(percent),
        value(r.diagonal),
        text::count(r.samples)
    );
    out
}
