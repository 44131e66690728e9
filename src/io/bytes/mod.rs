//! The bytes of a file, without reading it whole.
//!
//! A [`ByteSource`] is a file of known length with random access, in one of three ways that give
//! the same bytes:
//!
//! * **mapped** into memory ([`IoMode::Map`]): a volume larger than memory costs only the pages
//!   that are touched, which the system may drop again at any time, and bytes are used where they
//!   lie;
//! * **read** at given offsets ([`IoMode::Read`]): no page faults, which on a network file system
//!   each cost a request of 4 KiB, and no address space;
//! * **fetched** from a server by ranges, where the name is an address: see [`remote`].
//!
//! [`IoMode::Auto`], the default, reads on network file systems and maps elsewhere. Every access is
//! checked against the length, and a refusal names file, offset and lengths. A header with wrong
//! sizes ends here as a clear error, never as a panic.
//!
//! ```text
//!  ByteSource ──▶ read_at(offset, buf)   copies; works for every kind of source
//!            ├──▶ view(range, buf)       borrows from the mapping, or reads into the buffer
//!            ├──▶ slice(range)           borrows; for headers and text, see there
//!            ├──▶ reader(range)          a std::io::Read over a range, for decoders
//!            └──▶ check()                after views and slices: were those bytes the file's?
//! ```
//!
//! A file that another program shortens meanwhile is an error naming it, also when it is mapped:
//! see `mmap`. Users of borrowed bytes call [`ByteSource::check`] afterwards; `read_at` and readers
//! do it themselves.
//!
//! **The page cache is shared by all programs.** A file larger than a quarter of the machine's
//! memory would evict what other programs use. The pages of such a file are dropped once they have
//! been read ([`ByteSource::release`]); smaller files stay cached for the next run. Pages that
//! follow are requested ahead ([`ByteSource::advise_will_need`]).

mod borrowed;
pub(crate) mod filesystem;
mod mmap;
#[doc(hidden)]
pub mod opens;
pub mod paged;
pub mod place;
pub mod plain;
pub mod publish;
pub mod remote;
pub mod sorter;
mod stage;
pub mod stamp;
pub mod store;

use crate::error::{Error, Fault, Place, Result};
use borrowed::Borrowed;
use remote::{RemoteFile, is_remote};
pub use stage::StagedFolder;
use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// How a file's bytes are accessed. All modes give the same bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IoMode {
    /// [`IoMode::Read`] on network file systems (NFS, SMB, Lustre, GPFS, FUSE, AFS, Ceph, BeeGFS
    /// and others; on Linux), [`IoMode::Map`] elsewhere.
    #[default]
    Auto,
    /// Mapped into memory.
    Map,
    /// Read at given offsets.
    Read,
}

impl IoMode {
    /// The mode that is used for an open file, never [`IoMode::Auto`].
    fn resolve(self, file: &File) -> Self {
        match self {
            Self::Auto if filesystem::is_remote(file) => Self::Read,
            Self::Auto => Self::Map,
            chosen => chosen,
        }
    }
}

/// A file's bytes with checked random access.
#[derive(Debug)]
pub struct ByteSource {
    path: PathBuf,
    len: u64,
    bytes: Bytes,
    /// Whether pages that have been read are dropped from the system's cache.
    drop_behind: bool,
}

/// Where the bytes are.
#[derive(Debug)]
enum Bytes {
    Mapped(File, mmap::Mapping),
    /// The mapping is made when a slice is first asked for.
    Read(File, OnceLock<mmap::Mapping>),
    Memory(InMemory),
    /// Slices that were borrowed are kept.
    Remote(Box<RemoteFile>, Borrowed),
}

/// Bytes that something else owns.
struct InMemory(Box<dyn AsRef<[u8]> + Send + Sync>);

impl InMemory {
    fn bytes(&self) -> &[u8] {
        (*self.0).as_ref()
    }
}

impl fmt::Debug for InMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes in memory", self.bytes().len())
    }
}

/// Readers drop the bytes that they have read in pieces of this size.
const DROP_BYTES: u64 = 16 << 20;
/// Readers of a file on a server fetch so many bytes at a time.
const FETCHED_BYTES: u64 = 1 << 20;
/// The most bytes that are fetched at once, and the most that are borrowed of a file on a server.
const MOST_FETCHED: u64 = (1 << 30) + (16 << 20);
const MOST_KEPT: u64 = 64 << 20;
/// Bytes at the beginning of a file on a server that are fetched for a header in them.
const HEAD_BYTES: u64 = 1 << 20;

impl ByteSource {
    /// Opens a file, on a server where the path is an address. Cost: none until bytes are used; of
    /// a file on a server, a request.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses; [`Error::BadInput`] for a folder, a pipe or device,
    /// or an empty file.
    pub fn open(path: impl AsRef<Path>, mode: IoMode) -> Result<Self> {
        let path = path.as_ref();
        if is_remote(path) {
            let file = RemoteFile::open(path)?;
            let len = file.len();
            if len == 0 {
                return Err(not_regular(path, "an empty file"));
            }
            let bytes = Bytes::Remote(Box::new(file), Borrowed::default());
            return Ok(Self { path: path.to_path_buf(), len, bytes, drop_behind: false });
        }
        Self::of_file(path, open_with_data(path)?, mode)
    }

    /// [`ByteSource::open`] with [`IoMode::Map`].
    ///
    /// # Errors
    /// Those of [`ByteSource::open`].
    pub fn map(path: impl AsRef<Path>) -> Result<Self> {
        Self::open(path, IoMode::Map)
    }

    /// The bytes of an open file; `path` is the name used in messages.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses.
    pub fn of_file(path: impl AsRef<Path>, file: File, mode: IoMode) -> Result<Self> {
        let path = path.as_ref();
        let about = file.metadata().map_err(|e| Error::io("read the length of", path, e))?;
        let bytes = match mode.resolve(&file) {
            IoMode::Read => Bytes::Read(file, OnceLock::new()),
            _ => {
                let mapping = mmap::Mapping::new(&file).map_err(|e| Error::io("map", path, e))?;
                Bytes::Mapped(file, mapping)
            }
        };
        let len = match &bytes {
            Bytes::Mapped(_, mapping) => mapping.bytes().len() as u64,
            _ => about.len(),
        };
        let drop_behind = len > filesystem::machine_memory() / 4;
        Ok(Self { path: path.to_path_buf(), len, bytes, drop_behind })
    }

    /// Bytes that are in memory already; `path` is the name used in messages.
    pub fn from_vec(path: impl AsRef<Path>, bytes: Vec<u8>) -> Self {
        Self::in_memory(path, bytes)
    }

    /// As [`ByteSource::from_vec`], for bytes with any owner. They must stay the same.
    pub fn in_memory(path: impl AsRef<Path>, owner: impl AsRef<[u8]> + Send + Sync + 'static) -> Self {
        let bytes = InMemory(Box::new(owner));
        let len = bytes.bytes().len() as u64;
        Self { path: path.as_ref().to_path_buf(), len, bytes: Bytes::Memory(bytes), drop_behind: false }
    }

    /// The file's name, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length in bytes, when it was opened.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Whether there are no bytes; never so for a file that was opened by name.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// How the bytes are accessed: [`IoMode::Map`] or [`IoMode::Read`].
    pub fn mode(&self) -> IoMode {
        if matches!(self.bytes, Bytes::Read(..) | Bytes::Remote(..)) { IoMode::Read } else { IoMode::Map }
    }

    /// Copies the `out.len()` bytes at `offset`.
    ///
    /// # Errors
    /// [`Error::BadInput`] when they do not all lie within the file, or it has become shorter.
    pub fn read_at(&self, offset: u64, out: &mut [u8]) -> Result<()> {
        let range = self.within(offset, out.len() as u64)?;
        match &self.bytes {
            Bytes::Read(file, _) => self.read_into(file, offset, out),
            Bytes::Mapped(_, mapping) => {
                out.copy_from_slice(&mapping.bytes()[range]);
                self.check()
            }
            Bytes::Memory(bytes) => {
                out.copy_from_slice(&bytes.bytes()[range]);
                Ok(())
            }
            Bytes::Remote(file, _) => self.fetch_into(file, offset, out),
        }
    }

    /// Whether the bytes come from a server.
    pub(crate) fn is_remote(&self) -> bool {
        matches!(self.bytes, Bytes::Remote(..))
    }

    fn fetch_into(&self, file: &RemoteFile, offset: u64, out: &mut [u8]) -> Result<()> {
        file.read_at(offset, out)
            .map_err(|e| Error::io(format!("read {} bytes at {offset} of", out.len()), &self.path, e))
    }

    /// Bytes of a range that are to be fetched: a server may claim any length of a file.
    fn expect_few(&self, range: &Range<u64>, most: u64) -> Result<()> {
        let count = range.end - range.start;
        if count <= most {
            return Ok(());
        }
        let expected = format!("at most {most} bytes to fetch at a time");
        Err(Error::bad_input(&self.path, Place::byte(range.start), expected, format!("{count} bytes"))
            .with_help("copy the file to a disk, and name that copy"))
    }

    fn read_into(&self, file: &File, offset: u64, out: &mut [u8]) -> Result<()> {
        store::read_at(file, out, offset).map_err(|e| match e.kind() {
            io::ErrorKind::UnexpectedEof => self.shrunk(file),
            _ => Error::io(format!("read {} bytes at {offset} of", out.len()), &self.path, e),
        })
    }

    /// A range of bytes: borrowed where they are in memory or mapped, else read into `buffer`. When
    /// they have been used, [`ByteSource::check`] says whether they were the file's.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the range does not lie within the file, or that has become shorter.
    pub fn view<'a>(&'a self, range: Range<u64>, buffer: &'a mut Vec<u8>) -> Result<&'a [u8]> {
        let within = self.range(&range)?;
        match &self.bytes {
            Bytes::Mapped(_, mapping) => Ok(&mapping.bytes()[within]),
            Bytes::Memory(bytes) => Ok(&bytes.bytes()[within]),
            Bytes::Read(file, _) => {
                buffer.resize(within.len(), 0);
                self.read_into(file, range.start, buffer)?;
                Ok(buffer)
            }
            Bytes::Remote(file, _) => {
                self.expect_few(&range, MOST_FETCHED)?;
                buffer.resize(within.len(), 0);
                self.fetch_into(file, range.start, buffer)?;
                Ok(buffer)
            }
        }
    }

    /// The bytes of a range that need not be read first, for they are in memory or mapped; `None`
    /// of others, and beyond the end.
    pub(crate) fn at_hand(&self, range: Range<u64>) -> Option<&[u8]> {
        let bytes = match &self.bytes {
            Bytes::Mapped(_, mapping) => mapping.bytes(),
            Bytes::Memory(bytes) => bytes.bytes(),
            Bytes::Read(..) | Bytes::Remote(..) => return None,
        };
        bytes.get(usize::try_from(range.start).ok()?..usize::try_from(range.end).ok()?)
    }

    /// Borrows a range of bytes. A file that is read and not mapped gets a mapping for that. This
    /// is for headers, directories and text that must be searched: only what is touched is loaded.
    /// Of a file on a server the range is fetched and kept, up to 64 MiB in all.
    /// Samples are read by [`ByteSource::view`]. When the bytes have been used,
    /// [`ByteSource::check`] says whether they were the file's.
    ///
    /// # Errors
    /// [`Error::BadInput`] when it does not lie within the file, [`Error::Io`] when it cannot be
    /// mapped.
    pub fn slice(&self, range: Range<u64>) -> Result<&[u8]> {
        let within = self.range(&range)?;
        Ok(match &self.bytes {
            Bytes::Mapped(_, mapping) => &mapping.bytes()[within],
            Bytes::Memory(bytes) => &bytes.bytes()[within],
            Bytes::Read(file, mapping) => {
                if mapping.get().is_none() {
                    let made = mmap::Mapping::new(file).map_err(|e| Error::io("map", &self.path, e))?;
                    // Another thread's mapping is as good.
                    let _ = mapping.set(made);
                }
                let bytes = mapping.get().expect("it was set, here or by another thread").bytes();
                bytes.get(within).ok_or_else(|| self.shrunk(file))?
            }
            Bytes::Remote(file, kept) => {
                if let Some(bytes) = kept.get(&range) {
                    return Ok(bytes);
                }
                self.expect_few(&range, MOST_KEPT.saturating_sub(kept.bytes()))?;
                let mut bytes = vec![0; within.len()];
                self.fetch_into(file, range.start, &mut bytes)?;
                kept.keep(range.start, bytes)
            }
        })
    }

    /// The bytes from `start` on in which a header is searched: all, but of a file on a server the
    /// first mebibyte.
    ///
    /// # Errors
    /// Those of [`ByteSource::slice`].
    pub(crate) fn head_from(&self, start: u64) -> Result<&[u8]> {
        let end = if self.is_remote() { start.saturating_add(HEAD_BYTES).min(self.len) } else { self.len };
        self.slice(start..end)
    }

    /// Whether the bytes of views and slices used so far were those of the file: an error when it
    /// has become shorter, or its device failed. Costs one `fstat` of a mapped file, else nothing.
    ///
    /// # Errors
    /// [`Error::BadInput`] naming the file.
    pub fn check(&self) -> Result<()> {
        let (file, mapping) = match &self.bytes {
            Bytes::Mapped(file, mapping) => (file, mapping),
            Bytes::Read(file, mapping) => match mapping.get() {
                Some(mapping) => (file, mapping),
                None => return Ok(()),
            },
            Bytes::Memory(_) | Bytes::Remote(..) => return Ok(()),
        };
        let short = file.metadata().is_ok_and(|about| about.len() < self.len);
        if short || mapping.is_broken() { Err(self.shrunk(file)) } else { Ok(()) }
    }

    fn shrunk(&self, file: &File) -> Error {
        let got = match file.metadata() {
            Ok(about) if about.len() < self.len => format!("{} bytes now", about.len()),
            _ => "pages that cannot be read".into(),
        };
        let expected = format!("{} bytes, as when it was opened", self.len);
        Error::bad_input(&self.path, "length of the file", expected, got)
            .of_fault(Fault::CutShort)
            .with_help("another program shortened it while it was read, or its device failed")
    }

    /// Reads a range front to back. A range beyond the end is an error at once.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the range does not lie within the file.
    pub fn reader(self: &Arc<Self>, range: Range<u64>) -> Result<ByteReader> {
        self.range(&range)?;
        let fetched = (range.start, vec![]);
        Ok(ByteReader {
            source: Arc::clone(self),
            at: range.start,
            end: range.end,
            released: range.start,
            fetched,
        })
    }

    /// Advises the system that a range will be read soon. A hint: nothing happens where it cannot
    /// be given.
    pub fn advise_will_need(&self, range: Range<u64>) {
        let range = range.start.min(self.len)..range.end.min(self.len);
        match &self.bytes {
            Bytes::Mapped(_, mapping) => mapping.advise_will_need(range),
            Bytes::Read(file, _) => advise(file, &range, Advice::WillNeed),
            Bytes::Memory(_) | Bytes::Remote(..) => {}
        }
    }

    /// Announces that this run will not read a range again. Its pages are dropped if the file is
    /// larger than a quarter of the machine's memory. A hint: reading it again gives the same
    /// bytes.
    pub fn release(&self, range: Range<u64>) {
        let range = range.start.min(self.len)..range.end.min(self.len);
        if !self.drop_behind || range.is_empty() {
            return;
        }
        match &self.bytes {
            Bytes::Mapped(file, mapping) => {
                mapping.let_go(range.clone());
                advise(file, &range, Advice::DontNeed);
            }
            Bytes::Read(file, mapping) => {
                if let Some(mapping) = mapping.get() {
                    mapping.let_go(range.clone());
                }
                advise(file, &range, Advice::DontNeed);
            }
            Bytes::Memory(_) | Bytes::Remote(..) => {}
        }
    }

    fn range(&self, range: &Range<u64>) -> Result<Range<usize>> {
        let len = range.end.checked_sub(range.start);
        self.within(range.start, len.ok_or_else(|| self.too_short(range.start, range.end))?)
    }

    fn within(&self, offset: u64, len: u64) -> Result<Range<usize>> {
        let end = offset.checked_add(len).filter(|&end| end <= self.len);
        let end = end.ok_or_else(|| self.too_short(offset, len))?;
        Ok(offset as usize..end as usize)
    }

    fn too_short(&self, offset: u64, len: u64) -> Error {
        Error::bad_input(
            &self.path,
            Place::byte(offset),
            format!("{len} more bytes"),
            format!("a file of {} bytes", self.len),
        )
        .of_fault(Fault::CutShort)
        .with_help("the file is cut short, or its header is wrong")
    }
}

#[derive(Clone, Copy)]
enum Advice {
    WillNeed,
    DontNeed,
}

/// A hint about the page cache; refused hints are of no consequence.
fn advise(file: &File, range: &Range<u64>, advice: Advice) {
    #[cfg(target_os = "linux")]
    if let Some(len) = std::num::NonZeroU64::new(range.end - range.start) {
        let advice = match advice {
            Advice::WillNeed => rustix::fs::Advice::WillNeed,
            Advice::DontNeed => rustix::fs::Advice::DontNeed,
        };
        let _ = rustix::fs::fadvise(file, range.start, Some(len), advice);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, range, advice);
}

/// Opens a regular file with data.
fn open_with_data(path: &Path) -> Result<File> {
    let file = open_regular(path)?;
    let about = file.metadata().map_err(|e| Error::io("read the length of", path, e))?;
    if about.len() == 0 {
        return Err(not_regular(path, "an empty file"));
    }
    Ok(file)
}

/// Opens a regular file for reading. Never waits, and never touches a device: a pipe without a
/// writer would block for ever, a device may have no end.
///
/// # Errors
/// [`Error::Io`] when the system refuses; [`Error::BadInput`] for a folder, a pipe, a socket or a
/// device.
pub fn open_regular(path: &Path) -> Result<File> {
    opens::note(path);
    expect_regular(path, &std::fs::metadata(path).map_err(|e| Error::io("open", path, e))?)?;
    let mut options = File::options();
    options.read(true);
    // Another process may replace the file by a pipe after the look above.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(
        &mut options,
        rustix::fs::OFlags::NONBLOCK.bits().cast_signed(),
    );
    let file = options.open(path).map_err(|e| Error::io("open", path, e))?;
    expect_regular(path, &file.metadata().map_err(|e| Error::io("read the length of", path, e))?)?;
    Ok(file)
}

/// Opens a regular file for reading that no link leads to. Never waits.
///
/// # Errors
/// Those of the system; [`io::ErrorKind::InvalidInput`] for a link, a folder, a pipe, a socket or a
/// device.
#[doc(hidden)]
pub fn open_unlinked(path: &Path) -> io::Result<File> {
    plain::open_plain(path, File::options().read(true))
}

/// Writes a file that appears whole or not at all. What had its name is replaced, and no link is
/// followed.
///
/// # Errors
/// [`Error::Io`].
#[doc(hidden)]
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut out = publish::Unpublished::create(path)?;
    out.write(bytes)?;
    out.publish()
}

/// Reads a regular file of at most `most` bytes into memory.
///
/// # Errors
/// Those of [`open_regular`]; [`Error::BadInput`] for a longer file.
pub fn read_whole(path: &Path, most: u64) -> Result<Vec<u8>> {
    let file = open_regular(path)?;
    let len = file.metadata().map_err(|e| Error::io("read the length of", path, e))?.len();
    let mut bytes = vec![];
    if len <= most {
        // One byte more than allowed shows a file that grows while it is read.
        file.take(most + 1).read_to_end(&mut bytes).map_err(|e| Error::io("read", path, e))?;
    }
    match len.max(bytes.len() as u64) {
        len if len <= most => Ok(bytes),
        len => {
            let (most, got) = (format!("at most {most} bytes"), format!("{len} bytes"));
            Err(Error::bad_input(path, "file length", most, got))
        }
    }
}

fn expect_regular(path: &Path, about: &std::fs::Metadata) -> Result<()> {
    if about.is_dir() {
        return Err(not_regular(path, "a folder").with_help("name a file in it"));
    }
    if !about.is_file() {
        let error = not_regular(path, "a pipe, socket or device");
        return Err(error.with_help("copy the data to a file first"));
    }
    Ok(())
}

fn not_regular(path: &Path, got: &str) -> Error {
    Error::bad_input(path, "file", "a regular file with data", got)
}

/// Reads a range of a [`ByteSource`] front to back.
#[derive(Debug)]
pub struct ByteReader {
    source: Arc<ByteSource>,
    at: u64,
    end: u64,
    /// Up to here pages have been given up.
    released: u64,
    /// Bytes that were fetched, and where they begin; none of a file on this machine.
    fetched: (u64, Vec<u8>),
}

impl ByteReader {
    /// Reads from what was fetched before, or now.
    fn read_fetched(&mut self, out: &mut [u8]) -> Result<()> {
        let within = |first: u64, len: usize| self.at >= first && self.at < first + len as u64;
        if !within(self.fetched.0, self.fetched.1.len()) {
            let end = (self.at + FETCHED_BYTES).min(self.end);
            self.fetched.1.resize((end - self.at) as usize, 0);
            self.fetched.0 = self.at;
            if let Err(e) = self.source.read_at(self.at, &mut self.fetched.1) {
                self.fetched.1.clear();
                return Err(e);
            }
        }
        let skip = (self.at - self.fetched.0) as usize;
        out.copy_from_slice(&self.fetched.1[skip..skip + out.len()]);
        Ok(())
    }
}

impl Read for ByteReader {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut n = (self.end - self.at).min(out.len() as u64) as usize;
        if self.source.is_remote() && n > 0 {
            let (first, bytes) = &self.fetched;
            let left = (first + bytes.len() as u64).checked_sub(self.at).filter(|&left| left > 0);
            n = n.min(left.unwrap_or(FETCHED_BYTES) as usize);
            self.read_fetched(&mut out[..n]).map_err(io::Error::other)?;
        } else {
            self.source.read_at(self.at, &mut out[..n]).map_err(io::Error::other)?;
        }
        self.at += n as u64;
        if self.at - self.released >= DROP_BYTES {
            self.source.release(self.released..self.at);
            self.released = self.at;
        }
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
        for source in [
            ByteSource::open(&path, IoMode::Map).unwrap(),
            ByteSource::open(&path, IoMode::Read).unwrap(),
            ByteSource::open(&path, IoMode::Auto).unwrap(),
            ByteSource::from_vec(&path, data.clone()),
        ] {
            assert_eq!((source.len(), source.path(), source.is_empty()), (256, path.as_path(), false));
            let mut out = [0; 3];
            source.read_at(253, &mut out).unwrap();
            assert_eq!(out, [253, 254, 255]);
            assert_eq!(source.slice(10..12).unwrap(), [10, 11]);
            assert_eq!(source.slice(256..256).unwrap(), [0u8; 0]);
            let mut buffer = vec![9; 5];
            assert_eq!(source.view(10..12, &mut buffer).unwrap(), [10, 11]);
            assert!(source.view(255..257, &mut buffer).is_err());
            source.check().unwrap();
            source.release(0..u64::MAX);
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

    /// Cuts a mapped file at every kind of place while it is being read; no access may end the
    /// process.
    #[test]
    fn a_file_that_shrinks_is_an_error_that_names_it() {
        let page = 4096usize;
        for (mode, cut) in
            [IoMode::Map, IoMode::Read].into_iter().flat_map(|m| [0, 100, page, page + 7].map(|c| (m, c)))
        {
            let (_dir, path) = temporary(&vec![7; 64 * page]);
            let source = Arc::new(ByteSource::open(&path, mode).unwrap());
            source.read_at(0, &mut [0; 10]).unwrap();
            let mut reader = source.reader(0..source.len()).unwrap();
            reader.read_exact(&mut [0; 50]).unwrap();
            File::options().write(true).open(&path).unwrap().set_len(cut as u64).unwrap();
            // Borrowed bytes are zeros at worst, and a check afterwards reports the cut.
            let sum: u64 = source.slice(0..source.len()).map_or(0, |b| b.iter().map(|&b| u64::from(b)).sum());
            assert!(sum <= 7 * 4096 * 64);
            let mut buffer = vec![];
            let viewed = source.view(10 * page as u64..11 * page as u64, &mut buffer).map(<[u8]>::len);
            let failures = [
                viewed.and_then(|_| source.check()),
                source.read_at(60 * page as u64, &mut [0; 10]),
                source.read_at(cut as u64, &mut [0; 1]),
                reader.read_to_end(&mut vec![]).map(|_| ()).map_err(|e| {
                    e.downcast::<Error>().unwrap_or_else(|e| panic!("{e}: one of our errors inside"))
                }),
            ];
            for failure in failures {
                let error = failure.unwrap_err();
                let line = error.to_string();
                assert_eq!(error.exit_code(), 5);
                assert!(line.contains("data.bin") && line.contains(&format!("{cut} bytes now")), "{line}");
            }
        }
    }

    /// Pages of a file that are in the page cache.
    #[cfg(target_os = "linux")]
    fn cached_pages(path: &Path) -> Option<u64> {
        let out = std::process::Command::new("fincore").args(["-b", "-n", "-o", "PAGES"]).arg(path).output();
        String::from_utf8(out.ok()?.stdout).ok()?.trim().parse().ok()
    }

    #[test]
    #[cfg(target_os = "linux")]
    #[ignore = "wants the program fincore and a temporary folder on a disk; tools/check runs it where they are"]
    fn what_is_behind_leaves_the_page_cache_of_a_large_file_only() {
        let (_dir, path) = temporary(&vec![7; 8 << 20]);
        File::open(&path).unwrap().sync_all().unwrap();
        let all =
            cached_pages(&path).filter(|&n| n > 1000).expect("fincore, and a file system with page cache");
        for mode in [IoMode::Map, IoMode::Read] {
            for (drop_behind, most) in [(false, all), (true, all / 2 + 64)] {
                let mut source = ByteSource::open(&path, mode).unwrap();
                source.drop_behind = drop_behind;
                let mut whole = vec![0; 8 << 20];
                source.read_at(0, &mut whole).unwrap();
                source.release(0..4 << 20);
                let left = cached_pages(&path).unwrap();
                // The system may take back pages of its own accord: a few, not half of the file.
                assert!(
                    left <= most && (drop_behind || left > all / 4 * 3),
                    "{mode:?} {drop_behind}: {left} of {all}"
                );
                source.read_at(0, &mut whole).unwrap();
                assert!(whole.iter().all(|&b| b == 7));
            }
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
