//! One writer of an archive at a time.
//!
//! ```text
//!  scan.isospan/          the archive
//!  .scan.isospan.lock     locked while a process writes it; says which one
//! ```
//!
//! The lock is the system's (`flock`), so it ends with its process, however that ends. Linux passes
//! it on to NFS servers. The file lies next to the archive, since `replace` replaces the archive's
//! folder as a whole. A file system without locks is not protected: there, the user must keep two
//! writers apart.
//!
//! The file is removed with the lock. So a process that has locked it checks that it is still the
//! file of that name: the previous owner may have removed it in between.
//!
//! **The name may be taken** by what is not ours: a link, a pipe, another name of a user's file, a
//! file of that name. It is never followed, emptied or removed: the archive is refused until it is
//! moved away. Ours is a regular file with one name that says which process locks it, or an empty
//! one of this user, left by a process that ended before it could say so.
//!
//! Workers of a planned reduction take no lock: those of one segment write the same bytes.

use isospan_io::bytes::plain::{is_named, is_of_this_user, kind_of, names_of, open_plain};
use isospan_io::bytes::publish::host;
use isospan_io::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};

/// Bytes of a lock file, at most: a host's name has up to 64 letters.
const MOST: u64 = 200;

/// Held by the writer of an archive; dropping it lets others write.
#[derive(Debug)]
pub struct WriterLock {
    file: File,
    path: PathBuf,
}

/// How often a lock is looked for that others make and remove meanwhile.
const MOST_TRIES: u32 = 10_000;

impl WriterLock {
    /// Locks an archive, which need not be there.
    ///
    /// # Errors
    /// [`Error::Busy`] when another process, or thread, writes it; [`Error::Io`] when its folder
    /// cannot be written.
    pub fn acquire(archive: &Path) -> Result<Self> {
        let path = lock_path(archive)?;
        for _ in 0..MOST_TRIES {
            let Some(file) = open(&path)? else { continue };
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => {
                    let writer = text_of(&file).trim().to_owned();
                    return Err(Error::Busy { path: archive.to_path_buf(), writer });
                }
                // Without locks the name of the file is of no use.
                Ok(()) | Err(TryLockError::Error(_)) => {}
            }
            if is_named(&file, &path) {
                expect_ours(&file, &path)?;
                let lock = Self { file, path };
                lock.sign();
                return Ok(lock);
            }
        }
        // Folders such as /proc have no new files, and say that there are none.
        Err(Error::io("create", &path, std::io::Error::from(ErrorKind::NotFound)))
    }

    /// Says whose the lock is. This is for messages only, so a failure is ignored.
    fn sign(&self) {
        let mut file = &self.file;
        let _ = file.set_len(0).and_then(|()| file.rewind());
        let _ = writeln!(file, "process {} on {}", std::process::id(), host());
    }
}

impl Drop for WriterLock {
    fn drop(&mut self) {
        // Removed while it is locked: no other process can have taken it.
        if is_named(&self.file, &self.path) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

fn lock_path(archive: &Path) -> Result<PathBuf> {
    let name = archive.file_name();
    let name = name.ok_or_else(|| Error::usage(format!("{} does not name an archive", archive.display())))?;
    Ok(archive.with_file_name(format!(".{}.lock", name.to_string_lossy())))
}

/// Opens the file of a lock, or makes it; `None` when another process has made or removed it
/// meanwhile.
fn open(path: &Path) -> Result<Option<File>> {
    let made = open_plain(path, File::options().read(true).write(true).create_new(true));
    let opened = match made {
        Err(e) if e.kind() == ErrorKind::AlreadyExists => {
            open_plain(path, File::options().read(true).write(true))
        }
        made => made,
    };
    match opened {
        Ok(file) => Ok(Some(file)),
        Err(e) if matches!(e.kind(), ErrorKind::AlreadyExists | ErrorKind::NotFound) => {
            // A folder that is not there, or cannot be written, stays so.
            let is_there = path.parent().is_none_or(|p| p.as_os_str().is_empty() || p.is_dir());
            if is_there { Ok(None) } else { Err(Error::io("create", path, e)) }
        }
        Err(e) => match std::fs::symlink_metadata(path) {
            Ok(about) if !about.is_file() => Err(not_ours(path, &format!("it is {}", kind_of(&about)))),
            _ => Err(Error::io("create", path, e)),
        },
    }
}

/// Refuses a file that is not a lock of this program.
fn expect_ours(file: &File, path: &Path) -> Result<()> {
    let about = file.metadata().map_err(|e| Error::io("look at", path, e))?;
    if names_of(&about) > 1 {
        return Err(not_ours(path, "the file has another name, too (a hard link)"));
    }
    let is_ours = match about.len() {
        0 => is_of_this_user(&about),
        len => len <= MOST && is_signature(&text_of(file)),
    };
    if is_ours { Ok(()) } else { Err(not_ours(path, "it holds something else")) }
}

fn not_ours(path: &Path, why: &str) -> Error {
    let path = path.display();
    Error::usage(format!("{path} is the name of a lock, but {why}: move it away, it is not touched"))
}

/// Whether a text is what [`WriterLock::sign`] writes.
fn is_signature(text: &str) -> bool {
    let of = |text: &str| -> Option<bool> {
        let (process, host) = text.strip_prefix("process ")?.strip_suffix('\n')?.split_once(" on ")?;
        Some(process.parse::<u32>().is_ok() && host.chars().all(|c| c.is_ascii_alphanumeric() || c == '_'))
    };
    of(text).unwrap_or(false)
}

/// What a lock file says.
fn text_of(file: &File) -> String {
    let (mut file, mut text) = (file, String::new());
    let read = file.rewind().and_then(|()| file.take(MOST + 1).read_to_string(&mut text));
    read.map_or_else(|_| String::new(), |_| text)
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

    #[test]
    fn what_a_killed_writer_left_is_taken_over() {
        let dir = tempfile::tempdir().unwrap();
        let archive = dir.path().join("a.isospan");
        for left in [String::new(), format!("process {} on {}\n", 1 << 30, host())] {
            std::fs::write(dir.path().join(".a.isospan.lock"), left).unwrap();
            drop(WriterLock::acquire(&archive).unwrap());
            assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        }
    }

    /// A lock's name that is taken stays as it is, and what it leads to.
    #[cfg(unix)]
    fn refused(what: &str, make: impl Fn(&Path, &Path)) {
        let dir = tempfile::tempdir().unwrap();
        let (archive, lock) = (dir.path().join("a.isospan"), dir.path().join(".a.isospan.lock"));
        let letter = dir.path().join("letter");
        // Of the length and the words of a lock, too.
        for text in ["dear", "process 4711 on here\n", ""] {
            std::fs::write(&letter, text).unwrap();
            make(&letter, &lock);
            let before = std::fs::symlink_metadata(&lock).unwrap();
            let error = WriterLock::acquire(&archive).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{what}: {error}");
            let words = error.to_string();
            assert!(words.contains(".a.isospan.lock") && words.contains(what), "{what}: {words}");
            let after = std::fs::symlink_metadata(&lock).unwrap();
            let state = |m: std::fs::Metadata| (m.file_type(), m.len(), m.modified().unwrap());
            assert_eq!(state(before), state(after), "{what}");
            assert_eq!(std::fs::read_to_string(&letter).unwrap(), text, "{what}");
            std::fs::remove_file(&lock).or_else(|_| std::fs::remove_dir(&lock)).unwrap();
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_name_that_is_taken_is_refused_and_left_alone() {
        refused("a link", |letter, lock| std::os::unix::fs::symlink(letter, lock).unwrap());
        refused("a link", |_, lock| std::os::unix::fs::symlink("none", lock).unwrap());
        refused("a link", |_, lock| std::os::unix::fs::symlink(lock, lock).unwrap());
        refused("a hard link", |letter, lock| std::fs::hard_link(letter, lock).unwrap());
        refused("a folder", |_, lock| std::fs::create_dir(lock).unwrap());
        refused("something else", |_, lock| std::fs::write(lock, "a user's own text").unwrap());
        refused("something else", |_, lock| std::fs::write(lock, vec![b'p'; 300]).unwrap());
        refused("a pipe", |_, lock| {
            assert!(std::process::Command::new("mkfifo").arg(lock).status().unwrap().success());
        });
        refused("a socket", |_, lock| drop(std::os::unix::net::UnixListener::bind(lock).unwrap()));
    }
}
