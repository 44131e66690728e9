//! Where the files of an archive are.

use crate::archive::manifest::{self, StepPlan};
use crate::archive::publish::sync_folders;
use crate::error::Result;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Chunks a segment: about 4 M points.
const SEGMENT_CHUNKS: u64 = 16;

/// The files of one step of an archive in the folder `root`, and the mesh that it shares with the others.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    root: PathBuf,
    chunks: u64,
    step: u64,
}

impl Layout {
    pub(crate) fn new(root: &Path, chunks: u64, step: u64) -> Self {
        Self { root: root.to_path_buf(), chunks, step }
    }

    /// The files of another step.
    pub(crate) fn at(&self, step: u64) -> Self {
        Self { step, ..self.clone() }
    }

    /// The folder of the step.
    pub(crate) fn step_folder(&self) -> PathBuf {
        manifest::step_folder(&self.root, self.step)
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// Makes the names of all files durable that the mesh and these steps have, before something names them. A shard without segments has made no folder
    /// of its steps.
    pub(crate) fn sync<'a>(&self, steps: impl IntoIterator<Item = &'a StepPlan>) -> Result<()> {
        let mesh = self.mesh(0).parent().map(Path::to_path_buf);
        let of_steps: Vec<PathBuf> =
            steps.into_iter().map(|step| self.at(step.number).step_folder()).collect();
        let all = of_steps.first().and_then(|folder| folder.parent()).map(Path::to_path_buf);
        let folders = mesh.into_iter().chain(of_steps).chain(all).chain([self.root.clone()]);
        sync_folders(folders.filter(|folder| folder.exists()))
    }

    pub(crate) fn segment_count(&self) -> u64 {
        self.chunks.div_ceil(SEGMENT_CHUNKS)
    }

    pub(crate) fn chunks_of(&self, segment: u64) -> Range<u64> {
        let first = segment * SEGMENT_CHUNKS;
        first..(first + SEGMENT_CHUNKS).min(self.chunks)
    }

    pub(crate) fn mesh(&self, segment: u64) -> PathBuf {
        manifest::mesh_segment_path(&self.root, segment)
    }

    pub(crate) fn values(&self, segment: u64) -> PathBuf {
        manifest::values_segment_path(&self.root, self.step, segment)
    }

    pub(crate) fn index(&self) -> PathBuf {
        manifest::index_path(&self.root, self.step)
    }

    pub(crate) fn coordinates(&self) -> PathBuf {
        manifest::coordinates_path(&self.root, self.step)
    }

    pub(crate) fn spectrum(&self) -> PathBuf {
        manifest::spectrum_path(&self.root, self.step)
    }
}
