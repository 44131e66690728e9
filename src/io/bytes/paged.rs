//! Records with random access within a given memory: they lie in pages, the least recently used
//! ones on disk.
//!
//! For example, work on a surface jumps between the vertices of a triangle, and most of these are
//! close in the order of numbers. So pages are kept as long as memory suffices. A page that was not
//! needed for a whole round of the clock hand is written to a nameless file of the scratch folder.
//! Where all pages fit, no file is made.
//!
//! Memory: the pages, and 5 bytes for each 4096 records.

use super::store::{read_at, write_at};
use crate::error::{Error, Result};
use bytemuck::Pod;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Records of a page.
const PAGE: usize = 1 << 12;
/// The least number of pages kept, with any memory: those of a triangle and one more.
const LEAST_FRAMES: usize = 4;
const NONE: u32 = u32::MAX;

/// An array of a fixed length, at first all zero bytes.
#[derive(Debug)]
pub struct Paged<T> {
    len: u64,
    most_frames: usize,
    /// Frame of each page; `NONE` when it is not in memory.
    frame_of: Vec<u32>,
    /// Whether a page is in the file.
    written: Vec<bool>,
    frames: Vec<PageFrame<T>>,
    hand: usize,
    file: Option<File>,
    scratch: PathBuf,
}

#[derive(Debug)]
struct PageFrame<T> {
    page: u32,
    needed: bool,
    changed: bool,
    records: Vec<T>,
}

impl<T: Pod> Paged<T> {
    /// `len` records of zero bytes, up to about `memory_bytes` of them in memory.
    pub fn new(len: u64, memory_bytes: u64, scratch: &Path) -> Self {
        let pages = len.div_ceil(PAGE as u64) as usize;
        let fit = (memory_bytes / (PAGE * size_of::<T>()) as u64) as usize;
        Self {
            len,
            most_frames: fit.max(LEAST_FRAMES),
            frame_of: vec![NONE; pages],
            written: vec![false; pages],
            frames: vec![],
            hand: 0,
            file: None,
            scratch: scratch.to_path_buf(),
        }
    }

    /// Number of records.
    #[allow(clippy::len_without_is_empty, reason = "who counts asks for the number")]
    pub fn len(&self) -> u64 {
        self.len
    }

    /// A record.
    #[inline]
    pub fn get(&mut self, at: u64) -> Result<T> {
        let frame = self.frame(at)?;
        Ok(self.frames[frame].records[at as usize % PAGE])
    }

    /// Replaces a record.
    #[inline]
    pub fn set(&mut self, at: u64, record: T) -> Result<()> {
        *self.change(at)? = record;
        Ok(())
    }

    /// A record, to be changed.
    #[inline]
    pub fn change(&mut self, at: u64) -> Result<&mut T> {
        let frame = self.frame(at)?;
        let frame = &mut self.frames[frame];
        frame.changed = true;
        Ok(&mut frame.records[at as usize % PAGE])
    }

    #[inline]
    fn frame(&mut self, at: u64) -> Result<usize> {
        debug_assert!(at < self.len);
        let page = at as usize / PAGE;
        match self.frame_of[page] {
            NONE => self.load(page),
            frame => {
                self.frames[frame as usize].needed = true;
                Ok(frame as usize)
            }
        }
    }

    #[cold]
    fn load(&mut self, page: usize) -> Result<usize> {
        let frame = self.free_frame()?;
        let slot = &mut self.frames[frame];
        (slot.page, slot.needed, slot.changed) = (page as u32, true, false);
        if self.written[page] {
            let file = self.file.as_ref().expect("a page is written only after the file was made");
            read_at(file, bytemuck::cast_slice_mut(&mut slot.records), Self::offset(page))
                .map_err(|e| Error::io("read records from a temporary file in", &self.scratch, e))?;
        } else {
            slot.records.fill(T::zeroed());
        }
        self.frame_of[page] = frame as u32;
        Ok(frame)
    }

    /// A frame that no page is in: a new one, or that of a page that was not needed for a round.
    fn free_frame(&mut self) -> Result<usize> {
        if self.frames.len() < self.most_frames {
            // A short array takes a short page.
            let records = vec![T::zeroed(); PAGE.min(self.len as usize)];
            self.frames.push(PageFrame { page: NONE, needed: false, changed: false, records });
            return Ok(self.frames.len() - 1);
        }
        while std::mem::take(&mut self.frames[self.hand].needed) {
            self.hand = (self.hand + 1) % self.frames.len();
        }
        let frame = self.hand;
        self.hand = (self.hand + 1) % self.frames.len();
        let page = self.frames[frame].page as usize;
        if self.frames[frame].changed {
            self.write(frame, page)?;
        }
        self.frame_of[page] = NONE;
        Ok(frame)
    }

    fn write(&mut self, frame: usize, page: usize) -> Result<()> {
        let made = match self.file.take() {
            Some(file) => Ok(file),
            None => tempfile::tempfile_in(&self.scratch),
        };
        let file = made.map_err(|e| Error::io("make a temporary file in", &self.scratch, e))?;
        let file = self.file.insert(file);
        write_at(file, bytemuck::cast_slice(&self.frames[frame].records), Self::offset(page))
            .map_err(|e| Error::io("write records to a temporary file in", &self.scratch, e))?;
        self.written[page] = true;
        Ok(())
    }

    fn offset(page: usize) -> u64 {
        page as u64 * (PAGE * size_of::<T>()) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_those_of_an_array_whatever_the_memory() {
        let scratch = tempfile::tempdir().unwrap();
        let len = 20 * PAGE as u64 + 17;
        for memory in [0, 7 * PAGE as u64 * 8, 1 << 30] {
            let mut paged = Paged::<u64>::new(len, memory, scratch.path());
            let mut array = vec![0u64; len as usize];
            let mut at = 1u64;
            for n in 0..30_000 {
                at = at.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let i = (at >> 33) % len;
                assert_eq!(paged.get(i).unwrap(), array[i as usize], "{memory} bytes of memory");
                if n % 3 == 0 {
                    paged.set(i, at).unwrap();
                    array[i as usize] = at;
                }
            }
            assert_eq!(paged.frames.len(), paged.most_frames.min(21));
            assert_eq!(paged.file.is_some(), memory < 1 << 30);
            assert!((0..len).all(|i| paged.get(i).unwrap() == array[i as usize]));
        }
        assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0, "the files have no names");
    }

    #[test]
    fn a_short_array_takes_a_short_page() {
        let mut paged = Paged::<u8>::new(3, 0, Path::new("."));
        paged.set(2, 9).unwrap();
        assert_eq!((paged.get(2).unwrap(), paged.get(0).unwrap(), paged.frames[0].records.len()), (9, 0, 3));
    }
}
