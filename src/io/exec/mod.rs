//! Running work: a byte budget, bounded queues, an ordered release, cancelling, progress, threads.
//!
//! Stages are joined by queues whose bound is in bytes. A thread that starts a piece of work first
//! takes a [`Permit`] for the memory that the piece will need. The permit travels with the piece
//! through all queues, and is given back when the last stage is done with it. So a slow stage stops
//! the ones before it, for any number of pieces. A thread of the compute pool never waits for a
//! permit or a queue: permits are taken by the thread that feeds the pool.

mod ahead;
mod budget;
mod cancel;
mod clock;
mod limits;
mod ordered;
mod progress;
mod reorder;
mod resources;
mod room;
mod threads;

pub use ahead::will_read;
pub use budget::{MemoryBudget, Permit};
pub use cancel::CancelToken;
pub use clock::Clock;
pub use limits::{expect_address_space, usable_memory};
pub use ordered::in_order;
pub use progress::{Attempt, Progress, Reached, Silent};
pub use reorder::Reorder;
pub use resources::Resources;
pub use room::{Lent, Room};
pub use threads::Threads;

use crate::error::{Error, Result};

/// The most threads that can be asked for: more than any machine has, few enough to be started.
pub const MOST_THREADS: usize = 4096;

/// A pool of `threads` worker threads of our own; 0 means as many as the process may use. If the
/// system refuses this number, the pool has half of it, and so on down to one. The results are the
/// same.
///
/// # Errors
/// [`Error::Usage`] for more than [`MOST_THREADS`]; [`Error::Io`] when the system refuses even one
/// thread.
pub fn pool(threads: usize) -> Result<rayon::ThreadPool> {
    if threads > MOST_THREADS {
        return Err(Error::usage(format!("{threads} threads: ask for {MOST_THREADS} at the most")));
    }
    let threads = if threads == 0 { available_threads() } else { threads };
    fewer_if_refused(threads, |threads| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("isospan-{i}")).build()
    })
    .map_err(no_thread)
}

fn fewer_if_refused<T, E>(
    threads: usize,
    start: impl Fn(usize) -> std::result::Result<T, E>,
) -> std::result::Result<T, E> {
    match start(threads) {
        Err(_) if threads > 1 => fewer_if_refused(threads / 2, start),
        result => result,
    }
}

/// The error of a thread that the system refuses.
pub fn no_thread(why: impl std::fmt::Display) -> Error {
    let hint = std::io::Error::other(format!("{why}; raise the limit of processes (ulimit -u), or end some"));
    Error::io("start", "a thread", hint)
}

/// Threads that this process may use (affinity and cgroup quota respected).
pub fn available_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refused_threads_are_fewer_threads_or_one_line() {
        let start = |most: usize| move |n: usize| if n <= most { Ok(n) } else { Err("refused") };
        assert_eq!(fewer_if_refused(16, start(16)), Ok(16));
        assert_eq!(fewer_if_refused(16, start(5)), Ok(4));
        assert_eq!(fewer_if_refused(7, start(1)), Ok(1));
        assert_eq!(fewer_if_refused(7, start(0)), Err("refused"));
        assert_eq!(pool(usize::MAX).err().map(|e| e.exit_code()), Some(2));
        let line = no_thread("refused").to_string();
        assert!(line.contains("ulimit -u") && !line.contains('\n'), "{line}");
    }
}
