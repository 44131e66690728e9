//! NPY (NumPy): a short text header that is a Python dictionary, then the array.
//!
//! ```text
//!  0  6  "\x93NUMPY"
//!  6  2  version: 1.0, 2.0 or 3.0
//!  8  2  length of the header (4 bytes from version 2.0 on), little-endian
//! 10  …  {'descr': '<i2', 'fortran_order': False, 'shape': (256, 128, 128), }  and blanks
//!     …  the array
//! ```
//!
//! An array is indexed `[z, y, x]`, as volumes are in NumPy: a shape of (256, 128, 64) has 64
//! samples along x. In memory order that is x fastest, unless `fortran_order` is true: then z is
//! fastest, and the same array gives the same volume. `bool` is read as `u8` 0 and 1. The reader
//! refuses by name: other than three axes (further ones of one entry apart), complex numbers, long
//! double, records, objects. `.npz` archives are read by [`crate::formats::volume::npz`].
//!
//! The format: NumPy Enhancement Proposal 1, and `numpy.lib.format`.

use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::formats::shared::axes::layout;
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::header::{given_geometry, plain_info};
use crate::formats::shared::stream::sample_bytes;
use crate::formats::shared::{OpenOptions, pick_field};
use crate::grid::Geometry;
use crate::volume::strided::StridedVolume;
use crate::volume::{ScalarType, VolumeSource};
use std::path::Path;
use std::sync::Arc;

/// One array of NumPy.
pub(in crate::formats) struct Npy;

static ABOUT: About = About {
    volumes: &["NPY"],
    suffixes: &[".npy"],
    magic: &[b"\x93NUMPY"],
    on_servers: true,
    has_spacing: false,
    ..About::named("an NPY file")
};

impl Format for Npy {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        let source = Arc::clone(head.file()?);
        let array = Array::parse(head.path, source.head_from(0)?)?;
        Ok(Box::new(NpyFile { source, array }))
    }
}

/// An NPY file.
struct NpyFile {
    source: Arc<ByteSource>,
    array: Array,
}

impl Dataset for NpyFile {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let (path, array) = (self.source.path(), &self.array);
        let format = if array.z_fastest { "NPY (Fortran order)" } else { "NPY" };
        let geometry = given_geometry(path, options, Geometry::default())?;
        let mut info = plain_info(path, format, array.dims, array.scalar, geometry);
        info.assumed = options.assumed([true; 3]);
        pick_field(path, &info.fields, options.field.as_deref())?;
        let (at, big) = (array.data_at as u64, array.big_endian);
        let strides = array.strides(path)?;
        Ok(StridedVolume::new(info, Arc::clone(&self.source), at, big, strides)?.source())
    }
}

/// What the header of an array says.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::formats) struct Array {
    pub dims: [u64; 3],
    pub scalar: ScalarType,
    pub big_endian: bool,
    /// `fortran_order`.
    pub z_fastest: bool,
    /// Bytes before the first sample.
    pub data_at: usize,
}

impl Array {
    /// Parses the header at the start of `bytes`.
    pub(in crate::formats) fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let bad = |at: &str, expected: &str, got: &str| Error::bad_input(path, at, expected, got);
        if !bytes.starts_with(b"\x93NUMPY") {
            return Err(bad("byte 0", "the magic of an NPY file", "other bytes"));
        }
        let short =
            || bad("header", "a whole header", "the end of the file").with_help("the file is cut short");
        let (length_bytes, start): (usize, usize) = match bytes.get(6..8).ok_or_else(short)? {
            [1, 0] => (2, 10),
            [2 | 3, 0] => (4, 12),
            v => return Err(bad("version, byte 6", "1.0, 2.0 or 3.0", &format!("{}.{}", v[0], v[1]))),
        };
        let length = bytes.get(8..8 + length_bytes).ok_or_else(short)?;
        let length = length.iter().rev().fold(0usize, |n, &b| n << 8 | usize::from(b));
        let text = start.checked_add(length).and_then(|end| bytes.get(start..end)).ok_or_else(short)?;
        let text = String::from_utf8_lossy(text);
        let wrong = || bad("header", "{'descr': …, 'fortran_order': …, 'shape': …}", &text);
        let items = dictionary(&text).ok_or_else(wrong)?;
        let get = |key: &str| items.iter().find(|(k, _)| *k == key).map(|(_, v)| *v).ok_or_else(wrong);
        let z_fastest = match get("fortran_order")? {
            "True" => true,
            "False" => false,
            other => return Err(bad("fortran_order", "True or False", other)),
        };
        let (scalar, big_endian) = element(get("descr")?).ok_or_else(|| {
            let expected = "an integer of 8 to 64 bits, bool, f4 or f8";
            bad("descr", expected, get("descr").unwrap_or(""))
                .with_help("convert it, e.g. with .astype('f4')")
        })?;
        let dims = shape(get("shape")?).ok_or_else(|| {
            bad("shape", "three numbers (z, y, x)", get("shape").unwrap_or(""))
                .with_help("cut out or reshape one volume")
        })?;
        sample_bytes(path, dims, scalar)?;
        Ok(Self { dims, scalar, big_endian, z_fastest, data_at: start + length })
    }

    /// Bytes a step along x, y, z.
    pub(in crate::formats) fn strides(&self, path: &Path) -> Result<[i64; 3]> {
        let [x, y, z] = self.dims;
        let order = if self.z_fastest { [z, y, x] } else { [x, y, z] };
        sample_bytes(path, self.dims, self.scalar)?;
        let mut strides = StridedVolume::packed_strides(order, self.scalar).expect("fewer than 2^63 bytes");
        if self.z_fastest {
            strides.reverse();
        }
        Ok(strides)
    }
}

/// The items of a Python dictionary of strings to literals; values as they are written.
fn dictionary(text: &str) -> Option<Vec<(&str, &str)>> {
    let mut rest = text.trim().strip_prefix('{')?.strip_suffix('}')?.trim_start();
    let mut items = vec![];
    while !rest.is_empty() {
        let quote = rest.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
        let (key, after) = rest[1..].split_once(quote)?;
        let after = after.trim_start().strip_prefix(':')?.trim_start();
        let end = value_end(after)?;
        items.push((key, after[..end].trim_end()));
        rest = after[end..].strip_prefix(',').unwrap_or(&after[end..]).trim_start();
    }
    Some(items)
}

/// Where the value at the start of `text` ends: at the first comma outside of quotes and brackets.
fn value_end(text: &str) -> Option<usize> {
    let (mut depth, mut quoted) = (0i32, None);
    for (at, c) in text.char_indices() {
        match (quoted, c) {
            (Some(q), _) if c == q => quoted = None,
            (Some(_), _) => {}
            (None, '\'' | '"') => quoted = Some(c),
            (None, '(' | '[' | '{') => depth += 1,
            (None, ')' | ']' | '}') => depth -= 1,
            (None, ',') if depth == 0 => return Some(at),
            _ => {}
        }
    }
    (depth == 0 && quoted.is_none()).then_some(text.len())
}

/// Type and byte order of an element: "'<i2'".
fn element(descr: &str) -> Option<(ScalarType, bool)> {
    let inner = descr.strip_prefix(['\'', '"'])?.strip_suffix(['\'', '"'])?;
    let (order, kind) = inner.split_at_checked(1)?;
    let scalar = match kind {
        "b1" => ScalarType::U8,
        _ => ScalarType::from_code(kind)?,
    };
    match order {
        "<" => Some((scalar, false)),
        ">" => Some((scalar, true)),
        "|" if scalar.bytes() == 1 => Some((scalar, false)),
        _ => None,
    }
}

/// Samples along x, y, z of a shape "(z, y, x)"; further axes have one entry.
fn shape(text: &str) -> Option<[u64; 3]> {
    let inner = text.strip_prefix('(')?.strip_suffix(')')?.trim_end();
    let parts = inner.strip_suffix(',').unwrap_or(inner).split(',');
    // Python 2 wrote long integers with an L.
    let numbers: Option<Vec<u64>> = parts.map(|n| n.trim().trim_end_matches('L').parse().ok()).collect();
    let numbers = numbers?;
    let found = layout(&numbers, &vec!['?'; numbers.len()]).ok()?;
    let is_one = found.series.is_none() && found.channels.is_none();
    is_one.then(|| found.space.map(|axis| numbers[axis]))
}

#[cfg(test)]
pub(in crate::formats) mod tests {
    use super::*;
    use crate::formats::open_volume;
    use crate::formats::tests::{read_all, torture, write};
    use crate::volume::VolumeInfo;

    /// An NPY file.
    pub(crate) fn npy(version: u8, descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let text = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}      \n");
        let length = if version == 1 {
            (text.len() as u16).to_le_bytes().to_vec()
        } else {
            (text.len() as u32).to_le_bytes().to_vec()
        };
        [b"\x93NUMPY", &[version, 0][..], &length, text.as_bytes(), data].concat()
    }

    /// The samples 1000 + x + 4 y + 12 z of a 4 x 3 x 2 volume, x or z fastest.
    pub(crate) fn samples(big: bool, z_fastest: bool) -> Vec<u8> {
        let at = |i: u16| if z_fastest { i / 6 + 4 * (i / 2 % 3) + 12 * (i % 2) } else { i };
        (0..24)
            .flat_map(|i| if big { (1000 + at(i)).to_be_bytes() } else { (1000 + at(i)).to_le_bytes() })
            .collect()
    }

    pub(crate) fn check(path: &Path, options: &OpenOptions) -> VolumeInfo {
        let (info, values) = read_all(open_volume(path, options).unwrap());
        assert_eq!((info.dims, info.field.scalar), ([4, 3, 2], ScalarType::U16));
        assert_eq!(values, (0..24).map(|i| (1000 + i) as f32).collect::<Vec<_>>());
        info
    }

    #[test]
    fn versions_and_orders() {
        let dir = tempfile::tempdir().unwrap();
        for (version, big, fortran) in
            [(1, false, false), (2, true, false), (3, false, true), (1, true, true)]
        {
            let descr = if big { "'>u2'" } else { "'<u2'" };
            let file = npy(version, descr, fortran, "(2, 3, 4)", &samples(big, fortran));
            check(&write(&dir, "a.npy", &file), &OpenOptions::default());
        }
    }

    #[test]
    fn axes_of_one_entry_are_left_out() {
        let dir = tempfile::tempdir().unwrap();
        for fortran in [false, true] {
            let file = npy(1, "'<u2'", fortran, "(1, 2, 3, 4)", &samples(false, fortran));
            check(&write(&dir, "a.npy", &file), &OpenOptions::default());
        }
        // One channel, as ilastik exports it.
        let file = npy(1, "'|u1'", false, "(5, 6, 7, 1)", &(0..210).collect::<Vec<u8>>());
        let (info, values) =
            read_all(open_volume(&write(&dir, "a.npy", &file), &OpenOptions::default()).unwrap());
        assert_eq!((info.dims, values), ([7, 6, 5], (0..210).map(|i| i as f32).collect()));
    }

    #[test]
    fn every_type_of_number() {
        let dir = tempfile::tempdir().unwrap();
        for (descr, bytes) in [
            ("'|b1'", 1),
            ("'|u1'", 1),
            ("'<f2'", 2),
            ("'<i8'", 8),
            ("'>u8'", 8),
            ("\"<f4\"", 4),
            ("'>f8'", 8),
        ] {
            let file = npy(1, descr, false, "(2L, 2L, 2L)", &vec![0; 8 * bytes]);
            let (info, values) =
                read_all(open_volume(&write(&dir, "a.npy", &file), &OpenOptions::default()).unwrap());
            assert_eq!((info.field.scalar.bytes(), values), (bytes, vec![0.0; 8]));
        }
    }

    #[test]
    fn what_is_not_read_is_named() {
        let dir = tempfile::tempdir().unwrap();
        for (descr, shape, message) in [
            ("'<c8'", "(2, 3, 4)", "descr"),
            ("'|O'", "(2, 3, 4)", "descr"),
            ("'|u2'", "(2, 3, 4)", "descr"),
            ("''", "(2, 3, 4)", "descr"),
            ("[('a', '<u2'), ('b', '<f4')]", "(2, 3, 4)", "descr"),
            ("'<u2'", "(2, 12)", "shape"),
            ("'<u2'", "(24,)", "shape"),
            ("'<u2'", "()", "shape"),
            ("'<u2'", "(2, 1, 3, 4)", "shape"),
            ("'<u2'", "(2, 9, 9, 2)", "shape"),
            ("'<u2'", "(2, 3, -4)", "shape"),
            ("'<u2'", "(2, 0, 4)", "dimensions"),
            ("'<u2'", "(4294967296, 4294967296, 4294967296)", "dimensions"),
            ("'<u2'", "(2, 3, 5)", "cut short"),
        ] {
            let path = write(&dir, "a.npy", &npy(1, descr, false, shape, &samples(false, false)));
            let error = open_volume(&path, &OpenOptions::default()).err().expect(shape);
            assert!(error.exit_code() == 5 && error.to_string().contains(message), "{error}");
        }
        let version =
            open_volume(&write(&dir, "a.npy", &npy(9, "'<u2'", false, "()", &[])), &OpenOptions::default());
        assert!(version.err().expect("refused").to_string().contains("9.0"));
    }

    #[test]
    fn damage_is_refused() {
        let file = npy(1, "'<u2'", true, "(2, 3, 4)", &samples(false, true));
        torture("a.npy", &file, file.len());
    }
}
