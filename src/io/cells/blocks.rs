//! Points, cells and numbers of a file, checked, block by block.

use super::order::Orders;
use super::polyhedron::{Faces, check};
use super::{
    BLOCK, CellBlock, CellField, CellFile, CellKind, CellStream, Center, GHOSTS, NumberStream, is_ghost,
};
use crate::error::{Error, Result};
use std::path::Path;

/// What is taken of a point's or cell's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// One of them.
    Component(usize),
    /// The root of the sum of their squares.
    Magnitude,
}

impl Part {
    /// The value of a tuple.
    pub(super) fn of(self, tuple: &[f64]) -> f64 {
        match self {
            Self::Component(i) => tuple[i],
            Self::Magnitude => tuple.iter().map(|x| x * x).sum::<f64>().sqrt(),
        }
    }
}

/// The positions of points 0, 1, 2, …, block by block.
pub struct PointBlocks {
    path: Box<Path>,
    stream: Box<dyn NumberStream>,
    left: u64,
    at: u64,
    numbers: Vec<f64>,
}

impl PointBlocks {
    pub(super) fn new(file: &dyn CellFile) -> Result<Self> {
        let info = file.info();
        let (path, left) = (info.path.clone().into(), info.points);
        Ok(Self { path, stream: file.points()?, left, at: 0, numbers: vec![] })
    }

    /// Puts the next positions, at most [`BLOCK`], into `out` (cleared first); `false` after the
    /// last.
    ///
    /// # Errors
    /// When the file cannot be read; [`Error::BadInput`] for a coordinate that is not finite.
    pub fn next_block(&mut self, out: &mut Vec<[f64; 3]>) -> Result<bool> {
        out.clear();
        let n = self.left.min(BLOCK as u64) as usize;
        if n == 0 {
            self.stream.finish()?;
            return Ok(false);
        }
        self.numbers.resize(3 * n, 0.0);
        self.stream.fill(&mut self.numbers)?;
        out.extend(self.numbers.chunks_exact(3).map(|p| [p[0], p[1], p[2]]));
        if let Some(bad) = out.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            let ([x, y, z], point) = (out[bad], self.at + bad as u64);
            let got = format!("({x}, {y}, {z})");
            return Err(Error::bad_input(&self.path, format!("point {point}"), "finite coordinates", got));
        }
        self.left -= n as u64;
        self.at += n as u64;
        Ok(true)
    }
}

/// The cells in file order, block by block; those without a volume included. Cells that the file
/// marks as ghosts (copies of another piece's cells, or hidden) count as cells without a volume.
pub struct CellBlocks {
    path: Box<Path>,
    stream: Box<dyn CellStream>,
    points: u64,
    at: u64,
    /// The marks of ghosts.
    marks: Option<Box<dyn NumberStream>>,
    numbers: Vec<f64>,
    ghosts: u64,
    orders: Orders,
}

impl CellBlocks {
    pub(super) fn new(file: &dyn CellFile) -> Result<Self> {
        let info = file.info();
        let is_mark = |f: &CellField| f.name == GHOSTS && f.center == Center::Cell && f.components == 1;
        let marks = info.fields.iter().position(is_mark).map(|i| file.field(i)).transpose()?;
        Ok(Self {
            path: info.path.clone().into(),
            stream: file.cells()?,
            points: info.points,
            at: 0,
            marks,
            numbers: vec![],
            ghosts: 0,
            orders: Orders::default(),
        })
    }

    /// The same cells, their vertices put into VTK's order.
    pub(super) fn in_order(self, orders: Orders) -> Self {
        Self { orders, ..self }
    }

    /// How many ghosts there were so far.
    pub fn ghosts(&self) -> u64 {
        self.ghosts
    }

    /// Puts the next cells, at most [`BLOCK`], into `out` (cleared first); `false` after the last.
    ///
    /// # Errors
    /// When the file cannot be read; [`Error::BadInput`] for a vertex number that no point has, and
    /// for a polyhedron whose faces do not close.
    pub fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        if !self.stream.next_block(out)? {
            self.marks.as_mut().map_or(Ok(()), |marks| marks.finish())?;
            return Ok(false);
        }
        if let Some(marks) = &mut self.marks {
            self.numbers.resize(out.len(), 0.0);
            marks.fill(&mut self.numbers)?;
            self.ghosts += self.numbers.iter().filter(|&&m| is_ghost(m)).count() as u64;
            out.flatten(|i| is_ghost(self.numbers[i]));
        }
        let wrong = |i: usize, expected: String, got: String| {
            let at = format!("cell {} (counted from 0)", self.at + i as u64);
            Error::bad_input(&self.path, at, expected, got)
        };
        let beyond = |vertices: &[u64]| vertices.iter().copied().find(|&v| v >= self.points);
        for (i, (kind, vertices)) in out.iter().enumerate() {
            let found = match kind {
                CellKind::Polyhedron => Faces::new(vertices).find_map(beyond),
                _ => beyond(vertices),
            };
            if let Some(v) = found {
                let expected = format!("vertices among {} points", self.points);
                return Err(wrong(i, expected, format!("point {v} (counted from 0)")));
            }
        }
        for i in 0..out.len() {
            if out.kinds[i] == CellKind::Polyhedron {
                check(out.of_mut(i)).map_err(|(expected, got)| {
                    let help = "the mesh is damaged; each polyhedron must be closed by its faces";
                    wrong(i, expected.into(), got).with_help(help)
                })?;
            }
        }
        self.at += out.len() as u64;
        self.orders.apply(out);
        Ok(true)
    }
}

/// A part of tuples of numbers.
pub(super) struct Tuples {
    stream: Box<dyn NumberStream>,
    components: usize,
    part: Part,
    left: u64,
    numbers: Vec<f64>,
}

impl Tuples {
    pub(super) fn new(stream: Box<dyn NumberStream>, components: usize, part: Part, count: u64) -> Self {
        Self { stream, components, part, left: count, numbers: vec![] }
    }

    /// The next values, at most [`BLOCK`] and about as many numbers; `false` after the last.
    pub(super) fn next_block<T>(&mut self, out: &mut Vec<T>, convert: impl Fn(f64) -> T) -> Result<bool> {
        out.clear();
        // A tuple of very many components is gone through in a row, but not many at a time.
        let most = (16 * BLOCK / self.components).clamp(1, BLOCK) as u64;
        let n = self.left.min(most) as usize;
        if n == 0 {
            self.stream.finish()?;
            return Ok(false);
        }
        self.numbers.resize(n * self.components, 0.0);
        self.stream.fill(&mut self.numbers)?;
        out.extend(self.numbers.chunks_exact(self.components).map(|t| convert(self.part.of(t))));
        self.left -= n as u64;
        Ok(true)
    }
}
