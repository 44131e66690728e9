//! A file read at offsets, on disk or in an object store.

use crate::bytes::remote::{RemoteFile, is_remote};
use crate::bytes::{ByteSource, IoMode, open_regular};
use crate::error::{Error, Result};
use std::fs::File;
use std::path::Path;
#[cfg(not(unix))]
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// A file read at given offsets, from any thread; mapped only where its blocks are used where they
/// lie.
pub(super) struct PositionedFile {
    bytes: Bytes,
    pub(super) len: u64,
}

/// Where the bytes are.
enum Bytes {
    #[cfg(unix)]
    Local(File),
    #[cfg(not(unix))]
    Local(Mutex<File>),
    Remote(Box<RemoteFile>),
    /// Mapped, but on a network file system.
    Source(Box<ByteSource>),
}

impl PositionedFile {
    pub(super) fn open(path: &Path) -> Result<Self> {
        if is_remote(path) {
            let file = RemoteFile::open(path)?;
            return Ok(Self { len: file.len(), bytes: Bytes::Remote(Box::new(file)) });
        }
        let file = open_regular(path)?;
        let meta = file.metadata().map_err(|e| Error::io("read the length of", path, e))?;
        #[cfg(not(unix))]
        let file = Mutex::new(file);
        Ok(Self { bytes: Bytes::Local(file), len: meta.len() })
    }

    /// A file whose bytes are used where they lie, on file systems on which files are mapped.
    pub(super) fn map(path: &Path) -> Result<Self> {
        let source = ByteSource::open(path, IoMode::Auto)?;
        Ok(Self { len: source.len(), bytes: Bytes::Source(Box::new(source)) })
    }

    /// Bytes where they lie, if the file is mapped.
    pub(super) fn at_hand(&self, offset: u64, len: u64) -> Option<&[u8]> {
        match &self.bytes {
            Bytes::Source(source) => source.at_hand(offset..offset.checked_add(len)?),
            _ => None,
        }
    }

    /// Whether bytes that were used where they lie were those of the file.
    pub(super) fn check(&self) -> Result<()> {
        match &self.bytes {
            Bytes::Source(source) => source.check(),
            _ => Ok(()),
        }
    }

    pub(super) fn read_at(&self, path: &Path, offset: u64, out: &mut [u8], count: &AtomicU64) -> Result<()> {
        count.fetch_add(out.len() as u64, Ordering::Relaxed);
        let filled = match &self.bytes {
            Bytes::Source(source) => match source.at_hand(offset..offset.saturating_add(out.len() as u64)) {
                // Whether they were the file's is checked after they have been used.
                Some(bytes) => {
                    out.copy_from_slice(bytes);
                    Ok(())
                }
                None => return source.read_at(offset, out),
            },
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
