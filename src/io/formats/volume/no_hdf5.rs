//! HDF5 and NetCDF-4 in a program that does not read them.

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::shared::arrays::Arrays;
use crate::formats::shared::format::{About, Dataset, Format, Head};
use std::path::Path;
use std::sync::Arc;

/// HDF5 and NetCDF-4.
pub(in crate::formats) struct Hdf5;

/// Lists of what is read do not name it.
static ABOUT: About = About { has_spacing: false, ..About::named("an HDF5 or NetCDF-4 file") };

impl Format for Hdf5 {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        head.is_hdf5()
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        Err(not_read(head.path))
    }
}

/// The datasets of a file, which are not read.
pub fn arrays(source: &Arc<ByteSource>, _: usize) -> Result<Arc<dyn Arrays>> {
    Err(not_read(source.path()))
}

/// The type of a VTKHDF file, which is not read.
pub fn vtk_kind(source: &Arc<ByteSource>) -> Result<Option<String>> {
    Err(not_read(source.path()))
}

fn not_read(path: &Path) -> Error {
    let got = "an HDF5 or NetCDF-4 file, and a program built without the feature hdf5";
    Error::bad_input(path, "kind of file", "a format that this program reads", got)
        .with_help("install it with `--features hdf5`")
}
