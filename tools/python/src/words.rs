//! Settings in the words of Python: keywords. The library names settings ([`isospan::setting`]),
//! and the parser of the program names flags.

use crate::errors::{exception, usage};
use isospan::setting::{Setting, worded};
use isospan_cli::commands::grammar;
use pyo3::prelude::*;

/// An isovalue of a text, `600` or `50%` of a range of values.
#[pyfunction]
pub(crate) fn isovalue(py: Python<'_>, text: &str, range: Option<[f64; 2]>) -> PyResult<f64> {
    let value = grammar::value(text).map_err(|e| usage(py, format!("isovalue: {e}, not {text:?}")))?;
    value.of(range).map_err(|e| exception(py, &e))
}

/// A share of a text, `10%` or `1/10`, for the keyword of a name.
#[pyfunction]
pub(crate) fn share(py: Python<'_>, text: &str, name: &str) -> PyResult<f64> {
    grammar::share(text).map_err(|e| usage(py, format!("{name}: {e}, not {text:?}")))
}

/// A text with its settings as keywords: `memory="4GiB"`.
pub(crate) fn in_keywords(text: &str) -> String {
    worded(text, keyword)
}

fn keyword(setting: Setting, value: Option<&str>) -> String {
    let name = match setting {
        Setting::Interpolation => "interp",
        Setting::Replace => "force",
        Setting::ReplaceSteps => "replace",
        other => other.name(),
    };
    value.map_or_else(|| name.to_owned(), |value| format!("{name}={}", literal(value)))
}

/// A value as Python writes it: a number, a tuple, a name that stands for a value, or a text.
fn literal(value: &str) -> String {
    let is_plain = |item: &str| {
        let stands_for = !item.is_empty() && item.chars().all(|c| c.is_ascii_uppercase());
        stands_for || item.parse::<f64>().is_ok()
    };
    match value {
        "true" => "True".into(),
        "false" => "False".into(),
        value if is_plain(value) => value.into(),
        list if list.split(',').all(is_plain) => format!("({})", list.replace(',', ", ")),
        text => format!("{text:?}"),
    }
}

/// What the parser of flags says, in keywords, without its hint at the program's help.
pub(crate) fn of_parser(text: &str) -> String {
    let text = text.split("; isospan").next().unwrap_or_default();
    let mut parts = text.split("--");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(|c: char| !c.is_ascii_lowercase() && c != '-').unwrap_or(part.len());
        let (flag, rest) = part.split_at(end);
        out += &if flag == "no-measure" { "measure=False".into() } else { flag.replace('-', "_") };
        // The name of its value follows: "--target-rms <E>".
        let of_value = rest.strip_prefix(" <").or_else(|| rest.strip_prefix("=<"));
        out += of_value.and_then(|rest| rest.split_once('>')).map_or(rest, |(_, rest)| rest);
    }
    out
}
