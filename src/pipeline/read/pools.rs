//! Pools of what extraction reuses. Buffers are reused for the next chunk and, while an archive
//! caches blocks, for the next question: their pages need not be cleared again. Threads are reused
//! too.

use super::block::Block;
use super::reader_memory::{ReaderMemory, ValuesMemory};
use crate::surface::extract::{ChunkSurface, Sides, Workbench};
use isospan_io::error::Result;
use isospan_io::exec::{Threads, available_threads};
use isospan_mesh::mesh::tet::Tet;
use std::ops::Deref;
use std::sync::{Mutex, PoisonError};

/// Memory for the chunks to come; from any thread.
#[derive(Default)]
pub(in crate::pipeline) struct BufferPool {
    surfaces: List<ChunkSurface>,
    buffers: List<Buffers>,
    nodes: List<Vec<f32>>,
}

/// Bytes of vectors of nodes that are kept.
const MOST_OF_NODES: usize = 64 << 20;

/// The memory in which a chunk is read and processed.
#[derive(Default)]
pub(in crate::pipeline) struct Buffers {
    pub(in crate::pipeline) reader: ReaderMemory,
    /// Of each step that is asked.
    pub(in crate::pipeline) values: Vec<ValuesMemory>,
    pub(in crate::pipeline) block: Block,
    pub(in crate::pipeline) sides: Sides,
    pub(in crate::pipeline) active: Vec<Tet>,
    pub(in crate::pipeline) bench: Workbench,
}

/// The threads of questions that were answered, for the next ones.
#[derive(Default)]
pub(in crate::pipeline) struct Pools(Mutex<Vec<Threads>>);

/// Threads, until this is dropped. No other question has them meanwhile.
pub(in crate::pipeline) struct LentPool<'a> {
    pools: &'a Pools,
    /// There until the end.
    pool: Option<Threads>,
}

impl Pools {
    /// Lends `threads` threads; 0 means as many as the process may use.
    pub(in crate::pipeline) fn lend(&self, threads: usize) -> Result<LentPool<'_>> {
        let count = if threads == 0 { available_threads() } else { threads };
        let mut pools = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // Those of another number are of no use any more.
        pools.retain(|pool| pool.count() == count);
        let found = pools.pop();
        drop(pools);
        let pool = found.map_or_else(|| Threads::new(count), Ok)?;
        Ok(LentPool { pools: self, pool: Some(pool) })
    }
}

impl Deref for LentPool<'_> {
    type Target = Threads;
    fn deref(&self) -> &Threads {
        self.pool.as_ref().expect("it is given back only when this is dropped")
    }
}

impl Drop for LentPool<'_> {
    fn drop(&mut self) {
        self.pools.0.lock().unwrap_or_else(PoisonError::into_inner).extend(self.pool.take());
    }
}

struct List<T>(Mutex<Vec<T>>);

impl<T> Default for List<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T: Default> List<T> {
    /// Takes the last one, or a new one.
    fn take(&self) -> T {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    fn give(&self, items: impl IntoIterator<Item = T>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(items);
    }

    /// Keeps the first ones, up to `most` bytes.
    fn trim(&self, most: usize, bytes: impl Fn(&T) -> usize) {
        let mut sum = 0;
        self.0.lock().unwrap_or_else(PoisonError::into_inner).retain(|item| {
            sum += bytes(item);
            sum <= most
        });
    }
}

impl BufferPool {
    pub(in crate::pipeline) fn surface(&self) -> ChunkSurface {
        self.surfaces.take()
    }

    pub(in crate::pipeline) fn give_surfaces(&self, surfaces: Vec<ChunkSurface>) {
        self.surfaces.give(surfaces);
    }

    pub(in crate::pipeline) fn buffers(&self) -> Buffers {
        self.buffers.take()
    }

    pub(in crate::pipeline) fn give_buffers(&self, buffers: Buffers) {
        self.buffers.give([buffers]);
    }

    /// A vector with room for so many nodes, or at most twice as many.
    pub(in crate::pipeline) fn nodes(&self, count: usize) -> Vec<f32> {
        let mut all = self.nodes.0.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |v: &Vec<f32>| (count..=2 * count).contains(&v.capacity());
        let fitting = all.iter().enumerate().filter(|(_, v)| fits(v));
        let least = fitting.min_by_key(|(_, v)| v.capacity()).map(|(n, _)| n);
        least.map_or_else(|| Vec::with_capacity(count), |n| all.swap_remove(n))
    }

    pub(in crate::pipeline) fn give_nodes(&self, nodes: Vec<f32>) {
        self.nodes.give([nodes]);
        self.nodes.trim(MOST_OF_NODES, bytes_of);
    }

    /// Drops what exceeds `most` bytes.
    pub(in crate::pipeline) fn trim(&self, most: usize) {
        self.surfaces.trim(most / 2, ChunkSurface::bytes);
        // An archive has the one or the other.
        self.buffers
            .trim(most / 2, |b| b.reader.bytes() + b.values.iter().map(ValuesMemory::bytes).sum::<usize>());
        self.nodes.trim(most / 2, bytes_of);
    }
}

fn bytes_of(nodes: &Vec<f32>) -> usize {
    4 * nodes.capacity()
}
