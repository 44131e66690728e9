//! The header of a NetCDF-3 file.

use crate::error::{Error, Result};
use crate::formats::shared::cf::{AttributeNumbers, Attributes, Packing, netcdf_fill, signed_as};
use crate::formats::shared::numbers::to_f64;
use crate::volume::ScalarType;
use crate::volume::strided::swap_bytes;
use byteorder::{BE, ByteOrder};
use std::path::Path;

/// What a header says.
pub(super) struct NetcdfHeader {
    version: u8,
    pub(super) dims: Vec<Dim>,
    pub(super) variables: Vec<Variable>,
    attributes: Vec<Attribute>,
    records: u64,
    /// Bytes of a record of all variables.
    record_bytes: u64,
}

/// A dimension.
pub(super) struct Dim {
    pub(super) name: String,
    /// 0 for the one of records.
    size: u64,
}

/// A variable.
pub(super) struct Variable {
    pub(super) name: String,
    /// The numbers of its dimensions, slowest first.
    pub(super) dims: Vec<usize>,
    kind: NetcdfType,
    /// Byte of its first sample.
    pub(super) begin: u64,
    attributes: Vec<Attribute>,
}

/// An attribute that is used.
struct Attribute {
    name: String,
    kind: NetcdfType,
    /// As they are stored.
    bytes: Vec<u8>,
}

/// The type of numbers, or text.
#[derive(Clone, Copy, PartialEq, Eq)]
enum NetcdfType {
    Text,
    Number(ScalarType),
}

impl NetcdfType {
    fn of(code: u32, version: u8) -> Option<Self> {
        let kind = match code {
            1 => Self::Number(ScalarType::I8),
            2 => Self::Text,
            3 => Self::Number(ScalarType::I16),
            4 => Self::Number(ScalarType::I32),
            5 => Self::Number(ScalarType::F32),
            6 => Self::Number(ScalarType::F64),
            7 => Self::Number(ScalarType::U8),
            8 => Self::Number(ScalarType::U16),
            9 => Self::Number(ScalarType::U32),
            10 => Self::Number(ScalarType::I64),
            11 => Self::Number(ScalarType::U64),
            _ => return None,
        };
        (code <= 6 || version == 5).then_some(kind)
    }

    fn bytes(self) -> u64 {
        match self {
            Self::Text => 1,
            Self::Number(scalar) => scalar.bytes() as u64,
        }
    }
}

/// The attributes that are used.
const USED: [&str; 28] = [
    "scale_factor",
    "add_offset",
    "_FillValue",
    "missing_value",
    "valid_range",
    "valid_min",
    "valid_max",
    "axis",
    "units",
    "_Unsigned",
    "elem_type",
    // Of time, meshes and conventions of files.
    "coordinates",
    "calendar",
    "mesh",
    "location",
    "CDI_grid_type",
    "Conventions",
    "conventions",
    "file_format",
    "floating_point_word_size",
    "xyz_origin",
    // Of MINC.
    "varid",
    "signtype",
    "spacing",
    "start",
    "step",
    "direction_cosines",
    "minc_version",
];
/// The most bytes of an attribute that is used.
const MOST_ATTRIBUTE: u64 = 64 << 10;
/// The most axes of a variable, as the library has it.
const MOST_AXES: u64 = 1024;

/// Tags of lists.
const DIMENSIONS: u32 = 10;
const VARIABLES: u32 = 11;
const ATTRIBUTES: u32 = 12;

impl NetcdfHeader {
    /// Parses the header at the start of `bytes`, the beginning of a file of `length` bytes.
    ///
    /// # Errors
    /// [`Error::BadInput`] where it is malformed or cut short.
    pub(super) fn parse(path: &Path, bytes: &[u8], length: u64) -> Result<Self> {
        let version = bytes.get(3).copied().unwrap_or(0);
        let mut cursor = Cursor { path, bytes, at: 4, version };
        let records = cursor.size("number of records")?;
        let is_unknown = records == if version == 5 { u64::MAX } else { u64::from(u32::MAX) };
        let count = cursor.list(DIMENSIONS, "dimensions")?;
        let mut dims = vec![];
        for _ in 0..count {
            dims.push(Dim { name: cursor.name("dimensions")?, size: cursor.size("dimensions")? });
        }
        let attributes = cursor.attributes()?;
        let count = cursor.list(VARIABLES, "variables")?;
        let mut variables = vec![];
        for _ in 0..count {
            variables.push(cursor.variable(&dims)?);
        }
        let mut header = Self { version, dims, variables, attributes, records, record_bytes: 0 };
        header.record_bytes = header.bytes_of_record(path)?;
        if is_unknown {
            header.records = header.records_in(length);
        }
        Ok(header)
    }

    /// The format, as a person would call it.
    pub(super) fn name(&self) -> &'static str {
        match self.version {
            1 => "NetCDF-3 (classic)",
            2 => "NetCDF-3 (64-bit offset)",
            _ => "NetCDF-3 (CDF-5)",
        }
    }

    /// The text of an attribute of the file; "" where there is no such text.
    pub(super) fn text(&self, name: &str) -> String {
        text_of(&self.attributes, name)
    }

    /// Whether the file has an attribute.
    pub(super) fn has(&self, name: &str) -> bool {
        self.attributes.iter().any(|a| a.name == name)
    }

    /// A variable by its name.
    pub(super) fn variable(&self, name: &str) -> Option<&Variable> {
        self.variables.iter().find(|v| v.name == name)
    }

    /// The names of a variable's dimensions.
    pub(super) fn dim_names(&self, variable: &Variable) -> Vec<String> {
        variable.dims.iter().map(|&dim| self.dims[dim].name.clone()).collect()
    }

    /// The size of a dimension.
    pub(super) fn size(&self, dim: usize) -> u64 {
        if self.dims[dim].size == 0 { self.records } else { self.dims[dim].size }
    }

    /// The sizes of a variable's dimensions.
    pub(super) fn shape(&self, variable: &Variable) -> Vec<u64> {
        variable.dims.iter().map(|&dim| self.size(dim)).collect()
    }

    /// Bytes a step along each axis of a variable.
    pub(super) fn steps(&self, path: &Path, variable: &Variable) -> Result<Vec<u64>> {
        let (mut steps, mut step) = (vec![0; variable.dims.len()], variable.kind.bytes());
        for (n, &dim) in variable.dims.iter().enumerate().rev() {
            let is_record = self.dims[dim].size == 0;
            steps[n] = if is_record { self.record_bytes } else { step };
            if !is_record {
                step = step.checked_mul(self.dims[dim].size).ok_or_else(|| variable.too_large(path))?;
            }
        }
        Ok(steps)
    }

    pub(super) fn has_records(&self, variable: &Variable) -> bool {
        variable.dims.first().is_some_and(|&dim| self.dims[dim].size == 0)
    }

    /// Bytes of a record of a variable, without what fills it up to a multiple of 4.
    fn bytes_of_part(&self, path: &Path, variable: &Variable) -> Result<u64> {
        let mut sizes = variable.dims.iter().skip(1).map(|&dim| self.dims[dim].size);
        let bytes = sizes.try_fold(variable.kind.bytes(), u64::checked_mul);
        bytes.ok_or_else(|| variable.too_large(path))
    }

    /// Bytes of a record of all variables. The parts of a single variable follow each other without
    /// a gap.
    fn bytes_of_record(&self, path: &Path) -> Result<u64> {
        let of_records: Vec<&Variable> = self.variables.iter().filter(|v| self.has_records(v)).collect();
        if let [only] = of_records[..] {
            return self.bytes_of_part(path, only);
        }
        of_records.into_iter().try_fold(0u64, |sum, variable| {
            let part = self.bytes_of_part(path, variable)?.checked_next_multiple_of(4);
            part.and_then(|part| sum.checked_add(part)).ok_or_else(|| variable.too_large(path))
        })
    }

    /// The records of a file whose writer did not note their number.
    fn records_in(&self, length: u64) -> u64 {
        let of_records = self.variables.iter().filter(|v| self.has_records(v));
        let begin = of_records.map(|v| v.begin).min().unwrap_or(length);
        length.saturating_sub(begin).checked_div(self.record_bytes).unwrap_or(0)
    }
}

impl Variable {
    /// The type of its samples, as `_Unsigned` says.
    ///
    /// # Errors
    /// [`Error::BadInput`] for text.
    pub(super) fn scalar(&self, path: &Path) -> Result<ScalarType> {
        Ok(signed_as(self.stored(path)?, &self.text("_Unsigned")))
    }

    /// The type of its stored numbers.
    ///
    /// # Errors
    /// [`Error::BadInput`] for text.
    pub(super) fn stored(&self, path: &Path) -> Result<ScalarType> {
        match self.kind {
            NetcdfType::Text => Err(Error::bad_input(path, &*self.name, "numbers", "text")
                .with_help("write the numbers that are wanted to a variable of such a type")),
            NetcdfType::Number(scalar) => Ok(scalar),
        }
    }

    /// Whether it has characters.
    pub(super) fn is_text(&self) -> bool {
        self.kind == NetcdfType::Text
    }

    /// The text of an attribute; none where there is no such text.
    pub(super) fn text(&self, name: &str) -> String {
        text_of(&self.attributes, name)
    }

    /// The numbers of an attribute; `None` where there are none of this name.
    pub(super) fn numbers(&self, name: &str) -> Option<AttributeNumbers> {
        let found = self.attributes.iter().find(|a| a.name == name)?;
        let NetcdfType::Number(scalar) = found.kind else { return None };
        let (mut bytes, size) = (found.bytes.clone(), scalar.bytes());
        swap_bytes(&mut bytes, size);
        let mut values = vec![0.0; bytes.len() / size];
        to_f64(scalar, &bytes, &mut values);
        Some(AttributeNumbers { values, are_floats: scalar.is_float() })
    }

    fn has(&self, name: &str) -> bool {
        self.attributes.iter().any(|a| a.name == name)
    }

    /// What the attributes say about stored numbers.
    pub(super) fn packing(&self, path: &Path) -> Result<Packing> {
        let stored = self.stored(path)?;
        Packing::of(&self.of(path), stored, |_| netcdf_fill(stored))
    }

    /// Its attributes, for those who ask for them by the rules of CF.
    pub(super) fn of<'a>(&'a self, path: &'a Path) -> OfVariable<'a> {
        OfVariable { path, variable: self }
    }

    fn too_large(&self, path: &Path) -> Error {
        Error::bad_input(path, &*self.name, "fewer than 2^64 bytes", "more")
            .with_help("the header is damaged")
    }
}

/// The text of one of some attributes; "" where there is no such text.
fn text_of(attributes: &[Attribute], name: &str) -> String {
    let found = attributes.iter().find(|a| a.name == name && a.kind == NetcdfType::Text);
    found.map_or_else(String::new, |a| String::from_utf8_lossy(&a.bytes).trim_end_matches('\0').to_string())
}

/// A variable's attributes.
pub(super) struct OfVariable<'a> {
    path: &'a Path,
    variable: &'a Variable,
}

impl Attributes for OfVariable<'_> {
    fn numbers(&self, name: &str) -> Result<Option<AttributeNumbers>> {
        match self.variable.numbers(name) {
            None if self.variable.has(name) => Err(self.wrong(name, "numbers", "text".into())),
            found => Ok(found),
        }
    }

    fn text(&self, name: &str) -> String {
        self.variable.text(name)
    }

    fn wrong(&self, names: &str, expected: &str, got: String) -> Error {
        Error::bad_input(self.path, format!("{}, {names}", self.variable.name), expected, got)
    }
}

/// The bytes of a header, from a place on.
struct Cursor<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    version: u8,
}

impl<'a> Cursor<'a> {
    fn bad(&self, what: &str, expected: &str, got: String) -> Error {
        Error::bad_input(self.path, format!("{what}, byte {}", self.at), expected, got)
            .with_help("the header is damaged")
    }

    fn take(&mut self, what: &str, count: u64) -> Result<&'a [u8]> {
        let end = usize::try_from(count).ok().and_then(|count| self.at.checked_add(count));
        let found = end.and_then(|end| self.bytes.get(self.at..end));
        let found = found.ok_or_else(|| {
            let got = format!("the end of the header's {} bytes", self.bytes.len());
            Error::bad_input(self.path, format!("{what}, byte {}", self.at), format!("{count} bytes"), got)
                .with_help("the file is damaged or cut short")
        })?;
        self.at += found.len();
        Ok(found)
    }

    fn word(&mut self, what: &str) -> Result<u32> {
        self.take(what, 4).map(BE::read_u32)
    }

    /// A number of things: of 64 bits in CDF-5.
    fn size(&mut self, what: &str) -> Result<u64> {
        match self.version {
            5 => self.take(what, 8).map(BE::read_u64),
            _ => self.word(what).map(u64::from),
        }
    }

    /// Bytes, and those that fill them up to a multiple of 4.
    fn padded(&mut self, what: &str, count: u64) -> Result<&'a [u8]> {
        let found = self.take(what, count)?;
        self.take(what, count.wrapping_neg() % 4)?;
        Ok(found)
    }

    fn name(&mut self, what: &str) -> Result<String> {
        let length = self.size(what)?;
        let name = self.padded(what, length)?;
        Ok(String::from_utf8_lossy(name).chars().filter(|c| !c.is_control()).collect())
    }

    /// The length of a list.
    fn list(&mut self, tag: u32, what: &str) -> Result<u64> {
        let (found, count) = (self.word(what)?, self.size(what)?);
        if found == tag || (found == 0 && count == 0) {
            return Ok(count);
        }
        Err(self.bad(what, &format!("the tag {tag}"), format!("{found}, with {count} entries")))
    }

    /// The attributes that are used.
    fn attributes(&mut self) -> Result<Vec<Attribute>> {
        let what = "attributes";
        let (count, mut used) = (self.list(ATTRIBUTES, what)?, vec![]);
        for _ in 0..count {
            let name = self.name(what)?;
            let kind = self.kind(what)?;
            let length = self.size(what)?;
            let size = length.saturating_mul(kind.bytes());
            let bytes = self.padded(what, size)?;
            if !USED.contains(&name.as_str()) {
                continue;
            }
            if size > MOST_ATTRIBUTE {
                let expected = format!("at most {MOST_ATTRIBUTE} bytes");
                return Err(self.bad(&name, &expected, format!("{size}")));
            }
            used.push(Attribute { name, kind, bytes: bytes.to_vec() });
        }
        Ok(used)
    }

    fn kind(&mut self, what: &str) -> Result<NetcdfType> {
        let code = self.word(what)?;
        let wrong = || self.bad(what, "a type from 1 to 6, or of CDF-5 to 11", code.to_string());
        NetcdfType::of(code, self.version).ok_or_else(wrong)
    }

    fn variable(&mut self, all: &[Dim]) -> Result<Variable> {
        let what = "variables";
        let name = self.name(what)?;
        let rank = self.size(what)?;
        if rank > MOST_AXES {
            return Err(self.bad(&name, "at most 1024 axes", rank.to_string()));
        }
        let mut dims = vec![];
        for n in 0..rank {
            let dim = self.size(&name)?;
            let known = usize::try_from(dim).ok().filter(|&dim| dim < all.len());
            let known = known
                .ok_or_else(|| self.bad(&name, "the number of a dimension", format!("dimension {dim}")))?;
            if n > 0 && all[known].size == 0 {
                let got = format!("axis {n}");
                return Err(self.bad(&name, "the dimension of records as the first axis", got));
            }
            dims.push(known);
        }
        let attributes = self.attributes()?;
        let kind = self.kind(&name)?;
        // The bytes of the variable, which follow from the rest; large ones do not fit here.
        self.size(&name)?;
        let begin = match self.version {
            1 => self.word(&name).map(u64::from)?,
            _ => self.take(&name, 8).map(BE::read_u64)?,
        };
        Ok(Variable { name, dims, kind, begin, attributes })
    }
}
