//! Header, footer and directory pages of a segment, each with its checksum behind.

use super::{
    END_MAGIC, FOOTER_BYTES, FORMAT_VERSION, HEADER_BYTES, MAGIC, OLDEST_FORMAT, OLDEST_READER, PAGE_BLOCKS,
    PAGE_ENTRY_BYTES, PAGE_FRAME_BYTES, PlanHash, SegmentInfo, SegmentKind,
};
use crate::archive::wire::{Cursor, Malformed};

/// Appends the CRC32C of what is there.
fn seal(mut bytes: Vec<u8>) -> Vec<u8> {
    let crc = crc32c::crc32c(&bytes);
    bytes.extend(crc.to_le_bytes());
    bytes
}

pub(super) fn header(kind: u32, plan: PlanHash) -> Vec<u8> {
    let mut h = MAGIC.to_vec();
    h.extend(FORMAT_VERSION.to_le_bytes());
    h.extend(OLDEST_READER.to_le_bytes());
    h.extend(kind.to_le_bytes());
    h.extend(plan.0.to_le_bytes());
    h.extend(0u32.to_le_bytes());
    seal(h)
}

pub(super) fn directory_page(first_offset: u64, entries: &[(u32, u32)]) -> Vec<u8> {
    let mut page = first_offset.to_le_bytes().to_vec();
    for (len, crc) in entries {
        page.extend(len.to_le_bytes());
        page.extend(crc.to_le_bytes());
    }
    seal(page)
}

pub(super) fn footer(info: &SegmentInfo, directory: u64) -> Vec<u8> {
    let mut f = info.blocks.to_le_bytes().to_vec();
    f.extend(directory.to_le_bytes());
    f.extend(info.bytes.to_le_bytes());
    f.extend(info.content_hash.to_le_bytes());
    f.extend(0u32.to_le_bytes());
    f.extend(END_MAGIC);
    seal(f)
}

pub(super) fn hex(crc: u32) -> String {
    format!("{crc:08x}")
}

/// Checks and strips the CRC32C that [`seal`] appended.
pub(super) fn unseal<'a>(bytes: &'a [u8], at: &'static str) -> std::result::Result<&'a [u8], Malformed> {
    let (body, tail) = bytes.split_at(bytes.len() - 4);
    let (expected, got) = (Cursor::new(tail).u32(at)?, crc32c::crc32c(body));
    if expected != got {
        return Err(Malformed::checksum(at, hex(expected), hex(got)));
    }
    Ok(body)
}

/// The plan hash. The magic and the version come first: a file of a future version may differ in
/// all the rest.
pub(super) fn read_header(bytes: &[u8], kind: SegmentKind) -> std::result::Result<PlanHash, Malformed> {
    let mut c = Cursor::new(bytes);
    if c.take(8, "magic")? != MAGIC {
        let got = String::from_utf8_lossy(&bytes[..8]).escape_debug().to_string();
        return Err(Malformed::new("magic", "a segment of an isospan archive", format!("\"{got}\"")));
    }
    let (version, oldest) = (c.u16("version")?, c.u16("version")?);
    if oldest > FORMAT_VERSION || version < OLDEST_FORMAT {
        return Err(Malformed::new(
            "format version",
            format!("a version that format {FORMAT_VERSION} programs can read ({OLDEST_FORMAT} and later)"),
            format!("version {version}, for programs of format {oldest} and later"),
        ));
    }
    let body = unseal(bytes, "CRC32C")?;
    let mut c = Cursor::new(&body[12..]);
    let found = c.u32("kind")?;
    if found != kind as u32 {
        let expected = format!("a {} segment", SegmentKind::name(kind as u32));
        return Err(Malformed::new("kind", expected, SegmentKind::name(found)));
    }
    Ok(PlanHash(c.u128("plan hash")?))
}

/// The plan hash of a whole header of any kind.
pub(super) fn header_plan(bytes: &[u8]) -> Option<PlanHash> {
    let body = unseal(bytes, "CRC32C").ok()?.strip_prefix(&MAGIC)?;
    // Versions and kind come before it.
    Cursor::new(&body[8..]).u128("plan hash").ok().map(PlanHash)
}

pub(super) fn read_footer(bytes: &[u8], file_len: u64) -> std::result::Result<(SegmentInfo, u64), Malformed> {
    let mut c = Cursor::new(unseal(bytes, "CRC32C")?);
    let (blocks, directory, length) = (c.u64("block count")?, c.u64("directory")?, c.u64("length")?);
    let content_hash = c.u64("content hash")?;
    c.u32("reserved")?;
    if c.take(8, "end magic")? != END_MAGIC {
        return Err(Malformed::new("end magic", "ISOEND", "something else"));
    }
    if length != file_len {
        return Err(Malformed::new("length", format!("{length} bytes"), format!("{file_len} bytes")));
    }
    let pages = blocks.div_ceil(PAGE_BLOCKS);
    let end = blocks
        .checked_mul(PAGE_ENTRY_BYTES)
        .and_then(|b| b.checked_add(pages * PAGE_FRAME_BYTES))
        .and_then(|b| b.checked_add(directory))
        .and_then(|b| b.checked_add(FOOTER_BYTES));
    if directory < HEADER_BYTES || end != Some(length) {
        let got = format!("{blocks} blocks, directory at {directory}");
        return Err(Malformed::new("directory", format!("one that fills a file of {length} bytes"), got));
    }
    Ok((SegmentInfo { bytes: length, blocks, content_hash }, directory))
}
