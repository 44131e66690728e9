//! A mesh as the pipeline reads it: which field, and checked blocks of points, values and cells.

use super::average::{Averages, Replace};
use super::blocks::{CellBlocks, Part, PointBlocks, Tuples};
use super::order::Orders;
use super::{CellField, CellFile, CellsInfo, Center, GHOSTS, survey};
use crate::error::{Error, Result};
use crate::volume::ScalarType;
use std::sync::{Arc, OnceLock};

/// Where values come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    Data { field: usize, part: Part },
    Coordinate(usize),
}

/// A field that was chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct ChosenField {
    /// As it is asked for: "pressure", "velocity.x", "velocity.magnitude".
    pub name: String,
    /// Type of a stored number.
    pub scalar: ScalarType,
    /// Where it is given.
    pub center: Center,
    source: Source,
}

/// An opened mesh, with or without a field.
#[derive(Clone)]
pub struct CellMesh {
    file: Arc<dyn CellFile>,
    field: Option<ChosenField>,
    /// In which order cells have the vertices on their edges; known when cells were first asked
    /// for.
    orders: Arc<OnceLock<Orders>>,
    /// Whether points of one place have means of their own cells, where a field is of cells.
    jumps: bool,
}

/// Components of a field, at most: a tuple is in memory.
const MOST_COMPONENTS: u32 = 1 << 16;

impl CellMesh {
    /// A mesh, with the field `wanted`: the name of a field with one component, `NAME.x`, `NAME.y`,
    /// `NAME.z` or `NAME.2` for a component of another, `NAME.magnitude`, or the coordinates `x`,
    /// `y`, `z` where no field has that name. Without `wanted`: the file's active field, else its
    /// only field on points with one component, else its only one on cells, else none yet.
    ///
    /// # Errors
    /// [`Error::Usage`], listing the fields, when there is none of that name;
    /// [`Error::BadInput`] for a field of more than 65 536 components.
    pub fn new(file: Arc<dyn CellFile>, wanted: Option<&str>) -> Result<Self> {
        let info = file.info();
        if let Some(field) = info.fields.iter().find(|f| f.components > MOST_COMPONENTS) {
            let (expected, got) = (format!("at most {MOST_COMPONENTS} components"), field.components);
            return Err(Error::bad_input(&info.path, &field.name, expected, got.to_string()));
        }
        let field = match wanted {
            Some(name) => Some(find(file.info(), name)?),
            None => default_field(file.info()),
        };
        Ok(Self { file, field, orders: Arc::default(), jumps: false })
    }

    /// The same mesh with another field.
    ///
    /// # Errors
    /// Those of [`CellMesh::new`].
    pub fn with_field(&self, name: &str) -> Result<Self> {
        let other = Self::new(Arc::clone(&self.file), Some(name))?;
        Ok(Self { orders: Arc::clone(&self.orders), jumps: self.jumps, ..other })
    }

    /// The same mesh, whose field jumps between points of one place: cell data are averaged over
    /// the cells of each point, and not over all those around its place.
    pub(crate) fn jumping(self) -> Self {
        Self { jumps: true, ..self }
    }

    /// Whether the field is of cells.
    pub fn is_of_cells(&self) -> bool {
        self.field
            .as_ref()
            .is_some_and(|field| field.center == Center::Cell && matches!(field.source, Source::Data { .. }))
    }

    /// Whether points of one place are one, whatever their cells have.
    pub fn averages_places(&self) -> bool {
        self.is_of_cells() && !self.jumps
    }

    /// What the file tells.
    pub fn info(&self) -> &CellsInfo {
        self.file.info()
    }

    /// The field that is read.
    ///
    /// # Errors
    /// [`Error::Usage`], listing the fields, when a choice is needed and was not made.
    pub fn field(&self) -> Result<&ChosenField> {
        let info = self.info();
        self.field.as_ref().ok_or_else(|| {
            let path = info.path.display();
            Error::usage(if info.fields.is_empty() {
                format!("{path}: no field; `field` x, y or z takes a coordinate as the field")
            } else {
                format!("{path}: {}, and x, y, z; choose one with `field=NAME`", list(info))
            })
        })
    }

    /// The positions of all points.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn points(&self) -> Result<PointBlocks> {
        PointBlocks::new(&*self.file)
    }

    /// The cells, their vertices in VTK's order.
    ///
    /// # Errors
    /// When the file cannot be read; [`Error::BadInput`] for vertices in an order that is not
    /// understood.
    pub fn cells(&self) -> Result<CellBlocks> {
        let stored = || CellBlocks::new(&*self.file);
        let orders = match self.orders.get() {
            Some(orders) => orders,
            None => {
                let found = survey::orders(self.info(), stored()?, || self.points())?;
                self.orders.get_or_init(|| found)
            }
        };
        Ok(stored()?.in_order(orders.clone()))
    }

    /// Whether some cells may be polyhedra.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn may_have_polyhedra(&self) -> Result<bool> {
        self.file.may_have_polyhedra()
    }

    /// A hash of all that points and cells are read from: see [`CellFile::stored_hash`].
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn stored_hash(&self) -> Result<Option<u128>> {
        self.file.stored_hash()
    }

    /// The numbers of the field `info().fields[field]` as they are stored, one a point or cell: its
    /// value, or its magnitude where it has several components.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn stored(&self, field: usize) -> Result<StoredBlocks> {
        let info = &self.info().fields[field];
        let part = if info.components == 1 { Part::Component(0) } else { Part::Magnitude };
        let count = if info.center == Center::Point { self.info().points } else { self.info().cells };
        let stream = self.file.field(field)?;
        Ok(StoredBlocks(Tuples::new(stream, info.components as usize, part, count)))
    }

    /// The values of the chosen field at all points. Cell data are averaged, in passes that take at
    /// most `memory` bytes each; other fields take a block. Points of cells whose value
    /// `is_missing` are NaN.
    ///
    /// # Errors
    /// Those of [`CellMesh::field`]; when the file cannot be read.
    pub fn values(&self, memory: u64, is_missing: impl Fn(f64) -> bool + 'static) -> Result<FieldBlocks> {
        self.values_of_places(memory, is_missing, None)
    }

    /// As [`CellMesh::values`]. Cell data are averaged over the cells around each place: `replace`
    /// puts the first point of its place in the place of each, and other points are NaN.
    ///
    /// # Errors
    /// As [`CellMesh::values`].
    pub fn values_of_places(
        &self,
        memory: u64,
        is_missing: impl Fn(f64) -> bool + 'static,
        replace: Option<Replace>,
    ) -> Result<FieldBlocks> {
        let chosen = self.field()?;
        let from = match (chosen.source, chosen.center) {
            (Source::Coordinate(axis), _) => From::Coordinate(self.points()?, axis, vec![]),
            (Source::Data { field, part }, Center::Cell) => From::Average(Averages::new(
                Arc::clone(&self.file),
                field,
                part,
                memory,
                Box::new(is_missing),
                replace,
            )),
            (Source::Data { field, part }, Center::Point) => {
                let components = self.info().fields[field].components as usize;
                From::Tuples(Tuples::new(self.file.field(field)?, components, part, self.info().points))
            }
        };
        Ok(FieldBlocks(from))
    }
}

/// The field that needs no name.
fn default_field(info: &CellsInfo) -> Option<ChosenField> {
    let scalar = |i: &usize| info.fields[*i].components == 1 && info.fields[*i].name != GHOSTS;
    let only = |center| {
        let mut found = (0..info.fields.len()).filter(|&i| info.fields[i].center == center && scalar(&i));
        found.next().filter(|_| found.next().is_none())
    };
    let points = |i: &usize| scalar(i) && info.fields[*i].center == Center::Point;
    let any_on_points = (0..info.fields.len()).any(|i| points(&i));
    let on_cells = || if any_on_points { None } else { only(Center::Cell) };
    let field = info.active.filter(scalar).or_else(|| only(Center::Point)).or_else(on_cells)?;
    Some(chosen(&info.fields[field], field, Part::Component(0), info.fields[field].name.clone()))
}

fn chosen(field: &CellField, at: usize, part: Part, name: String) -> ChosenField {
    let source = Source::Data { field: at, part };
    ChosenField { name, scalar: field.scalar, center: field.center, source }
}

fn find(info: &CellsInfo, wanted: &str) -> Result<ChosenField> {
    let named = |name: &str| info.fields.iter().position(|f| f.name == name);
    let field = |at: usize, part| Ok(chosen(&info.fields[at], at, part, wanted.into()));
    if let Some(at) = named(wanted).filter(|&at| info.fields[at].components == 1) {
        return field(at, Part::Component(0));
    }
    if let Some((name, part)) = wanted.rsplit_once('.')
        && let Some(at) = named(name)
    {
        let components = info.fields[at].components as usize;
        let component = match part {
            "magnitude" => return field(at, Part::Magnitude),
            "x" => Some(0),
            "y" => Some(1),
            "z" => Some(2),
            number => number.parse().ok(),
        };
        if let Some(i) = component.filter(|&i| i < components) {
            return field(at, Part::Component(i));
        }
    }
    if let Some(axis) = ["x", "y", "z"].iter().position(|a| *a == wanted) {
        let (scalar, center, source) = (ScalarType::F64, Center::Point, Source::Coordinate(axis));
        return Ok(ChosenField { name: wanted.into(), scalar, center, source });
    }
    Err(Error::usage(format!("{}: no scalar field {wanted}; {}", info.path.display(), list(info))))
}

/// "its fields: pressure (float32), velocity.x .y .z .magnitude (3 x float32), material (uint8, on
/// cells)"; of very many, the first.
fn list(info: &CellsInfo) -> String {
    const MOST: usize = 40;
    let one = |f: &CellField| {
        let cells = if f.center == Center::Cell { ", on cells" } else { "" };
        let (name, scalar) = (&f.name, f.scalar.name());
        match f.components {
            1 => format!("{name} ({scalar}{cells})"),
            2 => format!("{name}.x .y .magnitude (2 x {scalar}{cells})"),
            3 => format!("{name}.x .y .z .magnitude (3 x {scalar}{cells})"),
            n => format!("{name}.0 … .{} .magnitude ({n} x {scalar}{cells})", n - 1),
        }
    };
    if info.fields.is_empty() {
        return "it has no fields".into();
    }
    let mut fields: Vec<String> = info.fields.iter().take(MOST).map(one).collect();
    if info.fields.len() > MOST {
        fields.push(format!("… {} in all", info.fields.len()));
    }
    format!("its fields: {}", fields.join(", "))
}

/// The values of a field at points 0, 1, 2, …, block by block. Values may be NaN or infinite, as
/// the file has them; a point without a cell has NaN where cell data are averaged.
pub struct FieldBlocks(From);

enum From {
    Coordinate(PointBlocks, usize, Vec<[f64; 3]>),
    Tuples(Tuples),
    Average(Averages),
}

impl FieldBlocks {
    /// Puts the next values, at most [`BLOCK`](crate::cells::BLOCK), into `out` (cleared first);
    /// `false` after the last.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn next_block(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        match &mut self.0 {
            From::Coordinate(points, axis, block) => {
                let more = points.next_block(block)?;
                out.clear();
                out.extend(block.iter().map(|p| p[*axis]));
                Ok(more)
            }
            From::Tuples(tuples) => tuples.next_block(out, |v| v),
            From::Average(averages) => averages.next_block(out),
        }
    }
}

/// The stored numbers of a field, block by block.
pub struct StoredBlocks(Tuples);

impl StoredBlocks {
    /// Puts the next numbers, at most [`BLOCK`](crate::cells::BLOCK), into `out` (cleared first);
    /// `false` after the last.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn next_block(&mut self, out: &mut Vec<f64>) -> Result<bool> {
        self.0.next_block(out, |v| v)
    }
}

#[cfg(test)]
pub(crate) mod tests;
