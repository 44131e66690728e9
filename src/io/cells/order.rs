//! In which order cells have the vertices on their edges, found from where these lie.
//!
//! Formats have orders of their own (VTK's, Gmsh's, TetGen's), and programs write one format in the
//! order of another. A vertex on an edge lies near the middle of this edge, also where edges are
//! curved. So a sample of cells tells the order ([`survey`](super::survey)): the one of the least
//! distances.

use super::{CellBlock, CellKind};

/// For kinds whose vertices on edges are in another order than VTK's: which of them lies on each
/// edge.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Orders(Vec<(CellKind, Vec<usize>)>);

impl Orders {
    /// Notes the order of a kind.
    pub(super) fn add(&mut self, kind: CellKind, order: Vec<usize>) {
        self.0.push((kind, order));
    }

    /// Puts the vertices of cells into VTK's order.
    pub(super) fn apply(&self, block: &mut CellBlock) {
        let mut old = vec![];
        for (kind, order) in &self.0 {
            for i in 0..block.len() {
                if block.kinds[i] == *kind {
                    let start = if i == 0 { 0 } else { block.ends[i - 1] } + kind.shape().corners;
                    let on_edges = &mut block.vertices[start..start + order.len()];
                    old.clear();
                    old.extend_from_slice(on_edges);
                    on_edges.iter_mut().zip(order).for_each(|(v, &from)| *v = old[from]);
                }
            }
        }
    }
}

/// How far the vertices of a cell lie from the middles of its edges.
pub(super) struct PlacedVertices {
    /// For each vertex and edge the square of the distance, in squares of the length of the edge.
    /// Of an edge without length it is 0 in its place.
    squares: Vec<Vec<f64>>,
}

impl PlacedVertices {
    pub(super) fn new(
        edges: &[[u8; 2]],
        corners: &[[f64; 3]],
        vertices: impl Iterator<Item = [f64; 3]>,
    ) -> Self {
        let square = |p: [f64; 3], q: [f64; 3]| (0..3).map(|i| (p[i] - q[i]) * (p[i] - q[i])).sum::<f64>();
        let of_vertex = |p: [f64; 3]| {
            let to_edge = |&[a, b]: &[u8; 2]| {
                let (a, b) = (corners[usize::from(a)], corners[usize::from(b)]);
                let middle = std::array::from_fn(|i| 0.5 * (a[i] + b[i]));
                square(p, middle) / square(a, b).max(f64::MIN_POSITIVE)
            };
            edges.iter().map(to_edge).map(|square| square.min(FARTHEST)).collect()
        };
        Self { squares: vertices.map(of_vertex).collect() }
    }

    /// Whether each vertex may be on its edge: a quarter of its length from the middle, as on an
    /// arc of more than a right angle, or nearer to it than to others.
    pub(super) fn fits(&self, edges: &[usize]) -> bool {
        self.squares.iter().zip(edges).all(|(squares, &edge)| {
            squares[edge] <= 1.0 / 16.0 || squares.iter().all(|&other| other >= squares[edge])
        })
    }
}

/// The most that a distance counts.
const FARTHEST: f64 = 1e6;

/// Which vertex is on which edge: the sum of the squares of all distances is least, over the
/// subsets of edges that the first vertices have. So the two sides of a thin curved cell are told
/// apart, where a vertex of one is nearer to the edge of the other.
pub(super) fn likeliest(cells: &[PlacedVertices], edges: usize) -> Vec<usize> {
    let cost = |vertex: usize, edge: usize| cells.iter().map(|cell| cell.squares[vertex][edge]).sum::<f64>();
    let cost: Vec<Vec<f64>> = (0..edges).map(|v| (0..edges).map(|e| cost(v, e)).collect()).collect();
    // For each subset the least sum, and the edge of its last vertex.
    let mut least = vec![(f64::INFINITY, 0usize); 1 << edges];
    least[0].0 = 0.0;
    for taken in 0usize..1 << edges {
        let (sum, vertex) = (least[taken].0, taken.count_ones() as usize);
        for edge in (0..edges).filter(|edge| taken >> edge & 1 == 0) {
            let found = sum + cost[vertex][edge];
            let known = &mut least[taken | 1 << edge];
            if found < known.0 {
                *known = (found, edge);
            }
        }
    }
    let (mut out, mut taken) = (vec![0; edges], (1usize << edges) - 1);
    for vertex in (0..edges).rev() {
        out[vertex] = least[taken].1;
        taken &= !(1 << out[vertex]);
    }
    out
}
