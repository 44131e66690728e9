//! Reads the directories of a TIFF file: where its pages are, and what each of them says.
//!
//! ```text
//!  II 2a 00 | first IFD u32        little-endian; MM 00 2a big-endian
//!  II 2b 00 | 8, 0 u16 | first IFD u64     BigTIFF: counts and places have 64 bits
//!
//!  IFD:  number of entries u16 (u64) | entries | place of the next IFD, 0 after the last
//!  entry: tag u16 | type u16 | count u32 (u64) | the values, or their place if they have more than 4 (8) bytes
//! ```

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use rustc_hash::FxHashSet;
use std::sync::Arc;

/// Numbers of the tags that are read.
pub(super) mod tag {
    pub(crate) const SUBFILE_TYPE: u16 = 254;
    pub(crate) const WIDTH: u16 = 256;
    pub(crate) const LENGTH: u16 = 257;
    pub(crate) const BITS: u16 = 258;
    pub(crate) const COMPRESSION: u16 = 259;
    pub(crate) const PHOTOMETRIC: u16 = 262;
    pub(crate) const FILL_ORDER: u16 = 266;
    pub(crate) const DESCRIPTION: u16 = 270;
    pub(crate) const STRIP_OFFSETS: u16 = 273;
    pub(crate) const SAMPLES: u16 = 277;
    pub(crate) const ROWS_PER_STRIP: u16 = 278;
    pub(crate) const STRIP_COUNTS: u16 = 279;
    pub(crate) const X_RESOLUTION: u16 = 282;
    pub(crate) const Y_RESOLUTION: u16 = 283;
    pub(crate) const PREDICTOR: u16 = 317;
    pub(crate) const TILE_WIDTH: u16 = 322;
    pub(crate) const TILE_LENGTH: u16 = 323;
    pub(crate) const TILE_OFFSETS: u16 = 324;
    pub(crate) const TILE_COUNTS: u16 = 325;
    pub(crate) const SAMPLE_FORMAT: u16 = 339;
}

/// A TIFF file whose header has been read.
#[derive(Clone, Debug)]
pub(super) struct Tiff {
    pub(super) source: Arc<ByteSource>,
    pub(super) big_endian: bool,
    /// BigTIFF.
    pub(super) big: bool,
    first: u64,
}

/// One entry of a directory.
#[derive(Clone, Copy, Debug)]
struct IfdEntry {
    tag: u16,
    kind: u16,
    count: u64,
    /// Where its values are in the file.
    at: u64,
}

/// One directory.
#[derive(Debug)]
pub(super) struct Ifd<'a> {
    tiff: &'a Tiff,
    /// Its place, by which messages name it.
    at: u64,
    entries: Vec<IfdEntry>,
    next: u64,
}

/// Whether these are the first bytes of a TIFF file.
pub(crate) fn has_magic(head: &[u8]) -> bool {
    [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|m| head.starts_with(*m))
}

impl Tiff {
    pub(super) fn open(source: Arc<ByteSource>) -> Result<Self> {
        let mut head = [0; 16];
        let head = &mut head[..source.len().min(16) as usize];
        source.read_at(0, head)?;
        if !has_magic(head) {
            let got = format!("{:02x?}", &head[..head.len().min(4)]);
            return Err(Error::bad_input(source.path(), "byte 0", "a TIFF file (II*, MM*, II+ or MM+)", got));
        }
        let (big_endian, big) = (head[0] == b'M', head[2..4].contains(&b'+'));
        let mut tiff = Self { source, big_endian, big, first: 0 };
        if big && (tiff.number(4, 2)?, tiff.number(6, 2)?) != (8, 0) {
            return Err(tiff.wrong("byte 4", "8 and 0, as BigTIFF has", "other numbers"));
        }
        tiff.first = if big { tiff.number(8, 8)? } else { tiff.number(4, 4)? };
        Ok(tiff)
    }

    pub(super) fn wrong(&self, at: &str, expected: &str, got: impl Into<String>) -> Error {
        Error::bad_input(self.source.path(), at, expected, got)
    }

    /// An unsigned number of `size` bytes.
    fn number(&self, at: u64, size: u64) -> Result<u64> {
        let end = at.checked_add(size).ok_or_else(|| {
            self.wrong(&format!("byte {at}"), "a place within the file", "one beyond 64 bits")
        })?;
        let mut buffer = vec![];
        Ok(number(self.source.view(at..end, &mut buffer)?, self.big_endian))
    }

    /// The places of all directories, in the order of the file's chain.
    pub(super) fn places(&self) -> Result<Vec<u64>> {
        let (mut places, mut seen, mut at) = (vec![], FxHashSet::default(), self.first);
        while at != 0 {
            if !seen.insert(at) {
                let place = format!("directory at byte {at}");
                return Err(self.wrong(&place, "a chain of directories that ends", "one that comes again"));
            }
            places.push(at);
            at = self.ifd(at)?.next;
        }
        if places.is_empty() { Err(self.wrong("header", "a directory", "none")) } else { Ok(places) }
    }

    /// Reads a directory, without its values.
    pub(super) fn ifd(&self, at: u64) -> Result<Ifd<'_>> {
        let (count_size, entry_size, wide) = if self.big { (8, 20, 8) } else { (2, 12, 4) };
        let count = self.number(at, count_size)?;
        let (start, bytes) = (at + count_size, count.saturating_mul(entry_size));
        let end = start.saturating_add(bytes);
        let mut buffer = vec![];
        let table = self.source.view(start..end, &mut buffer)?;
        let field = |e: &[u8], at: u64, n: u64| number(&e[at as usize..(at + n) as usize], self.big_endian);
        let mut entries = vec![];
        for (i, e) in table.chunks_exact(entry_size as usize).enumerate() {
            let (kind, count) = (field(e, 2, 2) as u16, field(e, 4, wide));
            let inline = start + i as u64 * entry_size + 4 + wide;
            let fits = size_of_kind(kind).is_some_and(|s| s.saturating_mul(count) <= wide);
            let at = if fits { inline } else { field(e, 4 + wide, wide) };
            entries.push(IfdEntry { tag: field(e, 0, 2) as u16, kind, count, at });
        }
        Ok(Ifd { tiff: self, at, entries, next: self.number(end, wide)? })
    }
}

/// A number of up to 8 bytes.
fn number(bytes: &[u8], big_endian: bool) -> u64 {
    let push = |n: u64, b: &u8| n << 8 | u64::from(*b);
    if big_endian { bytes.iter().fold(0, push) } else { bytes.iter().rev().fold(0, push) }
}

/// Bytes of a value of a type; `None` for a type that TIFF does not have.
fn size_of_kind(kind: u16) -> Option<u64> {
    Some(match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16 | 17 | 18 => 8,
        _ => return None,
    })
}

impl Ifd<'_> {
    pub(super) fn wrong(&self, what: &str, expected: &str, got: impl Into<String>) -> Error {
        self.tiff.wrong(&format!("page at byte {}: {what}", self.at), expected, got)
    }

    fn entry(&self, tag: u16) -> Option<&IfdEntry> {
        self.entries.iter().find(|e| e.tag == tag)
    }

    /// The stored bytes of an entry. They are sure to lie in the file, even if the entry's count is
    /// wrong.
    fn bytes<'b>(&'b self, entry: &IfdEntry, buffer: &'b mut Vec<u8>) -> Result<&'b [u8]> {
        let size = size_of_kind(entry.kind).and_then(|s| s.checked_mul(entry.count));
        let end = size.and_then(|s| entry.at.checked_add(s));
        let end = end.ok_or_else(|| {
            let got = format!("{} values of type {}", entry.count, entry.kind);
            self.wrong(&format!("tag {}", entry.tag), "values of a known type that fit a file", got)
        })?;
        self.tiff.source.view(entry.at..end, buffer)
    }

    /// The values of a tag of unsigned integers; `None` where the tag is missing.
    pub(super) fn numbers(&self, tag: u16) -> Result<Option<Vec<u64>>> {
        let Some(entry) = self.entry(tag) else { return Ok(None) };
        if !matches!(entry.kind, 1 | 3 | 4 | 13 | 16 | 18) {
            let got = format!("type {}", entry.kind);
            return Err(self.wrong(&format!("tag {tag}"), "unsigned integers", got));
        }
        let size = size_of_kind(entry.kind).expect("the types above have sizes") as usize;
        let mut buffer = vec![];
        let bytes = self.bytes(entry, &mut buffer)?.chunks_exact(size);
        Ok(Some(bytes.map(|b| number(b, self.tiff.big_endian)).collect()))
    }

    /// The one value of a tag, or `default` where the tag is missing.
    pub(super) fn one(&self, tag: u16, default: Option<u64>) -> Result<u64> {
        match (self.numbers(tag)?.as_deref(), default) {
            (Some(&[value]), _) => Ok(value),
            (None, Some(value)) => Ok(value),
            (None, None) => Err(self.wrong(&format!("tag {tag}"), "a value", "none")),
            (Some(many), _) => {
                Err(self.wrong(&format!("tag {tag}"), "one value", format!("{} values", many.len())))
            }
        }
    }

    /// A rational number; `None` where the tag is missing, of another type, or no number.
    pub(super) fn rational(&self, tag: u16) -> Result<Option<f64>> {
        let (mut buffer, entry) = (vec![], self.entry(tag).filter(|e| e.kind == 5 && e.count == 1));
        let Some(bytes) = self.bytes_in_file(entry, &mut buffer)? else { return Ok(None) };
        let part = |b: &[u8]| number(b, self.tiff.big_endian) as f64;
        let value = part(&bytes[..4]) / part(&bytes[4..]);
        Ok((value.is_finite() && value > 0.0).then_some(value))
    }

    /// The bytes of an entry; `None` where they do not lie in the file.
    fn bytes_in_file<'b>(
        &'b self,
        entry: Option<&IfdEntry>,
        buffer: &'b mut Vec<u8>,
    ) -> Result<Option<&'b [u8]>> {
        match entry.map(|e| self.bytes(e, buffer)) {
            Some(Err(e @ Error::Io { .. })) => Err(e),
            found => Ok(found.and_then(Result::ok)),
        }
    }

    /// The text of a tag, empty where it is missing. A description that does not lie in the file is
    /// no reason to refuse the samples.
    pub(super) fn text(&self, tag: u16) -> Result<String> {
        /// The longest text that is read: OME-XML of large data sets has some megabytes.
        const MOST: u64 = 64 << 20;
        let mut buffer = vec![];
        let entry = self.entry(tag).filter(|e| (e.kind == 2 || e.kind == 1) && e.count <= MOST);
        let bytes = self.bytes_in_file(entry, &mut buffer)?.unwrap_or_default();
        Ok(String::from_utf8_lossy(bytes).trim_end_matches('\0').to_string())
    }
}
