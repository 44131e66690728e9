//! Grids with coordinates of their own: into the archive, and onto what comes out of it.
//!
//! A surface is extracted in index space, like any, and placed while it is written: vertices by the trilinear map of
//! their cell, normals as covectors. Its triangles are turned over where most cells mirror.

use super::layout::Layout;
use super::open::OpenArchive;
use super::plan::Plan;
use crate::archive::coordinates::{self, CoordinateMap, Coordinates};
use crate::archive::manifest::CoordinateRecord;
use crate::error::{Error, Result};
use crate::formats::coordinates::GridCoordinates;
use crate::formats::{OpenOptions, open_coordinates};
use crate::grid::Geometry;
use crate::surface::{SurfaceSource, TriMesh, Vertex, WorldMap};
use std::path::Path;

/// Copies the coordinates of the input into the archive, where it has some, and counts bad cells.
pub(super) fn write_coordinates(
    input: &Path,
    options: &OpenOptions,
    plan: &Plan,
    layout: &Layout,
) -> Result<Option<CoordinateRecord>> {
    let Some(found) = open_coordinates(input, options)? else { return Ok(None) };
    let (path, hash, dims) = (layout.coordinates(), plan.step_hash(), plan.step.source.dims);
    let info = match found {
        GridCoordinates::Axes(axes) => {
            axes.iter().try_for_each(|axis| finite(input, axis, 0))?;
            coordinates::write(&path, hash, dims, Coordinates::Axes(axes))?
        }
        GridCoordinates::Points(mut stream) => {
            let mut at = 0;
            let mut next = |out: &mut [f64]| {
                stream.fill(out)?;
                finite(input, out, at)?;
                at += out.len() as u64 / 3;
                Ok(())
            };
            let info = coordinates::write(&path, hash, dims, Coordinates::Points(&mut next))?;
            stream.finish()?;
            info
        }
    };
    let cells = CoordinateMap::open(&path, hash, dims)?.count_cells()?;
    Ok(Some(CoordinateRecord { info, cells }))
}

fn finite(input: &Path, numbers: &[f64], first: u64) -> Result<()> {
    match numbers.iter().position(|x| !x.is_finite()) {
        None => Ok(()),
        Some(bad) => {
            let at = format!("coordinates, from sample {first} on");
            Err(Error::bad_input(input, at, "finite numbers", numbers[bad].to_string()))
        }
    }
}

/// The map of what is extracted: to the world, or where coordinates are to be applied, to index space.
pub(super) fn world_map(archive: &OpenArchive) -> WorldMap {
    let step = archive.step();
    let geometry = if step.coordinates.is_some() { Geometry::default() } else { step.plan.source.geometry };
    WorldMap::new(&archive.manifest.plan.lattice, &geometry)
}

/// Hands a surface that was extracted with [`world_map`] to `use_it`, in the world.
pub(super) fn in_world<T>(
    archive: &OpenArchive,
    surface: &dyn SurfaceSource,
    use_it: impl FnOnce(&dyn SurfaceSource) -> Result<T>,
) -> Result<T> {
    match (archive.coordinates()?, &archive.step().coordinates) {
        (Some(map), Some(record)) => use_it(&Placed { surface, map, mirrored: record.cells.mirrored }),
        _ => use_it(surface),
    }
}

/// A surface of index space in the world.
struct Placed<'a> {
    surface: &'a dyn SurfaceSource,
    map: CoordinateMap,
    mirrored: bool,
}

impl Placed<'_> {
    fn vertex(&self, v: &Vertex) -> Result<Vertex> {
        let placed = self.map.place(v.position.map(f64::from))?;
        let w = placed.direction(v.normal.map(f64::from));
        // Scaled by the largest component first, lest squares overflow or vanish.
        let largest = w.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        let normal = if largest > 0.0 && largest.is_finite() {
            let w = w.map(|x| x / largest);
            let length = w.iter().map(|x| x * x).sum::<f64>().sqrt();
            w.map(|x| (x / length) as f32)
        } else {
            // A cell without a volume has no direction; a unit vector is what readers expect.
            v.normal
        };
        Ok(Vertex { position: placed.position.map(|x| x as f32), normal })
    }
}

impl SurfaceSource for Placed<'_> {
    fn vertex_count(&self) -> u64 {
        self.surface.vertex_count()
    }

    fn triangle_count(&self) -> u64 {
        self.surface.triangle_count()
    }

    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
        let mut placed = vec![];
        self.surface.vertices(&mut |batch| {
            placed.clear();
            for vertex in batch {
                placed.push(self.vertex(vertex)?);
            }
            each(&placed)
        })
    }

    fn triangles(&self, each: &mut dyn FnMut(&[[u32; 3]]) -> Result<()>) -> Result<()> {
        if !self.mirrored {
            return self.surface.triangles(each);
        }
        let mut turned = vec![];
        self.surface.triangles(&mut |batch| {
            turned.clear();
            turned.extend(batch.iter().map(|&[a, b, c]| [a, c, b]));
            each(&turned)
        })
    }
}

/// A surface in memory, in the world.
pub(super) fn in_memory(archive: &OpenArchive, surface: &dyn SurfaceSource) -> Result<TriMesh> {
    in_world(archive, surface, TriMesh::from_source)
}
