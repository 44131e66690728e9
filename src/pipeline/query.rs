//! Questions to an archive: the index names the blocks that can hold an answer; those are read, and no others.

use super::horizon::Horizon;
use super::need::{self, SurfaceShares};
use super::open::{DecodedChunk, OpenArchive};
use super::reduce::folder_bytes;
use crate::error::{Error, Result};
use crate::exec::{CancelToken, Progress, Silent, pool};
use crate::formats::surface::{SurfaceFormat, SurfaceMeta, write_surface};
use crate::grid::ChunkId;
use crate::index::Entry;
use crate::mesh::tet::{is_active, range};
use crate::surface::marching_tets::{CellSource, ChunkSurface, extract};
use crate::surface::weld::{BuilderSettings, StoredSurface, SurfaceBuilder};
use crate::surface::{SurfaceSource, TriMesh, WorldMap};
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// How a surface is extracted.
#[derive(Clone, Debug)]
pub struct SurfaceSettings {
    /// The isovalue: a value `>=` it is inside.
    pub isovalue: f32,
    /// Threads; 0 means as many as the process may use.
    pub threads: usize,
    /// Bytes for everything that grows with the surface.
    pub memory: u64,
    /// Folder for what does not fit in memory; the output's folder if not given.
    pub scratch: Option<PathBuf>,
    /// Stops the extraction; nothing is written then.
    pub cancel: CancelToken,
}

impl Default for SurfaceSettings {
    fn default() -> Self {
        Self {
            isovalue: 0.0,
            threads: 0,
            memory: crate::exec::usable_memory() / 2,
            scratch: None,
            cancel: CancelToken::new(),
        }
    }
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
    /// Whether the number was stored; otherwise the blocks of the isovalue were decoded.
    pub stored: bool,
    /// Bytes read for it: the manifest, the spectrum's knots and a page of its levels; also index pages and blocks where it
    /// was not stored.
    pub bytes_read: u64,
}

fn finite(isovalue: f32) -> Result<()> {
    if isovalue.is_finite() { Ok(()) } else { Err(Error::usage("the isovalue must be a finite number")) }
}

/// The active blocks, chunk by chunk.
fn by_chunk(archive: &OpenArchive, refs: &[Entry]) -> Result<Vec<(ChunkId, Vec<u32>)>> {
    refs.chunk_by(|a, b| a.chunk == b.chunk)
        .map(|run| {
            let chunk = ChunkId(run[0].chunk);
            archive.expect_chunk(chunk)?;
            Ok((chunk, run.iter().map(|r| r.block).collect()))
        })
        .collect()
}

/// Counts the active tetrahedra of an isovalue, exactly: from the spectrum where it is stored ([`crate::spectrum`]: at any
/// isovalue of a few digits), else by decoding the active blocks.
///
/// # Errors
/// [`Error::BadInput`] for a damaged archive.
pub fn count_active(path: &Path, isovalue: f32) -> Result<CountReport> {
    finite(isovalue)?;
    let archive = OpenArchive::open(path)?;
    let spectrum = archive.spectrum()?;
    let stored = match &spectrum {
        Some(file) => file.active(isovalue)?,
        None => Some(0),
    };
    let mut bytes_read = archive.manifest_bytes()? + spectrum.map_or(0, |f| f.segment().bytes_read());
    let active_tetrahedra = match stored {
        Some(n) => n,
        None => {
            let (n, bytes) = decoded_count(&archive, isovalue)?;
            bytes_read += bytes;
            n
        }
    };
    Ok(CountReport {
        isovalue,
        active_tetrahedra,
        tetrahedra: archive.manifest.counts.tetrahedra,
        stored: stored.is_some(),
        bytes_read,
    })
}

/// Decodes the active blocks; also tells the bytes read.
fn decoded_count(archive: &OpenArchive, isovalue: f32) -> Result<(u64, u64)> {
    let index = archive.index()?;
    let refs = index.query(isovalue)?;
    let active = by_chunk(archive, &refs)?
        .par_iter()
        .map(|(chunk, blocks)| Ok(active_tets(&archive.decode(*chunk, blocks)?, isovalue)))
        .sum::<Result<u64>>()?;
    Ok((active, index.segment().bytes_read() + archive.bytes_read()))
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
/// depend on the number of threads, nor on memory. Vertices and triangles that memory does not hold wait in the scratch
/// folder. An isovalue outside the values' range gives an empty, valid file.
///
/// # Errors
/// [`Error::BadInput`] for a damaged archive; [`Error::Budget`] when the memory does not suffice; those of writing the
/// file, of which nothing is left then.
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
    let work = by_chunk(&archive, &refs)?;
    let (surface, active_tetrahedra) = welded(&archive, &work, settings, &world, parent_of(out), progress)?;
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
        bytes_read: archive.bytes_read() + index.segment().bytes_read() + archive.manifest_bytes()?,
        archive_bytes: folder_bytes(path)?,
        seconds: [("open, index", opened), ("extract", extracted), ("write", written)]
            .map(|(name, time)| (name.to_owned(), time.as_secs_f64()))
            .to_vec(),
    })
}

/// An isosurface in memory.
pub(super) fn surface_in_memory(archive: &OpenArchive, isovalue: f32) -> Result<TriMesh> {
    finite(isovalue)?;
    let settings = SurfaceSettings { isovalue, ..SurfaceSettings::default() };
    let world = WorldMap::new(&archive.manifest.plan.lattice, &archive.step().plan.source.geometry);
    let work = by_chunk(archive, &archive.index()?.query(isovalue)?)?;
    let (surface, _) = welded(archive, &work, &settings, &world, std::env::temp_dir(), &Silent)?;
    TriMesh::from_source(&surface)
}

/// Extracts the active blocks of all chunks and joins the surfaces; also tells the number of active tetrahedra.
fn welded(
    archive: &OpenArchive,
    work: &[(ChunkId, Vec<u32>)],
    settings: &SurfaceSettings,
    world: &WorldMap,
    out_folder: PathBuf,
    progress: &dyn Progress,
) -> Result<(StoredSurface, u64)> {
    let active_blocks = work.iter().map(|w| w.1.len() as u64).sum::<u64>();
    let bytes_of = |(chunk, blocks): &(ChunkId, Vec<u32>)| extraction_need(archive, *chunk, blocks.len());
    let largest = work.iter().map(bytes_of).max().unwrap_or(0);
    let shares = SurfaceShares::of(settings.memory, active_blocks, largest)?;
    let scratch = settings.scratch.clone().unwrap_or(out_folder);
    let memory_bytes = usize::try_from(shares.finished).unwrap_or(usize::MAX);
    let mut builder = SurfaceBuilder::new(world, &BuilderSettings { scratch, memory_bytes });
    let mut closing = Closing::new(archive, work, shares);
    let pool = pool(settings.threads)?;
    progress.begin("surface", active_blocks, "blocks");
    let (mut active_tetrahedra, mut done) = (0, 0);
    while done < work.len() {
        settings.cancel.check()?;
        let batch = &work
            [done..done + batch_len(&work[done..], shares.batch, 2 * pool.current_num_threads(), bytes_of)];
        let surfaces: Vec<Result<ChunkSurface>> = pool.install(|| {
            let surface = |(chunk, blocks): &(ChunkId, Vec<u32>)| {
                chunk_surface(archive, *chunk, blocks, settings.isovalue, world)
            };
            batch.par_iter().map(surface).collect()
        });
        for (surface, (_, blocks)) in surfaces.into_iter().zip(batch) {
            let surface = surface?;
            active_tetrahedra += surface.active_cells();
            builder.push(&surface)?;
            done += 1;
            closing.after(&mut builder, done, settings.memory)?;
            progress.advance(blocks.len() as u64);
        }
        if let Some((next, _)) = work.get(done) {
            archive.close_before(*next);
        }
    }
    Ok((builder.finish()?, active_tetrahedra))
}

/// Bytes in which some blocks of a chunk are extracted: from the plan's target and the point set, without reading.
fn extraction_need(archive: &OpenArchive, chunk: ChunkId, blocks: usize) -> u64 {
    let core = &archive.chunks.chunk(chunk).core;
    // The halo points that tetrahedra use lie within about one spacing.
    let near = core.grow_within(archive.points.mean_spacing(), &archive.chunks.bricks().lattice.domain());
    let tets = blocks as u64 * u64::from(archive.manifest.plan.block_tets);
    need::extraction_bytes(archive.points.count_in(&near), tets)
}

/// How many of the next chunks are extracted side by side: at least one.
fn batch_len<T>(next: &[T], room: u64, most: usize, bytes_of: impl Fn(&T) -> u64) -> usize {
    let mut sum = 0u64;
    let fit = next.iter().take(most).take_while(|chunk| {
        sum = sum.saturating_add(bytes_of(chunk));
        sum <= room
    });
    fit.count().max(1)
}

/// Closes shared edges when they have become many.
struct Closing<'a> {
    archive: &'a OpenArchive,
    work: &'a [(ChunkId, Vec<u32>)],
    /// Made when first needed: most surfaces fit in memory.
    horizon: Option<Horizon>,
    shares: SurfaceShares,
    /// Open edges at which it is worth looking.
    look_at: u64,
    least: u64,
}

impl<'a> Closing<'a> {
    fn new(archive: &'a OpenArchive, work: &'a [(ChunkId, Vec<u32>)], shares: SurfaceShares) -> Self {
        // Looking at all of them whenever they have doubled costs a constant number of looks an edge.
        let least = shares.open_edges / 64 + 1;
        Self { archive, work, horizon: None, shares, look_at: least, least }
    }

    fn after(&mut self, builder: &mut SurfaceBuilder, done: usize, memory: u64) -> Result<()> {
        if (builder.open_edges() as u64) < self.look_at {
            return Ok(());
        }
        let horizon = match self.horizon.take() {
            Some(horizon) => horizon,
            None => Horizon::new(self.archive, self.work.iter().map(|w| w.0))?,
        };
        let beyond = self.horizon.insert(horizon).after(done);
        let place = |id| self.archive.points.position(id);
        builder.keep_open(|a, b| match (place(a), place(b)) {
            (Some(a), Some(b)) => beyond.can_have(a, b),
            _ => true,
        })?;
        let open = builder.open_edges() as u64;
        if open > self.shares.open_edges {
            return Err(self.shares.too_many_open(memory, open));
        }
        self.look_at = (2 * open).clamp(self.least, self.shares.open_edges + 1);
        Ok(())
    }
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

fn parent_of(file: &Path) -> PathBuf {
    match file.parent() {
        Some(p) if !p.as_os_str().is_empty() => p.to_path_buf(),
        _ => PathBuf::from("."),
    }
}
