//! The bytes of a file, without reading it whole.
//!
//! A [`ByteSource`] is a file of known length with random access. It is mapped into memory (so that a volume larger
//! than memory costs only the pages that are touched, which the system may drop again at any time) or held in memory
//! (tests, small headers). Every access is checked against the length, and a refusal names file, offset and lengths:
//! a header that lies about sizes ends here as a clear error, never as a panic.
//!
//! ```text
//!  ByteSource ──▶ read_at(offset, buf)   copies; works for every kind of source
//!            ├──▶ slice(range)           borrows from the mapping, no copy
//!            └──▶ reader(range)          a std::io::Read over a range, for decoders
//! ```
//!
//! Not promised: a file that another program shortens while it is mapped ends the process with SIGBUS; see `mmap`.

mod mmap;

use crate::error::{Error, Result};
use std::fs::File;
use std::io::{self, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A file's bytes with checked random access.
#[derive(Debug)]
pub struct ByteSource {
    path: PathBuf,
    bytes: Bytes,
}

/// Where the bytes are.
#[derive(Debug)]
enum Bytes {
    Mapped(mmap::Mapping),
    Memory(Vec<u8>),
}

impl ByteSource {
    /// Maps a file. Cost: none until bytes are touched.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses; [`Error::BadInput`] for a folder, a pipe or device, or an empty file.
    pub fn map(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::of_file(path, &open_regular(path)?)
    }

    /// Maps an open file; `path` is the name used in messages.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses.
    pub fn of_file(path: impl AsRef<Path>, file: &File) -> Result<Self> {
        let path = path.as_ref();
        let mapping = mmap::Mapping::new(file).map_err(|e| Error::io("map", path, e))?;
        Ok(Self { path: path.to_path_buf(), bytes: Bytes::Mapped(mapping) })
    }

    /// Bytes that are in memory already; `path` is the name used in messages.
    pub fn from_vec(path: impl AsRef<Path>, bytes: Vec<u8>) -> Self {
        Self { path: path.as_ref().to_path_buf(), bytes: Bytes::Memory(bytes) }
    }

    /// The file's name, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length in bytes.
    pub fn len(&self) -> u64 {
        self.all().len() as u64
    }

    /// Whether there are no bytes; never so for a mapped file.
    pub fn is_empty(&self) -> bool {
        self.all().is_empty()
    }

    /// Copies the `out.len()` bytes at `offset`.
    ///
    /// # Errors
    /// [`Error::BadInput`] when they do not all lie within the file.
    pub fn read_at(&self, offset: u64, out: &mut [u8]) -> Result<()> {
        let bytes = self.at(offset, out.len() as u64)?;
        out.copy_from_slice(bytes);
        Ok(())
    }

    /// Borrows a range of bytes.
    ///
    /// # Errors
    /// [`Error::BadInput`] when it does not lie within the file.
    pub fn slice(&self, range: Range<u64>) -> Result<&[u8]> {
        let len = range.end.checked_sub(range.start);
        self.at(range.start, len.ok_or_else(|| self.too_short(range.start, range.end))?)
    }

    /// Reads a range front to back. A range beyond the end is an error at once.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the range does not lie within the file.
    pub fn reader(self: &Arc<Self>, range: Range<u64>) -> Result<ByteReader> {
        self.slice(range.clone())?;
        Ok(ByteReader { source: Arc::clone(self), at: range.start, end: range.end })
    }

    /// Tells the system that a range will be read soon. A hint: nothing happens where it cannot be given.
    pub fn advise_will_need(&self, range: Range<u64>) {
        if let Bytes::Mapped(mapping) = &self.bytes {
            mapping.advise_will_need(range.start.min(self.len())..range.end.min(self.len()));
        }
    }

    fn all(&self) -> &[u8] {
        match &self.bytes {
            Bytes::Mapped(mapping) => mapping.bytes(),
            Bytes::Memory(bytes) => bytes,
        }
    }

    fn at(&self, offset: u64, len: u64) -> Result<&[u8]> {
        let end = offset.checked_add(len).filter(|&end| end <= self.len());
        let end = end.ok_or_else(|| self.too_short(offset, len))?;
        Ok(&self.all()[offset as usize..end as usize])
    }

    fn too_short(&self, offset: u64, len: u64) -> Error {
        Error::bad_input(
            &self.path,
            format!("byte {offset}"),
            format!("{len} more bytes"),
            format!("a file of {} bytes", self.len()),
        )
        .with_help("the file is cut short, or its header is wrong")
    }
}

/// Opens a file that can be mapped. Looks before it opens: opening a pipe would wait for a writer for ever.
fn open_regular(path: &Path) -> Result<File> {
    let refuse = |got: &str| Error::bad_input(path, "file", "a regular file with data", got);
    let about = std::fs::metadata(path).map_err(|e| Error::io("open", path, e))?;
    if about.is_dir() {
        return Err(refuse("a folder").with_help("name a file in it"));
    }
    if !about.is_file() {
        return Err(refuse("a pipe, socket or device").with_help("copy the data to a file first"));
    }
    if about.len() == 0 {
        return Err(refuse("an empty file"));
    }
    File::open(path).map_err(|e| Error::io("open", path, e))
}

/// Reads a range of a [`ByteSource`] front to back.
#[derive(Debug)]
pub struct ByteReader {
    source: Arc<ByteSource>,
    at: u64,
    end: u64,
}

impl Read for ByteReader {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let n = (self.end - self.at).min(out.len() as u64) as usize;
        self.source.read_at(self.at, &mut out[..n]).map_err(io::Error::other)?;
        self.at += n as u64;
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn temporary(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("data.bin");
        std::fs::write(&path, bytes).unwrap();
        (dir, path)
    }

    #[test]
    fn mapped_and_memory_agree() {
        let data: Vec<u8> = (0..=255).collect();
        let (_dir, path) = temporary(&data);
        for source in [ByteSource::map(&path).unwrap(), ByteSource::from_vec(&path, data.clone())] {
            assert_eq!((source.len(), source.path(), source.is_empty()), (256, path.as_path(), false));
            let mut out = [0; 3];
            source.read_at(253, &mut out).unwrap();
            assert_eq!(out, [253, 254, 255]);
            assert_eq!(source.slice(10..12).unwrap(), [10, 11]);
            assert_eq!(source.slice(256..256).unwrap(), [0u8; 0]);
            source.advise_will_need(200..u64::MAX);
            let mut rest = vec![];
            Arc::new(source).reader(250..256).unwrap().read_to_end(&mut rest).unwrap();
            assert_eq!(rest, [250, 251, 252, 253, 254, 255]);
        }
    }

    #[test]
    fn every_access_is_checked() {
        let (_dir, path) = temporary(&[1, 2, 3, 4]);
        let source = Arc::new(ByteSource::map(&path).unwrap());
        let mut out = [0; 2];
        for offset in [3, 4, u64::MAX - 1, u64::MAX] {
            let line = source.read_at(offset, &mut out).unwrap_err().to_string();
            assert!(line.contains(&offset.to_string()) && line.contains("4 bytes"), "{line}");
        }
        #[allow(clippy::reversed_empty_ranges)]
        for range in [0..5, 3..2, 5..5, u64::MAX..0] {
            assert!(source.slice(range.clone()).is_err() && source.reader(range).is_err());
        }
    }

    #[test]
    fn what_is_not_a_file_with_data_is_refused() {
        let (dir, path) = temporary(&[]);
        let refused = |p: &Path| ByteSource::map(p).unwrap_err();
        assert!(refused(&path).to_string().contains("an empty file"));
        assert!(refused(dir.path()).to_string().contains("a folder"));
        assert_eq!(refused(&dir.path().join("none")).exit_code(), 1);
        #[cfg(unix)]
        assert!(refused(Path::new("/dev/null")).to_string().contains("device"));
    }
}
