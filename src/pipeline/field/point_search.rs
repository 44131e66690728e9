//! Locates points in the tetrahedra of an archive, and gives the values there.
//!
//! The points of a batch are sorted by brick. A chunk's tetrahedra lie in its region, core and
//! halo, so the points that it may hold are a few runs of that list. Each tetrahedron then looks up
//! the points in its box ([`PointLocator`]), as in scan conversion, with points in place of
//! samples. Chunks without a point near them are not read.
//!
//! Surfaces are written in `f32`, and rounding moves a vertex on the boundary outside as often as
//! inside. So a point outside of all tetrahedra takes the value at the nearest place of one
//! ([`super::nearest`]), if that is within such a rounding. For this, the chunks around the point
//! are read once more.

use super::nearest::{NearPlace, keep, near_places};
use crate::pipeline::chunk::{CellLocator, NO_BODY};
use crate::pipeline::read::{Blocks, DecodedChunk, StepView, Visit, full_region};
use isospan_io::error::Result;
use isospan_io::exec::{Progress, Resources};
use isospan_io::geom::{LatticeBox, LatticePos};
use isospan_io::grid::{BrickGrid, ChunkId};
use isospan_mesh::mesh::tet::{Tet, is_active, range};
use isospan_mesh::raster::{PointLocator, interpolate};
use std::collections::BTreeMap;

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
    pub(super) progress: &'a dyn Progress,
    /// What the progress is called.
    pub(super) stage: &'a str,
}

/// Vertices of surfaces. Only tetrahedra that the surface cuts are a vertex's own.
pub(super) struct OnSurface<'a> {
    /// Which list of values has the surface.
    pub(super) list: usize,
    /// The isovalue of each point.
    pub(super) isovalues: &'a [f32],
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

/// The values that are asked for: a list of those of a chunk's vertices for each step.
#[derive(Clone, Copy)]
pub(super) enum Lists<'a> {
    /// Those of the view alone.
    OfView,
    /// Those of steps, by ascending positions in the manifest.
    OfSteps(&'a [usize]),
}

impl Lists<'_> {
    /// Bytes for a vertex beyond those that a chunk has anyway.
    fn bytes(self) -> u64 {
        match self {
            Self::OfView => 0,
            Self::OfSteps(steps) => (steps.len() as u64 - 1) * size_of::<f32>() as u64,
        }
    }

    fn of(self, archive: &StepView, id: ChunkId, chunk: &mut DecodedChunk) -> Result<Vec<Vec<f32>>> {
        match self {
            Self::OfView => Ok(vec![std::mem::take(&mut chunk.values)]),
            Self::OfSteps(steps) => archive.chunk_values_of(steps, id, chunk.positions.len()),
        }
    }
}

/// Calls `each` with the number and the values of every point that lies in a tetrahedron, or
/// outside of all as [`Find`] says, and whether it lies in one. A value is NaN in a tetrahedron
/// with a void corner. Each point is located once for all lists. Returns the number of chunks read.
pub(super) fn each_value(
    archive: &StepView,
    lists: Lists<'_>,
    points: impl Iterator<Item = (LatticePos, u32)>,
    find: &Find<'_>,
    mut each: impl FnMut(u32, &[f32], bool) + Send,
) -> Result<u64> {
    let batch = PointBatch::new(archive.chunks.bricks(), points);
    let mut search = PointLookup { archive, lists, find, batch, chunks_read: 0 };
    let foreign = search.in_tetrahedra(&mut each)?;
    search.at_nearest_places(foreign, &mut each)?;
    Ok(search.chunks_read)
}

/// Points sorted by brick.
struct PointBatch<'a> {
    bricks: &'a BrickGrid,
    /// Brick, position, number in the list.
    sorted: Vec<(u64, LatticePos, u32)>,
}

impl<'a> PointBatch<'a> {
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

/// Points that are looked for; those found are taken out.
struct PointLookup<'a> {
    archive: &'a StepView,
    lists: Lists<'a>,
    find: &'a Find<'a>,
    batch: PointBatch<'a>,
    chunks_read: u64,
}

/// Values of other bodies, for points that have none of their own.
type Foreign = BTreeMap<u32, Vec<f32>>;

impl<'a> PointLookup<'a> {
    /// Finds the points in tetrahedra. Those in tetrahedra of other bodies alone are returned.
    fn in_tetrahedra(&mut self, each: &mut (impl FnMut(u32, &[f32], bool) + Send)) -> Result<Foreign> {
        let (visit, extra) = self.visit(0)?;
        self.find.progress.begin(self.find.stage, visit.chunks.len() as u64, "chunks");
        let job = |id, chunk| Ok(self.chunk(id, chunk, 0)?.locate());
        let mut is_found = vec![0u64; self.batch.numbers().div_ceil(64)];
        let mut foreign = Foreign::new();
        visit.each(extra, self.find.progress, job, |_, found: FoundPoints| {
            let lists = found.values.len().checked_div(found.points.len()).unwrap_or(1);
            // The own tetrahedra of a mesh may overlap: the first one's value counts, or that
            // nearest to an isovalue.
            for (&(n, is_own), at) in found.points.iter().zip(found.values.chunks(lists.max(1))) {
                if !is_own {
                    foreign.entry(n).or_insert_with(|| at.to_vec());
                    continue;
                }
                let (word, bit) = (&mut is_found[n as usize / 64], 1 << (n % 64));
                if *word & bit == 0 || self.find.surface.is_some() {
                    *word |= bit;
                    each(n, at, true);
                }
            }
            Ok(())
        })?;
        self.chunks_read += visit.chunks.len() as u64;
        let is_left = |n: u32| is_found[n as usize / 64] >> (n % 64) & 1 == 0;
        self.batch.sorted.retain(|s| is_left(s.2));
        foreign.retain(|&n, _| is_left(n));
        Ok(foreign)
    }

    /// Gives points that lie in no tetrahedron of theirs the values of the nearest place.
    fn at_nearest_places(
        &mut self,
        mut foreign: Foreign,
        each: &mut (impl FnMut(u32, &[f32], bool) + Send),
    ) -> Result<()> {
        let whole = self.archive.manifest.plan.lattice.max().into_iter().max().unwrap_or(0);
        let mut reach = match self.find.outside {
            Outside::Within(steps) => steps,
            Outside::All => self.archive.points.mean_spacing().into_iter().max().unwrap_or(1).max(1),
        };
        while !self.batch.sorted.is_empty() {
            let mut places = self.nearest(reach)?;
            // A point in a tetrahedron of another body has that one's value if its own body is
            // farther.
            places.retain(|n, place| !place.is_foreign || !foreign.contains_key(n));
            places.iter().for_each(|(&n, place)| each(n, &place.values, false));
            for (&n, values) in foreign.iter().filter(|(n, _)| !places.contains_key(n)) {
                each(n, values, false);
            }
            if self.find.outside != Outside::All || reach >= whole.saturating_mul(2) {
                break;
            }
            self.batch.sorted.retain(|s| !places.contains_key(&s.2) && !foreign.contains_key(&s.2));
            foreign.clear();
            reach = reach.saturating_mul(2);
        }
        Ok(())
    }

    /// The nearest places of points, within `reach` lattice steps.
    fn nearest(&mut self, reach: u32) -> Result<BTreeMap<u32, NearPlace>> {
        let (visit, extra) = self.visit(reach)?;
        let job = |id, chunk| Ok(self.chunk(id, chunk, reach)?.near_places(reach, self.archive));
        let mut places = BTreeMap::new();
        visit.each(extra, self.find.progress, job, |_, found| {
            found.into_iter().for_each(|(n, place)| keep(&mut places, n, place));
            Ok(())
        })?;
        self.chunks_read += visit.chunks.len() as u64;
        // Places farther than the reach along some axis were not searched.
        places.retain(|_, place| place.is_within(reach));
        Ok(places)
    }

    /// A visit of the chunks with points at most `reach` steps from their region, and the bytes
    /// that a chunk takes besides.
    fn visit(&self, reach: u32) -> Result<(Visit<'a>, u64)> {
        let mut visit = Visit::new(self.archive, Blocks::All, self.find.resources, self.find.share)?;
        visit.confine(|region| self.batch.within(self.around(region, reach)).next().is_some())?;
        let of_vertex = self.lists.bytes() + self.find.bodies.as_ref().map_or(0, |_| BODY);
        let extra = of_vertex * visit.most_vertices();
        visit.check_memory(extra)?;
        Ok((visit, extra))
    }

    fn around(&self, region: &LatticeBox, reach: u32) -> LatticeBox {
        region.grow_within([reach; 3], &self.archive.manifest.plan.lattice.domain())
    }

    /// What is needed to look for points in a chunk.
    fn chunk(&self, id: ChunkId, mut chunk: DecodedChunk, reach: u32) -> Result<ChunkSearch<'_>> {
        let region = self.around(&full_region(self.archive, id)?, reach);
        let values = self.lists.of(self.archive, id, &mut chunk)?;
        let bodies = match &self.find.bodies {
            Some(bodies) => bodies.cells.bodies_of(&chunk.positions, &chunk.tets)?,
            None => vec![],
        };
        let far = self.archive.manifest.plan.lattice.max();
        let points = PointLocator::new(region, far, self.batch.within(region));
        Ok(ChunkSearch { find: self.find, chunk, values, bodies, points })
    }
}

/// A chunk, and the points near it.
struct ChunkSearch<'a> {
    find: &'a Find<'a>,
    chunk: DecodedChunk,
    values: Vec<Vec<f32>>,
    /// The body of each tetrahedron; none where all count for all points.
    bodies: Vec<u64>,
    points: PointLocator,
}

impl ChunkSearch<'_> {
    /// Whether a tetrahedron has the value of a point that it holds.
    fn is_own(&self, tet: usize, point: u32) -> bool {
        let same_body = self.find.bodies.as_ref().is_none_or(|bodies| {
            let (of_tet, of_point) = (self.bodies[tet], bodies.of_points[point as usize]);
            of_tet == of_point || of_tet == NO_BODY || of_point == NO_BODY
        });
        let tet = &self.chunk.tets[tet];
        same_body && self.find.surface.as_ref().is_none_or(|surface| surface.cuts(tet, &self.values, point))
    }

    /// The points that lie in tetrahedra, and the fields there: NaN in one with a void corner.
    fn locate(&self) -> FoundPoints {
        let mut found = FoundPoints::default();
        for (number, tet) in self.chunk.tets.iter().enumerate() {
            self.points.each_in(tet.map(|v| self.chunk.positions[v as usize]), |n, weights| {
                found.points.push((n, self.is_own(number, n)));
                found.values.extend(self.values.iter().map(|values| {
                    let corners = tet.map(|v| values[v as usize]);
                    let void = corners.iter().any(|v| v.is_nan());
                    if void { f32::NAN } else { interpolate(weights, corners) }
                }));
            });
        }
        found
    }

    /// The places nearest to points.
    fn near_places(&self, reach: u32, archive: &StepView) -> BTreeMap<u32, NearPlace> {
        let is_own = |tet, n| self.is_own(tet, n);
        near_places(&self.chunk, &self.values, &self.points, is_own, reach, &archive.manifest.plan.lattice)
    }
}

/// Points of a chunk, each with whether the tetrahedron is of its own body, and the values of all
/// lists at the first, the second, ….
#[derive(Default)]
struct FoundPoints {
    points: Vec<(u32, bool)>,
    values: Vec<f32>,
}
