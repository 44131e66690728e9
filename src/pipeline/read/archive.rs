//! An archive opened for reading: manifest, point set, grids; segments are opened when first needed.

use super::block_cache::BlockCache;
use super::choice::{StepChoice, View};
use super::pools::{BufferPool, Pools};
use crate::archive::chunked::ChunkSegment;
use crate::archive::coordinates::CoordinateMap;
use crate::archive::manifest::{CoordinateRecord, MANIFEST_NAME, Manifest, SegmentRecord, Step};
use crate::archive::segment::{PlanHash, Segment, SegmentInfo, SegmentKind};
use crate::archive::unpacked::Unpacked;
use crate::bytes::remote::is_remote;
use crate::error::{Error, Result};
use crate::grid::{ChunkGrid, ChunkId};
use crate::index::{SpanIndex, index_entries};
use crate::mesh::bcc::{BccChunk, BccMesh};
use crate::pipeline::plan::{Attachments, Layout, MeshParts, folder_bytes, parts};
use crate::points::PointSet;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Whether `path` is an archive: a folder with a manifest. Nothing else is read from an object store or a web server.
pub fn is_archive(path: &Path) -> bool {
    is_remote(path) || path.is_dir() && path.join(MANIFEST_NAME).exists()
}

/// The two files that hold a range of chunks at the step that is looked at.
pub(in crate::pipeline) struct OpenSegment {
    pub(in crate::pipeline) mesh: ChunkSegment,
    pub(in crate::pipeline) values: Arc<ChunkSegment>,
}

/// An archive opened for reading.
pub(in crate::pipeline) struct OpenArchive {
    pub(in crate::pipeline) manifest: Manifest,
    pub(in crate::pipeline) points: PointSet,
    pub(in crate::pipeline) chunks: ChunkGrid,
    /// The mesh, where it follows by formula.
    pub(super) bcc: Option<BccMesh>,
    /// The files of the step that is looked at.
    pub(in crate::pipeline) layout: Layout,
    pub(in crate::pipeline) view: View,
    segments: Mutex<BTreeMap<u64, Arc<OpenSegment>>>,
    /// Value segments by number and position of the step: those of `segments`, and of steps that are needed besides.
    values: Mutex<BTreeMap<(u64, usize), Arc<ChunkSegment>>>,
    /// Bytes read from segments that are closed again.
    read_before: AtomicU64,
    /// Bytes of all files, once they were asked for.
    bytes: OnceLock<u64>,
    /// Blocks that are kept for the next question.
    pub(in crate::pipeline) cache: BlockCache,
    /// The unpacked blocks of the step, once they were looked for.
    pub(in crate::pipeline) unpacked: OnceLock<Option<Unpacked>>,
    /// Buffers for it, while blocks are kept.
    pub(in crate::pipeline) spare: BufferPool,
    /// The threads of questions that were answered.
    pub(in crate::pipeline) pools: Pools,
}

impl OpenArchive {
    pub(in crate::pipeline) fn open(root: &Path) -> Result<Self> {
        Self::open_at(root, StepChoice::First)
    }

    pub(in crate::pipeline) fn open_at(root: &Path, choice: StepChoice) -> Result<Self> {
        if !is_remote(root) && !root.is_dir() {
            let got = if root.exists() { "a file" } else { "nothing" };
            return Err(Error::bad_input(root, "archive", "a folder made by isospan reduce", got));
        }
        Self::of(root, Manifest::read(root)?, choice)
    }

    /// The archive that a manifest is of, published or not.
    pub(in crate::pipeline) fn of(root: &Path, manifest: Manifest, choice: StepChoice) -> Result<Self> {
        let bad = |at: &str, expected: String, got: String| {
            Err(Error::bad_input(root.join(MANIFEST_NAME), at, expected, got))
        };
        let attachments =
            Attachments::read_of(root, manifest.plan_hash, &manifest.plan).map_err(|e| lost(root, e))?;
        let MeshParts { points, chunks, bcc, .. } = match parts(&manifest.plan, attachments) {
            Ok(parts) => parts,
            Err(e) => return bad("plan", "a plan that can be carried out".into(), e.to_string()),
        };
        if chunks.len() != manifest.counts.chunks {
            return bad("counts.chunks", chunks.len().to_string(), manifest.counts.chunks.to_string());
        }
        if manifest.steps.is_empty() {
            return bad("steps", "at least one".into(), "none".into());
        }
        for source in manifest.steps.iter().map(|s| &s.plan.source) {
            if !source.geometry.is_valid() || source.dims != manifest.plan.lattice.dims {
                return bad(
                    "source",
                    "an invertible geometry, and the dimensions of the lattice".into(),
                    format!("{source:?}"),
                );
            }
        }
        let view = View::of(&manifest, choice, root)?;
        let layout = Layout::new(root, chunks.len(), manifest.steps[view.step].plan.number);
        for records in manifest.steps.iter().map(|s| &s.values).chain([&manifest.mesh]) {
            let as_cut = |(n, r): (u64, &SegmentRecord)| {
                layout.chunks_of(n) == (r.first_chunk..r.first_chunk + r.chunks)
            };
            if records.len() as u64 != layout.segment_count() || !(0..).zip(records).all(as_cut) {
                let expected =
                    format!("{} segments of 16 chunks, the last of the rest", layout.segment_count());
                return bad("segments", expected, format!("{} segments, or cut otherwise", records.len()));
            }
        }
        Ok(Self {
            manifest,
            points,
            chunks,
            bcc,
            layout,
            view,
            segments: Mutex::default(),
            values: Mutex::default(),
            read_before: AtomicU64::new(0),
            bytes: OnceLock::new(),
            cache: BlockCache::default(),
            unpacked: OnceLock::new(),
            spare: BufferPool::default(),
            pools: Pools::default(),
        })
    }

    /// The same, which keeps up to about so many bytes of decoded blocks.
    pub(in crate::pipeline) fn keeping(self, bytes: usize) -> Self {
        Self { cache: BlockCache::new(bytes), ..self }
    }

    pub(in crate::pipeline) fn path(&self) -> &Path {
        self.layout.root()
    }

    /// The step that is looked at, or the one before the moment that is.
    pub(in crate::pipeline) fn step(&self) -> &Step {
        &self.manifest.steps[self.view.step]
    }

    pub(super) fn step_hash(&self) -> PlanHash {
        self.step().plan.hash(self.manifest.plan_hash)
    }

    /// The index; of a small archive made of the ranges that its only chunk tells.
    pub(in crate::pipeline) fn index(&self) -> Result<SpanIndex> {
        let Some(recorded) = &self.step().index else {
            let summary = self.only_values()?.value_summary(ChunkId(0))?;
            return Ok(SpanIndex::of_entries(index_entries(0, &summary.ranges).collect()));
        };
        let index = SpanIndex::open(self.layout.index(), Some(self.step_hash())).map_err(|e| self.lost(e))?;
        index.segment().map_or(Ok(()), |file| expect_recorded(file, Some(recorded)))?;
        Ok(index)
    }

    /// The coordinates of a rectilinear or curvilinear grid; none of a volume with a spacing.
    pub(in crate::pipeline) fn coordinates(&self) -> Result<Option<CoordinateMap>> {
        let (Some(recorded), Some((path, hash))) = (self.coordinate_record(), self.coordinate_file()) else {
            return Ok(None);
        };
        let dims = self.step().plan.source.dims;
        let map = CoordinateMap::open(&path, hash, dims).map_err(|e| self.lost(e))?;
        expect_recorded(map.segment(), Some(&recorded.info))?;
        Ok(Some(map))
    }

    /// What is recorded of the grid's coordinates: with the first step, for all.
    pub(in crate::pipeline) fn coordinate_record(&self) -> Option<CoordinateRecord> {
        self.manifest.steps[0].coordinates
    }

    /// Their file and its hash.
    pub(super) fn coordinate_file(&self) -> Option<(PathBuf, PlanHash)> {
        let first = &self.manifest.steps[0].plan;
        let file = (self.layout.at(first.number).coordinates(), first.hash(self.manifest.plan_hash));
        self.coordinate_record().map(|_| file)
    }

    /// Looks at the step at a position in the manifest.
    pub(in crate::pipeline) fn turn_to(&mut self, step: usize) {
        self.view = View { step, beyond: None };
        (self.cache, self.spare) = (BlockCache::default(), BufferPool::default());
        let unpacked = std::mem::take(&mut self.unpacked).into_inner().flatten();
        let read = unpacked.map_or(0, |file| file.segment().bytes_read());
        self.read_before.fetch_add(read, Ordering::Relaxed);
        self.layout = self.layout.at(self.manifest.steps[step].plan.number);
        // Of the mesh and of other steps nothing changes, but a segment here has values of the step.
        self.close_before(ChunkId(u64::MAX));
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

    /// Bytes of all files of the archive, with unpacked blocks that are used; of those that the manifest tells of, where files cannot be listed.
    pub(in crate::pipeline) fn bytes(&self) -> Result<u64> {
        let unpacked = self.unpacked.get().and_then(Option::as_ref);
        let unpacked = unpacked.map_or(0, |file| file.segment().info().bytes);
        if let Some(&bytes) = self.bytes.get() {
            return Ok(bytes + unpacked);
        }
        let bytes = if is_remote(self.path()) { self.bytes_told() } else { folder_bytes(self.path())? };
        Ok(*self.bytes.get_or_init(|| bytes) + unpacked)
    }

    /// Bytes of the files that the manifest tells of, and its own.
    fn bytes_told(&self) -> u64 {
        let m = &self.manifest;
        let of_steps = m.steps.iter().flat_map(|s| {
            let others = [s.index, s.spectrum, s.coordinates.map(|c| c.info)];
            s.values.iter().map(|v| v.info).chain(others.into_iter().flatten())
        });
        m.mesh.iter().map(|r| r.info).chain(of_steps).map(|f| f.bytes).sum::<u64>() + m.text_bytes()
    }

    /// Bytes of the manifest.
    pub(in crate::pipeline) fn manifest_bytes(&self) -> Result<u64> {
        if is_remote(self.path()) {
            return Ok(self.manifest.text_bytes());
        }
        let file = self.layout.root().join(MANIFEST_NAME);
        Ok(std::fs::metadata(&file).map_err(|e| Error::io("look at", &file, e))?.len())
    }

    /// Refuses a chunk that an index names and that is not there.
    pub(in crate::pipeline) fn expect_chunk(&self, id: ChunkId) -> Result<()> {
        if id.0 >= self.chunks.len() {
            let got = format!("an entry of chunk {}", id.0);
            return Err(Error::bad_input(
                self.layout.index(),
                "entries",
                format!("chunks below {}", self.chunks.len()),
                got,
            ));
        }
        Ok(())
    }

    pub(in crate::pipeline) fn segment(&self, number: u64) -> Result<Arc<OpenSegment>> {
        let mut open = self.segments.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(segment) = open.get(&number) {
            return Ok(Arc::clone(segment));
        }
        let (path, hash) = (self.layout.mesh(number), self.manifest.plan_hash);
        let record = self.manifest.mesh.get(number as usize);
        let mesh = self.chunk_segment(&path, SegmentKind::Mesh, hash, number, record)?;
        let values = self.values_segment(self.view.step, number)?;
        let segment = Arc::new(OpenSegment { mesh, values });
        open.insert(number, Arc::clone(&segment));
        Ok(segment)
    }

    /// Opens the file of a range of chunks that a record is of.
    fn chunk_segment(
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

    /// The value segment of a step, by its position in the manifest, and a number.
    fn values_segment(&self, step: usize, number: u64) -> Result<Arc<ChunkSegment>> {
        let mut open = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(segment) = open.get(&(number, step)) {
            return Ok(Arc::clone(segment));
        }
        let Step { plan, values, .. } = &self.manifest.steps[step];
        let (path, hash) = (self.layout.at(plan.number).values(number), plan.hash(self.manifest.plan_hash));
        let record = values.get(number as usize);
        let segment = Arc::new(self.chunk_segment(&path, SegmentKind::Values, hash, number, record)?);
        open.insert((number, step), Arc::clone(&segment));
        Ok(segment)
    }

    /// The value segment of a step, by its position in the manifest, that has a chunk.
    pub(in crate::pipeline) fn values_of(&self, step: usize, chunk: ChunkId) -> Result<Arc<ChunkSegment>> {
        self.values_segment(step, self.segment_number(chunk))
    }

    /// The value segment of an archive of one chunk.
    pub(super) fn only_values(&self) -> Result<Arc<ChunkSegment>> {
        self.values_segment(self.view.step, 0)
    }

    /// A file that is not there makes the archive incomplete, which the same reduction repairs.
    pub(super) fn lost(&self, error: Error) -> Error {
        lost(self.layout.root(), error)
    }

    pub(in crate::pipeline) fn segment_of(&self, chunk: ChunkId) -> Result<Arc<OpenSegment>> {
        self.segment(self.segment_number(chunk))
    }

    fn segment_number(&self, chunk: ChunkId) -> u64 {
        let number = Manifest::segment_of(&self.manifest.mesh, chunk.0);
        number.expect("the segments of a checked manifest cover all chunks") as u64
    }

    /// Bytes read so far from all segments.
    pub(in crate::pipeline) fn bytes_read(&self) -> u64 {
        let open = self.segments.lock().unwrap_or_else(PoisonError::into_inner);
        let values = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        let meshes = open.values().map(|s| s.mesh.segment().bytes_read()).sum::<u64>();
        let values = values.values().map(|s| s.segment().bytes_read()).sum::<u64>();
        let unpacked = self.unpacked.get().and_then(Option::as_ref);
        let unpacked = unpacked.map_or(0, |file| file.segment().bytes_read());
        self.read_before.load(Ordering::Relaxed) + meshes + values + unpacked
    }

    /// Closes the segments before that of a chunk: their files, and the pages of their directories that are kept.
    pub(in crate::pipeline) fn close_before(&self, chunk: ChunkId) {
        let number = Manifest::segment_of(&self.manifest.mesh, chunk.0).unwrap_or(self.manifest.mesh.len());
        let mut open = self.segments.lock().unwrap_or_else(PoisonError::into_inner);
        let mut values = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        let (later, later_values) = (open.split_off(&(number as u64)), values.split_off(&(number as u64, 0)));
        let closed = std::mem::replace(&mut *open, later);
        let closed_values = std::mem::replace(&mut *values, later_values);
        let meshes = closed.values().map(|s| s.mesh.segment().bytes_read()).sum::<u64>();
        let read = closed_values.values().map(|s| s.segment().bytes_read()).sum::<u64>();
        self.read_before.fetch_add(meshes + read, Ordering::Relaxed);
    }
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
    /// A chunk whose mesh follows by formula.
    pub(in crate::pipeline) fn bcc_chunk(&self, id: ChunkId) -> Option<BccChunk> {
        let mesh = self.bcc?;
        let [lo, hi] = self.chunks.bricks().cells_of(&self.chunks.chunk(id));
        Some(mesh.chunk(lo, hi))
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
