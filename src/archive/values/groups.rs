//! Bricks of a lattice that share a block of a file.
//!
//! A brick may take some ten bytes, fewer than a block's entry in the directory. So some bricks in
//! a row are put into one block, with the length of each but the last before them. How many these
//! are follows from the number of blocks of the chunk.

use super::ValueBlocks;
use crate::archive::wire::{Cursor, Malformed, put_varint};
use std::ops::Range;

/// Bytes of a block of several bricks, on average, at most.
const MOST_BYTES: usize = 2048;
/// Bricks in a block, at most: a power of two.
pub(crate) const MOST_BRICKS: usize = 64;

/// Where the bricks of a chunk are in the blocks of its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrickGroups {
    bricks: usize,
    /// Bricks in a block; the last one has the rest.
    size: usize,
}

impl BrickGroups {
    /// How values are stored in `stored` blocks; `None` where that is no such number.
    pub fn of(blocks: &ValueBlocks, stored: u64) -> Option<Self> {
        let bricks = blocks.bricks.len();
        let groups = stored.checked_sub((blocks.stored_count() - bricks) as u64)?;
        let mut sizes = (0..).map(|n| 1usize << n).take_while(|&size| size <= MOST_BRICKS);
        let size = sizes.find(|size| bricks.div_ceil(*size) as u64 == groups)?;
        Some(Self { bricks, size })
    }

    /// The number of the stored block that has a block of values.
    pub fn stored_block(&self, block: usize) -> u64 {
        match block.checked_sub(self.bricks) {
            None => (block / self.size) as u64,
            Some(behind) => (self.bricks.div_ceil(self.size) + behind) as u64,
        }
    }

    /// Whether a block of values may share its stored block with others.
    pub fn is_shared(&self, block: usize) -> bool {
        block < self.bricks && self.size > 1
    }

    /// The bytes of a block of values in those of the stored block that has it.
    ///
    /// # Errors
    /// When the stored block has other lengths than those of its bricks.
    pub fn part(&self, block: usize, bytes: &[u8]) -> Result<Range<usize>, Malformed> {
        if !self.is_shared(block) {
            return Ok(0..bytes.len());
        }
        let (first, wanted) = (block / self.size * self.size, block % self.size);
        let last = (self.bricks - first).min(self.size) - 1;
        let mut c = Cursor::new(bytes);
        let (mut before, mut own) = (0u64, None);
        for n in 0..last {
            let length = c.varint("length of a brick")?;
            own = if n == wanted { Some((before, length)) } else { own };
            before = before.saturating_add(length);
        }
        let all = c.rest();
        let rest = (all.len() as u64).checked_sub(before);
        let rest = rest.ok_or_else(|| {
            Malformed::new("lengths of bricks", format!("at most {} bytes", all.len()), before.to_string())
        })?;
        let (start, length) = own.unwrap_or((before, rest));
        let start = bytes.len() - all.len() + start as usize;
        Ok(start..start + length as usize)
    }
}

/// Puts the bricks that the blocks of a chunk begin with together.
pub fn group_bricks(mut encoded: Vec<Vec<u8>>, blocks: &ValueBlocks) -> Vec<Vec<u8>> {
    let bricks = blocks.bricks.len();
    let bytes = encoded[..bricks].iter().map(Vec::len).sum::<usize>().max(1);
    let fits = (MOST_BYTES * bricks / bytes).clamp(1, MOST_BRICKS);
    let size = 1 << fits.ilog2();
    let others = encoded.split_off(bricks);
    let together = |group: &[Vec<u8>]| {
        let mut block = vec![];
        group[..group.len() - 1].iter().for_each(|brick| put_varint(&mut block, brick.len() as u64));
        block.extend(group.iter().flatten());
        block
    };
    // A number of blocks stands for the least size that gives it.
    let groups = bricks.div_ceil(size);
    let size = (0..).map(|n| 1 << n).find(|&least| bricks.div_ceil(least) == groups).unwrap_or(size);
    encoded.chunks(size).map(together).chain(others).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bricks_are_found_in_their_groups() {
        for bricks in [1, 2, 3, 7, 64, 65, 200] {
            for length in [0, 1, 100, 900, 5000] {
                let values = 16 * bricks;
                let blocks = ValueBlocks::new(vec![[2, 2, 2]; bricks], values + 1500, values + 4000);
                let all: Vec<Vec<u8>> = (0..bricks + 2)
                    .map(|n| (0..(length + n % 3)).map(|i| (n * 7 + i) as u8).collect())
                    .collect();
                let stored = group_bricks(all.clone(), &blocks);
                let groups = BrickGroups::of(&blocks, stored.len() as u64).unwrap();
                for (n, brick) in all.iter().enumerate() {
                    let block = &stored[groups.stored_block(n) as usize];
                    assert_eq!(&block[groups.part(n, block).unwrap()], brick, "{bricks} {length} {n}");
                    for cut in 0..block.len().min(70) {
                        let _ = groups.part(n, &block[..cut]);
                    }
                }
                assert!(length > 0 || bricks < 7 || stored.len() < bricks);
                assert!(BrickGroups::of(&blocks, stored.len() as u64 + 1000).is_none());
                assert!(BrickGroups::of(&blocks, 1).is_none());
            }
        }
    }

    #[test]
    fn lengths_that_lie_are_refused() {
        let blocks = ValueBlocks::new(vec![[2, 2, 2]; 4], 64, 64);
        let groups = BrickGroups::of(&blocks, 1).unwrap();
        let good = [1, 2, 0, 9, 8, 8, 5];
        assert_eq!((0..4).map(|n| groups.part(n, &good).unwrap().len()).collect::<Vec<_>>(), [1, 2, 0, 1]);
        for bad in [&[1, 2][..], &[1, 200, 1, 0], &[9, 9, 9, 1, 2], &[255; 40]] {
            assert!((0..4).all(|n| groups.part(n, bad).is_err()), "{bad:?}");
        }
    }
}
