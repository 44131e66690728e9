//! GLB: glTF 2.0 in one binary file (Khronos Group, ISO/IEC 12113).
//!
//! ```text
//! 0    "glTF", u32 version 2, u32 bytes of the file
//! 12   u32 length, "JSON", a JSON text padded with spaces to a multiple of 4
//!      u32 length, "BIN\0":
//!        positions  3 × f32 a vertex      compressed: 3 × u16, padded to 8 bytes
//!        normals    3 × f32 a vertex                  3 × i8, padded to 4 bytes
//!        colours    4 × u8 a vertex       of a surface with values
//!        values     f32 a vertex
//!        indices    3 × u32 a triangle                u16 where all of them are below 65535
//! ```
//!
//! We write a mesh of one primitive (triangles) and a node for each surface of the file;
//! everything is little-endian. The JSON text names the runs of bytes. It also has the least and
//! the largest position of each mesh, as the format demands: this takes one more pass over the
//! vertices before the first byte is written. The isovalue, units, time and comments are
//! `asset.extras`. A surface without triangles is a scene without a mesh, as glTF has no empty
//! arrays. The material is not metallic and has two sides.
//!
//! **Metres, y up.** glTF demands both. Where the unit of length is known, the node has the
//! transform from world coordinates, z up, to them: (x, y, z) in mm is (x, z, -y) / 1000.
//! Without a unit coordinates are as they are. A surface that is far from 0 has its origin in the
//! transform of its node. What is added for compression (`KHR_mesh_quantization`) is there, too.
//! `extras.world` of the node has the way to world coordinates alone, for our reader.
//!
//! **Coded.** With `EXT_meshopt_compression` each run of bytes is coded (`encode`), to about a
//! quarter of the plain bytes: browsers decode it fast, and programs that do not know it refuse
//! the file. The lengths of what is coded stand before it, so it waits in memory, and beyond that
//! on disk. Triangles keep their order, and may begin at another corner.
//!
//! All lengths are 32 bits wide, so a file ends at 4 GiB: about 89 million vertices with twice as
//! many triangles. Larger surfaces are refused before a byte is written.
//!
//! We read the triangles of all meshes, as stored, in place: only the tree of the JSON text,
//! usually a few KiB, is in memory. The translation of a node without a parent or children counts;
//! of a file that we wrote, `extras.world` in place of its transform. Files whose true shape needs
//! more than this are refused: other node transforms, sparse accessors, data in other files, other
//! required extensions, strips and fans. What is coded is decoded into memory before. Primitives
//! that are points or lines are skipped.

mod coded;
mod decode;
mod encode;
mod read;
mod write;

pub(in crate::files) use read::read;
pub(in crate::files) use write::{check_limits, write};

const MAGIC: &[u8; 4] = b"glTF";
const JSON: u32 = u32::from_le_bytes(*b"JSON");
const BIN: u32 = u32::from_le_bytes(*b"BIN\0");
/// Bytes of the file's head, and of a chunk's.
const HEAD: u64 = 12;
const CHUNK_HEAD: u64 = 8;
/// Numbers of the format.
const BYTE: u64 = 5120;
const UNSIGNED_BYTE: u64 = 5121;
const SHORT: u64 = 5122;
const UNSIGNED_SHORT: u64 = 5123;
const UNSIGNED_INT: u64 = 5125;
const FLOAT: u64 = 5126;
const TRIANGLES: u64 = 4;
const ARRAY_BUFFER: u64 = 34962;
const ELEMENT_ARRAY_BUFFER: u64 = 34963;
/// The extension that has positions of 16 bits.
const QUANTIZATION: &str = "KHR_mesh_quantization";
/// The extension that codes arrays.
const MESHOPT: &str = "EXT_meshopt_compression";
/// How the names of programs begin that write what `extras.world` says.
const GENERATOR: &str = "isospan ";

/// How the arrays of a GLB are made small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// They are not: positions and normals of 32 bits.
    #[default]
    None,
    /// Positions of 16 bits and normals of 8 (`KHR_mesh_quantization`): about half the bytes.
    Quantized,
    /// These and all indices, coded (`EXT_meshopt_compression`): about a quarter of the bytes.
    Meshopt,
}

impl Compression {
    fn is_quantized(self) -> bool {
        self != Self::None
    }

    fn is_coded(self) -> bool {
        self == Self::Meshopt
    }

    /// The extensions of glTF that it needs.
    fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::None => &[],
            Self::Quantized => &[QUANTIZATION],
            Self::Meshopt => &[QUANTIZATION, MESHOPT],
        }
    }
}

impl From<bool> for Compression {
    fn from(is_wanted: bool) -> Self {
        if is_wanted { Self::Quantized } else { Self::None }
    }
}

/// Whether a file begins like a GLB.
pub(in crate::files) fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::labels::LabelStyle;
    use crate::files::surface::tests::{far_tetrahedron, source, tetrahedron};
    use crate::files::surface::{
        ReadLimits, SurfaceFormat, SurfaceMeta, SurfacePart, VertexValues, read_surface, write_surface,
    };
    use crate::surface::Joined;
    use crate::surface::TriMesh;
    use crate::surface::check::CheckSettings;
    use crate::surface::weld::{BuilderSettings, StoredSurface};
    use isospan_io::error::{Error, Result};
    use isospan_io::exec::Resources;
    use isospan_io::fixtures::survive;
    use isospan_io::volume::units::{Unit, Units};
    use serde_json::Value;
    use std::path::Path;

    fn read(path: &Path, bytes: &[u8]) -> Result<TriMesh> {
        let mut out = StoredSurface::new(&BuilderSettings::default());
        super::read(path, bytes, &ReadLimits::of(&CheckSettings::default()), &mut out)?;
        out.settle()?;
        TriMesh::from_source(&out)
    }

    fn written(mesh: TriMesh) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.glb");
        let meta = SurfaceMeta {
            isovalue: Some(-1.5),
            comments: vec!["of a \"b\"".into()],
            ..SurfaceMeta::default()
        };
        write_surface(&source(mesh), &path, SurfaceFormat::Glb, &meta, &Resources::default()).unwrap();
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
    fn a_known_unit_is_metres_with_y_up() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.glb");
        for compress in [Compression::None, Compression::Quantized, Compression::Meshopt] {
            let units = Units::of_length(Unit::length("mm"));
            let meta = SurfaceMeta { units, compress, ..SurfaceMeta::default() };
            let mesh = far_tetrahedron();
            write_surface(&source(mesh.clone()), &path, SurfaceFormat::Glb, &meta, &Resources::default())
                .unwrap();
            let bytes = std::fs::read(&path).unwrap();
            let json = json_of(&bytes);
            let m: Vec<f64> =
                json["nodes"][0]["matrix"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
            let [_, hi] =
                ["min", "max"].map(|end| [0, 1, 2].map(|k| json["accessors"][0][end][k].as_f64().unwrap()));
            // The largest corner of the box of positions in the file.
            let found = [0, 1, 2].map(|r| m[r] * hi[0] + m[4 + r] * hi[1] + m[8 + r] * hi[2] + m[12 + r]);
            let world = [0.375, 0.375, 0.375];
            let [x, y, z] = [0, 1, 2].map(|k| (mesh.origin[k] + world[k]) / 1000.0);
            for (a, b) in found.iter().zip([x, z, -y]) {
                assert!((a - b).abs() < 1e-6, "{compress:?} {found:?} {x} {y} {z}");
            }
            let material = &json["materials"][0];
            assert_eq!(material["doubleSided"], true);
            assert_eq!(material["pbrMetallicRoughness"]["metallicFactor"], 0.0);
        }
    }

    #[test]
    fn compressed_positions_are_near() {
        let mesh = far_tetrahedron();
        let all = [Compression::None, Compression::Quantized, Compression::Meshopt];
        let [plain, packed, coded] = all.map(|compress| {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("t.glb");
            let meta = SurfaceMeta { compress, ..SurfaceMeta::default() };
            write_surface(&source(mesh.clone()), &path, SurfaceFormat::Glb, &meta, &Resources::default())
                .unwrap();
            std::fs::read(path).unwrap()
        });
        assert_eq!(json_of(&packed)["buffers"][0]["byteLength"], 4 * 12 + 4 * 6);
        assert_eq!(json_of(&coded)["buffers"][1]["byteLength"], 4 * 12 + 4 * 6);
        assert_eq!(json_of(&plain)["buffers"][0]["byteLength"], 4 * 24 + 4 * 12);
        let back = read(Path::new("f"), &packed).unwrap();
        assert_eq!(back.triangles, mesh.triangles);
        // Half a step of the longest edge of the box.
        let most = 0.875 / 65535.0 / 2.0 + 1e-9;
        for (found, right) in back.vertices.iter().zip(&mesh.vertices) {
            let [a, b] = [found.world(back.origin), right.world(mesh.origin)];
            assert!((0..3).all(|k| (a[k] - b[k]).abs() <= most), "{a:?} {b:?}");
            assert_eq!(found.normal, right.normal);
        }
        let decoded = read(Path::new("f"), &coded).unwrap();
        assert_eq!(decoded.vertices, back.vertices);
        let turned = |&[a, b, c]: &[u32; 3]| [[a, b, c], [b, c, a], [c, a, b]].into_iter().min();
        let of = |mesh: &TriMesh| mesh.triangles.iter().map(turned).collect::<Vec<_>>();
        assert_eq!(of(&decoded), of(&mesh));
        survive(&coded, |b| drop(read(Path::new("f"), b)));
    }

    #[test]
    fn all_that_a_vertex_has_is_coded() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.glb");
        let mut values =
            VertexValues::new("f", [0.0, 1.0], crate::render::ColourMap::Grey, 1 << 10, dir.path()).unwrap();
        values.extend(&[0.0, 1.0, 0.5, f32::NAN]).unwrap();
        let values = Some(std::sync::Arc::new(values));
        let meta = SurfaceMeta { compress: Compression::Meshopt, values, ..SurfaceMeta::default() };
        write_surface(&source(tetrahedron()), &path, SurfaceFormat::Glb, &meta, &Resources::default())
            .unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let (json, text) = (json_of(&bytes), u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize);
        let bin = &bytes[20 + text + 8..];
        assert_eq!(json["bufferViews"].as_array().unwrap().len(), 5);
        let coded = &json["bufferViews"][3]["extensions"][MESHOPT];
        let of = |name: &str| coded[name].as_u64().unwrap() as usize;
        let found = decode::attributes(&bin[of("byteOffset")..][..of("byteLength")], 4, of("byteStride"));
        let right: Vec<u8> = [0.0f32, 1.0, 0.5, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(found.unwrap(), right);
        assert_eq!(u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize, bytes.len());
        // An accessor that lies beyond what was decoded, another mode, and a filter are refused.
        for (from, to) in [
            ("\"count\":12", "\"count\":15"),
            ("TRIANGLES", "INDICES"),
            ("\"mode\":\"ATTRIBUTES\"", "\"mode\":\"ATTRIBUTES\",\"filter\":\"OCTAHEDRAL\""),
            ("\"byteStride\":8,\"count\":4", "\"byteStride\":8,\"count\":9"),
        ] {
            let right = std::str::from_utf8(&bytes[20..20 + text]).unwrap();
            let bad = right.replacen(from, to, 1);
            assert_ne!(right, bad, "{from}");
            read(Path::new("f"), &glb(bad.trim_end(), bin)).unwrap_err();
        }
    }

    #[test]
    fn several_isovalues_are_nodes_of_their_own() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.glb");
        let (a, b) = (source(far_tetrahedron()), source(far_tetrahedron()));
        let part = |isovalue, vertices, triangles| SurfacePart { isovalue, vertices, triangles, label: None };
        let parts = vec![part(0.5, 4, 4), part(0.75, 0, 0), part(1.0, 4, 4)];
        let meta = SurfaceMeta { parts, ..SurfaceMeta::default() };
        write_surface(&Joined::new(vec![&a, &b]), &path, SurfaceFormat::Glb, &meta, &Resources::default())
            .unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let json = json_of(&bytes);
        let names: Vec<&Value> = json["nodes"].as_array().unwrap().iter().map(|n| &n["name"]).collect();
        assert_eq!(names, ["isovalue 0.5", "isovalue 1"]);
        let back = read(Path::new("f"), &bytes).unwrap();
        assert_eq!((back.vertices.len(), back.triangles.len()), (8, 8));
        assert_eq!(
            back.triangles[4..],
            back.triangles[..4].iter().map(|t| t.map(|v| v + 4)).collect::<Vec<_>>()
        );
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
        write_surface(&joined, &path, SurfaceFormat::Glb, &meta, &Resources::default()).unwrap();
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
