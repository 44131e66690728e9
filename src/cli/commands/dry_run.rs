//! `isospan reduce --dry-run`: what the run would need, and whether it is there.

use super::text;
use isospan::Result;
use isospan::pipeline::{Estimate, SearchEstimate, Target};
use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

/// Prints an estimate; an error when the run would be refused.
pub(super) fn tell(estimate: &Estimate, output: &Path, json: bool) -> Result<()> {
    if json {
        super::print_json("estimate", estimate)?;
    } else {
        super::print(&in_words(estimate, output))?;
    }
    estimate.check()
}

fn in_words(e: &Estimate, output: &Path) -> String {
    let mut out = format!("{}: not made, a dry run\n", output.display());
    let mut row = |name: &str, value: String| {
        let _ = writeln!(out, "  {name:<10} {value}");
    };
    let free = |bytes: Option<u64>| bytes.map_or("unknown".to_owned(), text::bytes);
    row("samples", text::count(e.samples));
    if let Some(search) = &e.search {
        row("target", format!("found by trying: about {} tries; all else is of the first", search.tries));
    }
    row("points", format!("{} in {}", text::count(e.points), text::plural(e.chunks, "chunk")));
    row(
        "memory",
        format!(
            "{} given, at least {}, {} for all threads; {} at work at a time",
            text::bytes(e.memory),
            text::bytes(e.memory_least),
            text::bytes(e.memory_comfortable),
            text::plural(e.workers as u64, "chunk")
        ),
    );
    let (words, most) = match e.search {
        Some(SearchEstimate { target, archive_bytes: [least, most], .. }) => {
            // A size that is wanted is a bound; all else is a guess.
            let to = if matches!(target, Target::Size(_) | Target::Ratio(_)) { "to" } else { "to about" };
            (format!("{} {to} {}", text::bytes(least), text::bytes(most)), most)
        }
        None => (format!("about {}", text::bytes(e.archive_bytes)), e.archive_bytes),
    };
    row("archive", format!("{words} ({} free)", free(e.archive_free)));
    if let Some(source) = e.source_bytes {
        row("ratio", text::about_of(most, source));
    }
    match e.scratch_bytes {
        0 => row("scratch", "none".into()),
        n => row("scratch", format!("about {} ({} free)", text::bytes(n), free(e.scratch_free))),
    }
    if let Some(lost) = e.rounding {
        row("rounded", text::rounding_words(lost));
    }
    let roughly = |seconds: f64| text::rough_duration(Duration::from_secs(seconds.ceil() as u64));
    match &e.search {
        Some(search) => {
            let (one, all) = (roughly(e.seconds), roughly(search.seconds));
            row("time", format!("roughly {one}, and {all} for all tries"));
        }
        None => row("time", format!("roughly {}", roughly(e.seconds))),
    }
    out
}
