//! Building an index of more entries than memory holds.
//!
//! The tree is that of [`super::subtree`], and so are its bytes: which half an entry falls in is a
//! matter of a total order, not of the algorithm. A subtree that fits in memory is built there. A
//! larger one is cut in two on disk:
//!
//! ```text
//!  file A  ····region of n entries····        1. count the entries by the 16 highest bits of their key
//!              │ partition by the median      2. collect the keys of the bucket that has the median: it is one of those
//!  file B  ···smaller·│···larger····          3. copy the smaller to the front of the same region of the other file,
//!                                                the larger behind; the next cut goes back to file A
//! ```
//!
//! (Where one bucket does not fit in memory, as with many equal values, its next 16 bits are
//! counted, and so on.) Partitioning also counts both halves for their own cut, so a level of
//! halving costs two readings and one writing of the entries. Only the levels above subtrees that
//! fit in memory are cut so: five for 10^8 entries and 256 MiB.
//!
//! Disk: two files of 24 bytes an entry, without a name (where the system allows), so that nothing
//! is left behind.

use super::page::{Bounds, LEAF_ENTRIES, PAGE_LEVELS, encode_inner, split_sizes};
use super::subtree::{SplitAxis, split, write_subtree};
use super::{Entry, RECORD, record};
use crate::archive::segment::SegmentWriter;
use byteorder::{ByteOrder, LE};
use isospan_io::error::{Error, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Records of a buffer.
const BUFFERED: usize = 1 << 15;
/// Buckets of a count.
const BUCKETS: usize = 1 << 16;

fn decode(r: &[u8]) -> Entry {
    Entry {
        min: LE::read_f32(r),
        max: LE::read_f32(&r[4..]),
        chunk: LE::read_u64(&r[8..]),
        block: LE::read_u32(&r[16..]),
        tets: LE::read_u32(&r[20..]),
    }
}

/// A run of records of one of the two files.
struct Region {
    file: usize,
    first: u64,
    len: u64,
    bounds: Bounds,
    /// How many entries have each value of the highest 16 bits of their key on the axis of the next
    /// cut; empty where none follows.
    counts: Vec<u64>,
}

/// The entries of an index on disk.
#[derive(Debug)]
pub(super) struct Spill {
    files: [File; 2],
    folder: PathBuf,
    len: u64,
    bounds: Bounds,
    counts: Vec<u64>,
}

impl Spill {
    pub(super) fn new(folder: &Path) -> Result<Self> {
        let file =
            || tempfile::tempfile_in(folder).map_err(|e| Error::io("make a temporary file in", folder, e));
        Ok(Self {
            files: [file()?, file()?],
            folder: folder.to_path_buf(),
            len: 0,
            bounds: Bounds::NONE,
            counts: vec![0; BUCKETS],
        })
    }

    /// Bounds of all entries.
    pub(super) fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Adds entries behind those that are there.
    pub(super) fn append(&mut self, entries: &[Entry]) -> Result<()> {
        let mut to = RecordWriter::new(self.len);
        for e in entries {
            self.bounds.add(e);
            self.counts[bucket(SplitAxis::Min.key(e), 0)] += 1;
            to.put(self, 0, e)?;
        }
        to.flush(self, 0)?;
        self.len += entries.len() as u64;
        Ok(())
    }

    /// Writes all pages, with room for `capacity` entries in `memory`.
    pub(super) fn write(
        mut self,
        memory: Vec<Entry>,
        capacity: usize,
        out: &mut SegmentWriter,
    ) -> Result<()> {
        let counts = std::mem::take(&mut self.counts);
        let all = Region { file: 0, first: 0, len: self.len, bounds: self.bounds, counts };
        Build { spill: self, memory, capacity }.write(all, SplitAxis::Min, out)
    }

    fn seek(&self, file: usize, record: u64) -> Result<&File> {
        let mut f = &self.files[file];
        f.seek(SeekFrom::Start(record * RECORD as u64)).map_err(|e| self.io("seek in", e))?;
        Ok(f)
    }

    fn io(&self, doing: &str, e: std::io::Error) -> Error {
        Error::io(format!("{doing} a temporary file in"), &self.folder, e)
    }

    /// Hands all entries of a region to `each`, in the order in which they lie.
    fn for_each(&self, region: &Region, mut each: impl FnMut(Entry) -> Result<()>) -> Result<()> {
        let mut buffer = vec![0; RECORD * BUFFERED];
        let mut done = 0;
        while done < region.len {
            let n = (region.len - done).min(BUFFERED as u64) as usize;
            let part = &mut buffer[..n * RECORD];
            let mut file = self.seek(region.file, region.first + done)?;
            file.read_exact(part).map_err(|e| self.io("read", e))?;
            part.chunks_exact(RECORD).try_for_each(|r| each(decode(r)))?;
            done += n as u64;
        }
        Ok(())
    }
}

/// The place to which entries are written, one after the other.
struct RecordWriter {
    next: u64,
    buffer: Vec<u8>,
}

impl RecordWriter {
    fn new(first: u64) -> Self {
        Self { next: first, buffer: Vec::with_capacity(RECORD * BUFFERED) }
    }

    fn put(&mut self, spill: &Spill, file: usize, e: &Entry) -> Result<()> {
        if self.buffer.len() == RECORD * BUFFERED {
            self.flush(spill, file)?;
        }
        self.buffer.extend(record(e));
        Ok(())
    }

    fn flush(&mut self, spill: &Spill, file: usize) -> Result<()> {
        let mut f = spill.seek(file, self.next)?;
        f.write_all(&self.buffer).map_err(|e| spill.io("write", e))?;
        self.next += (self.buffer.len() / RECORD) as u64;
        self.buffer.clear();
        Ok(())
    }
}

/// The `digit`-th 16 bits of a key, from the highest.
fn bucket(key: u128, digit: u32) -> usize {
    (key >> (112 - 16 * digit)) as usize & (BUCKETS - 1)
}

struct Build {
    spill: Spill,
    /// Room for the entries of a subtree, used again and again.
    memory: Vec<Entry>,
    capacity: usize,
}

impl Build {
    /// Writes the page of a region and all pages below it.
    fn write(&mut self, region: Region, axis: SplitAxis, out: &mut SegmentWriter) -> Result<()> {
        if region.len <= self.capacity as u64 {
            self.load(&region)?;
            return write_subtree(&mut self.memory, axis, out);
        }
        let mut children = vec![];
        self.split(region, axis, PAGE_LEVELS, &mut children)?;
        let bounds: Vec<Bounds> = children.iter().map(|c| c.bounds).collect();
        out.push_block(&encode_inner(&bounds))?;
        children.into_iter().try_for_each(|child| self.write(child, axis, out))
    }

    fn load(&mut self, region: &Region) -> Result<()> {
        let memory = &mut self.memory;
        memory.clear();
        memory.reserve_exact(region.len as usize);
        self.spill.for_each(region, |e| {
            memory.push(e);
            Ok(())
        })
    }

    /// Halves a region `levels` times, as [`split`] does, and appends the parts in order.
    fn split(&mut self, region: Region, axis: SplitAxis, levels: u32, parts: &mut Vec<Region>) -> Result<()> {
        if levels == 0 || region.len <= LEAF_ENTRIES {
            parts.push(region);
            return Ok(());
        }
        if region.len > self.capacity as u64 {
            for half in self.halve(region, axis, levels > 1)? {
                self.split(half, axis.other(), levels - 1, parts)?;
            }
            return Ok(());
        }
        self.load(&region)?;
        split(&mut self.memory, axis, levels);
        let mut to = RecordWriter::new(region.first);
        self.memory.iter().try_for_each(|e| to.put(&self.spill, region.file, e))?;
        to.flush(&self.spill, region.file)?;
        let mut first = 0;
        for len in split_sizes(region.len, levels) {
            let bounds = Bounds::of(&self.memory[first as usize..(first + len) as usize]);
            parts.push(Region {
                file: region.file,
                first: region.first + first,
                len,
                bounds,
                counts: vec![],
            });
            first += len;
        }
        Ok(())
    }

    /// Copies the smaller half of a region to the front of the same place in the other file, the
    /// larger one behind it.
    fn halve(&mut self, region: Region, axis: SplitAxis, again: bool) -> Result<[Region; 2]> {
        let file = 1 - region.file;
        let smaller = region.len / 2;
        let median = self.key_of_rank(&region, axis, smaller)?;
        let half = |first: u64, len: u64| {
            // The next page of a region that is cut no more in this one begins with the same axis
            // as this page did: min.
            Region { file, first, len, bounds: Bounds::NONE, counts: vec![0; BUCKETS] }
        };
        let mut halves = [half(region.first, smaller), half(region.first + smaller, region.len - smaller)];
        let mut targets = [RecordWriter::new(halves[0].first), RecordWriter::new(halves[1].first)];
        let next = if again { axis.other() } else { SplitAxis::Min };
        self.spill.for_each(&region, |e| {
            let at = usize::from(axis.key(&e) >= median);
            halves[at].bounds.add(&e);
            halves[at].counts[bucket(next.key(&e), 0)] += 1;
            targets[at].put(&self.spill, file, &e)
        })?;
        for (target, half) in targets.iter_mut().zip(&halves) {
            target.flush(&self.spill, file)?;
            assert_eq!(target.next, half.first + half.len, "each block is added once, so keys differ");
        }
        Ok(halves)
    }

    /// The key that has `rank` smaller ones in the region.
    fn key_of_rank(&mut self, region: &Region, axis: SplitAxis, mut rank: u64) -> Result<u128> {
        let mut counts = region.counts.clone();
        // The digits of the key that are known.
        let (mut known, mut digits) = (0u128, 0u32);
        loop {
            let mut at = 0;
            while rank >= counts[at] {
                rank -= counts[at];
                at += 1;
            }
            known = known << 16 | at as u128;
            digits += 1;
            let here = |key: &u128| key >> (128 - 16 * digits) == known;
            if digits == 8 {
                return Ok(known);
            }
            // A key has 16 bytes, an entry 24.
            if counts[at] <= self.capacity as u64 {
                self.memory = vec![];
                let mut keys = Vec::with_capacity(counts[at] as usize);
                self.spill.for_each(region, |e| {
                    keys.extend(Some(axis.key(&e)).filter(here));
                    Ok(())
                })?;
                return Ok(*keys.select_nth_unstable(rank as usize).1);
            }
            counts.fill(0);
            self.spill.for_each(region, |e| {
                if let Some(key) = Some(axis.key(&e)).filter(here) {
                    counts[bucket(key, digits)] += 1;
                }
                Ok(())
            })?;
        }
    }
}
