//! [`Threads`]: the threads that answer a question.

use super::{available_threads, pool};
use crate::error::Result;
use rayon::ThreadPool;

/// Threads that pieces of work are made on. One thread is the calling one: no other is started, so
/// a question is answered where there are no threads, too.
pub enum Threads {
    /// The calling thread alone.
    Calling,
    /// Some of their own.
    Pool(ThreadPool),
}

impl Threads {
    /// So many threads; 0 means as many as the process may use.
    ///
    /// # Errors
    /// Those of [`pool`].
    pub fn new(threads: usize) -> Result<Self> {
        match if threads == 0 { available_threads() } else { threads } {
            1 => Ok(Self::Calling),
            threads => pool(threads).map(Self::Pool),
        }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        match self {
            Self::Calling => 1,
            Self::Pool(pool) => pool.current_num_threads(),
        }
    }
}
