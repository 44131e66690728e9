//! Unpacks a small stream into a volume in memory, because that takes less than a bricked copy on
//! disk.

use super::strided::StridedVolume;
use super::{SlabStream, VolumeInfo};
use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::grid::IndexBox;
use std::sync::Arc;

/// Bytes of the samples of a volume, as they are stored.
pub(crate) fn stored_bytes(info: &VolumeInfo) -> Option<u64> {
    IndexBox::whole(info.dims).checked_len()?.checked_mul(info.field.scalar.bytes() as u64)
}

/// Reads all of a stream.
///
/// # Errors
/// Those of the stream; [`Error::BadInput`] where it does not give each sample once.
pub fn unpack(mut stream: Box<dyn SlabStream>) -> Result<StridedVolume> {
    let info = stream.info().clone();
    let (whole, size) = (IndexBox::whole(info.dims), info.field.scalar.bytes());
    let bad = |expected: String, got: String| Error::bad_input(&info.path, "samples", expected, got);
    let bytes = stored_bytes(&info).and_then(|n| usize::try_from(n).ok());
    let strides = StridedVolume::packed_strides(info.dims, info.field.scalar);
    let (Some(bytes), Some(strides)) = (bytes, strides) else {
        return Err(bad("a volume that fits in memory".into(), format!("{:?}", info.dims)));
    };
    let (mut all, mut slab, mut written) = (vec![], vec![], 0u64);
    while let Some(part) = stream.next_slab(&mut slab)? {
        assert!(part.intersect(&whole) == part && slab.len() == part.len() * size, "the samples of a box");
        if part == whole && written == 0 {
            // Most small ones come at once.
            (all, written) = (std::mem::take(&mut slab), part.len() as u64);
            continue;
        }
        all.resize(bytes, 0);
        let row = part.dims()[0] as usize * size;
        let rows = (part.lo[2]..part.hi[2]).flat_map(|z| (part.lo[1]..part.hi[1]).map(move |y| [y, z]));
        for ([y, z], from) in rows.zip(slab.chunks_exact(row.max(1))) {
            let at = whole.offset([part.lo[0], y, z]) * size;
            all[at..at + row].copy_from_slice(from);
        }
        written += part.len() as u64;
    }
    if written != whole.len() as u64 {
        return Err(bad(format!("{} samples", whole.len()), written.to_string()));
    }
    let source = ByteSource::from_vec(&info.path, all);
    StridedVolume::new(info, Arc::new(source), 0, false, strides)
}
