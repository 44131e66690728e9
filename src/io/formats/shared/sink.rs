//! Files that are written and then published, or handed on byte by byte.

use crate::bytes::publish::{Unpublished, folder_of};
use crate::error::{Error, Result};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Takes the bytes of a file, one after another.
pub(in crate::formats) type EachByte<'a> = &'a mut dyn FnMut(&[u8]) -> Result<()>;

/// A file being written.
pub struct Sink<'a> {
    out: Out<'a>,
    target: PathBuf,
    bytes: u64,
}

enum Out<'a> {
    /// Under a temporary name next to its target.
    File { out: Unpublished, parent: PathBuf },
    /// To somebody who takes the bytes.
    Stream(EachByte<'a>),
}

impl<'a> Sink<'a> {
    /// Begins a file, which gets its name when it is published.
    ///
    /// # Errors
    /// [`Error::Usage`] when the target is a folder or lies in none; [`Error::Io`] when the system
    /// refuses to write.
    pub fn create(path: &Path) -> Result<Self> {
        let target = resolve(path)?;
        let parent = folder_of(&target).to_path_buf();
        if !parent.is_dir() {
            return Err(Error::usage(format!(
                "cannot write {}: there is no folder {}; create it first",
                path.display(),
                parent.display()
            )));
        }
        let out = Out::File { out: Unpublished::create(&target)?, parent };
        Ok(Self { out, target, bytes: 0 })
    }

    /// Hands the bytes on.
    pub fn stream(each: EachByte<'a>) -> Self {
        Self { out: Out::Stream(each), target: PathBuf::from("a surface file"), bytes: 0 }
    }

    /// Appends bytes.
    pub fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.bytes += bytes.len() as u64;
        match &mut self.out {
            Out::File { out, .. } => out.write(bytes),
            Out::Stream(each) => each(bytes),
        }
    }

    /// The file that will be written.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// A second file next to the target, for data that a format needs in another order. It has no
    /// name, so it never stays behind. `None` where there is no target.
    pub fn scratch(&self) -> Result<Option<File>> {
        let Out::File { parent, .. } = &self.out else { return Ok(None) };
        let made = tempfile::tempfile_in(parent);
        made.map(Some).map_err(|e| Error::io("create a scratch file beside", &self.target, e))
    }

    /// The error of a surface store that does not hold what it announced.
    pub fn broken_source(&self, what: String) -> Error {
        Error::io("write", &self.target, io::Error::new(io::ErrorKind::InvalidData, what))
    }

    /// Makes the file durable, then visible.
    pub fn publish(self) -> Result<u64> {
        if let Out::File { out, .. } = self.out {
            out.publish()?;
        }
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
