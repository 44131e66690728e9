//! Which files are not what an archive was made from any more.
//!
//! The archive has a hash of the contents of each file. Next to it, in `NAME.isospan.work`, is a
//! list with length and time of change of the files: one that has both is not read again.

use super::plan_file::work_folder;
use crate::archive::manifest::{Manifest, StoredStep};
use crate::pipeline::plan::{Inputs, RecordedFile, Watch};
use isospan_io::bytes::publish::Unpublished;
use isospan_io::bytes::read_whole;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::formats::{Input, OpenOptions, open_input};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The list of files next to an archive.
const LIST: &str = "sources.json";
/// The most bytes of it.
const LARGEST_LIST: u64 = 64 << 20;

/// A file of an archive in a state that is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Known {
    /// All files that belong to it.
    files: Vec<RecordedFile>,
    /// The hash of their contents.
    fingerprint: String,
}

/// Those of some files whose contents are not the ones that the archive's steps of their names were
/// made from, and why. A file of another name is left out.
///
/// # Errors
/// When the archive is damaged; [`Error::Cancelled`]; when the list of files cannot be written.
pub fn changed_sources(
    archive: &Path,
    sources: &[PathBuf],
    options: &OpenOptions,
    cancel: &CancelToken,
) -> Result<Vec<(PathBuf, String)>> {
    let manifest = Manifest::read(archive)?;
    let list = work_folder(archive).join(LIST);
    // One that cannot be read is made anew.
    let known = read_whole(&list, LARGEST_LIST).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let known: BTreeMap<String, Known> = known.unwrap_or_default();
    let (mut now, mut changed) = (BTreeMap::new(), vec![]);
    for source in sources {
        cancel.check()?;
        let name = source.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let steps: Vec<&StoredStep> = manifest.steps.iter().filter(|s| s.plan.source.path == name).collect();
        let Some(first) = steps.first() else { continue };
        let made_from: BTreeSet<&str> = steps.iter().map(|s| &*s.plan.source.fingerprint).collect();
        let is_made_from = |found: &str| made_from.len() == 1 && made_from.contains(found);
        if let Some(before) = known.get(&name).filter(|k| is_made_from(&k.fingerprint) && is_as_before(k)) {
            now.insert(name, before.clone());
            continue;
        }
        let field = Some(first.plan.source.field.clone());
        match known_of(source, &OpenOptions { field, ..options.clone() }, cancel) {
            Ok(found) if is_made_from(&found.fingerprint) => _ = now.insert(name, found),
            Ok(_) => changed.push((source.clone(), "its contents are others".to_owned())),
            Err(e @ Error::Cancelled) => return Err(e),
            Err(e) => changed.push((source.clone(), e.to_string())),
        }
    }
    if now != known {
        let folder = work_folder(archive);
        fs::create_dir_all(&folder).map_err(|e| Error::io("create the folder", &folder, e))?;
        let mut out = Unpublished::create(&list)?;
        out.write(&serde_json::to_vec(&now).expect("a list is plain data"))?;
        out.publish()?;
    }
    Ok(changed)
}

/// Whether all files of a source have the lengths and times that they had.
fn is_as_before(known: &Known) -> bool {
    let mut watch = Watch::default();
    let files: Vec<PathBuf> = known.files.iter().map(|file| file.path().to_path_buf()).collect();
    watch.add(&files).is_ok_and(|()| watch.records() == known.files)
}

fn known_of(source: &Path, options: &OpenOptions, cancel: &CancelToken) -> Result<Known> {
    let files = match open_input(source, options)? {
        Input::Volume(volume) => volume.info().files(),
        Input::Mesh(mesh) => mesh.info().files(),
    };
    let mut inputs = Inputs::default();
    let fingerprint = inputs.fingerprint(0, &files, cancel)?;
    Ok(Known { files: inputs.watch.records(), fingerprint })
}
