//! A chunk meshed star by star: the tetrahedra at one point after another, each tetrahedron once.
//!
//! An insertion (`delaunay.rs`) makes 27 tetrahedra a point, of which 6.8 stay. Where points lie
//! evenly, which tetrahedron lies behind a known face can be asked of the points around directly
//! (gift wrapping: Chand and Kapur, 1970; Tanemura, Ogawa and Ogita, 1983), and four (NEON), eight
//! (AVX2) or sixteen (AVX-512) are looked at by one instruction:
//!
//! ```text
//!      ┄┄┄ c              The tetrahedra at p, seen from p, are the triangles of a sphere, the *link* of p. Those with a point that had its turn
//!     known ╲    · w      before p are known; the faces at p that bound them wait for it. Each is a *gate* cd: behind it is the
//!            ╲  ·         point w in front of p, c, d whose sphere with them reaches least far to the front: the least
//!      ┄┄┄┄┄┄ d           (|w - m|² - r²) / n·w, (m, r) the circle through p, c, d and n its normal. The triangle cwd
//!                         opens gates cw and wd, or closes them.
//! ```
//!
//! When no gate is open, the star is complete. The face across from p of each new tetrahedron waits
//! for the first of its points to have its turn. Points have their turns in the order of their
//! numbers, so tetrahedra come out in the order of their least numbers. A chunk needs no
//! tetrahedron but those at its own points: no halo is meshed, only looked at.
//!
//! # Why the tetrahedra are those of the whole mesh
//! Floating point only guesses. A star of p is taken when for each of its new tetrahedra it is
//! proven, within error bounds (`wide.rs`), that
//!
//! 1. it is positively oriented, and its sphere leaves out all points within D of p but its own
//!    four;
//! 2. the diameter of its sphere is less than D, so that these are all that could lie in it, for a
//!    sphere through p reaches no further.
//!
//! So each is a tetrahedron of the whole mesh 𝒟, and no tie is involved. Across each of its faces
//! at p is another one of the star, or nothing where the three corners of the face lie in one face
//! of the domain. The tetrahedra of 𝒟 at p are connected across such faces; hence what is closed
//! across them, and not empty, is all of them.
//!
//! Time: half a microsecond a point (0.6 with AVX2 alone) on a machine on which insertion takes one
//! with its halo: a third is following gates, an eighth listing the points nearby. Memory: 16 bytes
//! a tetrahedron and 30 a point. Tried, for no gain: two gates that share no point at once, the
//! last gate first, reciprocals in place of divisions, faces that wait for one point side by side.
//!
//! Where that proof fails (a large sphere at the domain's boundary, a tie, a point twice) D grows,
//! and at last the points of a box around p are tetrahedralized by insertion, exactly, and
//! certified as a chunk is (`certify.rs`). Where even that fails, or happens often, as on a
//! lattice, the chunk is left to insertion altogether. The outcome is the same.

mod around;
mod batch;
mod grid;
mod machine;
mod wide;

use super::certify::Unseen;
use super::delaunay::{self, Kernel};
use super::list::TetList;
use super::region::{ChunkMesh, ChunkRegion};
use super::tet::Tet;
use grid::StarGrid;
use isospan_io::error::Result;
use isospan_io::geom::curve::Order;
use isospan_io::geom::{LatticeBox, LatticePos};
use machine::Vectors;
use wide::{Neighbourhood, View};

/// D in mean spacings, at first and where that does not do. With 2.15, one star in 140 of
/// Hammersley points wants more, one in 20 of Halton points.
const REACHES: [f64; 3] = [2.15, 2.7, 3.3];
/// Half the edge of the box whose points are tetrahedralized, in mean spacings; doubled where that
/// does not do.
const BOX: f64 = 3.0;
/// How many stars of a chunk may ask for that: so many, and one of so many. Of Halton and
/// Hammersley points, hardly any do, unless the domain is two or three spacings thick: then all do.
const SLOW: (usize, usize) = (50, 2000);

/// A point that had no tetrahedron yet, as the first face that waits for it.
const NEW: u32 = u32::MAX;
/// None.
const END: u32 = u32::MAX - 1;

/// A face that waits for a point of it to have its turn: the other two, as they follow each other
/// in its link seen from the known tetrahedron; and the next face of that point.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    others: [u32; 2],
    next: u32,
}

/// The memory of one worker.
#[derive(Debug, Default)]
pub(super) struct Stars {
    grid: StarGrid,
    near: Box<Neighbourhood>,
    /// For each point, the first face that waits for it.
    first: Vec<u32>,
    waiting: Vec<Waiting>,
    free: Vec<u32>,
    tets: Vec<Tet>,
    /// The new tetrahedra of the star at hand, the point first.
    star: Vec<Tet>,
    slow: Slow,
}

/// Buffers for a star by insertion.
#[derive(Debug, Default)]
struct Slow {
    numbers: Vec<u32>,
    positions: Vec<LatticePos>,
    stars: usize,
    patience: Patience,
}

/// The first number of [`SLOW`]; tests have more.
#[derive(Debug)]
struct Patience(usize);

impl Default for Patience {
    fn default() -> Self {
        Self(SLOW.0)
    }
}

/// The most points that are looked at together; there is room for this many more behind lists.
const LANES: usize = 16;

/// How a star ended.
enum Star {
    Whole,
    /// A larger D may do.
    TooNear,
    /// Only integers can decide.
    Doubtful,
}

impl Stars {
    /// Takes the memory of a list that is no longer needed.
    pub(super) fn reuse(&mut self, tets: Vec<Tet>) {
        if tets.capacity() > self.tets.capacity() {
            self.tets = tets;
        }
    }

    /// Makes gates of the faces that wait for a point.
    #[inline]
    fn open_gates(&mut self, p: u32) {
        self.near.gates.clear();
        let mut next = self.first[p as usize];
        while next < END {
            let face = self.waiting[next as usize];
            self.near.gates.push(face.others);
            self.free.push(next);
            next = face.next;
        }
    }

    /// The mesh of a chunk of evenly spread points, those of the core first; `None` where insertion
    /// is to make it. With `around`, also the tetrahedra around those owned.
    ///
    /// # Errors
    /// As [`Kernel::delaunay`].
    pub(super) fn mesh(
        &mut self,
        kernel: &mut Kernel,
        boxes: &ChunkRegion,
        positions: &[LatticePos],
        order: &Order,
        around: bool,
    ) -> Result<Option<ChunkMesh>> {
        self.mesh_with(Vectors::found(), kernel, boxes, positions, order, around)
    }

    /// As [`Stars::mesh`], with these vectors.
    fn mesh_with(
        &mut self,
        vectors: Vectors,
        kernel: &mut Kernel,
        boxes: &ChunkRegion,
        positions: &[LatticePos],
        order: &Order,
        around: bool,
    ) -> Result<Option<ChunkMesh>> {
        match self.begin(vectors, boxes, positions, order) {
            Some(chunk) => chunk.mesh(self, kernel, around),
            None => Ok(None),
        }
    }

    /// Prepares for a chunk; `None` where this is nothing for it.
    fn begin<'a>(
        &mut self,
        vectors: Vectors,
        boxes: &'a ChunkRegion,
        positions: &'a [LatticePos],
        order: &'a Order,
    ) -> Option<Chunk<'a>> {
        let core = positions.iter().take_while(|p| boxes.core.contains(**p)).count();
        if core < 64 || positions[core..].iter().any(|p| boxes.core.contains(*p)) {
            return None;
        }
        let spacing = self.list(boxes, positions)?;
        Some(Chunk {
            vectors,
            boxes,
            positions,
            order,
            spacing,
            core,
            rows: vec![],
            cell: [usize::MAX; 3],
            used: vec![],
            turned: core,
            knows_owned: false,
        })
    }

    /// Lists the points of a region for the stars among them; their mean spacing, or `None` where
    /// they are too few for it.
    fn list(&mut self, boxes: &ChunkRegion, positions: &[LatticePos]) -> Option<f64> {
        let volume: f64 = (0..3).map(|a| f64::from(boxes.region.hi[a] - boxes.region.lo[a])).product();
        let spacing = (volume / positions.len() as f64).cbrt();
        if !self.grid.fill(&boxes.region, positions, REACHES[0] * spacing, spacing) {
            return None;
        }
        self.first.resize(positions.len(), NEW);
        self.first.fill(NEW);
        self.waiting.clear();
        self.free.clear();
        self.slow.stars = 0;
        Some(spacing)
    }
}

/// A chunk at work.
struct Chunk<'a> {
    vectors: Vectors,
    boxes: &'a ChunkRegion,
    positions: &'a [LatticePos],
    order: &'a Order,
    spacing: f64,
    /// How many positions are the core's.
    core: usize,
    rows: Vec<[u32; 2]>,
    /// The cell around which the rows are, with the first reach.
    cell: [usize; 3],
    /// For each position, whether an owned tetrahedron has it, and others may. Empty until all
    /// those are known.
    used: Vec<bool>,
    /// The number of first positions that have their turn, used or not.
    turned: usize,
    /// Whether the tetrahedra that the chunk owns are known.
    knows_owned: bool,
}

impl Chunk<'_> {
    fn mesh(mut self, room: &mut Stars, kernel: &mut Kernel, around: bool) -> Result<Option<ChunkMesh>> {
        room.tets.clear();
        delaunay::reserve(&mut room.tets, 7 * self.core);
        let mut shared: Vec<bool> = vec![false; self.core];
        shared.resize(self.positions.len(), true);
        let mut foreign = vec![];
        for p in 0..self.core as u32 {
            if !self.close(room, kernel, p)? {
                return Ok(None);
            }
            let Stars { tets, star, .. } = room;
            for &tet in &*star {
                if self.owns(tet) {
                    tets.push(tet);
                } else {
                    tet.iter().for_each(|&v| shared[v as usize] = true);
                    if around {
                        foreign.push(tet);
                    }
                }
            }
            self.wait(room, around);
        }
        let own = room.tets.len();
        if around && !self.add_around(room, kernel, foreign)? {
            return Ok(None);
        }
        let mut tets = TetList::from(std::mem::take(&mut room.tets));
        tets.split_at(own);
        Ok(Some(ChunkMesh { tets, shared }))
    }

    fn owns(&self, tet: Tet) -> bool {
        let core = self.core as u32;
        if tet.iter().all(|&v| v < core) {
            return true;
        }
        let least = tet.into_iter().min_by_key(|&v| self.positions[v as usize]);
        least.is_some_and(|v| v < core)
    }

    /// Lets the faces of the new tetrahedra wait that lie across from the point.
    fn wait(&self, room: &mut Stars, around: bool) {
        for i in 0..room.star.len() {
            let [_, b, a, c] = room.star[i];
            for v in [b, a, c] {
                let first = &mut room.first[v as usize];
                *first = (*first).min(END);
            }
            if around || b.min(a).min(c) < self.core as u32 {
                self.wait_for(room, [b, a, c]);
            }
        }
    }

    /// Lets a face wait for the first of its points that has its turn, if any; seen from the known
    /// tetrahedron the three follow each other the other way round.
    #[inline]
    fn wait_for(&self, room: &mut Stars, [b, a, c]: [u32; 3]) {
        let turn = |v: u32| if self.used.is_empty() || self.used[v as usize] { v } else { u32::MAX };
        let (tb, ta, tc) = (turn(b), turn(a), turn(c));
        let least = tb.min(ta).min(tc);
        if least == u32::MAX {
            return;
        }
        let others = if least == tb {
            [c, a]
        } else if least == ta {
            [b, c]
        } else {
            [a, b]
        };
        let first = &mut room.first[least as usize];
        let face = Waiting { others, next: (*first).min(END) };
        if let Some(place) = room.free.pop() {
            room.waiting[place as usize] = face;
            *first = place;
        } else {
            *first = room.waiting.len() as u32;
            room.waiting.push(face);
        }
    }

    /// Makes the new tetrahedra at a point; false where that cannot be.
    fn close(&mut self, room: &mut Stars, kernel: &mut Kernel, p: u32) -> Result<bool> {
        let at = self.positions[p as usize];
        room.star.clear();
        if room.first[p as usize] == END {
            // All its tetrahedra are known.
            return Ok(true);
        }
        let is_new = room.first[p as usize] == NEW;
        room.open_gates(p);
        let Stars { grid, near, star, slow, .. } = room;
        let cell = grid.cell(&at);
        let mut view = self.view(grid, p, is_new);
        for (n, reach) in REACHES.into_iter().enumerate() {
            let d = reach * self.spacing;
            if !self.knows(at, d) {
                break;
            }
            if n > 0 || cell != self.cell {
                let cells = (reach / REACHES[0]).ceil() as usize;
                grid.rows(cell, cells, &mut self.rows);
                self.cell = if n == 0 { cell } else { [usize::MAX; 3] };
            }
            view.reach = (d * f64::from(grid.scale)) as f32;
            match self.vectors.star(near, grid, &self.rows, &view, |face| self.is_outer(face)) {
                Star::Whole => {
                    near.tets(p, star);
                    return Ok(true);
                }
                Star::TooNear => {}
                Star::Doubtful => break,
            }
        }
        slow.stars += 1;
        if slow.stars > slow.patience.0 + p as usize / SLOW.1 {
            return Ok(false);
        }
        self.close_slowly(grid, slow, star, kernel, p)
    }

    /// How a point looks around, without a reach.
    fn view(&self, grid: &StarGrid, p: u32, is_new: bool) -> View {
        let at = self.positions[p as usize];
        let ends = |a: usize| [self.boxes.domain.lo[a], self.boxes.domain.hi[a] - 1];
        View {
            p,
            at: std::array::from_fn(|a| grid.local(&at, a)),
            is_new,
            reach: 0.0,
            domain: std::array::from_fn(|a| {
                ends(a).map(|end| (f64::from(end) - f64::from(at[a])) * f64::from(grid.scale))
            }),
        }
    }

    /// Whether all points within `d` of a position are at hand.
    fn knows(&self, at: LatticePos, d: f64) -> bool {
        let ChunkRegion { region, domain, .. } = self.boxes;
        let d = d as u32 + 1;
        (0..3).all(|a| {
            (region.lo[a] == domain.lo[a] || at[a] >= region.lo[a].saturating_add(d))
                && (region.hi[a] == domain.hi[a] || at[a].saturating_add(d) < region.hi[a])
        })
    }

    /// Whether three points lie in one face of the domain, with nothing beyond: where (p, a, b, x)
    /// is negatively oriented.
    fn is_outer(&self, face: [u32; 3]) -> bool {
        let domain = &self.boxes.domain;
        let [p, a, b] = face.map(|v| self.positions[v as usize]);
        (0..3).any(|k| {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            let from_p = |q: LatticePos, k: usize| i64::from(q[k]) - i64::from(p[k]);
            let turn = from_p(b, i) * from_p(a, j) - from_p(b, j) * from_p(a, i);
            p[k] == a[k]
                && p[k] == b[k]
                && (p[k] == domain.lo[k] && turn < 0 || p[k] + 1 == domain.hi[k] && turn > 0)
        })
    }

    /// The new tetrahedra at a point, from the points of a box around it; false where they cannot
    /// be certified.
    fn close_slowly(
        &self,
        grid: &StarGrid,
        slow: &mut Slow,
        star: &mut Vec<Tet>,
        kernel: &mut Kernel,
        p: u32,
    ) -> Result<bool> {
        let ChunkRegion { region, domain, .. } = self.boxes;
        let at = self.positions[p as usize];
        let mut half = BOX * self.spacing;
        loop {
            let w = half as u32 + 1;
            let around = LatticeBox {
                lo: std::array::from_fn(|a| at[a].saturating_sub(w).max(region.lo[a])),
                hi: std::array::from_fn(|a| at[a].saturating_add(w).min(region.hi[a])),
            };
            let mut rows = vec![];
            grid.rows(grid.cell(&at), (half * grid.per_step).ceil() as usize + 1, &mut rows);
            let ids = rows.iter().flat_map(|&[start, end]| &grid.ids[start as usize..end as usize]);
            slow.numbers.clear();
            slow.numbers.extend(ids.copied().filter(|&v| around.contains(self.positions[v as usize])));
            slow.numbers.sort_unstable();
            slow.positions.clear();
            slow.positions.extend(slow.numbers.iter().map(|&v| self.positions[v as usize]));
            kernel.delaunay(&slow.positions, self.order)?;
            if self.take_star(&Unseen::new(around, *domain, kernel.local()), slow, star, kernel, p) {
                return Ok(true);
            }
            if around == *region {
                return Ok(false);
            }
            half *= 2.0;
        }
    }

    /// Takes the new tetrahedra at a point from the kernel's mesh; false where one of the star is
    /// not certified.
    fn take_star(&self, unseen: &Unseen, slow: &Slow, star: &mut Vec<Tet>, kernel: &Kernel, p: u32) -> bool {
        star.clear();
        let mut any = false;
        for id in 0..kernel.records() {
            let Some((v, sphere)) = kernel.record(id) else { continue };
            // Infinity is vertex 0.
            let ids = v.map(|v| if v == 0 { None } else { Some(slow.numbers[kernel.source(v) as usize]) });
            let Some(place) = ids.iter().position(|&v| v == Some(p)) else { continue };
            any = true;
            let at = |v: Option<u32>| v.map(|v| self.positions[v as usize]);
            if let Some(k) = ids.iter().position(Option::is_none) {
                let [Some(a), Some(b), Some(c)] = delaunay::face(k).map(|i| at(ids[i])) else { return false };
                if !unseen.spares_beyond([a, b, c]) {
                    return false;
                }
                continue;
            }
            let [Some(a), Some(b), Some(c), Some(d)] = ids.map(at) else { return false };
            if !unseen.spares(|| [a, b, c, d], sphere) {
                return false;
            }
            let tet = ids.map(|v| v.unwrap_or(p));
            let is_known = self.knows_owned && self.owns(tet);
            if !is_known && tet.iter().all(|&v| v == p || !self.had_turn(v, p)) {
                let face = delaunay::face(place).map(|i| tet[i]);
                // Seen from beyond the face the three are ordered; the point comes first, an even
                // permutation of the four.
                star.push([p, face[0], face[2], face[1]]);
            }
        }
        any
    }

    /// Whether a point had its turn when it is that of `p`.
    fn had_turn(&self, v: u32, p: u32) -> bool {
        v < p && (v < self.turned as u32 || self.used.get(v as usize).is_some_and(|used| *used))
    }
}

#[cfg(test)]
mod tests;
