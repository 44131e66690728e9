//! The extrema graph (Itoh and Koyamada, "Isosurface extraction by using extrema graphs", 1994).
//!
//! Every piece of an isosurface separates a local maximum from a local minimum. So a graph that
//! joins all local extrema crosses every piece: its edges that hold the isovalue are walked until a
//! cell is active, and from there the piece is followed from face to face, with a queue and a mark
//! for each cell that was seen.
//!
//! Why no piece is missed: let M be the grid's edges of a piece, from inside to outside corners. A
//! square of the grid has an even number of them, all of the same piece, so M is the border between
//! two classes of corners (a box has no holes); all of M's corners of one class are inside, of the
//! other outside. The largest value of the first class is then a local maximum of the whole grid,
//! the smallest of the other a local minimum: both are nodes of the graph, and a path between them
//! uses an edge of M.
//!
//! Where we depart: extrema on the boundary are nodes too, so that there is no list of boundary
//! cells to be looked through; a connected set of equal samples is one extremum; and nodes are
//! joined in the order of a Hilbert curve, by paths along the axes which, following from their
//! ends, are not stored.
//!
//! Fast where there are few extrema. Noise has one every few samples, and then the graph has as
//! many edges.

use super::{CORNERS, Cells, Method, NOTHING, coordinates, sample_of};
use isospan::Result;
use isospan::geom::curve::hilbert_key;
use isospan::mesh::tet::is_active;
use std::collections::VecDeque;

/// A path between two extrema, and the range of its samples.
struct Path {
    ends: [u32; 2],
    min: f32,
    max: f32,
}

/// The graph, and marks of cells.
pub(crate) struct ExtremaGraph {
    paths: Vec<Path>,
    seen: Vec<u64>,
    queue: VecDeque<u32>,
}

impl ExtremaGraph {
    /// `None` for tetrahedra.
    pub(crate) fn new(cells: &Cells<'_>) -> Option<Self> {
        let Cells::Cubes { dims, samples } = *cells else { return None };
        let nodes = along_a_curve(extrema(dims, samples), dims);
        let path = |pair: &[u32]| {
            let ends = [pair[0], pair[1]];
            let along = walk(dims, ends).map(|n| samples[n]);
            let (min, max) = along.fold(NOTHING, |(lo, hi), v| (lo.min(v), hi.max(v)));
            Path { ends, min, max }
        };
        let paths = nodes.windows(2).map(path).collect();
        Some(Self { paths, seen: vec![0; cells.len().div_ceil(64)], queue: VecDeque::new() })
    }

    fn put(&mut self, cell: usize, found: &mut Vec<u32>) {
        let (word, bit) = (cell / 64, 1 << (cell % 64));
        if self.seen[word] & bit == 0 {
            self.seen[word] |= bit;
            self.queue.push_back(cell as u32);
            found.push(cell as u32);
        }
    }

    /// Follows the pieces of the cells in the queue.
    fn follow(&mut self, dims: [usize; 3], samples: &[f32], isovalue: f32, found: &mut Vec<u32>) {
        let cubes = dims.map(|d| d - 1);
        while let Some(cell) = self.queue.pop_front() {
            let at = coordinates(cubes, cell as usize);
            let first = sample_of(dims, at);
            let bits = CORNERS.iter().enumerate().fold(0u8, |bits, (n, &c)| {
                bits | u8::from(samples[first + sample_of(dims, c)] >= isovalue) << n
            });
            for axis in 0..3 {
                // The corners of the face on the lower side.
                let face = [0b0101_0101u8, 0b0011_0011, 0b0000_1111][axis];
                for (mask, inner, step) in
                    [(face, at[axis] > 0, usize::MAX), (!face, at[axis] + 1 < cubes[axis], 1)]
                {
                    if inner && bits & mask != 0 && bits & mask != mask {
                        let mut next = at;
                        next[axis] = next[axis].wrapping_add(step);
                        self.put(sample_of(cubes, next), found);
                    }
                }
            }
        }
    }
}

impl Method for ExtremaGraph {
    fn bytes(&self) -> u64 {
        let queue = self.queue.capacity() * size_of::<u32>();
        (size_of_val(&self.paths[..]) + size_of_val(&self.seen[..]) + queue) as u64
    }

    fn active(&mut self, cells: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()> {
        let Cells::Cubes { dims, samples } = *cells else { unreachable!("a graph is made from cubes") };
        let before = found.len();
        for n in 0..self.paths.len() {
            let Path { ends, min, max } = self.paths[n];
            if !is_active(min, max, isovalue) {
                continue;
            }
            let mut last = ends[0] as usize;
            for next in walk(dims, ends) {
                if (samples[last] >= isovalue) != (samples[next] >= isovalue) {
                    self.put(cell_at(dims, last, next), found);
                    self.follow(dims, samples, isovalue, found);
                }
                last = next;
            }
        }
        found[before..].iter().for_each(|&cell| self.seen[cell as usize / 64] = 0);
        Ok(())
    }
}

/// A cell that has the edge between two samples.
fn cell_at(dims: [usize; 3], a: usize, b: usize) -> usize {
    let at = coordinates(dims, a.min(b));
    sample_of(dims.map(|d| d - 1), std::array::from_fn(|k| at[k].min(dims[k] - 2)))
}

/// Samples from one to another, along x, then y, then z, with both ends.
fn walk(dims: [usize; 3], [from, to]: [u32; 2]) -> impl Iterator<Item = usize> {
    let [mut at, to] = [from, to].map(|n| coordinates(dims, n as usize));
    let mut begun = false;
    std::iter::from_fn(move || {
        if begun {
            let axis = (0..3).find(|&a| at[a] != to[a])?;
            at[axis] = if at[axis] < to[axis] { at[axis] + 1 } else { at[axis] - 1 };
        }
        begun = true;
        Some(sample_of(dims, at))
    })
}

fn neighbours(dims: [usize; 3], n: usize) -> impl Iterator<Item = usize> {
    let at = coordinates(dims, n);
    let strides = [1, dims[0], dims[0] * dims[1]];
    (0..3).flat_map(move |a| {
        let down = (at[a] > 0).then(|| n - strides[a]);
        down.into_iter().chain((at[a] + 1 < dims[a]).then(|| n + strides[a]))
    })
}

/// A sample of each connected set of equal samples that has no larger neighbour, or no smaller one.
fn extrema(dims: [usize; 3], samples: &[f32]) -> Vec<u32> {
    let mut done = vec![false; samples.len()];
    let (mut out, mut open) = (vec![], vec![]);
    for first in 0..samples.len() {
        if done[first] {
            continue;
        }
        done[first] = true;
        open.push(first);
        let (mut larger, mut smaller) = (false, false);
        while let Some(n) = open.pop() {
            for m in neighbours(dims, n) {
                larger |= samples[m] > samples[n];
                smaller |= samples[m] < samples[n];
                if samples[m] == samples[n] && !done[m] {
                    done[m] = true;
                    open.push(m);
                }
            }
        }
        if !larger || !smaller {
            out.push(first as u32);
        }
    }
    out
}

fn along_a_curve(mut nodes: Vec<u32>, dims: [usize; 3]) -> Vec<u32> {
    const BITS: u32 = 12;
    nodes.sort_by_cached_key(|&n| {
        hilbert_key(coordinates(dims, n as usize).map(|c| (c as u32) << (24 - BITS)), BITS)
    });
    nodes
}
