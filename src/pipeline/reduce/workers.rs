//! Makes the segments of an archive: reader, compute and writer, joined by queues bounded in bytes.
//!
//! ```text
//!  feeder thread ──▶ compute pool ─────────────▶ writer (this thread)
//!  takes a permit    mesh, sample, encode          puts chunks in order,
//!  for the chunk,    one chunk a job               appends to the segments,
//!  reads ahead                                     gives the permit back
//! ```
//!
//! Memory ([`crate::pipeline::plan::estimate`]): the pool has as many threads as the budget has
//! rooms for chunks at work. The feeder takes a permit for the *encoded* chunk before it hands a
//! chunk on, so the encoded chunks that wait are bounded too. A chunk at work waits for nothing but
//! the rooms of others ([`super::encode`]), so this ends. The writer ([`super::sink`]) releases
//! chunks in order: the bytes written do not depend on threads, on memory, or on which chunk is
//! ready first.

use super::encoded::EncodedChunk;
use super::sink::{SegmentFiles, Sink};
use crate::pipeline::plan::{Watch, estimate};
use crate::pipeline::stage::StageTimes;
use crossbeam::channel;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{CancelToken, MemoryBudget, Permit, Progress, Reorder, no_thread};
use isospan_io::grid::{Chunk, ChunkGrid, ChunkId};
use std::any::Any;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Makes the contents of chunks; shared by all threads.
pub(super) trait MakeChunks: Sync {
    /// Makes a chunk.
    ///
    /// # Errors
    /// The first that occurs.
    fn make(&self, chunk: &Chunk) -> Result<EncodedChunk>;

    /// Points of a chunk, for the progress.
    fn points(&self, chunk: &Chunk) -> u64;

    /// Bytes of a chunk that waits to be written, of some steps, at most.
    fn product_bytes(&self, chunk: &Chunk, steps: u64) -> u64 {
        estimate::product_bytes(self.points(chunk), steps)
    }

    /// Tells that a chunk will be made soon.
    fn will_need(&self, chunk: &Chunk);

    /// Tells that all chunks up to one are made.
    fn pass(&self, chunk: &Chunk);

    /// Bytes of chunks that may wait to be written.
    fn queue(&self) -> u64;

    /// What stops the work.
    fn cancel(&self) -> &CancelToken;
}

/// Makes segments: which, of what, and where they go.
pub(super) struct SegmentMaker<'a> {
    pub(super) maker: &'a dyn MakeChunks,
    pub(super) files: &'a SegmentFiles<'a>,
    pub(super) chunks: &'a ChunkGrid,
    /// The segments to make, of all.
    pub(super) segments: Range<u64>,
    pub(super) pool: &'a rayon::ThreadPool,
    /// The files that are read, which must not change.
    pub(super) watch: &'a Watch,
    pub(super) progress: &'a dyn Progress,
}

impl SegmentMaker<'_> {
    /// Makes all segments that are not there yet. Returns the time spent in each stage.
    ///
    /// Chunks flow through the queues without regard to segments; only the writer changes files
    /// between two of them. So no thread waits at the end of a segment.
    pub(super) fn make(&self) -> Result<StageTimes> {
        let (to_pool, tasks) = channel::unbounded::<(u64, Chunk, Permit)>();
        let (to_writer, encoded) = channel::unbounded::<(u64, u64, Result<EncodedChunk>, Permit)>();
        let (to_sinks, sinks) = channel::unbounded::<(Sink, u64)>();
        let budget = MemoryBudget::new(self.maker.queue());
        let stop = &CancelToken::new();
        std::thread::scope(|threads| {
            let thread = || std::thread::Builder::new();
            // Feeder: the queues need no bound of their own, every chunk in them holds a permit of
            // the budget.
            let feed = || {
                let (to_pool, to_sinks) = (to_pool, to_sinks);
                self.feed(&budget, stop, &to_pool, &to_sinks)
            };
            let feeder = thread().spawn_scoped(threads, feed).map_err(no_thread)?;
            // Dispatcher: hands tasks to the pool; never more at a time than the pool has threads,
            // so that a mesher's memory belongs to a thread at self.
            let dispatch = move || {
                self.pool.in_place_scope(|scope| {
                    for (number, chunk, permit) in tasks {
                        let to_writer = to_writer.clone();
                        scope.spawn(move |_| {
                            let encoded = match stop.check().and_then(|()| self.maker.cancel().check()) {
                                Ok(()) => self.encoded(&chunk),
                                Err(e) => Err(e),
                            };
                            // The writer is gone only after an error that it already has.
                            let _ = to_writer.send((number, chunk.id.0, encoded, permit));
                        });
                    }
                });
            };
            // Where it is refused, the tasks have no receiver any more, which ends the feeder.
            let dispatcher = thread().spawn_scoped(threads, dispatch).map_err(no_thread)?;
            let written = self.write_in_order(&sinks, encoded);
            if written.is_err() {
                stop.cancel();
            }
            let fed = feeder.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            dispatcher.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            // An error of the feeder cuts the encoded short, and is the reason that the writer has
            // too few of them.
            fed.and(written)
        })
    }

    /// Opens the files of each segment that is not there yet, and sends its missing chunks to the
    /// pool, numbered without gaps.
    fn feed(
        &self,
        budget: &MemoryBudget,
        stop: &CancelToken,
        to_pool: &channel::Sender<(u64, Chunk, Permit)>,
        to_sinks: &channel::Sender<(Sink, u64)>,
    ) -> Result<()> {
        let (mut number, left) = (0, self.files.left());
        for segment in self.segments.clone() {
            self.maker.cancel().check()?;
            let chunks = self.files.chunks_of(segment);
            if self.files.is_done(segment) {
                self.progress.advance(self.points_in(&chunks));
                continue;
            }
            let (sink, done) = Sink::resume(self.files, segment, &chunks, &left)?;
            let first = chunks.start + done;
            self.progress.advance(self.points_in(&(chunks.start..first)));
            if to_sinks.send((sink, chunks.end - first)).is_err() {
                return Ok(());
            }
            for id in first..chunks.end {
                let chunk = self.chunks.chunk(ChunkId(id));
                let bytes = self.maker.product_bytes(&chunk, self.files.steps());
                let permit = budget.acquire(bytes.min(budget.total()), self.maker.cancel())?;
                if stop.is_cancelled() {
                    return Ok(());
                }
                self.maker.will_need(&chunk);
                if to_pool.send((number, chunk, permit)).is_err() {
                    return Ok(());
                }
                number += 1;
            }
        }
        Ok(())
    }

    fn points_in(&self, chunks: &Range<u64>) -> u64 {
        chunks.clone().map(|c| self.maker.points(&self.chunks.chunk(ChunkId(c)))).sum()
    }

    /// Receives encoded, puts them in order and writes them, segment by segment. The first error in
    /// chunk order wins.
    fn write_in_order(
        &self,
        sinks: &channel::Receiver<(Sink, u64)>,
        encoded: channel::Receiver<(u64, u64, Result<EncodedChunk>, Permit)>,
    ) -> Result<StageTimes> {
        let (mut order, mut times) = (Reorder::new(0), StageTimes::default());
        let mut open: Option<(Sink, u64)> = None;
        for (number, chunk, encoded, permit) in encoded {
            order.push(number, (chunk, encoded, permit));
            while let Some((chunk, encoded, permit)) = order.pop() {
                let encoded = encoded?;
                let (mut sink, missing) = match open.take() {
                    Some(open) => open,
                    None => self
                        .next_sink(sinks, &mut times)?
                        .expect("a segment is opened before its chunks are sent"),
                };
                self.watch.check_few()?;
                sink.write(&encoded)?;
                self.progress.advance(encoded.points);
                drop(permit);
                self.maker.pass(&self.chunks.chunk(ChunkId(chunk)));
                if missing == 1 {
                    times.add(&sink.finish(self.watch)?);
                } else {
                    open = Some((sink, missing - 1));
                }
            }
        }
        self.maker.cancel().check()?;
        if open.is_none() {
            // Segments whose chunks were all there, but not under their names yet. Where one comes
            // that misses chunks, the feeder has stopped, and says why.
            self.next_sink(sinks, &mut times)?;
        }
        Ok(times)
    }

    /// The next segment with missing chunks; those without are finished.
    fn next_sink(
        &self,
        sinks: &channel::Receiver<(Sink, u64)>,
        times: &mut StageTimes,
    ) -> Result<Option<(Sink, u64)>> {
        while let Ok((sink, missing)) = sinks.recv() {
            if missing > 0 {
                return Ok(Some((sink, missing)));
            }
            times.add(&sink.finish(self.watch)?);
        }
        Ok(None)
    }

    /// The contents of a chunk. A panic there is a bug; it must end the run with a message, not
    /// leave it waiting.
    fn encoded(&self, chunk: &Chunk) -> Result<EncodedChunk> {
        catch_unwind(AssertUnwindSafe(|| self.maker.make(chunk)))
            .unwrap_or_else(|panic| Err(internal(chunk, &*panic)))
    }
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
