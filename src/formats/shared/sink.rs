//! Files that are written and then published.

use crate::bytes::publish::{Unpublished, folder_of};
use crate::error::{Error, Result};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// A file being written under a temporary name next to its target.
pub(in crate::formats) struct Sink {
    out: Unpublished,
    target: PathBuf,
    parent: PathBuf,
    bytes: u64,
}

impl Sink {
    pub(in crate::formats) fn create(path: &Path) -> Result<Self> {
        let target = resolve(path)?;
        let parent = folder_of(&target).to_path_buf();
        if !parent.is_dir() {
            return Err(Error::usage(format!(
                "cannot write {}: there is no folder {}; create it first",
                path.display(),
                parent.display()
            )));
        }
        let out = Unpublished::create(&target)?;
        Ok(Self { out, target, parent, bytes: 0 })
    }

    /// Appends bytes.
    pub(in crate::formats) fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.bytes += bytes.len() as u64;
        self.out.write(bytes)
    }

    /// The file that will be written.
    pub(in crate::formats) fn target(&self) -> &Path {
        &self.target
    }

    /// A second file next to the target, for data that a format needs in another order. It has no
    /// name, so it never stays behind.
    pub(in crate::formats) fn scratch(&self) -> Result<File> {
        tempfile::tempfile_in(&self.parent)
            .map_err(|e| Error::io("create a scratch file beside", &self.target, e))
    }

    /// The error of a surface store that does not hold what it announced.
    pub(in crate::formats) fn broken_source(&self, what: String) -> Error {
        Error::io("write", &self.target, io::Error::new(io::ErrorKind::InvalidData, what))
    }

    /// Makes the file durable, then visible.
    pub(in crate::formats) fn publish(self) -> Result<u64> {
        self.out.publish()?;
        Ok(self.bytes)
    }
}

/// The file to write: a link is followed, what is no regular file is refused (a rename would
/// replace a device).
pub(in crate::formats) fn resolve(path: &Path) -> Result<PathBuf> {
    let refuse = |what: &str| {
        Err(Error::usage(format!("cannot write {}: it is {what}; give the name of a file", path.display())))
    };
    match std::fs::metadata(path) {
        Ok(about) if about.is_dir() => refuse("a folder"),
        Ok(about) if !about.is_file() => refuse("a pipe, socket or device"),
        Ok(_) => std::fs::canonicalize(path).map_err(|e| Error::io("find", path, e)),
        Err(_) if path.file_name().is_none() => refuse("no file name"),
        Err(_) => Ok(path.to_path_buf()),
    }
}
