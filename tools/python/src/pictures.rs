//! Pictures and pages, as the program makes them: keywords are its flags.

use crate::json::to_python;
use crate::reduce::parsed;
use crate::work::run;
use isospan_cli::commands::{self, Command};
use pyo3::prelude::*;
use std::ffi::OsString;

fn picture(command: Command) -> Option<Box<commands::render::Args>> {
    if let Command::Render(args) = command { Some(args) } else { None }
}

fn page(command: Command) -> Option<commands::publish::Args> {
    if let Command::Publish(args) = command { Some(args) } else { None }
}

/// `isospan render`.
#[pyfunction]
pub(crate) fn render<'py>(
    py: Python<'py>,
    arguments: Vec<OsString>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (args, talk) = parsed(py, arguments, picture)?;
    let report = run(py, progress.as_ref(), |cancel, progress| {
        commands::render::draw(&args, &talk, cancel.clone(), progress)
    })?;
    to_python(py, &report)
}

/// `isospan publish`.
#[pyfunction]
pub(crate) fn publish<'py>(py: Python<'py>, arguments: Vec<OsString>) -> PyResult<Bound<'py, PyAny>> {
    let (args, _) = parsed(py, arguments, page)?;
    let report = run(py, None, |cancel, _| commands::publish::publish(&args, cancel.clone()))?;
    to_python(py, &report)
}
