//! Samples of a field on a grid, written in any order: VTI and NPY.
//!
//! Both formats have a header whose length is known beforehand, then the samples one after another,
//! x fastest: `f32`, or `f64` where they are counted from an offset. So each run of samples has a
//! known place in the file and is written as soon as it is ready; the memory used is that of a
//! header. The bytes go to a temporary file next to the target, which is synced and then renamed.
//!
//! * **VTI** (VTK ImageData): one piece, appended raw, `UInt64` header, with origin, spacing and
//!   direction.
//! * **NPY** version 1: `<f4` of shape (z, y, x), or (n) for a list.

use crate::bytes::publish::Unpublished;
use crate::bytes::store::write_at;
use crate::error::{Error, Result};
use crate::formats::shared::sink::resolve;
use crate::formats::shared::text::xml_attribute;
use crate::grid::Geometry;
use std::fmt::Write as _;
use std::path::Path;

/// A format that samples are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleFormat {
    /// VTK XML ImageData, appended raw.
    Vti,
    /// NumPy.
    Npy,
}

impl SampleFormat {
    /// The format that a file name asks for, by its extension in any case.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no extension or it is none of ours.
    pub fn from_path(path: &Path) -> Result<Self> {
        let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        match extension.as_deref() {
            Some("vti") => Ok(Self::Vti),
            Some("npy") => Ok(Self::Npy),
            _ => Err(Error::usage(format!(
                "cannot tell the format of samples on a grid from {}: end its name in .vti or .npy",
                path.display()
            ))),
        }
    }
}

/// The grid of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct GridMeta {
    /// Samples along each axis.
    pub dims: [u64; 3],
    /// From sample numbers to the world.
    pub geometry: Geometry,
    /// Name of the field.
    pub field: String,
    /// The offset that is added to all values; where it is not 0, they are written as `f64`.
    pub offset: f64,
}

impl GridMeta {
    /// Number of samples.
    ///
    /// # Errors
    /// [`Error::Usage`] when their bytes do not fit a file.
    pub fn samples(&self) -> Result<u64> {
        let [x, y, z] = self.dims;
        let samples = x.checked_mul(y).and_then(|n| n.checked_mul(z)).filter(|&n| n < 1 << 60);
        samples.ok_or_else(|| Error::usage(format!("a grid of {x} x {y} x {z} samples does not fit a file")))
    }
}

/// Samples that are being written.
pub struct SampleFile {
    out: Unpublished,
    /// Where the samples begin.
    start: u64,
    bytes: u64,
    offset: f64,
}

impl SampleFile {
    /// Begins a file of samples on a grid.
    ///
    /// # Errors
    /// [`Error::Usage`] when the target is a folder or there are too many samples; [`Error::Io`]
    /// when the system refuses to write.
    pub fn create(path: &Path, format: SampleFormat, meta: &GridMeta) -> Result<Self> {
        let samples = meta.samples()?;
        match format {
            SampleFormat::Npy => {
                let [x, y, z] = meta.dims;
                Self::begin(
                    path,
                    &npy_head(&format!("({z}, {y}, {x})"), meta.offset),
                    samples,
                    &[],
                    meta.offset,
                )
            }
            SampleFormat::Vti => {
                let mut head = vti_head(meta).into_bytes();
                head.extend((sample_bytes(meta.offset) * samples).to_le_bytes());
                Self::begin(path, &head, samples, b"\n  </AppendedData>\n</VTKFile>\n", meta.offset)
            }
        }
    }

    /// Begins a file of a list of samples, as NPY; see [`GridMeta::offset`].
    ///
    /// # Errors
    /// As [`SampleFile::create`].
    pub fn create_list(path: &Path, samples: u64, offset: f64) -> Result<Self> {
        Self::begin(path, &npy_head(&format!("({samples},)"), offset), samples, &[], offset)
    }

    fn begin(path: &Path, head: &[u8], samples: u64, tail: &[u8], offset: f64) -> Result<Self> {
        let mut out = publishable(path)?;
        out.write(head)?;
        out.flush()?;
        let (start, end) = (head.len() as u64, head.len() as u64 + sample_bytes(offset) * samples);
        let file = Self { out, start, bytes: end + tail.len() as u64, offset };
        file.put(tail, end)?;
        if tail.is_empty() {
            file.out.file().set_len(end).map_err(|e| Error::io("write", file.out.temporary(), e))?;
        }
        Ok(file)
    }

    fn put(&self, bytes: &[u8], offset: u64) -> Result<()> {
        write_at(self.out.file(), bytes, offset).map_err(|e| Error::io("write", self.out.temporary(), e))
    }

    /// Writes samples from number `first` on; any thread may, in any order.
    ///
    /// # Errors
    /// When the system refuses to write.
    pub fn write(&self, first: u64, samples: &[f32]) -> Result<()> {
        let at = self.start + sample_bytes(self.offset) * first;
        if self.offset != 0.0 {
            let value = |v: &f32| (self.offset + f64::from(*v)).to_le_bytes();
            let bytes: Vec<u8> = samples.iter().flat_map(value).collect();
            return self.put(&bytes, at);
        }
        if cfg!(target_endian = "little") {
            return self.put(bytemuck::cast_slice(samples), at);
        }
        let bytes: Vec<u8> = samples.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.put(&bytes, at)
    }

    /// Makes the file durable, then visible; returns its bytes.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn publish(self) -> Result<u64> {
        self.out.publish()?;
        Ok(self.bytes)
    }
}

/// Bytes of a sample that is counted from an offset.
fn sample_bytes(offset: f64) -> u64 {
    if offset == 0.0 { 4 } else { 8 }
}

/// A file that gets its name when it is complete.
pub(in crate::formats) fn publishable(path: &Path) -> Result<Unpublished> {
    Unpublished::create(&resolve(path)?)
}

/// Numbers as the value of an XML attribute.
pub(in crate::formats) fn numbers(list: &[f64]) -> String {
    let mut text = String::new();
    for x in list {
        let _ = write!(text, "{}{x}", if text.is_empty() { "" } else { " " });
    }
    text
}

fn npy_head(shape: &str, offset: f64) -> Vec<u8> {
    let mut text =
        format!("{{'descr': '<f{}', 'fortran_order': False, 'shape': {shape}, }}", sample_bytes(offset));
    // Magic, version and length take ten bytes; the data begin at a multiple of 64.
    while !(10 + text.len() + 1).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat()
}

fn vti_head(meta: &GridMeta) -> String {
    let (g, name) = (&meta.geometry, xml_attribute(&meta.field));
    // A matrix, row by row, whose columns are the axes.
    let direction: Vec<f64> = (0..9).map(|i| g.direction[i % 3][i / 3]).collect();
    let [x, y, z] = meta.dims.map(|n| n - 1);
    let extent = format!("0 {x} 0 {y} 0 {z}");
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n  <ImageData WholeExtent=\"{extent}\" Origin=\"{}\" Spacing=\"{}\" Direction=\"{}\">\n    \
         <Piece Extent=\"{extent}\">\n      <PointData Scalars=\"{name}\">\n        <DataArray type=\"Float{}\" \
         Name=\"{name}\" NumberOfComponents=\"1\" format=\"appended\" offset=\"0\"/>\n      </PointData>\n    </Piece>\n  \
         </ImageData>\n  <AppendedData encoding=\"raw\">\n   _",
        numbers(&g.origin),
        numbers(&g.spacing),
        numbers(&direction),
        8 * sample_bytes(meta.offset),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::tests::read_all;
    use crate::formats::{OpenOptions, open_volume};

    #[test]
    fn runs_in_any_order_come_back_from_our_own_readers() {
        let dir = tempfile::tempdir().unwrap();
        let geometry = Geometry {
            origin: [1.0, -2.5, 1e-3],
            spacing: [0.5, 2.0, 3.0],
            direction: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        };
        let meta = GridMeta { dims: [4, 3, 2], geometry, field: "a < \"b\"".into(), offset: 0.0 };
        for name in ["a.vti", "a.npy"] {
            let path = dir.path().join(name);
            let file = SampleFile::create(&path, SampleFormat::from_path(&path).unwrap(), &meta).unwrap();
            for first in [12u64, 0, 20, 4, 16, 8] {
                let run: Vec<f32> = (first..first + 4).map(|i| i as f32).collect();
                file.write(first, &run).unwrap();
            }
            assert_eq!(file.publish().unwrap(), std::fs::metadata(&path).unwrap().len());
            let (info, values) = read_all(open_volume(&path, &OpenOptions::default()).unwrap());
            assert_eq!(info.dims, [4, 3, 2]);
            assert_eq!(values, (0..24).map(|i| i as f32).collect::<Vec<_>>());
            if name == "a.vti" {
                assert_eq!((info.geometry, info.field.name), (geometry, meta.field.clone()));
            }
        }
    }

    #[test]
    fn other_names_and_endless_grids_are_refused() {
        assert!(SampleFormat::from_path(Path::new("a.csv")).is_err());
        let endless =
            GridMeta { dims: [1 << 24; 3], geometry: Geometry::default(), field: String::new(), offset: 0.0 };
        assert_eq!(endless.samples().unwrap_err().exit_code(), 2);
    }
}
