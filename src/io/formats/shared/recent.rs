//! Parts of a volume in files of their own.
//!
//! A volume may have more files than a process may have open (often 1024). So they are opened when
//! they are first needed, and the most recently used ones stay open. Chunks come in layers along
//! z: neighbours need the same files.

use crate::error::Result;
use rustc_hash::FxHashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// The most that stay open.
pub(in crate::formats) const MOST_OPEN: usize = 400;

/// What was opened last, by numbers.
pub(in crate::formats) struct Recent<T>(Mutex<Held<T>>);

struct Held<T> {
    /// With the time of last use.
    all: FxHashMap<usize, (u64, Arc<T>)>,
    clock: u64,
}

impl<T> Default for Recent<T> {
    fn default() -> Self {
        Self(Mutex::new(Held { all: FxHashMap::default(), clock: 0 }))
    }
}

impl<T> Recent<T> {
    /// That of a number, which is opened unless it is open.
    ///
    /// # Errors
    /// Those of `open`.
    pub(in crate::formats) fn get(&self, number: usize, open: impl FnOnce() -> Result<T>) -> Result<Arc<T>> {
        let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        held.clock += 1;
        let now = held.clock;
        if let Some((used, found)) = held.all.get_mut(&number) {
            *used = now;
            return Ok(Arc::clone(found));
        }
        if held.all.len() >= MOST_OPEN {
            // Half of them at once, so that the search costs little each.
            let mut times: Vec<u64> = held.all.values().map(|(used, _)| *used).collect();
            times.sort_unstable();
            let middle = times[times.len() / 2];
            held.all.retain(|_, (used, _)| *used > middle);
        }
        let opened = Arc::new(open()?);
        held.all.insert(number, (now, Arc::clone(&opened)));
        Ok(opened)
    }

    #[cfg(test)]
    pub(in crate::formats) fn len(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).all.len()
    }
}
