//! Flags as keywords of Python: `tools/python/keywords` writes the package's signatures from what
//! `isospan man --keywords COMMAND` prints.

use super::grammar::{Range, Size, Value};
use super::times::Times;
use clap::builder::ArgAction;
use clap::{Arg, Command};
use isospan::pipeline::{Bound, Length, NanPolicy};
use std::any::TypeId;
use std::fmt::Write as _;
use std::path::PathBuf;

/// What Python gives in another way, or does itself.
const OTHERS: [&str; 6] = ["output", "dry-run", "json", "help", "version", "shards"];

/// The keywords of a command, a line each, as a signature has them.
pub(super) fn of(command: &Command) -> String {
    let mut out = String::new();
    for arg in command.get_arguments().filter(|arg| !arg.is_global_set()) {
        let Some(flag) = arg.get_long().filter(|flag| !OTHERS.contains(flag)) else { continue };
        let _ = writeln!(out, "    {},", keyword(flag, arg));
    }
    out
}

fn keyword(flag: &str, arg: &Arg) -> String {
    // What is not done is said as what is done.
    if let Some(done) = flag.strip_prefix("no-") {
        return format!("{done}: bool = True");
    }
    let name = flag.replace('-', "_");
    if matches!(arg.get_action(), ArgAction::SetTrue) {
        return format!("{name}: bool = False");
    }
    if arg.get_value_parser().type_id() == TypeId::of::<usize>() {
        return format!("{name}: int = 0");
    }
    format!("{name}: {} | None = None", type_of(arg))
}

/// The type of a value; its text is always taken, too.
fn type_of(arg: &Arg) -> &'static str {
    let id = arg.get_value_parser().type_id();
    let is = |types: &[TypeId]| types.iter().any(|of| id == *of);
    if is(&[TypeId::of::<PathBuf>()]) {
        "PathLike"
    } else if is(&[TypeId::of::<u32>(), TypeId::of::<u64>(), TypeId::of::<Size>()]) {
        "int | str"
    } else if is(&[TypeId::of::<f64>(), TypeId::of::<Bound>(), TypeId::of::<NanPolicy>()])
        || is(&[TypeId::of::<Length>()])
    {
        "float | str"
    } else if is(&[TypeId::of::<Value>()]) {
        "float | Sequence[float] | str"
    } else if is(&[TypeId::of::<[u32; 3]>(), TypeId::of::<[u64; 3]>()]) {
        "Sequence[int] | str"
    } else if is(&[TypeId::of::<[f64; 3]>(), TypeId::of::<Range>(), TypeId::of::<Times>()]) {
        "Sequence[float] | str"
    } else if matches!(arg.get_action(), ArgAction::Append) {
        "Sequence[str] | str"
    } else if arg.get_value_names().is_some_and(|names| names[0] == "NAME|N") {
        "int | str"
    } else {
        "str"
    }
}
