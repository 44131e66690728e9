//! `isospan plan`: a reduction in parts, for several processes or machines.

use super::choices::Choices;
use super::grammar;
use super::input::InputArgs;
use super::machine::{InputScratch, Machine};
use super::output::expect_apart;
use super::progress::Talk;
use super::step::StepInputs;
use super::text;
use isospan::pipeline::{PlanReport, RunSettings};
use isospan::{Reduction, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Plan a reduction for several processes or machines.
///
/// `work` makes shards of it, `commit` puts the archive together.
/// The plan is written to ARCHIVE.work/plan.json and never changed. Any number of workers, in any
/// order, make the same bytes as `reduce`. A target, as --target-rms, takes several tries: where
/// `commit` ends with exit code 7, it has planned the next one. A worker decodes its part of a
/// volume that is compressed in chunks. Every worker unpacks any other compressed volume, and sorts
/// a mesh, for itself; `brick` such a volume first.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan plan scan.nrrd -o scan.isospan --shards 16\n  isospan plan 'step_*.vti' -o run.isospan --shards 64 --target-rms 1%"
)]
pub struct Args {
    #[command(flatten)]
    pub steps: StepInputs,
    /// The archive to make: a folder NAME.isospan in a place that all workers can reach.
    #[arg(short, long, value_name = "ARCHIVE")]
    pub output: PathBuf,
    /// Number of shards: parts that can be made at the same time.
    #[arg(help_heading = "Resources", long, value_name = "N", default_value = "1", value_parser = grammar::natural, allow_negative_numbers = true)]
    shards: u64,
    #[command(flatten)]
    pub choices: Choices,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: InputScratch,
    /// Replace an existing archive or plan.
    #[arg(long)]
    force: bool,
    /// Print the plan's figures as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let run = RunSettings { replace: args.force, ..args.machine.run(&args.scratch, talk) };
    let run = RunSettings { keep_going: args.steps.keep_going, ..run };
    let steps = args.steps.all(&args.read, talk)?;
    let settings = args.choices.settings()?;
    expect_apart(&args.output, steps.iter().map(|step| &step.path))?;
    let reduction = Reduction::of_steps(steps).settings(settings).resources(run.resources);
    let reduction = reduction.replace(run.replace).keep_going(run.keep_going);
    let reduction = reduction.isovalues(args.choices.isovalues());
    let bar = talk.progress();
    let report = reduction.progress(&*bar).plan_shards(&args.output, args.shards);
    bar.end();
    let report = report?;
    if args.json { super::print_json("plan", &report) } else { super::print(&in_words(args, &report)) }
}

fn in_words(args: &Args, r: &PlanReport) -> String {
    let (mut out, e) = (format!("{}\n", r.plan.display()), &r.needs);
    let mut row = |name: &str, value: String| {
        let _ = writeln!(out, "  {name:<10} {value}");
    };
    let plural = text::plural;
    row("hash", r.hash.join(" "));
    row("points", format!("{} in {}", text::count(e.points), plural(e.chunks, "chunk")));
    if let Some(lost) = e.rounding {
        row("rounded", text::rounding_words(lost));
    }
    let most = plural(r.shard_segments, "segment");
    row(
        "shards",
        match r.segments % r.shards {
            0 => format!("{}, each of {most}", text::count(r.shards)),
            more => {
                format!("{}: {} of {most}, the others of one fewer", text::count(r.shards), text::count(more))
            }
        },
    );
    if r.shards < args.shards {
        let (asked, all) = (text::count(args.shards), plural(r.segments, "segment"));
        let are = if r.segments == 1 { "is" } else { "are" };
        row("", format!("not {asked}: there {are} {all}, and each is made by one worker"));
    }
    row("archive", format!("about {}", text::bytes(e.archive_bytes)));
    if let Some(source) = e.source_bytes {
        row("ratio", text::about_of(e.archive_bytes, source));
    }
    let at_work = plural(e.workers as u64, "chunk");
    let (least, all) = (text::bytes(e.memory_least), text::bytes(e.memory_comfortable));
    row("each shard", format!("memory at least {least}, {all} for all threads"));
    let time = Duration::from_secs(r.shard_seconds.ceil() as u64);
    row("", format!("roughly {} with {at_work} at work at a time", text::rough_duration(time)));
    if e.scratch_bytes > 0 {
        row("", format!("about {} of scratch", text::bytes(e.scratch_bytes)));
    }
    out + &next_commands(&args.output, r.shards)
}

/// The commands that come after a plan.
pub(super) fn next_commands(archive: &Path, shards: u64) -> String {
    let name = text::shell(archive);
    let shard = match shards {
        1 => String::new(),
        n => format!(" --shard I/{n} (I = 0 .. {})", n - 1),
    };
    format!("next: isospan work {name}{shard}, then\n      isospan commit {name}\n")
}
