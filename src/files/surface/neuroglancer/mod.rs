//! Meshes of neuroglancer ("precomputed") of several resolutions, written only: a folder.
//!
//! ```text
//! info                      {"@type": "neuroglancer_multilod_draco", "transform": ...}
//! segment_properties/info   the segments and their names
//! 0.shard                   of each segment fragments, coded by Draco, and then its manifest: the
//!                           cells of each level of detail, and the bytes of their fragments
//! ```
//!
//! A segment is a label, or one of the isovalues, which are numbered from 1 on. The transform makes
//! nanometres of coordinates, so the unit of length must be known, and adds the origin.
//! neuroglancer fetches the cells that are in view, each in the level that the screen shows.

mod cut;
mod draco;
mod levels;
mod shard;

use super::SurfaceMeta;
use super::parts::{PartRange, TakeParts, each_part, parts_of};
use crate::surface::weld::StoredSurface;
use crate::surface::{SurfaceSource, Vertex};
use isospan_io::bytes::StagedFolder;
use isospan_io::bytes::publish::folder_of;
use isospan_io::bytes::read_whole;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Resources, pool};
use levels::{WriterMeans, least_memory, write_levels};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::json;
use shard::Shard;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

/// What `info` calls the folder.
const KIND: &str = "neuroglancer_multilod_draco";
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

/// The first three rows of the matrix from coordinates of the meshes to nanometres.
fn transform(source: &dyn SurfaceSource, meta: &SurfaceMeta) -> Result<Vec<f64>> {
    let scale = nanometres(meta)?;
    let row = |k: usize| {
        let mut row = [0.0; 4];
        (row[k], row[3]) = (scale, scale * source.origin()[k]);
        row
    };
    Ok((0..3).flat_map(row).collect())
}

/// The numbers of segments of parts.
fn segments(parts: &[PartRange], meta: &SurfaceMeta) -> Result<Vec<u64>> {
    let segment = |part: &PartRange| {
        let Some(label) = meta.parts.get(part.number).filter(|_| meta.are_labels()) else {
            return Ok(part.number as u64 + 1);
        };
        let value = label.isovalue;
        if value < 1.0 {
            return Err(Error::usage(format!(
                "neuroglancer has segments from 1 on, and this surface the label {value}: write .glb"
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
    segments(&parts_of(source, meta), meta)?;
    nanometres(meta).map(drop)
}

/// Writes a folder of meshes, and returns its bytes. It replaces one of this kind.
pub(in crate::files) fn write(
    source: &dyn SurfaceSource,
    path: &Path,
    meta: &SurfaceMeta,
    resources: &Resources,
) -> Result<u64> {
    let refuse = |why: String| Error::usage(format!("cannot write {}: {why}", path.display()));
    let above = folder_of(path);
    if !above.is_dir() {
        return Err(refuse(format!("there is no folder {}; create it first", above.display())));
    }
    let parts = parts_of(source, meta);
    let segments = segments(&parts, meta)?;
    let least = least_memory(parts.iter().map(|part| part.triangles).max().unwrap_or(0));
    if resources.memory < least {
        return Err(Error::memory("for levels of detail of a mesh", least, resources.memory));
    }
    // It puts back what a run that was killed had moved.
    let stage = StagedFolder::begin(path)?;
    let is_replaced = || match path.symlink_metadata() {
        Err(_) => Ok(false),
        Ok(about) if about.is_dir() && is_ours(path) => Ok(true),
        Ok(_) => Err(refuse("it is there, and not a folder of neuroglancer's meshes alone".into())),
    };
    is_replaced()?;
    let mut folder = Folder { path: stage.new_folder(), bytes: 0 };
    let means = WriterMeans {
        // The other half holds the surface.
        memory: resources.memory / 2,
        held: usize::try_from(resources.memory / 16).unwrap_or(usize::MAX),
        scratch: resources.scratch.clone().unwrap_or_else(|| above.to_path_buf()),
        pool: pool(resources.threads)?,
        cancel: resources.cancel.clone(),
        target: path,
    };
    let (shard, file) = folder.create(shard::NAME)?;
    let shard = Shard::begin(shard, file, segments.len())?;
    let mut meshes = Meshes {
        shard,
        segments: segments.iter(),
        means: &means,
        mesh: None,
        waiting: vec![],
        held: 0,
        written: BTreeSet::new(),
    };
    each_part(source, &parts, &means.store(), path, &mut meshes)
        .and_then(|()| meshes.write_waiting())
        .map_err(|e| e.of_share(means.memory, resources.memory))?;
    folder.bytes += meshes.shard.finish()?;
    folder.put_info(&transform(source, meta)?, segments.len())?;
    let named = segments.iter().zip(&parts).filter(|(segment, _)| meshes.written.contains(segment));
    folder.put_names(&named.collect::<Vec<_>>())?;
    // Somebody may have put files there meanwhile.
    stage.publish(is_replaced()?)?;
    Ok(folder.bytes)
}

/// Whether a folder has such meshes, and nothing else that would be lost.
fn is_ours(folder: &Path) -> bool {
    let info = read_whole(&folder.join("info"), MOST_INFO).ok();
    let is_kind = info
        .and_then(|bytes| serde_json::from_slice::<serde_json::Value>(&bytes).ok())
        .is_some_and(|info| info["@type"] == KIND);
    let is_known = |name: &str, is_folder: bool| match name {
        PROPERTIES => is_folder,
        name => !is_folder && (name == "info" || name == shard::NAME),
    };
    is_kind
        && has_only(folder, is_known)
        && has_only(&folder.join(PROPERTIES), |name, is_folder| name == "info" && !is_folder)
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

    /// Writes what the meshes are, of this many segments.
    fn put_info(&mut self, transform: &[f64], segments: usize) -> Result<()> {
        let info = json!({
            "@type": KIND,
            "vertex_quantization_bits": 16,
            "lod_scale_multiplier": 1,
            "transform": transform,
            "sharding": shard::sharding(segments),
            PROPERTIES: PROPERTIES,
        });
        self.put("info", format!("{info}\n").as_bytes())
    }

    /// Writes the names of segments.
    fn put_names(&mut self, segments: &[(&u64, &PartRange)]) -> Result<()> {
        let of_names = self.path.join(PROPERTIES);
        fs::create_dir(&of_names).map_err(|e| Error::io("create the folder", of_names, e))?;
        let values = segments.iter().map(|(_, part)| part.name.clone()).collect();
        let properties = [Property { id: "label", kind: "label", values }];
        let inline = Inline { ids: segments.iter().map(|(id, _)| id.to_string()).collect(), properties };
        let text = serde_json::to_string(&Properties { kind: "neuroglancer_segment_properties", inline });
        let text = text.map_err(|e| Error::io("write", &self.path, e.into()))?;
        self.put(&format!("{PROPERTIES}/info"), format!("{text}\n").as_bytes())
    }
}

/// Writes the mesh of each part.
struct Meshes<'a> {
    shard: Shard,
    segments: std::slice::Iter<'a, u64>,
    means: &'a WriterMeans<'a>,
    /// The segment that comes, and what is there of its mesh.
    mesh: Option<(u64, StoredSurface)>,
    /// Small meshes, and their triangles.
    waiting: Vec<(u64, StoredSurface)>,
    held: u64,
    /// Segments that have a mesh.
    written: BTreeSet<u64>,
}

/// A mesh of no more triangles waits, to be coded beside others.
const SMALL: u64 = 1 << 14;
/// Bytes for each of its triangles, while it waits and is coded.
const OF_SMALL: u64 = 1 << 10;

impl Meshes<'_> {
    /// Writes the meshes that wait.
    fn write_waiting(&mut self) -> Result<()> {
        self.held = 0;
        let (waiting, means) = (std::mem::take(&mut self.waiting), self.means);
        let code = |(segment, mesh)| {
            let mut fragments = vec![];
            let mut put = |fragment: &[u8]| {
                fragments.extend_from_slice(fragment);
                Ok(())
            };
            let manifest = write_levels(mesh, means, &mut put)?;
            Ok((segment, fragments, manifest))
        };
        let coded: Vec<_> = means.pool.install(|| waiting.into_par_iter().map(code).collect());
        for one in coded {
            let (segment, fragments, manifest) = one?;
            self.shard.put(&fragments)?;
            self.end_segment(segment, manifest)?;
        }
        Ok(())
    }

    fn end_segment(&mut self, segment: u64, manifest: Option<Vec<u8>>) -> Result<()> {
        let Some(manifest) = manifest else { return Ok(()) };
        self.written.insert(segment);
        self.shard.end_segment(segment, &manifest)
    }

    fn mesh(&mut self) -> &mut StoredSurface {
        &mut self.mesh.as_mut().expect("a part was begun").1
    }
}

impl TakeParts for Meshes<'_> {
    fn begin(&mut self, _: &PartRange) -> Result<()> {
        let segment = *self.segments.next().expect("each part has a segment");
        self.mesh = Some((segment, StoredSurface::new(&self.means.store())));
        Ok(())
    }

    fn vertices(&mut self, positions: &[[f32; 3]]) -> Result<()> {
        self.means.cancel.check()?;
        let vertex = |&position| Vertex { position, normal: [0.0; 3] };
        let mesh = self.mesh();
        positions.iter().try_for_each(|position| mesh.push_vertex(vertex(position)))
    }

    fn triangles(&mut self, _: &PartRange, triangles: &[[u32; 3]]) -> Result<()> {
        self.means.cancel.check()?;
        let mesh = self.mesh();
        triangles.iter().try_for_each(|&triangle| mesh.push_triangle(triangle))
    }

    fn end(&mut self) -> Result<()> {
        let Some((segment, mesh)) = self.mesh.take() else { return Ok(()) };
        let triangles = mesh.triangle_count().max(16);
        let is_small = triangles <= SMALL;
        if !is_small || (self.held + triangles) * OF_SMALL > self.means.memory / 2 {
            self.write_waiting()?;
        }
        if is_small {
            self.held += triangles;
            self.waiting.push((segment, mesh));
            return Ok(());
        }
        let manifest = write_levels(mesh, self.means, &mut |fragment| self.shard.put(fragment))?;
        self.end_segment(segment, manifest)
    }
}

#[cfg(test)]
mod tests;
