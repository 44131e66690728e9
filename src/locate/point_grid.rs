//! Points in a grid, through which tetrahedra pass.
//!
//! ```text
//!   ┌───┬───┬───┬───┐     the points of a row of grid cells are one run of memory, so a
//!   │ · │   │·  │ · │     tetrahedron reads one run for each row that its bounding box meets
//!   ├───┼──╱╲───┼───┤
//!   │   │·╱ ·╲  │ · │     most boxes meet a few cells, most of those few have no point:
//!   ├───┼╱────╲─┼───┤     that is a subtraction of two numbers
//!   │ · ╱───────╲   │
//!   └───┴───┴───┴───┘
//! ```

use super::{CellBatch, FinePos, Found, keep, minus, weights};

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
    /// Their numbers.
    numbers: Vec<u32>,
}

/// Points a grid cell, about, at the least.
const POINTS_A_CELL: usize = 1;

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
        let mut grid =
            Self { lo, hi, shift, dims: cells_at(shift), starts: vec![], sorted: vec![], numbers: vec![] };
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
    }

    /// Looks for each point in the cells of a batch; `found[i]` keeps the answer of the lowest id for point i.
    pub fn locate(&self, cells: &CellBatch, found: &mut [Found]) {
        assert_eq!(found.len(), self.numbers.len(), "an answer for each point");
        if found.is_empty() {
            return;
        }
        for (cell, &id) in cells.ids.iter().enumerate() {
            self.locate_cell(cells.corners_of(cell), |number, weights| {
                keep(&mut found[number], id, cell, weights)
            });
        }
    }

    /// The range of grid cells on each axis that a tetrahedron's bounding box meets; `None` if it meets none.
    #[inline]
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

    #[inline]
    fn locate_cell(&self, corners: [FinePos; 4], mut hit: impl FnMut(usize, [f64; 4])) {
        let [a, b, c, d] = corners;
        let lo: FinePos = std::array::from_fn(|k| a[k].min(b[k]).min(c[k].min(d[k])));
        let hi: FinePos = std::array::from_fn(|k| a[k].max(b[k]).max(c[k].max(d[k])));
        let Some([x, y, z]) = self.reach(lo, hi) else { return };
        // Made when the first point lies in the box.
        let mut faces = None;
        for row_z in z.0..=z.1 {
            for row_y in y.0..=y.1 {
                let row = (row_z * self.dims[1] + row_y) * self.dims[0];
                let (from, to) = (self.starts[row + x.0] as usize, self.starts[row + x.1 + 1] as usize);
                for at in from..to {
                    let p = self.sorted[at];
                    // Without branches but the one at the end: most points near a cell are beside it.
                    let within = (lo[0] <= p[0]) & (p[0] <= hi[0]) & (lo[1] <= p[1]) & (p[1] <= hi[1]);
                    let within = within & (lo[2] <= p[2]) & (p[2] <= hi[2]);
                    if !within || faces.get_or_insert_with(|| Faces::new(corners, lo, hi)).is_outside(p) {
                        continue;
                    }
                    if let Some(weights) = weights(corners, p) {
                        hit(self.numbers[at] as usize, weights);
                    }
                }
            }
        }
    }
}

/// The faces of a tetrahedron, to throw out points of its bounding box that are surely outside: three in four or more.
struct Faces {
    /// Inner normals, twice the area long.
    normals: [[f64; 3]; 4],
    /// A corner of each face.
    corners: [FinePos; 4],
    margin: f64,
}

impl Faces {
    /// The faces of a positively oriented tetrahedron with the bounding box `lo` to `hi`.
    ///
    /// # The margin
    /// With P the product of the box's lengths and u = 2^-53: differences are exact; a component of a normal has two products and an error of at
    /// most 4u of their bounds, so a product with a difference, of a point in the box, one of 5u·2P, and their sum one of 30u·P and 2u·6P for
    /// the additions. 64u·P is more.
    fn new([a, b, c, d]: [FinePos; 4], lo: FinePos, hi: FinePos) -> Self {
        const U: f64 = 1.0 / (1u64 << 53) as f64;
        let normal = |p: FinePos, q: FinePos, r: FinePos| {
            let (u, v) = (minus(q, p).map(|x| x as f64), minus(r, p).map(|x| x as f64));
            [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
        };
        let lengths = minus(hi, lo).map(|x| x as f64);
        Self {
            normals: [normal(b, d, c), normal(a, c, d), normal(a, d, b), normal(a, b, c)],
            corners: [b, a, a, a],
            margin: 64.0 * U * lengths[0] * lengths[1] * lengths[2],
        }
    }

    /// Whether a point of the box is outside; false also where rounding cannot tell.
    #[inline]
    fn is_outside(&self, p: FinePos) -> bool {
        let side = |i: usize| {
            let (n, to) = (&self.normals[i], minus(p, self.corners[i]).map(|x| x as f64));
            n[0] * to[0] + n[1] * to[1] + n[2] * to[2] < -self.margin
        };
        side(0) | side(1) | side(2) | side(3)
    }
}
