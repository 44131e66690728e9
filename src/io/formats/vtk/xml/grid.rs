//! Reads the positions of the samples of rectilinear (`.vtr`) and curvilinear (`.vts`) grids.
//!
//! ```text
//! <Piece Extent="0 3 0 2 0 1">
//!   <Coordinates> three arrays: x, y, z along the axes </Coordinates>          RectilinearGrid
//!   <Points> one array: x, y, z of each sample </Points>                       StructuredGrid
//! </Piece>
//! ```

use super::array::{ArrayStream, scalar_type};
use super::cells::{LISTS, blocks_of};
use super::head::{Document, Element};
use super::image::{Image, Joined, What, arrays, name_of, points_of};
use crate::bytes::ByteSource;
use crate::cells::{Center, NumberStream};
use crate::error::Result;
use crate::formats::shared::centers::{Middles, along_axis};
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::header;
use crate::formats::shared::numbers::to_f64;
use crate::volume::ScalarType;
use std::sync::Arc;

/// The coordinates of the samples of a field; `None` of an image. Values of cells are those of
/// their middles.
pub(super) fn coordinates(image: &Image, wanted: Option<&str>) -> Result<Option<GridCoordinates>> {
    if image.kind == "ImageData" {
        return Ok(None);
    }
    let center = image.choice(wanted)?.center;
    Ok(Some(match (image.kind, center) {
        ("RectilinearGrid", _) => GridCoordinates::Axes(axes(image)?.map(|axis| along_axis(axis, center))),
        (_, Center::Point) => GridCoordinates::Points(points(image)?),
        (_, Center::Cell) => GridCoordinates::Points(Box::new(Middles::new(points(image)?, image.points()))),
    }))
}

/// The number of the field data that is called `TimeValue`; of an index that of its first file.
pub(super) fn time(doc: &Document) -> Result<Option<f64>> {
    if let Some(kind) = doc.kind.strip_prefix('P')
        && let Some(name) = doc.data.child("Piece").and_then(|piece| piece.attribute("Source"))
    {
        let path = header::sibling(doc.source.path(), name);
        let source = Arc::new(ByteSource::open(path, doc.source.mode())?);
        return time(&Document::open(&source, kind)?);
    }
    if LISTS.contains(&doc.kind) {
        let Some(path) = blocks_of(doc)?.into_iter().next() else { return Ok(None) };
        let source = Arc::new(ByteSource::open(path, doc.source.mode())?);
        return time(&Document::open_one_of(
            &source,
            &["UnstructuredGrid", "PUnstructuredGrid", "PolyData"],
        )?);
    }
    let array = arrays(doc.data.child("FieldData")).find(|a| name_of(a) == "TimeValue");
    let Some(array) = array else { return Ok(None) };
    let mut time = vec![];
    GridNumbers::open(doc, array, 1)?.read_all(1, &mut time)?;
    Ok(time.first().copied())
}

/// The tables of all pieces, joined.
fn axes(image: &Image) -> Result<[Vec<f64>; 3]> {
    let mut out: [Vec<f64>; 3] = Default::default();
    for piece in &image.pieces {
        let doc = piece.document()?;
        let element = piece.element(&doc)?;
        let tables: Vec<&Element> = arrays(element.child("Coordinates")).collect();
        let [x, y, z] = tables[..] else {
            return Err(doc.wrong(element, "three arrays in Coordinates", tables.len().to_string()));
        };
        for (a, array) in [x, y, z].into_iter().enumerate() {
            let (lo, hi) = (piece.voxels.lo[a] as usize, piece.voxels.hi[a] as usize);
            let mut table = vec![];
            GridNumbers::open(&doc, array, (hi - lo) as u64)?.read_all((hi - lo) as u64, &mut table)?;
            if out[a].len() < hi {
                out[a].resize(hi, f64::NAN);
            }
            for (known, found) in out[a][lo..hi].iter_mut().zip(table) {
                if !known.is_nan() && *known != found {
                    let expected = format!("{known}, as a piece before has it");
                    return Err(doc.wrong(array, expected, found.to_string()));
                }
                *known = found;
            }
        }
    }
    Ok(out)
}

/// x, y, z of all points.
fn points(image: &Image) -> Result<Box<dyn NumberStream>> {
    let dims = image.points();
    let first = image.pieces[0].document()?;
    let array = points_of(&first, &image.pieces[0], None)?;
    let scalar = array.attribute("type").and_then(scalar_type);
    let scalar = scalar.ok_or_else(|| first.wrong(array, "numbers", "another type"))?;
    let count = dims.iter().try_fold(3u64, |n, &d| n.checked_mul(d)).filter(|&n| n < 1 << 59);
    if count.is_none() {
        let doc = &image.doc;
        return Err(doc.wrong(&doc.data, "an Extent that can be counted", "a larger one"));
    }
    let joined = Joined::new(dims, scalar, What::Points, image.pieces.clone())?;
    Ok(Box::new(JoinedNumbers { joined, scalar, bytes: vec![], used: 0 }))
}

/// The numbers of all pieces, in the order of the samples.
struct JoinedNumbers {
    joined: Joined,
    scalar: ScalarType,
    /// A slab, and how much of it was given out.
    bytes: Vec<u8>,
    used: usize,
}

impl NumberStream for JoinedNumbers {
    fn fill(&mut self, mut out: &mut [f64]) -> Result<()> {
        let size = self.scalar.bytes();
        while !out.is_empty() {
            if self.used == self.bytes.len() {
                self.joined.next_slab(&mut self.bytes)?.expect("as many numbers are asked for as there are");
                self.used = 0;
            }
            let count = out.len().min((self.bytes.len() - self.used) / size);
            let (now, later) = out.split_at_mut(count);
            to_f64(self.scalar, &self.bytes[self.used..][..count * size], now);
            self.used += count * size;
            out = later;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        // Each piece was finished after its last sample.
        Ok(())
    }
}

/// The numbers of one array.
struct GridNumbers {
    stream: ArrayStream,
    scalar: ScalarType,
    bytes: Vec<u8>,
}

impl GridNumbers {
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
        self.stream.finish()
    }
}

impl GridNumbers {
    fn fill(&mut self, out: &mut [f64]) -> Result<()> {
        self.bytes.resize(out.len() * self.scalar.bytes(), 0);
        self.stream.fill(&mut self.bytes)?;
        to_f64(self.scalar, &self.bytes, out);
        Ok(())
    }
}
