//! A file with a mesh. All its fields share what was found out about its cells.

use super::OpenOptions;
use super::format::Dataset;
use crate::cells::{CellFile, CellMesh};
use crate::error::Result;
use std::path::PathBuf;
use std::sync::Arc;

/// A file whose mesh is asked for by the names of its fields.
pub(in crate::formats) struct MeshFile<F> {
    pub(in crate::formats) file: Arc<F>,
    mesh: CellMesh,
}

impl<F: CellFile + 'static> MeshFile<F> {
    /// # Errors
    /// Those of [`CellMesh::new`].
    pub(in crate::formats) fn new(file: F) -> Result<Self> {
        let file = Arc::new(file);
        let mesh = CellMesh::new(Arc::clone(&file) as Arc<dyn CellFile>, None)?;
        Ok(Self { file, mesh })
    }

    /// The mesh with the field that is wanted.
    ///
    /// # Errors
    /// Those of [`CellMesh::new`].
    pub(in crate::formats) fn of_field(&self, options: &OpenOptions) -> Result<CellMesh> {
        match &options.field {
            Some(name) => self.mesh.with_field(name),
            None => Ok(self.mesh.clone()),
        }
    }

    /// The files that hold the mesh.
    pub(in crate::formats) fn data_files(&self) -> Vec<PathBuf> {
        self.file.info().data_files.clone()
    }
}

/// A mesh that no time is known of.
pub(in crate::formats) struct PlainMesh<F>(pub(in crate::formats) MeshFile<F>);

impl<F: CellFile + 'static> Dataset for PlainMesh<F> {
    fn is_mesh(&self) -> bool {
        true
    }

    fn files(&self) -> Vec<PathBuf> {
        self.0.data_files()
    }

    fn mesh(&self, options: &OpenOptions) -> Result<CellMesh> {
        self.0.of_field(options)
    }
}
