//! Compressors and filters that several formats have. Each decodes into at most as many bytes as
//! its caller allows. An error is the reason, in words.

#[cfg(feature = "hdf5")]
pub(in crate::formats) mod bitshuffle;
pub(in crate::formats) mod blosc;
#[cfg(feature = "hdf5")]
pub(in crate::formats) mod blosc2;
#[cfg(feature = "hdf5")]
mod front;
pub(in crate::formats) mod gzip;
#[cfg(feature = "hdf5")]
pub(in crate::formats) mod lz4;
#[cfg(feature = "hdf5")]
pub(in crate::formats) mod lzf;

use byteorder::{ByteOrder, LE};
use std::io::Read;

/// What was decoded, or what is wrong.
pub(in crate::formats) type Decoded<T> = std::result::Result<T, String>;

/// Reads a decoder to its end, which is an error beyond `limit` bytes.
pub(in crate::formats) fn read_to_end(decoder: impl Read, limit: usize, out: &mut Vec<u8>) -> Decoded<()> {
    decoder.take(limit as u64 + 1).read_to_end(out).map_err(|e| e.to_string())?;
    if out.len() > limit { Err(format!("more than {limit} bytes")) } else { Ok(()) }
}

/// Decodes frames of zstd.
pub(in crate::formats) fn unzstd(stored: &[u8], limit: usize) -> Decoded<Vec<u8>> {
    let frames = zstd::stream::read::Decoder::with_buffer(stored).map_err(|e| e.to_string())?;
    let mut out = vec![];
    read_to_end(frames, limit, &mut out)?;
    Ok(out)
}

/// Byte b of element i was stored at b · count + i; bytes after the last whole element as they are.
pub(in crate::formats) fn unshuffle(stored: &[u8], typesize: usize, out: &mut [u8]) {
    let count = stored.len() / typesize;
    for (b, plane) in stored[..count * typesize].chunks_exact(count.max(1)).enumerate() {
        out[b..].iter_mut().step_by(typesize).zip(plane).for_each(|(o, p)| *o = *p);
    }
    out[count * typesize..].copy_from_slice(&stored[count * typesize..]);
}

/// Bit k of byte b of element i was stored as bit i mod 8 of byte (8 b + k) · count / 8 + i / 8.
/// What follows the last eight elements is as it was.
fn unshuffle_bits(stored: &[u8], typesize: usize, out: &mut [u8]) {
    let row = stored.len() / typesize / 8;
    let (shuffled, rest) = stored.split_at(8 * row * typesize);
    let (unshuffled, out_rest) = out.split_at_mut(shuffled.len());
    out_rest.copy_from_slice(rest);
    if row == 0 {
        return;
    }
    for (b, rows) in shuffled.chunks_exact(8 * row).enumerate() {
        for (i8, elements) in unshuffled.chunks_exact_mut(8 * typesize).enumerate() {
            let bits = u64::from_le_bytes(std::array::from_fn(|k| rows[k * row + i8]));
            let bytes = transposed(bits).to_le_bytes();
            elements[b..].iter_mut().step_by(typesize).zip(bytes).for_each(|(o, byte)| *o = byte);
        }
    }
}

/// Eight rows of eight bits as columns (Warren, "Hacker's Delight", section 7-3).
fn transposed(mut bits: u64) -> u64 {
    for (mask, shift) in
        [(0x00aa_00aa_00aa_00aa, 7), (0x0000_cccc_0000_cccc, 14), (0x0000_0000_f0f0_f0f0, 28)]
    {
        let swapped = (bits ^ bits >> shift) & mask;
        bits ^= swapped ^ swapped << shift;
    }
    bits
}

/// A number of four bytes, the lowest first.
fn le32(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at.checked_add(4)?).map(LE::read_u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_go_where_they_were() {
        for typesize in [1, 2, 3, 8] {
            let bytes: Vec<u8> =
                (0..35 * typesize).map(|i| (i as u32).wrapping_mul(2_654_435_761).to_le_bytes()[3]).collect();
            let mut stored = bytes.clone();
            stored[..32 * typesize].fill(0);
            for (i, b, k) in
                (0..32).flat_map(|i| (0..typesize).flat_map(move |b| (0..8).map(move |k| (i, b, k))))
            {
                stored[(8 * b + k) * 4 + i / 8] |= (bytes[i * typesize + b] >> k & 1) << (i % 8);
            }
            let mut out = vec![0; bytes.len()];
            unshuffle_bits(&stored, typesize, &mut out);
            assert_eq!(out, bytes);
        }
    }
}
