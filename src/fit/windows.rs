//! The windows of a volume, and which tetrahedra touch each.
//!
//! Windows are cubes of samples on a grid that belongs to the volume, not to a chunk. A window is read where tetrahedra have samples: its
//! box is cut to theirs.

use crate::geom::LatticePos;
use crate::grid::IndexBox;
use crate::mesh::tet::Tet;
use crate::raster::SampleGrid;

/// Samples along an edge of a window, at least: few tetrahedra then touch two of them.
const LEAST_EDGE: u64 = 32;

/// Samples along the edges of a window where bricks have so many cells: bricks, or some of them together.
pub fn window_edge(brick: [u64; 3]) -> [u64; 3] {
    brick.map(|edge| edge * LEAST_EDGE.div_ceil(edge))
}

/// Tetrahedra, window by window.
#[derive(Debug)]
pub struct Windows {
    /// Samples along each edge.
    edge: [u64; 3],
    /// The windows that vertices lie in: first, and past the last.
    lo: [u64; 3],
    dims: [u64; 3],
    /// The samples of each window that tetrahedra may have.
    boxes: Vec<IndexBox>,
    /// End of each window's tetrahedra.
    ends: Vec<u32>,
    tets: Vec<u32>,
}

impl Windows {
    /// Sorts tetrahedra into windows of `edge` samples. Time and memory also grow with the number of windows that the box around all vertices
    /// touches.
    pub fn new(grid: &SampleGrid, edge: [u64; 3], positions: &[LatticePos], tets: &[Tet]) -> Self {
        // The window of the last sample at or before a vertex: a tetrahedron has no sample outside of those of its vertices.
        let at: Vec<[u32; 3]> = positions.iter().map(|&p| window_of(grid, edge, p)).collect();
        let lo = [0, 1, 2].map(|k| u64::from(at.iter().map(|w| w[k]).min().unwrap_or(0)));
        let hi = [0, 1, 2].map(|k| u64::from(at.iter().map(|w| w[k] + 1).max().unwrap_or(0)));
        let dims: [u64; 3] = std::array::from_fn(|k| hi[k].saturating_sub(lo[k]));
        let count = dims.iter().product::<u64>() as usize;
        let nothing = IndexBox { lo: [u64::MAX; 3], hi: [0; 3] };
        let mut windows =
            Self { edge, lo, dims, boxes: vec![nothing; count], ends: vec![0; count], tets: vec![] };
        for tet in tets {
            windows.each_of(&at, tet, |windows, n| windows.ends[n] += 1);
            windows.include(grid, &at, tet, positions);
        }
        let mut sum = 0;
        for n in &mut windows.ends {
            sum += std::mem::replace(n, sum);
        }
        windows.tets = vec![0; sum as usize];
        for (t, tet) in tets.iter().enumerate() {
            windows.each_of(&at, tet, |windows, n| {
                windows.tets[windows.ends[n] as usize] = t as u32;
                windows.ends[n] += 1;
            });
        }
        windows
    }

    /// The windows that have samples, ascending, x first: the box of their samples, and their tetrahedra.
    pub fn iter(&self) -> impl Iterator<Item = (IndexBox, &[u32])> {
        (0..self.ends.len()).filter_map(|n| {
            let start = if n == 0 { 0 } else { self.ends[n - 1] as usize };
            let tets = &self.tets[start..self.ends[n] as usize];
            (!self.boxes[n].is_empty()).then_some((self.boxes[n], tets))
        })
    }

    fn number(&self, w: [u64; 3]) -> usize {
        let [x, y, z] = std::array::from_fn(|k| w[k] - self.lo[k]);
        ((z * self.dims[1] + y) * self.dims[0] + x) as usize
    }

    /// Calls `f` with the number of each window that a tetrahedron's bounding box touches.
    #[inline]
    fn each_of(&mut self, at: &[[u32; 3]], tet: &Tet, mut f: impl FnMut(&mut Self, usize)) {
        let (lo, hi) = bounds(tet.map(|v| at[v as usize]));
        if lo == hi {
            let n = self.number(lo.map(u64::from));
            return f(self, n);
        }
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    let n = self.number([x, y, z].map(u64::from));
                    f(self, n);
                }
            }
        }
    }

    /// Widens the boxes of a tetrahedron's windows to its samples.
    #[inline]
    fn include(&mut self, grid: &SampleGrid, at: &[[u32; 3]], tet: &Tet, positions: &[LatticePos]) {
        let (lo, hi) = bounds(tet.map(|v| positions[v as usize]));
        let samples = grid.within(lo, hi);
        if samples.is_empty() {
            return;
        }
        let edge = self.edge;
        let (first, last) = bounds(tet.map(|v| at[v as usize]));
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let w = [x, y, z].map(u64::from);
                    let n = self.number(w);
                    let own = IndexBox {
                        lo: std::array::from_fn(|k| w[k] * edge[k]),
                        hi: std::array::from_fn(|k| (w[k] + 1) * edge[k]),
                    };
                    let part = own.intersect(&samples);
                    if !part.is_empty() {
                        let b = &mut self.boxes[n];
                        b.lo = std::array::from_fn(|k| b.lo[k].min(part.lo[k]));
                        b.hi = std::array::from_fn(|k| b.hi[k].max(part.hi[k]));
                    }
                }
            }
        }
    }
}

fn window_of(grid: &SampleGrid, edge: [u64; 3], p: LatticePos) -> [u32; 3] {
    let sample = |k: usize| (grid.axes()[k].below(p[k] + 1) as u64).saturating_sub(1);
    std::array::from_fn(|k| (sample(k) / edge[k]) as u32)
}

#[inline]
fn bounds(c: [[u32; 3]; 4]) -> ([u32; 3], [u32; 3]) {
    let [a, b, c, d] = c;
    (
        std::array::from_fn(|k| a[k].min(b[k]).min(c[k].min(d[k]))),
        std::array::from_fn(|k| a[k].max(b[k]).max(c[k].max(d[k]))),
    )
}
