//! An archive opened for reading: manifest, point set, grids; segments are opened when first needed.

use super::layout::Layout;
use super::plan::{MeshParts, parts};
use super::reader::ChunkReader;
use super::reduce::folder_bytes;
use crate::archive::chunked::ChunkSegment;
use crate::archive::coordinates::{CellCount, CoordinateMap};
use crate::archive::explicit::read_explicit;
use crate::archive::manifest::{MANIFEST_NAME, Manifest, MeshSource, SegmentRecord, Step};
use crate::archive::segment::{FORMAT_VERSION, PlanHash, Segment, SegmentInfo, SegmentKind};
use crate::archive::values::Quantiser;
use crate::error::{Error, Result};
use crate::geom::{LatticePos, PointId};
use crate::grid::{ChunkGrid, ChunkId, Geometry};
use crate::index::SpanIndex;
use crate::measure::FieldError;
use crate::mesh::tet::Tet;
use crate::points::PointSet;
use crate::spectrum::SpectrumFile;
use crate::spectrum::suggest::Suggestion;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Whether `path` is an archive: a folder with a manifest.
pub fn is_archive(path: &Path) -> bool {
    path.is_dir() && path.join(MANIFEST_NAME).is_file()
}

/// What an archive holds, from its manifest.
#[derive(Clone, Debug, Serialize)]
pub struct ArchiveSummary {
    /// "archive".
    pub kind: &'static str,
    /// Version of the format.
    pub format: u16,
    /// Name of the source's file.
    pub source: String,
    /// Its format.
    pub source_format: String,
    /// Samples along x, y, z.
    pub dims: [u64; 3],
    /// Type of its samples.
    pub scalar: String,
    /// Name of the field.
    pub field: String,
    /// Index space to world.
    pub geometry: Geometry,
    /// Of a rectilinear or curvilinear grid, whose coordinates are in the archive: its bad cells.
    pub grid_cells: Option<CellCount>,
    /// Of a tetrahedral mesh: what it had.
    pub mesh: Option<MeshSource>,
    /// The point set, with its parameters.
    pub point_set: serde_json::Value,
    /// How values were interpolated.
    pub interpolation: String,
    /// How values were rounded, if they were.
    pub quantiser: Option<Quantiser>,
    /// Points.
    pub points: u64,
    /// Points without a value.
    pub void_points: u64,
    /// Tetrahedra.
    pub tetrahedra: u64,
    /// Chunks.
    pub chunks: u64,
    /// Tetrahedron blocks.
    pub blocks: u64,
    /// Time steps.
    pub steps: usize,
    /// Least and largest value.
    pub range: Option<[f32; 2]>,
    /// Area of the isosurface at each isovalue of the contour spectrum.
    pub areas: Vec<[f64; 2]>,
    /// Isovalues that are worth a look, the most marked one first.
    pub suggestions: Vec<Suggestion>,
    /// How far the reduced field is from the samples of its source, where that was measured.
    pub error: Option<FieldError>,
    /// Bytes of all files.
    pub bytes: u64,
}

/// Tells what an archive holds.
///
/// # Errors
/// [`Error::BadInput`] when there is no archive at `path`, or its manifest is damaged.
pub fn summarize(path: &Path) -> Result<ArchiveSummary> {
    let archive = OpenArchive::open(path)?;
    let (plan, counts, step) = (&archive.manifest.plan, &archive.manifest.counts, archive.step());
    let source = &step.plan.source;
    let spectrum = super::spectrum::report(&archive)?;
    Ok(ArchiveSummary {
        kind: "archive",
        format: FORMAT_VERSION,
        source: source.path.clone(),
        source_format: source.format.clone(),
        dims: source.dims,
        scalar: source.scalar.name().into(),
        field: source.field.clone(),
        geometry: source.geometry,
        grid_cells: step.coordinates.map(|c| c.cells),
        mesh: source.mesh,
        point_set: serde_json::json!(plan.points),
        interpolation: step.plan.interpolation.name().into(),
        quantiser: step.plan.quantiser,
        points: counts.points,
        void_points: step.void_points,
        tetrahedra: counts.tetrahedra,
        chunks: counts.chunks,
        blocks: counts.blocks,
        steps: archive.manifest.steps.len(),
        range: step.value_range,
        areas: spectrum.knots.iter().map(|k| [f64::from(k.isovalue), k.area]).collect(),
        suggestions: spectrum.suggestions,
        error: step.error.clone(),
        bytes: folder_bytes(path)?,
    })
}

/// The two files that hold a range of chunks.
pub(super) struct OpenSegment {
    pub(super) mesh: ChunkSegment,
    pub(super) values: ChunkSegment,
}

impl OpenSegment {
    fn bytes_read(&self) -> u64 {
        self.mesh.segment().bytes_read() + self.values.segment().bytes_read()
    }
}

/// An archive opened for reading.
pub(super) struct OpenArchive {
    pub(super) manifest: Manifest,
    pub(super) points: PointSet,
    pub(super) chunks: ChunkGrid,
    pub(super) layout: Layout,
    segments: Mutex<BTreeMap<u64, Arc<OpenSegment>>>,
    /// Bytes read from segments that are closed again.
    read_before: AtomicU64,
}

impl OpenArchive {
    pub(super) fn open(root: &Path) -> Result<Self> {
        if !root.is_dir() {
            let got = if root.exists() { "a file" } else { "nothing" };
            return Err(Error::bad_input(root, "archive", "a folder made by isospan reduce", got));
        }
        Self::of(root, Manifest::read(root)?)
    }

    /// The archive that a manifest is of, published or not.
    pub(super) fn of(root: &Path, manifest: Manifest) -> Result<Self> {
        let bad = |at: &str, expected: String, got: String| {
            Err(Error::bad_input(root.join(MANIFEST_NAME), at, expected, got))
        };
        let explicit = match &manifest.plan.explicit {
            Some(record) => {
                let read = read_explicit(root, manifest.plan_hash, &manifest.plan.lattice, record);
                Some(Arc::new(read.map_err(|e| lost(root, e))?))
            }
            None => None,
        };
        let MeshParts { points, chunks, .. } = match parts(&manifest.plan, explicit) {
            Ok(parts) => parts,
            Err(e) => return bad("plan", "a plan that can be carried out".into(), e.to_string()),
        };
        if chunks.len() != manifest.counts.chunks {
            return bad("counts.chunks", chunks.len().to_string(), manifest.counts.chunks.to_string());
        }
        let Some(step) = manifest.steps.first() else {
            return bad("steps", "at least one".into(), "none".into());
        };
        let source = &step.plan.source;
        if !source.geometry.is_valid() || source.dims != manifest.plan.lattice.dims {
            return bad(
                "source",
                "an invertible geometry, and the dimensions of the lattice".into(),
                format!("{source:?}"),
            );
        }
        let layout = Layout::new(root, chunks.len(), step.plan.number);
        for records in [&manifest.mesh, &step.values] {
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
            layout,
            segments: Mutex::default(),
            read_before: AtomicU64::new(0),
        })
    }

    pub(super) fn path(&self) -> &Path {
        self.layout.root()
    }

    pub(super) fn step(&self) -> &Step {
        &self.manifest.steps[0]
    }

    fn step_hash(&self) -> PlanHash {
        self.step().plan.hash(self.manifest.plan_hash)
    }

    pub(super) fn index(&self) -> Result<SpanIndex> {
        let index = SpanIndex::open(self.layout.index(), Some(self.step_hash())).map_err(|e| self.lost(e))?;
        expect_recorded(index.segment(), Some(&self.step().index))?;
        Ok(index)
    }

    /// The coordinates of a rectilinear or curvilinear grid; none of a volume with a spacing.
    pub(super) fn coordinates(&self) -> Result<Option<CoordinateMap>> {
        let Some(recorded) = &self.step().coordinates else { return Ok(None) };
        let (path, dims) = (self.layout.coordinates(), self.step().plan.source.dims);
        let map = CoordinateMap::open(&path, self.step_hash(), dims).map_err(|e| self.lost(e))?;
        expect_recorded(map.segment(), Some(&recorded.info))?;
        Ok(Some(map))
    }

    /// Refuses a question that is not answered for grids with coordinates of their own.
    pub(super) fn refuse_coordinates(&self, question: &str) -> Result<()> {
        match self.step().coordinates {
            None => Ok(()),
            Some(_) => Err(Error::usage(format!(
                "{}: of a rectilinear or curvilinear grid, to which {question} is not made",
                self.path().display()
            ))),
        }
    }

    /// The contour spectrum; none where every tetrahedron is void.
    pub(super) fn spectrum(&self) -> Result<Option<SpectrumFile>> {
        let Some(recorded) = &self.step().spectrum else { return Ok(None) };
        let file =
            SpectrumFile::open(self.layout.spectrum(), Some(self.step_hash())).map_err(|e| self.lost(e))?;
        expect_recorded(file.segment(), Some(recorded))?;
        Ok(Some(file))
    }

    /// Bytes of the manifest.
    pub(super) fn manifest_bytes(&self) -> Result<u64> {
        let file = self.layout.root().join(MANIFEST_NAME);
        Ok(std::fs::metadata(&file).map_err(|e| Error::io("look at", &file, e))?.len())
    }

    /// Refuses a chunk that an index names and that is not there.
    pub(super) fn expect_chunk(&self, id: ChunkId) -> Result<()> {
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

    pub(super) fn segment(&self, number: u64) -> Result<Arc<OpenSegment>> {
        let mut open = self.segments.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(segment) = open.get(&number) {
            return Ok(Arc::clone(segment));
        }
        let file = |path, kind, hash| ChunkSegment::open(path, kind, Some(hash)).map_err(|e| self.lost(e));
        let mesh = file(self.layout.mesh(number), SegmentKind::Mesh, self.manifest.plan_hash)?;
        let values = file(self.layout.values(number), SegmentKind::Values, self.step_hash())?;
        let wanted = self.layout.chunks_of(number);
        for file in [&mesh, &values] {
            if file.chunks() != wanted {
                let (path, got) = (file.segment().path(), format!("{:?}", file.chunks()));
                return Err(Error::bad_input(path, "chunk table", format!("chunks {wanted:?}"), got));
            }
        }
        let at = number as usize;
        expect_recorded(mesh.segment(), self.manifest.mesh.get(at).map(|r| &r.info))?;
        expect_recorded(values.segment(), self.step().values.get(at).map(|r| &r.info))?;
        let segment = Arc::new(OpenSegment { mesh, values });
        open.insert(number, Arc::clone(&segment));
        Ok(segment)
    }

    /// A file that is not there makes the archive incomplete, which the same reduction repairs.
    fn lost(&self, error: Error) -> Error {
        lost(self.layout.root(), error)
    }

    pub(super) fn segment_of(&self, chunk: ChunkId) -> Result<Arc<OpenSegment>> {
        let number = Manifest::segment_of(&self.manifest.mesh, chunk.0);
        self.segment(number.expect("the segments of a checked manifest cover all chunks") as u64)
    }

    /// Bytes read so far from all segments.
    pub(super) fn bytes_read(&self) -> u64 {
        let open = self.segments.lock().unwrap_or_else(PoisonError::into_inner);
        self.read_before.load(Ordering::Relaxed) + open.values().map(|s| s.bytes_read()).sum::<u64>()
    }

    /// Closes the segments before that of a chunk: their files, and the pages of their directories that are kept.
    pub(super) fn close_before(&self, chunk: ChunkId) {
        let Some(number) = Manifest::segment_of(&self.manifest.mesh, chunk.0) else { return };
        let mut open = self.segments.lock().unwrap_or_else(PoisonError::into_inner);
        let later = open.split_off(&(number as u64));
        let closed = std::mem::replace(&mut *open, later);
        let read = closed.values().map(|s| s.bytes_read()).sum::<u64>();
        self.read_before.fetch_add(read, Ordering::Relaxed);
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

/// Some blocks of a chunk, decoded: tetrahedra, and position, id and value of the corners they use. Corner arrays are
/// indexed by chunk-local vertex number; corners that are not used hold anything.
#[derive(Default)]
pub(super) struct DecodedChunk {
    pub(super) positions: Vec<LatticePos>,
    pub(super) ids: Vec<PointId>,
    pub(super) values: Vec<f32>,
    pub(super) shared: Vec<bool>,
    /// Tetrahedra, block after block.
    pub(super) tets: Vec<Tet>,
    /// End of each block in `tets`.
    pub(super) block_ends: Vec<usize>,
    /// Corners that the chunk owns; the others are halo.
    pub(super) core: usize,
}

impl OpenArchive {
    /// Decodes `blocks` (numbers within the chunk) of a chunk, and of its values and positions what they use. For a question
    /// that needs but some of that, or a block at a time, there is [`ChunkReader`].
    pub(super) fn decode(&self, id: ChunkId, blocks: &[u32]) -> Result<DecodedChunk> {
        let mut reader = ChunkReader::open(self, id)?;
        let (mut tets, mut block_ends) = (vec![], vec![]);
        for &block in blocks {
            reader.tets(block, &mut tets)?;
            block_ends.push(tets.len());
        }
        reader.load_values(&tets)?;
        reader.place(&tets)?;
        let core = reader.core();
        let (positions, ids, values, shared) = reader.into_corners();
        Ok(DecodedChunk { positions, ids, values, shared, tets, block_ends, core })
    }
}

/// A segment is the one that the manifest was written for, and not a valid one with other content.
fn expect_recorded(segment: &Segment, recorded: Option<&SegmentInfo>) -> Result<()> {
    let found = segment.info();
    if recorded == Some(&found) {
        return Ok(());
    }
    let text = |i: &SegmentInfo| {
        format!("{} bytes, {} blocks, content hash {:016x}", i.bytes, i.blocks, i.content_hash)
    };
    let expected = recorded.map_or_else(|| "no such segment".to_owned(), text);
    Err(Error::bad_input(segment.path(), "length, blocks and hash in the manifest", expected, text(&found))
        .with_help("the file is not this archive's: restore it, or run the same reduction again"))
}

/// Which corners some tetrahedron uses.
pub(super) fn used_corners(tets: &[Tet], local: usize) -> Vec<bool> {
    let mut used = vec![false; local];
    for &v in tets.iter().flatten() {
        used[v as usize] = true;
    }
    used
}
