//! Visits the chunks of an archive: they are decoded and processed in parallel, and the results are
//! handed on in chunk order.
//!
//! ```text
//!  chunks of a question ──▶ as many as fit the memory: decode ▶ job, on all threads ──▶ take, in order
//! ```
//!
//! This serves the questions that want whole tetrahedra, as [`crate::pipeline::surface`] serves
//! those about surfaces.

use super::decoded::DecodedChunk;
use super::step_view::StepView;
use crate::index::Entry;
use crate::pipeline::plan::estimate;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Resources, Threads, in_order};
use isospan_io::geom::LatticeBox;
use isospan_io::grid::ChunkId;

/// Bytes for a vertex of a decoded chunk and for one of its tetrahedra, results of a job included,
/// and for a chunk of any size.
const VERTEX: u64 = 72;
const TET: u64 = 64;
const CHUNK: u64 = 1 << 20;
/// Tetrahedra a point, at most, where they are not counted.
const TETS_A_POINT: u64 = 8;

/// Which blocks to read.
pub(in crate::pipeline) enum Blocks {
    /// All of the archive.
    All,
    /// The blocks of an index's answer, in order.
    Some(Vec<Entry>),
}

impl Blocks {
    /// Bytes that the list takes, with what chooses from it.
    pub(in crate::pipeline) fn bytes(&self) -> u64 {
        match self {
            Self::All => 0,
            Self::Some(entries) => 64 * entries.len() as u64,
        }
    }
}

/// Chunks of an archive to be read, in order.
pub(in crate::pipeline) struct Visit<'a> {
    pub(in crate::pipeline) archive: &'a StepView,
    /// The chunks, in order.
    pub(in crate::pipeline) chunks: Vec<ChunkId>,
    blocks: Blocks,
    resources: &'a Resources,
    pub(in crate::pipeline) threads: usize,
    /// The part of the memory that is for chunks at work at one time.
    share: Box<dyn Fn(u64) -> u64 + Sync + 'a>,
}

impl<'a> Visit<'a> {
    /// All chunks of some blocks. Chunks at work have a `share` of the memory of `resources`.
    pub(in crate::pipeline) fn new(
        archive: &'a StepView,
        blocks: Blocks,
        resources: &'a Resources,
        share: impl Fn(u64) -> u64 + Sync + 'a,
    ) -> Result<Self> {
        let chunks = match &blocks {
            Blocks::All => (0..archive.chunks.len()).map(ChunkId).collect(),
            Blocks::Some(entries) => {
                let mut chunks: Vec<ChunkId> = entries.iter().map(|e| ChunkId(e.chunk)).collect();
                chunks.dedup();
                chunks
            }
        };
        chunks.iter().try_for_each(|&c| archive.expect_chunk(c))?;
        let threads = resources.threads;
        Ok(Self { archive, chunks, blocks, resources, threads, share: Box::new(share) })
    }

    /// Leaves out chunks none of whose tetrahedra can touch what `touches` accepts (a box, or
    /// larger).
    pub(in crate::pipeline) fn confine(&mut self, touches: impl Fn(&LatticeBox) -> bool) -> Result<()> {
        let mut kept = vec![];
        for &id in &self.chunks {
            // A halo is wider than the least only where the summary says so.
            if touches(&region(self.archive, id, 0)) || touches(&full_region(self.archive, id)?) {
                kept.push(id);
            }
        }
        self.chunks = kept;
        Ok(())
    }

    /// The blocks of a chunk that are read.
    fn blocks_of(&self, id: ChunkId) -> Result<Vec<u32>> {
        match &self.blocks {
            Blocks::All => {
                let blocks = self.archive.mesh_sizes(id)?.tet_blocks;
                Ok((0..blocks).collect())
            }
            Blocks::Some(entries) => {
                let first = entries.partition_point(|e| e.chunk < id.0);
                Ok(entries[first..].iter().take_while(|e| e.chunk == id.0).map(|e| e.block).collect())
            }
        }
    }

    /// Whether the tetrahedra of the chunks have the volume of the box.
    pub(in crate::pipeline) fn have_volume_of_box(&self) -> Result<bool> {
        let mut sum = 0i128;
        for &id in &self.chunks {
            self.archive.close_before(id);
            sum = sum.saturating_add(self.archive.mesh_of(id)?.mesh_summary(id)?.volume6);
        }
        Ok(sum == self.archive.manifest.plan.lattice.volume6())
    }

    /// Vertices of a chunk, about: from the plan and the point set, without reading.
    fn vertices(&self, id: ChunkId) -> u64 {
        let archive = self.archive;
        archive.points.count_in(&estimate::near(
            &archive.points,
            &archive.chunks.chunk(id).core,
            &archive.chunks.bricks().lattice.domain(),
            estimate::Halo::Owned,
        ))
    }

    /// Vertices of the largest chunk, about.
    pub(in crate::pipeline) fn most_vertices(&self) -> u64 {
        self.chunks.iter().map(|&c| self.vertices(c)).max().unwrap_or(0)
    }

    /// Bytes in which a chunk is read and worked on.
    fn need(&self, id: ChunkId) -> u64 {
        CHUNK.saturating_add(self.vertices(id).saturating_mul(VERTEX + TETS_A_POINT * TET))
    }

    /// Bytes in which the largest chunk is read and worked on, with `extra` bytes for its job.
    pub(in crate::pipeline) fn least(&self, extra: u64) -> u64 {
        self.chunks.iter().map(|&c| self.need(c)).max().unwrap_or(0).saturating_add(extra)
    }

    /// Refuses memory in which the largest chunk, with `extra` bytes for its job, does not fit.
    ///
    /// # Errors
    /// [`Error::Budget`] naming the least that would do.
    pub(in crate::pipeline) fn check_memory(&self, extra: u64) -> Result<()> {
        let (largest, available) = (self.least(extra), self.resources.memory);
        if largest > (self.share)(available) {
            let needed = least_with(largest, &self.share);
            return Err(Error::memory("", needed, available));
        }
        Ok(())
    }

    /// Reads all chunks. `job` runs on any thread, with `extra` bytes of its own; `take` gets the
    /// results in chunk order. On one thread jobs run in chunk order, too.
    pub(in crate::pipeline) fn each<T: Send>(
        &self,
        extra: u64,
        progress: &dyn Progress,
        job: impl Fn(ChunkId, DecodedChunk) -> Result<T> + Sync,
        mut take: impl FnMut(usize, T) -> Result<()> + Send,
    ) -> Result<()> {
        let (threads, memory) = (Threads::new(self.threads)?, (self.share)(self.resources.memory));
        let bytes: Vec<u64> = self.chunks.iter().map(|&id| self.need(id).saturating_add(extra)).collect();
        let make = |n: usize| {
            self.resources.cancel.check()?;
            let id = self.chunks[n];
            job(id, self.archive.decode(id, &self.blocks_of(id)?)?)
        };
        in_order(&bytes, memory, &threads, make, |n, result| {
            self.archive.close_before(self.chunks[n]);
            take(n, result)?;
            progress.advance(1);
            Ok(())
        })
    }
}

/// The least budget whose share, which grows with it, is `wanted` bytes.
fn least_with(wanted: u64, share: impl Fn(u64) -> u64) -> u64 {
    let (mut too_little, mut enough) = (0, wanted.max(1));
    while share(enough) < wanted {
        if enough == u64::MAX {
            return enough;
        }
        (too_little, enough) = (enough, enough.saturating_mul(2));
    }
    while enough - too_little > 1 {
        let middle = too_little + (enough - too_little) / 2;
        if share(middle) < wanted { too_little = middle } else { enough = middle }
    }
    enough
}

fn region(archive: &StepView, id: ChunkId, retries: u32) -> LatticeBox {
    let domain = archive.chunks.bricks().lattice.domain();
    let halo = estimate::Halo::of(&archive.manifest.plan);
    estimate::region(&archive.points, &archive.chunks.chunk(id).core, &domain, halo, retries)
}

/// A box that holds all tetrahedra of a chunk. Reads its summary.
pub(in crate::pipeline) fn full_region(archive: &StepView, id: ChunkId) -> Result<LatticeBox> {
    let retries = archive.mesh_sizes(id)?.retries;
    Ok(region(archive, id, retries))
}
