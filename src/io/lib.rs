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
//! Nothing is read whole. Sizes of a header never allocate unchecked, and every error names the
//! file, the place, what was expected and what was found ([`Error`]).
//!
//! # Example
//!
//! A slice of a CT of 103 × 94 × 161 samples, whichever format it has:
//!
//! ```
//! use isospan_io::formats::{OpenOptions, open_volume};
//! use isospan_io::grid::IndexBox;
//! use isospan_io::volume::VolumeSource;
//! use std::path::Path;
//!
//! # fn main() -> isospan_io::Result<()> {
//! # std::env::set_current_dir("../..").unwrap();
//! let source = open_volume(Path::new("datasets/tooth/tooth.nhdr"), &OpenOptions::default())?;
//! let info = source.info();
//! println!("{}, {:?}, spacing {:?}", info.format, info.dims, info.geometry.spacing);
//!
//! // Raw samples are mapped; chunks and streams have readers of their own.
//! let VolumeSource::Random(reader) = source else { panic!("these are raw") };
//! let slice = IndexBox { lo: [0, 0, 80], hi: [103, 94, 81] };
//! let mut samples = vec![0.0; slice.len()];
//! reader.read_box(slice, &mut samples)?;
//! assert!(samples.iter().any(|&sample| sample > 800.0), "enamel is dense");
//! # Ok(())
//! # }
//! ```
//!
//! # Features
//!
//! * `hdf5` (default): HDF5 and NetCDF-4 volumes, by a pure-Rust reader.
//! * `remote` (default): files in object stores and on web servers. It brings an asynchronous
//!   runtime and TLS.
//! * `fixtures`: not for users, but for tests of several crates, which make files with it.

#![cfg_attr(docsrs, feature(doc_cfg))]

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
