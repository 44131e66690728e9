//! Levels for a mesh: where its field bends, where its vertices are, and where it ends.
//!
//! The errors of simple reductions ([`crate::density`]) are those of the mesh's field at the
//! samples of its lattice, which lie about as far apart as vertices do. Two things differ from a
//! volume:
//!
//! * **Weights.** The error of a mesh is measured at its vertices, and its author has placed them
//!   where something happens. So half of a cell's weight is its share of the vertices. The other
//!   half is its share of the volume, because surfaces pass between vertices too.
//! * **Boundary.** Cells with samples inside and outside have at least the mean density. Cells
//!   outside have no weight: they have no more points than grading gives them. The number of points
//!   is that of points inside.
//!
//! In a series, the values of the first step decide.

use crate::density::{BlockErrors, Choice, ErrorCurves};
use crate::domain::settings::StoreSettings;
use crate::domain::store::CellStore;
use crate::domain::voxels::Voxels;
use crate::pipeline::plan::estimate;
use crate::pipeline::settings::{Adapt, RunSettings, Target};
use isospan_io::error::{Error, Result};
use isospan_io::exec::pool;
use isospan_io::grid::{BrickGrid, BrickId};
use isospan_mesh::locate::rounded;
use rayon::prelude::*;

/// Blocks that are measured before their errors are added, in order, for each thread.
const BLOCKS_A_THREAD: u64 = 4;
/// Bytes of a block's samples and of its errors.
const BLOCK_BYTES: u64 = 33 * 33 * 33 * Voxels::SAMPLE_BYTES + 17 * 17 * 17 * 48;

/// What was chosen for a mesh.
pub(in crate::pipeline) struct MeshChoice {
    pub(in crate::pipeline) choice: Choice,
    /// Points inside.
    pub(in crate::pipeline) count: u64,
}

/// The errors of simple reductions of a mesh, from which levels are chosen.
pub(in crate::pipeline) struct MeshCurves {
    curves: ErrorCurves,
    /// The range of the values at vertices.
    range: [f32; 2],
    vertices: u64,
    threads: usize,
}

impl MeshCurves {
    /// Measures them.
    ///
    /// # Errors
    /// [`Error::Budget`] when the memory does not hold the curves; when the scratch folder cannot
    /// be written.
    pub(in crate::pipeline) fn new(
        store: &CellStore,
        how: &StoreSettings,
        adapt: &Adapt,
        run: &RunSettings,
    ) -> Result<Self> {
        let lattice = store.frame.lattice;
        let fixed = estimate::BASE + ErrorCurves::bytes_for_mesh(lattice);
        let needed = fixed + BLOCK_BYTES;
        if run.resources.memory < needed {
            let purpose = "to find where points are needed";
            return Err(Error::memory(purpose, needed, run.resources.memory));
        }
        let threads = run.resources.worker_threads();
        let at_once = ((run.resources.memory - fixed) / BLOCK_BYTES).min(BLOCKS_A_THREAD * threads as u64);
        let mut curves = ErrorCurves::of_mesh(lattice);
        let range = measure(store, how, adapt, at_once, run, &mut curves)?;
        let at_cells = vertices_by_cell(store, curves.cells())?;
        curves.weigh(&at_cells, store.census.vertices);
        Ok(Self { curves, range, vertices: store.census.vertices, threads })
    }

    /// Levels for `count` points inside the mesh, or for as many as a target asks for.
    ///
    /// # Errors
    /// When threads cannot be started.
    pub(in crate::pipeline) fn choose(&self, target: Option<Target>, count: u64) -> Result<MeshChoice> {
        let curves = &self.curves;
        let bound = target.and_then(Target::bound).map(|b| b.in_units(self.range.map(f64::from)));
        pool(self.threads)?.install(|| {
            if let (Some(Target::Max(_)), Some(bound)) = (target, bound) {
                let choice = Choice::of_bound(curves, bound, self.vertices)?;
                return Ok(MeshChoice { count: choice.points_in(curves), choice });
            }
            let count = bound.map_or(count, |bound| Choice::count_of_rms(curves, bound));
            Ok(MeshChoice { choice: Choice::of_count(curves, count)?, count })
        })
    }
}

/// Adds the errors of all blocks; returns the range of the values at vertices.
fn measure(
    store: &CellStore,
    how: &StoreSettings,
    adapt: &Adapt,
    at_once: u64,
    run: &RunSettings,
    curves: &mut ErrorCurves,
) -> Result<[f32; 2]> {
    let blocks = BlockErrors::blocks(curves.cells());
    let voxels = Voxels::new(store, blocks, how)?;
    let pool = pool(run.resources.worker_threads())?;
    for first in (0..blocks.len()).step_by(at_once as usize) {
        run.resources.cancel.check()?;
        let some = first..(first + at_once).min(blocks.len());
        let cells = curves.cells();
        let of = |block| {
            let samples = BlockErrors::samples_of(&blocks, BrickId(block));
            let mut values = voxels.read(BrickId(block), &samples)?;
            if let Some([lo, hi]) = adapt.focus.map(|f| f.map(|v| (v - how.offset) as f32)) {
                values.iter_mut().for_each(|v| *v = v.clamp(lo, hi));
            }
            Ok(BlockErrors::measure(cells, &samples, &values))
        };
        let found: Result<Vec<_>> = pool.install(|| some.into_par_iter().map(of).collect());
        found?.iter().for_each(|errors| curves.add(errors));
    }
    let values = store.values.get()?.iter().filter(|v| !v.is_nan());
    let range = values.fold(None, |range: Option<[f32; 2]>, &v| {
        Some(range.map_or([v, v], |[lo, hi]| [lo.min(v), hi.max(v)]))
    });
    Ok(range.unwrap_or_default().map(|v| v + 0.0))
}

/// The number of vertices in each cell.
fn vertices_by_cell(store: &CellStore, cells: &BrickGrid) -> Result<Vec<u32>> {
    let mut counts = vec![0u32; cells.len() as usize];
    for &p in &store.positions.get()?[..store.census.vertices as usize] {
        let count = &mut counts[cells.id(cells.brick_at(rounded(p))).0 as usize];
        *count = count.saturating_add(1);
    }
    Ok(counts)
}
