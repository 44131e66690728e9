//! Decodes bitshuffle, the HDF5 filter 32008: blocks of elements, their bits shuffled, then
//! compressed or not.
//!
//! ```text
//!  compressed:   u64 bytes decoded │ u32 bytes of a block, decoded │ for each block: u32 length, bytes │ rest
//!  as they are:  blocks │ rest
//! ```
//!
//! Numbers have the highest byte first. The last block has the elements that are left, down to a
//! multiple of eight; up to seven more are the rest, as they were.
//!
//! The format: Masui et al. 2015, "A compression scheme for radio data in high performance
//! computing"; <https://github.com/kiyo-masui/bitshuffle/blob/master/src/bshuf_h5filter.c>.

use super::front::Front;
use super::{Decoded, lz4, unshuffle_bits};

/// Bytes of a block whose size is not given.
const USUAL_BLOCK: usize = 8192;
/// The fewest elements of such a block.
const FEWEST: usize = 128;

/// Decodes at most `limit` bytes. `settings` are those of the filter: version (two numbers), bytes
/// of an element, elements of a block, compressor.
pub(in crate::formats) fn decode(stored: &[u8], settings: &[u32], limit: usize) -> Decoded<Vec<u8>> {
    let setting = |at: usize| settings.get(at).map_or(0, |&n| n as usize);
    let (element, compressor) = (setting(2), setting(4));
    if element == 0 || element > 1 << 16 {
        return Err(format!("bitshuffle of elements of {element} bytes"));
    }
    let mut front = Front(stored);
    let (size, block) = match (compressor, setting(3)) {
        (0, 0) => (stored.len(), (USUAL_BLOCK / element / 8 * 8).max(FEWEST).saturating_mul(element)),
        (0, elements) => (stored.len(), elements.saturating_mul(element)),
        _ => (front.size(limit)?, front.u32()?),
    };
    if size > limit {
        return Err(format!("more than {limit} bytes"));
    }
    if block == 0 || !block.is_multiple_of(8 * element) {
        return Err(format!("bitshuffle blocks of {block} bytes, which are no multiple of 8 elements"));
    }
    let mut out = vec![0; size];
    let (whole, rest) = out.split_at_mut(size - size % (8 * element));
    let mut shuffled = vec![0; block.min(size)];
    for out in whole.chunks_mut(block) {
        let shuffled = &mut shuffled[..out.len()];
        match compressor {
            0 => shuffled.copy_from_slice(front.bytes(out.len())?),
            2 | 3 => {
                let length = front.u32()?;
                let bytes = front.bytes(length)?;
                if compressor == 2 {
                    lz4::into(bytes, shuffled)?;
                } else {
                    let written =
                        zstd::bulk::decompress_to_buffer(bytes, shuffled).map_err(|e| e.to_string())?;
                    if written != shuffled.len() {
                        return Err(format!("a zstd block of {written} bytes"));
                    }
                }
            }
            other => return Err(format!("bitshuffle's compressor {other}, which is unknown")),
        }
        unshuffle_bits(shuffled, element, out);
    }
    rest.copy_from_slice(front.bytes(rest.len())?);
    Ok(out)
}
