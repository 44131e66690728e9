//! Where the files of an archive are.

use crate::archive::manifest;
use isospan_io::bytes::publish::sync_folders;
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;
use std::fs;
use std::io::ErrorKind;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Chunks a segment: about 4 M points.
const SEGMENT_CHUNKS: u64 = 16;

/// The files of one step of an archive in the folder `root`, and the mesh that it shares with the
/// others.
#[derive(Clone, Debug)]
pub(in crate::pipeline) struct Layout {
    root: PathBuf,
    chunks: u64,
    step: u64,
}

impl Layout {
    pub(in crate::pipeline) fn new(root: &Path, chunks: u64, step: u64) -> Self {
        Self { root: root.to_path_buf(), chunks, step }
    }

    /// The files of another step.
    pub(in crate::pipeline) fn at(&self, step: u64) -> Self {
        Self { step, ..self.clone() }
    }

    /// The folder of the files of all steps.
    pub(in crate::pipeline) fn steps_folder(&self) -> PathBuf {
        manifest::steps_folder(&self.root)
    }

    /// Removes all files of the step.
    pub(in crate::pipeline) fn remove_step(&self) -> Result<()> {
        let (folder, prefix) = (self.steps_folder(), manifest::step_prefix(self.step));
        let entries = match fs::read_dir(&folder) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
            entries => entries.map_err(|e| Error::io("list", &folder, e))?,
        };
        for entry in entries {
            let entry = entry.map_err(|e| Error::io("list", &folder, e))?;
            // Names of temporaries begin with a dot.
            if entry.file_name().to_string_lossy().trim_start_matches('.').starts_with(&prefix) {
                fs::remove_file(entry.path()).map_err(|e| Error::io("remove", entry.path(), e))?;
            }
        }
        Ok(())
    }

    pub(in crate::pipeline) fn root(&self) -> &Path {
        &self.root
    }

    /// Makes the folders of the mesh and of the steps.
    pub(in crate::pipeline) fn make_folders(&self) -> Result<()> {
        let make =
            |folder| fs::create_dir_all(&folder).map_err(|e| Error::io("create the folder", folder, e));
        [self.mesh_folder(), self.steps_folder()].into_iter().try_for_each(make)
    }

    /// Makes the names of all files durable that the mesh and steps have, before something names
    /// them.
    pub(in crate::pipeline) fn sync(&self) -> Result<()> {
        // Where the mesh is not stored, its folder may be missing.
        let mesh = Some(self.mesh_folder()).filter(|folder| folder.is_dir());
        sync_folders(mesh.into_iter().chain([self.steps_folder(), self.root.clone()]))
    }

    pub(in crate::pipeline) fn mesh_folder(&self) -> PathBuf {
        manifest::mesh_folder(&self.root)
    }

    pub(in crate::pipeline) fn chunk_count(&self) -> u64 {
        self.chunks
    }

    pub(in crate::pipeline) fn segment_count(&self) -> u64 {
        self.chunks.div_ceil(SEGMENT_CHUNKS)
    }

    pub(in crate::pipeline) fn chunks_of(&self, segment: u64) -> Range<u64> {
        let first = segment * SEGMENT_CHUNKS;
        first..(first + SEGMENT_CHUNKS).min(self.chunks)
    }

    /// The segment that has a chunk.
    pub(in crate::pipeline) fn segment_of(&self, chunk: ChunkId) -> u64 {
        chunk.0 / SEGMENT_CHUNKS
    }

    /// Whether a chunk is the first one of its segment.
    pub(in crate::pipeline) fn begins_segment(&self, chunk: ChunkId) -> bool {
        chunk.0.is_multiple_of(SEGMENT_CHUNKS)
    }

    pub(in crate::pipeline) fn mesh(&self, segment: u64) -> PathBuf {
        manifest::mesh_segment_path(&self.root, segment)
    }

    pub(in crate::pipeline) fn values(&self, segment: u64) -> PathBuf {
        manifest::values_segment_path(&self.root, self.step, segment)
    }

    /// What chunks add to sums over all, until the step is finished.
    pub(in crate::pipeline) fn sums(&self, segment: u64) -> PathBuf {
        manifest::sums_segment_path(&self.root, self.step, segment)
    }

    /// Low coefficients of a pyramid, until its coarse levels are made.
    pub(in crate::pipeline) fn low(&self, segment: u64) -> PathBuf {
        manifest::low_segment_path(&self.root, self.step, segment)
    }

    /// The coarse levels of a pyramid.
    pub(in crate::pipeline) fn coarse(&self) -> PathBuf {
        manifest::coarse_path(&self.root, self.step)
    }

    /// Ranges and corrections of a pyramid.
    pub(in crate::pipeline) fn ranges(&self, segment: u64) -> PathBuf {
        manifest::ranges_segment_path(&self.root, self.step, segment)
    }

    pub(in crate::pipeline) fn index(&self) -> PathBuf {
        manifest::index_path(&self.root, self.step)
    }

    pub(in crate::pipeline) fn coordinates(&self) -> PathBuf {
        manifest::coordinates_path(&self.root, self.step)
    }

    pub(in crate::pipeline) fn spectrum(&self) -> PathBuf {
        manifest::spectrum_path(&self.root, self.step)
    }
}

/// Bytes of all files below a folder.
pub(in crate::pipeline) fn folder_bytes(folder: &Path) -> Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder).map_err(|e| Error::io("list", folder, e))? {
        let entry = entry.map_err(|e| Error::io("list", folder, e))?;
        let meta = entry.metadata().map_err(|e| Error::io("look at", entry.path(), e))?;
        bytes += match meta.is_dir() {
            true => folder_bytes(&entry.path())?,
            false => meta.len(),
        };
    }
    Ok(bytes)
}
