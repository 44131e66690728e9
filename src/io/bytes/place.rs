//! Files and folders by their names, on this machine or on a server.
//!
//! What a reader of a folder needs: a small file in it or a whole one, whether it is there, and the
//! folders in it. That a file is not there is an answer; anything else that fails is an error.

use super::remote::{self, is_remote};
use super::{ByteSource, IoMode, read_whole};
use crate::error::{Error, Result};
use std::io;
use std::path::{Path, PathBuf};

/// Whether nothing is there. What a reader takes for a folder may be a file that somebody keeps.
fn is_absent(e: &io::Error) -> bool {
    matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

/// All bytes of a small file; `None` where there is none. What a server said is believed for some
/// seconds.
pub(crate) fn read_if_there(path: &Path, most: u64) -> Result<Option<Vec<u8>>> {
    if is_remote(path) {
        return remote::small_if_there(path, most);
    }
    match std::fs::metadata(path) {
        Err(e) if is_absent(&e) => Ok(None),
        Err(e) => Err(Error::io("look at", path, e)),
        Ok(_) => read_whole(path, most).map(Some),
    }
}

/// A file of which all bytes are needed, at most `most` where it has to be fetched; `None` where
/// there is none.
pub(crate) fn open_if_there(path: &Path, io: IoMode, most: u64) -> Result<Option<ByteSource>> {
    if is_remote(path) {
        return Ok(remote::whole_if_there(path, most)?.map(|bytes| ByteSource::from_vec(path, bytes)));
    }
    match std::fs::metadata(path) {
        Err(e) if is_absent(&e) => Ok(None),
        Err(e) => Err(Error::io("look at", path, e)),
        Ok(_) => ByteSource::open(path, io).map(Some),
    }
}

/// A file that is read by ranges; `None` where there is none.
pub fn ranges_if_there(path: &Path, io: IoMode) -> Result<Option<ByteSource>> {
    if is_remote(path) {
        return match ByteSource::open(path, io) {
            Err(e) if e.kind() == crate::error::ErrorKind::NotFound => Ok(None),
            opened => opened.map(Some),
        };
    }
    open_if_there(path, io, 0)
}

/// Whether a file or a folder is there; of a server, a file.
pub(crate) fn exists(path: &Path) -> Result<bool> {
    if is_remote(path) { Ok(lengths(&[path.to_path_buf()])?[0].is_some()) } else { Ok(path.exists()) }
}

/// The lengths of files; `None` where there is none.
pub fn lengths(paths: &[PathBuf]) -> Result<Vec<Option<u64>>> {
    let on_servers: Vec<PathBuf> = paths.iter().filter(|path| is_remote(path)).cloned().collect();
    remote::look_at(&on_servers)?;
    let length = |path: &PathBuf| {
        if is_remote(path) { remote::seen(path).map(|s| s.len) } else { Ok(length_here(path)) }
    };
    paths.iter().map(length).collect()
}

fn length_here(path: &Path) -> Option<u64> {
    std::fs::metadata(path).ok().map(|about| about.len())
}

/// The names of the folders in a folder.
pub(crate) fn folders_in(path: &Path) -> Result<Vec<String>> {
    if is_remote(path) {
        return remote::folders_in(path);
    }
    let mut names = vec![];
    for entry in std::fs::read_dir(path).map_err(|e| Error::io("list", path, e))? {
        let entry = entry.map_err(|e| Error::io("list", path, e))?;
        if entry.path().is_dir() {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    Ok(names)
}

/// The folders above a path, the next one first; of an address, down to the server or bucket.
pub(crate) fn above(path: &Path) -> impl Iterator<Item = &Path> {
    // Two slashes are in front of a server's name.
    let parts = |p: &Path| p.as_os_str().as_encoded_bytes().iter().filter(|&&b| b == b'/').count();
    let remote = is_remote(path);
    path.ancestors().skip(1).take_while(move |p| !remote || parts(p) > 2)
}

/// The absolute path; an address is one.
pub fn absolute(path: &Path) -> io::Result<PathBuf> {
    if is_remote(path) { Ok(path.to_path_buf()) } else { std::path::absolute(path) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_absolute_and_end_at_the_server() {
        let address = Path::new("https://h:1/a/b.zarr/0");
        assert_eq!(absolute(address).unwrap(), address);
        let above: Vec<&str> = above(address).map(|p| p.to_str().unwrap()).collect();
        assert_eq!(above, ["https://h:1/a/b.zarr", "https://h:1/a"]);
        assert_eq!(super::above(Path::new("a/b/c")).count(), 3);
    }
}
