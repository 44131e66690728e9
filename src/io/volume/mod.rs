//! Volumes: how a reader describes a structured scalar field, and how its samples are read.
//!
//! A format of `formats/` gives random access (a mapped file, [`VolumeReader`]), chunks that are
//! decoded separately ([`chunked`], random access through a cache of chunks), or a sequence of
//! slabs ([`SlabStream`]: other compressed files, and text). A stream is turned into random access
//! by [`bricked`], once; a small one in memory.

pub(crate) mod ahead;
pub mod bricked;
pub mod chunked;
pub mod convert;
pub(crate) mod dates;
pub mod memory;
pub mod shifted;
pub mod slabs;
pub mod strided;
pub mod units;
pub mod unpacked;

use crate::bytes::remote::is_remote;
use crate::error::Result;
use crate::grid::{Geometry, IndexBox};
use half::f16;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use units::Units;

/// The type of a stored sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum ScalarType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

impl ScalarType {
    /// All of them, in the order of their names on the command line.
    pub const ALL: [Self; 11] = [
        Self::U8,
        Self::I8,
        Self::U16,
        Self::I16,
        Self::U32,
        Self::I32,
        Self::U64,
        Self::I64,
        Self::F16,
        Self::F32,
        Self::F64,
    ];

    /// Bytes a sample.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Its name, as NumPy has it: "uint8" … "float64".
    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::I8 => "int8",
            Self::U16 => "uint16",
            Self::I16 => "int16",
            Self::U32 => "uint32",
            Self::I32 => "int32",
            Self::U64 => "uint64",
            Self::I64 => "int64",
            Self::F16 => "float16",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }

    /// The number of this type that a number of a header becomes, as far as it is a float.
    pub fn rounded(self, number: f64) -> f64 {
        match self {
            Self::F16 => f16::from_f64(number).to_f64(),
            Self::F32 => f64::from(number as f32),
            _ => number,
        }
    }

    /// Whether it is a floating-point type.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F16 | Self::F32 | Self::F64)
    }

    /// The type of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|t| t.name() == name)
    }

    /// The type of NumPy's short name, with bytes in place of bits: "u2", "f8".
    pub fn from_code(code: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|t| code.strip_prefix(&t.name()[..1]) == Some(&t.bytes().to_string()))
    }

    /// Writes the name, in a report.
    pub fn serialize_name<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }

    /// Reads what [`ScalarType::serialize_name`] writes.
    pub(crate) fn deserialize_name<'de, D: Deserializer<'de>>(
        from: D,
    ) -> std::result::Result<Self, D::Error> {
        let name = String::deserialize(from)?;
        Self::from_name(&name).ok_or_else(|| D::Error::custom(format!("no type is called {name:?}")))
    }
}

/// The little-endian half at the start of some bytes.
#[inline]
pub(crate) fn half_at(bytes: &[u8]) -> f32 {
    f16::from_le_bytes([bytes[0], bytes[1]]).to_f32()
}

/// A scalar field that a file offers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldInfo {
    /// The name in the file; "data" where the format has no names.
    pub name: String,
    /// Type of a stored sample.
    #[serde(
        serialize_with = "ScalarType::serialize_name",
        deserialize_with = "ScalarType::deserialize_name"
    )]
    pub scalar: ScalarType,
    /// Values a sample: 1 for a scalar field, 3 for a vector. Only scalar fields are read.
    pub components: u32,
}

/// What a file says about the field that is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VolumeInfo {
    /// The file that was named.
    pub path: PathBuf,
    /// The format, as a person would call it: "NRRD (attached, gzip)".
    pub format: String,
    /// Samples along x, y, z.
    pub dims: [u64; 3],
    /// The field read.
    pub field: FieldInfo,
    /// All fields of the file, in file order, the one read included.
    pub fields: Vec<FieldInfo>,
    /// Index space to world.
    pub geometry: Geometry,
    /// A sample's value is `slope · stored + intercept`.
    pub slope: f64,
    /// See `slope`.
    pub intercept: f64,
    /// The stored value that the file declares to mean "no data".
    pub missing: Option<f64>,
    /// The units that the file names.
    #[serde(default, skip_serializing_if = "Units::are_unknown")]
    pub units: Units,
    /// What a reader converted, took or left out, a line each.
    #[serde(skip)]
    pub notes: Vec<String>,
    /// The files that hold the samples, where that is not the file that was named.
    #[serde(default)]
    pub data_files: Vec<PathBuf>,
    /// What the geometry assumes, as the file does not say it.
    #[serde(skip)]
    pub assumed: Assumed,
    /// Whether the file says that its samples are labels: names, and no quantities.
    #[serde(skip)]
    pub is_labels: bool,
}

/// Axes along which nothing says how far samples lie apart: a spacing of 1 is assumed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Assumed {
    /// Along x, y, z.
    pub axes: [bool; 3],
    /// Whether the user may give the spacing of such a file.
    pub can_be_given: bool,
}

impl Assumed {
    /// Of a file whose format has a place for the spacing.
    pub(crate) fn in_header(axes: [bool; 3]) -> Self {
        Self { axes, can_be_given: false }
    }
}

impl VolumeInfo {
    /// All files that make up the volume, the one that was named first. Where a folder or a pattern
    /// was named, that is no file: only the files it stands for.
    pub fn files(&self) -> Vec<PathBuf> {
        let has_files_in =
            |folder: &PathBuf| self.data_files.iter().any(|f| f.starts_with(folder) && f != folder);
        let is_file = |p: &PathBuf| if is_remote(p) { !has_files_in(p) } else { p.is_file() };
        let named = Some(self.path.clone()).filter(|p| self.data_files.is_empty() || is_file(p));
        let others = self.data_files.iter().filter(|f| **f != self.path).cloned();
        named.into_iter().chain(others).collect()
    }
}

/// Random access to the samples of one scalar field.
pub trait VolumeReader: Send + Sync {
    /// What is read.
    fn info(&self) -> &VolumeInfo;

    /// Reads the samples of `voxels`, x fastest, slope and intercept applied (in `f64`, then
    /// rounded to `f32`), into `out`, whose length is the box's. A declared missing value comes out
    /// as NaN.
    ///
    /// # Errors
    /// When the file cannot be read or ends too early.
    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()>;

    /// A text that stands for the samples: the same text only where all samples are the same.
    /// Without one, a volume that a program gives is read once more to hash its samples.
    fn identity(&self) -> Option<String> {
        None
    }

    /// Announces that `voxels` will be read soon; a hint.
    fn will_need(&self, _voxels: IndexBox) {}

    /// Announces that this run will not read samples with a z in `slices` again, after the slices
    /// before were given up in the same way; a hint.
    fn release(&self, _slices: Range<u64>) {}

    /// What [`VolumeReader::read_stored`] gives, for a copy without loss. A reader that cannot give
    /// the stored samples gives its values: `f32`, slope 1, nothing missing.
    fn stored_info(&self) -> VolumeInfo {
        let mut info = self.info().clone();
        info.field.scalar = ScalarType::F32;
        (info.slope, info.intercept, info.missing) = (1.0, 0.0, None);
        info
    }

    /// Reads the samples of `voxels`, x fastest, as **little-endian** bytes of the type that
    /// [`VolumeReader::stored_info`] names, no slope applied.
    ///
    /// # Errors
    /// When the file cannot be read or ends too early.
    fn read_stored(&self, voxels: IndexBox, out: &mut [u8]) -> Result<()> {
        let mut values = vec![0.0f32; voxels.len()];
        self.read_box(voxels, &mut values)?;
        for (bytes, value) in out.chunks_exact_mut(4).zip(values) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        Ok(())
    }
}

/// The samples of one scalar field as a sequence of boxes that together tile the volume, each once.
pub trait SlabStream: Send {
    /// What is read.
    fn info(&self) -> &VolumeInfo;

    /// Bytes of memory that reading takes at a time, at most: what is decoded together, as often as
    /// it is held, and a slab.
    fn working_bytes(&self) -> u64 {
        4 << 20
    }

    /// The next box, its stored samples (no slope applied) as **little-endian** bytes of
    /// [`FieldInfo::scalar`], x fastest, in `out` (cleared first); `None` after the last. A box is
    /// at most a few MiB, or one row.
    ///
    /// # Errors
    /// When the file cannot be read, decoded, or ends too early. Data beyond the last sample are an
    /// error too.
    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>>;
}

/// An opened volume.
pub enum VolumeSource {
    /// Random access, without a copy.
    Random(Box<dyn VolumeReader>),
    /// Random access, without a copy, through a cache of decoded chunks:
    /// [`chunked::ChunkedVolume`].
    Chunked(Arc<dyn chunked::ChunkSource>),
    /// One pass, front to back.
    Stream(Box<dyn SlabStream>),
}

/// A volume that several readers share.
pub(crate) struct SharedVolume(pub(crate) Arc<dyn VolumeReader>);

impl VolumeReader for SharedVolume {
    fn info(&self) -> &VolumeInfo {
        self.0.info()
    }

    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        self.0.read_box(voxels, out)
    }

    fn identity(&self) -> Option<String> {
        self.0.identity()
    }

    fn will_need(&self, voxels: IndexBox) {
        self.0.will_need(voxels);
    }

    fn release(&self, slices: Range<u64>) {
        self.0.release(slices);
    }

    fn stored_info(&self) -> VolumeInfo {
        self.0.stored_info()
    }

    fn read_stored(&self, voxels: IndexBox, out: &mut [u8]) -> Result<()> {
        self.0.read_stored(voxels, out)
    }
}

impl VolumeSource {
    /// What is read.
    pub fn info(&self) -> &VolumeInfo {
        match self {
            Self::Random(r) => r.info(),
            Self::Chunked(c) => c.info(),
            Self::Stream(s) => s.info(),
        }
    }

    /// The stored samples front to back, for any source.
    pub fn into_stream(self) -> Box<dyn SlabStream> {
        match self {
            Self::Random(reader) => Box::new(slabs::ReaderSlabs::new(reader)),
            Self::Chunked(chunks) => Box::new(chunked::ChunkSlabs::new(chunks)),
            Self::Stream(stream) => stream,
        }
    }
}
