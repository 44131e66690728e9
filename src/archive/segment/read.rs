//! Reading a segment: header and footer first, pages of the directory and blocks when they are
//! asked for.

use super::frame::{header_plan, hex, read_footer, read_header, unseal};
use super::positioned::PositionedFile;
use super::{
    FOOTER_BYTES, HEADER_BYTES, PAGE_BLOCKS, PAGE_ENTRY_BYTES, PAGE_FRAME_BYTES, PlanHash, SegmentInfo,
    SegmentKind,
};
use crate::archive::wire::{Cursor, Malformed};
use isospan_io::error::{Error, Fault, Result};
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use xxhash_rust::xxh3::Xxh3Default;

/// A directory page that has been read: offset, length and checksum of each of its blocks.
type Page = Arc<Vec<(u64, u32, u32)>>;

/// The plan hash in the header of a segment of any kind, finished or not; `None` of any other file.
pub(crate) fn segment_plan(path: &Path) -> Option<PlanHash> {
    let mut head = [0; HEADER_BYTES as usize];
    if !std::fs::metadata(path).ok()?.is_file() {
        return None;
    }
    std::fs::File::open(path).ok()?.read_exact(&mut head).ok()?;
    header_plan(&head)
}

/// An open segment: blocks by number, from any thread.
pub struct Segment {
    path: PathBuf,
    file: PositionedFile,
    plan: PlanHash,
    info: SegmentInfo,
    directory: u64,
    pages: Mutex<std::collections::BTreeMap<u64, Arc<Mutex<Option<Page>>>>>,
    bytes_read: AtomicU64,
}

impl Segment {
    /// Opens a finished segment; reads its header and footer only.
    ///
    /// # Errors
    /// [`Error::BadInput`] when it is not a whole segment of this kind, of a version that can be
    /// read, and of this plan (`None`: of any plan).
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
        let (offset, len, crc) = self.place(n)?;
        out.clear();
        out.resize(len as usize, 0);
        self.read_at(offset, out)?;
        self.check_block(n, crc, out)
    }

    /// As [`Segment::block`], of blocks that follow each other, with one read; `ends` is replaced
    /// by the end of each in `out`.
    ///
    /// # Errors
    /// As there.
    ///
    /// # Panics
    /// As there.
    pub(crate) fn run(&self, numbers: Range<u64>, out: &mut Vec<u8>, ends: &mut Vec<usize>) -> Result<()> {
        ends.clear();
        out.clear();
        if numbers.is_empty() {
            return Ok(());
        }
        let (offset, mut crcs, mut end) = (self.place(numbers.start)?.0, vec![], 0);
        for n in numbers.clone() {
            let (_, len, crc) = self.place(n)?;
            end += len as usize;
            ends.push(end);
            crcs.push(crc);
        }
        out.resize(end, 0);
        self.read_at(offset, out)?;
        let mut start = 0;
        for ((n, crc), &end) in numbers.zip(crcs).zip(&*ends) {
            self.check_block(n, crc, &out[start..end])?;
            start = end;
        }
        Ok(())
    }

    /// Where a block is: offset, length and checksum.
    fn place(&self, n: u64) -> Result<(u64, u32, u32)> {
        assert!(n < self.info.blocks, "block {n} of {}", self.info.blocks);
        Ok(self.page(n / PAGE_BLOCKS)?[(n % PAGE_BLOCKS) as usize])
    }

    fn check_block(&self, n: u64, crc: u32, bytes: &[u8]) -> Result<()> {
        let got = crc32c::crc32c(bytes);
        if got != crc {
            let damage = self.damage(format!("block {n}: CRC32C"), hex(crc), hex(got));
            return Err(damage.of_fault(Fault::Checksum));
        }
        Ok(())
    }

    /// The length of block `n`.
    ///
    /// # Errors
    /// When its directory page is damaged.
    ///
    /// # Panics
    /// When `n` is not below [`Segment::block_count`].
    pub(crate) fn block_len(&self, n: u64) -> Result<u64> {
        Ok(self.place(n)?.1.into())
    }

    fn read_at(&self, offset: u64, out: &mut [u8]) -> Result<()> {
        self.file.read_at(&self.path, offset, out, &self.bytes_read)
    }

    fn damage(&self, at: String, expected: String, got: String) -> Error {
        Error::bad_input(&self.path, at, expected, got)
            .with_help("the file is damaged: restore it, or delete it and run the same reduction again")
    }

    fn page(&self, n: u64) -> Result<Page> {
        // A thread that needs a page which another one reads waits for it, so each page is read
        // once and `bytes_read` does not depend on threads. Pages do not wait for each other.
        let lock = "no thread panics with a page locked";
        let slot = Arc::clone(self.pages.lock().expect(lock).entry(n).or_default());
        let mut slot = slot.lock().expect(lock);
        if let Some(page) = &*slot {
            return Ok(page.clone());
        }
        let page = Arc::new(self.read_page(n)?);
        *slot = Some(page.clone());
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

    /// Reads everything: each directory page, each block, that blocks follow each other without a
    /// gap, and the content hash.
    ///
    /// # Errors
    /// The first damage found.
    pub fn verify(&self) -> Result<()> {
        let mut at = HEADER_BYTES;
        let mut block = vec![];
        for n in 0..self.info.blocks {
            let (offset, len, _) = self.place(n)?;
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
            let damage = self.damage("footer: content hash".into(), text(expected), text(got));
            return Err(damage.of_fault(Fault::Checksum));
        }
        Ok(())
    }
}

pub(super) fn at_frame(m: Malformed, path: &Path, part: &str) -> Error {
    Error::bad_input(path, format!("{part}: {}", m.at), m.expected, m.got)
        .of_fault(m.fault)
        .with_help("the file is damaged, or was not written by this version of isospan")
}
