//! A format: how its files are found and opened, and what an open one answers.
//!
//! ```text
//!  Head: first bytes, name ─▶ Format::is_in ─▶ Format::open ─▶ Dataset ─▶ volume, mesh, coordinates
//!                                                                    └──▶ steps, times
//! ```
//!
//! A file is opened and its header parsed once. The [`Dataset`] then answers for all its fields and
//! steps; options of each question choose among them.

use super::coordinates::GridCoordinates;
use super::hdf5_head;
use super::packed::PackedFrames;
use super::small::SmallFiles;
use super::stream::Codec;
use super::{Frames, OpenOptions};
use crate::bytes::{ByteSource, IoMode};
use crate::cells::CellMesh;
use crate::error::{Error, Result};
use crate::volume::{VolumeInfo, VolumeSource};
use std::collections::HashMap;
use std::fmt;
use std::io::Read;
use std::path::{Path, PathBuf};
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

/// What is known of all files of a format.
#[derive(Clone, Copy, Debug)]
pub struct About {
    /// Its name, with an article: "an NRRD file".
    pub name: &'static str,
    /// What lists of formats call its volumes; empty where it has none.
    pub volumes: &'static [&'static str],
    /// What lists of formats call its meshes; empty where it has none.
    pub meshes: &'static [&'static str],
    /// How names of its files end, in lower case.
    pub suffixes: &'static [&'static str],
    /// First bytes of its files: any of these.
    pub magic: &'static [&'static [u8]],
    /// Whether it is read from servers: by ranges, or chunk by chunk.
    pub on_servers: bool,
    /// Whether its files say where their samples lie. The user may where they do not.
    pub has_spacing: bool,
    /// Whether its arrays may have channels, of which the user chooses one.
    pub has_channels: bool,
    /// Whether its images may have levels, of which the user chooses one.
    pub has_scales: bool,
    /// Whether a mesh has its values in a file of their own.
    pub has_value_file: bool,
}

impl About {
    /// A format of a name, with an article; the rest is to be filled in. Its files say where their
    /// samples lie.
    pub const fn named(name: &'static str) -> Self {
        Self {
            name,
            volumes: &[],
            meshes: &[],
            suffixes: &[],
            magic: &[],
            on_servers: false,
            has_spacing: true,
            has_channels: false,
            has_scales: false,
            has_value_file: false,
        }
    }
}

/// A format of files or folders. [`OpenOptions::with_format`] adds one to those that are read.
pub trait Format: Send + Sync {
    /// What is known of all its files.
    fn about(&self) -> &About;

    /// Whether a file or a folder is of this format, by what is in it: by default, whether it
    /// begins with one of [`About::magic`]. A file that no format finds so is found by the end of
    /// its name.
    fn is_in(&self, head: &Head<'_>) -> bool {
        self.about().magic.iter().any(|magic| head.bytes.starts_with(magic))
    }

    /// Opens a file or a folder, and parses its header.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a malformed one; [`Error::Io`] when it cannot be read.
    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>>;
}

/// A file or a folder that is open. Its volume or its mesh, steps and coordinates are those of the
/// field that the options of each question choose; [`OpenOptions::io`] is that of the opening.
pub trait Dataset: Send + Sync {
    /// Whether it is a mesh, not a volume.
    fn is_mesh(&self) -> bool {
        false
    }

    /// The files of which it has parsed something or which it holds open, beside the one that was
    /// named. Where one of them has changed, all is opened anew.
    fn files(&self) -> Vec<PathBuf> {
        vec![]
    }

    /// The volume of the field that is wanted. Not asked of a mesh.
    ///
    /// # Errors
    /// [`Error::BadInput`] for malformed data; [`Error::Usage`] when several fields ask for a
    /// choice.
    fn volume(&self, _: &OpenOptions) -> Result<VolumeSource> {
        Err(Error::usage("the format has meshes alone"))
    }

    /// The mesh with the field that is wanted. Asked of a mesh alone.
    ///
    /// # Errors
    /// [`Error::BadInput`] for malformed data; [`Error::Usage`] when there is no field of the name
    /// wanted.
    fn mesh(&self, _: &OpenOptions) -> Result<CellMesh> {
        Err(Error::usage("the format has volumes alone"))
    }

    /// The coordinates of a volume that has no spacing.
    ///
    /// # Errors
    /// As [`Dataset::volume`].
    fn coordinates(&self, _: &OpenOptions) -> Result<Option<GridCoordinates>> {
        Ok(None)
    }

    /// The steps of a series, or of its field of the name in the options: their fields, and their
    /// times where these are known. None where there is one volume or mesh.
    ///
    /// # Errors
    /// [`Error::BadInput`] for malformed data.
    fn steps(&self, _: &OpenOptions) -> Result<Frames> {
        Ok(vec![])
    }

    /// The times of all fields that are steps, by their names.
    ///
    /// # Errors
    /// [`Error::BadInput`] for malformed data.
    fn times(&self, _: &OpenOptions) -> Result<HashMap<String, f64>> {
        Ok(HashMap::new())
    }

    /// The time that is stated for the field that is wanted.
    ///
    /// # Errors
    /// [`Error::BadInput`] for malformed data.
    fn time(&self, _: &OpenOptions) -> Result<Option<f64>> {
        Ok(None)
    }

    /// The calendar of the times, by CF's name; "" of the usual one.
    ///
    /// # Errors
    /// [`Error::BadInput`] for malformed data.
    fn calendar(&self, _: &OpenOptions) -> Result<String> {
        Ok(String::new())
    }

    /// The steps where reading one means to unpack those before it, and the description of the
    /// first.
    ///
    /// # Errors
    /// As [`Dataset::volume`].
    fn packed_steps(&self, _: &OpenOptions) -> Result<Option<(PackedFrames, VolumeInfo)>> {
        Ok(None)
    }
}

/// The beginning of a file, or a folder.
pub struct Head<'a> {
    /// Where it is.
    pub path: &'a Path,
    /// Its first bytes, 4096 at most; none of a folder.
    pub bytes: Vec<u8>,
    /// Whether it is a folder; on a server, one with metadata of Zarr.
    pub is_folder: bool,
    /// How further files are to be read.
    pub io: IoMode,
    source: Option<Arc<ByteSource>>,
    small: Arc<SmallFiles>,
}

impl<'a> Head<'a> {
    /// Looks at what a path names.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read; [`Error::BadInput`] for an empty file.
    pub(in crate::formats) fn of(path: &'a Path, io: IoMode) -> Result<Self> {
        if path.is_dir() {
            return Ok(Self::of_folder(path, io, Arc::default()));
        }
        let source = ByteSource::open(path, io)?;
        let mut bytes = vec![0; source.len().min(HEAD) as usize];
        source.read_at(0, &mut bytes)?;
        let source = Some(Arc::new(source));
        Ok(Self { path, bytes, is_folder: false, io, source, small: Arc::default() })
    }

    /// Whether it is HDF5.
    pub(in crate::formats) fn is_hdf5(&self) -> bool {
        is_hdf5(&self.bytes)
    }

    /// The file, where it is one.
    pub fn source(&self) -> Option<&Arc<ByteSource>> {
        self.source.as_ref()
    }

    /// The file.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a folder.
    pub fn file(&self) -> Result<&Arc<ByteSource>> {
        self.source.as_ref().ok_or_else(|| Error::bad_input(self.path, "kind of file", "a file", "a folder"))
    }

    /// The small files of a folder that were read to find its format.
    pub(in crate::formats) fn small(&self) -> &Arc<SmallFiles> {
        &self.small
    }

    pub(in crate::formats) fn of_folder(path: &'a Path, io: IoMode, small: Arc<SmallFiles>) -> Self {
        Self { path, bytes: vec![], is_folder: true, io, source: None, small }
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

/// Formats that a program adds to those that are read.
#[derive(Clone, Default)]
pub struct Registry(Vec<Arc<dyn Format>>);

impl Registry {
    /// The same with another format, which is looked for before all others.
    #[must_use]
    pub fn with(mut self, format: Arc<dyn Format>) -> Self {
        self.0.insert(0, format);
        self
    }

    /// The formats, those that were added last first.
    pub fn formats(&self) -> impl Iterator<Item = &dyn Format> {
        self.0.iter().map(|format| &**format)
    }
}

impl PartialEq for Registry {
    fn eq(&self, other: &Self) -> bool {
        self.0.len() == other.0.len() && self.0.iter().zip(&other.0).all(|(a, b)| Arc::ptr_eq(a, b))
    }
}

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.formats().map(|format| format.about().name)).finish()
    }
}
