//! Extracts several isosurfaces from an archive in one pass: each block is decoded once, for any
//! number of isovalues.
//!
//! Chunks are extracted in parallel, and welded in chunk order while others are extracted
//! ([`in_order`]). Every isovalue has its own weld, which gets the same input as it would get
//! alone: a surface does not depend on what else was asked for. Blocks of a chunk are decoded one
//! after another into the same small buffer, so the memory of a chunk is that of its corners and of
//! its surfaces, not of its tetrahedra.

use super::cubes::{node_place, nodes_of, part_bytes};
use super::parts::Parts;
use super::settings::SurfaceSettings;
use super::unpacked::UnpackedChunk;
use super::worker::{ChunkSurfaces, ChunkWork, ChunkWorker, Question};
use crate::error::Result;
use crate::exec::{Progress, in_order};
use crate::geom::LatticeBox;
use crate::grid::ChunkId;
use crate::index::Entry;
use crate::mesh::tet::is_active;
use crate::pipeline::plan::{SurfaceShares, estimate};
use crate::pipeline::read::{
    BufferPool, CacheHit, ChunkReader, Frontier, Needed, StepView, Wanted, bytes_per_vertex, in_memory,
    in_world, pyramid_of,
};
use crate::surface::edit::fans::split_fans;
use crate::surface::weld::{BuilderSettings, StoredSurface, SurfaceBuilder};
use crate::surface::{SurfaceSource, TriMesh};
use std::path::PathBuf;
use std::sync::atomic::Ordering;

/// A surface, welded, and the number of its tetrahedra.
pub(super) struct Extracted {
    pub(super) surface: StoredSurface,
    pub(super) active_cells: u64,
    /// Whether it is in the world already, of a grid with coordinates.
    pub(super) is_placed: bool,
}

impl Extracted {
    /// Hands this surface, or one with others, to `use_it`, in the world.
    pub(super) fn in_world<T>(
        &self,
        archive: &StepView,
        surface: &dyn SurfaceSource,
        use_it: impl FnOnce(&dyn SurfaceSource) -> Result<T>,
    ) -> Result<T> {
        if self.is_placed { use_it(surface) } else { in_world(archive, surface, use_it) }
    }

    /// This surface in memory, in the world.
    pub(super) fn into_mesh(self, archive: &StepView) -> Result<TriMesh> {
        if self.is_placed { self.surface.into_mesh() } else { in_memory(archive, self.surface) }
    }
}

/// Where surfaces are while they are made.
pub(super) struct SurfaceStorage {
    /// For what memory does not hold.
    pub(super) scratch: PathBuf,
    /// Surfaces that are no longer needed, whose memory is reused: the first one for the first
    /// isovalue, and so on.
    pub(super) reused: Vec<TriMesh>,
}

/// Extracts all isovalues from the active blocks of all chunks. What is finished goes to `parts`,
/// too, where there are some.
pub(super) fn extract_surfaces(
    question: &Question<'_>,
    settings: &SurfaceSettings,
    storage: SurfaceStorage,
    mut parts: Option<&mut Parts<'_>>,
    progress: &dyn Progress,
) -> Result<Vec<Extracted>> {
    let work = question.work;
    let active_blocks = work.iter().map(|w| w.blocks.len() as u64).sum::<u64>();
    let bytes: Vec<u64> = work.iter().map(|work| question.need(work)).collect();
    let largest = bytes.iter().copied().max().unwrap_or(0);
    let shares = SurfaceShares::of(settings.resources.memory, active_blocks, largest)?;
    let mut weld = Weld::new(question, settings, shares, storage, progress);
    let pool = question.archive.pools.lend(settings.resources.threads)?;
    progress.begin("surface", active_blocks, "blocks");
    let (cache, of_this_question) = (&question.archive.cache, BufferPool::default());
    let spare = if cache.most() > 0 { &question.archive.spare } else { &of_this_question };
    let extract = |n: usize| {
        settings.resources.cancel.check()?;
        question.chunk_surfaces(&work[n], spare)
    };
    in_order(&bytes, shares.batch, &pool, extract, |n, surfaces| {
        question.archive.close_before(work[n].chunk);
        weld.push(surfaces, spare)?;
        // After the last chunk comes the surface of which others are previews.
        let has_more = n + 1 < work.len();
        let parts = parts.as_mut().filter(|parts| has_more || !parts.are_previews());
        parts.map_or(Ok(()), |parts| weld.hand_on(parts, work[n].chunk.0 + 1))
    })?;
    if let Some(parts) = parts.filter(|parts| !parts.are_previews()) {
        weld.close()?;
        weld.hand_on(parts, question.archive.chunks.len())?;
    }
    question.archive.spare.trim(cache.most() / 4);
    weld.finish()
}

/// Cached blocks that are looked up together, and held meanwhile.
const AT_ONCE: usize = 32;

impl Question<'_> {
    /// Bytes in which the blocks of a chunk are extracted: from the plan's target and the point
    /// set, without reading.
    fn need(&self, work: &ChunkWork) -> u64 {
        if let Some(cells) = &work.cells {
            return part_bytes(cells, work.blocks.len() as u64, self.isovalues.len() as u64);
        }
        let tets: u64 = work.blocks.iter().map(|b| u64::from(b.tets) * self.times_active(b)).sum();
        let per_vertex =
            bytes_per_vertex(self.archive) + estimate::SURFACE_PER_VERTEX * self.isovalues.len() as u64;
        estimate::extraction_bytes(self.vertices_near(work.chunk), per_vertex, tets)
    }

    /// Vertices that a chunk uses, about.
    pub(super) fn vertices_near(&self, chunk: ChunkId) -> u64 {
        let archive = self.archive;
        let core = &archive.chunks.chunk(chunk).core;
        // The halo points that tetrahedra use lie within about one spacing.
        let near =
            core.grow_sides(archive.points.spacing_around(core), &archive.chunks.bricks().lattice.domain());
        archive.points.count_in(&near)
    }

    /// For how many isovalues a block can hold an answer.
    pub(super) fn times_active(&self, block: &Entry) -> u64 {
        self.isovalues.iter().filter(|&&v| self.is_wanted(block, v)).count() as u64
    }

    /// Whether a block is active, or may have caps.
    fn is_wanted(&self, block: &Entry, isovalue: f32) -> bool {
        is_active(block.min, block.max, isovalue) || self.caps.is_some() && isovalue <= block.max
    }

    /// The surfaces of a chunk; buffers come from `spare` where there are any.
    fn chunk_surfaces(&self, work: &ChunkWork, spare: &BufferPool) -> Result<ChunkSurfaces> {
        if let Some(cells) = &work.cells {
            return self.cube_surfaces(cells, spare);
        }
        let (mut buffers, mut reader) = (spare.buffers(), None);
        let mut chunk = ChunkWorker::new(self, spare);
        let mut unpacked = UnpackedChunk::of(self.archive, work)?;
        // Unpacked blocks are not in the cache: they need not be looked up.
        let at_once = if unpacked.is_none() { AT_ONCE } else { 1 };
        let mut cached = vec![];
        for (n, block) in work.blocks.iter().enumerate() {
            if let Some(unpacked) = &mut unpacked
                && unpacked.add(n, block, &mut chunk, &mut buffers)?
            {
                continue;
            }
            if n % at_once == 0 {
                let next = work.blocks[n..].iter().take(at_once).map(|b| b.block);
                self.archive.cache.get(work.chunk, next, &mut cached);
            }
            let ahead = |blocks: usize| cached.get(n % at_once + blocks).and_then(Option::as_ref);
            self.prefetch(ahead(1), ahead(2));
            if let Some(found) = ahead(0) {
                chunk.add_cached(work.chunk, block, found, &mut buffers);
                continue;
            }
            let reader = match &mut reader {
                Some(reader) => reader,
                None => {
                    let memory = std::mem::take(&mut buffers.reader);
                    let reader = reader.insert(ChunkReader::open(self.archive, work.chunk, memory)?);
                    reader.expect(work.blocks[n..].iter().map(|b| (b.block, self.wanted(b))))?;
                    reader
                }
            };
            if !reader.block(block.block, &self.wanted(block), &self.needed(), &mut buffers.block)? {
                continue;
            }
            self.archive.cache.put(work.chunk, block.block, &buffers.block, &mut buffers.bench);
            chunk.add(block, &mut buffers, Some(reader));
        }
        unpacked.map_or(Ok(()), UnpackedChunk::end)?;
        if let Some(reader) = reader {
            self.active_bytes.fetch_add(reader.active_bytes(), Ordering::Relaxed);
            buffers.reader = reader.into_memory();
        }
        spare.give_buffers(buffers);
        Ok(chunk.finish())
    }

    /// Whether all tetrahedra of a block are wanted, and nothing but their surfaces.
    pub(super) fn is_whole(&self) -> bool {
        self.cut.is_none() && self.caps.is_none()
    }

    /// Prefetches the next cached block, and from the one after it what shows which tetrahedra may
    /// be active.
    fn prefetch(&self, next: Option<&CacheHit>, after: Option<&CacheHit>) {
        if let Some(next) = next {
            next.block.rest_will_be_read(self.isovalues);
        }
        if let Some(after) = after {
            after.block.will_be_read();
        }
    }

    /// What is wanted of an entry's block; one without active tetrahedra is read for caps only.
    pub(super) fn wanted(&self, entry: &Entry) -> Wanted<'_> {
        match (self.cut, self.caps) {
            (Some(cut), _) => Wanted::Touching(cut),
            (None, Some(top)) if !self.isovalues.iter().any(|&v| is_active(entry.min, entry.max, v)) => {
                Wanted::AtEnds(top)
            }
            _ => Wanted::All,
        }
    }

    /// Caps have triangles in tetrahedra that are not active, and cached blocks are for
    /// other isovalues too.
    fn needed(&self) -> Needed<'_> {
        match self.caps.is_some() || self.archive.cache.most() > 0 {
            true => Needed::All,
            false => Needed::ForActive(self.isovalues),
        }
    }
}

/// The welds of all isovalues, which take chunks in order.
pub(super) struct Weld<'a> {
    question: &'a Question<'a>,
    builders: Vec<(SurfaceBuilder, Closing)>,
    active_cells: Vec<u64>,
    /// Made when first needed: most surfaces fit in memory.
    frontier: Option<Frontier>,
    shares: SurfaceShares,
    /// Where each surface is stored.
    place: BuilderSettings,
    memory: u64,
    done: usize,
    progress: &'a dyn Progress,
}

impl<'a> Weld<'a> {
    pub(super) fn new(
        question: &'a Question<'a>,
        settings: &SurfaceSettings,
        shares: SurfaceShares,
        SurfaceStorage { scratch, reused }: SurfaceStorage,
        progress: &'a dyn Progress,
    ) -> Self {
        let count = question.isovalues.len();
        let memory_bytes = usize::try_from(shares.finished / count as u64).unwrap_or(usize::MAX);
        let place = BuilderSettings { scratch, memory_bytes };
        let memory = reused.into_iter().chain(std::iter::repeat_with(TriMesh::default)).take(count);
        let open_edges = shares.open_edges / count as u64;
        let builder =
            |memory| (SurfaceBuilder::reusing(&question.world, &place, memory), Closing::new(open_edges));
        Self {
            question,
            builders: memory.map(builder).collect(),
            active_cells: vec![0; count],
            frontier: None,
            shares,
            place: place.clone(),
            memory: settings.resources.memory,
            done: 0,
            progress,
        }
    }

    /// Adds the next chunk; the buffers go back to `spare`.
    pub(super) fn push(&mut self, surfaces: ChunkSurfaces, spare: &BufferPool) -> Result<()> {
        for (i, surface) in surfaces.iter().enumerate() {
            self.active_cells[i] += surface.active_cells();
            self.builders[i].0.push(surface)?;
        }
        spare.give_surfaces(surfaces);
        let blocks = self.question.work[self.done].blocks.len() as u64;
        self.done += 1;
        self.close_edges()?;
        self.progress.advance(blocks);
        Ok(())
    }

    /// Closes shared edges where they have become many.
    fn close_edges(&mut self) -> Result<()> {
        let archive = self.question.archive;
        for (builder, closing) in &mut self.builders {
            if (builder.open_edges() as u64) < closing.look_at {
                continue;
            }
            let frontier = match self.frontier.take() {
                Some(frontier) => frontier,
                None if archive.is_pyramid() => Frontier::of_regions(&part_regions(self.question)),
                None => Frontier::new(archive, self.question.work.iter().map(|w| w.chunk))?,
            };
            let beyond = self.frontier.insert(frontier).after(self.done);
            let pyramid = pyramid_of(archive.manifest.plan.points);
            let nodes = pyramid.map(|pyramid| pyramid.nodes(self.question.level).map(|n| n as u64));
            let place = |id| match nodes {
                Some(nodes) => Some(node_place(nodes, id)),
                None => archive.points.position(id),
            };
            builder.keep_open(|a, b| match (place(a), place(b)) {
                (Some(a), Some(b)) => beyond.can_have(a, b),
                _ => true,
            })?;
            if !closing.looked(builder.open_edges() as u64) {
                let open = builder.open_edges() as u64 * self.question.isovalues.len() as u64;
                return Err(self.shares.too_many_open(self.memory, open));
            }
        }
        Ok(())
    }

    /// Hands on what chunks before a number have added.
    fn hand_on(&mut self, parts: &mut Parts<'_>, chunks: u64) -> Result<()> {
        let mut builders = self.builders.iter_mut().enumerate();
        builders.try_for_each(|(isovalue, (builder, _))| parts.take(builder, isovalue, chunks))
    }

    /// Finishes all vertices: no chunk comes any more.
    fn close(&mut self) -> Result<()> {
        self.builders.iter_mut().try_for_each(|(builder, _)| builder.close())
    }

    pub(super) fn finish(self) -> Result<Vec<Extracted>> {
        let has_holes = self.question.archive.may_have_holes();
        let (place, memory) = (self.place, self.shares.batch);
        let extracted = |((builder, _), active_cells): ((SurfaceBuilder, _), u64)| {
            let surface = builder.finish()?;
            let surface = if has_holes { split_fans(surface, &place, memory)? } else { surface };
            Ok(Extracted { surface, active_cells, is_placed: false })
        };
        self.builders.into_iter().zip(self.active_cells).map(extracted).collect()
    }
}

/// The nodes of the parts of a pyramid, with the place of the row of each.
fn part_regions(question: &Question<'_>) -> Vec<([u64; 2], LatticeBox)> {
    let cells = question.work.iter().filter_map(|work| work.cells);
    cells.map(|cells| ([cells[1][0], cells[2][0]], nodes_of(&cells))).collect()
}

/// When to look at the open edges of a surface: whenever they have doubled, which costs a constant
/// number of looks an edge.
struct Closing {
    most: u64,
    look_at: u64,
}

impl Closing {
    fn new(most: u64) -> Self {
        Self { most, look_at: most / 64 + 1 }
    }

    /// Whether `open` edges may stay open.
    fn looked(&mut self, open: u64) -> bool {
        self.look_at = (2 * open).clamp(self.most / 64 + 1, self.most + 1);
        open <= self.most
    }
}
