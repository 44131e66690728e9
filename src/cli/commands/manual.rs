//! What the program says about itself: the overview of commands, `isospan completions`,
//! `isospan man`, and the version.

use super::Cli;
use clap::{Arg, ArgAction, Command, CommandFactory};
use clap_mangen::Man;
use isospan::{Error, Result};
use std::ffi::OsString;
use std::fmt::Write as _;
use std::io::{IsTerminal, Write as _};
use std::path::PathBuf;

/// Print a completion script for a shell.
#[derive(clap::Args, Debug)]
pub struct CompletionsArgs {
    /// The shell.
    shell: clap_complete::Shell,
}

/// Print a manual page, or write one for each command.
#[derive(clap::Args, Debug)]
pub struct ManArgs {
    /// The command whose page is printed [default: that of the program].
    #[arg(conflicts_with = "dir")]
    command: Option<String>,
    /// Write isospan.1, isospan-info.1 and so on into this folder instead, over what is there.
    #[arg(long, value_name = "FOLDER")]
    dir: Option<PathBuf>,
    /// Print the flags of the command as keywords of Python instead.
    #[arg(long, hide = true, requires = "command")]
    keywords: bool,
}

/// The commands, in the order in which they are listed.
const GROUPS: [(&str, &[&str]); 5] = [
    ("Make archives", &["reduce", "append", "brick"]),
    (
        "Ask files and archives",
        &["info", "spectrum", "count", "probe", "export", "measure", "view", "publish"],
    ),
    ("Surfaces", &["surface", "check", "compare", "render"]),
    ("Clusters", &["plan", "work", "commit", "status", "gc", "slurm", "nightly"]),
    ("Other", &["completions", "man", "help"]),
];

const EXIT_STATUS: [(&str, &str); 9] = [
    ("0", "All was done."),
    ("1", "The system refused something: a file is not there, or may not be read or written."),
    ("2", "The command line is wrong, or does not fit the input. Nothing was done."),
    ("3", "Segments of a planned reduction are missing."),
    ("4", "There is not enough memory, or not enough space on a disk."),
    ("5", "An input is damaged, malformed or of a kind that cannot be used; a surface is not sound."),
    ("6", "The archive is written, but its error or size does not meet the target."),
    ("7", "`commit` of a try for a target: the next try is planned, and takes `work` and `commit` again."),
    (
        "75",
        "The run was stopped by a signal, or another process writes the archive. The same command can succeed later.",
    ),
];

const ENVIRONMENT: [(&str, &str); 4] = [
    ("TMPDIR", "The folder for temporary files, unless --scratch names one [default: /tmp]."),
    ("NO_COLOR", "If set, help and messages have no colours."),
    (
        "AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT_URL, ...",
        "Keys and place of archives and volumes in object stores (s3://), as other programs take them.",
    ),
    (
        "GLIBC_TUNABLES",
        "Vector instructions that glibc.cpu.hwcaps forbids are not used; the results are the same.",
    ),
];

const FILES: [(&str, &str); 3] = [
    ("NAME.isospan", "An archive, a folder: manifest.zst, mesh/ and steps/."),
    (
        "NAME.isospan.work",
        "A planned reduction beside its archive: plan.json, and slurm/ with job scripts and logs.",
    ),
    (
        ".NAME.tmp-*",
        "A file that is being written, or that a killed run has left; isospan gc removes those of archives.",
    ),
];

/// The name of the command that arguments are for.
pub(crate) fn command_of(args: &[OsString]) -> Option<String> {
    let cli = Cli::command();
    let command = args.iter().skip(1).find_map(|arg| cli.find_subcommand(arg));
    command.map(|command| command.get_name().to_owned())
}

/// The version, the features and where the program comes from, on several lines.
pub(crate) fn long_version() -> String {
    let mut features = isospan::features();
    features.extend(cfg!(feature = "view").then_some("view"));
    format!("{}\nfeatures: {}", env!("CARGO_PKG_VERSION"), features.join(" "))
}

/// A group's commands, with what each does.
fn commands<'a>(cli: &'a Command, names: &'a [&str]) -> impl Iterator<Item = (&'a str, String)> {
    let about = |c: &Command| c.get_about().map(ToString::to_string).unwrap_or_default();
    names.iter().filter_map(move |name| match *name {
        "help" => Some(("help", "Print this, or the help of a command".to_owned())),
        name => cli.find_subcommand(name).map(|c| (c.get_name(), about(c))),
    })
}

/// The help of the program as a whole: its commands in groups.
fn overview() -> clap::builder::StyledStr {
    let cli = Cli::command();
    let mut list = String::new();
    for (title, names) in GROUPS {
        // As clap marks its own headings.
        let _ = writeln!(list, "\u{1b}[1m\u{1b}[4m{title}:\u{1b}[0m");
        for (name, about) in commands(&cli, names) {
            let _ = writeln!(list, "  \u{1b}[1m{name:<12}\u{1b}[0m {about}");
        }
        list.push('\n');
    }
    let template = format!("{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}{{all-args}}");
    let hide = |command: Command| command.hide(true);
    let help = Arg::new("help").short('h').long("help").help("Print help").action(ArgAction::Help);
    cli.disable_help_subcommand(true)
        .mut_subcommands(hide)
        .override_usage("isospan [OPTIONS] <COMMAND>")
        .disable_help_flag(true)
        .arg(help)
        .help_template(template)
        .render_help()
}

/// Prints it where it was asked for, or on standard error. Whoever closes that has seen enough.
pub(crate) fn print_overview(to_stderr: bool) {
    let (text, is_plain) = (overview(), std::env::var_os("NO_COLOR").is_some_and(|v| !v.is_empty()));
    let show = |is_terminal: bool| {
        if is_terminal && !is_plain { text.ansi().to_string() } else { text.to_string() }
    };
    let _ = if to_stderr {
        write!(std::io::stderr(), "{}", show(std::io::stderr().is_terminal()))
    } else {
        write!(std::io::stdout(), "{}", show(std::io::stdout().is_terminal()))
    };
}

pub(crate) fn completions(args: &CompletionsArgs) -> Result<()> {
    let mut text = vec![];
    clap_complete::generate(args.shell, &mut Cli::command(), "isospan", &mut text);
    super::print_page(&String::from_utf8_lossy(&text))
}

pub(crate) fn man(args: &ManArgs) -> Result<()> {
    let mut cli = Cli::command().disable_help_subcommand(true);
    cli.build();
    let Some(dir) = &args.dir else {
        let command = match &args.command {
            None => &cli,
            Some(name) => cli.find_subcommand(name).ok_or_else(|| {
                Error::usage(format!("there is no command {name}; isospan --help lists them"))
            })?,
        };
        if args.keywords {
            return super::print_page(&super::keywords::of(command));
        }
        return super::print_page(&page(command)?);
    };
    std::fs::create_dir_all(dir).map_err(|e| Error::io("create", dir, e))?;
    [&cli].into_iter().chain(cli.get_subcommands()).try_for_each(|command| {
        let file = dir.join(Man::new(command.clone()).get_filename());
        std::fs::write(&file, page(command)?).map_err(|e| Error::io("write", &file, e))
    })
}

/// The manual page of the program, or of a command.
fn page(command: &Command) -> Result<String> {
    let source = format!("isospan {}", env!("CARGO_PKG_VERSION"));
    let man = Man::new(command.clone()).source(source).manual("isospan");
    let mut text = vec![];
    let is_whole = command.has_subcommands();
    man.render_title(&mut text)
        .and_then(|()| man.render_name_section(&mut text))
        .and_then(|()| man.render_synopsis_section(&mut text))
        .and_then(|()| man.render_description_section(&mut text))
        .and_then(|()| man.render_options_section(&mut text))
        .map_err(|e| Error::io("render", "the manual page", e))?;
    let mut text = String::from_utf8_lossy(&text).into_owned();
    if is_whole {
        for (title, names) in GROUPS {
            section(&mut text, title);
            commands(command, names).filter(|(name, _)| *name != "help").for_each(|(name, about)| {
                item(&mut text, &format!("isospan-{name}(1)"), &about);
            });
        }
    }
    if let Some(examples) = command.get_after_help() {
        section(&mut text, "examples");
        text += ".nf\n";
        for line in examples.to_string().lines().skip(1) {
            let _ = writeln!(text, "{}", roff(line.trim_start()));
        }
        text += ".fi\n";
    }
    for (title, list) in
        [("exit status", &EXIT_STATUS[..]), ("environment", &ENVIRONMENT[..]), ("files", &FILES[..])]
    {
        section(&mut text, title);
        list.iter().for_each(|(name, about)| item(&mut text, name, about));
    }
    if !is_whole {
        section(&mut text, "see also");
        text += "isospan(1)\n";
    }
    section(&mut text, "version");
    let _ = writeln!(text, "v{}", env!("CARGO_PKG_VERSION"));
    Ok(text)
}

fn section(page: &mut String, title: &str) {
    let _ = writeln!(page, ".SH {:?}", title.to_uppercase());
}

/// A term and what it means.
fn item(page: &mut String, term: &str, about: &str) {
    let _ = writeln!(page, ".TP\n\\fB{}\\fR\n{}", roff(term), roff(about));
}

/// A line of text that begins no request.
fn roff(text: &str) -> String {
    let text = text.replace('\\', "\\e").replace('-', "\\-").replace('\'', "\\(aq");
    if text.starts_with('.') { format!("\\&{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::volume::units::Unit;

    #[test]
    fn every_command_is_in_one_group_and_fits_a_line() {
        let cli = Cli::command();
        let mut listed: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        listed.retain(|name| cfg!(feature = "view") || !["view", "publish"].contains(name));
        let mut known: Vec<&str> = cli.get_subcommands().map(Command::get_name).collect();
        known.push("help");
        for names in [&mut listed, &mut known] {
            names.sort_unstable();
        }
        assert_eq!(listed, known);
        for (_, names) in GROUPS {
            for (name, about) in commands(&cli, names) {
                assert!(about.len() <= 63 && !about.ends_with('.'), "{name}: {about}");
            }
        }
    }

    #[test]
    fn pages_have_all_sections_and_examples() {
        let mut cli = Cli::command().disable_help_subcommand(true);
        cli.build();
        for command in [&cli].into_iter().chain(cli.get_subcommands()) {
            let text = page(command).unwrap();
            for title in ["NAME", "SYNOPSIS", "EXIT STATUS", "ENVIRONMENT", "FILES"] {
                let heading = |line: &str| line.trim_start_matches(".SH ").trim_matches('"') == title;
                assert!(text.lines().any(heading), "{}: {title}", command.get_name());
            }
        }
    }

    /// Every value that no list explains is parsed by the grammar: its message says what is
    /// expected.
    #[test]
    fn values_have_one_kind_of_message() {
        use std::any::TypeId;
        let texts = [TypeId::of::<PathBuf>(), TypeId::of::<String>(), TypeId::of::<Unit>()];
        let cli = Cli::command();
        for command in cli.get_subcommands() {
            for arg in command.get_arguments().filter(|a| a.get_action().takes_values()) {
                let Some(flag) = arg.get_long() else { continue };
                let id = arg.get_value_parser().type_id();
                if texts.iter().any(|text| id == *text) || !arg.get_possible_values().is_empty() {
                    continue;
                }
                let given = format!("--{flag}=?");
                let error = Cli::command()
                    .try_get_matches_from(["isospan", command.get_name(), &given])
                    .unwrap_err()
                    .to_string();
                // A name of sbatch's option is a text of its own kind.
                assert!(error.contains("': expected "), "{} {given}: {error}", command.get_name());
            }
        }
    }

    /// A negative number is a value: its flag says what it expects.
    #[test]
    fn negative_numbers_are_values() {
        use std::any::TypeId;
        let cli = Cli::command();
        for command in cli.get_subcommands() {
            for arg in command.get_arguments().filter(|a| a.get_action().takes_values()) {
                let texts = [TypeId::of::<PathBuf>(), TypeId::of::<String>(), TypeId::of::<Unit>()];
                let is_text = texts.iter().any(|text| arg.get_value_parser().type_id() == *text);
                let Some(flag) = arg.get_long().filter(|_| !is_text && arg.get_possible_values().is_empty())
                else {
                    continue;
                };
                let words = ["isospan", command.get_name(), &format!("--{flag}"), "-5"];
                let refused = Cli::command().try_get_matches_from(words).err();
                let text = refused.map_or(String::new(), |error| error.to_string());
                assert!(!text.contains("argument '-5'"), "{} --{flag}: {text}", command.get_name());
            }
        }
    }
}
