//! `isospan nightly`: the new files of a folder become time steps of an archive, and a summary says
//! so.
//!
//! ```text
//!  FOLDER ──▶ names that match, settled, not in the archive yet ──▶ reduce, or append ──▶ summary
//! ```
//!
//! It is meant for `cron` and Slurm, which run without a screen: all errors are in the summary too,
//! and the exit code shows whether a person should look. The job script for Slurm is made from the
//! command itself, so a job can submit its successor.

use super::choices::Choices;
use super::input::InputArgs;
use super::machine::{InputScratch, Machine};
use super::progress::Talk;
use super::{grammar, signals, text};
use isospan::formats::{StepSource, sort_by_names, steps_of, steps_of_fields};
use isospan::pipeline::{
    ReduceReport, RunSettings, StepSummary, SurfaceErrors, changed_sources, work_folder,
};
use isospan::{Addition, Archive, Error, Reduction, Result};
use serde::Serialize;
use std::ffi::OsString;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Add the new files of a folder to an archive, night by night.
///
/// The first run makes the archive of all files, as `reduce` with the same choices does. Later runs
/// add files whose names the archive does not have yet, each where its time lies. Files without
/// times come after all others, by the numbers in their names, and the summary names them; their
/// numbers as steps count as their times. The choices are then those of the archive's last step; N%
/// of --isovalue is of the range of the new steps. A file that cannot be used, as one of a time
/// that is there, is left out and reported, every time until it is gone; all others are added. So
/// is a file that has changed since it was added: --replace takes it anew. A run that was stopped
/// is continued by the next.
///
/// The summary is ARCHIVE.work/nightly/DATE-JOB.json and .txt. Exit code 0: all files are in the
/// archive as they are. 1: some were left out, or have changed. 6: the steps that were added do not
/// meet the target. Otherwise that of the error; 5 if no new file could be used, or the folder
/// could not be read.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan nightly /data/scope '*.vti' scope.isospan --target-rms 1%\n  isospan nightly /data/scope '*.vti' scope.isospan --submit 02:00 --again"
)]
pub struct Args {
    /// The folder of the files.
    folder: PathBuf,
    /// What names of files match: * stands for any characters, ? for one, [0-9] for one of these.
    #[arg(value_parser = parse_pattern)]
    pattern: glob::Pattern,
    /// The archive to make, or to add to: a folder NAME.isospan.
    pub archive: PathBuf,
    /// Leave files that were written to within this SPAN for the next time: 90s, 10m, 2h.
    #[arg(long, value_name = "SPAN", default_value = "10m", value_parser = grammar::span, allow_hyphen_values = true)]
    settle: Duration,
    /// Replace the steps of files that have changed since they were added, and steps of the same
    /// times as new files.
    #[arg(help_heading = "Series", long)]
    replace: bool,
    /// Fields of each file: each step has all of them, and --step N --field NAME asks for one.
    #[arg(
        help_heading = "Input",
        long,
        value_name = "NAME[,NAME..]",
        value_delimiter = ',',
        conflicts_with = "field"
    )]
    fields: Vec<String>,
    /// Submit this command to Slurm, to begin at TIME (as `sbatch --begin` takes it: now, 02:00),
    /// and print the number of the job.
    #[arg(help_heading = "Slurm", long, value_name = "TIME")]
    submit: Option<String>,
    /// When the job begins, submit it again for a day later.
    #[arg(help_heading = "Slurm", long)]
    again: bool,
    /// Another option of sbatch, as --option=--partition=long; may be repeated.
    #[arg(help_heading = "Slurm", long, value_name = "OPTION", allow_hyphen_values = true, value_parser = super::slurm::parse_option)]
    option: Vec<String>,
    #[command(flatten)]
    pub choices: Choices,
    #[command(flatten)]
    machine: Machine,
    #[command(flatten)]
    scratch: InputScratch,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
}

fn parse_pattern(text: &str) -> std::result::Result<glob::Pattern, String> {
    glob::Pattern::new(text).map_err(|e| e.to_string())
}

/// What came of a night.
#[derive(Serialize, Default)]
struct Summary {
    archive: String,
    /// Steps that the archive had before.
    steps_before: usize,
    /// Names of the files that it did not have.
    new: Vec<String>,
    /// Files that have changed since they were added.
    changed: Vec<LeftOut>,
    added: Vec<StepSummary>,
    /// How wrong the surfaces of these steps are, where isovalues were given.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    surfaces: Vec<SurfaceErrors>,
    /// Names of files that were added without times, where other steps have times.
    without_time: Vec<String>,
    /// Numbers of steps that were replaced.
    replaced: Vec<u64>,
    skipped: Vec<LeftOut>,
    error: Option<String>,
    archive_bytes: Option<u64>,
    wall_seconds: f64,
    /// The exit code.
    code: u8,
}

/// A file that could not be used, or that has changed.
#[derive(Serialize)]
struct LeftOut {
    source: String,
    reason: String,
}

/// Does the work of a night, or submits it; returns the exit code.
pub(crate) fn run(args: &Args, talk: &Talk) -> Result<u8> {
    if let Some(time) = &args.submit {
        return super::print(&format!("{}\n", submit(&args.option, time)?)).map(|()| 0);
    }
    let job = std::env::var("SLURM_JOB_ID").ok();
    if args.again && job.is_none() {
        return Err(Error::usage("--again: this is no job of Slurm; add --submit TIME to make it one"));
    }
    // Submitted first, because the job's time may be over later. Its result is reported last,
    // because the work matters more.
    let next = if args.again { submit(&args.option, "now+1day").map(drop) } else { Ok(()) };
    let (started, mut summary) = (Instant::now(), Summary::default());
    let done = add(args, talk, &mut summary).and(next);
    summary.archive = args.archive.display().to_string();
    summary.wall_seconds = started.elapsed().as_secs_f64();
    match &done {
        Ok(()) if summary.error.is_some() => summary.code = super::TARGET_NOT_MET,
        Ok(()) => {}
        Err(error) => (summary.code, summary.error) = (error.exit_code(), Some(error.to_string())),
    }
    let kept = keep(&args.archive, job, &summary);
    if args.json {
        super::print_json("nightly", &summary)?
    } else {
        super::print(&in_words(&summary, false))?
    }
    let is_said = !args.json && (!summary.skipped.is_empty() || !summary.changed.is_empty());
    match done {
        // The summary has the reasons already.
        Err(_) if is_said => {
            kept?;
            super::print_error(&left_out_text(&summary));
            return Ok(summary.code);
        }
        done => done.and(kept)?,
    }
    // All other errors are printed by the caller.
    summary.error.iter().for_each(|unmet| super::print_error(unmet));
    Ok(summary.code)
}

/// The files that were left out, by their names.
fn left_out_text(summary: &Summary) -> String {
    let all = summary.skipped.iter().chain(&summary.changed).map(|s| &*s.source);
    format!("not used, for the reasons above: {}", all.collect::<Vec<_>>().join(", "))
}

/// Does the night's work; what came of it is in the summary as far as it went.
///
/// # Errors
/// Those of `reduce` and `append`; where only some files could not be used, one of exit code 1.
fn add(args: &Args, talk: &Talk, summary: &mut Summary) -> Result<()> {
    let there = match args.archive.join("manifest.zst").exists() {
        true => Archive::open(&args.archive)?.info()?.steps,
        false => vec![],
    };
    summary.steps_before = there.len();
    let (mut files, known): (Vec<_>, Vec<_>) =
        settled(args)?.into_iter().partition(|file| !there.iter().any(|step| step.source == name_of(file)));
    summary.new = files.iter().map(|file| name_of(file)).collect();
    if !known.is_empty() {
        let cancel = signals::cancel_token();
        let changed = changed_sources(&args.archive, &known, &args.read.options()?, &cancel)?;
        for (file, reason) in changed {
            summary.changed.push(LeftOut { source: name_of(&file), reason });
            files.extend(Some(file).filter(|_| args.replace));
        }
        sort_by_names(&mut files);
    }
    let steps = usable(args, &files, &mut summary.skipped)?;
    if !steps.is_empty() {
        let report = match write(args, talk, steps, there.is_empty()) {
            Err(e) if files.len() == 1 && matches!(e.exit_code(), 2 | 5) && summary.skipped.is_empty() => {
                summary.skipped.push(LeftOut { source: name_of(&files[0]), reason: e.to_string() });
                return Err(e);
            }
            report => report?,
        };
        let unmet = super::reduce::unmet(&report).map(|why| format!("{}: {why}", args.archive.display()));
        let left_out = report
            .skipped
            .into_iter()
            .map(|s| LeftOut { source: name_of(Path::new(&s.source)), reason: s.reason });
        for file in left_out {
            // Each field of a step may be left out.
            if args.fields.is_empty() || summary.skipped.iter().all(|s| s.source != file.source) {
                summary.skipped.push(file);
            }
        }
        summary.error = unmet;
        summary.without_time = without_time(&there, &report.steps);
        (summary.added, summary.archive_bytes) = (report.steps, Some(report.archive_bytes));
        (summary.replaced, summary.surfaces) = (report.replaced, report.surfaces);
        if args.replace {
            let is_left = |file: &LeftOut| summary.skipped.iter().any(|s| s.source == file.source);
            summary.changed.retain(is_left);
        }
    }
    if let Some(first) = summary.skipped.first() {
        let what = format!("{} of {} new files", summary.skipped.len(), files.len());
        let why = std::io::Error::other(format!("{}: {}", first.source, first.reason));
        return Err(Error::io("use", what, why));
    }
    let Some(first) = summary.changed.first() else { return Ok(()) };
    let what = text::plural(summary.changed.len() as u64, "changed file");
    let why = std::io::Error::other(format!("{}: {}: add --replace", first.source, first.reason));
    Err(Error::io("keep", what, why))
}

/// Makes the archive of the steps, or adds them to it.
fn write(args: &Args, talk: &Talk, steps: Vec<StepSource>, first: bool) -> Result<ReduceReport> {
    let run = args.machine.run_until(&args.scratch, talk, signals::cancel_token());
    let run = RunSettings { keep_going: true, ..run };
    let bar = talk.progress();
    let report = if first {
        let settings = args.choices.settings()?;
        let reduction = Reduction::of_steps(steps).settings(settings).resources(run.resources);
        let reduction = reduction.isovalues(args.choices.isovalues());
        reduction.keep_going(true).progress(&*bar).write(&args.archive)
    } else {
        let addition = Addition::of_steps(steps).replace(args.replace).keep_going(run.keep_going);
        // The first night chose the precision: later ones may have errors beyond the target.
        let addition = addition.isovalues(args.choices.isovalues()).judged_by(args.choices.target()?);
        addition.resources(run.resources).progress(&*bar).append_to(&args.archive)
    };
    bar.end();
    report
}

fn name_of(file: &Path) -> String {
    file.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The files that match and are not written to any more, by the numbers in their names.
///
/// # Errors
/// [`Error::BadInput`] where the folder cannot be read: it may not be mounted tonight.
fn settled(args: &Args) -> Result<Vec<PathBuf>> {
    let refused =
        |e: std::io::Error| Error::bad_input(&args.folder, "folder", "one that can be read", e.to_string());
    let limit = SystemTime::now() - args.settle;
    let mut files = vec![];
    for entry in std::fs::read_dir(&args.folder).map_err(refused)? {
        let path = entry.map_err(refused)?.path();
        // If a file cannot be examined here, the reader says why it is left out.
        let written = path.metadata().and_then(|about| about.modified());
        if args.pattern.matches(&name_of(&path)) && written.map_or(true, |time| time <= limit) {
            files.push(path);
        }
    }
    let archive = args.archive.canonicalize().ok();
    files.retain(|file| archive.is_none() || file.canonicalize().ok() != archive);
    sort_by_names(&mut files);
    Ok(files)
}

/// The steps in the files by their times, then those without. A file whose steps cannot be found is
/// left out.
///
/// # Errors
/// That of the first file, where no file has steps; [`Error::Usage`] for flags that contradict each
/// other.
fn usable(args: &Args, files: &[PathBuf], left_out: &mut Vec<LeftOut>) -> Result<Vec<StepSource>> {
    let (options, mut first_error) = (args.read.options()?, None);
    let mut found: Vec<Vec<StepSource>> = vec![];
    for file in files {
        let input = std::slice::from_ref(file);
        let steps = match &args.fields[..] {
            [] => steps_of(input, &options).map(|steps| steps.into_iter().map(|step| vec![step]).collect()),
            fields => steps_of_fields(input, fields, &options).map(|steps| by_moment(&steps, fields.len())),
        };
        match steps {
            Ok(steps) => found.extend::<Vec<_>>(steps),
            Err(e) => {
                left_out.push(LeftOut { source: name_of(file), reason: e.to_string() });
                first_error.get_or_insert(e);
            }
        }
    }
    let time = |fields: &[StepSource]| fields[0].time.filter(|time| time.is_finite());
    found.sort_by(|a, b| match (time(a), time(b)) {
        (Some(a), Some(b)) => a.total_cmp(&b),
        (a, b) => a.is_none().cmp(&b.is_none()),
    });
    let steps: Vec<StepSource> = match args.fields.is_empty() {
        true => found.into_iter().flatten().collect(),
        false => by_field(&args.fields, &found),
    };
    first_error.filter(|_| steps.is_empty()).map_or(Ok(steps), Err)
}

/// The names of the files that were added without times, where other steps have times.
fn without_time(there: &[StepSummary], added: &[StepSummary]) -> Vec<String> {
    let mut names: Vec<String> = vec![];
    if there.iter().chain(added).any(|step| step.time.is_some()) {
        for step in added.iter().filter(|step| step.time.is_none()) {
            if names.last() != Some(&step.source) {
                names.push(step.source.clone());
            }
        }
    }
    names
}

/// Steps of one field after another, as the fields of each step.
fn by_moment(steps: &[StepSource], fields: usize) -> Vec<Vec<StepSource>> {
    let count = steps.len() / fields;
    let fields_of = |moment: usize| (0..fields).map(|n| steps[n * count + moment].clone()).collect();
    (0..count).map(fields_of).collect()
}

/// The fields of each step, as steps of one field after another.
fn by_field(fields: &[String], found: &[Vec<StepSource>]) -> Vec<StepSource> {
    let of_field = |(n, name): (usize, &String)| -> Vec<StepSource> {
        let numbered = (0..).zip(found);
        numbered.map(|(moment, fields)| fields[n].clone().as_field(name, Some(moment))).collect()
    };
    fields.iter().enumerate().flat_map(of_field).collect()
}

/// Writes the summary next to the archive, as JSON and in words, each whole or not at all.
fn keep(archive: &Path, job: Option<String>, summary: &Summary) -> Result<()> {
    let folder = work_folder(archive).join("nightly");
    std::fs::create_dir_all(&folder).map_err(|e| Error::io("create the folder", &folder, e))?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    // Two short runs may end within a second.
    let name = format!("{}-{}", date(now), job.unwrap_or_else(|| std::process::id().to_string()));
    for (form, text) in [("json", super::json_line("nightly", summary)?), ("txt", in_words(summary, true))] {
        isospan::bytes::write_file(&folder.join(format!("{name}.{form}")), text.as_bytes())?;
    }
    Ok(())
}

/// A time of UTC, of seconds since 1970: 2026-11-25T023000Z.
fn date(seconds: u64) -> String {
    let (days, second) = (seconds / 86_400, seconds % 86_400);
    // A year that begins in March has its leap day at the end: 400 of them are 146 097 days, and
    // the 719 468 days up to 1970 begin with one. See Hinnant, "chrono-compatible low-level date
    // algorithms".
    let (era, day) = ((days + 719_468) / 146_097, (days + 719_468) % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let (month, later) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    let (hour, minute, second) = (second / 3_600, second / 60 % 60, second % 60);
    format!("{:04}-{month:02}-{day:02}T{hour:02}{minute:02}{second:02}Z", era * 400 + year + later)
}

/// A summary in words; the error too, unless that is printed apart.
fn in_words(s: &Summary, with_error: bool) -> String {
    let mut out = format!("{}: exit code {}\n", s.archive, s.code);
    let [before, new, added] = [s.steps_before, s.new.len(), s.added.len()].map(|n| text::count(n as u64));
    let _ = writeln!(out, "  files      {new} new");
    let _ = writeln!(out, "  steps      {before} before, {added} added");
    if !s.replaced.is_empty() {
        let numbers: Vec<String> = s.replaced.iter().map(|n| text::count(*n)).collect();
        let _ = writeln!(out, "  replaced   {}", numbers.join(", "));
    }
    if !s.without_time.is_empty() {
        let _ = writeln!(out, "  no times   {}: after all others", s.without_time.join(", "));
    }
    for left_out in &s.skipped {
        let _ = writeln!(out, "  left out   {}: {}", left_out.source, left_out.reason);
    }
    for changed in &s.changed {
        let (file, reason) = (&changed.source, &changed.reason);
        let _ = writeln!(out, "  changed    {file}: {reason}; --replace takes it anew");
    }
    if let Some(error) = s.error.as_ref().filter(|_| with_error) {
        let _ = writeln!(out, "  error      {error}");
    }
    out += &super::reduce::surface_lines(Path::new(&s.archive), &s.surfaces, s.added.len() > 1);
    let _ = writeln!(out, "  time       {}", text::duration(Duration::from_secs_f64(s.wall_seconds)));
    out
}

/// Gives Slurm this command as a job, without `--submit`; returns the job's number.
fn submit(options: &[String], begin: &str) -> Result<String> {
    let (program, words) = super::slurm::own_command()?;
    let script = job_script(&program, words, options)?;
    let failed = |e: std::io::Error| Error::io("run", "sbatch", e);
    let mut sbatch = Command::new("sbatch");
    sbatch.args(["--parsable", &format!("--begin={begin}")]);
    sbatch.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut sbatch = sbatch.spawn().map_err(failed)?;
    // Where it does not read to the end, it says why.
    let _ = sbatch.stdin.take().map(|mut input| input.write_all(script.as_bytes()));
    let out = sbatch.wait_with_output().map_err(failed)?;
    if !out.status.success() {
        let why = String::from_utf8_lossy(&out.stderr).trim().replace('\n', "; ");
        return Err(failed(std::io::Error::other(format!("{}: {why}", out.status))));
    }
    // "NUMBER;CLUSTER" where there are several.
    Ok(String::from_utf8_lossy(&out.stdout).trim().split(';').next().unwrap_or_default().to_owned())
}

/// The script of a job: one runs at a time, is started again after its node died, and gets a signal
/// to end two minutes before its time is over.
fn job_script(program: &Path, words: Vec<OsString>, options: &[String]) -> Result<String> {
    let mut script = String::from(
        "#!/bin/bash\n#SBATCH --job-name=isospan-nightly\n#SBATCH --dependency=singleton\n#SBATCH --requeue\n\
         #SBATCH --open-mode=append\n#SBATCH --signal=B:TERM@120\n",
    );
    options.iter().for_each(|option| script += &format!("#SBATCH {option}\n"));
    script += "exec ";
    script += &super::slurm::quoted(program)?;
    for word in without_submit(words) {
        script += &format!(" {}", super::slurm::quoted(Path::new(&word))?);
    }
    Ok(script + "\n")
}

/// The words of a command without `--submit TIME` or `--submit=TIME`.
fn without_submit(words: Vec<OsString>) -> Vec<OsString> {
    let (mut kept, mut words) = (vec![], words.into_iter());
    while let Some(word) = words.next() {
        match word.to_str() {
            Some("--submit") => drop(words.next()),
            Some(text) if text.starts_with("--submit=") => {}
            _ => kept.push(word),
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, expected) in [
            (0, "1970-01-01T000000Z"),
            (951_782_399, "2000-02-28T235959Z"),
            (951_782_400, "2000-02-29T000000Z"),
            (951_868_800, "2000-03-01T000000Z"),
            (1_798_761_599, "2026-12-31T235959Z"),
            (4_107_542_400, "2100-03-01T000000Z"),
        ] {
            assert_eq!(date(seconds), expected);
        }
    }

    #[test]
    fn a_job_is_the_command_that_submits_it() {
        let given =
            ["nightly", "/d", "it's *.vti", "--submit", "02:00", "a.isospan", "--submit=now", "--again"];
        let script = job_script(Path::new("/b/isospan"), given.map(Into::into).to_vec(), &["-p x".into()]);
        let script = script.unwrap();
        assert!(script.starts_with("#!/bin/bash\n#SBATCH --job-name=isospan-nightly\n"), "{script}");
        let command = r"exec '/b/isospan' 'nightly' '/d' 'it'\''s *.vti' 'a.isospan' '--again'";
        assert!(script.ends_with(&format!("#SBATCH -p x\n{command}\n")), "{script}");
    }
}
