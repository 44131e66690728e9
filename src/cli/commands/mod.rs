//! The command line: one file a subcommand, each with `Args` and `run`. All share these two names,
//! as they are read with their module: `reduce::Args`, `reduce::run`. Results go to standard
//! output, progress and errors to standard error; an error is one line; exit codes are those of
//! [`isospan::Error::exit_code`], [`TARGET_NOT_MET`] and [`NEXT_TRY`].

pub mod append;
mod brick;
mod check;
mod choices;
mod commit;
mod compare;
mod count;
mod dry_run;
mod export;
mod figure;
mod gc;
pub mod grammar;
mod heap;
mod info;
mod info_mesh;
mod input;
mod keywords;
mod labels;
mod level;
mod machine;
mod manual;
mod measure;
mod nightly;
mod numbers;
mod output;
mod plan;
mod probe;
pub mod progress;
#[cfg(feature = "view")]
pub mod publish;
pub mod reduce;
pub mod render;
mod signals;
mod slurm;
mod spectrum;
mod status;
mod step;
mod surface;
pub(crate) mod text;
mod times;
#[cfg(feature = "view")]
mod view;
mod words;
mod work;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use isospan::Result;
use serde::Serialize;
use std::ffi::OsString;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Reduce scalar volumes larger than memory to small archives; extract watertight isosurfaces from
/// them.
#[derive(Parser, Debug)]
#[command(name = "isospan", version, long_version = manual::long_version(), arg_required_else_help = true, max_term_width = 110)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
    #[command(flatten)]
    pub talk: progress::Talk,
}

#[derive(Subcommand, Debug)]
pub enum Command {
    Info(info::Args),
    Reduce(Box<reduce::Args>),
    Append(append::Args),
    Surface(surface::Args),
    Compare(compare::Args),
    Count(count::Args),
    Export(export::Args),
    Probe(probe::Args),
    Measure(measure::Args),
    Spectrum(spectrum::Args),
    Render(Box<render::Args>),
    #[cfg(feature = "view")]
    View(view::Args),
    #[cfg(feature = "view")]
    Publish(publish::Args),
    Brick(brick::Args),
    Check(check::Args),
    Plan(Box<plan::Args>),
    Work(work::Args),
    Commit(commit::Args),
    Status(status::Args),
    Gc(gc::Args),
    Slurm(slurm::Args),
    Nightly(Box<nightly::Args>),
    Completions(manual::CompletionsArgs),
    Man(manual::ManArgs),
}

impl Command {
    /// Whether the same command goes on where it was stopped: only what makes an archive has
    /// something to continue.
    fn continues(&self) -> bool {
        matches!(self, Self::Reduce(_) | Self::Append(_) | Self::Work(_) | Self::Commit(_) | Self::Nightly(_))
    }
}

/// Whether this process is the program itself, and not an interpreter of Python.
static IS_PROGRAM: AtomicBool = AtomicBool::new(false);

fn is_program() -> bool {
    IS_PROGRAM.load(Ordering::Relaxed)
}

/// The program itself: runs the command of this process, and returns the exit code.
pub fn program() -> u8 {
    IS_PROGRAM.store(true, Ordering::Relaxed);
    main(std::env::args_os())
}

/// Runs the program on arguments, the first of which is its name; returns the exit code.
pub fn main(args: impl IntoIterator<Item = OsString>) -> u8 {
    heap::give_back_early();
    // Before anything is parsed: that takes memory too.
    if let Err(error) = isospan::exec::expect_address_space() {
        let _ = writeln!(std::io::stderr(), "isospan: error: {error}");
        return error.exit_code();
    }
    let args: Vec<OsString> = args.into_iter().collect();
    let cli = match Cli::try_parse_from(&args) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are results; everything else is a usage error on standard error.
            let code = u8::from(error.use_stderr()) * 2;
            let is_help = matches!(
                error.kind(),
                ErrorKind::DisplayHelp | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
            );
            if is_help && manual::command_of(&args).is_none() {
                manual::print_overview(error.use_stderr());
            } else if code == 0 {
                let _ = error.print();
            } else {
                let _ = writeln!(std::io::stderr(), "isospan: error: {}", one_line(&error, &args));
            }
            return code;
        }
    };
    signals::survive_file_size_limit();
    match run(&cli) {
        Ok(code) => code,
        Err(error) if is_broken_pipe(&error) => 0,
        Err(error @ isospan::Error::Cancelled) if !cli.command.continues() => {
            let _ = writeln!(std::io::stderr(), "isospan: error: stopped by a signal; nothing was written");
            error.exit_code()
        }
        Err(error) => {
            print_error(&error.to_string());
            error.exit_code()
        }
    }
}

/// What the parser refuses, and where to read more, on one line.
pub fn one_line(error: &clap::Error, args: &[OsString]) -> String {
    let text = error.render().to_string();
    let what = text.split("Usage: ").next().unwrap_or_default();
    let what = what.split("For more information").next().unwrap_or_default();
    let what: Vec<&str> = what.trim_start_matches("error: ").split_whitespace().collect();
    let name = manual::command_of(args).map_or(String::new(), |name| format!(" {name}"));
    isospan::error::printable(&format!("{}; isospan{name} --help tells more", what.join(" "))).into_owned()
}

/// The exit code of a reduction whose archive is there and does not meet its target.
pub(crate) const TARGET_NOT_MET: u8 = 6;
/// The exit code of a commit that has planned the next try for a target.
pub(crate) const NEXT_TRY: u8 = 7;

/// Runs a command; returns the exit code of one that did its work.
fn run(cli: &Cli) -> Result<u8> {
    let done = match &cli.command {
        Command::Reduce(args) => return reduce::run(args, &cli.talk),
        Command::Nightly(args) => return nightly::run(args, &cli.talk),
        Command::Info(args) => info::run(args, &cli.talk),
        Command::Append(args) => append::run(args, &cli.talk),
        Command::Surface(args) => surface::run(args, &cli.talk),
        Command::Compare(args) => compare::run(args, &cli.talk),
        Command::Count(args) => count::run(args, &cli.talk),
        Command::Export(args) => export::run(args, &cli.talk),
        Command::Probe(args) => probe::run(args, &cli.talk),
        Command::Measure(args) => measure::run(args, &cli.talk),
        Command::Spectrum(args) => spectrum::run(args, &cli.talk),
        Command::Render(args) => render::run(args, &cli.talk),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(args, &cli.talk),
        #[cfg(feature = "view")]
        Command::Publish(args) => publish::run(args, &cli.talk),
        Command::Brick(args) => brick::run(args, &cli.talk),
        Command::Check(args) => check::run(args, &cli.talk),
        Command::Plan(args) => plan::run(args, &cli.talk),
        Command::Work(args) => work::run(args, &cli.talk),
        Command::Commit(args) => return commit::run(args, &cli.talk),
        Command::Status(args) => status::run(args),
        Command::Gc(args) => gc::run(args),
        Command::Slurm(args) => slurm::run(args, &cli.talk),
        Command::Completions(args) => manual::completions(args),
        Command::Man(args) => manual::man(args),
    };
    done.map(|()| 0)
}

/// Refuses an archive that was not planned, and says what it is.
fn expect_planned(archive: &Path) -> Result<()> {
    if isospan::pipeline::plan_path(archive).exists() {
        return Ok(());
    }
    let got = if isospan::pipeline::is_archive(archive) {
        "a finished archive that isospan reduce made; isospan info tells what is in it"
    } else if archive.join("mesh").is_dir() {
        "an unfinished archive of isospan reduce; the same reduce command goes on with it"
    } else {
        "none"
    };
    Err(isospan::Error::bad_input(archive, "plan", "one that isospan plan made", got))
}

/// The memory of a run: what was asked for, or half of what the process may use; that number is
/// reported.
fn memory(asked: Option<u64>, talk: &progress::Talk) -> u64 {
    asked.unwrap_or_else(|| {
        let half = isospan::exec::usable_memory() / 2;
        talk.detail(&format!("--memory {} (half of what this process may use)", text::bytes(half)));
        half
    })
}

/// Whoever read our output has closed it (`isospan info … | head`): no error.
fn is_broken_pipe(error: &isospan::Error) -> bool {
    matches!(error, isospan::Error::Io { source, .. } if source.kind() == std::io::ErrorKind::BrokenPipe)
}

/// Writes an error, one line, to standard error; who closed that does not want it.
fn print_error(text: &str) {
    let text = words::in_flags(text);
    let _ = writeln!(std::io::stderr(), "isospan: error: {}", isospan::error::printable(&text));
}

/// Writes a result to standard output, its settings as flags. Names from files do not steer the
/// terminal.
fn print(text: &str) -> Result<()> {
    print_page(&words::in_flags(text))
}

/// Writes what the program says of itself.
fn print_page(text: &str) -> Result<()> {
    let text = isospan::error::printable(text);
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(|e| isospan::Error::io("write to", "standard output", e))
}

/// The version of the JSON reports: raised when a field is removed, or means something else.
const REPORT_VERSION: u32 = 1;

/// A report with the name of its schema.
#[derive(Serialize)]
struct Report<'a, T> {
    schema: String,
    version: u32,
    #[serde(flatten)]
    report: &'a T,
}

/// Writes a result as JSON, one line.
fn print_json(schema: &str, report: &impl Serialize) -> Result<()> {
    print(&json_line(schema, report)?)
}

/// A result as JSON, one line. `schema` is its name in the schema of reports, after "isospan.".
fn json_line(schema: &str, report: &impl Serialize) -> Result<String> {
    let report = Report { schema: format!("isospan.{schema}"), version: REPORT_VERSION, report };
    let text = serde_json::to_string(&report)
        .map_err(|e| isospan::Error::io("write JSON to", "standard output", std::io::Error::other(e)))?;
    Ok(text + "\n")
}
