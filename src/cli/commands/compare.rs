//! `isospan compare`: how far are two surfaces apart?

use super::grammar::{self, Value};
use super::level::LevelArgs;
use super::machine::Machine;
use super::output::Force;
use super::progress::Talk;
use super::render::BothWays;
use super::step::StepArgs;
use super::text;
use isospan::compare::{CompareReport, CompareSettings, compare};
use isospan::formats::surface::load_surface;
use isospan::pipeline::{Step, is_archive};
use isospan::surface::check::{CheckSettings, SurfaceCheckReport};
use isospan::volume::units::{Unit, common};
use isospan::{Archive, Error, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Compare two surfaces, or those of two archives at an isovalue.
///
/// That is distances, deviation of normals, area, volume, Euler number, components.
/// Both surfaces are sampled evenly by area, always at the same points, and nearest points are
/// exact. The largest distance also takes all vertices into account. With --output a picture shows
/// both side by side, each coloured by its distance from the other.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan compare full.ply reduced.ply\n  isospan compare a.isospan b.isospan --isovalue 600 --json\n  isospan compare a.isospan b.isospan -i 600 -o both.png\n  isospan compare scan.isospan scan.ply -i 600 --level 2"
)]
pub struct Args {
    /// A surface (.ply .stl .obj .vtp .vtkhdf .glb), or an archive.
    a: PathBuf,
    /// The other surface, or archive.
    b: PathBuf,
    /// The isovalue of the archives. 50% is half-way from the least value of the first one's step
    /// to its largest.
    #[arg(long, short = 'i', value_name = "VALUE", allow_hyphen_values = true, value_parser = grammar::value)]
    isovalue: Option<Value>,
    /// Also draw both surfaces side by side, each coloured by its distance from the other, with a
    /// scale: a .png.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    level: LevelArgs,
    #[command(flatten)]
    step: StepArgs,
    /// Number of samples on each surface.
    #[arg(long, value_name = "N", default_value = "200000", value_parser = grammar::natural, allow_negative_numbers = true)]
    samples: u64,
    #[command(flatten)]
    force: Force,
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
    if let Some(out) = &args.output {
        BothWays::check(out)?;
        args.force.check(out, [&args.a, &args.b])?;
    }
    let settings = CompareSettings {
        resources: args.machine.resources(args.scratch.clone(), talk),
        samples: args.samples,
    };
    let scratch = args.scratch.clone().unwrap_or_else(std::env::temp_dir);
    let check = CheckSettings { memory: settings.resources.memory, scratch };
    let steps = [opened(args, &args.a)?, opened(args, &args.b)?];
    let isovalue = isovalue(args, &steps)?;
    if let (Some(_), false) = (args.level.choice(), steps.iter().flatten().any(|s| s.is_pyramid())) {
        return Err(Error::usage("a level is one of a pyramid: neither input is one"));
    }
    let folder = tempfile::tempdir_in(&check.scratch)
        .map_err(|e| Error::io("make a temporary folder in", &check.scratch, e))?;
    let mut files = [args.a.clone(), args.b.clone()];
    for ((file, step), name) in files.iter_mut().zip(&steps).zip(["a.ply", "b.ply"]) {
        if let Some(step) = step {
            let out = folder.path().join(name);
            extract(file, step, isovalue, &out, args, &settings, talk)?;
            *file = out;
        }
    }
    let [a, b] = [load_surface(&files[0], &check)?, load_surface(&files[1], &check)?];
    let report = compare(&a, &b, &settings)?;
    let units = [&a, &b].map(|surface| surface.units().length.clone());
    if let [Some(a), Some(b)] = &units
        && a != b
    {
        talk.note(&format!("warning: A is in {a} and B in {b}: numbers are compared as they are"));
    }
    let unit = common(units);
    drop([a, b]);
    if let Some(out) = &args.output {
        let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let picture = BothWays {
            surfaces: [&files[0], &files[1]],
            names: [stem(&args.a), stem(&args.b)],
            out,
            memory: settings.resources.memory,
            threads: settings.resources.threads,
            scratch: &check.scratch,
        };
        picture.draw(talk)?;
    }
    if args.json {
        super::print_json("compare", &report)
    } else {
        super::print(&in_words(args, &report, unit.as_ref()))
    }
}

/// The step of an archive; none of a surface.
fn opened(args: &Args, path: &Path) -> Result<Option<Step>> {
    if !is_archive(path) {
        if path.is_dir() {
            let path = path.display();
            let text = "is a folder and no archive: name an archive, or the file of a surface";
            return Err(Error::usage(format!("{path} {text}")));
        }
        return Ok(None);
    }
    if args.isovalue.is_none() {
        let path = path.display();
        let text = "is an archive: give the isovalue whose surface is compared, --isovalue VALUE";
        return Err(Error::usage(format!("{path} {text}")));
    }
    Archive::open(path)?.at(args.step.choice()?).map(Some)
}

/// The isovalue of the archives; 0 where there are none.
fn isovalue(args: &Args, steps: &[Option<Step>; 2]) -> Result<f64> {
    match (&args.isovalue, steps.iter().flatten().next()) {
        (Some(isovalue), Some(first)) => isovalue.of(first.value_range()),
        (None, _) if !args.step.is_given() && args.level.choice().is_none() => Ok(0.0),
        _ => Err(Error::usage(
            "--isovalue, --step, --time and levels are for archives; both inputs are surfaces",
        )),
    }
}

/// Writes the surface of an archive at an isovalue to a file.
fn extract(
    path: &Path,
    step: &Step,
    isovalue: f64,
    out: &Path,
    args: &Args,
    settings: &CompareSettings,
    talk: &Talk,
) -> Result<()> {
    // Of two archives, one may have no levels.
    let level = args.level.choice().filter(|_| step.is_pyramid());
    let (resources, bar) = (settings.resources.clone(), talk.progress());
    let report = step.query(isovalue).level(level).resources(resources).progress(&*bar).write(out);
    bar.end();
    if report?.triangles == 0 {
        let path = path.display();
        return Err(Error::usage(format!("{path}: the isovalue {isovalue} gives no surface")));
    }
    Ok(())
}

fn value(v: f64) -> String {
    text::value(text::figures(v, 6))
}

fn in_words(args: &Args, r: &CompareReport, unit: Option<&Unit>) -> String {
    let mut out = format!("A  {}\nB  {}\n", args.a.display(), args.b.display());
    let mut row = |name: &str, cells: [String; 3]| {
        let [a, b, c] = cells;
        let _ = writeln!(out, "  {name:<18} {a:>14} {b:>14} {c:>14}");
    };
    row("", ["A".into(), "B".into(), String::new()]);
    let of = |f: &dyn Fn(&SurfaceCheckReport) -> String| [f(&r.a), f(&r.b), String::new()];
    row("triangles", of(&|s| text::count(s.triangles)));
    row("area", of(&|s| value(s.area)));
    row("volume", of(&|s| s.volume.map_or("open".into(), value)));
    row("Euler number", of(&|s| s.euler.to_string()));
    row("components", of(&|s| text::count(s.components)));
    row("", ["A to B".into(), "B to A".into(), "both".into()]);
    row("largest distance", [r.a_to_b.max, r.b_to_a.max, r.hausdorff].map(value));
    row("mean distance", [r.a_to_b.mean, r.b_to_a.mean, r.mean].map(value));
    row("RMS distance", [r.a_to_b.rms, r.b_to_a.rms, r.rms].map(value));
    let place = |at: [f64; 3]| at.map(value).join(", ");
    let places = [r.a_to_b.max_at, r.b_to_a.max_at].map(place);
    let angles = [r.a_to_b.rms_normal_degrees, r.b_to_a.rms_normal_degrees, r.rms_normal_degrees];
    row("RMS normal angle", angles.map(|v| format!("{}°", value(v))));
    let [from_a, from_b] = places;
    let _ = writeln!(out, "  the largest is from A at {from_a}; from B at {from_b}");
    let percent = 100.0 * r.hausdorff / r.diagonal;
    let _ = writeln!(
        out,
        "  in {}; the largest distance is {} % of the diagonal {}; {} samples each",
        unit.map_or("world units", Unit::as_str),
        value(percent),
        value(r.diagonal),
        text::count(r.samples)
    );
    out
}
