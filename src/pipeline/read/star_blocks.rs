//! Blocks whose tetrahedra are not stored: they are made again from the points of the chunk and
//! those around it ([`PointStars`](crate::mesh::stars::asked::PointStars)).
//!
//! ```text
//!  blocks that will be read ─▶ the bricks of their runs, and what lies around ─▶ points ─▶ stars
//! ```
//!
//! Stars are made among points that have numbers of their own: those of the chunk first, in its
//! order, then the others. So the smallest vertex of a tetrahedron is the same in both numberings.
//!
//! Points are listed as far around as most stars need. Where a star cannot be proven with them,
//! more are listed; with all points of the domain every star can.

use super::damaged::damaged;
use super::reader_memory::ReaderMemory;
use super::star_memory::StarMemory;
use super::step_view::StepView;
use crate::archive::chunked::ChunkSegment;
use crate::archive::mesh::{StarRuns, sort_star};
use crate::error::{Error, Result};
use crate::geom::curve::Order;
use crate::geom::{LatticeBox, LatticePos, PointId, Site};
use crate::grid::{BrickId, Chunk};
use crate::mesh::chunk::ChunkRegion;
use crate::pipeline::plan::{check_brick, reach_unit};
use std::ops::Range;

/// How far around the bricks of blocks points are listed at first, in mean spacings: the stars of
/// nearly all points are proven with those within 2.7.
const MARGIN: u32 = 3;

/// The blocks of a chunk.
pub(super) struct StarBlocks {
    runs: StarRuns,
    /// Those that will be read, ascending.
    expected: Vec<u32>,
    /// How far around their bricks points are listed, in lattice steps; 0 before they are.
    margin: u32,
    /// Whether these are all points of the domain.
    is_all: bool,
}

/// The bricks of a chunk.
pub(super) struct ChunkBricks<'a> {
    pub(super) archive: &'a StepView,
    pub(super) mesh: &'a ChunkSegment,
    pub(super) chunk: &'a Chunk,
    pub(super) bricks: &'a [BrickId],
    /// First vertex of each brick, and the number of core points.
    pub(super) starts: &'a [u32],
}

impl ChunkBricks<'_> {
    fn brick(&self, n: usize) -> LatticeBox {
        self.archive.chunks.bricks().brick(self.bricks[n])
    }

    /// The bricks that have some vertices.
    fn of(&self, vertices: &Range<u32>) -> Range<usize> {
        let brick = |v: u32| self.starts.partition_point(|&s| s <= v);
        if vertices.is_empty() { 0..0 } else { brick(vertices.start) - 1..brick(vertices.end - 1) }
    }

    /// A box around the bricks of some vertices.
    fn hull(&self, vertices: &Range<u32>, hull: LatticeBox) -> LatticeBox {
        self.of(vertices).map(|n| self.brick(n)).fold(hull, |a, b| a.hull(&b))
    }

    /// Lists the points of a brick, and notes positions and ids of its vertices.
    pub(super) fn place(
        &self,
        n: usize,
        positions: &mut [LatticePos],
        ids: &mut [PointId],
        sites: &mut Vec<Site>,
    ) -> Result<()> {
        let (points, brick, first) = (&self.archive.points, self.brick(n), self.starts[n]);
        check_brick(points, &brick).map_err(|e| self.wrong(&e.to_string()))?;
        points.sites_in(&brick, sites);
        let (got, said) = (sites.len(), self.starts[n + 1] - first);
        if got != said as usize {
            let what = format!("brick {} has {got} points, not the {said} recorded", self.bricks[n].0);
            return Err(self.wrong(&what));
        }
        for (v, site) in (first as usize..).zip(&*sites) {
            (positions[v], ids[v]) = (site.pos, site.id);
        }
        Ok(())
    }

    fn wrong(&self, what: &str) -> Error {
        damaged(self.mesh, self.chunk.id, "header", what)
    }
}

impl StarBlocks {
    pub(super) fn new(runs: StarRuns) -> Self {
        Self { runs, expected: vec![], margin: 0, is_all: false }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.runs.len()
    }

    /// Says which blocks will be read.
    pub(super) fn expect(&mut self, mut blocks: Vec<u32>) {
        blocks.sort_unstable();
        self.expected = blocks;
        self.margin = 0;
    }

    /// A box that holds the tetrahedra of a block.
    pub(super) fn hull(&self, of: &ChunkBricks<'_>, number: u32) -> LatticeBox {
        let run = self.runs.run(number as usize);
        let unit = reach_unit(&of.archive.points);
        let reach = self.runs.reach(number as usize).saturating_mul(unit);
        of.hull(&run, LatticeBox::NOTHING)
            .grow_within([reach; 3], &of.archive.chunks.bricks().lattice.domain())
    }

    /// Lists the points around a block and the expected ones that follow.
    fn list(&mut self, of: &ChunkBricks<'_>, number: u32, memory: &mut ReaderMemory) -> Result<()> {
        let points = &of.archive.points;
        let domain = of.archive.chunks.bricks().lattice.domain();
        let least = MARGIN.saturating_mul(points.mean_spacing()[0]);
        self.margin = self.margin.saturating_mul(2).max(least);
        self.expected.retain(|&b| b >= number);
        if self.expected.first() != Some(&number) {
            self.expected = vec![number];
        }
        let runs = || self.expected.iter().map(|&b| self.runs.run(b as usize));
        let hull = runs().fold(LatticeBox::NOTHING, |hull, run| of.hull(&run, hull));
        let region = hull.grow_within([self.margin; 3], &domain);
        self.is_all = region == domain;
        let ReaderMemory { positions: at, ids, sites, stars: memory, .. } = memory;
        let StarMemory { stars, numbers, others, firsts, .. } = memory;
        numbers.clear();
        others.clear();
        firsts.clear();
        let fill = |positions: &mut Vec<LatticePos>| {
            for n in 0..of.bricks.len() {
                firsts.push(numbers.len() as u32);
                let (brick, first) = (of.brick(n), of.starts[n]);
                if brick.intersect(&region).is_empty() {
                    continue;
                }
                of.place(n, at, ids, sites)?;
                for (v, site) in (first..).zip(&*sites) {
                    if region.contains(site.pos) {
                        positions.push(site.pos);
                        numbers.push(v);
                    }
                }
            }
            for part in region.without(&of.chunk.core) {
                points.candidates_in(&part, sites);
                // Of points at one position, the first counts.
                sites.sort_unstable_by_key(|s| s.id);
                others.extend_from_slice(sites);
                positions.extend(sites.iter().map(|s| s.pos));
            }
            Ok(numbers.len())
        };
        let boxes = ChunkRegion { core: of.chunk.core, near: region, region, domain };
        let order = Order { bits: of.archive.manifest.plan.order_bits };
        if !stars.start(boxes, order, fill)? {
            return Err(of.wrong("too few points for their domain"));
        }
        for run in runs() {
            for n in of.of(&run) {
                let vertices = run.start.max(of.starts[n])..run.end.min(of.starts[n + 1]);
                vertices.for_each(|v| stars.will_ask(firsts[n] + v - of.starts[n]));
            }
        }
        Ok(())
    }

    /// Makes the tetrahedra of a block. Returns whether points of other chunks are among their
    /// vertices.
    pub(super) fn make(
        &mut self,
        of: &ChunkBricks<'_>,
        number: u32,
        memory: &mut ReaderMemory,
    ) -> Result<bool> {
        if self.margin == 0 || self.expected.binary_search(&number).is_err() {
            self.margin = 0;
            self.list(of, number, memory)?;
        }
        while !self.make_listed(of, number, &mut memory.stars)? {
            if self.is_all {
                return Err(of.wrong("a point has no tetrahedra"));
            }
            self.list(of, number, memory)?;
        }
        let StarMemory { numbers, tets, .. } = &memory.stars;
        let core = numbers.len() as u32;
        Ok(tets.iter().any(|t| t.iter().any(|&v| v >= core)))
    }

    /// As [`StarBlocks::make`], with the points that are listed; false where they are too few.
    fn make_listed(&self, of: &ChunkBricks<'_>, number: u32, memory: &mut StarMemory) -> Result<bool> {
        let StarMemory { stars, firsts, star, tets, .. } = memory;
        tets.clear();
        let run = self.runs.run(number as usize);
        for n in of.of(&run) {
            for v in run.start.max(of.starts[n])..run.end.min(of.starts[n + 1]) {
                if !stars.star(firsts[n] + v - of.starts[n], star)? {
                    return Ok(false);
                }
                tets.extend_from_slice(star);
            }
        }
        Ok(true)
    }

    /// Leaves the tetrahedra that were made in `memory.tets`, sorted, with vertices numbered as in
    /// the chunk. The numbers of points of other chunks are known.
    pub(super) fn take(&self, of: &ChunkBricks<'_>, memory: &mut ReaderMemory) -> Result<()> {
        let ReaderMemory { positions, stars, halo, tets: out, .. } = memory;
        let StarMemory { tets, numbers, others, .. } = stars;
        for corner in tets.iter_mut().flatten() {
            *corner = match numbers.get(*corner as usize) {
                Some(&number) => number,
                None => {
                    let site = others[*corner as usize - numbers.len()];
                    let Some(&number) = halo.get(&site.id) else {
                        let what = format!("point {:#x} is missing", site.id.0);
                        return Err(damaged(of.mesh, of.chunk.id, "halo", &what));
                    };
                    positions[number as usize] = site.pos;
                    number
                }
            };
        }
        tets.chunk_by_mut(|a, b| a[0] == b[0]).for_each(sort_star);
        std::mem::swap(tets, out);
        Ok(())
    }
}
