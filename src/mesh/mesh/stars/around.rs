//! The tetrahedra around those that a chunk owns.
//!
//! The owned tetrahedra are known: they were just made, or they come from an archive. The others at
//! their points lie beyond the faces that bound them. So the stars of the points of such faces are
//! closed, one after another.

use super::machine::Vectors;
use super::{Chunk, END, Stars, Waiting};
use crate::mesh::delaunay::{self, Kernel};
use crate::mesh::owned::sort_around;
use crate::mesh::region::{Border, ChunkRegion};
use crate::mesh::tet::Tet;
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::geom::curve::Order;

impl Stars {
    /// The tetrahedra around those that a chunk owns, in canonical order; `None` if insertion has
    /// to find them.
    ///
    /// # Errors
    /// As [`Kernel::delaunay`].
    pub(in crate::mesh) fn around(
        &mut self,
        kernel: &mut Kernel,
        boxes: &ChunkRegion,
        positions: &[LatticePos],
        order: &Order,
        border: Border<'_>,
    ) -> Result<Option<Vec<Tet>>> {
        self.around_with(Vectors::found(), kernel, boxes, positions, order, border)
    }

    /// As [`Stars::around`], with these vectors.
    pub(super) fn around_with(
        &mut self,
        vectors: Vectors,
        kernel: &mut Kernel,
        boxes: &ChunkRegion,
        positions: &[LatticePos],
        order: &Order,
        border: Border<'_>,
    ) -> Result<Option<Vec<Tet>>> {
        let Some(mut chunk) = self.begin(vectors, boxes, positions, order) else { return Ok(None) };
        chunk.used = border.points.to_vec();
        chunk.turned = 0;
        chunk.knows_owned = true;
        self.first.fill(END);
        for tet in border.tets {
            for place in 0..4 {
                let [a, b, c] = delaunay::face(place).map(|i| tet[i]);
                // A face of two owned ones waits twice for the same point, and goes when that has
                // its turn.
                if [a, b, c].iter().all(|&v| border.points[v as usize]) {
                    chunk.wait_for(self, [a, c, b]);
                }
            }
        }
        let mut around = vec![];
        if !chunk.close_used(self, kernel, 0, &mut around)? {
            return Ok(None);
        }
        sort_around(&mut around);
        Ok(Some(around))
    }
}

impl Chunk<'_> {
    /// Appends the tetrahedra around those owned; `foreign` are those at points of the core that
    /// are not owned.
    pub(super) fn add_around(
        &mut self,
        room: &mut Stars,
        kernel: &mut Kernel,
        foreign: Vec<Tet>,
    ) -> Result<bool> {
        let mut used = vec![false; self.positions.len()];
        room.tets.iter().flatten().for_each(|&v| used[v as usize] = true);
        let own = room.tets.len();
        let is_around = |t: &Tet| t.iter().any(|&v| used[v as usize]);
        room.tets.extend(foreign.into_iter().filter(is_around));
        // Faces that no point of the core has wait for the first that is used.
        let Stars { first, waiting, .. } = &mut *room;
        let mut loose = vec![];
        for (v, first) in (0u32..).zip(&mut *first).skip(self.core) {
            let mut at = *first;
            while at < END {
                let Waiting { others: [c, d], next } = waiting[at as usize];
                loose.push([v, d, c]);
                at = next;
            }
            *first = (*first).max(END);
        }
        waiting.clear();
        room.free.clear();
        self.used = used;
        loose.into_iter().for_each(|face| self.wait_for(room, face));
        let mut tets = std::mem::take(&mut room.tets);
        let done = self.close_used(room, kernel, self.core, &mut tets)?;
        room.tets = tets;
        sort_around(&mut room.tets[own..]);
        Ok(done)
    }

    /// Closes the stars of used points from the `first` on, and appends what is new; false where
    /// one cannot be.
    fn close_used(
        &mut self,
        room: &mut Stars,
        kernel: &mut Kernel,
        first: usize,
        tets: &mut Vec<Tet>,
    ) -> Result<bool> {
        for p in first as u32..self.positions.len() as u32 {
            if self.used[p as usize] {
                if !self.close(room, kernel, p)? {
                    return Ok(false);
                }
                tets.extend_from_slice(&room.star);
                self.wait(room, true);
            }
        }
        Ok(true)
    }
}
