//! Writing a segment: blocks, directory pages, footer; the name last.

use super::frame::{directory_page, footer, header};
use super::{FOOTER_BYTES, HEADER_BYTES, LARGEST_BLOCK, PAGE_BLOCKS, PlanHash, SegmentInfo, SegmentKind};
use crate::archive::segment::Record;
use isospan_io::bytes::publish::{Dead, Unpublished};
use isospan_io::error::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3Default;

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
        Self::begin(Unpublished::create(&path)?, path, kind, plan)
    }

    /// As [`SegmentWriter::create`], without looking in its folder, which may have many files, for
    /// what dead writers of it left.
    ///
    /// # Errors
    /// As there.
    pub fn create_unlooked(path: impl AsRef<Path>, kind: SegmentKind, plan: PlanHash) -> Result<Self> {
        let path = path.as_ref().to_path_buf();
        Self::begin(Unpublished::begin(&path)?, path, kind, plan)
    }

    fn begin(out: Unpublished, path: PathBuf, kind: SegmentKind, plan: PlanHash) -> Result<Self> {
        let mut writer = Self { out, path, hash: Xxh3Default::new(), offset: 0, entries: vec![] };
        writer.put(&header(kind as u32, plan))?;
        Ok(writer)
    }

    /// Goes on with what a dead writer of this segment left: the first of `records` whose blocks
    /// are there, undamaged, give the blocks to begin with, and their number is returned. `None`
    /// when it is not of this kind and plan. Reads and checks all bytes that are kept.
    pub(in crate::archive) fn adopt(
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

    /// Hands all blocks so far to the system, so that they outlive this process, and keeps the
    /// temporary file for [`SegmentWriter::adopt`] should the segment not be finished.
    pub(in crate::archive) fn keep(&mut self) -> Result<()> {
        self.out.flush()?;
        self.out.keep();
        Ok(())
    }

    /// The file's name until it is finished.
    pub(in crate::archive) fn temporary(&self) -> &Path {
        self.out.temporary()
    }

    /// Length and CRC32C of the blocks from number `first` on.
    pub(in crate::archive) fn entries_from(&self, first: usize) -> &[(u32, u32)] {
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

    /// Writes directory and footer, and publishes the file as a part of an archive, whose folders
    /// are synced before its manifest is written.
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
        self.out.publish_part()?;
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
