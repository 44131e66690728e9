//! `probe` at points: each point is located exactly, in the chunk that has its tetrahedron.
//!
//! The points of a batch are sorted by brick. A chunk's tetrahedra lie in its region, core and
//! halo, so the points that it may hold are a few runs of that list. Each tetrahedron then looks up
//! the points in its box ([`PointLocator`]), as in scan conversion, with points in place of
//! samples. Chunks without a point near them are not read. A list that does not fit in memory is
//! processed in batches. Each batch reads the archive again where it has points.
//!
//! Surfaces are written in `f32`, and rounding moves a vertex on the boundary outside as often as
//! inside. So a point outside of all tetrahedra takes the value at the nearest place of one
//! ([`super::nearest`]), if that is within such a rounding. For this, the chunks around the point
//! are read once more.

use super::levels::values_at_places;
use super::nearest::{keep, near_places};
use super::probe_grid::{ProbeReport, ProbeSettings};
use crate::archive::manifest::Source;
use crate::pipeline::chunk::{CellLocator, NO_BODY};
use crate::pipeline::plan::estimate;
use crate::pipeline::read::{
    Blocks, DecodedChunk, StepView, Visit, full_region, index_places, origin_of_volume, samples_of_level,
};
use glam::DVec3;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{CancelToken, Clock, Progress, Resources, Silent};
use isospan_io::formats::point_list::{PointReader, PointWriter};
use isospan_io::formats::samples::SampleFile;
use isospan_io::geom::{Lattice, LatticeBox, LatticePos};
use isospan_io::grid::{BrickGrid, ChunkId, Geometry};
use isospan_mesh::mesh::tet::{Tet, is_active, range};
use isospan_mesh::raster::{PointLocator, interpolate};
use std::collections::BTreeMap;
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

/// Points sorted by brick.
struct Batch<'a> {
    bricks: &'a BrickGrid,
    /// Brick, position, number in the list.
    sorted: Vec<(u64, LatticePos, u32)>,
}

impl<'a> Batch<'a> {
    fn new(bricks: &'a BrickGrid, points: impl Iterator<Item = (LatticePos, u32)>) -> Self {
        let brick = |p: LatticePos| bricks.id(bricks.brick_at(p)).0;
        let mut sorted: Vec<_> = points.map(|(p, n)| (brick(p), p, n)).collect();
        sorted.sort_unstable_by_key(|&(brick, _, n)| (brick, n));
        Self { bricks, sorted }
    }

    /// One more than the largest number of a point.
    fn numbers(&self) -> usize {
        self.sorted.iter().map(|s| s.2 as usize + 1).max().unwrap_or(0)
    }

    /// The points in a box of the lattice, which is not empty.
    fn within(&self, region: LatticeBox) -> impl Iterator<Item = (LatticePos, u32)> + '_ {
        let (lo, hi) = (self.bricks.brick_at(region.lo), self.bricks.brick_at(region.hi.map(|x| x - 1)));
        let first = self.sorted.partition_point(|s| s.0 < self.bricks.id(lo).0);
        let rows = (lo[2]..=hi[2]).flat_map(move |z| (lo[1]..=hi[1]).map(move |y| (y, z)));
        // Few points: looking at all of them is less than looking each row up.
        let few = self.sorted.len() - first < 64;
        let all = if few { &self.sorted[first..] } else { &[] };
        let runs = (!few).then_some(rows).into_iter().flatten().flat_map(move |(y, z)| {
            let (from, to) = (self.bricks.id([lo[0], y, z]).0, self.bricks.id([hi[0], y, z]).0);
            let start = self.sorted.partition_point(|s| s.0 < from);
            self.sorted[start..].iter().take_while(move |s| s.0 <= to)
        });
        all.iter().chain(runs).map(|s| (s.1, s.2)).filter(move |s| region.contains(s.0))
    }
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
    let find = Find { resources: &settings.resources, share, outside, bodies: None, surface: None };
    let chunks_read = each_value(archive, placed.into_iter(), &find, progress, "probe", |n, value| {
        values[n as usize] = value;
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
    let find = Find { resources: &settings.resources, share, outside, bodies: None, surface };
    let (mut values, mut least) = (vec![f32::NAN; vertices.len()], vec![f32::INFINITY; vertices.len()]);
    each_value_of(archive, &steps, placed.into_iter(), &find, &Silent, "probe", |n, found, _| {
        let n = n as usize;
        let off = (found[list] - isovalues[n]).abs();
        if off < least[n] || least[n] == f32::INFINITY {
            (values[n], least[n]) = (found[of_field], off);
        }
    })?;
    Ok(values)
}

/// How points are located.
pub(super) struct Find<'a> {
    pub(super) resources: &'a Resources,
    /// The part of the memory that is for chunks.
    pub(super) share: &'a (dyn Fn(u64) -> u64 + Sync),
    /// Which points in no tetrahedron have the value of the nearest place.
    pub(super) outside: Outside,
    /// The bodies of a mesh, where a point has the value of its own.
    pub(super) bodies: Option<PointBodies<'a>>,
    /// The surfaces of which the points are vertices, where tetrahedra may overlap.
    pub(super) surface: Option<OnSurface<'a>>,
}

/// Vertices of surfaces. Only tetrahedra that the surface cuts are a vertex's own.
pub(super) struct OnSurface<'a> {
    /// Which list of values has the surface.
    list: usize,
    /// The isovalue of each point.
    isovalues: &'a [f32],
}

impl OnSurface<'_> {
    /// Whether the surface of a point cuts a tetrahedron.
    fn cuts(&self, tet: &Tet, lists: &[Vec<f32>], point: u32) -> bool {
        range(tet.map(|v| lists[self.list][v as usize]))
            .is_some_and(|(least, largest)| is_active(least, largest, self.isovalues[point as usize]))
    }
}

/// The bodies that points lie in, for a mesh of several bodies. They touch or overlap, and a vertex
/// next to such a place has the value of the body that it belongs to.
pub(super) struct PointBodies<'a> {
    /// That of each point, by its number; [`NO_BODY`] of one without.
    pub(super) of_points: &'a [u64],
    /// Tells the bodies of tetrahedra.
    pub(super) cells: &'a CellLocator<'a>,
}

/// Bytes that finding the bodies of a chunk's tetrahedra takes, for each vertex: its place, thrice
/// while places are sorted by brick, the cell found, and six tetrahedra of eight bytes.
const BODY: u64 = 240;

/// Points that lie in no tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Outside {
    /// Those within this many lattice steps of one have a value.
    Within(u32),
    /// All have one.
    All,
}

/// Calls `each` with the number and the value of every point that lies in a tetrahedron, or outside
/// of all as [`Find`] says. The value is NaN in a tetrahedron with a void corner. Returns the
/// number of chunks read.
fn each_value(
    archive: &StepView,
    points: impl Iterator<Item = (LatticePos, u32)>,
    find: &Find<'_>,
    progress: &dyn Progress,
    stage: &str,
    mut each: impl FnMut(u32, f32) + Send,
) -> Result<u64> {
    let values = |_, chunk: &mut DecodedChunk| Ok(vec![std::mem::take(&mut chunk.values)]);
    find_each(archive, points, find, progress, stage, 0, values, |n, values, _| each(n, values[0]))
}

/// As [`each_value`], at steps given by ascending positions in the manifest: each point is located
/// once. `each` also gets whether the point is in a tetrahedron.
pub(super) fn each_value_of(
    archive: &StepView,
    steps: &[usize],
    points: impl Iterator<Item = (LatticePos, u32)>,
    find: &Find<'_>,
    progress: &dyn Progress,
    stage: &str,
    each: impl FnMut(u32, &[f32], bool) + Send,
) -> Result<u64> {
    let values = |id, chunk: &mut DecodedChunk| archive.chunk_values_of(steps, id, chunk.positions.len());
    let further = steps.len() as u64 - 1;
    find_each(archive, points, find, progress, stage, further, values, each)
}

/// Calls `each` with the values at every point that lies in a tetrahedron: one for each list of
/// values at a chunk's vertices. There are `further` lists after the first.
#[expect(clippy::too_many_arguments, reason = "two questions, and nothing else, are asked in this way")]
fn find_each(
    archive: &StepView,
    points: impl Iterator<Item = (LatticePos, u32)>,
    find: &Find<'_>,
    progress: &dyn Progress,
    stage: &str,
    further: u64,
    values: impl Fn(ChunkId, &mut DecodedChunk) -> Result<Vec<Vec<f32>>> + Sync,
    mut each: impl FnMut(u32, &[f32], bool) + Send,
) -> Result<u64> {
    let far = archive.manifest.plan.lattice.max();
    let mut batch = Batch::new(archive.chunks.bricks(), points);
    let mut visit = Visit::new(archive, Blocks::All, find.resources, find.share)?;
    visit.confine(|region| batch.within(*region).next().is_some())?;
    let of_vertex = further * size_of::<f32>() as u64 + find.bodies.as_ref().map_or(0, |_| BODY);
    let extra = of_vertex * visit.most_vertices();
    visit.check_memory(extra)?;
    progress.begin(stage, visit.chunks.len() as u64, "chunks");
    // The body of each tetrahedron of a chunk; none where all count for all points.
    let bodies_of = |chunk: &DecodedChunk| match &find.bodies {
        Some(bodies) => bodies.cells.bodies_of(&chunk.positions, &chunk.tets),
        None => Ok(vec![]),
    };
    let is_own = |chunk: &DecodedChunk, lists: &[Vec<f32>], of_tets: &[u64], tet: usize, point: u32| {
        let same_body = find.bodies.as_ref().is_none_or(|bodies| {
            let (of_tet, of_point) = (of_tets[tet], bodies.of_points[point as usize]);
            of_tet == of_point || of_tet == NO_BODY || of_point == NO_BODY
        });
        same_body && find.surface.as_ref().is_none_or(|surface| surface.cuts(&chunk.tets[tet], lists, point))
    };
    let job = |id, mut chunk: DecodedChunk| {
        let region = full_region(archive, id)?;
        let values = values(id, &mut chunk)?;
        let of_tets = bodies_of(&chunk)?;
        let points = PointLocator::new(region, far, batch.within(region));
        Ok(locate(&chunk, &values, &points, |tet, n| is_own(&chunk, &values, &of_tets, tet, n)))
    };
    let mut is_found = vec![0u64; batch.numbers().div_ceil(64)];
    // Values of other bodies, for points that have none of their own.
    let mut foreign = BTreeMap::<u32, Vec<f32>>::new();
    visit.each(extra, progress, job, |_, found: FoundPoints| {
        let lists = found.values.len().checked_div(found.points.len()).unwrap_or(1);
        // The own tetrahedra of a mesh may overlap: the first one's value counts, or that nearest
        // to an isovalue.
        for (&(n, is_own), at) in found.points.iter().zip(found.values.chunks(lists.max(1))) {
            if !is_own {
                foreign.entry(n).or_insert_with(|| at.to_vec());
                continue;
            }
            let (word, bit) = (&mut is_found[n as usize / 64], 1 << (n % 64));
            if *word & bit == 0 || find.surface.is_some() {
                *word |= bit;
                each(n, at, true);
            }
        }
        Ok(())
    })?;
    let mut chunks_read = visit.chunks.len() as u64;
    batch.sorted.retain(|s| is_found[s.2 as usize / 64] >> (s.2 % 64) & 1 == 0);
    foreign.retain(|&n, _| is_found[n as usize / 64] >> (n % 64) & 1 == 0);
    drop(is_found);
    let lattice = archive.manifest.plan.lattice;
    let whole = far.into_iter().max().unwrap_or(0);
    let mut reach = match find.outside {
        Outside::Within(steps) => steps,
        Outside::All => archive.points.mean_spacing().into_iter().max().unwrap_or(1).max(1),
    };
    while !batch.sorted.is_empty() {
        let around = |region: &LatticeBox| region.grow_within([reach; 3], &lattice.domain());
        let mut visit = Visit::new(archive, Blocks::All, find.resources, find.share)?;
        visit.confine(|region| batch.within(around(region)).next().is_some())?;
        visit.check_memory(extra)?;
        let job = |id, mut chunk: DecodedChunk| {
            let region = around(&full_region(archive, id)?);
            let values = values(id, &mut chunk)?;
            let of_tets = bodies_of(&chunk)?;
            let points = PointLocator::new(region, far, batch.within(region));
            let is_own = |tet, n| is_own(&chunk, &values, &of_tets, tet, n);
            Ok(near_places(&chunk, &values, &points, is_own, reach, &lattice))
        };
        let mut places = BTreeMap::new();
        visit.each(extra, progress, job, |_, found| {
            found.into_iter().for_each(|(n, place)| keep(&mut places, n, place));
            Ok(())
        })?;
        chunks_read += visit.chunks.len() as u64;
        // Places farther than the reach along some axis were not searched.
        places.retain(|_, place| place.is_within(reach));
        // A point in a tetrahedron of another body has that one's value if its own body is farther.
        places.retain(|n, place| !place.is_foreign || !foreign.contains_key(n));
        places.iter().for_each(|(&n, place)| each(n, &place.values, false));
        for (&n, values) in foreign.iter().filter(|(n, _)| !places.contains_key(n)) {
            each(n, values, false);
        }
        if find.outside != Outside::All || reach >= whole.saturating_mul(2) {
            break;
        }
        batch.sorted.retain(|s| !places.contains_key(&s.2) && !foreign.contains_key(&s.2));
        foreign.clear();
        reach = reach.saturating_mul(2);
    }
    Ok(chunks_read)
}

/// Points of a chunk, each with whether the tetrahedron is of its own body, and the values of all
/// lists at the first, the second, ….
#[derive(Default)]
struct FoundPoints {
    points: Vec<(u32, bool)>,
    values: Vec<f32>,
}

/// The points that lie in tetrahedra of a chunk, and the fields there: NaN in one with a void
/// corner.
fn locate(
    chunk: &DecodedChunk,
    lists: &[Vec<f32>],
    points: &PointLocator,
    is_own: impl Fn(usize, u32) -> bool,
) -> FoundPoints {
    let mut found = FoundPoints::default();
    for (number, tet) in chunk.tets.iter().enumerate() {
        points.each_in(tet.map(|v| chunk.positions[v as usize]), |n, weights| {
            found.points.push((n, is_own(number, n)));
            found.values.extend(lists.iter().map(|values| {
                let corners = tet.map(|v| values[v as usize]);
                let void = corners.iter().any(|v| v.is_nan());
                if void { f32::NAN } else { interpolate(weights, corners) }
            }));
        });
    }
    found
}
