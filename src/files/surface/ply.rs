//! PLY, the Polygon File Format of Stanford University (Greg Turk, 1994).
//!
//! A text header names *elements* (vertex, face, …), how many there are, and the *properties* of
//! each; then come the elements in that order, as text or as packed binary of either byte order. A
//! property is one number, or a list: a count and that many numbers.
//!
//! ```text
//! ply                                           vertex   x y z nx ny nz        6 × f32
//! format binary_little_endian 1.0               …
//! element vertex 4                              face     3 a b c               u8, 3 × i32
//! property float x  (y, z, nx, ny, nz)          …
//! element face 4
//! property list uchar int vertex_indices
//! end_header
//! ```
//!
//! We write vertex numbers as `int`, which every reader knows, and as `uint` only where there are
//! more than 2³¹-1 vertices. Coordinates are `double` where `f32` does not tell them apart. Several
//! surfaces in one file have a seventh property, `float isovalue` (`double` where one has more
//! digits); those of labels `int label`, and the label's colour. In a file that we read, `vertex`
//! needs `x`, `y`, `z` (`nx`, `ny`, `nz` are kept); `face` needs the list `vertex_indices` or
//! `vertex_index`; all other elements and properties are skipped. Triangle strips are refused.

use super::{
    Fan, SurfaceMeta, ascii, coordinate_bytes, each_triangle, each_vertex_with, is_finite, put_floats,
    put_place, take_line,
};
use crate::surface::SurfaceSource;
use crate::surface::weld::StoredSurface;
use byteorder::{BE, ByteOrder, LE};
use isospan_io::error::{Error, Place, Result};
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::shared::text::Words;
use isospan_io::volume::ScalarType;
use std::path::Path;

/// Writes a surface as binary little-endian PLY.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
) -> Result<()> {
    let origin = source.origin();
    let kind = if coordinate_bytes(source) == 4 { "float" } else { "double" };
    sink.put(header(source.vertex_count(), source.triangle_count(), kind, meta).as_bytes())?;
    let put_isovalue = meta.put_isovalue();
    let (label_colour, has_label_colours) = (meta.label_colour(), has_label_colours(meta));
    let values = meta.values.as_deref();
    each_vertex_with(source, sink, values, |buffer, number, v, value| {
        put_place(buffer, v, origin);
        put_floats(buffer, v.normal);
        if !meta.parts.is_empty() {
            put_isovalue(number, buffer);
        }
        if has_label_colours {
            buffer.extend_from_slice(&label_colour(number));
        }
        if let Some(values) = values {
            values.put(value, buffer);
            buffer.extend_from_slice(&values.colour(value));
        }
    })?;
    each_triangle(source, sink, |buffer, _, t| {
        let mut record = [3; 13];
        LE::write_u32_into(&t, &mut record[1..]);
        buffer.extend_from_slice(&record);
        Ok(())
    })
}

fn header(vertices: u64, triangles: u64, coordinate: &str, meta: &SurfaceMeta) -> String {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\ncomment isospan surface\n");
    for line in meta.lines() {
        // The header is ASCII.
        text += &format!("comment {}\n", ascii(&line));
    }
    text += &format!("element vertex {vertices}\n");
    for name in ["x", "y", "z"] {
        text += &format!("property {coordinate} {name}\n");
    }
    for name in ["nx", "ny", "nz"] {
        text += &format!("property float {name}\n");
    }
    if !meta.parts.is_empty() {
        let kind = match meta.part_scalar() {
            ScalarType::F32 => "float",
            ScalarType::I32 => "int",
            _ => "double",
        };
        text += &format!("property {kind} {}\n", meta.part_array());
    }
    if has_label_colours(meta) {
        text += COLOURS;
    }
    if let Some(values) = &meta.values {
        let kind = if values.bytes() == 4 { "float" } else { "double" };
        text += &format!("property {kind} {}\n", values.plain_name());
        text += COLOURS;
    }
    let index = if vertices <= i32::MAX as u64 + 1 { "int" } else { "uint" };
    text + &format!("element face {triangles}\nproperty list uchar {index} vertex_indices\nend_header\n")
}

/// The properties of a colour.
const COLOURS: &str = "property uchar red\nproperty uchar green\nproperty uchar blue\n";

/// Whether vertices have the colours of their labels; those of values go first.
fn has_label_colours(meta: &SurfaceMeta) -> bool {
    meta.are_labels() && meta.values.is_none()
}

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
enum PlyKind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl PlyKind {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> u64 {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// A number of this type, of as many bytes.
    fn read<B: ByteOrder>(self, stored: &[u8]) -> f64 {
        match self {
            Self::I8 => (stored[0] as i8).into(),
            Self::U8 => stored[0].into(),
            Self::I16 => B::read_i16(stored).into(),
            Self::U16 => B::read_u16(stored).into(),
            Self::I32 => B::read_i32(stored).into(),
            Self::U32 => B::read_u32(stored).into(),
            Self::F32 => B::read_f32(stored).into(),
            Self::F64 => B::read_f64(stored),
        }
    }
}

/// A property of an element; a list has a type for its count.
#[derive(Debug)]
struct Property {
    name: String,
    kind: PlyKind,
    count: Option<PlyKind>,
}

#[derive(Debug)]
struct PlyElement {
    name: String,
    rows: u64,
    properties: Vec<Property>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum PlyEncoding {
    Ascii,
    Binary { big_endian: bool },
}

/// The elements' data, number by number.
struct Body<'a> {
    words: Words<'a>,
    encoding: PlyEncoding,
}

/// Reads a PLY surface.
pub(in crate::files) fn read(path: &Path, bytes: &[u8], out: &mut StoredSurface) -> Result<()> {
    let mut words = Words::new(path, bytes, 0);
    let (encoding, elements) = read_header(&mut words, &mut |line| take_line(out, line))?;
    let mut body = Body { words, encoding };
    if !elements.iter().any(|e| e.name == "vertex") {
        return Err(body.words.wrong("an element 'vertex'", "a header without it"));
    }
    for element in &elements {
        body.check_rows(element)?;
        match element.name.as_str() {
            "vertex" => read_vertices(&mut body, element, out)?,
            "face" => read_faces(&mut body, element, out)?,
            "tristrips" => {
                return Err(body
                    .words
                    .wrong("faces", "triangle strips")
                    .with_help("convert strips to triangles"));
            }
            _ => skip_rows(&mut body, element)?,
        }
    }
    body.finish()?;
    check_indices(path, out)
}

/// Every vertex number is that of a vertex.
pub(in crate::files) fn check_indices(path: &Path, surface: &StoredSurface) -> Result<()> {
    let (vertices, mut before) = (surface.vertex_count(), 0);
    surface.triangles(&mut |batch| {
        match batch.iter().position(|t| t.iter().any(|&v| u64::from(v) >= vertices)) {
            None => before += batch.len(),
            Some(n) => {
                let at = format!("triangle {}", before + n);
                let expected = format!("vertex numbers below {vertices}");
                return Err(Error::bad_input(path, at, expected, format!("{:?}", batch[n])));
            }
        }
        Ok(())
    })
}

/// Reads a header; hands the comments on.
fn read_header(
    words: &mut Words<'_>,
    each_comment: &mut dyn FnMut(&str),
) -> Result<(PlyEncoding, Vec<PlyElement>)> {
    words.line();
    let (mut encoding, mut elements) = (None, Vec::<PlyElement>::new());
    loop {
        let Some(line) = words.line() else {
            return Err(words.wrong("a header that ends with 'end_header'", "the end of the file"));
        };
        let parts: Vec<&str> = line.split_ascii_whitespace().collect();
        let bad = |expected: &str| Err(words.wrong(expected, format!("'{line}'")));
        match parts[..] {
            ["comment", ..] => each_comment(line.trim_start().trim_start_matches("comment")),
            [] | ["obj_info", ..] => {}
            ["format", name, "1.0"] => match name {
                "ascii" => encoding = Some(PlyEncoding::Ascii),
                "binary_little_endian" => encoding = Some(PlyEncoding::Binary { big_endian: false }),
                "binary_big_endian" => encoding = Some(PlyEncoding::Binary { big_endian: true }),
                _ => return bad("format ascii, binary_little_endian or binary_big_endian"),
            },
            ["element", name, rows] => match rows.parse() {
                Ok(rows) => elements.push(PlyElement { name: name.into(), rows, properties: vec![] }),
                Err(_) => return bad("the number of elements"),
            },
            ["property", ref rest @ ..] => match (property(rest), elements.last_mut()) {
                (Some(property), Some(element)) => element.properties.push(property),
                _ => return bad("a property of an element: a type, or 'list' and two types, and a name"),
            },
            ["end_header"] => match encoding {
                Some(encoding) => return Ok((encoding, elements)),
                None => return bad("a line 'format' before"),
            },
            _ => return bad("a header line of PLY 1.0"),
        }
    }
}

fn property(parts: &[&str]) -> Option<Property> {
    match *parts {
        ["list", count, kind, name] => {
            let count = PlyKind::from_name(count).filter(|k| k.is_integer())?;
            Some(Property { name: name.into(), kind: PlyKind::from_name(kind)?, count: Some(count) })
        }
        [kind, name] => Some(Property { name: name.into(), kind: PlyKind::from_name(kind)?, count: None }),
        _ => None,
    }
}

impl Body<'_> {
    /// As many rows as announced can lie in what is left of the file, so that memory may be
    /// reserved for them.
    fn check_rows(&self, element: &PlyElement) -> Result<()> {
        let bytes = |p: &Property| match self.encoding {
            PlyEncoding::Ascii => 2, // a digit and a space
            PlyEncoding::Binary { .. } => p.count.unwrap_or(p.kind).bytes(),
        };
        let least: u64 = element.properties.iter().map(bytes).sum();
        let left = self.words.rest().len() as u64;
        // The last number of a text needs no space after it.
        if element.rows.checked_mul(least).is_none_or(|n| n > left + 1) {
            return Err(self.wrong(
                format!("{} rows of '{}'", element.rows, element.name),
                format!("{left} bytes, too few for them; the file is cut short or its header is wrong"),
            ));
        }
        Ok(())
    }

    fn number(&mut self, kind: PlyKind) -> Result<f64> {
        match self.encoding {
            PlyEncoding::Ascii => self.text_number(kind),
            PlyEncoding::Binary { big_endian } => self.binary_number(kind, big_endian),
        }
    }

    /// Parsed as its own type: a decimal is rounded once.
    fn text_number(&mut self, kind: PlyKind) -> Result<f64> {
        let what = "a number of the property's type";
        Ok(match kind {
            PlyKind::I8 => self.words.parse::<i8>(what)?.into(),
            PlyKind::U8 => self.words.parse::<u8>(what)?.into(),
            PlyKind::I16 => self.words.parse::<i16>(what)?.into(),
            PlyKind::U16 => self.words.parse::<u16>(what)?.into(),
            PlyKind::I32 => self.words.parse::<i32>(what)?.into(),
            PlyKind::U32 => self.words.parse::<u32>(what)?.into(),
            PlyKind::F32 => self.words.parse::<f32>(what)?.into(),
            PlyKind::F64 => self.words.parse::<f64>(what)?,
        })
    }

    fn binary_number(&mut self, kind: PlyKind, big_endian: bool) -> Result<f64> {
        let Some(stored) = self.words.take(kind.bytes()) else {
            return Err(self.wrong("a number".into(), "the end of the file".into()));
        };
        Ok(if big_endian { kind.read::<BE>(stored) } else { kind.read::<LE>(stored) })
    }

    /// The length of a list.
    fn list_len(&mut self, kind: PlyKind) -> Result<u64> {
        let n = self.number(kind)?;
        if n < 0.0 {
            return Err(self.wrong("the length of a list".into(), n.to_string()));
        }
        Ok(n as u64)
    }

    /// Reads a property and forgets it.
    fn skip(&mut self, property: &Property) -> Result<()> {
        let n = match property.count {
            None => 1,
            Some(count) => self.list_len(count)?,
        };
        (0..n).try_for_each(|_| self.number(property.kind).map(drop))
    }

    /// Nothing but white space follows the last row of a text, nothing but a line end that of a
    /// binary file.
    fn finish(&self) -> Result<()> {
        let rest = self.words.rest().trim_ascii();
        if rest.is_empty() {
            return Ok(());
        }
        Err(self
            .wrong("the end of the file after the last element".into(), format!("{} bytes more", rest.len())))
    }

    fn wrong(&self, expected: String, got: String) -> Error {
        let error = self.words.wrong(expected, got);
        match self.encoding {
            PlyEncoding::Binary { .. } => error.placed(Place::byte(self.words.at() as u64)),
            _ => error,
        }
    }
}

fn read_vertices(body: &mut Body<'_>, element: &PlyElement, out: &mut StoredSurface) -> Result<()> {
    let slot = |p: &Property| {
        let names = ["x", "y", "z", "nx", "ny", "nz"];
        names.iter().position(|n| *n == p.name).filter(|_| p.count.is_none())
    };
    let slots: Vec<Option<usize>> = element.properties.iter().map(slot).collect();
    if !(0..3).all(|c| slots.contains(&Some(c))) {
        return Err(body.wrong("vertices with the properties x, y, z".into(), "a header without them".into()));
    }
    for _ in 0..element.rows {
        let mut fields = [0f64; 6];
        for (property, slot) in element.properties.iter().zip(&slots) {
            match *slot {
                Some(slot) => fields[slot] = body.number(property.kind)?,
                None => body.skip(property)?,
            }
        }
        let [x, y, z, nx, ny, nz] = fields;
        if !is_finite(&[x, y, z].map(|c| c as f32)) {
            return Err(body.wrong("finite coordinates".into(), format!("{x} {y} {z}")));
        }
        out.push_double([x, y, z], [nx, ny, nz].map(|n| n as f32))?;
    }
    Ok(())
}

fn read_faces(body: &mut Body<'_>, element: &PlyElement, out: &mut StoredSurface) -> Result<()> {
    let is_polygon = |p: &Property| matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
    let polygon_at = element.properties.iter().position(is_polygon);
    let list = polygon_at
        .and_then(|i| element.properties[i].count)
        .filter(|_| element.properties[polygon_at.expect("the list was found")].kind.is_integer());
    let (Some(polygon_at), Some(count)) = (polygon_at, list) else {
        return Err(
            body.wrong("faces with an integer list 'vertex_indices'".into(), "a header without it".into())
        );
    };
    for _ in 0..element.rows {
        for (i, property) in element.properties.iter().enumerate() {
            if i == polygon_at {
                read_polygon(body, count, property.kind, out)?;
            } else {
                body.skip(property)?;
            }
        }
    }
    Ok(())
}

fn read_polygon(body: &mut Body<'_>, count: PlyKind, kind: PlyKind, out: &mut StoredSurface) -> Result<()> {
    let n = body.list_len(count)?;
    if n < 3 {
        return Err(body.wrong("a face of at least 3 vertices".into(), n.to_string()));
    }
    let mut fan = Fan::default();
    for _ in 0..n {
        let number = body.number(kind)?;
        if number < 0.0 {
            return Err(body.wrong("a vertex number".into(), number.to_string()));
        }
        fan.corner(number as u32).map_or(Ok(()), |triangle| out.push_triangle(triangle))?;
    }
    Ok(())
}

fn skip_rows(body: &mut Body<'_>, element: &PlyElement) -> Result<()> {
    if element.properties.is_empty() {
        return Ok(());
    }
    (0..element.rows).try_for_each(|_| element.properties.iter().try_for_each(|p| body.skip(p)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::surface::tests::{in_memory, source, tetrahedron};
    use crate::files::surface::{SurfaceFormat, write_surface};
    use crate::surface::TriMesh;
    use isospan_io::exec::Resources;
    use isospan_io::fixtures::survive;

    fn parse(bytes: &[u8]) -> Result<TriMesh> {
        in_memory(|out| read(Path::new("f.ply"), bytes, out))
    }

    fn written() -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.ply");
        let meta =
            SurfaceMeta { isovalue: Some(1.5), comments: vec!["é\nb".into()], ..SurfaceMeta::default() };
        write_surface(&source(tetrahedron()), &path, SurfaceFormat::Ply, &meta, &Resources::default())
            .unwrap();
        std::fs::read(path).unwrap()
    }

    #[test]
    fn the_header_is_what_others_read() {
        let bytes = written();
        let text = "ply\nformat binary_little_endian 1.0\ncomment isospan surface\ncomment isovalue 1.5\n\
            comment ?\ncomment b\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
            property float nx\nproperty float ny\nproperty float nz\nelement face 4\n\
            property list uchar int vertex_indices\nend_header\n";
        assert_eq!(&bytes[..text.len()], text.as_bytes());
        assert_eq!(bytes.len(), text.len() + 4 * 24 + 4 * 13);
        assert_eq!(parse(&bytes).unwrap(), tetrahedron());
        assert!(header(1 << 31, 0, "float", &SurfaceMeta::default()).contains("uchar int "));
        assert!(header((1 << 31) + 1, 0, "float", &SurfaceMeta::default()).contains("uchar uint "));
    }

    /// Extra properties of every type, lists among them, extra elements, polygons.
    const HEADER: &str = "element camera 2\nproperty list uchar short a\nproperty double b\n\
        element vertex 5\nproperty uchar red\nproperty double x\nproperty list int uint l\nproperty float y\n\
        property ushort u\nproperty short z\nelement nothing 99\nelement face 2\nproperty char c\n\
        property list uchar uint vertex_index\nproperty list short float w\nend_header\n";

    fn rich_ascii() -> String {
        format!(
            "ply\r\nformat ascii 1.0\r\nobj_info x\r\n{HEADER}2 -1 5 1.5\n0 2.5\n\
             1 0.5 0 0 9 0\n2 1 1 7 0 9 0\n3 1 0 1 9 0\n4 0 0 1 9 -3\n5 2 0 2 9 2\n\
             -1 5 0 1 2 3 4 1 0.5\n3 3 2 1 0 0\n"
        )
    }

    fn rich_binary(big_endian: bool) -> Vec<u8> {
        let name = if big_endian { "big" } else { "little" };
        let mut out = format!("ply\nformat binary_{name}_endian 1.0\n{HEADER}").into_bytes();
        let mut put = |mut b: Vec<u8>| {
            if big_endian {
                b.reverse();
            }
            out.extend(b);
        };
        let f = |v: f32| v.to_le_bytes().to_vec();
        let d = |v: f64| v.to_le_bytes().to_vec();
        let s = |v: i16| v.to_le_bytes().to_vec();
        let i = |v: i32| v.to_le_bytes().to_vec();
        let parts = [vec![2], s(-1), s(5), d(1.5), vec![0], d(2.5)];
        parts.into_iter().for_each(&mut put);
        let vertices = [(0.5, 0.0, 0), (1.0, 0.0, 0), (1.0, 1.0, 0), (0.0, 1.0, -3), (2.0, 2.0, 2)];
        for (n, (x, y, z)) in vertices.into_iter().enumerate() {
            let list = if n == 1 { vec![i(1), i(7)] } else { vec![i(0)] };
            let parts = [vec![vec![n as u8], d(x)], list, vec![f(y), s(9), s(z)]].concat();
            parts.into_iter().for_each(&mut put);
        }
        let parts = [vec![255], vec![5], i(0), i(1), i(2), i(3), i(4), s(1), f(0.5)];
        parts.into_iter().for_each(&mut put);
        let parts = [vec![3], vec![3], i(2), i(1), i(0), s(0)];
        parts.into_iter().for_each(&mut put);
        out
    }

    #[test]
    fn every_encoding_and_property() {
        let mesh = parse(rich_ascii().as_bytes()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4], [2, 1, 0]]);
        assert_eq!(mesh.vertices[3].position, [0.0, 1.0, -3.0]);
        assert_eq!(mesh.vertices[0].position, [0.5, 0.0, 0.0]);
        for big_endian in [false, true] {
            assert_eq!(parse(&rich_binary(big_endian)).unwrap(), mesh, "big endian: {big_endian}");
        }
    }

    #[test]
    fn malformed_files_are_refused() {
        let good = rich_ascii();
        for (from, to, says) in [
            ("ascii", "ebcdic", "format ascii"),
            ("1.0", "2.0", "PLY 1.0"),
            ("property double x", "property double xx", "x, y, z"),
            ("property double x", "property quad x", "a property"),
            ("element vertex 5", "element vertex 99999999999999999", "rows of 'vertex'"),
            ("element vertex 5", "element vertex -5", "the number of elements"),
            ("vertex_index", "vertices", "vertex_indices"),
            ("end_header", "end", "header line"),
            ("-1 5 0 1 2 3 4", "-1 5 0 1 2 3 5", "vertex numbers below 5"),
            ("-1 5 0 1 2 3 4", "-1 2 0 1", "at least 3"),
            ("1 0.5 0 0 9 0", "1 nan 0 0 9 0", "finite"),
            ("3 3 2 1 0 0\n", "3 3 2 1 0 0\n7", "1 bytes more"),
        ] {
            let bad = good.replace(from, to);
            assert_ne!(good, bad);
            let error = parse(bad.as_bytes()).unwrap_err();
            assert!(error.exit_code() == 5 && error.to_string().contains(says), "{says}: {error}");
        }
        let strips = b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n\
            property float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n3 0 1 2\n";
        assert!(parse(strips).unwrap_err().to_string().contains("strips"));
    }

    #[test]
    fn damage_does_not_panic() {
        for bytes in [written(), rich_ascii().into_bytes(), rich_binary(true)] {
            survive(&bytes, |b| drop(parse(b)));
        }
        let binary = rich_binary(false);
        let body = binary.len() - 100;
        assert!((body..binary.len()).all(|cut| parse(&binary[..cut]).is_err()), "a short body is an error");
    }
}
