//! Files of an object store or a web server: `s3://bucket/name`, `https://host/name`; and those
//! that a program itself gets by ranges, `host://name`.
//!
//! A file is read by ranges (`RemoteFile`), or whole where it is small or a chunk of a volume
//! (`whole_if_there`). Opening a file for ranges fetches its end, which gives the length, and
//! where a segment has its directory.
//!
//! ```text
//!  read_at(offset, n) ─▶ many bytes ────────────────────────────▶ GET, Range: bytes=from-to
//!                     └▶ few: pages ─▶ kept? ── no ─▶ GET of all missing ones ─▶ keep
//!  whole_if_there ──────────────────────────────────────────────▶ GET ─▶ 404: there is none
//! ```
//!
//! Keys and region come from the environment, as for Amazon's own tools (`AWS_ACCESS_KEY_ID`,
//! `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT_URL`; `AWS_SKIP_SIGNATURE=true` for public
//! buckets). Failed requests are tried again by the client; a server that does not exist, or does
//! not answer, is given up within half a minute, all tries together, and not asked again for some
//! seconds. At most 32 requests are under way to a server. One that answers a range with the whole
//! file is an error.
//!
//! **A server's word is not believed.** Of an answer are read as many bytes as were asked for, of
//! a failure the first ones. An answer that has less or more than it says, or something else than
//! was asked for, is an error. It must go on coming: see `client`.
//!
//! **What is not there.** A server's 404 says that there is no such file. Anything else is an
//! error, 403 too: S3 gives that for a missing file where the keys may not list the bucket, but
//! also for one that they may not read, and a chunk that may not be read is not a missing chunk.
//!
//! **Changes.** Each answer has the file's length and its ETag, or else its time of change. They
//! are noted: what differs from the answer before has been changed (`Seen`).
//!
//! Without the feature `remote` there is no such file: opening one says so. A program in which
//! there is no client, as a web page's, gives ranges of its own ([`add_host`]).

#[cfg(feature = "remote")]
mod client;
mod file;
mod host;
mod pages;
#[cfg(feature = "remote")]
mod server;

use crate::error::{Error, Result};
use serde::Serialize;
use std::io;
use std::ops::Range;
use std::path::Path;

/// What the addresses of a program's own hosts begin with.
const HOST: &str = "host://";

/// Whether a path names an object of a store, a web server or a host of the program.
pub fn is_remote(path: &Path) -> bool {
    let schemes = ["s3://", "https://", "http://", HOST];
    path.to_str().is_some_and(|p| schemes.iter().any(|scheme| p.starts_with(scheme)))
}

/// Gets ranges of bytes of files that lie elsewhere.
pub trait Ranges: Send + Sync {
    /// Gets bytes of the file of a name.
    ///
    /// # Errors
    /// When there is no such file, or it cannot be had.
    fn get(&self, name: &str, wanted: &Wanted) -> io::Result<Fetched>;
}

/// Which bytes of a file are wanted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// The last ones, so many, or all of a shorter file.
    Last(u64),
    /// Those at these offsets.
    At(Range<u64>),
}

/// Bytes of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fetched {
    /// Bytes of the whole file.
    pub len: u64,
    /// Where these lie in it.
    pub range: Range<u64>,
    /// These.
    pub bytes: Vec<u8>,
}

/// What came of a file.
struct Answer {
    /// The length of the whole file, and what tells its states apart.
    len: u64,
    tag: u64,
    range: Range<u64>,
    bytes: Vec<u8>,
}

impl Answer {
    /// Refuses what was not asked for, and less or more than was said.
    fn expect(self, wanted: &Wanted) -> io::Result<Self> {
        let expected = match wanted {
            Wanted::Last(count) => self.len.saturating_sub(*count)..self.len,
            Wanted::At(range) => range.clone(),
        };
        let is_whole = self.bytes.len() as u64 == expected.end.saturating_sub(expected.start);
        if self.range == expected && self.range.end <= self.len && self.len <= LONGEST && is_whole {
            return Ok(self);
        }
        let text = format!(
            "asked for bytes {expected:?}, got {} bytes, which are called {:?} of {}",
            self.bytes.len(),
            self.range,
            self.len
        );
        Err(io::Error::other(text))
    }
}

/// No file is longer.
const LONGEST: u64 = i64::MAX as u64;

/// Bytes of pages that are kept of a server, at most.
pub(crate) const PAGES_BYTES: u64 = 32 << 20;

/// What was fetched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Traffic {
    /// Requests, those that were tried again counted once.
    pub requests: u64,
    /// Bytes of the answers, without their headers.
    pub bytes: u64,
}

/// What a server said last about a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Its length; `None` where there is no such file.
    pub len: Option<u64>,
    /// A hash of its ETag, or else of its time of change.
    pub tag: u64,
    /// How often an answer differed from the one before.
    pub changes: u32,
}

/// All bytes of a small object, by ranges.
pub fn read_all(path: &Path, most: u64) -> Result<Vec<u8>> {
    let file = RemoteFile::open(path)?;
    if file.len() > most {
        let (expected, got) = (format!("at most {most} bytes"), format!("{} bytes", file.len()));
        return Err(Error::bad_input(path, "length", expected, got));
    }
    let mut bytes = vec![0; file.len() as usize];
    file.read_at(0, &mut bytes).map_err(|e| Error::io("read", path, e))?;
    Ok(bytes)
}

pub use file::RemoteFile;
pub use host::add_host;
#[cfg(feature = "remote")]
pub use server::{folders_in, look_at, seen, small_if_there, whole_if_there};

/// What this process has fetched from the server of a path; nothing for a local path.
pub fn traffic(path: &Path) -> Option<Traffic> {
    let fetched = || file::Origin::of(path).map_or_else(|_| Traffic::default(), |o| o.cache().traffic());
    is_remote(path).then(fetched)
}

/// What was fetched from the server of a file since `before`.
pub fn traffic_since(path: &Path, before: Option<Traffic>) -> Option<Traffic> {
    traffic(path).zip(before).map(|(now, before)| Traffic {
        requests: now.requests - before.requests,
        bytes: now.bytes - before.bytes,
    })
}

#[cfg(not(feature = "remote"))]
pub use without_client::*;

#[cfg(not(feature = "remote"))]
fn refused<T>(path: &Path) -> Result<T> {
    Err(Error::usage(format!(
        "{}: this isospan was built without object stores; build it with the feature `remote`, which is a default one",
        path.display()
    )))
}

/// There is nothing on servers without the feature.
#[cfg(not(feature = "remote"))]
mod without_client {
    use super::{Result, Seen, refused};
    use std::path::{Path, PathBuf};

    /// Refuses `path`.
    pub fn whole_if_there(path: &Path, _most: u64) -> Result<Option<Vec<u8>>> {
        refused(path)
    }

    /// Refuses `path`.
    pub fn small_if_there(path: &Path, _most: u64) -> Result<Option<Vec<u8>>> {
        refused(path)
    }

    /// Refuses `path`.
    pub fn folders_in(path: &Path) -> Result<Vec<String>> {
        refused(path)
    }

    /// Refuses the first of the paths.
    pub fn look_at(paths: &[PathBuf]) -> Result<()> {
        paths.first().map_or(Ok(()), |path| refused(path))
    }

    /// Refuses `path`.
    pub fn seen(path: &Path) -> Result<Seen> {
        refused(path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_told_from_paths() {
        let remote = |p: &str| is_remote(Path::new(p));
        assert!(remote("s3://b/a.isospan") && remote("https://h/a.isospan") && remote("http://h:1/a"));
        assert!(!remote("a.isospan") && !remote("/s3://b") && !remote("ftp://h/a"));
        let joined = Path::new("s3://b/a.isospan").join("mesh/000000.seg");
        assert_eq!(joined.to_str(), Some("s3://b/a.isospan/mesh/000000.seg"));
    }

    /// A file of these bytes, which is had by ranges.
    struct RangedFile(Vec<u8>);

    impl Ranges for RangedFile {
        fn get(&self, name: &str, wanted: &Wanted) -> io::Result<Fetched> {
            if name != "folder/file" {
                return Err(io::ErrorKind::NotFound.into());
            }
            let len = self.0.len() as u64;
            let range = match wanted {
                Wanted::Last(count) => len.saturating_sub(*count)..len,
                Wanted::At(range) => range.clone(),
            };
            let bytes = self.0[range.start as usize..range.end as usize].to_vec();
            Ok(Fetched { len, range, bytes })
        }
    }

    #[test]
    fn a_host_of_the_program_is_asked_for_what_is_not_kept() {
        let bytes: Vec<u8> = (0..10 * file::PAGE + 100).map(|i| (i * 7 / 5) as u8).collect();
        add_host("one", RangedFile(bytes.clone()));
        add_host("two", RangedFile(vec![7; 9]));
        let path = Path::new("host://one/folder/file");
        assert_eq!(read_all(Path::new("host://two/folder/file"), 9).unwrap(), [7; 9]);
        let before = traffic(path);
        let file = RemoteFile::open(path).unwrap();
        assert_eq!(file.len(), bytes.len() as u64);
        let mut out = vec![0; 3 * file::PAGE as usize];
        for offset in [100, 50, 9 * file::PAGE - 2000] {
            let n = (file.len() - offset).min(out.len() as u64) as usize;
            file.read_at(offset, &mut out[..n]).unwrap();
            assert_eq!(out[..n], bytes[offset as usize..][..n]);
        }
        let fetched = traffic_since(path, before).unwrap();
        assert_eq!(fetched.requests, 3, "the end, and two of the reads");
        assert!(file.read_at(file.len() - 1, &mut out[..2]).is_err());

        let missing = RemoteFile::open(Path::new("host://one/other")).err().unwrap().to_string();
        assert!(missing.contains("host://one/other"), "{missing}");
        let unknown = RemoteFile::open(Path::new("host://three/file")).err().unwrap().to_string();
        assert!(unknown.contains("'three'"), "{unknown}");
    }

    /// Answers that are not what they say: another length of the file, range and bytes.
    struct Liar(u64, Range<u64>, usize);

    impl Ranges for Liar {
        fn get(&self, _: &str, _: &Wanted) -> io::Result<Fetched> {
            Ok(Fetched { len: self.0, range: self.1.clone(), bytes: vec![1; self.2] })
        }
    }

    #[test]
    fn an_answer_that_is_not_what_it_says_is_an_error() {
        let all = file::PAGE;
        for (n, liar) in [
            Liar(all, 0..all, 0),
            Liar(all, 0..all, all as usize - 1),
            Liar(all, 0..all, all as usize + 1),
            Liar(all, 1..all, all as usize - 1),
            Liar(2 * all, 0..all, all as usize),
            Liar(all, 0..2 * all, 2 * all as usize),
            Liar(u64::MAX, u64::MAX - all..u64::MAX, all as usize),
            Liar(u64::MAX, Range { start: u64::MAX, end: 0 }, 0),
            Liar(0, 0..all, all as usize),
        ]
        .into_iter()
        .enumerate()
        {
            add_host(&format!("liar-{n}"), liar);
            let path = format!("host://liar-{n}/file");
            let error = RemoteFile::open(Path::new(&path)).err().unwrap_or_else(|| panic!("{n}"));
            assert!(error.to_string().contains("asked for bytes"), "{n}: {error}");
        }
    }

    #[cfg(feature = "remote")]
    #[test]
    fn addresses_with_secrets_are_refused_and_not_shown() {
        for address in ["https://me:secret@h/a.nrrd", "https://h/a.nrrd?key=secret", "s3://b/a#secret"] {
            let error = RemoteFile::open(Path::new(address)).err().unwrap();
            assert!(!error.to_string().contains("secret"), "{error}");
        }
    }

    #[cfg(not(feature = "remote"))]
    #[test]
    fn without_the_feature_an_address_is_refused() {
        let error = RemoteFile::open(Path::new("s3://b/a.isospan")).err().unwrap();
        assert!(error.exit_code() == 2 && error.to_string().contains("feature `remote`"));
    }
}
