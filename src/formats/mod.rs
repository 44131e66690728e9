//! Other programs' files, both ways.

pub mod metaimage;
pub mod nifti;
pub mod npy;
pub mod nrrd;
pub mod obj;
pub mod ply;
pub mod raw;
pub mod stl;
pub mod surface;
mod text;
pub mod vtk_legacy;
pub mod vtk_xml;
pub mod vtp;

/// How to open a volume.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenOptions {
    /// The field to read, where the file has several.
    pub field: Option<String>,
    /// The layout of a headerless file; required for those, refused for others.
    pub raw: Option<raw::RawLayout>,
}
