//! The index: which blocks can an isosurface cross?
//!
//! A tetrahedron of values `min` to `max` is active for an isovalue v when `min < v <= max`
//! ([`crate::mesh::tet::is_active`]). Take (min, max) as a point of the plane, the *span space*: the active ones are those left of
//! v and not below it, a corner of the plane whatever v is (Livnat, Shen, Johnson 1996, "A near optimal isosurface
//! extraction algorithm using the span space", NOISE). We index *blocks* of some hundred tetrahedra, by the
//! range of all their values: an index over single cells would be larger than the data (Chiang, Silva, Schroeder 1998).
//!
//! ```text
//!  max │ · active ·│ ·  ·        each · a block; v is the isovalue
//!    v ├───────────┘  ·          a kd-tree halves the blocks by min, then by max, then by min …
//!      │  ·  ·    /  never:      and a query enters only the halves that can hold an active one
//!      │   ·   /     max < min
//!      └────/──────┴────── min
//!                  v
//! ```
//!
//! **The tree on disk** is a kd-tree that alternates between min and max, as NOISE's, and without pointers, as NOISE's: where
//! the halves lie follows from the number of entries alone. Unlike NOISE's, entries are in the leaves only, and a node
//! tells for each child the lowest min and the highest max below it, so that a child is read only if its own
//! bounds say that it can hold an answer. Six levels of halving make one page of at most 64 children; a leaf page has at
//! most 64 entries. Pages are blocks of a segment in depth-first order ([`build`] writes, [`query`] reads).
//!
//! **Cost.** Opening reads the segment's header and footer and one small block. A query of k answers reads O(√(n/L) + k/L) pages of L
//! entries. Building takes as much memory as it is given: what does not fit is cut on disk ([`build`]); the bytes are the same.

pub mod build;
mod external;
pub(crate) mod page;
pub mod query;

pub use build::{BuildSettings, IndexBuilder};
pub use query::SpanIndex;

/// One block, as a point of span space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Smallest value of the block's finite tetrahedra.
    pub min: f32,
    /// Largest value of the block's finite tetrahedra.
    pub max: f32,
    /// The chunk.
    pub chunk: u64,
    /// The tetrahedron block in the chunk, from 0.
    pub block: u32,
    /// Tetrahedra in the block.
    pub tets: u32,
}

impl Entry {
    /// Where the block is; unique, and the order of answers.
    pub fn place(&self) -> (u64, u32) {
        (self.chunk, self.block)
    }
}

/// A number for each `f32`, in the order of [`f32::total_cmp`].
pub(crate) fn ordered_key(v: f32) -> u32 {
    let bits = v.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// A set of entries, told by a number: two sets without repetitions have the same digest only if they are equal, short of
/// chance (128 bits). Takes any number of entries, in any order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EntryDigest {
    /// Entries.
    pub count: u64,
    sum: u128,
}

impl EntryDigest {
    /// Takes an entry in.
    pub fn add(&mut self, e: &Entry) {
        let mut bytes = [0; 24];
        bytes[..4].copy_from_slice(&e.min.to_le_bytes());
        bytes[4..8].copy_from_slice(&e.max.to_le_bytes());
        bytes[8..16].copy_from_slice(&e.chunk.to_le_bytes());
        bytes[16..20].copy_from_slice(&e.block.to_le_bytes());
        bytes[20..].copy_from_slice(&e.tets.to_le_bytes());
        self.count += 1;
        self.sum = self.sum.wrapping_add(xxhash_rust::xxh3::xxh3_128(&bytes));
    }
}
