//! VTP: VTK XML PolyData.
//!
//! We write one piece of triangles, its arrays appended raw, so that each is one run of bytes that
//! a reader may map. All lengths follow from the two counts, so the XML header is final before the
//! first vertex.
//!
//! ```text
//! <VTKFile type="PolyData" … byte_order="LittleEndian" header_type="UInt64">
//!   …  DataArray … format="appended" offset="N"     N counted from the byte after the '_'
//!   <AppendedData encoding="raw">
//!    _[u64 length][Points 3 × f32 a vertex]         (f64 where f32 does not tell them apart)
//!     [u64 length][Normals 3 × f32 a vertex]
//!     [u64 length][isovalue f32 a vertex]            (f64 where one has more digits; label i32) of several surfaces in one file only
//!     [u64 length][connectivity 3 × i64 a triangle]
//!     [u64 length][offsets i64 a triangle: 3, 6, 9, …]
//!   </AppendedData>
//! </VTKFile>
//! ```
//!
//! The isovalue is a field array `isovalue`. Several surfaces in one file have theirs as the active
//! scalars of the points instead, as VTK's contour filters do: ParaView colours by it, and its
//! Threshold filter picks one. Units and the time are field arrays, too.
//!
//! We read the polygons of all pieces, with the points (and the point data's active normals) of any
//! number type, in every encoding that VTK XML has. Vertices and lines are no surface
//! and are skipped; triangle strips are refused.

use super::ply::check_indices;
use super::{
    Fan, LENGTH_UNIT, SurfaceMeta, TIME_UNIT, TIME_VALUE, VALUE_UNIT, coordinate_bytes, each_triangle,
    each_value, each_vertex, is_finite, put_floats, put_place, take_unit,
};
use crate::surface::SurfaceSource;
use crate::surface::weld::StoredSurface;
use byteorder::{ByteOrder, LE};
use isospan_io::bytes::ByteSource;
use isospan_io::error::Result;
use isospan_io::formats::shared::sink::Sink;
use isospan_io::formats::shared::text::xml_attribute;
use isospan_io::formats::vtk::xml::array::{ArrayStream, first_text, scalar_type};
use isospan_io::formats::vtk::xml::head::{Document, Element};
use isospan_io::volume::ScalarType;
use isospan_io::volume::units::Unit;
use std::sync::Arc;

/// Writes a surface as VTP.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
) -> Result<()> {
    let (vertices, triangles) = (source.vertex_count(), source.triangle_count());
    // At most 2³² vertices and far fewer than 2⁵⁸ triangles: no product overflows.
    let scalars = if meta.parts.is_empty() { 0 } else { meta.part_scalar().bytes() as u64 * vertices };
    let of_values = meta.values.as_ref().map_or(0, |values| values.bytes() * vertices);
    let (coordinate, origin) = (coordinate_bytes(source), source.origin());
    let of_points = 3 * coordinate * vertices;
    let lengths = [of_points, 12 * vertices, scalars, of_values, 24 * triangles, 8 * triangles];
    let kind = if coordinate == 4 { "Float32" } else { "Float64" };
    sink.put(head(vertices, triangles, lengths, kind, meta).as_bytes())?;
    sink.put(&lengths[0].to_le_bytes())?;
    each_vertex(source, sink, |buffer, _, v| put_place(buffer, v, origin))?;
    sink.put(&lengths[1].to_le_bytes())?;
    each_vertex(source, sink, |buffer, _, v| put_floats(buffer, v.normal))?;
    if !meta.parts.is_empty() {
        let put_isovalue = meta.put_isovalue();
        sink.put(&lengths[2].to_le_bytes())?;
        each_vertex(source, sink, |buffer, v, _| put_isovalue(v, buffer))?;
    }
    if let Some(values) = &meta.values {
        sink.put(&lengths[3].to_le_bytes())?;
        each_value(source, sink, values, |buffer, v| values.put(v, buffer))?;
    }
    sink.put(&lengths[4].to_le_bytes())?;
    each_triangle(source, sink, |buffer, _, t| {
        t.iter().for_each(|&v| buffer.extend_from_slice(&u64::from(v).to_le_bytes()));
        Ok(())
    })?;
    sink.put(&lengths[5].to_le_bytes())?;
    each_triangle(source, sink, |buffer, n, _| {
        buffer.extend_from_slice(&(3 * (n + 1)).to_le_bytes());
        Ok(())
    })?;
    sink.put(b"\n  </AppendedData>\n</VTKFile>\n")
}

fn head(vertices: u64, triangles: u64, lengths: [u64; 6], coordinate: &str, meta: &SurfaceMeta) -> String {
    let several = !meta.parts.is_empty();
    let mut offset = 0;
    let mut place = |length: u64| {
        let at = offset;
        offset += 8 + length;
        at
    };
    let (points, normals) = (place(lengths[0]), place(lengths[1]));
    let scalars = if several { place(lengths[2]) } else { 0 };
    let values = meta.values.as_deref();
    let values_at = values.map_or(0, |_| place(lengths[3]));
    let (connectivity, offsets) = (place(lengths[4]), place(lengths[5]));
    let comment: String = meta.lines().iter().map(|line| format!("  {}\n", comment_text(line))).collect();
    let parts = match meta.part_scalar() {
        ScalarType::F32 => "Float32",
        ScalarType::I32 => "Int32",
        _ => "Float64",
    };
    let part_array = meta.part_array();
    [
        "<?xml version=\"1.0\"?>\n<!-- isospan surface\n".to_string(),
        comment,
        "-->\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n  <PolyData>\n"
            .to_string(),
        field_data(meta),
        format!(
            "    <Piece NumberOfPoints=\"{vertices}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" \
             NumberOfStrips=\"0\" NumberOfPolys=\"{triangles}\">\n"
        ),
        format!(
            "      <PointData{} Normals=\"Normals\">\n",
            match values {
                Some(values) => format!(" Scalars=\"{}\"", xml_attribute(values.name())),
                None if several => format!(" Scalars=\"{part_array}\""),
                None => String::new(),
            }
        ),
        array("Float32", "Normals", 3, normals),
        if several { array(parts, part_array, 1, scalars) } else { String::new() },
        values.map_or_else(String::new, |v| {
            let kind = if v.bytes() == 4 { "Float32" } else { "Float64" };
            array(kind, &xml_attribute(v.name()), 1, values_at)
        }),
        "      </PointData>\n      <Points>\n".to_string(),
        array(coordinate, "Points", 3, points),
        "      </Points>\n      <Polys>\n".to_string(),
        array("Int64", "connectivity", 1, connectivity),
        array("Int64", "offsets", 1, offsets),
        "      </Polys>\n    </Piece>\n  </PolyData>\n  <AppendedData encoding=\"raw\">\n   _".to_string(),
    ]
    .concat()
}

/// Arrays of the whole data set: the isovalue of one surface, the time and the units.
fn field_data(meta: &SurfaceMeta) -> String {
    let array = |kind: &str, name: &str, text: String| {
        format!(
            "      <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfTuples=\"1\" \
             format=\"ascii\">{text}</DataArray>\n"
        )
    };
    let numbers = [("isovalue", meta.isovalue), (TIME_VALUE, meta.time)];
    let numbers = numbers.into_iter().filter_map(|(name, n)| Some(array("Float64", name, n?.to_string())));
    // The bytes of a text, and the 0 that ends it.
    let bytes = |unit: &Unit| -> String { unit.as_str().bytes().map(|b| format!("{b} ")).collect() };
    let units = meta.named_units().map(|(name, unit)| array("String", name, bytes(unit) + "0"));
    let arrays: String = numbers.chain(units).collect();
    if arrays.is_empty() { arrays } else { format!("    <FieldData>\n{arrays}    </FieldData>\n") }
}

/// An array whose numbers are appended.
fn array(kind: &str, name: &str, components: u32, offset: u64) -> String {
    format!(
        "        <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
         format=\"appended\" offset=\"{offset}\"/>\n"
    )
}

/// "--" may not stand in an XML comment.
fn comment_text(line: &str) -> String {
    line.replace("--", "- -").replace("--", "- -")
}

/// Reads a VTP surface. No more than a batch of each array is in memory.
pub(in crate::files) fn read(source: &Arc<ByteSource>, out: &mut StoredSurface) -> Result<()> {
    let doc = Document::open(source, "PolyData")?;
    read_field_data(&doc, out)?;
    for piece in doc.data.all("Piece") {
        if doc.count(piece, "NumberOfStrips", 0)? > 0 {
            let error = doc.wrong(piece, "polygons", "triangle strips");
            return Err(error.with_help("convert strips to triangles first"));
        }
        let first = out.vertex_count();
        read_points(&doc, piece, out)?;
        read_polygons(&doc, piece, first, out)?;
    }
    check_indices(source.path(), out)
}

/// Units and the time.
fn read_field_data(doc: &Document, out: &mut StoredSurface) -> Result<()> {
    let arrays = doc.data.child("FieldData").into_iter().flat_map(|data| data.children.iter());
    for array in arrays {
        match array.attribute("Name").unwrap_or_default() {
            TIME_VALUE if array.name == "DataArray" => {
                out.time = Some(ArrayNumbers::floats(doc, array, 1, 1)?.next_number()?);
            }
            name @ (LENGTH_UNIT | VALUE_UNIT | TIME_UNIT) if array.attribute("type") == Some("String") => {
                take_unit(out, name, &first_text(doc, array)?);
            }
            _ => {}
        }
    }
    Ok(())
}

fn read_points(doc: &Document, piece: &Element, out: &mut StoredSurface) -> Result<()> {
    let count = doc.count(piece, "NumberOfPoints", 0)?;
    let points = piece.child("Points").and_then(|p| p.child("DataArray"));
    let points = match points {
        Some(points) => points,
        None if count == 0 => return Ok(()),
        None => return Err(doc.wrong(piece, "an array in Points", "none")),
    };
    let mut points = ArrayNumbers::floats(doc, points, 3, count)?;
    let mut normals = normals(piece).map(|n| ArrayNumbers::floats(doc, n, 3, count)).transpose()?;
    for n in 0..count {
        let position = points.next_point()?;
        if !is_finite(&position.map(|x| x as f32)) {
            let got = format!("{position:?} for point {n}");
            return Err(doc.wrong(piece, "finite coordinates", got));
        }
        let normal = normals.as_mut().map_or(Ok([0.0; 3]), ArrayNumbers::next_point)?;
        out.push_double(position, normal.map(|x| x as f32))?;
    }
    points.finish()?;
    normals.map_or(Ok(()), ArrayNumbers::finish)
}

/// The point data's active normals.
fn normals(piece: &Element) -> Option<&Element> {
    let data = piece.child("PointData")?;
    let name = data.attribute("Normals")?;
    data.all("DataArray").find(|a| a.attribute("Name") == Some(name))
}

fn read_polygons(doc: &Document, piece: &Element, first: u64, out: &mut StoredSurface) -> Result<()> {
    let count = doc.count(piece, "NumberOfPolys", 0)?;
    if count == 0 {
        return Ok(());
    }
    let polys = piece.child("Polys").ok_or_else(|| doc.wrong(piece, "an element Polys", "none"))?;
    let named = |name: &str| {
        let found = polys.all("DataArray").find(|a| a.attribute("Name") == Some(name));
        found.ok_or_else(|| doc.wrong(polys, format!("an array '{name}'"), "none"))
    };
    // The last offset is the number of corners, so the offsets are read twice.
    let mut offsets = ArrayNumbers::integers(doc, named("offsets")?, count)?;
    let all = (0..count).try_fold(0, |_, _| offsets.next_integer())?;
    offsets.finish()?;
    let mut offsets = ArrayNumbers::integers(doc, named("offsets")?, count)?;
    let mut corners = ArrayNumbers::integers(doc, named("connectivity")?, all)?;
    let (vertices, mut start) = (out.vertex_count() - first, 0);
    for _ in 0..count {
        let end = offsets.next_integer()?;
        let wrong = |what: String| doc.wrong(polys, "polygons of at least 3 existing points", what);
        if end < start || end - start < 3 || end > all {
            return Err(wrong(format!("one from corner {start} to {end}")));
        }
        let mut fan = Fan::default();
        for _ in start..end {
            let v = corners.next_integer()?;
            let number = Some(v).filter(|&v| v < vertices).and_then(|v| u32::try_from(v + first).ok());
            let number = number.ok_or_else(|| wrong(format!("point {v} of {vertices}")))?;
            fan.corner(number).map_or(Ok(()), |triangle| out.push_triangle(triangle))?;
        }
        start = end;
    }
    offsets.finish()?;
    corners.finish()
}

/// The numbers of an array, one after the other; a batch is in memory.
struct ArrayNumbers<'a> {
    doc: &'a Document,
    array: &'a Element,
    scalar: ScalarType,
    stream: ArrayStream,
    /// Bytes of the array that are not in `batch` yet.
    left: u64,
    batch: Vec<u8>,
    at: usize,
}

/// Bytes of a batch: a multiple of every number's size.
const BATCH: u64 = 1 << 16;

impl<'a> ArrayNumbers<'a> {
    fn open(doc: &'a Document, array: &'a Element, components: u64, tuples: u64) -> Result<Self> {
        let found = doc.count(array, "NumberOfComponents", 1)?;
        if found != components {
            return Err(doc.wrong(array, format!("{components} components"), found.to_string()));
        }
        let scalar = array.attribute("type").and_then(scalar_type);
        let scalar = scalar.ok_or_else(|| doc.wrong(array, "an array of numbers", "another type"))?;
        let bytes = tuples.checked_mul(components * scalar.bytes() as u64);
        let left =
            bytes.ok_or_else(|| doc.wrong(array, "fewer than 2^64 bytes", format!("{tuples} tuples")))?;
        let stream = ArrayStream::open(doc, array, scalar, left)?;
        Ok(Self { doc, array, scalar, stream, left, batch: vec![], at: 0 })
    }

    fn floats(doc: &'a Document, array: &'a Element, components: u64, tuples: u64) -> Result<Self> {
        let numbers = Self::open(doc, array, components, tuples)?;
        match numbers.scalar {
            ScalarType::F32 | ScalarType::F64 => Ok(numbers),
            other => Err(doc.wrong(array, "type Float32 or Float64", other.name())),
        }
    }

    fn integers(doc: &'a Document, array: &'a Element, tuples: u64) -> Result<Self> {
        let numbers = Self::open(doc, array, 1, tuples)?;
        match numbers.scalar {
            ScalarType::F32 | ScalarType::F64 => Err(doc.wrong(array, "integers", numbers.scalar.name())),
            _ => Ok(numbers),
        }
    }

    /// The bytes of the next number; to be asked for as often as there are numbers.
    fn next(&mut self) -> Result<&[u8]> {
        if self.at == self.batch.len() {
            self.batch.resize(self.left.min(BATCH) as usize, 0);
            self.stream.fill(&mut self.batch)?;
            (self.left, self.at) = (self.left - self.batch.len() as u64, 0);
        }
        let start = self.at;
        self.at += self.scalar.bytes();
        Ok(&self.batch[start..self.at])
    }

    /// The next three floating-point numbers.
    fn next_point(&mut self) -> Result<[f64; 3]> {
        let mut point = [0.0; 3];
        for c in &mut point {
            *c = self.next_number()?;
        }
        Ok(point)
    }

    /// The next floating-point number.
    fn next_number(&mut self) -> Result<f64> {
        let stored = self.next()?;
        Ok(if stored.len() == 4 { LE::read_f32(stored).into() } else { LE::read_f64(stored) })
    }

    /// The next integer, not negative.
    fn next_integer(&mut self) -> Result<u64> {
        let signed =
            matches!(self.scalar, ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64);
        let value = self.next()?;
        if signed && value[value.len() - 1] & 0x80 != 0 {
            return Err(self.doc.wrong(self.array, "no negative numbers", "one"));
        }
        Ok(LE::read_uint(value, value.len()))
    }

    /// Must be called after the last number.
    fn finish(mut self) -> Result<()> {
        self.stream.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::surface::tests::{in_memory, source, tetrahedron};
    use crate::files::surface::{SurfaceFormat, write_surface};
    use crate::surface::TriMesh;
    use isospan_io::exec::Resources;
    use isospan_io::fixtures::{Encoding, every_encoding, survive};

    fn parse(bytes: &[u8]) -> Result<TriMesh> {
        in_memory(|out| read(&Arc::new(ByteSource::from_vec("f.vtp", bytes.to_vec())), out))
    }

    fn written() -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.vtp");
        let meta =
            SurfaceMeta {
                isovalue: Some(-1.5), comments: vec!["a--->b<é".into()], ..SurfaceMeta::default()
            };
        write_surface(&source(tetrahedron()), &path, SurfaceFormat::Vtp, &meta, &Resources::default())
            .unwrap();
        std::fs::read(path).unwrap()
    }

    #[test]
    fn what_we_write_is_found_where_its_offsets_say() {
        let bytes = written();
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("  isovalue -1.5\n  a- - ->b<é\n") && text.contains(">-1.5</DataArray>"));
        let start = bytes.windows(2).position(|w| w == b"_\x30").unwrap() + 1;
        assert_eq!(bytes[start..start + 8], 48u64.to_le_bytes());
        assert_eq!(bytes[start + 8..start + 12], 0.1f32.to_le_bytes());
        assert_eq!(bytes[start + 2 * 56..start + 2 * 56 + 8], 96u64.to_le_bytes());
        assert_eq!(parse(&bytes).unwrap(), tetrahedron());
    }

    /// A square and a triangle in two pieces.
    fn two_pieces(encoding: Encoding) -> Vec<u8> {
        let mut file = encoding.file("PolyData", "");
        for (points, corners, offsets) in [
            (
                &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.5][..],
                &[0, 1, 2, 3][..],
                &[4u16][..],
            ),
            (&[5.0, 0.0, 0.0, 6.0, 0.0, 0.0, 6.0, 1.0, 0.25], &[2, 0, 1], &[3]),
        ] {
            let (n, polys) = (points.len() / 3, offsets.len());
            file.text(&format!("<Piece NumberOfPoints=\"{n}\" NumberOfPolys=\"{polys}\"><Points>"));
            file.array("p", 3, points);
            file.text("</Points><Polys>");
            file.array("connectivity", 1, corners);
            file.array("offsets", 1, offsets);
            file.text("</Polys></Piece>");
        }
        file.finish()
    }

    #[test]
    fn every_encoding_is_read() {
        for encoding in every_encoding() {
            let mesh = parse(&two_pieces(encoding)).unwrap();
            assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [6, 4, 5]], "{encoding:?}");
            assert_eq!(mesh.vertices[6].position, [6.0, 1.0, 0.25]);
        }
    }

    #[test]
    fn malformed_files_are_refused() {
        let encoding = every_encoding().into_iter().next().unwrap();
        let good = String::from_utf8(two_pieces(encoding)).unwrap();
        for (from, to, says) in [
            ("NumberOfPoints=\"4\"", "NumberOfPoints=\"5\"", "too short"),
            ("NumberOfPoints=\"4\"", "NumberOfPoints=\"99999999999\"", "too short"),
            ("NumberOfPoints=\"4\"", "NumberOfPoints=\"x\"", "1 numbers in NumberOfPoints"),
            ("NumberOfPoints=\"4\"", "NumberOfStrips=\"1\"", "strips"),
            ("type=\"PolyData\"", "type=\"ImageData\"", "an image (.vti)"),
            ("Name=\"offsets\"", "Name=\"offset\"", "'offsets'"),
            ("0 1 2 3", "0 1 2 4", "point 4 of 4"),
            ("0 1 2 3", "0 1 2 -1", "negative"),
            ("type=\"Int32\"", "type=\"Float32\"", "integers"),
        ] {
            let bad = good.replacen(from, to, 1);
            assert_ne!(good, bad, "{from}");
            let error = parse(bad.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }

    #[test]
    fn damage_does_not_panic() {
        survive(&written(), |b| drop(parse(b)));
    }
}
