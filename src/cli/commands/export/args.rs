//! The flags of `isospan export`.

use crate::commands::grammar::{self, Range};
use crate::commands::machine::{Machine, OutputScratch};
use crate::commands::output::Force;
use crate::commands::step::StepArgs;
use isospan::formats::samples::SampleFormat;
use isospan::pipeline::{Roi, Step, StepRange};
use isospan::{Archive, Error, Result};
use std::path::PathBuf;

/// Write the tetrahedra or the samples of an archive to a file.
///
/// Tetrahedra are an unstructured grid, VTU or VTKHDF, with the values of each field at the points.
/// A level of a pyramid is a grid of samples: VTI, NRRD, NIfTI, MetaImage, TIFF or NPY; VTR and VTS
/// of a grid with coordinates. OME-Zarr has it and all coarser levels, and several steps. Where the
/// archive keeps whole numbers without loss, samples have the source's type; else they are float32,
/// or float64 where values are counted from an offset.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  isospan export scan.isospan -o scan.vtu --compress\n  isospan export scan.isospan -o skin.vtu --range 300:500\n  isospan export flow.isospan -o flow3.vtu --step 3 --fields T,p\n  isospan export brain.isospan -o brain.nii.gz\n  isospan export brain.isospan -o brain.ome.zarr\n  isospan export brain.isospan -o small.nrrd --level 2 --roi 40:200,40:200,:"
)]
pub struct Args {
    /// The archive: a folder, or its address, s3://... or https://...
    pub archive: PathBuf,
    /// The file to write. Of tetrahedra .vtu or .vtkhdf; of a pyramid .vti .vtr .vts .nrrd .nii
    /// .nii.gz .mha .mhd (with .raw) .tif or .npy, or the folder .zarr.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// The fields to write, where the archive has several [default: all; that of --field or of
    /// --step FIELD].
    #[arg(
        help_heading = "Series",
        long,
        value_name = "NAME[,NAME..]",
        value_delimiter = ',',
        conflicts_with = "field"
    )]
    pub(super) fields: Vec<String>,
    /// The level of a pyramid: 0 is the finest, 1 has every second sample along each axis, and so
    /// on; isospan info lists them [default: 0].
    #[arg(long, value_name = "L", value_parser = grammar::whole::<usize>, allow_negative_numbers = true)]
    pub(super) level: Option<usize>,
    /// Only tetrahedra whose corners all have values from LO to HI; either end may be omitted. 100%
    /// is the range of the values of the step. Of several fields, the first of --fields. Only
    /// blocks that can hold such tetrahedra are read.
    #[arg(long, value_name = "LO:HI", value_parser = grammar::range, allow_hyphen_values = true)]
    pub(super) range: Option<Range>,
    /// With --range: tetrahedra with at least one corner in the range.
    #[arg(long, requires = "range")]
    pub(super) any_corner: bool,
    /// Only tetrahedra whose bounding box touches a box, or the samples in it, ends included:
    /// I0:I1,J0:J1,K0:K1 in sample indices of the source, or world:X0:X1,Y0:Y1,Z0:Z1. An omitted
    /// end is that of the volume. Only chunks that touch the box are read.
    #[arg(long, value_name = "BOX", allow_hyphen_values = true, value_parser = grammar::region)]
    pub(super) roi: Option<Roi>,
    /// Of the remaining tetrahedra, keep only every K-th.
    #[arg(long, value_name = "K", value_parser = grammar::natural, allow_negative_numbers = true)]
    pub(super) every: Option<u64>,
    /// Compress the arrays of the file with zlib or gzip, which VTK, ParaView, ITK and NRRD's
    /// readers know. Of HDF5, this needs version 1.10. A .nii.gz is always compressed.
    #[arg(long)]
    pub(super) compress: bool,
    #[command(flatten)]
    pub(super) machine: Machine,
    #[command(flatten)]
    pub(super) scratch: OutputScratch,
    /// All steps, as .zarr alone has them.
    #[arg(help_heading = "Series", long, conflicts_with_all = ["step", "time", "steps"])]
    pub(super) all_steps: bool,
    /// As --all-steps, the steps from one number to another; either end may be omitted.
    #[arg(help_heading = "Series", long, value_name = "FIRST:LAST", value_parser = grammar::steps, conflicts_with_all = ["step", "time"], allow_hyphen_values = true)]
    pub steps: Option<StepRange>,
    #[command(flatten)]
    pub(super) step: StepArgs,
    #[command(flatten)]
    pub(super) force: Force,
    /// Print the result as JSON.
    #[arg(long)]
    pub(super) json: bool,
}

impl Args {
    /// Whether the output is a folder of OME-Zarr.
    pub(super) fn is_zarr(&self) -> bool {
        self.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("zarr"))
    }

    /// Refuses what is for the other kind of archive.
    pub(super) fn expect_of(&self, archive: &Archive) -> Result<()> {
        let path = archive.path().display();
        let of_tetrahedra = [("--range", self.range.is_some()), ("--every", self.every.is_some())];
        if (self.all_steps || self.steps.is_some()) && !(self.is_zarr() && archive.is_pyramid()) {
            return Err(Error::usage(
                "--all-steps and --steps are for pyramids written as .zarr: choose one with --step or --time",
            ));
        }
        match of_tetrahedra.into_iter().find(|(_, is_given)| *is_given) {
            Some((flag, _)) if archive.is_pyramid() => Err(Error::usage(format!(
                "{path} is a pyramid of samples, and {flag} chooses tetrahedra: leave it out; --roi and --level \
                 choose samples"
            ))),
            _ if self.level.is_some() && !archive.is_pyramid() => {
                Err(Error::usage(format!("{path} has tetrahedra and no levels: leave out --level")))
            }
            _ if archive.is_pyramid() => Ok(()),
            _ if self.is_zarr() || SampleFormat::from_path(&self.output).is_ok() => {
                Err(Error::usage(format!(
                    "{path} has tetrahedra, and {} is for samples: write .vtu or .vtkhdf, or samples with isospan probe \
                 --grid",
                    self.output.display()
                )))
            }
            _ => Ok(()),
        }
    }

    /// The fields that are written, none for that of the step alone.
    pub(super) fn fields(&self, step: &Step) -> Result<Vec<String>> {
        if !self.fields.is_empty() || self.step.names_field() {
            return Ok(self.fields.clone());
        }
        let fields = step.fields_here();
        if self.range.is_some() && fields.len() > 1 {
            return Err(Error::usage(format!(
                "--range is one of values of a field, and there are {}: name that field first in --fields",
                fields.join(", ")
            )));
        }
        let is_several = fields.len() > 1;
        Ok(fields.into_iter().filter(|_| is_several).map(str::to_owned).collect())
    }
}
