//! What is kept of a server: pages of files, and how much was fetched.

use super::Traffic;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Pages kept for each server: 32 MiB.
pub(super) const KEPT: usize = 2048;

/// What is kept of a server.
#[derive(Default)]
pub(super) struct ServerCache {
    requests: AtomicU64,
    bytes: AtomicU64,
    pages: Mutex<Pages>,
    came: Condvar,
    /// The files that were opened, as they were then, and the numbers of their pages.
    numbers: Mutex<HashMap<(PathBuf, u64, u64), u64>>,
}

impl ServerCache {
    pub(super) fn pages(&self) -> MutexGuard<'_, Pages> {
        self.pages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until some pages have come, or have failed to.
    pub(super) fn wait<'a>(&self, pages: MutexGuard<'a, Pages>) -> MutexGuard<'a, Pages> {
        self.came.wait(pages).unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells those that wait that some pages have come, or have failed to.
    pub(super) fn fetched(&self) {
        self.came.notify_all();
    }

    /// The number of a file's pages, the same for the same state of it.
    pub(super) fn number_of(&self, path: &Path, len: u64, tag: u64) -> u64 {
        let mut numbers = self.numbers.lock().unwrap_or_else(PoisonError::into_inner);
        let next = numbers.len() as u64;
        *numbers.entry((path.to_path_buf(), len, tag)).or_insert(next)
    }

    /// Counts a request.
    pub(super) fn asked(&self) {
        self.requests.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts the bytes of an answer.
    pub(super) fn got(&self, bytes: &[u8]) {
        self.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
    }

    pub(super) fn traffic(&self) -> Traffic {
        Traffic { requests: self.requests.load(Ordering::Relaxed), bytes: self.bytes.load(Ordering::Relaxed) }
    }
}

/// Pages by file and number, and the order in which they came.
#[derive(Default)]
pub(super) struct Pages {
    kept: BTreeMap<(u64, u64), Arc<[u8]>>,
    order: VecDeque<(u64, u64)>,
    /// Those that are on their way.
    coming: BTreeSet<(u64, u64)>,
}

/// Pages that are fetched too when a reader moves forward.
const AHEAD: u64 = 8;

impl Pages {
    pub(super) fn get(&self, at: (u64, u64)) -> Option<Arc<[u8]>> {
        self.kept.get(&at).cloned()
    }

    /// Missing pages of a file of so many, with some more if the page before is there.
    pub(super) fn ahead(&self, file: u64, missing: Range<u64>, all: u64) -> Range<u64> {
        let moves_forward = missing.start > 0 && self.kept.contains_key(&(file, missing.start - 1));
        let most = if moves_forward { (missing.start + AHEAD).min(all) } else { missing.end };
        let is_new = |n: &u64| !self.kept.contains_key(&(file, *n)) && !self.coming.contains(&(file, *n));
        missing.start..(missing.end..most).find(|n| !is_new(n)).unwrap_or(most).max(missing.end)
    }

    /// Notes that pages are on their way; false if one of them was.
    pub(super) fn begin(&mut self, file: u64, pages: Range<u64>) -> bool {
        let is_free = !pages.clone().any(|n| self.coming.contains(&(file, n)));
        if is_free {
            self.coming.extend(pages.map(|n| (file, n)));
        }
        is_free
    }

    /// Notes that pages have come, or have failed to.
    pub(super) fn end(&mut self, file: u64, pages: Range<u64>) {
        pages.for_each(|n| _ = self.coming.remove(&(file, n)));
    }

    pub(super) fn keep(&mut self, at: (u64, u64), page: Arc<[u8]>) {
        if self.kept.insert(at, page).is_none() {
            self.order.push_back(at);
        }
        while self.order.len() > KEPT {
            let oldest = self.order.pop_front().expect("it is longer than nothing");
            self.kept.remove(&oldest);
        }
    }
}
