//! Segments of a range of chunks, each chunk a run of blocks.
//!
//! A mesh segment has for each chunk its header and its tetrahedron blocks ([`super::chunk`]), a value segment its value
//! blocks ([`super::values`]). The last block of the segment is the chunk table: how many blocks each chunk has.

use super::segment::{PlanHash, Segment, SegmentInfo, SegmentKind, SegmentWriter};
use super::wire::{Cursor, Malformed, put_varint};
use crate::error::{Error, Result};
use crate::grid::ChunkId;
use std::ops::Range;
use std::path::Path;

/// Writes chunks in order.
pub struct ChunkSegmentWriter {
    segment: SegmentWriter,
    first: ChunkId,
    block_counts: Vec<u64>,
}

impl ChunkSegmentWriter {
    /// Begins a segment whose first chunk is `first`.
    ///
    /// # Errors
    /// When the temporary file cannot be made.
    pub fn create(path: impl AsRef<Path>, kind: SegmentKind, plan: PlanHash, first: ChunkId) -> Result<Self> {
        Ok(Self { segment: SegmentWriter::create(path, kind, plan)?, first, block_counts: vec![] })
    }

    /// Appends the blocks of the next chunk.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn push_chunk(&mut self, blocks: &[Vec<u8>]) -> Result<()> {
        for block in blocks {
            self.segment.push_block(block)?;
        }
        self.block_counts.push(blocks.len() as u64);
        Ok(())
    }

    /// Writes the chunk table and publishes the file.
    ///
    /// # Errors
    /// When the file cannot be written, synced or renamed.
    pub fn finish(mut self) -> Result<SegmentInfo> {
        let mut table = vec![];
        put_varint(&mut table, self.first.0);
        put_varint(&mut table, self.block_counts.len() as u64);
        self.block_counts.iter().for_each(|&n| put_varint(&mut table, n));
        self.segment.push_block(&table)?;
        self.segment.finish()
    }
}

/// An open segment of chunks.
pub struct ChunkSegment {
    segment: Segment,
    first: u64,
    /// First block of each chunk, and the number of blocks before the table.
    starts: Vec<u64>,
}

impl ChunkSegment {
    /// Opens a segment; reads its header, footer and chunk table.
    ///
    /// # Errors
    /// As [`Segment::open`], and when the table is not that of this segment.
    pub fn open(path: impl AsRef<Path>, kind: SegmentKind, plan: Option<PlanHash>) -> Result<Self> {
        let segment = Segment::open(path, kind, plan)?;
        let Some(last) = segment.block_count().checked_sub(1) else {
            return Err(Error::bad_input(segment.path(), "block count", "at least 1", "0")
                .with_help("the file is not a segment of chunks"));
        };
        let mut table = vec![];
        segment.block(last, &mut table)?;
        let (first, starts) = read_table(&table, last).map_err(|m| m.in_block(segment.path(), last))?;
        Ok(Self { segment, first, starts })
    }

    /// The container: path, bytes read, verification.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// The chunks in the segment.
    pub fn chunks(&self) -> Range<u64> {
        self.first..self.first + self.starts.len() as u64 - 1
    }

    /// Number of blocks of a chunk.
    ///
    /// # Panics
    /// When the chunk is not in the segment.
    pub fn block_count(&self, chunk: ChunkId) -> u64 {
        let at = self.position(chunk);
        self.starts[at + 1] - self.starts[at]
    }

    /// The number in the segment of block `n` of a chunk.
    ///
    /// # Panics
    /// When the chunk is not in the segment or has no such block.
    pub fn block_number(&self, chunk: ChunkId, n: u64) -> u64 {
        assert!(n < self.block_count(chunk), "block {n} of {} of chunk {}", self.block_count(chunk), chunk.0);
        self.starts[self.position(chunk)] + n
    }

    /// Reads block `n` of a chunk into `out` (cleared first).
    ///
    /// # Errors
    /// When the block cannot be read or is damaged.
    ///
    /// # Panics
    /// When the chunk is not in the segment or has no such block.
    pub fn block(&self, chunk: ChunkId, n: u64, out: &mut Vec<u8>) -> Result<()> {
        self.segment.block(self.block_number(chunk, n), out)
    }

    /// The error for block `n` of a chunk whose bytes could not be decoded.
    pub fn blame(&self, chunk: ChunkId, n: u64, what: Malformed) -> Error {
        what.in_block(self.segment.path(), self.block_number(chunk, n))
    }

    fn position(&self, chunk: ChunkId) -> usize {
        let chunks = self.chunks();
        assert!(chunks.contains(&chunk.0), "chunk {} is not in {chunks:?}", chunk.0);
        (chunk.0 - self.first) as usize
    }
}

fn read_table(table: &[u8], blocks: u64) -> std::result::Result<(u64, Vec<u64>), Malformed> {
    let mut c = Cursor::new(table);
    let (first, n) = (c.varint("first chunk")?, c.varint("chunks")?);
    if n > c.rest().len() as u64 || first.checked_add(n).is_none() {
        return Err(Malformed::new("chunks", format!("at most {}", c.rest().len()), n.to_string()));
    }
    let mut starts = vec![0u64];
    for _ in 0..n {
        let before = starts[starts.len() - 1];
        starts.push(before.saturating_add(c.varint("blocks of a chunk")?));
    }
    c.end("chunk table")?;
    let sum = starts[starts.len() - 1];
    if sum != blocks {
        return Err(Malformed::new("blocks of all chunks", blocks.to_string(), sum.to_string()));
    }
    Ok((first, starts))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_found_by_chunk() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("values.seg");
        let plan = PlanHash(5);
        let chunks: Vec<Vec<Vec<u8>>> =
            [3u8, 0, 1, 7].iter().map(|&n| (0..n).map(|i| vec![i, n, i * n]).collect()).collect();
        let mut w = ChunkSegmentWriter::create(&path, SegmentKind::Values, plan, ChunkId(40)).unwrap();
        chunks.iter().for_each(|c| w.push_chunk(c).unwrap());
        let info = w.finish().unwrap();
        assert_eq!(info.blocks, 12);
        let s = ChunkSegment::open(&path, SegmentKind::Values, Some(plan)).unwrap();
        assert_eq!(s.chunks(), 40..44);
        let mut out = vec![];
        for (chunk, blocks) in (40..).map(ChunkId).zip(&chunks) {
            assert_eq!(s.block_count(chunk), blocks.len() as u64);
            for (n, block) in (0..).zip(blocks) {
                s.block(chunk, n, &mut out).unwrap();
                assert_eq!(&out, block);
            }
        }
        s.segment().verify().unwrap();
        let blamed = s.blame(ChunkId(42), 0, Malformed::new("codec", "a known one", "9")).to_string();
        assert!(blamed.contains("values.seg: block 3: codec"), "{blamed}");
    }

    #[test]
    fn tables_that_lie_are_refused() {
        let good = [40, 3, 1, 0, 2];
        assert_eq!(read_table(&good, 3).unwrap(), (40, vec![0, 1, 1, 3]));
        assert!(read_table(&good, 4).is_err());
        for i in 0..good.len() {
            assert!(read_table(&good[..i], 3).is_err());
        }
        assert!(read_table(&[40, 0xff, 0xff, 0xff, 0xff, 0x0f, 1], 3).is_err());
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.seg");
        SegmentWriter::create(&path, SegmentKind::Mesh, PlanHash(1)).unwrap().finish().unwrap();
        assert!(ChunkSegment::open(&path, SegmentKind::Mesh, None).is_err(), "no table");
    }
}
