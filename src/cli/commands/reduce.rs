//! `isospan reduce`: a volume becomes an archive.

use super::choices::Choices;
use super::input::InputArgs;
use super::machine::{InputScratch, Machine};
use super::output::expect_apart;
use super::progress::Talk;
use super::step::StepInputs;
use super::{dry_run, signals, text};
use isospan::exec::CancelToken;
use isospan::formats::StepSource;
use isospan::pipeline::{
    ArchiveSummary, NO_SURFACE, ReduceReport, ReduceSettings, RunSettings, Stage, StepSummary, SurfaceErrors,
    Target, TargetReport,
};
use isospan::points::PointSpec;
use isospan::{Archive, Reduction, Resources, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Reduce a volume or mesh to an archive.
///
/// The field is sampled at points, these are joined to tetrahedra, and the tetrahedra are indexed.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan reduce scan.nrrd -o scan.isospan --target-rms 1%\n  isospan reduce scan.nrrd -o scan.isospan --isovalue 600 --target-surface 0.2mm\n  isospan reduce 'step_*.vti' -o run.isospan --fraction 1/64 --memory 4GiB"
)]
pub struct Args {
    #[command(flatten)]
    pub steps: StepInputs,
    /// The archive to make, a folder NAME.isospan.
    #[arg(short, long, value_name = "ARCHIVE")]
    pub output: PathBuf,
    #[command(flatten)]
    pub choices: Choices,
    /// Also measure the error of the first step against this file: of an archive that is reduced
    /// again, against its source.
    #[arg(long, value_name = "INPUT")]
    against: Option<PathBuf>,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: InputScratch,
    /// Print what the run needs (memory, disk, time) and make nothing; exit code 4 if there is not
    /// enough.
    #[arg(long)]
    dry_run: bool,
    /// Replace an existing archive.
    #[arg(long)]
    force: bool,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
}

impl Args {
    /// How the machine is used, until a token stops the run.
    pub fn run_settings(&self, talk: &Talk, cancel: CancelToken) -> RunSettings {
        let run = self.machine.run_until(&self.scratch, talk, cancel);
        RunSettings { replace: self.force, keep_going: self.steps.keep_going, ..run }
    }

    /// The files that are reduced, and what is made of them.
    pub fn request(&self, talk: &Talk) -> Result<(Vec<StepSource>, ReduceSettings)> {
        let steps = self.steps.all(&self.read, talk)?;
        let settings = self.choices.settings()?;
        expect_apart(&self.output, steps.iter().map(|step| &step.path).chain(&self.against))?;
        Ok((steps, settings))
    }

    /// What the error is measured against besides.
    pub fn against(&self) -> Result<Option<StepSource>> {
        let Some(path) = &self.against else { return Ok(None) };
        Ok(Some(StepSource::new(path, &self.read.options()?)))
    }
}

/// Makes the archive; returns the exit code, which says whether a target was met.
pub(crate) fn run(args: &Args, talk: &Talk) -> Result<u8> {
    let run = args.run_settings(talk, signals::cancel_token());
    let (steps, settings) = args.request(talk)?;
    let io = args.read.io_text(&steps[0].path);
    let RunSettings { resources, replace, keep_going } = run;
    let Resources { threads, memory, .. } = resources;
    let reduction = Reduction::of_steps(steps).settings(settings).resources(resources);
    let reduction = reduction.replace(replace).keep_going(keep_going).isovalues(args.choices.isovalues());
    let reduction = match args.against()? {
        Some(source) => reduction.against(source),
        None => reduction,
    };
    if args.dry_run {
        let found = reduction.estimate(&args.output)?;
        talk.notices(&found.notices);
        return dry_run::tell(&found, &args.output, args.json).map(|()| 0);
    }
    let threads = if threads == 0 { isospan::exec::available_threads() } else { threads };
    talk.detail(&format!("memory {}, {threads} threads, {io}", text::bytes(memory)));
    let bar = talk.progress();
    let report = reduction.progress(&*bar).write(&args.output);
    bar.end();
    let report = report?;
    tell("reduce", &args.output, &report, args.json, talk)?;
    Ok(code_of(&args.output, &report))
}

/// The exit code of an archive that is written; says so where a target was not met.
pub(super) fn code_of(archive: &Path, report: &ReduceReport) -> u8 {
    let Some(why) = unmet(report) else { return 0 };
    super::print_error(&format!("{}: written, but {why}", archive.display()));
    super::TARGET_NOT_MET
}

/// What a target lacks that was not met.
pub fn unmet(report: &ReduceReport) -> Option<String> {
    report.unmet().map(|t| format!("the target is not met: {}", reached_text(t)))
}

/// Prints what was made.
pub(super) fn tell(
    schema: &str,
    archive: &Path,
    report: &ReduceReport,
    json: bool,
    talk: &Talk,
) -> Result<()> {
    talk.stages(&report.seconds);
    talk.detail(&format!(
        "{}, {} had to be widened",
        text::plural(report.chunks, "chunk"),
        text::plural(report.halo_retries, "halo")
    ));
    report.source_chunks.iter().for_each(|found| talk.detail(&text::source_chunks(found)));
    if json {
        return super::print_json(schema, report);
    }
    super::print(&in_words(archive, report, schema == "append"))
}

/// What was reached, of what was wanted.
pub(super) fn reached_text(t: &TargetReport) -> String {
    let four = |v: f64| text::value(text::figures(v, 4));
    match t.target {
        Target::Rms(_) | Target::Max(_) if t.of_ranges => {
            let [reached, bound] = [t.reached, t.bound].map(|share| four(100.0 * share));
            let what = if matches!(t.target, Target::Rms(_)) { "RMS" } else { "at most" };
            format!("{what} {reached} % of {bound} % wanted, of the range of each field")
        }
        Target::Rms(_) => format!("RMS {} of {} wanted", four(t.reached), four(t.bound)),
        Target::Max(_) => format!("at most {} of {} wanted", four(t.reached), four(t.bound)),
        Target::Surface(_) if t.reached >= NO_SURFACE => "one of the two surfaces is missing".into(),
        Target::Surface(_) => {
            format!("99 % of the surface within {} of {} wanted", four(t.reached), four(t.bound))
        }
        Target::Lossless | Target::Labels if t.met => "no sample is changed".into(),
        Target::Lossless | Target::Labels => format!("samples are changed by at most {}", four(t.reached)),
        Target::Size(_) | Target::Ratio(_) => {
            let [reached, bound] = [t.reached, t.bound].map(|b| text::bytes(b as u64));
            format!("{reached} of {bound} wanted")
        }
    }
}

fn target_line(t: &TargetReport) -> String {
    let (met, what) = (if t.met { "met" } else { "NOT MET" }, reached_text(t));
    let [meshed, chunks] = t.meshed_chunks;
    let reused = match meshed < chunks {
        true => format!(" ({} of their {} chunks meshed)", text::count(meshed), text::count(chunks)),
        false => String::new(),
    };
    let full = t.full_cells.map_or(String::new(), |cells| {
        let [full, all] = cells.map(text::count);
        format!("; {full} of {all} cells have a point a sample")
    });
    let tries = match t.tries {
        // The archive was made before.
        0 => String::new(),
        n => format!(", after {}{reused}", if n == 1 { "1 try".to_owned() } else { format!("{n} tries") }),
    };
    format!("  target      {met}: {what}{tries}{full}")
}

/// The error of the one step, or the largest of several.
fn error_line(report: &ReduceReport) -> Option<String> {
    if report.steps.len() < 2 {
        return report.error.as_ref().map(super::measure::line);
    }
    if report.of_fields {
        return error_lines(report);
    }
    let largest = |which: fn([f64; 2]) -> f64| {
        let errors = report.steps.iter().filter_map(|s| Some((which(s.error?), s.number)));
        // The first of equal ones.
        errors.reduce(|a, b| if b.0 > a.0 { b } else { a })
    };
    let (rms, max) = (largest(|[rms, _]| rms)?, largest(|[_, max]| max)?);
    let ranges = report.steps.iter().filter_map(|s| s.range);
    let range = ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    let [of_rms, of_max] =
        [rms.0, max.0].map(|v| text::value(text::figures(v, 4)) + &text::share_of(v, range));
    let error = format!("RMS at most {of_rms} in step {}, at most {of_max} in step {}", rms.1, max.1);
    Some(format!("  error       {error}; % of the range of all steps"))
}

/// The largest errors of each of several fields.
fn error_lines(report: &ReduceReport) -> Option<String> {
    let mut names: Vec<&str> = vec![];
    for step in &report.steps {
        if !names.contains(&&*step.field) {
            names.push(&step.field);
        }
    }
    let line = |name: &&str| {
        let steps = || report.steps.iter().filter(|s| s.field == *name);
        let largest = |which: usize| steps().filter_map(|s| s.error).map(|e| e[which]).reduce(f64::max);
        let range = steps().filter_map(|s| s.range).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        let [rms, max] =
            [largest(0)?, largest(1)?].map(|v| text::value(text::figures(v, 4)) + &text::share_of(v, range));
        Some(format!("  error       RMS at most {rms}, at most {max}: {}", text::name(name)))
    };
    let lines: Vec<String> = names.iter().filter_map(line).collect();
    Some(lines.join("\n")).filter(|lines| !lines.is_empty())
}

/// How much smaller the archive is than its source, and the bits of both.
fn size_line(report: &ReduceReport, source: u64) -> String {
    let samples = report.samples * report.steps.len().max(1) as u64;
    let what = if report.mesh.is_some() { "vertex" } else { "sample" };
    text::ratio_line(report.archive_bytes, source, samples, what)
}

/// A step that was added: its number, what it is of, and what it takes.
fn added_line(step: &StepSummary) -> String {
    let time = step.time.map_or(String::new(), |time| format!(" (time {})", text::number(time)));
    format!(
        "  added       step {}{time}: {}: {}, {}\n",
        text::count(step.number),
        text::name(&step.source),
        text::name(&step.field),
        text::bytes(step.value_bytes + step.index_bytes)
    )
}

/// Whether samples are kept as labels.
fn has_labels(report: &ReduceReport) -> bool {
    report.target.is_some_and(|target| target.target == Target::Labels)
}

/// A report in words; `is_added`: of steps that were added to an archive.
fn in_words(archive: &Path, report: &ReduceReport, is_added: bool) -> String {
    let mut out = format!("{}\n", archive.display());
    out += &points_text(report);
    out += &values_text(report);
    out += &steps_text(report, is_added);
    let per_point = report.archive_bytes as f64 / report.points.max(1) as f64;
    let _ =
        writeln!(out, "  archive     {} ({per_point:.2} bytes a point)", text::bytes(report.archive_bytes));
    if let Some(source) = report.source_bytes {
        let _ = writeln!(out, "{}", size_line(report, source));
    }
    out += &time_line(&report.seconds);
    out += &surface_lines(archive, &report.surfaces, report.steps.len() > 1);
    out + &next_line(archive, report.surfaces.first().map(|found| found.isovalue))
}

/// How many points there are, and what lies between them.
fn points_text(report: &ReduceReport) -> String {
    let mut out = String::new();
    // Steps of a mesh may have holes of their own; then only the archive's points can be reported.
    let of_mesh = report.mesh.is_some() && report.steps.len() == 1;
    let points = report.points - if of_mesh { report.void_points } else { 0 };
    let of_what = if report.mesh.is_some() { "vertices" } else { "samples" };
    let added = match &report.mesh {
        Some(mesh) if report.own && mesh.added > 0 => format!(" and {} added", text::count(mesh.added)),
        _ => String::new(),
    };
    let of = text::count(report.samples);
    let _ = writeln!(out, "  points      {} of {of} {of_what}{added}", text::count(points));
    let chunks = text::plural(report.chunks, "chunk");
    let _ = match report.tetrahedra {
        0 if has_labels(report) => writeln!(out, "  labels      of all samples, in {chunks}"),
        0 => writeln!(out, "  pyramid     of all samples, in {chunks}"),
        count => writeln!(out, "  tetrahedra  {} in {chunks}", text::count(count)),
    };
    if let Some(cells) = report.grid_cells {
        let _ = writeln!(out, "{}", text::grid_cells(&cells));
    }
    if let Some(mesh) = report.mesh {
        let kept = if report.own { "; kept as it is" } else { "" };
        let _ = writeln!(out, "{}{kept}", text::mesh_census(&mesh));
    }
    if report.void_points > 0 {
        let all = if report.steps.len() > 1 { ", of all steps together" } else { "" };
        let _ =
            writeln!(out, "  void        {} without a value{all}", text::plural(report.void_points, "point"));
    }
    out
}

/// The values: their range, how they are stored, their errors.
fn values_text(report: &ReduceReport) -> String {
    let mut out = String::new();
    if let Some(range) = report.range.filter(|_| !report.of_fields) {
        let _ = writeln!(out, "  range       {}", text::range(range));
    }
    if let Some(q) = &report.quantiser {
        let bound = text::value(text::figures(q.bound, 4));
        let _ = writeln!(out, "  values      {} bits, within {bound}", text::figures(q.bits, 3));
    }
    out += &text::rounding(report.steps.iter().filter_map(|s| s.rounding).reduce(f64::max));
    if let Some(line) = error_line(report) {
        let _ = writeln!(out, "{line}");
    }
    if let Some(error) = &report.against {
        let _ = writeln!(out, "{}", super::measure::line(error).replacen("error  ", "against", 1));
    }
    if let Some(t) = &report.target {
        let _ = writeln!(out, "{}", target_line(t));
    }
    out
}

/// The steps that were made, replaced, or left out.
fn steps_text(report: &ReduceReport, is_added: bool) -> String {
    let mut out = String::new();
    if is_added {
        report.steps.iter().for_each(|step| out += &added_line(step));
    }
    if !report.replaced.is_empty() {
        let numbers: Vec<String> = report.replaced.iter().map(|n| text::count(*n)).collect();
        let what = if numbers.len() == 1 { "step" } else { "steps" };
        let _ = writeln!(out, "  replaced    {what} {}", numbers.join(", "));
    }
    if report.steps.is_empty() {
        let _ = writeln!(out, "  steps       none added: the archive has these already");
    } else if report.made_before {
        let _ = writeln!(out, "  state       finished before: there was nothing left to make");
    } else if !is_added && report.steps.len() + report.skipped.len() > 1 {
        let bytes = report.steps.iter().map(|s| s.value_bytes + s.index_bytes).sum::<u64>();
        let each = bytes / report.steps.len().max(1) as u64;
        let numbers = [report.steps.first(), report.steps.last()].map(|s| s.map_or(0, |s| s.number));
        let count = report.steps.len();
        let _ = writeln!(
            out,
            "  steps       {count}, {} to {}, {} each",
            numbers[0],
            numbers[1],
            text::bytes(each)
        );
    }
    for step in &report.skipped {
        let _ = writeln!(out, "  left out    step {}: {}", step.number, step.reason);
    }
    out
}

/// How wrong each surface is that was measured.
pub(super) fn surface_lines(archive: &Path, surfaces: &[SurfaceErrors], is_series: bool) -> String {
    if surfaces.is_empty() {
        return String::new();
    }
    let archive = Archive::open(archive).ok();
    let units = archive.as_ref().map(|archive| archive.units().clone()).unwrap_or_default();
    let of_step = |step: u64| if is_series { format!(" in step {step}") } else { String::new() };
    let text = |found: &SurfaceErrors| super::measure::surface_text(found, &units, &of_step(found.step));
    surfaces.iter().map(text).collect()
}

/// The time of the run, and what its threads worked on: several at a time, so that their times add
/// up to more.
fn time_line(seconds: &[(Stage, f64)]) -> String {
    let text_of = |s: f64| text::duration(Duration::from_secs_f64(s));
    let total: f64 = seconds.iter().filter(|(stage, _)| *stage == Stage::Total).map(|(_, s)| s).sum();
    let parts = seconds.iter().filter(|(stage, s)| *stage != Stage::Total && *s >= 0.005);
    let parts: Vec<String> = parts.map(|(stage, s)| format!("{stage} {}", text_of(*s))).collect();
    let parts =
        if parts.is_empty() { String::new() } else { format!("; threads together: {}", parts.join(", ")) };
    format!("  time        {}{parts}\n", text_of(total))
}

/// What can be done with an archive: the surface that was asked about, or is most worth a look.
fn next_line(archive: &Path, asked: Option<f64>) -> String {
    let name = text::shell(archive);
    let found = Archive::open(archive).and_then(|archive| archive.info()).ok();
    let isovalue = |s: &ArchiveSummary| asked.or_else(|| Some(s.suggestions.first()?.isovalue));
    let has_labels = found.as_ref().is_some_and(|s| matches!(s.point_set, PointSpec::Labels { .. }));
    let most = found.and_then(|s| Some((isovalue(&s)?, s.range?)));
    match (most, archive.file_stem()) {
        (_, Some(stem)) if has_labels => {
            let file = text::shell(&Path::new(stem).with_extension("glb"));
            format!("next: isospan surface {name} --labels all -o {file}\n")
        }
        (Some((isovalue, range)), Some(stem)) => {
            let file = text::shell(&Path::new(stem).with_extension("ply"));
            format!("next: isospan surface {name} --isovalue {} -o {file}\n", text::in_range(isovalue, range))
        }
        _ => format!("next: isospan info {name}\n"),
    }
}
