//! A look at a sample of a mesh's cells: in which order they have the vertices on their edges, and
//! whether they are whole.
//!
//! Where vertices on edges are far from them in each [order](super::order), the mesh is refused, as
//! are cells whose tetrahedra are turned both ways: their vertices are in an order that is not
//! understood.
//!
//! Memory: the cells of the sample and the positions of their vertices. Cost: a pass over cells and
//! points, where one of the first blocks has another cell than a linear tetrahedron, whose order of
//! vertices decides nothing.

use super::blocks::{CellBlocks, PointBlocks};
use super::order::{Orders, PlacedVertices, likeliest};
use super::polyhedron::{Faces, is_folded};
use super::quadratic::with_middles;
use super::{CellBlock, CellKind, CellsInfo, Orientation, orient, split};
use crate::error::{Error, Result};
use std::collections::HashMap;
use std::path::Path;

/// Blocks that tell whether a mesh has other cells than linear tetrahedra.
const FIRST_BLOCKS: u64 = 16;
/// Cells of the sample, about.
const SAMPLE: u64 = 4096;
/// Numbers of vertices that the sample has, at most: a polyhedron may have very many.
const MOST_NUMBERS: usize = 1 << 20;

/// Looks at some cells of all parts of a mesh.
///
/// # Errors
/// [`Error::BadInput`] where vertices on edges are in no order, or more than one of a hundred
/// cells is folded; when the file cannot be read.
pub(super) fn orders(
    info: &CellsInfo,
    cells: CellBlocks,
    points: impl FnOnce() -> Result<PointBlocks>,
) -> Result<Orders> {
    let sampled = sampled(info, cells)?;
    if sampled.is_empty() {
        return Ok(Orders::default());
    }
    let places = places(&sampled, points()?)?;
    let sample = Sample { path: &info.path, cells: sampled, places };
    let mut orders = Orders::default();
    for kind in CellKind::SOLID {
        if let Some(order) = sample.order_of(kind)? {
            orders.add(kind, order);
        }
    }
    sample.refuse_folded(&orders)?;
    Ok(orders)
}

/// A cell of the sample.
struct SampledCell {
    /// Its number in the mesh.
    number: u64,
    kind: CellKind,
    vertices: Vec<u64>,
}

/// Cells from all parts of a mesh; none where its first blocks have linear tetrahedra alone.
fn sampled(info: &CellsInfo, mut cells: CellBlocks) -> Result<Vec<SampledCell>> {
    let stride = info.cells.div_ceil(SAMPLE).max(1);
    let (mut block, mut before, mut blocks) = (CellBlock::default(), 0u64, 0u64);
    let (mut sampled, mut held) = (vec![], 0);
    while cells.next_block(&mut block)? {
        for (number, (kind, vertices)) in (before..).zip(block.iter()) {
            let has_order = !matches!(kind, CellKind::Flat | CellKind::Tetrahedron);
            if number.is_multiple_of(stride) && has_order && held + vertices.len() <= MOST_NUMBERS {
                held += vertices.len();
                sampled.push(SampledCell { number, kind, vertices: vertices.to_vec() });
            }
        }
        before += block.len() as u64;
        blocks += 1;
        if blocks == FIRST_BLOCKS && sampled.is_empty() {
            break;
        }
    }
    Ok(sampled)
}

/// Where the vertices of some cells are.
fn places(cells: &[SampledCell], mut points: PointBlocks) -> Result<HashMap<u64, [f64; 3]>> {
    let mut places: HashMap<u64, [f64; 3]> = HashMap::new();
    for SampledCell { kind, vertices, .. } in cells {
        let mut note = |&v: &u64| {
            places.insert(v, [f64::NAN; 3]);
        };
        match kind {
            CellKind::Polyhedron => Faces::new(vertices).flatten().for_each(note),
            _ => vertices.iter().for_each(&mut note),
        }
    }
    let (mut block, mut before) = (vec![], 0u64);
    while points.next_block(&mut block)? {
        for (v, p) in (before..).zip(&block) {
            places.entry(v).and_modify(|place| *place = *p);
        }
        before += block.len() as u64;
    }
    Ok(places)
}

/// Some cells of a mesh, and where their vertices are.
struct Sample<'a> {
    path: &'a Path,
    cells: Vec<SampledCell>,
    places: HashMap<u64, [f64; 3]>,
}

impl Sample<'_> {
    fn place(&self, v: u64) -> [f64; 3] {
        self.places[&v]
    }

    /// The order in which cells of a kind have the vertices on their edges; `None` where it is
    /// VTK's, or not known.
    fn order_of(&self, kind: CellKind) -> Result<Option<Vec<usize>>> {
        let shape = kind.shape();
        let on_edges = shape.corners..shape.corners + shape.edges.len();
        let cells: Vec<_> = self.cells.iter().filter(|cell| cell.kind == kind).collect();
        if kind.vertices() < on_edges.end || cells.is_empty() {
            return Ok(None);
        }
        let place = |v: &u64| self.place(*v);
        let placed_of = |cell: &&SampledCell| {
            let corners: Vec<[f64; 3]> = cell.vertices[..shape.corners].iter().map(place).collect();
            PlacedVertices::new(shape.edges, &corners, cell.vertices[on_edges.clone()].iter().map(place))
        };
        let placed: Vec<PlacedVertices> = cells.iter().map(placed_of).collect();
        let edges = likeliest(&placed, shape.edges.len());
        let odd: Vec<usize> = (0..placed.len()).filter(|&c| !placed[c].fits(&edges)).collect();
        let order: Vec<usize> = (0..edges.len()).filter_map(|e| edges.iter().position(|&f| f == e)).collect();
        let is_usual = order.iter().copied().eq(0..edges.len());
        let most = if is_usual { placed.len() / 2 } else { placed.len() / 100 };
        // One or two odd cells tell nothing.
        if odd.len() > most && placed.len() >= 3 {
            let expected = "vertices on edges, each near the middle of its edge";
            let got = format!("those of {} of {} {} elsewhere", odd.len(), placed.len(), kind.plural());
            let help = "write the mesh in VTK's order of vertices (.vtu), or with linear cells";
            return Err(self.wrong(cells[odd[0]], expected, got).with_help(help));
        }
        Ok((!is_usual && odd.len() <= most).then_some(order))
    }

    /// An error where too many cells, in that order, are folded.
    fn refuse_folded(&self, orders: &Orders) -> Result<()> {
        let folded: Vec<_> = self.cells.iter().filter(|cell| self.is_folded(cell, orders)).collect();
        if folded.len() <= 2 || folded.len() * 100 <= self.cells.len() {
            return Ok(());
        }
        let expected = "cells whose tetrahedra are turned one way";
        let got = format!("{} of {} cells that were looked at folded over", folded.len(), self.cells.len());
        Err(self.wrong(folded[0], expected, got).with_help(match folded[0].kind {
            CellKind::Polyhedron => {
                "not all of its faces are seen from its middle: split such polyhedra into convex ones"
            }
            _ => "its vertices are in another order than the format's, or the mesh is damaged",
        }))
    }

    /// Whether tetrahedra of a cell are turned both ways.
    fn is_folded(&self, cell: &SampledCell, orders: &Orders) -> bool {
        if cell.kind == CellKind::Polyhedron {
            return is_folded(Faces::new(&cell.vertices), |v| self.place(v));
        }
        let mut one = CellBlock::default();
        one.push(cell.kind, &cell.vertices);
        orders.apply(&mut one);
        let (kind, all, added) = with_middles(cell.kind, &one.vertices, |v| self.place(v));
        let mut tets = vec![];
        split(kind, &all, &mut tets);
        let place = |v: u64| added.get((u64::MAX - v) as usize).copied().unwrap_or_else(|| self.place(v));
        let has = |way| tets.iter().any(|tet| orient(tet.map(place)) == way);
        has(Orientation::Positive) && has(Orientation::Inverted)
    }

    fn wrong(&self, cell: &SampledCell, expected: &str, got: String) -> Error {
        Error::bad_input(self.path, format!("cell {} (counted from 0)", cell.number), expected, got)
    }
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
