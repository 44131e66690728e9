//! Fingerprints of input files: a hash of all their bytes, and a watch for changes while they are
//! read.
//!
//! An archive is made from one state of its input. Before a file is hashed its [`Stamp`] is taken
//! (length, times of change, inode); the watch compares it again before each chunk and each segment
//! is stored, and before a manifest is published. If a comparison finds no change, all that was
//! read before it is from the bytes that were hashed.
//!
//! A file on a server is not read for that. Its address, its length and its ETag (or else its time
//! of change) stand for its bytes. Servers are asked for these when the watch begins. From then on
//! each answer is compared with the one before, so the watch sees what has been read since.

use isospan_io::bytes::remote::{self, is_remote};
use isospan_io::bytes::stamp::Stamp;
use isospan_io::bytes::{open_regular, place};
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::formats::StepSource;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use xxhash_rust::xxh3::{Xxh3, xxh3_128};

/// Bytes that are read at a time.
const PIECE: usize = 1 << 20;
/// Stands for the length of a file that does not exist: the chunk of a Zarr array that has only
/// fill values.
const NO_FILE: u64 = u64::MAX;

/// XXH3 (128 bits), in hexadecimal, of the files that make up an input. It hashes, for each file in
/// order, its length as a little-endian u64, then all its bytes. A file that does not exist counts
/// as the length 2^64 - 1. Cost: reading everything once, 0.7 CPU seconds a GiB. Of a file on a
/// server it hashes the length, the address and what the server says of its state: a request each,
/// or a listing of many.
///
/// # Errors
/// [`Error::Io`] when a file cannot be read; [`Error::BadInput`] for what is no regular file.
pub fn fingerprint(files: &[PathBuf]) -> Result<String> {
    look_at(files)?;
    hash_of(files, &CancelToken::new())
}

/// Asks servers about the files that they have.
fn look_at<'a>(files: impl IntoIterator<Item = &'a PathBuf>) -> Result<()> {
    let on_servers: Vec<PathBuf> = files.into_iter().filter(|file| is_remote(file)).cloned().collect();
    remote::look_at(&on_servers)
}

fn hash_of(files: &[PathBuf], cancel: &CancelToken) -> Result<String> {
    let (mut hash, mut buffer) = (Xxh3::new(), vec![0; PIECE]);
    for path in files {
        if is_remote(path) {
            let seen = remote::seen(path)?;
            hash.update(&seen.len.unwrap_or(NO_FILE).to_le_bytes());
            if seen.len.is_some() {
                hash.update(path.as_os_str().as_encoded_bytes());
                hash.update(&seen.tag.to_le_bytes());
            }
            continue;
        }
        let mut file = match open_regular(path) {
            Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                hash.update(&NO_FILE.to_le_bytes());
                continue;
            }
            file => file?,
        };
        let read = |e| Error::io("read", path, e);
        hash.update(&file.metadata().map_err(read)?.len().to_le_bytes());
        loop {
            cancel.check()?;
            match file.read(&mut buffer).map_err(read)? {
                0 => break,
                n => hash.update(&buffer[..n]),
            }
        }
    }
    Ok(format!("{:032x}", hash.digest128()))
}

/// A file of a planned input: a worker that finds the same length and time of change believes the
/// plan's fingerprint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(in crate::pipeline) struct RecordedFile {
    /// Its absolute path.
    path: PathBuf,
    /// Its length; none where it does not exist.
    bytes: Option<u64>,
    /// Its time of change in nanoseconds since 1970, as text: JSON has no integers of this size.
    modified: String,
}

impl RecordedFile {
    /// Its absolute path.
    pub(in crate::pipeline) fn path(&self) -> &Path {
        &self.path
    }
}

/// More files than these are not all checked before each chunk, but at the end of each segment.
const FEW: usize = 64;

/// The files of a run's input, as they were when it began to read them.
#[derive(Clone, Debug, Default)]
pub(in crate::pipeline) struct Watch(BTreeMap<PathBuf, Option<Stamp>>);

impl Watch {
    /// Takes the stamps of files that are not watched yet.
    ///
    /// # Errors
    /// When a server fails.
    pub(in crate::pipeline) fn add(&mut self, files: &[PathBuf]) -> Result<()> {
        let new: Vec<&PathBuf> = files.iter().filter(|&f| !self.0.contains_key(f)).collect();
        look_at(new.iter().copied())?;
        for file in new {
            self.0.insert(file.clone(), Stamp::of(file)?);
        }
        Ok(())
    }

    /// [`Watch::add`] for what a user named, before it is opened: a file, or a folder, which has no
    /// stamp. An address is opened first, because what a server says of a folder means nothing.
    ///
    /// # Errors
    /// Those of [`Watch::add`].
    pub(in crate::pipeline) fn add_named(&mut self, path: &Path) -> Result<()> {
        if is_remote(path) { Ok(()) } else { self.add(&[path.to_path_buf()]) }
    }

    /// Whether all files are what they were.
    ///
    /// # Errors
    /// [`Error::BadInput`] that names one that is not.
    pub(in crate::pipeline) fn check(&self) -> Result<()> {
        self.0.iter().try_for_each(|(path, &before)| unchanged(path, before))
    }

    /// As [`Watch::check`], where it is cheap.
    ///
    /// # Errors
    /// As [`Watch::check`].
    pub(in crate::pipeline) fn check_few(&self) -> Result<()> {
        if self.0.len() <= FEW { self.check() } else { Ok(()) }
    }

    /// What a plan records for its workers, by ascending paths.
    pub(in crate::pipeline) fn records(&self) -> Vec<RecordedFile> {
        let record = |(path, stamp): (&PathBuf, &Option<Stamp>)| recorded(path, *stamp);
        let mut records: Vec<RecordedFile> = self.0.iter().map(record).collect();
        // Absolute paths may be in another order.
        records.sort_by(|a, b| a.path.cmp(&b.path));
        records
    }
}

fn recorded(path: &Path, stamp: Option<Stamp>) -> RecordedFile {
    let path = place::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let modified = stamp.map_or(String::new(), |s| s.modified.to_string());
    RecordedFile { path, bytes: stamp.map(|s| s.len), modified }
}

fn unchanged(path: &Path, before: Option<Stamp>) -> Result<()> {
    let now = Stamp::of(path)?;
    if now == before {
        return Ok(());
    }
    let bytes = |stamp: Option<Stamp>| stamp.map_or("no file".to_owned(), |s| format!("{} bytes", s.len));
    let got = match (before, now) {
        (Some(a), Some(b)) if !a.is_of_same_file(&b) => format!("another file of {}", bytes(now)),
        (Some(a), Some(b)) if a.len == b.len => "a file changed since then".to_owned(),
        _ => bytes(now),
    };
    let expected = format!("{}, as when this run began to read it", bytes(before));
    Err(Error::bad_input(path, "file", expected, got).with_help(
        "nothing read after the change was stored: run the same command again when the file is complete",
    ))
}

/// Fingerprints of the inputs of a run, and their watch.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct Inputs<'a> {
    pub(in crate::pipeline) watch: Watch,
    /// The files of a plan, and the fingerprints of its steps by their numbers.
    planned: Option<(&'a [RecordedFile], BTreeMap<u64, &'a str>)>,
}

impl<'a> Inputs<'a> {
    /// Inputs whose fingerprints a plan has.
    pub(in crate::pipeline) fn planned(
        files: &'a [RecordedFile],
        fingerprints: BTreeMap<u64, &'a str>,
    ) -> Self {
        Self { watch: Watch::default(), planned: Some((files, fingerprints)) }
    }

    /// The fingerprint of the files of a step. They are watched from now on, if they were not
    /// before. Files that this process has hashed in the same state, and files that are as a plan
    /// recorded them, are not read again.
    ///
    /// # Errors
    /// Those of [`fingerprint`]; [`Error::BadInput`] for a file that changes meanwhile.
    pub(in crate::pipeline) fn fingerprint(
        &mut self,
        number: u64,
        files: &[PathBuf],
        cancel: &CancelToken,
    ) -> Result<String> {
        self.watch.add(files)?;
        let stamps: Vec<Option<Stamp>> = files.iter().map(|file| self.watch.0[file]).collect();
        if let Some(found) = self.of_plan(number, files, &stamps) {
            return Ok(found.to_owned());
        }
        static HASHED: Mutex<BTreeMap<u128, String>> = Mutex::new(BTreeMap::new());
        let lock = || HASHED.lock().unwrap_or_else(PoisonError::into_inner);
        let key = xxh3_128(format!("{files:?} {stamps:?}").as_bytes());
        let known = lock().get(&key).cloned();
        let found = known.map_or_else(|| hash_of(files, cancel), Ok)?;
        files.iter().zip(&stamps).try_for_each(|(file, &stamp)| unchanged(file, stamp))?;
        lock().insert(key, found.clone());
        Ok(found)
    }

    /// As [`Inputs::fingerprint`]; for a volume that a program gives, a hash of its samples.
    ///
    /// # Errors
    /// Those of [`Inputs::fingerprint`], and of reading the samples.
    pub(in crate::pipeline) fn of_source(
        &mut self,
        number: u64,
        source: &StepSource,
        files: &[PathBuf],
        cancel: &CancelToken,
    ) -> Result<String> {
        match source.given_hash(cancel)? {
            Some(hash) => Ok(hash),
            None => {
                // Of these servers have just told.
                for (file, stamp) in source.read_from_servers()? {
                    self.watch.0.entry(file).or_insert(stamp);
                }
                self.fingerprint(number, files, cancel)
            }
        }
    }

    fn of_plan(&self, number: u64, files: &[PathBuf], stamps: &[Option<Stamp>]) -> Option<&'a str> {
        let (known, fingerprints) = self.planned.as_ref()?;
        let is_known = |(file, &stamp): (&PathBuf, _)| {
            let found = recorded(file, stamp);
            known.binary_search_by(|k| k.path.cmp(&found.path)).is_ok_and(|at| known[at] == found)
        };
        fingerprints.get(&number).copied().filter(|_| files.iter().zip(stamps).all(is_known))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::io::{Seek, SeekFrom, Write};

    #[test]
    fn every_byte_and_every_length_matters() {
        let dir = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = (0..3).map(|i| dir.path().join(format!("{i}"))).collect();
        for (n, file) in (0u8..).zip(&files) {
            std::fs::write(file, vec![n; 100]).unwrap();
        }
        let whole = fingerprint(&files).unwrap();
        assert_eq!(whole, fingerprint(&files).unwrap());
        let mut expected = vec![];
        for n in 0u8..3 {
            expected.extend(100u64.to_le_bytes());
            expected.extend([n; 100]);
        }
        assert_eq!(whole, format!("{:032x}", xxh3_128(&expected)), "as the format tells");
        // A byte goes from the end of one file to the start of the next.
        std::fs::write(&files[0], [0; 99]).unwrap();
        assert_ne!(whole, fingerprint(&files).unwrap());
        std::fs::remove_file(&files[0]).unwrap();
        let without = fingerprint(&files).unwrap();
        assert_ne!(without, fingerprint(&files[1..]).unwrap(), "a file that is missing");
        std::fs::write(&files[0], []).unwrap();
        assert_ne!(without, fingerprint(&files).unwrap(), "an empty one");
    }

    #[test]
    fn a_byte_in_the_middle_of_a_large_file_matters() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("large");
        let mut file = File::create(&path).unwrap();
        file.set_len(40 << 20).unwrap();
        let files = [path];
        let before = fingerprint(&files).unwrap();
        // Between the pieces that were looked at once.
        file.seek(SeekFrom::Start((20 << 20) + 300_000)).unwrap();
        file.write_all(&[1]).unwrap();
        assert_ne!(before, fingerprint(&files).unwrap());
    }

    #[test]
    fn changes_are_noticed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let files = [path.clone(), dir.path().join("none")];
        let rewrite = |text: &str| {
            std::fs::write(&path, text).unwrap();
            // The clock of a file system may tick every few milliseconds.
            std::thread::sleep(std::time::Duration::from_millis(30));
        };
        rewrite("one");
        let mut inputs = Inputs::default();
        let cancel = CancelToken::new();
        let first = inputs.fingerprint(0, &files, &cancel).unwrap();
        inputs.watch.check().unwrap();
        let records = inputs.watch.records();
        let planned = || Inputs::planned(&records, [(0, "of the plan")].into());
        assert_eq!(planned().fingerprint(0, &files, &cancel).unwrap(), "of the plan");
        assert_eq!(planned().fingerprint(1, &files, &cancel).unwrap(), first, "another step");
        rewrite("two");
        let line = inputs.watch.check().unwrap_err().to_string();
        assert!(line.contains("changed since then") && line.contains("run the same command again"), "{line}");
        assert!(inputs.fingerprint(0, &files, &cancel).is_err());
        assert_ne!(planned().fingerprint(0, &files, &cancel).unwrap(), "of the plan");
        rewrite("one");
        assert!(inputs.watch.check().is_err(), "the same bytes, written anew");
        assert_eq!(Inputs::default().fingerprint(0, &files, &cancel).unwrap(), first);
        std::fs::remove_file(&path).unwrap();
        assert!(inputs.watch.check().unwrap_err().to_string().contains("no file"));
    }
}
