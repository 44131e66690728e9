//! Points in a grid, through which tetrahedra pass.
//!
//! ```text
//!   ┌───┬───┬───┬───┐     the points of a row of grid cells are one run of memory, so a
//!   │ · │   │·  │ · │     tetrahedron reads one run for each row that its bounding box meets
//!   ├───┼──╱╲───┼───┤
//!   │   │·╱ ·╲  │ · │     eight points of a run at a time are held against the planes of its
//!   ├───┼╱────╲─┼───┤     faces, in f32: most are surely outside, and few that are not are in
//!   │ · ╱───────╲   │     the tetrahedron's exact test for nothing
//!   └───┴───┴───┴───┘
//! ```

use super::{CellBatch, CellHit, FinePos, keep, weights};
use crate::simd::with_vectors;
use isospan_io::geom::vec3::{cross, minus};

/// Points to be located, sorted into a grid.
#[derive(Clone, Debug)]
pub struct PointGrid {
    /// Smallest coordinates of the points.
    lo: FinePos,
    /// Largest.
    hi: FinePos,
    /// log2 of the fine steps of a grid cell's edge.
    shift: u32,
    dims: [usize; 3],
    /// Where each grid cell's points begin; x fastest; one more than cells.
    starts: Vec<u32>,
    /// Positions, by grid cell.
    sorted: Vec<FinePos>,
    /// The same from `lo`, rounded, as columns; some points more than there are, so that the last
    /// can be read as one of eight.
    columns: [Vec<f32>; 3],
    /// Their numbers.
    numbers: Vec<u32>,
}

/// Points a grid cell, about, at the least.
const POINTS_A_CELL: usize = 2;
/// Points that are held against planes at a time.
const LANES: usize = 8;

impl PointGrid {
    /// Sorts points into a grid, in time proportional to their number; fewer than 2^32.
    pub fn new(points: &[FinePos]) -> Self {
        let bound = |pick: fn(i64, i64) -> i64, start: i64| {
            points.iter().fold([start; 3], |m, p| std::array::from_fn(|a| pick(m[a], p[a])))
        };
        let (lo, hi) = (bound(i64::min, i64::MAX), bound(i64::max, 0));
        let (lo, hi) = if points.is_empty() { ([0; 3], [0; 3]) } else { (lo, hi) };
        let cells_at =
            |shift: u32| -> [usize; 3] { std::array::from_fn(|a| ((hi[a] - lo[a]) >> shift) as usize + 1) };
        let product = |d: [usize; 3]| d.iter().map(|&n| n as u128).product::<u128>();
        let most = (points.len() / POINTS_A_CELL).max(1) as u128;
        let shift = (0..40).find(|&s| product(cells_at(s)) <= most).unwrap_or(40);
        let dims = cells_at(shift);
        let columns = [(); 3].map(|()| vec![0.0; points.len() + LANES]);
        let mut grid = Self { lo, hi, shift, dims, starts: vec![], sorted: vec![], columns, numbers: vec![] };
        grid.fill(points);
        grid
    }

    /// A counting sort by grid cell.
    fn fill(&mut self, points: &[FinePos]) {
        let cells: usize = self.dims.iter().product();
        self.starts = vec![0; cells + 1];
        let cell_of = |p: &FinePos| {
            let c: [usize; 3] = std::array::from_fn(|a| ((p[a] - self.lo[a]) >> self.shift) as usize);
            (c[2] * self.dims[1] + c[1]) * self.dims[0] + c[0]
        };
        let of: Vec<u32> = points.iter().map(|p| cell_of(p) as u32).collect();
        for &c in &of {
            self.starts[c as usize + 1] += 1;
        }
        for c in 0..cells {
            self.starts[c + 1] += self.starts[c];
        }
        let mut next = self.starts.clone();
        (self.sorted, self.numbers) = (vec![[0; 3]; points.len()], vec![0; points.len()]);
        for (i, (p, &c)) in points.iter().zip(&of).enumerate() {
            let at = next[c as usize] as usize;
            next[c as usize] += 1;
            self.sorted[at] = *p;
            self.numbers[at] = i as u32;
        }
        for (a, column) in self.columns.iter_mut().enumerate() {
            column.iter_mut().zip(&self.sorted).for_each(|(x, p)| *x = (p[a] - self.lo[a]) as f32);
        }
    }

    /// Looks for each point in the cells of a batch; `found[i]` keeps the answer of the lowest id
    /// for point i.
    pub fn locate(&self, cells: &CellBatch, found: &mut [CellHit]) {
        assert_eq!(found.len(), self.numbers.len(), "an answer for each point");
        if !found.is_empty() {
            with_vectors(|| self.locate_all(cells, found));
        }
    }

    #[inline(always)]
    fn locate_all(&self, cells: &CellBatch, found: &mut [CellHit]) {
        let size = minus(self.hi, self.lo).map(|x| x as f64);
        for (cell, &id) in cells.ids.iter().enumerate() {
            self.locate_cell(cells.corners_of(cell), size, |number, weights| {
                keep(&mut found[number], id, cell, weights)
            });
        }
    }

    /// The range of grid cells on each axis that a tetrahedron's bounding box meets; `None` if it
    /// meets none.
    #[inline(always)]
    fn reach(&self, lo: FinePos, hi: FinePos) -> Option<[(usize, usize); 3]> {
        let mut reach = [(0, 0); 3];
        for a in 0..3 {
            let (first, last) = (lo[a].max(self.lo[a]), hi[a].min(self.hi[a]));
            if first > last {
                return None;
            }
            let cell = |p: i64| ((p - self.lo[a]) >> self.shift) as usize;
            reach[a] = (cell(first), cell(last));
        }
        Some(reach)
    }

    #[inline(always)]
    fn locate_cell(&self, corners: [FinePos; 4], size: [f64; 3], mut hit: impl FnMut(usize, [f64; 4])) {
        let [a, b, c, d] = corners;
        let lo: FinePos = std::array::from_fn(|k| a[k].min(b[k]).min(c[k].min(d[k])));
        let hi: FinePos = std::array::from_fn(|k| a[k].max(b[k]).max(c[k].max(d[k])));
        let Some([x, y, z]) = self.reach(lo, hi) else { return };
        // Made for the first run that has points.
        let mut planes = None;
        for row_z in z.0..=z.1 {
            for row_y in y.0..=y.1 {
                let row = (row_z * self.dims[1] + row_y) * self.dims[0];
                let (mut at, to) = (self.starts[row + x.0] as usize, self.starts[row + x.1 + 1] as usize);
                if at == to {
                    continue;
                }
                let planes = planes.get_or_insert_with(|| Planes::new(corners, self.lo, minus(hi, lo), size));
                while at < to {
                    let run = &self.columns;
                    let eight =
                        |k: usize| run[k][at..at + LANES].first_chunk().expect("some more than points");
                    let mut left = planes.not_outside([eight(0), eight(1), eight(2)]);
                    left &= !(u32::MAX << (to - at).min(LANES));
                    while left != 0 {
                        let i = at + left.trailing_zeros() as usize;
                        left &= left - 1;
                        if let Some(weights) = weights(corners, self.sorted[i]) {
                            hit(self.numbers[i] as usize, weights);
                        }
                    }
                    at += LANES;
                }
            }
        }
    }
}

/// The planes of a tetrahedron's faces, to throw out points that are surely outside.
struct Planes {
    /// Inner normals, twice the area long; by axis.
    normals: [[f32; 4]; 3],
    /// A point with a smaller product with the normal is outside.
    least: [f32; 4],
}

impl Planes {
    /// The planes of a positively oriented tetrahedron whose bounding box is `sides` long and meets
    /// that of the points, which begins at `lo` and is `size` long.
    ///
    /// # The margin
    /// Let L be the lengths of the tetrahedron's box and D those of both boxes together. A
    /// component of a normal is at most B_x = 2·L_y·L_z, and so on; a coordinate of a point or a
    /// corner less `lo`, at most D. With W = Σ B·D and u = 2^-24 the errors in f32 are: of the
    /// points' coordinates, of the normals, of the three products and of `least` at most u·W each,
    /// of the two sums u·W each; those in f64 are below 2^-48·W. 8u·W is more than all of them and
    /// what they do to each other. The largest number is W < 2^119.
    #[inline(always)]
    fn new([a, b, c, d]: [FinePos; 4], lo: FinePos, sides: [i64; 3], size: [f64; 3]) -> Self {
        const U: f64 = 1.0 / (1u32 << 24) as f64;
        let [u, v, w] = [b, c, d].map(|p| minus(p, a).map(|x| x as f64));
        // The fourth is what the others lack of a closed surface.
        let (of_b, of_c, of_d) = (cross(v, w), cross(w, u), cross(u, v));
        let of_a: [f64; 3] = std::array::from_fn(|k| -(of_b[k] + of_c[k] + of_d[k]));
        let sides = sides.map(|x| x as f64);
        let wide: f64 =
            (0..3).map(|k| 2.0 * sides[(k + 1) % 3] * sides[(k + 2) % 3] * (size[k] + sides[k])).sum();
        let (at_a, at_b) = (minus(a, lo).map(|x| x as f64), minus(b, lo).map(|x| x as f64));
        let least =
            |n: [f64; 3], at: [f64; 3]| (n[0] * at[0] + n[1] * at[1] + n[2] * at[2] - 8.0 * U * wide) as f32;
        Self {
            normals: [0, 1, 2].map(|k| [of_a[k] as f32, of_b[k] as f32, of_c[k] as f32, of_d[k] as f32]),
            least: [least(of_a, at_b), least(of_b, at_a), least(of_c, at_a), least(of_d, at_a)],
        }
    }

    /// Bit i is clear where point i is outside.
    #[inline(always)]
    fn not_outside(&self, [x, y, z]: [&[f32; LANES]; 3]) -> u32 {
        // One instruction, as nothing is NaN here.
        let least = |a: f32, b: f32| if a < b { a } else { b };
        let mut over = [0.0f32; LANES];
        for i in 0..LANES {
            let side = |f: usize| {
                self.normals[0][f] * x[i] + self.normals[1][f] * y[i] + self.normals[2][f] * z[i]
                    - self.least[f]
            };
            over[i] = least(least(side(0), side(1)), least(side(2), side(3)));
        }
        (0..LANES).map(|i| u32::from(over[i] >= 0.0) << i).sum()
    }
}
