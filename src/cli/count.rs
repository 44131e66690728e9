//! `isospan count`: how large would the surface be?

use super::text;
use isospan::Result;
use std::path::PathBuf;

/// Count the active tetrahedra of an isovalue without extracting the surface.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The archive.
    archive: PathBuf,
    /// The isovalue.
    #[arg(long, short = 'i', value_name = "VALUE", allow_negative_numbers = true)]
    isovalue: f32,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let report = isospan::pipeline::count_active(&args.archive, args.isovalue)?;
    if args.json {
        return super::print_json(&report);
    }
    super::print(&format!(
        "isovalue {}: {} active tetrahedra of {}, in {} of {} blocks\n",
        args.isovalue,
        text::count(report.active_tetrahedra),
        text::count(report.tetrahedra),
        text::count(report.active_blocks),
        text::count(report.blocks)
    ))
}
