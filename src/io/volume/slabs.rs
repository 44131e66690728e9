//! A volume as a sequence of slabs: the order in which streams deliver, and random-access volumes
//! read as streams.
//!
//! The slabs of a volume are, front to back, as many whole slices as fit in a mebibyte; where a
//! slice is larger, as many whole rows; where a row is larger, one row. They tile the volume in the
//! order of its samples, x fastest.

use crate::error::Result;
use crate::grid::IndexBox;
use crate::volume::{SlabStream, VolumeInfo, VolumeReader};

/// Bytes of a slab, unless a single row has more.
const SLAB_BYTES: u64 = 1 << 20;

/// Bytes of a slab of a decoded chunk, unless a slice of that has more.
pub(crate) const CHUNK_SLAB_BYTES: u64 = 4 << 20;

/// Samples that have been read are released once there are this many.
const RELEASE_SAMPLES: u64 = 8 << 20;

/// The boxes of a volume's slabs, front to back.
#[derive(Clone, Debug)]
pub struct SlabWalk {
    dims: [u64; 3],
    /// Rows of a slab: several slices' worth, or a part of one slice's.
    rows: u64,
    slices: u64,
    next: [u64; 2],
}

impl SlabWalk {
    /// The slabs of a volume of `dims` samples of `sample_bytes` bytes; none where a dimension
    /// is 0.
    pub fn new(dims: [u64; 3], sample_bytes: usize) -> Self {
        let row = dims[0].saturating_mul(sample_bytes as u64).max(1);
        let slice = row.saturating_mul(dims[1]).max(1);
        let (rows, slices) = ((SLAB_BYTES / row).clamp(1, dims[1].max(1)), (SLAB_BYTES / slice).max(1));
        let start = if dims.contains(&0) { dims[2] } else { 0 };
        Self { dims, rows, slices, next: [0, start] }
    }
}

impl Iterator for SlabWalk {
    type Item = IndexBox;

    fn next(&mut self) -> Option<IndexBox> {
        let (d, [y, z]) = (self.dims, self.next);
        if z >= d[2] {
            return None;
        }
        let hi = [
            d[0],
            d[1].min(y + self.rows),
            if self.rows == d[1] { d[2].min(z + self.slices) } else { z + 1 },
        ];
        self.next = if hi[1] == d[1] { [0, hi[2]] } else { [hi[1], z] };
        Some(IndexBox { lo: [0, y, z], hi })
    }
}

/// Appends to `out` the first slab of what is left of a decoded chunk: whole slices, of samples of
/// `size` bytes. `bytes` ends with all that is left.
pub(crate) fn cut_slab(left: &mut IndexBox, bytes: &[u8], size: usize, out: &mut Vec<u8>) -> IndexBox {
    let d = left.dims();
    let slice = d[0] * d[1] * size as u64;
    let slices = (CHUNK_SLAB_BYTES / slice).max(1);
    // At boundaries of 32: the bricks that are copied to.
    let slices = if slices >= 32 { slices / 32 * 32 } else { slices }.min(d[2]);
    let at = bytes.len() - (slice * d[2]) as usize;
    out.extend_from_slice(&bytes[at..at + (slice * slices) as usize]);
    let mut slab = *left;
    slab.hi[2] = slab.lo[2] + slices;
    left.lo[2] = slab.hi[2];
    slab
}

/// A random-access volume as a stream of its stored samples.
pub struct ReaderSlabs {
    reader: Box<dyn VolumeReader>,
    info: VolumeInfo,
    walk: SlabWalk,
    /// Slices before this one have been given up.
    released: u64,
}

impl ReaderSlabs {
    /// Reads `reader` front to back.
    pub fn new(reader: Box<dyn VolumeReader>) -> Self {
        let info = reader.stored_info();
        let walk = SlabWalk::new(info.dims, info.field.scalar.bytes());
        Self { reader, info, walk, released: 0 }
    }
}

impl SlabStream for ReaderSlabs {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        out.clear();
        let Some(slab) = self.walk.next() else { return Ok(None) };
        out.resize(slab.len() * self.info.field.scalar.bytes(), 0);
        self.reader.read_stored(slab, out)?;
        let (behind, slice) = (slab.lo[2], self.info.dims[0] * self.info.dims[1]);
        if (behind - self.released).saturating_mul(slice) >= RELEASE_SAMPLES {
            self.reader.release(self.released..behind);
            self.released = behind;
        }
        Ok(Some(slab))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slabs_follow_the_order_of_the_samples() {
        for (dims, bytes) in [
            ([5, 4, 3], 2),
            ([1 << 19, 3, 2], 2),
            ([1 << 21, 2, 2], 1),
            ([1000, 1000, 5], 4),
            ([64, 64, 600], 8),
        ] {
            let mut next = 0;
            for slab in SlabWalk::new(dims, bytes) {
                assert_eq!(IndexBox::whole(dims).offset(slab.lo), next);
                let d = slab.dims();
                assert!(d[2] == 1 || d[1] == dims[1], "a slab is contiguous");
                assert!((slab.len() * bytes) as u64 <= SLAB_BYTES || d[1] * d[2] == 1);
                next += slab.len();
            }
            assert_eq!(next as u64, dims.iter().product::<u64>());
        }
        assert_eq!(SlabWalk::new([3, 0, 2], 4).count(), 0);
    }
}
