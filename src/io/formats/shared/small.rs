//! Small files of a folder that are asked for several times while it is opened, on a disk or on a
//! server: each is read once.

use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

type Found = Result<Option<Arc<[u8]>>>;

fn again(found: &Found) -> Found {
    match found {
        Ok(bytes) => Ok(bytes.clone()),
        Err(error) => Err(error.again()),
    }
}

/// What was read of them: nothing of those that are not there, and the error of those that a server
/// denies.
#[derive(Default)]
pub(in crate::formats) struct SmallFiles(Mutex<BTreeMap<PathBuf, Found>>);

impl SmallFiles {
    /// The bytes of a file: those that were read before, else what `read` gives.
    ///
    /// # Errors
    /// Those of `read`, which is asked again the next time unless a server denies the file.
    pub(in crate::formats) fn get(
        &self,
        path: &Path,
        read: impl FnOnce() -> Result<Option<Vec<u8>>>,
    ) -> Found {
        // Held while a file is read: another thread waits for it.
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = known.get(path) {
            return again(found);
        }
        let found = read().map(|bytes| bytes.map(Arc::from));
        if found.as_ref().map_or_else(Error::is_denied, |_| true) {
            known.insert(path.to_path_buf(), again(&found));
        }
        found
    }

    /// The files that were there.
    pub(in crate::formats) fn paths(&self) -> Vec<PathBuf> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.iter().filter(|(_, found)| matches!(found, Ok(Some(_)))).map(|(path, _)| path.clone()).collect()
    }
}
