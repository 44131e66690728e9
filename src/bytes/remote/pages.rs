//! What is kept of a server: pages of files, and how much was fetched.

use super::Traffic;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Pages kept for each server: 32 MiB.
pub(super) const KEPT: usize = 2048;

/// What is kept of a server.
#[derive(Default)]
pub(super) struct ServerCache {
    requests: AtomicU64,
    bytes: AtomicU64,
    pages: Mutex<Pages>,
    /// The files that were opened, as they were then, and the numbers of their pages.
    numbers: Mutex<HashMap<(PathBuf, u64, u64), u64>>,
}

impl ServerCache {
    pub(super) fn pages(&self) -> MutexGuard<'_, Pages> {
        self.pages.lock().unwrap_or_else(PoisonError::into_inner)
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
}

impl Pages {
    pub(super) fn get(&self, at: (u64, u64)) -> Option<Arc<[u8]>> {
        self.kept.get(&at).cloned()
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
