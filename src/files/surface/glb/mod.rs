//! GLB: glTF 2.0 in one binary file (Khronos Group, ISO/IEC 12113).
//!
//! ```text
//! 0    "glTF", u32 version 2, u32 bytes of the file
//! 12   u32 length, "JSON", a JSON text padded with spaces to a multiple of 4
//!      u32 length, "BIN\0":
//!        positions  3 × f32 a vertex
//!        normals    3 × f32 a vertex
//!        indices    3 × u32 a triangle
//! ```
//!
//! We write one mesh of one primitive (triangles); everything is little-endian and a multiple of 4
//! bytes. The JSON text names the three runs of bytes. It also has the least and the largest
//! position, as the format demands: this takes one more pass over the vertices before the first
//! byte is written. The isovalue and the comments are `asset.extras`. Coordinates are the world's,
//! as in all our formats, though glTF says metres and y up. A surface without triangles is a scene
//! without a mesh, as glTF has no empty arrays. A surface that is far from 0 has its origin as the
//! translation of its node.
//!
//! All lengths are 32 bits wide, so a file ends at 4 GiB: about 89 million vertices with twice as
//! many triangles. Larger surfaces are refused before a byte is written. One primitive always
//! suffices: 2^32 indices alone are 16 GiB.
//!
//! We read the triangles of all meshes, as stored, in place: only the tree of the JSON text,
//! usually a few KiB, is in memory. The translation of a node without a parent or children counts.
//! Files whose true shape needs more than this are refused: other node transforms, sparse
//! accessors, data in other files, required extensions (compression), strips and fans. Primitives
//! that are points or lines are skipped.

use super::ply::check_indices;
use super::values::linear;
use super::{ReadLimits, SurfaceMeta, each_triangle, each_value, each_vertex, is_finite, put_floats};
use crate::surface::weld::StoredSurface;
use crate::surface::{SurfaceSource, world_of};
use byteorder::{ByteOrder, LE};
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::sink::Sink;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::Path;

const MAGIC: &[u8; 4] = b"glTF";
const JSON: u32 = u32::from_le_bytes(*b"JSON");
const BIN: u32 = u32::from_le_bytes(*b"BIN\0");
/// Bytes of the file's head, and of a chunk's.
const HEAD: u64 = 12;
const CHUNK_HEAD: u64 = 8;
/// Bytes for the JSON text when the limits are checked; the text is far shorter, except with long
/// comments.
const JSON_ROOM: u64 = 1 << 20;
/// Bytes for what the text says of a label, but for its name.
const TEXT_OF_LABEL: u64 = 1024;
/// Bytes of memory that the tree of a JSON text takes for each of its bytes, at most: a map of one
/// item takes 632 and is written with five.
const TREE_PER_BYTE: u64 = 130;
/// Numbers of the format.
pub(super) const FLOAT: u64 = 5126;
const UNSIGNED_SHORT: u64 = 5123;
pub(super) const UNSIGNED_INT: u64 = 5125;
pub(super) const TRIANGLES: u64 = 4;
pub(super) const ARRAY_BUFFER: u64 = 34962;
pub(super) const ELEMENT_ARRAY_BUFFER: u64 = 34963;

/// Whether a file begins like a GLB.
pub(in crate::files) fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// Bytes of a vertex: position, normal and, where it has a value, that and the colour.
fn vertex_bytes(meta: &SurfaceMeta) -> u64 {
    if meta.values.is_some() { 36 } else { 24 }
}

/// Lengths are 32 bits wide.
pub(in crate::files) fn check_limits(vertices: u64, triangles: u64, meta: &SurfaceMeta) -> Result<()> {
    let labels = if meta.are_labels() { TEXT_OF_LABEL * meta.parts.len() as u64 } else { 0 };
    let bytes = u128::from(vertex_bytes(meta)) * u128::from(vertices)
        + 12 * u128::from(triangles)
        + u128::from(labels);
    if bytes > u128::from(u64::from(u32::MAX) - JSON_ROOM) {
        return Err(Error::usage(format!(
            "a GLB file holds at most 4 GiB, this surface of {vertices} vertices and {triangles} triangles takes {bytes} \
             bytes; write PLY or VTP instead, or decimate it"
        )));
    }
    Ok(())
}

/// Writes a surface as GLB.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
) -> Result<()> {
    let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    each_vertex(source, sink, |_, _, v| {
        for (k, x) in v.position.into_iter().enumerate() {
            (bounds[0][k], bounds[1][k]) = (bounds[0][k].min(x), bounds[1][k].max(x));
        }
    })?;
    let bin = if source.triangle_count() == 0 {
        0
    } else {
        vertex_bytes(meta) * source.vertex_count() + 12 * source.triangle_count()
    };
    let mut document = document(source.vertex_count(), source.triangle_count(), bounds, meta);
    if bin > 0 && source.origin() != [0.0; 3] {
        document["nodes"][0]["translation"] = json!(source.origin());
    }
    let mut text = document.to_string();
    if text.len() as u64 > JSON_ROOM - 64 {
        return Err(Error::usage("the comments of a GLB file hold at most 1 MiB: give shorter ones"));
    }
    text.extend(std::iter::repeat_n(' ', text.len().next_multiple_of(4) - text.len()));
    put_head(sink, &text, bin)?;
    if bin == 0 {
        return Ok(());
    }
    each_vertex(source, sink, |buffer, _, v| put_floats(buffer, v.position))?;
    each_vertex(source, sink, |buffer, _, v| put_floats(buffer, v.normal))?;
    if let Some(values) = &meta.values {
        each_value(source, sink, values, |buffer, value| {
            let [r, g, b] = values.colour(value).map(linear);
            [r, g, b, u16::MAX].iter().for_each(|c| buffer.extend_from_slice(&c.to_le_bytes()));
        })?;
        // No number of a file may be NaN.
        each_value(source, sink, values, |buffer, value| {
            let value = if value.is_finite() { values.whole(value) as f32 } else { 0.0 };
            buffer.extend_from_slice(&value.to_le_bytes());
        })?;
    }
    each_triangle(source, sink, |buffer, _, t| {
        t.iter().for_each(|v| buffer.extend_from_slice(&v.to_le_bytes()));
        Ok(())
    })
}

/// Bytes of a file with a JSON text, padded, and so many bytes of arrays.
pub(super) fn file_bytes(text: &str, bin: u64) -> u64 {
    HEAD + CHUNK_HEAD + text.len() as u64 + if bin == 0 { 0 } else { CHUNK_HEAD + bin }
}

/// Writes all that comes before the arrays.
pub(super) fn put_head(sink: &mut Sink<'_>, text: &str, bin: u64) -> Result<()> {
    let put = |sink: &mut Sink<'_>, n: u64| {
        sink.put(&u32::try_from(n).expect("limits were checked before").to_le_bytes())
    };
    sink.put(MAGIC)?;
    put(sink, 2)?;
    put(sink, file_bytes(text, bin))?;
    put(sink, text.len() as u64)?;
    put(sink, u64::from(JSON))?;
    sink.put(text.as_bytes())?;
    if bin == 0 {
        return Ok(());
    }
    put(sink, bin)?;
    put(sink, u64::from(BIN))
}

/// The JSON text. Bounds are written so that they are exact also for a reader that uses `f64`.
fn document(vertices: u64, triangles: u64, bounds: [[f32; 3]; 2], meta: &SurfaceMeta) -> Value {
    let asset = json!({
        "version": "2.0",
        "generator": concat!("isospan ", env!("CARGO_PKG_VERSION")),
        "extras": { "isovalue": meta.isovalue, "comments": meta.lines() },
    });
    if triangles == 0 {
        return json!({ "asset": asset, "scene": 0, "scenes": [{}] });
    }
    // A zero has no sign: which of two zeros is the lesser one differs from machine to machine.
    let [lo, hi] = bounds.map(|b| b.map(|x| f64::from(x) + 0.0));
    let view = |offset: u64, length: u64, target: u64| json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": target });
    let mut attributes = json!({ "POSITION": 0, "NORMAL": 1 });
    let mut accessors = vec![
        json!({ "bufferView": 0, "componentType": FLOAT, "count": vertices, "type": "VEC3", "min": lo, "max": hi }),
        json!({ "bufferView": 1, "componentType": FLOAT, "count": vertices, "type": "VEC3" }),
    ];
    let mut views =
        vec![view(0, 12 * vertices, ARRAY_BUFFER), view(12 * vertices, 12 * vertices, ARRAY_BUFFER)];
    if let Some(values) = &meta.values {
        attributes["COLOR_0"] = json!(2);
        // Attributes of our own begin with an underscore.
        attributes[format!("_{}", values.plain_name().to_ascii_uppercase())] = json!(3);
        accessors.push(json!({
            "bufferView": 2, "componentType": UNSIGNED_SHORT, "normalized": true, "count": vertices, "type": "VEC4"
        }));
        accessors
            .push(json!({ "bufferView": 3, "componentType": FLOAT, "count": vertices, "type": "SCALAR" }));
        views.push(view(24 * vertices, 8 * vertices, ARRAY_BUFFER));
        views.push(view(32 * vertices, 4 * vertices, ARRAY_BUFFER));
    }
    let of_vertices = vertex_bytes(meta) * vertices;
    let indices = accessors.len();
    accessors.push(json!({
        "bufferView": indices, "componentType": UNSIGNED_INT, "count": 3 * triangles, "type": "SCALAR"
    }));
    views.push(view(of_vertices, 12 * triangles, ELEMENT_ARRAY_BUFFER));
    json!({
        "asset": asset,
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "mode": TRIANGLES }] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": of_vertices + 12 * triangles }],
    })
}

/// Reads the triangles of a GLB.
pub(in crate::files) fn read(
    path: &Path,
    bytes: &[u8],
    limits: &ReadLimits,
    out: &mut StoredSurface,
) -> Result<()> {
    let file = File::parse(path, bytes, limits)?;
    file.refuse_what_changes_the_shape()?;
    let places = file.places()?;
    for (m, one) in list(&file.json, "meshes").iter().enumerate() {
        for (p, primitive) in list(one, "primitives").iter().enumerate() {
            let place = places.get(&m).copied().unwrap_or_default();
            file.add_primitive(primitive, &format!("mesh {m}, primitive {p}"), place, out)?;
        }
    }
    check_indices(path, out)
}

/// A member that is a list; empty without it.
fn list<'a>(value: &'a Value, name: &str) -> &'a [Value] {
    value.get(name).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

struct File<'a> {
    path: &'a Path,
    json: Value,
    bin: &'a [u8],
}

/// The elements of an accessor: each `size` bytes long, `stride` bytes apart.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
}

impl<'a> Elements<'a> {
    fn bytes(&self, i: usize) -> &'a [u8] {
        &self.bytes[i * self.stride..][..self.size]
    }

    fn unsigned(&self, i: usize) -> u64 {
        self.bytes(i).iter().rev().fold(0, |n, &byte| n << 8 | u64::from(byte))
    }

    fn vector(&self, i: usize) -> [f32; 3] {
        let mut vector = [0.0; 3];
        LE::read_f32_into(&self.bytes(i)[..12], &mut vector);
        vector
    }
}

impl<'a> File<'a> {
    fn parse(path: &'a Path, bytes: &'a [u8], limits: &ReadLimits) -> Result<Self> {
        let bad = |at: &str, expected: &str, got: String| Err(Error::bad_input(path, at, expected, got));
        let word = |at: usize| bytes.get(at..at + 4).map(LE::read_u32);
        if word(4) != Some(2) {
            return bad("version", "2", word(4).map_or("the end".into(), |v| v.to_string()));
        }
        let mut chunks = [None; 2];
        let mut at = HEAD as usize;
        while let (Some(length), Some(kind)) = (word(at), word(at + 4)) {
            let start = at + CHUNK_HEAD as usize;
            let Some(data) = start.checked_add(length as usize).and_then(|end| bytes.get(start..end)) else {
                let got = format!("{} left", bytes.len() - start);
                return bad("chunks", &format!("{length} bytes from byte {start}"), got);
            };
            match kind {
                JSON if chunks[0].is_none() => chunks[0] = Some(data),
                BIN if chunks[1].is_none() => chunks[1] = Some(data),
                _ => {}
            }
            at = start + length as usize;
        }
        let Some(text) = chunks[0] else { return bad("chunks", "one of JSON", "none".into()) };
        limits.check("for the JSON text of a GLB file", TREE_PER_BYTE * text.len() as u64)?;
        match serde_json::from_slice(text) {
            Ok(json) => Ok(Self { path, json, bin: chunks[1].unwrap_or_default() }),
            Err(e) => bad("JSON chunk", "a JSON text", e.to_string()),
        }
    }

    fn wrong(&self, at: impl Into<String>, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(self.path, at.into(), expected.into(), got.into())
    }

    fn refuse_what_changes_the_shape(&self) -> Result<()> {
        let required = list(&self.json, "extensionsRequired");
        if !required.is_empty() {
            let got = Value::from(required).to_string();
            return Err(self
                .wrong("extensionsRequired", "none", got)
                .with_help("save the file without compression and other extensions"));
        }
        let moved = |n: &Value| ["matrix", "rotation", "scale"].iter().any(|t| n.get(t).is_some());
        match list(&self.json, "nodes").iter().position(moved) {
            Some(n) => Err(self.transformed(n)),
            None => Ok(()),
        }
    }

    fn transformed(&self, node: usize) -> Error {
        self.wrong(format!("node {node}"), "a mesh in its own coordinates", "a transform")
            .with_help("apply the transforms first")
    }

    /// What is added to the positions of each mesh: the translation of its node, where that has
    /// neither a parent nor children, and is alone with the mesh.
    fn places(&self) -> Result<HashMap<usize, [f64; 3]>> {
        let nodes = list(&self.json, "nodes");
        let number = |value: &Value| value.as_u64().and_then(|n| usize::try_from(n).ok());
        let children = || nodes.iter().flat_map(|node| list(node, "children")).filter_map(number);
        let mesh_of = |node: &Value| node.get("mesh").and_then(number);
        let mut places = HashMap::new();
        for (n, node) in nodes.iter().enumerate().filter(|(_, node)| node.get("translation").is_some()) {
            if mesh_of(node).is_none() && list(node, "children").is_empty() {
                // A camera, or a light.
                continue;
            }
            let numbers: Option<Vec<f64>> = list(node, "translation").iter().map(Value::as_f64).collect();
            let place = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
            let (Some(place), Some(mesh)) = (place, mesh_of(node)) else { return Err(self.transformed(n)) };
            let is_alone = list(node, "children").is_empty()
                && !children().any(|child| child == n)
                && nodes.iter().filter(|other| mesh_of(other) == Some(mesh)).count() == 1;
            if !is_alone {
                return Err(self.transformed(n));
            }
            places.insert(mesh, place);
        }
        Ok(places)
    }

    /// An unsigned member, or `default` without it.
    fn number(&self, of: &Value, name: &str, default: Option<u64>) -> Result<usize> {
        let value = of.get(name);
        let number = value.map_or(default, Value::as_u64).and_then(|n| usize::try_from(n).ok());
        number.ok_or_else(|| {
            let got = value.map_or("none".into(), Value::to_string);
            self.wrong(name, "a number that is not negative", got)
        })
    }

    /// Item `number` of a list of the document.
    fn item(&self, name: &str, number: usize) -> Result<&Value> {
        let items = list(&self.json, name);
        items
            .get(number)
            .ok_or_else(|| self.wrong(name, format!("one of number {number}"), items.len().to_string()))
    }

    fn elements(
        &self,
        accessor: usize,
        kind: &str,
        size_of: impl Fn(usize) -> Option<usize>,
    ) -> Result<Elements<'a>> {
        let about = self.item("accessors", accessor)?;
        let at = format!("accessor {accessor}");
        let found = about.get("type").and_then(Value::as_str).unwrap_or("none");
        let component = self.number(about, "componentType", None)?;
        let size = size_of(component).filter(|_| found == kind && about.get("sparse").is_none());
        let Some(size) = size else {
            let got = format!("{found} of component type {component}, or sparse");
            return Err(self.wrong(at, format!("{kind} of a plain type"), got));
        };
        let view = self.item("bufferViews", self.number(about, "bufferView", None)?)?;
        let buffer = self.number(view, "buffer", None)?;
        if buffer != 0 || self.item("buffers", 0)?.get("uri").is_some() {
            return Err(self.wrong(at, "data in this file", "data elsewhere"));
        }
        let (start, length) =
            (self.number(view, "byteOffset", Some(0))?, self.number(view, "byteLength", None)?);
        let stride = self.number(view, "byteStride", Some(size as u64))?;
        let (skip, count) = (self.number(about, "byteOffset", Some(0))?, self.number(about, "count", None)?);
        let needed = count.checked_sub(1).map_or(Some(0), |n| n.checked_mul(stride)?.checked_add(size));
        let bytes = start.checked_add(length).and_then(|end| self.bin.get(start..end)?.get(skip..));
        match (bytes, needed) {
            (Some(bytes), Some(needed)) if stride >= size && needed <= bytes.len() => {
                Ok(Elements { bytes, stride, size, count })
            }
            _ => {
                let got = format!("{count} elements beyond the end of {} bytes", self.bin.len());
                Err(self.wrong(at, "elements inside the file", got))
            }
        }
    }

    /// Three floats an element.
    fn vectors(&self, accessor: usize) -> Result<Elements<'a>> {
        self.elements(accessor, "VEC3", |c| (c as u64 == FLOAT).then_some(12))
    }

    fn add_primitive(
        &self,
        primitive: &Value,
        at: &str,
        place: [f64; 3],
        out: &mut StoredSurface,
    ) -> Result<()> {
        match self.number(primitive, "mode", Some(TRIANGLES))? as u64 {
            TRIANGLES => {}
            0..TRIANGLES => return Ok(()),
            other => return Err(self.wrong(at, "triangles (mode 4)", format!("mode {other}"))),
        }
        let first = out.vertex_count();
        let count = self.add_vertices(primitive, at, place, out)?;
        let indices = match primitive.get("indices") {
            Some(_) => Some(self.indices(self.number(primitive, "indices", None)?)?),
            None => None,
        };
        let corners = indices.as_ref().map_or(count, |i| i.count);
        if !corners.is_multiple_of(3) {
            return Err(self.wrong(at, "three corners a triangle", format!("{corners} corners")));
        }
        for t in 0..corners / 3 {
            let triangle =
                [0, 1, 2].map(|k| indices.as_ref().map_or((3 * t + k) as u64, |i| i.unsigned(3 * t + k)));
            let global = triangle.map(|v| u32::try_from(first + v).ok().filter(|_| v < count as u64));
            let [Some(a), Some(b), Some(c)] = global else {
                return Err(self.wrong(at, format!("vertex numbers below {count}"), format!("{triangle:?}")));
            };
            out.push_triangle([a, b, c])?;
        }
        Ok(())
    }

    /// Adds the vertices of a primitive, and returns their number.
    fn add_vertices(
        &self,
        primitive: &Value,
        at: &str,
        place: [f64; 3],
        out: &mut StoredSurface,
    ) -> Result<usize> {
        let none = Value::Null;
        let attributes = primitive.get("attributes").unwrap_or(&none);
        let positions = self.vectors(self.number(attributes, "POSITION", None)?)?;
        let normals = match attributes.get("NORMAL") {
            Some(_) => Some(self.vectors(self.number(attributes, "NORMAL", None)?)?),
            None => None,
        };
        if let Some(other) = normals.as_ref().map(|n| n.count).filter(|&n| n != positions.count) {
            return Err(self.wrong(at, format!("{} normals", positions.count), other.to_string()));
        }
        for n in 0..positions.count {
            let position = world_of(positions.vector(n), place);
            if !is_finite(&position.map(|x| x as f32)) {
                return Err(self.wrong(at, "finite positions", format!("{position:?} for vertex {n}")));
            }
            let normal = normals.as_ref().map_or([0.0; 3], |normals| normals.vector(n));
            out.push_double(position, normal)?;
        }
        Ok(positions.count)
    }

    fn indices(&self, accessor: usize) -> Result<Elements<'a>> {
        self.elements(accessor, "SCALAR", |component| match component {
            5121 => Some(1),
            5123 => Some(2),
            5125 => Some(4),
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::surface::tests::{source, tetrahedron};
    use crate::files::surface::{SurfaceFormat, write_surface};
    use crate::surface::TriMesh;
    use crate::surface::check::CheckSettings;
    use crate::surface::weld::BuilderSettings;
    use isospan_io::fixtures::survive;

    fn read(path: &Path, bytes: &[u8]) -> Result<TriMesh> {
        let mut out = StoredSurface::new(&BuilderSettings::default());
        super::read(path, bytes, &ReadLimits::of(&CheckSettings::default()), &mut out)?;
        TriMesh::from_source(&out)
    }

    fn written(mesh: TriMesh) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.glb");
        let meta = SurfaceMeta {
            isovalue: Some(-1.5),
            comments: vec!["of a \"b\"".into()],
            parts: vec![],
            values: None,
        };
        write_surface(&source(mesh), &path, SurfaceFormat::Glb, &meta).unwrap();
        std::fs::read(path).unwrap()
    }

    fn json_of(bytes: &[u8]) -> Value {
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        serde_json::from_slice(&bytes[20..20 + length]).unwrap()
    }

    /// A GLB of a JSON text and data.
    fn glb(text: &str, bin: &[u8]) -> Vec<u8> {
        let mut out = [&b"glTF\x02\0\0\0\0\0\0\0"[..], &(text.len() as u32).to_le_bytes(), b"JSON"].concat();
        out.extend(text.as_bytes());
        out.extend((bin.len() as u32).to_le_bytes());
        out.extend(b"BIN\0");
        out.extend(bin);
        out
    }

    #[test]
    fn lengths_offsets_and_bounds_are_those_of_the_data() {
        let mesh = tetrahedron();
        let bytes = written(mesh.clone());
        assert_eq!(u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize, bytes.len());
        assert_eq!(bytes.len() % 4, 0);
        let json = json_of(&bytes);
        assert_eq!(json["asset"]["extras"]["isovalue"], -1.5);
        let bound = |name: &str, k: usize| json["accessors"][0][name][k].as_f64().unwrap();
        for k in 0..3 {
            let all: Vec<f64> = mesh.vertices.iter().map(|v| f64::from(v.position[k])).collect();
            assert_eq!(bound("min", k), all.iter().copied().fold(f64::INFINITY, f64::min));
            assert_eq!(bound("max", k), all.iter().copied().fold(f64::NEG_INFINITY, f64::max));
        }
        let bin = &bytes[bytes.len() - (24 * 4 + 12 * 4)..];
        assert_eq!(bin[..4], mesh.vertices[0].position[0].to_le_bytes());
        assert_eq!(bin[96..100], mesh.triangles[0][0].to_le_bytes());
        assert_eq!(json["bufferViews"][2]["byteOffset"], 96);
    }

    #[test]
    fn no_triangles_are_a_scene_without_a_mesh() {
        let bytes = written(TriMesh::default());
        let json = json_of(&bytes);
        assert!(json.get("meshes").is_none() && json.get("buffers").is_none());
        assert_eq!(read(Path::new("f"), &bytes).unwrap(), TriMesh::default());
    }

    #[test]
    fn strides_short_indices_and_several_meshes_are_read() {
        let text = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":60}],
            "bufferViews":[{"buffer":0,"byteLength":52,"byteStride":20},{"buffer":0,"byteOffset":52,"byteLength":3}],
            "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
                         {"bufferView":1,"componentType":5121,"count":3,"type":"SCALAR"}],
            "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]},
                      {"primitives":[{"attributes":{"POSITION":0}},{"attributes":{"POSITION":0},"mode":1}]}]}"#;
        let mut bin = vec![0; 56];
        for v in 0..3 {
            bin[20 * v..20 * v + 4].copy_from_slice(&(v as f32).to_le_bytes());
        }
        bin[52..55].copy_from_slice(&[2, 0, 1]);
        let mesh = read(Path::new("f"), &glb(text, &bin)).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles), (6, vec![[2, 0, 1], [3, 4, 5]]));
        for (from, to, says) in [
            ("\"count\":3,\"type\":\"VEC3\"", "\"count\":4,\"type\":\"VEC3\"", "inside the file"),
            (
                "\"count\":3,\"type\":\"VEC3\"",
                "\"count\":18446744073709551615,\"type\":\"VEC3\"",
                "inside the file",
            ),
            ("\"byteStride\":20", "\"byteStride\":8", "inside the file"),
            ("5126", "5123", "VEC3"),
            ("\"mode\":1", "\"mode\":5", "mode 5"),
            ("{\"byteLength\":60}", "{\"byteLength\":60,\"uri\":\"x.bin\"}", "in this file"),
            ("\"meshes\"", "\"nodes\":[{\"mesh\":0,\"scale\":[2,2,2]}],\"meshes\"", "a transform"),
            ("\"meshes\"", "\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],\"meshes\"", "draco"),
            ("\"indices\":1", "\"indices\":7", "number 7"),
        ] {
            let bad = text.replacen(from, to, 1);
            assert_ne!(text, bad, "{from}");
            let error = read(Path::new("f"), &glb(&bad, &bin)).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
        bin[53] = 3;
        let error = read(Path::new("f"), &glb(text, &bin)).unwrap_err().to_string();
        assert!(error.contains("below 3"), "{error}");
    }

    #[test]
    fn a_long_text_needs_memory_and_says_how_much() {
        let bytes = glb(&format!("{{\"a\":[{}0]}}", "0,".repeat(50_000)), &[]);
        let read = |memory: u64| {
            let settings = CheckSettings { memory, ..CheckSettings::default() };
            let mut out = StoredSurface::new(&BuilderSettings::default());
            super::read(Path::new("f"), &bytes, &ReadLimits::of(&settings), &mut out)
        };
        let Err(Error::Budget { needed, .. }) = read(1 << 20) else { panic!("it was read") };
        read(needed).unwrap();
        assert!(read(needed - 8).is_err());
    }

    #[test]
    fn more_than_4_gib_is_refused() {
        assert!(check_limits(89_000_000, 178_000_000, &SurfaceMeta::default()).is_ok());
        assert!(check_limits(90_000_000, 180_000_000, &SurfaceMeta::default()).is_err());
        assert!(check_limits(u64::MAX, u64::MAX, &SurfaceMeta::default()).is_err());
    }

    #[test]
    fn damage_does_not_panic() {
        survive(&written(tetrahedron()), |b| drop(read(Path::new("f"), b)));
    }
}
