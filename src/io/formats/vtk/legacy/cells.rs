//! Unstructured grids in legacy files.
//!
//! ```text
//! DATASET UNSTRUCTURED_GRID
//! POINTS 5 float
//! …
//! CELLS 2 10                           cells, and numbers that follow
//! 4 0 1 2 3  4 1 2 3 4                 for each cell: how many vertices, then these
//! CELL_TYPES 2
//! 10 10
//! ```
//!
//! Since version 5.1 the cells are two arrays, the first with one entry more than there are cells:
//!
//! ```text
//! CELLS 3 8
//! OFFSETS vtktypeint64
//! 0 4 8
//! CONNECTIVITY vtktypeint64
//! 0 1 2 3  1 2 3 4
//! ```

use super::scan::{Connectivity, Dataset, LegacyArray, Scanned, Scanner, Type};
use crate::bytes::ByteSource;
use crate::cells::{
    BLOCK, CellBlock, CellField, CellFile, CellKind, CellStream, CellsInfo, Center, NumberStream,
};
use crate::error::{Error, Result};
use crate::formats::shared::ranges::{Ids, RangeNumbers};
use crate::volume::ScalarType;
use std::ops::Range;
use std::sync::Arc;

/// Opens the grid of a file.
pub(super) fn open(source: &Arc<ByteSource>) -> Result<Grid> {
    let path = source.path();
    let file = Scanner::new(path, source.slice(0..source.len())?, &[Dataset::UnstructuredGrid])?.scan()?;
    let lacks = |what: &str| Error::bad_input(path, "DATASET UNSTRUCTURED_GRID", what, "none");
    let points = file.points.as_ref().ok_or_else(|| lacks("POINTS"))?;
    if !matches!(points.kind, Type::Number(_)) {
        return Err(Error::bad_input(path, "POINTS", "numbers", "bits or strings"));
    }
    let cells = file.connectivity.as_ref().ok_or_else(|| lacks("CELLS"))?.cells();
    let types = file.types.as_ref().ok_or_else(|| lacks("CELL_TYPES"))?.0;
    if types != cells {
        return Err(Error::bad_input(path, "CELL_TYPES", format!("{cells} cell types"), types.to_string()));
    }
    let arrays = file.arrays.iter().map(|a| (a, Center::Point));
    let arrays = arrays.chain(file.cell_arrays.iter().map(|a| (a, Center::Cell)));
    let (mut fields, mut places, mut active) = (vec![], vec![], None);
    for (array, center) in arrays {
        let Some(f) = array.field() else { continue };
        if array.is_scalars && center == Center::Point && active.is_none() {
            active = Some(fields.len());
        }
        fields.push(CellField { name: f.name, scalar: f.scalar, components: f.components, center });
        places.push(array.data.clone());
    }
    let info = CellsInfo {
        path: path.to_path_buf(),
        format: format!("legacy VTK unstructured grid ({})", if file.binary { "binary" } else { "ascii" }),
        points: file.point_count,
        cells,
        fields,
        active,
        data_files: vec![],
    };
    Ok(Grid(Arc::new(Shared { info, source: Arc::clone(source), file, places })))
}

struct Shared {
    info: CellsInfo,
    source: Arc<ByteSource>,
    file: Scanned,
    /// Where the fields lie.
    places: Vec<Range<u64>>,
}

impl Shared {
    fn numbers(&self, data: &Range<u64>, scalar: ScalarType) -> RangeNumbers {
        super::numbers(&self.source, &self.file, data, scalar)
    }

    /// Integers: `int` in a binary file, any width in a text.
    fn ints(&self, data: &Range<u64>, count: u64) -> Ids {
        let scalar = if self.file.binary { ScalarType::I32 } else { ScalarType::I64 };
        Ids::new(self.numbers(data, scalar), count)
    }

    fn array(&self, array: &LegacyArray, count: u64) -> Result<Ids> {
        match array.kind {
            Type::Number(scalar) if !scalar.is_float() => {
                Ok(Ids::new(self.numbers(&array.data, scalar), count))
            }
            _ => Err(Error::bad_input(&self.info.path, &array.name[..], "integers", "another type")),
        }
    }
}

/// An opened grid.
pub(super) struct Grid(Arc<Shared>);

impl Grid {
    /// The file, and what was found in it.
    pub(super) fn scanned(&self) -> (&Arc<ByteSource>, &Scanned) {
        (&self.0.source, &self.0.file)
    }
}

impl CellFile for Grid {
    fn info(&self) -> &CellsInfo {
        &self.0.info
    }

    fn points(&self) -> Result<Box<dyn NumberStream>> {
        let points = self.0.file.points.as_ref().expect("it was seen when the file was opened");
        let Type::Number(scalar) = points.kind else { unreachable!("that was seen when it was opened") };
        Ok(Box::new(self.0.numbers(&points.data, scalar)))
    }

    fn cells(&self) -> Result<Box<dyn CellStream>> {
        let file = &self.0.file;
        let (count, types) = file.types.as_ref().expect("it was seen when the file was opened");
        let types = self.0.ints(types, *count);
        let lists = match file.connectivity.as_ref().expect("it was seen when the file was opened") {
            Connectivity::Counted { numbers, data, .. } => Lists::Counted(self.0.ints(data, *numbers)),
            Connectivity::Offsets { offsets, offset_array, vertices, vertex_array } => Lists::Offsets {
                offsets: self.0.array(offset_array, *offsets)?,
                vertices: self.0.array(vertex_array, *vertices)?,
                last: None,
            },
        };
        Ok(Box::new(LegacyCells { shared: Arc::clone(&self.0), types, lists, at: 0, vertices: vec![] }))
    }

    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>> {
        Ok(Box::new(self.0.numbers(&self.0.places[field], self.0.info.fields[field].scalar)))
    }
}

/// The vertices of one cell after another.
enum Lists {
    Counted(Ids),
    Offsets { offsets: Ids, vertices: Ids, last: Option<u64> },
}

struct LegacyCells {
    shared: Arc<Shared>,
    types: Ids,
    lists: Lists,
    /// Cells read.
    at: u64,
    vertices: Vec<u64>,
}

impl LegacyCells {
    fn wrong(&self, expected: impl Into<String>, got: impl Into<String>) -> Error {
        let at = format!("cell {} (counted from 0)", self.at);
        Error::bad_input(&self.shared.info.path, at, expected, got)
    }

    /// How many vertices the next cell has.
    fn count(&mut self) -> Result<u64> {
        let (count, expected) = match &mut self.lists {
            Lists::Counted(numbers) => (numbers.next()?, "a number of vertices"),
            Lists::Offsets { offsets, last, .. } => {
                let from = match *last {
                    None => offsets.next()?.filter(|&first| first == 0),
                    known => known,
                };
                *last = offsets.next()?;
                (last.zip(from).and_then(|(end, start)| end.checked_sub(start)), "offsets that ascend from 0")
            }
        };
        count.ok_or_else(|| self.wrong(expected, "others, or the end of the list"))
    }

    fn read(&mut self, out: &mut CellBlock) -> Result<()> {
        let kind = self.types.next()?.expect("there are as many types as cells");
        let kind = CellKind::from_vtk(kind).map_err(|name| {
            let expected = "a linear or quadratic cell: tetrahedron, hexahedron, voxel, wedge, pyramid";
            self.wrong(expected, name).with_help("convert it to tetrahedra first")
        })?;
        let count = self.count()?;
        if kind != CellKind::Flat && count != kind.vertices() as u64 {
            let expected = format!("{} vertices of {}", kind.vertices(), kind.plural());
            return Err(self.wrong(expected, count.to_string()));
        }
        self.vertices.clear();
        for _ in 0..count {
            let (Lists::Counted(vertices) | Lists::Offsets { vertices, .. }) = &mut self.lists;
            let vertex = vertices.next()?;
            let vertex =
                vertex.ok_or_else(|| self.wrong(format!("{count} vertices"), "the end of the list"))?;
            if kind != CellKind::Flat {
                self.vertices.push(vertex);
            }
        }
        out.push(kind, &self.vertices);
        self.at += 1;
        Ok(())
    }
}

impl CellStream for LegacyCells {
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        out.clear();
        let n = (self.shared.info.cells - self.at).min(BLOCK as u64);
        (0..n).try_for_each(|_| self.read(out))?;
        let (Lists::Counted(vertices) | Lists::Offsets { vertices, .. }) = &mut self.lists;
        if n == 0 && vertices.next()?.is_some() {
            return Err(self.wrong("the end of the list of vertices", "more numbers"));
        }
        Ok(n > 0)
    }
}
