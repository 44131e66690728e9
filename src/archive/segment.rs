//! The container of everything binary: a file of numbered blocks, written once.
//!
//! ```text
//! header | block 0 | block 1 | … | directory pages | footer
//! ```
//!
//! Header and footer are of fixed size and are all that opening reads, whatever the number of blocks. The directory
//! (length and CRC32C of each block) lies in pages that are read, checked and kept the first time a block of
//! theirs is asked for. So a block costs one read, and a damaged byte is found when it is used, or by [`Segment::verify`].
//! A segment is *done* when header, length and footer verify: a file cut short at any byte is not a segment.
//!
//! Every byte is specified in [the format](super#the-bytes).

use super::journal::Record;
use super::publish::{Dead, Unpublished};
use super::wire::{Cursor, Malformed};
use crate::bytes::remote::{RemoteFile, is_remote};
use crate::error::{Error, Result};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use xxhash_rust::xxh3::Xxh3Default;

/// First bytes of a segment. As in PNG, the high bit and the line ends show damage by a text-mode transfer.
pub const MAGIC: [u8; 8] = *b"\x89ISO\r\n\x1a\n";
/// Last bytes but eight of a segment.
pub const END_MAGIC: [u8; 8] = *b"ISOEND\r\n";
/// The version this program writes.
pub const FORMAT_VERSION: u16 = 1;
/// The oldest program version (in the same numbering) that can read what this program writes.
pub const OLDEST_READER: u16 = 1;
/// Bytes of the header.
pub const HEADER_BYTES: u64 = 40;
/// Bytes of the footer.
pub const FOOTER_BYTES: u64 = 48;
/// Blocks described by a full directory page.
pub const PAGE_BLOCKS: u64 = 510;
/// Bytes of a directory page besides its entries: the offset of its first block before them, and its checksum behind.
pub const PAGE_FRAME_BYTES: u64 = 12;
/// Bytes of a directory entry: length and checksum of a block.
pub const PAGE_ENTRY_BYTES: u64 = 8;
/// The most bytes of a block.
pub const LARGEST_BLOCK: u64 = 1 << 30;

/// What a segment holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SegmentKind {
    /// Vertex tables and tetrahedra of a range of chunks.
    Mesh = 1,
    /// Values of a range of chunks, of one step.
    Values = 2,
    /// The span-space index of one step.
    Index = 3,
    /// The contour spectrum of one step.
    Spectrum = 4,
    /// A bricked copy of a volume.
    Bricks = 5,
    /// Points for which there is no formula.
    Points = 6,
    /// Coordinates of a rectilinear or curvilinear grid.
    Coordinates = 7,
    /// How dense the points are, cell by cell.
    Levels = 8,
    /// Vertices that a source mesh tells more than once.
    Repeated = 9,
}

impl SegmentKind {
    fn name(code: u32) -> String {
        match code {
            1 => "mesh".into(),
            2 => "values".into(),
            3 => "index".into(),
            4 => "spectrum".into(),
            5 => "bricks".into(),
            6 => "points".into(),
            7 => "coordinates".into(),
            8 => "levels".into(),
            9 => "repeated vertices".into(),
            other => format!("unknown kind {other}"),
        }
    }
}

/// The hash of everything that decides the bytes of a segment: files of different plans never mix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlanHash(pub u128);

impl PlanHash {
    /// The hash (XXH3, 128 bits) of the canonical text of a plan.
    pub fn of(canonical: &[u8]) -> Self {
        Self(xxhash_rust::xxh3::xxh3_128(canonical))
    }
}

impl fmt::Display for PlanHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

impl Serialize for PlanHash {
    fn serialize<S: Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for PlanHash {
    fn deserialize<D: Deserializer<'de>>(d: D) -> std::result::Result<Self, D::Error> {
        let text = String::deserialize(d)?;
        let number = (text.len() == 32).then(|| u128::from_str_radix(&text, 16).ok()).flatten();
        number.map(Self).ok_or_else(|| serde::de::Error::custom("a plan hash has 32 hexadecimal digits"))
    }
}

/// A finished segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
pub struct SegmentInfo {
    /// Length of the file.
    pub bytes: u64,
    /// Number of blocks.
    pub blocks: u64,
    /// XXH3 (64 bits) of all bytes before the footer: two writers of the same segment agree on it.
    #[serde(with = "hex_hash")]
    pub content_hash: u64,
}

/// A 64-bit hash as text: a JSON number of that size loses digits in many programs.
mod hex_hash {
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(hash: &u64, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(&format_args!("{hash:016x}"))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<u64, D::Error> {
        let text = String::deserialize(d)?;
        let number = (text.len() == 16).then(|| u64::from_str_radix(&text, 16).ok()).flatten();
        number.ok_or_else(|| serde::de::Error::custom("a content hash has 16 hexadecimal digits"))
    }
}

/// Writes a segment block by block. Memory: eight bytes a block.
pub struct SegmentWriter {
    out: Unpublished,
    path: PathBuf,
    hash: Xxh3Default,
    offset: u64,
    /// Length and CRC32C of each block.
    entries: Vec<(u32, u32)>,
}

impl SegmentWriter {
    /// Begins the segment that will be `path`, whose folder exists.
    ///
    /// # Errors
    /// When the temporary file cannot be made.
    pub fn create(path: impl AsRef<Path>, kind: SegmentKind, plan: PlanHash) -> Result<Self> {
        let path = path.as_ref().to_path_buf();
        let out = Unpublished::create(&path)?;
        let mut writer = Self { out, path, hash: Xxh3Default::new(), offset: 0, entries: vec![] };
        writer.put(&header(kind as u32, plan))?;
        Ok(writer)
    }

    /// Goes on with what a dead writer of this segment left: the first of `records` whose blocks are there, undamaged, give
    /// the blocks to begin with, and their number is returned. `None` when it is not of this kind and plan. Reads and checks
    /// all bytes that are kept.
    pub(super) fn adopt(
        mut dead: Dead,
        path: &Path,
        kind: SegmentKind,
        plan: PlanHash,
        records: &[Record],
    ) -> Result<Option<(Self, usize)>> {
        let head = header(kind as u32, plan);
        let read = |e| Error::io("read", path, e);
        let len = dead.file.metadata().map_err(read)?.len();
        let mut buffer = vec![0; head.len()];
        if len < head.len() as u64 || dead.file.read_exact(&mut buffer).is_err() || buffer != head {
            return Ok(None);
        }
        let (mut hash, mut offset, mut entries, mut whole) = (Xxh3Default::new(), HEADER_BYTES, vec![], 0);
        hash.update(&head);
        for record in records {
            let (mut with, bytes) = (hash.clone(), record.blocks.iter().map(|b| u64::from(b.0)).sum::<u64>());
            if bytes > len - offset || !take_blocks(&mut dead.file, record, &mut with, &mut buffer) {
                break;
            }
            (hash, offset, whole) = (with, offset + bytes, whole + 1);
            entries.extend_from_slice(&record.blocks);
        }
        let out = Unpublished::adopt(dead, path, offset)?;
        Ok(Some((Self { out, path: path.to_path_buf(), hash, offset, entries }, whole)))
    }

    /// Hands all blocks so far to the system, so that they outlive this process, and keeps the temporary file for
    /// [`SegmentWriter::adopt`] should the segment not be finished.
    pub(super) fn keep(&mut self) -> Result<()> {
        self.out.flush()?;
        self.out.keep();
        Ok(())
    }

    /// The file's name until it is finished.
    pub(super) fn temporary(&self) -> &Path {
        self.out.temporary()
    }

    /// Length and CRC32C of the blocks from number `first` on.
    pub(super) fn entries_from(&self, first: usize) -> &[(u32, u32)] {
        &self.entries[first..]
    }

    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.hash.update(bytes);
        self.offset += bytes.len() as u64;
        self.out.write(bytes)
    }

    /// Appends a block and gives its number.
    ///
    /// # Errors
    /// When the file cannot be written, or the block is larger than [`LARGEST_BLOCK`].
    pub fn push_block(&mut self, block: &[u8]) -> Result<u64> {
        if block.len() as u64 > LARGEST_BLOCK {
            return Err(Error::usage(format!(
                "{}: a block of {} bytes is larger than the {LARGEST_BLOCK} allowed; use smaller chunks",
                self.path.display(),
                block.len()
            )));
        }
        self.put(block)?;
        self.entries.push((block.len() as u32, crc32c::crc32c(block)));
        Ok(self.entries.len() as u64 - 1)
    }

    /// Blocks pushed so far.
    pub fn block_count(&self) -> u64 {
        self.entries.len() as u64
    }

    /// Writes directory and footer, and publishes the file.
    ///
    /// # Errors
    /// When the file cannot be written, synced or renamed; then no file of that name has been made.
    pub fn finish(mut self) -> Result<SegmentInfo> {
        let directory = self.offset;
        let entries = std::mem::take(&mut self.entries);
        let mut block_at = HEADER_BYTES;
        for page in entries.chunks(PAGE_BLOCKS as usize) {
            self.put(&directory_page(block_at, page))?;
            block_at += page.iter().map(|e| u64::from(e.0)).sum::<u64>();
        }
        let info = SegmentInfo {
            bytes: self.offset + FOOTER_BYTES,
            blocks: entries.len() as u64,
            content_hash: self.hash.digest(),
        };
        self.out.write(&footer(&info, directory))?;
        self.out.publish()?;
        Ok(info)
    }
}

/// Reads the blocks of a chunk and adds them to the hash; `false` when one is cut short or damaged.
fn take_blocks(file: &mut File, record: &Record, hash: &mut Xxh3Default, buffer: &mut Vec<u8>) -> bool {
    record.blocks.iter().all(|&(len, crc)| {
        buffer.resize(len as usize, 0);
        let whole = file.read_exact(buffer).is_ok() && crc32c::crc32c(buffer) == crc;
        hash.update(buffer);
        whole
    })
}

/// Appends the CRC32C of what is there.
fn seal(mut bytes: Vec<u8>) -> Vec<u8> {
    let crc = crc32c::crc32c(&bytes);
    bytes.extend(crc.to_le_bytes());
    bytes
}

fn header(kind: u32, plan: PlanHash) -> Vec<u8> {
    let mut h = MAGIC.to_vec();
    h.extend(FORMAT_VERSION.to_le_bytes());
    h.extend(OLDEST_READER.to_le_bytes());
    h.extend(kind.to_le_bytes());
    h.extend(plan.0.to_le_bytes());
    h.extend(0u32.to_le_bytes());
    seal(h)
}

fn directory_page(first_offset: u64, entries: &[(u32, u32)]) -> Vec<u8> {
    let mut page = first_offset.to_le_bytes().to_vec();
    for (len, crc) in entries {
        page.extend(len.to_le_bytes());
        page.extend(crc.to_le_bytes());
    }
    seal(page)
}

fn footer(info: &SegmentInfo, directory: u64) -> Vec<u8> {
    let mut f = info.blocks.to_le_bytes().to_vec();
    f.extend(directory.to_le_bytes());
    f.extend(info.bytes.to_le_bytes());
    f.extend(info.content_hash.to_le_bytes());
    f.extend(0u32.to_le_bytes());
    f.extend(END_MAGIC);
    seal(f)
}

/// A directory page that has been read: offset, length and checksum of each of its blocks.
type Page = Arc<Vec<(u64, u32, u32)>>;

/// An open segment: blocks by number, from any thread.
pub struct Segment {
    path: PathBuf,
    file: PositionedFile,
    plan: PlanHash,
    info: SegmentInfo,
    directory: u64,
    pages: Mutex<std::collections::BTreeMap<u64, Page>>,
    bytes_read: AtomicU64,
}

impl Segment {
    /// Opens a finished segment; reads its header and footer only.
    ///
    /// # Errors
    /// [`Error::BadInput`] when it is not a whole segment of this kind, of a version that can be read, and of this plan
    /// (`None`: of any plan).
    pub fn open(path: impl AsRef<Path>, kind: SegmentKind, plan: Option<PlanHash>) -> Result<Self> {
        let path = path.as_ref().to_path_buf();
        let file = PositionedFile::open(&path)?;
        if file.len < HEADER_BYTES + FOOTER_BYTES {
            return Err(Error::bad_input(
                &path,
                "file length",
                format!("at least {} bytes", HEADER_BYTES + FOOTER_BYTES),
                file.len.to_string(),
            )
            .with_help("the file is cut short or is not a segment of an isospan archive"));
        }
        let bytes_read = AtomicU64::new(0);
        let mut head = [0; HEADER_BYTES as usize];
        file.read_at(&path, 0, &mut head, &bytes_read)?;
        let found = read_header(&head, kind).map_err(|m| at_frame(m, &path, "header"))?;
        if let Some(plan) = plan
            && plan != found
        {
            return Err(Error::bad_input(&path, "header: plan hash", plan.to_string(), found.to_string())
                .with_help(
                    "the file belongs to a run with other input or parameters: use another output name",
                ));
        }
        let mut foot = [0; FOOTER_BYTES as usize];
        file.read_at(&path, file.len - FOOTER_BYTES, &mut foot, &bytes_read)?;
        let (info, directory) = read_footer(&foot, file.len).map_err(|m| at_frame(m, &path, "footer"))?;
        Ok(Self { path, file, plan: found, info, directory, pages: Mutex::default(), bytes_read })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The hash of the plan it belongs to.
    pub fn plan(&self) -> PlanHash {
        self.plan
    }

    /// Length, blocks and content hash, as the footer says.
    pub fn info(&self) -> SegmentInfo {
        self.info
    }

    /// Number of blocks.
    pub fn block_count(&self) -> u64 {
        self.info.blocks
    }

    /// Bytes read from the file since it was opened, header, footer and directory pages included.
    pub fn bytes_read(&self) -> u64 {
        self.bytes_read.load(Ordering::Relaxed)
    }

    /// Reads block `n` into `out` (cleared first) and checks its CRC32C.
    ///
    /// # Errors
    /// When the file cannot be read or the block or its directory page is damaged.
    ///
    /// # Panics
    /// When `n` is not below [`Segment::block_count`].
    pub fn block(&self, n: u64, out: &mut Vec<u8>) -> Result<()> {
        assert!(n < self.info.blocks, "block {n} of {}", self.info.blocks);
        let page = self.page(n / PAGE_BLOCKS)?;
        let (offset, len, crc) = page[(n % PAGE_BLOCKS) as usize];
        out.clear();
        out.resize(len as usize, 0);
        self.read_at(offset, out)?;
        let got = crc32c::crc32c(out);
        if got != crc {
            return Err(self.damage(format!("block {n}: CRC32C"), hex(crc), hex(got)));
        }
        Ok(())
    }

    fn read_at(&self, offset: u64, out: &mut [u8]) -> Result<()> {
        self.file.read_at(&self.path, offset, out, &self.bytes_read)
    }

    fn damage(&self, at: String, expected: String, got: String) -> Error {
        Error::bad_input(&self.path, at, expected, got)
            .with_help("the file is damaged: restore it, or delete it and run the same reduction again")
    }

    fn page(&self, n: u64) -> Result<Page> {
        // The lock is not held while reading: two threads may read the same page, and keep the same one.
        if let Some(page) = self.pages.lock().expect("no thread panics with the page table locked").get(&n) {
            return Ok(page.clone());
        }
        let page = Arc::new(self.read_page(n)?);
        self.pages.lock().expect("no thread panics with the page table locked").insert(n, page.clone());
        Ok(page)
    }

    fn read_page(&self, n: u64) -> Result<Vec<(u64, u32, u32)>> {
        let entries = (self.info.blocks - n * PAGE_BLOCKS).min(PAGE_BLOCKS);
        let full = PAGE_FRAME_BYTES + PAGE_BLOCKS * PAGE_ENTRY_BYTES;
        let mut bytes = vec![0; (PAGE_FRAME_BYTES + entries * PAGE_ENTRY_BYTES) as usize];
        self.read_at(self.directory + n * full, &mut bytes)?;
        let parse = || -> std::result::Result<Vec<(u64, u32, u32)>, Malformed> {
            let mut c = Cursor::new(unseal(&bytes, "CRC32C")?);
            let mut offset = c.u64("offset")?;
            let mut page = Vec::with_capacity(entries as usize);
            for _ in 0..entries {
                let (len, crc) = (c.u32("length")?, c.u32("checksum")?);
                let end = offset.checked_add(u64::from(len)).filter(|&e| e <= self.directory);
                let Some(end) = end else {
                    let got = format!("offset {offset}, length {len}");
                    return Err(Malformed::new("block", format!("an end up to {}", self.directory), got));
                };
                page.push((offset, len, crc));
                offset = end;
            }
            Ok(page)
        };
        parse().map_err(|m| at_frame(m, &self.path, &format!("directory page {n}")))
    }

    /// Reads everything: each directory page, each block, that blocks follow each other without a gap, and the content hash.
    ///
    /// # Errors
    /// The first damage found.
    pub fn verify(&self) -> Result<()> {
        let mut at = HEADER_BYTES;
        let mut block = vec![];
        for n in 0..self.info.blocks {
            let (offset, len, _) = self.page(n / PAGE_BLOCKS)?[(n % PAGE_BLOCKS) as usize];
            if offset != at {
                return Err(self.damage(format!("block {n}: offset"), at.to_string(), offset.to_string()));
            }
            self.block(n, &mut block)?;
            at += u64::from(len);
        }
        if at != self.directory {
            return Err(self.damage("directory: offset".into(), at.to_string(), self.directory.to_string()));
        }
        self.verify_content_hash()
    }

    fn verify_content_hash(&self) -> Result<()> {
        let end = self.info.bytes - FOOTER_BYTES;
        let mut hash = Xxh3Default::new();
        let mut buffer = vec![0; 1 << 18];
        let mut at = 0;
        while at < end {
            let n = (end - at).min(buffer.len() as u64) as usize;
            self.read_at(at, &mut buffer[..n])?;
            hash.update(&buffer[..n]);
            at += n as u64;
        }
        let (expected, got) = (self.info.content_hash, hash.digest());
        if expected != got {
            let text = |h: u64| format!("{h:016x}");
            return Err(self.damage("footer: content hash".into(), text(expected), text(got)));
        }
        Ok(())
    }
}

fn hex(crc: u32) -> String {
    format!("{crc:08x}")
}

fn at_frame(m: Malformed, path: &Path, part: &str) -> Error {
    Error::bad_input(path, format!("{part}: {}", m.at), m.expected, m.got)
        .with_help("the file is damaged, or was not written by this version of isospan")
}

/// Checks and strips the CRC32C that [`seal`] appended.
fn unseal<'a>(bytes: &'a [u8], at: &'static str) -> std::result::Result<&'a [u8], Malformed> {
    let (body, tail) = bytes.split_at(bytes.len() - 4);
    let (expected, got) = (Cursor::new(tail).u32(at)?, crc32c::crc32c(body));
    if expected != got {
        return Err(Malformed::new(at, hex(expected), hex(got)));
    }
    Ok(body)
}

/// The plan hash. The magic and the version come first: a file of a future version may differ in all the rest.
fn read_header(bytes: &[u8], kind: SegmentKind) -> std::result::Result<PlanHash, Malformed> {
    let mut c = Cursor::new(bytes);
    if c.take(8, "magic")? != MAGIC {
        let got = String::from_utf8_lossy(&bytes[..8]).escape_debug().to_string();
        return Err(Malformed::new("magic", "a segment of an isospan archive", format!("\"{got}\"")));
    }
    let (version, oldest) = (c.u16("version")?, c.u16("version")?);
    if oldest > FORMAT_VERSION || version == 0 {
        return Err(Malformed::new(
            "format version",
            format!("a version that format {FORMAT_VERSION} programs can read"),
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

fn read_footer(bytes: &[u8], file_len: u64) -> std::result::Result<(SegmentInfo, u64), Malformed> {
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

/// A file read at given offsets, from any thread. Not mapped: a file cut short by another program is then an error
/// and not the end of this process.
struct PositionedFile {
    bytes: Bytes,
    len: u64,
}

/// Where the bytes are.
enum Bytes {
    #[cfg(unix)]
    Local(File),
    #[cfg(not(unix))]
    Local(Mutex<File>),
    Remote(RemoteFile),
}

impl PositionedFile {
    fn open(path: &Path) -> Result<Self> {
        if is_remote(path) {
            let file = RemoteFile::open(path)?;
            return Ok(Self { len: file.len(), bytes: Bytes::Remote(file) });
        }
        let file = File::open(path).map_err(|e| Error::io("open", path, e))?;
        let meta = file.metadata().map_err(|e| Error::io("read the length of", path, e))?;
        if !meta.is_file() {
            return Err(Error::bad_input(path, "file", "a segment of an isospan archive", "not a file"));
        }
        #[cfg(not(unix))]
        let file = Mutex::new(file);
        Ok(Self { bytes: Bytes::Local(file), len: meta.len() })
    }

    fn read_at(&self, path: &Path, offset: u64, out: &mut [u8], count: &AtomicU64) -> Result<()> {
        count.fetch_add(out.len() as u64, Ordering::Relaxed);
        let filled = match &self.bytes {
            Bytes::Local(file) => fill(file, offset, out),
            Bytes::Remote(file) => file.read_at(offset, out),
        };
        filled.map_err(|e| Error::io(format!("read {} bytes at {offset} of", out.len()), path, e))
    }
}

#[cfg(unix)]
fn fill(file: &File, offset: u64, out: &mut [u8]) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, out, offset)
}

#[cfg(not(unix))]
fn fill(file: &Mutex<File>, offset: u64, out: &mut [u8]) -> std::io::Result<()> {
    use std::io::{Read, Seek, SeekFrom};
    let mut file = file.lock().expect("no thread panics while it reads");
    file.seek(SeekFrom::Start(offset))?;
    file.read_exact(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: PlanHash = PlanHash(0x0123_4567_89ab_cdef_0011_2233_4455_6677);

    fn blocks(n: usize) -> Vec<Vec<u8>> {
        (0..n).map(|i| (0..i * 7 % 23).map(|j| (i * 31 + j * 17) as u8).collect()).collect()
    }

    fn write(path: &Path, blocks: &[Vec<u8>]) -> SegmentInfo {
        let mut w = SegmentWriter::create(path, SegmentKind::Mesh, PLAN).unwrap();
        for (i, b) in blocks.iter().enumerate() {
            assert_eq!(w.push_block(b).unwrap(), i as u64);
        }
        w.finish().unwrap()
    }

    #[test]
    fn blocks_come_back_in_any_order() {
        let dir = tempfile::tempdir().unwrap();
        for n in [0, 1, 2, 509, 510, 511, 1021] {
            let path = dir.path().join(format!("{n}.seg"));
            let expected = blocks(n);
            let info = write(&path, &expected);
            let s = Segment::open(&path, SegmentKind::Mesh, Some(PLAN)).unwrap();
            assert_eq!((s.block_count(), s.info(), s.plan()), (n as u64, info, PLAN));
            assert_eq!(info.bytes, std::fs::metadata(&path).unwrap().len());
            assert_eq!(
                s.bytes_read(),
                HEADER_BYTES + FOOTER_BYTES,
                "opening reads no block and no directory"
            );
            s.verify().unwrap();
            let mut out = vec![1, 2, 3];
            for i in (0..n).rev() {
                s.block(i as u64, &mut out).unwrap();
                assert_eq!(out, expected[i]);
            }
        }
    }

    #[test]
    fn other_kinds_plans_and_versions_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.seg");
        write(&path, &blocks(3));
        let error = |kind, plan| Segment::open(&path, kind, plan).err().map(|e| e.to_string()).unwrap();
        let e = error(SegmentKind::Index, None);
        assert!(e.contains("kind") && e.contains("index") && e.contains("mesh"), "{e}");
        let e = error(SegmentKind::Mesh, Some(PlanHash(1)));
        assert!(e.contains(&PLAN.to_string()) && e.contains("other input or parameters"), "{e}");
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[10] = 2;
        std::fs::write(&path, bytes).unwrap();
        let e = error(SegmentKind::Mesh, None);
        assert!(e.contains("format 2 and later"), "{e}");
        std::fs::write(&path, vec![b'x'; 500]).unwrap();
        assert!(error(SegmentKind::Mesh, None).contains("magic"));
        assert!(Segment::open(dir.path(), SegmentKind::Mesh, None).is_err());
    }

    #[test]
    fn every_flipped_byte_and_every_cut_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.seg");
        write(&path, &blocks(9));
        let good = std::fs::read(&path).unwrap();
        let check = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Segment::open(&path, SegmentKind::Mesh, Some(PLAN)).and_then(|s| s.verify())
        };
        check(&good).unwrap();
        for i in 0..good.len() {
            for bit in [1, 0x80] {
                let mut bad = good.clone();
                bad[i] ^= bit;
                let e = check(&bad).expect_err("a flipped byte").to_string();
                assert!(!e.contains('\n') && e.contains("a.seg"), "{e}");
            }
            assert!(check(&good[..i]).is_err(), "cut at {i}");
        }
        assert!(check(&[&good[..], &[0]].concat()).is_err(), "a byte too many");
    }

    #[test]
    fn plan_hashes_are_text_and_back() {
        let json = serde_json::to_string(&PLAN).unwrap();
        assert_eq!(json, "\"0123456789abcdef0011223344556677\"");
        assert_eq!(serde_json::from_str::<PlanHash>(&json).unwrap(), PLAN);
        assert!(serde_json::from_str::<PlanHash>("\"12\"").is_err());
    }
}
