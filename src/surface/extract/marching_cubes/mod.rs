//! Marching cubes on blocks of a grid.
//!
//! # How does it work?
//!
//! A node whose value is `>= isovalue` is *inside*. A cell has eight nodes, and the surface cuts it
//! in at most five triangles, by the rule of `cases.rs`: on a face with two diagonal corners inside
//! these are kept apart. Both cells at a face see the same four nodes, so their triangles meet
//! there without a gap. Cuts of loops do not lie in faces, so no edge has more than two triangles.
//!
//! A cell with a NaN node is *void* and gives nothing, neither surface nor cap.
//!
//! # Where is a vertex?
//!
//! On the edge (a, b) of neighbouring nodes, a the lower one, at `t = (isovalue - f_a) / (f_b -
//! f_a)`, which stays as far from the ends as in [`super::marching_tets`], and for the same reason.
//! Index space counts samples of the source: a node lies at its number times the stride.
//!
//! # Which way is its normal?
//!
//! Minus the gradient: central differences at the two nodes, interpolated along the edge. A
//! difference is one-sided where the grid ends or has no data. Where the gradient has no direction,
//! that of the edge is used. So a window has one more node on each side, and position and normal
//! are functions of the edge, whichever block it is made by. Normals need no sums, unlike those of
//! tetrahedra.
//!
//! # Caps
//!
//! On each face of the grid the inside part of each cell's square, by the same rule (`caps.rs`).
//! Surface and caps together are closed, but for void cells.
//!
//! # Cost
//!
//! One pass over rows of cells. Which nodes are inside is a bit each, so 64 cells without a
//! crossing take a few operations (`rows.rs`). The vertex of an edge is found by the edge's place
//! in two planes: 4 bytes for each edge of two planes, nothing is hashed.
//!
//! # References
//! Lorensen, Cline 1987, "Marching cubes: a high resolution 3D surface construction algorithm".
//! Schroeder, Maynard, Geveci 2015, "Flying edges: a high-performance scalable isocontouring
//! algorithm": the same number of triangles in each case.

mod caps;
mod cases;
mod rows;
mod share;
mod vertices;

use super::chunk_surface::ChunkSurface;
use crate::surface::world_map::WorldMap;
use cases::{CASES, lower_corner};
use rows::Plane;

pub use share::share_inside;

/// Nodes of a box of a grid, as they are stored: x fastest, NaN where there is no data.
#[derive(Clone, Copy, Debug)]
pub struct GridBlock<'a> {
    /// Nodes of the whole grid along x, y, z.
    pub grid: [u64; 3],
    /// Samples of the source from one node to the next along each axis.
    pub stride: [u64; 3],
    /// The first node of the window.
    pub start: [u64; 3],
    /// Nodes of the window along each axis.
    pub size: [usize; 3],
    /// The values of the window's nodes.
    pub values: &'a [f32],
    /// The cells whose surface is wanted, from the first to past the last along each axis: cell i
    /// lies between nodes i and i + 1. The window has all their nodes, and one more on each side
    /// where the grid has one.
    pub cells: [[u64; 2]; 3],
}

/// Buffers in which marching cubes work: some bytes for each node of two planes. One is enough for
/// all blocks that a thread works on.
#[derive(Debug, Default)]
pub struct CubeBench {
    /// The planes of nodes below and above a layer of cells.
    planes: [Plane; 2],
    /// For each section the number of a vertex plus one, by the place of its edge or node in its
    /// plane. Numbers of earlier planes are left, and told by being low.
    vertices: Vec<u32>,
}

/// Extracts a block; `world` is [`WorldMap::of_samples`] of the source. For several blocks use the
/// three methods that this calls.
///
/// # Panics
/// When the window does not have the nodes that it must have.
pub fn marching_cubes(
    block: &GridBlock<'_>,
    isovalue: f32,
    caps: bool,
    world: &WorldMap,
    bench: &mut CubeBench,
    out: &mut ChunkSurface,
) {
    out.start(isovalue, 0);
    out.add_cubes(block, caps, world, bench);
    out.finish(world);
}

impl ChunkSurface {
    /// Adds the surface of a block, and its caps where the grid ends if `caps` says so. A vertex
    /// that several blocks have is added by each of them, and welded by its edge.
    ///
    /// # Panics
    /// When the window does not have the nodes that it must have.
    pub fn add_cubes(&mut self, block: &GridBlock<'_>, caps: bool, world: &WorldMap, bench: &mut CubeBench) {
        block.check();
        let cells = block.cells.map(|[lo, hi]| hi.saturating_sub(lo) as usize);
        if cells.contains(&0) {
            return;
        }
        let mut march = March::new(block, cells, caps, world, bench, self);
        march.look(0);
        for z in 0..cells[2] {
            march.add_layer(z);
        }
    }
}

impl GridBlock<'_> {
    fn check(&self) {
        let [x, y, z] = self.size;
        assert_eq!(self.values.len(), x * y * z, "the window has a value for each node");
        for k in 0..3 {
            let ([lo, hi], start, end) = (self.cells[k], self.start[k], self.start[k] + self.size[k] as u64);
            let wanted = lo.saturating_sub(1)..(hi + 2).min(self.grid[k]);
            let is_whole =
                hi < self.grid[k] && start <= wanted.start && wanted.end <= end && end <= self.grid[k];
            assert!(lo >= hi || is_whole, "the window has the nodes of its cells and one more on each side");
        }
    }
}

/// The sections of [`CubeBench::vertices`]: x and y edges of the lower and upper plane, edges
/// between these, and nodes of the lower and upper plane.
const BETWEEN: usize = 4;
const NODES: usize = 5;
const SECTIONS: usize = 7;

/// A block while it is worked on.
struct March<'a> {
    block: &'a GridBlock<'a>,
    world: &'a WorldMap,
    caps: bool,
    /// Cells along each axis.
    cells: [usize; 3],
    /// The place in the window of the first cell's lower node, and from one node to the next along
    /// each axis.
    first: usize,
    step: [usize; 3],
    /// Words of a row of bits, nodes of a row and of a plane.
    words: usize,
    row: usize,
    section: usize,
    planes: &'a mut [Plane; 2],
    vertices: &'a mut [u32],
    out: &'a mut ChunkSurface,
    layer: Layer,
    differences: vertices::Differences,
    outwards: [[f32; 3]; 6],
}

/// Where the edges and nodes of the first cell of a layer are among the vertices, and which numbers
/// there are not left from other planes: those above.
#[derive(Default)]
struct Layer {
    z: usize,
    edges: [Slot; 12],
    nodes: [Slot; 8],
}

#[derive(Clone, Copy, Default)]
struct Slot {
    at: usize,
    above: u32,
}

impl<'a> March<'a> {
    fn new(
        block: &'a GridBlock<'a>,
        cells: [usize; 3],
        caps: bool,
        world: &'a WorldMap,
        CubeBench { planes, vertices }: &'a mut CubeBench,
        out: &'a mut ChunkSurface,
    ) -> Self {
        let step = [1, block.size[0], block.size[0] * block.size[1]];
        let first = (0..3).map(|k| (block.cells[k][0] - block.start[k]) as usize * step[k]).sum();
        let (row, rows) = (cells[0] + 1, cells[1] + 1);
        // A word more, so that each has one behind it.
        let words = row.div_ceil(64) + 1;
        planes.iter_mut().for_each(|plane| plane.resize(rows, words));
        vertices.clear();
        vertices.resize(row * rows * if caps { SECTIONS } else { NODES }, 0);
        Self {
            block,
            world,
            caps,
            cells,
            first,
            step,
            words,
            row,
            section: row * rows,
            planes,
            vertices,
            out,
            layer: Layer::default(),
            differences: vertices::Differences::new(block.stride),
            outwards: vertices::outwards(world),
        }
    }

    /// Looks at the nodes of a plane.
    fn look(&mut self, z: usize) {
        let plane = &mut self.planes[z % 2];
        for y in 0..=self.cells[1] {
            let from = self.first + y * self.step[1] + z * self.step[2];
            plane.look(y, self.words, &self.block.values[from..][..self.row], self.out.isovalue());
        }
    }

    /// Adds a layer of cells, whose lower plane has been looked at.
    fn add_layer(&mut self, z: usize) {
        self.look(z + 1);
        self.enter(z);
        for y in 0..self.cells[1] {
            self.add_row(y);
        }
        if self.caps {
            self.add_caps();
        }
    }

    /// Finds out where the vertices of a layer are.
    fn enter(&mut self, z: usize) {
        let new = self.out.vertices.len() as u32;
        // The upper plane of the layer before is the lower one of this.
        let before = if z == 0 { new } else { self.layer.edges[8].above };
        let (row, section) = (self.row, self.section);
        let slot = |axis: usize, corner: usize| {
            let dz = corner >> 2;
            let plane = (z + dz) % 2;
            let number = match axis {
                2 => BETWEEN,
                0 | 1 => 2 * axis + plane,
                _ => NODES + plane,
            };
            let above = if axis == 2 || dz == 1 { new } else { before };
            Slot { at: number * section + (corner >> 1 & 1) * row + (corner & 1), above }
        };
        self.layer = Layer {
            z,
            edges: std::array::from_fn(|e| slot(e / 4, usize::from(lower_corner(e as u8)))),
            nodes: std::array::from_fn(|corner| slot(3, corner)),
        };
    }

    /// Adds a row of cells, 64 at a time.
    fn add_row(&mut self, y: usize) {
        let mut left = self.cells[0];
        for w in 0..self.words - 1 {
            let rows = self.rows(y);
            let [mut any, mut all, mut any_next, mut all_next, mut void] = [0, !0, 0, !0, 0u64];
            let mut bits = [[0u64; 2]; 4];
            for (bits, (plane, row)) in bits.iter_mut().zip(rows) {
                let at = row + w;
                let inside = shifted(&plane.inside, at);
                let missing = shifted(&plane.missing, at);
                void |= missing[0] | missing[1];
                any |= inside[0];
                all &= inside[0];
                any_next |= inside[1];
                all_next &= inside[1];
                *bits = inside;
            }
            let cells = if left >= 64 { !0 } else { (1u64 << left) - 1 };
            left = left.saturating_sub(64);
            let mut crossed = (any | any_next) & !(all & all_next) & !void & cells;
            self.out.active_cells += u64::from(crossed.count_ones());
            while crossed != 0 {
                let x = crossed.trailing_zeros();
                crossed &= crossed - 1;
                let mut mask = 0;
                for (n, [this, next]) in bits.iter().enumerate() {
                    mask |= ((this >> x & 1) | (next >> x & 1) << 1) << (2 * n);
                }
                self.add_cell(64 * w + x as usize, y, mask as usize);
            }
        }
    }

    /// The four rows of nodes around a row of cells: their planes and first words.
    fn rows(&self, y: usize) -> [(&Plane, usize); 4] {
        let [below, above] = [self.layer.z, self.layer.z + 1].map(|z| &self.planes[z % 2]);
        let [this, next] = [y, y + 1].map(|y| y * self.words);
        [(below, this), (below, next), (above, this), (above, next)]
    }

    /// Adds a crossed cell.
    #[inline(always)]
    fn add_cell(&mut self, x: usize, y: usize, mask: usize) {
        let case = &CASES[mask];
        let mut numbers = [0; 16];
        for &edge in &case.edges[..usize::from(case.count)] {
            numbers[usize::from(edge % 16)] = self.vertex_of_edge(x, y, edge);
        }
        for corners in &case.corners[..usize::from(case.triangles)] {
            self.out.triangles.push(corners.map(|edge| numbers[usize::from(edge % 16)]));
        }
    }

    /// The vertex on an edge of a cell of this layer.
    #[inline(always)]
    fn vertex_of_edge(&mut self, x: usize, y: usize, edge: u8) -> u32 {
        let Slot { at, above } = self.layer.edges[usize::from(edge)];
        let at = at + y * self.row + x;
        let known = self.vertices[at];
        if known > above {
            return known - 1;
        }
        let number = self.push_crossing([x, y, self.layer.z], edge);
        self.vertices[at] = number + 1;
        number
    }
}

/// The bits of a word of a row, and the bits behind them.
#[inline(always)]
fn shifted(words: &[u64], at: usize) -> [u64; 2] {
    [words[at], words[at] >> 1 | words[at + 1] << 63]
}

#[cfg(test)]
mod tests;
