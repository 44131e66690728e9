//! A copy of an archive: the files that its manifest names, each a regular file with the contents
//! that the manifest says.

use super::existing::segments;
use crate::archive::manifest::{MANIFEST_NAME, Manifest};
use crate::archive::segment::{Copied, Known, copy_segment};
use crate::pipeline::plan::Attachments;
use isospan_io::bytes::plain::kind_of;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_64;

/// A file of an archive that was copied.
#[derive(Clone, Debug)]
pub struct CopiedFile {
    /// Its name in the archive.
    pub name: PathBuf,
    /// Its length.
    pub bytes: u64,
    /// XXH3 (64 bits) of its bytes.
    pub hash: u64,
}

/// Copies an archive to a folder that is not there yet. No link in the archive is followed, and
/// nothing but its own files is copied. The files are synced, their folders are not.
///
/// # Errors
/// [`Error::BadInput`] for a file that is not what the manifest says; [`Error::Io`];
/// [`Error::Cancelled`].
pub fn copy_archive(archive: &Path, to: &Path, cancel: &CancelToken) -> Result<Vec<CopiedFile>> {
    let (manifest, text) = Manifest::read_plain(archive)?;
    let mut files: Vec<(PathBuf, Known)> =
        segments(archive, &manifest).into_iter().map(|(path, info)| (path, Known::Info(info))).collect();
    let attached = Attachments::files(archive, &manifest.plan).into_iter();
    files.extend(attached.map(|path| (path, Known::Plan(manifest.plan.hash()))));
    make_folders(archive, to, &files)?;
    let mut copied = vec![];
    for (path, known) in files {
        let name = name_in(archive, &path);
        let Copied { bytes, hash } = copy_segment(&path, &to.join(&name), &known, &|| cancel.check())?;
        copied.push(CopiedFile { name, bytes, hash });
    }
    let path = to.join(MANIFEST_NAME);
    let mut file = File::create_new(&path).map_err(|e| Error::io("create", &path, e))?;
    file.write_all(&text).and_then(|()| file.sync_all()).map_err(|e| Error::io("write", &path, e))?;
    copied.push(CopiedFile { name: MANIFEST_NAME.into(), bytes: text.len() as u64, hash: xxh3_64(&text) });
    Ok(copied)
}

fn name_in(archive: &Path, file: &Path) -> PathBuf {
    file.strip_prefix(archive).map_or_else(|_| file.to_path_buf(), Path::to_path_buf)
}

/// Makes the folders of the copy. Those of the archive must be folders, and no links to some.
fn make_folders(archive: &Path, to: &Path, files: &[(PathBuf, Known)]) -> Result<()> {
    let folders: BTreeSet<&Path> = files.iter().filter_map(|(path, _)| path.parent()).collect();
    fs::create_dir(to).map_err(|e| Error::io("create the folder", to, e))?;
    for folder in folders.into_iter().filter(|&folder| folder != archive) {
        let about = fs::symlink_metadata(folder).map_err(|e| Error::io("look at", folder, e))?;
        if !about.is_dir() {
            let got = kind_of(&about);
            return Err(Error::bad_input(folder, "folder", "a folder of the archive", got));
        }
        let copy = to.join(name_in(archive, folder));
        fs::create_dir_all(&copy).map_err(|e| Error::io("create the folder", copy, e))?;
    }
    Ok(())
}
