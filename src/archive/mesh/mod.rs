//! The mesh of a chunk: which vertices it has, and its tetrahedra as blocks that decode on their
//! own.
//!
//! * `vertices`: the points that a chunk has, and those of other chunks that it uses.
//! * `heads`: what is known of blocks of tetrahedra before they are read.
//! * `chunk`: the blocks of tetrahedra, from `runs` of vertices, each coded by `connectivity` or as
//!   `tuples`.

pub(super) mod chunk;
pub(super) mod connectivity;
pub(super) mod heads;
mod runs;
mod tuples;
pub(super) mod vertices;

pub use chunk::{ChunkEncoder, TetBlock, TetScratch};
pub use heads::{BlockHead, PAGE_HEADS};
pub use vertices::{ChunkHeader, ChunkVertices, PAGE_FLAGS, PAGE_IDS, decode_flags, decode_ids, order_halo};
