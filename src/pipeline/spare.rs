//! The buffers of extraction, for the next chunk, and, while an archive keeps blocks, for the next question: pages that a process has
//! need not be cleared again.

use super::block::Block;
use super::reader::ReaderMemory;
use crate::mesh::tet::Tet;
use crate::surface::marching_tets::{ChunkSurface, Sides};
use crate::surface::patch::Patch;
use std::sync::{Mutex, PoisonError};

/// Memory for the chunks to come; from any thread.
#[derive(Default)]
pub(super) struct Spare {
    surfaces: List<ChunkSurface>,
    buffers: List<Buffers>,
}

/// What a chunk is read and worked on in.
#[derive(Default)]
pub(super) struct Buffers {
    pub(super) reader: ReaderMemory,
    pub(super) block: Block,
    pub(super) sides: Sides,
    pub(super) tets: Vec<Tet>,
    pub(super) active: Vec<Tet>,
    pub(super) patch: Patch,
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

    /// Keeps the first ones, up to so many bytes.
    fn trim(&self, most: usize, bytes: impl Fn(&T) -> usize) {
        let mut sum = 0;
        self.0.lock().unwrap_or_else(PoisonError::into_inner).retain(|item| {
            sum += bytes(item);
            sum <= most
        });
    }
}

impl Spare {
    pub(super) fn surface(&self) -> ChunkSurface {
        self.surfaces.take()
    }

    pub(super) fn give_surfaces(&self, surfaces: Vec<ChunkSurface>) {
        self.surfaces.give(surfaces);
    }

    pub(super) fn buffers(&self) -> Buffers {
        self.buffers.take()
    }

    pub(super) fn give_buffers(&self, buffers: Buffers) {
        self.buffers.give([buffers]);
    }

    /// Drops what exceeds so many bytes.
    pub(super) fn trim(&self, most: usize) {
        self.surfaces.trim(most / 2, ChunkSurface::bytes);
        self.buffers.trim(most / 2, |b| b.reader.bytes());
    }
}
