//! `isospan export` of a pyramid: the samples of a level for other programs.

use super::args::Args;
use crate::commands::output::{exists, expect_apart, expect_no_input};
use crate::commands::progress::Talk;
use crate::commands::text;
use isospan::formats::samples::SampleFormat;
use isospan::pipeline::{GridSettings, StepRange};
use isospan::{Archive, Error, Result};
use std::fmt::Write as _;

/// The format of the file to write.
fn format_of(args: &Args) -> Result<SampleFormat> {
    let is_mesh = args.output.extension().is_some_and(|e| e == "vtu" || e == "vtkhdf");
    if is_mesh {
        return Err(Error::usage(format!(
            "{} is a pyramid of samples, which has no tetrahedra for {}: write .vti, .nrrd, .nii.gz, .mha or .npy",
            args.archive.display(),
            args.output.display()
        )));
    }
    SampleFormat::from_path(&args.output)
}

/// Refuses a folder that is not to be written, before any work begins.
fn check_folder(args: &Args) -> Result<()> {
    if args.compress {
        return Err(Error::usage("OME-Zarr is always compressed: leave out --compress"));
    }
    expect_no_input(&args.output, [&args.archive])?;
    expect_apart(&args.output, [&args.archive])?;
    if args.output.exists() && !args.force.is_given() { Err(exists(&args.output)) } else { Ok(()) }
}

/// Writes a level of a pyramid.
pub(super) fn run(args: &Args, archive: &Archive, talk: &Talk) -> Result<()> {
    let format = if args.is_zarr() { None } else { Some(format_of(args)?) };
    match format {
        Some(format) => args.force.check_all(&format.files(&args.output), &[&args.archive])?,
        None => check_folder(args)?,
    }
    let step = archive.at(args.step.choice_among(&args.fields, archive)?)?;
    let settings = GridSettings {
        fields: args.fields(&step)?,
        level: args.level.unwrap_or(0),
        roi: args.roi,
        compress: args.compress,
        resources: args.machine.resources(args.scratch.scratch.clone(), talk),
    };
    let bar = talk.progress();
    let steps = args.steps.or(args.all_steps.then(StepRange::default));
    let report = match (format, steps) {
        (Some(format), _) => step.write_grid(&settings, &args.output, format, &*bar),
        (None, None) => step.write_ome_zarr(&settings, &args.output, args.force.is_given(), &*bar),
        (None, Some(steps)) => {
            let field = (!archive.fields().is_empty()).then(|| step.field().to_owned());
            let steps = Archive::open(&args.archive)?.in_field(field).steps(steps)?;
            steps.write_ome_zarr(&settings, &args.output, args.force.is_given(), &*bar)
        }
    };
    bar.end();
    let report = report?;
    report.notices.iter().for_each(|line| talk.note(line));
    if args.json {
        return crate::commands::print_json("export.grid", &report);
    }
    let ([x, y, z], [i, j, k]) = (report.dims, report.stride);
    let mut out = format!(
        "{}: {x} x {y} x {z} samples of {}, {}\n",
        args.output.display(),
        report.types.join(", "),
        text::bytes(report.file_bytes)
    );
    if report.level > 0 {
        let _ = writeln!(out, "  level {}: one sample for each {i} x {j} x {k} of the source", report.level);
    }
    if report.levels > 1 {
        let _ = writeln!(out, "  {} levels", report.levels);
    }
    if report.steps > 1 {
        let _ = writeln!(out, "  {} steps", report.steps);
    }
    if report.void > 0 {
        let _ = writeln!(out, "  NaN: {} where the source has no data", text::count(report.void));
    }
    if report.fields.len() > 1 {
        let _ = writeln!(out, "  fields: {}", report.fields.join(", "));
    }
    crate::commands::print(&out)
}
