//! An archive opened for reading: manifest, point set, grids. Segments are opened when first
//! needed.
//!
//! All of this is common to the steps. What depends on the step is in `step_view`.

use super::pools::Pools;
use crate::archive::chunked::{ChunkSegment, MeshSizes};
use crate::archive::manifest::{CoordinateRecord, MANIFEST_NAME, Manifest, SegmentRecord};
use crate::archive::segment::{PlanHash, Segment, SegmentInfo, SegmentKind};
use crate::archive::tables::{CellBoxes, CoordinateMap};
use crate::pipeline::plan::{Attachments, Layout, MeshParts, folder_bytes, parts};
use isospan_io::bytes::remote::is_remote;
use isospan_io::bytes::{IoMode, place};
use isospan_io::error::{Error, Result};
use isospan_io::grid::{ChunkGrid, ChunkId};
use isospan_mesh::points::PointSet;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Whether `path` is an archive: a folder with a manifest. Of an address that ends in ".isospan"
/// the server is not asked.
pub fn is_archive(path: &Path) -> bool {
    if is_remote(path) {
        let is_called = path.extension().is_some_and(|e| e == "isospan");
        // Where the server fails, opening the volume tells why.
        let manifest = || place::ranges_if_there(&path.join(MANIFEST_NAME), IoMode::Auto);
        return is_called || manifest().is_ok_and(|found| found.is_some());
    }
    path.is_dir() && path.join(MANIFEST_NAME).exists()
}

/// An archive opened for reading: what all its steps share. Nothing of it changes but what is
/// cached.
pub(in crate::pipeline) struct OpenArchive {
    pub(in crate::pipeline) manifest: Manifest,
    pub(in crate::pipeline) points: PointSet,
    pub(in crate::pipeline) chunks: ChunkGrid,
    /// The files of the mesh and of the first step.
    layout: Layout,
    meshes: Mutex<BTreeMap<u64, Arc<ChunkSegment>>>,
    /// Bytes read from mesh segments that are closed again.
    read_before: AtomicU64,
    /// Bytes of all files, once they were asked for.
    bytes: OnceLock<u64>,
    /// The bounds of the cells of a grid with coordinates, once they were asked for.
    pub(super) cell_boxes: OnceLock<CellBoxes>,
    /// The threads of questions that were answered.
    pub(in crate::pipeline) pools: Pools,
}

impl OpenArchive {
    pub(in crate::pipeline) fn open(root: &Path) -> Result<Arc<Self>> {
        if !is_remote(root) && !root.is_dir() {
            let got = if root.exists() { "a file" } else { "nothing" };
            return Err(Error::bad_input(root, "archive", "a folder made by isospan reduce", got));
        }
        Self::of(root, Manifest::read(root)?)
    }

    /// The archive that a manifest is of, published or not.
    pub(in crate::pipeline) fn of(root: &Path, manifest: Manifest) -> Result<Arc<Self>> {
        let bad = |at: &str, expected: String, got: String| {
            Err(Error::bad_input(root.join(MANIFEST_NAME), at, expected, got))
        };
        let attachments =
            Attachments::read_of(root, manifest.plan_hash, &manifest.plan).map_err(|e| lost(root, e))?;
        let MeshParts { points, chunks, .. } = match parts(&manifest.plan, attachments) {
            Ok(parts) => parts,
            Err(e) => return bad("plan", "a plan that can be carried out".into(), e.to_string()),
        };
        if chunks.len() != manifest.counts.chunks {
            return bad("counts.chunks", chunks.len().to_string(), manifest.counts.chunks.to_string());
        }
        if manifest.steps.is_empty() {
            return bad("steps", "at least one".into(), "none".into());
        }
        for source in manifest.all_steps().map(|s| &s.plan.source) {
            if !source.geometry.is_valid() || source.dims != manifest.plan.lattice.dims {
                return bad(
                    "source",
                    "an invertible geometry, and the dimensions of the lattice".into(),
                    format!("{source:?}"),
                );
            }
        }
        let layout = Layout::new(root, chunks.len(), manifest.steps[0].plan.number);
        // A mesh that follows by formula is not stored: the manifest was checked.
        let mesh = manifest.plan.stores_mesh().then_some(&manifest.mesh);
        for records in manifest.all_steps().map(|s| &s.values).chain(mesh) {
            let as_cut = |(n, r): (u64, &SegmentRecord)| {
                layout.chunks_of(n) == (r.first_chunk..r.first_chunk + r.chunks)
            };
            if records.len() as u64 != layout.segment_count() || !(0..).zip(records).all(as_cut) {
                let expected =
                    format!("{} segments of 16 chunks, the last of the rest", layout.segment_count());
                return bad("segments", expected, format!("{} segments, or cut otherwise", records.len()));
            }
        }
        Ok(Arc::new(Self {
            manifest,
            points,
            chunks,
            layout,
            meshes: Mutex::default(),
            read_before: AtomicU64::new(0),
            bytes: OnceLock::new(),
            cell_boxes: OnceLock::new(),
            pools: Pools::default(),
        }))
    }

    pub(in crate::pipeline) fn path(&self) -> &Path {
        self.layout.root()
    }

    /// The files of the step at a position in the manifest.
    pub(in crate::pipeline) fn layout_at(&self, position: usize) -> Layout {
        self.layout.at(self.manifest.step_at(position).plan.number)
    }

    /// The coordinates of a rectilinear or curvilinear grid; none of a volume with a spacing.
    pub(in crate::pipeline) fn coordinates(&self) -> Result<Option<CoordinateMap>> {
        let (Some(recorded), Some((path, hash))) = (self.coordinate_record(), self.coordinate_file()) else {
            return Ok(None);
        };
        let dims = self.manifest.plan.lattice.dims;
        let map = CoordinateMap::open(&path, hash, dims).map_err(|e| self.lost(e))?;
        expect_recorded(map.segment(), Some(&recorded.info))?;
        Ok(Some(map))
    }

    /// The record of the grid's coordinates: the first step that was made has it, for all steps.
    pub(in crate::pipeline) fn coordinate_record(&self) -> Option<CoordinateRecord> {
        self.manifest.coordinates().map(|(_, record)| record)
    }

    /// Their file and its hash.
    pub(super) fn coordinate_file(&self) -> Option<(PathBuf, PlanHash)> {
        let (first, _) = self.manifest.coordinates()?;
        Some((self.layout.at(first.number).coordinates(), first.hash(self.manifest.plan_hash)))
    }

    /// Refuses a question that is not answered for grids with coordinates of their own.
    pub(in crate::pipeline) fn refuse_coordinates(&self, question: &str) -> Result<()> {
        match self.coordinate_record() {
            None => Ok(()),
            Some(_) => Err(Error::usage(format!(
                "{}: of a rectilinear or curvilinear grid, to which {question} is not made",
                self.path().display()
            ))),
        }
    }

    /// Bytes of all files of the archive. Where files cannot be listed,
    /// these are the files that the manifest names.
    pub(in crate::pipeline) fn file_bytes(&self) -> Result<u64> {
        if let Some(&bytes) = self.bytes.get() {
            return Ok(bytes);
        }
        let bytes = if is_remote(self.path()) { self.listed_bytes() } else { folder_bytes(self.path())? };
        Ok(*self.bytes.get_or_init(|| bytes))
    }

    /// Bytes of the files that the manifest lists, and of the manifest.
    fn listed_bytes(&self) -> u64 {
        let m = &self.manifest;
        let of_steps = m.all_steps().flat_map(|s| {
            let others = [s.index, s.spectrum, s.coarse, s.coordinates.map(|c| c.info)];
            s.values.iter().chain(&s.ranges).map(|v| v.info).chain(others.into_iter().flatten())
        });
        m.mesh.iter().map(|r| r.info).chain(of_steps).map(|f| f.bytes).sum::<u64>()
            + m.to_bytes().len() as u64
    }

    /// Bytes of the manifest.
    pub(in crate::pipeline) fn manifest_bytes(&self) -> Result<u64> {
        if is_remote(self.path()) {
            return Ok(self.manifest.to_bytes().len() as u64);
        }
        let file = self.layout.root().join(MANIFEST_NAME);
        Ok(std::fs::metadata(&file).map_err(|e| Error::io("look at", &file, e))?.len())
    }

    /// Refuses a question about tetrahedra that the archive does not have.
    pub(super) fn expect_tetrahedra(&self) -> Result<()> {
        if !self.manifest.plan.is_pyramid() {
            return Ok(());
        }
        Err(Error::usage(format!(
            "{} is a pyramid of samples, which has no tetrahedra: isospan export writes its samples, \
             isospan surface its isosurfaces",
            self.path().display()
        )))
    }

    /// The mesh segment of a number.
    pub(super) fn mesh_segment(&self, number: u64) -> Result<Arc<ChunkSegment>> {
        self.expect_tetrahedra()?;
        let mut open = self.meshes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(segment) = open.get(&number) {
            return Ok(Arc::clone(segment));
        }
        let (path, hash) = (self.layout.mesh(number), self.manifest.plan_hash);
        let record = self.manifest.mesh.get(number as usize);
        let segment = Arc::new(self.chunk_segment(&path, SegmentKind::Mesh, hash, number, record)?);
        open.insert(number, Arc::clone(&segment));
        Ok(segment)
    }

    /// Opens the file of a range of chunks that a record is of.
    pub(super) fn chunk_segment(
        &self,
        path: &Path,
        kind: SegmentKind,
        hash: PlanHash,
        number: u64,
        record: Option<&SegmentRecord>,
    ) -> Result<ChunkSegment> {
        let file = ChunkSegment::open(path, kind, Some(hash)).map_err(|e| self.lost(e))?;
        let wanted = self.layout.chunks_of(number);
        if file.chunks() != wanted {
            let got = format!("{:?}", file.chunks());
            return Err(Error::bad_input(path, "chunk table", format!("chunks {wanted:?}"), got));
        }
        expect_recorded(file.segment(), record.map(|r| &r.info))?;
        Ok(file)
    }

    /// The mesh segment that has a chunk, where the mesh is stored.
    pub(in crate::pipeline) fn mesh_of(&self, chunk: ChunkId) -> Result<Arc<ChunkSegment>> {
        self.mesh_segment(self.layout.segment_of(chunk))
    }

    /// The sizes of a chunk's mesh.
    pub(in crate::pipeline) fn mesh_sizes(&self, chunk: ChunkId) -> Result<MeshSizes> {
        Ok(self.mesh_of(chunk)?.mesh_summary(chunk)?.sizes)
    }

    /// A file that is not there makes the archive incomplete, which the same reduction repairs.
    pub(super) fn lost(&self, error: Error) -> Error {
        lost(self.layout.root(), error)
    }

    /// Bytes read so far from all mesh segments.
    pub(super) fn mesh_bytes_read(&self) -> u64 {
        let open = self.meshes.lock().unwrap_or_else(PoisonError::into_inner);
        self.read_before.load(Ordering::Relaxed) + bytes_read(open.values())
    }

    /// Closes the mesh segments before one.
    pub(super) fn close_meshes_before(&self, number: u64) {
        let mut open = self.meshes.lock().unwrap_or_else(PoisonError::into_inner);
        let later = open.split_off(&number);
        let closed = std::mem::replace(&mut *open, later);
        self.read_before.fetch_add(bytes_read(closed.values()), Ordering::Relaxed);
    }
}

/// Bytes read so far from some segments.
pub(super) fn bytes_read<'a>(segments: impl Iterator<Item = &'a Arc<ChunkSegment>>) -> u64 {
    segments.map(|s| s.segment().bytes_read()).sum()
}

/// A file of the archive `root` that is not there makes it incomplete.
fn lost(root: &Path, error: Error) -> Error {
    match error {
        Error::Io { path, source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
            let name = path.strip_prefix(root).unwrap_or(&path).display().to_string();
            Error::Incomplete { path: root.to_path_buf(), missing: vec![name] }
        }
        other => other,
    }
}

impl OpenArchive {
    /// Whether the archive is a pyramid.
    pub(in crate::pipeline) fn is_pyramid(&self) -> bool {
        self.manifest.plan.is_pyramid()
    }
}

/// A segment is the one that the manifest was written for, and not a valid one with other content.
pub(super) fn expect_recorded(segment: &Segment, recorded: Option<&SegmentInfo>) -> Result<()> {
    let found = segment.info();
    if recorded == Some(&found) {
        return Ok(());
    }
    let text = |i: &SegmentInfo| {
        format!("{} bytes, {} blocks, content hash {:016x}", i.bytes, i.blocks, i.content_hash)
    };
    let expected = recorded.map_or_else(|| "no such segment".to_owned(), text);
    Err(Error::bad_input(segment.path(), "length, blocks and hash in the manifest", expected, text(&found))
        .with_help(
            "the file is not this archive's: restore it, or delete it and run the same reduction again",
        ))
}
