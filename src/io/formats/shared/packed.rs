//! Volumes of one size that follow each other in a compressed range of a file. To find one, those
//! before it are decoded. So where several are read, all are unpacked once.

use super::pick_field;
use super::stream::{ByteSlabs, Codec, Tail, sample_bytes};
use crate::bytes::{ByteSource, IoMode};
use crate::error::{Error, Result};
use crate::exec::CancelToken;
use crate::volume::strided::StridedVolume;
use crate::volume::{VolumeInfo, VolumeReader, VolumeSource};
use std::io::{self, BufWriter, Read, Write};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Where such volumes are.
pub struct PackedFrames {
    pub(in crate::formats) source: Arc<ByteSource>,
    pub(in crate::formats) range: Range<u64>,
    pub(in crate::formats) codec: Codec,
    /// Decoded bytes before the first one.
    pub(in crate::formats) skip: u64,
    pub(in crate::formats) frames: u64,
    pub(in crate::formats) big_endian: bool,
    /// What may follow the last one.
    pub(in crate::formats) tail: Tail,
}

impl PackedFrames {
    /// One of the volumes, decoded from the beginning of the range.
    ///
    /// # Errors
    /// Those of [`ByteSlabs::new`].
    pub(in crate::formats) fn volume(&self, info: VolumeInfo, frame: u64) -> Result<VolumeSource> {
        let bytes = sample_bytes(&info.path, info.dims, info.field.scalar)?;
        let skip = self.skip.saturating_add(frame.saturating_mul(bytes));
        let tail = if frame + 1 == self.frames { self.tail } else { Tail::Ignored };
        let (range, big) = (self.range.clone(), self.big_endian);
        let slabs = ByteSlabs::new(info, &self.source, range, self.codec, skip, big, tail)?;
        Ok(VolumeSource::Stream(Box::new(slabs)))
    }

    /// Unpacks all of them into a nameless file in a folder; `info` describes one.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the range ends too early, is damaged, or has more where nothing may
    /// follow; [`Error::Io`] when the folder cannot be written; [`Error::Cancelled`].
    pub(in crate::formats) fn unpack(
        &self,
        info: VolumeInfo,
        folder: &Path,
        cancel: &CancelToken,
    ) -> Result<UnpackedFrames> {
        let needed = self.bytes(&info)?;
        let mut packed = self.codec.reader(&self.source, self.range.clone())?;
        let short = |got: String| {
            let expected = format!("{} frames, {needed} bytes from byte {} on", self.frames, self.skip);
            Error::bad_input(self.source.path(), "samples", expected, got)
        };
        let read = |e: io::Error| short(e.to_string());
        let skipped = io::copy(&mut packed.by_ref().take(self.skip), &mut io::sink()).map_err(read)?;
        let failed = |e| Error::io("write a temporary file in", folder, e);
        let mut out = BufWriter::with_capacity(1 << 18, tempfile::tempfile_in(folder).map_err(failed)?);
        let (mut left, mut buffer) = (needed, vec![0; 1 << 20]);
        while left > 0 {
            cancel.check()?;
            let want = left.min(buffer.len() as u64) as usize;
            let n = packed.read(&mut buffer[..want]).map_err(read)?;
            if n == 0 {
                return Err(short(format!("{} bytes", skipped + needed - left)));
            }
            out.write_all(&buffer[..n]).map_err(failed)?;
            left -= n as u64;
        }
        // Read to the end, because the checksum of all is there.
        match self.tail {
            Tail::Ignored => {}
            Tail::Checked => {
                io::copy(&mut packed, &mut io::sink()).map_err(read)?;
            }
            Tail::Nothing => match packed.read(&mut buffer[..1]).map_err(read)? {
                0 => {}
                _ => return Err(short("more".into())),
            },
        }
        let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
        let source = Arc::new(ByteSource::of_file(folder, file, IoMode::Map)?);
        Ok(UnpackedFrames { source, info, big_endian: self.big_endian })
    }

    /// Bytes of the samples of all of them.
    ///
    /// # Errors
    /// Those of [`sample_bytes`].
    pub(in crate::formats) fn bytes(&self, info: &VolumeInfo) -> Result<u64> {
        Ok(sample_bytes(&info.path, info.dims, info.field.scalar)?.saturating_mul(self.frames))
    }
}

/// The volumes of a file, unpacked.
pub struct UnpackedFrames {
    source: Arc<ByteSource>,
    /// The description of one of them.
    info: VolumeInfo,
    big_endian: bool,
}

impl UnpackedFrames {
    /// A frame by the name of its field.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is none of that name.
    pub fn open(&self, name: &str) -> Result<Box<dyn VolumeReader>> {
        let frame = pick_field(&self.info.path, &self.info.fields, Some(name))?;
        let info = VolumeInfo { field: self.info.fields[frame].clone(), ..self.info.clone() };
        let bytes = sample_bytes(&info.path, info.dims, info.field.scalar)?;
        let strides =
            StridedVolume::packed_strides(info.dims, info.field.scalar).expect("fewer than 2^63 bytes");
        let at = frame as u64 * bytes;
        Ok(Box::new(StridedVolume::new(info, self.source.clone(), at, self.big_endian, strides)?))
    }
}
