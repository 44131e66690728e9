//! The errors of an archive that has a mesh's own vertices: each vertex is compared with its point
//! of the archive.
//!
//! Vertices need not be located: their points follow from the mesh, as they did when the archive
//! was made. So the error is the rounding of values, and nothing else. Vertices without a
//! tetrahedron have no point, and are counted as missing.
//!
//! Cost: reading the values of all steps once. Memory: the list of points, twice, and a value for
//! each point and step.

use super::error_map::Map;
use super::vertex_errors::{StepErrors, on_lattice, other_mesh, reported_errors};
use crate::domain::column::Column;
use crate::domain::own::{OwnVertices, POINT_BYTES, UNUSED};
use crate::domain::settings::StoreSettings;
use crate::domain::store::CellStore;
use crate::measure::{BrickErrors, ErrorSums};
use crate::pipeline::plan::estimate;
use crate::pipeline::read::{ChunkReader, ReaderMemory, StepView};
use isospan_io::error::{Error, Result};
use isospan_io::exec::Progress;
use isospan_io::grid::ChunkId;
use std::collections::BTreeMap;

/// Vertices whose errors in bricks are handed on together.
const BATCH: usize = 1 << 16;

/// The errors of steps, by their positions in the manifest, whose values at the vertices are given;
/// a map is of one step. `memory` is for all.
pub(super) fn own_errors(
    archive: &StepView,
    store: &CellStore,
    steps: &[(usize, &Column<f32>)],
    mut map: Option<Map>,
    how: &StoreSettings,
    memory: u64,
    progress: &dyn Progress,
) -> Result<Vec<StepErrors>> {
    let columns = steps.iter().map(|(_, values)| values.get()).collect::<Result<Vec<_>>>()?;
    let steps: Vec<usize> = steps.iter().map(|step| step.0).collect();
    let listed = archive.points.explicit().expect("own vertices are listed").len();
    let vertices = (store.census.vertices + store.census.added).max(listed);
    let needed = estimate::BASE + vertices * (POINT_BYTES + 4 * steps.len() as u64);
    if needed > memory {
        return Err(Error::memory("", needed, memory));
    }
    let how = StoreSettings { memory: memory - estimate::BASE, ..how.clone() };
    let vertices = OwnVertices::new(store, &how, archive.path())?;
    if archive.points.explicit() != Some(&*vertices.points) {
        return Err(other_mesh(archive));
    }
    let reduced = values_by_place(archive, &steps, listed as usize, progress)?;
    let (positions, places) = (store.positions.get()?, vertices.places.get()?);
    let bricks = archive.chunks.bricks();
    let mut sums = vec![ErrorSums::default(); steps.len()];
    // Those that polyhedra add are not the file's.
    let own = store.census.vertices as usize;
    for first in (0..own).step_by(BATCH) {
        how.cancel.check()?;
        let mut errors = BTreeMap::<u64, BrickErrors>::new();
        for number in first..own.min(first + BATCH) {
            let mut of = [number as u64];
            store.firsts.replace(&mut of)?;
            let place = places[of[0] as usize];
            for ((sums, values), reduced) in sums.iter_mut().zip(&columns).zip(&reduced) {
                let found = if place == UNUSED { f32::NAN } else { reduced[place as usize] };
                sums.add(values[number], found, || number as u64);
                if map.is_some() {
                    let brick = bricks.id(bricks.brick_at(on_lattice(positions[number])));
                    errors.entry(brick.0).or_default().add(values[number], found);
                }
            }
        }
        if let Some(map) = &mut map {
            map.add(first as u64, &errors)?;
        }
    }
    map.map_or(Ok(0), Map::finish)?;
    let found: Vec<_> = sums.into_iter().map(|sums| (sums, vec![])).collect();
    reported_errors(archive, store, &steps, &columns, &found, &vec![0; steps.len()])
}

/// The values of steps at all points, in the order of the list.
fn values_by_place(
    archive: &StepView,
    steps: &[usize],
    listed: usize,
    progress: &dyn Progress,
) -> Result<Vec<Vec<f32>>> {
    let mut out = vec![vec![f32::NAN; listed]; steps.len()];
    progress.begin("measure", archive.chunks.len(), "chunks");
    let (mut sites, mut memory) = (vec![], ReaderMemory::default());
    for id in (0..archive.chunks.len()).map(ChunkId) {
        archive.close_before(id);
        let reader = ChunkReader::open(archive, id, memory)?;
        let (core, vertices) = (reader.core(), reader.vertices());
        memory = reader.into_memory();
        let values = archive.chunk_values_of(steps, id, vertices)?;
        let mut at = 0;
        for brick in archive.chunks.chunk(id).bricks(archive.chunks.bricks()) {
            archive.points.sites_in(&archive.chunks.bricks().brick(brick), &mut sites);
            if at + sites.len() > core {
                break;
            }
            for site in &sites {
                let place = site.id.index() as usize;
                out.iter_mut().zip(&values).for_each(|(out, values)| out[place] = values[at]);
                at += 1;
            }
        }
        if at != core {
            let expected = format!("{core} in chunk {}", id.0);
            return Err(Error::bad_input(archive.path(), "points", expected, "another number"));
        }
        progress.advance(1);
    }
    Ok(out)
}
