//! A folder that is made beside the one whose place it takes.
//!
//! ```text
//!  viewer/                              there is a whole one, or none
//!  .viewer.tmp-node12-4711-9f3c…x0/     this one's work, for this user alone
//!      new/                             what becomes viewer/
//!      old/                             what was viewer/, until it is removed
//! ```
//!
//! What a killed process has left is removed by the next one that makes the same folder on the same
//! host, or put back where it was killed between two renames. Callers hold a lock of the folder.

use super::publish::{
    TEMPORARY_MARK, folder_of, host, is_alive, process_of, remove_folder, restore_folder, swap_folder,
    sync_folder, sync_folders, temporary_name,
};
use crate::error::{Error, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// The folder in which another one is made; removed when dropped.
#[derive(Debug)]
pub struct StagedFolder {
    path: PathBuf,
    out: PathBuf,
}

impl StagedFolder {
    /// Begins a folder that is to be called `out`.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder above cannot be written.
    pub fn begin(out: &Path) -> Result<Self> {
        for dead in dead_of(out) {
            restore_folder(out, &dead.join("old"))?;
            remove_folder(&dead)?;
        }
        let path = temporary_name(out)?;
        private_folder(&path).map_err(|e| Error::io("create the folder", &path, e))?;
        let stage = Self { path, out: out.to_path_buf() };
        let new = stage.new_folder();
        fs::create_dir(&new).map_err(|e| Error::io("create the folder", new, e))?;
        Ok(stage)
    }

    /// The folder on its way.
    pub fn new_folder(&self) -> PathBuf {
        self.path.join("new")
    }

    /// Gives the folder its name, all folders in it synced. With `replace` it takes the place of
    /// the one of this name, which is returned: what the caller leaves in it is removed with the
    /// stage. Without, there must be none, or an empty one.
    ///
    /// # Errors
    /// [`Error::Io`]; what was there is in its place.
    pub fn publish(&self, replace: bool) -> Result<Option<PathBuf>> {
        let (new, old) = (self.new_folder(), self.path.join("old"));
        let mut folders = vec![new.clone()];
        let mut next = 0;
        while let Some(folder) = folders.get(next).cloned() {
            let list = |e| Error::io("list", &folder, e);
            for entry in fs::read_dir(&folder).map_err(list)? {
                let entry = entry.map_err(list)?;
                if entry.file_type().map_err(list)?.is_dir() {
                    folders.push(entry.path());
                }
            }
            next += 1;
        }
        sync_folders(folders)?;
        if !replace {
            fs::rename(&new, &self.out).map_err(|e| Error::io("write", &self.out, e))?;
            return sync_folder(&self.out).map(|()| None);
        }
        swap_folder(&new, &self.out, &old)?;
        Ok(old.exists().then_some(old))
    }
}

impl Drop for StagedFolder {
    fn drop(&mut self) {
        let _ = remove_folder(&self.path);
    }
}

/// Makes a folder that other users cannot read.
fn private_folder(path: &Path) -> std::io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::DirBuilderExt;
        fs::DirBuilder::new().mode(0o700).create(path)
    }
    #[cfg(not(unix))]
    fs::create_dir(path)
}

/// What processes that are no more left of making `out`, on this host.
fn dead_of(out: &Path) -> Vec<PathBuf> {
    let (Some(name), Ok(entries)) = (out.file_name(), fs::read_dir(folder_of(out))) else { return vec![] };
    let prefix = format!(".{}{TEMPORARY_MARK}", name.to_string_lossy());
    let mut dead = vec![];
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let process = process_of(&name, host()).filter(|_| name.starts_with(&prefix));
        let is_dead = process.is_some_and(|process| !is_alive(process));
        // A link that has this name is none of ours.
        if is_dead && entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            dead.push(entry.path());
        }
    }
    dead.sort();
    dead
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<_> =
            entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_folder_gets_its_name_last_and_the_old_one_is_handed_over() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("viewer");
        for text in ["one", "two"] {
            let stage = StagedFolder::begin(&out).unwrap();
            fs::create_dir(stage.new_folder().join("a")).unwrap();
            fs::write(stage.new_folder().join("a/file"), text).unwrap();
            let old = stage.publish(text == "two").unwrap();
            assert_eq!(fs::read_to_string(out.join("a/file")).unwrap(), text);
            assert_eq!(old.map(|old| fs::read_to_string(old.join("a/file")).unwrap()), {
                (text == "two").then(|| "one".to_owned())
            });
        }
        // One that appears meanwhile is not replaced.
        let stage = StagedFolder::begin(&out).unwrap();
        assert!(stage.publish(false).is_err());
        drop(stage);
        assert_eq!(names(dir.path()), ["viewer"]);
        assert_eq!(fs::read_to_string(out.join("a/file")).unwrap(), "two");
    }

    #[test]
    fn what_a_killed_process_left_is_removed_or_put_back() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("viewer");
        let dead = dir.path().join(format!(".viewer.tmp-{}-{}-0", host(), 1 << 30));
        let others = [
            dir.path().join(format!(".viewer.tmp-{}-1-0", host())),
            dir.path().join(format!(".other.tmp-{}-{}-0", host(), 1 << 30)),
            dir.path().join(".viewer.tmp-x"),
        ];
        for folder in others.iter().chain([&dead]) {
            fs::create_dir_all(folder.join("new")).unwrap();
        }
        fs::create_dir(dead.join("old")).unwrap();
        fs::write(dead.join("old/file"), "whole").unwrap();
        drop(StagedFolder::begin(&out).unwrap());
        assert_eq!(fs::read_to_string(out.join("file")).unwrap(), "whole");
        assert!(!dead.exists() && others.iter().all(|other| other.exists()));
    }
}
