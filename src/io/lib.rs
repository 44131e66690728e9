//! isospan-io reads what other programs wrote, out of core: boxes of samples of volumes, and blocks
//! of cells of unstructured meshes, from files, folders, object stores and web servers.
//!
//! * [`formats`] finds the format of a file and opens it: [`formats::open_volume`],
//!   [`formats::open_mesh`].
//! * [`volume`] answers for boxes of samples ([`volume::VolumeReader`]): of a mapped file, of
//!   chunks that are decoded when they are needed, or of the program's own.
//! * [`cells`] are points, cells and values of a mesh, in blocks.
//! * [`bytes`] reads ranges of files and of servers, and publishes files in one step.
//! * [`exec`] has the budget of memory, cancellation and progress.
//!
//! Sizes of a header never allocate unchecked, and every error names the file, the place, what was
//! expected and what was found ([`Error`]).

#[cfg(target_endian = "big")]
compile_error!(
    "isospan is for machines whose integers begin with the lowest byte: on s390x, Hammersley points were wrong"
);

pub mod bytes;
pub mod cells;
pub mod error;
pub mod exec;
#[cfg(any(test, feature = "fixtures"))]
#[doc(hidden)]
pub mod fixtures;
pub mod formats;
pub mod geom;
pub mod grid;
pub mod setting;
pub mod volume;

pub use error::{Error, ErrorKind, Result};
