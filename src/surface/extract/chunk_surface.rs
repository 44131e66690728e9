//! The surface of a chunk while it grows: its vertices, the edges that further tetrahedra may have,
//! and its triangles.

use super::cells::{CellSource, along_edge};
use super::edges::{EdgeLookup, EdgeTable};
use super::{fours, patch};
use crate::surface::model::Vertex;
use crate::surface::world_map::WorldMap;
use isospan_io::geom::PointId;
use isospan_mesh::simd::{Avx2, F64x4s, Plain, on_avx2_or_plain};

/// A vertex on an edge that tetrahedra of other chunks may use too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedEdge {
    /// The edge: lower id, higher id.
    pub key: (PointId, PointId),
    /// Its vertex, as a number in [`ChunkSurface::vertices`].
    pub vertex: u32,
    /// This chunk's part of the gradient sum, in the edge's own unit.
    pub gradient: [i64; 3],
}

/// The surface of one chunk: vertices welded inside the chunk, in order of first use, and
/// triangles.
#[derive(Debug, Default)]
pub struct ChunkSurface {
    pub(super) isovalue: f32,
    pub(super) active_cells: u64,
    /// The crossed edges that further tetrahedra may have, and what is known of each.
    pub(super) edges: EdgeTable,
    pub(super) open: Vec<OpenVertex>,
    pub(super) vertices: Vec<Vertex>,
    pub(super) shared: Vec<SharedEdge>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Buffers for the edges of the block that is worked on.
    pub(super) joined: JoinedBlock,
}

/// A vertex whose gradient is not yet summed up.
#[derive(Clone, Copy, Debug)]
pub(super) struct OpenVertex {
    pub(super) gradient: [i64; 3],
    pub(super) vertex: u32,
}

/// The edges of a patch, in their chunk.
#[derive(Debug, Default)]
pub(super) struct JoinedBlock {
    /// The vertex of each.
    pub(super) vertices: Vec<u32>,
    /// The edges whose vertices are new.
    pub(super) new: Vec<u16>,
    /// The edges that the patch has alone; those that it is the first to have.
    pub(super) alone: Vec<u16>,
    pub(super) first: Vec<u16>,
}

impl ChunkSurface {
    /// Empties the buffers for another chunk, of this many corners, or another isovalue.
    pub fn start(&mut self, isovalue: f32, corners: usize) {
        self.isovalue = isovalue;
        self.active_cells = 0;
        self.edges.clear(corners);
        self.open.clear();
        self.vertices.clear();
        self.shared.clear();
        self.triangles.clear();
    }

    /// Ends the chunk: finds normals, and turns the triangles over when `world`, the same as
    /// before, mirrors.
    pub fn finish(&mut self, world: &WorldMap) {
        on_avx2_or_plain!(Avx2::found(), F64x4, Plain<f64, 4>, |W, token| self.finish_normals::<W>(token, world));
        if world.mirrors() {
            self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
    }

    /// Finds the normals of open vertices.
    #[inline(always)]
    fn finish_normals<W: F64x4s>(&mut self, token: W::Token, world: &WorldMap) {
        let mut shared = self.shared.iter_mut().peekable();
        for four in self.open.chunks(4) {
            let mut sums = [[0; 3]; 4];
            for (sum, open) in sums.iter_mut().zip(four) {
                *sum = open.gradient;
            }
            let normals = fours::normals::<W>(token, &sums, world);
            for (open, normal) in four.iter().zip(normals) {
                let edge = shared.next_if(|edge| edge.vertex == open.vertex);
                // The sum of a shared edge is known only at the end: until then its normal is the
                // one for want of a sum. A corner of a cap has no other for the time being: any
                // part of its sum has a direction.
                let is_part = edge.as_ref().is_some_and(|edge| edge.key.0 != edge.key.1);
                let vertex = &mut self.vertices[open.vertex as usize];
                let normal = if is_part { None } else { normal };
                vertex.normal = normal.unwrap_or_else(|| along_edge(vertex.normal, world));
                if let Some(edge) = edge {
                    edge.gradient = open.gradient;
                }
            }
        }
    }

    /// Vertices, after `finish`. The normals of shared ones are not final.
    pub fn vertices(&self) -> &[Vertex] {
        &self.vertices
    }

    /// The vertices that other chunks may have too, in the order of their numbers, after `finish`.
    pub fn shared_edges(&self) -> &[SharedEdge] {
        &self.shared
    }

    /// Triangles of chunk-local vertex numbers.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Active tetrahedra seen since `start`.
    pub fn active_cells(&self) -> u64 {
        self.active_cells
    }

    /// Bytes of memory that the buffers hold.
    pub fn bytes(&self) -> usize {
        self.edges.bytes()
            + self.open.capacity() * size_of::<OpenVertex>()
            + self.vertices.capacity() * size_of::<Vertex>()
            + self.shared.capacity() * size_of::<SharedEdge>()
            + self.triangles.capacity() * size_of::<[u32; 3]>()
    }

    /// The isovalue.
    pub(super) fn isovalue(&self) -> f32 {
        self.isovalue
    }

    /// The number among the open vertices of that of a crossed edge, the corner of lower id first;
    /// or of that of a corner itself, as an edge without length.
    pub(super) fn open_vertex(&mut self, cells: &CellSource<'_>, world: &WorldMap, ends: [u32; 2]) -> usize {
        let next = self.vertices.len() as u32;
        let numbers = match cells.numbers {
            Some(numbers) => ends.map(|c| numbers[c as usize]),
            None => ends,
        };
        let (number, is_new) = find_or_open(&mut self.edges, &mut self.open, numbers, next);
        if is_new {
            let at = ends.map(|c| {
                // At most 2^24: exact.
                let [x, y, z] = cells.positions[c as usize].map(|x| x as f32);
                [x, y, z, cells.values[c as usize]]
            });
            let [a, b] = &at;
            let [position, ..] = fours::crossings::<Plain<f64, 4>>((), [[a, b]; 4], self.isovalue, world);
            self.vertices.push(Vertex { position, normal: patch::up([a, b]) });
            self.shared.extend(shared_edge(cells, ends, next));
        }
        number
    }

    /// Adds to the gradient at an open vertex, along an axis of the lattice.
    pub(super) fn pull(&mut self, open: usize, axis: usize, units: i64) {
        let sum = &mut self.open[open].gradient[axis];
        *sum = sum.wrapping_add(units);
    }

    /// Adds a triangle of open vertices.
    pub(super) fn push_triangle(&mut self, open: [usize; 3]) {
        self.triangles.push(open.map(|n| self.open[n].vertex));
    }
}

/// The number of an edge among the open vertices, and whether it is new: `next` is its vertex then.
/// Its ends are given by their numbers in the chunk.
#[inline(always)]
pub(super) fn find_or_open(
    edges: &mut EdgeTable,
    open: &mut Vec<OpenVertex>,
    edge: [u32; 2],
    next: u32,
) -> (usize, bool) {
    match edges.find_or_add(edge) {
        EdgeLookup::Known(number) => (number as usize, false),
        EdgeLookup::New(number) => {
            open.push(OpenVertex { gradient: [0; 3], vertex: next });
            (number as usize, true)
        }
    }
}

/// What is known of an edge that other chunks may have.
#[inline(always)]
fn shared_edge(cells: &CellSource<'_>, ends: [u32; 2], vertex: u32) -> Option<SharedEdge> {
    let [a, b] = [ends[0] as usize, ends[1] as usize];
    let (shared, a, b) = (cells.shared[a] && cells.shared[b], cells.ids[a], cells.ids[b]);
    shared.then_some(SharedEdge { key: (a, b), vertex, gradient: [0; 3] })
}
