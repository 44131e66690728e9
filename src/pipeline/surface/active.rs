//! Which blocks can hold an answer: those that the index names, and that touch the cut.

use super::cubes::{by_part, of_level};
use super::question::{Cells, ChunkWork, by_chunk};
use super::settings::SurfaceSettings;
use crate::index::Entry;
use crate::pipeline::plan::estimate;
use crate::pipeline::read::{
    Cut, Ranges, RoiSpace, StepView, WorldBox, cells_in, chunk_place, pyramid_of, world_box, world_map,
};
use crate::surface::edit::clip::HalfSpace;
use isospan_io::error::Result;
use isospan_io::geom::LatticeBox;
use isospan_io::grid::ChunkId;

/// The cut of surfaces as they are extracted; or half-spaces of the world, for a curvilinear grid.
pub(super) fn cut_of(
    archive: &StepView,
    settings: &SurfaceSettings,
) -> Result<(Option<Cut>, Option<Vec<HalfSpace>>)> {
    let Some(mut roi) = settings.roi else { return Ok((None, None)) };
    if roi.space == RoiSpace::World {
        match world_box(archive, &roi, &settings.resources.cancel)? {
            Some(WorldBox::HalfSpaces(half_spaces)) => return Ok((None, Some(half_spaces))),
            Some(WorldBox::Index(same)) => roi = same,
            None => {}
        }
    }
    let source = &archive.step().plan.source;
    let log2_steps = archive.manifest.plan.lattice.log2_steps;
    let cut = roi.cut(&source.geometry, source.dims, log2_steps, world_map(archive).origin())?;
    Ok((Some(cut), None))
}

/// The blocks that are read, and what was read of the index for them.
#[derive(Default)]
pub(super) struct ActiveWork {
    pub(super) work: Vec<ChunkWork>,
    pub(super) index_bytes: u64,
}

/// The blocks that are read: those that are active, or all of a level without bricks.
pub(super) fn work_of(
    archive: &StepView,
    settings: &SurfaceSettings,
    level: usize,
    cut: Option<&Cut>,
) -> Result<ActiveWork> {
    let (isovalues, mut index_bytes) = (settings.kept(archive), 0);
    let pyramid = pyramid_of(archive.manifest.plan.points);
    let work = if pyramid.is_some_and(|pyramid| level > pyramid.details()) {
        of_level(archive, level)?
    } else {
        let index = archive.ranges()?;
        let refs = match settings.cap {
            true => with_inside(archive, level, &index, &isovalues)?,
            false => index.query_any(&isovalues)?,
        };
        index_bytes = index.bytes_read();
        by_part(archive, level, by_chunk(archive, &refs)?)?
    };
    let work = match cut {
        Some(cut) => touching(archive, cut, level, work)?,
        None => work,
    };
    Ok(ActiveWork { work, index_bytes })
}

/// The blocks that are active, and those inside of chunks at the ends of the domain.
fn with_inside(
    archive: &StepView,
    level: usize,
    index: &Ranges<'_>,
    isovalues: &[f32],
) -> Result<Vec<Entry>> {
    let ends = chunks_at_ends(archive, level)?;
    let lowest = isovalues.iter().copied().fold(f32::INFINITY, f32::min);
    let mut refs = index.query_any(isovalues)?;
    // A chunk that is not there is named later.
    refs.extend(index.query_inside(lowest, |id| ends.get(id as usize).copied().unwrap_or(true))?);
    refs.sort_unstable_by_key(Entry::place);
    refs.dedup_by_key(|e| e.place());
    Ok(refs)
}

/// Whether a tetrahedron or a cell of a chunk may reach the ends of the domain, for each chunk.
fn chunks_at_ends(archive: &StepView, level: usize) -> Result<Vec<bool>> {
    let domain = archive.chunks.bricks().lattice.domain();
    let halo = estimate::Halo::of(&archive.manifest.plan);
    if let Some(pyramid) = pyramid_of(archive.manifest.plan.points) {
        let reaches_ends = |id: u64| {
            let place = pyramid.chunk(chunk_place(&pyramid, ChunkId(id)));
            let (cells, nodes) = (cells_in(&pyramid, &place, level), pyramid.nodes(level));
            (0..3).any(|a| cells[a].start == 0 || cells[a].end == nodes[a] - 1)
        };
        return Ok((0..archive.chunks.len()).map(reaches_ends).collect());
    }
    let reaches_ends = |id: ChunkId| {
        let core = archive.chunks.chunk(id).core;
        let reaches = |retries| {
            let region = estimate::region(&archive.points, &core, &domain, halo, retries);
            (0..3).any(|a| region.lo[a] == domain.lo[a] || region.hi[a] == domain.hi[a])
        };
        archive.close_before(id);
        // All corners of a chunk's tetrahedra are in its region, which is wider where the halo was
        // widened.
        Ok(reaches(0) || reaches(archive.mesh_sizes(id)?.retries))
    };
    (0..archive.chunks.len()).map(|id| reaches_ends(ChunkId(id))).collect()
}

/// The chunks with a tetrahedron that may touch the cut.
fn touching(archive: &StepView, cut: &Cut, level: usize, work: Vec<ChunkWork>) -> Result<Vec<ChunkWork>> {
    let domain = archive.chunks.bricks().lattice.domain();
    let halo = estimate::Halo::of(&archive.manifest.plan);
    let touches = |id: ChunkId| {
        let core = archive.chunks.chunk(id).core;
        let reaches =
            |retries| cut.may_touch_box(&estimate::region(&archive.points, &core, &domain, halo, retries));
        // All corners of a chunk's tetrahedra are in its region, which is wider where the halo was
        // widened.
        Ok(reaches(0) || reaches(archive.mesh_sizes(id)?.retries))
    };
    let steps = archive.manifest.plan.lattice.log2_steps;
    let stride = pyramid_of(archive.manifest.plan.points).map_or([1; 3], |pyramid| pyramid.stride(level));
    let part_touches = |cells: &Cells| {
        let at = |node: u64, a: usize| ((node as u32) * stride[a] as u32) << steps[a];
        let lo = std::array::from_fn(|a| at(cells[a][0], a));
        let hi = std::array::from_fn(|a| at(cells[a][1], a) + 1);
        Ok(cut.may_touch_box(&LatticeBox { lo, hi }))
    };
    let keep = |w: ChunkWork| match w.cells.as_ref().map_or_else(|| touches(w.chunk), part_touches) {
        Ok(touches) => touches.then_some(Ok(w)),
        Err(e) => Some(Err(e)),
    };
    work.into_iter().filter_map(keep).collect()
}
