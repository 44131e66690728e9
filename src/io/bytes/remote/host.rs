//! Files that a program itself gets by ranges: `host://NAME/…`.

use super::pages::ServerCache;
use super::{Answer, Fetched, HOST, Ranges, Wanted};
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A host of the program, and what was fetched from it.
pub(super) struct Host {
    ranges: Box<dyn Ranges>,
    pub(super) cache: ServerCache,
}

impl Host {
    pub(super) fn get(&self, name: &str, wanted: &Wanted) -> io::Result<Answer> {
        self.cache.asked();
        let Fetched { len, range, bytes } = self.ranges.get(name, wanted)?;
        self.cache.got(&bytes);
        Ok(Answer { len, tag: 0, range, bytes })
    }
}

/// Makes the files `host://NAME/…` those that `ranges` gets by the rest of their address.
pub fn add_host(name: &str, ranges: impl Ranges + 'static) {
    hosts()
        .insert(name.to_owned(), Arc::new(Host { ranges: Box::new(ranges), cache: ServerCache::default() }));
}

/// The hosts by their names.
fn hosts() -> MutexGuard<'static, BTreeMap<String, Arc<Host>>> {
    static HOSTS: Mutex<BTreeMap<String, Arc<Host>>> = Mutex::new(BTreeMap::new());
    HOSTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The host of a path, and the name of the file there; `None` of other paths.
pub(super) fn host_of(path: &Path) -> Result<Option<(Arc<Host>, String)>> {
    let Some(rest) = path.to_str().and_then(|p| p.strip_prefix(HOST)) else { return Ok(None) };
    let (host, name) = rest.split_once('/').unwrap_or((rest, ""));
    let found = hosts().get(host).cloned();
    let none = || Error::bad_input(path, "address", "a host that the program has", format!("'{host}'"));
    Ok(Some((found.ok_or_else(none)?, name.to_owned())))
}
