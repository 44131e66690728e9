//! Read-only mappings: the one place of `bytes` that needs `unsafe`.
//!
//! The promise that makes a mapping sound is one we ask of the user, as every program that maps its input does: **the
//! file is not changed or shortened while it is read.** A shortened file ends the process with SIGBUS; a changed one
//! gives the changed values.

#![allow(unsafe_code)]

use memmap2::{Mmap, MmapOptions};
use std::fs::File;
use std::io;
use std::ops::Range;

/// A whole file, mapped read-only.
#[derive(Debug)]
pub(super) struct Mapping(Mmap);

impl Mapping {
    pub(super) fn new(file: &File) -> io::Result<Self> {
        // SAFETY: the mapping is private and read-only, and lives as long as `Mmap`. The caller opened a regular file
        // of its own input; that nobody changes or shortens it meanwhile is the documented promise of this module.
        let map = unsafe { MmapOptions::new().map(file)? };
        Ok(Self(map))
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// A hint; refused hints are of no consequence.
    pub(super) fn advise_will_need(&self, range: Range<u64>) {
        #[cfg(unix)]
        if range.start < range.end {
            let (start, len) = (range.start as usize, (range.end - range.start) as usize);
            let _ = self.0.advise_range(memmap2::Advice::WillNeed, start, len);
        }
        #[cfg(not(unix))]
        let _ = range;
    }
}
