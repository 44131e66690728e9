//! The methods that the thesis reviews (its section 1.2), for comparison with ours: here is an
//! isovalue, which cells are active?
//!
//! | method | keeps | a query looks at |
//! |---|---|---|
//! | marching cubes ([`marching`]) | nothing | every cell |
//! | branch-on-need octree ([`octree`]) | ranges of cubes of 2³, 4³, … cells | nodes whose range holds the isovalue |
//! | extrema graph ([`extrema_graph`]) | paths between local extrema | paths, then neighbours of active cells |
//! | active list ([`active_list`]) | cells sorted by minimum and by maximum | what lies between two isovalues |
//! | span filter ([`span_filter`]) | cells by bucket and length of their range | buckets that may hold the isovalue |
//! | sweeping simplices ([`sweeping_simplices`]) | both sorted lists, in groups, with flags | the group of each level |
//! | NOISE ([`noise`]) | a kd-tree of the cells' (min, max) | O(√n + k) nodes |
//! | isospan ([`blocks`]) | a kd-tree of (min, max) of blocks of 1024 cells, on disk | pages, then the cells of active blocks |
//!
//! A cell is active when `min < isovalue <= max`. All find the same cells, in orders of their own;
//! nothing is triangulated. Values are finite numbers.
//!
//! Memory is what a method holds besides the values (and corners) themselves. A method that must
//! look at a cell whose range it does not hold reads its corners.

pub(crate) mod active_list;
pub(crate) mod blocks;
pub(crate) mod extrema_graph;
pub(crate) mod marching;
pub(crate) mod noise;
pub(crate) mod octree;
pub(crate) mod span_filter;
pub(crate) mod sweeping_simplices;
#[cfg(test)]
mod tests;
pub(crate) mod volume;

use isospan::mesh::tet::{self, Tet, is_active};
use isospan::{Error, Result};
use std::time::Instant;

/// What is searched.
#[derive(Clone, Copy)]
pub(crate) enum Cells<'a> {
    /// The cubes of a structured grid; cell (i, j, k) is number (k·(ny-1) + j)·(nx-1) + i.
    Cubes {
        /// Samples along each axis, at least 2.
        dims: [usize; 3],
        /// x fastest.
        samples: &'a [f32],
    },
    /// Tetrahedra, in an order in which neighbours are close.
    Tets {
        /// Of the vertices.
        values: &'a [f32],
        /// Vertices of each.
        corners: &'a [Tet],
    },
}

impl Cells<'_> {
    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Cubes { dims, .. } => dims.iter().map(|d| d - 1).product(),
            Self::Tets { corners, .. } => corners.len(),
        }
    }

    /// Smallest and largest value of a cell's corners.
    pub(crate) fn range(&self, id: usize) -> (f32, f32) {
        match *self {
            Self::Cubes { dims, samples } => {
                let first = sample_of(dims, coordinates(dims.map(|d| d - 1), id));
                CORNERS
                    .iter()
                    .map(|c| samples[first + sample_of(dims, *c)])
                    .fold(NOTHING, |(lo, hi), v| (lo.min(v), hi.max(v)))
            }
            Self::Tets { values, corners } => {
                tet::range(corners[id].map(|v| values[v as usize])).expect("values are numbers")
            }
        }
    }

    /// Ranges of all cells, in their order.
    pub(crate) fn ranges(&self) -> impl Iterator<Item = (f32, f32)> + '_ {
        (0..self.len()).map(|id| self.range(id))
    }

    /// Smallest and largest value of all cells.
    pub(crate) fn bounds(&self) -> (f32, f32) {
        self.ranges().fold(NOTHING, |(lo, hi), r| (lo.min(r.0), hi.max(r.1)))
    }
}

/// The range of no values.
pub(crate) const NOTHING: (f32, f32) = (f32::INFINITY, f32::NEG_INFINITY);

/// Corners of a cube.
pub(crate) const CORNERS: [[usize; 3]; 8] =
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]];

/// The number of a place, x fastest.
pub(crate) fn sample_of(dims: [usize; 3], [x, y, z]: [usize; 3]) -> usize {
    (z * dims[1] + y) * dims[0] + x
}

/// The place of a number.
pub(crate) fn coordinates(dims: [usize; 3], n: usize) -> [usize; 3] {
    [n % dims[0], n / dims[0] % dims[1], n / dims[0] / dims[1]]
}

/// A method that has looked at the cells.
pub(crate) trait Method {
    /// Bytes that it holds, besides values and corners, in memory or on disk.
    fn bytes(&self) -> u64;

    /// Appends the active cells, each once. `cells` are those that it was made from.
    fn active(&mut self, cells: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()>;
}

/// A method; `None` where it is not for such cells.
type Made = Result<Option<Box<dyn Method>>>;

/// A method by name, and how it is made.
pub(crate) struct Kind {
    pub(crate) name: &'static str,
    pub(crate) make: fn(&Cells<'_>) -> Made,
}

/// All methods, in the order of the thesis.
pub(crate) const KINDS: [Kind; 8] = [
    Kind { name: "marching", make: |_| Ok(Some(Box::new(marching::Marching))) },
    Kind { name: "branch-on-need octree", make: |c| Ok(octree::Octree::new(c).map(boxed)) },
    Kind { name: "extrema graph", make: |c| Ok(extrema_graph::ExtremaGraph::new(c).map(boxed)) },
    Kind { name: "active list", make: |c| Ok(Some(Box::new(active_list::ActiveList::new(c)))) },
    Kind { name: "span filter", make: |c| Ok(Some(Box::new(span_filter::SpanFilter::new(c)))) },
    Kind {
        name: "sweeping simplices",
        make: |c| Ok(Some(Box::new(sweeping_simplices::SweepingSimplices::new(c)))),
    },
    Kind { name: "NOISE, kd-tree of cells", make: |c| Ok(Some(Box::new(noise::Noise::new(c)))) },
    Kind {
        name: "isospan, kd-tree of blocks on disk",
        make: |c| Ok(Some(Box::new(blocks::Blocks::new(c)?))),
    },
];

fn boxed<M: Method + 'static>(method: M) -> Box<dyn Method> {
    Box::new(method)
}

/// What one method takes.
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) build_seconds: f64,
    pub(crate) bytes: u64,
    /// Of each isovalue, the median.
    pub(crate) query_seconds: Vec<f64>,
}

/// Isovalues with few and with many active cells, each with their number.
pub(crate) fn few_and_many(cells: &Cells<'_>) -> [(f32, usize); 2] {
    const TRIED: usize = 64;
    let (lo, hi) = cells.bounds();
    let at = |i: usize| lo + (hi - lo) * (i as f32 / TRIED as f32);
    let mut counts = [0usize; TRIED];
    for (min, max) in cells.ranges() {
        (1..TRIED).filter(|&i| is_active(min, max, at(i))).for_each(|i| counts[i] += 1);
    }
    let all = (1..TRIED).filter(|&i| counts[i] > 0).map(|i| (at(i), counts[i]));
    let few = all.clone().min_by_key(|a| a.1).unwrap_or((hi, 0));
    [few, all.max_by_key(|a| a.1).unwrap_or(few)]
}

/// Builds and asks every method that is for such cells, and checks each answer's size. Isovalues
/// take turns, so that a method that remembers the one before is asked for another.
pub(crate) fn compare(cells: &Cells<'_>, isovalues: &[(f32, usize)], repeats: usize) -> Result<Vec<Row>> {
    let mut rows = vec![];
    for kind in &KINDS {
        let started = Instant::now();
        let Some(mut method) = (kind.make)(cells)? else { continue };
        let build_seconds = started.elapsed().as_secs_f64();
        let mut seconds = vec![vec![]; isovalues.len()];
        let mut found = vec![];
        for _ in 0..repeats {
            for (&(isovalue, count), seconds) in isovalues.iter().zip(&mut seconds) {
                found.clear();
                let started = Instant::now();
                method.active(cells, isovalue, &mut found)?;
                seconds.push(started.elapsed().as_secs_f64());
                if found.len() != count {
                    let (name, n) = (kind.name, found.len());
                    return Err(Error::usage(format!("{name} finds {n} of {count} active cells")));
                }
            }
        }
        let query_seconds = seconds.into_iter().map(median).collect();
        rows.push(Row { name: kind.name, build_seconds, bytes: method.bytes(), query_seconds });
    }
    Ok(rows)
}

/// The middle one; NaN of none.
pub(crate) fn median(mut all: Vec<f64>) -> f64 {
    all.sort_unstable_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(f64::NAN)
}
