//! Duplicate vertices of a source mesh, in a segment of their own: further steps merge the same
//! ones.
//!
//! The values of the first step decide which vertices are one ([`crate::pipeline`] does that). The
//! samples of the boundary depend on it, and the first step's file may be gone when another is
//! added. The segment has pairs of a vertex and the first vertex that equals it. Pairs are sorted
//! by the former, in blocks of [`BLOCK_PAIRS`] (the last block has the rest). A block is zstd of
//! two columns of varints: the vertices as differences to the one before (the first: to 0), and how
//! far before each vertex its first one is. The plan has the number of pairs and the hash of all.
//! Neither writing nor reading holds more than a block.

use crate::archive::segment::{PlanHash, Segment, SegmentKind, SegmentWriter};
use crate::archive::wire::{Cursor, Malformed, put_varint, to_zstd, unzstd};
use isospan_io::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3;

/// Pairs of a block.
pub(in crate::archive) const BLOCK_PAIRS: usize = 4096;
/// Bytes of a varint of 64 bits, at most.
const LARGEST_VARINT: usize = 10;
const LEVEL: i32 = 9;

/// A vertex, and the first that it equals.
pub(crate) type Pair = [u64; 2];

/// What a plan says about the duplicate vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RepeatedRecord {
    /// Number of pairs.
    pub count: u64,
    /// XXH3 (128 bits) of the pairs, two u64 each, in order.
    pub hash: PlanHash,
}

impl RepeatedRecord {
    /// The record of all pairs; none if there is no pair.
    pub(crate) fn of(pairs: impl Iterator<Item = Pair>) -> Option<Self> {
        let mut sum = Sum::default();
        pairs.for_each(|pair| sum.add(pair));
        (sum.count > 0).then(|| sum.record())
    }
}

/// The hash of the pairs so far.
#[derive(Default)]
struct Sum {
    count: u64,
    hash: Xxh3,
}

impl Sum {
    fn add(&mut self, [vertex, first]: Pair) {
        self.count += 1;
        self.hash.update(&vertex.to_le_bytes());
        self.hash.update(&first.to_le_bytes());
    }

    fn record(&self) -> RepeatedRecord {
        RepeatedRecord { count: self.count, hash: PlanHash(self.hash.digest128()) }
    }
}

/// Path of the repeated vertices' segment.
pub fn repeated_path(archive: &Path) -> PathBuf {
    archive.join("mesh/repeated.seg")
}

/// Writes all pairs.
///
/// # Errors
/// When the file cannot be written.
pub(crate) fn write_repeated(
    archive: &Path,
    plan: PlanHash,
    mut pairs: impl Iterator<Item = Pair>,
) -> Result<()> {
    let mut out = SegmentWriter::create(repeated_path(archive), SegmentKind::Repeated, plan)?;
    let mut block = Vec::with_capacity(BLOCK_PAIRS);
    loop {
        block.clear();
        block.extend(pairs.by_ref().take(BLOCK_PAIRS));
        if block.is_empty() {
            return out.finish().map(|_| ());
        }
        out.push_block(&encode(&block))?;
    }
}

/// The pairs that a plan speaks of, one after another.
pub(crate) struct RepeatedReader {
    segment: Segment,
    record: RepeatedRecord,
    next_block: u64,
    buffer: Vec<u8>,
    block: std::vec::IntoIter<Pair>,
    last: Option<u64>,
    sum: Sum,
}

impl RepeatedReader {
    /// # Errors
    /// [`Error::BadInput`] when the segment is damaged, or another; [`Error::Io`] when it is not
    /// there.
    pub(crate) fn open(archive: &Path, plan: PlanHash, record: &RepeatedRecord) -> Result<Self> {
        let path = repeated_path(archive);
        let segment = Segment::open(&path, SegmentKind::Repeated, Some(plan))?;
        let blocks = record.count.div_ceil(BLOCK_PAIRS as u64);
        if segment.block_count() != blocks {
            let (expected, got) =
                (format!("{blocks}, of {} pairs", record.count), segment.block_count().to_string());
            return Err(Error::bad_input(&path, "blocks", expected, got));
        }
        Ok(Self {
            segment,
            record: *record,
            next_block: 0,
            buffer: vec![],
            block: vec![].into_iter(),
            last: None,
            sum: Sum::default(),
        })
    }

    pub(crate) fn segment(&self) -> &Segment {
        &self.segment
    }

    /// The next pair; none after the last.
    ///
    /// # Errors
    /// [`Error::BadInput`] for damage, and when these were not the pairs of the plan.
    pub(crate) fn next(&mut self) -> Result<Option<Pair>> {
        loop {
            if let Some(pair) = self.block.next() {
                self.sum.add(pair);
                return Ok(Some(pair));
            }
            if self.next_block == self.segment.block_count() {
                return self.end();
            }
            self.segment.block(self.next_block, &mut self.buffer)?;
            let before = self.next_block * BLOCK_PAIRS as u64;
            let expected = (self.record.count - before).min(BLOCK_PAIRS as u64) as usize;
            let block = decode(&self.buffer, expected, self.last)
                .map_err(|m| m.in_block(self.segment.path(), self.next_block))?;
            self.last = block.last().map(|pair| pair[0]);
            self.block = block.into_iter();
            self.next_block += 1;
        }
    }

    fn end(&self) -> Result<Option<Pair>> {
        let (expected, found) = (self.record.hash, self.sum.record().hash);
        if found == expected {
            return Ok(None);
        }
        Err(Error::bad_input(self.segment.path(), "pairs", expected.to_string(), found.to_string()))
    }
}

fn encode(pairs: &[Pair]) -> Vec<u8> {
    let (mut body, mut before) = (vec![], 0);
    for [vertex, _] in pairs {
        put_varint(&mut body, vertex - before);
        before = *vertex;
    }
    for [vertex, first] in pairs {
        put_varint(&mut body, vertex - first);
    }
    to_zstd(&body, LEVEL)
}

/// `last`: the last vertex of the block before.
fn decode(bytes: &[u8], expected: usize, mut last: Option<u64>) -> std::result::Result<Vec<Pair>, Malformed> {
    let body = unzstd(bytes, 2 * LARGEST_VARINT * BLOCK_PAIRS, "repeated vertices")?;
    let (mut c, mut pairs, mut before) = (Cursor::new(&body), Vec::with_capacity(expected), 0u64);
    for _ in 0..expected {
        let step = c.varint("vertex")?;
        let vertex = before.checked_add(step).filter(|&v| last.is_none_or(|last| v > last));
        let Some(vertex) = vertex else {
            return Err(Malformed::new("vertex", "ascending numbers", format!("{step} after {before}")));
        };
        (before, last) = (vertex, Some(vertex));
        pairs.push([vertex, 0]);
    }
    for [vertex, first] in &mut pairs {
        let back = c.varint("first vertex")?;
        let Some(found) = vertex.checked_sub(back).filter(|_| back > 0) else {
            let expected = format!("a vertex before {vertex}");
            return Err(Malformed::new("first vertex", expected, format!("{back} before it")));
        };
        *first = found;
    }
    c.end("repeated vertices")?;
    Ok(pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: PlanHash = PlanHash(7);

    fn pairs(count: u64) -> Vec<Pair> {
        (1..=count).map(|i| [3 * i + (i >> 5), (3 * i).saturating_sub(1 + (i * i) % 900)]).collect()
    }

    fn all(archive: &Path, record: &RepeatedRecord) -> Result<Vec<Pair>> {
        let (mut reader, mut found) = (RepeatedReader::open(archive, PLAN, record)?, vec![]);
        while let Some(pair) = reader.next()? {
            found.push(pair);
        }
        Ok(found)
    }

    #[test]
    fn pairs_come_back_and_others_are_refused() {
        assert_eq!(RepeatedRecord::of([].into_iter()), None);
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("mesh")).unwrap();
        for count in [1, 4095, 4096, 4097, 10_000] {
            let pairs = pairs(count);
            let record = RepeatedRecord::of(pairs.iter().copied()).unwrap();
            write_repeated(dir.path(), PLAN, pairs.iter().copied()).unwrap();
            assert_eq!(all(dir.path(), &record).unwrap(), pairs);
            let other = RepeatedRecord { hash: PlanHash(1), ..record };
            assert!(all(dir.path(), &other).unwrap_err().to_string().contains("pairs"));
            let other = RepeatedRecord { count: count + 4096, ..record };
            assert!(all(dir.path(), &other).unwrap_err().to_string().contains("blocks"));
        }
    }

    #[test]
    fn damaged_blocks_never_panic() {
        let body = unzstd(&encode(&pairs(40)), 1 << 20, "body").unwrap();
        for i in 0..body.len() {
            for value in [0, 1, 0x7f, 0x80, 0xff] {
                let mut bad = body.clone();
                bad[i] = value;
                let _ = decode(&to_zstd(&bad, 1), 40, None);
                let _ = decode(&bad[..i], 40, None);
            }
        }
        assert!(decode(&encode(&[[5, 5]]), 1, None).is_err(), "no vertex is before itself");
        assert!(decode(&encode(&[[5, 1]]), 1, Some(5)).is_err(), "vertices ascend from block to block");
    }
}
