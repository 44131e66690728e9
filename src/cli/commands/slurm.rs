//! `isospan slurm`: a planned reduction as jobs of a Slurm cluster.
//!
//! It writes three scripts next to the plan: `work.sh`, a job array of shards; `commit.sh`, which
//! waits for them, and submits what is missing again; `submit.sh`, which submits both. They are
//! plain scripts: to be read, changed and submitted by hand.

use super::grammar;
use super::output::{Force, exists};
use super::progress::Talk;
use super::text;
use isospan::pipeline::{ShardNeeds, Shards, work_folder};
use isospan::{Error, Result};
use serde::Serialize;
use std::ffi::OsString;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// Write Slurm job scripts for a planned reduction.
///
/// With --submit they are submitted. They are in ARCHIVE.work/slurm: a job array of shards that may
/// be requeued, and a commit that waits for them and submits missing shards again. Logs are written
/// to the same folder.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan slurm scan.isospan --submit\n  isospan slurm scan.isospan --threads 16 --time-limit 2h --option=--partition=long"
)]
pub struct Args {
    /// The planned archive, in a folder that all nodes can reach.
    pub archive: PathBuf,
    /// Submit the jobs, and print their numbers.
    #[arg(long)]
    submit: bool,
    /// Threads per task (--cpus-per-task).
    #[arg(help_heading = "Resources", long, value_name = "N", default_value = "4", value_parser = grammar::whole_in(1..=4096u64), allow_negative_numbers = true)]
    threads: u64,
    /// Limit of memory per task [default: what all its threads need]; the job requests a quarter
    /// more.
    #[arg(help_heading = "Resources", long, value_name = "SIZE", value_parser = grammar::memory, allow_hyphen_values = true)]
    memory: Option<u64>,
    /// Time limit of a task: 90m, 12h [default: 6 times the estimate, at least 60m]. Slurm counts
    /// whole minutes.
    #[arg(help_heading = "Resources", long, value_name = "SPAN", value_parser = grammar::span, allow_hyphen_values = true)]
    time_limit: Option<Duration>,
    /// How long before that limit a task is asked to stop.
    #[arg(help_heading = "Resources", long, value_name = "SPAN", default_value = "120s", value_parser = grammar::span, allow_hyphen_values = true)]
    grace: Duration,
    /// Largest number of tasks at one time [default: no limit].
    #[arg(help_heading = "Resources", long, value_name = "N", value_parser = grammar::natural, allow_negative_numbers = true)]
    throttle: Option<u64>,
    /// How often shards are submitted, including the first time.
    #[arg(long, value_name = "N", default_value = "3", value_parser = grammar::natural, allow_negative_numbers = true)]
    tries: u64,
    /// Largest number of tasks in an array [default: the cluster's MaxArraySize if scontrol knows
    /// it, else 1001]. If there are more shards, the work is divided anew.
    #[arg(long, value_name = "N", value_parser = grammar::natural, allow_negative_numbers = true)]
    max_array: Option<u64>,
    /// Folder on the node for temporary files [default: the system's temporary folder].
    #[arg(help_heading = "Resources", long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,
    /// Another option of sbatch for both jobs, as --option=--partition=long; may be repeated.
    #[arg(long, value_name = "OPTION", allow_hyphen_values = true, value_parser = parse_option)]
    option: Vec<String>,
    #[command(flatten)]
    force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn parse_option(text: &str) -> std::result::Result<String, String> {
    match text.starts_with('-') && !text.contains(['\n', '\r']) {
        true => Ok(text.to_owned()),
        false => Err("expected an option of sbatch, as in --partition=long".into()),
    }
}

#[derive(Serialize)]
struct Report {
    scripts: [PathBuf; 3],
    shards: u64,
    tasks: u64,
    /// Bytes that a task asks for.
    memory: u64,
    minutes: u64,
    work_job: Option<String>,
    commit_job: Option<String>,
}

/// Slurm's own default of MaxArraySize.
const MAX_ARRAY: u64 = 1001;
const NAMES: [&str; 3] = ["submit.sh", "work.sh", "commit.sh"];
const TEMPLATES: [&str; 3] =
    [include_str!("slurm/submit.sh"), include_str!("slurm/work.sh"), include_str!("slurm/commit.sh")];

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    super::expect_planned(&args.archive)?;
    let plan = Shards::at(&args.archive).needs(args.threads as usize)?;
    let archive = std::path::absolute(&args.archive).map_err(|e| Error::io("find", &args.archive, e))?;
    let folder = work_folder(&archive).join("slurm");
    std::fs::create_dir_all(&folder).map_err(|e| Error::io("create the folder", &folder, e))?;
    let max = args.max_array.or_else(cluster_max_array).unwrap_or(MAX_ARRAY);
    let tasks = plan.shards.min(max);
    if tasks < plan.shards {
        talk.note(&format!("{} shards are cut into {tasks}, the most tasks of an array here", plan.shards));
    }
    let job = Job::new(args, &plan, tasks, &archive, &folder)?;
    let scripts = NAMES.map(|n| folder.join(n));
    let texts = TEMPLATES.map(|template| job.fill(template));
    // A script may have been changed by hand.
    let changed = |(path, text): &(&PathBuf, &String)| {
        let mut found = vec![];
        let read = isospan::bytes::open_unlinked(path)
            .and_then(|file| file.take(text.len() as u64 + 1).read_to_end(&mut found));
        std::fs::symlink_metadata(path).is_ok() && (read.is_err() || found != text.as_bytes())
    };
    if let Some((path, _)) = scripts.iter().zip(&texts).find(changed).filter(|_| !args.force.is_given()) {
        return Err(exists(path));
    }
    scripts.iter().zip(&texts).try_for_each(|(path, text)| write_script(path, text))?;
    let (minutes, memory) = (job.minutes, job.ask);
    let jobs = if args.submit { Some(submit(&scripts[0])?) } else { None };
    let (work_job, commit_job) = jobs.unzip();
    let report = Report { scripts, shards: plan.shards, tasks, memory, minutes, work_job, commit_job };
    if args.json {
        super::print_json("slurm", &report)
    } else {
        super::print(&in_words(&args.archive, &report))
    }
}

fn in_words(archive: &Path, r: &Report) -> String {
    let mut out: String = r.scripts.iter().map(|s| format!("{}\n", s.display())).collect();
    let asked = format!("{} and {} min each", text::bytes(r.memory), r.minutes);
    out += &format!("  tasks      {}, {asked}\n", text::count(r.tasks));
    match (&r.work_job, &r.commit_job) {
        (Some(work), Some(commit)) => {
            out + &format!("  submitted  shards as job {work}, their commit as job {commit}\n")
        }
        _ => {
            let (script, archive) = (text::shell(&r.scripts[0]), text::shell(archive));
            out + &format!("next: {script}, or isospan slurm {archive} --submit\n")
        }
    }
}

/// What is filled into the scripts.
struct Job {
    minutes: u64,
    ask: u64,
    words: Vec<(&'static str, String)>,
}

impl Job {
    fn new(args: &Args, plan: &ShardNeeds, tasks: u64, archive: &Path, folder: &Path) -> Result<Self> {
        let memory = args.memory.unwrap_or(plan.memory);
        if memory < plan.memory_least {
            let (needed, available) = (plan.memory_least, memory);
            return Err(Error::memory("for a shard", needed, available));
        }
        // The rest is for code, and pages of files that a control group counts.
        let ask = memory + memory / 4 + (128 << 20);
        let seconds = plan.seconds / tasks as f64;
        let minutes = match args.time_limit.map(|limit| limit.as_secs().div_ceil(60)) {
            Some(0) => return Err(Error::usage("--time-limit is at least a minute")),
            Some(minutes) => minutes,
            None => ((seconds / 10.0).ceil() as u64).max(60),
        };
        let grace = args.grace.as_secs();
        if !(1..=65_535).contains(&grace) {
            return Err(Error::usage("--grace is 1s to 65535s, as Slurm has it"));
        }
        let shown = archive.display().to_string();
        let name = archive.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let letter = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
        let throttle = args.throttle.map_or_else(String::new, |n| format!("%{n}"));
        let (program, _) = own_command()?;
        let scratch = args.scratch.as_deref().map(quoted).transpose()?.map(|s| format!(" --scratch {s}"));
        let words = vec![
            ("ARCHIVE", shown.replace(|c: char| c.is_control(), " ")),
            ("QUOTED", quoted(archive)?),
            ("QUOTED_FOLDER", quoted(folder)?),
            ("FOLDER", in_directive(folder)?),
            ("PROGRAM", quoted(&program)?),
            ("JOB", format!("isospan-{}", name.chars().map(letter).collect::<String>())),
            ("ARRAY", format!("0-{}{throttle}", tasks - 1)),
            ("THROTTLE", throttle),
            ("SHARDS", tasks.to_string()),
            ("THREADS", args.threads.to_string()),
            ("MEMORY", memory.to_string()),
            ("MEM", ask.div_ceil(1 << 20).to_string()),
            ("MINUTES", minutes.to_string()),
            ("GRACE", grace.to_string()),
            ("TRIES", args.tries.to_string()),
            ("SCRATCH", scratch.unwrap_or_default()),
            ("OPTIONS", args.option.iter().map(|o| format!("#SBATCH {o}\n")).collect()),
        ];
        Ok(Self { minutes, ask, words })
    }

    /// A template with its words, `@NAME@` each, filled in: in one pass, so that a value is never
    /// searched for words.
    fn fill(&self, template: &str) -> String {
        let (mut out, mut rest) = (String::new(), template);
        while let Some(at) = rest.find('@') {
            let (before, from) = rest.split_at(at);
            out += before;
            let word = self.words.iter().find_map(|(name, value)| {
                let rest = from.strip_prefix('@')?.strip_prefix(name)?.strip_prefix('@')?;
                Some((value.as_str(), rest))
            });
            let (text, after) = word.unwrap_or_else(|| from.split_at(1));
            out += text;
            rest = after;
        }
        out + rest
    }
}

/// This program and its arguments. In the Python package it is a script, the second word of a
/// command of the interpreter.
pub(super) fn own_command() -> Result<(PathBuf, Vec<OsString>)> {
    let failed = |e: std::io::Error| Error::io("find", "this program", e);
    let mut words = std::env::args_os().skip(1);
    if super::is_program() {
        return Ok((std::env::current_exe().map_err(failed)?, words.collect()));
    }
    let script = words.next().map(PathBuf::from).filter(|path| path.ends_with("isospan"));
    let script = script.ok_or_else(|| Error::usage("start it as `isospan`, so that a job can, too"))?;
    Ok((std::path::absolute(script).map_err(failed)?, words.collect()))
}

/// A path as a word of a shell. A script is text: a path that is not UTF-8 is refused.
pub(super) fn quoted(path: &Path) -> Result<String> {
    let text = path.to_str().ok_or_else(|| {
        Error::usage(format!("{}: the path is not UTF-8; rename it, for scripts name it", path.display()))
    })?;
    Ok(text::quoted(text))
}

/// A path between the quotes of a directive, where Slurm replaces what follows a `%`.
fn in_directive(path: &Path) -> Result<String> {
    let text = path.to_string_lossy();
    if text.contains(['"', '\\', '\n', '\r', '%']) {
        return Err(Error::usage(format!(
            "{}: Slurm takes no path of a log with quotes, backslashes, line ends or %",
            path.display()
        )));
    }
    Ok(text.into_owned())
}

fn write_script(path: &Path, text: &str) -> Result<()> {
    isospan::bytes::write_file(path, text.as_bytes())?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755))
            .map_err(|e| Error::io("make executable", path, e))?;
    }
    Ok(())
}

/// MaxArraySize of the cluster that this machine belongs to; array indices stay below it.
fn cluster_max_array() -> Option<u64> {
    let out = Command::new("scontrol").args(["show", "config"]).output().ok()?;
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    let line = text.lines().find(|l| l.trim_start().starts_with("MaxArraySize"))?;
    line.split_once('=')?.1.trim().parse().ok().filter(|&n| n > 0)
}

/// Runs the script that submits; gives the numbers of both jobs.
fn submit(script: &Path) -> Result<(String, String)> {
    let failed = |e: std::io::Error| Error::io("run", script, e);
    let out = Command::new(script).output().map_err(failed)?;
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    match text.trim().split_once(' ') {
        Some((work, commit)) if out.status.success() => Ok((work.to_owned(), commit.to_owned())),
        _ => {
            let why = String::from_utf8_lossy(&out.stderr).trim().replace('\n', "; ");
            Err(failed(std::io::Error::other(format!("{}: {why}", out.status))))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_words_of_a_shell() {
        assert_eq!(quoted(Path::new("/a b/it's")).unwrap(), r"'/a b/it'\''s'");
        assert!(in_directive(Path::new("/a b")).is_ok());
        assert!(["/a%j", "/a\"b", "/a\nb"].iter().all(|p| in_directive(Path::new(p)).is_err()));
    }

    /// A value is not filled in again: it may be a name that another user has chosen.
    #[test]
    fn values_are_not_filled_in() {
        let nasty = "@QUOTED_FOLDER@;touch pwned;x";
        let words = vec![("ARCHIVE", nasty.to_owned()), ("QUOTED_FOLDER", "'/f'".to_owned())];
        let job = Job { minutes: 1, ask: 1, words };
        let text = job.fill("# @ARCHIVE@ a@b @NO@ TERM@@QUOTED_FOLDER@\n@ARCHIVE@@");
        assert_eq!(text, format!("# {nasty} a@b @NO@ TERM@'/f'\n{nasty}@"));
    }

    /// Every word of a template is known.
    #[test]
    fn templates_are_filled() {
        let names = [
            "ARCHIVE",
            "QUOTED",
            "QUOTED_FOLDER",
            "FOLDER",
            "PROGRAM",
            "JOB",
            "ARRAY",
            "THROTTLE",
            "SHARDS",
            "THREADS",
            "MEMORY",
            "MEM",
            "MINUTES",
            "GRACE",
            "TRIES",
            "SCRATCH",
            "OPTIONS",
        ];
        let job = Job { minutes: 1, ask: 1, words: names.map(|n| (n, "7".to_owned())).to_vec() };
        for template in TEMPLATES {
            let text = job.fill(template);
            assert!(text.starts_with("#!/bin/bash\n") && !text.replace("TERM@7", "").contains('@'), "{text}");
        }
    }
}
