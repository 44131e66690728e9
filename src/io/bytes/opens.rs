//! Counts how often files are opened, for tests that hold readers to one opening.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Counts that are under way: without one, opening a file costs a look at this.
static UNDER_WAY: AtomicUsize = AtomicUsize::new(0);
static COUNTS: Mutex<Vec<(PathBuf, BTreeMap<PathBuf, u64>)>> = Mutex::new(vec![]);

fn counts() -> MutexGuard<'static, Vec<(PathBuf, BTreeMap<PathBuf, u64>)>> {
    COUNTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Notes that a file is opened.
pub(super) fn note(path: &Path) {
    if UNDER_WAY.load(Ordering::Relaxed) == 0 {
        return;
    }
    for (folder, of_folder) in counts().iter_mut() {
        if let Ok(name) = path.strip_prefix(&*folder) {
            *of_folder.entry(name.to_path_buf()).or_default() += 1;
        }
    }
}

/// How often this process opens each file of a folder, as long as this is there.
pub struct OpenCount(PathBuf);

impl OpenCount {
    /// Begins to count in a folder, by the paths that files are opened by. No other count may be of
    /// the same one.
    pub fn begin(folder: &Path) -> Self {
        counts().push((folder.to_path_buf(), BTreeMap::new()));
        UNDER_WAY.fetch_add(1, Ordering::Relaxed);
        Self(folder.to_path_buf())
    }

    /// The files that were opened since the last call, by their names in the folder.
    pub fn take(&self) -> BTreeMap<PathBuf, u64> {
        let mut counts = counts();
        let own = counts.iter_mut().find(|(folder, _)| *folder == self.0);
        own.map(|(_, of_folder)| std::mem::take(of_folder)).unwrap_or_default()
    }
}

impl Drop for OpenCount {
    fn drop(&mut self) {
        counts().retain(|(folder, _)| *folder != self.0);
        UNDER_WAY.fetch_sub(1, Ordering::Relaxed);
    }
}
