//! Surfaces of a pyramid: marching cubes on the nodes around active bricks.
//!
//! The work is cut into parts of chunks, so that a volume of one chunk has work for some threads.
//! Of each part the least box that holds its active bricks is decoded, with a node on each side.

use super::question::{Cells, ChunkWork, Question};
use super::worker::ChunkSurfaces;
use crate::index::Entry;
use crate::pipeline::read::{Brick, BufferPool, StepView, bricks_of, chunk_place, pyramid_of};
use crate::surface::extract::{ChunkSurface, CubeBench, GridBlock};
use isospan_io::error::Result;
use isospan_io::geom::{LatticeBox, PointId};
use isospan_io::grid::{ChunkId, IndexBox};
use isospan_wavelet::Pyramid;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Cells along each axis of a part, at most.
const PART: u64 = isospan_wavelet::PART as u64;

/// Cells along each axis of the parts of a level: of a chunk at most.
fn part_of(pyramid: &Pyramid, level: usize) -> [u64; 3] {
    match level <= pyramid.details() {
        true => pyramid.stride(level).map(|stride| PART.min((isospan_wavelet::CHUNK / stride) as u64)),
        false => [PART; 3],
    }
}

/// The parts that have some of the bricks of chunks, those of other levels left out.
pub(super) fn by_part(archive: &StepView, level: usize, work: Vec<ChunkWork>) -> Result<Vec<ChunkWork>> {
    let Some(pyramid) = pyramid_of(archive.manifest.plan.points) else { return Ok(work) };
    let part = part_of(&pyramid, level);
    let mut parts = vec![];
    for ChunkWork { chunk, blocks, .. } in work {
        let bricks = bricks_of(&pyramid, chunk_place(&pyramid, chunk));
        let mut found: BTreeMap<[u64; 3], (Cells, Vec<Entry>)> = BTreeMap::new();
        for entry in blocks {
            // A brick that is not there is one of a damaged index.
            let Some(Brick { level: of_level, cells }) = bricks.get(entry.block as usize) else {
                archive.expect_block(chunk, entry.block, bricks.len())?;
                continue;
            };
            if *of_level != level {
                continue;
            }
            let cells: Cells = [0, 1, 2].map(|a| [cells[a].start as u64, cells[a].end as u64]);
            let place = [2, 1, 0].map(|a: usize| cells[a][0] / part[a]);
            let (all, entries) = found.entry(place).or_insert((cells, vec![]));
            for (all, cells) in all.iter_mut().zip(cells) {
                *all = [all[0].min(cells[0]), all[1].max(cells[1])];
            }
            entries.push(entry);
        }
        let work = |(cells, blocks)| ChunkWork { chunk, blocks, cells: Some(cells) };
        parts.extend(found.into_values().map(work));
    }
    Ok(parts)
}

/// All parts of a level that is coarser than those with bricks.
pub(super) fn of_level(archive: &StepView, level: usize) -> Result<Vec<ChunkWork>> {
    let pyramid = &archive.pyramid()?.pyramid;
    let (nodes, range) = (pyramid.nodes(level).map(|n| n as u64), archive.value_range());
    let Some([min, max]) = range else { return Ok(vec![]) };
    let counts = nodes.map(|n| (n - 1).div_ceil(PART));
    let part = |i: u64| {
        let at = [i % counts[0], i / counts[0] % counts[1], i / counts[0] / counts[1]];
        let cells: Cells = std::array::from_fn(|a| [at[a] * PART, ((at[a] + 1) * PART).min(nodes[a] - 1)]);
        let tets = cells.iter().map(|[lo, hi]| hi - lo).product::<u64>() as u32;
        let entry = Entry { min, max, chunk: 0, block: 0, tets };
        ChunkWork { chunk: ChunkId(0), blocks: vec![entry], cells: Some(cells) }
    };
    Ok((0..counts.iter().product()).map(part).collect())
}

/// The box of nodes of some cells; past the last ones it ends.
pub(super) fn nodes_of(cells: &Cells) -> LatticeBox {
    LatticeBox { lo: cells.map(|[lo, _]| lo as u32), hi: cells.map(|[_, hi]| hi as u32 + 1) }
}

/// The place of the node that a vertex's edge has as an end.
pub(super) fn node_place(dims: [u64; 3], id: PointId) -> [u32; 3] {
    let n = id.index();
    [n % dims[0], n / dims[0] % dims[1], n / dims[0] / dims[1]].map(|n| n as u32)
}

/// Bytes in which a part is extracted, for a number of isovalues: its nodes at some levels, and a
/// surface that crosses its bricks some times.
pub(super) fn part_bytes(cells: &Cells, bricks: u64, isovalues: u64) -> u64 {
    let nodes: u64 = cells.iter().map(|[lo, hi]| hi - lo + 14).product();
    14 * nodes + isovalues * bricks * 32 * 32 * 4 * 60 + (1 << 20)
}

impl Question<'_> {
    /// The surfaces of a part.
    pub(super) fn cube_surfaces(&self, cells: &Cells, spare: &BufferPool) -> Result<ChunkSurfaces> {
        let mut surfaces: ChunkSurfaces = self.isovalues.iter().map(|_| spare.surface()).collect();
        let mut bench = CubeBench::default();
        march(self.archive, self.level, cells, |block| {
            for (surface, &isovalue) in surfaces.iter_mut().zip(self.isovalues) {
                surface.start(isovalue, 0);
                surface.add_cubes(block, self.caps.is_some(), &self.world, &mut bench);
                surface.finish(&self.world);
            }
        })?;
        Ok(surfaces)
    }
}

/// Calls with the nodes of some cells.
pub(super) fn march(
    archive: &StepView,
    level: usize,
    cells: &Cells,
    mut each: impl FnMut(&GridBlock<'_>),
) -> Result<()> {
    let pyramid = &archive.pyramid()?.pyramid;
    let [grid, stride] = [pyramid.nodes(level), pyramid.stride(level)].map(|n| n.map(|n| n as u64));
    let wanted = IndexBox {
        lo: cells.map(|[lo, _]| lo.saturating_sub(1)),
        hi: std::array::from_fn(|a| (cells[a][1] + 2).min(grid[a])),
    };
    let part = part_of(pyramid, level);
    let key = std::array::from_fn(|a| cells[a][0] / part[a]);
    let window = archive.cached_nodes(level, key, &wanted)?;
    each(&GridBlock {
        grid,
        stride,
        start: window.place.lo,
        size: window.place.dims().map(|n| n as usize),
        values: &window.values,
        cells: *cells,
    });
    if let Some(window) = Arc::into_inner(window) {
        archive.spare.give_nodes(window.values);
    }
    Ok(())
}

/// How many cells of parts a surface crosses.
pub(super) fn crossed_cells(
    archive: &StepView,
    level: usize,
    work: &ChunkWork,
    isovalue: f32,
) -> Result<u64> {
    let (mut surface, mut bench, world) =
        (ChunkSurface::default(), CubeBench::default(), crate::pipeline::read::world_map(archive));
    let Some(cells) = &work.cells else { return Ok(0) };
    march(archive, level, cells, |block| {
        surface.start(isovalue, 0);
        surface.add_cubes(block, false, &world, &mut bench);
    })?;
    Ok(surface.active_cells())
}
