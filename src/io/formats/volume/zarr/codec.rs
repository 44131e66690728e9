//! Decodes the stored bytes of a chunk into samples.

use crate::formats::shared::codec::{blosc, gzip, read_to_end, unshuffle, unzstd};
use flate2::bufread::ZlibDecoder;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    Blosc,
    Gzip,
    Zlib,
    Zstd,
    /// numcodecs' LZ4: the length (u32), then one LZ4 block.
    Lz4,
    /// The last four bytes are the CRC32C of those before.
    Crc32c,
    /// Bytes of elements of this size, planes of equal bytes first.
    Shuffle(usize),
}

impl Codec {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Blosc => "Blosc",
            Self::Gzip => "gzip",
            Self::Zlib => "zlib",
            Self::Zstd => "zstd",
            Self::Lz4 => "LZ4",
            Self::Crc32c => "CRC32C",
            Self::Shuffle(_) => "shuffle",
        }
    }

    /// Decodes `stored` to at most `limit` bytes; one byte more is an error. An error is the
    /// reason, in words.
    fn decode(self, stored: &[u8], limit: usize) -> std::result::Result<Vec<u8>, String> {
        let mut out = vec![];
        match self {
            Self::Blosc => blosc::decode(stored, limit, &mut out)?,
            Self::Gzip => read_to_end(gzip::Members::new(stored), limit, &mut out)?,
            Self::Zlib => read_to_end(ZlibDecoder::new(stored), limit, &mut out)?,
            Self::Zstd => out = unzstd(stored, limit)?,
            Self::Lz4 => {
                let (length, block) = stored.split_first_chunk::<4>().ok_or("no length before LZ4 data")?;
                let length = u32::from_le_bytes(*length) as usize;
                // LZ4 gives at most 255 bytes for one.
                if length > limit || length > block.len().saturating_mul(255) {
                    return Err(format!("LZ4 data of {length} bytes"));
                }
                out = lz4_flex::block::decompress(block, length).map_err(|e| e.to_string())?;
            }
            Self::Crc32c => {
                let (bytes, sum) = stored.split_last_chunk::<4>().ok_or("no CRC32C")?;
                if crc32c::crc32c(bytes) != u32::from_le_bytes(*sum) {
                    return Err("another CRC32C than the one stored".into());
                }
                out = bytes.to_vec();
            }
            Self::Shuffle(size) => {
                out.resize(stored.len(), 0);
                unshuffle(stored, size, &mut out);
            }
        }
        Ok(out)
    }
}

/// Decodes what `codecs` encoded, the last one last, to exactly `needed` bytes.
pub(super) fn decode(codecs: &[Codec], stored: &[u8], needed: usize) -> std::result::Result<Vec<u8>, String> {
    // The bytes between two compressors may be a little longer than the samples.
    let between = needed.saturating_add(needed / 8).saturating_add(1 << 16);
    let mut bytes = None::<Vec<u8>>;
    for (left, codec) in codecs.iter().enumerate().rev() {
        let limit = if left == 0 { needed } else { between };
        bytes = Some(codec.decode(bytes.as_deref().unwrap_or(stored), limit)?);
    }
    let bytes = bytes.unwrap_or_else(|| stored.to_vec());
    if bytes.len() == needed { Ok(bytes) } else { Err(format!("{} bytes", bytes.len())) }
}
