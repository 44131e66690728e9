//! The surfaces of a question, welded from those of its chunks, which come in order.
//!
//! Every isovalue has its own weld, which gets the same input as it would get alone: a surface does
//! not depend on what else was asked for.

use super::cubes::{node_place, nodes_of};
use super::parts::Parts;
use super::question::Question;
use super::settings::SurfaceSettings;
use super::worker::ChunkSurfaces;
use crate::pipeline::plan::SurfaceShares;
use crate::pipeline::read::{BufferPool, Frontier, StepView, in_memory, in_world, pyramid_of};
use crate::surface::edit::fans::split_fans;
use crate::surface::weld::{BuilderSettings, StoredSurface, SurfaceBuilder};
use crate::surface::{SurfaceSource, TriMesh};
use isospan_io::error::Result;
use isospan_io::exec::Progress;
use isospan_io::geom::LatticeBox;
use std::path::PathBuf;

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
    pub(super) fn hand_on(&mut self, parts: &mut Parts<'_>, chunks: u64) -> Result<()> {
        let mut builders = self.builders.iter_mut().enumerate();
        builders.try_for_each(|(isovalue, (builder, _))| parts.take(builder, isovalue, chunks))
    }

    /// Finishes all vertices: no chunk comes any more.
    pub(super) fn close(&mut self) -> Result<()> {
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
