//! Files of an object store or a web server, read by ranges: `s3://bucket/name`,
//! `https://host/name`; and those that a program itself gets by ranges, `host://name`.
//!
//! An object is cut into pages. A page that is asked for is fetched with all missing ones of the
//! same read, in one request. If the page before it is there already, the reader moves forward, and
//! the next pages are fetched too. Fetched pages are kept, a fixed number for each server. Opening
//! an object fetches its end, which gives the length, and where a segment has its directory.
//!
//! ```text
//!  read_at(offset, n) ─▶ pages ─▶ kept? ── no ─▶ Ranges::get: client, or a host of the program ─▶ keep
//! ```
//!
//! How ranges of stores and web servers are fetched is in `client`; without the feature `remote`
//! there is none, and opening such a file says so. A program in which there is no such client, as a
//! web page's, gives its own ([`add_host`]).

#[cfg(feature = "remote")]
mod client;

use crate::error::{Error, Result};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Bytes of a page: a block of tetrahedra and its neighbours, or a few pages of an index.
const PAGE: u64 = 16 << 10;
/// Pages that are fetched too when a reader moves forward.
const AHEAD: u64 = 8;
/// Pages kept for each server: 32 MiB.
const KEPT: usize = 2048;
/// What the addresses of a program's own hosts begin with.
const HOST: &str = "host://";

/// Whether a path names an object of a store, a web server or a host of the program.
pub fn is_remote(path: &Path) -> bool {
    let schemes = ["s3://", "https://", "http://", HOST];
    path.to_str().is_some_and(|p| schemes.iter().any(|scheme| p.starts_with(scheme)))
}

/// What was fetched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Traffic {
    /// Requests, those that were tried again counted once.
    pub requests: u64,
    /// Bytes of the answers, without their headers.
    pub bytes: u64,
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

/// Makes the files `host://NAME/…` those that `ranges` gets by the rest of their address.
pub fn add_host(name: &str, ranges: impl Ranges + 'static) {
    servers().insert(format!("{HOST}{name}"), Arc::new(Server::new(ranges)));
}

/// All bytes of a small object.
pub(crate) fn read_all(path: &Path, most: u64) -> Result<Vec<u8>> {
    let file = RemoteFile::open(path)?;
    if file.len() > most {
        let (expected, got) = (format!("at most {most} bytes"), format!("{} bytes", file.len()));
        return Err(Error::bad_input(path, "length", expected, got));
    }
    let mut bytes = vec![0; file.len() as usize];
    file.read_at(0, &mut bytes).map_err(|e| Error::io("read", path, e))?;
    Ok(bytes)
}

/// What this process has fetched from the server of a path; nothing for a local path.
pub(crate) fn traffic(path: &Path) -> Option<Traffic> {
    let of_server = |server: Arc<Server>| Traffic {
        requests: server.requests.load(Ordering::Relaxed),
        bytes: server.bytes.load(Ordering::Relaxed),
    };
    is_remote(path)
        .then(|| server_of(path).map_or_else(|_| Traffic::default(), |(server, _)| of_server(server)))
}

/// What was fetched from the server of a file since `before`.
pub(crate) fn traffic_since(path: &Path, before: Option<Traffic>) -> Option<Traffic> {
    traffic(path).zip(before).map(|(now, before)| Traffic {
        requests: now.requests - before.requests,
        bytes: now.bytes - before.bytes,
    })
}

/// The servers that are known, by the address that their files' addresses begin with.
fn servers() -> MutexGuard<'static, BTreeMap<String, Arc<Server>>> {
    static SERVERS: Mutex<BTreeMap<String, Arc<Server>>> = Mutex::new(BTreeMap::new());
    SERVERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The server of a path, known from before or new, and the name of the object there.
fn server_of(path: &Path) -> Result<(Arc<Server>, String)> {
    let Some(rest) = path.to_str().and_then(|p| p.strip_prefix(HOST)) else {
        return server_of_address(path);
    };
    let (host, name) = rest.split_once('/').unwrap_or((rest, ""));
    let server = servers().get(&format!("{HOST}{host}")).cloned();
    let none = || Error::bad_input(path, "address", "a host that the program has", format!("'{host}'"));
    Ok((server.ok_or_else(none)?, name.to_owned()))
}

#[cfg(feature = "remote")]
fn server_of_address(path: &Path) -> Result<(Arc<Server>, String)> {
    let address = client::Address::of(path)?;
    let mut servers = servers();
    let server = match servers.get(address.origin()) {
        Some(server) => Arc::clone(server),
        None => {
            let server = Arc::new(Server::new(address.client()?));
            servers.insert(address.origin().to_owned(), Arc::clone(&server));
            server
        }
    };
    Ok((server, address.into_name()))
}

#[cfg(not(feature = "remote"))]
fn server_of_address(path: &Path) -> Result<(Arc<Server>, String)> {
    Err(Error::usage(format!(
        "{}: this isospan was built without object stores; build it with the feature `remote`, which is a default one",
        path.display()
    )))
}

/// A server or bucket, and what was fetched from it.
struct Server {
    ranges: Box<dyn Ranges>,
    requests: AtomicU64,
    bytes: AtomicU64,
    files: AtomicU64,
    pages: Mutex<Pages>,
}

/// Pages by file and number, and the order in which they came.
#[derive(Default)]
struct Pages {
    kept: BTreeMap<(u64, u64), Arc<[u8]>>,
    order: VecDeque<(u64, u64)>,
}

impl Pages {
    fn keep(&mut self, at: (u64, u64), page: Arc<[u8]>) {
        if self.kept.insert(at, page).is_none() {
            self.order.push_back(at);
        }
        while self.order.len() > KEPT {
            let oldest = self.order.pop_front().expect("it is longer than nothing");
            self.kept.remove(&oldest);
        }
    }
}

impl Server {
    fn new(ranges: impl Ranges + 'static) -> Self {
        Self {
            ranges: Box::new(ranges),
            requests: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            files: AtomicU64::new(0),
            pages: Mutex::default(),
        }
    }

    fn get(&self, name: &str, wanted: &Wanted) -> io::Result<Fetched> {
        self.requests.fetch_add(1, Ordering::Relaxed);
        let fetched = self.ranges.get(name, wanted)?;
        self.bytes.fetch_add(fetched.bytes.len() as u64, Ordering::Relaxed);
        Ok(fetched)
    }
}

/// An object that is read by ranges.
pub(crate) struct RemoteFile {
    server: Arc<Server>,
    name: String,
    number: u64,
    len: u64,
}

impl RemoteFile {
    /// Fetches the end of an object.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let failed = |e: io::Error| Error::io("open", path, e);
        let (server, name) = server_of(path)?;
        let number = server.files.fetch_add(1, Ordering::Relaxed);
        let Fetched { len, range, bytes } = server.get(&name, &Wanted::Last(PAGE)).map_err(failed)?;
        let file = Self { server, name, number, len };
        if range.end == len {
            file.keep(range, &bytes);
        }
        Ok(file)
    }

    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    /// Fills `out` with the bytes from `offset` on.
    pub(crate) fn read_at(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let end = offset.checked_add(out.len() as u64).filter(|&end| end <= self.len);
        let end = end.ok_or(io::ErrorKind::UnexpectedEof)?;
        let (mut at, mut missing) = (offset, None::<Range<u64>>);
        let last = end.div_ceil(PAGE);
        // All pages, from the first that is missing to the last that is: one request.
        for page in offset / PAGE..last {
            if self.page(page).is_none() {
                missing = Some(missing.map_or(page, |m| m.start)..page + 1);
            }
        }
        let fetched = missing.map(|m| self.fetch(m)).transpose()?;
        while at < end {
            let n = at / PAGE;
            let from_fetched = fetched.as_ref().and_then(|(first, bytes)| {
                let skip = usize::try_from(at.checked_sub(*first)?).ok()?;
                bytes.get(skip..).filter(|b| !b.is_empty())
            });
            let kept = if from_fetched.is_none() { self.page(n) } else { None };
            let here = match (from_fetched, &kept) {
                (Some(bytes), _) => bytes,
                (None, Some(page)) => &page[(at - n * PAGE) as usize..],
                // Another thread's pages have pushed it out since: fetch what is left of the
                // read.
                (None, None) => return self.read_at(at, &mut out[(at - offset) as usize..]),
            };
            let n = here.len().min((end - at) as usize);
            let start = (at - offset) as usize;
            out[start..start + n].copy_from_slice(&here[..n]);
            at += n as u64;
        }
        Ok(())
    }

    fn page(&self, n: u64) -> Option<Arc<[u8]>> {
        let pages = self.server.pages.lock().unwrap_or_else(PoisonError::into_inner);
        pages.kept.get(&(self.number, n)).cloned()
    }

    /// Fetches pages, and some more if the page before is there; returns the offset of the
    /// first byte, and all bytes.
    fn fetch(&self, mut pages: Range<u64>) -> io::Result<(u64, Vec<u8>)> {
        if pages.start > 0 && self.page(pages.start - 1).is_some() {
            pages.end = pages.end.max(pages.start + AHEAD);
        }
        let wanted = pages.start * PAGE..(pages.end * PAGE).min(self.len);
        let Fetched { len, range, bytes } = self.server.get(&self.name, &Wanted::At(wanted.clone()))?;
        if len != self.len || range != wanted || bytes.len() as u64 != wanted.end - wanted.start {
            let text = format!(
                "asked for bytes {wanted:?} of {}, got {} bytes of {range:?} of {len}: it was changed meanwhile",
                self.len,
                bytes.len()
            );
            return Err(io::Error::other(text));
        }
        self.keep(wanted.clone(), &bytes);
        Ok((wanted.start, bytes))
    }

    /// Keeps the pages that lie whole in a range.
    fn keep(&self, range: Range<u64>, bytes: &[u8]) {
        let mut pages = self.server.pages.lock().unwrap_or_else(PoisonError::into_inner);
        for n in range.start.div_ceil(PAGE)..range.end.div_ceil(PAGE) {
            let (from, to) = (n * PAGE, ((n + 1) * PAGE).min(self.len));
            if to <= range.end {
                let part = &bytes[(from - range.start) as usize..(to - range.start) as usize];
                pages.keep((self.number, n), part.into());
            }
        }
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
    struct File(Vec<u8>);

    impl Ranges for File {
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
        let bytes: Vec<u8> = (0..10 * PAGE + 100).map(|i| (i * 7 / 5) as u8).collect();
        add_host("one", File(bytes.clone()));
        add_host("two", File(vec![7; 9]));
        let path = Path::new("host://one/folder/file");
        assert_eq!(read_all(Path::new("host://two/folder/file"), 9).unwrap(), [7; 9]);
        let before = traffic(path);
        let file = RemoteFile::open(path).unwrap();
        assert_eq!(file.len(), bytes.len() as u64);
        let mut out = vec![0; 3 * PAGE as usize];
        for offset in [100, 50, 9 * PAGE - 2000] {
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

    #[cfg(not(feature = "remote"))]
    #[test]
    fn without_the_feature_an_address_is_refused() {
        let error = RemoteFile::open(Path::new("s3://b/a.isospan")).err().unwrap();
        assert!(error.exit_code() == 2 && error.to_string().contains("--features remote"));
    }
}
