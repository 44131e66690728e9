//! A file read at offsets, on disk or in an object store.

use isospan_io::bytes::open_regular;
use isospan_io::bytes::remote::{RemoteFile, is_remote};
use isospan_io::error::{Error, Result};
use std::fs::File;
use std::path::Path;
#[cfg(not(unix))]
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// A file read at given offsets, from any thread.
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

    pub(super) fn read_at(&self, path: &Path, offset: u64, out: &mut [u8], count: &AtomicU64) -> Result<()> {
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
