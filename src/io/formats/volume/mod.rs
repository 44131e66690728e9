//! Formats of volumes, one file or folder each, and the writers of samples.

pub(in crate::formats) mod amira;
pub mod brick_map;
pub(in crate::formats) mod bricks;
pub(in crate::formats) mod dicom;
pub(in crate::formats) mod folder;
#[cfg(feature = "hdf5")]
pub mod hdf5;
#[cfg(not(feature = "hdf5"))]
#[path = "no_hdf5.rs"]
pub mod hdf5;
pub(in crate::formats) mod metaimage;
pub(in crate::formats) mod mrc;
pub(in crate::formats) mod netcdf;
pub(in crate::formats) mod nifti;
pub(in crate::formats) mod npy;
pub(in crate::formats) mod npz;
pub(in crate::formats) mod nrrd;
pub mod ome_zarr;
pub mod raw;
pub mod samples;
pub(in crate::formats) mod stack;
pub(in crate::formats) mod tiff;
pub(in crate::formats) mod zarr;

#[cfg(all(test, feature = "hdf5"))]
mod dialect_tests;
