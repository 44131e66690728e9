//! The outer part of a halo: points that are known, and inserted only where a tetrahedron asks for them.
//!
//! A tetrahedron near the core whose sphere leaves the inner region is certified when no point that is not inserted lies in the
//! sphere. Such points are found in a grid of cells, about two points each; those found are **wanted**, and inserted
//! before the next look. Most points of a wide halo are never wanted.
//!
//! Time: a sphere looks at the cells that its bounding box touches. Memory: 28 bytes a point.

use super::certify::{Local, Unseen};
use crate::geom::predicates::{insphere, orient3d};
use crate::geom::{LatticeBox, LatticePos};

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Out,
    Wanted,
    Inserted,
}

/// The points of the halo that were not inserted with the rest, in a grid.
pub(super) struct Late<'a> {
    positions: &'a [LatticePos],
    local: Local,
    /// What is unseen even here.
    far: Unseen,
    grid: Grid,
    /// By index into `positions` less `first`.
    state: Vec<State>,
    first: usize,
    /// Indices of the points wanted.
    wanted: Vec<u32>,
    /// How often the answer lay beyond the points here.
    pub(super) uncovered: u64,
}

impl<'a> Late<'a> {
    /// The positions from `first` on, all in `region`; what is not in `region` is unseen.
    pub(super) fn new(
        positions: &'a [LatticePos],
        first: usize,
        region: LatticeBox,
        far: Unseen,
        local: Local,
    ) -> Self {
        let grid = Grid::new(&positions[first..], region, local);
        let state = vec![State::Out; positions.len() - first];
        Self { positions, local, far, grid, state, first, wanted: vec![], uncovered: 0 }
    }

    /// Takes the wanted points out, to be inserted.
    pub(super) fn take_wanted(&mut self) -> Vec<u32> {
        for &i in &self.wanted {
            self.state[i as usize - self.first] = State::Inserted;
        }
        std::mem::take(&mut self.wanted)
    }

    /// Whether a tetrahedron's closed circumsphere holds no point that is not inserted; those it holds become wanted. `close` is
    /// what is not among the points inserted at once.
    pub(super) fn spares(&mut self, close: &Unseen, tet: [LatticePos; 4], sphere: &[f64; 4]) -> bool {
        let found = match close.radius(sphere) {
            Some(radius) => self.want_in_ball([sphere[0], sphere[1], sphere[2]], radius),
            None if close.spares(|| tet, sphere) => return true,
            // Too thin or too large for a sphere in floating point.
            None => {
                let [a, b, c, d] = tet;
                self.want_all(|q| insphere(a, b, c, d, q) >= 0)
            }
        };
        // Only a tetrahedron that would stay has to answer for what lies beyond.
        !found && self.covers(self.far.spares(|| tet, sphere))
    }

    /// Whether no point that is not inserted lies strictly beyond a hull facet; those that do become wanted.
    pub(super) fn spares_beyond(&mut self, facet: [LatticePos; 3]) -> bool {
        let [a, b, c] = facet;
        let found = self.want_all(|q| orient3d(a, b, c, q) > 0);
        !found && self.covers(self.far.spares_beyond(facet))
    }

    fn covers(&mut self, covered: bool) -> bool {
        self.uncovered += u64::from(!covered);
        covered
    }

    /// Whether there is any such point; they become wanted.
    fn want_all(&mut self, is_such: impl Fn(LatticePos) -> bool) -> bool {
        let mut found = false;
        for i in 0..self.state.len() as u32 {
            if self.state[i as usize] != State::Inserted && is_such(self.positions[self.first + i as usize]) {
                found = true;
                want(&mut self.state, &mut self.wanted, self.first, i);
            }
        }
        found
    }

    fn want_in_ball(&mut self, centre: [f64; 3], radius: f64) -> bool {
        let Self { grid, state, wanted, positions, first, local, .. } = self;
        let mut found = false;
        grid.for_each_near(centre, radius, |i| {
            let at = local.coordinates(positions[*first + i as usize]);
            let d2: f64 = (0..3).map(|k| (at[k] - centre[k]) * (at[k] - centre[k])).sum();
            if d2 <= radius * radius && state[i as usize] != State::Inserted {
                found = true;
                want(state, wanted, *first, i);
            }
        });
        found
    }
}

fn want(state: &mut [State], wanted: &mut Vec<u32>, first: usize, i: u32) {
    if state[i as usize] == State::Out {
        state[i as usize] = State::Wanted;
        wanted.push(first as u32 + i);
    }
}

/// Points by cell.
struct Grid {
    lo: [f64; 3],
    cells_per_unit: f64,
    dims: [usize; 3],
    /// Where the points of each cell start in `points`; one more at the end.
    start: Vec<u32>,
    points: Vec<u32>,
}

impl Grid {
    fn new(positions: &[LatticePos], region: LatticeBox, local: Local) -> Self {
        let (lo, hi) = (local.coordinates(region.lo), local.coordinates(region.hi));
        let size: [f64; 3] = std::array::from_fn(|k| (hi[k] - lo[k]).max(1.0));
        // The points fill a shell, about a quarter of the region.
        let cells = (2 * positions.len()).clamp(1, 1 << 22) as f64;
        let cells_per_unit = (cells / (size[0] * size[1] * size[2])).cbrt();
        let dims = size.map(|s| ((s * cells_per_unit) as usize + 1).min(1 << 12));
        let mut grid = Self { lo, cells_per_unit, dims, start: vec![], points: vec![0; positions.len()] };
        let cell_of: Vec<u32> = positions.iter().map(|p| grid.cell(local.coordinates(*p)) as u32).collect();
        let mut start = vec![0u32; dims[0] * dims[1] * dims[2] + 1];
        cell_of.iter().for_each(|&c| start[c as usize + 1] += 1);
        for c in 1..start.len() {
            start[c] += start[c - 1];
        }
        // Filled from the end of each cell, so that `start` is right again afterwards.
        for (i, &c) in cell_of.iter().enumerate() {
            let place = &mut start[c as usize];
            grid.points[*place as usize] = i as u32;
            *place += 1;
        }
        start.rotate_right(1);
        start[0] = 0;
        grid.start = start;
        grid
    }

    /// The cell's coordinate on an axis; positions outside count to the outermost cells.
    fn axis(&self, k: usize, at: f64) -> usize {
        // A negative number converts to 0.
        (((at - self.lo[k]) * self.cells_per_unit) as usize).min(self.dims[k] - 1)
    }

    fn cell(&self, at: [f64; 3]) -> usize {
        let [x, y, z] = [0, 1, 2].map(|k| self.axis(k, at[k]));
        (z * self.dims[1] + y) * self.dims[0] + x
    }

    /// Calls `f` with each point in the cells that a ball's bounding box touches.
    fn for_each_near(&self, centre: [f64; 3], radius: f64, mut f: impl FnMut(u32)) {
        let [x, y, z] =
            [0, 1, 2].map(|k| (self.axis(k, centre[k] - radius), self.axis(k, centre[k] + radius)));
        for z in z.0..=z.1 {
            for y in y.0..=y.1 {
                let row = (z * self.dims[1] + y) * self.dims[0];
                let (from, to) = (self.start[row + x.0], self.start[row + x.1 + 1]);
                self.points[from as usize..to as usize].iter().for_each(|&i| f(i));
            }
        }
    }
}
