//! The coordinates of rectilinear and curvilinear grids, whose samples are read as those of a volume.

use super::{OpenOptions, folder, kind_of, vtk_legacy, vtk_xml};
use crate::bytes::ByteSource;
use crate::cells::NumberStream;
use crate::error::Result;
use std::path::Path;
use std::sync::Arc;

/// Where the samples of a grid are.
pub enum GridCoordinates {
    /// Tables of x, y and z.
    Axes([Vec<f64>; 3]),
    /// x, y, z of each sample, x fastest.
    Points(Box<dyn NumberStream>),
}

/// The coordinates of a file that [`open_volume`](super::open_volume) reads; `None` where its volume has a spacing.
///
/// # Errors
/// As [`open_volume`](super::open_volume).
pub fn open_coordinates(path: &Path, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
    if folder::is_several(path) {
        return Ok(None);
    }
    let source = Arc::new(ByteSource::open(path, options.io)?);
    match kind_of(&source) {
        Some(super::Kind::VtkXml) => vtk_xml::coordinates(&source),
        Some(super::Kind::VtkLegacy) => vtk_legacy::coordinates(&source),
        #[cfg(feature = "hdf5")]
        Some(super::Kind::Hdf5) => super::hdf5::coordinates(path, options),
        _ => Ok(None),
    }
}
