//! Reads other programs' files.
//!
//! [`open`] finds the format of a file by its first bytes or, where they do not show it, by its
//! name (`kinds`: one line a format). It hands the file to that format, which parses the header
//! once and checks every number of it against the file's length. What is open answers for all its
//! fields and steps: [`Opened`]. Uncompressed samples become a mapped
//! [`StridedVolume`](crate::volume::strided::StridedVolume); compressed samples and text become a
//! stream of slabs. A program adds formats of its own: [`OpenOptions::with_format`].
//!
//! World coordinates are the file's own: NRRD and MetaImage files usually say
//! left-posterior-superior, NIfTI right-anterior-superior. They are not converted into one another.
//!
//! ```text
//!  series ─▶ opened ─▶ kinds ─▶ mesh ─▶ volume, vtk ─▶ shared
//!                                       point_list ─▶ shared
//! ```

mod kinds;
mod mesh;
mod opened;
#[doc(hidden)]
pub mod point_list;
mod series;
#[doc(hidden)]
pub mod shared;
#[doc(hidden)]
pub mod volume;
#[doc(hidden)]
pub mod vtk;

pub use opened::{Input, Opened, open, open_input, open_mesh, open_volume};
pub use series::{FieldOfStep, StepSource, order_in_doubt, sort_by_names, steps_of, steps_of_fields};
pub use series::{counted_from, listed_files, without_frame};
pub use shared::coordinates;
pub use shared::format::{About, Dataset, Format, Head, Registry};
pub use shared::packed::{PackedFrames, UnpackedFrames};
pub use shared::{Frames, OpenOptions, RawLayout, pick_field};
pub use volume::brick_map;
pub use volume::folder::passed_over;
pub use volume::ome_zarr;
pub use volume::{raw, samples};

#[cfg(test)]
mod shared_data;
#[cfg(test)]
pub(crate) mod tests;
