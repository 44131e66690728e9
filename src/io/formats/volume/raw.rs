//! Headerless files, whose layout the user gives.
//!
//! ```text
//! byte 0        offset                                 end of file
//!      | skipped | x fastest, then y, then z; no gaps  |
//! ```
//!
//! The file must end with the last sample: a file of another length means that the dimensions or
//! the type are wrong, and a wrong volume would look almost right. A gzip file (`.raw.gz`) is read
//! as a stream, `offset` counting decoded bytes.

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::shared::format::{About, Dataset, Head};
use crate::formats::shared::header::{given_geometry, plain_info};
use crate::formats::shared::stream::{ByteSlabs, Codec, Tail, sample_bytes};
use crate::formats::shared::{OpenOptions, RawLayout, pick_field};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::{ScalarType, VolumeSource};
use std::path::Path;
use std::sync::Arc;

/// A type of samples, with the byte order where its name states one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleType {
    /// The type.
    pub scalar: ScalarType,
    /// Whether samples are big-endian, where the name says so.
    pub big_endian: Option<bool>,
}

impl SampleType {
    /// The type of a name: of NumPy and Zarr, "uint16", or with the byte order "<u2", ">f4", "|u1";
    /// of Rust, "u16", "f32"; of C, "unsigned short", "uint16_t", "float". In any case.
    ///
    /// "u8" and "i8" have eight bits, as in Rust and of most programs that read raw files. NumPy
    /// means eight bytes, which a file's length shows. C's `char` and `long` are no names, since
    /// they are not the same everywhere.
    pub fn from_name(name: &str) -> Option<Self> {
        let name = name.trim().to_ascii_lowercase();
        let (order, code) = name.split_at_checked(1)?;
        let big_endian = match order {
            "<" => Some(false),
            ">" => Some(true),
            "|" => None,
            _ => return named(&name).map(|scalar| Self { scalar, big_endian: None }),
        };
        let found = ScalarType::from_code(code).map(|scalar| Self { scalar, big_endian });
        found.filter(|t| t.big_endian.is_some() || t.scalar.bytes() == 1)
    }
}

/// Names of C and of programs, without blanks, hyphens, "_t" and "int" at the end.
const NAMED: [(ScalarType, &[&str]); 11] = [
    (ScalarType::U8, &["uchar", "unsignedchar", "byte", "ubyte"]),
    (ScalarType::I8, &["schar", "signedchar"]),
    (ScalarType::U16, &["ushort", "unsignedshort"]),
    (ScalarType::I16, &["short", "signedshort"]),
    (ScalarType::U32, &["u", "unsigned"]),
    (ScalarType::I32, &["", "signed"]),
    (ScalarType::U64, &["ulonglong", "unsignedlonglong"]),
    (ScalarType::I64, &["longlong", "signedlonglong"]),
    (ScalarType::F16, &["half"]),
    (ScalarType::F32, &["float", "single"]),
    (ScalarType::F64, &["double"]),
];

/// The type of a name in lower case.
fn named(name: &str) -> Option<ScalarType> {
    let plain = name.strip_suffix("_t").unwrap_or(name);
    let of_rust = |t: &ScalarType| format!("{}{}", &t.name()[..1], 8 * t.bytes());
    let known = ScalarType::from_name(plain);
    let known = known.or_else(|| ScalarType::ALL.into_iter().find(|t| of_rust(t) == name));
    let known = known.or_else(|| ScalarType::from_code(name));
    known.or_else(|| {
        let joined = plain.replace([' ', '-', '_'], "");
        let short = joined.strip_suffix("int").unwrap_or(&joined);
        // Of nothing at all nothing is left, too.
        let found = NAMED.iter().find(|(_, names)| names.contains(&short) && !joined.is_empty());
        found.map(|&(scalar, _)| scalar)
    })
}

/// Headerless files.
pub(in crate::formats) static ABOUT: About =
    About { volumes: &["raw"], on_servers: true, has_spacing: false, ..About::named("a headerless file") };

/// Opens a headerless file: its layout is asked for with the volume.
pub(in crate::formats) fn open(head: &Head<'_>) -> Result<Box<dyn Dataset>> {
    Ok(Box::new(RawFile(Arc::clone(head.file()?))))
}

struct RawFile(Arc<ByteSource>);

impl Dataset for RawFile {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let (source, path) = (&self.0, self.0.path());
        let layout = options.raw.as_ref().ok_or_else(|| no_layout(path))?;
        let geometry = given_geometry(path, options, Geometry::default())?;
        let needed = sample_bytes(path, layout.dims, layout.scalar)?;
        let gzip = source.len() > 2 && source.slice(0..2)? == [0x1f, 0x8b] && has_extension(path, "gz");
        let format = if gzip { "raw (gzip)" } else { "raw" };
        let mut info = plain_info(path, format, layout.dims, layout.scalar, geometry);
        info.assumed = options.assumed([true; 3]);
        pick_field(path, &info.fields, options.field.as_deref())?;
        let (offset, big_endian) = (layout.offset, layout.big_endian);
        if gzip {
            let range = 0..source.len();
            let slabs = ByteSlabs::new(info, source, range, Codec::Gzip, offset, big_endian, Tail::Nothing)?;
            return Ok(VolumeSource::Stream(Box::new(slabs)));
        }
        if offset.checked_add(needed) != Some(source.len()) {
            return Err(wrong_length(path, layout, needed, source.len()));
        }
        let strides =
            StridedVolume::packed_strides(layout.dims, layout.scalar).expect("fewer than 2^63 bytes");
        Ok(StridedVolume::new(info, Arc::clone(source), offset, big_endian, strides)?.source())
    }
}

/// The error for a file whose layout must be given.
pub(in crate::formats) fn no_layout(path: &Path) -> Error {
    Error::usage(format!(
        "{}: a headerless file: give its layout with `dims=X,Y,Z` `type=TYPE`, as in uint16 or float32 \
         (and, where they differ from the defaults, `endian=big`, `offset=BYTES`, `spacing=X,Y,Z`, `origin=X,Y,Z`)",
        path.display()
    ))
}

fn wrong_length(path: &Path, layout: &RawLayout, needed: u64, got: u64) -> Error {
    let ([x, y, z], offset) = (layout.dims, layout.offset);
    let expected = format!(
        "{} bytes: {offset} to skip, then {needed} for {x} x {y} x {z} samples of {}",
        u128::from(offset) + u128::from(needed),
        layout.scalar.name()
    );
    Error::bad_input(path, "length of the file", expected, format!("{got} bytes"))
        .with_help("give the right `dims`, `type` and `offset`")
}

fn has_extension(path: &Path, wanted: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(wanted))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::open_volume;
    use crate::formats::tests::{gzip, ramp, read_all, write};

    fn layout() -> RawLayout {
        RawLayout { dims: [4, 3, 2], scalar: ScalarType::U16, big_endian: true, offset: 3 }
    }

    fn options(raw: RawLayout) -> OpenOptions {
        let (spacing, origin) = (Some([1.0, 2.0, 0.5]), Some([-1.0, 0.0, 9.0]));
        OpenOptions { raw: Some(raw), spacing, origin, ..OpenOptions::default() }
    }

    fn bytes() -> Vec<u8> {
        [&[7; 3][..], &ramp(true)].concat()
    }

    #[test]
    fn axis_order_type_and_offset() {
        let dir = tempfile::tempdir().unwrap();
        for (name, content) in [("a.raw", bytes()), ("a.raw.gz", gzip(&bytes()))] {
            let path = write(&dir, name, &content);
            let (info, values) = read_all(open_volume(&path, &options(layout())).unwrap());
            assert_eq!((info.dims, info.geometry.spacing), ([4, 3, 2], [1.0, 2.0, 0.5]));
            assert_eq!(info.geometry.origin, [-1.0, 0.0, 9.0]);
            assert_eq!(values, (0..24).map(|i| (1000 + i) as f32).collect::<Vec<_>>());
        }
    }

    #[test]
    fn types_have_the_names_that_programs_give_them() {
        use ScalarType::*;
        for (scalar, names) in [
            (U8, &["u8", "uint8", "|u1", "u1", "UINT8", "uint8_t", "uchar", "unsigned char", "byte"][..]),
            (I8, &["i8", "int8", "|i1", "i1", "int8_t", "signed char"]),
            (U16, &["u16", "uint16", "<u2", ">u2", "u2", "uint16_t", "ushort", "unsigned short", "UShort"]),
            (I16, &["i16", "int16", "<i2", "i2", "int16_t", "short", "short int", "signed short int"]),
            (U32, &["u32", "uint32", "<u4", "u4", "uint32_t", "uint", "unsigned int", "unsigned"]),
            (I32, &["i32", "int32", "<i4", "i4", "int32_t", "int", "signed int"]),
            (U64, &["u64", "uint64", "<u8", "uint64_t", "unsigned long long", "ulonglong"]),
            (I64, &["i64", "int64", "<i8", "int64_t", "long long"]),
            (F16, &["f16", "float16", "<f2", "f2", "half"]),
            (F32, &["f32", "float32", "<f4", ">f4", "f4", "float", "Float32", "single"]),
            (F64, &["f64", "float64", "<f8", "f8", "double"]),
        ] {
            for name in names {
                let found = SampleType::from_name(name).expect(name);
                let big_endian = match &name[..1] {
                    "<" => Some(false),
                    ">" => Some(true),
                    _ => None,
                };
                assert_eq!(found, SampleType { scalar, big_endian }, "{name}");
            }
        }
        for name in [
            "",
            " ",
            "char",
            "long",
            "long int",
            "<u3",
            "|u2",
            "<u16",
            "u12",
            "f8x",
            "f128",
            "_t",
            "complex64",
        ] {
            assert_eq!(SampleType::from_name(name), None, "{name}");
        }
    }

    #[test]
    fn wrong_layouts_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = write(&dir, "a.raw", &bytes());
        let code = |o: &OpenOptions| match open_volume(&path, o) {
            Ok(_) => 0,
            Err(e) => e.exit_code(),
        };
        assert_eq!(code(&OpenOptions::default()), 2);
        assert_eq!(code(&OpenOptions { spacing: Some([1.0, -1.0, 1.0]), ..options(layout()) }), 2);
        assert_eq!(code(&OpenOptions { field: Some("x".into()), ..options(layout()) }), 2);
        assert_eq!(code(&OpenOptions { field: Some("data".into()), ..options(layout()) }), 0);
        let big = u64::MAX;
        for (dims, offset) in
            [([4, 3, 2], 2), ([4, 3, 2], 4), ([4, 3, 2], big), ([3, 3, 2], 3), ([big; 3], 0), ([0, 3, 2], 3)]
        {
            assert_eq!(code(&options(RawLayout { dims, offset, ..layout() })), 5, "{dims:?} {offset}");
        }
    }
}
