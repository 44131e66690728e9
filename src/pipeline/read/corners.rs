//! The corners of a chunk while it is read: positions, ids, and which of them other chunks have.
//! Each is found when a block first needs it.
//!
//! Positions of core corners come brick by brick, which lists its points again by formula; those of
//! halo corners from their ids. Flags and ids of halo points come in pages.

use super::damaged::damaged;
use super::reader_memory::{CornersMemory, PLACED, SHARED};
use super::step_view::StepView;
use crate::archive::chunked::ChunkSegment;
use crate::archive::mesh::{ChunkHeader, PAGE_FLAGS, PAGE_IDS, decode_flags, decode_ids};
use crate::pipeline::plan::check_brick;
use isospan_io::error::Result;
use isospan_io::geom::{LatticeBox, LatticePos, PointId};
use isospan_io::grid::{BrickId, Chunk, ChunkId};
use std::sync::Arc;

/// The corners of a chunk: those of its core, brick after brick, then those of the halo. Arrays are
/// indexed by their numbers; ids of corners that were not placed, and flags of pages that were not
/// read, mean nothing.
pub(super) struct ChunkCorners<'a> {
    archive: &'a StepView,
    mesh: Arc<ChunkSegment>,
    id: ChunkId,
    bricks: Vec<BrickId>,
    /// First corner of each brick, and the number of core corners.
    starts: Vec<u32>,
    /// Pages of flags; those of ids follow.
    flag_pages: usize,
    /// For each page, whether it has been read.
    read: Vec<bool>,
    memory: CornersMemory,
}

/// Positions, ids, and whether another chunk has a corner.
pub(super) type CornerLists = (Vec<LatticePos>, Vec<PointId>, Vec<bool>);

impl<'a> ChunkCorners<'a> {
    /// No corner is placed yet.
    pub(super) fn new(
        archive: &'a StepView,
        mesh: Arc<ChunkSegment>,
        chunk: &Chunk,
        header: &ChunkHeader,
        mut memory: CornersMemory,
    ) -> Self {
        let mut starts = vec![0];
        starts.extend(header.core_counts.iter().scan(0, |sum, n| {
            *sum += n;
            Some(*sum)
        }));
        memory.start(header.len());
        Self {
            archive,
            mesh,
            id: chunk.id,
            bricks: chunk.bricks(archive.chunks.bricks()).collect(),
            starts,
            flag_pages: header.flag_pages(),
            read: vec![false; header.flag_pages() + header.id_pages()],
            memory,
        }
    }

    /// Corners that the chunk owns; the others are halo.
    pub(super) fn core(&self) -> usize {
        self.starts[self.starts.len() - 1] as usize
    }

    /// All corners.
    pub(super) fn len(&self) -> usize {
        self.memory.states.len()
    }

    /// Pages of flags and ids.
    pub(super) fn pages(&self) -> usize {
        self.read.len()
    }

    /// Replaces `out` by the positions of some corners; their ids are known then, too.
    pub(super) fn place(&mut self, corners: &[u32], out: &mut Vec<LatticePos>) -> Result<()> {
        for &v in corners {
            if !self.is_placed(v) {
                self.place_corner(v as usize)?;
            }
        }
        gather(&self.memory.positions, corners, out);
        Ok(())
    }

    #[inline]
    fn is_placed(&self, v: u32) -> bool {
        self.memory.states[v as usize] & PLACED != 0
    }

    /// Replaces `ids` and `shared` by those of some corners that were placed.
    pub(super) fn ids_and_flags(
        &mut self,
        corners: &[u32],
        ids: &mut Vec<PointId>,
        shared: &mut Vec<bool>,
    ) -> Result<()> {
        self.load_flags(corners)?;
        ids.clear();
        ids.extend(corners.iter().map(|&v| PointId(self.memory.ids[v as usize])));
        shared.clear();
        shared.extend(corners.iter().map(|&v| self.memory.states[v as usize] & SHARED != 0));
        Ok(())
    }

    /// Finds positions, ids and flags of all corners.
    pub(super) fn place_all(&mut self) -> Result<()> {
        (0..self.starts.len() - 1).try_for_each(|brick| self.place_brick(brick))?;
        (self.core()..self.len()).try_for_each(|v| self.place_corner(v))?;
        self.load_all_flags()
    }

    /// A box that holds some corners, without placing them: those of core corners are in their
    /// bricks.
    pub(super) fn hull(&mut self, corners: &[u32]) -> Result<LatticeBox> {
        let (core, bricks) = (self.core(), self.archive.chunks.bricks());
        let mut hull = LatticeBox::NOTHING;
        let mut brick_end = 0;
        for &v in corners {
            let here = if v as usize >= core {
                let position = self.halo_position(v as usize)?;
                LatticeBox { lo: position, hi: position.map(|x| x + 1) }
            } else if v < brick_end {
                continue;
            } else {
                let brick = self.brick_of(v);
                brick_end = self.starts[brick + 1];
                bricks.brick(self.bricks[brick])
            };
            hull = hull.hull(&here);
        }
        Ok(hull)
    }

    /// The brick of a core corner.
    fn brick_of(&self, v: u32) -> usize {
        self.starts.partition_point(|&s| s <= v) - 1
    }

    /// A halo corner's position is a formula of its id; a core corner's brick is enumerated.
    #[cold]
    fn place_corner(&mut self, v: usize) -> Result<()> {
        if v < self.core() {
            return self.place_brick(self.brick_of(v as u32));
        }
        self.memory.positions[v] = self.halo_position(v)?;
        self.memory.states[v] |= PLACED;
        Ok(())
    }

    fn halo_position(&mut self, v: usize) -> Result<LatticePos> {
        self.load_page(self.flag_pages + v / PAGE_IDS - self.core() / PAGE_IDS)?;
        let id = PointId(self.memory.ids[v]);
        let wrong = || damaged(&self.mesh, self.id, "halo", &format!("no point {:#x}", id.0));
        self.archive.points.position(id).ok_or_else(wrong)
    }

    /// Lists the points of a brick, which are corners.
    fn place_brick(&mut self, n: usize) -> Result<()> {
        let brick = self.archive.chunks.bricks().brick(self.bricks[n]);
        let (points, first) = (&self.archive.points, self.starts[n]);
        let CornersMemory { positions, ids, states, sites } = &mut self.memory;
        let wrong = |what: &str| damaged(&self.mesh, self.id, "header", what);
        check_brick(points, &brick).map_err(|e| wrong(&e.to_string()))?;
        points.sites_in(&brick, sites);
        let (got, said) = (sites.len(), self.starts[n + 1] - first);
        if got != said as usize {
            let number = self.bricks[n].0;
            return Err(wrong(&format!("brick {number} has {got} points, not the {said} recorded")));
        }
        for (v, site) in (first as usize..).zip(&*sites) {
            (positions[v], ids[v]) = (site.pos, site.id.0);
            states[v] |= PLACED;
        }
        Ok(())
    }

    /// Reads the flags of core corners.
    fn load_flags(&mut self, corners: &[u32]) -> Result<()> {
        let mut last = usize::MAX;
        for &v in corners {
            let page = v as usize / PAGE_FLAGS;
            if page == last || v as usize >= self.core() {
                continue;
            }
            last = page;
            self.load_page(page)?;
        }
        Ok(())
    }

    /// Reads the flags of all corners.
    pub(super) fn load_all_flags(&mut self) -> Result<()> {
        (0..self.flag_pages).try_for_each(|page| self.load_page(page))
    }

    #[inline]
    fn load_page(&mut self, page: usize) -> Result<()> {
        if self.read[page] { Ok(()) } else { self.read_page(page) }
    }

    #[cold]
    fn read_page(&mut self, page: usize) -> Result<()> {
        let (core, vertices, at) = (self.core(), self.len(), 1 + page as u64);
        let CornersMemory { ids, states, .. } = &mut self.memory;
        let mut bytes = vec![];
        self.mesh.block(self.id, at, &mut bytes)?;
        let decoded = match page.checked_sub(self.flag_pages) {
            None => {
                let states = &mut states[page * PAGE_FLAGS..core.min((page + 1) * PAGE_FLAGS)];
                let mut shared = vec![false; states.len()];
                decode_flags(&bytes, &mut shared).map(|()| {
                    states
                        .iter_mut()
                        .zip(shared)
                        .filter(|(_, shared)| !shared)
                        .for_each(|(s, _)| *s &= !SHARED);
                })
            }
            Some(n) => {
                let first = (core / PAGE_IDS + n) * PAGE_IDS;
                let ids = &mut ids[first.max(core)..vertices.min(first + PAGE_IDS)];
                let mut found = vec![PointId(0); ids.len()];
                decode_ids(&bytes, &mut found)
                    .map(|()| ids.iter_mut().zip(found).for_each(|(id, found)| *id = found.0))
            }
        };
        decoded.map_err(|m| self.mesh.blame(self.id, at, m))?;
        self.read[page] = true;
        Ok(())
    }

    /// Points of each brick.
    pub(super) fn core_counts(&self) -> Vec<u32> {
        self.starts.windows(2).map(|w| w[1] - w[0]).collect()
    }

    /// What has been found.
    pub(super) fn into_lists(self) -> CornerLists {
        let CornersMemory { mut positions, mut ids, states, .. } = self.memory;
        positions.truncate(states.len());
        ids.truncate(states.len());
        let shared = states.iter().map(|state| state & SHARED != 0).collect();
        (positions, ids.into_iter().map(PointId).collect(), shared)
    }

    /// The memory, for another chunk.
    pub(super) fn into_memory(self) -> CornersMemory {
        self.memory
    }
}

/// The values of an array at certain places, which begin with a run.
pub(super) fn gather<T: Copy>(all: &[T], places: &[u32], out: &mut Vec<T>) {
    out.clear();
    let Some(&first) = places.first() else { return };
    let run = places.iter().zip(first..).take_while(|&(&v, expected)| v == expected).count();
    out.extend_from_slice(&all[first as usize..first as usize + run]);
    out.extend(places[run..].iter().map(|&v| all[v as usize]));
}
