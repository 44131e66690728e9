//! One chunk, from its number to its points and its owned tetrahedra.
//!
//! Everything here is a function of the plan and the chunk alone: no chunk sees another, so chunks
//! can be made in any order, on any machine, twice, and give the same result.

use super::recipe::{OwnMesh, Recipe};
use crate::archive::mesh::order_halo;
use crate::pipeline::plan::{Halo, check_brick, estimate};
use crate::pipeline::read::MeshedChunk;
use isospan_io::error::Result;
use isospan_io::exec::CancelToken;
use isospan_io::geom::{LatticeBox, LatticePos, PointId, Site};
use isospan_io::grid::Chunk;
use isospan_mesh::mesh::chunk::{
    Border, ChunkMesh, ChunkOutcome, ChunkRegion, Manner, mesh_around, mesh_widening,
};
use isospan_mesh::mesh::list::TetList;
use isospan_mesh::mesh::mesher::Mesher;
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::points::PointSet;
use std::collections::HashMap;

/// The result of meshing a chunk.
pub(in crate::pipeline) enum Meshing {
    Done(MeshedChunk),
    /// A halo that is wide enough needs more memory than there is limit for.
    NeedsRoom {
        bytes: u64,
    },
}

/// Makes meshes of chunks, with memory that it keeps from chunk to chunk.
#[derive(Default)]
pub(in crate::pipeline) struct ChunkMesher {
    mesher: Mesher,
    /// The sites of the core, brick after brick, then those of the halo.
    sites: Vec<Site>,
    one_box: Vec<Site>,
    late: Vec<Site>,
    positions: Vec<LatticePos>,
}

impl ChunkMesher {
    /// Enumerates the chunk's points and meshes them; the halo is widened until every owned
    /// tetrahedron is certified, as long as the region fits in `limit` bytes. The result does not
    /// depend on `limit`.
    pub(in crate::pipeline) fn mesh(
        &mut self,
        recipe: &Recipe<'_>,
        chunk: &Chunk,
        limit: u64,
        cancel: &CancelToken,
    ) -> Result<Meshing> {
        cancel.check()?;
        if let Some(own) = recipe.own {
            return self.keep_own(own, recipe, chunk, limit);
        }
        let domain = recipe.bricks.lattice.domain();
        let core_counts = self.list_core(recipe, chunk)?;
        let core = self.sites.len();
        let region = |retries| estimate::region(recipe.points, &chunk.core, &domain, recipe.halo, retries);
        let needs = |region: &LatticeBox| estimate::chunk_bytes(recipe.points.count_in(region), recipe.halo);
        let boxes = recipe.boxes(chunk);
        let bytes = needs(&boxes.region);
        if bytes > limit {
            return Ok(Meshing::NeedsRoom { bytes });
        }
        if core > 0 {
            self.list_halo(recipe, &boxes);
        }
        self.positions.clear();
        self.positions.extend(self.sites.iter().map(|s| s.pos));
        let (mut retries, mut bytes) = (0, bytes);
        let Self { mesher, sites, one_box, positions, .. } = self;
        // Twice as wide each time: a region that is the whole domain certifies everything, so this
        // ends.
        let mut widen = |positions: &mut Vec<LatticePos>| {
            cancel.check()?;
            let (narrow, wide) = (region(retries), region(retries + 1));
            retries += 1;
            bytes = needs(&wide);
            if bytes > limit {
                return Ok(None);
            }
            for b in wide.without(&narrow) {
                list_box(recipe.points, &b, one_box);
                sites.extend_from_slice(one_box);
            }
            let known = positions.len();
            positions.extend(sites[known..].iter().map(|s| s.pos));
            Ok(Some(wide))
        };
        let manner = Manner { around: recipe.halo == Halo::Stars, even: recipe.points.is_even() };
        match mesh_widening(mesher, &boxes, positions, &recipe.order, manner, &mut widen)? {
            ChunkOutcome::Done(mesh) => {
                let positions = std::mem::take(&mut self.positions);
                Ok(Meshing::Done(renumber(core_counts, &self.sites, positions, mesh, retries)))
            }
            ChunkOutcome::WidenHalo { .. } => Ok(Meshing::NeedsRoom { bytes }),
        }
    }

    /// As [`ChunkMesher::mesh`], of a mesh whose own tetrahedra are kept.
    fn keep_own(
        &mut self,
        own: OwnMesh<'_>,
        recipe: &Recipe<'_>,
        chunk: &Chunk,
        limit: u64,
    ) -> Result<Meshing> {
        let points = own.points_of(recipe, chunk, recipe.points.count_in(&chunk.core))?;
        let bytes = estimate::chunk_bytes(points, recipe.halo);
        if bytes > limit {
            return Ok(Meshing::NeedsRoom { bytes });
        }
        let core_counts = self.list_core(recipe, chunk)?;
        own.chunk(recipe, chunk, core_counts, &self.sites).map(Meshing::Done)
    }

    /// Finds what is around a chunk whose own tetrahedra are known; false where it has to be meshed
    /// again for that.
    pub(in crate::pipeline) fn surround(
        &mut self,
        recipe: &Recipe<'_>,
        chunk: &Chunk,
        mesh: &mut MeshedChunk,
        limit: u64,
        cancel: &CancelToken,
    ) -> Result<bool> {
        cancel.check()?;
        if !recipe.points.is_even() {
            return Ok(false);
        }
        let boxes = recipe.boxes(chunk);
        let fits = estimate::chunk_bytes(recipe.points.count_in(&boxes.region), recipe.halo) <= limit;
        if !fits || self.list_core(recipe, chunk)? != mesh.core_counts {
            return Ok(false);
        }
        let core = self.sites.len();
        self.list_halo(recipe, &boxes);
        self.positions.clear();
        self.positions.extend(self.sites.iter().map(|s| s.pos));
        // Vertices of the core have the numbers of their sites; where are those of the halo?
        let places: HashMap<PointId, u32> =
            (core as u32..).zip(&self.sites[core..]).map(|(i, s)| (s.id, i)).collect();
        let halo: Option<Vec<u32>> = mesh.halo.iter().map(|id| places.get(id).copied()).collect();
        let Some(halo) = halo else { return Ok(false) };
        let site = |v: u32| (v as usize).checked_sub(core).map_or(v, |i| halo[i]);
        let (mut tets, mut points) = (vec![], vec![false; self.sites.len()]);
        for tet in mesh.tets.iter() {
            let mut shared = 0;
            for &v in tet.iter().filter(|&&v| mesh.shared[v as usize]) {
                points[site(v) as usize] = true;
                shared += 1;
            }
            if shared >= 3 {
                tets.push(tet.map(site));
            }
        }
        let border = Border { tets: &tets, points: &points };
        let Some(mut around) = mesh_around(&mut self.mesher, &boxes, &self.positions, &recipe.order, border)?
        else {
            return Ok(false);
        };
        let mut numbers = vec![u32::MAX; self.sites.len() - core];
        (core as u32..).zip(&halo).for_each(|(number, &site)| numbers[site as usize - core] = number);
        let mut positions = vec![];
        number_others(&mut around, &mut numbers, core, mesh.vertices(), |site| {
            positions.push(self.sites[site].pos)
        });
        mesh.put_around(&around, positions);
        Ok(true)
    }

    /// Takes memory of a chunk that is finished, for the next.
    pub(in crate::pipeline) fn reuse(&mut self, positions: Vec<LatticePos>, tets: TetList) {
        self.positions = positions;
        self.mesher.reuse(tets);
    }

    /// Lists the sites of the core, and returns how many each brick has.
    fn list_core(&mut self, recipe: &Recipe<'_>, chunk: &Chunk) -> Result<Vec<u32>> {
        self.sites.clear();
        let mut counts = vec![];
        for brick in chunk.bricks(&recipe.bricks) {
            let brick_box = recipe.bricks.brick(brick);
            check_brick(recipe.points, &brick_box)?;
            recipe.points.sites_in(&brick_box, &mut self.one_box);
            let count = u32::try_from(self.one_box.len());
            counts.push(count.expect("a checked brick has far fewer than 2^32 points"));
            self.sites.extend_from_slice(&self.one_box);
        }
        Ok(counts)
    }

    /// Appends the sites of the region outside the chunk's core, those of its inner part first.
    fn list_halo(&mut self, recipe: &Recipe<'_>, boxes: &ChunkRegion) {
        let Self { sites, one_box, late, .. } = self;
        for b in boxes.region.without(&boxes.core) {
            list_box(recipe.points, &b, one_box);
            for site in &*one_box {
                if boxes.near.contains(site.pos) { sites.push(*site) } else { late.push(*site) }
            }
        }
        sites.append(late);
    }
}

/// Lists the sites of a box by their ids. If positions are equal, the mesh keeps the first, which
/// must be the one with the lowest id.
fn list_box(points: &PointSet, b: &LatticeBox, sites: &mut Vec<Site>) {
    points.candidates_in(b, sites);
    sites.sort_unstable_by_key(|s| s.id);
}

/// Keeps only the halo points that tetrahedra use, ordered as they are stored; `positions` are
/// those of all sites.
fn renumber(
    core_counts: Vec<u32>,
    sites: &[Site],
    mut positions: Vec<LatticePos>,
    mesh: ChunkMesh,
    retries: u32,
) -> MeshedChunk {
    let ChunkMesh { mut tets, mut shared } = mesh;
    let core: usize = core_counts.iter().map(|&n| n as usize).sum();
    let mut used = vec![false; sites.len() - core];
    let mut with_halo = vec![];
    let all: &mut [Tet] = &mut tets;
    for (i, t) in (0..).zip(&*all) {
        // The least comes first.
        if t[1].max(t[2]).max(t[3]) as usize >= core {
            with_halo.push(i);
            let outside = t.iter().filter_map(|&v| (v as usize).checked_sub(core));
            outside.for_each(|v| used[v] = true);
        }
    }
    let mut halo: Vec<u32> = (0..used.len()).filter(|&i| used[i]).map(|i| (core + i) as u32).collect();
    order_halo(core, &mut halo, |&v| sites[v as usize].pos, |&v| sites[v as usize].id);
    let mut number = vec![u32::MAX; used.len()];
    for (i, &v) in halo.iter().enumerate() {
        number[v as usize - core] = (core + i) as u32;
    }
    for i in with_halo {
        for v in all[i].iter_mut().filter(|v| **v as usize >= core) {
            *v = number[*v as usize - core];
        }
    }
    positions.truncate(core);
    positions.extend(halo.iter().map(|&v| sites[v as usize].pos));
    let vertices = positions.len();
    number_others(tets.around_mut(), &mut number, core, vertices, |site| positions.push(sites[site].pos));
    shared.truncate(core);
    shared.resize(vertices, true);
    let halo = halo.iter().map(|&v| sites[v as usize].id).collect();
    let around = positions.len() - vertices;
    MeshedChunk { core_counts, halo, all_positions: positions, around, shared, tets, retries }
}

/// Numbers the sites outside the core that tetrahedra around have: those that are vertices have
/// numbers, the others follow `vertices`, as they come.
fn number_others(
    around: &mut [Tet],
    numbers: &mut [u32],
    core: usize,
    vertices: usize,
    mut found: impl FnMut(usize),
) {
    let mut next = vertices as u32;
    for v in around.iter_mut().flatten().filter(|v| **v as usize >= core) {
        let number = &mut numbers[*v as usize - core];
        if *number == u32::MAX {
            *number = next;
            next += 1;
            found(*v as usize);
        }
        *v = *number;
    }
}
