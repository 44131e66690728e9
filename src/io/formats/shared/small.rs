//! Small files of a folder that are asked for several times while it is opened, on a disk or on a
//! server: each is read once.

use crate::error::Result;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// What was read of them; nothing of those that are not there.
#[derive(Default)]
pub(in crate::formats) struct SmallFiles(Mutex<BTreeMap<PathBuf, Option<Arc<[u8]>>>>);

impl SmallFiles {
    /// The bytes of a file: those that were read before, else what `read` gives.
    ///
    /// # Errors
    /// Those of `read`, which is then asked again the next time.
    pub(in crate::formats) fn get(
        &self,
        path: &Path,
        read: impl FnOnce() -> Result<Option<Vec<u8>>>,
    ) -> Result<Option<Arc<[u8]>>> {
        // Held while a file is read: another thread waits for it.
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(bytes) = known.get(path) {
            return Ok(bytes.clone());
        }
        let bytes: Option<Arc<[u8]>> = read()?.map(Arc::from);
        known.insert(path.to_path_buf(), bytes.clone());
        Ok(bytes)
    }

    /// The files that were there.
    pub(in crate::formats) fn paths(&self) -> Vec<PathBuf> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.iter().filter(|(_, bytes)| bytes.is_some()).map(|(path, _)| path.clone()).collect()
    }
}
