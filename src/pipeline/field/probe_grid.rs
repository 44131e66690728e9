//! `probe` on a grid: the reduced field, linear in each tetrahedron, at the samples of a grid of
//! any size.
//!
//! ```text
//!  chunk ─▶ decode ─▶ box of its tetrahedra, cut into windows ─▶ scan conversion ─▶ runs, each to its place in the file
//! ```
//!
//! Each sample is in exactly one tetrahedron ([`isospan_mesh::raster`]), so each is written exactly
//! once, by the chunk with that tetrahedron, and chunks need not wait for each other. Memory: some
//! chunks, and a window for each.
//!
//! The own tetrahedra of a mesh may overlap. Then the value of the first one counts. One bit for
//! each sample says whether it is taken. Where two chunks have the same sample, all is done again
//! on one thread, chunk by chunk.

use super::export_grid::pool_of;
use super::levels::{Without, values_on_grid};
use crate::pipeline::plan::estimate;
use crate::pipeline::read::{Blocks, DecodedChunk, LevelChoice, StepView, Visit};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Clock, Progress, Resources, Silent, Threads};
use isospan_io::formats::samples::{Anatomy, GridMeta, SampleField, SampleFile, SampleFormat};
use isospan_io::grid::{Geometry, IndexBox};
use isospan_mesh::raster::{Axis, SampleGrid, Scanner, interpolate};
use serde::Serialize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// How a field is probed.
#[derive(Clone, Debug, Default)]
pub struct ProbeSettings {
    /// The level of a pyramid; the finest if not given. Beyond the last node of a level there is no
    /// value.
    pub level: Option<LevelChoice>,
    /// Threads, memory, and what stops it. Nothing waits in a scratch folder.
    pub resources: Resources,
}

/// What was probed.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct ProbeReport {
    /// Samples or points asked for.
    pub samples: u64,
    /// Those without a value, because a corner of their tetrahedron has none: NaN.
    pub void: u64,
    /// Those outside the domain, or beyond the last node of the level: NaN.
    pub outside: u64,
    /// The level of a pyramid that answers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub level: Option<usize>,
    /// Chunks read, each as often as it was.
    pub chunks_read: u64,
    /// Bytes read of segments.
    pub bytes_read: u64,
    /// Bytes of the file written.
    pub file_bytes: u64,
    /// What of a grid has no place in the file, or is converted, a line each.
    pub notices: Vec<String>,
    /// Seconds of wall time.
    pub seconds: f64,
}

/// Bits of a sample that no tetrahedron has claimed: a NaN that no computation gives.
const UNSET: u32 = 0x7fff_ffff;
/// Samples of a window: 16 MiB.
const WINDOW: u64 = 1 << 22;

/// Samples written at a time where the tetrahedra leave gaps.
const BLANK: u64 = 1 << 18;

/// Samples the field of an archive on a grid and writes them to a file: see
/// [`Step::write_samples`](crate::pipeline::Step::write_samples).
pub(in crate::pipeline) fn probe_grid(
    archive: &StepView,
    dims: [u64; 3],
    settings: &ProbeSettings,
    out: &Path,
    format: SampleFormat,
    progress: &dyn Progress,
) -> Result<ProbeReport> {
    archive.refuse_coordinates("a probe on a grid")?;
    let level = archive.level(settings.level)?;
    let (start, read_before) = (Clock::start(), archive.bytes_read());
    let source = &archive.step().plan.source;
    let geometry = grid_geometry(&source.geometry, source.dims, dims)?;
    let meta = GridMeta {
        units: source.units.clone(),
        anatomy: Anatomy::of_format(&source.format),
        ..GridMeta::even(dims, geometry, SampleField::floats(&source.field, source.offset))
    };
    let samples = meta.samples()?;
    let create = || SampleFile::create(out, format, &meta, false, settings.resources.scratch.as_deref());
    let (file, found) = if archive.is_pyramid() {
        let file = create()?;
        let write = |first, run: &[f32]| file.write(first, run);
        let Without { void, outside } =
            values_on_grid(archive, level, dims, &settings.resources, progress, write)?;
        let (level, chunks_read) = (Some(level), archive.chunks.len());
        (file, ProbeReport { void, outside, level, chunks_read, ..ProbeReport::default() })
    } else {
        let mut scan = GridScan::new(archive, dims, settings)?;
        let file = create()?;
        if scan.has_gaps {
            write_blank(&file, samples)?;
        }
        let void = scan.run(samples, progress, |first, run| file.write(first, run))?;
        let chunks_read = scan.visit.chunks.len() as u64;
        (file, ProbeReport { void, chunks_read, ..ProbeReport::default() })
    };
    let (threads, bytes_read) =
        (Threads::new(settings.resources.threads)?, archive.bytes_read() - read_before);
    Ok(ProbeReport {
        samples,
        bytes_read,
        file_bytes: file.publish(pool_of(&threads), &settings.resources.cancel)?,
        notices: format.notices(&meta),
        seconds: start.elapsed().as_secs_f64(),
        ..found
    })
}

/// Writes samples without a value.
fn write_blank(file: &SampleFile, samples: u64) -> Result<()> {
    let blank = vec![f32::NAN; BLANK.min(samples) as usize];
    for first in (0..samples).step_by(BLANK as usize) {
        file.write(first, &blank[..BLANK.min(samples - first) as usize])?;
    }
    Ok(())
}

/// The same samples, in memory.
pub(in crate::pipeline) fn sample_grid(
    archive: &StepView,
    dims: [u64; 3],
    settings: &ProbeSettings,
) -> Result<Vec<f64>> {
    let meta = GridMeta::even(dims, Geometry::default(), SampleField::floats("", 0.0));
    let level = archive.level(settings.level)?;
    let (samples, offset) = (meta.samples()?, archive.step().plan.source.offset);
    let bytes = 8 * samples;
    if bytes > settings.resources.memory {
        return Err(Error::memory("", bytes, settings.resources.memory));
    }
    let all = Mutex::new(vec![f64::NAN; samples as usize]);
    let write = |first: u64, run: &[f32]| {
        let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
        all[first as usize..].iter_mut().zip(run).for_each(|(out, &v)| *out = offset + f64::from(v));
        Ok(())
    };
    if archive.is_pyramid() {
        values_on_grid(archive, level, dims, &settings.resources, &Silent, write)?;
    } else {
        GridScan::new(archive, dims, settings)?.run(samples, &Silent, write)?;
    }
    Ok(all.into_inner().unwrap_or_else(PoisonError::into_inner))
}

/// Everything that scan converts an archive.
struct GridScan<'a> {
    visit: Visit<'a>,
    grid: SampleGrid,
    /// Whether the tetrahedra leave gaps in the domain, in which there is no value.
    has_gaps: bool,
    /// Whether tetrahedra may overlap.
    may_overlap: bool,
}

/// Samples that have a value, where tetrahedra may overlap.
struct TakenSamples {
    bits: Vec<AtomicU64>,
    /// Whether a sample was taken twice.
    twice: AtomicBool,
    counted: Mutex<Counted>,
}

/// Bytes for the bits of `samples` samples.
fn taken_bytes(samples: u64) -> u64 {
    8 * samples.div_ceil(64)
}

impl TakenSamples {
    fn new(samples: u64) -> Self {
        let bits = (0..samples.div_ceil(64)).map(|_| AtomicU64::new(0)).collect();
        Self { bits, twice: AtomicBool::new(false), counted: Mutex::default() }
    }

    /// Takes the samples of a run that are still free, and hands them on.
    fn take(&self, first: u64, run: &[f32], write: impl Fn(u64, &[f32]) -> Result<()>) -> Result<()> {
        let is_free = |n: usize| {
            let (word, bit) = ((first + n as u64) / 64, 1 << ((first + n as u64) % 64));
            self.bits[word as usize].fetch_or(bit, Ordering::Relaxed) & bit == 0
        };
        let free: Vec<bool> = (0..run.len()).map(is_free).collect();
        if free.contains(&false) {
            self.twice.store(true, Ordering::Relaxed);
        }
        let (mut at, mut counted) = (0, Counted::default());
        for group in free.chunk_by(|a, b| a == b) {
            let values = &run[at..at + group.len()];
            if group[0] {
                counted.set += values.len() as u64;
                counted.void += values.iter().filter(|v| v.is_nan()).count() as u64;
                write(first + at as u64, values)?;
            }
            at += group.len();
        }
        self.counted.lock().unwrap_or_else(PoisonError::into_inner).add(counted);
        Ok(())
    }
}

impl<'a> GridScan<'a> {
    fn new(archive: &'a StepView, dims: [u64; 3], settings: &'a ProbeSettings) -> Result<Self> {
        let grid = spanning_grid(archive, dims)?;
        let axes = 4 * dims.iter().sum::<u64>();
        let may_overlap = archive.manifest.plan.own.is_some();
        let bits = if may_overlap { taken_bytes(dims.iter().product()) } else { 0 };
        let fixed = estimate::BASE + axes + bits;
        let share = move |memory: u64| memory.saturating_sub(fixed);
        let visit = Visit::new(archive, Blocks::All, &settings.resources, share)?;
        visit.check_memory(4 * WINDOW)?;
        // The tetrahedra of a mesh may overlap, so their volume does not show whether there are
        // gaps.
        let has_gaps = may_overlap || !visit.have_volume_of_box()?;
        Ok(Self { visit, grid, has_gaps, may_overlap })
    }

    /// Hands all samples to `write`, in runs, from any thread in any order; returns the number of
    /// those without a value. Where tetrahedra overlap, some samples are handed on again.
    fn run(
        &mut self,
        samples: u64,
        progress: &dyn Progress,
        write: impl Fn(u64, &[f32]) -> Result<()> + Sync,
    ) -> Result<u64> {
        if self.may_overlap {
            let (mut total, twice) = self.scan_taking(samples, progress, &write)?;
            if twice {
                self.visit.threads = 1;
                total = self.scan_taking(samples, progress, &write)?.0;
            }
            return Ok(total.void + (samples - total.set));
        }
        let total = self.scan(progress, &write)?;
        if total.set == samples || (self.has_gaps && total.set < samples) {
            return Ok(total.void + (samples - total.set));
        }
        let expected = format!("tetrahedra that hold {samples} samples, each once");
        let path = self.visit.archive.path();
        Err(Error::bad_input(path, "tetrahedra", expected, total.set.to_string())
            .with_help("isospan check tells more"))
    }

    /// Hands the samples of all chunks to `write`.
    fn scan(
        &self,
        progress: &dyn Progress,
        write: impl Fn(u64, &[f32]) -> Result<()> + Sync,
    ) -> Result<Counted> {
        progress.begin("probe", self.visit.chunks.len() as u64, "chunks");
        let mut total = Counted::default();
        let job = |_, chunk: DecodedChunk| scan_chunk(&chunk, &self.grid, self.may_overlap, &write);
        self.visit.each(4 * WINDOW, progress, job, |_, counted| {
            total.add(counted);
            Ok(())
        })?;
        Ok(total)
    }

    /// As [`GridScan::scan`], but each sample once. Also returns whether two chunks had the same
    /// one.
    fn scan_taking(
        &self,
        samples: u64,
        progress: &dyn Progress,
        write: impl Fn(u64, &[f32]) -> Result<()> + Sync,
    ) -> Result<(Counted, bool)> {
        let taken = TakenSamples::new(samples);
        self.scan(progress, |first, run: &[f32]| taken.take(first, run, &write))?;
        let counted = taken.counted.into_inner().unwrap_or_else(PoisonError::into_inner);
        Ok((counted, taken.twice.into_inner()))
    }
}

/// Evenly spaced samples from face to face of the domain.
fn spanning_grid(archive: &StepView, dims: [u64; 3]) -> Result<SampleGrid> {
    let lattice = archive.manifest.plan.lattice;
    let far = lattice.max();
    let axis = |a: usize| Axis::even(0, far[a], dims[a]);
    SampleGrid::new(&lattice, [axis(0)?, axis(1)?, axis(2)?])
}

/// The geometry of a grid of `dims` samples that spans a volume.
fn grid_geometry(volume: &Geometry, volume_dims: [u64; 3], dims: [u64; 3]) -> Result<Geometry> {
    if dims.contains(&0) {
        return Err(Error::usage("a grid has at least one sample along each axis"));
    }
    let length = volume_dims.map(|n| (n - 1) as f64);
    let first = std::array::from_fn(|a| if dims[a] == 1 { length[a] / 2.0 } else { 0.0 });
    let voxels = |a: usize| length[a] / (dims[a].max(2) - 1) as f64;
    Ok(Geometry {
        origin: volume.to_world(first),
        spacing: std::array::from_fn(|a| volume.spacing[a] * voxels(a)),
        direction: volume.direction,
    })
}

/// Samples of a chunk.
#[derive(Clone, Copy, Debug, Default)]
struct Counted {
    set: u64,
    void: u64,
}

impl Counted {
    fn add(&mut self, other: Self) {
        self.set += other.set;
        self.void += other.void;
    }
}

/// Samples the tetrahedra of a chunk, and hands runs of samples (the number of the first in the
/// grid, their values) to `write`.
fn scan_chunk(
    chunk: &DecodedChunk,
    grid: &SampleGrid,
    may_overlap: bool,
    write: impl Fn(u64, &[f32]) -> Result<()>,
) -> Result<Counted> {
    let mut counted = Counted::default();
    let Some(whole) = samples_around(chunk, grid) else { return Ok(counted) };
    let mut samples = vec![];
    for window in whole.windows(WINDOW) {
        samples.clear();
        samples.resize(window.len(), f32::from_bits(UNSET));
        let scanner = Scanner::new(grid, &window);
        for tet in &chunk.tets {
            let values = tet.map(|v| chunk.values[v as usize]);
            let void = values.iter().any(|v| v.is_nan());
            scanner.each_run(tet.map(|v| chunk.positions[v as usize]), |place, run| {
                for (sample, &weights) in samples[place..].iter_mut().zip(run) {
                    if !may_overlap || sample.to_bits() == UNSET {
                        *sample = if void { f32::NAN } else { interpolate(weights, values) };
                    }
                }
                counted.set += run.len() as u64;
                counted.void += if void { run.len() as u64 } else { 0 };
            });
        }
        write_runs(&samples, &window, grid.dims(), &write)?;
    }
    Ok(counted)
}

/// The samples in the bounding box of a chunk's tetrahedra.
fn samples_around(chunk: &DecodedChunk, grid: &SampleGrid) -> Option<IndexBox> {
    let mut corners = chunk.tets.iter().flatten().map(|&v| chunk.positions[v as usize]);
    let first = corners.next()?;
    let (lo, hi) = corners.fold((first, first), |(lo, hi), p| {
        (std::array::from_fn(|a| p[a].min(lo[a])), std::array::from_fn(|a| p[a].max(hi[a])))
    });
    Some(grid.within(lo, hi)).filter(|b| !b.is_empty())
}

/// Hands on the runs of samples that were set, row by row.
fn write_runs(
    samples: &[f32],
    window: &IndexBox,
    dims: [u64; 3],
    write: impl Fn(u64, &[f32]) -> Result<()>,
) -> Result<()> {
    let width = window.dims()[0] as usize;
    let is_set = |v: &f32| v.to_bits() != UNSET;
    for (n, row) in samples.chunks(width).enumerate() {
        let rows = window.dims()[1];
        let (y, z) = (window.lo[1] + n as u64 % rows, window.lo[2] + n as u64 / rows);
        let first = (z * dims[1] + y) * dims[0] + window.lo[0];
        let mut at = 0;
        for run in row.chunk_by(|a, b| is_set(a) == is_set(b)) {
            if is_set(&run[0]) {
                write(first + at, run)?;
            }
            at += run.len() as u64;
        }
    }
    Ok(())
}
