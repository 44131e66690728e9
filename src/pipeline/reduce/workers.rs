//! Making the segments of an archive: reader, compute and writer, joined by queues bounded in bytes.
//!
//! ```text
//!  feeder thread ──▶ compute pool ─────────────▶ writer (this thread)
//!  takes a permit    mesh, sample, encode          puts chunks in order,
//!  for the chunk,    one chunk a job               appends to the segments,
//!  reads ahead                                     gives the permit back
//! ```
//!
//! Memory ([`crate::pipeline::plan::estimate`]): the pool has as many threads as the budget has rooms for chunks at work. The feeder takes a permit
//! for the *encoded* chunk before it hands a chunk on, so what waits for its turn is bounded too. A chunk at work waits for nothing but the
//! rooms of others ([`super::encode`]), so this ends. The writer ([`super::sink`]) releases chunks in order: the bytes written do not depend on
//! threads, on memory, or on which chunk is ready first.

use super::encode::{Product, Workspaces, make_chunk};
use super::reuse::ReusedChunks;
use super::sink::{Sink, is_done, left};
use crate::archive::manifest::{Plan as MeshPlan, StepPlan};
use crate::archive::segment::PlanHash;
use crate::error::{Error, Result};
use crate::exec::{CancelToken, MemoryBudget, Permit, Progress, Reorder, no_thread};
use crate::grid::{Chunk, ChunkGrid, ChunkId};
use crate::pipeline::chunk::{Field, Recipe, SampleErrors, Samples};
use crate::pipeline::plan::{Layout, Shares, Watch, estimate};
use crate::pipeline::read::{Meter, StepView};
use crossbeam::channel;
use std::any::Any;
use std::collections::BTreeMap;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::time::Duration;

/// Time spent in each stage, summed over threads.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::pipeline) struct StageTimes {
    pub(super) mesh: Duration,
    pub(super) sample: Duration,
    pub(super) fit: Duration,
    pub(super) measure: Duration,
    pub(super) encode: Duration,
    pub(super) spectrum: Duration,
    pub(super) write: Duration,
}

impl StageTimes {
    pub(super) fn add(&mut self, other: &Self) {
        self.mesh += other.mesh;
        self.sample += other.sample;
        self.fit += other.fit;
        self.measure += other.measure;
        self.encode += other.encode;
        self.spectrum += other.spectrum;
        self.write += other.write;
    }
}

/// A step whose values are to be made.
pub(super) struct StepWork<'a> {
    pub(super) plan: &'a StepPlan,
    pub(super) hash: PlanHash,
    pub(super) field: &'a dyn Field,
}

/// What earlier passes have made.
pub(super) struct Stored<'a> {
    /// All of the mesh.
    pub(super) archive: &'a StepView,
    /// The base of the first step: its position in the manifest.
    pub(super) base: Option<usize>,
}

/// What the work needs besides the plan.
pub(super) struct Work<'a> {
    pub(super) plan: &'a MeshPlan,
    pub(super) mesh_hash: PlanHash,
    /// Steps that follow each other; at least one.
    pub(super) steps: &'a [StepWork<'a>],
    pub(super) meter: &'a Meter,
    /// What errors are measured with, against the samples of each step; none where they are not.
    pub(super) sample_errors: Option<(SampleErrors, Vec<Samples<'a>>)>,
    /// Where the mesh comes from, if it is there.
    pub(super) stored: Option<Stored<'a>>,
    /// Chunks that an earlier try has made, and where `steps` are in that.
    pub(super) taken: Option<(&'a ReusedChunks<'a>, Range<usize>)>,
    /// Positions in `steps` whose data could not be used.
    pub(super) bad_steps: &'a Mutex<BTreeMap<usize, String>>,
    /// Whether errors name the step.
    pub(super) several: bool,
    pub(super) recipe: &'a Recipe<'a>,
    pub(super) chunks: &'a ChunkGrid,
    pub(super) layout: &'a Layout,
    /// The segments to make, of all.
    pub(super) segments: Range<u64>,
    pub(super) pool: &'a rayon::ThreadPool,
    pub(super) shares: Shares,
    pub(super) rooms: &'a Workspaces,
    /// The files that are read, which must not change.
    pub(super) watch: &'a Watch,
    pub(super) cancel: &'a CancelToken,
    pub(super) progress: &'a dyn Progress,
}

/// Makes all segments that are not there yet. Returns the time spent in each stage.
///
/// Chunks flow through the queues without regard to segments; only the writer changes files between two of them. So no
/// thread waits at the end of a segment.
pub(super) fn make_segments(work: &Work<'_>) -> Result<StageTimes> {
    let (to_pool, tasks) = channel::unbounded::<(u64, Chunk, Permit)>();
    let (to_writer, products) = channel::unbounded::<(u64, u64, Result<Product>, Permit)>();
    let (to_sinks, sinks) = channel::unbounded::<(Sink, u64)>();
    let budget = MemoryBudget::new(work.shares.queue);
    let stop = &CancelToken::new();
    std::thread::scope(|threads| {
        let thread = || std::thread::Builder::new();
        // Feeder: the queues need no bound of their own, every chunk in them holds a permit of the budget.
        let feed = || {
            let (to_pool, to_sinks) = (to_pool, to_sinks);
            feed(work, &budget, stop, &to_pool, &to_sinks)
        };
        let feeder = thread().spawn_scoped(threads, feed).map_err(no_thread)?;
        // Dispatcher: hands tasks to the pool; never more at a time than the pool has threads, so that a mesher's memory
        // belongs to a thread at work.
        let dispatch = move || {
            work.pool.in_place_scope(|scope| {
                for (number, chunk, permit) in tasks {
                    let to_writer = to_writer.clone();
                    scope.spawn(move |_| {
                        let product = match stop.check().and_then(|()| work.cancel.check()) {
                            Ok(()) => guarded(work, &chunk),
                            Err(e) => Err(e),
                        };
                        // The writer is gone only after an error that it already has.
                        let _ = to_writer.send((number, chunk.id.0, product, permit));
                    });
                }
            });
        };
        // Where it is refused, the tasks have no receiver any more, which ends the feeder.
        let dispatcher = thread().spawn_scoped(threads, dispatch).map_err(no_thread)?;
        let written = write_in_order(work, &sinks, products);
        if written.is_err() {
            stop.cancel();
        }
        let fed = feeder.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        dispatcher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        // An error of the feeder cuts the products short, and is the reason that the writer has too few of them.
        fed.and(written)
    })
}

/// Opens the files of each segment that is not there yet, and sends its missing chunks to the pool, numbered without gaps.
fn feed(
    work: &Work<'_>,
    budget: &MemoryBudget,
    stop: &CancelToken,
    to_pool: &channel::Sender<(u64, Chunk, Permit)>,
    to_sinks: &channel::Sender<(Sink, u64)>,
) -> Result<()> {
    let (mut number, left) = (0, left(work.layout));
    for segment in work.segments.clone() {
        work.cancel.check()?;
        let chunks = work.layout.chunks_of(segment);
        if is_done(work, segment) {
            work.progress.advance(points_in(work, &chunks));
            continue;
        }
        let (sink, done) = Sink::resume(work, segment, &chunks, &left)?;
        let first = chunks.start + done;
        work.progress.advance(points_in(work, &(chunks.start..first)));
        if to_sinks.send((sink, chunks.end - first)).is_err() {
            return Ok(());
        }
        for id in first..chunks.end {
            let chunk = work.chunks.chunk(ChunkId(id));
            let points = work.recipe.points.count_in(&chunk.core);
            let bytes = estimate::product_bytes(points, work.steps.len() as u64);
            let permit = budget.acquire(bytes.min(budget.total()), work.cancel)?;
            if stop.is_cancelled() {
                return Ok(());
            }
            work.steps.iter().for_each(|s| s.field.will_need(&chunk));
            if to_pool.send((number, chunk, permit)).is_err() {
                return Ok(());
            }
            number += 1;
        }
    }
    Ok(())
}

fn points_in(work: &Work<'_>, chunks: &Range<u64>) -> u64 {
    chunks.clone().map(|c| work.recipe.points.count_in(&work.chunks.chunk(ChunkId(c)).core)).sum()
}

/// Receives products, puts them in order and writes them, segment by segment. The first error in chunk order wins.
fn write_in_order(
    work: &Work<'_>,
    sinks: &channel::Receiver<(Sink, u64)>,
    products: channel::Receiver<(u64, u64, Result<Product>, Permit)>,
) -> Result<StageTimes> {
    let (mut order, mut times) = (Reorder::new(0), StageTimes::default());
    let mut open: Option<(Sink, u64)> = None;
    for (number, chunk, product, permit) in products {
        order.push(number, (chunk, product, permit));
        while let Some((chunk, product, permit)) = order.pop() {
            let product = product?;
            let (mut sink, missing) = match open.take() {
                Some(open) => open,
                None => next_sink(work, sinks, &mut times)?
                    .expect("a segment is opened before its chunks are sent"),
            };
            work.watch.check_few()?;
            sink.write(&product)?;
            work.progress.advance(product.points);
            drop(permit);
            let passed = work.chunks.chunk(ChunkId(chunk));
            work.steps.iter().for_each(|s| s.field.pass(&passed));
            if let Some(stored) = &work.stored {
                stored.archive.close_before(passed.id);
            }
            if let Some((taken, _)) = &work.taken {
                taken.pass(passed.id);
            }
            if missing == 1 {
                times.add(&sink.finish(work.watch)?);
            } else {
                open = Some((sink, missing - 1));
            }
        }
    }
    work.cancel.check()?;
    if open.is_none() {
        // Segments whose chunks were all there, but not under their names yet. Where one comes that misses chunks, the
        // feeder has stopped, and says why.
        next_sink(work, sinks, &mut times)?;
    }
    Ok(times)
}

/// The next segment with missing chunks; those without are finished.
fn next_sink(
    work: &Work<'_>,
    sinks: &channel::Receiver<(Sink, u64)>,
    times: &mut StageTimes,
) -> Result<Option<(Sink, u64)>> {
    while let Ok((sink, missing)) = sinks.recv() {
        if missing > 0 {
            return Ok(Some((sink, missing)));
        }
        times.add(&sink.finish(work.watch)?);
    }
    Ok(None)
}

/// A panic in a chunk is a bug; it must end the run with a message, not leave it waiting.
fn guarded(work: &Work<'_>, chunk: &Chunk) -> Result<Product> {
    catch_unwind(AssertUnwindSafe(|| make_chunk(work, chunk)))
        .unwrap_or_else(|panic| Err(internal(chunk, &*panic)))
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
