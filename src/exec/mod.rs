//! Running work: a byte budget, bounded queues, an ordered release, cancelling, progress, threads.
//!
//! Stages are joined by queues whose bound is in bytes: whoever starts a piece of work first takes a [`Permit`] for the
//! memory that the piece will need, the permit travels with the piece through all queues, and it is given back when the
//! last stage is done with it. So a slow stage stops the ones before it, whatever the number of pieces. A thread of the
//! compute pool never waits for a permit or a queue: permits are taken by the thread that feeds the pool.

mod ahead;
mod budget;
mod cancel;
pub(crate) mod lanes;
mod limits;
mod progress;
mod reorder;
mod room;
mod vectors;

pub(crate) use ahead::will_read;
pub use budget::{MemoryBudget, Permit};
pub use cancel::CancelToken;
pub use limits::usable_memory;
pub use progress::{Progress, Silent};
pub use reorder::Reorder;
pub use room::{Lent, Room};
pub(crate) use vectors::{Avx2, Avx512, with_avx512, with_vectors};

use crate::error::{Error, Result};

/// A pool of `threads` worker threads of our own; 0 means as many as the process may use.
///
/// # Errors
/// [`Error::Io`] when the system refuses threads.
pub fn pool(threads: usize) -> Result<rayon::ThreadPool> {
    let threads = if threads == 0 { available_threads() } else { threads };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(|i| format!("isospan-{i}"))
        .build()
        .map_err(|e| Error::io("start the threads of", "the compute pool", std::io::Error::other(e)))
}

/// Threads that this process may use (affinity and cgroup quota respected).
pub fn available_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}
