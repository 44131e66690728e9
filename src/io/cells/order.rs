//! In which order cells have the vertices on their edges, found from where these lie; and whether
//! cells are whole.
//!
//! Formats have orders of their own (VTK's, Gmsh's, TetGen's), and programs write one format in the
//! order of another. A vertex on an edge lies near the middle of this edge, also where edges are
//! curved. So a sample of cells tells the order: the one of the least distances. Where vertices are
//! far from their edges in that too, the mesh is refused, as are cells whose tetrahedra are turned
//! both ways: their vertices are in an order that is not understood.
//!
//! Memory: the cells of the sample and the positions of their vertices. Cost: a pass over cells and
//! points, where one of the first blocks has another cell than a linear tetrahedron, whose order of
//! vertices decides nothing.

use super::mesh::{CellBlocks, CellMesh};
use super::polyhedron::{Faces, is_folded};
use super::quadratic::with_middles;
use super::{CellBlock, CellKind, Orientation, orient, split};
use crate::error::{Error, Result};
use std::collections::HashMap;

/// Blocks that tell whether a mesh has other cells than linear tetrahedra.
const FIRST: u64 = 16;
/// Cells of the sample, about.
const SAMPLE: u64 = 4096;
/// Numbers of vertices that the sample has, at most: a polyhedron may have very many.
const MOST_NUMBERS: usize = 1 << 20;

/// For kinds whose vertices on edges are in another order than VTK's: which of them lies on each
/// edge.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Orders(Vec<(CellKind, Vec<usize>)>);

impl Orders {
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

    /// Looks at cells of all parts of a mesh.
    ///
    /// # Errors
    /// [`Error::BadInput`] where vertices on edges are in no order, or more than one of a hundred
    /// cells is folded; when the file cannot be read.
    pub(super) fn of(mesh: &CellMesh, cells: impl Fn() -> Result<CellBlocks>) -> Result<Self> {
        let info = mesh.info();
        let stride = info.cells.div_ceil(SAMPLE).max(1);
        let (mut stream, mut block, mut at) = (cells()?, CellBlock::default(), 0u64);
        let (mut sample, mut number): (Vec<(u64, CellKind, Vec<u64>)>, u64) = (vec![], 0);
        let mut held = 0;
        while stream.next_block(&mut block)? {
            for (i, (kind, vertices)) in block.iter().enumerate() {
                let cell = at + i as u64;
                let is_one = !matches!(kind, CellKind::Flat | CellKind::Tetrahedron);
                if cell.is_multiple_of(stride) && is_one && held + vertices.len() <= MOST_NUMBERS {
                    held += vertices.len();
                    sample.push((cell, kind, vertices.to_vec()));
                }
            }
            at += block.len() as u64;
            number += 1;
            if number == FIRST && sample.is_empty() {
                break;
            }
        }
        if sample.is_empty() {
            return Ok(Self::default());
        }
        let mut places: HashMap<u64, [f64; 3]> = HashMap::new();
        for (_, kind, vertices) in &sample {
            let mut note = |&v: &u64| {
                places.insert(v, [f64::NAN; 3]);
            };
            match kind {
                CellKind::Polyhedron => Faces::new(vertices).flatten().for_each(note),
                _ => vertices.iter().for_each(&mut note),
            }
        }
        let (mut points, mut block, mut at) = (mesh.points()?, vec![], 0u64);
        while points.next_block(&mut block)? {
            for (i, p) in block.iter().enumerate() {
                places.entry(at + i as u64).and_modify(|place| *place = *p);
            }
            at += block.len() as u64;
        }
        let place = |v: &u64| places[v];
        let mut orders = Self::default();
        for kind in CellKind::SOLID {
            let shape = kind.shape();
            let on_edges = shape.corners + shape.edges.len();
            if kind.vertices() < on_edges {
                continue;
            }
            let cells: Vec<_> = sample.iter().filter(|(_, k, _)| *k == kind).collect();
            let wrong = |cell: u64, got: String| {
                let expected = "vertices on edges, each near the middle of its edge";
                Error::bad_input(&info.path, format!("cell {cell} (counted from 0)"), expected, got)
                    .with_help("write the mesh in VTK's order of vertices (.vtu), or with linear cells")
            };
            if cells.is_empty() {
                continue;
            }
            let placed: Vec<Placed> = cells
                .iter()
                .map(|(_, _, vertices)| {
                    let corners: Vec<[f64; 3]> = vertices[..shape.corners].iter().map(place).collect();
                    Placed::new(shape.edges, &corners, vertices[shape.corners..on_edges].iter().map(place))
                })
                .collect();
            let edges = likeliest(&placed, shape.edges.len());
            let odd: Vec<usize> = (0..placed.len()).filter(|&c| !placed[c].fits(&edges)).collect();
            let order: Vec<usize> =
                (0..edges.len()).filter_map(|e| edges.iter().position(|&f| f == e)).collect();
            let is_usual = order.iter().copied().eq(0..edges.len());
            let most = if is_usual { placed.len() / 2 } else { placed.len() / 100 };
            // One or two odd cells tell nothing.
            if odd.len() > most && placed.len() >= 3 {
                let got = format!("those of {} of {} {} elsewhere", odd.len(), placed.len(), kind.plural());
                return Err(wrong(cells[odd[0]].0, got));
            }
            if !is_usual && odd.len() <= most {
                orders.0.push((kind, order));
            }
        }
        // The cells, in that order: whole, or folded?
        let (mut folded, mut tets) = (vec![], vec![]);
        for (cell, kind, vertices) in &sample {
            if *kind == CellKind::Polyhedron {
                folded.extend(is_folded(Faces::new(vertices), |v| places[&v]).then_some(*cell));
                continue;
            }
            let mut one = CellBlock::default();
            one.push(*kind, vertices);
            orders.apply(&mut one);
            tets.clear();
            let (kind, all, added) = with_middles(*kind, &one.vertices, |v| places[&v]);
            split(kind, &all, &mut tets);
            let place = |v: u64| added.get((u64::MAX - v) as usize).copied().unwrap_or_else(|| places[&v]);
            let turned = |t: &[u64; 4]| orient(t.map(place));
            let has = |way| tets.iter().any(|t| turned(t) == way);
            if has(Orientation::Positive) && has(Orientation::Inverted) {
                folded.push(*cell);
            }
        }
        if folded.len() > 2 && folded.len() * 100 > sample.len() {
            let expected = "cells whose tetrahedra are turned one way";
            let got = format!("{} of {} cells that were looked at folded over", folded.len(), sample.len());
            return Err(Error::bad_input(
                &info.path,
                format!("cell {} (counted from 0)", folded[0]),
                expected,
                got,
            )
            .with_help(match sample.iter().find(|(cell, ..)| *cell == folded[0]) {
                Some((_, CellKind::Polyhedron, _)) => {
                    "not all of its faces are seen from its middle: split such polyhedra into convex ones"
                }
                _ => "its vertices are in another order than the format's, or the mesh is damaged",
            }));
        }
        Ok(orders)
    }
}

/// How far the vertices of a cell lie from the middles of its edges.
struct Placed {
    /// For each vertex and edge the square of the distance, in squares of the length of the edge.
    /// Of an edge without length it is 0 in its place.
    squares: Vec<Vec<f64>>,
}

impl Placed {
    fn new(edges: &[[u8; 2]], corners: &[[f64; 3]], vertices: impl Iterator<Item = [f64; 3]>) -> Self {
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
    fn fits(&self, edges: &[usize]) -> bool {
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
fn likeliest(cells: &[Placed], edges: usize) -> Vec<usize> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::{OpenOptions, open_mesh};

    /// Ten cells of second order in a row, as VTU, their vertices on edges in an order.
    fn vtu(order: [usize; 6]) -> String {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0f64]];
        let (mut points, mut cells) = (String::new(), String::new());
        for c in 0..10 {
            let mut all: Vec<[f64; 3]> = corners.to_vec();
            let middles = CellKind::QuadraticTetrahedron.shape().edges.iter().map(|[a, b]| {
                let (a, b) = (corners[usize::from(*a)], corners[usize::from(*b)]);
                // A little off, as on a curved body.
                std::array::from_fn(|i| 0.5 * (a[i] + b[i]) + 0.1 * (a[i] + b[i] - 1.0) * a[(i + 1) % 3])
            });
            let middles: Vec<[f64; 3]> = middles.collect();
            all.extend(order.map(|e| middles[e]));
            all.iter().for_each(|p| points += &format!("{} {} {} ", p[0] + 2.0 * f64::from(c), p[1], p[2]));
            (0..10).for_each(|i| cells += &format!("{} ", 10 * c + i));
        }
        let ends: String = (1..=10).map(|c| format!("{} ", 10 * c)).collect();
        let heat: String = (0..100).map(|i| format!("{i} ")).collect();
        format!(
            "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid><Piece NumberOfPoints=\"100\" NumberOfCells=\"10\">\
             <PointData><DataArray type=\"Float32\" Name=\"heat\">{heat}</DataArray></PointData>\
             <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\">{points}</DataArray></Points>\
             <Cells><DataArray type=\"Int64\" Name=\"connectivity\">{cells}</DataArray>\
             <DataArray type=\"Int64\" Name=\"offsets\">{ends}</DataArray>\
             <DataArray type=\"UInt8\" Name=\"types\">{}</DataArray></Cells>\
             </Piece></UnstructuredGrid></VTKFile>",
            "24 ".repeat(10)
        )
    }

    fn tetrahedra(text: &str) -> Result<Vec<[u64; 4]>> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.vtu");
        std::fs::write(&path, text).unwrap();
        let mesh = open_mesh(&path, &OpenOptions::default())?;
        let (mut cells, mut block, mut tets) = (mesh.cells()?, CellBlock::default(), vec![]);
        let mut places = vec![];
        let (mut points, mut some) = (mesh.points()?, vec![]);
        while points.next_block(&mut some)? {
            places.extend_from_slice(&some);
        }
        while cells.next_block(&mut block)? {
            block.iter().for_each(|(kind, v)| assert_eq!(split(kind, v, &mut tets), 0));
        }
        assert!(tets.iter().all(|t| orient(t.map(|v| places[v as usize])) == Orientation::Positive));
        Ok(tets)
    }

    #[test]
    fn positions_tell_the_order_of_vertices_on_edges() {
        let vtk = tetrahedra(&vtu([0, 1, 2, 3, 4, 5])).unwrap();
        assert_eq!(vtk.len(), 80);
        // TetGen's order, and Gmsh's: as many whole tetrahedra.
        for order in [[5, 3, 0, 1, 4, 2], [0, 1, 2, 3, 5, 4]] {
            assert_eq!(tetrahedra(&vtu(order)).unwrap().len(), 80);
        }
        let error = tetrahedra(&vtu([0, 0, 2, 3, 4, 5])).unwrap_err();
        assert_eq!(error.exit_code(), 5);
        let line = error.to_string();
        assert!(line.contains("a.vtu") && line.contains("cell 0 (counted from 0)"), "{line}");
    }

    #[test]
    fn folded_cells_are_refused() {
        // Linear hexahedra whose bottom is numbered around and whose top is not.
        let text = |top: [u64; 4]| {
            let (mut points, mut cells) = (String::new(), String::new());
            for c in 0..4u64 {
                for p in ["0 0 0", "1 0 0", "1 1 0", "0 1 0", "0 0 1", "1 0 1", "1 1 1", "0 1 1"] {
                    points += &format!("{} {} ", 2 * c + u64::from(p.starts_with('1')), &p[2..]);
                }
                [0, 1, 2, 3].into_iter().chain(top).for_each(|v| cells += &format!("{} ", 8 * c + v));
            }
            let heat: String = (0..32).map(|i| format!("{i} ")).collect();
            format!(
                "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid><Piece NumberOfPoints=\"32\" NumberOfCells=\"4\">\
                 <PointData><DataArray type=\"Float32\" Name=\"heat\">{heat}</DataArray></PointData>\
                 <Points><DataArray type=\"Float64\" NumberOfComponents=\"3\">{points}</DataArray></Points>\
                 <Cells><DataArray type=\"Int64\" Name=\"connectivity\">{cells}</DataArray>\
                 <DataArray type=\"Int64\" Name=\"offsets\">8 16 24 32</DataArray>\
                 <DataArray type=\"UInt8\" Name=\"types\">12 12 12 12</DataArray></Cells>\
                 </Piece></UnstructuredGrid></VTKFile>"
            )
        };
        assert_eq!(tetrahedra(&text([4, 5, 6, 7])).unwrap().len(), 24);
        let line = tetrahedra(&text([4, 5, 7, 6])).unwrap_err().to_string();
        assert!(line.contains("4 of 4 cells that were looked at folded over"), "{line}");
    }
}
