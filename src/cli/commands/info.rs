//! `isospan info`: what is in a volume, a mesh or an archive.

use super::input::InputArgs;
use super::progress::Talk;
use super::step::MomentArgs;
use super::text;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{self, ArchiveSummary, Scan, StepChoice, StepSummary};
use isospan::points::PointSpec;
use isospan::sample::Values;
use isospan::volume::VolumeInfo;
use isospan::volume::units::{Unit, common};
use isospan::{Archive, Error, Result, formats};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Show what volumes, meshes and archives hold.
///
/// That is dimensions, type, fields, geometry, range, histogram, error, suggested isovalues.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:\n  isospan info scan.nrrd\n  isospan info scan.isospan --json")]
pub struct Args {
    /// Volumes, meshes or archives; volumes and archives also by address: s3://... or https://...
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Read the header only: no range, no histogram.
    #[arg(long)]
    no_scan: bool,
    #[command(flatten)]
    step: MomentArgs,
    /// Print JSON, one object per line.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    args.inputs.iter().try_for_each(|path| one(path, args, talk))
}

fn one(path: &Path, args: &Args, talk: &Talk) -> Result<()> {
    if pipeline::is_archive(path) {
        let summary = Archive::open(path)?.at(args.step.choice(args.read.field.as_deref())?)?.info()?;
        return if args.json {
            super::print_json("info.archive", &summary)
        } else {
            super::print(&archive_text(path, &summary))
        };
    }
    let Opened { input, step, steps, shown, several } = open(path, args)?;
    let source = match input {
        formats::Input::Volume(source) => source,
        formats::Input::Mesh(mesh) => return super::info_mesh::run(&mesh, !args.no_scan, args.json, talk),
    };
    let (info, scan, notices) = if args.no_scan {
        (source.info().clone(), None, pipeline::header_notices(source.info()))
    } else {
        let (info, scan, notices) = pipeline::scan_with_notices(source)?;
        (info, Some(scan), notices)
    };
    talk.notices(&notices);
    if args.json {
        let mut value =
            serde_json::json!({ "kind": "volume", "info": info, "scan": scan, "notices": notices });
        if steps.len() > 1 {
            let step = |s: &StepSource| serde_json::json!({ "field": s.options.field, "time": s.time });
            value["steps"] = steps.iter().map(step).collect();
            value["step"] = shown.into();
        }
        if let Some([lo, hi]) = scan.as_ref().and_then(|s| stored_range(&info, s)) {
            value["stored_range"] = serde_json::json!([lo, hi]);
        }
        return super::print_json("info.volume", &value);
    }
    let own = step.coordinates()?.is_some();
    let mut out = volume_text(&info, scan.as_ref(), own);
    if let [first, .., last] = &steps[..] {
        let which = if shown == 0 { "the first".into() } else { format!("number {shown}") };
        let _ = write!(out, "  steps      {}, of which this is {which}", text::count(steps.len() as u64));
        let _ = match (first.time, last.time) {
            (Some(lo), Some(hi)) => {
                let unit = text::unit(info.units.time.as_ref());
                writeln!(out, "; times {}{unit}", text::range([lo, hi]))
            }
            _ => writeln!(out),
        };
    } else if several {
        let _ = writeln!(out, "  next       --field NAME chooses another field than this, the first");
    }
    super::print(&out)
}

/// What is shown of an input.
struct Opened {
    input: formats::Input,
    step: StepSource,
    /// The steps in it.
    steps: Vec<StepSource>,
    /// The one that is opened.
    shown: usize,
    /// Whether there are several fields, none of which was chosen: the first is opened.
    several: bool,
}

fn open(path: &Path, args: &Args) -> Result<Opened> {
    let options = args.read.options()?;
    let steps = formats::steps_of(&[path.to_path_buf()], &options)?;
    let shown = chosen(path, &steps, args.step.choice(None)?)?;
    let step = steps.get(shown).cloned().unwrap_or_else(|| StepSource::new(path, &options));
    match step.open() {
        Err(error @ Error::Usage(_)) if step.options.field.is_none() => {
            // Any field: the contents of the file are listed, to choose from.
            let step = step.with_options(&OpenOptions { field: Some("*".into()), ..step.options.clone() });
            let input = step.open().map_err(|_| error)?;
            Ok(Opened { input, step, steps, shown, several: true })
        }
        opened => Ok(Opened { input: opened?, step, steps, shown, several: false }),
    }
}

/// The place of the step that is asked of an input.
fn chosen(path: &Path, steps: &[StepSource], choice: StepChoice) -> Result<usize> {
    let refuse = |why: String| Err(Error::usage(format!("{}: {why}", path.display())));
    match choice {
        StepChoice::First => Ok(0),
        StepChoice::Number(n) | StepChoice::NumberOf(n, _) => {
            match usize::try_from(n).ok().filter(|n| *n < steps.len().max(1)) {
                Some(n) => Ok(n),
                None => refuse(format!("no step {n}; the steps are 0 to {}", steps.len().max(1) - 1)),
            }
        }
        StepChoice::Field(name) => {
            match steps.iter().position(|step| step.options.field.as_deref() == Some(&*name)) {
                Some(n) => Ok(n),
                None => refuse(format!("no step of the field {name}; --field NAME chooses a field")),
            }
        }
        StepChoice::Time(time) | StepChoice::TimeOf(time, _) => {
            // As in an archive, a step without a time has its number.
            let times = || steps.iter().enumerate().map(|(n, step)| step.time.unwrap_or(n as f64));
            let found = times().position(|of_step| of_step == time);
            let ends = times().reduce(f64::min).zip(times().reduce(f64::max));
            match (found, ends) {
                (Some(n), _) => Ok(n),
                (None, Some((lo, hi))) => refuse(format!(
                    "no step at time {}; the times are {} to {}, and between them only an archive has values",
                    text::number(time),
                    text::number(lo),
                    text::number(hi)
                )),
                (None, None) => refuse("no time is known".into()),
            }
        }
    }
}

/// `own`: whether a grid has coordinates of its own.
fn volume_text(info: &VolumeInfo, scan: Option<&Scan>, own: bool) -> String {
    let ([x, y, z], g) = (info.dims, &info.geometry);
    let mut out = String::new();
    let _ = writeln!(out, "{}: {}", info.path.display(), info.format);
    let _ = writeln!(out, "  dims       {x} x {y} x {z}  ({} samples)", text::count(x * y * z));
    let _ = writeln!(out, "  type       {}", info.field.scalar.name());
    let _ = writeln!(out, "  field      {}", text::name(&info.field.name));
    if info.fields.len() > 1 {
        let names: Vec<String> = info.fields.iter().map(field_text).collect();
        let _ = writeln!(out, "  fields     {}", names.join(", "));
    }
    if own {
        let _ = writeln!(out, "  placed     by the grid's coordinates");
    } else {
        let unit = text::unit(info.units.length.as_ref());
        let _ = writeln!(out, "  spacing    {}{unit}", triple(g.spacing));
        let _ = writeln!(out, "  origin     {}{unit}", triple(g.origin));
    }
    if g.direction != isospan::grid::Geometry::default().direction {
        let _ = writeln!(out, "  direction  {}", g.direction.map(triple).join("  |  "));
    }
    if (info.slope, info.intercept) != (1.0, 0.0) {
        let [slope, intercept] = [info.slope, info.intercept].map(text::number);
        let _ = writeln!(out, "  scaled     value = {slope} * stored + {intercept}");
    }
    if let Some(scan) = scan {
        scan_text(&mut out, info, scan);
    }
    out
}

fn scan_text(out: &mut String, info: &VolumeInfo, scan: &Scan) {
    match (scan.min, scan.max, scan.mean) {
        (Some(lo), Some(hi), Some(mean)) => {
            let (range, mean) = (text::range([lo, hi]), text::in_range(mean, [lo, hi]));
            let unit = text::unit(info.units.value.as_ref());
            let _ = writeln!(out, "  range      {range}{unit}  (mean {mean})");
        }
        _ => {
            let _ = writeln!(out, "  range      none: there is no finite sample");
        }
    }
    if let Some(stored) = stored_range(info, scan) {
        let _ = writeln!(out, "  stored     {}", text::range(stored));
    }
    if scan.nan > 0 || scan.infinite > 0 {
        let _ = writeln!(
            out,
            "  missing    {} NaN, {} infinite",
            text::count(scan.nan),
            text::count(scan.infinite)
        );
    }
    let _ = writeln!(
        out,
        "  histogram  {}",
        sparkline(&scan.histogram.iter().map(|&n| n as f64).collect::<Vec<_>>(), |share| share.sqrt().sqrt())
    );
}

/// The range of the stored numbers, where values are scaled from them.
fn stored_range(info: &VolumeInfo, scan: &Scan) -> Option<[f64; 2]> {
    let back = |v: f64| {
        let stored = (v - info.intercept) / info.slope;
        // Values were rounded to f32: integers come back to the nearest one.
        let float = info.field.scalar.is_float();
        if float { stored } else { stored.round() }
    };
    if (info.slope, info.intercept) == (1.0, 0.0) {
        return None;
    }
    let (a, b) = (back(scan.min?), back(scan.max?));
    Some([a.min(b), a.max(b)])
}

fn field_text(f: &isospan::volume::FieldInfo) -> String {
    if f.components == 1 {
        format!("{} ({})", text::name(&f.name), f.scalar.name())
    } else {
        format!("{} ({} x{})", text::name(&f.name), f.scalar.name(), f.components)
    }
}

fn triple(v: [f64; 3]) -> String {
    v.map(text::number).join(" ")
}

/// Heights by a root of the share of the largest, so that small bins show next to a large
/// background.
fn sparkline(bins: &[f64], root: fn(f64) -> f64) -> String {
    const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let most = bins.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    bins.iter()
        .map(|&n| if n <= 0.0 { ' ' } else { BARS[((root(n / most) * 7.0).round() as usize).min(7)] })
        .collect()
}

/// The area of the isosurface over the range of isovalues, in 64 steps: the mean of what was
/// measured in each, or of its neighbours.
fn area_line(areas: &[[f64; 2]]) -> String {
    const STEPS: usize = 64;
    let (lo, hi) = (areas[0][0], areas[areas.len() - 1][0]);
    let step = |v: f64| (((v - lo) / (hi - lo) * STEPS as f64) as usize).min(STEPS - 1);
    let mut sums = vec![(0.0, 0u32); STEPS];
    for &[isovalue, area] in areas {
        let (sum, n) = &mut sums[step(isovalue)];
        (*sum, *n) = (*sum + area, *n + 1);
    }
    let mut last = 0.0;
    let means: Vec<f64> = sums
        .iter()
        .map(|&(sum, n)| {
            if n > 0 {
                last = sum / f64::from(n);
            }
            last
        })
        .collect();
    sparkline(&means, f64::sqrt)
}

fn archive_text(path: &Path, s: &ArchiveSummary) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "{}: isospan archive, format {}", path.display(), s.format);
    out += &source_line(s);
    out += &points_text(s);
    out += &levels_text(s);
    out += &mesh_text(s);
    out += &values_text(s);
    out += &steps_text(s);
    let each = s.bytes as f64 / s.points.max(1) as f64;
    let _ = writeln!(out, "  size        {} ({each:.2} bytes a point)", text::bytes(s.bytes));
    if let Some(samples) = s.sample_bytes {
        let count = s.dims.iter().product::<u64>() * s.steps.len() as u64;
        let _ = writeln!(out, "{}", text::bits_line(s.bytes, samples, count));
    }
    out
}

fn source_line(s: &ArchiveSummary) -> String {
    // The lattice of a mesh is not the user's.
    let dims = match s.mesh {
        Some(_) => String::new(),
        None => s.dims.map(|n| n.to_string()).join(" x ") + " ",
    };
    let (source, scalar) = (text::name(&s.source), s.scalar.name());
    format!("  source      {source} ({}, {dims}{scalar})\n", s.source_format)
}

/// The points, with the levels of density of adapted ones, and what lies between them.
fn points_text(s: &ArchiveSummary) -> String {
    let mut out = String::new();
    // Steps of a mesh may have holes of their own.
    let outside = if s.mesh.is_some() && s.steps.len() == 1 { s.void_points } else { 0 };
    let _ = writeln!(out, "  points      {} ({})", text::count(s.points - outside), point_set(&s.point_set));
    let all: u64 = s.levels.iter().map(|l| l.voxels).sum();
    for (n, level) in s.levels.iter().enumerate() {
        let _ = writeln!(
            out,
            "  {:<11} {:.4} points a voxel in {:.1} % of the domain: {} points, {}{}",
            format!("level {n}"),
            level.density,
            100.0 * level.voxels as f64 / all as f64,
            text::count(level.points),
            text::bytes(level.bytes),
            level.error.map_or_else(String::new, |e| {
                let [rms, max] = [e.rms, e.max].map(|e| text::value(text::figures(e, 4)));
                format!(", error RMS {rms}, at most {max}")
            })
        );
    }
    let (chunks, blocks) = (text::plural(s.chunks, "chunk"), text::count(s.blocks));
    let _ = match s.tetrahedra {
        0 => writeln!(out, "  bricks      {blocks} with a range each, in {chunks}"),
        count => writeln!(
            out,
            "  tetrahedra  {} in {}, {chunks}",
            text::count(count),
            text::plural(s.blocks, "block")
        ),
    };
    out
}

/// The cells of the source, and how a value between points is found.
fn mesh_text(s: &ArchiveSummary) -> String {
    let mut out = String::new();
    if let Some(cells) = s.grid_cells {
        let _ = writeln!(out, "{}", text::grid_cells(&cells));
    }
    if let Some(mesh) = s.mesh {
        let _ = writeln!(
            out,
            "  mesh        {} vertices, {} tetrahedra{}",
            text::count(mesh.vertices),
            text::count(mesh.tetrahedra),
            if s.own { ", kept as they are" } else { "" }
        );
    }
    let fitted = match s.values {
        Values::Sample => "",
        Values::Fit => ", fitted to the samples",
    };
    if s.pyramid.is_empty() {
        let _ = writeln!(out, "  interp      {}{fitted}", s.interpolation);
    }
    out
}

/// The values: how they are stored, their range, error, and isovalues worth a look.
fn values_text(s: &ArchiveSummary) -> String {
    let mut out = String::new();
    if let Some(q) = &s.quantiser {
        let bound = text::value(text::figures(q.bound, 4));
        let _ = writeln!(out, "  values      {} bits, within {bound}", text::figures(q.bits, 3));
    }
    if let Some(range) = s.range {
        let unit = text::unit(s.units.value.as_ref());
        let _ = writeln!(out, "  range       {}{unit}", text::range(range));
    }
    if let Some(line) = units_line(s) {
        let _ = writeln!(out, "  units       {line}");
    }
    out += &text::rounding(s.rounding);
    if !s.areas.is_empty() {
        let _ = writeln!(out, "  area        {}", area_line(&s.areas));
    }
    if !s.suggestions.is_empty() {
        let value = |v: f64| s.range.map_or_else(|| text::number(v), |range| text::in_range(v, range));
        let values: Vec<String> = s.suggestions.iter().map(|s| value(s.isovalue)).collect();
        let _ =
            writeln!(out, "  isovalues   worth a look: {} (isospan spectrum says more)", values.join(", "));
    }
    if let Some(error) = &s.error {
        let _ = writeln!(out, "{}", super::measure::line(error));
    }
    if s.void_points > 0 {
        let all =
            if s.steps.len() > 1 { " without a value, of all steps together" } else { " without a value" };
        let _ = writeln!(out, "  void        {}{all}", text::plural(s.void_points, "point"));
    }
    out
}

/// The levels of a pyramid, a line each.
fn levels_text(s: &ArchiveSummary) -> String {
    if s.pyramid.is_empty() {
        return String::new();
    }
    let range = s.error.as_ref().and_then(|e| e.source_range).map(|[lo, hi]| hi - lo).filter(|r| *r > 0.0);
    let mut out =
        format!("  {:<11} {:>20} {:>15} {:>10} {:>12}\n", "level", "nodes", "cells", "bytes", "RMS error");
    for level in &s.pyramid {
        let nodes = level.nodes.map(|n| n.to_string()).join(" x ");
        let bytes = level.bytes.map_or("-".into(), text::bytes);
        let rms = level.rms.map_or("-".into(), |rms| {
            let share = range.map_or(String::new(), |range| format!("  {:.3} %", 100.0 * rms / range));
            format!("{:>12}{share}", text::value(text::figures(rms, 4)))
        });
        let cells = text::count(level.cells);
        let _ = writeln!(out, "  {:>11} {nodes:>20} {cells:>15} {bytes:>10} {rms:>12}", level.level);
    }
    out
}

/// The units that are known, of what.
fn units_line(s: &ArchiveSummary) -> Option<String> {
    let mut values: Vec<String> = vec![];
    for step in &s.steps {
        let named = step.unit.as_ref().map(|unit| format!("{unit} of {}", text::name(&step.field)));
        values.extend(named.filter(|text| !values.contains(text)));
    }
    // Those of the frames of a series are one.
    let of_values = |unit: &Unit| vec![format!("{unit} of values")];
    let one = common(s.steps.iter().map(|step| step.unit.clone()));
    let values = one.as_ref().map_or(values, of_values);
    let [length, time] = [(&s.units.length, "lengths"), (&s.units.time, "times")]
        .map(|(unit, of)| unit.as_ref().map(|unit| format!("{unit} of {of}")));
    let all: Vec<String> = values.into_iter().take(8).chain(length).chain(time).collect();
    (!all.is_empty()).then(|| all.join(", "))
}

/// A point set, in words.
fn point_set(set: &PointSpec) -> String {
    let by = |n: [u64; 3]| n.map(|n| n.to_string()).join(" x ");
    match *set {
        PointSpec::Hammersley { n, shift } => {
            format!("hammersley, {} inside, shift {}", text::count(n), text::number(shift))
        }
        PointSpec::Halton { n } => format!("halton, {} inside", text::count(n)),
        PointSpec::HyperbolicCross { m, k, r: [x, y, z] } => {
            format!("hyperbolic-cross, m {m}, k {k}, r {x},{y},{z}")
        }
        PointSpec::Regular { counts } => format!("regular, {}", by(counts)),
        PointSpec::Pyramid { dims, .. } => format!("pyramid, {} samples", by(dims)),
        PointSpec::Labels { dims } => format!("labels, {} samples", by(dims)),
        PointSpec::Own { .. } => "the mesh's own vertices".into(),
    }
}

/// Whether the steps are fields of one moment.
fn is_of_fields(steps: &[StepSummary]) -> bool {
    steps.iter().enumerate().all(|(n, step)| {
        step.time.is_none()
            && step.source == steps[0].source
            && steps[..n].iter().all(|s| s.field != step.field)
    })
}

/// The steps, one line for each in a series.
fn steps_text(s: &ArchiveSummary) -> String {
    let mut out = match s.steps.len() {
        n if n > 1 && is_of_fields(&s.steps) => format!("  fields      {n}, a step each\n"),
        n => format!("  steps       {n}\n"),
    };
    if s.steps.len() == 1 {
        return out;
    }
    let _ = writeln!(
        out,
        "  {:>6} {:>12} {:>24} {:>12} {:>10} {:>10}  source",
        "step", "time", "range", "RMS error", "values", "index"
    );
    for step in &s.steps {
        let time = step.time.map_or("-".into(), text::number);
        let range = step.range.map_or("none".into(), text::range);
        let error = step.error.map_or("-".into(), |[rms, _]| text::value(text::figures(rms, 4)));
        let [values, index] = [step.value_bytes, step.index_bytes].map(text::bytes);
        let is_asked = step.number == s.step && step.field == s.field;
        let asked = if is_asked { '>' } else { ' ' };
        let key = if step.base.is_none() { " (keyframe)" } else { "" };
        let _ = writeln!(
            out,
            " {asked}{:>6} {time:>12} {range:>24} {error:>12} {values:>10} {index:>10}  {}: {}{key}",
            step.number,
            text::name(&step.source),
            text::name(&step.field)
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_a_line_of_64_steps() {
        let areas: Vec<[f64; 2]> = (0..=10).map(|i| [f64::from(i), f64::from(i * i)]).collect();
        let line: Vec<char> = area_line(&areas).chars().collect();
        assert_eq!((line.len(), line[0], line[63]), (64, ' ', '█'));
        assert!(line[1..].is_sorted_by_key(|&c| if c == ' ' { 0 } else { c as u32 }), "{line:?}");
        assert_eq!(area_line(&[[3.0, 1.0]]).chars().count(), 64);
    }
}
