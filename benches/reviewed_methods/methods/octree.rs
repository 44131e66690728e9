//! The branch-on-need octree (Wilhelms and Van Gelder, "Octrees for faster isosurface
//! generation", 1992).
//!
//! A node holds the range of the values of a cube of cells; one whose range does not hold the
//! isovalue is not entered. The lowest nodes have 2³ cells, the next 4³, and so on: a dimension is
//! halved only as far as there are cells, so that a grid whose sides are no powers of two has no
//! empty nodes, and about a seventh as many nodes as cells. Nodes lie in arrays, a level each;
//! there are no pointers.
//!
//! O(k + k log(n/k)) where the field is smooth; noise makes a query enter everything.

use super::marching::{range_of, scan};
use super::{Cells, Method, coordinates, sample_of};
use isospan::Result;
use isospan::mesh::tet::is_active;

/// Ranges of a level's nodes.
struct Level {
    dims: [usize; 3],
    ranges: Vec<(f32, f32)>,
}

/// All levels, from that of 2³ cells a node to that of one node.
pub(crate) struct Octree {
    levels: Vec<Level>,
}

/// What the children of a node along an axis are: two, or one at the end.
fn pair(i: usize, below: usize) -> std::ops::Range<usize> {
    2 * i..(2 * i + 2).min(below)
}

impl Octree {
    /// `None` for tetrahedra.
    pub(crate) fn new(cells: &Cells<'_>) -> Option<Self> {
        let Cells::Cubes { dims, samples } = *cells else { return None };
        let halved = |dims: [usize; 3]| dims.map(|d| d.div_ceil(2));
        let lowest = halved(dims.map(|d| d - 1));
        let of_samples = |n: usize| {
            let [x, y, z] = coordinates(lowest, n);
            // The samples of two cells along each axis, or of one at the end.
            let [xs, ys, zs] = [(x, 0), (y, 1), (z, 2)].map(|(i, a)| 2 * i..(2 * i + 3).min(dims[a]));
            let rows = zs.flat_map(|z| ys.clone().map(move |y| (y, z)));
            let of_row = |(y, z)| &samples[sample_of(dims, [xs.start, y, z])..][..xs.len()];
            range_of(rows.flat_map(of_row).copied())
        };
        let ranges = (0..lowest.iter().product()).map(of_samples).collect();
        let mut levels = vec![Level { dims: lowest, ranges }];
        while let Some(below) = levels.last().filter(|l| l.ranges.len() > 1) {
            let dims = halved(below.dims);
            let of_children = |n: usize| {
                let ranges = below.children(coordinates(dims, n)).map(|c| below.ranges[c]);
                range_of(ranges.flat_map(|r| [r.0, r.1]))
            };
            let ranges = (0..dims.iter().product()).map(of_children).collect();
            levels.push(Level { dims, ranges });
        }
        Some(Self { levels })
    }

    fn visit(&self, level: usize, node: usize, isovalue: f32, each: &mut impl FnMut([usize; 3])) {
        let Level { dims, ranges } = &self.levels[level];
        let (lo, hi) = ranges[node];
        if !is_active(lo, hi, isovalue) {
            return;
        }
        match level {
            0 => each(coordinates(*dims, node)),
            _ => {
                let below = level - 1;
                let children = self.levels[below].children(coordinates(*dims, node));
                children.for_each(|child| self.visit(below, child, isovalue, each));
            }
        }
    }
}

impl Level {
    /// Nodes of this level that a node of the one above has.
    fn children(&self, [x, y, z]: [usize; 3]) -> impl Iterator<Item = usize> {
        let dims = self.dims;
        let [xs, ys, zs] = [(x, 0), (y, 1), (z, 2)].map(|(i, a)| pair(i, dims[a]));
        zs.flat_map(move |z| ys.clone().map(move |y| (y, z)))
            .flat_map(move |(y, z)| xs.clone().map(move |x| sample_of(dims, [x, y, z])))
    }
}

impl Method for Octree {
    fn bytes(&self) -> u64 {
        self.levels.iter().map(|l| size_of_val(&l.ranges[..]) as u64).sum()
    }

    fn active(&mut self, cells: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()> {
        let Cells::Cubes { dims, samples } = *cells else { unreachable!("an octree is made from cubes") };
        self.visit(self.levels.len() - 1, 0, isovalue, &mut |node| {
            let hi = std::array::from_fn(|a| pair(node[a], dims[a] - 1).end);
            scan([node.map(|i| 2 * i), hi], dims, samples, isovalue, |id, _| found.push(id));
        });
        Ok(())
    }
}
