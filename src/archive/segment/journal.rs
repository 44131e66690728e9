//! A list of the chunks that are whole in an unfinished segment, kept next to its temporary file.
//!
//! A segment has its directory at its end, so the temporary file of a killed writer does not say
//! where its blocks are. The journal does: after each chunk the writer hands its blocks to the
//! system, then appends a record here.
//!
//! ```text
//!  .000007.seg.tmp-node12-4711-…            the blocks
//!  .000007.seg.chunks.tmp-node12-4711-…     the journal, a record a chunk:
//!      8  number of the chunk
//!      4  number n of its blocks
//!     8n  length and CRC32C of each
//!      4  CRC32C of the record so far
//! ```
//!
//! The next writer trusts none of it: a record counts if its checksum is right, its chunk is the
//! next one, and the blocks have their checksums
//! ([`crate::archive::segment::SegmentWriter::adopt`]). So neither a torn record nor a machine that
//! lost power can do more than lose chunks. The journal is no part of the archive and is removed
//! when the segment is done.

use crate::archive::wire::Cursor;
use isospan_io::bytes::publish::{Dead, TEMPORARY_MARK, open_own};
use isospan_io::error::{Error, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// The blocks of a chunk, each by length and CRC32C.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::archive) struct Record {
    pub(in crate::archive) chunk: u64,
    pub(in crate::archive) blocks: Vec<(u32, u32)>,
}

impl Record {
    fn encode(&self) -> Vec<u8> {
        let mut bytes = self.chunk.to_le_bytes().to_vec();
        bytes.extend((self.blocks.len() as u32).to_le_bytes());
        for (len, crc) in &self.blocks {
            bytes.extend(len.to_le_bytes());
            bytes.extend(crc.to_le_bytes());
        }
        let crc = crc32c::crc32c(&bytes);
        bytes.extend(crc.to_le_bytes());
        bytes
    }

    /// The record at the start of `bytes`, and its length; `None` when there is no whole one.
    fn decode(bytes: &[u8]) -> Option<(Self, usize)> {
        let mut c = Cursor::new(bytes);
        let (chunk, n) = (c.u64("chunk").ok()?, c.u32("blocks").ok()? as usize);
        if n > c.rest().len() / 8 {
            return None;
        }
        let blocks = (0..n).map(|_| Some((c.u32("length").ok()?, c.u32("checksum").ok()?)));
        let blocks = blocks.collect::<Option<_>>()?;
        let body = 12 + 8 * n;
        let crc = c.u32("checksum").ok()?;
        (crc == crc32c::crc32c(&bytes[..body])).then_some((Self { chunk, blocks }, body + 4))
    }
}

/// A journal being written; removed when dropped, unless kept.
pub(in crate::archive) struct Journal {
    file: File,
    path: PathBuf,
    keep: bool,
}

/// The journal's name, from that of the temporary that it is about.
fn name(temporary: &Path) -> PathBuf {
    let name = temporary.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let (name, process) = name.rsplit_once(TEMPORARY_MARK).unwrap_or((&name, ""));
    temporary.with_file_name(format!("{name}.chunks{TEMPORARY_MARK}{process}"))
}

impl Journal {
    /// An empty journal of a temporary.
    pub(in crate::archive) fn create(temporary: &Path) -> Result<Self> {
        let path = name(temporary);
        let file = File::options().read(true).write(true).create_new(true).open(&path);
        let file = file.map_err(|e| Error::io("create", &path, e))?;
        // As for the temporary itself: a writer that holds the lock is alive.
        let _ = file.try_lock();
        Ok(Self { file, path, keep: false })
    }

    /// Renames the journal of a temporary that was renamed. There may be none.
    pub(in crate::archive) fn follow(before: &Path, temporary: &Path) {
        let _ = std::fs::rename(name(before), name(temporary));
    }

    /// The journal that a dead writer left with its temporary, and its whole records.
    pub(in crate::archive) fn of_dead(dead: &Dead) -> Option<(Self, Vec<Record>)> {
        let path = name(&dead.path);
        let mut file = open_own(&path)?;
        let _ = file.try_lock();
        let (mut bytes, mut records) = (vec![], vec![]);
        file.read_to_end(&mut bytes).ok()?;
        let mut rest = &bytes[..];
        while let Some((record, len)) = Record::decode(rest) {
            records.push(record);
            rest = &rest[len..];
        }
        Some((Self { file, path, keep: false }, records))
    }

    /// Forgets all but the first records, which were found whole.
    pub(in crate::archive) fn truncate(&mut self, records: &[Record]) -> Result<()> {
        let len = records.iter().map(|r| 16 + 8 * r.blocks.len() as u64).sum();
        self.file
            .set_len(len)
            .and_then(|()| self.file.seek(SeekFrom::Start(len)))
            .map_err(|e| Error::io("continue", &self.path, e))?;
        self.keep = len > 0;
        Ok(())
    }

    /// Notes a chunk whose blocks have been handed to the system. From then on the journal stays
    /// when dropped.
    pub(in crate::archive) fn push(&mut self, record: &Record) -> Result<()> {
        self.file.write_all(&record.encode()).map_err(|e| Error::io("write", &self.path, e))?;
        self.keep = true;
        Ok(())
    }

    /// The segment is done.
    pub(in crate::archive) fn remove(mut self) {
        self.keep = false;
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        if !self.keep {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_torn_or_damaged_record_ends_the_journal() {
        let record = |chunk, n: u32| Record { chunk, blocks: (0..n).map(|i| (i * 7, !i)).collect() };
        let (a, b) = (record(5, 3).encode(), record(6, 0).encode());
        assert_eq!((a.len(), b.len()), (40, 16));
        assert_eq!(Record::decode(&[&a[..], &b].concat()).unwrap(), (record(5, 3), 40));
        for i in 0..a.len() {
            assert!(Record::decode(&a[..i]).is_none(), "cut at {i}");
            let mut bad = a.clone();
            bad[i] ^= 4;
            assert!(Record::decode(&bad).is_none(), "byte {i} changed");
        }
        let mut huge = 0u64.to_le_bytes().to_vec();
        huge.extend([0xff; 12]);
        assert!(Record::decode(&huge).is_none());
    }
}
