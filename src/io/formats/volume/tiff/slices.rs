//! A stack of uncompressed slices in separate files, read in place.
//!
//! A stack may have more files than a process may have open (often 1024). So files are opened when
//! a slice is first needed, and the most recently used ones stay open. Chunks come in layers along
//! z: neighbours need the same slices.

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::grid::IndexBox;
use crate::volume::strided::StridedVolume;
use crate::volume::{VolumeInfo, VolumeReader};
use rustc_hash::FxHashMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// The most files that stay open.
const MOST_OPEN: usize = 400;

/// Slices in files of their own.
pub(super) struct SliceFiles {
    info: VolumeInfo,
    files: Vec<PathBuf>,
    /// The byte of the first sample in each file.
    offsets: Vec<u64>,
    big_endian: bool,
    io: IoMode,
    open: Mutex<Open>,
}

#[derive(Default)]
struct Open {
    /// By slice, with the time of last use.
    slices: FxHashMap<u64, (u64, Arc<StridedVolume>)>,
    clock: u64,
}

impl SliceFiles {
    pub(super) fn new(
        info: VolumeInfo,
        files: Vec<PathBuf>,
        offsets: Vec<u64>,
        big_endian: bool,
        io: IoMode,
    ) -> Self {
        Self { info, files, offsets, big_endian, io, open: Mutex::default() }
    }

    fn open(&self, z: u64) -> Result<Arc<StridedVolume>> {
        let mut open = self.open.lock().expect("no thread panics while it holds the lock");
        open.clock += 1;
        let now = open.clock;
        if let Some((used, slice)) = open.slices.get_mut(&z) {
            *used = now;
            return Ok(Arc::clone(slice));
        }
        if open.slices.len() >= MOST_OPEN {
            // Half of them at once, so that the search costs little each.
            let mut times: Vec<u64> = open.slices.values().map(|(used, _)| *used).collect();
            times.sort_unstable();
            let middle = times[times.len() / 2];
            open.slices.retain(|_, (used, _)| *used > middle);
        }
        let slice = Arc::new(self.map(z as usize)?);
        open.slices.insert(z, (now, Arc::clone(&slice)));
        Ok(slice)
    }

    #[cfg(test)]
    pub(super) fn open_files(&self) -> usize {
        self.open.lock().expect("no thread panics while it holds the lock").slices.len()
    }

    fn map(&self, z: usize) -> Result<StridedVolume> {
        let source = Arc::new(ByteSource::open(&self.files[z], self.io)?);
        let mut info = self.info.clone();
        (info.dims[2], info.data_files) = (1, vec![]);
        let strides = StridedVolume::packed_strides(info.dims, info.field.scalar).ok_or_else(|| {
            let got = format!("{} x {}", info.dims[0], info.dims[1]);
            Error::bad_input(&self.files[z], "dimensions", "fewer than 2^63 bytes", got)
        })?;
        StridedVolume::new(info, source, self.offsets[z], self.big_endian, strides)
    }

    /// Calls `take` with each slice of a box, the part of the box in it, and its range in the box's
    /// array of samples.
    fn each(
        &self,
        voxels: IndexBox,
        mut take: impl FnMut(&StridedVolume, IndexBox, Range<usize>) -> Result<()>,
    ) -> Result<()> {
        let mut part = voxels;
        (part.lo[2], part.hi[2]) = (0, 1);
        let count = part.len();
        for (i, z) in (voxels.lo[2]..voxels.hi[2]).enumerate() {
            take(&*self.open(z)?, part, i * count..(i + 1) * count)?;
        }
        Ok(())
    }
}

impl VolumeReader for SliceFiles {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        assert_eq!(out.len(), voxels.len(), "the output has the size of the box");
        self.each(voxels, |slice, part, range| slice.read_box(part, &mut out[range]))
    }

    fn stored_info(&self) -> VolumeInfo {
        self.info.clone()
    }

    fn read_stored(&self, voxels: IndexBox, out: &mut [u8]) -> Result<()> {
        let size = self.info.field.scalar.bytes();
        assert_eq!(out.len(), voxels.len() * size, "the output has the size of the box");
        self.each(voxels, |slice, part, range| {
            slice.read_stored(part, &mut out[range.start * size..range.end * size])
        })
    }

    fn will_need(&self, voxels: IndexBox) {
        // A hint must not close files that are in use, so it covers only the first slices of a tall
        // box.
        let mut voxels = voxels;
        voxels.hi[2] = voxels.hi[2].min(voxels.lo[2] + MOST_OPEN as u64 / 2);
        // A file that cannot be opened is an error when it is read.
        let _ = self.each(voxels, |slice, part, _| {
            slice.will_need(part);
            Ok(())
        });
    }
}
