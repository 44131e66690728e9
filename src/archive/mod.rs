//! The archive: a folder of segments that are written once, and a manifest.
//!
//! * [`segment`]: the container, numbered blocks with checksums, published whole or not at all.
//! * [`chunked`]: segments of a range of chunks.
//! * [`chunk`]: the mesh of a chunk as blocks that decode on their own.
//! * [`manifest`]: what the archive is of and which segments it has; written last.
//! * [`values`]: the values of a chunk's vertices.

pub mod chunk;
pub mod chunked;
mod grow;
mod grow_odds;
pub mod manifest;
mod publish;
mod range_coder;
pub mod segment;
pub mod summary;
mod tuples;
pub mod values;
pub(crate) mod wire;

pub use publish::TEMPORARY_MARK;
pub use wire::Malformed;
