//! What is known of the blocks of tetrahedra before they are read: which vertices each has as own
//! ones, and how many tetrahedra. It lies in pages, so that a small question reads little.
//!
//! A block is a run of vertices with all tetrahedra of which each is the smallest; a run begins
//! where the one before ended.

use crate::archive::wire::{Cursor, Malformed, put_varint};
use isospan_mesh::mesh::tet::Tet;

/// Blocks of a page.
pub const PAGE_HEADS: usize = 256;

/// A block of tetrahedra before it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockHead {
    /// Its first own vertex.
    pub first: u32,
    /// Its own vertices.
    pub own: u32,
    /// Its tetrahedra.
    pub tets: u32,
}

impl BlockHead {
    /// Those of blocks that begin at some of the tetrahedra, which are in the order of their
    /// smallest vertices; the last start is the end of all.
    pub(super) fn all(tets: &[Tet], starts: &[u32]) -> Vec<Self> {
        let mut first = 0;
        let of_block = |w: &[u32]| {
            let end = tets[w[1] as usize - 1][0] + 1;
            let head = Self { first, own: end - first, tets: w[1] - w[0] };
            first = end;
            head
        };
        starts.windows(2).map(of_block).collect()
    }

    /// Pages of the heads of all blocks. `usual` is the number of tetrahedra near which most have
    /// theirs.
    pub(super) fn encode(heads: &[Self], usual: u32) -> Vec<Vec<u8>> {
        let page = |page: &[Self]| {
            let mut out = vec![];
            put_varint(&mut out, u64::from(page[0].first));
            put_varint(&mut out, u64::from(usual));
            for head in page {
                let more = i64::from(head.tets) - i64::from(usual);
                put_varint(&mut out, u64::from(head.own));
                put_varint(&mut out, (more << 1 ^ more >> 63) as u64);
            }
            out
        };
        heads.chunks(PAGE_HEADS).map(page).collect()
    }

    /// Decodes a page of `count` heads, of a chunk with `vertices` vertices.
    ///
    /// # Errors
    /// When the bytes are not such a page.
    pub fn decode(bytes: &[u8], count: usize, vertices: u32) -> Result<Vec<Self>, Malformed> {
        let mut c = Cursor::new(bytes);
        let (mut first, usual) = (c.varint32("first vertex")?, c.varint32("usual tetrahedra")?);
        // A head takes at least two bytes, so a lying count is found first.
        let mut heads = Vec::with_capacity(count.min(bytes.len()));
        for _ in 0..count {
            let (own, more) = (c.varint32("own vertices")?, c.varint("tetrahedra")?);
            let more = (more >> 1) as i64 ^ -((more & 1) as i64);
            let tets = i64::from(usual).checked_add(more).and_then(|tets| u32::try_from(tets).ok());
            let end = first.checked_add(own).filter(|&end| end <= vertices);
            let (Some(tets), Some(end)) = (tets, end) else {
                let expected = format!("runs of {vertices} vertices");
                return Err(Malformed::new("heads of blocks", expected, format!("{own} after {first}")));
            };
            heads.push(Self { first, own, tets });
            first = end;
        }
        c.end("heads of blocks")?;
        Ok(heads)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some(count: u32) -> Vec<BlockHead> {
        let head = |i: u32| BlockHead { first: 40 * i, own: 40, tets: (256 + i * 7919 % 90) - 45 };
        (0..count).map(head).collect()
    }

    #[test]
    fn heads_come_back() {
        for count in [1, 255, 256, 257, 1000] {
            let heads = some(count);
            let pages = BlockHead::encode(&heads, 256);
            assert_eq!(pages.len(), heads.len().div_ceil(PAGE_HEADS));
            let back = pages.iter().zip(heads.chunks(PAGE_HEADS));
            for (bytes, heads) in back {
                assert_eq!(BlockHead::decode(bytes, heads.len(), 40 * count).unwrap(), heads);
                assert!(BlockHead::decode(bytes, heads.len(), 40 * count - 1).is_err() || heads.len() == 256);
            }
        }
        assert!(BlockHead::encode(&[], 256).is_empty());
    }

    #[test]
    fn damaged_heads_never_panic() {
        let good = BlockHead::encode(&some(30), 256).remove(0);
        for i in 0..good.len() {
            assert!(BlockHead::decode(&good[..i], 30, 1200).is_err());
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[i] ^= 1 << bit;
                let _ = BlockHead::decode(&bad, 30, 1200);
            }
        }
    }
}
