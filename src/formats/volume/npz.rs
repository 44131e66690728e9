//! NPZ (NumPy): a zip archive whose members are NPY files. Each three-dimensional array in it is a
//! field.
//!
//! ```text
//!  PK 3 4 | name | extra | member …            local header of each member, then its bytes
//!  PK 1 2 | … name | extra                     the directory: sizes, checksums and places of the members
//!  PK 6 6, PK 6 7                              the same as below in 64 bits, in large archives
//!  PK 5 6 | … number, size and place of the directory
//! ```
//!
//! A stored member (`numpy.savez`) is mapped where it lies in the archive; a deflated one
//! (`numpy.savez_compressed`) is a stream, whose CRC-32 is checked at its end. Deflated arrays in
//! Fortran order are refused, because they would have to be transposed out of core; once unpacked,
//! they can be read.
//!
//! The format: PKWARE's APPNOTE.TXT, sections 4.3 to 4.5.

use super::npy::Array;
use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::shared::format::{Format, Head};
use crate::formats::shared::header::{given_geometry, plain_info};
use crate::formats::shared::stream::{ByteSlabs, Codec, Tail};
use crate::formats::shared::{OpenOptions, pick_field};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::{FieldInfo, VolumeSource};
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

/// Several arrays of NumPy.
pub(in crate::formats) struct Npz;

impl Format for Npz {
    fn name(&self) -> &'static str {
        "an NPZ file"
    }

    fn is_on_servers(&self) -> bool {
        true
    }

    fn suffixes(&self) -> &'static [&'static str] {
        &[".npz"]
    }

    fn is_in(&self, head: &Head<'_>) -> bool {
        head.bytes.starts_with(b"PK\x03\x04")
    }

    fn has_spacing(&self) -> bool {
        false
    }

    fn volume(&self, path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
        open(path, options)
    }
}

/// Opens an array of an NPZ archive.
///
/// # Errors
/// [`Error::BadInput`] when the archive is malformed or has no array that can be read;
/// [`Error::Usage`] when it has several and none is chosen.
pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let (mut arrays, mut refused) = (vec![], None);
    for member in members(&source)? {
        match member.array(&source) {
            Ok(array) => arrays.push((member, array)),
            Err(e) => refused = refused.or(Some(e)),
        }
    }
    let field = |m: &Member, a: &Array| FieldInfo { name: m.name.clone(), scalar: a.scalar, components: 1 };
    let fields: Vec<FieldInfo> = arrays.iter().map(|(m, a)| field(m, a)).collect();
    if fields.is_empty() {
        let none = || Error::bad_input(path, "members", "an array (.npy)", "none");
        return Err(refused.unwrap_or_else(none));
    }
    let (member, array) = arrays.swap_remove(pick_field(path, &fields, options.field.as_deref())?);
    let format = if member.deflated { "NPZ (deflated)" } else { "NPZ (stored)" };
    let geometry = given_geometry(path, options, Geometry::default())?;
    let mut info = plain_info(path, format, array.dims, array.scalar, geometry);
    info.field = field(&member, &array);
    info.fields = fields;
    if !member.deflated {
        let source = member.check_length(&array, source)?;
        let at = member.bytes.start + array.data_at as u64;
        let volume = StridedVolume::new(info, source, at, array.big_endian, array.strides(path)?)?;
        return Ok(volume.source());
    }
    if array.z_fastest {
        return Err(Error::bad_input(path, &member.name, "C order in a compressed archive", "Fortran order")
            .with_help("unpack it: `unzip` the member, whose .npy file is read in either order"));
    }
    let codec = Codec::Deflate { crc32: member.crc32 };
    let skip = array.data_at as u64;
    let slabs = ByteSlabs::new(info, &source, member.bytes, codec, skip, array.big_endian, Tail::Nothing)?;
    Ok(VolumeSource::Stream(Box::new(slabs)))
}

/// A member of the archive that is an NPY file.
struct Member {
    /// Without ".npy".
    name: String,
    deflated: bool,
    crc32: u32,
    /// Where its bytes, compressed or not, are in the archive.
    bytes: std::ops::Range<u64>,
}

impl Member {
    /// The array's header. NumPy writes at most 64 KiB of it unless more is asked for.
    fn array(&self, source: &Arc<ByteSource>) -> Result<Array> {
        let mut head = vec![];
        let reader: Box<dyn Read> = if self.deflated {
            Codec::Deflate { crc32: self.crc32 }.reader(source, self.bytes.clone())?
        } else {
            Box::new(source.reader(self.bytes.clone())?)
        };
        let read = reader.take(1 << 17).read_to_end(&mut head);
        let array = Array::parse(source.path(), &head);
        match (array, read) {
            (Err(_), Err(e)) => {
                Err(Error::bad_input(source.path(), &self.name, "good deflate data", e.to_string()))
            }
            (array, _) => array,
        }
    }

    /// Refuses a stored member that is shorter than its array: what follows it in the archive are
    /// no samples.
    fn check_length(&self, array: &Array, source: Arc<ByteSource>) -> Result<Arc<ByteSource>> {
        let samples = array.dims.iter().product::<u64>() * array.scalar.bytes() as u64;
        let (needed, got) = (array.data_at as u64 + samples, self.bytes.end - self.bytes.start);
        if got == needed {
            return Ok(source);
        }
        Err(Error::bad_input(source.path(), &self.name, format!("{needed} bytes"), format!("{got} bytes")))
    }
}

/// The NPY members of an archive, in the order of its directory.
fn members(source: &ByteSource) -> Result<Vec<Member>> {
    let (count, directory) = directory(source)?;
    let bytes = source.slice(directory.clone())?;
    let (mut members, mut at) = (vec![], 0usize);
    for number in 0..count {
        let wrong = || bad(source, format!("directory entry {number}"), "an entry of a zip directory");
        let entry =
            bytes.get(at..).filter(|e| e.starts_with(b"PK\x01\x02") && e.len() >= 46).ok_or_else(wrong)?;
        let (name, extra) = (le(entry, 28, 2) as usize, le(entry, 30, 2) as usize);
        let length = 46 + name + extra + le(entry, 32, 2) as usize;
        let entry = entry.get(..length).ok_or_else(wrong)?;
        at += length;
        let full_name = String::from_utf8_lossy(&entry[46..46 + name]).into_owned();
        if let Some(short) = full_name.strip_suffix(".npy") {
            members.push(member(source, short, entry, &entry[46 + name..46 + name + extra])?);
        }
    }
    Ok(members)
}

fn member(source: &ByteSource, name: &str, entry: &[u8], extra: &[u8]) -> Result<Member> {
    let wrong = |what: &str| bad(source, name.to_string(), what);
    let [_, compressed, local] = sizes(entry, extra).ok_or_else(|| wrong("sizes in the zip directory"))?;
    let deflated = match (le(entry, 8, 2) & 1, le(entry, 10, 2)) {
        (0, 0) => false,
        (0, 8) => true,
        _ => return Err(wrong("a stored or deflated member without encryption")),
    };
    let header = source.slice(local..local.saturating_add(30))?;
    if !header.starts_with(b"PK\x03\x04") {
        return Err(wrong("the local header that the zip directory points to"));
    }
    let start = local + 30 + le(header, 26, 2) + le(header, 28, 2);
    let end = start.checked_add(compressed).filter(|&e| e <= source.len());
    let end =
        end.ok_or_else(|| wrong("a member that lies in the archive").with_help("the file is cut short"))?;
    Ok(Member { name: name.into(), deflated, crc32: le(entry, 16, 4) as u32, bytes: start..end })
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

/// Number of entries, and bytes, of the directory.
fn directory(source: &ByteSource) -> Result<(u64, std::ops::Range<u64>)> {
    // The last record has 22 bytes and a comment of at most 65 535.
    let tail_at = source.len().saturating_sub(22 + 65_535);
    let tail = source.slice(tail_at..source.len())?;
    let cut =
        || bad(source, "end".into(), "the end record of a zip archive").with_help("the file is cut short");
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
    let range = at..at.checked_add(size).filter(|&e| e <= source.len()).ok_or_else(cut)?;
    // An entry has at least 46 bytes: a directory cannot claim more than fit.
    if count > size / 46 { Err(cut()) } else { Ok((count, range)) }
}

fn bad(source: &ByteSource, at: String, expected: &str) -> Error {
    Error::bad_input(source.path(), at, expected, "something else").with_help("the archive is damaged")
}

/// A little-endian number of `size` bytes.
fn le(bytes: &[u8], at: usize, size: usize) -> u64 {
    bytes[at..at + size].iter().rev().fold(0, |n, &b| n << 8 | u64::from(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::open_volume;
    use crate::formats::tests::{torture, write};
    use crate::formats::volume::npy::tests::{check, npy, samples};
    use std::io::Write;

    /// A zip archive, with the sizes in 64-bit extra fields or not.
    fn zip(members: &[(&str, Vec<u8>)], deflate: bool, long: bool) -> Vec<u8> {
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

    fn volume() -> Vec<u8> {
        npy(1, "'>u2'", false, "(2, 3, 4)", &samples(true, false))
    }

    fn options(field: Option<&str>) -> OpenOptions {
        OpenOptions { field: field.map(str::to_string), ..OpenOptions::default() }
    }

    #[test]
    fn members_stored_or_deflated() {
        let dir = tempfile::tempdir().unwrap();
        for (deflate, long) in [(false, false), (true, false), (false, true), (true, true)] {
            let path = write(
                &dir,
                "a.npz",
                &zip(&[("readme.txt", vec![1]), ("a/vol.npy", volume())], deflate, long),
            );
            let info = check(&path, &options(None));
            assert_eq!(info.format, if deflate { "NPZ (deflated)" } else { "NPZ (stored)" });
            check(&path, &options(Some("a/vol")));
            assert_eq!(open(&path, &options(Some("b"))).err().expect("refused").exit_code(), 2);
        }
    }

    #[test]
    fn arrays_are_fields() {
        let dir = tempfile::tempdir().unwrap();
        let other = npy(1, "'<f4'", false, "(1, 1, 2)", &[0; 8]);
        let spacing = npy(1, "'<f8'", false, "(3,)", &[0; 24]);
        let both = [("spacing.npy", spacing.clone()), ("a.npy", volume()), ("b.npy", other)];
        let path = write(&dir, "a.npz", &zip(&both, true, false));
        let error = open(&path, &options(None)).err().expect("two fields").to_string();
        assert!(error.contains("a (uint16), b (float32)"), "{error}");
        check(&path, &options(Some("a")));
        for (members, message) in [
            (vec![("spacing.npy", spacing)], "shape"),
            (vec![("a.txt", vec![1])], "members"),
            (vec![("a.npy", npy(1, "'<u2'", true, "(2, 3, 4)", &samples(false, true)))], "Fortran"),
            (vec![], "end"),
        ] {
            let path = write(&dir, "a.npz", &zip(&members, true, false));
            let error = open_volume(&path, &options(None)).err().expect(message);
            assert!(error.exit_code() == 5, "{error}");
        }
        let stored =
            zip(&[("a.npy", npy(1, "'<u2'", true, "(2, 3, 4)", &samples(false, true)))], false, false);
        check(&write(&dir, "a.npz", &stored), &options(None));
    }

    #[test]
    fn damage_is_refused() {
        for deflate in [false, true] {
            let file = zip(&[("a.npy", volume())], deflate, false);
            // The last two bytes are the archive's comment.
            torture("a.npz", &file, file.len() - 2);
        }
    }

    #[test]
    fn a_wrong_checksum_is_seen() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = zip(&[("a.npy", volume())], true, false);
        let entry = file.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
        file[entry + 16] ^= 1;
        let source = open(&write(&dir, "a.npz", &file), &options(None)).unwrap();
        let error = crate::formats::tests::try_read_all(source).unwrap_err().to_string();
        assert!(error.contains("CRC-32"), "{error}");
    }
}
