//! Fixed-size records that are appended, patched, and read front to back or at random; beyond a
//! given size they are on disk.

use crate::error::{Error, Result};
use bytemuck::Pod;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Records handed out, and patched on disk, at a time.
const BATCH: usize = 1 << 14;
/// Patches at this distance are made together.
const CLOSE: u32 = 128;

/// A list of records: the first `written` in a nameless file of the scratch folder, the others in
/// `tail`.
#[derive(Debug)]
pub struct Store<T> {
    tail: Vec<T>,
    /// Records that `tail` may hold.
    most: usize,
    file: Option<File>,
    written: u64,
    scratch: PathBuf,
}

impl<T: Pod> Store<T> {
    /// A store that keeps up to about `memory_bytes` in memory.
    pub fn new(memory_bytes: usize, scratch: &Path) -> Self {
        let most = (memory_bytes / size_of::<T>()).max(1);
        Self { tail: Vec::new(), most, file: None, written: 0, scratch: scratch.to_path_buf() }
    }

    /// The same, which puts the first records where those of `memory` were, in place of them.
    pub fn reusing(memory_bytes: usize, scratch: &Path, mut memory: Vec<T>) -> Self {
        memory.clear();
        Self { tail: memory, ..Self::new(memory_bytes, scratch) }
    }

    /// An empty store in the same folder, of a part of the memory that another one has.
    pub fn beside<U: Pod>(other: &Store<U>, part: usize) -> Self {
        Self::new(other.most.saturating_mul(size_of::<U>()) / part, &other.scratch)
    }

    /// The number of records.
    #[allow(clippy::len_without_is_empty, reason = "who counts asks for the number")]
    pub fn len(&self) -> u64 {
        self.written + self.tail.len() as u64
    }

    /// All records, as long as they are in memory.
    pub fn in_memory(&self) -> Option<&[T]> {
        (self.written == 0).then_some(&self.tail)
    }

    /// Appends a record.
    pub fn push(&mut self, record: T) -> Result<()> {
        if self.tail.len() >= self.most {
            self.spill()?;
        }
        self.tail.push(record);
        Ok(())
    }

    /// Moves all records of the tail to the file.
    fn spill(&mut self) -> Result<()> {
        if self.file.is_none() {
            let made = tempfile::tempfile_in(&self.scratch);
            self.file = Some(made.map_err(|e| Error::io("make a temporary file in", &self.scratch, e))?);
        }
        let offset = self.written * size_of::<T>() as u64;
        write_at(self.file(), bytemuck::cast_slice(&self.tail), offset)
            .map_err(|e| Error::io("write records to a temporary file in", &self.scratch, e))?;
        self.written += self.tail.len() as u64;
        self.tail.clear();
        Ok(())
    }

    fn file(&self) -> &File {
        self.file.as_ref().expect("records are counted as written only after the file was made")
    }

    fn read(&self, first: u64, records: &mut [T]) -> Result<()> {
        read_at(self.file(), bytemuck::cast_slice_mut(records), first * size_of::<T>() as u64)
            .map_err(|e| Error::io("read records from a temporary file in", &self.scratch, e))
    }

    /// Reads records from a number on, which must be there.
    pub fn read_from(&self, first: u64, records: &mut [T]) -> Result<()> {
        let on_disk = (self.written.saturating_sub(first)).min(records.len() as u64) as usize;
        let (from_file, from_tail) = records.split_at_mut(on_disk);
        if !from_file.is_empty() {
            self.read(first, from_file)?;
        }
        let at = (first + on_disk as u64).saturating_sub(self.written) as usize;
        from_tail.copy_from_slice(&self.tail[at..at + from_tail.len()]);
        Ok(())
    }

    /// Hands out all records, in order, in batches.
    pub fn each(&self, each: &mut dyn FnMut(&[T]) -> Result<()>) -> Result<()> {
        self.each_from(0, each)
    }

    /// Hands out the records from a number on, in order, in batches.
    pub fn each_from(&self, mut first: u64, each: &mut dyn FnMut(&[T]) -> Result<()>) -> Result<()> {
        let mut batch = Vec::new();
        while first < self.written {
            batch.resize((self.written - first).min(BATCH as u64) as usize, T::zeroed());
            self.read(first, &mut batch)?;
            each(&batch)?;
            first += batch.len() as u64;
        }
        self.tail[(first - self.written) as usize..].chunks(BATCH).try_for_each(each)
    }

    /// Appends records.
    pub fn extend(&mut self, mut records: &[T]) -> Result<()> {
        while !records.is_empty() {
            if self.tail.len() >= self.most {
                self.spill()?;
            }
            let (now, later) = records.split_at(records.len().min(self.most - self.tail.len()));
            self.tail.extend_from_slice(now);
            records = later;
        }
        Ok(())
    }

    /// All records, in order.
    pub fn into_vec(self) -> Result<Vec<T>> {
        if self.written == 0 {
            return Ok(self.tail);
        }
        let mut all = vec![T::zeroed(); self.written as usize];
        self.read(0, &mut all)?;
        all.extend_from_slice(&self.tail);
        Ok(all)
    }

    /// The memory, for another store.
    pub fn into_memory(self) -> Vec<T> {
        self.tail
    }

    /// Changes records in place, each given with its number. `patches` ascend by record number.
    pub fn patch<P>(&mut self, patches: &[(u32, P)], mut apply: impl FnMut(u32, &mut T, &P)) -> Result<()> {
        let on_disk = patches.partition_point(|&(number, _)| u64::from(number) < self.written);
        let (mut on_disk, in_memory) = patches.split_at(on_disk);
        let mut batch = Vec::new();
        while let Some(&(number, _)) = on_disk.first() {
            // As far as patches follow each other closely: what lies between is read and written
            // too.
            let first = u64::from(number);
            let near = |pair: &[(u32, P)]| {
                pair[1].0 - pair[0].0 <= CLOSE && u64::from(pair[1].0) < first + BATCH as u64
            };
            let here = 1 + on_disk.windows(2).take_while(|pair| near(pair)).count();
            let past = u64::from(on_disk[here - 1].0) + 1;
            batch.resize((past - first) as usize, T::zeroed());
            self.read(first, &mut batch)?;
            for (n, p) in &on_disk[..here] {
                apply(*n, &mut batch[(u64::from(*n) - first) as usize], p);
            }
            write_at(self.file(), bytemuck::cast_slice(&batch), first * size_of::<T>() as u64)
                .map_err(|e| Error::io("write records to a temporary file in", &self.scratch, e))?;
            on_disk = &on_disk[here..];
        }
        for (n, p) in in_memory {
            apply(*n, &mut self.tail[(u64::from(*n) - self.written) as usize], p);
        }
        Ok(())
    }
}

/// Single records of a [`Store`], had through a cache of blocks of counted size. Neighbours lie
/// together in what programs write, so that nearly all records are found in it.
#[derive(Debug)]
pub struct Cached<'a, T> {
    store: &'a Store<T>,
    /// The block that lies in each slot; a block has one slot that it may lie in.
    blocks: Vec<u64>,
    records: Vec<T>,
}

/// Records in a block of the cache: few, because a miss reads them all.
const BLOCK: u64 = 256;

impl<'a, T: Pod> Cached<'a, T> {
    /// A cache of about `memory_bytes`.
    pub fn new(store: &'a Store<T>, memory_bytes: usize) -> Self {
        let useful = store.written.div_ceil(BLOCK) as usize;
        let slots = (memory_bytes / (BLOCK as usize * size_of::<T>() + 8)).clamp(1, useful.max(1));
        let records = if useful > 0 { vec![T::zeroed(); slots * BLOCK as usize] } else { vec![] };
        Self { store, blocks: vec![u64::MAX; slots], records }
    }

    /// The record of a number below the store's length.
    pub fn get(&mut self, number: u64) -> Result<T> {
        if number >= self.store.written {
            return Ok(self.store.tail[(number - self.store.written) as usize]);
        }
        let (block, within) = (number / BLOCK, (number % BLOCK) as usize);
        let slot = (block % self.blocks.len() as u64) as usize;
        let at = slot * BLOCK as usize;
        if self.blocks[slot] != block {
            let here = (self.store.written - block * BLOCK).min(BLOCK) as usize;
            // Until the read has worked there is no good block in the slot.
            self.blocks[slot] = u64::MAX;
            self.store.read(block * BLOCK, &mut self.records[at..at + here])?;
            self.blocks[slot] = block;
        }
        Ok(self.records[at + within])
    }
}

/// Fills `bytes` from `offset` of a file on.
///
/// # Errors
/// When the file ends before, or the system refuses to read.
#[cfg(unix)]
pub fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

/// Writes `bytes` at `offset` of a file.
///
/// # Errors
/// When the system refuses to write.
#[cfg(unix)]
pub fn write_at(file: &File, bytes: &[u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
}

/// Fills `bytes` from `offset` of a file on.
///
/// # Errors
/// When the file ends before, or the system refuses to read.
#[cfg(windows)]
pub fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> std::io::Result<()> {
    let mut done = 0;
    while done < bytes.len() {
        match std::os::windows::fs::FileExt::seek_read(file, &mut bytes[done..], offset + done as u64)? {
            0 => return Err(std::io::ErrorKind::UnexpectedEof.into()),
            n => done += n,
        }
    }
    Ok(())
}

/// Writes `bytes` at `offset` of a file.
///
/// # Errors
/// When the system refuses to write.
#[cfg(windows)]
pub fn write_at(file: &File, bytes: &[u8], offset: u64) -> std::io::Result<()> {
    let mut done = 0;
    while done < bytes.len() {
        match std::os::windows::fs::FileExt::seek_write(file, &bytes[done..], offset + done as u64)? {
            0 => return Err(std::io::ErrorKind::WriteZero.into()),
            n => done += n,
        }
    }
    Ok(())
}

/// Fills `bytes` from `offset` of a file on.
///
/// # Errors
/// Always: this system has no files.
#[cfg(not(any(unix, windows)))]
pub fn read_at(_file: &File, _bytes: &mut [u8], _offset: u64) -> std::io::Result<()> {
    Err(std::io::ErrorKind::Unsupported.into())
}

/// Writes `bytes` at `offset` of a file.
///
/// # Errors
/// Always: this system has no files.
#[cfg(not(any(unix, windows)))]
pub fn write_at(_file: &File, _bytes: &[u8], _offset: u64) -> std::io::Result<()> {
    Err(std::io::ErrorKind::Unsupported.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(store: &Store<[u32; 3]>) -> Vec<[u32; 3]> {
        let mut records = Vec::new();
        store
            .each(&mut |batch| {
                records.extend_from_slice(batch);
                Ok(())
            })
            .unwrap();
        records
    }

    #[test]
    fn records_come_back_from_memory_and_disk_patched() {
        let scratch = tempfile::tempdir().unwrap();
        let count = 3 * BATCH as u32 + 5;
        for memory in [0, 12 * 1000, 12 * BATCH, 1 << 30] {
            let mut store = Store::new(memory, scratch.path());
            (0..count).for_each(|i| store.push([i, 0, i / 2]).unwrap());
            assert_eq!(store.len(), u64::from(count));
            let patches: Vec<(u32, u32)> = (0..count).filter(|i| i % 7 < 2).map(|i| (i, i * 3)).collect();
            store.patch(&patches, |_, record, &p| record[1] = p).unwrap();
            let wanted: Vec<[u32; 3]> =
                (0..count).map(|i| [i, if i % 7 < 2 { i * 3 } else { 0 }, i / 2]).collect();
            assert_eq!(all(&store), wanted, "{memory} bytes of memory");
            store.extend(&wanted[..40_000]).unwrap();
            assert_eq!(store.into_vec().unwrap(), [&wanted[..], &wanted[..40_000]].concat());
        }
        assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0, "the files have no names");
    }

    #[test]
    fn single_records_are_found_wherever_they_lie() {
        let scratch = tempfile::tempdir().unwrap();
        for (memory, cache) in [(0, 0), (12 * 700, 12 * 600), (12 * 700, 1 << 20), (1 << 20, 0)] {
            let mut store = Store::new(memory, scratch.path());
            (0..3000u32).for_each(|i| store.push([i, i / 2, 7]).unwrap());
            let mut cached = Cached::new(&store, cache);
            for n in (0..3000).chain((0..9000).map(|i| i * 1237 % 3000)) {
                assert_eq!(cached.get(n).unwrap(), [n as u32, n as u32 / 2, 7]);
            }
        }
    }

    #[test]
    fn no_scratch_folder_is_an_error_that_names_it() {
        let mut store = Store::new(0, Path::new("/no/such/folder"));
        store.push(1u32).unwrap();
        let message = store.push(2).unwrap_err().to_string();
        assert!(message.contains("/no/such/folder"), "{message}");
    }
}
