//! Decodes Blosc 2 as the HDF5 filter 32026 stores it: a frame of one chunk.
//!
//! ```text
//!  frame:  header (msgpack) │ chunk │ chunk of the offsets of chunks │ trailer
//!  header: 11 u32 bytes of the header, 30 u64 bytes decoded, 39 u64 bytes of all chunks; the highest byte first;
//!          the array b2nd, if there is one: axes, shape, shape of a chunk, shape of a block
//!  chunk:  as of Blosc 1 (see the module blosc); then, if both of its shuffle flags are set: 16 six filters,
//!          24 what each takes, 31 more flags, 32 the places of blocks
//! ```
//!
//! Filters are undone last first: bytes shuffled, bits shuffled, differences (of the first block to
//! the element before, of others to the first block), bits dropped (nothing to undo). A stream of
//! length 0 is zeros, one of negative length a byte repeated. A chunk may be special: zeros, NaN,
//! or one value repeated; as an offset, zeros or NaN have no chunk at all.
//!
//! **Arrays.** The chunk of an array of several axes has its blocks one after another, as boxes,
//! the last along each axis padded.
//!
//! The format: <https://github.com/Blosc/c-blosc2>, README_CFRAME_FORMAT, README_CHUNK_FORMAT,
//! README_B2ND_METALAYER.

use super::{Decoded, blosc, le32, unshuffle, unshuffle_bits};
use byteorder::{BE, ByteOrder, LE};

/// Bytes of the header of a chunk.
const HEADER: usize = 32;
/// The most axes of an array.
const MOST_AXES: usize = 8;

/// Decodes a frame of at most one chunk and `limit` bytes.
pub(in crate::formats) fn decode(stored: &[u8], limit: usize) -> Decoded<Vec<u8>> {
    let cut = || String::from("a Blosc 2 frame that is cut short");
    let header = stored.get(..63).ok_or_else(cut)?;
    if &header[2..10] != b"b2frame\0" {
        return Err("another beginning than that of a Blosc 2 frame".into());
    }
    let header_bytes = BE::read_u32(&header[11..]) as usize;
    let number = |at: usize| {
        let number = BE::read_u64(&header[at..]);
        usize::try_from(number).map_err(|_| format!("a Blosc 2 frame of {number} bytes"))
    };
    let (size, all) = (number(30)?, number(39)?);
    let typesize = BE::read_u32(&header[48..]) as usize;
    let chunk_size = BE::read_u32(&header[58..]) as usize;
    if size > chunk_size {
        return Err("a Blosc 2 frame of several chunks".into());
    }
    let shapes = Shapes::of(stored.get(..header_bytes).ok_or_else(cut)?, typesize)?;
    let padded = shapes.as_ref().map_or(Ok(size), Shapes::padded)?;
    // Padding at most doubles each of three axes.
    if size != padded || size > limit.saturating_mul(8) {
        return Err(format!("Blosc 2 data of {size} bytes"));
    }
    let chunks = stored.get(header_bytes..).ok_or_else(cut)?;
    let offsets = chunk(chunks.get(all..).ok_or_else(cut)?, 8)?;
    let offset = offsets.get(..8).map(LE::read_i64).ok_or_else(cut)?;
    let decoded = match usize::try_from(offset) {
        Ok(offset) => chunk(chunks.get(offset..).ok_or_else(cut)?, size)?,
        Err(_) => repeated((offset >> 56 & 0x7f) as u8, typesize, &[], size)?,
    };
    if decoded.len() != size {
        return Err(format!("a Blosc 2 chunk of {} bytes in place of {size}", decoded.len()));
    }
    let out = match shapes {
        Some(shapes) => shapes.in_order(&decoded, limit)?,
        None => decoded,
    };
    if out.len() > limit { Err(format!("more than {limit} bytes")) } else { Ok(out) }
}

/// A chunk of one value: a special kind of chunk.
fn repeated(kind: u8, typesize: usize, value: &[u8], size: usize) -> Decoded<Vec<u8>> {
    let value = match (kind, typesize) {
        // Of no value at all, which the writer promised not to read.
        (1 | 4, _) => vec![0],
        (2, 4) => f32::NAN.to_le_bytes().to_vec(),
        (2, 8) => f64::NAN.to_le_bytes().to_vec(),
        (3, _) if !value.is_empty() => value.to_vec(),
        _ => return Err(format!("a special Blosc 2 chunk of kind {kind}")),
    };
    Ok(value.iter().copied().cycle().take(size).collect())
}

/// Decodes a chunk of at most `limit` bytes.
fn chunk(stored: &[u8], limit: usize) -> Decoded<Vec<u8>> {
    let cut = || String::from("a Blosc 2 chunk that is cut short");
    let header = stored.get(..HEADER).ok_or_else(cut)?;
    let (version, flags, typesize) = (header[0], header[2], usize::from(header[3]).max(1));
    let [bytes, block, all] = [4, 8, 12].map(|at| LE::read_u32(&header[at..]) as usize);
    if !(3..=5).contains(&version) || flags & 5 != 5 {
        return Err(format!("version {version} of the Blosc 2 format, of which 3 to 5 are read"));
    }
    if bytes > limit {
        return Err(format!("Blosc 2 data of {bytes} bytes"));
    }
    let stored = stored.get(..all).ok_or_else(cut)?;
    let (filters, settings, more) = (&header[16..22], &header[24..30], header[31]);
    if more & 1 != 0 {
        return Err("Blosc 2 data with a dictionary, which are not read".into());
    }
    if more >> 4 & 7 != 0 {
        return repeated(more >> 4 & 7, typesize, &stored[HEADER..], bytes);
    }
    if flags & 2 != 0 {
        return stored.get(HEADER..HEADER + bytes).map(<[u8]>::to_vec).ok_or_else(cut);
    }
    if bytes > 0 && block == 0 {
        return Err("Blosc 2 blocks of 0 bytes".into());
    }
    let mut out = vec![0; bytes];
    let mut first = vec![];
    for (number, out) in out.chunks_mut(block.max(1)).enumerate() {
        let start = le32(stored, HEADER + 4 * number).ok_or_else(cut)? as usize;
        let streams = stored.get(start..).ok_or_else(cut)?;
        let split = flags & 16 == 0 && out.len() == block;
        let mut now = vec![0; out.len()];
        decode_block(flags >> 5, streams, if split { typesize } else { 1 }, &mut now)?;
        for (&filter, &setting) in filters.iter().zip(settings).rev() {
            let mut next = vec![0; now.len()];
            match filter {
                0 | 4 => continue,
                1 => unshuffle(&now, if setting == 0 { typesize } else { setting.into() }, &mut next),
                2 => unshuffle_bits(&now, typesize, &mut next),
                3 => undo_differences(&now, (number > 0).then_some(&first), typesize, &mut next)?,
                other => return Err(format!("Blosc 2's filter {other}, which is not read")),
            }
            now = next;
        }
        out.copy_from_slice(&now);
        if number == 0 && filters.contains(&3) {
            first = now;
        }
    }
    Ok(out)
}

/// Undoes the filter of differences: to the element before in the first block, to the first block
/// in all others.
fn undo_differences(now: &[u8], first: Option<&Vec<u8>>, typesize: usize, out: &mut [u8]) -> Decoded<()> {
    let element = if [2, 4].contains(&typesize) { typesize } else { 1 };
    let element = if typesize.is_multiple_of(8) { 8 } else { element };
    for at in 0..now.len() {
        let before = match first {
            None => at.checked_sub(element).map_or(0, |at| out[at]),
            Some(first) => *first.get(at).ok_or("a Blosc 2 block that is too long")?,
        };
        out[at] = now[at] ^ before;
    }
    Ok(())
}

fn decode_block(compressor: u8, mut streams: &[u8], splits: usize, out: &mut [u8]) -> Decoded<()> {
    let cut = "a Blosc 2 block that is cut short";
    let part = out.len() / splits;
    if part * splits != out.len() {
        return Err("a Blosc 2 block that is no multiple of its elements".into());
    }
    for out in out.chunks_exact_mut(part.max(1)) {
        let length = le32(streams, 0).ok_or(cut)? as i32;
        streams = &streams[4..];
        match usize::try_from(length) {
            Ok(0) => out.fill(0),
            Ok(length) => {
                let stream = streams.get(..length).ok_or(cut)?;
                streams = &streams[length..];
                if length == out.len() {
                    out.copy_from_slice(stream);
                } else {
                    blosc::decompress(compressor, stream, out)?;
                }
            }
            // The lowest bit of the byte that follows says that all bytes are the same.
            Err(_) => {
                let (token, rest) = streams.split_first().ok_or(cut)?;
                streams = rest;
                if token & 1 == 0 || length < -255 {
                    return Err("a Blosc 2 stream of an unknown kind".into());
                }
                out.fill(length.unsigned_abs() as u8);
            }
        }
    }
    Ok(())
}

/// The array of a frame.
struct Shapes {
    typesize: usize,
    chunk: Vec<usize>,
    block: Vec<usize>,
}

impl Shapes {
    /// That of a header, if there is one.
    fn of(header: &[u8], typesize: usize) -> Decoded<Option<Self>> {
        // A name in msgpack is its length, with bits that say that it is a name, and its letters.
        let Some(name) = header.windows(5).position(|w| w == b"\xa4b2nd") else { return Ok(None) };
        let wrong = || String::from("a Blosc 2 array whose shape is not understood");
        let at = header.get(name + 6..).and_then(|b| b.get(..4)).map(BE::read_u32).ok_or_else(wrong)?;
        // Its content: bytes with a length (u32), then an array: version, axes, three shapes.
        let content = header.get(at as usize..).and_then(|b| b.get(5..)).ok_or_else(wrong)?;
        let axes = usize::from(*content.get(2).ok_or_else(wrong)?);
        if axes == 0 || axes > MOST_AXES || content[0] & 0xf0 != 0x90 {
            return Err(wrong());
        }
        // Each shape is an array (one byte); its numbers have a byte that says their kind.
        let [whole, of_chunk] = [1 + 9 * axes, 1 + 5 * axes];
        let shape = |from: usize| -> Option<Vec<usize>> {
            let numbers = content.get(from..)?.get(..of_chunk)?[1..].chunks_exact(5);
            numbers.map(|n| (n[0] == 0xd2).then(|| BE::read_u32(&n[1..]) as usize)).collect()
        };
        let shapes = Option::zip(shape(3 + whole), shape(3 + whole + of_chunk));
        let (chunk, block) = shapes.ok_or_else(wrong)?;
        let fits = chunk.iter().zip(&block).all(|(&c, &b)| 0 < b && b <= c);
        if typesize == 0 || !fits { Err(wrong()) } else { Ok(Some(Self { typesize, chunk, block })) }
    }

    /// Bytes of a chunk of whole blocks.
    fn padded(&self) -> Decoded<usize> {
        let mut padded = self.chunk.iter().zip(&self.block).map(|(&c, &b)| c.checked_next_multiple_of(b));
        let bytes = padded.try_fold(self.typesize, |n, c| n.checked_mul(c?));
        bytes.ok_or_else(|| "a Blosc 2 array that is too large".into())
    }

    /// The chunk in the order of its array, of blocks one after another.
    fn in_order(&self, blocks: &[u8], limit: usize) -> Decoded<Vec<u8>> {
        let bytes = self.chunk.iter().try_fold(self.typesize, |n, &c| n.checked_mul(c));
        let bytes = bytes.filter(|&n| n <= limit).ok_or_else(|| format!("more than {limit} bytes"))?;
        let axes = self.chunk.len();
        let counts: Vec<usize> = self.chunk.iter().zip(&self.block).map(|(c, b)| c.div_ceil(*b)).collect();
        let row = self.block[axes - 1] * self.typesize;
        let rows: usize = self.block[..axes - 1].iter().product();
        let mut out = vec![0; bytes];
        for (number, block) in blocks.chunks_exact(rows * row).enumerate() {
            let first = split(number, &counts);
            for (n, stored) in block.chunks_exact(row).enumerate() {
                let mut at = split(n, &self.block[..axes - 1]);
                at.push(0);
                for ((at, first), block) in at.iter_mut().zip(&first).zip(&self.block) {
                    *at += first * block;
                }
                // Rows of the padding are not there.
                if at.iter().zip(&self.chunk).any(|(at, size)| at >= size) {
                    continue;
                }
                let length = (self.chunk[axes - 1] - at[axes - 1]).min(self.block[axes - 1]) * self.typesize;
                let place = at.iter().zip(&self.chunk).fold(0, |n, (at, size)| n * size + at) * self.typesize;
                out[place..place + length].copy_from_slice(&stored[..length]);
            }
        }
        Ok(out)
    }
}

/// The place with a number in a box, the last axis fastest.
fn split(mut number: usize, dims: &[usize]) -> Vec<usize> {
    let mut place = vec![0; dims.len()];
    for (place, dim) in place.iter_mut().zip(dims).rev() {
        (*place, number) = (number % dim, number / dim);
    }
    place
}
