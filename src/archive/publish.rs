//! A file that appears whole or not at all.
//!
//! It is written under a temporary name in its final folder, synced, renamed, and the folder synced. The temporary
//! name is unique per host, process and file, so two writers of the same file do not disturb each other: they write the
//! same bytes and the later rename wins. A writer that is dropped unfinished removes its temporary; one that is killed leaves
//! it, under a name that starts with a dot and that no reader looks at.

use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// A file being written; see the module.
pub(crate) struct Unpublished {
    file: Option<BufWriter<File>>,
    temporary: PathBuf,
    path: PathBuf,
}

/// The mark of a temporary's name, between the final name and host, process and number.
pub const TEMPORARY_MARK: &str = ".tmp-";

fn host() -> String {
    #[cfg(unix)]
    let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
    #[cfg(not(unix))]
    let name = std::env::var("COMPUTERNAME").unwrap_or_default();
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).take(64).collect()
}

impl Unpublished {
    pub(crate) fn create(path: &Path) -> Result<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let name = path
            .file_name()
            .ok_or_else(|| Error::usage(format!("{} does not name a file", path.display())))?
            .to_string_lossy();
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let temporary =
            path.with_file_name(format!(".{name}{TEMPORARY_MARK}{}-{}-{number}", host(), std::process::id()));
        // A leftover of a killed process of the same number is overwritten.
        let file = File::create(&temporary).map_err(|e| Error::io("create", &temporary, e))?;
        let file = Some(BufWriter::with_capacity(1 << 18, file));
        Ok(Self { file, temporary, path: path.to_path_buf() })
    }

    pub(crate) fn write(&mut self, bytes: &[u8]) -> Result<()> {
        let file = self.file.as_mut().expect("the file is open until it is published");
        file.write_all(bytes).map_err(|e| Error::io("write", &self.temporary, e))
    }

    /// Makes the file durable and visible under its name.
    pub(crate) fn publish(mut self) -> Result<()> {
        let file = self.file.take().expect("the file is open until it is published");
        let file = file.into_inner().map_err(|e| Error::io("write", &self.temporary, e.into_error()))?;
        file.sync_all().map_err(|e| Error::io("sync", &self.temporary, e))?;
        drop(file);
        std::fs::rename(&self.temporary, &self.path).map_err(|e| Error::io("rename a new", &self.path, e))?;
        self.temporary = PathBuf::new();
        sync_folder(&self.path)
    }
}

/// A rename is durable once its folder is; only Unix can sync a folder.
fn sync_folder(path: &Path) -> Result<()> {
    #[cfg(unix)]
    {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder).and_then(|f| f.sync_all()).map_err(|e| Error::io("sync the folder", folder, e))?;
    }
    #[cfg(not(unix))]
    let _ = path;
    Ok(())
}

impl Drop for Unpublished {
    fn drop(&mut self) {
        if !self.temporary.as_os_str().is_empty() {
            // Nothing can be done about a temporary that cannot be removed; no reader looks at it.
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_published_file_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let mut dropped = Unpublished::create(&path).unwrap();
        dropped.write(b"half").unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "the temporary");
        drop(dropped);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        let (mut one, mut two) = (Unpublished::create(&path).unwrap(), Unpublished::create(&path).unwrap());
        one.write(b"same").unwrap();
        two.write(b"same").unwrap();
        one.publish().unwrap();
        two.publish().unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
        assert_eq!(std::fs::read(&path).unwrap(), b"same");
    }

    #[test]
    fn a_missing_folder_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let error = Unpublished::create(&dir.path().join("no/a")).err().unwrap();
        assert_eq!(error.exit_code(), 1);
        assert!(error.to_string().contains("no/.a.tmp-"), "{error}");
    }
}
