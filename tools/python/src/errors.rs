//! Errors of the library as exceptions: a class for each kind, with what the error knows as
//! attributes.

use crate::words::in_keywords;
use isospan::Error;
use isospan::bytes::remote::is_remote;
use isospan::pipeline::ReduceReport;
use isospan_cli::commands::reduce::unmet;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::io::ErrorKind;
use std::path::Path;

/// The exception of an error.
pub(crate) fn exception(py: Python<'_>, error: &Error) -> PyErr {
    build(py, error).unwrap_or_else(|broken| broken)
}

/// An exception for arguments that make no sense.
pub(crate) fn usage(py: Python<'_>, message: impl Into<String>) -> PyErr {
    exception(py, &Error::usage(message))
}

/// Warns that the archive of a report does not meet its target, where that is so.
pub(crate) fn warn_unmet(py: Python<'_>, archive: &Path, report: &ReduceReport) -> PyResult<()> {
    let Some(why) = unmet(report) else { return Ok(()) };
    let text = format!("{}: written, but {why}", archive.display());
    py.import("isospan._errors")?.call_method1("_warn_unmet", (text,)).map(drop)
}

/// The system's number for an error that was passed on without it.
fn number_of(kind: ErrorKind) -> Option<i32> {
    match kind {
        ErrorKind::NotFound => Some(2),
        ErrorKind::PermissionDenied => Some(13),
        ErrorKind::AlreadyExists => Some(17),
        _ => None,
    }
}

fn build(py: Python<'_>, error: &Error) -> PyResult<PyErr> {
    let about = PyDict::new(py);
    let class = match error {
        Error::Io { doing, path, source } => {
            about.set_item("doing", doing)?;
            about.set_item("file", path)?;
            about.set_item("errno", source.raw_os_error().or_else(|| number_of(source.kind())))?;
            about.set_item("reason", source.to_string())?;
            "FileError"
        }
        Error::BadInput(bad) => {
            about.set_item("file", &bad.path)?;
            about.set_item("at", in_keywords(&bad.at.to_string()))?;
            about.set_item("offset", bad.at.offset())?;
            about.set_item("expected", in_keywords(&bad.expected))?;
            about.set_item("got", in_keywords(&bad.got))?;
            about.set_item("help", in_keywords(&bad.help))?;
            let is_missing = !is_remote(&bad.path) && !bad.path.exists();
            if is_missing { "MissingInputError" } else { "BadInputError" }
        }
        Error::Budget { resource, purpose, needed, available } => {
            about.set_item("resource", resource.to_string())?;
            about.set_item("purpose", purpose)?;
            about.set_item("needed", needed)?;
            about.set_item("available", available)?;
            "BudgetError"
        }
        Error::Incomplete { path, missing } => {
            about.set_item("file", path)?;
            about.set_item("missing", missing)?;
            "IncompleteError"
        }
        Error::Busy { path, writer } => {
            about.set_item("file", path)?;
            about.set_item("writer", writer)?;
            "BusyError"
        }
        Error::Cancelled => "Cancelled",
        Error::Usage(_) => "UsageError",
        Error::NoSuch(_) => "NoSuchError",
        _ => "Error",
    };
    let class = py.import("isospan._errors")?.getattr(class)?;
    let made =
        class.call_method("_of", (in_keywords(&error.to_string()), error.exit_code()), Some(&about))?;
    Ok(PyErr::from_value(made))
}
