//! One writer of an archive at a time.
//!
//! ```text
//!  scan.isospan/          the archive
//!  .scan.isospan.lock     locked while a process writes it; says which one
//! ```
//!
//! The lock is the system's (`flock`), so it ends with its process, however that ends. Linux passes
//! it on to NFS servers. The file lies next to the archive, since `--force` replaces the archive's
//! folder as a whole. A file system without locks is not protected: there, the user must keep two
//! writers apart.
//!
//! The file is removed with the lock. So a process that has locked it checks that it is still the
//! file of that name: the previous owner may have removed it in between.
//!
//! Workers of a planned reduction take no lock: those of one segment write the same bytes.

use crate::bytes::publish::host;
use crate::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// Held by the writer of an archive; dropping it lets others write.
#[derive(Debug)]
pub(crate) struct WriterLock {
    file: File,
    path: PathBuf,
}

impl WriterLock {
    /// Locks an archive, which need not be there.
    ///
    /// # Errors
    /// [`Error::Busy`] when another process, or thread, writes it; [`Error::Io`] when its folder
    /// cannot be written.
    pub(crate) fn acquire(archive: &Path) -> Result<Self> {
        let path = lock_path(archive)?;
        loop {
            let mut options = File::options();
            let file = options.read(true).write(true).create(true).truncate(false).open(&path);
            let file = file.map_err(|e| Error::io("create", &path, e))?;
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => {
                    let writer = writer(&path);
                    return Err(Error::Busy { path: archive.to_path_buf(), writer });
                }
                // Without locks the name of the file is of no use.
                Ok(()) | Err(TryLockError::Error(_)) => {}
            }
            if is_named(&file, &path) {
                let lock = Self { file, path };
                lock.sign();
                return Ok(lock);
            }
        }
    }

    /// Says whose the lock is. This is for messages only, so a failure is ignored.
    fn sign(&self) {
        let mut file = &self.file;
        let _ = file.set_len(0);
        let _ = writeln!(file, "process {} on {}", std::process::id(), host());
    }
}

impl Drop for WriterLock {
    fn drop(&mut self) {
        // Removed while it is locked: no other process can have taken it.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn lock_path(archive: &Path) -> Result<PathBuf> {
    let name = archive.file_name();
    let name = name.ok_or_else(|| Error::usage(format!("{} does not name an archive", archive.display())))?;
    Ok(archive.with_file_name(format!(".{}.lock", name.to_string_lossy())))
}

fn writer(path: &Path) -> String {
    let mut text = String::new();
    let read = File::open(path).and_then(|file| file.take(200).read_to_string(&mut text));
    read.map_or_else(|_| String::new(), |_| text.trim().to_owned())
}

/// Whether an open file is still the one of its name.
fn is_named(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let place = |about: std::io::Result<std::fs::Metadata>| about.map(|a| (a.dev(), a.ino())).ok();
        place(file.metadata()).is_some_and(|own| place(std::fs::metadata(path)) == Some(own))
    }
    #[cfg(not(unix))]
    {
        let _ = (file, path);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_writer_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let archive = dir.path().join("a.isospan");
        let first = WriterLock::acquire(&archive).unwrap();
        let error = WriterLock::acquire(&archive).unwrap_err();
        assert_eq!(error.exit_code(), 75);
        assert!(error.to_string().contains(&format!("process {}", std::process::id())), "{error}");
        let other = WriterLock::acquire(&dir.path().join("b.isospan")).unwrap();
        drop((first, other));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "nothing stays");
        WriterLock::acquire(&archive).unwrap();
    }

    #[test]
    fn many_writers_take_turns() {
        let dir = tempfile::tempdir().unwrap();
        let (archive, inside) = (dir.path().join("a.isospan"), std::sync::atomic::AtomicU32::new(0));
        let taken: u32 = std::thread::scope(|scope| {
            let write = || {
                let mut taken = 0;
                for _ in 0..200 {
                    let Ok(_lock) = WriterLock::acquire(&archive) else { continue };
                    taken += 1;
                    assert_eq!(inside.fetch_add(1, std::sync::atomic::Ordering::SeqCst), 0);
                    inside.fetch_sub(1, std::sync::atomic::Ordering::SeqCst);
                }
                taken
            };
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(write)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).sum()
        });
        assert!(taken > 0);
    }
}
