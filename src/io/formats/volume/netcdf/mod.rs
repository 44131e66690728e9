//! NetCDF-3: the classic format, the one with offsets of 64 bits, and CDF-5.
//!
//! ```text
//!  "CDF" 1|2|5                      then the number of records
//!  dimensions, attributes           names and sizes; a size of 0 is that of the records
//!  variables                        name, dimensions, attributes, type, first byte
//!  …                                variables of fixed size, one after another
//!  record 0, record 1, …            of each record a part of every variable with records
//! ```
//!
//! All numbers are big-endian. Every variable lies in place at regular steps, so it is mapped as it
//! is: a variable with records has the size of a record as the step of its first axis.
//!
//! Variables of three axes or more are the fields, as in NetCDF-4: see `hdf5` for frames and
//! channels, and [`cf`] for attributes and coordinates. Where no attribute names a value that means
//! "no data", it is the fill value of the library for that type, of bytes none. Files of MINC 1 are
//! read by their own rules, see [`minc`]; for other conventions see the module `dialect`. Memory:
//! the header's attributes, and of converted numbers a piece of 128 KiB.
//!
//! The reader is our own, since the format is small, and no scratch copy may be needed. The format:
//! "NetCDF Classic Format Specification", Unidata.

mod arrays;
mod dialect;
mod header;

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::shared::cf::{self, Convert, Hyperslab, Line, MOST_COORDINATES, Rules};
use crate::formats::shared::coordinates::GridCoordinates;
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::header::{given_geometry, plain_info};
use crate::formats::shared::lengths::Lengths;
use crate::formats::shared::minc;
use crate::formats::shared::numbers::to_f64;
use crate::formats::shared::stream::sample_bytes;
use crate::formats::shared::{Frames, OpenOptions, pick_field};
use crate::grid::{Geometry, IndexBox};
use crate::volume::chunked::ChunkSource;
use crate::volume::strided::StridedVolume;
use crate::volume::units::Units;
use crate::volume::{FieldInfo, ScalarType, VolumeInfo, VolumeReader, VolumeSource};
pub(in crate::formats) use arrays::arrays;
use dialect::Dialect;
use header::{NetcdfHeader, Variable};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// NetCDF-3.
pub(in crate::formats) struct NetCdf;

static ABOUT: About = About {
    volumes: &["NetCDF"],
    magic: &[b"CDF\x01", b"CDF\x02", b"CDF\x05"],
    on_servers: true,
    has_spacing: false,
    has_channels: true,
    ..About::named("a NetCDF-3 file")
};

impl Format for NetCdf {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        Ok(Box::new(NetcdfFile::open(head.file()?)?))
    }
}

/// Most fields of a file: frames of all variables.
const MOST_FIELDS: usize = 1 << 20;
/// Bytes of a piece whose numbers are converted together.
const PIECE: u64 = 128 << 10;

impl Dataset for NetcdfFile {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let (path, field) = (self.path(), &self.fields[self.pick(options)?]);
        if self.dialect == Dialect::Minc {
            return self.image(field, options);
        }
        let lines = self.lines(field)?;
        if lines.iter().any(Option::is_some) {
            options.refuse_other_geometry(path, "a file with coordinates")?;
        }
        let geometry = cf::placed(path, &lines, field.part.world, [1.0; 3])?;
        let geometry = given_geometry(path, options, geometry)?;
        let variable = &self.header.variables[field.variable];
        let mut info = self.info(field, geometry);
        info.assumed = options.assumed([0, 1, 2].map(|a| lines[a].is_none()));
        let convert = variable.packing(path)?.into_info(&mut info);
        info.units = self.units(field);
        info.notes.extend(self.lengths(field).note);
        self.source(field, info, convert)
    }

    fn coordinates(&self, options: &OpenOptions) -> Result<Option<GridCoordinates>> {
        let field = &self.fields[self.pick(options)?];
        if self.dialect == Dialect::Minc {
            return Ok(None);
        }
        let lines = self.lines(field)?;
        cf::grid_of(self.path(), &field.part.info.name, lines, field.part.world, self.dims(field))
    }

    fn steps(&self, options: &OpenOptions) -> Result<Frames> {
        let wanted = cf::with_channel(self.path(), options, self.fields.iter().map(|f| &f.part))?;
        let first = match &wanted {
            Some(name) => {
                let first = format!("{name}:t0");
                self.fields.iter().find(|f| f.part.is_frame() && f.part.info.name == first)
            }
            None => self.fields.first().filter(|f| f.part.is_frame()),
        };
        let Some(first) = first else { return Ok(vec![]) };
        let times = first.part.frames.map_or(Ok(None), |axis| self.times_along(first, axis))?;
        let parts = self.fields.iter().map(|f| &f.part);
        Ok(cf::frames(parts, &first.part, wanted.is_some(), times))
    }

    fn times(&self, _: &OpenOptions) -> Result<HashMap<String, f64>> {
        let mut failed = Ok(());
        let of_frames =
            |field: &NetcdfField| field.part.frames.map_or(Ok(None), |axis| self.times_along(field, axis));
        let times = cf::times(self.fields.iter(), |field| {
            of_frames(field).unwrap_or_else(|e| {
                failed = Err(e);
                None
            })
        });
        failed.map(|()| times)
    }

    fn time(&self, options: &OpenOptions) -> Result<Option<f64>> {
        if options.field.is_none() {
            return Ok(cf::common_time(self.fields.iter(), |field| self.time_of(field).ok().flatten()));
        }
        self.time_of(&self.fields[self.pick(options)?])
    }

    fn calendar(&self, options: &OpenOptions) -> Result<String> {
        let time = self.time_variable(&self.fields[self.pick(options)?]);
        Ok(time.map_or_else(String::new, |time| time.text("calendar")))
    }
}

/// A file whose header was read.
struct NetcdfFile {
    source: Arc<ByteSource>,
    header: NetcdfHeader,
    dialect: Dialect,
    fields: Vec<NetcdfField>,
    /// Variables of three axes or more that are not read, and why.
    refused: Vec<(String, Error)>,
}

/// A variable of three axes, or a part of one with more.
struct NetcdfField {
    part: Hyperslab,
    variable: usize,
}

impl AsRef<Hyperslab> for NetcdfField {
    fn as_ref(&self) -> &Hyperslab {
        &self.part
    }
}

impl NetcdfFile {
    fn open(source: &Arc<ByteSource>) -> Result<Self> {
        let path = source.path();
        let header = NetcdfHeader::parse(path, source.head_from(0)?, source.len())?;
        source.check()?;
        let dialect = Dialect::of(path, &header)?;
        let source = Arc::clone(source);
        let mut file = Self { source, header, dialect, fields: vec![], refused: vec![] };
        for (number, variable) in file.header.variables.iter().enumerate() {
            if variable.dims.len() < 3 || !dialect.has_field(&variable.name) {
                continue;
            }
            match file.parts(variable) {
                Ok(parts) => {
                    file.fields.extend(parts.into_iter().map(|part| NetcdfField { part, variable: number }));
                }
                Err(e) => file.refused.push((variable.name.clone(), e)),
            }
            if file.fields.len() > MOST_FIELDS {
                let expected = format!("at most {MOST_FIELDS} frames of all variables");
                return Err(Error::bad_input(path, "variables", expected, "more")
                    .with_help("write the variable that is wanted to a file of its own (ncks -v)"));
            }
        }
        Ok(file)
    }

    fn path(&self) -> &Path {
        self.source.path()
    }

    /// The fields of a variable.
    fn parts(&self, variable: &Variable) -> Result<Vec<Hyperslab>> {
        let scalar = match self.dialect {
            Dialect::Plain => variable.scalar(self.path())?,
            Dialect::Minc => dialect::scalar_of_minc(variable, self.path())?,
        };
        let shape = self.header.shape(variable);
        if shape.contains(&0) {
            let got = format!("{shape:?} of them");
            return Err(Error::bad_input(self.path(), &*variable.name, "samples along each axis", got)
                .with_help("the file has no records yet, or an empty dimension"));
        }
        if self.dialect == Dialect::Minc {
            let kinds = minc::kinds(&self.header.dim_names(variable), shape.len());
            return cf::parts_of(self.path(), &variable.name, &shape, &kinds, scalar, Rules::Volumes);
        }
        cf::refuse_mesh(&variable.of(self.path()), &self.header.dim_names(variable))?;
        let kinds: Vec<char> = variable.dims.iter().map(|&dim| self.kind(dim)).collect();
        cf::parts_of(self.path(), &variable.name, &shape, &kinds, scalar, Rules::Plain)
    }

    /// What a dimension is: see [`cf::kind_of_name`].
    fn kind(&self, dim: usize) -> char {
        let name = &self.header.dims[dim].name;
        match self.coordinate(dim) {
            Some(line) => cf::kind_of_coordinate(name, &line.text("axis"), &line.text("units")),
            None => cf::kind_of_name(name),
        }
    }

    /// The coordinate variable of a dimension.
    fn coordinate(&self, dim: usize) -> Option<&Variable> {
        let name = &self.header.dims[dim].name;
        self.header.variables.iter().find(|v| v.name == *name && v.dims == [dim])
    }

    /// What the attributes say of units.
    fn units(&self, field: &NetcdfField) -> Units {
        let variable = &self.header.variables[field.variable];
        let time = self.time_variable(field).map(|time| time.text("units"));
        cf::units(&variable.text("units"), &self.lengths(field), time)
    }

    /// The variable with the times of a field, or with its one time.
    fn time_variable(&self, field: &NetcdfField) -> Option<&Variable> {
        let variable = &self.header.variables[field.variable];
        match field.part.time {
            Some(axis) => self.coordinate(variable.dims[axis]),
            None => self.single_time(variable),
        }
    }

    /// The variable with the one time of a variable that has no axis of time.
    fn single_time(&self, variable: &Variable) -> Option<&Variable> {
        let coordinates = [variable.text("coordinates"), self.header.text("coordinates")].join(" ");
        cf::names_of_time(&coordinates).find_map(|(name, most_axes)| {
            let v = self.header.variable(name)?;
            let kind = cf::kind_of_coordinate(name, &v.text("axis"), &v.text("units"));
            let is_one = v.dims.len() <= most_axes && self.header.shape(v).iter().all(|&n| n == 1);
            (kind == 't' && is_one && v.scalar(self.path()).is_ok()).then_some(v)
        })
    }

    /// The time of a field.
    fn time_of(&self, field: &NetcdfField) -> Result<Option<f64>> {
        let variable = &self.header.variables[field.variable];
        let Some(axis) = field.part.time else {
            if self.dialect == Dialect::Minc {
                return Ok(None);
            }
            let time = self.single_time(variable).map(|time| self.small(time)).transpose()?;
            return Ok(time.and_then(|numbers| numbers.first().copied()));
        };
        let times = self.times_along(field, axis)?;
        Ok(times.and_then(|times| times.get(field.part.entries[axis] as usize).copied()))
    }

    /// The times along an axis of a variable.
    fn times_along(&self, field: &NetcdfField, axis: usize) -> Result<Option<Vec<f64>>> {
        if self.dialect == Dialect::Minc {
            let count = self.header.shape(&self.header.variables[field.variable])[axis];
            return Ok(minc::times(self, count));
        }
        Ok(self.line(field, axis)?.map(|line| line.values))
    }

    fn info(&self, field: &NetcdfField, geometry: Geometry) -> VolumeInfo {
        let (scalar, dims) = (field.part.info.scalar, self.dims(field));
        let mut info = plain_info(self.path(), self.header.name(), dims, scalar, geometry);
        info.field = field.part.info.clone();
        info.fields = self.infos();
        info
    }

    /// The samples of a field, as they are stored or converted.
    fn source(
        &self,
        field: &NetcdfField,
        info: VolumeInfo,
        convert: Option<Convert>,
    ) -> Result<VolumeSource> {
        let (at, strides) = self.place(field)?;
        let volume = StridedVolume::new(info, self.source.clone(), at, true, strides)?;
        Ok(match convert {
            None => volume.source(),
            Some(convert) => VolumeSource::Chunked(Arc::new(NetcdfPieces::new(volume, convert))),
        })
    }

    /// The image of a MINC file.
    fn image(&self, field: &NetcdfField, options: &OpenOptions) -> Result<VolumeSource> {
        options.refuse_geometry(self.path(), "a MINC file")?;
        let variable = &self.header.variables[field.variable];
        let (axes, shape) = (self.header.dim_names(variable), self.header.shape(variable));
        let Hyperslab { info, time, entries, .. } = &field.part;
        let moment = time.map(|axis| entries[axis]);
        let stored = minc::Stored { axes: &axes, shape: &shape, scalar: info.scalar, moment };
        let minc::Image { geometry, convert, units, assumed } = minc::image(self, &stored)?;
        let info = VolumeInfo { format: "MINC 1".into(), units, assumed, ..self.info(field, geometry) };
        self.source(field, info, convert)
    }

    fn infos(&self) -> Vec<FieldInfo> {
        self.fields.iter().map(|f| f.part.info.clone()).collect()
    }

    /// The number of the field that is wanted.
    fn pick(&self, options: &OpenOptions) -> Result<usize> {
        let wanted = cf::with_channel(self.path(), options, self.fields.iter().map(|f| &f.part))?;
        let refused = match &wanted {
            Some(wanted) => self.refused.iter().position(|(name, _)| name == wanted),
            None if self.fields.is_empty() && !self.refused.is_empty() => Some(0),
            None => None,
        };
        match refused {
            Some(number) => Err(self.refused[number].1.again()),
            None if self.fields.is_empty() => {
                Err(Error::bad_input(self.path(), "variables", "a variable with three axes", "none"))
            }
            None => pick_field(self.path(), &self.infos(), wanted.as_deref()),
        }
    }

    /// Samples along x, y, z.
    fn dims(&self, field: &NetcdfField) -> [u64; 3] {
        field.part.dims(&self.header.shape(&self.header.variables[field.variable]))
    }

    /// Byte of the first sample, and bytes a step along x, y, z.
    fn place(&self, field: &NetcdfField) -> Result<(u64, [i64; 3])> {
        let variable = &self.header.variables[field.variable];
        let steps = self.header.steps(self.path(), variable)?;
        sample_bytes(self.path(), self.dims(field), field.part.info.scalar)?;
        let large = || {
            let got = "a number of more than 63 bits";
            Error::bad_input(self.path(), &*variable.name, "a place in the file", got)
                .with_help("the header is damaged")
        };
        let mut at = variable.begin;
        for (&entry, &step) in field.part.entries.iter().zip(&steps) {
            at = entry.checked_mul(step).and_then(|by| at.checked_add(by)).ok_or_else(large)?;
        }
        let mut strides = [0; 3];
        for (axis, stride) in field.part.axes.into_iter().zip(&mut strides) {
            *stride = i64::try_from(steps[axis]).map_err(|_| large())?;
        }
        Ok((at, strides))
    }

    /// The coordinates along x, y, z, where the file has them.
    fn lines(&self, field: &NetcdfField) -> Result<[Option<Line>; 3]> {
        let [x, y, z] = field.part.axes.map(|axis| self.line(field, axis));
        Ok(cf::in_one_unit([x?, y?, z?], &self.lengths(field), field.part.world))
    }

    /// The lengths along the axes of the world.
    fn lengths(&self, field: &NetcdfField) -> Lengths {
        let dims = &self.header.variables[field.variable].dims;
        let of_axis = |axis: usize| Some(self.coordinate(dims[axis])?.text("units"));
        cf::lengths(field.part.axes.map(of_axis), field.part.world)
    }

    /// The coordinates along an axis of a variable, where the file has them.
    fn line(&self, field: &NetcdfField, axis: usize) -> Result<Option<Line>> {
        let dim = self.header.variables[field.variable].dims[axis];
        let Some(variable) = self.coordinate(dim) else { return Ok(None) };
        // Names, for example, are no coordinates.
        let Ok(scalar) = variable.scalar(self.path()) else { return Ok(None) };
        let count = self.header.size(dim);
        if count > MOST_COORDINATES {
            return Ok(None);
        }
        Ok(Some(Line::new(self.small(variable)?, scalar == ScalarType::F32)))
    }

    /// The numbers of a variable of at most two axes.
    fn small(&self, variable: &Variable) -> Result<Vec<f64>> {
        let scalar = variable.scalar(self.path())?;
        let size = scalar.bytes() as i64;
        // Not along x: the numbers of records are far apart, and are read each by itself.
        let (mut dims, mut strides) = ([1; 3], [size; 3]);
        let (shape, steps) = (self.header.shape(variable), self.header.steps(self.path(), variable)?);
        for (axis, (&count, &step)) in shape.iter().rev().zip(steps.iter().rev()).enumerate().take(2) {
            (dims[1 + axis], strides[1 + axis]) = (count, i64::try_from(step).unwrap_or(i64::MAX));
        }
        let mut info = plain_info(self.path(), self.header.name(), dims, scalar, Geometry::default());
        info.field.name.clone_from(&variable.name);
        let reader = StridedVolume::new(info, self.source.clone(), variable.begin, true, strides)?;
        let count = IndexBox::whole(dims).len();
        let mut bytes = vec![0; count * scalar.bytes()];
        reader.read_stored(IndexBox::whole(dims), &mut bytes)?;
        let mut values = vec![0.0; count];
        to_f64(scalar, &bytes, &mut values);
        variable.packing(self.path())?.unpack(&mut values);
        Ok(values)
    }
}

impl minc::Variables for NetcdfFile {
    fn path(&self) -> &Path {
        self.source.path()
    }

    fn place(&self, variable: &str) -> String {
        variable.into()
    }

    fn text(&self, variable: &str, attribute: &str) -> String {
        self.header.variable(variable).map_or_else(String::new, |v| v.text(attribute))
    }

    fn numbers(&self, variable: &str, attribute: &str) -> Option<Vec<f64>> {
        Some(self.header.variable(variable)?.numbers(attribute)?.values)
    }

    fn table(&self, variable: &str, most: u64) -> Result<Option<(Vec<u64>, Vec<f64>)>> {
        let found = self.header.variable(variable).ok_or_else(|| {
            Error::bad_input(self.path(), variable, "the values of the ends of the valid range", "none")
        })?;
        let shape = self.header.shape(found);
        let count = shape.iter().try_fold(1u64, |n, &d| n.checked_mul(d));
        if shape.len() > 2 || count.is_none_or(|n| n > most) {
            return Ok(None);
        }
        Ok(Some((shape, self.small(found)?)))
    }
}

/// The values of a variable with a valid range, as `f64`, piece by piece.
struct NetcdfPieces {
    info: VolumeInfo,
    volume: StridedVolume,
    convert: Convert,
    piece: [u64; 3],
}

impl NetcdfPieces {
    fn new(volume: StridedVolume, convert: Convert) -> Self {
        let mut info = volume.info().clone();
        info.field.scalar = ScalarType::F64;
        let (dims, mut piece) = (info.dims, [1; 3]);
        for a in 0..3 {
            while piece[a] < dims[a] && 16 * piece.iter().product::<u64>() <= PIECE {
                piece[a] = (2 * piece[a]).min(dims[a]);
            }
        }
        Self { info, volume, convert, piece }
    }
}

impl ChunkSource for NetcdfPieces {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn chunk_dims(&self) -> [u64; 3] {
        self.piece
    }

    fn decoding_bytes(&self) -> u64 {
        // Stored, as f64, and given out.
        24 * self.piece.iter().product::<u64>()
    }

    fn decode(&self, at: [u64; 3], out: &mut Vec<u8>) -> Result<()> {
        let d = self.info.dims;
        let lo: [u64; 3] = std::array::from_fn(|a| at[a].saturating_mul(self.piece[a]).min(d[a]));
        let hi = std::array::from_fn(|a| lo[a].saturating_add(self.piece[a]).min(d[a]));
        let voxels = IndexBox { lo, hi };
        let scalar = self.volume.info().field.scalar;
        let mut stored = vec![0; voxels.len() * scalar.bytes()];
        self.volume.read_stored(voxels, &mut stored)?;
        let mut numbers = vec![0.0; voxels.len()];
        to_f64(scalar, &stored, &mut numbers);
        out.clear();
        self.convert.push_values(&numbers, voxels, out);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
