//! The index: which blocks can an isosurface cross?
//!
//! A tetrahedron of values `min` to `max` is active for an isovalue v when `min < v <= max`
//! ([`isospan_mesh::mesh::tet::is_active`]). Take (min, max) as a point of the plane, the *span
//! space*: the active ones are those left of v and not below it, a corner of the plane for any v
//! (Livnat, Shen, Johnson 1996, "A near optimal isosurface extraction algorithm using the span
//! space", NOISE). We index *blocks* of some hundred tetrahedra, by the range of all their values:
//! an index over single cells would be larger than the data (Chiang, Silva, Schroeder 1998).
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
//! **The tree on disk** is a kd-tree that alternates between min and max, as NOISE's, and without
//! pointers, as NOISE's: where the halves lie follows from the number of entries alone. Unlike
//! NOISE's, entries are in the leaves only, and a node has for each child the lowest min and the
//! highest max below it, so that a child is read only if its own bounds say that it can hold an
//! answer. Six levels of halving make one page of at most 64 children; a leaf page has at most 64
//! entries. Pages are blocks of a segment in depth-first order ([`build`] writes, [`query`] reads).
//!
//! **Cost.** Opening reads the segment's header and footer and one small block. A query of k
//! answers reads O(√(n/L) + k/L) pages of L entries. Building takes as much memory as it is given:
//! what does not fit is cut on disk ([`build`]); the bytes are the same.

pub mod build;
mod external;
pub(crate) mod page;
pub mod query;
mod subtree;

use crate::archive::chunked::BlockRange;
pub use build::{BuildSettings, IndexBuilder};
use byteorder::{ByteOrder, LE};
pub use query::SpanIndex;

/// Bytes of an entry on disk, and in the digest of a set of entries.
const RECORD: usize = 24;

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

/// The entries of a chunk, given the ranges of its blocks: one for each block that has tetrahedra
/// with finite values.
pub(crate) fn index_entries(chunk: u64, ranges: &[BlockRange]) -> impl Iterator<Item = Entry> {
    let entry = move |(block, r): (usize, &BlockRange)| {
        (r.tets > 0).then_some(Entry { min: r.min, max: r.max, chunk, block: block as u32, tets: r.tets })
    };
    ranges.iter().enumerate().filter_map(entry)
}

impl Entry {
    pub(crate) fn range(&self) -> BlockRange {
        BlockRange { min: self.min, max: self.max, tets: self.tets }
    }

    /// Where the block is; unique, and the order of answers.
    pub fn place(&self) -> (u64, u32) {
        (self.chunk, self.block)
    }
}

fn record(e: &Entry) -> [u8; RECORD] {
    let mut r = [0; RECORD];
    LE::write_f32_into(&[e.min, e.max], &mut r[..8]);
    LE::write_u64(&mut r[8..], e.chunk);
    LE::write_u32_into(&[e.block, e.tets], &mut r[16..]);
    r
}

/// A number for each `f32`, in the order of [`f32::total_cmp`].
pub(crate) fn ordered_key(v: f32) -> u32 {
    let bits = v.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// A set of entries, identified by a number: two sets without repetitions have the same digest only
/// if they are equal, short of chance (128 bits). Takes any number of entries, in any order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EntryDigest {
    /// Entries.
    pub count: u64,
    sum: u128,
}

impl EntryDigest {
    /// Takes an entry in.
    pub fn add(&mut self, e: &Entry) {
        self.count += 1;
        self.sum = self.sum.wrapping_add(xxhash_rust::xxh3::xxh3_128(&record(e)));
    }
}
