//! Decodes Blosc 1: blocks that are shuffled and compressed separately.
//!
//! ```text
//!  0  version of the format (1, 2)       4  u32 bytes decoded        16  u32 place of each block
//!  1  version of the compressor          8  u32 bytes of a block     …   blocks
//!  2  flags                             12  u32 bytes of all this
//!  3  bytes of an element
//! ```
//!
//! Flags: 1 bytes shuffled, 2 stored as they are, 4 bits shuffled, 16 blocks not split; the upper
//! three bits are the compressor: BloscLZ, LZ4, Snappy, zlib, zstd. A split block of elements of n
//! bytes has n streams, so that after shuffling each holds one byte of all elements. A stream is
//! its length (u32) and its bytes; bytes of full length are stored uncompressed.
//!
//! The format: <https://github.com/Blosc/c-blosc/blob/main/README_CHUNK_FORMAT.rst>. Snappy is
//! refused by name.

use super::{Decoded, le32, unshuffle, unshuffle_bits};
use flate2::bufread::ZlibDecoder;
use std::io::Read;

/// Decodes `stored` into `out` (cleared first); at most `limit` bytes. An error is the reason, in
/// words.
pub(in crate::formats) fn decode(stored: &[u8], limit: usize, out: &mut Vec<u8>) -> Decoded<()> {
    let header = stored.get(..16).ok_or("fewer than the 16 bytes of a Blosc header")?;
    let u32_at = |at: usize| le32(stored, at).map(|n| n as usize).ok_or("a Blosc buffer that is cut short");
    let (version, flags, typesize) = (header[0], header[2], usize::from(header[3]).max(1));
    let (bytes, block, all) = (u32_at(4)?, u32_at(8)?, u32_at(12)?);
    if !(1..=2).contains(&version) {
        return Err(format!("version {version} of the Blosc format, of which 1 and 2 are read"));
    }
    if bytes > limit {
        return Err(format!("Blosc data of {bytes} bytes"));
    }
    let stored = stored.get(..all).ok_or(format!("{} of {all} bytes of Blosc data", stored.len()))?;
    out.clear();
    if flags & 2 != 0 {
        out.extend_from_slice(stored.get(16..16 + bytes).ok_or("Blosc data that are cut short")?);
        return Ok(());
    }
    if bytes > 0 && block == 0 {
        return Err("Blosc blocks of 0 bytes".into());
    }
    out.resize(bytes, 0);
    let mut shuffled = vec![];
    for (number, out) in out.chunks_mut(block.max(1)).enumerate() {
        let start = u32_at(16 + 4 * number)?;
        let streams = stored.get(start..).ok_or("a Blosc block beyond the end")?;
        let split = flags & 16 == 0 && typesize <= 16 && block / typesize >= 128 && out.len() == block;
        shuffled.resize(out.len(), 0);
        decode_block(flags >> 5, streams, if split { typesize } else { 1 }, &mut shuffled)?;
        match flags & 5 {
            1 if typesize > 1 => unshuffle(&shuffled, typesize, out),
            // Nothing is shuffled where a block has a few elements more than a multiple of eight.
            4 if (shuffled.len() / typesize).is_multiple_of(8) => {
                unshuffle_bits(&shuffled, typesize, out);
            }
            _ => out.copy_from_slice(&shuffled),
        }
    }
    Ok(())
}

fn decode_block(compressor: u8, mut streams: &[u8], splits: usize, out: &mut [u8]) -> Decoded<()> {
    let part = out.len() / splits;
    if part * splits != out.len() {
        return Err("a Blosc block that is no multiple of its elements".into());
    }
    for out in out.chunks_exact_mut(part) {
        let length = le32(streams, 0).ok_or("a Blosc block that is cut short")? as usize;
        let stream = streams.get(4..4 + length).ok_or("a Blosc stream that is cut short")?;
        streams = &streams[4 + length..];
        if length == part {
            out.copy_from_slice(stream);
            continue;
        }
        decompress(compressor, stream, out)?;
    }
    Ok(())
}

/// Decodes a stream, which must fill `out`.
pub(super) fn decompress(compressor: u8, stream: &[u8], out: &mut [u8]) -> Decoded<()> {
    let written = match compressor {
        0 => blosclz(stream, out)?,
        1 => lz4_flex::block::decompress_into(stream, out).map_err(|e| e.to_string())?,
        3 => {
            ZlibDecoder::new(stream).read_exact(out).map_err(|e| e.to_string())?;
            out.len()
        }
        4 => zstd::bulk::decompress_to_buffer(stream, out).map_err(|e| e.to_string())?,
        2 => return Err("Blosc's Snappy, which is not read".into()),
        n => return Err(format!("Blosc's compressor {n}, which is unknown")),
    };
    if written == out.len() {
        Ok(())
    } else {
        Err(format!("a Blosc stream of {written} bytes in place of {}", out.len()))
    }
}

/// BloscLZ, a kind of FastLZ. Gives the number of bytes written.
fn blosclz(stored: &[u8], out: &mut [u8]) -> std::result::Result<usize, String> {
    /// Distances beyond this have two bytes more.
    const FAR: usize = 8191;
    let cut = || "BloscLZ data that are cut short".to_string();
    let mut input = stored.iter().map(|&b| usize::from(b));
    let mut next = || input.next();
    // The first code is of literals, for any upper bits.
    let (mut code, mut at) = (next().ok_or_else(cut)? & 31, 0);
    loop {
        if code < 32 {
            for _ in 0..=code {
                *out.get_mut(at).ok_or("BloscLZ data that are too long")? = next().ok_or_else(cut)? as u8;
                at += 1;
            }
        } else {
            let (mut length, mut distance) = ((code >> 5) + 2, (code & 31) << 8);
            if code >> 5 == 7 {
                loop {
                    let more = next().ok_or_else(cut)?;
                    length += more;
                    if more != 255 {
                        break;
                    }
                }
            }
            let low = next().ok_or_else(cut)?;
            if low == 255 && distance == 31 << 8 {
                distance = (next().ok_or_else(cut)? << 8) + next().ok_or_else(cut)? + FAR;
            } else {
                distance += low;
            }
            let from = at.checked_sub(distance + 1).ok_or("a BloscLZ match before the start")?;
            if at + length > out.len() {
                return Err("BloscLZ data that are too long".into());
            }
            (0..length).for_each(|i| out[at + i] = out[from + i]);
            at += length;
        }
        match next() {
            Some(next) => code = next,
            None => return Ok(at),
        }
    }
}

/// Bytes of a block that is written, at most.
const BLOCK: usize = 1 << 18;
/// The level of zstd for what is written.
const LEVEL: i32 = 3;

/// Encodes bytes of elements of `typesize` bytes, less than 2^31 of them: blocks with their bytes
/// shuffled, each one stream of zstd.
pub(in crate::formats) fn encode(bytes: &[u8], typesize: usize) -> std::io::Result<Vec<u8>> {
    // Other decoders refuse blocks that are larger than all.
    let block = BLOCK.min(bytes.len()).max(1);
    let blocks = bytes.len().div_ceil(block);
    // Shuffled if elements have several bytes, not split, zstd.
    let flags = u8::from(typesize > 1) | 16 | 4 << 5;
    let mut out = vec![2, 1, flags, typesize as u8];
    out.extend((bytes.len() as u32).to_le_bytes());
    out.extend((block as u32).to_le_bytes());
    // The length of all, and the places of the blocks, are known when they are there.
    out.resize(16 + 4 * blocks, 0);
    let (mut compressor, mut shuffled) = (zstd::bulk::Compressor::new(LEVEL)?, vec![]);
    for (number, block) in bytes.chunks(block).enumerate() {
        let at = out.len() as u32;
        out[16 + 4 * number..][..4].copy_from_slice(&at.to_le_bytes());
        shuffle(block, typesize, &mut shuffled);
        let packed = compressor.compress(&shuffled)?;
        // Of full length, a stream is stored as it is.
        let stream = if packed.len() < block.len() { &packed } else { &shuffled };
        out.extend((stream.len() as u32).to_le_bytes());
        out.extend_from_slice(stream);
    }
    let all = out.len() as u32;
    out[12..16].copy_from_slice(&all.to_le_bytes());
    Ok(out)
}

/// The first bytes of all elements, then the second ones, and so on; what is left over at the end.
fn shuffle(bytes: &[u8], typesize: usize, out: &mut Vec<u8>) {
    out.clear();
    let whole = bytes.len() / typesize * typesize;
    for n in 0..typesize {
        out.extend(bytes[..whole].iter().skip(n).step_by(typesize));
    }
    out.extend_from_slice(&bytes[whole..]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_encoded_is_decoded() {
        for (typesize, count) in [(1, 5), (2, 300_000), (4, 100_000), (8, 65_537), (4, 0)] {
            let bytes: Vec<u8> =
                (0..count * typesize).map(|i: usize| ((i * i % 251) >> (i % 4)) as u8).collect();
            let mut decoded = vec![];
            decode(&encode(&bytes, typesize).unwrap(), bytes.len(), &mut decoded).unwrap();
            assert!(decoded == bytes, "{typesize} {count}");
        }
    }
}
