//! A file, a folder or a pattern that was opened: once, for all that is asked of it.

use crate::bytes::remote::is_remote;
use crate::bytes::stamp::Stamp;
use crate::cells::CellMesh;
use crate::error::{Error, Result};
use crate::exec::CancelToken;
use crate::formats::kinds::{found, head_of, unknown};
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::format::{About, Dataset};
use crate::formats::shared::packed::UnpackedFrames;
use crate::formats::shared::{Frames, OpenOptions};
use crate::formats::volume::{folder, raw, stack};
use crate::volume::VolumeSource;
use crate::volume::chunked::refuse_many_chunks;
use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// What a file holds.
pub enum Input {
    /// A structured volume.
    Volume(VolumeSource),
    /// An unstructured mesh.
    Mesh(CellMesh),
}

/// A file, a folder or a pattern that was opened.
pub struct Opened {
    path: PathBuf,
    about: About,
    dataset: Box<dyn Dataset>,
    /// Its files, as they were.
    stamps: Vec<(PathBuf, Option<Stamp>)>,
}

/// Opens a file, a folder or a pattern of any format that is read. Of the options those count that
/// say how bytes are read, and whether there is a header.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file or an unknown kind; [`Error::Usage`] when a headerless
/// file comes without its layout, or another with one.
pub fn open(path: &Path, options: &OpenOptions) -> Result<Opened> {
    let before = Stamp::of_any(path);
    let (about, dataset) = dataset_of(path, options)?;
    let mut files = dataset.files();
    // What a server says of a folder means nothing.
    if is_remote(path) && files.is_empty() {
        files.push(path.to_path_buf());
    }
    let others = files.into_iter().filter(|file| is_remote(path) || file != path);
    let others = others.map(|file| stamp_of(&file).map(|stamp| (file, stamp)));
    let here = (!is_remote(path)).then(|| Ok((path.to_path_buf(), before)));
    let stamps = here.into_iter().chain(others).collect::<Result<_>>()?;
    Ok(Opened { path: path.to_path_buf(), about, dataset, stamps })
}

/// The stamp of a file or a folder; of a server, that of its last answer.
fn stamp_of(path: &Path) -> Result<Option<Stamp>> {
    if is_remote(path) { Stamp::of(path) } else { Ok(Stamp::of_any(path)) }
}

fn dataset_of(path: &Path, options: &OpenOptions) -> Result<(About, Box<dyn Dataset>)> {
    if stack::is_pattern(path) {
        return folder::open(path, options);
    }
    let head = head_of(path, options)?;
    match (found(&head, options), &options.raw) {
        (Some(format), Some(_)) => Err(Error::usage(format!(
            "{} is {}, which tells its own layout: leave out `dims`, `type`, `endian` and `offset`",
            path.display(),
            format.about().name
        ))),
        (Some(format), None) => Ok((*format.about(), format.open(&head)?)),
        (None, _) if head.is_folder => folder::open(path, options),
        (None, Some(_)) => Ok((raw::ABOUT, raw::open(&head)?)),
        (None, None) => Err(unknown(&head, options)),
    }
}

impl Opened {
    /// Whether it is a mesh, not a volume.
    pub fn is_mesh(&self) -> bool {
        self.dataset.is_mesh()
    }

    /// The volume or the mesh of the field that is wanted.
    ///
    /// # Errors
    /// Those of [`Opened::volume`] and [`Opened::mesh`].
    pub fn input(&self, options: &OpenOptions) -> Result<Input> {
        match self.is_mesh() {
            true => self.mesh(options).map(Input::Mesh),
            false => self.volume(options).map(Input::Volume),
        }
    }

    /// The volume of the field that is wanted.
    ///
    /// # Errors
    /// Those of [`open_volume`].
    pub fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let path = &self.path;
        if self.is_mesh() {
            return Err(self.other_kind("a volume", "a mesh"));
        }
        if options.values.is_some() {
            return Err(Error::usage(format!("{} is no mesh: leave out `value_file`", path.display())));
        }
        if options.jumps {
            return Err(Error::usage(format!("{} is no mesh: leave out `jumps`", path.display())));
        }
        if !self.about.has_channels {
            options.refuse_channel(path)?;
        }
        if !self.about.has_scales {
            options.refuse_scale(path)?;
        }
        if self.about.has_spacing {
            options.refuse_geometry(path, self.about.name)?;
        }
        let source = self.dataset.volume(options)?;
        if let VolumeSource::Chunked(chunks) = &source {
            refuse_many_chunks(path, source.info().dims, chunks.chunk_dims())?;
        }
        Ok(source)
    }

    /// The mesh with the field that is wanted.
    ///
    /// # Errors
    /// Those of [`open_mesh`].
    pub fn mesh(&self, options: &OpenOptions) -> Result<CellMesh> {
        let path = &self.path;
        if !self.is_mesh() {
            return Err(self.other_kind("a mesh", "a volume"));
        }
        if options.values.is_some() && !self.about.has_value_file {
            return Err(Error::usage(format!(
                "{} has its own fields: leave out `value_file`",
                path.display()
            )));
        }
        options.refuse_geometry(path, "a mesh")?;
        options.refuse_channel(path)?;
        options.refuse_scale(path)?;
        let mesh = self.dataset.mesh(options)?;
        match options.jumps {
            false => Ok(mesh),
            true if mesh.field().is_ok_and(|_| !mesh.is_of_cells()) => Err(Error::usage(format!(
                "{}: a value for each point may always jump between points of one place: leave out `jumps`",
                path.display()
            ))),
            true => Ok(mesh.jumping()),
        }
    }

    fn other_kind(&self, expected: &str, got: &str) -> Error {
        Error::bad_input(&self.path, "kind of file", expected, format!("{got} ({})", self.about.name))
    }

    /// The coordinates of the samples; `None` where the volume has a spacing.
    ///
    /// # Errors
    /// As [`Opened::volume`].
    pub fn coordinates(&self, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
        match self.is_mesh() || options.replaces_coordinates() {
            true => Ok(None),
            false => self.dataset.coordinates(options),
        }
    }

    /// The names of its fields with one number a sample, a point or a cell.
    pub(super) fn scalar_fields(&self, options: &OpenOptions) -> Result<Vec<String>> {
        let fields: Vec<(String, u32)> = match self.is_mesh() {
            true => {
                let mesh = self.mesh(&OpenOptions { field: None, ..options.clone() })?;
                mesh.info().fields.iter().map(|f| (f.name.clone(), f.components)).collect()
            }
            // With a pattern, any field that matches is opened.
            false => {
                let volume = self.volume(options)?;
                volume.info().fields.iter().map(|f| (f.name.clone(), f.components)).collect()
            }
        };
        Ok(fields.into_iter().filter(|(_, components)| *components == 1).map(|(name, _)| name).collect())
    }

    pub(super) fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        self.dataset.steps(options)
    }

    pub(super) fn times(&self, options: &OpenOptions) -> Result<HashMap<String, f64>> {
        self.dataset.times(options)
    }

    /// The time that the file states.
    pub(super) fn time(&self, options: &OpenOptions) -> Result<Option<f64>> {
        Ok(self.dataset.time(options)?.filter(|time| time.is_finite()))
    }

    pub(super) fn calendar(&self, options: &OpenOptions) -> Result<String> {
        self.dataset.calendar(options)
    }

    /// Bytes of all steps, unpacked, where each would be decoded from the beginning of the file;
    /// `None` of other files.
    pub(super) fn packed_bytes(&self, options: &OpenOptions) -> Result<Option<u64>> {
        self.dataset.packed_steps(options)?.map(|(steps, info)| steps.bytes(&info)).transpose()
    }

    /// Unpacks such a file, into a nameless file in `folder`.
    pub(super) fn unpack(
        &self,
        options: &OpenOptions,
        folder: &Path,
        cancel: &CancelToken,
    ) -> Result<UnpackedFrames> {
        let Some((steps, info)) = self.dataset.packed_steps(options)? else {
            return Err(Error::bad_input(&self.path, "file", "the compressed series it was", "another one"));
        };
        steps.unpack(info, folder, cancel)
    }

    /// Its files on servers, as they were when they were read.
    pub(super) fn remote_files(&self) -> impl Iterator<Item = (&Path, Option<Stamp>)> {
        self.stamps.iter().filter(|(file, _)| is_remote(file)).map(|(file, stamp)| (&**file, *stamp))
    }

    /// Whether all its files are what they were, as far as the system and servers have said.
    fn is_unchanged(&self) -> bool {
        self.stamps.iter().all(|(file, stamp)| stamp_of(file).is_ok_and(|now| now == *stamp))
    }
}

/// Files that were opened last: a question about another step or field of one does not open it
/// again.
#[derive(Default)]
pub(super) struct OpenedFiles(Mutex<Vec<(Key, Arc<Opened>)>>);

impl fmt::Debug for OpenedFiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        f.debug_list().entries(held.iter().map(|(key, _)| &key.path)).finish()
    }
}

/// What is opened, and how.
#[derive(Clone, PartialEq)]
struct Key {
    path: PathBuf,
    /// Without what questions choose.
    options: OpenOptions,
}

/// Opened files that are held, at most, and of those that have parts, parts: each may be open.
const MOST_HELD: usize = 8;
const MOST_PARTS: usize = 64;

impl OpenedFiles {
    /// A file that is open, or is opened now.
    ///
    /// # Errors
    /// Those of [`open`].
    pub(super) fn open(&self, path: &Path, options: &OpenOptions) -> Result<Arc<Opened>> {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (io, raw, formats) = (options.io, options.raw.clone(), options.formats.clone());
        let options = OpenOptions { io, raw, formats, ..OpenOptions::default() };
        let key = Key { path: path.to_path_buf(), options };
        let held = lock().iter().find(|(of, _)| *of == key).map(|(_, opened)| Arc::clone(opened));
        if let Some(held) = held.filter(|held| held.is_unchanged()) {
            return Ok(held);
        }
        let opened = Arc::new(open(path, &key.options)?);
        let mut held = lock();
        held.retain(|(of, _)| *of != key);
        held.insert(0, (key, Arc::clone(&opened)));
        let mut parts = 0;
        let fit = held.iter().take(MOST_HELD).take_while(|(_, opened)| {
            parts += opened.stamps.len();
            parts <= MOST_PARTS
        });
        let count = fit.count().max(1);
        held.truncate(count);
        Ok(opened)
    }
}

/// Opens a volume of any format that is read: a file, a folder of slices, or a pattern for the
/// names of slices.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file or an unknown kind; [`Error::Usage`] when several
/// fields ask for a choice, when a headerless file comes without its layout, or another with one,
/// or a volume with a table of values.
pub fn open_volume(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    open(path, options)?.volume(options)
}

/// Opens a volume or a mesh of any format that is read.
///
/// # Errors
/// Those of [`open_volume`] and [`open_mesh`].
pub fn open_input(path: &Path, options: &OpenOptions) -> Result<Input> {
    open(path, options)?.input(options)
}

/// Opens a mesh of any format that is read: VTU, PVTU, VTM, VTKHDF, legacy VTK, Exodus II, EnSight
/// Gold, Gmsh, TetGen, points and tetrahedra as text.
///
/// # Errors
/// [`Error::BadInput`] for a malformed file or another kind; [`Error::Usage`] when there is no
/// field of the name wanted.
pub fn open_mesh(path: &Path, options: &OpenOptions) -> Result<CellMesh> {
    open(path, options)?.mesh(options)
}
