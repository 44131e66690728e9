//! [`Resources`]: what a run may use of the machine.

use super::{CancelToken, available_threads, usable_memory};
use std::path::PathBuf;

/// The resources of the machine that a run may use. They decide how long the run takes, and no byte
/// of what it makes.
///
/// ```
/// use isospan_io::exec::Resources;
/// let small = Resources::default().with_threads(2).with_memory(1 << 30);
/// assert_eq!((small.threads, small.scratch), (2, None));
/// ```
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Resources {
    /// Threads; 0 means as many as the process may use.
    pub threads: usize,
    /// Bytes for everything that grows; half of what the process may use by default.
    pub memory: u64,
    /// Folder for what does not fit in memory. Not given, it is the output's folder where a surface
    /// or tetrahedra are written, else the system's temporary folder.
    pub scratch: Option<PathBuf>,
    /// Stops the run; the same call makes a reduction go on, and of a question nothing is written.
    pub cancel: CancelToken,
}

impl Default for Resources {
    fn default() -> Self {
        Self { threads: 0, memory: usable_memory() / 2, scratch: None, cancel: CancelToken::new() }
    }
}

impl Resources {
    /// The same with this many threads; 0 means as many as the process may use.
    #[must_use]
    pub fn with_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// The same with this many bytes for everything that grows.
    #[must_use]
    pub fn with_memory(self, memory: u64) -> Self {
        Self { memory, ..self }
    }

    /// The same with a folder for what does not fit in memory, or without.
    #[must_use]
    pub fn with_scratch(self, scratch: impl Into<Option<PathBuf>>) -> Self {
        Self { scratch: scratch.into(), ..self }
    }

    /// The same, stopped by a token.
    #[must_use]
    pub fn with_cancel(self, cancel: CancelToken) -> Self {
        Self { cancel, ..self }
    }

    /// How many threads work.
    pub fn worker_threads(&self) -> usize {
        if self.threads == 0 { available_threads() } else { self.threads }
    }

    /// The folder for what does not fit in memory, where no output suggests one.
    pub fn scratch_folder(&self) -> PathBuf {
        self.scratch.clone().unwrap_or_else(std::env::temp_dir)
    }
}
