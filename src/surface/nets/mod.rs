//! Surfaces of labels: surface nets, one closed mesh a label, with walls that neighbours share.
//!
//! # How does it work?
//!
//! A cell lies between eight nodes of the grid; around the grid there is a layer of nodes outside,
//! so cells go half a voxel beyond the outer nodes. A cell whose nodes differ has one vertex, and
//! an edge of the grid whose two nodes differ has one quad, whose corners are the vertices of the
//! four cells around it. Both labels get this quad, one of them turned over (Gibson 1998;
//! Frisken 2022, which VTK's vtkSurfaceNets3D follows).
//!
//! ```text
//!   1   1 │ 2        a quad between a 1 and a 2 belongs to both;
//!         │          where 1, 2 and 3 meet, their walls have the vertex + in common
//!   1   1 + 2
//!      ───┘──
//!   3   3   3
//! ```
//!
//! Vertices lie in the middle of their cells. So a label's mesh is the faces of its voxels, with
//! exactly their volume. Smoothing moves them within their cells ([`smooth`]); it looks at the
//! labels around, and not at which of them were asked for. The diagonal of a quad is the shorter
//! one, by its corners alone.
//!
//! Where a label touches itself, at an edge or a corner of voxels, its mesh has two vertices at one
//! place or more (`loops.rs`). So each mesh is closed and manifold.
//!
//! # Memory and order
//!
//! A block gives [`Side`]s, which say all about their corners. Sorted, those of a label follow each
//! other, layer by layer; [`LabelBuilder`] makes its mesh of them and needs two layers of vertices
//! for it. So neither blocks nor threads show in a mesh.

mod builder;
mod loops;
mod smooth;
#[cfg(test)]
mod tests;

pub use builder::{LabelBuilder, LabelMeshSize};

use bytemuck::{Pod, Zeroable};
use loops::{NO_FACE, edge_number, loops};
use smooth::Offsets;

/// The label of nodes outside the domain, and of missing samples: no label is asked for by it.
pub const NO_LABEL: i32 = i32::MIN;

/// The most steps of smoothing: as many cells around a block are needed.
pub const MOST_STEPS: u32 = 64;

/// Labels of the nodes in a box.
#[derive(Clone, Copy, Debug)]
pub struct LabelBlock<'a> {
    /// The first node; nodes before the grid's first have negative numbers.
    pub start: [i64; 3],
    /// Nodes along each axis, at least two.
    pub size: [usize; 3],
    /// Their labels, x fastest; [`NO_LABEL`] outside the grid.
    pub labels: &'a [i32],
}

/// One side of a quad: that of a label.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub struct Side {
    /// The label.
    pub label: i32,
    /// The first of the quad's four cells: z, y, x.
    cell: [u32; 3],
    /// From the lowest bit on: two bits for the loop of each corner; whether the label is at the
    /// edge's second node; two bits for its axis.
    code: u32,
    /// The corners' offsets from the middle of their cells.
    offsets: [[i16; 3]; 4],
}

/// The four cells around an edge, from the first one on along the two axes after the edge's.
const AROUND: [[usize; 2]; 4] = [[0, 0], [1, 0], [1, 1], [0, 1]];

impl Side {
    /// The axis of the edge.
    fn axis(&self) -> usize {
        (self.code >> 9) as usize
    }

    /// Whether the label is at the edge's second node.
    fn is_second(&self) -> bool {
        self.code >> 8 & 1 == 1
    }

    /// The cell of a corner: x, y, z.
    fn corner_cell(&self, corner: usize) -> [u32; 3] {
        let [z, y, x] = self.cell;
        let mut cell = [x, y, z];
        cell[(self.axis() + 1) % 3] += AROUND[corner][0] as u32;
        cell[(self.axis() + 2) % 3] += AROUND[corner][1] as u32;
        cell
    }

    /// Which of the label's vertices in its cell a corner is.
    fn corner_loop(&self, corner: usize) -> u32 {
        self.code >> (2 * corner) & 3
    }

    /// Whether the diagonal from the second corner is shorter than that from the first.
    fn is_cut_at_second(&self) -> bool {
        let place = |corner: usize| {
            let (cell, offset) = (self.corner_cell(corner), self.offsets[corner]);
            std::array::from_fn::<i64, 3, _>(|a| (i64::from(cell[a]) << 16) + i64::from(offset[a]))
        };
        let squared = |i: usize, j: usize| {
            let (p, q) = (place(i), place(j));
            (0..3).map(|a| (p[a] - q[a]).pow(2)).sum::<i64>()
        };
        squared(1, 3) < squared(0, 2)
    }
}

/// Nodes that a block has around those of its cells, for so many steps of smoothing.
pub fn nodes_around(steps: u32) -> u64 {
    u64::from(steps.max(1))
}

/// Appends the sides of the quads whose first cell is in a box of cells, of labels that are
/// wanted. Cell c lies between nodes c - 1 and c; a grid of n nodes has cells 0 to n.
///
/// The block has the nodes of these cells and of the next ones, and [`nodes_around`] more on each
/// side.
pub fn quads_of(
    block: &LabelBlock<'_>,
    grid: [u64; 3],
    cells: [[u64; 2]; 3],
    steps: u32,
    is_wanted: impl Fn(i32) -> bool,
    out: &mut Vec<Side>,
) {
    let offsets = Offsets::after(steps, block, grid);
    let stride = block.stride();
    let corners = std::array::from_fn(|k| (0..3).map(|a| (k >> a & 1) * stride[a]).sum());
    let quads = Quads { block, offsets, stride, corners };
    let [xs, ys, zs] = cells.map(|[lo, hi]| lo..hi);
    for z in zs {
        for y in ys.clone() {
            for x in xs.clone() {
                let first = block.cell_at([x, y, z]);
                for axis in 0..3 {
                    let [from, to] = quads.nodes(first, axis);
                    let two = [block.labels[from], block.labels[to]];
                    if two[0] == two[1] {
                        continue;
                    }
                    let cell = [z, y, x].map(|n| n as u32);
                    let sides = two.into_iter().enumerate().filter(|(_, label)| is_wanted(*label));
                    out.extend(sides.map(|(n, label)| quads.side(label, cell, first, axis, n == 1)));
                }
            }
        }
    }
}

/// What quads are made of.
struct Quads<'a> {
    block: &'a LabelBlock<'a>,
    offsets: Offsets,
    stride: [usize; 3],
    /// From the first corner of a cell to each.
    corners: [usize; 8],
}

impl Quads<'_> {
    /// The nodes of the edge along an axis of which a cell is the first around.
    fn nodes(&self, first: usize, axis: usize) -> [usize; 2] {
        let from = first + self.stride[(axis + 1) % 3] + self.stride[(axis + 2) % 3];
        [from, from + self.stride[axis]]
    }

    fn side(&self, label: i32, cell: [u32; 3], first: usize, axis: usize, is_second: bool) -> Side {
        let [b, c] = [self.stride[(axis + 1) % 3], self.stride[(axis + 2) % 3]];
        let mut side =
            Side { label, cell, code: (axis as u32) << 9 | u32::from(is_second) << 8, offsets: [[0; 3]; 4] };
        for (corner, [u, v]) in AROUND.into_iter().enumerate() {
            let at = first + u * b + v * c;
            let number = self.loop_of(label, at, edge_number(axis, 1 - u, 1 - v));
            side.code |= u32::from(number) << (2 * corner);
            side.offsets[corner] = self.offsets.of(at);
        }
        side
    }

    /// The loop of a label that crosses an edge of a cell.
    fn loop_of(&self, label: i32, cell: usize, edge: usize) -> u8 {
        let mask = self.mask(label, cell);
        let tied = loops(mask, false).tied;
        let is_turned = tied != NO_FACE && {
            let along = self.stride[usize::from(tied / 2)];
            let behind = if tied % 2 == 1 { cell + along } else { cell - along };
            loops(self.mask(label, behind), false).tied == tied ^ 1
        };
        loops(mask, is_turned).of(edge)
    }

    /// The corners of a cell that have a label.
    fn mask(&self, label: i32, cell: usize) -> u8 {
        let has = |k: usize| u8::from(self.block.labels[cell + self.corners[k]] == label);
        (0..8).fold(0, |mask, k| mask | has(k) << k)
    }
}

impl LabelBlock<'_> {
    /// Places from one node to the next along each axis.
    fn stride(&self) -> [usize; 3] {
        [1, self.size[0], self.size[0] * self.size[1]]
    }

    /// The place of a node of the block, and of the cell of which it is the first.
    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    /// The place of a cell of the grid.
    fn cell_at(&self, cell: [u64; 3]) -> usize {
        self.index([0, 1, 2].map(|a| (cell[a] as i64 - 1 - self.start[a]) as usize))
    }

    /// The inverse of [`Self::index`].
    fn local(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [index % nx, index / nx % ny, index / nx / ny]
    }

    /// The place in the grid of a cell.
    fn cell_place(&self, index: usize) -> [i64; 3] {
        let local = self.local(index);
        [0, 1, 2].map(|a| self.start[a] + local[a] as i64 + 1)
    }

    /// The label at a corner of a cell.
    fn corner(&self, cell: usize, corner: usize) -> i32 {
        let stride = self.stride();
        let along = |a: usize| (corner >> a & 1) * stride[a];
        self.labels[cell + along(0) + along(1) + along(2)]
    }
}
