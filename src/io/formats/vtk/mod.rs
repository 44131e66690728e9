//! VTK's formats: legacy and XML, which hold volumes and meshes, and what its HDF5 files have in
//! common.

pub mod hdf;
pub(in crate::formats) mod legacy;
pub mod xml;
