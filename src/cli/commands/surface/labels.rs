//! `isospan surface --labels`: a closed mesh for each label of a label image.

use super::{Args, STANDARD_OUTPUT};
use crate::commands::labels;
use crate::commands::output::exists;
use crate::commands::progress::Talk;
use crate::commands::{print, print_json, text};
use isospan::formats::surface::SurfaceFormat;
use isospan::pipeline::{LabelReport, Opening};
use isospan::volume::units::Unit;
use isospan::{Archive, Error, Result};
use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

/// The labels that are wanted, and how files hold them.
pub(super) const HELP: &str = "The surfaces of labels, in place of isovalues: 3,7, names of \
    --label-table, or all but 0, the background: all. The archive is one of a label image: see \
    reduce --labels. Each label has a closed mesh, whose walls its neighbours share: .glb has a \
    node with name and colour for each, .3mf an object, .obj a group, .precomputed a segment, .ply \
    .vtp and .vtkhdf an array 'label' of the points; with {} in the file's name each has its own \
    file. Without --smooth these are the faces of voxels, with their exact volume";

/// What else a surface may be asked for, and one of labels may not.
pub(super) const OTHERS: [&str; 16] = [
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

/// Writes the surfaces of labels.
pub(super) fn run(args: &Args, archive: &Archive, format: SurfaceFormat, talk: &Talk) -> Result<()> {
    if args.output == Path::new(STANDARD_OUTPUT) {
        return Err(Error::usage("surfaces of labels are written to files: give -o a name in place of -"));
    }
    let table = args.labels.table()?;
    let wanted = args.labels.wanted(&table)?;
    let step = archive.at(args.step.choice()?)?;
    let smooth = args.smooth.map_or(0, |steps| steps.unwrap_or(super::LABELS_SMOOTHED));
    let query = step.labels(wanted).smooth(smooth).table(table).compress(args.compression());
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
    labels::note_without_voxels(&report.labels, talk);
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
    let _ = writeln!(
        out,
        "{}: {} vertices, {}, {}",
        text::plural(report.labels.len() as u64, "label"),
        text::count(report.vertices),
        text::plural(report.triangles, "triangle"),
        text::bytes(report.file_bytes)
    );
    let _ = writeln!(out, "{}  file, name", labels::heads(length));
    for one in report.labels.iter().take(MOST_LISTED) {
        let name = if one.name.is_empty() { String::new() } else { format!(", {}", one.name) };
        let _ = writeln!(out, "{}  {}{name}", labels::columns(one), one.file.display());
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
