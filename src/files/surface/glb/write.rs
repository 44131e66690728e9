//! Writes GLB.

use super::coded::Coded;
use super::{
    ARRAY_BUFFER, BIN, BYTE, CHUNK_HEAD, ELEMENT_ARRAY_BUFFER, FLOAT, GENERATOR, HEAD, JSON, MAGIC, MESHOPT,
    TRIANGLES, UNSIGNED_BYTE, UNSIGNED_INT, UNSIGNED_SHORT,
};
use crate::files::labels::LabelStyle;
use crate::files::surface::values::{light, linear};
use crate::files::surface::{SurfaceMeta, SurfacePart, each_triangle, each_value, each_vertex, put_floats};
use crate::surface::SurfaceSource;
use crate::surface::weld::BuilderSettings;
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::sink::Sink;
use serde_json::{Value, json};

/// Bytes for the JSON text when the limits are checked; the text is far shorter, except with long
/// comments.
const JSON_ROOM: u64 = 1 << 20;
/// Bytes for what the text says of a part, but for a long name.
const TEXT_OF_PART: u64 = 1024;
/// The largest number of a quantized coordinate.
const STEPS: f32 = 65535.0;
/// Indices of two bytes are below this: 65535 is a mark of the format's.
const SHORT_INDICES: u64 = 65535;

/// Bytes of a position, and of a normal.
fn vector_bytes(meta: &SurfaceMeta) -> [u64; 2] {
    if meta.compress.is_quantized() { [8, 4] } else { [12, 12] }
}

/// Bytes of a vertex: position, normal and, where it has a value, that and the colour.
fn vertex_bytes(meta: &SurfaceMeta) -> u64 {
    vector_bytes(meta).iter().sum::<u64>() + if meta.values.is_some() { 8 } else { 0 }
}

/// Lengths are 32 bits wide.
pub(in crate::files) fn check_limits(vertices: u64, triangles: u64, meta: &SurfaceMeta) -> Result<()> {
    let text = TEXT_OF_PART * meta.parts.len() as u64;
    let arrays = u128::from(vertex_bytes(meta)) * u128::from(vertices) + 12 * u128::from(triangles);
    let bytes = arrays + u128::from(text);
    if bytes > u128::from(u64::from(u32::MAX) - JSON_ROOM) {
        return Err(Error::usage(format!(
            "a GLB file holds at most 4 GiB, this surface of {vertices} vertices and {triangles} triangles takes {bytes} \
             bytes; write PLY or VTP instead, or decimate it"
        )));
    }
    Ok(())
}

/// One of the surfaces of a file: a node with a mesh.
struct GlbSurface<'a> {
    name: Option<String>,
    /// The label and how it is shown, of a surface of one.
    label: Option<(f64, &'a LabelStyle)>,
    vertices: u64,
    triangles: u64,
    first_vertex: u64,
    first_triangle: u64,
    bounds: [[f32; 3]; 2],
}

/// What is written, before the first byte of it.
struct Plan<'a> {
    meta: &'a SurfaceMeta,
    pieces: Vec<GlbSurface<'a>>,
    origin: [f64; 3],
    vertices: u64,
    triangles: u64,
    /// Bytes of an index.
    index_bytes: u64,
    quantized: Quantized,
}

/// A grid on which positions are rounded.
#[derive(Clone, Copy, Debug, Default)]
struct Quantized {
    least: [f32; 3],
    step: f32,
}

impl Quantized {
    fn of([lo, hi]: [[f32; 3]; 2]) -> Self {
        let extent = (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f32::max);
        Self { least: lo, step: if extent > 0.0 { extent / STEPS } else { 1.0 } }
    }

    fn position(&self, p: [f32; 3]) -> [u16; 3] {
        std::array::from_fn(|k| ((p[k] - self.least[k]) / self.step).round().clamp(0.0, STEPS) as u16)
    }
}

/// The least box of positions; without any, one that holds nothing.
const NO_BOX: [[f32; 3]; 2] = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];

/// Extends a box by another one.
fn extend(bounds: &mut [[f32; 3]; 2], by: [[f32; 3]; 2]) {
    for k in 0..3 {
        (bounds[0][k], bounds[1][k]) = (bounds[0][k].min(by[0][k]), bounds[1][k].max(by[1][k]));
    }
}

/// Moves on to the piece that has the item of a number; `end` tells where a piece ends.
fn move_on(pieces: &[GlbSurface<'_>], at: &mut usize, number: u64, end: impl Fn(&GlbSurface<'_>) -> u64) {
    while pieces.get(*at).is_some_and(|piece| number >= end(piece)) {
        *at += 1;
    }
}

impl<'a> Plan<'a> {
    fn of(source: &dyn SurfaceSource, sink: &mut Sink<'_>, meta: &'a SurfaceMeta) -> Result<Self> {
        let mut pieces = pieces(source, meta);
        let mut at = 0;
        each_vertex(source, sink, |_, n, v| {
            move_on(&pieces, &mut at, n, |piece| piece.first_vertex + piece.vertices);
            if let Some(piece) = pieces.get_mut(at) {
                extend(&mut piece.bounds, [v.position; 2]);
            }
        })?;
        let mut bounds = NO_BOX;
        pieces.retain(|piece| piece.triangles > 0);
        pieces.iter().for_each(|piece| extend(&mut bounds, piece.bounds));
        let is_short =
            meta.compress.is_quantized() && pieces.iter().all(|piece| piece.vertices <= SHORT_INDICES);
        let is_empty = pieces.is_empty();
        Ok(Self {
            meta,
            pieces,
            origin: source.origin(),
            vertices: if is_empty { 0 } else { source.vertex_count() },
            triangles: source.triangle_count(),
            index_bytes: if is_short { 2 } else { 4 },
            quantized: Quantized::of(bounds),
        })
    }

    /// Bytes of the binary chunk, without padding.
    fn bin_bytes(&self) -> u64 {
        vertex_bytes(self.meta) * self.vertices + 3 * self.index_bytes * self.triangles
    }
}

/// The surfaces of a file.
fn pieces<'a>(source: &dyn SurfaceSource, meta: &'a SurfaceMeta) -> Vec<GlbSurface<'a>> {
    let piece = |name, vertices, triangles| GlbSurface {
        name,
        label: None,
        vertices,
        triangles,
        first_vertex: 0,
        first_triangle: 0,
        bounds: NO_BOX,
    };
    if meta.parts.is_empty() {
        let name = meta.isovalue.map(|isovalue| format!("isovalue {isovalue}"));
        return vec![piece(name, source.vertex_count(), source.triangle_count())];
    }
    let (mut vertices, mut triangles) = (0, 0);
    let part = |part: &'a SurfacePart| {
        let mut one = piece(Some(part.name()), part.vertices, part.triangles);
        one.label = part.label.as_ref().map(|style| (part.isovalue, style));
        (one.first_vertex, one.first_triangle) = (vertices, triangles);
        (vertices, triangles) = (vertices + part.vertices, triangles + part.triangles);
        one
    };
    meta.parts.iter().map(part).collect()
}

/// Writes a surface as GLB. What is coded waits as `scratch` says.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    sink: &mut Sink<'_>,
    meta: &SurfaceMeta,
    scratch: &BuilderSettings,
) -> Result<()> {
    let plan = Plan::of(source, sink, meta)?;
    let coded = match meta.compress.is_coded() && !plan.pieces.is_empty() {
        true => plan.coded(source, scratch)?,
        false => vec![],
    };
    let mut text = plan.document(&coded).to_string();
    text.extend(std::iter::repeat_n(' ', text.len().next_multiple_of(4) - text.len()));
    let bin = plan.stored_bytes(&coded);
    let padding = bin.next_multiple_of(4) - bin;
    let bin_chunk = if bin == 0 { 0 } else { CHUNK_HEAD + bin + padding };
    let total = HEAD + CHUNK_HEAD + text.len() as u64 + bin_chunk;
    if u32::try_from(total).is_err() {
        return Err(Error::usage(
            "a GLB file holds at most 4 GiB: give each part a file, or write PLY or VTP",
        ));
    }
    let put = |sink: &mut Sink<'_>, n: u64| {
        sink.put(&u32::try_from(n).expect("limits were checked before").to_le_bytes())
    };
    sink.put(MAGIC)?;
    put(sink, 2)?;
    put(sink, total)?;
    put(sink, text.len() as u64)?;
    put(sink, u64::from(JSON))?;
    sink.put(text.as_bytes())?;
    if bin == 0 {
        return Ok(());
    }
    put(sink, bin + padding)?;
    put(sink, u64::from(BIN))?;
    if coded.is_empty() {
        for run in 0..plan.strides().len() {
            plan.put_run(run, source, sink)?;
        }
        plan.put_triangles(source, sink)?;
    }
    coded.iter().try_for_each(|array| array.write(sink))?;
    sink.put(&[0; 4][..padding as usize])
}

impl Plan<'_> {
    /// Bytes of an element of each array of the vertices.
    fn strides(&self) -> Vec<u64> {
        let of_values: &[u64] = if self.meta.values.is_some() { &[4, 4] } else { &[] };
        [&vector_bytes(self.meta), of_values].concat()
    }

    /// Bytes of the binary chunk as it is in the file, without padding.
    fn stored_bytes(&self, coded: &[Coded]) -> u64 {
        if coded.is_empty() { self.bin_bytes() } else { coded.iter().map(Coded::padded_bytes).sum() }
    }

    /// All arrays, coded: those of the vertices, then the indices.
    fn coded(&self, source: &dyn SurfaceSource, scratch: &BuilderSettings) -> Result<Vec<Coded>> {
        let strides = self.strides();
        // Indices take two shares.
        let memory_bytes = scratch.memory_bytes / (strides.len() + 2);
        let share = BuilderSettings { memory_bytes, scratch: scratch.scratch.clone() };
        let mut all = vec![];
        for (run, &stride) in strides.iter().enumerate() {
            all.push(Coded::attributes(stride, &share, |sink| self.put_run(run, source, sink))?);
        }
        all.push(Coded::triangles(self.index_bytes, &share, |sink| self.put_triangles(source, sink))?);
        Ok(all)
    }

    /// Writes an array of the vertices: positions, normals, colours or values.
    fn put_run(&self, run: usize, source: &dyn SurfaceSource, sink: &mut Sink<'_>) -> Result<()> {
        match (run, self.meta.compress.is_quantized(), &self.meta.values) {
            (0, true, _) => each_vertex(source, sink, |buffer, _, v| {
                let [x, y, z] = self.quantized.position(v.position);
                [x, y, z, 0].iter().for_each(|c| buffer.extend_from_slice(&c.to_le_bytes()));
            }),
            (0, false, _) => each_vertex(source, sink, |buffer, _, v| put_floats(buffer, v.position)),
            (1, true, _) => each_vertex(source, sink, |buffer, _, v| {
                let bytes = v.normal.map(|c| (127.0 * c).round() as i8 as u8);
                buffer.extend_from_slice(&[bytes[0], bytes[1], bytes[2], 0]);
            }),
            (1, false, _) => each_vertex(source, sink, |buffer, _, v| put_floats(buffer, v.normal)),
            (_, _, None) => Ok(()),
            (2, _, Some(values)) => each_value(source, sink, values, |buffer, value| {
                let [r, g, b] = values.colour(value).map(linear);
                buffer.extend_from_slice(&[r, g, b, u8::MAX]);
            }),
            // No number of a file may be NaN.
            (_, _, Some(values)) => each_value(source, sink, values, |buffer, value| {
                let value = if value.is_finite() { values.whole(value) as f32 } else { 0.0 };
                buffer.extend_from_slice(&value.to_le_bytes());
            }),
        }
    }

    fn put_triangles(&self, source: &dyn SurfaceSource, sink: &mut Sink<'_>) -> Result<()> {
        let mut at = 0;
        let target = sink.target().to_path_buf();
        each_triangle(source, sink, |buffer, number, t| {
            move_on(&self.pieces, &mut at, number, |piece| piece.first_triangle + piece.triangles);
            // A part has its own vertices alone.
            let first = self.pieces.get(at).map_or(0, |piece| piece.first_vertex);
            for v in t {
                let v = u64::from(v).checked_sub(first).ok_or_else(|| {
                    let what = format!("triangle {t:?} of a part that begins at vertex {first}");
                    Error::io("write", &target, std::io::Error::new(std::io::ErrorKind::InvalidData, what))
                })?;
                buffer.extend_from_slice(&v.to_le_bytes()[..self.index_bytes as usize]);
            }
            Ok(())
        })
    }

    /// The JSON text. Bounds are written so that they are exact also for a reader that uses `f64`.
    fn document(&self, coded: &[Coded]) -> Value {
        let meta = self.meta;
        let mut extras = json!({ "isovalue": meta.isovalue, "comments": meta.lines() });
        meta.named_units().for_each(|(name, unit)| extras[name] = json!(unit.as_str()));
        if let Some(time) = meta.time {
            extras["time"] = json!(time);
        }
        let generator = format!("{GENERATOR}{}", env!("CARGO_PKG_VERSION"));
        let asset = json!({ "version": "2.0", "generator": generator, "extras": extras });
        if self.pieces.is_empty() {
            return json!({ "asset": asset, "scene": 0, "scenes": [{}] });
        }
        let mut out = json!({
            "asset": asset,
            "scene": 0,
            "scenes": [{ "nodes": (0..self.pieces.len()).collect::<Vec<_>>() }],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": self.views(coded),
            "buffers": [{ "byteLength": self.stored_bytes(coded) }],
            "materials": [],
        });
        let extensions = meta.compress.extensions();
        if !extensions.is_empty() {
            out["extensionsUsed"] = json!(extensions);
            out["extensionsRequired"] = json!(extensions);
        }
        if !coded.is_empty() {
            // What decoding makes: no bytes of the file.
            let decoded =
                json!({ "byteLength": self.bin_bytes(), "extensions": { MESHOPT: { "fallback": true } } });
            out["buffers"].as_array_mut().expect("a list was made").push(decoded);
        }
        for (n, piece) in self.pieces.iter().enumerate() {
            self.add_piece(&mut out, n, piece);
            if n == 0 || piece.label.is_some() {
                out["materials"].as_array_mut().expect("a list was made").push(material(piece));
            }
        }
        out
    }

    /// The runs of bytes: one for each kind of number.
    fn views(&self, coded: &[Coded]) -> Value {
        let mut offset = 0;
        let mut view = |bytes: u64, target: u64| {
            let view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes, "target": target });
            offset += bytes;
            view
        };
        let mut views = vec![];
        for stride in self.strides() {
            let mut of_vertices = view(stride * self.vertices, ARRAY_BUFFER);
            if self.meta.compress.is_quantized() {
                of_vertices["byteStride"] = json!(stride);
            }
            views.push(of_vertices);
        }
        views.push(view(3 * self.index_bytes * self.triangles, ELEMENT_ARRAY_BUFFER));
        let mut at = 0;
        for (number, (view, coded)) in views.iter_mut().zip(coded).enumerate() {
            let (stride, mode, count) = match self.strides().get(number) {
                Some(&stride) => (stride, "ATTRIBUTES", self.vertices),
                None => (self.index_bytes, "TRIANGLES", 3 * self.triangles),
            };
            view["buffer"] = json!(1);
            view["extensions"] = json!({ MESHOPT: {
                "buffer": 0, "byteOffset": at, "byteLength": coded.bytes(), "byteStride": stride,
                "count": count, "mode": mode
            } });
            at += coded.padded_bytes();
        }
        json!(views)
    }

    /// Adds a node, its mesh and what that refers to.
    fn add_piece(&self, out: &mut Value, number: usize, piece: &GlbSurface<'_>) {
        let (meta, [position, normal]) = (self.meta, vector_bytes(self.meta));
        let push = |out: &mut Value, list: &str, item: Value| {
            let list = out[list].as_array_mut().expect("a list was made");
            list.push(item);
            list.len() - 1
        };
        let accessor = |view: usize, bytes: u64, kind: u64, of: &str| {
            json!({
                "bufferView": view, "byteOffset": bytes * piece.first_vertex, "componentType": kind,
                "count": piece.vertices, "type": of
            })
        };
        let kinds = if meta.compress.is_quantized() { [UNSIGNED_SHORT, BYTE] } else { [FLOAT; 2] };
        let mut positions = accessor(0, position, kinds[0], "VEC3");
        let [lo, hi] = self.bounds(piece);
        (positions["min"], positions["max"]) = (json!(lo), json!(hi));
        let mut normals = accessor(1, normal, kinds[1], "VEC3");
        if meta.compress.is_quantized() {
            normals["normalized"] = json!(true);
        }
        let mut attributes = json!({});
        attributes["POSITION"] = json!(push(out, "accessors", positions));
        attributes["NORMAL"] = json!(push(out, "accessors", normals));
        let mut views = 2;
        if let Some(values) = &meta.values {
            let mut colours = accessor(2, 4, UNSIGNED_BYTE, "VEC4");
            colours["normalized"] = json!(true);
            attributes["COLOR_0"] = json!(push(out, "accessors", colours));
            // Attributes of our own begin with an underscore.
            let name = format!("_{}", values.plain_name().to_ascii_uppercase());
            attributes[name] = json!(push(out, "accessors", accessor(3, 4, FLOAT, "SCALAR")));
            views = 4;
        }
        let kind = if self.index_bytes == 2 { UNSIGNED_SHORT } else { UNSIGNED_INT };
        let indices = json!({
            "bufferView": views, "byteOffset": 3 * self.index_bytes * piece.first_triangle,
            "componentType": kind, "count": 3 * piece.triangles, "type": "SCALAR"
        });
        let indices = push(out, "accessors", indices);
        let material = if piece.label.is_some() { number } else { 0 };
        let primitive =
            json!({ "attributes": attributes, "indices": indices, "material": material, "mode": TRIANGLES });
        let mut mesh = json!({ "primitives": [primitive] });
        let mut node = self.node(number);
        if let Some(name) = &piece.name {
            (mesh["name"], node["name"]) = (json!(name), json!(name));
        }
        if let Some((label, _)) = piece.label {
            node["extras"]["label"] = json!(label);
        }
        push(out, "meshes", mesh);
        push(out, "nodes", node);
    }

    /// The least and the largest position of a mesh, as its numbers are.
    fn bounds(&self, piece: &GlbSurface<'_>) -> [[f64; 3]; 2] {
        // A zero has no sign: which of two zeros is the lesser one differs from machine to machine.
        piece.bounds.map(|b| match self.meta.compress.is_quantized() {
            true => self.quantized.position(b).map(f64::from),
            false => b.map(|x| f64::from(x) + 0.0),
        })
    }

    /// A node of a mesh: the transform from the numbers of the file to metres, y up, or to the
    /// world where the unit is not known.
    fn node(&self, mesh: usize) -> Value {
        let (least, step) = match self.meta.compress.is_quantized() {
            true => (self.quantized.least.map(f64::from), f64::from(self.quantized.step)),
            false => ([0.0; 3], 1.0),
        };
        let place: [f64; 3] = std::array::from_fn(|k| self.origin[k] + least[k]);
        let mut node = json!({ "mesh": mesh });
        let is_moved = place != [0.0; 3] || step != 1.0;
        match self.meta.units.length.as_ref().and_then(|unit| unit.metres()) {
            Some((metres, power)) => {
                let scale: f64 = format!("{metres}e{power}").parse().unwrap_or(metres);
                let (s, [x, y, z]) = (scale * step, place.map(|c| scale * c));
                // Column by column; a zero has no sign.
                let [x, y, z] = [x, z, -y].map(|c| c + 0.0);
                node["matrix"] = json!([s, 0.0, 0.0, 0.0, 0.0, 0.0, -s, 0.0, 0.0, s, 0.0, 0.0, x, y, z, 1.0]);
                node["extras"] = json!({ "world": { "scale": step, "translation": place } });
            }
            None if step != 1.0 => {
                node["translation"] = json!(place);
                node["scale"] = json!([step, step, step]);
                node["extras"] = json!({ "world": { "scale": step, "translation": place } });
            }
            None if is_moved => node["translation"] = json!(place),
            None => {}
        }
        node
    }
}

/// The material of a surface; that of a label has its colour, whose light is linear in glTF.
fn material(piece: &GlbSurface<'_>) -> Value {
    let mut material = json!({
        "doubleSided": true,
        "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.7 },
    });
    if let Some((_, style)) = piece.label {
        let [r, g, b, opacity] = style.colour;
        let colour = [r, g, b].map(light);
        let opacity = f64::from(opacity) / 255.0;
        material["name"] = json!(piece.name);
        material["pbrMetallicRoughness"]["baseColorFactor"] =
            json!([colour[0], colour[1], colour[2], opacity]);
        if opacity < 1.0 {
            material["alphaMode"] = json!("BLEND");
        }
    }
    material
}
