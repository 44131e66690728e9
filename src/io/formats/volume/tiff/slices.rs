//! A stack of uncompressed slices in separate files, read in place.

use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::formats::shared::recent::{MOST_OPEN, Recent};
use crate::grid::IndexBox;
use crate::volume::strided::StridedVolume;
use crate::volume::{VolumeInfo, VolumeReader};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

/// Slices in files of their own.
pub(super) struct SliceFiles {
    info: VolumeInfo,
    files: Vec<PathBuf>,
    /// The byte of the first sample in each file.
    offsets: Vec<u64>,
    big_endian: bool,
    io: IoMode,
    open: Recent<StridedVolume>,
}

impl SliceFiles {
    pub(super) fn new(
        info: VolumeInfo,
        files: Vec<PathBuf>,
        offsets: Vec<u64>,
        big_endian: bool,
        io: IoMode,
    ) -> Self {
        Self { info, files, offsets, big_endian, io, open: Recent::default() }
    }

    fn open(&self, z: u64) -> Result<Arc<StridedVolume>> {
        self.open.get(z as usize, || self.map(z as usize))
    }

    #[cfg(test)]
    pub(super) fn open_files(&self) -> usize {
        self.open.len()
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
