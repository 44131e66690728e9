//! HDF5 and NetCDF-4 (which is HDF5 with conventions): a file of groups and datasets.
//!
//! ```text
//!  \x89HDF\r\n\x1a\n …        superblock; then object headers, indices and samples anywhere in the file
//!  /group/name                a dataset: shape, type, layout (contiguous, compact, chunked), filters, attributes
//! ```
//!
//! Datasets of three axes (slowest first: z, y, x, as in NPY) and of one number a sample are the fields, named by their path.
//! Axes before the last three must have one entry; of a dataset of four axes each entry of the first is a field of its own,
//! `name:t0`, `name:t1`, …. Links to one dataset are one field.
//!
//! Attributes that are followed: `scale_factor`, `add_offset`; `_FillValue`, `missing_value`; NetCDF's coordinate variables
//! (`DIMENSION_LIST`), where they are regular to a thousandth of a step, are spacing and origin, else these are 1 and 0.
//!
//! A contiguous dataset is mapped where it lies. Others are a stream, chunk by chunk (deflate, shuffle, Fletcher-32,
//! scale-offset, N-bit, szip, LZF), of which small ones are taken together. Memory: one chunk, stored, decoded and once more
//! as it is given out; chunks of more than 256 MiB are refused. Chunks that were never written read as the fill value.
//!
//! # The crate behind it
//! Tried on files written by h5py and netCDF4 (HDF5 2.0; oldest and newest file versions; ten types in both byte orders; each
//! layout, chunk index and filter above):
//!
//! * `hdf5-reader` 0.12: pure Rust, for reading alone. Read all of them right, by boxes, in memory of a few megabytes, through
//!   our own access to the file, with bounds on what a header can make it allocate. Taken, without its own threads.
//! * `hdf5-pure` 0.47: pure Rust, also writes. Refuses layout version 5 (what HDF5 2.0 writes for filtered chunks of its
//!   newest file version) and chunks indexed by a version 2 B-tree; reads by whole slices only.
//!
//! Not tried, as the first sufficed: `hdf5-metno`, bindings to the C library, which would have to be installed or built by
//! CMake and allows one thread at a time.
//!
//! The format: "HDF5 File Format Specification Version 4.0", The HDF Group.

use super::header::{geometry, plain_info, scaled_axes};
use super::stream::sample_bytes;
use super::{OpenOptions, pick_field};
use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::grid::{Geometry, IndexBox};
use crate::volume::strided::StridedVolume;
use crate::volume::{FieldInfo, ScalarType, SlabStream, VolumeInfo, VolumeSource};
use hdf5_reader::group::Group;
use hdf5_reader::io::Cursor;
use hdf5_reader::messages::HdfMessage;
use hdf5_reader::messages::layout::DataLayout;
use hdf5_reader::{ByteOrder, Dataset, Datatype, Hdf5File, SliceInfo, SliceInfoElem, Storage, StorageBuffer};
use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

/// Most bytes of a decoded chunk.
const MOST_CHUNK: u64 = 256 << 20;
/// Small chunks are read together up to so many bytes; what has no chunks, in pieces of so many.
const PIECE: u64 = 2 << 20;
/// Bytes of a slab, unless a slice of a chunk has more.
const SLAB: u64 = 4 << 20;
/// Most frames of a dataset with four axes.
const MOST_FRAMES: u64 = 1 << 16;
/// Most samples of a coordinate variable that is looked at.
const MOST_COORDINATES: u64 = 1 << 24;

/// Opens a dataset of an HDF5 file.
///
/// # Errors
/// [`Error::BadInput`] when the file is malformed or has no dataset that can be read; [`Error::Usage`] when it has several
/// and none is chosen.
pub fn open(path: &Path, options: &OpenOptions) -> Result<VolumeSource> {
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let file = open_file(path, &source)?;
    let mut tree = Tree::of(path, &file)?;
    let wanted = options.field.as_deref().map(|name| tree.full_name(&file, name));
    tree.check_wanted(path, wanted.as_deref())?;
    let fields: Vec<FieldInfo> = tree.fields.iter().map(|f| f.info.clone()).collect();
    let field = &tree.fields[pick_field(path, &fields, wanted.as_deref())?];
    let mut info = field.volume_info(path, &tree)?;
    info.fields = fields;
    if let Some((at, strides)) = field.in_place(path, &file)? {
        let volume = StridedVolume::new(info, source, at, field.big_endian, strides)?;
        return Ok(VolumeSource::Random(Box::new(volume)));
    }
    Ok(VolumeSource::Stream(Box::new(Pieces::new(info, field)?)))
}

/// The frames of a file whose only dataset has four axes, by the names of their fields, and their times, where the first axis has a coordinate
/// variable. None of other files.
///
/// # Errors
/// As [`open`].
pub(super) fn frames(path: &Path, options: &OpenOptions) -> Result<super::series::Frames> {
    let source = Arc::new(ByteSource::open(path, options.io)?);
    let file = open_file(path, &source)?;
    let tree = Tree::of(path, &file)?;
    let Some(first) = tree.fields.first().filter(|f| f.before.len() == 1) else { return Ok(vec![]) };
    if tree.fields.iter().any(|f| f.dataset.address() != first.dataset.address()) || tree.fields.len() == 1 {
        return Ok(vec![]);
    }
    let times = first.times(&tree).filter(|t| t.len() == tree.fields.len());
    let time = |n: usize| times.as_ref().map(|t| t[n]);
    Ok(tree.fields.iter().enumerate().map(|(n, f)| (f.info.name.clone(), time(n))).collect())
}

fn open_file(path: &Path, source: &Arc<ByteSource>) -> Result<Hdf5File> {
    let limits = hdf5_reader::OpenOptions::default()
        .with_chunk_cache_bytes(0)
        .with_max_chunk_bytes(MOST_CHUNK as usize)
        .with_max_read_bytes(MOST_CHUNK as usize);
    Hdf5File::from_storage_with_options(Arc::new(Bytes(source.clone())), limits)
        .map_err(|e| damaged(path, "superblock", &e))
}

/// Our file for the reader: checked, and followed when it shrinks.
struct Bytes(Arc<ByteSource>);

impl Storage for Bytes {
    fn len(&self) -> u64 {
        self.0.len()
    }

    fn read_range(&self, offset: u64, len: usize) -> hdf5_reader::error::Result<StorageBuffer> {
        let available = self.len().saturating_sub(offset);
        if len as u64 > available {
            let needed = len as u64;
            return Err(hdf5_reader::error::Error::UnexpectedEof { offset, needed, available });
        }
        let mut bytes = vec![0; len];
        self.0.read_at(offset, &mut bytes).map_err(std::io::Error::other)?;
        Ok(StorageBuffer::from_vec(bytes))
    }
}

/// What the reader found wrong, in one line.
fn damaged(path: &Path, at: &str, error: &hdf5_reader::error::Error) -> Error {
    let got: String =
        error.to_string().chars().map(|c| if c.is_control() { ' ' } else { c }).take(300).collect();
    let help = "the file is damaged, cut short, or uses what is not read; try h5dump or h5repack on it";
    Error::bad_input(path, at, "good HDF5", got).with_help(help)
}

/// The datasets of a file.
struct Tree {
    fields: Vec<Field>,
    /// Datasets of one axis: coordinates, maybe.
    lines: Vec<Dataset>,
    /// Datasets of three axes or more that cannot be read, and why.
    refused: Vec<(String, Error)>,
}

impl Tree {
    fn of(path: &Path, file: &Hdf5File) -> Result<Self> {
        let mut tree = Self { fields: vec![], lines: vec![], refused: vec![] };
        let root = file.root_group().map_err(|e| damaged(path, "/", &e))?;
        let (mut groups, mut seen) = (vec![(String::new(), root)], HashSet::new());
        while let Some((name, group)) = groups.pop() {
            if seen.insert(group.address()) {
                let below = tree.add(path, &name, &group, &mut seen)?;
                groups.extend(below.into_iter().rev());
            }
        }
        Ok(tree)
    }

    /// Adds a group's datasets; gives the groups in it.
    fn add(
        &mut self,
        path: &Path,
        prefix: &str,
        group: &Group,
        seen: &mut HashSet<u64>,
    ) -> Result<Vec<(String, Group)>> {
        let (mut groups, mut datasets) =
            group.member_names().map_err(|e| damaged(path, &format!("/{prefix}"), &e))?;
        groups.sort();
        datasets.sort();
        for short in datasets {
            let name = format!("{prefix}{short}");
            match group.dataset(&short) {
                Err(e) => self.refused.push((name.clone(), damaged(path, &name, &e))),
                Ok(dataset) if seen.insert(dataset.address()) => self.add_dataset(path, name, dataset),
                Ok(_) => {}
            }
        }
        let open = |short: String| match group.group(&short) {
            Ok(found) => Ok((format!("{prefix}{short}/"), found)),
            Err(e) => Err(damaged(path, &format!("/{prefix}{short}"), &e)),
        };
        groups.into_iter().map(open).collect()
    }

    fn add_dataset(&mut self, path: &Path, name: String, dataset: Dataset) {
        match dataset.ndim() {
            0 | 2 => {}
            1 => self.lines.push(dataset),
            _ => match fields_of(path, &name, &dataset) {
                Ok(fields) => self.fields.extend(fields),
                Err(e) => self.refused.push((name, e)),
            },
        }
    }

    /// The field that a user's word means: the path with or without its first "/", or that of another link to the dataset.
    fn full_name(&self, file: &Hdf5File, wanted: &str) -> String {
        let wanted = wanted.trim_start_matches('/');
        let (path, frame) = match wanted.rsplit_once(":t") {
            Some((path, frame)) => (path, Some(frame)),
            None => (wanted, None),
        };
        let known = |name: &str| self.fields.iter().any(|f| f.info.name == name);
        let linked = file.dataset(path).ok().filter(|_| !known(wanted)).map(|d| d.address());
        let found = self.fields.iter().filter(|f| Some(f.dataset.address()) == linked).find(|f| {
            frame.is_none_or(|frame| f.info.name.rsplit_once(":t").is_some_and(|(_, t)| t == frame))
        });
        found.map_or_else(|| wanted.to_string(), |f| f.info.name.clone())
    }

    /// Tells why the dataset that is wanted, or the only one, cannot be read.
    fn check_wanted(&mut self, path: &Path, wanted: Option<&str>) -> Result<()> {
        let refused = match wanted {
            Some(wanted) => self.refused.iter().position(|(name, _)| name == wanted),
            None if self.fields.is_empty() && !self.refused.is_empty() => Some(0),
            None => None,
        };
        if let Some(number) = refused {
            return Err(self.refused.swap_remove(number).1);
        }
        if self.fields.is_empty() {
            return Err(Error::bad_input(path, "datasets", "a dataset with three axes", "none"));
        }
        Ok(())
    }
}

/// A dataset of three axes, or one frame of a dataset with more.
struct Field {
    info: FieldInfo,
    dataset: Dataset,
    big_endian: bool,
    /// The entry of each axis before the last three.
    before: Vec<u64>,
}

/// The fields of a dataset with three axes or more.
fn fields_of(path: &Path, name: &str, dataset: &Dataset) -> Result<Vec<Field>> {
    let (scalar, big_endian) = scalar_of(path, name, dataset)?;
    let before = &dataset.shape()[..dataset.ndim() - 3];
    let field = |name: String, before: Vec<u64>| Field {
        info: FieldInfo { name, scalar, components: 1 },
        dataset: dataset.clone(),
        big_endian,
        before,
    };
    match before {
        &[frames] if frames != 1 && frames <= MOST_FRAMES => {
            Ok((0..frames).map(|t| field(format!("{name}:t{t}"), vec![t])).collect())
        }
        _ if before.iter().all(|&n| n == 1) => Ok(vec![field(name.into(), vec![0; before.len()])]),
        _ => {
            let shape: Vec<String> = dataset.shape().iter().map(u64::to_string).collect();
            let expected = "three axes, one more of at most 65536 frames before them, others of one entry";
            Err(Error::bad_input(path, name, expected, shape.join(" x "))
                .with_help("write the part that is wanted to a dataset of its own"))
        }
    }
}

/// The type of a dataset's samples, and whether they are big-endian.
fn scalar_of(path: &Path, name: &str, dataset: &Dataset) -> Result<(ScalarType, bool)> {
    let refuse = |got: String| {
        Error::bad_input(path, name, "integers of 8 to 64 bits, or 32- or 64-bit IEEE floats", got)
            .with_help("write the numbers that are wanted to a dataset of such a type")
    };
    let (scalar, order) = match dataset.dtype() {
        Datatype::FixedPoint { size, signed, byte_order } => (
            ScalarType::from_name(&format!("{}{}", if *signed { "i" } else { "u" }, 8 * u32::from(*size))),
            byte_order,
        ),
        Datatype::FloatingPoint { size, byte_order } => {
            (ScalarType::from_name(&format!("f{}", 8 * u32::from(*size))), byte_order)
        }
        other => return Err(refuse(kind(other).into())),
    };
    let raw = dataset.raw_datatype().map_err(|e| damaged(path, name, &e))?;
    let usual = scalar.filter(|&s| is_usual(s, &raw));
    let scalar =
        usual.ok_or_else(|| refuse(format!("numbers of {} bytes in another form", size(dataset))))?;
    if dataset.attribute("_Unsigned").is_ok_and(|a| a.read_string().is_ok_and(|s| s == "true")) {
        return Err(refuse("signed integers that _Unsigned declares to be unsigned".into()));
    }
    Ok((scalar, *order == ByteOrder::BigEndian))
}

fn size(dataset: &Dataset) -> u8 {
    match dataset.dtype() {
        Datatype::FixedPoint { size, .. } | Datatype::FloatingPoint { size, .. } => *size,
        _ => 0,
    }
}

fn kind(datatype: &Datatype) -> &'static str {
    match datatype {
        Datatype::String { .. } => "text",
        Datatype::Compound { .. } => "records (compound or complex numbers)",
        Datatype::Array { .. } => "arrays (vectors)",
        Datatype::Enum { .. } => "an enumeration (or booleans)",
        Datatype::VarLen { .. } => "lists of variable length",
        Datatype::Opaque { .. } => "opaque bytes",
        Datatype::Reference { .. } => "references",
        _ => "bit fields or another type",
    }
}

/// Whether a datatype message describes the machine's form of a type: all bits used; of floats, the fields of IEEE 754.
fn is_usual(scalar: ScalarType, message: &[u8]) -> bool {
    let bits = 8 * scalar.bytes() as u8;
    let float: &[u8] = match scalar {
        ScalarType::F32 => &[23, 8, 0, 23, 127, 0, 0, 0],
        ScalarType::F64 => &[52, 11, 0, 52, 255, 3, 0, 0],
        _ => &[],
    };
    // Class and version, flags, size; then the first bit and their number, and a float's fields. Bit 6 of the flags, with
    // bit 0, is the VAX order of bytes.
    let vax = !float.is_empty() && message.get(1).is_none_or(|flags| flags & 0x40 != 0);
    let expected = [&[0, 0, bits, 0][..], float].concat();
    !vax && message.get(8..8 + expected.len()) == Some(&expected[..])
}

impl Field {
    /// Samples along x, y, z.
    fn dims(&self) -> [u64; 3] {
        let shape = self.dataset.shape();
        std::array::from_fn(|a| shape[shape.len() - 1 - a])
    }

    fn volume_info(&self, path: &Path, tree: &Tree) -> Result<VolumeInfo> {
        let dims = self.dims();
        sample_bytes(path, dims, self.info.scalar)?;
        let mut info = plain_info(path, "HDF5", dims, self.info.scalar, self.placed(path, tree)?);
        info.format = match self.dataset.chunks() {
            Some(_) => "HDF5 (chunked)".into(),
            None => "HDF5".into(),
        };
        info.field = self.info.clone();
        info.slope = self.number(path, "scale_factor")?.unwrap_or(1.0);
        info.intercept = self.number(path, "add_offset")?.unwrap_or(0.0);
        let scaled = info.slope.is_finite() && info.slope != 0.0 && info.intercept.is_finite();
        if !scaled {
            let got = format!("{} and {}", info.slope, info.intercept);
            let expected = "finite numbers, the first not 0";
            return Err(Error::bad_input(path, self.at("scale_factor, add_offset"), expected, got));
        }
        info.missing = match [self.number(path, "_FillValue")?, self.number(path, "missing_value")?] {
            [Some(a), Some(b)] if a != b && !a.is_nan() && !b.is_nan() => {
                let got = format!("{a} and {b}");
                return Err(Error::bad_input(path, self.at("_FillValue, missing_value"), "one value", got)
                    .with_help("replace the one by the other, and delete its attribute"));
            }
            // What is not a number is missing anyway.
            both => both.into_iter().flatten().find(|v| !v.is_nan()),
        };
        Ok(info)
    }

    fn at(&self, what: &str) -> String {
        format!("{}, {what}", self.info.name)
    }

    /// An attribute that is one number; `None` where there is none.
    fn number(&self, path: &Path, name: &str) -> Result<Option<f64>> {
        let Ok(attribute) = self.dataset.attribute(name) else { return Ok(None) };
        let wrong = |got: String| Error::bad_input(path, self.at(name), "one number", got);
        match attribute.num_elements() {
            Ok(1) => {}
            Ok(n) => return Err(wrong(format!("{n} values"))),
            Err(e) => return Err(damaged(path, &self.at(name), &e)),
        }
        attribute.read_as_f64().map(Some).map_err(|_| wrong(kind(&attribute.datatype).into()))
    }

    /// Spacing and origin, from the coordinate variables.
    fn placed(&self, path: &Path, tree: &Tree) -> Result<Geometry> {
        let (mut origin, mut spacing) = ([0.0; 3], [1.0; 3]);
        let rank = self.dataset.ndim();
        if let Ok(list) = self.dataset.attribute("DIMENSION_LIST") {
            let size = self.dataset.vlen_reference_size();
            for a in 0..3 {
                let reference = list.raw_data.get((rank - 1 - a) * size..(rank - a) * size);
                let line = reference.and_then(|r| self.coordinates(r, tree));
                if let Some((start, step)) = line.filter(|l| l.2 == self.dims()[a]).map(|l| (l.0, l.1)) {
                    (origin[a], spacing[a]) = (start, step);
                }
            }
        }
        geometry(path, "coordinate variables", origin, scaled_axes(spacing))
    }

    /// The times of the frames: the coordinate variable of the first axis, in its own unit.
    fn times(&self, tree: &Tree) -> Option<Vec<f64>> {
        let list = self.dataset.attribute("DIMENSION_LIST").ok()?;
        let reference = list.raw_data.get(..self.dataset.vlen_reference_size())?;
        self.line(reference, tree).filter(|times| times.iter().all(|t| t.is_finite()))
    }

    /// Start, step and number of the coordinates that an entry of `DIMENSION_LIST` refers to, where they are regular.
    fn coordinates(&self, reference: &[u8], tree: &Tree) -> Option<(f64, f64, u64)> {
        let values = self.line(reference, tree)?;
        regular(&values).map(|(start, step)| (start, step, values.len() as u64))
    }

    /// The coordinates that an entry of `DIMENSION_LIST` refers to.
    fn line(&self, reference: &[u8], tree: &Tree) -> Option<Vec<f64>> {
        let bytes = self.dataset.resolve_vlen_reference_bytes(reference, 8).ok()?;
        let address = u64::from_le_bytes(bytes.get(..8)?.try_into().ok()?);
        let line = tree.lines.iter().find(|d| d.address() == address)?;
        // A dimension without coordinates has a dataset too, of zeros.
        let name = line.attribute("NAME").ok().and_then(|a| a.read_string().ok()).unwrap_or_default();
        if name.starts_with("This is a netCDF dimension but not a netCDF variable") {
            return None;
        }
        line.num_elements().ok().filter(|&n| n <= MOST_COORDINATES)?;
        let (scalar, _) = scalar_of(Path::new(""), "", line).ok()?;
        all_f64(line, scalar).ok()
    }

    /// Byte of the first sample, and bytes a step, where the samples lie in the file as they are.
    fn in_place(&self, path: &Path, file: &Hdf5File) -> Result<Option<(u64, [i64; 3])>> {
        let header = file
            .get_or_parse_header(self.dataset.address())
            .map_err(|e| damaged(path, &self.info.name, &e))?;
        let elsewhere = header.messages.iter().any(|m| matches!(m, HdfMessage::ExternalFiles(_)));
        let layout = header.messages.iter().find_map(|m| match m {
            HdfMessage::DataLayout(message) => Some(&message.layout),
            _ => None,
        });
        let (d, bytes) = (self.dims(), self.info.scalar.bytes() as u64);
        let frame = sample_bytes(path, d, self.info.scalar)?;
        let frames = self.dataset.shape()[..self.before.len()].iter().product::<u64>();
        let Some(DataLayout::Contiguous { address, size }) = layout else { return Ok(None) };
        if elsewhere || frame.checked_mul(frames) != Some(*size) {
            return Ok(None);
        }
        let number = self.before.first().copied().unwrap_or(0);
        if Cursor::is_undefined_offset(*address, file.superblock().offset_size) {
            return Ok(None);
        }
        let at = file.superblock().base_address.checked_add(*address);
        let Some(at) = at.and_then(|at| at.checked_add(number * frame)) else { return Ok(None) };
        if at.checked_add(frame).is_none() {
            return Ok(None);
        }
        // They fit, as all samples have fewer than 2^63 bytes.
        let strides = [bytes, bytes * d[0], bytes * d[0] * d[1]].map(|s| s as i64);
        Ok(Some((at, strides)))
    }
}

/// Start and step of numbers that are regular to a thousandth of a step.
fn regular(values: &[f64]) -> Option<(f64, f64)> {
    let (first, last) = (*values.first()?, *values.last()?);
    let step = if values.len() == 1 { 1.0 } else { (last - first) / (values.len() - 1) as f64 };
    let near = |(i, v): (usize, &f64)| (v - (first + i as f64 * step)).abs() <= 1e-3 * step.abs();
    let good = first.is_finite() && step.is_finite() && step != 0.0 && values.iter().enumerate().all(near);
    good.then_some((first, step))
}

/// Runs `$body` with each sample `$value`, in its own type, of a selection of a dataset.
macro_rules! each_sample {
    ($dataset:expr, $selection:expr, $scalar:expr, $value:ident, $body:expr) => {{
        macro_rules! of {
            ($type:ty) => {
                for &$value in $dataset.read_slice::<$type>($selection)?.iter() {
                    $body
                }
            };
        }
        match $scalar {
            ScalarType::U8 => of!(u8),
            ScalarType::I8 => of!(i8),
            ScalarType::U16 => of!(u16),
            ScalarType::I16 => of!(i16),
            ScalarType::U32 => of!(u32),
            ScalarType::I32 => of!(i32),
            ScalarType::U64 => of!(u64),
            ScalarType::I64 => of!(i64),
            ScalarType::F32 => of!(f32),
            ScalarType::F64 => of!(f64),
        }
    }};
}

/// All of a dataset as `f64`.
fn all_f64(dataset: &Dataset, scalar: ScalarType) -> hdf5_reader::error::Result<Vec<f64>> {
    let (all, mut out) = (SliceInfo::all(dataset.ndim()), vec![]);
    each_sample!(dataset, &all, scalar, value, out.push(value as f64));
    Ok(out)
}

/// A box of a dataset as little-endian bytes.
fn little_endian(
    dataset: &Dataset,
    scalar: ScalarType,
    selection: &SliceInfo,
    out: &mut Vec<u8>,
) -> hdf5_reader::error::Result<()> {
    each_sample!(dataset, selection, scalar, value, out.extend_from_slice(&value.to_le_bytes()));
    Ok(())
}

/// The samples of a dataset, some chunks after the others.
struct Pieces {
    info: VolumeInfo,
    dataset: Dataset,
    before: Vec<u64>,
    /// Size of a piece: a multiple of the chunks'.
    piece: [u64; 3],
    /// Where the next one starts.
    next: Option<[u64; 3]>,
    /// What is left of the piece read last, and its bytes, with those given out in front.
    left: IndexBox,
    bytes: Vec<u8>,
    /// Bytes of a chunk.
    chunk_bytes: u64,
}

impl Pieces {
    fn new(info: VolumeInfo, field: &Field) -> Result<Self> {
        let (dims, size) = (info.dims, info.field.scalar.bytes() as u64);
        let wrong = |got: String| {
            Error::bad_input(
                &info.path,
                &info.field.name,
                "chunks of the dataset's axes and at most 256 MiB",
                got,
            )
            .with_help("write the dataset again in smaller chunks (h5repack -l)")
        };
        let (mut piece, mut chunk_bytes) = ([1; 3], 0);
        if let Some(chunk) = field.dataset.chunks() {
            let shown = format!("{chunk:?} samples of {size} bytes");
            let bytes = chunk.iter().try_fold(size, |n, &c| n.checked_mul(u64::from(c)));
            let good = bytes.is_some_and(|b| b > 0 && b <= MOST_CHUNK) && chunk.len() == field.dataset.ndim();
            if !good {
                return Err(wrong(shown));
            }
            chunk_bytes = bytes.unwrap_or(0);
            piece = std::array::from_fn(|a| u64::from(chunk[chunk.len() - 1 - a]).min(dims[a]));
        }
        for a in 0..3 {
            // Either the whole axis, or doubled as often as there is room.
            while piece[a] < dims[a] && 2 * size * piece.iter().product::<u64>() <= PIECE {
                piece[a] = (2 * piece[a]).min(dims[a]);
            }
        }
        let left = IndexBox { lo: [0; 3], hi: [0; 3] };
        let (dataset, before) = (field.dataset.clone(), field.before.clone());
        Ok(Self { info, dataset, before, piece, next: Some([0; 3]), left, bytes: vec![], chunk_bytes })
    }

    /// Reads the piece that starts at `lo`.
    fn read(&mut self, lo: [u64; 3]) -> Result<()> {
        let d = self.info.dims;
        let hi: [u64; 3] = std::array::from_fn(|a| d[a].min(lo[a] + self.piece[a]));
        let range = |start, end| SliceInfoElem::Slice { start, end, step: 1 };
        let before = self.before.iter().map(|&at| range(at, at + 1));
        let selections = before.chain([2, 1, 0].map(|a| range(lo[a], hi[a]))).collect();
        self.left = IndexBox { lo, hi };
        self.bytes.clear();
        let needed = self.left.len() * self.info.field.scalar.bytes();
        self.bytes.reserve(needed);
        let selection = SliceInfo { selections };
        let at = format!("{}, samples from {lo:?} on", self.info.field.name);
        little_endian(&self.dataset, self.info.field.scalar, &selection, &mut self.bytes)
            .map_err(|e| damaged(&self.info.path, &at, &e))?;
        if self.bytes.len() != needed {
            let (expected, got) = (format!("{needed} bytes"), format!("{}", self.bytes.len()));
            return Err(Error::bad_input(&self.info.path, at, expected, got));
        }
        let mut next = lo;
        self.next = None;
        for a in 0..3 {
            next[a] = hi[a];
            if next[a] < d[a] {
                self.next = Some(next);
                break;
            }
            next[a] = 0;
        }
        Ok(())
    }
}

impl SlabStream for Pieces {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn working_bytes(&self) -> u64 {
        let piece = self.piece.iter().product::<u64>() * self.info.field.scalar.bytes() as u64;
        3 * self.chunk_bytes.max(piece) + 2 * SLAB
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        out.clear();
        if self.left.is_empty() {
            let Some(lo) = self.next else { return Ok(None) };
            self.read(lo)?;
        }
        let d = self.left.dims();
        let slice = d[0] * d[1] * self.info.field.scalar.bytes() as u64;
        let slices = (SLAB / slice).max(1);
        // At boundaries of 32: the bricks that are copied to.
        let slices = if slices >= 32 { slices / 32 * 32 } else { slices }.min(d[2]);
        let at = self.bytes.len() - (slice * d[2]) as usize;
        out.extend_from_slice(&self.bytes[at..at + (slice * slices) as usize]);
        let mut slab = self.left;
        slab.hi[2] = slab.lo[2] + slices;
        self.left.lo[2] = slab.hi[2];
        Ok(Some(slab))
    }
}

#[cfg(test)]
mod tests;
