//! Estimates what a run needs before it starts: memory, disk, time. Also says how the memory that
//! it gets is shared out.
//!
//! Only these grow with the input, and each has its part of the budget:
//!
//! ```text
//!  memory = BASE                    the process itself, buffers of readers and writers
//!         + workers · chunk         a chunk at work: its points, their tetrahedra, its values, its blocks
//!         + workers · extra         its values at further steps; samples of the source, errors
//!         + workers · 3 products    encoded chunks that wait for their turn to be written
//!         + steps · cache           decoded chunks of each step's source: see `inputs::access`
//!         + workers · decoding      a chunk of a source while it is decoded
//!  memory >= BASE + decoder         before: a stream is copied into bricks, chunk by chunk of its own
//!  memory >= BASE + index           afterwards, when the first two are gone: see below
//! ```
//!
//! The bytes of a chunk follow from the number of points of its region (core and halo), which the
//! point set counts without listing them. If the budget does not hold as many chunks as there are
//! threads, fewer run. A chunk whose halo must be widened beyond them waits until it is alone
//! and has all of them (`reduce::encode`). The index is built in the memory that there is; what
//! does not fit is sorted in the scratch folder.

use super::finding::Notice;
use super::{MeshParts, Plan};
use crate::archive::manifest::{BLOCK_TETS, MeshPlan};
use crate::fit::window_edge;
use crate::index::BuildSettings;
use crate::pipeline::settings::{RunSettings, Target};
use isospan_io::error::{Error, Result};
use isospan_io::geom::{LatticeBox, LatticePos};
use isospan_io::grid::{Chunk, ChunkGrid, ChunkId};
use isospan_mesh::points::{PointSet, SetKind};
use isospan_mesh::raster::BatchScan;
use isospan_wavelet::{CHUNK, PART};
use serde::Serialize;
use std::path::Path;

/// What the process needs for any work: code and tables, stacks, buffers of readers and writers.
pub(in crate::pipeline) const BASE: u64 = 16 << 20;
/// Working memory of a chunk for a point of its region, measured (all point sets, chunks of 30 000
/// to 500 000 points, one and two workers took at most 550 in all, what waits to be written
/// included) and rounded up: 6.8 tetrahedra of 64 bytes, where they are meshed and stay, sort keys
/// and sites of 100 bytes, then the memory that finds samples and sums up the spectrum, and what
/// the C library holds back between workers. Fitting values uses the part of the first that is
/// empty then.
const PER_POINT: u64 = 600;
/// In addition, for each further step, its value; and for each eight steps, which are measured
/// together: values; values, where they lie in the spectrum, counts.
const FURTHER_PER_POINT: u64 = 4;
const LANES_PER_POINT: u64 = 104;
/// In addition, where values are fitted: fitted values; for each eight steps but the first, sums;
/// and for each eight, weights, where voids differ.
const FITTED_PER_POINT: u64 = 4;
const SUMS_PER_POINT: u64 = 168;
const WEIGHTS_PER_POINT: u64 = 64;
/// And for any number of points: the samples around a brick, the encoder's tables.
const PER_CHUNK: u64 = 4 << 20;
/// Bytes of a point's share of an encoded chunk, at most: its value, and a little more than 6
/// tetrahedra.
const PRODUCT_PER_POINT: u64 = 26;
/// Bytes of a point's share of the encoded values of a further step: a value, which halo points
/// have too, and ranges of blocks.
const STEP_PER_POINT: u64 = 6;
/// Encoded chunks, for each worker, that may wait for their turn.
const WAITING: u64 = 3;
/// Tetrahedra a point; bytes of an index entry while the index is built in memory, and on disk.
const TETS_PER_POINT: u64 = 7;
const INDEX_ENTRY: u64 = 25;
const INDEX_ENTRY_ON_DISK: u64 = 48;
/// Bytes of an archive for a point: tetrahedra, a value, its share of tables. Points of fields and
/// of noise take 4 to 6, vertices of a mesh that is kept up to 9, points of a mask 3.
const ARCHIVE_PER_POINT: u64 = 6;
/// And for a point of a further step: a value, its share of ranges, index and spectrum.
const VALUES_PER_POINT: u64 = 4;
/// Bytes of a step, however few points it has.
const ARCHIVE_PER_STEP: u64 = 4 << 10;
/// The time of a further step, as a part of the first, and that of a further pass: the mesh is
/// decoded and scanned again, and where values are fitted, what is around it found (0.7), or all of
/// it made again (0.9).
const FURTHER_STEP: f64 = 0.06;
const FURTHER_PASS: f64 = 0.35;
const FURTHER_FITTED_PASS: f64 = 0.8;
/// Points a second of one thread, meshed and encoded, on a machine of 2020: rough.
const POINTS_PER_SECOND: f64 = 150_000.0;
/// Samples of a pyramid.
const SAMPLES_PER_SECOND: f64 = 5_000_000.0;
/// The most chunks that are checked to find the largest.
const MOST_LOOKED_AT: u64 = 1 << 16;

/// Halo width in quarters of the mean point spacing. All points within the first are inserted at
/// once; those within the second are known, and inserted where a tetrahedron needs them. The second
/// is doubled as often as a sphere leaves it.
const NEAR_QUARTERS: u64 = 7;
const HALO_QUARTERS: u64 = 12;
/// More of both where the tetrahedra around the chunk's are needed: they reach one edge further.
const STAR_QUARTERS: u64 = 6;
/// And more memory: the samples of a window, each with its tetrahedron and weights.
const PER_FIT: u64 = 8 << 20;

/// Steps whose files are open, and whose values are made, at a time.
pub(in crate::pipeline) const MOST_STEPS_AT_ONCE: u64 = 32;
/// The same where there are no more points than this: to make their mesh again, or to decode it, is
/// then a large part of the cost.
pub(in crate::pipeline) const MOST_SMALL_STEPS_AT_ONCE: u64 = 64;
const FEW_POINTS: u64 = 1 << 16;

/// Samples of a step that are read at a time: those around a block are fewer, except in coarse
/// meshes.
pub(in crate::pipeline) const ERROR_WINDOW: u64 = 1 << 16;

/// What a chunk needs of its surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pipeline) enum Halo {
    /// What proves its own tetrahedra.
    Owned,
    /// What proves all tetrahedra at the vertices of its own: values are fitted to the samples in
    /// them.
    Stars,
}

impl Halo {
    pub(in crate::pipeline) fn of(plan: &MeshPlan) -> Self {
        if plan.stars { Self::Stars } else { Self::Owned }
    }

    fn extra_quarters(self) -> u64 {
        match self {
            Self::Owned => 0,
            Self::Stars => STAR_QUARTERS,
        }
    }
}

/// The core of a chunk with its halo, widened `retries` times.
pub(in crate::pipeline) fn region(
    points: &PointSet,
    core: &LatticeBox,
    domain: &LatticeBox,
    halo: Halo,
    retries: u32,
) -> LatticeBox {
    core.grow_sides(widths(points, core, HALO_QUARTERS + halo.extra_quarters(), retries), domain)
}

/// The core of a chunk with its inner halo, whose points are all inserted.
pub(in crate::pipeline) fn near(
    points: &PointSet,
    core: &LatticeBox,
    domain: &LatticeBox,
    halo: Halo,
) -> LatticeBox {
    core.grow_sides(widths(points, core, NEAR_QUARTERS + halo.extra_quarters(), 0), domain)
}

/// On the low sides, and on the high ones.
fn widths(points: &PointSet, core: &LatticeBox, quarters: u64, retries: u32) -> [LatticePos; 2] {
    let factor = quarters << retries.min(40);
    let width = |s: u32| u32::try_from(u64::from(s).saturating_mul(factor) / 4).unwrap_or(u32::MAX);
    points.spacing_around(core).map(|side| side.map(width))
}

/// Bytes in which a part of a chunk of a pyramid is made, and those of its chunk that wait: its
/// samples with a halo, as they are and in tiles, low coefficients.
fn part_bytes(dims: [u64; 3], edge: usize) -> u64 {
    let of = |n: usize| dims.map(|d| d.min(n as u64 + 1)).iter().product::<u64>();
    8 * of(edge + 64) + 6 * of(edge) + of(CHUNK) / 2 + (4 << 20)
}

/// Samples along each axis of the parts in which a chunk of a pyramid is made in some memory.
pub(in crate::pipeline) fn part_edge(dims: [u64; 3], memory: u64) -> usize {
    if part_bytes(dims, CHUNK) <= memory { CHUNK } else { PART }
}

/// Bytes in which a chunk with `points_in_region` points in its region is meshed, sampled and
/// encoded.
pub(in crate::pipeline) fn chunk_bytes(points_in_region: u64, halo: Halo) -> u64 {
    let fixed = match halo {
        Halo::Owned => PER_CHUNK,
        Halo::Stars => PER_CHUNK + PER_FIT,
    };
    points_in_region.saturating_mul(PER_POINT).saturating_add(fixed)
}

/// The most bytes of an encoded chunk of `core_points` points, with the values of `steps` steps.
pub(in crate::pipeline) fn product_bytes(core_points: u64, steps: u64) -> u64 {
    let further = steps.saturating_sub(1);
    let per_point = PRODUCT_PER_POINT.saturating_add(STEP_PER_POINT.saturating_mul(further));
    core_points.saturating_mul(per_point).saturating_add((256 << 10) + further * (32 << 10))
}

/// The memory of a run, as it is shared out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pipeline) struct Shares {
    /// For the process itself, and what is in memory all the time.
    base: u64,
    /// Chunks at work at one time.
    pub(in crate::pipeline) workers: usize,
    /// Working memory of each.
    pub(in crate::pipeline) chunk: u64,
    /// For all encoded chunks that wait.
    pub(in crate::pipeline) queue: u64,
    /// In addition, for each chunk at work: the values of further steps, and what measures errors.
    pub(super) extra: u64,
}

impl Shares {
    /// The working memory of a chunk that is alone.
    pub(in crate::pipeline) fn all_chunks(&self) -> u64 {
        self.chunk * self.workers as u64
    }

    /// The memory with which such a chunk could be made.
    pub(in crate::pipeline) fn memory_for(&self, chunk: u64) -> u64 {
        self.base + self.queue + self.extra + chunk
    }
}

/// What the largest chunks of a plan need, and the index of all.
#[derive(Clone, Copy, Debug)]
pub(in crate::pipeline) struct Need {
    /// The process itself, how dense the points are, and what else is there all the time.
    base: u64,
    points: u64,
    chunks: u64,
    chunk: u64,
    /// Points of the largest region.
    region_points: u64,
    /// Points of the largest chunk, encoded with the values of `steps` steps.
    core_points: u64,
    steps: u64,
    held: Held,
    /// Samples of a window, where values are fitted to those.
    window: u64,
    /// Entries of the index.
    entries: u64,
    /// Bytes of an archive of one step for a point.
    archive_per_point: u64,
    /// Points a second of one thread.
    points_per_second: f64,
}

/// What is in memory besides the chunks at work.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::pipeline) struct Held {
    /// Bytes that are there all the time.
    pub(in crate::pipeline) always: u64,
    /// Bytes of decoded chunks that are cached of the source of each step.
    pub(in crate::pipeline) by_step: u64,
    /// Bytes that those of several steps may have together.
    pub(in crate::pipeline) most: u64,
    /// Bytes in which each worker decodes a chunk of a source.
    pub(in crate::pipeline) by_worker: u64,
}

impl Need {
    pub(in crate::pipeline) fn of(parts: &MeshParts) -> Self {
        if parts.points.spec().kind() == SetKind::Pyramid {
            return Self::of_pyramid(parts);
        }
        let (mut region_points, mut core_points) = (0, 0);
        let domain = parts.chunks.bricks().lattice.domain();
        for chunk in some_chunks(&parts.chunks) {
            region_points = region_points.max(parts.points.count_in(&region(
                &parts.points,
                &chunk.core,
                &domain,
                parts.halo,
                0,
            )));
            core_points = core_points.max(parts.points.count_in(&chunk.core));
        }
        let [region_points, core_points, points] =
            [region_points, core_points, parts.points.len()].map(|n| n.saturating_mul(parts.times));
        Self {
            base: BASE + parts.points.levels().map_or(0, |l| l.as_slice().len() as u64),
            points,
            chunks: parts.chunks.len(),
            chunk: chunk_bytes(region_points, parts.halo),
            region_points,
            core_points,
            steps: 1,
            held: Held::default(),
            window: match parts.halo {
                Halo::Owned => 0,
                Halo::Stars => window_edge(parts.chunks.bricks().voxels()).iter().product(),
            },
            entries: points.saturating_mul(TETS_PER_POINT) / u64::from(BLOCK_TETS) + parts.chunks.len(),
            archive_per_point: ARCHIVE_PER_POINT,
            points_per_second: POINTS_PER_SECOND,
        }
    }

    /// The need of a pyramid, whose chunks are made in the smallest parts where there is little
    /// memory.
    fn of_pyramid(parts: &MeshParts) -> Self {
        let dims = parts.chunks.bricks().lattice.dims;
        let core = dims.map(|n| n.min(CHUNK as u64 + 1)).iter().product::<u64>();
        let points = parts.points.len();
        Self {
            base: BASE,
            points,
            chunks: parts.chunks.len(),
            chunk: part_bytes(dims, PART),
            region_points: 0,
            core_points: core / 64,
            steps: 1,
            held: Held::default(),
            window: 0,
            entries: points / 32_768 + parts.chunks.len(),
            archive_per_point: 1,
            points_per_second: SAMPLES_PER_SECOND,
        }
    }

    /// The same with as many of `steps` made at a time, at most `most`, as takes the least time:
    /// more of them make fewer passes over the mesh, but the memory that they take may cost
    /// threads.
    pub(super) fn with_steps(self, steps: u64, most: u64, memory: u64, threads: usize) -> Self {
        let of = |steps| Self { steps, ..self };
        let most = self.held.most.checked_div(self.held.by_step).map_or(most, |n| n.clamp(1, most));
        let useful = (threads as u64).min(self.chunks).max(1);
        let choices = (1..=useful).rev().filter_map(|workers| {
            let need = (1..=most.min(steps)).rev().map(of).find(|need| need.of_workers(workers) <= memory)?;
            Some((need.work(steps) / workers as f64, need))
        });
        // The most threads of those that are equal.
        choices.reduce(|a, b| if b.0 < a.0 { b } else { a }).map_or(of(1), |(_, need)| need)
    }

    /// The work of `steps` steps, in units of that of the first one.
    fn work(&self, steps: u64) -> f64 {
        let pass = if self.window == 0 { FURTHER_PASS } else { FURTHER_FITTED_PASS };
        let passes = steps.div_ceil(self.steps).max(1);
        1.0 + pass * (passes - 1) as f64 + FURTHER_STEP * steps.saturating_sub(1) as f64
    }

    /// Steps that are made at a time.
    pub(in crate::pipeline) fn steps(&self) -> usize {
        self.steps as usize
    }

    /// Memory that is in use all the time while chunks are made.
    fn base(&self) -> u64 {
        let Held { always, by_step, .. } = self.held;
        self.base.saturating_add(always).saturating_add(by_step.saturating_mul(self.steps))
    }

    fn product(&self) -> u64 {
        product_bytes(self.core_points, self.steps)
    }

    /// Bytes in addition to those of a chunk: the values of the steps after the first, what
    /// measures the errors of all, and what decodes samples.
    fn extra(&self) -> u64 {
        let (further, groups) = (self.steps - 1, if self.steps > 1 { self.steps.div_ceil(8) } else { 0 });
        let (per_point, window) = match self.window {
            0 => (further * FURTHER_PER_POINT + groups * LANES_PER_POINT, 0),
            window => {
                let per_point = further * (FURTHER_PER_POINT + FITTED_PER_POINT)
                    + groups * (LANES_PER_POINT + WEIGHTS_PER_POINT)
                    + groups.saturating_sub(1) * SUMS_PER_POINT;
                // The samples of eight steps are there at a time.
                (per_point, window.saturating_mul(4 * further.min(7)))
            }
        };
        let work = error_bytes(self.steps).max(window).saturating_add(self.held.by_worker);
        per_point.saturating_mul(self.region_points).saturating_add(work)
    }

    fn of_workers(&self, workers: u64) -> u64 {
        let each = self.chunk.saturating_add(self.extra()).saturating_add(WAITING * self.product());
        self.base().saturating_add(each.saturating_mul(workers).max(BuildSettings::LEAST_MEMORY))
    }

    /// Scratch space with which the index is built, where `memory` does not hold it.
    fn index_scratch(&self, memory: u64) -> u64 {
        let room = memory.saturating_sub(self.base + self.held.always + BuildSettings::LEAST_MEMORY);
        if self.entries * INDEX_ENTRY <= room { 0 } else { self.entries * INDEX_ENTRY_ON_DISK }
    }

    /// The least memory that works: one chunk at a time.
    pub(super) fn least(&self) -> u64 {
        self.of_workers(1)
    }

    /// Memory with which `threads` threads work, as far as there are chunks for them.
    pub(in crate::pipeline) fn comfortable(&self, threads: usize) -> u64 {
        self.of_workers((threads as u64).min(self.chunks))
    }

    /// Roughly the seconds of `workers` workers for `steps` steps.
    pub(in crate::pipeline) fn seconds(&self, workers: usize, steps: usize) -> f64 {
        self.points as f64 * self.work(steps as u64) / (self.points_per_second * workers.max(1) as f64)
    }

    /// Shares `memory` out to at most `threads` workers.
    ///
    /// # Errors
    /// [`Error::Budget`] when it does not suffice for one.
    pub(in crate::pipeline) fn shares(&self, memory: u64, threads: usize) -> Result<Shares> {
        if memory < self.least() {
            return Err(Error::memory("", self.least(), memory));
        }
        let useful = (threads as u64).min(self.chunks).max(1);
        let workers = (1..=useful).rev().find(|&w| self.of_workers(w) <= memory).unwrap_or(1);
        let queue = workers * WAITING * self.product();
        let (base, extra) = (self.base(), self.extra());
        let each = (memory - base - queue) / workers;
        Ok(Shares { base, workers: workers as usize, chunk: each - extra, queue, extra })
    }
}

/// What the chunks need, and what is held besides, with as many steps at a time as the memory
/// allows.
pub(in crate::pipeline) fn need_of(
    parts: &MeshParts,
    held: Held,
    steps: usize,
    memory: u64,
    run: &RunSettings,
) -> Need {
    let few = parts.points.len() <= FEW_POINTS;
    let most = if few { MOST_SMALL_STEPS_AT_ONCE } else { MOST_STEPS_AT_ONCE };
    let need = Need { held, ..Need::of(parts) };
    need.with_steps(steps as u64, most, memory, run.resources.worker_threads())
}

/// Bytes that measuring a chunk at `steps` steps takes: samples, those of up to eight steps once
/// more while they are interleaved, sums.
pub(in crate::pipeline) const fn error_bytes(steps: u64) -> u64 {
    // As they are interleaved.
    let lanes = match steps % 8 {
        0 | 1 => steps,
        2..=4 => steps / 8 * 8 + 4,
        _ => steps / 8 * 8 + 8,
    };
    let more = match steps {
        0 | 1 => 0,
        2..8 => steps,
        _ => 8,
    };
    (lanes + more) * 4 * ERROR_WINDOW + steps * (116 << 10) + (256 << 10) + BatchScan::BYTES
}

/// All chunks, or as many of them, evenly spread.
pub(in crate::pipeline) fn some_chunks(chunks: &ChunkGrid) -> impl Iterator<Item = Chunk> + use<'_> {
    let step = chunks.len().div_ceil(MOST_LOOKED_AT).max(1);
    (0..chunks.len()).step_by(step as usize).map(|c| chunks.chunk(ChunkId(c)))
}

/// What is known of a search for a target before its first try. The rest of the estimate is that of
/// the first try.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SearchEstimate {
    /// What is wanted.
    pub target: Target,
    /// How many tries there will be, about.
    pub tries: u32,
    /// Bytes of the archive: the least, and about the most, that the search may end with.
    pub archive_bytes: [u64; 2],
    /// Seconds of all tries, roughly.
    #[serde(rename = "estimated_seconds")]
    pub seconds: f64,
}

/// What a reduction needs, and what there is.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Estimate {
    /// Samples of the volume.
    pub samples: u64,
    /// Points of the archive, boundary included.
    pub points: u64,
    /// Chunks.
    pub chunks: u64,
    /// Memory the run was given.
    pub memory: u64,
    /// The least memory that works: one chunk at a time.
    pub memory_least: u64,
    /// Memory with which all threads work.
    pub memory_comfortable: u64,
    /// Chunks at work at one time with the memory given; 0 when it does not suffice.
    pub workers: usize,
    /// Bytes of the archive, about: most fields take fewer, noise takes more.
    pub archive_bytes: u64,
    /// Bytes of the source: its files, or its samples as they are stored, whichever is less. None
    /// where that is not known.
    pub source_bytes: Option<u64>,
    /// Bytes that are free for the archive, including what is there of it already; `None` where
    /// the system does not say.
    pub archive_free: Option<u64>,
    /// Bytes of the temporary copy of an input that has no random access, or of the index while it
    /// is built.
    pub scratch_bytes: u64,
    /// Bytes that are free for it.
    pub scratch_free: Option<u64>,
    /// What samples lose when they become `f32`, at most, where that matters; errors will include
    /// it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rounding: Option<f64>,
    /// Seconds of work, roughly: from the speed of a machine of 2020.
    #[serde(rename = "estimated_seconds")]
    pub seconds: f64,
    /// Of a target: what is known of the search.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub search: Option<SearchEstimate>,
    /// What the user should know: see [`Notice`].
    pub notices: Vec<Notice>,
    #[serde(skip)]
    archive: std::path::PathBuf,
    #[serde(skip)]
    scratch: std::path::PathBuf,
}

/// What an estimate is asked about.
pub(in crate::pipeline) struct Question<'a> {
    pub(in crate::pipeline) plan: &'a Plan,
    pub(in crate::pipeline) need: &'a Need,
    pub(in crate::pipeline) memory: u64,
    pub(in crate::pipeline) threads: usize,
    pub(in crate::pipeline) out: &'a Path,
    /// Bytes of the archive that are there already.
    pub(in crate::pipeline) there: u64,
    /// Folder and bytes of the temporary copy.
    pub(in crate::pipeline) scratch: (&'a Path, u64),
    /// Memory to make that copy in; 0 where none is made.
    pub(in crate::pipeline) copying: u64,
}

impl Estimate {
    pub(in crate::pipeline) fn new(q: &Question<'_>) -> Self {
        let workers = q.need.shares(q.memory, q.threads).map_or(0, |s| s.workers);
        let further = q.plan.steps.len() as u64 - 1;
        Self {
            samples: q.plan.first().source.dims.iter().product(),
            points: q.need.points,
            chunks: q.need.chunks,
            memory: q.memory,
            memory_least: q.need.least().max(q.copying),
            memory_comfortable: q.need.comfortable(q.threads).max(q.copying),
            workers,
            archive_bytes: q
                .need
                .points
                .saturating_mul(q.need.archive_per_point + VALUES_PER_POINT * further)
                + ARCHIVE_PER_STEP * (1 + further),
            source_bytes: None,
            archive_free: free_bytes(q.out).map(|free| free.saturating_add(q.there)),
            // The copy of the input is gone when the index is built.
            scratch_bytes: q.scratch.1.max(q.need.index_scratch(q.memory)),
            scratch_free: free_bytes(q.scratch.0),
            rounding: q.plan.steps.iter().filter_map(|s| s.source.notable_rounding()).reduce(f64::max),
            seconds: q.need.seconds(workers, q.plan.steps.len()),
            search: None,
            notices: vec![],
            archive: q.out.to_path_buf(),
            scratch: q.scratch.0.to_path_buf(),
        }
    }

    /// Whether the run can be expected to work.
    ///
    /// # Errors
    /// [`Error::Budget`] naming what is too small, and the least that would do.
    pub fn check(&self) -> Result<()> {
        if self.memory_least > self.memory {
            return Err(Error::memory("", self.memory_least, self.memory));
        }
        let enough = |folder: &Path, needed: u64, free: Option<u64>| match free {
            Some(free) if needed > free => Err(Error::disk(folder, needed, free)),
            _ => Ok(()),
        };
        enough(&self.archive, self.archive_bytes, self.archive_free)?;
        enough(&self.scratch, self.scratch_bytes, self.scratch_free)
    }
}

/// Bytes while a shared edge is open: its record, its place in the table, and what closing it
/// takes.
const OPEN_EDGE: u64 = 170;
/// Bytes for a tetrahedron of an active block of a chunk that is being extracted (its part of the
/// surface, if it is active), for a vertex of the chunk and each isovalue, and for a chunk of any
/// size.
const ACTIVE_TET: u64 = 120;
pub(in crate::pipeline) const SURFACE_PER_VERTEX: u64 = 8;
pub(in crate::pipeline) const VALUE_PER_VERTEX: u64 = 4;
const DECODED_CHUNK: u64 = 1 << 20;
/// Bytes of an active block while it is known.
const ACTIVE_BLOCK: u64 = 64;

/// The memory of an extraction, as it is shared out: finished vertices and triangles (the rest goes
/// to the scratch folder), edges that chunks to come may share, chunks being extracted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pipeline) struct SurfaceShares {
    pub(in crate::pipeline) finished: u64,
    pub(in crate::pipeline) open_edges: u64,
    pub(in crate::pipeline) batch: u64,
    rest: u64,
}

impl SurfaceShares {
    /// # Errors
    /// [`Error::Budget`] when the memory does not hold the largest chunk.
    pub(in crate::pipeline) fn of(memory: u64, active_blocks: u64, largest_chunk: u64) -> Result<Self> {
        let fixed = BASE + active_blocks * ACTIVE_BLOCK;
        let needed = fixed.saturating_add(largest_chunk.saturating_mul(8).div_ceil(5));
        if memory < needed {
            return Err(Error::memory("", needed, memory));
        }
        let rest = memory - fixed;
        Ok(Self { finished: rest / 8, open_edges: rest / 4 / OPEN_EDGE, batch: rest / 8 * 5, rest })
    }

    /// The shares of each of several questions that are answered together; chunks are worked on for
    /// all of them.
    pub(in crate::pipeline) fn of_each(&self, questions: u64) -> Self {
        Self { finished: self.finished / questions, open_edges: self.open_edges / questions, ..*self }
    }

    /// The error for more open edges than there is memory for.
    pub(in crate::pipeline) fn too_many_open(&self, memory: u64, open: u64) -> Error {
        let needed = memory - self.rest + 4 * open.saturating_mul(OPEN_EDGE);
        Error::memory("for edges that chunks share", needed, memory)
    }
}

/// Bytes in which a chunk of `vertices` vertices, of `per_vertex` bytes each, is extracted; a
/// tetrahedron counts for each isovalue for which its block is active.
pub(in crate::pipeline) fn extraction_bytes(vertices: u64, per_vertex: u64, tets: u64) -> u64 {
    DECODED_CHUNK
        .saturating_add(vertices.saturating_mul(per_vertex))
        .saturating_add(tets.saturating_mul(ACTIVE_TET))
}

/// Bytes free for us on the file system of a path, or of the nearest folder above it that is there.
#[cfg(unix)]
pub(in crate::pipeline) fn free_bytes(path: &Path) -> Option<u64> {
    let path = std::path::absolute(path).ok()?;
    let there = path.ancestors().find(|p| p.exists())?;
    let stat = rustix::fs::statvfs(there).ok()?;
    stat.f_bavail.checked_mul(stat.f_frsize)
}

#[cfg(not(unix))]
pub(in crate::pipeline) fn free_bytes(_path: &Path) -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEED: Need = Need {
        base: BASE,
        points: 1 << 20,
        chunks: 9,
        chunk: 100 << 20,
        region_points: 100_000,
        core_points: 70_000,
        steps: 1,
        held: Held { always: 0, by_step: 0, most: 0, by_worker: 0 },
        window: 0,
        entries: 1 << 15,
        archive_per_point: ARCHIVE_PER_POINT,
        points_per_second: POINTS_PER_SECOND,
    };
    const PRODUCT: u64 = 70_000 * 26 + (256 << 10);

    #[test]
    fn fewer_work_where_memory_is_short() {
        let least = NEED.least();
        let each = (100 << 20) + error_bytes(1) + 3 * PRODUCT;
        assert_eq!(least, BASE + each);
        for (memory, workers) in [(least, 1), (least + each, 2), (u64::MAX / 2, 4)] {
            let shares = NEED.shares(memory, 4).unwrap();
            assert_eq!(shares.workers, workers);
            assert!(shares.chunk >= NEED.chunk && shares.memory_for(shares.all_chunks()) <= memory);
        }
        assert_eq!(NEED.shares(u64::MAX / 2, 100).unwrap().workers, 9, "not more than there are chunks");
        let error = NEED.shares(least - 1, 4).unwrap_err();
        assert!(matches!(error, Error::Budget { needed, .. } if needed == least), "{error}");
    }

    #[test]
    fn fewer_steps_at_a_time_where_memory_is_short() {
        let steps = |memory| NEED.with_steps(16, 16, memory, 1).steps();
        let least = NEED.least();
        assert_eq!(
            (steps(least - 1), steps(least), steps(least + (16 << 20)), steps(1 << 40)),
            (1, 1, 3, 16)
        );
        assert!(NEED.with_steps(16, 16, least + (16 << 20), 1).least() <= least + (16 << 20));
    }

    #[test]
    fn threads_are_given_up_for_steps_where_that_is_faster() {
        let steps_of = |need: Need| Need { steps: 32, ..need }.least();
        let found = |need: Need, memory| {
            let need = need.with_steps(32, 32, memory, 2);
            (need.steps(), need.shares(memory, 2).unwrap().workers)
        };
        // Two workers have room for a step each; one for all of them.
        let memory = NEED.of_workers(2).max(steps_of(NEED));
        assert_eq!(found(NEED, memory), (32, 1));
        // One pass less is not worth a thread.
        let two = Need { steps: 16, ..NEED }.of_workers(2);
        assert!(two >= steps_of(NEED));
        assert_eq!(found(NEED, two), (16, 2));
        let fitted = Need { window: 30 * 30 * 30, ..NEED };
        // The sums of fitted values take more for each eight steps: in the memory of all of them
        // two workers have eight each, which is faster.
        let memory = fitted.of_workers(2).max(steps_of(fitted));
        assert_eq!(found(fitted, memory), (8, 2));
    }

    #[test]
    fn each_step_has_a_cache_and_each_worker_decodes() {
        let cache = 40 << 20;
        let of = |most| Need { held: Held { by_step: cache, most, by_worker: 1 << 20, always: 0 }, ..NEED };
        assert_eq!(of(0).least(), NEED.least() + cache + (1 << 20));
        assert_eq!(of(0).of_workers(3), NEED.of_workers(3) + cache + (3 << 20));
        let steps = |most| of(most).with_steps(16, 16, 1 << 40, 1).steps();
        assert_eq!([steps(0), steps(3 * cache), steps(1 << 40)], [1, 3, 16]);
    }

    #[test]
    fn a_large_index_needs_scratch_and_not_memory() {
        let need = Need { entries: 1 << 30, ..NEED };
        assert_eq!(need.least(), NEED.least());
        assert_eq!((NEED.index_scratch(need.least()), need.index_scratch(need.least())), (0, 48 << 30));
        assert_eq!(need.index_scratch(64 << 30), 0);
    }

    #[cfg(unix)]
    #[test]
    fn free_space_is_that_of_the_nearest_folder() {
        let folder = tempfile::tempdir().unwrap();
        assert!(free_bytes(&folder.path().join("a/b/c")).unwrap() > 0);
    }
}
