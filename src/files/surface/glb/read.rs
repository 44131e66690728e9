//! Reads GLB.

use super::decode::{attributes, triangles};
use super::{
    BIN, BYTE, CHUNK_HEAD, FLOAT, GENERATOR, HEAD, JSON, MESHOPT, QUANTIZATION, SHORT, TRIANGLES,
    UNSIGNED_BYTE, UNSIGNED_INT, UNSIGNED_SHORT,
};
use crate::files::surface::ply::check_indices;
use crate::files::surface::{ReadLimits, is_finite, take_line};
use crate::surface::SurfaceSource;
use crate::surface::weld::StoredSurface;
use byteorder::{ByteOrder, LE};
use isospan_io::error::{Error, Result};
use serde_json::Value;
use std::collections::HashMap;
use std::path::Path;

/// Bytes of memory that the tree of a JSON text takes for each of its bytes, at most: a map of one
/// item takes 632 and is written with five.
const TREE_PER_BYTE: u64 = 130;

/// Reads the triangles of a GLB.
pub(in crate::files) fn read(
    path: &Path,
    bytes: &[u8],
    limits: &ReadLimits,
    out: &mut StoredSurface,
) -> Result<()> {
    let mut file = GlbFile::parse(path, bytes, limits)?;
    file.refuse_what_changes_the_shape()?;
    file.decode(limits)?;
    let places = file.places()?;
    if file.is_ours() {
        let lines = file.json.pointer("/asset/extras").map_or(&[][..], |extras| list(extras, "comments"));
        lines.iter().filter_map(Value::as_str).for_each(|line| take_line(out, line));
    }
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

struct GlbFile<'a> {
    path: &'a Path,
    json: Value,
    bin: &'a [u8],
    /// What coded runs of bytes decode to, by their numbers.
    decoded: HashMap<usize, Vec<u8>>,
}

/// The way from the numbers of a mesh to the world.
#[derive(Clone, Copy, Debug)]
struct NodeToWorld {
    scale: f64,
    place: [f64; 3],
}

impl Default for NodeToWorld {
    fn default() -> Self {
        Self { scale: 1.0, place: [0.0; 3] }
    }
}

impl NodeToWorld {
    fn to_world(self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| self.place[k] + self.scale * p[k])
    }
}

/// Three numbers.
fn triple(value: Option<&Value>) -> Option<[f64; 3]> {
    let numbers: Vec<f64> = value?.as_array()?.iter().map(Value::as_f64).collect::<Option<_>>()?;
    numbers.try_into().ok()
}

/// What a node that we wrote says of the way to the world.
fn own_frame(node: &Value) -> Option<NodeToWorld> {
    let world = node.pointer("/extras/world")?;
    Some(NodeToWorld { scale: world.get("scale")?.as_f64()?, place: triple(world.get("translation"))? })
}

/// Corners of triangles as indices of two or four bytes.
fn indices(triangles: &[[u32; 3]], width: usize) -> Option<Vec<u8>> {
    let corners = triangles.iter().flatten();
    match width {
        2 => {
            let short: Option<Vec<u16>> = corners.map(|&v| u16::try_from(v).ok()).collect();
            Some(short?.into_iter().flat_map(u16::to_le_bytes).collect())
        }
        4 => Some(corners.flat_map(|v| v.to_le_bytes()).collect()),
        _ => None,
    }
}

/// The elements of an accessor: each `size` bytes long, `stride` bytes apart.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
    kind: u64,
    normalized: bool,
}

impl<'a> Elements<'a> {
    fn bytes(&self, i: usize) -> &'a [u8] {
        &self.bytes[i * self.stride..][..self.size]
    }

    fn unsigned(&self, i: usize) -> u64 {
        self.bytes(i).iter().rev().fold(0, |n, &byte| n << 8 | u64::from(byte))
    }

    fn vector(&self, i: usize) -> [f64; 3] {
        let bytes = self.bytes(i);
        std::array::from_fn(|k| {
            let (number, most) = match self.kind {
                BYTE => (f64::from(bytes[k] as i8), 127.0),
                UNSIGNED_BYTE => (f64::from(bytes[k]), 255.0),
                SHORT => (f64::from(LE::read_i16(&bytes[2 * k..])), 32767.0),
                UNSIGNED_SHORT => (f64::from(LE::read_u16(&bytes[2 * k..])), 65535.0),
                _ => return f64::from(LE::read_f32(&bytes[4 * k..])),
            };
            if self.normalized { (number / most).max(-1.0) } else { number }
        })
    }
}

impl<'a> GlbFile<'a> {
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
            Ok(json) => {
                let (bin, decoded) = (chunks[1].unwrap_or_default(), HashMap::new());
                Ok(Self { path, json, bin, decoded })
            }
            Err(e) => bad("JSON chunk", "a JSON text", e.to_string()),
        }
    }

    fn wrong(&self, at: impl Into<String>, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(self.path, at.into(), expected.into(), got.into())
    }

    fn refuse_what_changes_the_shape(&self) -> Result<()> {
        let required = list(&self.json, "extensionsRequired");
        if required.iter().any(|name| name != QUANTIZATION && name != MESHOPT) {
            let got = Value::from(required).to_string();
            return Err(self
                .wrong("extensionsRequired", format!("none, {QUANTIZATION} or {MESHOPT}"), got)
                .with_help("save the file without compression and other extensions"));
        }
        let is_ours = |n: &Value| self.is_ours() && own_frame(n).is_some();
        let moved =
            |n: &Value| !is_ours(n) && ["matrix", "rotation", "scale"].iter().any(|t| n.get(t).is_some());
        match list(&self.json, "nodes").iter().position(moved) {
            Some(n) => Err(self.transformed(n)),
            None => Ok(()),
        }
    }

    /// Whether this program wrote the file.
    fn is_ours(&self) -> bool {
        let generator = self.json.pointer("/asset/generator").and_then(Value::as_str);
        generator.is_some_and(|name| name.starts_with(GENERATOR))
    }

    fn transformed(&self, node: usize) -> Error {
        self.wrong(format!("node {node}"), "a mesh in its own coordinates", "a transform")
            .with_help("apply the transforms first")
    }

    /// What is added to the positions of each mesh: the translation of its node, where that has
    /// neither a parent nor children, and is alone with the mesh.
    fn places(&self) -> Result<HashMap<usize, NodeToWorld>> {
        let nodes = list(&self.json, "nodes");
        let number = |value: &Value| value.as_u64().and_then(|n| usize::try_from(n).ok());
        let children = || nodes.iter().flat_map(|node| list(node, "children")).filter_map(number);
        let mesh_of = |node: &Value| node.get("mesh").and_then(number);
        let mut places = HashMap::new();
        for (n, node) in nodes.iter().enumerate() {
            if let (true, Some(frame), Some(mesh)) = (self.is_ours(), own_frame(node), mesh_of(node)) {
                places.insert(mesh, frame);
                continue;
            }
            if node.get("translation").is_none() {
                continue;
            }
            if mesh_of(node).is_none() && list(node, "children").is_empty() {
                // A camera, or a light.
                continue;
            }
            let place = triple(node.get("translation"));
            let (Some(place), Some(mesh)) = (place, mesh_of(node)) else { return Err(self.transformed(n)) };
            let is_alone = list(node, "children").is_empty()
                && !children().any(|child| child == n)
                && nodes.iter().filter(|other| mesh_of(other) == Some(mesh)).count() == 1;
            if !is_alone {
                return Err(self.transformed(n));
            }
            places.insert(mesh, NodeToWorld { scale: 1.0, place });
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

    /// Decodes the runs of bytes that are coded.
    fn decode(&mut self, limits: &ReadLimits) -> Result<()> {
        let (mut total, mut all) = (0u64, HashMap::new());
        for (number, view) in list(&self.json, "bufferViews").iter().enumerate() {
            let Some(coded) = view.get("extensions").and_then(|all| all.get(MESHOPT)) else { continue };
            let of = |name: &str, default| self.number(coded, name, default);
            let (start, length) = (of("byteOffset", Some(0))?, of("byteLength", None)?);
            let (count, stride) = (of("count", None)?, of("byteStride", None)?);
            let is_of_triangles = coded.get("mode").and_then(Value::as_str) == Some("TRIANGLES");
            // Triangles are there as numbers, too, before they are bytes.
            let each = if is_of_triangles { stride.saturating_mul(2).saturating_add(4) } else { stride };
            let size = count.checked_mul(each).map_or(u64::MAX, |size| size as u64);
            total = total.saturating_add(size);
            limits.check("for the coded arrays of a GLB file", total)?;
            // The view says, too, how many bytes there are afterwards.
            let is_alike = count.checked_mul(stride) == Some(self.number(view, "byteLength", None)?);
            let bytes = start.checked_add(length).and_then(|end| self.bin.get(start..end));
            let text = |name: &str| coded.get(name).and_then(Value::as_str);
            let is_plain =
                is_alike && of("buffer", None)? == 0 && text("filter").is_none_or(|filter| filter == "NONE");
            let decoded = match (bytes.filter(|_| is_plain), text("mode")) {
                (Some(bytes), Some("ATTRIBUTES")) => attributes(bytes, count, stride),
                (Some(bytes), Some("TRIANGLES")) if count.is_multiple_of(3) && [2, 4].contains(&stride) => {
                    triangles(bytes, count / 3).and_then(|all| indices(&all, stride))
                }
                _ => None,
            };
            let Some(decoded) = decoded else {
                let at = format!("bufferViews {number}");
                let expected = format!("{count} elements of {stride} bytes, coded without a filter");
                let [mode, filter] = ["mode", "filter"].map(|name| text(name).unwrap_or("none"));
                let got = format!("{length} bytes, mode {mode}, filter {filter}");
                return Err(self.wrong(at, expected, got).with_help("save the file without compression"));
            };
            all.insert(number, decoded);
        }
        self.decoded = all;
        Ok(())
    }

    /// The bytes of a run.
    fn view(&self, number: usize, at: &str) -> Result<&[u8]> {
        if let Some(decoded) = self.decoded.get(&number) {
            return Ok(decoded);
        }
        let view = self.item("bufferViews", number)?;
        let buffer = self.number(view, "buffer", None)?;
        if buffer != 0 || self.item("buffers", 0)?.get("uri").is_some() {
            return Err(self.wrong(at, "data in this file", "data elsewhere"));
        }
        let (start, length) =
            (self.number(view, "byteOffset", Some(0))?, self.number(view, "byteLength", None)?);
        let bytes = start.checked_add(length).and_then(|end| self.bin.get(start..end));
        bytes.ok_or_else(|| {
            let got = format!("{length} bytes beyond the end of {} bytes", self.bin.len());
            self.wrong(at, "elements inside the file", got)
        })
    }

    fn elements(
        &self,
        accessor: usize,
        kind: &str,
        size_of: impl Fn(usize) -> Option<usize>,
    ) -> Result<Elements<'_>> {
        let about = self.item("accessors", accessor)?;
        let at = format!("accessor {accessor}");
        let found = about.get("type").and_then(Value::as_str).unwrap_or("none");
        let component = self.number(about, "componentType", None)?;
        let size = size_of(component).filter(|_| found == kind && about.get("sparse").is_none());
        let Some(size) = size else {
            let got = format!("{found} of component type {component}, or sparse");
            return Err(self.wrong(at, format!("{kind} of a plain type"), got));
        };
        let number = self.number(about, "bufferView", None)?;
        let view = self.item("bufferViews", number)?;
        let bytes = self.view(number, &at)?;
        let stride = self.number(view, "byteStride", Some(size as u64))?;
        let (skip, count) = (self.number(about, "byteOffset", Some(0))?, self.number(about, "count", None)?);
        let needed = count.checked_sub(1).map_or(Some(0), |n| n.checked_mul(stride)?.checked_add(size));
        match (bytes.get(skip..), needed) {
            (Some(bytes), Some(needed)) if stride >= size && needed <= bytes.len() => {
                let normalized = about.get("normalized").and_then(Value::as_bool).unwrap_or(false);
                Ok(Elements { bytes, stride, size, count, kind: component as u64, normalized })
            }
            _ => {
                let got = format!("{count} elements beyond the end of {} bytes", bytes.len());
                Err(self.wrong(at, "elements inside the file", got))
            }
        }
    }

    /// Three numbers an element: floats or, of a file that is quantized, shorter ones.
    fn vectors(&self, accessor: usize) -> Result<Elements<'_>> {
        let is_quantized = list(&self.json, "extensionsRequired").iter().any(|name| name == QUANTIZATION);
        self.elements(accessor, "VEC3", |component| match component as u64 {
            FLOAT => Some(12),
            BYTE | UNSIGNED_BYTE if is_quantized => Some(3),
            SHORT | UNSIGNED_SHORT if is_quantized => Some(6),
            _ => None,
        })
    }

    fn add_primitive(
        &self,
        primitive: &Value,
        at: &str,
        place: NodeToWorld,
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
        place: NodeToWorld,
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
            let position = place.to_world(positions.vector(n));
            if !is_finite(&position.map(|x| x as f32)) {
                return Err(self.wrong(at, "finite positions", format!("{position:?} for vertex {n}")));
            }
            let normal = normals.as_ref().map_or([0.0; 3], |normals| normals.vector(n));
            out.push_double(position, normal.map(|c| c as f32))?;
        }
        Ok(positions.count)
    }

    fn indices(&self, accessor: usize) -> Result<Elements<'_>> {
        self.elements(accessor, "SCALAR", |component| match component as u64 {
            UNSIGNED_BYTE => Some(1),
            UNSIGNED_SHORT => Some(2),
            UNSIGNED_INT => Some(4),
            _ => None,
        })
    }
}
