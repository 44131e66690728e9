//! The mesh of a chunk: which vertices it has, and its tetrahedra as blocks that decode on their
//! own.
//!
//! * `vertices`: the points that a chunk has, and those of other chunks that it uses.
//! * `chunk`: the blocks of tetrahedra, from `runs` of vertices, each coded by `connectivity` or as
//!   `tuples`.
//! * `from_points`: blocks that are not stored, since their tetrahedra follow from the points.
//! * `unpacked`: precomputed blocks of a step, mapped where they lie, on request.

pub(super) mod chunk;
pub(super) mod connectivity;
mod from_points;
mod runs;
mod tuples;
pub(super) mod unpacked;
pub(super) mod vertices;

pub use chunk::{ChunkEncoder, TetBlock, TetScratch};
pub use from_points::{StarRuns, sort_star};
pub use unpacked::{Unpacked, UnpackedChunk, UnpackedPlace, UnpackedWriter, unpacked_hash};
pub use vertices::{ChunkHeader, ChunkVertices, PAGE_FLAGS, PAGE_IDS, decode_flags, decode_ids, order_halo};
