//! Archives are made as the program makes them: keywords are its flags, and are parsed where it
//! parses them.

use crate::archive::Machine;
use crate::errors::{usage, warn_unmet};
use crate::json::to_python;
use crate::volume::{Volume, raised_or, steps};
use crate::words::{in_keywords, of_parser};
use crate::work::run;
use clap::Parser;
use isospan::exec::{CancelToken, Progress};
use isospan::pipeline::{Committed, Shards};
use isospan::{Reduction, Resources, Result};
use isospan_cli::commands::progress::Talk;
use isospan_cli::commands::{self, Cli, Command};
use pyo3::prelude::*;
use std::ffi::OsString;
use std::path::PathBuf;

/// What arguments of the program mean, to the command that is expected; the program's own message
/// where they mean nothing.
pub(crate) fn parsed<Args>(
    py: Python<'_>,
    arguments: Vec<OsString>,
    expected: impl Fn(Command) -> Option<Args>,
) -> PyResult<(Args, Talk)> {
    let quiet = [OsString::from("isospan"), OsString::from("--quiet")];
    let arguments: Vec<OsString> = quiet.into_iter().chain(arguments).collect();
    let cli = Cli::try_parse_from(&arguments)
        .map_err(|error| usage(py, of_parser(&commands::one_line(&error, &arguments))))?;
    let args = expected(cli.command).ok_or_else(|| usage(py, "this is another command"))?;
    Ok((args, cli.talk))
}

fn reduction(command: Command) -> Option<Box<commands::reduce::Args>> {
    if let Command::Reduce(args) = command { Some(args) } else { None }
}

fn addition(command: Command) -> Option<commands::append::Args> {
    if let Command::Append(args) = command { Some(args) } else { None }
}

/// The reduction that arguments ask for, of files, or of volumes in their place.
fn asked<'a>(
    args: &commands::reduce::Args,
    talk: &Talk,
    volumes: Option<&[Py<Volume>]>,
    cancel: &CancelToken,
    progress: &'a dyn Progress,
) -> Result<Reduction<'a>> {
    let run = args.run_settings(talk, cancel.clone());
    let (steps, settings) = match volumes {
        None => args.request(talk)?,
        Some(volumes) => {
            let mut steps = steps(volumes, &run, progress)?;
            args.steps.tell(&mut steps)?;
            (steps, args.choices.settings()?)
        }
    };
    let reduction = Reduction::of_steps(steps).settings(settings).resources(run.resources);
    let reduction = reduction.replace(run.replace).keep_going(run.keep_going);
    let reduction = reduction.isovalues(args.choices.isovalues());
    let reduction = match args.against()? {
        Some(source) => reduction.against(source),
        None => reduction,
    };
    Ok(reduction.progress(progress))
}

/// `isospan reduce`.
#[pyfunction]
pub(crate) fn reduce<'py>(
    py: Python<'py>,
    arguments: Vec<OsString>,
    volumes: Option<Vec<Py<Volume>>>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (args, talk) = parsed(py, arguments, reduction)?;
    let done = run(py, progress.as_ref(), |cancel, progress| {
        asked(&args, &talk, volumes.as_deref(), cancel, progress)?.write(&args.output)
    });
    let report = done.map_err(|e| raised_or(e, volumes.as_deref().unwrap_or_default()))?;
    warn_unmet(py, &args.output, &report)?;
    to_python(py, &report)
}

/// `isospan reduce --dry-run`; what is refused, and why, is in the report.
#[pyfunction]
pub(crate) fn estimate<'py>(
    py: Python<'py>,
    arguments: Vec<OsString>,
    volumes: Option<Vec<Py<Volume>>>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (args, talk) = parsed(py, arguments, reduction)?;
    let done = run(py, progress.as_ref(), |cancel, progress| {
        asked(&args, &talk, volumes.as_deref(), cancel, progress)?.estimate(&args.output)
    });
    let estimate = done.map_err(|e| raised_or(e, volumes.as_deref().unwrap_or_default()))?;
    let refused = estimate.check().err().map(|error| in_keywords(&error.to_string()));
    let report = to_python(py, &estimate)?;
    report.set_item("refused", refused)?;
    Ok(report)
}

/// `isospan append`.
#[pyfunction]
pub(crate) fn append<'py>(
    py: Python<'py>,
    arguments: Vec<OsString>,
    volumes: Option<Vec<Py<Volume>>>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (args, talk) = parsed(py, arguments, addition)?;
    let done = run(py, progress.as_ref(), |cancel, progress| {
        let run = args.run_settings(&talk, cancel.clone());
        let steps = match &volumes {
            None => args.sources(&talk)?,
            Some(volumes) => {
                let mut steps = steps(volumes, &run, progress)?;
                args.steps.tell(&mut steps)?;
                steps
            }
        };
        args.addition(steps, run).progress(progress).append_to(&args.archive)
    });
    to_python(py, &done.map_err(|e| raised_or(e, volumes.as_deref().unwrap_or_default()))?)
}

/// `isospan plan`, of the arguments of a reduction.
#[pyfunction]
pub(crate) fn plan<'py>(
    py: Python<'py>,
    arguments: Vec<OsString>,
    shards: u64,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (args, talk) = parsed(py, arguments, reduction)?;
    let report = run(py, progress.as_ref(), |cancel, progress| {
        let run = args.run_settings(&talk, cancel.clone());
        let (steps, settings) = args.request(&talk)?;
        let reduction = Reduction::of_steps(steps).settings(settings).resources(run.resources);
        let reduction = reduction.replace(run.replace).keep_going(run.keep_going);
        reduction.progress(progress).plan_shards(&args.output, shards)
    })?;
    to_python(py, &report)
}

/// `isospan status`.
#[pyfunction]
pub(crate) fn status(py: Python<'_>, archive: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    let report = run(py, None, |cancel, _| {
        Shards::at(&archive).resources(Resources::default().with_cancel(cancel.clone())).status()
    })?;
    to_python(py, &report)
}

/// `isospan work`.
#[pyfunction]
pub(crate) fn work<'py>(
    py: Python<'py>,
    archive: PathBuf,
    shard: &str,
    machine: Machine,
) -> PyResult<Bound<'py, PyAny>> {
    let resources = machine.resources(py)?;
    let report = run(py, None, |cancel, progress| {
        let shards = Shards::at(&archive).resources(resources.with_cancel(cancel.clone()));
        shards.progress(progress).work(shard.parse()?)
    })?;
    to_python(py, &report)
}

/// `isospan commit`.
#[pyfunction]
pub(crate) fn commit<'py>(
    py: Python<'py>,
    archive: PathBuf,
    machine: Machine,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let resources = machine.resources(py)?;
    let report = run(py, progress.as_ref(), |cancel, progress| {
        let shards = Shards::at(&archive).resources(resources.with_cancel(cancel.clone()));
        shards.progress(progress).commit()
    })?;
    if let Committed::Archive(report) = &report {
        warn_unmet(py, &archive, report)?;
    }
    to_python(py, &report)
}
