//! `isospan surface --labels`: a closed mesh for each label of a label image.

use super::{Args, STANDARD_OUTPUT};
use crate::commands::grammar::{self, LabelChoice};
use crate::commands::output::exists;
use crate::commands::progress::Talk;
use crate::commands::{print, print_json, text};
use isospan::formats::labels::LabelTable;
use isospan::formats::surface::SurfaceFormat;
use isospan::pipeline::{LabelReport, Labels, Opening};
use isospan::volume::units::Unit;
use isospan::{Archive, Error, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What else a surface may be asked for, and one of labels may not.
const OTHERS: [&str; 16] = [
    "isovalue",
    "roi",
    "cap",
    "largest",
    "min_triangles",
    "min_volume",
    "smooth_limit",
    "components",
    "decimate",
    "decimate_error",
    "colour_by",
    "all_steps",
    "steps",
    "level",
    "triangles",
    "error",
];

/// Flags of labels.
#[derive(clap::Args, Debug)]
pub(super) struct LabelArgs {
    /// The surfaces of labels, in place of isovalues: 3,7, or all but 0, the background: all. The
    /// archive is one of a label image: see reduce --labels. Each label has a closed mesh, whose
    /// walls its neighbours share: .glb has a node with name and colour for each, .3mf an object,
    /// .obj a group, .precomputed a segment, .ply .vtp and .vtkhdf an array 'label' of the points;
    /// with {} in the file's name each has its own file. Without --smooth these are the faces of
    /// voxels, with their exact volume.
    #[arg(help_heading = "Labels", long, value_name = "LABEL[,LABEL..]", value_delimiter = ',', allow_hyphen_values = true, value_parser = grammar::label, conflicts_with_all = OTHERS)]
    labels: Vec<LabelChoice>,
    /// Names and colours of labels: a CSV with the header label,name,r,g,b, a label description
    /// of ITK-SNAP, or a colour table of 3D Slicer or FreeSurfer. Other labels have colours that
    /// their numbers give.
    #[arg(help_heading = "Labels", long, value_name = "FILE", requires = "labels")]
    label_table: Option<PathBuf>,
}

impl LabelArgs {
    pub(super) fn are_given(&self) -> bool {
        !self.labels.is_empty()
    }

    fn wanted(&self) -> Result<Labels> {
        let numbers = self.labels.iter().filter_map(|choice| match choice {
            LabelChoice::One(label) => Some(*label),
            LabelChoice::All => None,
        });
        let numbers: Vec<i64> = numbers.collect();
        match (numbers.len() == self.labels.len(), &numbers[..]) {
            (true, _) => Ok(Labels::Each(numbers)),
            (false, []) => Ok(Labels::All),
            (false, [0]) => Ok(Labels::AllWithBackground),
            _ => Err(Error::usage("--labels all has every label but 0: name no other than 0 beside it")),
        }
    }
}

/// Writes the surfaces of labels.
pub(super) fn run(args: &Args, archive: &Archive, format: SurfaceFormat, talk: &Talk) -> Result<()> {
    if args.output == Path::new(STANDARD_OUTPUT) {
        return Err(Error::usage("surfaces of labels are written to files: give -o a name in place of -"));
    }
    let labels = &args.labels;
    let table = labels.label_table.as_deref().map(LabelTable::read).transpose()?.unwrap_or_default();
    let step = archive.at(args.step.choice()?)?;
    let smooth = args.smooth.map_or(0, |steps| steps.unwrap_or(super::LABELS_SMOOTHED));
    let query = step.labels(labels.wanted()?).smooth(smooth).table(table).compress(args.compression());
    let query = query.format(format).resources(args.machine.resources(args.scratch.scratch.clone(), talk));
    args.check_outputs(&query.files(&args.output), format)?;
    if !args.force.is_given() {
        expect_no_file_of_a_label(&args.output)?;
    }
    let bar = talk.progress();
    let report = query.progress(&*bar).write(&args.output);
    bar.end();
    let report = with_opening(report?, archive.opening());
    talk.stages(&report.seconds);
    note_what_is_lost(&report, args, format, talk);
    if args.json {
        print_json("surface.labels", &report)?;
    } else {
        print(&in_words(&report, step.units().length.as_ref(), args.stats))?;
    }
    expect_area(&report, &args.output)
}

/// Refuses to replace a file of any label, where which labels there are is not known before.
fn expect_no_file_of_a_label(out: &Path) -> Result<()> {
    let name = out.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let Some((before, after)) = name.split_once("{}") else { return Ok(()) };
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(()) };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let label = name.to_str().and_then(|name| name.strip_prefix(before)?.strip_suffix(after));
        if label.is_some_and(|label| label.parse::<i64>().is_ok()) {
            return Err(exists(&out.with_file_name(name)));
        }
    }
    Ok(())
}

fn note_what_is_lost(report: &LabelReport, args: &Args, format: SurfaceFormat, talk: &Talk) {
    let without: Vec<String> =
        report.labels.iter().filter(|l| l.voxels == 0).map(|l| l.label.to_string()).take(10).collect();
    if !without.is_empty() {
        talk.note(&format!("warning: no voxel has the label {}", without.join(" ")));
    }
    let is_one_file = !args.output.to_string_lossy().contains("{}");
    if format == SurfaceFormat::Stl && is_one_file && report.labels.len() > 1 {
        talk.note(&format!(
            "warning: STL does not keep labels apart: the {} surfaces become one; -o NAME_{{}}.stl gives each a file",
            report.labels.len()
        ));
    }
}

/// The report of the whole command, in which opening the archive is part of the first stage.
fn with_opening(mut report: LabelReport, opening: Opening) -> LabelReport {
    report.bytes_read += opening.bytes_read;
    report.seconds[0].1 += opening.seconds;
    super::add_traffic(&mut report.remote, opening);
    report
}

/// Refuses surfaces that `isospan check` would refuse: the files are there, and are not sound.
fn expect_area(report: &LabelReport, output: &Path) -> Result<()> {
    if report.without_area == 0 {
        return Ok(());
    }
    let (without, all) = (text::count(report.without_area), text::count(report.triangles));
    let got = format!("{without} of {all} without, for f32 rounds their corners");
    Err(Error::bad_input(output, "surface", "triangles that have an area", got))
}

/// Labels that are listed, at most.
const MOST_LISTED: usize = 20;

fn in_words(report: &LabelReport, length: Option<&Unit>, stats: bool) -> String {
    let mut out = String::new();
    let of = |name: &str, power: u32| format!("{name}{}", text::unit_to_the(power, length));
    let _ = writeln!(
        out,
        "{}: {} vertices, {}, {}",
        text::plural(report.labels.len() as u64, "label"),
        text::count(report.vertices),
        text::plural(report.triangles, "triangle"),
        text::bytes(report.file_bytes)
    );
    let _ = writeln!(
        out,
        "  {:>9} {:>12} {:>12} {:>12} {:>12}  file, name",
        "label",
        "voxels",
        of("volume", 3),
        of("area", 2),
        "triangles"
    );
    for one in report.labels.iter().take(MOST_LISTED) {
        let [volume, area] = [one.volume, one.area].map(|v| text::value(text::figures(v, 5)));
        let name = if one.name.is_empty() { String::new() } else { format!(", {}", one.name) };
        let _ = writeln!(
            out,
            "  {:>9} {:>12} {volume:>12} {area:>12} {:>12}  {}{name}",
            one.label,
            text::count(one.voxels),
            text::count(one.triangles),
            one.file.display()
        );
    }
    if report.labels.len() > MOST_LISTED {
        let more = text::count((report.labels.len() - MOST_LISTED) as u64);
        let _ = writeln!(out, "  and {more} more (--json lists all)");
    }
    out += &super::shift_text(report.shift);
    if stats {
        out += &stats_text(report);
    }
    out
}

fn stats_text(report: &LabelReport) -> String {
    let mut out = String::new();
    let (active, all) = (text::count(report.active_bricks), text::count(report.bricks));
    let _ = writeln!(out, "  bricks        {active} active of {all}");
    let (read, whole) = (text::bytes(report.bytes_read), text::bytes(report.archive_bytes));
    let _ = writeln!(out, "  bytes read    {read} of {whole}");
    if let Some(remote) = &report.remote {
        let (requests, size) = (text::count(remote.requests), text::bytes(remote.bytes));
        let _ = writeln!(out, "  fetched       {size} in {requests} requests");
    }
    for (stage, seconds) in &report.seconds {
        let _ = writeln!(out, "  {stage:<13} {}", text::duration(Duration::from_secs_f64(*seconds)));
    }
    out
}
