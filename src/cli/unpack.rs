//! `isospan unpack`: disk for time.

use super::grammar::{self, Range};
use super::output::{Force, exists};
use super::progress::Talk;
use super::step::StepArgs;
use super::{machine::Machine, text};
use isospan::archive::manifest::unpacked_path;
use isospan::pipeline::{StepRange, UnpackReport, UnpackSettings, remove_unpacked, unpack, unpack_need};
use isospan::{Archive, Error, Resources, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Store the blocks of an archive as surfaces use them.
///
/// This trades disk for speed. The archive grows by about 60 bytes per tetrahedron, and surfaces
/// take a fraction of the time. They are the same, byte for byte. All commands that make surfaces
/// use the file from then on. It is mapped, so the system can take its memory back at any time. It
/// stays valid when steps are appended. Steps that are unpacked already stay as they are.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan unpack scan.isospan\n  isospan unpack run.isospan --all-steps --range 0.4:0.6"
)]
pub(crate) struct Args {
    /// The archive, a folder on this machine.
    archive: PathBuf,
    #[command(flatten)]
    step: StepArgs,
    /// All steps.
    #[arg(help_heading = "Series", long, conflicts_with_all = ["step", "time", "steps"])]
    all_steps: bool,
    /// The steps from one number to another; either end may be omitted.
    #[arg(help_heading = "Series", long, value_name = "FIRST:LAST", value_parser = grammar::steps, conflicts_with_all = ["step", "time"], allow_hyphen_values = true)]
    steps: Option<StepRange>,
    /// Only blocks that isovalues in this range need; 100% is the range of the values of the step
    /// that is asked, or of the first. Surfaces at other isovalues decode blocks as before.
    #[arg(long, value_name = "LO:HI", value_parser = grammar::range, allow_hyphen_values = true)]
    range: Option<Range>,
    /// Remove the unpacked blocks of all steps, or of the given ones.
    #[arg(long, conflicts_with = "range")]
    remove: bool,
    /// Print what would be written, and write nothing.
    #[arg(long, conflicts_with = "remove")]
    dry_run: bool,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let all = UnpackSettings::default();
    let settings = UnpackSettings {
        resources: Resources::default()
            .with_threads(args.machine.threads)
            .with_memory(if args.remove { all.resources.memory } else { args.machine.memory(talk) })
            .with_cancel(super::signals::cancel_token()),
        step: args.step.choice()?,
        steps: args.steps.or(args.all_steps.then(StepRange::default)),
        field: args.step.field(),
        range: match args.range {
            Some(range) => range.of(Archive::open(&args.archive)?.at(args.step.choice()?)?.value_range())?,
            None => all.range,
        },
        keep: !args.force.is_given(),
    };
    if !isospan::pipeline::is_archive(&args.archive) {
        return Err(Error::bad_input(&args.archive, "archive", "a folder made by isospan reduce", "none"));
    }
    let report = if args.remove {
        remove_unpacked(&args.archive, &settings, args.step.is_given() || settings.steps.is_some())?
    } else {
        let need = unpack_need(&args.archive, &settings)?;
        if let Some(step) = need.other_range.filter(|_| settings.keep && !args.dry_run) {
            return Err(exists(&unpacked_path(&args.archive, step)));
        }
        let free =
            need.free.map_or_else(String::new, |free| format!(" of {} that are free", text::bytes(free)));
        let about = format!(
            "about {}{free}, for {} tetrahedra",
            text::bytes(need.bytes),
            text::count(need.tetrahedra)
        );
        let is_done = need.unpacked > 0 && need.tetrahedra == 0;
        if is_done && !args.json {
            return super::print(&nothing_text(&args.archive));
        }
        if args.dry_run {
            return if args.json {
                super::print_json("unpack.estimate", &need)
            } else {
                super::print(&format!(
                    "{}: not unpacked, a dry run: it takes {about}\n",
                    args.archive.display()
                ))
            };
        }
        if !is_done {
            talk.note(&format!("writes {about}; unpack --remove removes them"));
        }
        let bar = talk.progress();
        let report = unpack(&args.archive, &settings, &*bar);
        bar.end();
        report?
    };
    if args.json {
        return super::print_json("unpack", &report);
    }
    super::print(&if args.remove { removed_text(&report) } else { unpacked_text(&report) })
}

/// What is said where all steps are unpacked already.
fn nothing_text(archive: &Path) -> String {
    format!("{}: unpacked already for this range; --force does it again\n", archive.display())
}

fn unpacked_text(report: &UnpackReport) -> String {
    let mut out = String::new();
    for f in &report.files {
        let _ = writeln!(
            out,
            "{}: {}, {} tetrahedra, {} ({:.1} bytes a tetrahedron)",
            f.file.display(),
            text::plural(f.blocks, "block"),
            text::count(f.tetrahedra),
            text::bytes(f.bytes),
            f.bytes as f64 / f.tetrahedra.max(1) as f64
        );
        if f.packed_blocks > 0 {
            let _ = writeln!(
                out,
                "  {} packed",
                text::plural(f.packed_blocks, "other block")
                    + if f.packed_blocks == 1 { " stays" } else { " stay" }
            );
        }
    }
    if report.files.len() > 1 {
        let _ = writeln!(out, "{} files, {}", report.files.len(), text::bytes(report.bytes));
    }
    out
}

fn removed_text(report: &UnpackReport) -> String {
    let names: String = report.files.iter().map(|f| format!("{}\n", f.file.display())).collect();
    format!(
        "{names}{}, {} removed\n",
        text::plural(report.files.len() as u64, "file"),
        text::bytes(report.bytes)
    )
}
