//! `isospan brick`: a bricked, mapped copy of a volume.

use super::input::InputArgs;
use super::progress::Talk;
use super::text;
use isospan::volume::bricked::BrickedVolume;
use isospan::{Error, Result, formats};
use std::path::PathBuf;

/// Copy a volume into bricks that are mapped instead of read: do it once for a compressed or slow input that is used often.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The volume.
    input: PathBuf,
    /// The file to write, NAME.bricks.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Memory for the slices in flight.
    #[arg(long, value_name = "SIZE", value_parser = text::parse_bytes, default_value = "256MiB")]
    memory: u64,
    /// Replace a file that is already there.
    #[arg(long)]
    force: bool,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    if args.output.exists() && !args.force {
        let text = format!("{} exists; choose another name, or --force to replace it", args.output.display());
        return Err(Error::usage(text));
    }
    if formats::open_coordinates(&args.input, &args.read.options()?)?.is_some() {
        return Err(isospan::Error::usage(format!(
            "{}: a bricked copy would lose the grid's coordinates; reduce the file itself",
            args.input.display()
        )));
    }
    let source = formats::open_volume(&args.input, &args.read.options()?)?;
    talk.detail(&args.read.io_text(&args.input));
    let bar = talk.progress();
    isospan::pipeline::brick(source, &args.output, args.memory, &super::signals::cancel_token(), &*bar)?;
    bar.end();
    let bricks = BrickedVolume::open(&args.output)?;
    let info = isospan::volume::VolumeReader::info(&bricks);
    let bytes =
        std::fs::metadata(&args.output).map_err(|e| Error::io("read the size of", &args.output, e))?.len();
    if args.json {
        return super::print_json(
            &serde_json::json!({ "file": args.output, "bytes": bytes, "dims": info.dims }),
        );
    }
    let [x, y, z] = info.dims;
    super::print(&format!(
        "{}: {x} x {y} x {z} {}, {}\n",
        args.output.display(),
        info.field.scalar.name(),
        text::bytes(bytes)
    ))
}
