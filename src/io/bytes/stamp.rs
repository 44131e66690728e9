//! What tells the states of a file apart without reading it.

use super::remote::{self, is_remote};
use crate::error::Result;
use std::fs::Metadata;
use std::path::Path;
use std::time::UNIX_EPOCH;

/// What the file system says about a file: it shows whether its bytes have changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Its length.
    pub len: u64,
    /// Nanoseconds since 1970; of a file on a server a hash of its ETag.
    pub modified: i128,
    /// Time of change of the inode, which no program can set, in nanoseconds; the inode; the
    /// device. 0 where the system has none. Of a file on a server, how often it changed.
    changed: i128,
    inode: [u64; 2],
}

impl Stamp {
    /// The stamp of a file; `None` for a folder, and where there is nothing. A server is asked only
    /// if it said nothing of the file so far.
    ///
    /// # Errors
    /// When a server fails.
    pub fn of(path: &Path) -> Result<Option<Self>> {
        if is_remote(path) {
            let remote::Seen { len, tag, changes } = remote::seen(path)?;
            let (modified, changed) = (i128::from(tag), i128::from(changes));
            return Ok(len.map(|len| Self { len, modified, changed, inode: [0; 2] }));
        }
        Ok(Self::of_local(path))
    }

    /// The stamp of a file on this machine; `None` for a folder, and where there is nothing.
    pub fn of_local(path: &Path) -> Option<Self> {
        std::fs::metadata(path).ok().filter(|about| !about.is_dir()).map(|about| Self::from(&about))
    }

    /// Whether it is of the same file, whatever is in that.
    pub fn is_of_same_file(&self, other: &Self) -> bool {
        self.inode == other.inode
    }

    /// The stamp of a file or a folder on this machine; `None` where there is nothing.
    pub fn of_any(path: &Path) -> Option<Self> {
        std::fs::metadata(path).ok().map(|about| Self::from(&about))
    }
}

impl From<&Metadata> for Stamp {
    fn from(about: &Metadata) -> Self {
        let modified = about.modified().ok().map_or(0, |time| match time.duration_since(UNIX_EPOCH) {
            Ok(after) => after.as_nanos() as i128,
            Err(before) => -(before.duration().as_nanos() as i128),
        });
        #[cfg(unix)]
        let (changed, inode) = {
            use std::os::unix::fs::MetadataExt;
            let nanoseconds = i128::from(about.ctime()) * 1_000_000_000 + i128::from(about.ctime_nsec());
            (nanoseconds, [about.dev(), about.ino()])
        };
        #[cfg(not(unix))]
        let (changed, inode) = (0, [0; 2]);
        Self { len: about.len(), modified, changed, inode }
    }
}
