//! `isospan surface`: isosurfaces from an archive, and surfaces of labels.

mod labels;

use super::grammar::{self, Value};
use super::labels::LabelArgs;
use super::level::LevelArgs;
use super::machine::{Machine, OutputScratch};
use super::output::Force;
use super::progress::Talk;
use super::step::{StepArgs, colour_fields};
use super::text;
use clap::ValueEnum;
use isospan::bytes::remote::Traffic;
use isospan::formats::surface::{Compression, SurfaceFormat};
use isospan::pipeline::{
    ColourBy, Length, OneSurface, Opening, Refine, Roi, SeriesReport, StepRange, SurfaceReport,
};
use isospan::render::ColourMap;
use isospan::surface::edit::{
    components::{ComponentFilter, ComponentReport},
    decimate::Decimation,
};
use isospan::volume::units::Unit;
use isospan::{Archive, Error, Result, Step, SurfaceQuery};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{IsTerminal, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Extract isosurfaces from an archive, or the surfaces of labels.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan surface scan.isospan --isovalue 600 -o bone.ply\n  isospan surface run.isospan -i 0.5 --all-steps -o front_%04d.vtp\n  isospan surface scan.isospan -i 600 --triangles 100000 -o look.glb\n  isospan surface atlas.isospan --labels 3,7 --smooth -o organs.glb",
    mut_arg("labels", |arg| arg.conflicts_with_all(labels::OTHERS).help(labels::HELP))
)]
pub struct Args {
    /// The archive: a folder, or its address, s3://... or https://...
    pub archive: PathBuf,
    /// One isovalue, or several: 600,1000. All are extracted in one pass. 50% is half-way from the
    /// least value of the step to its largest; of several steps, of their values together.
    #[arg(
        long,
        short = 'i',
        value_name = "VALUE[,VALUE..]",
        value_delimiter = ',',
        required_unless_present = "labels",
        allow_hyphen_values = true,
        value_parser = grammar::value
    )]
    isovalue: Vec<Value>,
    /// The file to write: .ply .stl .obj .vtp .vtkhdf .glb or .3mf; "-" for standard output; or a
    /// folder .precomputed of meshes for neuroglancer. Several isovalues go to one file; an array
    /// 'isovalue' of the points (.vtp, .vtkhdf, .ply), groups (.obj), nodes (.glb), objects (.3mf)
    /// or segments (.precomputed) distinguish them, and .stl does not. With {} in the name, each
    /// isovalue gets its own file: surface_{}.ply. Coordinates are those of the world, and files
    /// name their unit where it is known. Then .glb is in metres with y up, as its viewers expect;
    /// without a unit it has coordinates as they are, and .3mf is read as mm. A .precomputed is in
    /// nanometres and needs the unit. Far from 0, .stl has coordinates less a place that is
    /// printed.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// The format [default: as the file's name ends; ply for standard output].
    #[arg(long, value_enum)]
    format: Option<FormatArg>,
    /// A .glb of fewer bytes. Without HOW or with 'quantized', of about half: positions of 16
    /// bits, normals of 8 (KHR_mesh_quantization). Positions are off by at most 1/131070 of the
    /// longest edge of the surface's box. With 'meshopt', of about a quarter: the same numbers and
    /// indices, coded (EXT_meshopt_compression), which web viewers read and few other programs. A
    /// .3mf is always compressed.
    #[arg(long, value_name = "HOW", num_args = 0..=1, require_equals = true, default_missing_value = "quantized", value_enum)]
    compress: Option<Compress>,
    /// Cut the surface at a box: I0:I1,J0:J1,K0:K1 in sample indices, or world:X0:X1,Y0:Y1,Z0:Z1.
    /// An omitted end is that of the volume. Only chunks that touch the box are read.
    #[arg(long, value_name = "BOX", allow_hyphen_values = true, value_parser = grammar::region)]
    roi: Option<Roi>,
    /// Close the surfaces at the faces of the domain. Of a mesh, this needs one that fills its
    /// box.
    #[arg(long, conflicts_with = "roi")]
    cap: bool,
    /// Keep the N largest connected components (by triangles); without N, the largest.
    #[arg(help_heading = "Components and decimation", long, value_name = "N", num_args = 0..=1, default_missing_value = "1", value_parser = grammar::natural, allow_negative_numbers = true)]
    largest: Option<u64>,
    /// Keep connected components with at least N triangles.
    #[arg(help_heading = "Components and decimation", long, value_name = "N", value_parser = grammar::whole::<u64>, allow_negative_numbers = true)]
    min_triangles: Option<u64>,
    /// Keep connected components of at least this volume: 5mm3, or 5 in world units. For an open
    /// component, the volume between it and the centre of its bounding box counts.
    #[arg(help_heading = "Components and decimation", long, value_name = "VOLUME", value_parser = grammar::volume, allow_hyphen_values = true)]
    min_volume: Option<grammar::Volume>,
    /// Measure the connected components. The ten largest are listed; --json lists up to 1000.
    #[arg(help_heading = "Components and decimation", long)]
    components: bool,
    /// Smooth the surface: each vertex moves N times towards its neighbours and back (Taubin), and
    /// no farther than --smooth-limit from where it was. Steps of voxels go. The volume stays but
    /// for 1 or 2 % of pieces that are few voxels wide; isospan check tells it.
    /// Boundaries stay, and caps stay in their planes. Without N, 20 times. Of labels, without N 10
    /// times and at most 64: vertices stay in their cells, walls common, and volumes within 1 % for
    /// compact labels of a thousand voxels and more; small ones and thin sheets change more.
    #[arg(help_heading = "Smoothing", long, value_name = "N", num_args = 0..=1, value_parser = grammar::whole::<u32>, allow_negative_numbers = true)]
    smooth: Option<Option<u32>>,
    /// How far --smooth may move a vertex: 0.2mm, in world units, or N% of the domain's diagonal
    /// [default: half of the shortest edge of a voxel].
    #[arg(help_heading = "Smoothing", long, value_name = "LENGTH", requires = "smooth", value_parser = grammar::length, allow_hyphen_values = true)]
    smooth_limit: Option<Length>,
    /// Keep this share of the triangles: 10%, 1/10 or 0.1. Topology and boundaries are preserved.
    #[arg(help_heading = "Components and decimation", long, value_name = "SHARE", value_parser = grammar::share, allow_hyphen_values = true)]
    decimate: Option<f64>,
    /// Decimate until the estimated distance from the original surface reaches LENGTH: 0.2mm, in
    /// world units, or N% of the domain's diagonal. The estimate is no bound; isospan compare
    /// measures the distance. With --decimate, stop at whichever comes first.
    #[arg(help_heading = "Components and decimation", long, value_name = "LENGTH", value_parser = grammar::length, allow_hyphen_values = true)]
    decimate_error: Option<Length>,
    /// Give the vertices the values of another field, with colours: a field of this archive (see
    /// reduce --fields), or another archive in the same world. Not in .stl files.
    #[arg(help_heading = "Colours", long, visible_alias = "color-by", value_name = "FIELD|ARCHIVE", conflicts_with_all = ["all_steps", "steps"])]
    colour_by: Option<PathBuf>,
    /// The colour map: viridis, cividis, coolwarm or grey. VTP and VTKHDF files have values alone.
    #[arg(help_heading = "Colours", long, visible_alias = "color-map", value_name = "MAP", default_value = "viridis", allow_hyphen_values = true, value_parser = grammar::colour_map, requires = "colour_by")]
    colour_map: ColourMap,
    /// The values at the ends of the colour map [default: those of the whole field].
    #[arg(help_heading = "Colours", long, visible_alias = "color-range", value_name = "LO:HI", value_parser = grammar::range, allow_hyphen_values = true, requires = "colour_by")]
    colour_range: Option<grammar::Range>,
    #[command(flatten)]
    labels: LabelArgs,
    #[command(flatten)]
    level: LevelArgs,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: OutputScratch,
    #[command(flatten)]
    step: StepArgs,
    /// Extract all steps, one file each: out_%04d.ply, with the step number in the name. A list of
    /// files and times is written next to them: out.ply.series, or out.pvd for .vtp. With --force,
    /// a list that is there goes on naming its other files. A .vtkhdf without a number in its name
    /// has all steps. Steps whose values do not reach the isovalue are not read.
    #[arg(help_heading = "Series", long, conflicts_with_all = ["step", "time", "steps"])]
    all_steps: bool,
    /// As --all-steps, for the steps from one number to another; either end may be omitted.
    #[arg(help_heading = "Series", long, value_name = "FIRST:LAST", value_parser = grammar::steps, conflicts_with_all = ["step", "time"], allow_hyphen_values = true)]
    steps: Option<StepRange>,
    /// Print points, tetrahedra, active blocks, bytes read and the time of each stage.
    #[arg(long)]
    stats: bool,
    #[command(flatten)]
    force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// How often a surface is smoothed, and that of labels, unless it is said.
const SMOOTHED: u32 = 20;
const LABELS_SMOOTHED: u32 = 10;

/// The name of standard output.
const STANDARD_OUTPUT: &str = "-";

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    Ply,
    Stl,
    Obj,
    Vtp,
    Vtkhdf,
    Glb,
    #[value(name = "3mf")]
    ThreeMf,
    Precomputed,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Compress {
    Quantized,
    Meshopt,
}

impl From<FormatArg> for SurfaceFormat {
    fn from(format: FormatArg) -> Self {
        match format {
            FormatArg::Ply => Self::Ply,
            FormatArg::Stl => Self::Stl,
            FormatArg::Obj => Self::Obj,
            FormatArg::Vtp => Self::Vtp,
            FormatArg::Vtkhdf => Self::VtkHdf,
            FormatArg::Glb => Self::Glb,
            FormatArg::ThreeMf => Self::ThreeMf,
            FormatArg::Precomputed => Self::Neuroglancer,
        }
    }
}

impl Args {
    fn is_to_standard_output(&self) -> bool {
        self.output == Path::new(STANDARD_OUTPUT)
    }

    /// What is written.
    fn format(&self) -> Result<SurfaceFormat> {
        match self.format {
            Some(FormatArg::Precomputed) if self.is_to_standard_output() => Err(Error::usage(
                "meshes of neuroglancer are a folder: give -o a name such as meshes.precomputed in place of -",
            )),
            Some(format) => Ok(format.into()),
            None if self.is_to_standard_output() => Ok(SurfaceFormat::default()),
            None => SurfaceFormat::from_path(&self.output),
        }
    }
}

impl Args {
    /// How a GLB is made small.
    fn compression(&self) -> Compression {
        match self.compress {
            None => Compression::None,
            Some(Compress::Quantized) => Compression::Quantized,
            Some(Compress::Meshopt) => Compression::Meshopt,
        }
    }

    /// Refuses what may not be written, before work.
    fn check_outputs(&self, files: &[PathBuf], format: SurfaceFormat) -> Result<()> {
        if format.is_folder() {
            return files.iter().try_for_each(|folder| self.force.check_folder(folder, [&self.archive]));
        }
        self.force.check_all(files, &[&self.archive])
    }
}

fn refine(args: &Args, archive: &Archive) -> Result<Refine> {
    let wanted = args.components
        || args.largest.is_some()
        || args.min_triangles.is_some()
        || args.min_volume.is_some();
    let all = ComponentFilter::default();
    let unit = &archive.units().length;
    let min_volume = args.min_volume.map(|volume| volume.in_world(unit.as_ref())).transpose()?;
    let components = wanted.then(|| ComponentFilter {
        largest: args.largest,
        min_triangles: args.min_triangles.unwrap_or(all.min_triangles),
        min_volume: min_volume.unwrap_or(all.min_volume),
    });
    let wanted = args.decimate.is_some() || args.decimate_error.is_some();
    let far = Decimation::default();
    let max_error = args.decimate_error.map(|length| in_world(length, archive)).transpose()?;
    let decimate = wanted.then(|| Decimation {
        ratio: args.decimate.unwrap_or(far.ratio),
        max_error: max_error.unwrap_or(far.max_error),
    });
    let smooth_limit = args.smooth_limit.map(|length| in_world(length, archive)).transpose()?;
    let smooth = args.smooth.map(|times| times.unwrap_or(SMOOTHED));
    Ok(Refine { components, smooth, smooth_limit, decimate })
}

/// The field that colours the surface.
fn colours(args: &Args, archive: &Archive) -> Result<Option<ColourBy>> {
    let Some(by) = &args.colour_by else { return Ok(None) };
    let field = colour_fields(by, archive, [args.step.choice()?])?.swap_remove(0);
    let mut colours = field.colours(args.colour_map);
    colours.range = args.colour_range.map(|asked| asked.within(field.value_range())).transpose()?;
    Ok(Some(colours))
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let format = args.format()?;
    // One question is asked: no block is cached for a next one.
    let archive = Archive::open(&args.archive)?.keeping(0).in_field(args.step.field());
    if args.labels.are_given() {
        return labels::run(args, &archive, format, talk);
    }
    let steps = args.steps.or(args.all_steps.then(StepRange::default));
    let isovalues = isovalues(args, &archive, steps)?;
    let question = Question { args, archive: &archive, format, talk };
    match steps {
        None => question.of_step(&isovalues),
        Some(_) if args.is_to_standard_output() => Err(Error::usage(
            "several steps are several files: give -o a name such as out_%04d.ply in place of -",
        )),
        Some(steps) => question.of_steps(steps, &isovalues),
    }
}

/// What is asked, and of which archive.
struct Question<'a> {
    args: &'a Args,
    archive: &'a Archive,
    format: SurfaceFormat,
    talk: &'a Talk,
}

impl Question<'_> {
    /// A query as the arguments say.
    fn ask<'q, Of>(&self, query: SurfaceQuery<'q, Of>) -> Result<SurfaceQuery<'q, Of>> {
        let Self { args, archive, .. } = *self;
        let query = query.region(args.roi).cap(args.cap).level(args.level.choice()).format(self.format);
        let query = query.compress(args.compression());
        let query = query.refine(refine(args, archive)?).colour_by(colours(args, archive)?);
        Ok(query.resources(args.machine.resources(args.scratch.scratch.clone(), self.talk)))
    }

    /// Writes the surfaces of many steps.
    fn of_steps(&self, steps: StepRange, isovalues: &[f64]) -> Result<()> {
        let Self { args, talk, .. } = *self;
        let query = self.ask(self.archive.steps(steps)?.query(isovalues))?;
        let files = query.files(&args.output)?;
        args.check_outputs(&files, self.format)?;
        self.note_what_is_lost(isovalues.len(), files.len());
        let bar = talk.progress();
        let report = query.progress(&*bar).write(&args.output);
        bar.end();
        let report = report?;
        if args.json {
            super::print_json("surface.series", &report)?;
        } else {
            super::print(&series_text(&report, args.stats))?;
        }
        expect_area(&args.output, report.steps.iter().map(|s| &s.report))
    }

    /// Writes the surfaces of one step.
    fn of_step(&self, isovalues: &[f64]) -> Result<()> {
        let Self { args, archive, talk, .. } = *self;
        let step = archive.at(args.step.choice()?)?;
        let query = self.ask(step.query(isovalues))?;
        if args.is_to_standard_output() {
            return self.to_standard_output(&step, query);
        }
        let files = query.files(&args.output);
        args.check_outputs(&files, self.format)?;
        expect_more_than_nothing(args, &step, isovalues, &files)?;
        self.note_what_is_lost(isovalues.len(), files.len());
        let bar = talk.progress();
        let report = query.progress(&*bar).write(&args.output);
        bar.end();
        let report = with_opening(report?, archive.opening());
        talk.stages(&report.seconds);
        if args.json {
            super::print_json("surface", &report)?;
        } else {
            super::print(&in_words(&report, step.units().length.as_ref(), args.stats))?;
        }
        // Samples that are equal are told by the finest level, which a coarse question does not
        // read.
        if report.level.is_none_or(|level| level == 0) {
            note_plateaus(&step, isovalues, talk)?;
        }
        expect_area(&args.output, [&report])
    }

    /// Writes a surface to standard output, by way of a file in the scratch folder, so that it
    /// comes whole or not at all. What was made is reported on standard error.
    fn to_standard_output(&self, step: &Step, query: SurfaceQuery<'_>) -> Result<()> {
        let Self { args, archive, talk, .. } = *self;
        expect_open_output(args)?;
        let scratch = args.scratch.scratch.clone().unwrap_or_else(std::env::temp_dir);
        let folder = tempfile::tempdir_in(&scratch)
            .map_err(|e| Error::io("make a temporary folder in", &scratch, e))?;
        let (file, isovalues) = (folder.path().join("surface"), query.isovalues().to_vec());
        let bar = talk.progress();
        let report = query.progress(&*bar).write(&file);
        bar.end();
        let mut report = with_opening(report?, archive.opening());
        talk.stages(&report.seconds);
        let mut bytes = File::open(&file).map_err(|e| Error::io("open", &file, e))?;
        let mut out = std::io::stdout().lock();
        std::io::copy(&mut bytes, &mut out)
            .and_then(|_| out.flush())
            .map_err(|e| Error::io("write the whole surface to", "standard output", not_wanted(e)))?;
        report.surfaces.iter_mut().for_each(|s| s.file = "standard output".into());
        in_words(&report, step.units().length.as_ref(), args.stats).lines().for_each(|line| talk.note(line));
        note_plateaus(step, &isovalues, talk)?;
        expect_area("standard output".as_ref(), [&report])
    }

    /// Says what a format has no place for.
    fn note_what_is_lost(&self, isovalues: usize, files: usize) {
        if isovalues > 1 && files == 1 && !self.format.has_parts() {
            self.talk.note(&format!(
                "warning: STL does not keep isovalues apart: the {isovalues} surfaces become one;                  -o NAME_{{}} gives each a file"
            ));
        }
    }
}

/// Refuses a standard output that a surface cannot be written to.
fn expect_open_output(args: &Args) -> Result<()> {
    let refuse = |why: &str| Err(Error::usage(why));
    if args.json {
        return refuse("--json and -o - both write to standard output: give -o the name of a file");
    }
    if is_closed(std::io::stdout()) {
        return refuse("standard output is closed: redirect it, or give -o the name of a file");
    }
    if std::io::stdout().is_terminal() {
        return refuse("standard output is a terminal: redirect it, or give -o the name of a file");
    }
    Ok(())
}

/// Refuses surfaces that `isospan check` would refuse: the files are there, and are not sound.
fn expect_area<'a>(
    output: &Path,
    reports: impl IntoIterator<Item = &'a SurfaceReport> + Clone,
) -> Result<()> {
    let sum = |of: fn(&SurfaceReport) -> u64| reports.clone().into_iter().map(of).sum::<u64>();
    let (without, all) = (sum(|r| r.without_area), sum(|r| r.triangles));
    if without == 0 {
        return Ok(());
    }
    let got =
        format!("{} of {} without, for f32 rounds their corners", text::count(without), text::count(all));
    Err(Error::bad_input(output, "surface", "triangles that have an area", got)
        .with_help("the file is as good as f32 allows: reduce with fewer points, or decimate it"))
}

/// Refuses to replace a file by an empty surface.
fn expect_more_than_nothing(args: &Args, step: &Step, asked: &[f64], files: &[PathBuf]) -> Result<()> {
    let there: Vec<bool> = files.iter().map(|file| file.exists()).collect();
    if !there.contains(&true) {
        return Ok(());
    }
    let range = step.value_range();
    let cuts = |v: f64| range.is_some_and(|[lo, hi]| v <= hi && (v > lo || args.cap));
    let each_alone = files.len() == asked.len();
    for (n, (file, is_there)) in files.iter().zip(there).enumerate() {
        let isovalues = if each_alone { &asked[n..=n] } else { asked };
        if is_there && !isovalues.iter().any(|&v| cuts(v)) {
            let range =
                range.map_or("no point has a value".into(), |r| format!("values are {}", text::range(r)));
            return Err(Error::usage(format!(
                "{} stays as it is: no surface has the isovalue {}; {range}",
                file.display(),
                isovalues[0]
            )));
        }
    }
    Ok(())
}

/// Says which isovalues lie where many samples are equal: what the archive lost makes their
/// surfaces.
fn note_plateaus(step: &Step, isovalues: &[f64], talk: &Talk) -> Result<()> {
    for &isovalue in isovalues {
        let Some(found) = step.plateau(isovalue)? else { continue };
        let (percent, error) = (100.0 * found.share, text::number(2.0 * found.error));
        let beside = found
            .between
            .map_or_else(|| "ask for a value beside it".to_owned(), |between| format!("ask for {between}"));
        talk.note(&format!(
            "warning: {percent:.0} % of the samples around the surface of {isovalue} are within {error} of it, \
             which is what the archive keeps apart: {beside}, or reduce with a smaller error or --lossless"
        ));
    }
    Ok(())
}

/// A length in world units.
fn in_world(length: Length, archive: &Archive) -> Result<f64> {
    let diagonal = match length {
        Length::OfDiagonal(_) if archive.info()?.grid_cells.is_none() => {
            Some(archive.geometry().diagonal(archive.dims()))
        }
        _ => None,
    };
    length.in_world(archive.units().length.as_ref(), diagonal)
}

/// The isovalues; percentages refer to the step or to all steps together.
fn isovalues(args: &Args, archive: &Archive, steps: Option<StepRange>) -> Result<Vec<f64>> {
    let is_share = |value: &Value| matches!(value, Value::Share(_));
    let range =
        if args.isovalue.iter().any(is_share) { args.step.value_range(archive, steps)? } else { None };
    args.isovalue.iter().map(|value| value.of(range)).collect()
}

fn in_words(report: &SurfaceReport, length: Option<&Unit>, stats: bool) -> String {
    let stats = if stats { stats_text(report) } else { String::new() };
    surfaces_text(report, length) + &stats
}

/// The error of a reader that has closed its end: of a report it is none, of a surface it is one.
fn not_wanted(error: std::io::Error) -> std::io::Error {
    match error.kind() {
        std::io::ErrorKind::BrokenPipe => std::io::Error::other("its reader has closed it"),
        _ => error,
    }
}

/// Whether a process was started with a file closed: the system's null device stands in for it
/// then, open for reading too.
#[cfg(unix)]
fn is_closed(file: impl std::os::fd::AsFd) -> bool {
    let (Ok(about), Ok(null)) = (rustix::fs::fstat(&file), rustix::fs::stat("/dev/null")) else {
        return false;
    };
    let is_null = about.st_rdev == null.st_rdev && about.st_mode == null.st_mode;
    is_null && rustix::fs::fcntl_getfl(&file).is_ok_and(|flags| flags.contains(rustix::fs::OFlags::RDWR))
}

#[cfg(not(unix))]
fn is_closed(_: impl Sized) -> bool {
    false
}

/// The report of the whole command, in which opening the archive is part of the first stage.
fn with_opening(mut report: SurfaceReport, opening: Opening) -> SurfaceReport {
    report.bytes_read += opening.bytes_read;
    report.seconds[0].1 += opening.seconds;
    add_traffic(&mut report.remote, opening);
    report
}

/// Adds what opening the archive has fetched.
fn add_traffic(sum: &mut Option<Traffic>, opening: Opening) {
    if let (Some(sum), Some(opening)) = (sum, opening.remote) {
        sum.requests += opening.requests;
        sum.bytes += opening.bytes;
    }
}

/// A line for each step, and the lists.
fn series_text(report: &SeriesReport, stats: bool) -> String {
    let mut out = String::new();
    for s in &report.steps {
        let names: Vec<String> = s.report.surfaces.iter().map(|s| s.file.display().to_string()).collect();
        let mut names = names;
        names.dedup();
        let (triangles, size) = (text::count(s.report.triangles), text::bytes(s.report.file_bytes));
        let level = s.report.level.filter(|level| *level > 0);
        let level = level.map_or_else(String::new, |level| format!(", level {level}"));
        let skipped = if s.skipped { ", not read: no value reaches the isovalue" } else { "" };
        let size = if report.file_bytes.is_some() { String::new() } else { format!(", {size}") };
        let _ = writeln!(
            out,
            "step {} (time {}): {}: {triangles} triangles{size}{level}{skipped}",
            s.step,
            text::number(s.time),
            names.join(" ")
        );
    }
    if let Some(shifted) = report.steps.iter().find(|s| s.report.shift.is_some()) {
        out += &shift_text(shifted.report.shift);
    }
    if let Some(size) = report.file_bytes {
        let _ = writeln!(out, "  all steps     {}", text::bytes(size));
    }
    for list in &report.lists {
        let _ = writeln!(out, "{}", list.display());
    }
    if report.listed_before > 0 {
        let files = text::plural(report.listed_before, "file");
        let _ = writeln!(out, "  listed too    {files} of earlier runs; remove the list to begin anew");
    }
    if stats {
        let sum = |of: fn(&SurfaceReport) -> u64| report.steps.iter().map(|s| of(&s.report)).sum::<u64>();
        let _ = writeln!(
            out,
            "  steps         {} of {} read",
            report.steps.len() as u64 - report.skipped,
            report.steps.len()
        );
        let [read, active] = [sum(|r| r.bytes_read), sum(|r| r.active_bytes)].map(text::bytes);
        let _ = writeln!(
            out,
            "  bytes read    {read}, of blocks and values that hold an active tetrahedron {active}"
        );
        let seconds = report.steps.iter().flat_map(|s| &s.report.seconds).map(|(_, s)| s).sum::<f64>();
        let _ = writeln!(out, "  time          {}", text::duration(Duration::from_secs_f64(seconds)));
    }
    out
}

/// A line for each surface, and why it is empty where it must be.
fn surfaces_text(report: &SurfaceReport, length: Option<&Unit>) -> String {
    let mut out = String::new();
    for surface in &report.surfaces {
        let name = match report.surfaces.len() {
            1 => surface.file.display().to_string(),
            _ => format!("{}: isovalue {}", surface.file.display(), surface.isovalue),
        };
        let _ = write!(
            out,
            "{name}: {} vertices, {}",
            text::count(surface.vertices),
            text::plural(surface.triangles, "triangle")
        );
        let _ = match report.surfaces.len() {
            1 => writeln!(out, ", {}", text::bytes(report.file_bytes)),
            _ => writeln!(out),
        };
        out += &refined_text(surface, length);
        if surface.outside_range && surface.triangles == 0 {
            let range = report
                .range
                .map_or("no values at all".to_owned(), |range| format!("the range {}", text::range(range)));
            let _ = writeln!(
                out,
                "  the isovalue {} does not cut {range}: the surface is empty",
                surface.isovalue
            );
        }
    }
    if report.surfaces.len() > 1 {
        let _ = writeln!(
            out,
            "{} surfaces: {} triangles, {}",
            report.surfaces.len(),
            text::count(report.triangles),
            text::bytes(report.file_bytes)
        );
    }
    if let Some(level) = report.level.filter(|level| *level > 0) {
        let _ = writeln!(out, "  level         {level}");
    }
    out += &shift_text(report.shift);
    if let Some(without) = report.without_value.filter(|&n| n > 0) {
        let (without, all) = (text::count(without), text::count(report.vertices));
        let _ = writeln!(out, "  colours       {without} of {all} vertices have no value, and are grey");
    }
    out
}

/// What coordinates in the file are less, where they are.
fn shift_text(shift: Option<[f64; 3]>) -> String {
    shift.map_or_else(String::new, |[x, y, z]| {
        format!(
            "  coordinates   are less {x} {y} {z}, for f32 does not tell them apart; .vtp .vtkhdf .ply .obj have doubles\n"
        )
    })
}

/// What was done to a surface, a line each.
fn refined_text(surface: &OneSurface, length: Option<&Unit>) -> String {
    let mut out = String::new();
    let unit = length.map_or("world units", Unit::as_str);
    if let Some(c) = &surface.refined.components {
        let _ = writeln!(out, "  components    {} kept of {}", text::count(c.kept), text::count(c.found));
        out += &components_text(c, length);
    }
    if let Some(s) = &surface.refined.smoothing {
        let of = |v: f64| text::value(text::figures(v, 3));
        let _ = writeln!(
            out,
            "  smoothed      {} times; vertices moved by {} {unit} in the mean, {} at most, of {} allowed",
            s.iterations,
            of(s.mean_distance),
            of(s.max_distance),
            of(s.allowed)
        );
    }
    if let Some(d) = &surface.refined.decimation {
        let _ = writeln!(
            out,
            "  decimated     {} of {} triangles ({:.1} %) in {} {}; distance estimated at {} {unit}, which is no bound",
            text::count(d.triangles_after),
            text::count(d.triangles_before),
            100.0 * d.triangles_after as f64 / d.triangles_before.max(1) as f64,
            d.passes,
            if d.passes == 1 { "pass" } else { "passes" },
            text::value(text::figures(d.error_estimate, 3))
        );
    }
    out
}

/// The components that a table lists, at most.
const MOST_LISTED: usize = 10;

/// The largest components, a line each.
fn components_text(report: &ComponentReport, length: Option<&Unit>) -> String {
    if report.listed.is_empty() {
        return String::new();
    }
    let [area, volume] = [("area", 2), ("volume", 3)]
        .map(|(name, power)| format!("{name}{}", text::unit_to_the(power, length)));
    let mut out = format!("    {:>12} {area:>14} {volume:>14}  boundary\n", "triangles");
    for c in report.listed.iter().take(MOST_LISTED) {
        let [area, volume] = [c.area, c.volume].map(|v| text::value(text::figures(v, 4)));
        let boundary = if c.closed { "closed" } else { "open" };
        let _ = writeln!(out, "    {:>12} {area:>14} {volume:>14}  {boundary}", text::count(c.triangles));
    }
    let more = report.kept.saturating_sub(MOST_LISTED as u64);
    if more > 0 {
        let _ = writeln!(out, "    and {} more (--json lists the largest 1000)", text::count(more));
    }
    out
}

fn stats_text(report: &SurfaceReport) -> String {
    let mut out = String::new();
    let active = text::count(report.active_cells);
    let blocks = if report.tetrahedra == 0 {
        let _ = writeln!(out, "  samples       {}", text::count(report.points));
        let _ = writeln!(out, "  active        {active} cells");
        "bricks"
    } else {
        let _ = writeln!(out, "  points        {}", text::count(report.points));
        let _ = writeln!(out, "  tetrahedra    {}", text::count(report.tetrahedra));
        let _ = writeln!(out, "  active        {active} tetrahedra");
        "blocks"
    };
    let _ = writeln!(
        out,
        "  {blocks:<13} {} active of {}, in {} of {} chunks",
        text::count(report.active_blocks),
        text::count(report.blocks),
        text::count(report.active_chunks),
        text::count(report.chunks)
    );
    let _ = writeln!(
        out,
        "  bytes read    {} of {} ({:.1} %)",
        text::bytes(report.bytes_read),
        text::bytes(report.archive_bytes),
        100.0 * report.bytes_read as f64 / report.archive_bytes.max(1) as f64
    );
    if report.active_bytes > 0 {
        let _ = writeln!(
            out,
            "                {:.2} times the {} of the blocks and values that hold an active tetrahedron",
            report.bytes_read as f64 / report.active_bytes as f64,
            text::bytes(report.active_bytes)
        );
    }
    if let Some(remote) = &report.remote {
        let (requests, size) = (text::count(remote.requests), text::bytes(remote.bytes));
        let _ = writeln!(out, "  fetched       {size} in {requests} requests");
    }
    for (stage, seconds) in &report.seconds {
        let _ = writeln!(out, "  {stage:<13} {}", text::duration(Duration::from_secs_f64(*seconds)));
    }
    out
}
