//! Files of an object store or a web server, read by ranges: `s3://bucket/name`,
//! `https://host/name`.
//!
//! An object is cut into pages. A page that is asked for is fetched with all missing ones of the
//! same read, in one request. If the page before it is there already, the reader moves forward, and
//! the next pages are fetched too. Fetched pages are kept, a fixed number for each server. Opening
//! an object fetches its end, which gives the length, and where a segment has its directory.
//!
//! ```text
//!  read_at(offset, n) ─▶ pages ─▶ kept? ── no ─▶ GET, Range: bytes=from-to ─▶ keep
//! ```
//!
//! Keys and region come from the environment, as for Amazon's own tools (`AWS_ACCESS_KEY_ID`,
//! `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT_URL`; `AWS_SKIP_SIGNATURE=true` for public
//! buckets). Failed requests are tried again by the client; a server that does not exist, or does
//! not answer, is given up within about half a minute. A server must answer range requests; one
//! that sends the whole file instead is an error.
//!
//! Without the feature `remote` there is no such file: opening one says so.

use crate::error::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// Whether a path names an object of a store or web server.
pub fn is_remote(path: &Path) -> bool {
    path.to_str().is_some_and(|p| ["s3://", "https://", "http://"].iter().any(|scheme| p.starts_with(scheme)))
}

/// What was fetched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Traffic {
    /// Requests, those that were tried again counted once.
    pub requests: u64,
    /// Bytes of the answers, without their headers.
    pub bytes: u64,
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

#[cfg(feature = "remote")]
pub(crate) use with_client::RemoteFile;

/// What this process has fetched from the server of a path; nothing for a local path.
#[cfg(feature = "remote")]
pub(crate) fn traffic(path: &Path) -> Option<Traffic> {
    is_remote(path).then(|| with_client::traffic(path))
}

#[cfg(not(feature = "remote"))]
pub(crate) fn traffic(_path: &Path) -> Option<Traffic> {
    None
}

/// What was fetched from the server of a file since `before`.
pub(crate) fn traffic_since(path: &Path, before: Option<Traffic>) -> Option<Traffic> {
    traffic(path).zip(before).map(|(now, before)| Traffic {
        requests: now.requests - before.requests,
        bytes: now.bytes - before.bytes,
    })
}

/// There is none without the feature.
#[cfg(not(feature = "remote"))]
pub(crate) enum RemoteFile {}

#[cfg(not(feature = "remote"))]
impl RemoteFile {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        Err(Error::usage(format!(
            "{}: this isospan was built without object stores; build it with the feature `remote`, which is a default one",
            path.display()
        )))
    }

    pub(crate) fn len(&self) -> u64 {
        match *self {}
    }

    pub(crate) fn read_at(&self, _offset: u64, _out: &mut [u8]) -> std::io::Result<()> {
        match *self {}
    }
}

#[cfg(feature = "remote")]
mod with_client {
    use super::{Error, Result, Traffic};
    use object_store::aws::AmazonS3Builder;
    use object_store::http::HttpBuilder;
    use object_store::path::Path as Key;
    use object_store::{BackoffConfig, GetOptions, GetRange, ObjectStore, ObjectStoreScheme, RetryConfig};
    use std::collections::{BTreeMap, VecDeque};
    use std::future::Future;
    use std::io;
    use std::ops::Range;
    use std::path::Path;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::{Arc, LazyLock, Mutex, PoisonError};
    use std::time::Duration;
    use tokio::runtime::{Builder, Runtime};
    use url::{Position, Url};

    /// Bytes of a page: a block of tetrahedra and its neighbours, or a few pages of an index.
    const PAGE: u64 = 16 << 10;
    /// Pages that are fetched too when a reader moves forward.
    const AHEAD: u64 = 8;
    /// Pages kept for each server: 32 MiB.
    const KEPT: usize = 2048;

    /// A server or bucket, and what was fetched from it.
    struct Server {
        store: Box<dyn ObjectStore>,
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

    /// An object that is read by ranges.
    pub(crate) struct RemoteFile {
        server: Arc<Server>,
        key: Key,
        number: u64,
        len: u64,
    }

    impl RemoteFile {
        /// Fetches the end of an object.
        pub(crate) fn open(path: &Path) -> Result<Self> {
            let failed = |e: io::Error| Error::io("open", path, e);
            let (server, key) = server_of(path)?;
            let number = server.files.fetch_add(1, Ordering::Relaxed);
            let (len, range, bytes) = server.get(&key, GetRange::Suffix(PAGE)).map_err(failed)?;
            let file = Self { server, key, number, len };
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
            let (len, range, bytes) = self.server.get(&self.key, GetRange::Bounded(wanted.clone()))?;
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

    impl Server {
        /// The object's length, the range that came, and its bytes.
        fn get(&self, key: &Key, range: GetRange) -> io::Result<(u64, Range<u64>, Vec<u8>)> {
            self.requests.fetch_add(1, Ordering::Relaxed);
            let options = GetOptions { range: Some(range), ..GetOptions::default() };
            let (len, range, bytes) = wait(async {
                let got = self.store.get_opts(key, options).await?;
                let (len, range) = (got.meta.size, got.range.clone());
                Ok::<_, object_store::Error>((len, range, got.bytes().await?))
            })?
            .map_err(as_io)?;
            self.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
            Ok((len, range, bytes.to_vec()))
        }
    }

    fn as_io(error: object_store::Error) -> io::Error {
        let kind = match error {
            object_store::Error::NotFound { .. } => io::ErrorKind::NotFound,
            object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. } => {
                io::ErrorKind::PermissionDenied
            }
            _ => io::ErrorKind::Other,
        };
        io::Error::new(kind, one_line(&error))
    }

    /// A message in one line (those of servers have line ends), with its first cause where the
    /// message does not include it.
    fn one_line(error: &dyn std::error::Error) -> String {
        let line = |e: &dyn std::error::Error| e.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        let first = std::iter::successors(error.source(), |e| e.source()).last().map(line);
        let message = line(error);
        match first {
            Some(cause) if !message.contains(&cause) => format!("{message}: {cause}"),
            _ => message,
        }
    }

    /// Runs a request to its end.
    fn wait<T>(request: impl Future<Output = T>) -> io::Result<T> {
        static RUNTIME: LazyLock<io::Result<Runtime>> = LazyLock::new(|| {
            Builder::new_multi_thread().worker_threads(2).thread_name("isospan-net").enable_all().build()
        });
        match &*RUNTIME {
            Ok(runtime) => Ok(runtime.block_on(request)),
            Err(e) => Err(io::Error::new(e.kind(), e.to_string())),
        }
    }

    pub(super) fn traffic(path: &Path) -> Traffic {
        let Ok((server, _)) = server_of(path) else { return Traffic::default() };
        Traffic {
            requests: server.requests.load(Ordering::Relaxed),
            bytes: server.bytes.load(Ordering::Relaxed),
        }
    }

    /// The server of a path, known from before or new, and the name of the object there.
    fn server_of(path: &Path) -> Result<(Arc<Server>, Key)> {
        static SERVERS: Mutex<BTreeMap<String, Arc<Server>>> = Mutex::new(BTreeMap::new());
        let bad = |got: String| {
            Error::bad_input(path, "address", "s3://BUCKET/NAME.isospan or https://HOST/NAME.isospan", got)
        };
        let text = path.to_str().ok_or_else(|| bad("no UTF-8".into()))?;
        let url = Url::parse(text).map_err(|e| bad(e.to_string()))?;
        if url.query().is_some() || url.fragment().is_some() {
            return Err(bad("an address with ? or #".into()));
        }
        let (scheme, key) = ObjectStoreScheme::parse(&url).map_err(|e| bad(one_line(&e)))?;
        // The rest of the address without the key: the first part of the path may name a bucket.
        let mut origin = url.as_str().trim_end_matches('/');
        for _ in key.parts() {
            origin = origin.rsplit_once('/').map_or(origin, |(parent, _)| parent);
        }
        let origin = origin.to_owned();
        let mut servers = SERVERS.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(server) = servers.get(&origin) {
            return Ok((Arc::clone(server), key));
        }
        // Another library of the process may have chosen the cipher suites before.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let store = client(&scheme, &url).map_err(|e| bad(one_line(&e)))?;
        let server = Arc::new(Server {
            store,
            requests: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            files: AtomicU64::new(0),
            pages: Mutex::default(),
        });
        servers.insert(origin, Arc::clone(&server));
        Ok((server, key))
    }

    /// Failed requests are tried again, but none is begun later than this. A request without an
    /// answer takes half a minute itself, one whose server cannot be reached five seconds: the
    /// defaults of the client.
    const TRIES_END: Duration = Duration::from_secs(15);
    const LONGEST_PAUSE: Duration = Duration::from_secs(2);

    /// A client of the server of an address.
    fn client(scheme: &ObjectStoreScheme, url: &Url) -> object_store::Result<Box<dyn ObjectStore>> {
        let backoff = BackoffConfig { max_backoff: LONGEST_PAUSE, ..BackoffConfig::default() };
        let retry = RetryConfig { backoff, retry_timeout: TRIES_END, ..RetryConfig::default() };
        let options = options(url).into_iter();
        if matches!(scheme, ObjectStoreScheme::AmazonS3) {
            let builder = AmazonS3Builder::new().with_url(url.as_str()).with_retry(retry);
            let builder = options.fold(builder, |builder, (key, value)| match key.parse() {
                Ok(key) => builder.with_config(key, value),
                Err(_) => builder,
            });
            return Ok(Box::new(builder.build()?));
        }
        let builder = HttpBuilder::new().with_url(&url[..Position::BeforePath]).with_retry(retry);
        let builder = options.fold(builder, |builder, (key, value)| match key.parse() {
            Ok(key) => builder.with_config(key, value),
            Err(_) => builder,
        });
        Ok(Box::new(builder.build()?))
    }

    /// Keys and region from the environment. Plain HTTP only where the address itself says so.
    fn options(url: &Url) -> Vec<(String, String)> {
        let mut options: Vec<_> = std::env::vars()
            .filter(|(k, _)| k.starts_with("AWS_"))
            .map(|(k, v)| (k.to_ascii_lowercase(), v))
            .collect();
        let plain = |address: &str| address.starts_with("http://");
        if plain(url.as_str()) || options.iter().any(|(k, v)| k.starts_with("aws_endpoint") && plain(v)) {
            options.push(("allow_http".into(), "true".into()));
        }
        options
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

    #[cfg(not(feature = "remote"))]
    #[test]
    fn without_the_feature_an_address_is_refused() {
        let error = RemoteFile::open(Path::new("s3://b/a.isospan")).err().unwrap();
        assert!(error.exit_code() == 2 && error.to_string().contains("--features remote"));
    }
}
