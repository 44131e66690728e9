//! The tetrahedra of a body-centred cubic lattice, by formula.
//!
//! The box is cut into cells. Points are the corners of cells (*nodes*), their *centres*, and on
//! the faces of the box the centres of the cells' faces. Around the line that joins the centres of
//! two cells with a common face lie four tetrahedra, each with an edge of that face. At a face of
//! the box its centre stands for the second cell:
//!
//! ```text
//!        n───────n            the face between the cells of c and d, seen from the side; the tetrahedra are
//!       ╱│      ╱│            (c, d, n, n'), n n' one of its four edges
//!      n───────n │
//!   c ┄│┄│┄┄┄┄┄│┄│┄ d        all tetrahedra inside the box are congruent where cells are cubes, and they are
//!      │ n─────│─n            Delaunay: J. H. Conway, N. J. A. Sloane, Sphere Packings, Lattices and Groups,
//!      n───────n              chapter 21; A. Entezari, R. Dyer, T. Möller, IEEE Visualization 2004
//! ```
//!
//! So the mesh is a function of the numbers of cells. Positions are given in *halves*: a node has
//! even numbers, a centre odd ones. A tetrahedron belongs to the lower of its cells. Faces of
//! tetrahedra agree, whichever parts are made separately.
//!
//! A chunk is a box of cells. First come the points of its cells, in blocks of 4³ cells, in bricks
//! of 8³ (fewer if asked for; in a block first the nodes, x fastest, then the centres). Then come
//! the points at the far end of the domain and on its faces, which it has too, and then those of
//! other chunks that its tetrahedra use. A number is arithmetic, so nothing of a chunk is stored.

use super::tet::Tet;
use crate::geom::{Lattice, LatticePos, PointClass, PointId, half_plane};
use std::collections::HashMap;
use std::ops::Range;

/// Cells along each edge of a brick that has values of its own, at most; its 1024 points are
/// numbered one after another.
pub(crate) const BRICK_CELLS: u32 = 8;
/// Cells along each edge of a brick whose points follow from nodes at samples.
pub(crate) const NODE_BRICK_CELLS: u32 = 16;
/// Cells along each edge of a block, at most.
const BLOCK_CELLS: u32 = 4;

/// The place of a point: even numbers are corners of cells along an axis, odd ones are centres.
type Halves = [u32; 3];

/// The axes other than each.
const OTHERS: [[usize; 2]; 3] = [[1, 2], [2, 0], [0, 1]];
/// The corners of a face along its two axes, counterclockwise.
const AROUND: [[u32; 2]; 4] = [[0, 0], [1, 0], [1, 1], [0, 1]];

/// A lattice that fills a box.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BccMesh {
    cells: [u32; 3],
    /// Cells along each edge of a brick.
    brick: u32,
    max: LatticePos,
}

/// A box of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct CellBox {
    lo: [u32; 3],
    hi: [u32; 3],
}

impl CellBox {
    fn dims(&self) -> [u32; 3] {
        std::array::from_fn(|a| self.hi[a].saturating_sub(self.lo[a]))
    }

    fn len(&self) -> u32 {
        self.dims().iter().product()
    }

    /// All cells, x fastest.
    fn iter(self) -> impl Iterator<Item = [u32; 3]> {
        let [x, y, z] = std::array::from_fn(|a| self.lo[a]..self.hi[a]);
        z.flat_map(move |z| {
            y.clone().flat_map({
                let x = x.clone();
                move |y| x.clone().map(move |x| [x, y, z])
            })
        })
    }

    /// The cells from that of a number on, x fastest, without an end. The box is not empty.
    fn from(self, number: u32) -> impl Iterator<Item = [u32; 3]> {
        let (Self { lo, hi }, [x, y, _]) = (self, self.dims());
        let mut next = [lo[0] + number % x, lo[1] + number / x % y, lo[2] + number / x / y];
        std::iter::repeat_with(move || {
            let cell = next;
            next[0] += 1;
            for a in 0..2 {
                if next[a] == hi[a] {
                    next[a] = lo[a];
                    next[a + 1] += 1;
                }
            }
            cell
        })
    }

    /// The number of a cell, x fastest.
    fn offset(&self, cell: [u32; 3]) -> u32 {
        let d = self.dims();
        ((cell[2] - self.lo[2]) * d[1] + cell[1] - self.lo[1]) * d[0] + cell[0] - self.lo[0]
    }

    fn contains(&self, cell: [u32; 3]) -> bool {
        (0..3).all(|a| (self.lo[a]..self.hi[a]).contains(&cell[a]))
    }

    /// Boxes of at most `edge` cells along each axis, x fastest.
    fn cut(self, edge: u32) -> impl Iterator<Item = Self> {
        let parts = Self { lo: [0; 3], hi: self.dims().map(|d| d.div_ceil(edge)) };
        parts.iter().map(move |p| {
            let lo = std::array::from_fn(|a| self.lo[a] + p[a] * edge);
            Self { lo, hi: std::array::from_fn(|a| self.hi[a].min(lo[a] + edge)) }
        })
    }
}

impl BccMesh {
    /// The lattice with these numbers of cells along each axis, as a point set has checked them;
    /// `None` for bricks that are not cubes of 1, 2, 4, 8 or 16 cells.
    pub(crate) fn new(cells: [u32; 3], lattice: &Lattice, brick: [u64; 3]) -> Option<Self> {
        let is_cube = brick == [brick[0]; 3]
            && [1, 2, 4, BRICK_CELLS.into(), NODE_BRICK_CELLS.into()].contains(&brick[0]);
        is_cube.then(|| Self { cells, brick: brick[0] as u32, max: lattice.max() })
    }

    /// Number of blocks of all chunks.
    pub(crate) fn block_total(&self) -> u64 {
        self.cells.map(|n| u64::from(n.div_ceil(self.block()))).iter().product()
    }

    /// Cells along each edge of a block.
    fn block(&self) -> u32 {
        BLOCK_CELLS.min(self.brick)
    }

    fn position(&self, at: Halves) -> LatticePos {
        std::array::from_fn(|a| half_plane(at[a].into(), self.cells[a], self.max[a]))
    }

    /// The id of a point: nodes come first, then centres, then the centres on the six faces, x
    /// fastest.
    fn id(&self, at: Halves) -> PointId {
        let n = self.cells.map(u64::from);
        let half = at.map(|j| u64::from(j / 2));
        let (nodes, centres) = (n.iter().map(|n| n + 1).product::<u64>(), n.iter().product::<u64>());
        let index = match at.iter().filter(|&&j| j % 2 == 1).count() {
            0 => (half[2] * (n[1] + 1) + half[1]) * (n[0] + 1) + half[0],
            3 => nodes + (half[2] * n[1] + half[1]) * n[0] + half[0],
            _ => {
                let axis =
                    at.iter().position(|j| j % 2 == 0).expect("a centre of a face has one even number");
                let area = |a: usize| n[(a + 1) % 3] * n[(a + 2) % 3];
                let before =
                    2 * (0..axis).map(area).sum::<u64>() + if at[axis] == 0 { 0 } else { area(axis) };
                let [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
                nodes + centres + before + half[v] * n[u] + half[u]
            }
        };
        PointId::new(PointClass::Interior, index)
    }

    /// The tetrahedra of a cell, positively oriented.
    fn tets_of(&self, cell: [u32; 3], mut each: impl FnMut([Halves; 4])) {
        let centre = cell.map(|c| 2 * c + 1);
        for a in 0..3 {
            let [u, v] = OTHERS[a];
            let corner = |side: u32, [du, dv]: [u32; 2]| {
                let mut node = cell.map(|c| 2 * c);
                (node[a], node[u], node[v]) = (node[a] + 2 * side, node[u] + 2 * du, node[v] + 2 * dv);
                node
            };
            let mut apex = centre;
            apex[a] += if cell[a] + 1 == self.cells[a] { 1 } else { 2 };
            for m in 0..4 {
                each([centre, apex, corner(1, AROUND[m]), corner(1, AROUND[(m + 1) % 4])]);
            }
            if cell[a] == 0 {
                apex[a] = 0;
                for m in 0..4 {
                    each([centre, apex, corner(0, AROUND[(m + 1) % 4]), corner(0, AROUND[m])]);
                }
            }
        }
    }

    /// The bricks of nodes with the nodes from `lo` to `hi`, x fastest: brick for brick the low
    /// corners of the cells, and at the end of the domain the high corners too.
    fn node_bricks(&self, lo: [u32; 3], hi: [u32; 3]) -> impl Iterator<Item = NodeBrick> {
        let (cells, edge) = (self.cells, self.brick);
        let of_node = move |a: usize, node: u32| (node / edge).min(cells[a].div_ceil(edge) - 1);
        let all = CellBox {
            lo: std::array::from_fn(|a| of_node(a, lo[a])),
            hi: std::array::from_fn(|a| of_node(a, hi[a].min(cells[a])) + 1),
        };
        all.iter().map(move |brick| {
            let lo = brick.map(|b| b * edge);
            let end = |a: usize| if lo[a] + edge >= cells[a] { cells[a] + 1 } else { lo[a] + edge };
            NodeBrick { brick, lo, nodes: std::array::from_fn(|a| end(a) - lo[a]) }
        })
    }

    /// The cells from `lo` to before `hi`.
    pub(crate) fn chunk(&self, lo: [u32; 3], hi: [u32; 3]) -> BccChunk {
        BccChunk::new(*self, CellBox { lo, hi })
    }
}

/// Points of a chunk that are not in its blocks, in pieces: nodes at the high ends of one, two or
/// three axes (a set of axes as bits, less 1), then points above each axis, then below.
const PIECES: usize = 13;
const ABOVE: usize = 7;
const BELOW: usize = 10;

/// The nodes of a brick, whose values are coded together where those of all other points follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NodeBrick {
    /// Its place among all bricks.
    pub(crate) brick: [u32; 3],
    /// The first node, and nodes along each axis.
    pub(crate) lo: [u32; 3],
    pub(crate) nodes: [u32; 3],
}

/// The place of a point of a lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PointPlace(Halves);

impl PointPlace {
    /// The lowest and the highest of the nodes around it: itself, the corners of its cell or those
    /// of its face.
    pub(crate) fn corners(self) -> [[u32; 3]; 2] {
        [self.0.map(|j| j / 2), self.0.map(|j| j.div_ceil(2))]
    }
}

/// A box of cells, its points and its tetrahedra.
#[derive(Clone, Debug)]
pub(crate) struct BccChunk {
    mesh: BccMesh,
    cells: CellBox,
    /// The blocks, and the number of the first point of each.
    blocks: Vec<(CellBox, u32)>,
    /// The first block of each brick, and the number of all.
    bricks: Vec<u32>,
    /// The block at each place, x fastest.
    places: Vec<u32>,
    /// The first point of each piece.
    pieces: [u32; PIECES],
    core: u32,
    points: u32,
}

/// The points and tetrahedra of a block, or of a whole chunk.
#[derive(Clone, Debug, Default)]
pub(crate) struct BccBlock {
    number: usize,
    places: Vec<Halves>,
    /// Cells along each axis, and whether they begin the domain there: tetrahedra follow from it.
    shape: Option<([u32; 3], [bool; 3])>,
    /// Numbers in `places`.
    pub(crate) tets: Vec<Tet>,
}

impl BccChunk {
    fn new(mesh: BccMesh, cells: CellBox) -> Self {
        let d = cells.dims();
        let grid = CellBox { lo: [0; 3], hi: d.map(|d| d.div_ceil(mesh.block())) };
        let (mut blocks, mut places) = (vec![], vec![0; grid.len() as usize]);
        let (mut points, mut bricks) = (0, vec![0]);
        for brick in cells.cut(mesh.brick) {
            for block in brick.cut(mesh.block()) {
                let at = std::array::from_fn(|a| (block.lo[a] - cells.lo[a]) / mesh.block());
                places[grid.offset(at) as usize] = blocks.len() as u32;
                blocks.push((block, points));
                points += 2 * block.len();
            }
            bricks.push(blocks.len() as u32);
        }
        let mut chunk = Self { mesh, cells, blocks, bricks, places, pieces: [0; PIECES], core: 0, points };
        for is_core in [true, false] {
            for piece in 0..PIECES {
                if chunk.has_piece(piece) == is_core {
                    chunk.pieces[piece] = chunk.points;
                    chunk.points += chunk.piece_box(piece).map_or(0, |b| b.len());
                }
            }
            if is_core {
                chunk.core = chunk.points;
            }
        }
        chunk
    }

    /// Whether the points of a piece are the chunk's own: they are at the ends of the domain.
    fn has_piece(&self, piece: usize) -> bool {
        let ends = |a: usize| self.cells.hi[a] == self.mesh.cells[a];
        match piece {
            0..ABOVE => (0..3).all(|a| (piece + 1) >> a & 1 == 0 || ends(a)),
            ABOVE..BELOW => ends(piece - ABOVE),
            _ => true,
        }
    }

    /// The cells at which a piece has a point each, one thick along the axes at whose end it is;
    /// `None` if it has none.
    fn piece_box(&self, piece: usize) -> Option<CellBox> {
        let CellBox { mut lo, mut hi } = self.cells;
        let mut flatten = |a: usize, at: u32| (lo[a], hi[a]) = (at, at + 1);
        match piece {
            _ if self.cells.len() == 0 => return None,
            0..ABOVE => {
                (0..3).filter(|a| (piece + 1) >> a & 1 == 1).for_each(|a| flatten(a, self.cells.hi[a]))
            }
            ABOVE..BELOW => flatten(piece - ABOVE, self.cells.hi[piece - ABOVE]),
            _ if self.cells.lo[piece - BELOW] > 0 => return None,
            _ => flatten(piece - BELOW, 0),
        }
        Some(CellBox { lo, hi })
    }

    /// The point that a piece has at a cell of its box.
    fn point_of(&self, piece: usize, cell: [u32; 3]) -> Halves {
        let mut at = cell.map(|c| 2 * c + u32::from(piece >= ABOVE));
        if piece >= BELOW {
            at[piece - BELOW] = 0;
        } else if piece >= ABOVE && self.has_piece(piece) {
            at[piece - ABOVE] -= 1;
        }
        at
    }

    /// Number of points of its bricks; the others follow them.
    pub(crate) fn in_bricks(&self) -> usize {
        2 * self.cells.len() as usize
    }

    /// Number of points that the chunk owns; the others follow them.
    pub(crate) fn core(&self) -> usize {
        self.core as usize
    }

    /// Number of points.
    pub(crate) fn points(&self) -> usize {
        self.points as usize
    }

    /// Number of blocks.
    pub(crate) fn block_count(&self) -> usize {
        self.blocks.len()
    }

    /// Number of bricks.
    pub(crate) fn brick_count(&self) -> usize {
        self.bricks.len() - 1
    }

    /// The blocks of a brick; none of a brick that the chunk does not have.
    pub(crate) fn blocks_of(&self, brick: usize) -> Range<u32> {
        match self.bricks.get(brick..brick.saturating_add(2)) {
            Some(&[first, end]) => first..end,
            _ => 0..0,
        }
    }

    /// Number of tetrahedra of all blocks.
    pub(crate) fn tet_count(&self) -> u64 {
        (0..self.block_count()).map(|block| u64::from(self.tets_of(block))).sum()
    }

    /// Number of tetrahedra of a block.
    pub(crate) fn tets_of(&self, block: usize) -> u32 {
        let (cells, _) = self.blocks[block];
        let at_face = |a: usize| if cells.lo[a] == 0 { 4 * cells.len() / cells.dims()[a] } else { 0 };
        12 * cells.len() + (0..3).map(at_face).sum::<u32>()
    }

    /// The cells along each axis of each brick, in order, which has two points a cell. Points at
    /// the ends of the domain come after them.
    pub(crate) fn bricks(&self) -> impl Iterator<Item = [u32; 3]> {
        self.cells.cut(self.mesh.brick).map(|brick| brick.dims())
    }

    /// The bricks of nodes on which the values of its points depend where those follow from nodes:
    /// its own as in [`BccChunk::bricks`], among them those of chunks after it.
    pub(crate) fn node_bricks(&self) -> impl Iterator<Item = NodeBrick> {
        // A centre above the last cell has that of the next one.
        let CellBox { lo, hi } = self.cells;
        let is_empty = self.cells.len() == 0;
        self.mesh.node_bricks(lo, hi.map(|h| h + 1)).filter(move |_| !is_empty)
    }

    /// Whether a brick of nodes is its own.
    pub(crate) fn owns(&self, brick: &NodeBrick) -> bool {
        self.cells.contains(brick.lo)
    }

    /// The places of the points with such numbers.
    pub(crate) fn point_places(&self, numbers: Range<usize>) -> Vec<PointPlace> {
        let mut out = Vec::with_capacity(numbers.len());
        let mut add = |first: u32, cells: CellBox, place: &dyn Fn([u32; 3]) -> Halves| {
            let first = first as usize;
            let wanted = numbers.start.max(first)..numbers.end.min(first + cells.len() as usize);
            if !wanted.is_empty() {
                let cells = cells.from((wanted.start - first) as u32).take(wanted.len());
                out.extend(cells.map(|cell| PointPlace(place(cell))));
            }
        };
        let near = |&(block, first): &(CellBox, u32)| first as usize + 2 * block.len() as usize;
        let skipped = self.blocks.partition_point(|block| near(block) <= numbers.start);
        for &(block, first) in self.blocks[skipped..].iter().take_while(|b| (b.1 as usize) < numbers.end) {
            add(first, block, &|cell| cell.map(|c| 2 * c));
            add(first + block.len(), block, &|cell| cell.map(|c| 2 * c + 1));
        }
        for is_core in [true, false] {
            for piece in (0..PIECES).filter(|&piece| self.has_piece(piece) == is_core) {
                if let Some(cells) = self.piece_box(piece) {
                    add(self.pieces[piece], cells, &|cell| self.point_of(piece, cell));
                }
            }
        }
        out
    }

    /// The brick of the lattice that has a point, by its place among all bricks.
    pub(crate) fn home(&self, point: PointPlace) -> [u64; 3] {
        std::array::from_fn(|a| ((point.0[a] / 2).min(self.mesh.cells[a] - 1) / self.mesh.brick).into())
    }

    /// The number of a point that the chunk owns.
    pub(crate) fn own_number(&self, point: PointPlace) -> Option<usize> {
        self.number(point.0).filter(|&n| n < self.core).map(|n| n as usize)
    }

    /// Whether bricks are as large as they may be.
    pub(crate) fn has_whole_bricks(&self) -> bool {
        self.mesh.brick >= BRICK_CELLS
    }

    /// Whether its points may follow from nodes.
    pub(crate) fn has_node_bricks(&self) -> bool {
        self.mesh.brick == NODE_BRICK_CELLS
    }

    /// The number of a point; `None` of one that the chunk's tetrahedra do not have.
    fn number(&self, at: Halves) -> Option<u32> {
        let CellBox { lo, hi } = self.cells;
        let cell = at.map(|j| j / 2);
        if (0..3).any(|a| cell[a] < lo[a] || cell[a] > hi[a]) {
            return None;
        }
        let odd = (0..3).filter(|&a| at[a] % 2 == 1).count();
        let ends = (0..3).fold(0, |ends, a| ends | usize::from(cell[a] == hi[a]) << a);
        let in_piece = |piece: usize| {
            let found = self.piece_box(piece)?;
            found.contains(cell).then(|| self.pieces[piece] + found.offset(cell))
        };
        match (odd, ends) {
            (0 | 3, 0) => {
                let edge = self.mesh.block();
                let grid = CellBox { lo: [0; 3], hi: self.cells.dims().map(|d| d.div_ceil(edge)) };
                let place = grid.offset(std::array::from_fn(|a| (cell[a] - lo[a]) / edge));
                let (block, first) = self.blocks[self.places[place as usize] as usize];
                let of_kind = if odd == 0 { 0 } else { block.len() };
                Some(first + of_kind + block.offset(cell))
            }
            (0, ends) => in_piece(ends - 1),
            (3, 1 | 2 | 4) => in_piece(ABOVE + ends.trailing_zeros() as usize),
            (2, _) => {
                let axis = (0..3).find(|&a| at[a].is_multiple_of(2))?;
                let above = at[axis] == 2 * self.mesh.cells[axis];
                in_piece(if above { ABOVE + axis } else { BELOW + axis })
            }
            _ => None,
        }
    }

    /// Whether another chunk may have tetrahedra at a point of this one.
    fn is_shared(&self, at: Halves) -> bool {
        let CellBox { lo, hi } = self.cells;
        let is_centre_of_face = (0..3).filter(|&a| at[a] % 2 == 1).count() == 2;
        let at_end = |a: usize| {
            let cell = at[a] / 2;
            cell == lo[a] && lo[a] > 0 || cell == hi[a] && hi[a] < self.mesh.cells[a]
        };
        !is_centre_of_face && (0..3).any(at_end)
    }

    /// All points by their numbers.
    fn all_points(&self) -> Vec<Halves> {
        let mut all = Vec::with_capacity(self.points());
        for (block, _) in &self.blocks {
            all.extend(block.iter().map(|c| c.map(|c| 2 * c)));
            all.extend(block.iter().map(|c| c.map(|c| 2 * c + 1)));
        }
        for is_core in [true, false] {
            for piece in (0..PIECES).filter(|&piece| self.has_piece(piece) == is_core) {
                let cells = self.piece_box(piece).into_iter().flat_map(CellBox::iter);
                all.extend(cells.map(|cell| self.point_of(piece, cell)));
            }
        }
        all
    }

    /// The points and tetrahedra of a block.
    pub(crate) fn block(&self, number: usize, out: &mut BccBlock) {
        let (block, _) = self.blocks[number];
        let (lo, d) = (block.lo, block.dims());
        let nodes = CellBox { lo, hi: block.hi.map(|h| h + 1) };
        out.number = number;
        let BccBlock { places, shape, tets, .. } = out;
        places.clear();
        places.extend(nodes.iter().map(|c| c.map(|c| 2 * c)));
        let centres = places.len() as u32;
        places.extend(block.iter().map(|c| c.map(|c| 2 * c + 1)));
        // Behind the last cells of each axis, and before the first ones of the domain.
        let mut layers = [[0; 2]; 3];
        for a in 0..3 {
            for (side, first) in layers[a].iter_mut().enumerate() {
                if side == 1 && lo[a] > 0 {
                    continue;
                }
                *first = places.len() as u32;
                let mut layer = block;
                (layer.lo[a], layer.hi[a]) = (lo[a], lo[a] + 1);
                let at = match (side, block.hi[a] == self.mesh.cells[a]) {
                    (1, _) => 0,
                    (_, true) => 2 * block.hi[a],
                    (_, false) => 2 * block.hi[a] + 1,
                };
                places.extend(layer.iter().map(|c| {
                    let mut place = c.map(|c| 2 * c + 1);
                    place[a] = at;
                    place
                }));
            }
        }
        let shape_before = shape.replace((d, lo.map(|l| l == 0)));
        if shape_before == *shape {
            return;
        }
        tets.clear();
        let node_steps = [1, d[0] + 1, (d[0] + 1) * (d[1] + 1)];
        let cell_steps = [1, d[0], d[0] * d[1]];
        for cell in (CellBox { lo: [0; 3], hi: d }).iter() {
            let dot = |steps: [u32; 3]| (0..3).map(|a| cell[a] * steps[a]).sum::<u32>();
            let (centre, node) = (centres + dot(cell_steps), dot(node_steps));
            for a in 0..3 {
                let [u, v] = OTHERS[a];
                let corners = AROUND.map(|[du, dv]| node + du * node_steps[u] + dv * node_steps[v]);
                let mut flat = CellBox { lo: [0; 3], hi: d };
                flat.hi[a] = 1;
                let mut in_layer = cell;
                in_layer[a] = 0;
                let layer = flat.offset(in_layer);
                let apex = if cell[a] + 1 == d[a] { layers[a][0] + layer } else { centre + cell_steps[a] };
                let up = node_steps[a];
                for m in 0..4 {
                    tets.push([centre, apex, corners[m] + up, corners[(m + 1) % 4] + up]);
                }
                if cell[a] + lo[a] == 0 {
                    for m in 0..4 {
                        tets.push([centre, layers[a][1] + layer, corners[(m + 1) % 4], corners[m]]);
                    }
                }
            }
        }
    }

    /// The numbers of the points of a block.
    pub(crate) fn numbers<'a>(&'a self, block: &'a BccBlock) -> impl Iterator<Item = u32> + 'a {
        let (cells, first) = self.blocks[block.number];
        block.places.iter().map(move |&at| {
            let (cell, odd) = (at.map(|j| j / 2), at.map(|j| j % 2));
            if odd == [odd[0]; 3] && cells.contains(cell) {
                return first + odd[0] * cells.len() + cells.offset(cell);
            }
            self.number(at).expect("a block's points are the chunk's")
        })
    }

    /// What is known of the points of a block: number in the chunk, position, id, and whether other
    /// chunks may have it.
    pub(crate) fn corners<'a>(
        &'a self,
        block: &'a BccBlock,
    ) -> impl Iterator<Item = (u32, LatticePos, PointId, bool)> + 'a {
        let of_point = |(number, (position, id, shared))| (number, position, id, shared);
        self.numbers(block).zip(self.points_of(block)).map(of_point)
    }

    /// The same without the numbers.
    pub(crate) fn points_of<'a>(
        &'a self,
        block: &'a BccBlock,
    ) -> impl Iterator<Item = (LatticePos, PointId, bool)> + 'a {
        block.places.iter().map(|&at| (self.mesh.position(at), self.mesh.id(at), self.is_shared(at)))
    }

    /// The positions of the lowest and the highest corner of a block, its neighbours' centres
    /// included.
    pub(crate) fn hull(&self, number: usize) -> [LatticePos; 2] {
        let (block, _) = self.blocks[number];
        let high = std::array::from_fn(|a| (2 * block.hi[a] + 1).min(2 * self.mesh.cells[a]));
        [self.mesh.position(block.lo.map(|c| 2 * c)), self.mesh.position(high)]
    }

    /// All points: position, id, whether other chunks may have it.
    pub(crate) fn listed(&self) -> impl Iterator<Item = (LatticePos, PointId, bool)> + '_ {
        self.all_points().into_iter().map(|at| (self.mesh.position(at), self.mesh.id(at), self.is_shared(at)))
    }

    /// All tetrahedra, block after block, as numbers of points.
    pub(crate) fn tets(&self) -> Vec<Tet> {
        let (mut all, mut block) = (vec![], BccBlock::default());
        for n in 0..self.block_count() {
            self.block(n, &mut block);
            let numbers: Vec<u32> = self.numbers(&block).collect();
            all.extend(block.tets.iter().map(|t| t.map(|v| numbers[v as usize])));
        }
        all
    }

    /// The end of each brick in the tetrahedra of all.
    pub(crate) fn brick_ends(&self) -> Vec<usize> {
        let mut end = 0;
        let of_brick = |brick| {
            end += self.blocks_of(brick).map(|block| self.tets_of(block as usize) as usize).sum::<usize>();
            end
        };
        (0..self.brick_count()).map(of_brick).collect()
    }

    /// The other tetrahedra at the chunk's points, whose further points follow those, and their
    /// positions.
    pub(crate) fn around(&self) -> (Vec<Tet>, Vec<LatticePos>) {
        let near = CellBox {
            lo: self.cells.lo.map(|c| c.saturating_sub(1)),
            hi: std::array::from_fn(|a| (self.cells.hi[a] + 1).min(self.mesh.cells[a])),
        };
        let (mut tets, mut positions, mut further) = (vec![], vec![], HashMap::new());
        if self.cells.len() == 0 {
            return (tets, positions);
        }
        for cell in near.iter().filter(|&cell| !self.cells.contains(cell)) {
            self.mesh.tets_of(cell, |tet| {
                let numbers = tet.map(|at| self.number(at));
                if numbers.iter().all(Option::is_none) {
                    return;
                }
                tets.push(std::array::from_fn(|i| {
                    numbers[i].unwrap_or_else(|| {
                        *further.entry(tet[i]).or_insert_with(|| {
                            positions.push(self.mesh.position(tet[i]));
                            self.points + positions.len() as u32 - 1
                        })
                    })
                }));
            });
        }
        (tets, positions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::curve::Order;
    use crate::geom::predicates::signed_volume6;
    use crate::mesh::delaunay::Mesher;
    use crate::points::{PointSet, PointSpec};
    use std::collections::BTreeSet;

    fn lattice() -> Lattice {
        Lattice::new([40, 23, 31]).unwrap()
    }

    /// The tetrahedra of cells, by positions, each sorted.
    fn sorted(tets: impl IntoIterator<Item = [LatticePos; 4]>) -> Vec<[LatticePos; 4]> {
        let mut all: Vec<_> = tets
            .into_iter()
            .map(|mut tet| {
                tet.sort_unstable();
                tet
            })
            .collect();
        all.sort_unstable();
        all
    }

    fn of_cells(mesh: &BccMesh, cells: CellBox) -> Vec<[LatticePos; 4]> {
        let mut all = vec![];
        cells.iter().for_each(|cell| mesh.tets_of(cell, |tet| all.push(tet.map(|at| mesh.position(at)))));
        all
    }

    #[test]
    fn tetrahedra_fill_the_box() {
        let max = lattice().max();
        for cells in [[1, 1, 1], [5, 4, 3], [1, 9, 2], [16, 8, 12]] {
            let mesh = BccMesh::new(cells, &lattice(), [8; 3]).unwrap();
            let tets = of_cells(&mesh, CellBox { lo: [0; 3], hi: cells });
            let volumes = tets.iter().map(|&[a, b, c, d]| signed_volume6(a, b, c, d));
            assert!(volumes.clone().all(|v| v > 0));
            assert_eq!(volumes.sum::<i128>(), 6 * max.iter().map(|&m| i128::from(m)).product::<i128>());
            // Each face belongs to two tetrahedra, or lies on the box.
            let mut faces: HashMap<[LatticePos; 3], u32> = HashMap::new();
            for tet in sorted(tets) {
                for i in 0..4 {
                    let face: Vec<_> = (0..4).filter(|&j| j != i).map(|j| tet[j]).collect();
                    *faces.entry(face.try_into().unwrap()).or_default() += 1;
                }
            }
            let on_box = |f: &[LatticePos; 3]| {
                (0..3).any(|a| [0, max[a]].iter().any(|&end| f.iter().all(|p| p[a] == end)))
            };
            assert!(faces.iter().all(|(face, &n)| n == if on_box(face) { 1 } else { 2 }));
        }
    }

    #[test]
    fn points_are_among_the_nodes_of_bricks() {
        for (cells, cuts) in [([40, 9, 32], [16, 16, 32]), ([3, 16, 33], [16, 16, 16])] {
            let mesh = BccMesh::new(cells, &lattice(), [16; 3]).unwrap();
            for lo in (CellBox { lo: [0; 3], hi: std::array::from_fn(|a| cells[a].div_ceil(cuts[a])) }).iter()
            {
                let lo: [u32; 3] = std::array::from_fn(|a| lo[a] * cuts[a]);
                let chunk = mesh.chunk(lo, std::array::from_fn(|a| (lo[a] + cuts[a]).min(cells[a])));
                let places = chunk.point_places(0..chunk.points());
                assert_eq!(places, chunk.all_points().into_iter().map(PointPlace).collect::<Vec<_>>());
                let middle = places.len() / 3..places.len() - 5;
                assert_eq!(chunk.point_places(middle.clone()), places[middle]);
                let bricks: Vec<NodeBrick> = chunk.node_bricks().collect();
                let own: Vec<[u32; 3]> = bricks.iter().filter(|b| chunk.owns(b)).map(|b| b.lo).collect();
                assert_eq!(own, chunk.cells.cut(16).map(|b| b.lo).collect::<Vec<_>>());
                // Each node is in one of them.
                for node in places.iter().flat_map(|p| p.corners()) {
                    let has =
                        |b: &&NodeBrick| (0..3).all(|a| (b.lo[a]..b.lo[a] + b.nodes[a]).contains(&node[a]));
                    assert_eq!(bricks.iter().filter(has).count(), 1, "{node:?}");
                }
            }
        }
    }

    #[test]
    fn points_are_those_of_the_set() {
        let cells = [6, 4, 5];
        let set = PointSet::new(PointSpec::Bcc { cells }, lattice()).unwrap();
        let mesh = BccMesh::new(cells, &lattice(), [8; 3]).unwrap();
        let chunk = mesh.chunk([0; 3], cells);
        assert_eq!((chunk.core(), chunk.points() as u64), (chunk.points(), set.len()));
        for (position, id, shared) in chunk.listed() {
            assert_eq!(set.position(id), Some(position));
            assert!(!shared);
        }
        let ids: BTreeSet<u64> = chunk.listed().map(|p| p.1.index()).collect();
        assert_eq!(ids.len(), chunk.points());
    }

    #[test]
    fn chunks_are_parts_of_the_whole() {
        let cells = [19, 9, 12];
        for brick in [8, 4, 2] {
            parts_are_the_whole(cells, brick);
        }
    }

    fn parts_are_the_whole(cells: [u32; 3], brick: u64) {
        let mesh = BccMesh::new(cells, &lattice(), [brick; 3]).unwrap();
        let set = PointSet::new(PointSpec::Bcc { cells }, lattice()).unwrap();
        let cuts = [vec![0, 8, 16, 19], vec![0, 8, 9], vec![0, 8, 12]];
        let (mut owned, mut all, mut users) = (0, vec![], HashMap::<PointId, u32>::new());
        let mut flags = HashMap::new();
        for part in (CellBox { lo: [0; 3], hi: cuts.clone().map(|c| c.len() as u32 - 1) }).iter() {
            let bound = |side: u32| std::array::from_fn(|a| cuts[a][(part[a] + side) as usize]);
            let chunk = mesh.chunk(bound(0), bound(1));
            let points: Vec<_> = chunk.listed().collect();
            owned += chunk.core() as u64;
            assert_eq!(points.len(), chunk.points());
            let in_bricks: u32 = chunk.bricks().map(|cells| 2 * cells.iter().product::<u32>()).sum();
            assert!(in_bricks as usize <= chunk.core());
            for (n, at) in chunk.all_points().into_iter().enumerate() {
                assert_eq!(chunk.number(at), Some(n as u32));
            }
            let (tets, mut block, mut end) = (chunk.tets(), BccBlock::default(), 0);
            for (brick, expected) in chunk.brick_ends().into_iter().enumerate() {
                for n in chunk.blocks_of(brick) {
                    chunk.block(n as usize, &mut block);
                    let numbers = block.places.iter().map(|&at| chunk.number(at));
                    assert!(numbers.eq(chunk.numbers(&block).map(Some)));
                    let mut anew = BccBlock::default();
                    chunk.block(n as usize, &mut anew);
                    assert_eq!((&anew.places, &anew.tets), (&block.places, &block.tets));
                    end += block.tets.len();
                }
                assert_eq!(end, expected);
            }
            assert_eq!(end, tets.len());
            let mut used: BTreeSet<u32> = BTreeSet::new();
            for tet in &tets {
                used.extend(tet);
                all.push(tet.map(|v| points[v as usize].0));
            }
            for v in used {
                *users.entry(points[v as usize].1).or_default() += 1;
            }
            for (_, id, shared) in &points {
                flags.entry(*id).or_insert_with(Vec::new).push(*shared);
            }
            assert!((chunk.core()..points.len()).all(|v| tets.iter().flatten().any(|&u| u as usize == v)));
            // With what is around it, a chunk has all tetrahedra at its points.
            let (around, further) = chunk.around();
            let position = |v: u32| match points.get(v as usize) {
                Some(point) => point.0,
                None => further[v as usize - points.len()],
            };
            let mut own: Vec<_> = tets.iter().chain(&around).map(|t| t.map(position)).collect();
            let here: BTreeSet<LatticePos> = points.iter().map(|p| p.0).collect();
            let whole = of_cells(&mesh, CellBox { lo: [0; 3], hi: cells });
            let at_points = whole.into_iter().filter(|t| t.iter().any(|p| here.contains(p)));
            assert!(own.iter().all(|&[a, b, c, d]| signed_volume6(a, b, c, d) > 0));
            own = sorted(own);
            assert_eq!(own, sorted(at_points));
        }
        assert_eq!(owned, set.len());
        assert_eq!(sorted(all), sorted(of_cells(&mesh, CellBox { lo: [0; 3], hi: cells })));
        for (id, users) in users {
            assert!(users == 1 || flags[&id].iter().all(|&shared| shared), "{id:?}");
        }
    }

    #[test]
    fn tetrahedra_inside_are_delaunay() {
        let cells = [6, 5, 4];
        let lattice = lattice();
        let set = PointSet::new(PointSpec::Bcc { cells }, lattice).unwrap();
        let mut sites = vec![];
        set.sites_in(&lattice.domain(), &mut sites);
        let positions: Vec<LatticePos> = sites.iter().map(|s| s.pos).collect();
        let mut mesher = Mesher::new();
        mesher.delaunay(&positions, &Order::for_count(positions.len() as u64)).unwrap();
        let mut found = vec![];
        mesher.for_each_tet(|t| found.push(t.map(|v| positions[v as usize])));
        let delaunay: BTreeSet<_> = sorted(found).into_iter().collect();
        let mesh = BccMesh::new(cells, &lattice, [8; 3]).unwrap();
        let inner = CellBox { lo: [1; 3], hi: cells.map(|c| c - 1) };
        let inside = sorted(of_cells(&mesh, inner));
        assert!(!inside.is_empty() && inside.iter().all(|tet| delaunay.contains(tet)));
    }

    #[test]
    fn no_cells_are_a_chunk_too() {
        let chunk = BccMesh::new([4; 3], &lattice(), [8; 3]).unwrap().chunk([2, 2, 2], [2, 4, 4]);
        assert_eq!((chunk.points(), chunk.block_count()), (0, 0));
        assert_eq!(chunk.around(), (vec![], vec![]));
    }
}
