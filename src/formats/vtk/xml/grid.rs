//! Reads the positions of the samples of rectilinear (`.vtr`) and curvilinear (`.vts`) grids.
//!
//! ```text
//! <Piece Extent="0 3 0 2 0 1">
//!   <Coordinates> three arrays: x, y, z along the axes </Coordinates>          RectilinearGrid
//!   <Points> one array: x, y, z of each sample </Points>                       StructuredGrid
//! </Piece>
//! ```

use super::array::{ArrayStream, scalar_type};
use super::head::{Document, Element};
use super::image::{Extent, arrays, extent, name_of, pieces};
use crate::cells::NumberStream;
use crate::error::Result;
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::numbers::to_f64;
use crate::volume::ScalarType;

/// The coordinates of a grid; `None` of an image.
pub(super) fn coordinates(doc: &Document) -> Result<Option<GridCoordinates>> {
    match doc.kind {
        "RectilinearGrid" => axes(doc, &extent(doc, &doc.data, "WholeExtent")?).map(Some),
        "StructuredGrid" => points(doc).map(Some),
        _ => Ok(None),
    }
}

/// The number of the field data that is called `TimeValue`.
pub(super) fn time(doc: &Document) -> Result<Option<f64>> {
    let array = arrays(doc.data.child("FieldData")).find(|a| name_of(a) == "TimeValue");
    let Some(array) = array else { return Ok(None) };
    let mut time = vec![];
    Numbers::open(doc, array, 1)?.read_all(1, &mut time)?;
    Ok(time.first().copied())
}

/// The tables of all pieces, joined.
fn axes(doc: &Document, whole: &Extent) -> Result<GridCoordinates> {
    let mut out: [Vec<f64>; 3] = Default::default();
    for piece in pieces(doc, whole)? {
        let tables: Vec<&Element> = arrays(piece.element.child("Coordinates")).collect();
        let [x, y, z] = tables[..] else {
            return Err(doc.wrong(piece.element, "three arrays in Coordinates", tables.len().to_string()));
        };
        for (a, array) in [x, y, z].into_iter().enumerate() {
            let (lo, hi) = (piece.voxels.lo[a] as usize, piece.voxels.hi[a] as usize);
            let mut table = vec![];
            Numbers::open(doc, array, (hi - lo) as u64)?.read_all((hi - lo) as u64, &mut table)?;
            if out[a].len() < hi {
                out[a].resize(hi, f64::NAN);
            }
            out[a][lo..hi].copy_from_slice(&table);
        }
    }
    Ok(GridCoordinates::Axes(out))
}

fn points(doc: &Document) -> Result<GridCoordinates> {
    let all: Vec<&Element> = doc.data.all("Piece").collect();
    let [piece] = all[..] else {
        let error = doc.wrong(&doc.data, "a curvilinear grid in one piece", all.len().to_string());
        return Err(error.with_help("write it in one piece"));
    };
    let array = piece.child("Points").and_then(|p| p.child("DataArray"));
    let array = array.ok_or_else(|| doc.wrong(piece, "a DataArray in Points", "none"))?;
    let dims = extent(doc, piece, "Extent")?.dims;
    let count = dims.iter().try_fold(3u64, |n, &d| n.checked_mul(d)).filter(|&n| n < 1 << 59);
    let count = count.ok_or_else(|| doc.wrong(piece, "an Extent that can be counted", "a larger one"))?;
    Ok(GridCoordinates::Points(Box::new(Numbers::open(doc, array, count)?)))
}

/// The numbers of one array.
struct Numbers {
    stream: ArrayStream,
    scalar: ScalarType,
    bytes: Vec<u8>,
}

impl Numbers {
    fn open(doc: &Document, array: &Element, count: u64) -> Result<Self> {
        let scalar = array.attribute("type").and_then(scalar_type);
        let scalar = scalar.ok_or_else(|| doc.wrong(array, "numbers", "another type"))?;
        let stream = ArrayStream::open(doc, array, scalar, count * scalar.bytes() as u64)?;
        Ok(Self { stream, scalar, bytes: vec![] })
    }

    /// All numbers, in memory that grows as they arrive.
    fn read_all(mut self, count: u64, out: &mut Vec<f64>) -> Result<()> {
        while (out.len() as u64) < count {
            let old = out.len();
            out.resize(old + (count - old as u64).min(1 << 16) as usize, 0.0);
            self.fill(&mut out[old..])?;
        }
        self.finish()
    }
}

impl NumberStream for Numbers {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        self.bytes.resize(out.len() * self.scalar.bytes(), 0);
        self.stream.fill(&mut self.bytes)?;
        to_f64(self.scalar, &self.bytes, out);
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        self.stream.finish()
    }
}
