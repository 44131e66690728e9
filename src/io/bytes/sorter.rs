//! Sorts more records than memory holds.
//!
//! ```text
//!  push ─▶ buffer ── full: sort, append to a file ─▶ run 0 │ run 1 │ … ─▶ merge ─▶ next, next, …
//! ```
//!
//! External merge sort (Knuth, The Art of Computer Programming 3, section 5.4): runs of the size of
//! the given memory are sorted and written one after another into a nameless file. Then all are
//! read together, the least record first. If each of many runs would be read in too small pieces,
//! groups of them are merged into longer runs before. Records that fit in memory are never written.
//!
//! Cost: O(n log n) comparisons; each record is written and read once for up to memory / 16 KiB
//! runs, and once more each time the number of runs exceeds that. Records that compare equal are
//! equal bits, so the result does not depend on memory.

use super::store::{read_at, write_at};
use crate::error::{Error, Result};
use bytemuck::Pod;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::collections::binary_heap::PeekMut;
use std::fs::File;
use std::path::{Path, PathBuf};

/// A run is read in pieces of at least this size, so that reading stays sequential,
const LEAST_PIECE: usize = 16 << 10;
/// and at most this.
const MOST_PIECE: usize = 1 << 20;

/// Takes records in any order, to give them back sorted.
#[derive(Debug)]
pub struct Sorter<R> {
    buffer: Vec<R>,
    /// Records that `buffer` may hold.
    most: usize,
    memory_bytes: usize,
    scratch: PathBuf,
    runs: Option<Runs>,
}

/// Sorted runs of records in a file, one after another.
#[derive(Debug)]
struct Runs {
    file: File,
    /// Past the last record of each.
    ends: Vec<u64>,
}

impl Runs {
    fn new(scratch: &Path) -> Result<Self> {
        let file = tempfile::tempfile_in(scratch);
        Ok(Self { file: file.map_err(|e| Error::io("make a temporary file in", scratch, e))?, ends: vec![] })
    }

    fn end(&self) -> u64 {
        self.ends.last().copied().unwrap_or(0)
    }

    fn write<R: Pod>(&self, at: u64, records: &[R], scratch: &Path) -> Result<()> {
        write_at(&self.file, bytemuck::cast_slice(records), at * size_of::<R>() as u64)
            .map_err(|e| Error::io("write records to a temporary file in", scratch, e))
    }
}

impl<R: Pod + Ord> Sorter<R> {
    /// A sorter that uses up to about `memory_bytes` and, beyond, a file in `scratch`.
    pub fn new(memory_bytes: usize, scratch: &Path) -> Self {
        let most = (memory_bytes / size_of::<R>()).max(1);
        Self { buffer: vec![], most, memory_bytes, scratch: scratch.to_path_buf(), runs: None }
    }

    /// Takes a record.
    pub fn push(&mut self, record: R) -> Result<()> {
        if self.buffer.len() >= self.most {
            self.spill()?;
        }
        self.buffer.push(record);
        Ok(())
    }

    /// Writes the buffer as a run.
    fn spill(&mut self) -> Result<()> {
        self.buffer.sort_unstable();
        let runs = match &mut self.runs {
            Some(runs) => runs,
            None => self.runs.insert(Runs::new(&self.scratch)?),
        };
        let at = runs.end();
        runs.write(at, &self.buffer, &self.scratch)?;
        runs.ends.push(at + self.buffer.len() as u64);
        self.buffer.clear();
        Ok(())
    }

    /// All records, ascending.
    pub fn finish(mut self) -> Result<Sorted<R>> {
        if self.runs.is_none() {
            self.buffer.sort_unstable();
            return Ok(Sorted::Memory(self.buffer.into_iter()));
        }
        if !self.buffer.is_empty() {
            self.spill()?;
        }
        self.buffer = vec![];
        let mut runs = self.runs.take().expect("a run was written");
        let at_once = (self.memory_bytes / LEAST_PIECE).max(2);
        while runs.ends.len() > at_once {
            runs = self.longer(runs, at_once)?;
        }
        let all = 0..runs.ends.len();
        Ok(Sorted::Disk(Merge::new(runs, all, self.memory_bytes, &self.scratch)?))
    }

    /// The same records in fewer runs.
    fn longer(&self, mut runs: Runs, at_once: usize) -> Result<Runs> {
        let mut longer = Runs::new(&self.scratch)?;
        let mut piece: Vec<R> = vec![];
        let full = MOST_PIECE / size_of::<R>();
        for first in (0..runs.ends.len()).step_by(at_once) {
            let group = first..(first + at_once).min(runs.ends.len());
            let mut merge = Merge::<R>::new(runs, group, self.memory_bytes, &self.scratch)?;
            let mut at = longer.end();
            loop {
                let record = merge.next()?;
                piece.extend(record);
                if piece.len() >= full || record.is_none() {
                    longer.write(at, &piece, &self.scratch)?;
                    at += piece.len() as u64;
                    piece.clear();
                }
                if record.is_none() {
                    break;
                }
            }
            longer.ends.push(at);
            runs = merge.runs;
        }
        Ok(longer)
    }
}

/// Sorted records, to be taken one by one.
#[derive(Debug)]
pub enum Sorted<R> {
    /// All of them.
    Memory(std::vec::IntoIter<R>),
    /// Runs on disk, merged.
    Disk(Merge<R>),
}

impl<R: Pod + Ord> Sorted<R> {
    /// The next record; `None` after the last.
    #[allow(clippy::should_implement_trait, reason = "it can fail, or lends what it gives")]
    pub fn next(&mut self) -> Result<Option<R>> {
        match self {
            Self::Memory(records) => Ok(records.next()),
            Self::Disk(merge) => merge.next(),
        }
    }
}

/// Runs that are read together.
#[derive(Debug)]
pub struct Merge<R> {
    runs: Runs,
    pieces: Vec<RunBuffer<R>>,
    /// The least record of each run that is not at its end, and the number of its piece.
    least: BinaryHeap<Reverse<(R, usize)>>,
    scratch: PathBuf,
}

/// The part of a run that is in memory, and the rest of it.
#[derive(Debug)]
struct RunBuffer<R> {
    records: Vec<R>,
    at: usize,
    next: u64,
    end: u64,
    /// Records read at a time.
    most: usize,
}

impl<R: Pod + Ord> Merge<R> {
    fn new(runs: Runs, group: std::ops::Range<usize>, memory_bytes: usize, scratch: &Path) -> Result<Self> {
        let bytes = (memory_bytes / group.len()).clamp(1, MOST_PIECE);
        let most = (bytes / size_of::<R>()).max(1);
        let start = |run: usize| if run == 0 { 0 } else { runs.ends[run - 1] };
        let pieces = group
            .map(|run| RunBuffer { records: vec![], at: 0, next: start(run), end: runs.ends[run], most })
            .collect();
        let mut merge = Self { runs, pieces, least: BinaryHeap::new(), scratch: scratch.to_path_buf() };
        for n in 0..merge.pieces.len() {
            if let Some(record) = merge.pieces[n].take(&merge.runs.file, &merge.scratch)? {
                merge.least.push(Reverse((record, n)));
            }
        }
        Ok(merge)
    }

    fn next(&mut self) -> Result<Option<R>> {
        let Some(mut top) = self.least.peek_mut() else { return Ok(None) };
        let Reverse((record, n)) = *top;
        match self.pieces[n].take(&self.runs.file, &self.scratch)? {
            Some(next) => *top = Reverse((next, n)),
            None => drop(PeekMut::pop(top)),
        }
        Ok(Some(record))
    }
}

impl<R: Pod> RunBuffer<R> {
    fn take(&mut self, file: &File, scratch: &Path) -> Result<Option<R>> {
        if self.at == self.records.len() {
            let here = (self.end - self.next).min(self.most as u64);
            self.records.resize(here as usize, R::zeroed());
            read_at(file, bytemuck::cast_slice_mut(&mut self.records), self.next * size_of::<R>() as u64)
                .map_err(|e| Error::io("read records from a temporary file in", scratch, e))?;
            (self.next, self.at) = (self.next + here, 0);
        }
        let record = self.records.get(self.at).copied();
        self.at += usize::from(record.is_some());
        Ok(record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sorted(records: &[[u32; 2]], memory: usize, scratch: &Path) -> Vec<[u32; 2]> {
        let mut sorter = Sorter::new(memory, scratch);
        records.iter().for_each(|&r| sorter.push(r).unwrap());
        let mut sorted = sorter.finish().unwrap();
        std::iter::from_fn(|| sorted.next().unwrap()).collect()
    }

    #[test]
    fn any_memory_gives_the_same_order() {
        let scratch = tempfile::tempdir().unwrap();
        let mixed = |i: u32| i.wrapping_mul(2_654_435_761).rotate_left(9);
        for count in [0, 1, 2, 50_000u32] {
            // Equal first halves, and equal records.
            let records: Vec<[u32; 2]> = (0..count).map(|i| [mixed(i) % 1000, mixed(i) >> 28]).collect();
            let mut wanted = records.clone();
            wanted.sort_unstable();
            // All in memory; three runs; 500 and 2500 runs, merged two at a time because memory is
            // so small.
            for memory in [1 << 30, 8 * 20_000, 800, 160] {
                assert!(
                    sorted(&records, memory, scratch.path()) == wanted,
                    "{count} records in {memory} bytes"
                );
            }
        }
        // Three runs: one is left over when two are merged.
        let records: Vec<[u32; 2]> = (0..3 * 20).map(|i| [mixed(i), i]).collect();
        let mut wanted = records.clone();
        wanted.sort_unstable();
        assert_eq!(sorted(&records, 20 * 8, scratch.path()), wanted);
        assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0, "the files have no names");
    }

    #[test]
    fn no_scratch_folder_is_an_error_that_names_it() {
        let mut sorter = Sorter::new(0, Path::new("/no/such/folder"));
        sorter.push(1u32).unwrap();
        let message = sorter.push(2).unwrap_err().to_string();
        assert!(message.contains("/no/such/folder"), "{message}");
    }
}
