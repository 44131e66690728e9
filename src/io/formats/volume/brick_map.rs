//! Writes a map of bricks as VTI: the numbers of each brick are the data of a cell, written in any
//! order.
//!
//! The file has one piece, appended raw, with a `UInt64` header. Three arrays follow one another:
//! `rms` and `max` (`Float32`) and `samples` (`UInt64`). So each number has a known place in the
//! file and can be written at any time. The cell of a brick reaches from its first sample to that
//! of the next brick; the last brick of an axis may be smaller than its cell.

use super::samples::{numbers, publishable};
use crate::bytes::publish::Unpublished;
use crate::bytes::store::write_at;
use crate::error::{Error, Result};
use crate::grid::Geometry;
use std::path::Path;

/// The numbers of a brick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrickNumbers {
    /// The root of the mean square of its errors.
    pub rms: f32,
    /// Its largest error.
    pub max: f32,
    /// The samples that were compared.
    pub samples: u64,
}

/// A map being written.
pub struct BrickMapFile {
    out: Unpublished,
    bricks: u64,
    /// Where the numbers of `rms`, `max` and `samples` begin.
    starts: [u64; 3],
    bytes: u64,
}

/// Bytes of a number of each array.
const WIDTHS: [u64; 3] = [4, 4, 8];
const TAIL: &[u8] = b"\n  </AppendedData>\n</VTKFile>\n";

impl BrickMapFile {
    /// Begins a map of `dims` bricks; `geometry` takes numbers of bricks to the world.
    pub fn create(path: &Path, dims: [u64; 3], geometry: &Geometry) -> Result<Self> {
        if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("vti")) {
            return Err(Error::usage(format!("{}: a map's name ends in .vti", path.display())));
        }
        let bricks = dims.iter().product();
        let mut out = publishable(path)?;
        let head = head(dims, geometry).into_bytes();
        out.write(&head)?;
        out.flush()?;
        let mut at = head.len() as u64;
        let starts = WIDTHS.map(|width| {
            let start = at + 8;
            at = start + width * bricks;
            start
        });
        let file = Self { out, bricks, starts, bytes: at + TAIL.len() as u64 };
        for (start, width) in starts.iter().zip(WIDTHS) {
            file.put(&(width * bricks).to_le_bytes(), start - 8)?;
        }
        file.put(TAIL, at)?;
        Ok(file)
    }

    fn put(&self, bytes: &[u8], at: u64) -> Result<()> {
        write_at(self.out.file(), bytes, at).map_err(|e| Error::io("write", self.out.temporary(), e))
    }

    /// Writes the numbers of the bricks from `first` on.
    pub fn write(&self, first: u64, bricks: &[BrickNumbers]) -> Result<()> {
        debug_assert!(first + bricks.len() as u64 <= self.bricks, "bricks of the map");
        let columns: [Vec<u8>; 3] = [
            bricks.iter().flat_map(|b| b.rms.to_le_bytes()).collect(),
            bricks.iter().flat_map(|b| b.max.to_le_bytes()).collect(),
            bricks.iter().flat_map(|b| b.samples.to_le_bytes()).collect(),
        ];
        let places = self.starts.iter().zip(WIDTHS);
        columns
            .iter()
            .zip(places)
            .try_for_each(|(bytes, (start, width))| self.put(bytes, start + width * first))
    }

    /// Makes the file durable, then visible; returns its bytes.
    pub fn publish(self) -> Result<u64> {
        self.out.publish()?;
        Ok(self.bytes)
    }
}

fn head(dims: [u64; 3], g: &Geometry) -> String {
    // A matrix, row by row, whose columns are the axes.
    let direction: Vec<f64> = (0..9).map(|i| g.direction[i % 3][i / 3]).collect();
    let bricks: u64 = dims.iter().product();
    let extent = format!("0 {} 0 {} 0 {}", dims[0], dims[1], dims[2]);
    let array = |name: &str, kind: &str, offset: u64| {
        format!(
            "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"1\" format=\"appended\" offset=\"{offset}\"/>\n"
        )
    };
    let arrays = [
        array("rms", "Float32", 0),
        array("max", "Float32", 8 + 4 * bricks),
        array("samples", "UInt64", 16 + 8 * bricks),
    ];
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n  <ImageData WholeExtent=\"{extent}\" Origin=\"{}\" Spacing=\"{}\" Direction=\"{}\">\n    \
         <Piece Extent=\"{extent}\">\n      <CellData Scalars=\"rms\">\n{}      </CellData>\n    </Piece>\n  \
         </ImageData>\n  <AppendedData encoding=\"raw\">\n   _",
        numbers(&g.origin),
        numbers(&g.spacing),
        numbers(&direction),
        arrays.concat(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_lie_where_the_head_says() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map.vti");
        let file = BrickMapFile::create(&path, [2, 2, 1], &Geometry::default()).unwrap();
        let brick = |n: u64| BrickNumbers { rms: n as f32, max: 2.0 * n as f32, samples: 100 + n };
        file.write(2, &[brick(2), brick(3)]).unwrap();
        file.write(0, &[brick(0), brick(1)]).unwrap();
        assert_eq!(file.publish().unwrap(), std::fs::metadata(&path).unwrap().len());
        let bytes = std::fs::read(&path).unwrap();
        let data = bytes.windows(4).position(|w| w == b"   _").unwrap() + 4;
        let u64_at = |at: usize| u64::from_le_bytes(bytes[data + at..data + at + 8].try_into().unwrap());
        let f32_at = |at: usize| f32::from_le_bytes(bytes[data + at..data + at + 4].try_into().unwrap());
        assert_eq!([u64_at(0), u64_at(24), u64_at(48)], [16, 16, 32]);
        assert_eq!([f32_at(8), f32_at(20), f32_at(36), f32_at(40)], [0.0, 3.0, 2.0, 4.0]);
        assert_eq!([u64_at(56), u64_at(80)], [100, 103]);
        assert!(bytes.ends_with(TAIL));
        assert!(BrickMapFile::create(&dir.path().join("map.png"), [1; 3], &Geometry::default()).is_err());
    }
}
