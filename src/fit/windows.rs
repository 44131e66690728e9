//! The windows of a volume, and which tetrahedra touch each.
//!
//! Windows are cubes of samples on a grid that belongs to the volume, not to a chunk. A window is read where tetrahedra have samples: its
//! box is cut to theirs. Where samples lie anywhere, as the vertices of a mesh do, windows are bricks ([`BrickTets`]).

use crate::geom::LatticePos;
use crate::grid::{BrickGrid, BrickId, IndexBox};
use crate::mesh::tet::Tet;
use crate::raster::SampleGrid;

/// Samples along an edge of a window, at least: few tetrahedra then touch two of them.
const LEAST_EDGE: u64 = 32;

/// Samples along the edges of a window where bricks have so many cells: bricks, or some of them together.
pub fn window_edge(brick: [u64; 3]) -> [u64; 3] {
    brick.map(|edge| edge * LEAST_EDGE.div_ceil(edge))
}

/// The window of each vertex, by coordinates.
type Places = [[u32; 3]];

/// Tetrahedra, window by window: a counting sort.
#[derive(Debug)]
struct Sorted {
    /// The first window that a vertex lies in, and how many follow along each axis.
    lo: [u64; 3],
    dims: [u64; 3],
    /// End of each window's tetrahedra.
    ends: Vec<u32>,
    tets: Vec<u32>,
}

impl Sorted {
    fn new(at: &Places, tets: &[Tet]) -> Self {
        let lo = [0, 1, 2].map(|k| u64::from(at.iter().map(|w| w[k]).min().unwrap_or(0)));
        let hi = [0, 1, 2].map(|k| u64::from(at.iter().map(|w| w[k] + 1).max().unwrap_or(0)));
        let dims: [u64; 3] = std::array::from_fn(|k| hi[k].saturating_sub(lo[k]));
        let count = dims.iter().product::<u64>() as usize;
        let mut sorted = Self { lo, dims, ends: vec![0; count], tets: vec![] };
        for tet in tets {
            sorted.each_of(at, tet, |sorted, n| sorted.ends[n] += 1);
        }
        let mut sum = 0;
        for n in &mut sorted.ends {
            sum += std::mem::replace(n, sum);
        }
        sorted.tets = vec![0; sum as usize];
        for (t, tet) in tets.iter().enumerate() {
            sorted.each_of(at, tet, |sorted, n| {
                sorted.tets[sorted.ends[n] as usize] = t as u32;
                sorted.ends[n] += 1;
            });
        }
        sorted
    }

    /// The tetrahedra of each window, ascending, x first.
    fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let starts = std::iter::once(&0).chain(&self.ends);
        starts.zip(&self.ends).map(|(&start, &end)| &self.tets[start as usize..end as usize])
    }

    fn number(&self, w: [u64; 3]) -> usize {
        let [x, y, z] = std::array::from_fn(|k| w[k] - self.lo[k]);
        ((z * self.dims[1] + y) * self.dims[0] + x) as usize
    }

    /// The coordinates of a window.
    fn coordinates(&self, number: usize) -> [u64; 3] {
        let (n, [x, y, _]) = (number as u64, self.dims);
        [self.lo[0] + n % x, self.lo[1] + n / x % y, self.lo[2] + n / x / y]
    }

    /// Calls `f` with the number of each window that a tetrahedron's bounding box touches.
    #[inline]
    fn each_of(&mut self, at: &Places, tet: &Tet, mut f: impl FnMut(&mut Self, usize)) {
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
}

/// Tetrahedra, brick by brick.
#[derive(Debug)]
pub struct BrickTets {
    bricks: BrickGrid,
    sorted: Sorted,
}

impl BrickTets {
    /// Sorts tetrahedra into the bricks that their bounding boxes touch. Time and memory also grow with the number of bricks that the box
    /// around all vertices touches.
    pub fn new(bricks: &BrickGrid, positions: &[LatticePos], tets: &[Tet]) -> Self {
        // A volume has at most 2^24 + 1 samples along an axis.
        let at: Vec<[u32; 3]> = positions.iter().map(|&p| bricks.brick_at(p).map(|c| c as u32)).collect();
        Self { bricks: *bricks, sorted: Sorted::new(&at, tets) }
    }

    /// The bricks that tetrahedra touch, ascending, with these.
    pub fn iter(&self) -> impl Iterator<Item = (BrickId, &[u32])> {
        let all = self.sorted.iter().enumerate().filter(|(_, tets)| !tets.is_empty());
        all.map(|(n, tets)| (self.bricks.id(self.sorted.coordinates(n)), tets))
    }
}

/// Tetrahedra, window by window.
#[derive(Debug)]
pub struct Windows {
    /// Samples along each edge.
    edge: [u64; 3],
    sorted: Sorted,
    /// The samples of each window that tetrahedra may have.
    boxes: Vec<IndexBox>,
}

impl Windows {
    /// Sorts tetrahedra into windows of `edge` samples. Time and memory also grow with the number of windows that the box around all vertices
    /// touches.
    pub fn new(grid: &SampleGrid, edge: [u64; 3], positions: &[LatticePos], tets: &[Tet]) -> Self {
        // The window of the last sample at or before a vertex: a tetrahedron has no sample outside of those of its vertices.
        let at: Vec<[u32; 3]> = positions.iter().map(|&p| window_of(grid, edge, p)).collect();
        let sorted = Sorted::new(&at, tets);
        let nothing = IndexBox { lo: [u64::MAX; 3], hi: [0; 3] };
        let boxes = vec![nothing; sorted.ends.len()];
        let mut windows = Self { edge, sorted, boxes };
        for tet in tets {
            windows.include(grid, &at, tet, positions);
        }
        windows
    }

    /// The windows that have samples, ascending, x first: the box of their samples, and their tetrahedra.
    pub fn iter(&self) -> impl Iterator<Item = (IndexBox, &[u32])> {
        let all = self.boxes.iter().zip(self.sorted.iter());
        all.filter(|(samples, _)| !samples.is_empty()).map(|(samples, tets)| (*samples, tets))
    }

    /// Widens the boxes of a tetrahedron's windows to its samples.
    #[inline]
    fn include(&mut self, grid: &SampleGrid, at: &Places, tet: &Tet, positions: &[LatticePos]) {
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
                    let n = self.sorted.number(w);
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
