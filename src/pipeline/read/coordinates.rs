//! Coordinates of rectilinear and curvilinear grids: stored in the archive, and applied to output.
//!
//! A surface is extracted in index space, as any other, and placed while it is written. Vertices
//! follow the trilinear map of their cell, normals transform as covectors. Triangles are turned
//! over where most cells mirror.

use super::region::{Roi, RoiSpace, domain_hull, scale_of};
use super::step_view::StepView;
use crate::archive::manifest::CoordinateRecord;
use crate::archive::tables::{self, CellBoxes, CoordinateMap, Coordinates};
use crate::pipeline::plan::{Layout, Plan};
use crate::surface::edit::clip::HalfSpace;
use crate::surface::weld::StoredSurface;
use crate::surface::{SurfaceSource, TriMesh, Vertex, WorldMap, nearby_origin, relative_to};
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::formats::StepSource;
use isospan_io::formats::coordinates::GridCoordinates;
use isospan_io::grid::Geometry;
use std::path::Path;
use xxhash_rust::xxh3::Xxh3;

/// Copies the coordinates of the first step of the plan into the archive, where it has some, and
/// counts bad cells.
pub(in crate::pipeline) fn write_coordinates(
    source: &StepSource,
    plan: &Plan,
    layout: &Layout,
) -> Result<Option<CoordinateRecord>> {
    let input = &source.path;
    let Some(found) = source.coordinates()? else { return Ok(None) };
    let step = plan.first();
    let (path, hash, dims) = (layout.at(step.number).coordinates(), plan.step_hash(0), step.source.dims);
    let info = match found {
        GridCoordinates::Axes(axes) => {
            axes.iter().try_for_each(|axis| finite(input, axis, 0))?;
            tables::write_coordinates(&path, hash, dims, Coordinates::Axes(axes))?
        }
        GridCoordinates::Points(mut stream) => {
            let mut at = 0;
            let mut next = |out: &mut [f64]| {
                stream.fill(out)?;
                finite(input, out, at)?;
                at += out.len() as u64 / 3;
                Ok(())
            };
            let info = tables::write_coordinates(&path, hash, dims, Coordinates::Points(&mut next))?;
            stream.finish()?;
            info
        }
    };
    let cells = CoordinateMap::open(&path, hash, dims)?.count_cells()?;
    Ok(Some(CoordinateRecord { info, cells }))
}

/// A hash of the coordinates of a source; `None` where it has none of its own.
pub(in crate::pipeline) fn coordinate_hash(source: &StepSource, dims: [u64; 3]) -> Result<Option<u128>> {
    let mut hash = Xxh3::new();
    let mut add = |numbers: &[f64]| numbers.iter().for_each(|x| hash.update(&x.to_le_bytes()));
    match source.coordinates()? {
        None => return Ok(None),
        Some(GridCoordinates::Axes(axes)) => axes.iter().for_each(|axis| add(axis)),
        Some(GridCoordinates::Points(mut stream)) => {
            let mut left = dims.iter().product::<u64>();
            let mut numbers = vec![];
            while left > 0 {
                let n = left.min(4096);
                numbers.resize(3 * n as usize, 0.0);
                stream.fill(&mut numbers)?;
                add(&numbers);
                left -= n;
            }
        }
    }
    Ok(Some(hash.digest128()))
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

/// The map of what is extracted: to the world, or where coordinates are to be applied, to index
/// space.
pub(in crate::pipeline) fn world_map(archive: &StepView) -> WorldMap {
    let own = archive.coordinate_record().is_some();
    let geometry = if own { Geometry::default() } else { archive.step().plan.source.geometry };
    let map = match archive.is_pyramid() {
        true => WorldMap::of_samples(&geometry),
        false => WorldMap::new(&archive.manifest.plan.lattice, &geometry),
    };
    if own {
        return map;
    }
    let origin = origin_of_volume(archive);
    let hull = domain_hull(&geometry, archive.step().plan.source.dims);
    let volume: f64 = (0..3).map(|k| hull[1][k] - hull[0][k]).product();
    let spacing = libm::cbrt(volume / archive.manifest.counts.points.max(1) as f64);
    let far = scale_of(hull, origin).into_iter().fold(0.0, f64::max);
    map.counted_from(origin).resolving(spacing, far)
}

/// What the positions of surfaces are counted from, of a volume with a spacing or a mesh.
pub(in crate::pipeline) fn origin_of_volume(archive: &StepView) -> [f64; 3] {
    let source = &archive.step().plan.source;
    let hull = domain_hull(&source.geometry, source.dims);
    if source.mesh.is_some() {
        return nearby_origin(hull, even_spacing(archive, hull));
    }
    let axes = source.geometry.axes();
    nearby_origin(hull, [0, 1, 2].map(|k| axes.iter().map(|axis| axis[k].abs()).fold(0.0, f64::max)))
}

/// The shortest side of the world that a surface may have as `f32`: parts of it must be numbers.
const SHORTEST: f64 = 1e-30;

/// Refuses surfaces of a volume or a mesh whose coordinates are no numbers as `f32`.
///
/// # Errors
/// [`Error::Usage`] that names the coordinate.
pub(in crate::pipeline) fn expect_in_f32(archive: &StepView) -> Result<()> {
    if archive.coordinate_record().is_some() {
        return Ok(());
    }
    let source = &archive.step().plan.source;
    let (hull, origin) = (domain_hull(&source.geometry, source.dims), origin_of_volume(archive));
    let largest = scale_of(hull, origin).into_iter().fold(0.0, f64::max);
    let longest = (0..3).map(|k| hull[1][k] - hull[0][k]).fold(0.0, f64::max);
    let wrong = |what: String| {
        Err(Error::usage(format!(
            "{}: {what} as f32, which surfaces have: reduce it with another `spacing`",
            archive.path().display()
        )))
    };
    if largest > f64::from(f32::MAX) {
        return wrong(format!("a coordinate of {largest:.3e} is no number"));
    }
    if longest > 0.0 && longest < SHORTEST {
        return wrong(format!("a domain of a length of {longest:.3e} has no shape"));
    }
    Ok(())
}

/// The distance of neighbours along each axis, as if points filled a box evenly.
fn even_spacing(archive: &StepView, [lo, hi]: [[f64; 3]; 2]) -> [f64; 3] {
    let along = libm::cbrt(archive.manifest.counts.points.max(1) as f64);
    std::array::from_fn(|k| (hi[k] - lo[k]) / along)
}

/// Places along each axis by which the bounds of a grid with coordinates are estimated.
const LOOKED_AT: usize = 5;

/// What the positions of surfaces are counted from, of a grid with coordinates.
fn origin_of_grid(archive: &StepView, map: &CoordinateMap) -> Result<[f64; 3]> {
    let last = archive.step().plan.source.dims.map(|d| d.saturating_sub(1) as f64);
    let mut hull = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for n in 0..LOOKED_AT.pow(3) {
        let at = [n % LOOKED_AT, n / LOOKED_AT % LOOKED_AT, n / LOOKED_AT / LOOKED_AT];
        let at = std::array::from_fn(|a| last[a] * at[a] as f64 / (LOOKED_AT - 1) as f64);
        let place = map.place(at)?.position;
        for k in 0..3 {
            (hull[0][k], hull[1][k]) = (hull[0][k].min(place[k]), hull[1][k].max(place[k]));
        }
    }
    Ok(nearby_origin(hull, even_spacing(archive, hull)))
}

/// The way from index space to the world.
pub(in crate::pipeline) enum IndexToWorld {
    /// The map of a volume with a spacing.
    Geometry(Geometry),
    /// The map of a grid with coordinates of its own.
    Grid {
        /// The coordinates.
        map: CoordinateMap,
        /// Whether most cells mirror.
        mirrored: bool,
        /// What positions of surfaces are counted from.
        origin: [f64; 3],
    },
}

impl IndexToWorld {
    pub(in crate::pipeline) fn of(archive: &StepView) -> Result<Self> {
        Ok(match (archive.coordinates()?, archive.coordinate_record()) {
            (Some(map), Some(record)) => {
                let origin = origin_of_grid(archive, &map)?;
                Self::Grid { map, mirrored: record.cells.mirrored, origin }
            }
            _ => Self::Geometry(archive.step().plan.source.geometry),
        })
    }

    pub(in crate::pipeline) fn world(&self, ijk: [f64; 3]) -> Result<[f64; 3]> {
        match self {
            Self::Geometry(geometry) => Ok(geometry.to_world(ijk)),
            Self::Grid { map, .. } => Ok(map.place(ijk)?.position),
        }
    }

    /// Hands a surface that was extracted with [`world_map`] to `use_it`, in the world.
    pub(in crate::pipeline) fn surface<T>(
        &self,
        surface: &dyn SurfaceSource,
        use_it: impl FnOnce(&dyn SurfaceSource) -> Result<T>,
    ) -> Result<T> {
        match self {
            Self::Geometry(_) => use_it(surface),
            &Self::Grid { ref map, mirrored, origin } => {
                use_it(&WorldSurface { surface, map, mirrored, origin })
            }
        }
    }

    /// The same of one vertex.
    pub(in crate::pipeline) fn vertex(&self, vertex: &Vertex) -> Result<Vertex> {
        match self {
            Self::Geometry(_) => Ok(*vertex),
            Self::Grid { map, origin, .. } => placed(map, vertex, *origin),
        }
    }

    /// Whether tetrahedra are turned over (most of them, where a grid folds).
    pub(in crate::pipeline) fn mirrors(&self) -> bool {
        match self {
            Self::Geometry(geometry) => geometry.mirrors(),
            Self::Grid { mirrored, .. } => *mirrored,
        }
    }
}

/// Where a place of index space is.
pub(in crate::pipeline) fn world_of(archive: &StepView, ijk: [f64; 3]) -> Result<[f64; 3]> {
    match archive.coordinates()? {
        Some(map) => Ok(map.place(ijk)?.position),
        None => Ok(archive.step().plan.source.geometry.to_world(ijk)),
    }
}

/// Uses the coordinates of a grid and the bounds of its cells; `None` where it has no coordinates.
fn with_cells<T>(
    archive: &StepView,
    cancel: &CancelToken,
    use_them: impl FnOnce(&CoordinateMap, &CellBoxes) -> Result<T>,
) -> Result<Option<T>> {
    let Some(map) = archive.coordinates()? else { return Ok(None) };
    let boxes = match archive.cell_boxes.get() {
        Some(boxes) => boxes,
        None => {
            let boxes = map.cell_boxes(&|| cancel.check())?;
            archive.cell_boxes.get_or_init(|| boxes)
        }
    };
    use_them(&map, boxes).map(Some)
}

/// Where positions of the world are in the index space of a grid with coordinates: `None` for those
/// outside of it. `None` for a volume with a spacing.
pub(in crate::pipeline) fn index_places(
    archive: &StepView,
    positions: &[[f64; 3]],
    cancel: &CancelToken,
) -> Result<Option<Vec<Option<[f64; 3]>>>> {
    with_cells(archive, cancel, |map, boxes| {
        map.find(boxes, positions, origin_of_grid(archive, map)?, &|| cancel.check())
    })
}

/// The least box of the world that holds the domain.
pub(in crate::pipeline) fn bounds(archive: &StepView, cancel: &CancelToken) -> Result<[[f64; 3]; 2]> {
    let source = &archive.step().plan.source;
    let found = with_cells(archive, cancel, |map, boxes| Ok(map.bounds(boxes)))?;
    Ok(found.unwrap_or_else(|| domain_hull(&source.geometry, source.dims)))
}

/// A box of the world on a grid with coordinates.
pub(in crate::pipeline) enum WorldBox {
    /// The same box in index space.
    Index(Roi),
    /// Half-spaces of the world.
    HalfSpaces(Vec<HalfSpace>),
}

/// A box of the world on the grid of an archive that has coordinates.
///
/// # Errors
/// [`Error::Usage`] for a box without volume, and for one outside of the grid.
pub(in crate::pipeline) fn world_box(
    archive: &StepView,
    roi: &Roi,
    cancel: &CancelToken,
) -> Result<Option<WorldBox>> {
    with_cells(archive, cancel, |map, boxes| {
        let bounds = map.bounds(boxes);
        roi.check_within(bounds)?;
        let ranges = [0, 1, 2].map(|a| map.index_range(a, [roi.lo[a], roi.hi[a]]));
        Ok(match ranges {
            [Some(x), Some(y), Some(z)] => {
                let ranges = [x, y, z];
                let (lo, hi) = (ranges.map(|r| r[0]), ranges.map(|r| r[1]));
                WorldBox::Index(Roi { space: RoiSpace::Index, lo, hi })
            }
            _ => {
                let origin = origin_of_grid(archive, map)?;
                let scale = scale_of(bounds, origin);
                WorldBox::HalfSpaces(roi.half_spaces_of(&Geometry::default(), scale))
            }
        })
    })
}

/// Hands a surface that was extracted with [`world_map`] to `use_it`, in the world.
pub(in crate::pipeline) fn in_world<T>(
    archive: &StepView,
    surface: &dyn SurfaceSource,
    use_it: impl FnOnce(&dyn SurfaceSource) -> Result<T>,
) -> Result<T> {
    IndexToWorld::of(archive)?.surface(surface, use_it)
}

/// A vertex of index space in the world.
fn placed(map: &CoordinateMap, v: &Vertex, origin: [f64; 3]) -> Result<Vertex> {
    let placed = map.place(v.position.map(f64::from))?;
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
    let position = relative_to(placed.position, origin);
    if position.iter().all(|x| x.is_finite()) {
        return Ok(Vertex { position, normal });
    }
    let at = placed.position;
    Err(Error::usage(format!("a surface at {at:?} has coordinates that are no numbers as f32")))
}

/// A surface of index space in the world.
struct WorldSurface<'a> {
    surface: &'a dyn SurfaceSource,
    map: &'a CoordinateMap,
    mirrored: bool,
    origin: [f64; 3],
}

impl SurfaceSource for WorldSurface<'_> {
    fn vertex_count(&self) -> u64 {
        self.surface.vertex_count()
    }

    fn triangle_count(&self) -> u64 {
        self.surface.triangle_count()
    }

    fn origin(&self) -> [f64; 3] {
        self.origin
    }

    fn vertices(&self, each: &mut dyn FnMut(&[Vertex]) -> Result<()>) -> Result<()> {
        let mut moved = vec![];
        self.surface.vertices(&mut |batch| {
            moved.clear();
            for vertex in batch {
                moved.push(placed(self.map, vertex, self.origin)?);
            }
            each(&moved)
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
pub(in crate::pipeline) fn in_memory(archive: &StepView, surface: StoredSurface) -> Result<TriMesh> {
    match archive.coordinate_record() {
        Some(_) => in_world(archive, &surface, TriMesh::from_source),
        None => surface.into_mesh(),
    }
}
