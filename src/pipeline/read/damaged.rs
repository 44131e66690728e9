//! How a chunk is refused that verifies, but does not mean anything.

use crate::archive::chunked::ChunkSegment;
use isospan_io::error::Error;
use isospan_io::grid::ChunkId;

/// A block that verifies but does not mean anything: written by a faulty program.
pub(super) fn damaged(
    segment: &ChunkSegment,
    chunk: ChunkId,
    at: &str,
    what: &(impl std::fmt::Display + ?Sized),
) -> Error {
    Error::bad_input(
        segment.segment().path(),
        format!("chunk {}, {at}", chunk.0),
        "a chunk as FORMAT.md says",
        what.to_string(),
    )
    .with_help("reduce the source again")
}
