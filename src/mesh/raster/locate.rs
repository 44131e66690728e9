//! Which of some points lie in this tetrahedron?

use super::planes::{Int, LONGEST_64, Planes, bounds};
use isospan_io::geom::{LatticeBox, LatticePos};

/// Points in a box, sorted into cells of equal size, a few a cell: a tetrahedron looks at the cells
/// of its bounding box.
///
/// Memory: 16 bytes a point, 4 a cell; at most two cells a point.
#[derive(Debug)]
pub struct PointLocator {
    region: LatticeBox,
    far: LatticePos,
    /// Cells are cubes of 2^shift lattice steps.
    shift: u32,
    cells: [usize; 3],
    /// End of each cell's points.
    ends: Vec<u32>,
    /// Position and number, cell by cell.
    points: Vec<(LatticePos, u32)>,
}

impl PointLocator {
    /// Sorts those of the points that lie in a box; `far` is the largest position of the domain.
    ///
    /// # Panics
    /// For 2^32 points or more.
    pub fn new(region: LatticeBox, far: LatticePos, points: impl Iterator<Item = (LatticePos, u32)>) -> Self {
        let points: Vec<(LatticePos, u32)> = points.filter(|p| region.contains(p.0)).collect();
        let count = u32::try_from(points.len()).expect("fewer than 2^32 points are located at a time");
        let side = |shift: u32, k: usize| ((region.hi[k].saturating_sub(region.lo[k])) >> shift) as usize + 1;
        let cells_of = |shift: u32| (0..3).map(|k| side(shift, k) as u128).product::<u128>();
        let shift = (0..25).find(|&s| cells_of(s) <= 2 * u128::from(count) + 1).unwrap_or(25);
        let mut locator = Self {
            region,
            far,
            shift,
            cells: std::array::from_fn(|k| side(shift, k)),
            ends: vec![0; cells_of(shift) as usize],
            points: vec![([0; 3], 0); points.len()],
        };
        locator.sort(&points);
        locator
    }

    /// A counting sort.
    fn sort(&mut self, points: &[(LatticePos, u32)]) {
        for p in points {
            let cell = self.cell(self.coordinates(p.0));
            self.ends[cell] += 1;
        }
        let mut sum = 0;
        for n in &mut self.ends {
            sum += std::mem::replace(n, sum);
        }
        for &p in points {
            let cell = self.cell(self.coordinates(p.0));
            self.points[self.ends[cell] as usize] = p;
            self.ends[cell] += 1;
        }
    }

    /// Whether there is no point in the box.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    fn coordinates(&self, p: LatticePos) -> [usize; 3] {
        std::array::from_fn(|k| {
            let inside = p[k].clamp(self.region.lo[k], self.region.hi[k]) - self.region.lo[k];
            (inside >> self.shift) as usize
        })
    }

    fn cell(&self, c: [usize; 3]) -> usize {
        (c[2] * self.cells[1] + c[1]) * self.cells[0] + c[0]
    }

    /// Calls `each` with the number and the weights of every point that belongs to a positively
    /// oriented tetrahedron.
    pub fn each_in(&self, corners: [LatticePos; 4], each: impl FnMut(u32, [f64; 4])) {
        let (lo, hi) = bounds(&corners);
        if (0..3).all(|k| hi[k] - lo[k] <= LONGEST_64) {
            self.each_of::<i64>(corners, each)
        } else {
            self.each_of::<i128>(corners, each)
        }
    }

    /// Calls `each` with the position and the number of every point in a box, both ends included.
    pub fn each_within(&self, lo: LatticePos, hi: LatticePos, mut each: impl FnMut(LatticePos, u32)) {
        let (first, last) = (self.coordinates(lo), self.coordinates(hi));
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                let (from, to) = (self.cell([first[0], y, z]), self.cell([last[0], y, z]));
                let start = if from == 0 { 0 } else { self.ends[from - 1] as usize };
                for &(p, number) in &self.points[start..self.ends[to] as usize] {
                    if (0..3).all(|k| lo[k] <= p[k] && p[k] <= hi[k]) {
                        each(p, number);
                    }
                }
            }
        }
    }

    fn each_of<I: Int>(&self, corners: [LatticePos; 4], mut each: impl FnMut(u32, [f64; 4])) {
        let (lo, hi) = bounds(&corners);
        // Most tetrahedra have no point in their box.
        let mut planes: Option<Planes<I>> = None;
        let (first, last) = (self.coordinates(lo), self.coordinates(hi));
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                let (from, to) = (self.cell([first[0], y, z]), self.cell([last[0], y, z]));
                let start = if from == 0 { 0 } else { self.ends[from - 1] as usize };
                for &(p, number) in &self.points[start..self.ends[to] as usize] {
                    if (0..3).any(|k| p[k] < lo[k] || p[k] > hi[k]) {
                        continue;
                    }
                    let planes = planes.get_or_insert_with(|| Planes::new(corners));
                    if let Some(weights) = planes.weights(p, self.far) {
                        each(number, weights);
                    }
                }
            }
        }
    }
}
