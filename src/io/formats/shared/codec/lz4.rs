//! Decodes LZ4 as the HDF5 filter 32004 stores it: blocks of equal size, the last one excepted.
//!
//! ```text
//!  u64 bytes decoded │ u32 bytes of a block, decoded │ for each block: u32 length, bytes
//! ```
//!
//! Numbers have the highest byte first. A block whose length is that of its decoded bytes is stored
//! as it is.
//!
//! The format:
//! <https://github.com/HDFGroup/hdf5_plugins/blob/master/docs/RegisteredFilterPlugins.md>.

use super::Decoded;
use super::front::Front;

/// Decodes at most `limit` bytes.
pub(in crate::formats) fn decode(stored: &[u8], limit: usize) -> Decoded<Vec<u8>> {
    let mut front = Front(stored);
    let (size, block) = (front.size(limit)?, front.u32()?);
    if block == 0 {
        return Err("LZ4 blocks of 0 bytes".into());
    }
    let mut out = vec![0; size];
    for out in out.chunks_mut(block) {
        let length = front.u32()?;
        let bytes = front.bytes(length)?;
        if length == out.len() {
            out.copy_from_slice(bytes);
        } else {
            into(bytes, out)?;
        }
    }
    Ok(out)
}

/// Decodes one block of LZ4, which must fill `out`.
pub(super) fn into(stored: &[u8], out: &mut [u8]) -> Decoded<()> {
    let written = lz4_flex::block::decompress_into(stored, out).map_err(|e| e.to_string())?;
    if written == out.len() {
        Ok(())
    } else {
        Err(format!("an LZ4 block of {written} bytes in place of {}", out.len()))
    }
}
