//! Meshes as pairs of text tables: TetGen's `.node` and `.ele`, and points and tetrahedra as `.pts`
//! and `.tet`.
//!
//! ```text
//! body.node                                     body.ele
//! 4 3 1 0      points, 3, attributes, marker    1 4 1        cells, vertices of each, attributes
//! 1  0 0 0  0.5                                 1  1 2 3 4  7
//! 2  1 0 0  0.7
//! …            number, x, y, z, attributes      …            number, vertices, attributes
//! ```
//!
//! Cells of second order have ten vertices: the corners 1 to 4, then the middles of the edges 34,
//! 14, 12, 23, 24, 13 (`tetgen -o2`, as of its version 1.5).
//!
//! Numbers count from 0 or from 1, as the first point's does, and must be in order. `#` begins a
//! comment. Attributes of points are the fields `attribute` (or `attribute1`, `attribute2`, …),
//! those of cells are `region` (…); boundary markers are skipped.
//!
//! A `.pts` file has x, y, z on each line, a `.tet` file four vertices. Neither has a header (a
//! first line of one number, the count, is allowed). Vertices count from 1, unless a 0 occurs: a
//! first pass over the tetrahedra finds that out.
//!
//! Values of a field can come from a third file (`value_file`) with one number for each point;
//! the field has the file's name. Either file of a pair may be named; the other lies next to it.
//! Everything is read row by row.

use crate::bytes::{ByteSource, IoMode};
use crate::cells::{
    BLOCK, CellBlock, CellField, CellFile, CellKind, CellMesh, CellStream, CellsInfo, Center, NumberStream,
};
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::mesh_file::MeshFile;
use crate::formats::shared::text::{place, word};
use crate::formats::shared::{OpenOptions, has_suffix};
use crate::volume::ScalarType;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// TetGen, and points and tetrahedra as text: two files each.
pub(in crate::formats) struct Tetgen;

static ABOUT: About = About {
    meshes: &["TetGen", ".pts and .tet"],
    suffixes: &[".node", ".ele", ".pts", ".tet"],
    has_value_file: true,
    ..About::named("a mesh of two text files")
};

impl Format for Tetgen {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        Ok(Box::new(PairFile { pair: MeshFile::new(Pair::open(head)?)?, io: head.io }))
    }
}

/// A pair of files, which may have a third one with values.
struct PairFile {
    pair: MeshFile<Pair>,
    io: IoMode,
}

impl Dataset for PairFile {
    fn is_mesh(&self) -> bool {
        true
    }

    fn files(&self) -> Vec<PathBuf> {
        self.pair.data_files()
    }

    fn mesh(&self, options: &OpenOptions) -> Result<CellMesh> {
        let Some(values) = &options.values else { return self.pair.of_field(options) };
        let mut pair = Pair::clone(&self.pair.file);
        pair.add_values(&Arc::new(ByteSource::open(values, self.io)?))?;
        CellMesh::new(Arc::new(pair), options.field.as_deref())
    }
}

/// More attributes than this are a mistake in the head.
const MOST_ATTRIBUTES: u64 = 1000;

impl Pair {
    /// Opens a pair of files, one of which is named.
    ///
    /// # Errors
    /// [`Error::BadInput`] for malformed files or when one is missing.
    fn open(head: &Head<'_>) -> Result<Self> {
        let path = head.path;
        let tetgen = has_suffix(path, &[".node", ".ele"]);
        let suffixes = if tetgen { ["node", "ele"] } else { ["pts", "tet"] };
        let [points, cells] = suffixes.map(|s| path.with_extension(s));
        for file in [&points, &cells] {
            if !file.is_file() {
                let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                let at = "the other file of the pair";
                return Err(Error::bad_input(path, at, name, "none of that name beside it"));
            }
        }
        let open = |file: &Path| match file == path {
            true => head.file().map(Arc::clone),
            false => Ok(Arc::new(ByteSource::open(file, head.io)?)),
        };
        let (points, cells) = (open(&points)?, open(&cells)?);
        let mut pair =
            if tetgen { tetgen_pair(path, &points, &cells)? } else { bare_pair(path, &points, &cells)? };
        pair.info.data_files = vec![points.path().to_path_buf(), cells.path().to_path_buf()];
        Ok(pair)
    }
}

fn tetgen_pair(path: &Path, points: &Arc<ByteSource>, cells: &Arc<ByteSource>) -> Result<Pair> {
    let (head, start) = head(points, 2, "points, 3, attributes, 0 or 1")?;
    let marker = head.get(3).copied().unwrap_or(0);
    if head[1] != 3 || head.get(2).is_some_and(|&n| n > MOST_ATTRIBUTES) || marker > 1 {
        let got = format!("{} dimensions, {} attributes", head[1], head[2]);
        return Err(Error::bad_input(points.path(), "line 1", "points, 3, attributes, 0 or 1", got));
    }
    let attributes = head[2] as usize;
    let first = first_number(points, start)?;
    let columns = 3 + attributes + marker as usize;
    let points = Table { source: Arc::clone(points), start, rows: head[0], columns, numbered: Some(first) };
    let (head, start) = self::head(cells, 2, "cells, 4, attributes")?;
    let regions = head.get(2).copied().unwrap_or(0);
    let kind = match head[1] {
        4 => Some(CellKind::Tetrahedron),
        10 => Some(CellKind::QuadraticTetrahedron),
        _ => None,
    };
    let kind = kind.filter(|_| regions <= MOST_ATTRIBUTES).ok_or_else(|| {
        let got = format!("cells of {} vertices, {regions} attributes", head[1]);
        Error::bad_input(cells.path(), "line 1", "cells of 4 or 10 vertices", got)
    })?;
    let columns = kind.vertices() + regions as usize;
    let cells = Table { source: Arc::clone(cells), start, rows: head[0], columns, numbered: Some(first) };
    let mut pair = Pair::new(path, "TetGen .node and .ele", points, cells, first);
    pair.kind = kind;
    for (name, n, center, column) in [
        ("attribute", attributes, Center::Point, 3),
        ("region", regions as usize, Center::Cell, kind.vertices()),
    ] {
        for i in 0..n {
            let name = if n == 1 { name.into() } else { format!("{name}{}", i + 1) };
            let of = if center == Center::Point { Of::Points } else { Of::Cells };
            pair.add_field(name, center, of, column + i);
        }
    }
    Ok(pair)
}

fn bare_pair(path: &Path, points: &Arc<ByteSource>, cells: &Arc<ByteSource>) -> Result<Pair> {
    let (points, cells) = (bare_table(points, 3)?, bare_table(cells, 4)?);
    let (mut rows, mut least, mut most) = (Rows::new(&cells), u64::MAX, 0);
    let mut vertices = [0; 4];
    for _ in 0..cells.rows {
        rows.ids(&mut vertices)?;
        least = vertices.iter().copied().fold(least, u64::min);
        most = vertices.iter().copied().fold(most, u64::max);
    }
    let first = u64::from(least > 0);
    let format = format!("points and tetrahedra as text, counted from {first}");
    Ok(Pair::new(path, &format, points, cells, first))
}

/// A table without a head, but perhaps with its count.
fn bare_table(source: &Arc<ByteSource>, columns: usize) -> Result<Table> {
    let mut table = Table { source: Arc::clone(source), start: 0, rows: 0, columns, numbered: None };
    let mut rows = Rows::new(&table);
    let mut first = true;
    let mut counted = None;
    while let Some(words) = rows.count_words()? {
        if first && words == 1 {
            counted = head(source, 1, "a count").ok().map(|(head, _)| head[0]);
            table.start = rows.at;
        } else {
            table.rows += 1;
        }
        first = false;
    }
    match counted.filter(|&n| n != table.rows) {
        Some(n) => {
            Err(Error::bad_input(source.path(), "line 1", format!("{} rows", table.rows), n.to_string()))
        }
        None => Ok(table),
    }
}

/// The integers of the first line that is no comment, at least `least` of them, and the byte after
/// it.
fn head(source: &Arc<ByteSource>, least: usize, expected: &str) -> Result<(Vec<u64>, u64)> {
    let table = Table { source: Arc::clone(source), start: 0, rows: 1, columns: 0, numbered: None };
    let rows = Rows::new(&table);
    let mut numbers = vec![];
    let (line, end) = rows.line()?.ok_or_else(|| rows.wrong(expected, "the end of the file"))?;
    for text in line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()) {
        let number = std::str::from_utf8(text).ok().and_then(|w| w.parse().ok());
        numbers.push(number.ok_or_else(|| rows.wrong(expected, String::from_utf8_lossy(line).into_owned()))?);
    }
    if numbers.len() < least || numbers.len() > 4 {
        return Err(rows.wrong(expected, String::from_utf8_lossy(line).into_owned()));
    }
    if numbers.len() == 2 {
        numbers.push(0);
    }
    // A row takes a digit and a line end.
    if numbers[0] > source.len() {
        return Err(rows.wrong(format!("fewer rows than bytes ({})", source.len()), numbers[0].to_string()));
    }
    Ok((numbers, end))
}

/// The number of the first row: 0 or 1.
fn first_number(source: &Arc<ByteSource>, start: u64) -> Result<u64> {
    let table = Table { source: Arc::clone(source), start, rows: 1, columns: 0, numbered: None };
    let rows = Rows::new(&table);
    let line = rows.line()?.map(|(line, _)| line).unwrap_or_default();
    let first = line.split(u8::is_ascii_whitespace).find(|w| !w.is_empty()).unwrap_or_default();
    match first {
        b"0" => Ok(0),
        b"1" => Ok(1),
        other => {
            Err(rows.wrong("the first point, numbered 0 or 1", String::from_utf8_lossy(other).into_owned()))
        }
    }
}

/// Rows of numbers in a text file.
#[derive(Clone)]
struct Table {
    source: Arc<ByteSource>,
    /// The byte where the first row begins, or comments before it.
    start: u64,
    rows: u64,
    /// Numbers of a row, its own number not counted.
    columns: usize,
    /// Whether rows have numbers, and the first one's.
    numbered: Option<u64>,
}

/// Goes through a table.
struct Rows {
    table: Table,
    at: u64,
    row: u64,
}

impl Rows {
    fn new(table: &Table) -> Self {
        Self { table: table.clone(), at: table.start, row: 0 }
    }

    /// The next line that is not empty, without its comment, and the byte after it.
    fn line(&self) -> Result<Option<(&[u8], u64)>> {
        let source = &self.table.source;
        let mut at = self.at;
        while at < source.len() {
            let rest = source.slice(at..source.len())?;
            let end = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
            let line = &rest[..end];
            let line = &line[..line.iter().position(|&b| b == b'#').unwrap_or(end)];
            at = (at + end as u64 + 1).min(source.len());
            if !line.trim_ascii().is_empty() {
                return Ok(Some((line, at)));
            }
        }
        Ok(None)
    }

    /// Goes over a line and counts its words.
    fn count_words(&mut self) -> Result<Option<usize>> {
        let found = self.line()?;
        let found = found
            .map(|(line, end)| (line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).count(), end));
        Ok(found.map(|(words, end)| {
            self.at = end;
            words
        }))
    }

    /// Hands the words of the next row to `each`, which says whether a word is what it should be.
    fn row(&mut self, mut each: impl FnMut(usize, &str) -> bool) -> Result<()> {
        let table = &self.table;
        let expected = || match table.numbered {
            Some(first) => format!("row {} with its {} numbers", self.row + first, table.columns),
            None => format!("{} numbers", table.columns),
        };
        let Some((line, end)) = self.line()? else {
            // A file that was cut meanwhile reads as zeros.
            table.source.check()?;
            return Err(self.wrong(expected(), format!("the end of the file after {} rows", self.row)));
        };
        let (mut at, mut column, mut good) = (0, 0, true);
        let own = usize::from(table.numbered.is_some());
        while let Some((from, to)) = word(line, at) {
            let text = std::str::from_utf8(&line[from..to]).unwrap_or_default();
            good &= match table.numbered {
                Some(first) if column == 0 => text.parse() == Ok(self.row + first),
                _ => column < table.columns + own && each(column - own, text),
            };
            (at, column) = (to, column + 1);
        }
        if !good || column != table.columns + own {
            return Err(self.wrong(expected(), String::from_utf8_lossy(line.trim_ascii()).into_owned()));
        }
        self.at = end;
        self.row += 1;
        if self.row.is_multiple_of(BLOCK as u64) || self.row == table.rows {
            table.source.check()?;
        }
        Ok(())
    }

    /// The first columns of the next row as numbers of points.
    fn ids(&mut self, out: &mut [u64]) -> Result<()> {
        self.row(|column, text| match out.get_mut(column) {
            Some(slot) => text.parse().map(|v| *slot = v).is_ok(),
            None => true,
        })
    }

    /// After the last row.
    fn finish(&self) -> Result<()> {
        match self.line()? {
            None => Ok(()),
            Some((line, _)) => {
                let got = format!("more: {}", String::from_utf8_lossy(line.trim_ascii()));
                Err(self.wrong(format!("the end of the file after {} rows", self.table.rows), got))
            }
        }
    }

    fn wrong(&self, expected: impl Into<String>, got: impl Into<String>) -> Error {
        let source = &self.table.source;
        // The line that is wrong is the next one that is not empty.
        let next = self.line().ok().flatten().map_or(self.at, |(_, end)| end.saturating_sub(1));
        let place = source.slice(0..source.len()).map(|bytes| place(bytes, next as usize));
        Error::bad_input(source.path(), place.unwrap_or_default(), expected, got)
    }
}

/// The table that a field is in.
#[derive(Clone, Copy)]
enum Of {
    Points,
    Cells,
    Values,
}

/// A mesh in two tables.
#[derive(Clone)]
struct Pair {
    info: CellsInfo,
    points: Table,
    cells: Table,
    values: Option<Table>,
    /// The number of the first point.
    first: u64,
    /// The kind of all cells.
    kind: CellKind,
    /// Where the fields are: a table and a column of it.
    places: Vec<(Of, usize)>,
}

impl Pair {
    fn new(path: &Path, format: &str, points: Table, cells: Table, first: u64) -> Self {
        let info = CellsInfo {
            path: path.to_path_buf(),
            format: format.into(),
            points: points.rows,
            cells: cells.rows,
            fields: vec![],
            active: None,
            data_files: vec![],
        };
        Self { info, points, cells, values: None, first, kind: CellKind::Tetrahedron, places: vec![] }
    }

    fn add_field(&mut self, name: String, center: Center, of: Of, column: usize) {
        self.info.fields.push(CellField { name, scalar: ScalarType::F64, components: 1, center });
        self.places.push((of, column));
    }

    fn add_values(&mut self, source: &Arc<ByteSource>) -> Result<()> {
        let table = Table {
            source: Arc::clone(source),
            start: 0,
            rows: self.info.points,
            columns: 1,
            numbered: None,
        };
        let name = source.path().file_stem().unwrap_or_default().to_string_lossy().into_owned();
        self.info.active = Some(self.info.fields.len());
        self.add_field(name, Center::Point, Of::Values, 0);
        self.info.data_files.push(source.path().to_path_buf());
        self.values = Some(table);
        Ok(())
    }
}

impl CellFile for Pair {
    fn info(&self) -> &CellsInfo {
        &self.info
    }

    fn points(&self) -> Result<Box<dyn NumberStream>> {
        Ok(Box::new(Columns { rows: Rows::new(&self.points), first: 0, count: 3 }))
    }

    fn cells(&self) -> Result<Box<dyn CellStream>> {
        Ok(Box::new(Tets { rows: Rows::new(&self.cells), first: self.first, kind: self.kind }))
    }

    fn field(&self, field: usize) -> Result<Box<dyn NumberStream>> {
        let (of, column) = self.places[field];
        let table = match of {
            Of::Points => &self.points,
            Of::Cells => &self.cells,
            Of::Values => self.values.as_ref().expect("the field was added with its table"),
        };
        Ok(Box::new(Columns { rows: Rows::new(table), first: column, count: 1 }))
    }
}

/// Some columns of a table.
struct Columns {
    rows: Rows,
    first: usize,
    count: usize,
}

impl NumberStream for Columns {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        for tuple in out.chunks_exact_mut(self.count) {
            let first = self.first;
            self.rows.row(|column, text| match column.checked_sub(first).and_then(|i| tuple.get_mut(i)) {
                Some(slot) => text.parse().map(|v| *slot = v).is_ok(),
                None => true,
            })?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        self.rows.finish()
    }
}

struct Tets {
    rows: Rows,
    first: u64,
    kind: CellKind,
}

/// Where VTK's vertices of a tetrahedron of second order, with the middles of the edges 12, 23, 31,
/// 14, 24, 34, are in TetGen's.
const IN_VTK_ORDER: [usize; 10] = [0, 1, 2, 3, 6, 7, 9, 5, 8, 4];

impl CellStream for Tets {
    fn next_block(&mut self, out: &mut CellBlock) -> Result<bool> {
        out.clear();
        let n = (self.rows.table.rows - self.rows.row).min(BLOCK as u64);
        for _ in 0..n {
            let mut vertices = [0; 10];
            let n = self.kind.vertices();
            self.rows.ids(&mut vertices[..n])?;
            if let Some(v) = vertices[..n].iter().find(|&&v| v < self.first) {
                let cell = self.rows.row - 1 + self.first;
                let expected = format!("vertices counted from {}, as points are", self.first);
                let path = self.rows.table.source.path();
                return Err(Error::bad_input(path, format!("cell {cell}"), expected, format!("vertex {v}")));
            }
            let ordered = IN_VTK_ORDER.map(|i| vertices[i].saturating_sub(self.first));
            out.push(self.kind, &ordered[..n]);
        }
        if n == 0 {
            self.rows.finish()?;
        }
        Ok(n > 0)
    }
}

#[cfg(test)]
mod tests;
