//! Segments of a range of chunks, each chunk a run of blocks.
//!
//! A mesh segment has for each chunk its header and its tetrahedron blocks
//! ([`crate::archive::mesh`]), a value segment its value blocks ([`crate::archive::values`]). The
//! last block of the segment is the chunk table: how many blocks each chunk has.
//!
//! A writer that is killed loses no chunk that it was given: [`ChunkSegmentWriter::resume`]
//! continues after the last whole one.

mod ranges;
mod summary;

pub use ranges::BlockRange;
pub(crate) use ranges::{RangeDecoder, RangeEncoder};
pub use summary::{
    MeshSizes, MeshSummary, ValueRange, ValueSummary, decode_value_ranges, encode_value_ranges, value_ranges,
};

use crate::archive::manifest::SegmentRecord;
use crate::archive::segment::{Journal, PlanHash, Record, Segment, SegmentInfo, SegmentKind, SegmentWriter};
use crate::archive::wire::{Cursor, Malformed, put_varint};
use isospan_io::bytes::publish::{self, Dead};
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;
use std::ops::Range;
use std::path::Path;

/// Writes chunks in order.
pub struct ChunkSegmentWriter {
    segment: SegmentWriter,
    first: ChunkId,
    block_counts: Vec<u64>,
    journal: Option<Journal>,
}

impl ChunkSegmentWriter {
    /// Begins a segment whose first chunk is `first`.
    ///
    /// # Errors
    /// When the temporary file cannot be made.
    pub fn create(path: impl AsRef<Path>, kind: SegmentKind, plan: PlanHash, first: ChunkId) -> Result<Self> {
        let segment = SegmentWriter::create(path, kind, plan)?;
        Ok(Self { segment, first, block_counts: vec![], journal: None })
    }

    /// As [`ChunkSegmentWriter::resume`], or without a `journal` as [`ChunkSegmentWriter::create`],
    /// where no writer has left anything.
    ///
    /// # Errors
    /// As there.
    pub fn begin(
        path: impl AsRef<Path>,
        kind: SegmentKind,
        plan: PlanHash,
        first: ChunkId,
        journal: bool,
    ) -> Result<Self> {
        let segment = SegmentWriter::create_unlooked(path, kind, plan)?;
        let journal = journal.then(|| Journal::create(segment.temporary())).transpose()?;
        Ok(Self { segment, first, block_counts: vec![], journal })
    }

    /// Begins a segment, or continues what a killed or stopped writer left, with those of its
    /// chunks up to `most` that are whole ([`ChunkSegmentWriter::chunk_count`] gives their number).
    /// What this writer has written is there for the next one, chunk by chunk; other leftovers of
    /// the same segment are removed. The finished file is the same in any case.
    ///
    /// # Errors
    /// When a temporary file cannot be made or read.
    pub fn resume(
        path: impl AsRef<Path>,
        kind: SegmentKind,
        plan: PlanHash,
        first: ChunkId,
        most: u64,
    ) -> Result<Self> {
        let path = path.as_ref();
        let mut found: Option<Self> = None;
        for dead in publish::dead_of(path) {
            let before = dead.path.clone();
            let Some(dead) = dead.claim(path)? else { continue };
            Journal::follow(&before, &dead.path);
            let temporary = dead.path.clone();
            let adopted = Self::adopt(dead, path, kind, plan, first, most)?;
            match adopted.filter(|a| found.as_ref().is_none_or(|f| f.chunk_count() < a.chunk_count())) {
                // The one that is replaced, or not taken, has served.
                Some(better) => found.replace(better).into_iter().for_each(Self::discard),
                None => _ = std::fs::remove_file(temporary),
            }
        }
        if let Some(found) = found {
            return Ok(found);
        }
        Self::begin(path, kind, plan, first, true)
    }

    fn adopt(
        dead: Dead,
        path: &Path,
        kind: SegmentKind,
        plan: PlanHash,
        first: ChunkId,
        most: u64,
    ) -> Result<Option<Self>> {
        let Some((mut journal, mut records)) = Journal::of_dead(&dead) else { return Ok(None) };
        let expected = (first.0..).zip(&records).take_while(|(n, r)| *n == r.chunk).count();
        records.truncate(expected.min(usize::try_from(most).unwrap_or(usize::MAX)));
        let Some((mut segment, whole)) = SegmentWriter::adopt(dead, path, kind, plan, &records)? else {
            return Ok(None);
        };
        records.truncate(whole);
        if whole > 0 {
            segment.keep()?;
        }
        journal.truncate(&records)?;
        let block_counts = records.iter().map(|r| r.blocks.len() as u64).collect();
        Ok(Some(Self { segment, first, block_counts, journal: Some(journal) }))
    }

    /// Removes the temporary files.
    pub(crate) fn discard(self) {
        let temporary = self.segment.temporary().to_path_buf();
        self.journal.into_iter().for_each(Journal::remove);
        drop(self.segment);
        // Another process may have removed it already.
        let _ = std::fs::remove_file(temporary);
    }

    /// Chunks written so far, those of an earlier writer included.
    pub fn chunk_count(&self) -> u64 {
        self.block_counts.len() as u64
    }

    /// Appends the blocks of the next chunk.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn push_chunk(&mut self, blocks: &[Vec<u8>]) -> Result<()> {
        let before = self.segment.block_count() as usize;
        for block in blocks {
            self.segment.push_block(block)?;
        }
        if let Some(journal) = &mut self.journal {
            let blocks = self.segment.entries_from(before).to_vec();
            self.segment.keep()?;
            journal.push(&Record { chunk: self.first.0 + self.block_counts.len() as u64, blocks })?;
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
        let info = self.segment.finish()?;
        // Until here they are needed: a finish that failed for want of room is tried again.
        self.journal.into_iter().for_each(Journal::remove);
        Ok(info)
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

    /// As [`ChunkSegment::block`], of blocks that follow each other, with one read; `ends` is
    /// replaced by the end of each in `out`.
    ///
    /// # Errors
    /// As there.
    ///
    /// # Panics
    /// As there.
    pub(crate) fn run(
        &self,
        chunk: ChunkId,
        numbers: Range<u64>,
        out: &mut Vec<u8>,
        ends: &mut Vec<usize>,
    ) -> Result<()> {
        let first = self.block_number(chunk, numbers.start);
        assert!(numbers.end <= self.block_count(chunk), "blocks {numbers:?} of a chunk");
        self.segment.run(first..first + (numbers.end - numbers.start), out, ends)
    }

    /// The error for block `n` of a chunk whose bytes could not be decoded.
    pub fn blame(&self, chunk: ChunkId, n: u64, what: Malformed) -> Error {
        what.in_block(self.segment.path(), self.block_number(chunk, n))
    }

    /// All blocks of a chunk.
    ///
    /// # Errors
    /// As [`ChunkSegment::block`].
    ///
    /// # Panics
    /// When the chunk is not in the segment.
    pub(crate) fn blocks(&self, chunk: ChunkId) -> Result<Vec<Vec<u8>>> {
        let block = |n| {
            let mut bytes = vec![];
            self.block(chunk, n, &mut bytes).map(|()| bytes)
        };
        (0..self.block_count(chunk)).map(block).collect()
    }

    fn position(&self, chunk: ChunkId) -> usize {
        let chunks = self.chunks();
        assert!(chunks.contains(&chunk.0), "chunk {} is not in {chunks:?}", chunk.0);
        (chunk.0 - self.first) as usize
    }

    /// The summary of a chunk in a mesh segment: its last block.
    ///
    /// # Errors
    /// As [`ChunkSegment::block`]; [`Error::BadInput`] for a summary that cannot be decoded.
    pub(crate) fn mesh_summary(&self, chunk: ChunkId) -> Result<MeshSummary> {
        self.block_from_end(chunk, 0, MeshSummary::decode)
    }

    /// The summary of a chunk in a value segment: its last block.
    ///
    /// # Errors
    /// As [`ChunkSegment::mesh_summary`].
    pub(crate) fn value_summary(&self, chunk: ChunkId) -> Result<ValueSummary> {
        self.block_from_end(chunk, 0, ValueSummary::decode)
    }

    /// Decodes the block of a chunk that has `behind` blocks behind it.
    ///
    /// # Errors
    /// As [`ChunkSegment::mesh_summary`]; for a chunk of fewer blocks.
    pub(crate) fn block_from_end<T>(
        &self,
        chunk: ChunkId,
        behind: u64,
        decode: impl FnOnce(&[u8]) -> std::result::Result<T, Malformed>,
    ) -> Result<T> {
        let count = self.block_count(chunk);
        let block = count.checked_sub(behind + 1).ok_or_else(|| {
            let expected = format!("at least {} blocks", behind + 1);
            Error::bad_input(self.segment.path(), format!("chunk {}", chunk.0), expected, count.to_string())
        })?;
        let mut bytes = vec![];
        self.block(chunk, block, &mut bytes)?;
        decode(&bytes).map_err(|m| self.blame(chunk, block, m))
    }

    /// What a manifest records of the segment.
    pub(crate) fn record(&self) -> SegmentRecord {
        let chunks = self.chunks();
        let (first_chunk, chunks) = (chunks.start, chunks.end - chunks.start);
        SegmentRecord { first_chunk, chunks, info: self.segment.info() }
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

    const CHUNKS: u64 = 5;

    fn chunk(n: u64) -> Vec<Vec<u8>> {
        (0..n % 4 + 1).map(|b| (0..200 * b + n).map(|i| (i * 7 + n) as u8).collect()).collect()
    }

    fn resume(path: &Path, plan: u128, most: u64) -> ChunkSegmentWriter {
        ChunkSegmentWriter::resume(path, SegmentKind::Values, PlanHash(plan), ChunkId(30), most).unwrap()
    }

    /// Goes on with the segment and finishes it; returns how many chunks were there.
    fn finish(path: &Path, most: u64) -> u64 {
        let mut w = resume(path, 9, most);
        let there = w.chunk_count();
        (there..CHUNKS).for_each(|n| w.push_chunk(&chunk(n)).unwrap());
        w.finish().unwrap();
        there
    }

    #[test]
    fn a_stopped_writer_loses_no_chunk() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("v.seg");
        assert_eq!(finish(&path, 99), 0);
        let expected = std::fs::read(&path).unwrap();
        for stop in 0..=CHUNKS {
            for most in [99, 2] {
                std::fs::remove_file(&path).unwrap();
                let mut w = resume(&path, 9, 99);
                (0..stop).for_each(|n| w.push_chunk(&chunk(n)).unwrap());
                drop(w);
                assert_eq!(finish(&path, most), stop.min(most));
                assert_eq!(std::fs::read(&path).unwrap(), expected);
                assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary is left");
            }
        }
    }

    #[test]
    fn damage_in_what_is_left_costs_chunks_and_never_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("v.seg");
        finish(&path, 99);
        let expected = std::fs::read(&path).unwrap();
        for case in 0..40 {
            std::fs::remove_file(&path).unwrap();
            let mut w = resume(&path, 9, 99);
            (0..4).for_each(|n| w.push_chunk(&chunk(n)).unwrap());
            drop(w);
            let mut files: Vec<_> =
                std::fs::read_dir(dir.path()).unwrap().map(|f| f.unwrap().path()).collect();
            files.sort();
            let file = &files[case % 2];
            let mut bytes = std::fs::read(file).unwrap();
            let at = bytes.len() * (case / 4) / 10;
            if case / 2 % 2 == 0 {
                bytes.truncate(at)
            } else {
                bytes[at] ^= 8
            }
            std::fs::write(file, bytes).unwrap();
            assert!(finish(&path, 99) < 4, "case {case}");
            assert_eq!(std::fs::read(&path).unwrap(), expected);
            publish::sweep(dir.path());
            assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "case {case}");
        }
        // Another plan's.
        std::fs::remove_file(&path).unwrap();
        let mut w = resume(&path, 8, 99);
        w.push_chunk(&chunk(0)).unwrap();
        drop(w);
        assert_eq!(finish(&path, 99), 0);
        assert_eq!(std::fs::read(&path).unwrap(), expected);
    }
}
