//! A mesh that is stored unchanged: chunks of its own tetrahedra, values at its own vertices.
//!
//! A chunk lists the tetrahedra with a corner in its bricks, and keeps those whose least corner
//! lies in its core. So each belongs to one chunk, and a core point of another chunk's tetrahedron
//! is known to be shared. No halo is enumerated, since a tetrahedron may reach any distance. The
//! distance is recorded as the number of times that a halo would have to be widened, as for a
//! meshed chunk ([`estimate::region`]).

use super::placement::Placement;
use super::recipe::{OwnMesh, Recipe};
use crate::archive::mesh::order_halo;
use crate::domain::column::Column;
use crate::pipeline::plan::estimate;
use crate::pipeline::read::MeshedChunk;
use isospan_io::error::{Error, Result};
use isospan_io::geom::{LatticePos, PointClass, PointId, Site};
use isospan_io::grid::Chunk;
use std::collections::HashMap;

/// Tetrahedra for a point of a meshed chunk: this many tetrahedra need as much memory as a further
/// point.
const TETS_A_POINT: u64 = 6;

impl OwnMesh<'_> {
    /// The number of points that needs as much memory as a chunk of `points` points with its
    /// tetrahedra.
    pub(super) fn points_of(&self, recipe: &Recipe<'_>, chunk: &Chunk, points: u64) -> Result<u64> {
        Ok(points.max(self.cells.count(chunk.bricks(&recipe.bricks))? / TETS_A_POINT))
    }

    /// The tetrahedra of a chunk, whose core has these sites.
    pub(super) fn chunk(
        &self,
        recipe: &Recipe<'_>,
        chunk: &Chunk,
        core_counts: Vec<u32>,
        core: &[Site],
    ) -> Result<MeshedChunk> {
        let place_of = |site: &Site| site.id.index() as u32;
        let mut local: HashMap<u32, u32> = core.iter().map(place_of).zip(0..).collect();
        let (mut tets, mut halo) = (vec![], vec![]);
        let mut shared = vec![false; core.len()];
        for tet in self.cells.of_bricks(self.store, chunk.bricks(&recipe.bricks))? {
            let least = tet.into_iter().min_by_key(|&p| (self.cells.position(p), p)).expect("four corners");
            if local.contains_key(&least) {
                halo.extend(tet.iter().filter(|p| !local.contains_key(p)));
                tets.push(tet);
            } else {
                tet.iter().filter_map(|p| local.get(p)).for_each(|&v| shared[v as usize] = true);
            }
        }
        halo.sort_unstable();
        halo.dedup();
        let id = |&place: &u32| PointId::new(PointClass::Explicit, u64::from(place));
        order_halo(core.len(), &mut halo, |&p| self.cells.position(p), id);
        local.extend(halo.iter().copied().zip(core.len() as u32..));
        let tets: Vec<_> = tets.iter().map(|tet| tet.map(|place| local[&place])).collect();
        let outer = halo.iter().map(|&place| self.cells.position(place));
        let all_positions: Vec<LatticePos> = core.iter().map(|s| s.pos).chain(outer).collect();
        shared.resize(all_positions.len(), true);
        Ok(MeshedChunk {
            core_counts,
            retries: retries_for(recipe, chunk, &all_positions[core.len()..]),
            halo: halo.iter().map(id).collect(),
            all_positions,
            around: 0,
            shared,
            tets: tets.into(),
        })
    }
}

/// How often the halo of a chunk is widened until it has these positions.
fn retries_for(recipe: &Recipe<'_>, chunk: &Chunk, positions: &[LatticePos]) -> u32 {
    let domain = recipe.bricks.lattice.domain();
    let region = |retries| estimate::region(recipe.points, &chunk.core, &domain, recipe.halo, retries);
    let has_all = |retries: &u32| {
        let region = region(*retries);
        positions.iter().all(|&p| region.contains(p))
    };
    // Twice as wide each time: it ends with the whole domain.
    (0..).find(has_all).expect("the domain has all positions")
}

/// The field of a mesh at its own vertices.
pub(in crate::pipeline) struct OwnField<'a> {
    pub(in crate::pipeline) mesh: OwnMesh<'a>,
    /// The values of the step at the vertices.
    pub(in crate::pipeline) values: Column<f32>,
}

impl OwnField<'_> {
    /// The values at the vertices of a chunk.
    pub(super) fn at_vertices(&self, placement: &Placement) -> Result<Vec<f32>> {
        let values = self.values.get()?;
        Ok(placement.vertices.iter().map(|&v| values[v as usize]).collect())
    }

    /// Finds which vertices of the mesh the vertices of a chunk are.
    pub(super) fn place(&self, mesh: &MeshedChunk) -> Result<Placement> {
        let core = places_of(self.mesh, &mesh.positions()[..mesh.core_len()])?;
        let places = core.into_iter().chain(mesh.halo.iter().map(|id| id.index()));
        Ok(Placement { vertices: self.mesh.cells.numbers_at(places)?, ..Placement::default() })
    }
}

/// The places in the list of a chunk's core points. Those that share a position follow each other,
/// by ascending places, and are all there.
fn places_of(mesh: OwnMesh<'_>, core: &[LatticePos]) -> Result<Vec<u64>> {
    let listed = &mesh.cells.vertices.points;
    let mut places = Vec::with_capacity(core.len());
    for run in core.chunk_by(|a, b| a == b) {
        let Some(first) = listed.find(run[0]) else {
            let got = format!("one at {:?} that is none", run[0]);
            return Err(Error::bad_input("mesh/points.seg", "vertices", "those of the mesh", got));
        };
        places.extend((first as u64..).take(run.len()));
    }
    Ok(places)
}
