//! GLB of labels: a node, a mesh and a material for each, in one buffer.
//!
//! ```text
//! positions  3 × f32 a vertex, label after label
//! normals    3 × f32 a vertex
//! indices    3 × u32 a triangle, counted from the label's first vertex
//! ```
//!
//! Three views of the buffer are cut into accessors, three a label. A node has the label's name, or
//! `label 3`, and the number as `extras.label`; the material has its colour, is not metallic and has
//! two sides. A label without triangles has no node.

use super::glb::{ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, FLOAT, TRIANGLES, UNSIGNED_INT, file_bytes, put_head};
use super::values::linear;
use super::{SurfaceMeta, SurfacePart, each_triangle, each_vertex, put_floats};
use crate::surface::SurfaceSource;
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::sink::Sink;
use serde_json::{Value, json};

/// The least and the largest position of a label.
type Bounds = [[f32; 3]; 2];

/// Writes the surfaces of labels as GLB.
pub(super) fn write(source: &dyn SurfaceSource, sink: &mut Sink<'_>, meta: &SurfaceMeta) -> Result<()> {
    let bounds = bounds(source, sink, meta)?;
    let is_empty = source.triangle_count() == 0;
    let bin = if is_empty { 0 } else { 24 * source.vertex_count() + 12 * source.triangle_count() };
    let text = padded(document(source, meta, &bounds).to_string());
    if u32::try_from(file_bytes(&text, bin)).is_err() {
        return Err(Error::usage(
            "a GLB file holds at most 4 GiB: give each label a file, or write PLY or VTP",
        ));
    }
    put_head(sink, &text, bin)?;
    if bin == 0 {
        return Ok(());
    }
    each_vertex(source, sink, |buffer, _, v| put_floats(buffer, v.position))?;
    each_vertex(source, sink, |buffer, _, v| put_floats(buffer, v.normal))?;
    let (mut parts, mut first, mut end) = (meta.parts.iter(), 0, 0);
    let mut vertices = 0;
    each_triangle(source, sink, |buffer, number, triangle| {
        while number >= end {
            let Some(part) = parts.next() else { break };
            (first, vertices) = (vertices, vertices + part.vertices);
            end += part.triangles;
        }
        let own = triangle.map(|v| v.wrapping_sub(first as u32));
        own.iter().for_each(|v| buffer.extend_from_slice(&v.to_le_bytes()));
        Ok(())
    })
}

/// The bounds of each label. They take a pass over the vertices.
fn bounds(source: &dyn SurfaceSource, sink: &mut Sink<'_>, meta: &SurfaceMeta) -> Result<Vec<Bounds>> {
    let mut bounds = vec![[[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]]; meta.parts.len()];
    let (mut part, mut end) = (0, meta.parts.first().map_or(0, |p| p.vertices));
    each_vertex(source, sink, |_, number, v| {
        while number >= end && part + 1 < meta.parts.len() {
            part += 1;
            end += meta.parts[part].vertices;
        }
        let [lo, hi] = &mut bounds[part];
        for (k, x) in v.position.into_iter().enumerate() {
            (lo[k], hi[k]) = (lo[k].min(x), hi[k].max(x));
        }
    })?;
    Ok(bounds)
}

fn padded(mut text: String) -> String {
    text.extend(std::iter::repeat_n(' ', text.len().next_multiple_of(4) - text.len()));
    text
}

fn document(source: &dyn SurfaceSource, meta: &SurfaceMeta, bounds: &[Bounds]) -> Value {
    let asset = json!({
        "version": "2.0",
        "generator": concat!("isospan ", env!("CARGO_PKG_VERSION")),
        "extras": { "comments": meta.lines() },
    });
    if source.triangle_count() == 0 {
        return json!({ "asset": asset, "scene": 0, "scenes": [{}] });
    }
    let (vertices, triangles) = (source.vertex_count(), source.triangle_count());
    let view = |offset: u64, length: u64, target: u64| json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": target });
    let views = [
        view(0, 12 * vertices, ARRAY_BUFFER),
        view(12 * vertices, 12 * vertices, ARRAY_BUFFER),
        view(24 * vertices, 12 * triangles, ELEMENT_ARRAY_BUFFER),
    ];
    let (mut nodes, mut meshes, mut materials, mut accessors) = (vec![], vec![], vec![], vec![]);
    let (mut vertex, mut triangle) = (0, 0);
    for (part, bounds) in meta.parts.iter().zip(bounds) {
        if part.triangles > 0 {
            let number = nodes.len();
            nodes.push(node(part, number, source.origin()));
            materials.push(material(part));
            accessors.extend(accessors_of(part, bounds, vertex, triangle));
            let attributes = json!({ "POSITION": 3 * number, "NORMAL": 3 * number + 1 });
            meshes.push(json!({ "name": name(part), "primitives": [{
                "attributes": attributes, "indices": 3 * number + 2, "material": number, "mode": TRIANGLES
            }] }));
        }
        vertex += part.vertices;
        triangle += part.triangles;
    }
    json!({
        "asset": asset,
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": 24 * vertices + 12 * triangles }],
    })
}

/// Positions, normals and indices of a label, from its first vertex and triangle on.
fn accessors_of(part: &SurfacePart, bounds: &Bounds, vertex: u64, triangle: u64) -> [Value; 3] {
    // A zero has no sign: which of two zeros is the lesser one differs from machine to machine.
    let [lo, hi] = bounds.map(|b| b.map(|x| f64::from(x) + 0.0));
    let accessor = |view: u64, offset: u64, component: u64, count: u64, kind: &str| json!({ "bufferView": view, "byteOffset": offset, "componentType": component, "count": count, "type": kind });
    let mut positions = accessor(0, 12 * vertex, FLOAT, part.vertices, "VEC3");
    (positions["min"], positions["max"]) = (json!(lo), json!(hi));
    [
        positions,
        accessor(1, 12 * vertex, FLOAT, part.vertices, "VEC3"),
        accessor(2, 12 * triangle, UNSIGNED_INT, 3 * part.triangles, "SCALAR"),
    ]
}

fn node(part: &SurfacePart, mesh: usize, origin: [f64; 3]) -> Value {
    let mut node = json!({ "mesh": mesh, "name": name(part), "extras": { "label": part.isovalue } });
    if origin != [0.0; 3] {
        node["translation"] = json!(origin);
    }
    node
}

fn name(part: &SurfacePart) -> String {
    let named = part.label.as_ref().map(|label| &label.name).filter(|name| !name.is_empty());
    named.map_or_else(|| format!("label {}", part.isovalue), Clone::clone)
}

/// A material in the label's colour, whose light is linear in glTF.
fn material(part: &SurfacePart) -> Value {
    let [r, g, b, opacity] = part.label.as_ref().map_or([u8::MAX; 4], |label| label.colour);
    let light = |c: u8| f64::from(linear(c)) / 65535.0;
    let colour = [light(r), light(g), light(b), f64::from(opacity) / 255.0];
    let mut material = json!({
        "name": name(part),
        "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.8 },
    });
    if opacity < u8::MAX {
        material["alphaMode"] = json!("BLEND");
    }
    material
}

#[cfg(test)]
mod tests {
    use crate::files::labels::LabelStyle;
    use crate::files::surface::tests::{source, tetrahedron};
    use crate::files::surface::{SurfaceFormat, SurfaceMeta, SurfacePart, read_surface, write_surface};
    use crate::surface::{Joined, TriMesh};

    #[test]
    fn each_label_is_a_node_with_its_name_and_colour() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("l.glb");
        let (one, none) = (source(tetrahedron()), source(TriMesh::default()));
        let joined = Joined::new(vec![&one, &none, &one]);
        let part = |label: f64, name: &str, triangles: u64, opacity: u8| SurfacePart {
            isovalue: label,
            vertices: triangles,
            triangles,
            label: Some(LabelStyle { name: name.into(), colour: [255, 0, 128, opacity] }),
        };
        let parts = vec![part(3.0, "Caudate", 4, 255), part(5.0, "", 0, 255), part(7.0, "", 4, 128)];
        let meta = SurfaceMeta { parts, ..SurfaceMeta::default() };
        write_surface(&joined, &path, SurfaceFormat::Glb, &meta).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        assert_eq!(json["nodes"].as_array().unwrap().len(), 2);
        assert_eq!(
            (&json["nodes"][0]["name"], &json["nodes"][1]["name"]),
            (&"Caudate".into(), &"label 7".into())
        );
        assert_eq!(json["nodes"][1]["extras"]["label"], 7.0);
        let colour = &json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"];
        assert_eq!(
            (colour[0].as_f64(), colour[1].as_f64(), colour[3].as_f64()),
            (Some(1.0), Some(0.0), Some(1.0))
        );
        assert_eq!(
            (&json["materials"][0]["alphaMode"], &json["materials"][1]["alphaMode"]),
            (&serde_json::Value::Null, &"BLEND".into())
        );
        assert_eq!(json["accessors"][3]["byteOffset"], 48);
        let both = read_surface(&path).unwrap();
        let mut expected = tetrahedron().triangles;
        expected.extend(tetrahedron().triangles.iter().map(|t| t.map(|v| v + 4)));
        assert_eq!((both.vertices.len(), both.triangles), (8, expected));
    }
}
