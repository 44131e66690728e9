//! Headerless files: the user tells the layout.

use crate::volume::ScalarType;

/// The layout of a headerless file.
#[derive(Clone, Debug, PartialEq)]
pub struct RawLayout {
    /// Samples along x (fastest), y, z.
    pub dims: [u64; 3],
    /// Type of a sample.
    pub scalar: ScalarType,
    /// Whether samples are stored big-endian.
    pub big_endian: bool,
    /// Bytes before the first sample.
    pub offset: u64,
    /// World length of a voxel edge along each axis.
    pub spacing: [f64; 3],
}
