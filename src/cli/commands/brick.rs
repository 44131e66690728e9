//! `isospan brick`: a bricked, mapped copy of a volume.

use super::grammar;
use super::input::InputArgs;
use super::output::{Force, exists, expect_a_file, expect_no_input};
use super::progress::Talk;
use super::step::archive_level;
use super::text;
use isospan::pipeline::is_archive;
use isospan::volume::VolumeSource;
use isospan::volume::bricked::BrickedVolume;
use isospan::{Archive, Error, Result, formats};
use std::path::PathBuf;

/// Copy a volume into bricks that are mapped instead of read.
///
/// That is for a compressed or slow input that is used often.
/// If the output is already the copy of this input, the command says so and ends.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan brick scan.nii.gz -o scan.bricks\n  isospan brick slices.tif -o slices.bricks --memory 1GiB"
)]
pub struct Args {
    /// The volume: a file or folder, or its address, s3://... or https://...; or an archive that is
    /// a pyramid.
    input: PathBuf,
    /// The file to write, NAME.bricks.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Memory for the slices that are being copied.
    #[arg(help_heading = "Resources", long, value_name = "SIZE", value_parser = grammar::memory, default_value = "256MiB", allow_hyphen_values = true)]
    memory: u64,
    #[command(flatten)]
    force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    read: InputArgs,
}

/// The samples of an archive.
fn archive_volume(args: &Args) -> Result<VolumeSource> {
    let options = args.read.options()?;
    let archive = Archive::open(&args.input)?.in_field(options.field.clone());
    let steps = archive.sources_of_level(archive_level(&options)?)?;
    let [step] = &steps[..] else {
        return Err(Error::usage(format!(
            "{}: has {} steps, and a bricked copy is of one: isospan export writes each as a file",
            args.input.display(),
            steps.len()
        )));
    };
    match step.open()? {
        formats::Input::Volume(volume) => Ok(volume),
        formats::Input::Mesh(_) => Err(Error::usage(format!("{} is no volume", args.input.display()))),
    }
}

/// The samples of a file.
fn file_volume(args: &Args) -> Result<VolumeSource> {
    let options = args.read.options()?;
    let file = formats::open(&args.input, &options)?;
    if file.coordinates(&options)?.is_some() {
        return Err(Error::usage(format!(
            "{}: a bricked copy would lose the grid's coordinates; reduce the file itself",
            args.input.display()
        )));
    }
    file.volume(&options)
}

pub(crate) fn run(args: &Args, talk: &Talk) -> Result<()> {
    let source = if is_archive(&args.input) { archive_volume(args)? } else { file_volume(args)? };
    expect_no_input(&args.output, source.info().files().iter().chain([&args.input]))?;
    expect_a_file(&args.output)?;
    talk.detail(&args.read.io_text(&args.input));
    let (bar, cancel) = (talk.progress(), super::signals::cancel_token());
    let made_before = args.output.exists() && !args.force.is_given();
    if !made_before {
        isospan::pipeline::brick(source, &args.output, args.memory, &cancel, &*bar)?;
    } else if !isospan::pipeline::is_bricked(source, &args.output, &cancel, &*bar)? {
        return Err(exists(&args.output));
    }
    bar.end();
    let bricks = BrickedVolume::open(&args.output)?;
    let info = isospan::volume::VolumeReader::info(&bricks);
    let bytes =
        std::fs::metadata(&args.output).map_err(|e| Error::io("read the size of", &args.output, e))?.len();
    if args.json {
        return super::print_json(
            "brick",
            &serde_json::json!({ "file": args.output, "bytes": bytes, "dims": info.dims, "made_before": made_before }),
        );
    }
    let [x, y, z] = info.dims;
    super::print(&format!(
        "{}: {x} x {y} x {z} {}, {}{}\n",
        args.output.display(),
        info.field.scalar.name(),
        text::bytes(bytes),
        if made_before { ": finished before, there was nothing left to make" } else { "" }
    ))
}
