//! The mesh of a chunk: made from points, or read from an archive.

use crate::archive::values::ValueBlocks;
use isospan_io::geom::{LatticePos, PointId};
use isospan_mesh::mesh::list::TetList;
use isospan_mesh::mesh::tet::Tet;

/// The mesh of a chunk: its own points (core), the points of its neighbours that its tetrahedra
/// need (halo), and the tetrahedra it owns.
pub(in crate::pipeline) struct MeshedChunk {
    /// Points in each brick of the chunk, in brick order.
    pub(in crate::pipeline) core_counts: Vec<u32>,
    /// Ids of the halo points, ordered as they are stored; vertex numbers continue those of the
    /// core.
    pub(in crate::pipeline) halo: Vec<PointId>,
    /// Positions of core points, of halo points, then of those that only tetrahedra around have.
    pub(in crate::pipeline) all_positions: Vec<LatticePos>,
    /// How many are of the last kind: the others are the chunk's vertices.
    pub(in crate::pipeline) around: usize,
    /// Whether another chunk may have tetrahedra at the vertex.
    pub(in crate::pipeline) shared: Vec<bool>,
    /// Tetrahedra, as numbers into `all_positions`. With [`Halo::Stars`] the rest of the tetrahedra
    /// at all vertices are around them.
    pub(in crate::pipeline) tets: TetList,
    /// How often the halo had to be widened.
    pub(in crate::pipeline) retries: u32,
}

impl MeshedChunk {
    /// How the values of its vertices are cut into blocks.
    pub(in crate::pipeline) fn value_blocks(&self) -> ValueBlocks {
        ValueBlocks::new(self.vertices())
    }

    pub(in crate::pipeline) fn core_len(&self) -> usize {
        self.vertices() - self.halo.len()
    }

    /// How many vertices the chunk has.
    pub(in crate::pipeline) fn vertices(&self) -> usize {
        self.all_positions.len() - self.around
    }

    /// The positions of the chunk's vertices.
    pub(in crate::pipeline) fn positions(&self) -> &[LatticePos] {
        &self.all_positions[..self.vertices()]
    }

    /// The positions of the others that tetrahedra around have.
    pub(in crate::pipeline) fn positions_around(&self) -> &[LatticePos] {
        &self.all_positions[self.vertices()..]
    }

    /// Puts other tetrahedra, whose further positions follow those of the vertices, around its own.
    pub(in crate::pipeline) fn put_around(&mut self, around: &[Tet], positions: Vec<LatticePos>) {
        self.all_positions.truncate(self.vertices());
        self.around = positions.len();
        self.all_positions.extend(positions);
        self.tets.put_around(around);
    }

    /// Takes over what is around the same chunk, meshed again to as many tetrahedra, and the memory
    /// of those.
    pub(in crate::pipeline) fn surround(&mut self, mut again: Self) {
        again.tets.copy_from_slice(&self.tets);
        self.all_positions.truncate(self.vertices());
        self.all_positions.extend_from_slice(again.positions_around());
        (self.tets, self.around) = (again.tets, again.around);
    }

    /// Removes the halo points that no tetrahedron of the chunk uses; those that tetrahedra around
    /// use become vertices around. Returns the number that each vertex had, those around last.
    pub(in crate::pipeline) fn drop_unused_halo(&mut self) -> Vec<u32> {
        let (core, vertices) = (self.core_len(), self.vertices());
        let mut kept = used_corners(&self.tets, vertices);
        kept[..core].fill(true);
        let mut wanted = vec![false; vertices];
        self.tets.around().iter().flatten().for_each(|&v| {
            if let Some(wanted) = wanted.get_mut(v as usize) {
                *wanted = !kept[v as usize];
            }
        });
        let numbered =
            |flags: &[bool]| (0..vertices as u32).filter(|&v| flags[v as usize]).collect::<Vec<_>>();
        let (stay, moved) = (numbered(&kept), numbered(&wanted));
        let around = vertices as u32..self.all_positions.len() as u32;
        self.around = around.len() + moved.len();
        let mut numbers = vec![u32::MAX; around.end as usize];
        let before: Vec<u32> = stay.into_iter().chain(around).chain(moved).collect();
        (0..).zip(&before).for_each(|(number, &v)| numbers[v as usize] = number);
        self.tets.whole_mut().iter_mut().flatten().for_each(|v| *v = numbers[*v as usize]);
        fn keep<T>(all: &mut Vec<T>, kept: &[bool]) {
            let mut kept = kept.iter();
            all.retain(|_| *kept.next().expect("a flag for each"));
        }
        keep(&mut self.halo, &kept[core..]);
        keep(&mut self.shared, &kept);
        self.all_positions = before.iter().map(|&v| self.all_positions[v as usize]).collect();
        before
    }
}

/// For each corner, whether some tetrahedron uses it.
pub(in crate::pipeline) fn used_corners(tets: &[Tet], local: usize) -> Vec<bool> {
    let mut used = vec![false; local];
    for &v in tets.iter().flatten() {
        used[v as usize] = true;
    }
    used
}
