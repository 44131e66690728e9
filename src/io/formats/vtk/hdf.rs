//! VTKHDF: what files of surfaces and of meshes have in common. Images are the business of the
//! reader of HDF5.
//!
//! ```text
//! /VTKHDF                    attributes: Version, two integers; Type, a word
//!   NumberOfPoints           an entry for each piece, as in the other NumberOf…
//!   Points                   x, y, z of the points of all pieces
//!   PointData/NAME, CellData/NAME, FieldData/NAME
//!                            those with an attribute Attribute are active: Scalars, Normals.
//!                            VTK 9.3 reads all but that
//!   Offsets                  of each piece one more than its cells, from 0 on: where the vertices of a cell begin
//!   Connectivity             the vertices of all cells, counted in their piece from 0 on
//!   NumberOfCells, NumberOfConnectivityIds
//! ```
//!
//! A mesh has the last four, and `Types`; a surface has them in each of the groups `Vertices`,
//! `Lines`, `Polygons` and `Strips`. Files of several steps have a group `Steps`, and are refused.
//!
//! We write one piece. `/comments` has the lines that other formats have as comments: VTK passes
//! over what is not in `/VTKHDF`.
//!
//! The format: "VTKHDF File Format" 2.6, docs.vtk.org.

use crate::cells::NumberStream;
use crate::error::{Error, Result};
use crate::formats::shared::arrays::{ArrayInfo, Arrays};
use crate::formats::shared::hdf5_head::{Dataset, Group, Value};
use crate::volume::ScalarType;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The name of the lines of text.
const COMMENTS: &str = "comments";

/// A file to be written: its root group, of a type, with comments, and what is in `/VTKHDF`.
pub fn root(kind: &str, comments: &[String], group: Group) -> Group {
    let mut root = Group::default();
    if !comments.is_empty() {
        root.add(COMMENTS, Value::lines(comments));
    }
    // The version that has the attribute Attribute; readers look at the 2.
    root.add_group("VTKHDF", group.with("Version", Value::integers(&[2, 6])).with("Type", Value::word(kind)));
    root
}

/// A number of one piece.
pub fn count(n: u64) -> Value {
    Value::integers(&[n as i64])
}

/// The group that says where each of so many steps is.
pub fn steps(count: u64) -> Group {
    Group::default().with("NSteps", Value::integer(count as i64))
}

/// The same array, which is the active one of a kind: "Scalars", "Normals".
pub fn active(dataset: Dataset, kind: &str) -> Dataset {
    dataset.with("Attribute", Value::word(kind))
}

/// The name that an array has in a group of these others: HDF5 takes no "/" in it, no name twice,
/// and neither "" nor ".".
pub fn array_name(name: &str, others: &[&str]) -> String {
    let mut name = name.replace(['/', '\0'], "_");
    while name.is_empty() || name == "." || others.contains(&name.as_str()) {
        name.push('_');
    }
    name
}

/// Most pieces of a file.
const MOST_PIECES: u64 = 1 << 20;
/// Numbers that are read at one time.
const AT_A_TIME: u64 = 4096;

/// A file that is read.
pub struct HdfFile {
    pub(in crate::formats) path: PathBuf,
    pub(in crate::formats) arrays: Arc<dyn Arrays>,
    /// Points of each piece.
    pub(in crate::formats) points: Vec<u64>,
}

impl HdfFile {
    /// A file of one step.
    ///
    /// # Errors
    /// [`Error::BadInput`] for several steps, or points of another number or form.
    pub fn new(path: &Path, arrays: Arc<dyn Arrays>) -> Result<Self> {
        let mut file = Self { path: path.to_path_buf(), arrays, points: vec![] };
        if file.arrays.names().iter().any(|name| name.starts_with("VTKHDF/Steps/")) {
            return Err(file.wrong("Steps", "a VTKHDF file of one step", "a file of several").with_help(
                "write each step to a file of its own, and a .pvd list of them, e.g. with ParaView",
            ));
        }
        file.points = file.counts("NumberOfPoints")?;
        let points = file.expect("Points", &[file.point_count(), 3])?;
        if !points.scalar.is_float() {
            return Err(file.wrong("Points", "floating-point numbers", points.scalar.name()));
        }
        Ok(file)
    }

    pub fn point_count(&self) -> u64 {
        self.points.iter().sum()
    }

    /// The error of an array.
    pub fn wrong(&self, name: &str, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(&self.path, format!("/VTKHDF/{name}"), expected, got)
    }

    /// An array of the file.
    pub fn array(&self, name: &str) -> Result<Option<ArrayInfo>> {
        self.arrays.array(&format!("VTKHDF/{name}"))
    }

    /// The arrays in a group, by their names there.
    pub fn names_in(&self, group: &str) -> Vec<String> {
        let prefix = format!("VTKHDF/{group}/");
        self.arrays.names().iter().filter_map(|name| name.strip_prefix(&prefix)).map(String::from).collect()
    }

    /// Whether an array is the active one of a kind.
    pub fn is_active(&self, name: &str, kind: &str) -> bool {
        self.arrays.attribute(&format!("VTKHDF/{name}"), "Attribute").eq_ignore_ascii_case(kind)
    }

    /// An array of a shape.
    fn expect(&self, name: &str, shape: &[u64]) -> Result<ArrayInfo> {
        let array = self.array(name)?;
        let array = array.ok_or_else(|| self.wrong(name, format!("numbers {shape:?}"), "none"))?;
        if array.shape != shape {
            return Err(self.wrong(name, format!("numbers {shape:?}"), format!("{:?}", array.shape)));
        }
        Ok(array)
    }

    /// The lines of comment that [`root`] writes; none of other files.
    ///
    /// # Errors
    /// [`Error::BadInput`] for lines that cannot be read.
    pub fn comments(&self) -> Result<Vec<String>> {
        match self.arrays.is_text(COMMENTS) {
            true => Ok(self.arrays.texts(COMMENTS)?.unwrap_or_default()),
            false => Ok(vec![]),
        }
    }

    /// All numbers of an array.
    pub fn numbers(&self, name: &str) -> Result<Box<dyn NumberStream>> {
        self.arrays.numbers(&format!("VTKHDF/{name}"), &[])
    }

    /// The integers of an array of one axis.
    pub(in crate::formats) fn ids(&self, name: &str, count: u64) -> Result<Ids> {
        let array = self.expect(name, &[count])?;
        if array.scalar.is_float() {
            return Err(self.wrong(name, "integers", array.scalar.name()));
        }
        Ok(Ids { numbers: self.numbers(name)?, left: count, loaded: vec![], used: 0 })
    }

    /// A number for each piece.
    fn counts(&self, name: &str) -> Result<Vec<u64>> {
        let shape = self.array(name)?.map(|array| array.shape).unwrap_or_default();
        let [pieces @ 0..=MOST_PIECES] = shape[..] else {
            return Err(self.wrong(name, "a number for each of at most 2^20 pieces", format!("{shape:?}")));
        };
        let mut ids = self.ids(name, pieces)?;
        let mut counts = vec![];
        let mut sum = 0u64;
        while let Some(n) = ids.next()? {
            counts.push(n);
            sum = sum.saturating_add(n);
        }
        // Above any file: a point takes bytes.
        match sum < 1 << 53 {
            true => Ok(counts),
            false => {
                Err(self.wrong(name, "numbers that are not negative and sum to less than 2^53", "others"))
            }
        }
    }

    /// Whether a group of cells has some.
    pub fn has_cells(&self, group: &str) -> Result<bool> {
        let name = format!("{group}/NumberOfCells");
        Ok(self.array(&name)?.is_some() && self.counts(&name)?.iter().any(|&n| n > 0))
    }

    /// The cells of all pieces; `within` is the group that has their arrays, with a "/", or
    /// nothing.
    pub fn cells(&self, within: &str) -> Result<Cells> {
        let name = |name: &str| format!("{within}{name}");
        let cells = self.counts(&name("NumberOfCells"))?;
        let vertices = self.counts(&name("NumberOfConnectivityIds"))?;
        let pieces = self.points.len();
        if cells.len() != pieces || vertices.len() != pieces {
            let got = format!("{} and {}", cells.len(), vertices.len());
            return Err(self.wrong(
                &name("NumberOfCells, NumberOfConnectivityIds"),
                format!("{pieces} of either, as of NumberOfPoints"),
                got,
            ));
        }
        let [cell_count, vertex_count] = [&cells, &vertices].map(|n| n.iter().sum::<u64>());
        let ids = self.ids(&name("Offsets"), cell_count + pieces as u64)?;
        let offsets = Offsets { ids, at: 0, end: 0 };
        let connectivity = self.ids(&name("Connectivity"), vertex_count)?;
        let piece = |((&points, cells), vertices)| PieceCounts { points, cells, vertices };
        let mut pieces: Vec<PieceCounts> = self.points.iter().zip(cells).zip(vertices).map(piece).collect();
        pieces.reverse();
        Ok(Cells {
            path: self.path.clone(),
            at: format!("/VTKHDF/{within}"),
            cell_count,
            offsets,
            connectivity,
            pieces,
            piece: PieceCounts::default(),
            first: 0,
        })
    }
}

/// A known number of integers, one at a time. Negative ones read as 0 or more than there can be.
pub(in crate::formats) struct Ids {
    numbers: Box<dyn NumberStream>,
    /// Numbers not loaded yet.
    left: u64,
    loaded: Vec<f64>,
    used: usize,
}

impl Ids {
    /// The next one; `None` after the last.
    pub(in crate::formats) fn next(&mut self) -> Result<Option<u64>> {
        if self.used == self.loaded.len() {
            let n = self.left.min(AT_A_TIME);
            if n == 0 {
                return Ok(None);
            }
            self.loaded.resize(n as usize, 0.0);
            self.numbers.fill(&mut self.loaded)?;
            self.left -= n;
            self.used = 0;
            if self.left == 0 {
                self.numbers.finish()?;
            }
        }
        self.used += 1;
        let number = self.loaded[self.used - 1];
        Ok(Some(if number < 0.0 { u64::MAX } else { number as u64 }))
    }
}

#[derive(Default)]
struct PieceCounts {
    points: u64,
    cells: u64,
    vertices: u64,
}

struct Offsets {
    ids: Ids,
    /// Cells begun of this piece.
    at: u64,
    /// Where the last one ends.
    end: u64,
}

/// Cells, one after another.
pub struct Cells {
    path: PathBuf,
    at: String,
    /// Cells of all pieces.
    pub(in crate::formats) cell_count: u64,
    offsets: Offsets,
    connectivity: Ids,
    /// Pieces to come, the next one last.
    pieces: Vec<PieceCounts>,
    piece: PieceCounts,
    /// Points of the pieces before.
    first: u64,
}

impl Cells {
    fn wrong(&self, name: &str, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(&self.path, format!("{}{name}", self.at), expected, got)
    }

    /// Begins the next cell: how many vertices it has, which are to be asked for. `None` after the
    /// last.
    pub fn next_cell(&mut self) -> Result<Option<u64>> {
        while self.offsets.at == self.piece.cells {
            let (end, vertices) = (self.offsets.end, self.piece.vertices);
            if end != vertices {
                let expected = format!("{vertices} at the end of a piece, as NumberOfConnectivityIds tells");
                return Err(self.wrong("Offsets", expected, end.to_string()));
            }
            let Some(next) = self.pieces.pop() else { return Ok(None) };
            self.first += std::mem::replace(&mut self.piece, next).points;
            self.offsets.at = 0;
            self.offsets.end = 0;
            if self.offsets.ids.next()? != Some(0) {
                return Err(self.wrong("Offsets", "0 at the begin of each piece", "another number"));
            }
        }
        let begin = self.offsets.end;
        let end = self.offsets.ids.next()?.unwrap_or(u64::MAX);
        if end < begin || end > self.piece.vertices {
            let expected = format!("offsets that ascend, {begin} to {}", self.piece.vertices);
            return Err(self.wrong("Offsets", expected, end.to_string()));
        }
        self.offsets.at += 1;
        self.offsets.end = end;
        Ok(Some(end - begin))
    }

    /// The next vertex of the cell that was begun, counted among the points of all pieces.
    pub fn next_vertex(&mut self) -> Result<u64> {
        let vertex = self.connectivity.next()?.unwrap_or(u64::MAX);
        if vertex >= self.piece.points {
            let expected = format!("points below {}", self.piece.points);
            return Err(self.wrong("Connectivity", expected, (vertex as i64).to_string()));
        }
        Ok(self.first + vertex)
    }
}

/// The type of numbers of an array with an entry, or some, for each of `count`; and how many.
pub(in crate::formats) fn components(array: &ArrayInfo, count: u64) -> Option<(ScalarType, u32)> {
    match array.shape[..] {
        [n] if n == count => Some((array.scalar, 1)),
        [n, components] if n == count => Some((array.scalar, u32::try_from(components).ok()?)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_have_names_that_hdf5_takes() {
        let name = |name| array_name(name, &["Normals", "a_b"]);
        assert_eq!(["x.y", "", ".", "Normals", "a/b"].map(name), ["x.y", "_", "._", "Normals_", "a_b_"]);
    }
}
