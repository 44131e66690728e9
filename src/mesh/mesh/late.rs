//! Deferred insertion: halo points are inserted only when a tetrahedron needs them.
//!
//! A tetrahedron near the core whose sphere leaves the inner region is certified when its sphere
//! holds no point that was not inserted. Such points are found in a grid of cells, about two points
//! each. Of those in a sphere the one nearest to its centre is inserted, then the new tetrahedra
//! are examined. One is enough, since it removes the tetrahedron in question: where points crowd,
//! as in the planes of a hyperbolic cross, a large sphere holds thousands that are not needed. All
//! requested points are inserted before the next round: a point between such planes has hundreds of
//! tetrahedra, most of which another point removes.
//!
//! Time: a sphere examines the cells that its bounding box touches. Memory: some 40 bytes per
//! point.

use super::certify::{Local, Unseen};
use crate::predicates::{insphere, orient3d};
use isospan_io::geom::{LatticeBox, LatticePos};

/// A point that is not inserted, and its index among the chunk's positions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outer {
    pub(super) at: LatticePos,
    pub(super) index: u32,
}

/// What is known of a tetrahedron or a hull facet.
pub(super) enum Finding {
    /// Nothing lies in it, seen or unseen.
    Certified,
    /// This point does.
    Holds(Outer),
    /// No point that is known does; what lies beyond the region may.
    Uncovered,
}

/// The points that were not inserted, in a grid.
pub(super) struct Late {
    local: Local,
    /// What is unseen even here.
    far: Unseen,
    grid: LateGrid,
}

impl Late {
    /// What is not in `region` is unseen.
    pub(super) fn new(points: Vec<Outer>, region: LatticeBox, domain: LatticeBox, local: Local) -> Self {
        let grid = LateGrid::new(&points, region, local);
        Self { local, far: Unseen::new(region, domain, local), grid }
    }

    /// The points that are still out.
    pub(super) fn points(&self) -> Vec<Outer> {
        self.grid.cells().flat_map(|cell| self.grid.of(cell)).copied().collect()
    }

    /// Takes a point out, and those at the same place: of equal positions only one is a vertex.
    pub(super) fn take(&mut self, point: LatticePos) {
        let cell = self.grid.cell(self.local.coordinates(point));
        self.grid.remove(cell, point);
    }

    /// Whether a tetrahedron's closed circumsphere holds no point that is not inserted; `close` is
    /// what is not among those inserted at once.
    pub(super) fn look_in(
        &self,
        close: &Unseen,
        tet: impl Fn() -> [LatticePos; 4],
        sphere: &[f64; 4],
    ) -> Finding {
        let found = match close.radius(sphere) {
            Some(radius) => self.nearest([sphere[0], sphere[1], sphere[2]], radius),
            None if close.spares(&tet, sphere) => return Finding::Certified,
            // Too thin or too large for a sphere in floating point.
            None => {
                let [a, b, c, d] = tet();
                self.any(|q| insphere(a, b, c, d, q) >= 0)
            }
        };
        // Only a tetrahedron that would stay has to answer for what lies beyond.
        found.map_or_else(|| covered(self.far.spares(&tet, sphere)), Finding::Holds)
    }

    /// The same of what lies strictly beyond a hull facet.
    pub(super) fn look_beyond(&self, facet: [LatticePos; 3]) -> Finding {
        let [a, b, c] = facet;
        let found = self.any(|q| orient3d(a, b, c, q) > 0);
        found.map_or_else(|| covered(self.far.spares_beyond(facet)), Finding::Holds)
    }

    /// The first such point.
    fn any(&self, is_such: impl Fn(LatticePos) -> bool) -> Option<Outer> {
        self.grid.cells().flat_map(|cell| self.grid.of(cell)).copied().find(|p| is_such(p.at))
    }

    /// The point of a ball that is nearest to its centre.
    fn nearest(&self, centre: [f64; 3], radius: f64) -> Option<Outer> {
        let (mut best, mut least) = (None, radius * radius);
        self.grid.for_each_near(centre, radius, |point| {
            let at = self.local.coordinates(point.at);
            let d2: f64 = (0..3).map(|k| (at[k] - centre[k]) * (at[k] - centre[k])).sum();
            if d2 < least || best.is_none() && d2 <= least {
                (best, least) = (Some(*point), d2);
            }
        });
        best
    }
}

fn covered(covered: bool) -> Finding {
    if covered { Finding::Certified } else { Finding::Uncovered }
}

/// Points by cell.
struct LateGrid {
    lo: [f64; 3],
    cells_per_unit: f64,
    dims: [usize; 3],
    /// Where the points of each cell start in `points`; one more at the end.
    start: Vec<u32>,
    /// How many of them are left, at the start of each cell.
    left: Vec<u32>,
    points: Vec<Outer>,
}

impl LateGrid {
    fn new(points: &[Outer], region: LatticeBox, local: Local) -> Self {
        let (lo, hi) = (local.coordinates(region.lo), local.coordinates(region.hi));
        let size: [f64; 3] = std::array::from_fn(|k| (hi[k] - lo[k]).max(1.0));
        // The points fill a shell, about a quarter of the region.
        let cells = (2 * points.len()).clamp(1, 1 << 22) as f64;
        let cells_per_unit = (cells / (size[0] * size[1] * size[2])).cbrt();
        let dims = size.map(|s| ((s * cells_per_unit) as usize + 1).min(1 << 12));
        let mut grid =
            Self { lo, cells_per_unit, dims, start: vec![], left: vec![], points: points.to_vec() };
        let cell_of: Vec<u32> = points.iter().map(|p| grid.cell(local.coordinates(p.at)) as u32).collect();
        let mut left = vec![0u32; dims[0] * dims[1] * dims[2]];
        cell_of.iter().for_each(|&c| left[c as usize] += 1);
        let mut sum = 0;
        for n in &left {
            grid.start.push(sum);
            sum += n;
        }
        grid.start.push(sum);
        let mut next = grid.start.clone();
        for (&c, &point) in cell_of.iter().zip(points) {
            grid.points[next[c as usize] as usize] = point;
            next[c as usize] += 1;
        }
        grid.left = left;
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

    fn cells(&self) -> std::ops::Range<usize> {
        0..self.left.len()
    }

    fn of(&self, cell: usize) -> &[Outer] {
        &self.points[self.start[cell] as usize..][..self.left[cell] as usize]
    }

    /// The others stay in their order: of equal positions the first is the one that is found.
    fn remove(&mut self, cell: usize, at: LatticePos) {
        let (start, left) = (self.start[cell] as usize, &mut self.left[cell]);
        let points = &mut self.points[start..start + *left as usize];
        let mut kept = 0;
        for i in 0..points.len() {
            points[kept] = points[i];
            kept += usize::from(points[i].at != at);
        }
        *left = kept as u32;
    }

    /// Calls `f` with each point in the cells that a ball's bounding box touches.
    fn for_each_near(&self, centre: [f64; 3], radius: f64, mut f: impl FnMut(&Outer)) {
        let [x, y, z] =
            [0, 1, 2].map(|k| (self.axis(k, centre[k] - radius), self.axis(k, centre[k] + radius)));
        for z in z.0..=z.1 {
            for y in y.0..=y.1 {
                let row = (z * self.dims[1] + y) * self.dims[0];
                (row + x.0..=row + x.1).for_each(|cell| self.of(cell).iter().for_each(&mut f));
            }
        }
    }
}
