//! What isospan knows of a format that it reads.

use super::coordinates::GridCoordinates;
use super::hdf5_head;
use super::packed::PackedFrames;
use super::stream::Codec;
use super::{Frames, OpenOptions};
use crate::bytes::{ByteSource, IoMode};
use crate::cells::CellMesh;
use crate::error::{Error, Result};
use crate::volume::{VolumeInfo, VolumeSource};
use std::collections::HashMap;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

/// First bytes of a file that a format is found by.
const HEAD: u64 = 4096;
/// First bytes of a gzip file that are unpacked.
const UNZIPPED: u64 = 512;

/// Whether a file that begins so is HDF5, maybe behind a block of the user's: MATLAB writes one of
/// 512 bytes.
pub fn is_hdf5(bytes: &[u8]) -> bool {
    let begins = |at: usize| bytes.get(at..).is_some_and(|rest| rest.starts_with(hdf5_head::SIGNATURE));
    [0, 512, 1024, 2048].into_iter().any(begins)
}

/// The beginning of a file, or a folder.
pub(in crate::formats) struct Head<'a> {
    /// Where it is.
    pub(in crate::formats) path: &'a Path,
    /// Its first bytes; none of a folder.
    pub(in crate::formats) bytes: Vec<u8>,
    /// Whether it is a folder; on a server, one with metadata of Zarr.
    pub(in crate::formats) is_folder: bool,
    source: Option<Arc<ByteSource>>,
}

impl<'a> Head<'a> {
    /// Looks at what a path names.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read; [`Error::BadInput`] for an empty file.
    pub(in crate::formats) fn of(path: &'a Path, io: IoMode) -> Result<Self> {
        if path.is_dir() {
            return Ok(Self::of_folder(path));
        }
        let source = ByteSource::open(path, io)?;
        let mut bytes = vec![0; source.len().min(HEAD) as usize];
        source.read_at(0, &mut bytes)?;
        Ok(Self { path, bytes, is_folder: false, source: Some(Arc::new(source)) })
    }

    /// Whether it is HDF5.
    pub(in crate::formats) fn is_hdf5(&self) -> bool {
        is_hdf5(&self.bytes)
    }

    /// The file, where it is one.
    pub(in crate::formats) fn source(&self) -> Option<&Arc<ByteSource>> {
        self.source.as_ref()
    }

    pub(in crate::formats) fn of_folder(path: &'a Path) -> Self {
        Self { path, bytes: vec![], is_folder: true, source: None }
    }

    /// The first bytes of a gzip file, decoded; fewer where it is damaged, which its own reader
    /// will report, and none of other files.
    pub(in crate::formats) fn unzipped(&self) -> Vec<u8> {
        let mut head = vec![];
        let Some(source) = self.source.as_ref().filter(|_| self.bytes.starts_with(&[0x1f, 0x8b])) else {
            return head;
        };
        if let Ok(decoded) = Codec::Gzip.reader(source, 0..source.len()) {
            // The bytes decoded before an error suffice.
            let _ = decoded.take(UNZIPPED).read_to_end(&mut head);
        }
        head
    }

    /// The bytes after a byte order mark and white space.
    pub(in crate::formats) fn text(&self) -> &[u8] {
        self.bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&self.bytes).trim_ascii_start()
    }
}

/// A format: how it is found, and what is in it. What a format does not have has a default.
pub(in crate::formats) trait Format: Sync {
    /// Its name, with an article.
    fn name(&self) -> &'static str;

    /// How names of its files end, in lower case.
    fn suffixes(&self) -> &'static [&'static str];

    /// Whether a file or a folder is of this format, by what is in it.
    fn is_in(&self, _: &Head<'_>) -> bool {
        false
    }

    /// Whether it is read from servers: by ranges, or chunk by chunk.
    fn is_on_servers(&self) -> bool {
        false
    }

    /// Whether a file of this format is a mesh, not a volume.
    fn is_mesh(&self, _: &Head<'_>) -> bool {
        false
    }

    /// Whether its files say where their samples lie; the user may where they do not.
    fn has_spacing(&self) -> bool {
        true
    }

    /// Whether its arrays may have channels, of which the user chooses one.
    fn has_channels(&self) -> bool {
        false
    }

    /// Whether its images may have levels, of which the user chooses one.
    fn has_scales(&self) -> bool {
        false
    }

    /// Whether a mesh has its values in a file of their own.
    fn has_value_file(&self) -> bool {
        false
    }

    /// Opens a volume.
    fn volume(&self, path: &Path, _: &OpenOptions) -> Result<VolumeSource> {
        Err(Error::bad_input(path, "kind of file", "a volume", self.name()))
    }

    /// Opens a mesh.
    fn mesh(&self, path: &Path, _: &OpenOptions) -> Result<CellMesh> {
        Err(Error::bad_input(path, "kind of file", "a mesh", self.name()))
    }

    /// The coordinates of a volume that has no spacing.
    fn coordinates(&self, _: &Path, _: &OpenOptions) -> Result<Option<GridCoordinates>> {
        Ok(None)
    }

    /// The time that a file states.
    fn time(&self, _: &Path, _: &OpenOptions) -> Result<Option<f64>> {
        Ok(None)
    }

    /// The calendar of the times that a file states, by CF's name; "" of the usual one.
    fn calendar(&self, _: &Path, _: &OpenOptions) -> Result<String> {
        Ok(String::new())
    }

    /// The steps in a file that is a series, or in its field of the name in the options.
    fn frames(&self, _: &Path, _: &OpenOptions) -> Result<Option<Frames>> {
        Ok(None)
    }

    /// The times of all fields that are steps, by their names.
    fn times(&self, _: &Path, _: &OpenOptions) -> Result<HashMap<String, f64>> {
        Ok(HashMap::new())
    }

    /// The steps of a file where reading one means to unpack those before it, and the description
    /// of the first.
    fn packed_frames(&self, _: &Path, _: &OpenOptions) -> Result<Option<(PackedFrames, VolumeInfo)>> {
        Ok(None)
    }
}
