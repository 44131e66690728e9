//! AmiraMesh (Amira and Avizo): a text header that declares arrays, then the arrays, each behind a
//! label.
//!
//! ```text
//! # AmiraMesh BINARY-LITTLE-ENDIAN 2.1      or "# AmiraMesh 3D BINARY 2.0" (big-endian), "… ASCII …", "# Avizo …"
//! define Lattice 128 128 64                 samples along x, y, z
//! Parameters { BoundingBox 0 1 0 1 0 2, CoordType "uniform" }     the first and the last samples
//! Lattice { ushort Data } @1                raw, or @1(HxZip,BYTES): zlib, or @1(HxByteRLE,BYTES): runs of bytes
//! Coordinates { float xyz } @2              of "rectilinear": those along x, then y, then z
//! # Data section follows
//! @1
//! …                                         x fastest, then a line end
//! ```
//!
//! Each array of one number a sample on the lattice is a field. A `TransformationMatrix` is
//! followed. Refused by name: stacked and curvilinear coordinates, colours and vectors, surfaces,
//! tetrahedra and other kinds of AmiraMesh, which have no lattice of three axes.
//!
//! Raw samples are mapped, compressed ones and text are streams. Memory: the header, and a slab.
//! The format: the Amira user's guide, "AmiraMesh".

use crate::bytes::ByteSource;
use crate::error::{Error, Place, Result};
use crate::formats::shared::coordinates::{GridCoordinates, rectilinear, regular};
use crate::formats::shared::format::{About, Dataset, Format, Head};
use crate::formats::shared::header::{geometry, plain_info, scaled_axes};
use crate::formats::shared::numbers::to_f64;
use crate::formats::shared::stream::{ByteSlabs, Codec, Tail, TextSlabs, sample_bytes};
use crate::formats::shared::{OpenOptions, pick_field};
use crate::grid::Geometry;
use crate::volume::strided::{StridedVolume, swap_bytes};
use crate::volume::{Assumed, FieldInfo, ScalarType, VolumeSource};
use std::ops::Range;
use std::sync::Arc;

/// AmiraMesh.
pub(in crate::formats) struct Amira;

static ABOUT: About = About {
    volumes: &["AmiraMesh"],
    magic: &[b"# AmiraMesh", b"# Avizo"],
    on_servers: true,
    ..About::named("an AmiraMesh file")
};

impl Format for Amira {
    fn about(&self) -> &About {
        &ABOUT
    }

    fn open(&self, head: &Head<'_>) -> Result<Box<dyn Dataset>> {
        Ok(Box::new(AmiraFile::open(head.file()?)?))
    }
}

/// What ends the header.
const END: &[u8] = b"# Data section follows";
/// The longest header.
const LONGEST: usize = 16 << 20;
/// Bytes of the longest label, with blanks around it.
const LABEL: u64 = 64;
/// Most samples along all axes whose coordinates are read.
const MOST_COORDINATES: u64 = 1 << 24;

impl Dataset for AmiraFile {
    fn volume(&self, options: &OpenOptions) -> Result<VolumeSource> {
        let path = self.source.path();
        let on_lattice = || self.arrays.iter().filter(|a| a.on == "Lattice");
        let fields: Vec<FieldInfo> = on_lattice().map(|a| a.field.clone()).collect();
        let number = pick_field(path, &fields, options.field.as_deref())?;
        let array = on_lattice().nth(number).expect("one of them");
        let format = format!("AmiraMesh ({})", array.packed.as_ref().map_or(self.kind.name(), |p| p.name));
        let lines = self.lines()?;
        let assumed = Assumed::in_header([lines.is_none() && self.bounds.is_none(); 3]);
        let geometry = match lines {
            Some(lines) => match placed(&lines) {
                Some([origin, spacing]) => self.geometry(origin, spacing)?,
                None => self.plain_geometry()?,
            },
            None => self.uniform()?,
        };
        let scalar = array.field.scalar;
        sample_bytes(path, self.dims, scalar)?;
        let mut info = plain_info(path, format, self.dims, scalar, geometry);
        info.assumed = assumed;
        (info.field, info.fields) = (array.field.clone(), fields);
        let (range, big_endian) = (self.bytes_of(array)?, self.kind == AmiraEncoding::Big);
        let source = Arc::clone(&self.source);
        if let Some(packed) = &array.packed {
            let slabs = ByteSlabs::new(info, &source, range, packed.codec, 0, big_endian, Tail::Nothing)?;
            return Ok(VolumeSource::Stream(Box::new(slabs)));
        }
        if self.kind == AmiraEncoding::Text {
            return Ok(VolumeSource::Stream(Box::new(TextSlabs::new(info, source, range)?)));
        }
        let strides = StridedVolume::packed_strides(self.dims, scalar).expect("fewer than 2^63 bytes");
        Ok(StridedVolume::new(info, source, range.start, big_endian, strides)?.source())
    }

    fn coordinates(&self, _: &OpenOptions) -> Result<Option<GridCoordinates>> {
        let Some(lines) = self.lines()? else { return Ok(None) };
        match placed(&lines) {
            Some(_) => Ok(None),
            None => rectilinear(self.source.path(), "Coordinates", lines.map(Some), self.dims).map(Some),
        }
    }
}

/// Origin and spacing of coordinates that are regular along all axes.
fn placed(lines: &[Vec<f64>; 3]) -> Option<[[f64; 3]; 2]> {
    let [x, y, z] = lines.each_ref().map(|line| regular(line, true));
    let all = [x?, y?, z?];
    Some([all.map(|(first, _)| first), all.map(|(_, step)| step)])
}

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AmiraEncoding {
    Little,
    Big,
    Text,
}

impl AmiraEncoding {
    fn name(self) -> &'static str {
        if self == Self::Text { "ascii" } else { "raw" }
    }
}

/// An array that the header declares.
struct AmiraArray {
    /// What it is defined on: "Lattice".
    on: String,
    field: FieldInfo,
    /// The number of its label.
    label: u64,
    packed: Option<Packed>,
}

/// How an array is compressed, and to how many bytes.
struct Packed {
    name: &'static str,
    codec: Codec,
    bytes: u64,
}

struct AmiraFile {
    source: Arc<ByteSource>,
    kind: AmiraEncoding,
    dims: [u64; 3],
    /// Names and sizes of what arrays are defined on.
    sizes: Vec<(String, u64)>,
    arrays: Vec<AmiraArray>,
    bounds: Option<[f64; 6]>,
    coordinates: String,
    matrix: Option<[f64; 16]>,
    /// The byte after the header.
    end: u64,
}

/// The header's words: braces are words, quoted text is one, comments are left out.
fn words(text: &str) -> Vec<&str> {
    let (mut words, mut rest) = (vec![], text);
    loop {
        rest = rest.trim_start_matches(|c: char| c.is_whitespace() || c == ',');
        let Some(first) = rest.chars().next() else { return words };
        let length = match first {
            '#' => {
                rest = rest.split_once('\n').map_or("", |(_, after)| after);
                continue;
            }
            '{' | '}' | '=' => 1,
            '"' => rest[1..].find('"').map_or(rest.len(), |n| n + 2),
            // A comma within brackets belongs to the word.
            _ => {
                let ends = |c: char| c.is_whitespace() || "{}=\"".contains(c);
                let word = &rest[..rest.find(ends).unwrap_or(rest.len())];
                if word.contains('(') { word.len() } else { word.find(',').unwrap_or(word.len()) }
            }
        };
        let (word, after) = rest.split_at(length);
        words.push(word);
        rest = after;
    }
}

impl AmiraFile {
    fn open(source: &Arc<ByteSource>) -> Result<Self> {
        let (path, bytes) = (source.path(), source.head_from(0)?);
        let end = bytes[..bytes.len().min(LONGEST)].windows(END.len()).position(|w| w == END);
        let end = end.ok_or_else(|| {
            Error::bad_input(path, "header", "a line \"# Data section follows\"", "none")
                .with_help("the file is cut short")
        })?;
        let text = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let first = text.lines().next().unwrap_or_default().to_ascii_uppercase();
        let kind = match () {
            () if first.contains("BINARY-LITTLE-ENDIAN") => AmiraEncoding::Little,
            () if first.contains("BINARY") => AmiraEncoding::Big,
            () if first.contains("ASCII") => AmiraEncoding::Text,
            () => {
                return Err(Error::bad_input(
                    path,
                    "first line",
                    "BINARY-LITTLE-ENDIAN, BINARY or ASCII",
                    first,
                ));
            }
        };
        let end = (end + END.len()) as u64;
        source.check()?;
        let mut file = Self {
            source: Arc::clone(source),
            kind,
            dims: [0; 3],
            sizes: vec![],
            arrays: vec![],
            bounds: None,
            coordinates: "uniform".into(),
            matrix: None,
            end,
        };
        file.parse(&words(&text))?;
        sample_bytes(path, file.dims, ScalarType::U8)?;
        Ok(file)
    }

    fn wrong(&self, at: &str, expected: &str, got: impl Into<String>) -> Error {
        Error::bad_input(self.source.path(), at, expected, got)
    }

    /// Reads the statements of the header: definitions, parameters, arrays.
    fn parse(&mut self, words: &[&str]) -> Result<()> {
        let mut at = 0;
        while let Some(&word) = words.get(at) {
            at += 1;
            if word == "define" {
                at = self.define(words, at)?;
            } else if words.get(at) == Some(&"{") && word == "Parameters" {
                at = self.parameters(words, at + 1)?;
            } else if words.get(at) == Some(&"{") {
                at = self.array(word, words, at + 1)?;
            } else {
                let expected = "define, Parameters, or an array: NAME { TYPE NAME } @NUMBER";
                return Err(self.wrong("header", expected, word));
            }
        }
        let lattice = self.sizes.iter().any(|(name, _)| name == "Lattice");
        if lattice && self.dims != [0; 3] {
            return Ok(());
        }
        let got: Vec<&str> = self.sizes.iter().map(|(name, _)| name.as_str()).collect();
        Err(self
            .wrong(
                "header",
                "define Lattice with three sizes: a volume",
                format!("define {}", got.join(", ")),
            )
            .with_help("save surfaces as .stl or .ply, and tetrahedra as .vtu"))
    }

    fn define(&mut self, words: &[&str], at: usize) -> Result<usize> {
        let name = words.get(at).copied().unwrap_or_default();
        let sizes: Vec<u64> =
            words[at.min(words.len())..].iter().skip(1).map_while(|w| w.parse().ok()).collect();
        let all = sizes.iter().try_fold(1u64, |n, &s| n.checked_mul(s));
        let all = all.filter(|_| !sizes.is_empty()).ok_or_else(|| {
            self.wrong(&format!("define {name}"), "sizes whose product is below 2^64", format!("{sizes:?}"))
        })?;
        if name == "Lattice"
            && let Ok(dims) = <[u64; 3]>::try_from(&sizes[..])
        {
            self.dims = dims;
        }
        self.sizes.push((name.into(), all));
        Ok(at + 1 + sizes.len())
    }

    /// Reads parameters to their closing brace.
    fn parameters(&mut self, words: &[&str], mut at: usize) -> Result<usize> {
        let mut depth = 1;
        while depth > 0 {
            let Some(&word) = words.get(at) else {
                return Err(self.wrong("Parameters", "a closing brace", "the end of the header"));
            };
            at += 1;
            match word {
                "{" => depth += 1,
                "}" => depth -= 1,
                "BoundingBox" if depth == 1 => self.bounds = Some(self.numbers(word, &words[at..])?),
                "TransformationMatrix" if depth == 1 => self.matrix = Some(self.numbers(word, &words[at..])?),
                "CoordType" if depth == 1 => {
                    self.coordinates = words.get(at).unwrap_or(&"").trim_matches('"').to_owned();
                }
                _ => {}
            }
        }
        Ok(at)
    }

    fn numbers<const N: usize>(&self, name: &str, words: &[&str]) -> Result<[f64; N]> {
        let given = || words.iter().take(N).copied().collect::<Vec<_>>().join(" ");
        let numbers: Vec<f64> = words.iter().take(N).map_while(|w| w.parse().ok()).collect();
        let good = <[f64; N]>::try_from(numbers).ok().filter(|n| n.iter().all(|v| v.is_finite()));
        good.ok_or_else(|| self.wrong(name, &format!("{N} finite numbers"), given()))
    }

    /// Reads an array from the word after its brace on.
    fn array(&mut self, on: &str, words: &[&str], at: usize) -> Result<usize> {
        let end = words[at..].iter().position(|&w| w == "}").map(|n| at + n);
        let end = end.ok_or_else(|| self.wrong(on, "a closing brace", "the end of the header"))?;
        let inside = &words[at..end];
        let [kind, name] = inside else {
            return Err(self.wrong(on, "{ TYPE NAME }", inside.join(" ")));
        };
        let mut next = end + 1;
        if words.get(next) == Some(&"=") {
            next += 1;
        }
        let label = words.get(next).copied().unwrap_or_default();
        let (kind, components) = match kind.split_once('[') {
            Some((kind, count)) => (kind, count.trim_end_matches(']').parse().unwrap_or(0)),
            None => (*kind, 1),
        };
        let scalar = match kind {
            "byte" => ScalarType::U8,
            "short" => ScalarType::I16,
            "ushort" => ScalarType::U16,
            "int" | "int32" => ScalarType::I32,
            "uint" | "uint32" => ScalarType::U32,
            "float" => ScalarType::F32,
            "double" => ScalarType::F64,
            _ => {
                let expected = "byte, short, ushort, int, uint, float or double";
                return Err(self.wrong(&format!("type of {name}"), expected, kind));
            }
        };
        let field = FieldInfo { name: (*name).into(), scalar, components };
        let (number, packing) = label.split_once('(').map_or((label, None), |(n, p)| (n, Some(p)));
        let number = number.strip_prefix('@').and_then(|n| n.parse().ok());
        let number = number.ok_or_else(|| self.wrong(name, "a label @NUMBER", label))?;
        let packed = packing.map(|p| self.packed(&field, p)).transpose()?;
        self.arrays.push(AmiraArray { on: on.into(), field, label: number, packed });
        Ok(next + 1)
    }

    fn packed(&self, field: &FieldInfo, text: &str) -> Result<Packed> {
        let (name, bytes) = text.trim_end_matches(')').split_once(',').unwrap_or((text, ""));
        let bytes = bytes.trim().parse().ok();
        let is_bytes = field.scalar.bytes() == 1;
        match (name, bytes) {
            ("HxZip", Some(bytes)) => Ok(Packed { name: "zlib", codec: Codec::Zlib, bytes }),
            ("HxByteRLE", Some(bytes)) if is_bytes => {
                Ok(Packed { name: "runs of bytes", codec: Codec::ByteRuns, bytes })
            }
            _ => {
                let expected = "(HxZip,BYTES), or of bytes (HxByteRLE,BYTES)";
                Err(self
                    .wrong(&field.name, expected, format!("({text}"))
                    .with_help("save it again as raw or zipped AmiraMesh"))
            }
        }
    }

    /// The bytes of an array.
    fn bytes_of(&self, wanted: &AmiraArray) -> Result<Range<u64>> {
        let mut at = self.end;
        loop {
            let (label, start) = self.label_from(at, wanted)?;
            let array = self.arrays.iter().find(|a| a.label == label);
            let array = array.ok_or_else(|| {
                self.wrong(&format!("@{label}"), "the label of an array that the header declares", "another")
            })?;
            let length = match &array.packed {
                Some(packed) => Some(packed.bytes),
                None if self.kind == AmiraEncoding::Text => self.text_length(start),
                None => {
                    let size = self.sizes.iter().find(|(name, _)| *name == array.on).map(|(_, size)| *size);
                    let of_one = u64::from(array.field.components) * array.field.scalar.bytes() as u64;
                    size.and_then(|size| size.checked_mul(of_one))
                }
            };
            let end = length.and_then(|n| start.checked_add(n)).filter(|&end| end <= self.source.len());
            let end = end.ok_or_else(|| {
                let got = format!("{} bytes after the label", self.source.len() - start);
                let expected = length.map_or("a size of its own".into(), |n| format!("{n} bytes"));
                self.wrong(&array.field.name, &expected, got)
                    .with_help("the file is cut short, or its header is wrong")
            })?;
            if label == wanted.label {
                return Ok(start..end);
            }
            at = end;
        }
    }

    /// The label that follows, and the byte after its line.
    fn label_from(&self, at: u64, wanted: &AmiraArray) -> Result<(u64, u64)> {
        let mut bytes = vec![0; (self.source.len() - at).min(LABEL) as usize];
        self.source.read_at(at, &mut bytes)?;
        let blank = bytes.iter().take_while(|b| b.is_ascii_whitespace()).count();
        let line = &bytes[blank..];
        let length = line.iter().position(|&b| b == b'\n');
        let label =
            length.and_then(|n| std::str::from_utf8(&line[..n]).ok()?.trim().strip_prefix('@')?.parse().ok());
        let (label, length) = label.zip(length).ok_or_else(|| {
            let expected = format!("a label, as far as @{}", wanted.label);
            Error::bad_input(self.source.path(), Place::byte(at + blank as u64), expected, "other bytes")
                .with_help("the file is damaged, or its header is wrong")
        })?;
        Ok((label, at + (blank + length + 1) as u64))
    }

    /// Bytes of an array that is written as text: up to the next label.
    fn text_length(&self, start: u64) -> Option<u64> {
        let text = self.source.slice(start..self.source.len()).ok()?;
        let end = text.windows(2).position(|w| w == b"\n@").map_or(text.len(), |n| n + 1);
        Some(end as u64)
    }

    /// The coordinates along x, y, z of a rectilinear lattice; `None` of a uniform one.
    fn lines(&self) -> Result<Option<[Vec<f64>; 3]>> {
        match self.coordinates.as_str() {
            "uniform" => return Ok(None),
            "rectilinear" => {}
            other => {
                return Err(self
                    .wrong("CoordType", "\"uniform\" or \"rectilinear\"", other)
                    .with_help("resample it to uniform coordinates, with Resample in Amira"));
            }
        }
        let count = self.dims.iter().fold(0u64, |n, &d| n.saturating_add(d));
        let array = self.arrays.iter().find(|a| a.on == "Coordinates" && a.field.components == 1);
        let size = self.sizes.iter().find(|(name, _)| name == "Coordinates").map(|(_, size)| *size);
        let Some(array) = array.filter(|_| size == Some(count) && count <= MOST_COORDINATES) else {
            let got = size.map_or("none".into(), |n| n.to_string());
            return Err(self.wrong("Coordinates", &format!("{count} numbers along the axes"), got));
        };
        let scalar = array.field.scalar;
        let range = self.bytes_of(array)?;
        let info = plain_info(self.source.path(), "AmiraMesh", [count, 1, 1], scalar, Geometry::default());
        let mut bytes = vec![];
        match (&array.packed, self.kind) {
            (None, AmiraEncoding::Text) => {
                let mut slabs = TextSlabs::new(info, Arc::clone(&self.source), range)?;
                read_all(&mut slabs, &mut bytes)?;
            }
            (None, kind) => {
                bytes.resize((range.end - range.start) as usize, 0);
                self.source.read_at(range.start, &mut bytes)?;
                if kind == AmiraEncoding::Big {
                    swap_bytes(&mut bytes, scalar.bytes());
                }
            }
            (Some(packed), kind) => {
                let big = kind == AmiraEncoding::Big;
                let mut slabs =
                    ByteSlabs::new(info, &self.source, range, packed.codec, 0, big, Tail::Nothing)?;
                read_all(&mut slabs, &mut bytes)?;
            }
        }
        let mut numbers = vec![0.0; count as usize];
        to_f64(scalar, &bytes, &mut numbers);
        let [nx, ny, _] = self.dims.map(|d| d as usize);
        Ok(Some([numbers[..nx].to_vec(), numbers[nx..nx + ny].to_vec(), numbers[nx + ny..].to_vec()]))
    }

    /// Where a uniform lattice lies: the box has its first and its last samples.
    fn uniform(&self) -> Result<Geometry> {
        let Some(b) = self.bounds else { return self.geometry([0.0; 3], [1.0; 3]) };
        let spacing = std::array::from_fn(|a| match (b[2 * a + 1] - b[2 * a], self.dims[a]) {
            (0.0, 1) => 1.0,
            (size, 1) => size,
            (size, n) => size / (n - 1) as f64,
        });
        self.geometry([b[0], b[2], b[4]], spacing)
    }

    /// That of samples with coordinates of their own.
    fn plain_geometry(&self) -> Result<Geometry> {
        match self.matrix {
            Some(m) if (0..16).any(|i| m[i] != f64::from(u8::from(i % 5 == 0))) => Err(self
                .wrong("TransformationMatrix", "none, where coordinates are uneven", "one")
                .with_help("resample it to uniform coordinates, with Resample in Amira")),
            _ => Ok(Geometry::default()),
        }
    }

    /// The map to the world of samples from `origin` on, moved by the matrix of the file.
    fn geometry(&self, origin: [f64; 3], spacing: [f64; 3]) -> Result<Geometry> {
        let path = self.source.path();
        let columns = scaled_axes(spacing);
        let Some(m) = self.matrix else { return geometry(path, "BoundingBox", origin, columns) };
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            return Err(self.wrong("TransformationMatrix", "an affine one", "one with a perspective"));
        }
        let turned = |v: [f64; 3]| [0, 1, 2].map(|r| m[r] * v[0] + m[4 + r] * v[1] + m[8 + r] * v[2]);
        let origin = turned(origin);
        let origin = std::array::from_fn(|a| origin[a] + m[12 + a]);
        geometry(path, "BoundingBox and TransformationMatrix", origin, columns.map(turned))
    }
}

fn read_all(slabs: &mut dyn crate::volume::SlabStream, out: &mut Vec<u8>) -> Result<()> {
    let mut slab = vec![];
    while slabs.next_slab(&mut slab)?.is_some() {
        out.extend_from_slice(&slab);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::open_volume;
    use crate::formats::tests::{read_all, torture, write};
    use std::io::Write;

    const DIMS: [u64; 3] = [4, 3, 2];

    fn header(first: &str, more: &str) -> String {
        format!("# AmiraMesh {first} 2.1\n\n\ndefine Lattice 4 3 2\n{more}\n# Data section follows\n")
    }

    const UNIFORM: &str = "Parameters {\n    Materials { Bone { Color 1 0 0, Id 1 } }\n    \
        Content \"4x3x2 short, uniform coordinates\",\n    BoundingBox 1 7 2 6 3 8,\n    CoordType \"uniform\"\n}\n";

    fn sample(n: u64) -> i16 {
        100 * n as i16 - 700
    }

    fn samples(big: bool) -> Vec<u8> {
        (0..24).flat_map(|n| if big { sample(n).to_be_bytes() } else { sample(n).to_le_bytes() }).collect()
    }

    fn zip(bytes: &[u8]) -> Vec<u8> {
        let mut packed = flate2::write::ZlibEncoder::new(vec![], flate2::Compression::fast());
        packed.write_all(bytes).unwrap();
        packed.finish().unwrap()
    }

    fn check(name: &str, file: &[u8], format: &str) {
        let dir = tempfile::tempdir().unwrap();
        let source = open_volume(&write(&dir, name, file), &OpenOptions::default()).unwrap();
        let info = source.info().clone();
        assert_eq!((info.dims, info.format.as_str(), info.field.scalar), (DIMS, format, ScalarType::I16));
        assert_eq!((info.geometry.spacing, info.geometry.origin), ([2.0, 2.0, 5.0], [1.0, 2.0, 3.0]));
        let expected: Vec<f32> = (0..24).map(|n| f32::from(sample(n))).collect();
        assert_eq!(read_all(source).1, expected, "{format}");
    }

    #[test]
    fn raw_zipped_and_text() {
        let lattice = format!("{UNIFORM}Lattice {{ short Data }} @1\n");
        let little =
            [header("BINARY-LITTLE-ENDIAN", &lattice).as_bytes(), b"@1\n", &samples(false), b"\n"].concat();
        check("a.am", &little, "AmiraMesh (raw)");
        let head = header("3D BINARY", &lattice.replace("@1", "= @1"));
        check("a.am", &[head.as_bytes(), b"@1\n", &samples(true), b"\n"].concat(), "AmiraMesh (raw)");
        let packed = zip(&samples(false));
        let head =
            header("BINARY-LITTLE-ENDIAN", &lattice.replace("@1", &format!("@1(HxZip,{})", packed.len())));
        let zipped = [head.as_bytes(), b"\n@1\n", &packed, b"\n"].concat();
        check("a.am", &zipped, "AmiraMesh (zlib)");
        let numbers: Vec<String> = (0..24).map(|n| sample(n).to_string()).collect();
        let text = [header("3D ASCII", &lattice).as_bytes(), b"\n@1\n", numbers.join("\n").as_bytes(), b"\n"]
            .concat();
        check("a.am", &text, "AmiraMesh (ascii)");
        torture("a.am", &little, little.len() - 1);
        torture("a.am", &zipped, zipped.len() - 1);
    }

    #[test]
    fn labels_in_runs_after_another_array() {
        let lattice =
            format!("{UNIFORM}Lattice {{ float[3] Flow }} @1\nLattice {{ byte Labels }} @2(HxByteRLE,9)\n");
        let runs = [12, 5, 0x83, 1, 2, 3, 9, 7];
        let head = header("BINARY-LITTLE-ENDIAN", &lattice.replace(",9)", ",8)"));
        let file = [head.as_bytes(), b"@1\n", &[64; 24 * 12], b"\n@2\n", &runs, b"\n"].concat();
        let dir = tempfile::tempdir().unwrap();
        let source = open_volume(&write(&dir, "a.am", &file), &OpenOptions::default()).unwrap();
        assert_eq!(source.info().field.name, "Labels");
        let expected: Vec<f32> = [vec![5.0; 12], vec![1.0, 2.0, 3.0], vec![7.0; 9]].concat();
        assert_eq!(read_all(source).1, expected);
        torture("a.am", &file, file.len() - 1);
        // Amira ends the runs with a byte of 0. What follows the last sample is not needed.
        for tail in [&[0][..], &[0, 0], &[0, 9, 7], &[3], &[0x80]] {
            let length = format!(",{})", 8 + tail.len());
            let head = header("BINARY-LITTLE-ENDIAN", &lattice.replace(",9)", &length));
            let file = [head.as_bytes(), b"@1\n", &[64; 24 * 12], b"\n@2\n", &runs, tail].concat();
            let source = open_volume(&write(&dir, "a.am", &file), &OpenOptions::default()).unwrap();
            assert_eq!(read_all(source).1, expected, "{tail:?}");
        }
        // Runs that end before the last sample, or go on behind it.
        for runs in [&[12, 5, 0, 12, 7][..], &[12, 5, 12, 7, 1, 7], &[12, 5, 11, 7, 0], &[12, 5, 0x8c, 7]] {
            let length = format!(",{})", runs.len());
            let head = header("BINARY-LITTLE-ENDIAN", &lattice.replace(",9)", &length));
            let file = [head.as_bytes(), b"@1\n", &[64; 24 * 12], b"\n@2\n", runs].concat();
            let source = open_volume(&write(&dir, "a.am", &file), &OpenOptions::default()).unwrap();
            assert!(crate::formats::tests::try_read_all(source).is_err(), "{runs:?}");
        }
    }

    #[test]
    fn uneven_coordinates_and_matrices() {
        let lattice = "define Coordinates 9\nParameters { CoordType \"rectilinear\" }\nLattice { short Data } @1\n\
                       Coordinates { float xyz } @2\n";
        let file = |x: [f32; 4]| {
            let numbers = [&x[..], &[0.0, 2.0, 4.0], &[5.0, 6.0]].concat();
            let coordinates: Vec<u8> = numbers.into_iter().flat_map(f32::to_le_bytes).collect();
            let head = header("BINARY-LITTLE-ENDIAN", lattice);
            [head.as_bytes(), b"@1\n", &samples(false), b"\n@2\n", &coordinates, b"\n"].concat()
        };
        let (dir, options) = (tempfile::tempdir().unwrap(), OpenOptions::default());
        let uneven = write(&dir, "a.am", &file([0.0, 1.0, 2.0, 4.0]));
        match crate::formats::tests::open_coordinates(&uneven, &options).unwrap() {
            Some(GridCoordinates::Axes([x, y, z])) => {
                assert_eq!((x, y, z), (vec![0.0, 1.0, 2.0, 4.0], vec![0.0, 2.0, 4.0], vec![5.0, 6.0]));
            }
            _ => panic!("a rectilinear grid"),
        }
        let even = write(&dir, "a.am", &file([1.0, 2.0, 3.0, 4.0]));
        assert!(crate::formats::tests::open_coordinates(&even, &options).unwrap().is_none());
        let place = open_volume(&even, &options).unwrap().info().geometry;
        assert_eq!((place.origin, place.spacing), ([1.0, 0.0, 5.0], [1.0, 2.0, 1.0]));

        // A quarter turn around z, then a shift.
        let matrix = "TransformationMatrix 0 1 0 0 -1 0 0 0 0 0 1 0 10 20 30 1\n";
        let more = format!(
            "{}Lattice {{ short Data }} @1\n",
            UNIFORM.replace("CoordType", &format!("{matrix}CoordType"))
        );
        let head = header("BINARY-LITTLE-ENDIAN", &more);
        let turned = write(&dir, "a.am", &[head.as_bytes(), b"@1\n", &samples(false)].concat());
        let place = open_volume(&turned, &options).unwrap().info().geometry;
        assert_eq!(place.to_world([0.0; 3]), [8.0, 21.0, 33.0]);
        assert_eq!(place.to_world([1.0, 1.0, 1.0]), [6.0, 23.0, 38.0]);
    }

    #[test]
    fn what_is_not_read_is_named() {
        let dir = tempfile::tempdir().unwrap();
        for (more, message) in [
            ("Lattice { complex Data } @1", "complex"),
            ("Lattice { short Data } @1(HxTurbo,8)", "HxTurbo"),
            ("Lattice { short Data } @1(HxByteRLE,8)", "HxByteRLE"),
            ("Lattice { float[3] Data } @1", "not scalar"),
            ("Parameters { CoordType \"curvilinear\" } Lattice { short Data } @1", "curvilinear"),
            ("Parameters { BoundingBox 0 1 0 1 0 } Lattice { short Data } @1", "BoundingBox"),
            ("Lattice { short Data } @2", "@1: expected the label of an array"),
            ("Lattice { short Data } 1", "label"),
            ("Lattice { short", "closing brace"),
            ("Parameters {", "closing brace"),
            ("Field { float x } Constant(@1)", "label"),
        ] {
            let file = [header("BINARY-LITTLE-ENDIAN", more).as_bytes(), b"@1\n", &samples(false)].concat();
            let error = open_volume(&write(&dir, "a.am", &file), &OpenOptions::default()).err().expect(more);
            assert!(error.to_string().contains(message), "{error}");
        }
        let surface = "# AmiraMesh BINARY 2.1\ndefine Nodes 4\ndefine Tetrahedra 1\n# Data section follows\n";
        let error = open_volume(&write(&dir, "a.am", surface.as_bytes()), &OpenOptions::default()).err();
        let error = error.expect("no lattice").to_string();
        assert!(error.contains("Nodes, Tetrahedra") && error.contains(".vtu"), "{error}");
    }
}
