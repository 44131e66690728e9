//! Vertices of marching cubes: on crossed edges, and at the nodes of caps.

use super::cases::lower_corner;
use super::{GridBlock, March};
use crate::surface::extract::SharedEdge;
use crate::surface::extract::cells::along_edge;
use crate::surface::model::Vertex;
use crate::surface::world_map::WorldMap;
use isospan_io::geom::PointId;

/// The factors of differences along each axis, by the number of neighbours.
pub(super) struct Differences([[f64; 3]; 3]);

impl Differences {
    pub(super) fn new(stride: [u64; 3]) -> Self {
        // Strides are powers of two: exact.
        Self(stride.map(|s| [0.0, 1.0 / s as f64, 0.5 / s as f64]))
    }
}

/// The unit world vectors out of the grid, of its faces as `cases::FACES` numbers them.
pub(super) fn outwards(world: &WorldMap) -> [[f32; 3]; 6] {
    std::array::from_fn(|face| {
        let mut inwards = [0.0; 3];
        inwards[face / 2] = if face % 2 == 0 { 1.0 } else { -1.0 };
        along_edge(inwards, world)
    })
}

/// Where an edge or a node lies in its block.
struct Sides {
    /// The faces of the grid that it lies on, a bit each.
    outer: u8,
    /// Whether it lies on a face that another block has too.
    is_shared: bool,
}

impl March<'_> {
    /// Adds the vertex on an edge of a cell.
    #[inline(always)]
    pub(super) fn push_crossing(&mut self, cell: [usize; 3], edge: u8) -> u32 {
        let (axis, corner) = (usize::from(edge / 4), usize::from(lower_corner(edge)));
        let low: [usize; 3] = std::array::from_fn(|k| cell[k] + (corner >> k & 1));
        let at = self.place(low);
        let (a, b) = (self.block.values[at], self.block.values[at + self.step[axis]]);
        let (a, b, isovalue) = (f64::from(a), f64::from(b), f64::from(self.out.isovalue()));
        let t = self.world.part_of_edge((isovalue - a) / (b - a));
        let sides = self.sides(low, Some(axis));
        let normal = if self.caps && sides.outer != 0 {
            self.outwards(sides.outer)
        } else {
            self.normal(low, axis, t).unwrap_or_else(|| {
                let mut up = [0.0; 3];
                up[axis] = if a < b { 1.0 } else { -1.0 };
                along_edge(up, self.world)
            })
        };
        let mut index = self.node(low).map(|x| x as f64);
        index[axis] += t;
        let mut high = low;
        high[axis] += 1;
        self.push(index, normal, sides.is_shared.then_some([low, high]))
    }

    /// Adds the vertex of a cap at a node.
    pub(super) fn push_node(&mut self, node: [usize; 3]) -> u32 {
        let sides = self.sides(node, None);
        let normal = self.outwards(sides.outer);
        self.push(self.node(node).map(|x| x as f64), normal, sides.is_shared.then_some([node; 2]))
    }

    #[inline(always)]
    fn push(&mut self, index: [f64; 3], normal: [f32; 3], shared: Option<[[usize; 3]; 2]>) -> u32 {
        let vertex = self.out.vertices.len() as u32;
        let index = std::array::from_fn(|k| index[k] * self.block.stride[k] as f64);
        self.out.vertices.push(Vertex { position: self.world.position(index), normal });
        if let Some([low, high]) = shared {
            let key = (self.id(low), self.id(high));
            self.out.shared.push(SharedEdge { key, vertex, gradient: [0; 3] });
        }
        vertex
    }

    /// The place in the window of a node of the block.
    #[inline(always)]
    fn place(&self, node: [usize; 3]) -> usize {
        self.first + node[0] + node[1] * self.step[1] + node[2] * self.step[2]
    }

    /// The node of the grid.
    #[inline(always)]
    fn node(&self, node: [usize; 3]) -> [u64; 3] {
        std::array::from_fn(|k| self.block.cells[k][0] + node[k] as u64)
    }

    fn id(&self, node: [usize; 3]) -> PointId {
        let ([x, y, z], [nx, ny, _]) = (self.node(node), self.block.grid);
        PointId(x + nx * (y + ny * z))
    }

    /// The faces of the block on which a node lies, or an edge from there along an axis.
    #[inline(always)]
    fn sides(&self, low: [usize; 3], axis: Option<usize>) -> Sides {
        let GridBlock { cells, grid, .. } = self.block;
        let mut sides = Sides { outer: 0, is_shared: false };
        for k in (0..3).filter(|&k| axis != Some(k)) {
            let (is_first, is_last) = (low[k] == 0, low[k] == self.cells[k]);
            if is_first || is_last {
                let is_outer = if is_first { cells[k][0] == 0 } else { cells[k][1] + 1 == grid[k] };
                sides.outer |= u8::from(is_outer) << (2 * k + usize::from(is_last));
                sides.is_shared |= !is_outer;
            }
        }
        sides
    }

    /// The mean of the directions out of faces of the grid.
    fn outwards(&self, faces: u8) -> [f32; 3] {
        let mut sum = [0.0f64; 3];
        for face in (0..6).filter(|face| faces >> face & 1 == 1) {
            for (sum, x) in sum.iter_mut().zip(self.outwards[face]) {
                *sum += f64::from(x);
            }
        }
        let inverse = 1.0 / (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
        sum.map(|x| (x * inverse) as f32)
    }

    /// The normal at a part of an edge; `None` without a direction.
    #[inline(always)]
    fn normal(&self, low: [usize; 3], axis: usize, t: f64) -> Option<[f32; 3]> {
        let mut high = low;
        high[axis] += 1;
        let (a, b) = (self.gradient(low), self.gradient(high));
        let g: [f64; 3] = std::array::from_fn(|k| a[k] + t * (b[k] - a[k]));
        if g.iter().all(|x| x.is_finite()) { self.world.unit_normal(g) } else { None }
    }

    /// The gradient at a node, in index space.
    #[inline(always)]
    fn gradient(&self, node: [usize; 3]) -> [f64; 3] {
        let at = self.place(node);
        let global = self.node(node);
        std::array::from_fn(|k| {
            let (has_low, has_high) = (global[k] > 0, global[k] + 1 < self.block.grid[k]);
            let step = self.step[k];
            let low = self.block.values[if has_low { at - step } else { at }];
            let high = self.block.values[if has_high { at + step } else { at }];
            let factor = self.differences.0[k][usize::from(has_low) + usize::from(has_high)];
            let difference = f64::from(high) - f64::from(low);
            if difference.is_nan() { self.one_sided(at, k, [low, high]) } else { difference * factor }
        })
    }

    /// The difference at a node of which a neighbour may have no data, in index space.
    #[cold]
    fn one_sided(&self, at: usize, axis: usize, [low, high]: [f32; 2]) -> f64 {
        let here = self.block.values[at];
        let [_, one, both] = self.differences.0[axis];
        let [low, here, high] = [low, here, high].map(f64::from);
        match (low.is_nan(), high.is_nan()) {
            (false, false) => (high - low) * both,
            (true, false) => (high - here) * one,
            (false, true) => (here - low) * one,
            (true, true) => 0.0,
        }
    }
}
