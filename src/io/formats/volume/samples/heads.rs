//! The headers of NPY, NRRD and MetaImage.

use super::pack::Packed;
use super::{Anatomy, FileLayout, GridMeta, SampleFormat};
use crate::error::{Error, Result};
use crate::volume::ScalarType;
use crate::volume::units::Unit;
use std::fmt::Write as _;
use std::path::Path;

/// Numbers divided by blanks.
pub(in crate::formats) fn numbers(list: &[f64]) -> String {
    joined(list, " ")
}

fn joined<T: std::fmt::Display>(list: &[T], between: &str) -> String {
    let mut text = String::new();
    for x in list {
        let _ = write!(text, "{}{x}", if text.is_empty() { "" } else { between });
    }
    text
}

/// Text that is one line, without quotes.
fn line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() || c == '"' || c == '\\' { ' ' } else { c }).collect()
}

/// The type of a sample as NumPy writes it.
pub(crate) fn numpy_type(scalar: ScalarType) -> String {
    let order = if scalar.bytes() == 1 { "|" } else { "<" };
    format!("{order}{}{}", &scalar.name()[..1], scalar.bytes())
}

pub(super) fn npy(shape: &str, scalar: ScalarType) -> Vec<u8> {
    let descr = numpy_type(scalar);
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic, version and length take ten bytes; the data begin at a multiple of 64.
    while !(10 + text.len() + 1).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat()
}

pub(super) fn nrrd(meta: &GridMeta, is_packed: bool) -> Result<Vec<u8>> {
    let field = meta.field();
    let kind = match field.scalar {
        ScalarType::F32 => "float",
        ScalarType::F64 => "double",
        ScalarType::F16 => return Err(no_type("NRRD", field.scalar)),
        other => other.name(),
    };
    let geometry = meta.geometry_in(meta.anatomy);
    let vector = |v: &[f64; 3]| format!("({})", joined(v, ","));
    let mut text = format!("NRRD0005\n# isospan {}\n", env!("CARGO_PKG_VERSION"));
    let mut put = |line: String| {
        text.push_str(&line);
        text.push('\n');
    };
    if !field.name.is_empty() {
        put(format!("content: {}", line(&field.name)));
    }
    put(format!("type: {kind}\ndimension: 3"));
    put(match meta.anatomy {
        Anatomy::Unknown => "space dimension: 3".into(),
        known => format!("space: {}", known.name()),
    });
    put(format!("sizes: {}", joined(&meta.dims, " ")));
    put(format!("space directions: {}", geometry.axes().iter().map(vector).collect::<Vec<_>>().join(" ")));
    put("kinds: domain domain domain".into());
    if field.scalar.bytes() > 1 {
        put("endian: little".into());
    }
    put(format!("encoding: {}", if is_packed { "gzip" } else { "raw" }));
    if let Some(unit) = meta.length_unit() {
        let unit = line(unit.as_str());
        put(format!("space units: \"{unit}\" \"{unit}\" \"{unit}\""));
    }
    if let Some(unit) = &meta.units.value {
        put(format!("sample units: {}", line(unit.as_str())));
    }
    put(format!("space origin: {}\n", vector(&geometry.origin)));
    Ok(text.into_bytes())
}

/// Whether MetaImage has a word for a unit of lengths.
pub(super) fn has_unit(unit: Option<&Unit>) -> bool {
    distance_units(unit).is_some()
}

fn distance_units(unit: Option<&Unit>) -> Option<&'static str> {
    match unit?.as_str() {
        "µm" => Some("um"),
        "mm" => Some("mm"),
        "cm" => Some("cm"),
        _ => None,
    }
}

pub(super) fn metaimage(
    meta: &GridMeta,
    format: SampleFormat,
    path: &Path,
    stored: &Packed,
) -> Result<FileLayout> {
    let field = meta.field();
    let kind = match field.scalar {
        ScalarType::U8 => "MET_UCHAR",
        ScalarType::I8 => "MET_CHAR",
        ScalarType::U16 => "MET_USHORT",
        ScalarType::I16 => "MET_SHORT",
        ScalarType::U32 => "MET_UINT",
        ScalarType::I32 => "MET_INT",
        ScalarType::U64 => "MET_ULONG_LONG",
        ScalarType::I64 => "MET_LONG_LONG",
        ScalarType::F32 => "MET_FLOAT",
        ScalarType::F64 => "MET_DOUBLE",
        ScalarType::F16 => return Err(no_type("MetaImage", field.scalar)),
    };
    let geometry = meta.geometry_in(Anatomy::Lps);
    let mut text = "ObjectType = Image\nNDims = 3\nBinaryData = True\n".to_owned();
    let mut put = |key: &str, value: String| {
        let _ = writeln!(text, "{key} = {value}");
    };
    put("BinaryDataByteOrderMSB", "False".into());
    put("CompressedData", if stored.is_packed() { "True" } else { "False" }.into());
    if stored.is_packed() {
        put("CompressedDataSize", stored.bytes().to_string());
    }
    put("TransformMatrix", numbers(geometry.direction.as_flattened()));
    put("Offset", numbers(&geometry.origin));
    put("CenterOfRotation", "0 0 0".into());
    if let Some(unit) = distance_units(meta.length_unit()) {
        put("DistanceUnits", unit.into());
    }
    put("ElementSpacing", numbers(&geometry.spacing));
    put("DimSize", joined(&meta.dims, " "));
    put("ElementType", kind.into());
    if format == SampleFormat::Mha {
        put("ElementDataFile", "LOCAL".into());
        return Ok(FileLayout { head: text.into_bytes(), ..FileLayout::default() });
    }
    let samples = format.files(path).pop().unwrap_or_default();
    let name = samples.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    if name.contains(char::is_control) || name.trim() != name || name.contains(['%', ' ', '\t']) {
        return Err(Error::usage(format!(
            "cannot write {}: MetaImage has no way to name a file {name}; give a name without blanks and %, or \
             write .mha",
            path.display()
        )));
    }
    put("ElementDataFile", name);
    Ok(FileLayout { header: Some(text.into_bytes()), ..FileLayout::default() })
}

/// The error of a format without a type.
pub(super) fn no_type(format: &str, scalar: ScalarType) -> Error {
    Error::usage(format!("{format} has no samples of type {}", scalar.name()))
}
