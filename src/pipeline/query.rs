//! Questions to an archive: the index names the blocks that can hold an answer; those are read, and no others.

use super::open::{DecodedChunk, OpenArchive};
use super::reduce::folder_bytes;
use crate::archive::manifest::MANIFEST_NAME;
use crate::error::{Error, Result};
use crate::exec::{CancelToken, Progress, pool};
use crate::formats::surface::{SurfaceFormat, SurfaceMeta, write_surface};
use crate::grid::ChunkId;
use crate::index::Entry;
use crate::mesh::tet::{is_active, range};
use crate::surface::marching_tets::{CellSource, ChunkSurface, extract};
use crate::surface::weld::{BuilderSettings, SurfaceBuilder};
use crate::surface::{SurfaceSource, WorldMap};
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// How a surface is extracted.
#[derive(Clone, Debug, Default)]
pub struct SurfaceSettings {
    /// The isovalue: a value `>=` it is inside.
    pub isovalue: f32,
    /// Threads; 0 means as many as the process may use.
    pub threads: usize,
    /// Folder for what does not fit in memory; the output's folder if not given.
    pub scratch: Option<PathBuf>,
    /// Stops the extraction; nothing is written then.
    pub cancel: CancelToken,
}

/// What a surface extraction found and read.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SurfaceReport {
    /// The isovalue.
    pub isovalue: f32,
    /// Whether no value lies below the isovalue, or none at or above it; then the surface is empty.
    pub outside_range: bool,
    /// Least and largest value of the archive.
    pub range: Option<[f32; 2]>,
    /// Vertices written.
    pub vertices: u64,
    /// Triangles written.
    pub triangles: u64,
    /// Bytes of the file written.
    pub file_bytes: u64,
    /// Points of the archive.
    pub points: u64,
    /// Tetrahedra of the archive.
    pub tetrahedra: u64,
    /// Tetrahedra that the surface crosses.
    pub active_tetrahedra: u64,
    /// Tetrahedron blocks of the archive.
    pub blocks: u64,
    /// Blocks read.
    pub active_blocks: u64,
    /// Chunks of the archive.
    pub chunks: u64,
    /// Chunks that blocks were read of.
    pub active_chunks: u64,
    /// Bytes read: manifest, index pages, chunk headers, blocks, values.
    pub bytes_read: u64,
    /// Bytes of the archive.
    pub archive_bytes: u64,
    /// Seconds of wall time of each stage.
    pub seconds: Vec<(String, f64)>,
}

/// How many tetrahedra an isosurface crosses.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CountReport {
    /// The isovalue.
    pub isovalue: f32,
    /// Tetrahedra that the surface crosses.
    pub active_tetrahedra: u64,
    /// Tetrahedra of the archive.
    pub tetrahedra: u64,
    /// Blocks that can hold some.
    pub active_blocks: u64,
    /// Blocks of the archive.
    pub blocks: u64,
}

fn finite(isovalue: f32) -> Result<()> {
    if isovalue.is_finite() { Ok(()) } else { Err(Error::usage("the isovalue must be a finite number")) }
}

/// The active blocks, chunk by chunk.
fn by_chunk(refs: &[Entry]) -> Vec<(ChunkId, Vec<u32>)> {
    refs.chunk_by(|a, b| a.chunk == b.chunk)
        .map(|run| (ChunkId(run[0].chunk), run.iter().map(|r| r.block).collect()))
        .collect()
}

/// Counts the active tetrahedra of an isovalue, exactly, by decoding the active blocks.
///
/// # Errors
/// [`Error::BadInput`] for a damaged archive.
pub fn count_active(path: &Path, isovalue: f32) -> Result<CountReport> {
    finite(isovalue)?;
    let archive = OpenArchive::open(path)?;
    let refs = archive.index()?.query(isovalue)?;
    let active = by_chunk(&refs)
        .par_iter()
        .map(|(chunk, blocks)| Ok(active_tets(&archive.decode(*chunk, blocks)?, isovalue)))
        .sum::<Result<u64>>()?;
    Ok(CountReport {
        isovalue,
        active_tetrahedra: active,
        tetrahedra: archive.manifest.counts.tetrahedra,
        active_blocks: refs.len() as u64,
        blocks: archive.manifest.counts.blocks,
    })
}

fn active_tets(chunk: &DecodedChunk, isovalue: f32) -> u64 {
    let is_active = |t: &&[u32; 4]| {
        range(t.map(|v| chunk.values[v as usize])).is_some_and(|(lo, hi)| is_active(lo, hi, isovalue))
    };
    chunk.tets.iter().filter(is_active).count() as u64
}

/// Extracts an isosurface to a file.
///
/// Chunks are decoded and extracted in parallel, a batch at a time, and welded in chunk order: the file's bytes do not
/// depend on the number of threads. An isovalue outside the values' range gives an empty, valid file.
///
/// # Errors
/// [`Error::BadInput`] for a damaged archive; those of writing the file, of which nothing is left then.
pub fn extract_surface(
    path: &Path,
    settings: &SurfaceSettings,
    out: &Path,
    format: SurfaceFormat,
    progress: &dyn Progress,
) -> Result<SurfaceReport> {
    let isovalue = settings.isovalue;
    finite(isovalue)?;
    let start = Instant::now();
    let archive = OpenArchive::open(path)?;
    let index = archive.index()?;
    let refs = index.query(isovalue)?;
    let opened = start.elapsed();

    let start = Instant::now();
    let world = WorldMap::new(&archive.manifest.plan.lattice, &archive.step().plan.source.geometry);
    let scratch = settings.scratch.clone().unwrap_or_else(|| parent_of(out));
    let mut builder = SurfaceBuilder::new(&world, &BuilderSettings { scratch, ..BuilderSettings::default() });
    let work = by_chunk(&refs);
    let pool = pool(settings.threads)?;
    progress.begin("surface", refs.len() as u64, "blocks");
    let mut active_tetrahedra = 0;
    for batch in work.chunks(2 * pool.current_num_threads()) {
        settings.cancel.check()?;
        let surfaces = pool.install(|| {
            batch
                .par_iter()
                .map(|(chunk, blocks)| chunk_surface(&archive, *chunk, blocks, isovalue, &world))
                .collect()
        });
        let surfaces: Vec<Result<ChunkSurface>> = surfaces;
        for (surface, (_, blocks)) in surfaces.into_iter().zip(batch) {
            let surface = surface?;
            active_tetrahedra += surface.active_cells();
            builder.push(&surface)?;
            progress.advance(blocks.len() as u64);
        }
    }
    let surface = builder.finish()?;
    let extracted = start.elapsed();

    let start = Instant::now();
    let source = &archive.step().plan.source;
    let meta = SurfaceMeta {
        isovalue: Some(f64::from(isovalue)),
        comments: vec![format!("isospan {} of {}", env!("CARGO_PKG_VERSION"), source.path)],
    };
    let file_bytes = write_surface(&surface, out, format, &meta)?;
    let written = start.elapsed();
    let range = archive.step().value_range;
    let totals = &archive.manifest.counts;
    Ok(SurfaceReport {
        isovalue,
        outside_range: range.is_none_or(|[lo, hi]| isovalue <= lo || isovalue > hi),
        range,
        vertices: surface.vertex_count(),
        triangles: surface.triangle_count(),
        file_bytes,
        points: totals.points,
        tetrahedra: totals.tetrahedra,
        active_tetrahedra,
        blocks: totals.blocks,
        active_blocks: refs.len() as u64,
        chunks: totals.chunks,
        active_chunks: work.len() as u64,
        bytes_read: archive.bytes_read() + index.segment().bytes_read() + manifest_bytes(path)?,
        archive_bytes: folder_bytes(path)?,
        seconds: [("open, index", opened), ("extract", extracted), ("write", written)]
            .map(|(name, time)| (name.to_owned(), time.as_secs_f64()))
            .to_vec(),
    })
}

fn chunk_surface(
    archive: &OpenArchive,
    chunk: ChunkId,
    blocks: &[u32],
    isovalue: f32,
    world: &WorldMap,
) -> Result<ChunkSurface> {
    let decoded = archive.decode(chunk, blocks)?;
    let cells = CellSource {
        positions: &decoded.positions,
        values: &decoded.values,
        ids: &decoded.ids,
        shared: &decoded.shared,
        tets: &decoded.tets,
    };
    let mut surface = ChunkSurface::default();
    extract(&cells, isovalue, world, &mut surface);
    Ok(surface)
}

fn manifest_bytes(archive: &Path) -> Result<u64> {
    let file = archive.join(MANIFEST_NAME);
    Ok(std::fs::metadata(&file).map_err(|e| Error::io("look at", &file, e))?.len())
}

fn parent_of(file: &Path) -> PathBuf {
    match file.parent() {
        Some(p) if !p.as_os_str().is_empty() => p.to_path_buf(),
        _ => PathBuf::from("."),
    }
}
