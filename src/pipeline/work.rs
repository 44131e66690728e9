//! Making the segments of an archive: reader, compute and writer, joined by queues bounded in bytes.
//!
//! ```text
//!  feeder thread ──▶ compute pool ─────────────▶ writer (this thread)
//!  takes a permit    mesh, sample, encode          puts chunks in order,
//!  for the chunk,    one chunk a job               appends to the segments,
//!  reads ahead                                     gives the permit back
//! ```
//!
//! Memory ([`super::need`]): the pool has as many threads as the budget has rooms for chunks at work. The feeder takes a permit
//! for the *encoded* chunk before it hands a chunk on, so what waits for its turn is bounded too. A chunk that outgrows its room (its
//! halo had to be widened) drops all it has and starts again when no other is at work, with the rooms of all; a chunk at work waits
//! for nothing else, so this ends. The writer releases chunks in order: the bytes written do not depend on threads, on memory, or
//! on which chunk is ready first.
//!
//! Of a series, the values of several steps are made while the mesh of a chunk is there: sampled, encoded against those of the step
//! before, ranges measured. Where an earlier pass has made the mesh, it is decoded instead, and so are the values before the first step.

use super::chunk::{Maker, MeshedChunk, Meshing, Recipe};
use super::field::{Field, Placement};
use super::gauge::{Cells, Gauge, Samples};
use super::inspect::{Depth, SegmentState, inspect};
use super::layout::Layout;
use super::need::{self, Halo, Shares};
use super::open::OpenArchive;
use super::series::of_step;
use super::sides::Sides;
use super::spectrum::Meter;
use crate::archive::chunk::{ChunkEncoder, ChunkVertices, EncodedChunk};
use crate::archive::chunked::ChunkSegmentWriter;
use crate::archive::errors::{ChunkErrors, encode_errors};
use crate::archive::manifest::{Plan as MeshPlan, StepPlan};
use crate::archive::segment::{PlanHash, SegmentKind};
use crate::archive::summary::{BlockRange, MeshSummary, ValueSummary};
use crate::archive::values::encode_values;
use crate::error::{Error, Result};
use crate::exec::{CancelToken, MemoryBudget, Permit, Progress, Reorder};
use crate::geom::LatticePos;
use crate::geom::predicates::signed_volume6;
use crate::grid::{Chunk, ChunkGrid, ChunkId};
use crate::mesh::tet::Tet;
use crossbeam::channel;
use std::any::Any;
use std::collections::BTreeMap;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

/// A chunk ready to be written.
struct Product {
    points: u64,
    /// Empty where the mesh is there already.
    mesh_blocks: Vec<Vec<u8>>,
    /// Of each step.
    value_blocks: Vec<Vec<Vec<u8>>>,
    times: StageTimes,
}

/// Time spent in each stage, summed over threads.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StageTimes {
    pub(crate) mesh: Duration,
    pub(crate) sample: Duration,
    pub(crate) measure: Duration,
    pub(crate) encode: Duration,
    pub(crate) write: Duration,
}

impl StageTimes {
    pub(crate) fn add(&mut self, other: &Self) {
        self.mesh += other.mesh;
        self.sample += other.sample;
        self.measure += other.measure;
        self.encode += other.encode;
        self.write += other.write;
    }
}

/// A step whose values are to be made.
pub(crate) struct StepWork<'a> {
    pub(crate) plan: &'a StepPlan,
    pub(crate) hash: PlanHash,
    pub(crate) field: &'a dyn Field,
}

/// What earlier passes have made.
pub(crate) struct Stored<'a> {
    /// All of the mesh.
    pub(crate) archive: &'a OpenArchive,
    /// The base of the first step: its position in the manifest.
    pub(crate) base: Option<usize>,
}

/// What the work needs besides the plan.
pub(crate) struct Work<'a> {
    pub(crate) plan: &'a MeshPlan,
    pub(crate) mesh_hash: PlanHash,
    /// Steps that follow each other; at least one.
    pub(crate) steps: &'a [StepWork<'a>],
    pub(super) meter: &'a Meter,
    /// What errors are measured with, against the samples of each step; none where they are not.
    pub(super) gauge: Option<(Gauge, Vec<Samples<'a>>)>,
    /// Where the mesh comes from, if it is there.
    pub(crate) stored: Option<Stored<'a>>,
    /// Positions in `steps` whose data could not be used.
    pub(crate) bad_steps: &'a Mutex<BTreeMap<usize, String>>,
    /// Whether errors name the step.
    pub(crate) several: bool,
    pub(crate) recipe: &'a Recipe<'a>,
    pub(crate) chunks: &'a ChunkGrid,
    pub(crate) layout: &'a Layout,
    /// The segments to make, of all.
    pub(crate) segments: Range<u64>,
    pub(crate) pool: &'a rayon::ThreadPool,
    pub(crate) shares: Shares,
    pub(crate) rooms: &'a Rooms,
    pub(crate) cancel: &'a CancelToken,
    pub(crate) progress: &'a dyn Progress,
}

/// The working memory that chunks take turns in.
#[derive(Default)]
pub(crate) struct Rooms {
    /// The memory of workers between two chunks.
    desks: Mutex<Vec<Desk>>,
    /// Held shared by chunks at work, alone by a chunk that needs the rooms of all.
    turn: RwLock<()>,
}

/// Memory that a worker keeps from chunk to chunk.
#[derive(Default)]
struct Desk {
    maker: Maker,
    encoder: ChunkEncoder,
}

impl Rooms {
    fn take_desk(&self) -> Desk {
        self.desks.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    fn put_desk(&self, desk: Desk) {
        self.desks.lock().unwrap_or_else(PoisonError::into_inner).push(desk);
    }

    fn drop_desks(&self) {
        self.desks.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

/// Makes all segments that are not there yet. Returns the time spent in each stage.
///
/// Chunks flow through the queues without regard to segments; only the writer changes files between two of them. So no
/// thread waits at the end of a segment.
pub(crate) fn make_segments(work: &Work<'_>) -> Result<StageTimes> {
    let (to_pool, tasks) = channel::unbounded::<(u64, Chunk, Permit)>();
    let (to_writer, products) = channel::unbounded::<(u64, u64, Result<Product>, Permit)>();
    let (to_sinks, sinks) = channel::unbounded::<(Sink, u64)>();
    let budget = MemoryBudget::new(work.shares.queue);
    let stop = &CancelToken::new();
    std::thread::scope(|threads| {
        // Feeder: the queues need no bound of their own, every chunk in them holds a permit of the budget.
        let feeder = threads.spawn(|| {
            let (to_pool, to_sinks) = (to_pool, to_sinks);
            feed(work, &budget, stop, &to_pool, &to_sinks)
        });
        // Dispatcher: hands tasks to the pool; never more at a time than the pool has threads, so that a mesher's memory
        // belongs to a thread at work.
        let dispatcher = threads.spawn(move || {
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
        });
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
    let mut number = 0;
    for segment in work.segments.clone() {
        work.cancel.check()?;
        let chunks = work.layout.chunks_of(segment);
        if is_done(work, segment) {
            work.progress.advance(points_in(work, &chunks));
            continue;
        }
        let (sink, done) = Sink::resume(work, segment, &chunks)?;
        let first = chunks.start + done;
        work.progress.advance(points_in(work, &(chunks.start..first)));
        if to_sinks.send((sink, chunks.end - first)).is_err() {
            return Ok(());
        }
        for id in first..chunks.end {
            let chunk = work.chunks.chunk(ChunkId(id));
            let points = work.recipe.points.count_in(&chunk.core);
            let bytes = need::product_bytes(points, work.steps.len() as u64);
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

/// Done means that all files are there, belong to this plan, and verify; not that they exist.
fn is_done(work: &Work<'_>, segment: u64) -> bool {
    let chunks = work.layout.chunks_of(segment);
    Part::all(work).all(|part| part.is_whole(work, segment, &chunks))
}

/// Whether the mesh of some segments is there.
pub(crate) fn has_mesh(hash: PlanHash, layout: &Layout, segments: &Range<u64>) -> bool {
    let whole = |n| is_whole(&layout.mesh(n), SegmentKind::Mesh, hash, &layout.chunks_of(n));
    segments.clone().all(whole)
}

/// Whether the values of a step in some segments are there.
pub(crate) fn has_values(plan: &StepPlan, hash: PlanHash, layout: &Layout, segments: &Range<u64>) -> bool {
    let layout = layout.at(plan.number);
    let whole = |n| is_whole(&layout.values(n), SegmentKind::Values, hash, &layout.chunks_of(n));
    segments.clone().all(whole)
}

fn is_whole(path: &Path, kind: SegmentKind, hash: PlanHash, chunks: &Range<u64>) -> bool {
    inspect(path, kind, hash, chunks, Depth::All) == SegmentState::Whole
}

/// One of the files of a segment that are made: the mesh, where it is not there yet, and the values of each step.
#[derive(Clone, Copy)]
enum Part {
    Mesh,
    Values(usize),
}

impl Part {
    fn all<'a>(work: &'a Work<'_>) -> impl Iterator<Item = Self> + use<'a> {
        let mesh = work.stored.is_none().then_some(Self::Mesh);
        mesh.into_iter().chain((0..work.steps.len()).map(Self::Values))
    }

    fn path(self, work: &Work<'_>, segment: u64) -> PathBuf {
        match self {
            Self::Mesh => work.layout.mesh(segment),
            Self::Values(n) => work.layout.at(work.steps[n].plan.number).values(segment),
        }
    }

    fn kind(self, work: &Work<'_>) -> (SegmentKind, PlanHash) {
        match self {
            Self::Mesh => (SegmentKind::Mesh, work.mesh_hash),
            Self::Values(n) => (SegmentKind::Values, work.steps[n].hash),
        }
    }

    fn is_whole(self, work: &Work<'_>, segment: u64, chunks: &Range<u64>) -> bool {
        let (kind, hash) = self.kind(work);
        is_whole(&self.path(work, segment), kind, hash, chunks)
    }

    /// A writer that goes on behind at most `most` chunks; `None` when the file is whole already: a run was killed between
    /// two of them.
    fn resume(
        self,
        work: &Work<'_>,
        segment: u64,
        chunks: &Range<u64>,
        most: u64,
    ) -> Result<Option<ChunkSegmentWriter>> {
        if self.is_whole(work, segment, chunks) {
            return Ok(None);
        }
        let (kind, hash) = self.kind(work);
        let path = self.path(work, segment);
        ChunkSegmentWriter::resume(path, kind, hash, ChunkId(chunks.start), most).map(Some)
    }

    /// The blocks that a product has for the file.
    fn blocks(self, product: &Product) -> &[Vec<u8>] {
        match self {
            Self::Mesh => &product.mesh_blocks,
            Self::Values(n) => &product.value_blocks[n],
        }
    }
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
                None => {
                    next_sink(sinks, &mut times)?.expect("a segment is opened before its chunks are sent")
                }
            };
            sink.write(&product)?;
            work.progress.advance(product.points);
            drop(permit);
            let passed = work.chunks.chunk(ChunkId(chunk));
            work.steps.iter().for_each(|s| s.field.pass(&passed));
            if let Some(stored) = &work.stored {
                stored.archive.close_before(passed.id);
            }
            if missing == 1 {
                times.add(&sink.finish()?);
            } else {
                open = Some((sink, missing - 1));
            }
        }
    }
    work.cancel.check()?;
    if open.is_none() {
        // Segments whose chunks were all there, but not under their names yet. Where one comes that misses chunks, the
        // feeder has stopped, and says why.
        next_sink(sinks, &mut times)?;
    }
    Ok(times)
}

/// The next segment with missing chunks; those without are finished.
fn next_sink(sinks: &channel::Receiver<(Sink, u64)>, times: &mut StageTimes) -> Result<Option<(Sink, u64)>> {
    while let Ok((sink, missing)) = sinks.recv() {
        if missing > 0 {
            return Ok(Some((sink, missing)));
        }
        times.add(&sink.finish()?);
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

/// Makes a chunk in a room of its own; if that is too small, in the rooms of all.
fn make_chunk(work: &Work<'_>, chunk: &Chunk) -> Result<Product> {
    let retries = {
        let _together = work.rooms.turn.read().unwrap_or_else(PoisonError::into_inner);
        let mut desk = work.rooms.take_desk();
        match make_in_room(work, chunk, &mut desk, 0, work.shares.room)? {
            Making::Done(product) => {
                work.rooms.put_desk(desk);
                return Ok(product);
            }
            Making::NeedsRoom { retries, .. } => retries,
        }
    };
    let _alone = work.rooms.turn.write().unwrap_or_else(PoisonError::into_inner);
    work.rooms.drop_desks();
    match make_in_room(work, chunk, &mut Desk::default(), retries, work.shares.room_alone())? {
        Making::Done(product) => Ok(product),
        Making::NeedsRoom { bytes, .. } => Err(Error::Budget {
            what: format!(
                "memory (chunk {} needs a wide halo; smaller --chunk-points need less)",
                chunk.id.0
            ),
            needed: work.shares.memory_for(bytes),
            available: work.shares.memory_for(work.shares.room_alone()),
        }),
    }
}

/// As [`Meshing`].
enum Making {
    Done(Product),
    NeedsRoom { retries: u32, bytes: u64 },
}

fn make_in_room(
    work: &Work<'_>,
    chunk: &Chunk,
    desk: &mut Desk,
    first_try: u32,
    room: u64,
) -> Result<Making> {
    let mut times = StageTimes::default();
    let mut lap = Lap(Instant::now());
    if let Some(stored) = &work.stored {
        let again = match work.recipe.halo {
            Halo::Owned => None,
            // What values are fitted to is not stored: it is made again.
            Halo::Stars => match desk.maker.mesh(work.recipe, chunk, first_try, room, work.cancel)? {
                Meshing::Done(mesh) => Some(mesh),
                Meshing::NeedsRoom { retries, bytes } => return Ok(Making::NeedsRoom { retries, bytes }),
            },
        };
        return make_from_stored(work, stored, chunk, again).map(Making::Done);
    }
    let mut mesh = match desk.maker.mesh(work.recipe, chunk, first_try, room, work.cancel)? {
        Meshing::Done(mesh) => mesh,
        Meshing::NeedsRoom { retries, bytes } => return Ok(Making::NeedsRoom { retries, bytes }),
    };
    lap.add_to(&mut times.mesh);
    let mut placement = note(work, 0, work.steps[0].field.place(&mesh))?;
    let outside6 = drop_outside(&mut mesh, &mut placement);
    lap.add_to(&mut times.sample);
    let (encoded, summary) = encode_mesh(work, &mut desk.encoder, &mut mesh, outside6);
    let ends = encoded.block_ends();
    lap.add_to(&mut times.encode);
    let value_blocks = encode_steps(work, &mesh, &placement, None, (encoded.tets(), &ends), &mut times)?;
    let (mut mesh_blocks, tets) = encoded.into_parts();
    desk.maker.reuse(mesh.positions, tets);
    mesh_blocks.push(summary.encode());
    Ok(Making::Done(Product { points: u64::from(summary.core), mesh_blocks, value_blocks, times }))
}

/// The values of steps on a mesh that is there; `again` is that of the chunk with what is around it, where values ask for that.
fn make_from_stored(
    work: &Work<'_>,
    stored: &Stored<'_>,
    chunk: &Chunk,
    again: Option<MeshedChunk>,
) -> Result<Product> {
    let mut times = StageTimes::default();
    let mut lap = Lap(Instant::now());
    let (mut mesh, ends) = stored.archive.stored_mesh(chunk.id)?;
    let place = |mesh: &MeshedChunk| note(work, 0, work.steps[0].field.place(mesh));
    let placement = match again {
        // Of a mesh in which nothing lies outside any more.
        None => place(&mesh)?,
        Some(mut whole) => {
            let mut placement = place(&whole)?;
            drop_outside(&mut whole, &mut placement);
            mesh.around = whole.around;
            placement
        }
    };
    lap.add_to(&mut times.sample);
    let vertices = mesh.positions.len();
    let before = stored.base.map(|base| stored.archive.chunk_values(base, chunk.id, vertices)).transpose()?;
    lap.add_to(&mut times.mesh);
    let value_blocks =
        encode_steps(work, &mesh, &placement, before.as_deref(), (&mesh.tets, &ends), &mut times)?;
    Ok(Product { points: mesh.core_len() as u64, mesh_blocks: vec![], value_blocks, times })
}

/// Adds up what a stage takes.
struct Lap(Instant);

impl Lap {
    fn add_to(&mut self, stage: &mut Duration) {
        let now = Instant::now();
        *stage += now - std::mem::replace(&mut self.0, now);
    }
}

/// The values of a step, as they are stored.
fn values_of(work: &Work<'_>, n: usize, mesh: &MeshedChunk, placement: &Placement) -> Result<Vec<f32>> {
    let step = &work.steps[n];
    let mut values = note(work, n, step.field.values(mesh, placement))?;
    if let Some(quantiser) = &step.plan.quantiser {
        values.iter_mut().for_each(|v| *v = quantiser.round(*v));
    }
    Ok(values)
}

/// Notes a step whose data cannot be used.
fn note<T>(work: &Work<'_>, n: usize, found: Result<T>) -> Result<T> {
    let step = &work.steps[n];
    let found = found.map_err(|e| if work.several { of_step(e, step.plan.number) } else { e });
    if let Err(e @ (Error::BadInput { .. } | Error::Io { .. })) = &found {
        let mut bad = work.bad_steps.lock().unwrap_or_else(PoisonError::into_inner);
        bad.entry(n).or_insert_with(|| e.to_string());
    }
    found
}

/// Samples, measures and encodes all steps: the blocks of each, values, errors, part of the spectrum, summary. `before` are the values
/// of the first one's base; tetrahedra are those of all blocks, as they decode, with the end of each block.
fn encode_steps(
    work: &Work<'_>,
    mesh: &MeshedChunk,
    placement: &Placement,
    before: Option<&[f32]>,
    (tets, block_ends): (&[Tet], &[usize]),
    times: &mut StageTimes,
) -> Result<Vec<Vec<Vec<u8>>>> {
    let mut lap = Lap(Instant::now());
    let of_step = |n| work.cancel.check().and_then(|()| values_of(work, n, mesh, placement));
    let values = (0..work.steps.len()).map(of_step).collect::<Result<Vec<_>>>()?;
    lap.add_to(&mut times.sample);
    let of_steps: Vec<&[f32]> = values.iter().map(Vec::as_slice).collect();
    let sides = Sides::new(&of_steps);
    let errors = errors(work, &Cells { positions: &mesh.positions, tets, block_ends }, &sides)?;
    lap.add_to(&mut times.measure);
    let ranges = sides.ranges(tets, block_ends);
    drop(sides);
    let of_steps: Vec<(&[f32], &[BlockRange])> =
        of_steps.into_iter().zip(&ranges).map(|(values, ranges)| (values, &**ranges)).collect();
    let parts = work.meter.parts(&mesh.positions, tets, &of_steps)?;
    let (mut out, mut before) = (vec![], before);
    for (n, ((step, part), ranges)) in work.steps.iter().zip(&parts).zip(ranges).enumerate() {
        work.cancel.check()?;
        let values = &*values[n];
        let base = step.plan.base.map(|_| before.expect("a base is the step before"));
        let mut encoded = encode_values(values, base, step.plan.quantiser.as_ref());
        encoded.extend(errors.get(n).map(encode_errors));
        encoded.push(part.encode());
        encoded.push(ValueSummary::of(&values[..mesh.core_len()], ranges).encode());
        out.push(encoded);
        before = Some(values);
    }
    lap.add_to(&mut times.encode);
    Ok(out)
}

/// The errors of each step in a chunk; none where they are not measured.
fn errors(work: &Work<'_>, cells: &Cells<'_>, steps: &Sides<'_>) -> Result<Vec<ChunkErrors>> {
    let Some((gauge, samples)) = &work.gauge else { return Ok(vec![]) };
    let levels = work.recipe.points.levels().map(|levels| &**levels);
    gauge.chunk_errors(cells, steps, levels, |n, window, out| note(work, n, samples[n].read(window, out)))
}

/// Removes the tetrahedra that lie outside of the data, and the halo points that only they use; tells the six-fold volume of the chunk's own.
fn drop_outside(mesh: &mut MeshedChunk, placement: &mut Placement) -> i128 {
    let outside = std::mem::take(&mut placement.outside);
    if outside.is_empty() {
        return 0;
    }
    let gone = mesh.tets.iter().zip(&outside).filter(|(_, gone)| **gone).map(|(t, _)| t);
    let volume = volume6(&mesh.positions, gone);
    let mut flags = outside.iter();
    let mut stays = |_: &Tet| !flags.next().expect("a flag for each tetrahedron, those around last");
    mesh.tets.retain(&mut stays);
    mesh.around.tets.retain(&mut stays);
    let before = mesh.drop_unused_halo();
    placement.spots = before.iter().map(|&v| placement.spots[v as usize]).collect();
    volume
}

fn volume6<'a>(positions: &[LatticePos], tets: impl Iterator<Item = &'a Tet>) -> i128 {
    tets.map(|t| {
        let [a, b, c, d] = t.map(|v| positions[v as usize]);
        signed_volume6(a, b, c, d)
    })
    .sum()
}

/// A chunk's mesh, encoded, and its summary. Takes the tetrahedra, unless more than one step is to be surveyed on them.
fn encode_mesh(
    work: &Work<'_>,
    encoder: &mut ChunkEncoder,
    mesh: &mut MeshedChunk,
    outside6: i128,
) -> (EncodedChunk, MeshSummary) {
    let mut summary = MeshSummary {
        core: mesh.core_len() as u32,
        halo: mesh.halo.len() as u32,
        tet_blocks: 0,
        retries: mesh.retries,
        tets: mesh.tets.len() as u64,
        volume6: volume6(&mesh.positions, mesh.tets.iter()),
        outside6,
    };
    // Further steps ask for them, and so do values that are fitted to the samples in them.
    let is_needed = work.steps.len() > 1 || work.recipe.halo == Halo::Stars;
    let tets = if is_needed { mesh.tets.clone() } else { std::mem::take(&mut mesh.tets) };
    let vertices = ChunkVertices {
        core_counts: std::mem::take(&mut mesh.core_counts),
        halo: std::mem::take(&mut mesh.halo),
        shared: std::mem::take(&mut mesh.shared),
    };
    let encoded = encoder.encode(&vertices, &mesh.positions, tets, work.plan.block_tets);
    ChunkVertices { core_counts: mesh.core_counts, halo: mesh.halo, shared: mesh.shared } = vertices;
    summary.tet_blocks = encoded.tet_blocks() as u32;
    (encoded, summary)
}

/// The files of a segment being written; none in place of one that is there.
struct Sink {
    files: Vec<(Part, Option<ChunkSegmentWriter>)>,
    times: StageTimes,
}

impl Sink {
    /// Goes on behind the chunks that an earlier run has left in all files; also tells how many these are.
    fn resume(work: &Work<'_>, segment: u64, chunks: &Range<u64>) -> Result<(Self, u64)> {
        let all = chunks.end - chunks.start;
        let count = |w: &Option<ChunkSegmentWriter>| w.as_ref().map_or(all, ChunkSegmentWriter::chunk_count);
        let open = |part: Part| Ok((part, part.resume(work, segment, chunks, all)?));
        let mut files: Vec<(Part, Option<ChunkSegmentWriter>)> =
            Part::all(work).map(open).collect::<Result<_>>()?;
        // Of a file that is whole nothing is written again; the others need all chunks behind their last common one.
        let done = files.iter().map(|(_, w)| count(w)).min().unwrap_or(all);
        for (part, writer) in &mut files {
            if writer.is_some() && count(writer) > done {
                *writer = None;
                *writer = part.resume(work, segment, chunks, done)?;
            }
        }
        Ok((Self { files, times: StageTimes::default() }, done))
    }

    fn write(&mut self, product: &Product) -> Result<()> {
        let start = Instant::now();
        for (part, writer) in &mut self.files {
            if let Some(writer) = writer {
                writer.push_chunk(part.blocks(product))?;
            }
        }
        self.times.add(&product.times);
        self.times.write += start.elapsed();
        Ok(())
    }

    fn finish(mut self) -> Result<StageTimes> {
        let start = Instant::now();
        for writer in self.files.into_iter().filter_map(|(_, writer)| writer) {
            writer.finish()?;
        }
        self.times.write += start.elapsed();
        Ok(self.times)
    }
}
