//! A file that is read by ranges. Few bytes come in pages, which are kept.
//!
//! A page that is asked for is fetched with all missing ones of the same read, in one request. If
//! the page before it is there already, the reader moves forward, and the next pages are fetched
//! too. Pages are kept, a fixed number for each server, and found again when the same file, by its
//! ETag, is opened anew. Many bytes are fetched as they are asked for, and not kept.

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
/// Pages that are fetched too when a reader moves forward.
const AHEAD: u64 = 8;
/// A read of so many bytes passes the pages by.
const MANY: usize = 128 << 10;

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
pub(crate) struct RemoteFile {
    origin: Origin,
    path: PathBuf,
    number: u64,
    len: u64,
    tag: u64,
}

impl RemoteFile {
    /// Fetches the end of an object.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let failed = |e: io::Error| Error::io("open", path, e);
        let origin = Origin::of(path)?;
        let Answer { len, tag, range, bytes } = origin.get(path, &Wanted::Last(PAGE)).map_err(failed)?;
        let number = origin.cache().number_of(path, len, tag);
        let file = Self { origin, path: path.to_path_buf(), number, len, tag };
        file.keep(range, &bytes);
        Ok(file)
    }

    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    /// Fills `out` with the bytes from `offset` on.
    pub(crate) fn read_at(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let end = offset.checked_add(out.len() as u64).filter(|&end| end <= self.len);
        let end = end.ok_or(io::ErrorKind::UnexpectedEof)?;
        if out.len() >= MANY {
            out.copy_from_slice(&self.fetch(offset..end)?);
            return Ok(());
        }
        let (mut at, mut missing) = (offset, None::<Range<u64>>);
        let last = end.div_ceil(PAGE);
        // All pages, from the first that is missing to the last that is: one request.
        for page in offset / PAGE..last {
            if self.page(page).is_none() {
                missing = Some(missing.map_or(page, |m| m.start)..page + 1);
            }
        }
        let fetched = missing.map(|m| self.fetch_pages(m)).transpose()?;
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
                // Another thread's pages have pushed it out since: fetch what is left of the read.
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
        self.origin.cache().pages().get((self.number, n))
    }

    /// Fetches pages, and some more if the page before is there; returns the offset of the first
    /// byte, and all bytes.
    fn fetch_pages(&self, mut pages: Range<u64>) -> io::Result<(u64, Vec<u8>)> {
        if pages.start > 0 && self.page(pages.start - 1).is_some() {
            pages.end = pages.end.max(pages.start + AHEAD);
        }
        let wanted = pages.start * PAGE..(pages.end * PAGE).min(self.len);
        let bytes = self.fetch(wanted.clone())?;
        self.keep(wanted.clone(), &bytes);
        Ok((wanted.start, bytes))
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
