//! VTK's formats, legacy and XML, which hold volumes and meshes.

pub(in crate::formats) mod legacy;
pub(in crate::formats) mod xml;
