//! Marching tetrahedra on the tetrahedra of one chunk.
//!
//! # How does it work?
//!
//! A corner whose value is `>= isovalue` is *inside*. A tetrahedron with corners on both sides is
//! active, and the surface cuts it in one triangle (one corner against three) or one quadrilateral
//! (two against two). The corners are first sorted by [`PointId`], so a tetrahedron gives the same
//! triangles however its corners were listed:
//!
//! ```text
//!          3                         3             corners sorted by id; edges numbered in the
//!         /|\                       /|\            order of their keys (i, j):
//!        / | \                     x-|-x             0: 01   1: 02   2: 03
//!       /  |  \   0 inside:       / \|/ \            3: 12   4: 13   5: 23
//!      x   |   \  one triangle   /   X   \
//!     / \  |    \ (01, 02, 03)  0---/-\---2        0, 1 inside: the quadrilateral (02, 03, 13, 12),
//!    0---x-|-----2               \ x   x /         always cut at its smallest edge key, here 02:
//!     \  x |    /                 \ | | /          (02, 03, 13) and (02, 13, 12)
//!      \ | |   /                   \|/ /
//!          1                         1
//! ```
//!
//! The table of the 16 cases is derived at compile time (`cases.rs`). A tetrahedron with a NaN
//! corner is *void* and gives nothing: no surface is invented across a hole in the data.
//!
//! # Where is a vertex?
//!
//! On the edge (a, b), a the lower id, at `a + t (b - a)`, `t = (isovalue - f_a) / (f_b - f_a)`,
//! computed in `f64` from exact lattice positions in this one order: every tetrahedron and every
//! chunk around the edge computes the same bits.
//!
//! `t` is clamped to [1/1024, 1 - 1/1024]. Without that, a corner value equal to the isovalue would
//! put the vertices of all its edges on one point, and zero-area triangles between them. The clamp
//! moves a vertex by at most 1/1024 of its edge and cannot open or fold the surface: which edges
//! carry a vertex, and which vertices a triangle joins, depend on inside and outside alone, never
//! on `t`; the clamped surface is that of another field with the same corners inside. Nor can a
//! triangle be degenerate: its three vertices lie strictly inside three edges of a tetrahedron that
//! do not form one of its faces, so their barycentric coordinates are linearly independent.
//! (Rounding to `f32` at the very end may still flatten a triangle that is smaller than the spacing
//! of `f32` numbers at its place.)
//!
//! So the surface of a mesh of a box is a manifold, open only where the box ends. With voids, it
//! also ends at them, and a vertex on an edge where two otherwise separate groups of non-void
//! tetrahedra touch belongs to two sheets.
//!
//! # Which way is its normal?
//!
//! Minus the mean gradient around the edge: the sum over the tetrahedra around it of volume × ∇f of
//! the linear interpolant. With e_i = p_i - p_0 and d_i = f_i - f_0,
//!
//! ```text
//! 6 V ∇f = d_1 (e_2 × e_3) + d_2 (e_3 × e_1) + d_3 (e_1 × e_2)
//! ```
//!
//! All tetrahedra around a crossed edge are active, so all are seen, though maybe by several
//! chunks. To make the sum independent of who adds what first, each term is rounded to integers,
//! and integers are summed. The unit is a power of two made from the edge itself (|f_b - f_a|
//! |p_b - p_a|² is about 2^28 units), so neither the range of the field nor the density of the
//! points matters. A term longer than 2^50 units is shortened, its direction kept. Because the
//! component of every term along the edge is 6 V (f_b - f_a), the terms cannot cancel; only
//! infinite values leave no direction, and then the edge's own is used: the shortest gradient that
//! explains its two values.
//!
//! # Cost
//!
//! The tetrahedra of a block are worked on together (`patch.rs`): their edges are found in a table
//! of their ends, small enough for the nearest cache (`numbering.rs`), or, in a block whose values
//! change, have been numbered before (`numbered.rs`); of a block that is kept for many isovalues
//! all is known that does not depend on them (`known/`). Only those around which the block has not
//! all tetrahedra, a third of the edges but most of the look-ups, are then found in their chunk, in
//! a cache line of the edges of their lower corner (`edges.rs`). 4 bytes a corner, 24 a vertex,
//! about 70 more for each of those edges, and 12 a triangle while a chunk is extracted. Buffers are
//! kept for the next chunk.
//!
//! # References
//! Doi, Koide 1991, "An efficient method of triangulating equi-valued surfaces by using tetrahedral
//! cells". The clamp is the symbolic perturbation of a value off the isovalue, made visible enough
//! to leave every triangle an area.

use super::cases::{ODD, ORDERS};
use super::edges::{EdgeTable, Found};
use super::fours::{self, Corner};
use super::known::{Crossed, KnownBlock, Maker};
use super::numbered::{BlockBuffers, NumberedBlock};
use super::numbering::Numbering;
use super::patch::{self, Corners, Patch};
use super::{Vertex, WorldMap};
use crate::geom::{LatticePos, PointId};
use crate::mesh::tet::Tet;
use crate::simd::{Avx2, F64x4s, Plain, on_avx2_or_plain};

/// The corners and tetrahedra of (a part of) one chunk. Corner arrays are indexed by the numbers
/// that the tetrahedra use; entries that no tetrahedron uses may hold anything.
#[derive(Clone, Copy, Debug)]
pub struct CellSource<'a> {
    /// Positions of the corners.
    pub positions: &'a [LatticePos],
    /// Values of the corners; NaN where there is no data.
    pub values: &'a [f32],
    /// Ids of the corners.
    pub ids: &'a [PointId],
    /// Whether tetrahedra of other chunks use the corner. `true` is always right, and costs memory
    /// in the builder.
    pub shared: &'a [bool],
    /// The number that each corner has in the chunk, where `tets` number the corners of a block for
    /// themselves. Then the data of a block lies together.
    pub numbers: Option<&'a [u32]>,
    /// Positively oriented tetrahedra.
    pub tets: &'a [Tet],
}

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
    /// The vertices of edges that have numbers in the chunk: of those that were crossed since
    /// `start`.
    pub(super) of_numbers: Vec<u32>,
    pub(super) vertices: Vec<Vertex>,
    pub(super) shared: Vec<SharedEdge>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Finds the active tetrahedra of a block, which are then here: buffers.
    sides: Sides,
    active: Vec<Tet>,
    /// Buffers for the block that is worked on, and for its edges in the chunk.
    bench: Workbench,
    joined: Joined,
}

/// Buffers in which surfaces are made, some hundred kilobytes. One is enough for all surfaces that
/// a thread works on.
#[derive(Debug, Default)]
pub(crate) struct Workbench {
    numbering: Numbering,
    block: BlockBuffers,
    patch: Patch,
    maker: Maker,
    pub(super) crossed: Crossed,
}

impl Workbench {
    /// Numbers a block, for many isovalues. `None` of one that is too large, or whose corners have
    /// no numbers in a chunk.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(crate) fn number(&mut self, block: &CellSource<'_>) -> Option<NumberedBlock> {
        NumberedBlock::of(block, &mut self.block)
    }

    /// Finds out all about a block that does not depend on the isovalue. `None` of one that is too
    /// large.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(crate) fn know(&mut self, block: &CellSource<'_>, world: &WorldMap) -> Option<KnownBlock> {
        self.maker.make(block, world)
    }

    /// Bytes of memory that the buffers hold.
    pub(crate) fn bytes(&self) -> usize {
        self.numbering.bytes()
            + self.block.bytes()
            + self.patch.bytes()
            + self.maker.bytes()
            + self.crossed.bytes()
    }
}

/// A vertex whose gradient is not yet summed up.
#[derive(Clone, Copy, Debug)]
pub(super) struct OpenVertex {
    pub(super) gradient: [i64; 3],
    pub(super) vertex: u32,
}

/// The edges of a patch, in their chunk.
#[derive(Debug, Default)]
struct Joined {
    /// The vertex of each.
    vertices: Vec<u32>,
    /// The edges whose vertices are new.
    new: Vec<u16>,
    /// The edges that the patch has alone; those that it is the first to have.
    alone: Vec<u16>,
    first: Vec<u16>,
}

/// Extracts a chunk whose tetrahedra are all at hand. For several blocks use the three methods that
/// this calls.
///
/// # Panics
/// When a tetrahedron names a corner that is not there.
pub fn extract(cells: &CellSource<'_>, isovalue: f32, world: &WorldMap, out: &mut ChunkSurface) {
    out.start(isovalue, cells.ids.len());
    out.add(cells, world);
    out.finish(world);
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

    /// Adds the active tetrahedra of a block.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub fn add(&mut self, cells: &CellSource<'_>, world: &WorldMap) {
        let (mut active, mut bench) = (std::mem::take(&mut self.active), std::mem::take(&mut self.bench));
        active.clear();
        self.sides.select(cells.tets, cells.values, self.isovalue, &mut active);
        self.add_active(&CellSource { tets: &active, ..*cells }, world, &mut bench);
        (self.active, self.bench) = (active, bench);
    }

    /// Adds tetrahedra that are known to be active: those that [`Sides::select`] finds.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(crate) fn add_active(&mut self, cells: &CellSource<'_>, world: &WorldMap, bench: &mut Workbench) {
        self.add_active_on(cells, world, bench, Avx2::found());
    }

    /// With vectors of AVX2, or without: the same bits.
    fn add_active_on(
        &mut self,
        cells: &CellSource<'_>,
        world: &WorldMap,
        bench: &mut Workbench,
        avx2: Option<Avx2>,
    ) {
        on_avx2_or_plain!(avx2, F64x4, Plain<f64, 4>, |W, token| self.add_cells::<W>(token, cells, world, bench));
    }

    #[inline(always)]
    fn add_cells<W: F64x4s>(
        &mut self,
        token: W::Token,
        cells: &CellSource<'_>,
        world: &WorldMap,
        Workbench { numbering, patch, .. }: &mut Workbench,
    ) {
        self.active_cells += cells.tets.len() as u64;
        let mut left = cells.tets;
        while !left.is_empty() {
            let cells = CellSource { tets: left, ..*cells };
            let taken = numbering.list(&cells, self.isovalue, |tet| Sorted::new(cells.ids, tet), patch);
            left = &left[taken..];
            self.add_patch::<W>(token, patch, &numbering.corners(&cells), world);
        }
    }

    /// Adds the active tetrahedra of a numbered block, whose numbers in the chunk are below that of
    /// its corners.
    pub(crate) fn add_numbered(&mut self, block: &NumberedBlock, world: &WorldMap, bench: &mut Workbench) {
        self.add_numbered_on(block, world, bench, Avx2::found());
    }

    /// With vectors of AVX2, or without: the same bits.
    pub(super) fn add_numbered_on(
        &mut self,
        block: &NumberedBlock,
        world: &WorldMap,
        bench: &mut Workbench,
        avx2: Option<Avx2>,
    ) {
        on_avx2_or_plain!(avx2, F64x4, Plain<f64, 4>, |W, token| self.add_block::<W>(token, block, world, bench));
    }

    #[inline(always)]
    fn add_block<W: F64x4s>(
        &mut self,
        token: W::Token,
        block: &NumberedBlock,
        world: &WorldMap,
        Workbench { block: buffers, patch, .. }: &mut Workbench,
    ) {
        let active = block.list(self.isovalue, buffers, patch);
        self.active_cells += active as u64;
        if active > 0 {
            self.add_patch::<W>(token, patch, block, world);
        }
    }

    #[inline(always)]
    fn add_patch<W: F64x4s>(
        &mut self,
        token: W::Token,
        patch: &mut Patch,
        corners: &impl Corners,
        world: &WorldMap,
    ) {
        for (edge, &ends) in patch.edges().iter().enumerate() {
            if !patch.is_alone(edge) {
                self.edges.will_be_looked_for(ends.map(|corner| corners.number(corner)));
            }
        }
        patch.sum_gradients::<W>(token, corners.at());
        self.join_edges(patch, corners);
        self.append_vertices::<W>(token, patch, corners.at(), world);
        let vertex = |edge: u16| self.joined.vertices[usize::from(edge)];
        self.triangles.extend(patch.triangles().iter().map(|t| t.map(vertex)));
    }

    /// Finds the vertex of each edge of the patch, or numbers it. What the patch has alone is not
    /// looked for.
    #[inline(always)]
    fn join_edges(&mut self, patch: &Patch, corners: &impl Corners) {
        let Joined { vertices, new, alone, first } = &mut self.joined;
        vertices.clear();
        for list in [&mut *new, &mut *alone, &mut *first] {
            list.clear();
        }
        for (edge, &ends) in patch.edges().iter().enumerate() {
            let next = (self.vertices.len() + new.len()) as u32;
            if patch.is_alone(edge) {
                alone.push(edge as u16);
                new.push(edge as u16);
                vertices.push(next);
                continue;
            }
            let numbers = ends.map(|corner| corners.number(corner));
            let (number, is_new) = find_or_open(&mut self.edges, &mut self.open, numbers, next);
            let open = &mut self.open[number];
            vertices.push(open.vertex);
            for (sum, part) in open.gradient.iter_mut().zip(patch.gradient(edge)) {
                *sum = sum.wrapping_add(part);
            }
            if is_new {
                first.push(edge as u16);
                new.push(edge as u16);
                let key = corners.shared(ends);
                self.shared.extend(key.map(|key| SharedEdge { key, vertex: next, gradient: [0; 3] }));
            }
        }
    }

    /// Adds the new vertices, with normals where their gradients are known; until then a normal is
    /// what [`along_edge`] takes.
    #[inline(always)]
    fn append_vertices<W: F64x4s>(
        &mut self,
        token: W::Token,
        patch: &Patch,
        at: &[Corner],
        world: &WorldMap,
    ) {
        let Joined { vertices, new, alone, first } = &self.joined;
        patch.append_vertices::<W>(token, at, new, (self.isovalue, world), &mut self.vertices);
        let vertex = |edge: u16| vertices[usize::from(edge)] as usize;
        for &edge in first {
            self.vertices[vertex(edge)].normal = patch.up(at, edge.into());
        }
        for four in alone.chunks(4) {
            let mut sums = [[0; 3]; 4];
            for (sum, &edge) in sums.iter_mut().zip(four) {
                *sum = patch.gradient(edge.into());
            }
            let normals = fours::normals::<W>(token, &sums, world);
            for (&edge, normal) in four.iter().zip(normals) {
                let normal = normal.unwrap_or_else(|| along_edge(patch.up(at, edge.into()), world));
                self.vertices[vertex(edge)].normal = normal;
            }
        }
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

    /// Makes room for `count` edges with numbers.
    pub(crate) fn number_edges(&mut self, count: usize) {
        // Each is set before it is read, and a system hands out cleared pages when they are
        // touched.
        if self.of_numbers.len() < count {
            self.of_numbers = vec![0; count];
        }
    }

    /// Bytes of memory that the buffers hold.
    pub fn bytes(&self) -> usize {
        4 * self.of_numbers.capacity()
            + self.edges.bytes()
            + self.open.capacity() * size_of::<OpenVertex>()
            + self.vertices.capacity() * size_of::<Vertex>()
            + self.shared.capacity() * size_of::<SharedEdge>()
            + self.triangles.capacity() * size_of::<[u32; 3]>()
            + self.active.capacity() * size_of::<Tet>()
            + self.sides.0.capacity()
            + self.bench.bytes()
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
fn find_or_open(
    edges: &mut EdgeTable,
    open: &mut Vec<OpenVertex>,
    edge: [u32; 2],
    next: u32,
) -> (usize, bool) {
    match edges.find_or_add(edge) {
        Found::Known(number) => (number as usize, false),
        Found::New(number) => {
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

/// An active tetrahedron, its corners in the order of their ids.
#[derive(Clone, Copy, Default)]
pub(super) struct Sorted {
    pub(super) corners: Tet,
    /// The mask of corners inside, and [`ODD`].
    pub(super) case: u8,
}

impl Sorted {
    #[inline(always)]
    fn new(ids: &[PointId], tet: &Tet) -> Self {
        let id = tet.map(|c| ids[c as usize]);
        let swapped = |i: usize, j: usize, bit: u32| usize::from(id[j] < id[i]) << bit;
        let order = swapped(0, 1, 0) | swapped(0, 2, 1) | swapped(0, 3, 2);
        let order = order | swapped(1, 2, 3) | swapped(1, 3, 4) | swapped(2, 3, 5);
        let order = &ORDERS[order];
        let corners = order.corners.map(|i| tet[usize::from(i) % 4]);
        Self { corners, case: order.odd }
    }

    /// Looks which corners are inside.
    #[inline(always)]
    pub(super) fn look(&mut self, values: &[f32], isovalue: f32) {
        let inside = |i: usize| u8::from(values[self.corners[i] as usize] >= isovalue) << i;
        self.case |= inside(0) | inside(1) | inside(2) | inside(3);
    }
}

/// The same tetrahedron, its corners in the order of their ids, except that the last two are
/// swapped where its orientation asks for it.
///
/// # Panics
/// When it names a corner that is not there.
#[inline]
pub(crate) fn in_order(ids: &[PointId], tet: &Tet) -> Tet {
    let Sorted { corners: [a, b, c, d], case, .. } = Sorted::new(ids, tet);
    if case == ODD { [a, b, d, c] } else { [a, b, c, d] }
}

/// Finds active tetrahedra: on which side of the isovalue each corner is, a byte, is looked up
/// instead of compared.
#[derive(Clone, Debug, Default)]
pub struct Sides(Vec<u8>);

impl Sides {
    /// A corner inside counts 1, one outside 16, a NaN nothing.
    const OUTSIDE: u8 = 16;
    /// The sums of four corners, some of them inside and all others outside, as bits.
    const ACTIVE: u64 = 1 << (1 + 3 * 16) | 1 << (2 + 2 * 16) | 1 << (3 + 16);

    /// Appends the active tetrahedra to `active`: those for which [`crate::mesh::tet::is_active`]
    /// holds.
    ///
    /// # Panics
    /// When a tetrahedron names a corner without a value.
    pub fn select(&mut self, tets: &[Tet], values: &[f32], isovalue: f32, active: &mut Vec<Tet>) {
        self.set(values, isovalue);
        self.active_of(tets, active);
    }

    /// Looks on which side the corners are.
    pub(crate) fn set(&mut self, values: &[f32], isovalue: f32) {
        let side = |&v: &f32| u8::from(v >= isovalue) | (u8::from(v < isovalue) * Self::OUTSIDE);
        self.0.clear();
        self.0.extend(values.iter().map(side));
    }

    /// Appends the active ones of tetrahedra between the corners, found without branches.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    #[inline]
    pub(crate) fn active_of<N: Copy + Into<u32>>(&self, tets: &[[N; 4]], active: &mut Vec<Tet>) {
        let mut end = active.len();
        active.resize(end + tets.len(), [0; 4]);
        for tet in tets {
            let tet: Tet = tet.map(Into::into);
            let [a, b, c, d] = tet.map(|c| self.0[c as usize]);
            active[end] = tet;
            // Four outside are 64, which counts as 0: not active either.
            end += (Self::ACTIVE >> ((a + b + c + d) % 64) & 1) as usize;
        }
        active.truncate(end);
    }
}

/// The normal for an edge without a gradient sum: that of the shortest gradient with the edge's two
/// values, which goes from the lower one to the higher one.
#[cold]
pub(super) fn along_edge(up: [f32; 3], world: &WorldMap) -> [f32; 3] {
    let up = up.map(f64::from);
    world.unit_normal(up).expect("the two ends of an edge differ, and the world map is invertible")
}

#[cfg(test)]
mod tests;
