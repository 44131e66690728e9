//! Meshes of neuroglancer ("precomputed"), in its form of one resolution, written only: a folder.
//!
//! ```text
//! info                      {"@type": "neuroglancer_legacy_mesh", "segment_properties": ...}
//! segment_properties/info   the segments and their names
//! 7:0                       {"fragments": ["7.mesh"]}
//! 7.mesh                    u32 vertices, 3 × f32 each, then 3 × u32 a triangle; little-endian
//! ```
//!
//! A segment is a label, or one of the isovalues, which are numbered from 1 on. Coordinates are
//! nanometres, so the unit of length must be known. They are `f32`: a surface that is so far from
//! 0 that these do not tell its vertices apart is refused.
//!
//! The form of several resolutions is not written: its fragments are compressed by Draco.

use super::parts::{Part, TakeParts, each_part, parts_of};
use super::{SurfaceMeta, put_floats};
use crate::surface::SurfaceSource;
use crate::surface::weld::BuilderSettings;
use isospan_io::bytes::StagedFolder;
use isospan_io::bytes::publish::folder_of;
use isospan_io::bytes::read_whole;
use isospan_io::error::{Error, Result};
use serde::Serialize;
use serde_json::json;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// What `info` calls the folder.
const KIND: &str = "neuroglancer_legacy_mesh";
const PROPERTIES: &str = "segment_properties";
/// Powers of ten from a metre to a nanometre.
const NANO: i32 = 9;
/// The most bytes of an `info` of a folder that is replaced.
const MOST_INFO: u64 = 1 << 20;

/// Names of segments, as neuroglancer has them.
#[derive(Serialize)]
struct Properties {
    #[serde(rename = "@type")]
    kind: &'static str,
    inline: Inline,
}

#[derive(Serialize)]
struct Inline {
    ids: Vec<String>,
    properties: [Property; 1],
}

#[derive(Serialize)]
struct Property {
    id: &'static str,
    #[serde(rename = "type")]
    kind: &'static str,
    values: Vec<String>,
}

/// How many nanometres a unit of the surface is.
fn nanometres(meta: &SurfaceMeta) -> Result<f64> {
    let Some(unit) = &meta.units.length else {
        return Err(Error::usage(
            "neuroglancer has meshes in nanometres, and the unit of length of this archive is not known: \
             make the archive with `length_unit`, or write .glb",
        ));
    };
    let metres = unit.metres().and_then(|(n, power)| format!("{n}e{}", power + NANO).parse().ok());
    metres.ok_or_else(|| {
        Error::usage(format!(
            "neuroglancer has meshes in nanometres, which '{unit}' is not known in: make the archive with \
             `length_unit`, or write .glb"
        ))
    })
}

/// The numbers of segments of parts.
fn segments(parts: &[Part], meta: &SurfaceMeta) -> Result<Vec<u64>> {
    let segment = |part: &Part| {
        let Some(label) = meta.parts.get(part.number).filter(|_| meta.are_labels()) else {
            return Ok(part.number as u64 + 1);
        };
        let value = label.isovalue;
        if value < 0.0 {
            return Err(Error::usage(format!(
                "neuroglancer has segments from 0 on, and this surface the label {value}: write .glb"
            )));
        }
        Ok(value as u64)
    };
    let all: Vec<u64> = parts.iter().map(segment).collect::<Result<_>>()?;
    let mut sorted = all.clone();
    sorted.sort_unstable();
    match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        None => Ok(all),
        Some(pair) => Err(Error::usage(format!(
            "neuroglancer has one mesh for each segment, and this surface the label {} twice: write .glb",
            pair[0]
        ))),
    }
}

/// Refuses what the format cannot hold.
pub(in crate::files) fn check(source: &dyn SurfaceSource, meta: &SurfaceMeta) -> Result<()> {
    let [x, y, z] = source.origin();
    if source.origin() != [0.0; 3] {
        return Err(Error::usage(format!(
            "neuroglancer has f32 coordinates, which do not tell the vertices of a surface at {x}, {y}, {z} \
             apart: write .ply or .vtp"
        )));
    }
    if cfg!(windows) {
        return Err(Error::usage(
            "neuroglancer's meshes have files called 7:0, which Windows does not allow: write .glb",
        ));
    }
    segments(&parts_of(source, meta), meta)?;
    nanometres(meta).map(drop)
}

/// Writes a folder of meshes, and returns its bytes. It replaces one of this kind.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    path: &Path,
    meta: &SurfaceMeta,
    scratch: &BuilderSettings,
) -> Result<u64> {
    let refuse = |why: String| Error::usage(format!("cannot write {}: {why}", path.display()));
    let above = folder_of(path);
    if !above.is_dir() {
        return Err(refuse(format!("there is no folder {}; create it first", above.display())));
    }
    let parts = parts_of(source, meta);
    let segments = segments(&parts, meta)?;
    // It puts back what a run that was killed had moved.
    let stage = StagedFolder::begin(path)?;
    let is_replaced = || match path.symlink_metadata() {
        Err(_) => Ok(false),
        Ok(about) if about.is_dir() && is_ours(path) => Ok(true),
        Ok(_) => Err(refuse("it is there, and not a folder of neuroglancer's meshes alone".into())),
    };
    is_replaced()?;
    let folder = Folder { path: stage.new_folder(), bytes: 0 };
    let mut meshes =
        Meshes { folder, segments: segments.iter(), scale: nanometres(meta)?, file: None, buffer: vec![] };
    meshes.folder.put_info(&parts, &segments)?;
    each_part(source, &parts, scratch, path, &mut meshes)?;
    // Somebody may have put files there meanwhile.
    stage.publish(is_replaced()?)?;
    Ok(meshes.folder.bytes)
}

/// Whether a folder has such meshes, and nothing else that would be lost.
fn is_ours(folder: &Path) -> bool {
    let info = read_whole(&folder.join("info"), MOST_INFO).ok();
    let is_kind = info
        .and_then(|bytes| serde_json::from_slice::<serde_json::Value>(&bytes).ok())
        .is_some_and(|info| info["@type"] == KIND);
    let is_known = |name: &str, is_folder: bool| match name {
        PROPERTIES => is_folder,
        name => !is_folder && (name == "info" || is_of_segment(name)),
    };
    is_kind
        && has_only(folder, is_known)
        && has_only(&folder.join(PROPERTIES), |name, is_folder| name == "info" && !is_folder)
}

/// Whether a name is `7:0` or `7.mesh`.
fn is_of_segment(name: &str) -> bool {
    let number = name.strip_suffix(":0").or_else(|| name.strip_suffix(".mesh"));
    number.is_some_and(|number| number.parse::<u64>().is_ok())
}

/// Whether all that is in a folder is known by its name, and whether it is a folder.
fn has_only(folder: &Path, is_known: impl Fn(&str, bool) -> bool) -> bool {
    let Ok(entries) = fs::read_dir(folder) else { return false };
    let is_one = |entry: fs::DirEntry| {
        let is_folder = entry.file_type().ok()?.is_dir();
        Some(is_known(entry.file_name().to_str()?, is_folder))
    };
    entries.map(|entry| entry.ok().and_then(is_one)).all(|is_known| is_known == Some(true))
}

/// The folder on its way.
struct Folder {
    path: PathBuf,
    bytes: u64,
}

impl Folder {
    fn create(&self, name: &str) -> Result<(PathBuf, File)> {
        let path = self.path.join(name);
        let file = File::create_new(&path).map_err(|e| Error::io("create", &path, e))?;
        Ok((path, file))
    }

    fn put(&mut self, name: &str, bytes: &[u8]) -> Result<()> {
        let (path, mut file) = self.create(name)?;
        let written = file.write_all(bytes).and_then(|()| file.sync_all());
        self.bytes += bytes.len() as u64;
        written.map_err(|e| Error::io("write", path, e))
    }

    fn put_info(&mut self, parts: &[Part], segments: &[u64]) -> Result<()> {
        let of_names = self.path.join(PROPERTIES);
        fs::create_dir(&of_names).map_err(|e| Error::io("create the folder", of_names, e))?;
        let info = json!({ "@type": KIND, PROPERTIES: PROPERTIES });
        self.put("info", format!("{info}\n").as_bytes())?;
        let values = parts.iter().map(|part| part.name.clone()).collect();
        let properties = [Property { id: "label", kind: "label", values }];
        let inline = Inline { ids: segments.iter().map(u64::to_string).collect(), properties };
        let text = serde_json::to_string(&Properties { kind: "neuroglancer_segment_properties", inline });
        let text = text.map_err(|e| Error::io("write", &self.path, e.into()))?;
        self.put(&format!("{PROPERTIES}/info"), format!("{text}\n").as_bytes())
    }
}

/// Writes the mesh of each part.
struct Meshes<'a> {
    folder: Folder,
    segments: std::slice::Iter<'a, u64>,
    scale: f64,
    file: Option<(PathBuf, BufWriter<File>)>,
    buffer: Vec<u8>,
}

impl Meshes<'_> {
    /// Appends what the buffer has to the file.
    fn flush(&mut self) -> Result<()> {
        if let Some((path, file)) = &mut self.file {
            file.write_all(&self.buffer).map_err(|e| Error::io("write", path, e))?;
        }
        self.folder.bytes += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }
}

impl TakeParts for Meshes<'_> {
    fn begin(&mut self, part: &Part) -> Result<()> {
        let segment = self.segments.next().expect("each part has a segment");
        let name = format!("{segment}.mesh");
        self.folder
            .put(&format!("{segment}:0"), format!("{}\n", json!({ "fragments": [name] })).as_bytes())?;
        let (path, file) = self.folder.create(&name)?;
        self.file = Some((path, BufWriter::new(file)));
        self.buffer.extend_from_slice(&(part.vertices as u32).to_le_bytes());
        self.flush()
    }

    fn vertices(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        for position in positions {
            put_floats(&mut self.buffer, position.map(|x| (f64::from(x) * self.scale) as f32));
        }
        self.flush()
    }

    fn triangles(&mut self, _: &Part, triangles: &[[u32; 3]]) -> Result<()> {
        triangles.iter().flatten().for_each(|v| self.buffer.extend_from_slice(&v.to_le_bytes()));
        self.flush()
    }

    fn end(&mut self) -> Result<()> {
        let Some((path, file)) = self.file.take() else { return Ok(()) };
        let file = file.into_inner().map_err(|e| Error::io("write", &path, e.into_error()))?;
        file.sync_all().map_err(|e| Error::io("write", &path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::labels::LabelStyle;
    use crate::files::surface::tests::{far_tetrahedron, source};
    use crate::files::surface::{SurfaceFormat, SurfacePart, stream_surface, write_surface};
    use crate::surface::{Joined, TriMesh};
    use isospan_io::volume::units::{Unit, Units};

    fn near() -> TriMesh {
        TriMesh { origin: [0.0; 3], ..far_tetrahedron() }
    }

    fn micrometres() -> SurfaceMeta {
        SurfaceMeta { units: Units::of_length(Unit::length("um")), ..SurfaceMeta::default() }
    }

    #[cfg(unix)]
    #[test]
    fn each_label_is_a_segment_in_nanometres() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.precomputed");
        let (a, none, b) = (source(near()), source(TriMesh::default()), source(near()));
        let joined = Joined::new(vec![&a, &none, &b]);
        let part = |label: f64, name: &str, n: u64| {
            let label_style = LabelStyle { name: name.into(), colour: [0; 4] };
            SurfacePart { isovalue: label, vertices: n, triangles: n, label: Some(label_style) }
        };
        let parts = vec![part(3.0, "Left \"A\"", 4), part(5.0, "none", 0), part(7.0, "", 4)];
        let meta = SurfaceMeta { parts, ..micrometres() };
        // A second time, in the place of the first.
        for _ in 0..2 {
            let bytes = write_surface(&joined, &path, SurfaceFormat::Neuroglancer, &meta).unwrap();
            let text = |name: &str| fs::read_to_string(path.join(name)).unwrap();
            let json = |name: &str| serde_json::from_str::<serde_json::Value>(&text(name)).unwrap();
            assert_eq!(json("info")["@type"], KIND);
            let names = json("segment_properties/info");
            assert_eq!(names["inline"]["ids"], json!(["3", "7"]));
            assert_eq!(names["inline"]["properties"][0]["values"], json!(["Left \"A\"", "label 7"]));
            assert_eq!(json("7:0"), json!({ "fragments": ["7.mesh"] }));
            let mesh = fs::read(path.join("7.mesh")).unwrap();
            assert_eq!(mesh, fs::read(path.join("3.mesh")).unwrap());
            assert_eq!((mesh.len(), &mesh[..4]), (4 + 4 * 12 + 4 * 12, &[4, 0, 0, 0][..]));
            assert_eq!(mesh[4..8], 125f32.to_le_bytes());
            let corners: Vec<u8> = near().triangles.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
            assert_eq!(mesh[4 + 48..], corners);
            let all = ["info", "segment_properties/info", "3:0", "3.mesh", "7:0", "7.mesh"];
            let sizes: u64 = all.map(|name| fs::metadata(path.join(name)).unwrap().len()).iter().sum();
            assert_eq!((bytes, fs::read_dir(&path).unwrap().count()), (sizes, 6));
        }
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        // What somebody keeps beside the meshes is not lost.
        fs::write(path.join("photo.jpg"), "mine").unwrap();
        let error = write_surface(&joined, &path, SurfaceFormat::Neuroglancer, &meta).unwrap_err();
        assert!(error.to_string().contains("meshes alone"), "{error}");
        assert_eq!(fs::read_dir(&path).unwrap().count(), 7);
    }

    #[test]
    fn what_neuroglancer_does_not_have_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.precomputed");
        let refused = |mesh: TriMesh, meta: &SurfaceMeta, says: &str| {
            let error = write_surface(&source(mesh), &path, SurfaceFormat::Neuroglancer, meta).unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains(says), "{error}");
        };
        refused(near(), &SurfaceMeta::default(), "the unit of length of this archive is not known");
        let parsecs = SurfaceMeta { units: Units::of_length(Unit::new("pc")), ..SurfaceMeta::default() };
        refused(near(), &parsecs, "'pc'");
        refused(far_tetrahedron(), &micrometres(), "at 448262.5, -5411932.25, 310");
        let label = Some(LabelStyle { name: String::new(), colour: [0; 4] });
        let parts = vec![SurfacePart { isovalue: -2.0, vertices: 4, triangles: 4, label }];
        refused(near(), &SurfaceMeta { parts, ..micrometres() }, "the label -2");
        fs::create_dir(&path).unwrap();
        refused(near(), &micrometres(), "not a folder of neuroglancer's meshes alone");
        let scratch = BuilderSettings::default();
        let mut none = |_: &[u8]| Ok(());
        let near = source(near());
        let error = stream_surface(&near, SurfaceFormat::Neuroglancer, &micrometres(), &scratch, &mut none);
        assert!(error.unwrap_err().to_string().contains("a folder"));
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
