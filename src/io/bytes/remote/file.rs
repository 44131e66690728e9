//! A file that is read by ranges. Few bytes come in pages, which are kept.
//!
//! A page that is asked for is fetched with all missing ones of the same read, in one request. If
//! the page before it is there already, the reader moves forward, and the next pages are fetched
//! too. A page that another thread is fetching is waited for, so none is fetched twice. Pages are
//! kept, a fixed number for each server, and found again when the same file, by its ETag, is opened
//! anew. Very many bytes are fetched as they are asked for, and not kept.

use super::host::{Host, host_of};
use super::pages::{KEPT, ServerCache};
#[cfg(feature = "remote")]
use super::server::{Server, server_of};
use super::{Answer, Wanted};
use crate::error::{Error, Result};
#[cfg(feature = "remote")]
use object_store::path::Path as Key;
use std::fmt;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes of a page: a block of tetrahedra and its neighbours, or a few pages of an index.
pub(super) const PAGE: u64 = 16 << 10;
/// A read of so many bytes passes the pages by.
const MANY: usize = 4 << 20;

const _: () = assert!(KEPT as u64 * PAGE == super::PAGES_BYTES);

/// Where a file lies.
pub(super) enum Origin {
    /// On a server, with the name of the object there.
    #[cfg(feature = "remote")]
    Server(Arc<Server>, Key),
    /// With a host of the program, with its name there.
    Host(Arc<Host>, String),
}

impl fmt::Debug for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            #[cfg(feature = "remote")]
            Self::Server(server, key) => write!(f, "{server:?}, {key}"),
            Self::Host(_, name) => write!(f, "a host, {name}"),
        }
    }
}

impl Origin {
    /// # Errors
    /// [`Error::BadInput`] for an address that means nothing; [`Error::Usage`] where there is no
    /// client.
    pub(super) fn of(path: &Path) -> Result<Self> {
        if let Some((host, name)) = host_of(path)? {
            return Ok(Self::Host(host, name));
        }
        #[cfg(feature = "remote")]
        return server_of(path).map(|(server, key)| Self::Server(server, key));
        #[cfg(not(feature = "remote"))]
        super::refused(path)
    }

    pub(super) fn cache(&self) -> &ServerCache {
        match self {
            #[cfg(feature = "remote")]
            Self::Server(server, _) => &server.cache,
            Self::Host(host, _) => &host.cache,
        }
    }

    #[cfg_attr(not(feature = "remote"), allow(unused_variables, reason = "a host knows its names"))]
    fn get(&self, path: &Path, wanted: &Wanted) -> io::Result<Answer> {
        let answer = match self {
            #[cfg(feature = "remote")]
            Self::Server(server, key) => server.get(path, key, wanted),
            Self::Host(host, name) => host.get(name, wanted),
        };
        answer?.expect(wanted)
    }
}

/// An object that is read by ranges.
#[derive(Debug)]
pub struct RemoteFile {
    origin: Origin,
    path: PathBuf,
    number: u64,
    len: u64,
    tag: u64,
}

impl RemoteFile {
    /// Fetches the end of an object.
    pub fn open(path: &Path) -> Result<Self> {
        let failed = |e: io::Error| Error::io("open", path, e);
        let origin = Origin::of(path)?;
        let Answer { len, tag, range, bytes } = origin.get(path, &Wanted::Last(PAGE)).map_err(failed)?;
        let number = origin.cache().number_of(path, len, tag);
        let file = Self { origin, path: path.to_path_buf(), number, len, tag };
        file.keep(range, &bytes);
        Ok(file)
    }

    /// Its bytes.
    #[allow(clippy::len_without_is_empty, reason = "an empty file is an error before")]
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Fills `out` with the bytes from `offset` on.
    pub fn read_at(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let end = offset.checked_add(out.len() as u64).filter(|&end| end <= self.len);
        let end = end.ok_or(io::ErrorKind::UnexpectedEof)?;
        if out.len() >= MANY {
            out.copy_from_slice(&self.fetch(offset..end)?);
            return Ok(());
        }
        if out.is_empty() {
            return Ok(());
        }
        let pages = self.pages(offset / PAGE..end.div_ceil(PAGE))?;
        for (page, n) in pages.iter().zip(offset / PAGE..) {
            let first = n * PAGE;
            let (from, to) = (offset.max(first), end.min(first + PAGE));
            let part = &page[(from - first) as usize..(to - first) as usize];
            out[(from - offset) as usize..(to - offset) as usize].copy_from_slice(part);
        }
        Ok(())
    }

    /// Pages: those that are kept, and all from the first to the last of the others, in one
    /// request. What another thread fetches is waited for.
    fn pages(&self, wanted: Range<u64>) -> io::Result<Vec<Arc<[u8]>>> {
        let cache = self.origin.cache();
        let mut pages = cache.pages();
        let (mut found, fetched) = loop {
            let found: Vec<_> = wanted.clone().map(|n| pages.get((self.number, n))).collect();
            let missing = || wanted.clone().zip(&found).filter(|(_, page)| page.is_none()).map(|(n, _)| n);
            let Some((first, last)) = missing().next().zip(missing().last()) else {
                return Ok(found.into_iter().flatten().collect());
            };
            let range = pages.ahead(self.number, first..last + 1, self.len.div_ceil(PAGE));
            match pages.begin(self.number, range.clone()) {
                true => break (found, range),
                false => pages = cache.wait(pages),
            }
        };
        drop(pages);
        let coming = Coming { file: self, pages: fetched.clone() };
        let bytes = self.fetch(fetched.start * PAGE..(fetched.end * PAGE).min(self.len))?;
        let mut pages = cache.pages();
        for (n, page) in fetched.zip(bytes.chunks(PAGE as usize)) {
            let page: Arc<[u8]> = page.into();
            if wanted.contains(&n) {
                found[(n - wanted.start) as usize] = Some(Arc::clone(&page));
            }
            pages.keep((self.number, n), page);
        }
        drop(pages);
        drop(coming);
        Ok(found.into_iter().flatten().collect())
    }

    fn fetch(&self, wanted: Range<u64>) -> io::Result<Vec<u8>> {
        let Answer { len, tag, bytes, .. } = self.origin.get(&self.path, &Wanted::At(wanted))?;
        if (len, tag) != (self.len, self.tag) {
            let text = format!("it had {} bytes, now {len}: it was changed meanwhile", self.len);
            return Err(io::Error::other(text));
        }
        Ok(bytes)
    }

    /// Keeps the pages that lie whole in a range.
    fn keep(&self, range: Range<u64>, bytes: &[u8]) {
        let mut pages = self.origin.cache().pages();
        for n in range.start.div_ceil(PAGE)..range.end.div_ceil(PAGE) {
            let (from, to) = (n * PAGE, ((n + 1) * PAGE).min(self.len));
            if to <= range.end {
                let part = &bytes[(from - range.start) as usize..(to - range.start) as usize];
                pages.keep((self.number, n), part.into());
            }
        }
    }
}

/// Pages that a thread fetches, and others wait for until this is dropped.
struct Coming<'a> {
    file: &'a RemoteFile,
    pages: Range<u64>,
}

impl Drop for Coming<'_> {
    fn drop(&mut self) {
        let cache = self.file.origin.cache();
        cache.pages().end(self.file.number, self.pages.clone());
        cache.fetched();
    }
}
