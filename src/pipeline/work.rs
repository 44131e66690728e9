//! Making the segments of an archive: reader, compute and writer, joined by queues bounded in bytes.
//!
//! ```text
//!  feeder thread ──▶ compute pool ─────────────▶ writer (this thread)
//!  takes a permit    mesh, sample, encode          puts chunks in order,
//!  for the chunk,    one chunk a job               appends to the segments,
//!  reads ahead                                     gives the permit back
//! ```
//!
//! The feeder takes a permit for the memory that a chunk will need before it hands the chunk on, so the number of chunks in
//! flight follows from the budget. A job of the pool never waits. The writer releases chunks in order: the bytes
//! written do not depend on threads or on which chunk is ready first.

use super::chunk::{self, MeshedChunk, Recipe};
use super::layout::Layout;
use super::plan::Plan;
use crate::archive::chunk::{ChunkVertices, encode_chunk};
use crate::archive::chunked::{ChunkSegment, ChunkSegmentWriter};
use crate::archive::segment::SegmentKind;
use crate::archive::summary::{BlockRange, MeshSummary, ValueSummary};
use crate::archive::values::encode_values;
use crate::error::{Error, Result};
use crate::exec::{CancelToken, MemoryBudget, Permit, Progress, Reorder};
use crate::geom::predicates::signed_volume6;
use crate::grid::{Chunk, ChunkGrid, ChunkId};
use crate::mesh::delaunay::Mesher;
use crate::mesh::tet::Tet;
use crate::volume::VolumeReader;
use crossbeam::channel;
use std::any::Any;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A chunk ready to be written.
struct Product {
    points: u64,
    mesh_blocks: Vec<Vec<u8>>,
    value_blocks: Vec<Vec<u8>>,
    times: StageTimes,
}

/// Time spent in each stage, summed over threads.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StageTimes {
    pub(crate) mesh: Duration,
    pub(crate) sample: Duration,
    pub(crate) encode: Duration,
    pub(crate) write: Duration,
}

impl StageTimes {
    fn add(&mut self, other: &Self) {
        self.mesh += other.mesh;
        self.sample += other.sample;
        self.encode += other.encode;
        self.write += other.write;
    }
}

/// What the work needs besides the plan.
pub(crate) struct Work<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) recipe: &'a Recipe<'a>,
    pub(crate) chunks: &'a ChunkGrid,
    pub(crate) layout: &'a Layout,
    pub(crate) reader: &'a dyn VolumeReader,
    pub(crate) pool: &'a rayon::ThreadPool,
    pub(crate) budget: &'a MemoryBudget,
    pub(crate) cancel: &'a CancelToken,
    pub(crate) progress: &'a dyn Progress,
}

/// Bytes that a chunk needs while it is meshed, sampled and encoded, from the number of its points.
///
/// A point with its share of the halo (1.35 at the default chunk size) has 6.8 tetrahedra of 64 bytes while it is meshed,
/// and 16 bytes more for each tetrahedron that is kept, twice while they are put in order; positions, values and encoded
/// blocks are small beside that.
pub(crate) fn chunk_bytes(plan: &Plan, points: u64) -> u64 {
    const PER_POINT: u64 = 1200;
    const AT_LEAST: u64 = 4 << 20;
    plan.mesh.chunk_target.min(points).saturating_mul(PER_POINT).saturating_add(AT_LEAST)
}

/// Makes all segments that are not there yet. Returns the time spent in each stage.
pub(crate) fn make_segments(work: &Work<'_>) -> Result<StageTimes> {
    let mut times = StageTimes::default();
    for segment in 0..work.layout.segment_count() {
        let chunks = work.layout.chunks_of(segment);
        if is_done(work, segment) {
            work.progress.advance(points_in(work, &chunks));
            continue;
        }
        times.add(&make_segment(work, segment, chunks)?);
    }
    Ok(times)
}

fn points_in(work: &Work<'_>, chunks: &Range<u64>) -> u64 {
    chunks.clone().map(|c| work.recipe.points.count_in(&work.chunks.chunk(ChunkId(c)).core)).sum()
}

/// Done means that both files are there, belong to this plan, and verify; not that they exist.
fn is_done(work: &Work<'_>, segment: u64) -> bool {
    let chunks = work.layout.chunks_of(segment);
    let whole = |path: PathBuf, kind, hash| match ChunkSegment::open(path, kind, Some(hash)) {
        Ok(s) => s.chunks() == chunks && s.segment().verify().is_ok(),
        Err(_) => false,
    };
    whole(work.layout.mesh(segment), SegmentKind::Mesh, work.plan.mesh_hash())
        && whole(work.layout.values(segment), SegmentKind::Values, work.plan.step_hash())
}

fn make_segment(work: &Work<'_>, segment: u64, chunks: Range<u64>) -> Result<StageTimes> {
    let mut sink = Sink::create(work, segment, ChunkId(chunks.start))?;
    let (to_pool, tasks) = channel::unbounded::<(Chunk, Permit)>();
    let (to_writer, products) = channel::unbounded::<(u64, Result<Product>, Permit)>();
    let meshers = Mutex::new(Vec::<Mesher>::new());
    let stop = CancelToken::new();
    let outcome = std::thread::scope(|threads| {
        // Feeder: the queues need no bound of their own, every entry holds a permit of the budget.
        let feeder = threads.spawn(|| {
            let bytes = chunk_bytes(work.plan, work.recipe.points.len()).min(work.budget.total());
            for id in chunks.clone() {
                if stop.is_cancelled() {
                    break;
                }
                let permit = work.budget.acquire(bytes, work.cancel)?;
                let chunk = work.chunks.chunk(ChunkId(id));
                work.reader.will_need(chunk::voxels_of(work.recipe, &chunk));
                if to_pool.send((chunk, permit)).is_err() {
                    break;
                }
            }
            drop(to_pool);
            Ok(())
        });
        // Dispatcher: hands tasks to the pool; never more at a time than the pool has threads, so that a mesher's memory
        // belongs to a thread at work.
        let (meshers, stop) = (&meshers, &stop);
        let dispatcher = threads.spawn(move || {
            work.pool.in_place_scope(|scope| {
                for (chunk, permit) in tasks {
                    let to_writer = to_writer.clone();
                    scope.spawn(move |_| {
                        let id = chunk.id.0;
                        let product = match stop.check().and_then(|()| work.cancel.check()) {
                            Ok(()) => guarded(work, &chunk, meshers),
                            Err(e) => Err(e),
                        };
                        // The writer is gone only after an error that it already has.
                        let _ = to_writer.send((id, product, permit));
                    });
                }
            });
        });
        let written = write_in_order(work, &mut sink, products, chunks.start);
        if written.is_err() {
            stop.cancel();
        }
        let fed = feeder.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        dispatcher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        written.and(fed)
    });
    outcome?;
    sink.finish()
}

/// Receives products, puts them in order and writes them. The first error in chunk order wins.
fn write_in_order(
    work: &Work<'_>,
    sink: &mut Sink,
    products: channel::Receiver<(u64, Result<Product>, Permit)>,
    first: u64,
) -> Result<()> {
    let mut order = Reorder::new(first);
    for (id, product, permit) in products {
        order.push(id, (product, permit));
        while let Some((product, permit)) = order.pop() {
            let product = product?;
            sink.write(&product)?;
            work.progress.advance(product.points);
            drop(permit);
        }
    }
    work.cancel.check()
}

/// A panic in a chunk is a bug; it must end the run with a message, not leave it waiting.
fn guarded(work: &Work<'_>, chunk: &Chunk, meshers: &Mutex<Vec<Mesher>>) -> Result<Product> {
    let mut mesher = meshers.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
    let product = catch_unwind(AssertUnwindSafe(|| make_chunk(work, chunk, &mut mesher)))
        .unwrap_or_else(|panic| Err(internal(chunk, &*panic)));
    meshers.lock().unwrap_or_else(PoisonError::into_inner).push(mesher);
    product
}

fn internal(chunk: &Chunk, panic: &(dyn Any + Send)) -> Error {
    let text =
        panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    let text = text.unwrap_or("no message");
    Error::io(
        "make a chunk of",
        format!("the archive (chunk {})", chunk.id.0),
        std::io::Error::other(format!("internal error: {text}")),
    )
}

fn make_chunk(work: &Work<'_>, chunk: &Chunk, mesher: &mut Mesher) -> Result<Product> {
    let mut times = StageTimes::default();
    let start = Instant::now();
    let mesh = chunk::mesh(work.recipe, chunk, mesher, work.cancel)?;
    times.mesh = start.elapsed();
    let start = Instant::now();
    let values = chunk::values(work.recipe, work.reader, &mesh)?;
    times.sample = start.elapsed();
    let start = Instant::now();
    let mut product = encode(work.plan, mesh, &values);
    times.encode = start.elapsed();
    product.times = times;
    Ok(product)
}

/// A chunk's blocks: header, tetrahedra, summary; values, summary.
fn encode(plan: &Plan, mesh: MeshedChunk, values: &[f32]) -> Product {
    let core = mesh.core_len();
    let volume = |t: &Tet| {
        let [a, b, c, d] = t.map(|v| mesh.positions[v as usize]);
        signed_volume6(a, b, c, d)
    };
    let mut summary = MeshSummary {
        core: core as u32,
        halo: mesh.halo.len() as u32,
        tet_blocks: 0,
        retries: mesh.retries,
        tets: mesh.tets.len() as u64,
        volume6: mesh.tets.iter().map(volume).sum(),
    };
    let vertices = ChunkVertices { core_counts: mesh.core_counts, halo: mesh.halo, shared: mesh.shared };
    let encoded = encode_chunk(&vertices, &mesh.tets, plan.mesh.block_tets);
    let blocks = encoded.tet_blocks();
    summary.tet_blocks = blocks as u32;
    let ranges = (0..blocks).map(|n| BlockRange::of(encoded.block_tets(n), values)).collect();
    let mut mesh_blocks = encoded.blocks;
    mesh_blocks.push(summary.encode());
    let mut value_blocks = encode_values(values);
    value_blocks.push(ValueSummary::of(&values[..core], ranges).encode());
    Product { points: core as u64, mesh_blocks, value_blocks, times: StageTimes::default() }
}

/// The two files of a segment being written.
struct Sink {
    mesh: ChunkSegmentWriter,
    values: ChunkSegmentWriter,
    times: StageTimes,
}

impl Sink {
    fn create(work: &Work<'_>, segment: u64, first: ChunkId) -> Result<Self> {
        let (mesh, values) = (work.layout.mesh(segment), work.layout.values(segment));
        Ok(Self {
            mesh: ChunkSegmentWriter::create(&mesh, SegmentKind::Mesh, work.plan.mesh_hash(), first)?,
            values: ChunkSegmentWriter::create(&values, SegmentKind::Values, work.plan.step_hash(), first)?,
            times: StageTimes::default(),
        })
    }

    fn write(&mut self, product: &Product) -> Result<()> {
        let start = Instant::now();
        self.mesh.push_chunk(&product.mesh_blocks)?;
        self.values.push_chunk(&product.value_blocks)?;
        self.times.add(&product.times);
        self.times.write += start.elapsed();
        Ok(())
    }

    fn finish(mut self) -> Result<StageTimes> {
        let start = Instant::now();
        self.mesh.finish()?;
        self.values.finish()?;
        self.times.write += start.elapsed();
        Ok(self.times)
    }
}
