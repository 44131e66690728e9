//! How dense the points are, cell by cell.
//!
//! The domain is cut into cells of a few voxels, and each has a **level**: one more level, twice as
//! many points to a voxel. Neighbours, also those over an edge or a corner, differ by at most one
//! level, so that no tetrahedron has to bridge a jump:
//!
//! ```text
//!   3 3 3 3 2 1 0 0        a feature that needs level 3, and how its
//!   3 3 3 3 2 1 0 0        surroundings follow
//!   2 2 2 2 2 1 0 0
//!   1 1 1 1 1 1 0 0
//! ```
//!
//! Memory: a byte a cell. There are at most [`Levels::MOST_CELLS`] cells for any volume: cells grow
//! with it.

use isospan_io::error::{Error, Result};
use isospan_io::geom::{Lattice, LatticeBox, LatticePos};
use isospan_io::grid::{BrickGrid, BrickId};

/// The level of each cell of a domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Levels {
    cells: BrickGrid,
    levels: Vec<u8>,
    least: u8,
    top: u8,
}

/// The levels in a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Spread {
    pub(super) least: u8,
    pub(super) top: u8,
}

impl Levels {
    /// The most cells.
    pub const MOST_CELLS: u64 = 1 << 22;
    /// The largest level: a set has at most 2^59 points.
    pub const LARGEST: u8 = 40;

    /// The level of each cell, x fastest. They must be graded; see [`Levels::grade`].
    ///
    /// # Errors
    /// [`Error::Usage`] that says what is wrong: too many cells, levels for more or fewer, a level
    /// out of range or two neighbours too far apart.
    pub fn new(cells: BrickGrid, levels: Vec<u8>) -> Result<Self> {
        let count = checked_len(&cells)?;
        if levels.len() as u64 != count {
            return Err(Error::usage(format!("{} levels for {count} cells", levels.len())));
        }
        let (least, top) = levels.iter().fold((u8::MAX, 0), |(lo, hi), &l| (lo.min(l), hi.max(l)));
        if top > Self::LARGEST {
            return Err(Error::usage(format!("level {top}; the largest is {}", Self::LARGEST)));
        }
        let mut graded = levels.clone();
        Self::grade(&cells, &mut graded);
        if graded != levels {
            return Err(Error::usage("levels of neighbouring cells differ by more than one"));
        }
        Ok(Self { cells, levels, least, top })
    }

    /// The same levels on another lattice of the same samples.
    ///
    /// # Panics
    /// When it is of other ones.
    #[must_use]
    pub fn on(mut self, lattice: Lattice) -> Self {
        assert_eq!(self.cells.lattice.dims, lattice.dims, "a lattice of the same samples");
        self.cells.lattice = lattice;
        self
    }

    /// Raises levels, as few as possible, until those of neighbours differ by at most one. Two
    /// sweeps: distances in cells are those of a chess king, for which two suffice (Rosenfeld and
    /// Pfaltz, "Distance functions on digital pictures", 1968).
    pub fn grade(cells: &BrickGrid, levels: &mut [u8]) {
        let [nx, ny, nz] = cells.dims().map(|n| n as usize);
        let rows: Vec<[usize; 2]> = (0..nz).flat_map(|z| (0..ny).map(move |y| [y, z])).collect();
        let at = |y: usize, z: usize| (z * ny + y) * nx;
        for &[y, z] in &rows {
            let above = [(y > 0).then(|| at(y - 1, z))];
            let below = (z > 0).then(|| (y.saturating_sub(1)..(y + 2).min(ny)).map(|v| at(v, z - 1)));
            for other in above.into_iter().flatten().chain(below.into_iter().flatten()) {
                let (before, row) = levels.split_at_mut(at(y, z));
                raise(&mut row[..nx], &before[other..other + nx]);
            }
            let row = &mut levels[at(y, z)..at(y, z) + nx];
            (1..nx).for_each(|x| row[x] = row[x].max(row[x - 1].saturating_sub(1)));
        }
        for &[y, z] in rows.iter().rev() {
            let next = [(y + 1 < ny).then(|| at(y + 1, z))];
            let above = (z + 1 < nz).then(|| (y.saturating_sub(1)..(y + 2).min(ny)).map(|v| at(v, z + 1)));
            for other in next.into_iter().flatten().chain(above.into_iter().flatten()) {
                let (row, after) = levels.split_at_mut(other);
                raise(&mut row[at(y, z)..at(y, z) + nx], &after[..nx]);
            }
            let row = &mut levels[at(y, z)..at(y, z) + nx];
            (1..nx).rev().for_each(|x| row[x - 1] = row[x - 1].max(row[x].saturating_sub(1)));
        }
    }

    /// The cells.
    pub fn cells(&self) -> &BrickGrid {
        &self.cells
    }

    /// The level of each cell, x fastest.
    pub fn as_slice(&self) -> &[u8] {
        &self.levels
    }

    /// The largest level of a cell.
    pub fn top(&self) -> u8 {
        self.top
    }

    /// The level at a position.
    #[inline]
    pub fn at(&self, pos: LatticePos) -> u8 {
        self.levels[self.cells.id(self.cells.brick_at(pos)).0 as usize]
    }

    /// The cells that a box of the domain, not empty, touches: first and past the last.
    pub(super) fn cells_of(&self, b: &LatticeBox) -> ([u64; 3], [u64; 3]) {
        (self.cells.brick_at(b.lo), self.cells.brick_at(b.hi.map(|h| h - 1)).map(|c| c + 1))
    }

    /// Least and largest level of a box of the domain, not empty.
    pub(super) fn spread(&self, b: &LatticeBox) -> Spread {
        let (lo, hi) = self.cells_of(b);
        let mut spread = Spread { least: u8::MAX, top: 0 };
        self.rows(lo, hi, |row, _| {
            for &l in row {
                (spread.least, spread.top) = (spread.least.min(l), spread.top.max(l));
            }
        });
        spread
    }

    /// Whether other levels of the same cells are the same in those that a box of the domain, not
    /// empty, touches.
    pub fn same_in(&self, other: &Self, b: &LatticeBox) -> bool {
        let (lo, hi) = self.cells_of(b);
        let mut same = self.cells == other.cells;
        self.rows(lo, hi, |row, at| {
            let first = self.cells.id(at).0 as usize;
            same = same && other.levels.get(first..first + row.len()) == Some(row);
        });
        same
    }

    /// Calls `f` with each run of cells of one level along x, cut to the box.
    pub(super) fn runs(&self, b: &LatticeBox, mut f: impl FnMut(u8, &LatticeBox)) {
        if b.is_empty() {
            return;
        }
        let (lo, hi) = self.cells_of(b);
        self.rows(lo, hi, |row, [_, y, z]| {
            let mut x = lo[0];
            for run in row.chunk_by(|a, b| a == b) {
                let end = x + run.len() as u64;
                f(run[0], &self.cells.lattice_box([x, y, z], [end, y + 1, z + 1]).intersect(b));
                x = end;
            }
        });
    }

    /// Calls `f` with the parts of a box that are of one level, and their volumes in lattice steps.
    pub fn volumes_in(&self, b: &LatticeBox, mut f: impl FnMut(u8, f64)) {
        self.runs(b, |level, run| f(level, run.volume() as f64));
    }

    fn rows(&self, lo: [u64; 3], hi: [u64; 3], mut f: impl FnMut(&[u8], [u64; 3])) {
        for z in lo[2]..hi[2] {
            for y in lo[1]..hi[1] {
                let first = self.cells.id([lo[0], y, z]).0 as usize;
                f(&self.levels[first..first + (hi[0] - lo[0]) as usize], [lo[0], y, z]);
            }
        }
    }

    /// The least level in a layer of cells at each face of a box, low sides first: those that hold
    /// the face, and the ones beyond it. What a face of the domain has on its other side does not
    /// count.
    pub(super) fn least_at_faces(&self, b: &LatticeBox) -> [[u8; 3]; 2] {
        let (lo, hi) = self.cells_of(b);
        let dims = self.cells.dims();
        let wide = |c: u64, up: bool, a: usize| if up { (c + 1).min(dims[a]) } else { c.saturating_sub(1) };
        let outer_lo: [u64; 3] = std::array::from_fn(|a| wide(lo[a], false, a));
        let outer_hi: [u64; 3] = std::array::from_fn(|a| wide(hi[a], true, a));
        [false, true].map(|high| {
            std::array::from_fn(|a| {
                let (mut l, mut h) = (outer_lo, outer_hi);
                if high {
                    l[a] = hi[a] - 1
                } else {
                    h[a] = lo[a] + 1
                }
                let mut least = u8::MAX;
                self.rows(l, h, |row, _| least = row.iter().fold(least, |m, &v| m.min(v)));
                least
            })
        })
    }

    /// The share of the domain's cells, in voxels, that each level has.
    pub fn voxels_by_level(&self) -> Vec<u64> {
        let mut voxels = vec![0; usize::from(self.top) + 1];
        for (i, &level) in self.levels.iter().enumerate() {
            voxels[usize::from(level)] += cell_voxels(&self.cells, BrickId(i as u64));
        }
        voxels
    }

    /// The lowest level of a cell.
    pub fn least(&self) -> u8 {
        self.least
    }
}

/// Raises the cells of a row to one level below their neighbours in another row, which touches it.
fn raise(row: &mut [u8], other: &[u8]) {
    for (x, level) in row.iter_mut().enumerate() {
        *level = (*level).max(other[x].saturating_sub(1));
    }
    for (level, before) in row[1..].iter_mut().zip(other) {
        *level = (*level).max(before.saturating_sub(1));
    }
    for (level, after) in row.iter_mut().zip(&other[1..]) {
        *level = (*level).max(after.saturating_sub(1));
    }
}

/// The number of cells, if that many are allowed.
fn checked_len(cells: &BrickGrid) -> Result<u64> {
    let dims = cells.dims();
    let count = dims.iter().map(|&n| u128::from(n)).product::<u128>();
    if count > u128::from(Levels::MOST_CELLS) {
        let most = Levels::MOST_CELLS;
        return Err(Error::usage(format!("{count} cells with levels of their own; at most {most}")));
    }
    Ok(count as u64)
}

/// Voxel cells of a cell: fewer at the far faces.
pub fn cell_voxels(cells: &BrickGrid, cell: BrickId) -> u64 {
    let c = cells.coords(cell);
    (0..3).map(|a| cells.edge[a].min(cells.lattice.dims[a] - 1 - c[a] * cells.edge[a])).product()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(dims: [u64; 3]) -> BrickGrid {
        BrickGrid::new(Lattice::new(dims).unwrap(), [4; 3])
    }

    #[test]
    fn grading_raises_as_little_as_possible() {
        let grid = cells([50, 31, 22]);
        let d = grid.dims().map(|n| n as i64);
        let peaks = [([3i64, 2, 1], 7u8), ([11, 7, 5], 4), ([0, 0, 0], 2)];
        let mut levels = vec![0u8; grid.len() as usize];
        for (p, l) in peaks {
            levels[grid.id(p.map(|x| x as u64)).0 as usize] = l;
        }
        Levels::grade(&grid, &mut levels);
        for (i, &level) in levels.iter().enumerate() {
            let c = [i as i64 % d[0], i as i64 / d[0] % d[1], i as i64 / d[0] / d[1]];
            let king = |p: [i64; 3]| (0..3).map(|a| (p[a] - c[a]).abs()).max().unwrap();
            let expected = peaks.iter().map(|&(p, l)| (i64::from(l) - king(p)).max(0)).max().unwrap();
            assert_eq!(i64::from(level), expected, "{c:?}");
        }
        let levels = Levels::new(grid, levels).unwrap();
        assert_eq!((levels.least(), levels.top()), (0, 7));
        let voxels: u64 = levels.voxels_by_level().iter().sum();
        assert_eq!(voxels, 49 * 30 * 21);
    }

    #[test]
    fn what_is_no_map_of_levels_is_refused() {
        let grid = cells([9, 9, 9]);
        let refused = |levels: Vec<u8>, word: &str| {
            let message = Levels::new(grid, levels).unwrap_err().to_string();
            assert!(message.contains(word), "{message}");
        };
        refused(vec![0; 7], "8 cells");
        refused(vec![41; 8], "level 41");
        let huge = BrickGrid::new(Lattice::new([2000; 3]).unwrap(), [4; 3]);
        assert!(Levels::new(huge, vec![]).unwrap_err().to_string().contains("at most"));
        let grid = cells([13, 9, 9]);
        let levels = vec![0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2];
        assert!(Levels::new(grid, levels.clone()).is_ok());
        assert!(Levels::new(grid, levels.iter().map(|l| l * 2).collect()).is_err());
    }

    #[test]
    fn runs_tile_a_box() {
        let grid = cells([30, 20, 10]);
        let mut levels = vec![0u8; grid.len() as usize];
        levels[9] = 3;
        Levels::grade(&grid, &mut levels);
        let levels = Levels::new(grid, levels).unwrap();
        let s = grid.lattice.log2_steps[0];
        let b = LatticeBox { lo: [5 << s, 0, 1 << s], hi: [(28 << s) + 7, 9 << s, 9 << s] };
        let mut volume = 0;
        levels.runs(&b, |level, run| {
            volume += run.volume();
            assert_eq!((levels.at(run.lo), levels.at(run.hi.map(|h| h - 1))), (level, level));
        });
        assert_eq!(volume, b.volume());
    }
}
