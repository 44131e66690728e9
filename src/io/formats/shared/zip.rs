//! The directory of a zip archive: which members it has, and where their bytes are.
//!
//! ```text
//!  PK 3 4 | name | extra | member …            local header of each member, then its bytes
//!  PK 1 2 | … name | extra                     the directory: sizes, checksums and places of the members
//!  PK 6 6, PK 6 7                              the same as below in 64 bits, in large archives
//!  PK 5 6 | … number, size and place of the directory
//! ```
//!
//! Members are stored or deflated; others are refused when they are asked for. Memory: the
//! directory, where it has to be fetched.
//!
//! The format: PKWARE's APPNOTE.TXT, sections 4.3 to 4.5.

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use std::ops::Range;

/// Bytes of a local header before the name.
const LOCAL: u64 = 30;

/// The directory of an archive.
#[derive(Debug)]
pub(in crate::formats) struct Directory {
    count: u64,
    bytes: Range<u64>,
}

/// An entry of the directory.
#[derive(Clone, Debug)]
pub(in crate::formats) struct ZipMember {
    pub(in crate::formats) name: String,
    /// Where its local header is.
    local: u64,
    flags: u64,
    method: u64,
    crc32: u32,
    /// Compressed and uncompressed.
    sizes: [u64; 2],
}

/// Where a member's bytes are in the archive, and how they are stored.
#[derive(Clone, Debug)]
pub(in crate::formats) struct Stored {
    pub(in crate::formats) deflated: bool,
    pub(in crate::formats) crc32: u32,
    /// Bytes of the member, uncompressed.
    pub(in crate::formats) len: u64,
    /// Its bytes, compressed or not.
    pub(in crate::formats) bytes: Range<u64>,
}

impl Directory {
    /// # Errors
    /// [`Error::BadInput`] for an archive that is damaged or cut short.
    pub(in crate::formats) fn of(source: &ByteSource) -> Result<Self> {
        // The last record has 22 bytes and a comment of at most 65 535.
        let tail_at = source.len().saturating_sub(22 + 65_535);
        let tail = source.slice(tail_at..source.len())?;
        let cut = || bad(source, "end", "the end record of a zip archive").with_help("the file is cut short");
        let last = (0..tail.len().saturating_sub(21))
            .rev()
            .find(|&i| tail[i..].starts_with(b"PK\x05\x06"))
            .ok_or_else(cut)?;
        let end = &tail[last..];
        let (mut count, mut size, mut at) = (le(end, 10, 2), le(end, 12, 4), le(end, 16, 4));
        if count == 0xffff || size == 0xffff_ffff || at == 0xffff_ffff {
            let locator = last
                .checked_sub(20)
                .map(|i| &tail[i..])
                .filter(|l| l.starts_with(b"PK\x06\x07"))
                .ok_or_else(cut)?;
            let place = le(locator, 8, 8);
            let record = source.slice(place..place.saturating_add(56))?;
            if !record.starts_with(b"PK\x06\x06") {
                return Err(cut());
            }
            (count, size, at) = (le(record, 32, 8), le(record, 40, 8), le(record, 48, 8));
        }
        let bytes = at..at.checked_add(size).filter(|&e| e <= source.len()).ok_or_else(cut)?;
        // An entry has at least 46 bytes: a directory cannot claim more than fit.
        if count > size / 46 { Err(cut()) } else { Ok(Self { count, bytes }) }
    }

    /// Calls `take` with where each entry is in the directory, and its name.
    pub(in crate::formats) fn each(
        &self,
        source: &ByteSource,
        mut take: impl FnMut(u64, &[u8]),
    ) -> Result<()> {
        let (bytes, mut at) = (source.slice(self.bytes.clone())?, 0);
        for number in 0..self.count {
            let (name, length) = entry(bytes, at).ok_or_else(|| no_entry(source, number))?;
            take(at as u64, name);
            at += length;
        }
        Ok(())
    }

    /// The member whose entry is there.
    pub(in crate::formats) fn member(&self, source: &ByteSource, at: u64) -> Result<ZipMember> {
        let bytes = source.slice(self.bytes.clone())?;
        let wrong = || no_entry(source, at);
        let (name, length) = entry(bytes, at as usize).ok_or_else(wrong)?;
        let entry = &bytes[at as usize..at as usize + length];
        let extra = &entry[46 + name.len()..][..le(entry, 30, 2) as usize];
        let name = String::from_utf8_lossy(name).into_owned();
        let [len, compressed, local] =
            sizes(entry, extra).ok_or_else(|| bad(source, &name, "sizes in the zip directory"))?;
        Ok(ZipMember {
            name,
            local,
            flags: le(entry, 8, 2),
            method: le(entry, 10, 2),
            crc32: le(entry, 16, 4) as u32,
            sizes: [compressed, len],
        })
    }
}

impl ZipMember {
    /// A range in which all of it lies, if its local header has at most `extra` bytes more than its
    /// name needs.
    pub(in crate::formats) fn around(&self, extra: u64, len: u64) -> Range<u64> {
        let more = LOCAL + self.name.len() as u64 + extra;
        let end = self.local.saturating_add(more).saturating_add(self.sizes[0]).min(len);
        self.local.min(end)..end
    }

    /// Where it is: the local header is looked at, which may have another extra field than the
    /// directory. It is the beginning of `around`, or read.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a member that is encrypted, compressed in another way, or not there.
    pub(in crate::formats) fn stored(&self, source: &ByteSource, around: &[u8]) -> Result<Stored> {
        let wrong = |what: &str| bad(source, &self.name, what);
        let deflated = match (self.flags & 1, self.method) {
            (0, 0) => false,
            (0, 8) => true,
            _ => {
                return Err(Error::bad_input(
                    source.path(),
                    self.name.as_str(),
                    "a stored or deflated member without encryption",
                    format!("method {}, flags {:#06x}", self.method, self.flags),
                ));
            }
        };
        let mut header = [0; LOCAL as usize];
        match around.get(..header.len()) {
            Some(known) => header.copy_from_slice(known),
            None => source.read_at(self.local, &mut header)?,
        }
        if !header.starts_with(b"PK\x03\x04") {
            return Err(wrong("the local header that the zip directory points to"));
        }
        let start = self.local + LOCAL + le(&header, 26, 2) + le(&header, 28, 2);
        let [compressed, len] = self.sizes;
        let end = start.checked_add(compressed).filter(|&e| e <= source.len());
        let end =
            end.ok_or_else(|| wrong("a member that lies in the archive").with_help("the file is cut short"))?;
        if !deflated && len != compressed {
            return Err(wrong("a stored member with two equal sizes"));
        }
        Ok(Stored { deflated, crc32: self.crc32, len, bytes: start..end })
    }
}

/// The name of an entry that begins there, and the entry's length.
fn entry(bytes: &[u8], at: usize) -> Option<(&[u8], usize)> {
    let entry = bytes.get(at..).filter(|e| e.starts_with(b"PK\x01\x02") && e.len() >= 46)?;
    let name = le(entry, 28, 2) as usize;
    let length = 46 + name + le(entry, 30, 2) as usize + le(entry, 32, 2) as usize;
    Some((&entry.get(..length)?[46..46 + name], length))
}

/// Uncompressed size, compressed size and place of a member; what does not fit 32 bits is in the
/// extra field of kind 1.
fn sizes(entry: &[u8], mut extra: &[u8]) -> Option<[u64; 3]> {
    let mut sizes = [le(entry, 24, 4), le(entry, 20, 4), le(entry, 42, 4)];
    let mut long: &[u8] = &[];
    while extra.len() >= 4 {
        let (kind, length) = (le(extra, 0, 2), le(extra, 2, 2) as usize);
        let body = extra.get(4..4 + length)?;
        if kind == 1 {
            long = body;
        }
        extra = &extra[4 + length..];
    }
    for size in sizes.iter_mut().filter(|s| **s == 0xffff_ffff) {
        *size = le(long.get(..8)?, 0, 8);
        long = &long[8..];
    }
    Some(sizes)
}

fn no_entry(source: &ByteSource, number: u64) -> Error {
    bad(source, &format!("directory entry {number}"), "an entry of a zip directory")
}

fn bad(source: &ByteSource, at: &str, expected: &str) -> Error {
    Error::bad_input(source.path(), at, expected, "something else").with_help("the archive is damaged")
}

/// A little-endian number of `size` bytes.
fn le(bytes: &[u8], at: usize, size: usize) -> u64 {
    bytes[at..at + size].iter().rev().fold(0, |n, &b| n << 8 | u64::from(b))
}

#[cfg(test)]
pub(in crate::formats) mod tests {
    use std::io::Write;

    /// A zip archive, with the sizes in 64-bit extra fields or not.
    pub(in crate::formats) fn zip(members: &[(&str, Vec<u8>)], deflate: bool, long: bool) -> Vec<u8> {
        let (mut file, mut directory) = (vec![], vec![]);
        for (name, bytes) in members {
            let mut z = flate2::write::DeflateEncoder::new(vec![], flate2::Compression::fast());
            z.write_all(bytes).unwrap();
            let data = if deflate { z.finish().unwrap() } else { bytes.clone() };
            let mut crc = flate2::Crc::new();
            crc.update(bytes);
            let short = |n: usize| if long { u32::MAX } else { n as u32 };
            let mut common = [0u16, if deflate { 8 } else { 0 }, 0, 0].map(u16::to_le_bytes).concat();
            common.extend([crc.sum(), short(data.len()), short(bytes.len())].map(u32::to_le_bytes).concat());
            common.extend((name.len() as u16).to_le_bytes());
            let mut extra = vec![];
            if long {
                extra.extend([1u16, 24].map(u16::to_le_bytes).concat());
                extra.extend(
                    [bytes.len() as u64, data.len() as u64, file.len() as u64].map(u64::to_le_bytes).concat(),
                );
            }
            common.extend((extra.len() as u16).to_le_bytes());
            directory.extend(
                [
                    b"PK\x01\x02\x14\0\x14\0",
                    &common[..],
                    &[0; 10],
                    &short(file.len()).to_le_bytes(),
                    name.as_bytes(),
                    &extra,
                ]
                .concat(),
            );
            file.extend([b"PK\x03\x04\x14\0", &common[..], name.as_bytes(), &extra, &data].concat());
        }
        let (at, size, count) = (file.len(), directory.len(), members.len());
        file.extend(directory);
        if long {
            let end = file.len() as u64;
            file.extend([b"PK\x06\x06", &[0; 28][..]].concat());
            file.extend([count as u64, size as u64, at as u64].map(u64::to_le_bytes).concat());
            file.extend([b"PK\x06\x07\0\0\0\0", &end.to_le_bytes()[..], &[1, 0, 0, 0]].concat());
            file.extend([b"PK\x05\x06", &[0xff; 16][..], b"\0\0"].concat());
        } else {
            let count = (count as u16).to_le_bytes();
            let places = [size as u32, at as u32].map(u32::to_le_bytes).concat();
            file.extend([b"PK\x05\x06\0\0\0\0", &count[..], &count, &places, b"\x02\0ok"].concat());
        }
        file
    }
}
