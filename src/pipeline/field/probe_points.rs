//! `probe` at points: each point is located exactly, in the chunk that has its tetrahedron
//! ([`super::point_search`]). A list that does not fit in memory is processed in batches. Each
//! batch reads the archive again where it has points.

use super::levels::values_at_places;
use super::point_search::{Find, Lists, OnSurface, Outside, each_value};
use super::probe_grid::{ProbeReport, ProbeSettings};
use crate::archive::manifest::Source;
use crate::pipeline::plan::estimate;
use crate::pipeline::read::{StepView, index_places, origin_of_volume, samples_of_level};
use glam::DVec3;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{CancelToken, Clock, Progress, Silent};
use isospan_io::formats::point_list::{PointReader, PointWriter};
use isospan_io::formats::samples::SampleFile;
use isospan_io::geom::{Lattice, LatticePos};
use isospan_io::grid::Geometry;
use std::path::Path;

/// Bytes for a point of a batch: position, place in the list, value, its copy while a chunk looks
/// for it, and the nearest place.
const POINT: u64 = 300;
/// The most points of a batch.
const MOST: u64 = 1 << 31;

/// Values at points.
pub(in crate::pipeline) struct Probed {
    pub(in crate::pipeline) values: Vec<f32>,
    /// Points outside the domain.
    pub(super) outside: u64,
    pub(super) chunks_read: u64,
}

/// Lattice steps that rounding world coordinates of the domain, less the origin of its surfaces, to
/// `f32`, and positions to the lattice, may move a point by, along each axis.
fn tolerance(geometry: &Geometry, lattice: &Lattice, origin: [f64; 3]) -> u32 {
    let far = lattice.max();
    let steps = lattice.log2_steps.map(|s| f64::from(1u32 << s));
    // An affine map has its largest coordinates at corners.
    let largest = (0..8u32).fold(0.0, |largest: f64, corner| {
        let ijk =
            std::array::from_fn(|a| if corner >> a & 1 == 1 { f64::from(far[a]) / steps[a] } else { 0.0 });
        let corner = geometry.to_world(ijk);
        (0..3).fold(largest, |largest, k| largest.max((corner[k] - origin[k]).abs()))
    });
    // Half a unit in the last place, on each of three axes.
    let moved = largest * f64::from(f32::EPSILON) / 2.0 * 1.75;
    let of_axis = |a: usize| moved / geometry.spacing[a].abs() * steps[a];
    let most = (0..3).map(of_axis).fold(0.0, f64::max);
    (most.ceil() + 2.0).min(f64::from(Lattice::LARGEST)) as u32
}

/// The lattice position nearest to a world position; `None` where the domain is farther than
/// `tolerance` steps.
fn lattice_position(
    world: [f64; 3],
    geometry: &Geometry,
    lattice: &Lattice,
    tolerance: u32,
) -> Option<LatticePos> {
    let (ijk, far) = (geometry.to_index(world), lattice.max());
    let steps = lattice.log2_steps.map(|s| f64::from(1u32 << s));
    let mut pos = [0; 3];
    for a in 0..3 {
        let (x, far, tolerance) = ((ijk[a] * steps[a]).round(), f64::from(far[a]), f64::from(tolerance));
        // False for a NaN too. The faces belong to the domain, and what rounds to them.
        if !(-tolerance..=far + tolerance).contains(&x) {
            return None;
        }
        pos[a] = x.clamp(0.0, far) as u32;
    }
    Some(pos)
}

/// Distances from an edge's middle, in voxels, at which data are searched for: an edge may be as
/// short as the least of them, or lie in a thin tetrahedron.
const AROUND: [f64; 4] = [0.2, 0.05, 0.01, 0.002];

/// See [`super::Archive::edges_at_missing`]; `values` are those of the field at points of the
/// world.
pub(in crate::pipeline) fn edges_at_missing(
    edges: &[[[f64; 3]; 2]],
    geometry: &Geometry,
    dims: [u64; 3],
    values: impl FnOnce(&[[f64; 3]]) -> Result<Vec<f64>>,
) -> Result<u64> {
    let inside = |p: &[f64; 3]| (0..3).all(|a| p[a] > 0.0 && p[a] < (dims[a] - 1) as f64);
    let (mut points, mut ends) = (vec![], vec![]);
    for edge in edges {
        let [a, b] = edge.map(|end| DVec3::from_array(geometry.to_index(end)));
        // In the plane across the edge half of the directions point to the other side of the face
        // that the edge lies on.
        let along = (b - a).try_normalize().unwrap_or(DVec3::X);
        let (u, w) = along.any_orthonormal_pair();
        let diagonal = std::f64::consts::FRAC_1_SQRT_2;
        let directions = [u, w, (u + w) * diagonal, (u - w) * diagonal];
        for direction in directions.into_iter().flat_map(|d| [d, -d]) {
            let around = AROUND.map(|r| ((a + b) * 0.5 + direction * r).to_array());
            points.extend(around.into_iter().filter(inside).map(|p| geometry.to_world(p)));
        }
        ends.push(points.len());
    }
    let found = values(&points)?;
    let mut first = 0;
    let at_missing = |&end: &usize| found[std::mem::replace(&mut first, end)..end].iter().any(|v| v.is_nan());
    Ok(ends.iter().map(at_missing).map(u64::from).sum())
}

/// Where values go.
enum Out<'a> {
    Table(Box<PointWriter>, &'a Source),
    List(Box<SampleFile>),
}

impl<'a> Out<'a> {
    fn create(out: &Path, points: &Path, source: &'a Source) -> Result<Self> {
        let extension = out.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        match extension.as_deref() {
            Some("csv") => {
                Ok(Self::Table(Box::new(PointWriter::create(out, points, &source.field)?), source))
            }
            Some("npy") => {
                let (mut reader, mut count) = (PointReader::open(points)?, 0);
                while reader.next_point()?.is_some() {
                    count += 1;
                }
                Ok(Self::List(Box::new(SampleFile::create_list(out, count, source.offset)?)))
            }
            _ => Err(Error::usage(format!(
                "cannot tell the format of values at points from {}: end its name in .csv or .npy",
                out.display()
            ))),
        }
    }

    fn write(&mut self, first: u64, values: &[f32]) -> Result<()> {
        match self {
            Self::Table(table, source) => {
                let values: Vec<f64> = values.iter().map(|&v| source.in_file(v)).collect();
                table.write(&values)
            }
            Self::List(list) => list.write(first, values),
        }
    }

    fn publish(self) -> Result<u64> {
        match self {
            Self::Table(table, _) => table.publish(),
            Self::List(list) => list.publish(None, &CancelToken::new()),
        }
    }
}

/// Writes values for a table of points: see [`super::Archive::write_probed`].
pub(in crate::pipeline) fn probe_table(
    archive: &StepView,
    points: &Path,
    settings: &ProbeSettings,
    out: &Path,
    progress: &dyn Progress,
) -> Result<ProbeReport> {
    let (start, read_before) = (Clock::start(), archive.bytes_read());
    let mut reader = PointReader::open(points)?;
    let mut out = Out::create(out, points, &archive.step().plan.source)?;
    let rest = settings.resources.memory.saturating_sub(estimate::BASE);
    // Half for points, half for chunks.
    let most = (rest / 2 / POINT).clamp(1, MOST);
    let level = archive.level(settings.level)?;
    let mut report = ProbeReport { level: archive.is_pyramid().then_some(level), ..ProbeReport::default() };
    let mut batch = vec![];
    loop {
        batch.clear();
        while (batch.len() as u64) < most {
            let Some(point) = reader.next_point()? else { break };
            batch.push(point);
        }
        if batch.is_empty() {
            break;
        }
        let share = |memory: u64| memory.saturating_sub(estimate::BASE) / 2;
        let probed = values_at(archive, &batch, settings, &share, progress)?;
        out.write(report.samples, &probed.values)?;
        report.samples += batch.len() as u64;
        report.outside += probed.outside;
        report.void += probed.values.iter().filter(|v| v.is_nan()).count() as u64 - probed.outside;
        report.chunks_read += probed.chunks_read;
    }
    report.bytes_read = archive.bytes_read() - read_before;
    report.file_bytes = out.publish()?;
    report.seconds = start.elapsed().as_secs_f64();
    Ok(report)
}

/// Values of the field at points given in world coordinates; fewer than 2^32. NaN where there are
/// none.
pub(in crate::pipeline) fn values_at(
    archive: &StepView,
    points: &[[f64; 3]],
    settings: &ProbeSettings,
    share: &(dyn Fn(u64) -> u64 + Sync),
    progress: &dyn Progress,
) -> Result<Probed> {
    if points.len() as u64 > MOST {
        return Err(Error::usage(format!(
            "at most {MOST} points are probed at a time; not {}",
            points.len()
        )));
    }
    let (mut values, mut found) = (vec![f32::NAN; points.len()], 0);
    let level = archive.level(settings.level)?;
    if archive.is_pyramid() {
        let places = places(archive, level, points, &settings.resources.cancel)?;
        let chunks_read =
            values_at_places(archive, level, &places, &settings.resources, progress, |n, value| {
                values[n as usize] = value;
            })?;
        return Ok(Probed { values, outside: (points.len() - places.len()) as u64, chunks_read });
    }
    let (placed, outside) = placed(archive, points, &settings.resources.cancel)?;
    let (resources, stage) = (&settings.resources, "probe");
    let find = Find { resources, share, outside, bodies: None, surface: None, progress, stage };
    let chunks_read = each_value(archive, Lists::OfView, placed.into_iter(), &find, |n, found_at, _| {
        values[n as usize] = found_at[0];
        found += 1;
    })?;
    Ok(Probed { values, outside: points.len() as u64 - found, chunks_read })
}

/// How far beyond the last node of a coarse level, in samples of a grid with coordinates, a point
/// may lie: a vertex of a surface that ends there is not found exactly.
const BEYOND_NODE: f64 = 1e-3;

/// Points in the world among the samples of a pyramid that a level has, with their numbers; none of
/// those outside. Those that rounding may have moved outside lie at its faces.
fn places(
    archive: &StepView,
    level: usize,
    points: &[[f64; 3]],
    cancel: &CancelToken,
) -> Result<Vec<([f64; 3], u32)>> {
    let (lattice, source) = (archive.manifest.plan.lattice, &archive.step().plan.source);
    let ends = samples_of_level(&archive.pyramid()?.pyramid, level);
    let (found, tolerance) = match index_places(archive, points, cancel)? {
        Some(places) => (places, if level > 0 { BEYOND_NODE } else { 0.0 }),
        None => {
            let tolerance = tolerance(&source.geometry, &lattice, origin_of_volume(archive));
            let steps = f64::from(1u32 << lattice.log2_steps.into_iter().min().unwrap_or(0));
            let place = |p: &[f64; 3]| Some(source.geometry.to_index(*p));
            (points.iter().map(place).collect(), f64::from(tolerance) / steps)
        }
    };
    let within = |place: [f64; 3]| {
        let far = ends.map(|n| (n - 1) as f64);
        let inside = (0..3).all(|a| (-tolerance..=far[a] + tolerance).contains(&place[a]));
        inside.then(|| std::array::from_fn(|a| place[a].clamp(0.0, far[a])))
    };
    Ok(found.into_iter().zip(0u32..).filter_map(|(place, n)| Some((within(place?)?, n))).collect())
}

/// Points in the world on the lattice, with their numbers, and how far outside others count.
fn placed(
    archive: &StepView,
    points: &[[f64; 3]],
    cancel: &CancelToken,
) -> Result<(Vec<(LatticePos, u32)>, Outside)> {
    let lattice = archive.manifest.plan.lattice;
    if let Some(places) = index_places(archive, points, cancel)? {
        let place = |(p, n): (Option<[f64; 3]>, u32)| {
            Some((lattice_position(p?, &Geometry::default(), &lattice, 0)?, n))
        };
        return Ok((places.into_iter().zip(0u32..).filter_map(place).collect(), Outside::Within(1)));
    }
    let geometry = &archive.step().plan.source.geometry;
    let tolerance = tolerance(geometry, &lattice, origin_of_volume(archive));
    let place = |(&p, n)| Some((lattice_position(p, geometry, &lattice, tolerance)?, n));
    Ok((points.iter().zip(0u32..).filter_map(place).collect(), Outside::Within(tolerance)))
}

/// Values of the field at vertices of surfaces of another step, by its position in the manifest,
/// each with its isovalue. The tetrahedra of a mesh may overlap: of those that hold a vertex, the
/// one counts at which that step is nearest to the isovalue. NaN where there are none.
pub(in crate::pipeline) fn values_on_surface(
    archive: &StepView,
    step: usize,
    vertices: &[[f64; 3]],
    isovalues: &[f32],
    settings: &ProbeSettings,
    share: &(dyn Fn(u64) -> u64 + Sync),
) -> Result<Vec<f32>> {
    let mut steps = vec![step, archive.position()];
    steps.sort_unstable();
    steps.dedup();
    let list_of = |step: usize| steps.iter().position(|&s| s == step).expect("one of both");
    let (list, of_field) = (list_of(step), list_of(archive.position()));
    let (placed, outside) = placed(archive, vertices, &settings.resources.cancel)?;
    let surface = Some(OnSurface { list, isovalues });
    let (resources, progress, stage) = (&settings.resources, &Silent, "probe");
    let find = Find { resources, share, outside, bodies: None, surface, progress, stage };
    let (mut values, mut least) = (vec![f32::NAN; vertices.len()], vec![f32::INFINITY; vertices.len()]);
    each_value(archive, Lists::OfSteps(&steps), placed.into_iter(), &find, |n, found, _| {
        let n = n as usize;
        let off = (found[list] - isovalues[n]).abs();
        if off < least[n] || least[n] == f32::INFINITY {
            (values[n], least[n]) = (found[of_field], off);
        }
    })?;
    Ok(values)
}
