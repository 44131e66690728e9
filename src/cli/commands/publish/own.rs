//! What `isospan publish` has written to a folder: a list in the folder itself. Only what is in it,
//! and is still as it was written, is replaced.

use isospan::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3Default;

/// The list's own name in the folder.
pub(super) const LIST: &str = "published.json";
/// Bytes of a list, at most.
const MOST: u64 = 256 << 20;
const FORMAT: &str = "isospan publish 1";

/// A hash of the bytes of a file.
#[derive(Default)]
pub(super) struct Hash(Xxh3Default);

impl Hash {
    pub(super) fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    pub(super) fn digest(&self) -> u64 {
        self.0.digest()
    }
}

/// The files of a folder.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct List {
    format: String,
    files: BTreeMap<String, ListedFile>,
}

#[derive(Debug, Serialize, Deserialize)]
struct ListedFile {
    bytes: u64,
    xxh3: String,
}

impl List {
    pub(super) fn add(&mut self, name: String, bytes: u64, hash: u64) {
        self.files.insert(name, ListedFile { bytes, xxh3: format!("{hash:016x}") });
    }

    pub(super) fn to_text(&self) -> String {
        let list = serde_json::json!({ "format": FORMAT, "files": self.files });
        format!("{list:#}\n")
    }

    /// The list of a folder that holds what it names, and nothing else.
    ///
    /// # Errors
    /// [`Error::Usage`] that names what is not of this program.
    pub(super) fn of_all_in(folder: &Path) -> Result<Self> {
        let list = Self::read(folder)?;
        let (files, folders) = all_in(folder)?;
        let empty = folders.iter().find(|&name| {
            let inside = format!("{name}/");
            !list.files.keys().any(|file| file.starts_with(&inside))
        });
        if let Some(name) = empty {
            return Err(refused(folder, name, "is not of isospan publish"));
        }
        for name in files.iter().filter(|&name| name != LIST) {
            let Some(entry) = list.files.get(name) else {
                return Err(refused(folder, name, "is not of isospan publish"));
            };
            if !entry.is_of(&folder.join(name)) {
                return Err(refused(folder, name, "was changed since it was published"));
            }
        }
        Ok(list)
    }

    fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(LIST);
        let none = |why: &str| {
            let folder = folder.display();
            let help = "choose another name, or remove it by hand";
            Error::usage(format!(
                "cannot replace {folder}: it is no folder that isospan publish made ({LIST} {why}); {help}"
            ))
        };
        let mut text = String::new();
        let Some(file) = plain_file(&path) else { return Err(none("is missing")) };
        file.take(MOST).read_to_string(&mut text).map_err(|e| Error::io("read", &path, e))?;
        let list: Option<Self> = serde_json::from_str(&text).ok();
        list.filter(|list| list.format == FORMAT).ok_or_else(|| none("is no list of it"))
    }

    /// Removes these files, and their folders, from a folder that was replaced.
    ///
    /// # Errors
    /// [`Error::Usage`] where others came meanwhile: they are kept, and named.
    pub(super) fn remove_from(&self, old: &Path, out: &Path) -> Result<()> {
        let (files, mut folders) = all_in(old)?;
        for name in &files {
            let is_ours = name == LIST || self.files.get(name).is_some_and(|e| e.is_of(&old.join(name)));
            if is_ours {
                let path = old.join(name);
                fs::remove_file(&path).map_err(|e| Error::io("remove", path, e))?;
            }
        }
        folders.sort_by_key(|name| std::cmp::Reverse(name.len()));
        // Those that are not empty stay.
        folders.iter().for_each(|name| drop(fs::remove_dir(old.join(name))));
        if fs::remove_dir(old).is_ok() {
            return Ok(());
        }
        let kept = kept_name(out);
        fs::rename(old, &kept).map_err(|e| Error::io("keep", old, e))?;
        let (out, kept) = (out.display(), kept.display());
        Err(Error::usage(format!("{out} is published; files that came to it meanwhile are kept in {kept}")))
    }
}

impl ListedFile {
    /// Whether a file is the one that was written.
    fn is_of(&self, path: &Path) -> bool {
        let Some(mut file) = plain_file(path) else { return false };
        if file.metadata().map_or(true, |about| about.len() != self.bytes) {
            return false;
        }
        let (mut hash, mut piece) = (Hash::default(), vec![0; 1 << 20]);
        loop {
            match file.read(&mut piece) {
                Ok(0) => return format!("{:016x}", hash.digest()) == self.xxh3,
                Ok(count) => hash.update(&piece[..count]),
                Err(_) => return false,
            }
        }
    }
}

fn refused(folder: &Path, name: &str, what: &str) -> Error {
    let path = folder.join(name);
    let (folder, path) = (folder.display(), path.display());
    Error::usage(format!("cannot replace {folder}: {path} {what}; move it away, or choose another name"))
}

/// A regular file, opened; `None` of anything else, a link too.
fn plain_file(path: &Path) -> Option<File> {
    isospan::bytes::open_unlinked(path).ok()
}

/// A name beside a folder that is free.
fn kept_name(out: &Path) -> PathBuf {
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    let names = (1..).map(|n: u64| out.with_file_name(format!("{name}.kept-{n}")));
    let mut free = names.filter(|path| fs::symlink_metadata(path).is_err());
    free.next().unwrap_or_else(|| out.with_extension("kept"))
}

/// The names of all files and of all folders below a folder. No link is followed: it is a file.
fn all_in(folder: &Path) -> Result<(Vec<String>, Vec<String>)> {
    let (mut files, mut folders, mut next) = (vec![], vec![String::new()], 0);
    while let Some(below) = folders.get(next).cloned() {
        let here = folder.join(&below);
        let list = |e| Error::io("list", &here, e);
        for entry in fs::read_dir(&here).map_err(list)? {
            let entry = entry.map_err(list)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let name = if below.is_empty() { name } else { format!("{below}/{name}") };
            let is_folder = entry.file_type().map_err(list)?.is_dir();
            if is_folder { folders.push(name) } else { files.push(name) }
        }
        next += 1;
    }
    files.sort();
    folders.remove(0);
    Ok((files, folders))
}
