//! Marching tetrahedra on the tetrahedra of one chunk.
//!
//! # How does it work?
//!
//! A corner whose value is `>= isovalue` is *inside*. A tetrahedron with corners on both sides is active, and the
//! surface cuts it in one triangle (one corner against three) or one quadrilateral (two against two). The corners are
//! first sorted by [`PointId`], so a tetrahedron gives the same triangles however its corners were listed:
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
//! The table of the 16 cases is derived at compile time (`cases.rs`). A tetrahedron with a NaN corner is *void* and
//! gives nothing: no surface is invented across a hole in the data.
//!
//! # Where is a vertex?
//!
//! On the edge (a, b), a the lower id, at `a + t (b - a)`, `t = (isovalue - f_a) / (f_b - f_a)`, computed in `f64` from
//! exact lattice positions in this one order: every tetrahedron and every chunk around the edge computes the same bits.
//!
//! `t` is clamped to [1/1024, 1 - 1/1024]. Without that, a corner value equal to the isovalue would put the vertices
//! of all its edges on one point, and zero-area triangles between them. The clamp moves a vertex by at most 1/1024 of
//! its edge and cannot open or fold the surface: which edges carry a vertex, and which vertices a triangle joins, depend
//! on inside and outside alone, never on `t`; the clamped surface is that of another field with the same corners inside.
//! Nor can a triangle be degenerate: its three vertices lie strictly inside three edges of a tetrahedron that do not form
//! one of its faces, so their barycentric coordinates are linearly independent. (Rounding to `f32` at the very end may
//! still flatten a triangle that is smaller than the spacing of `f32` numbers at its place.)
//!
//! So the surface of a mesh of a box is a manifold, open only where the box ends. With voids, it also ends at them, and a
//! vertex on an edge where two otherwise separate groups of non-void tetrahedra touch belongs to two sheets.
//!
//! # Which way is its normal?
//!
//! Minus the mean gradient around the edge: the sum over the tetrahedra around it of volume × ∇f of the linear
//! interpolant. With e_i = p_i - p_0 and d_i = f_i - f_0,
//!
//! ```text
//! 6 V ∇f = d_1 (e_2 × e_3) + d_2 (e_3 × e_1) + d_3 (e_1 × e_2)
//! ```
//!
//! All tetrahedra around a crossed edge are active, so all are seen, though maybe by several chunks. To make the sum
//! independent of who adds what first, each term is rounded to integers, and integers are summed. The unit is a power of
//! two made from the edge itself (|f_b - f_a| |p_b - p_a|² is about 2^28 units), so neither the range of the field nor the
//! density of the points matters. A term longer than 2^50 units is shortened, its direction kept. Because the component of
//! every term along the edge is 6 V (f_b - f_a), the terms cannot cancel; only infinite values leave no direction, and
//! then the edge's own is used: the shortest gradient that explains its two values.
//!
//! # Cost
//!
//! One look-up for each crossed edge of an active tetrahedron, in a cache line of the edges of its lower corner (`edges.rs`); 4 bytes a
//! corner, about 90 a vertex and 12 a triangle while a chunk is extracted. Buffers are kept for the next chunk.
//!
//! # References
//! Doi, Koide 1991, "An efficient method of triangulating equi-valued surfaces by using tetrahedral cells". The clamp
//! is the symbolic perturbation of a value off the isovalue, made visible enough to leave every triangle an area.

use super::cases::{CASES, ODD, ORDERS};
use super::edges::{EdgeTable, Found};
use super::{Vertex, WorldMap};
use crate::geom::{LatticePos, PointId};
use crate::mesh::tet::Tet;

/// The corners and tetrahedra of (a part of) one chunk. Corner arrays are indexed by the numbers that the tetrahedra use; entries
/// that no tetrahedron uses may hold anything.
#[derive(Clone, Copy, Debug)]
pub struct CellSource<'a> {
    /// Positions of the corners.
    pub positions: &'a [LatticePos],
    /// Values of the corners; NaN where there is no data.
    pub values: &'a [f32],
    /// Ids of the corners.
    pub ids: &'a [PointId],
    /// Whether tetrahedra of other chunks use the corner. `true` is always right, and costs memory in the builder.
    pub shared: &'a [bool],
    /// The number that each corner has in the chunk, where `tets` number the corners of a block for themselves: then what is
    /// looked at lies together.
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

/// The surface of one chunk: vertices welded inside the chunk, in order of first use, and triangles.
#[derive(Debug, Default)]
pub struct ChunkSurface {
    isovalue: f32,
    active_cells: u64,
    edges: EdgeTable,
    /// The gradient around each edge.
    sums: Vec<GradientSum>,
    vertices: Vec<Vertex>,
    shared: Vec<SharedEdge>,
    triangles: Vec<[u32; 3]>,
    /// Finds the active tetrahedra of a block, which are then here: buffers.
    sides: Sides,
    active: Vec<Tet>,
}

/// Extracts a chunk whose tetrahedra are all at hand. For several blocks use the three methods that this calls.
///
/// # Panics
/// When a tetrahedron names a corner that is not there.
pub fn extract(cells: &CellSource<'_>, isovalue: f32, world: &WorldMap, out: &mut ChunkSurface) {
    out.start(isovalue, cells.ids.len());
    out.add(cells, world);
    out.finish(world);
}

impl ChunkSurface {
    /// Empties the buffers for another chunk, of so many corners, or another isovalue.
    pub fn start(&mut self, isovalue: f32, corners: usize) {
        self.isovalue = isovalue;
        self.active_cells = 0;
        self.edges.clear(corners);
        self.sums.clear();
        self.vertices.clear();
        self.shared.clear();
        self.triangles.clear();
    }

    /// Adds the active tetrahedra of a block.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub fn add(&mut self, cells: &CellSource<'_>, world: &WorldMap) {
        let mut active = std::mem::take(&mut self.active);
        active.clear();
        self.sides.select(cells.tets, cells.values, self.isovalue, &mut active);
        self.add_active(&CellSource { tets: &active, ..*cells }, world);
        self.active = active;
    }

    /// Adds tetrahedra that are known to be active: those that [`Sides::select`] finds.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub fn add_active(&mut self, cells: &CellSource<'_>, world: &WorldMap) {
        self.add_batches(cells, world, |tet| Sorted::new(cells.ids, tet));
    }

    /// Adds active tetrahedra of a source whose corners have numbers in the order of their ids, and that are [`in_order`]: of those
    /// nothing is left to be sorted.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub(crate) fn add_active_in_order(&mut self, cells: &CellSource<'_>, world: &WorldMap) {
        self.add_batches(cells, world, Sorted::of_ordered);
    }

    #[inline(always)]
    fn add_batches(&mut self, cells: &CellSource<'_>, world: &WorldMap, sort: impl Fn(&Tet) -> Sorted) {
        self.active_cells += cells.tets.len() as u64;
        let corners = Corners { cells, world, isovalue: self.isovalue };
        // Step after step for many: what takes long in one is then found out while others are worked on.
        let mut batch = [Sorted::default(); BATCH];
        for tets in cells.tets.chunks(BATCH) {
            let batch = &mut batch[..tets.len()];
            for (sorted, tet) in batch.iter_mut().zip(tets) {
                *sorted = sort(tet);
                sorted.look(cells.values, self.isovalue);
            }
            for sorted in &mut *batch {
                sorted.gradient = gradient(cells, sorted.corners, sorted.case);
            }
            match cells.numbers {
                Some(numbers) => self.add_sorted(&corners, batch, |c| numbers[c as usize]),
                None => self.add_sorted(&corners, batch, |c| c),
            }
        }
    }

    /// Adds the triangles of tetrahedra, without a branch that depends on how many: the second triangle, the fourth edge are
    /// written where there is none too, and ignored.
    #[inline(always)]
    fn add_sorted(&mut self, corners: &Corners<'_>, batch: &[Sorted], number: impl Fn(u32) -> u32) {
        const NOTHING: Gradient = Gradient { along: [0.0; 3], largest: 0.0 };
        let mut count = self.triangles.len();
        self.triangles.resize(count + 2 * batch.len(), [0; 3]);
        for tet in batch {
            let case = &CASES[usize::from(tet.case)];
            let mut vertex = [0u32; 4];
            for (k, vertex) in vertex.iter_mut().enumerate() {
                let ends = case.edges[k].map(|i| tet.corners[usize::from(i) % 4]);
                let edge = ends.map(&number);
                *vertex = match self.edges.find(edge) {
                    Some(vertex) => vertex,
                    None => self.find_or_add_behind(corners, ends, edge),
                };
                let gradient = if k < 3 || case.triangles == 2 { &tet.gradient } else { &NOTHING };
                self.sums[*vertex as usize].add(gradient);
            }
            for (k, edges) in case.corners.iter().enumerate() {
                self.triangles[count + k] = edges.map(|e| vertex[usize::from(e) % 4]);
            }
            count += usize::from(case.triangles);
        }
        self.triangles.truncate(count);
    }

    /// The vertex of an edge that is not in the first bucket of its chain. `ends` are numbers of the source, `edge` those of the
    /// chunk.
    #[inline(never)]
    fn find_or_add_behind(&mut self, corners: &Corners<'_>, ends: [u32; 2], edge: [u32; 2]) -> u32 {
        match self.edges.find_or_add_behind(edge) {
            Found::Known(vertex) => vertex,
            Found::New(vertex) => {
                self.sums.push(GradientSum { gradient: [0; 3], unit: corners.unit(ends) });
                self.vertices.push(corners.vertex(ends));
                self.shared.extend(corners.shared_edge(ends, vertex));
                vertex
            }
        }
    }

    /// Ends the chunk: finds normals, and turns the triangles over when `world`, the same as before, mirrors.
    pub fn finish(&mut self, world: &WorldMap) {
        let mut shared = self.shared.iter_mut().peekable();
        for (i, (vertex, sum)) in self.vertices.iter_mut().zip(&self.sums).enumerate() {
            let edge = shared.next_if(|edge| edge.vertex as usize == i);
            // The sum of a shared edge is known only at the end: until then its normal is the one for want of a sum.
            // A corner of a cap has no other for the time being: any part of its sum has a direction.
            let is_part = edge.as_ref().is_some_and(|edge| edge.key.0 != edge.key.1);
            let normal = if is_part { None } else { world.unit_normal(sum.gradient.map(|x| x as f64)) };
            vertex.normal = normal.unwrap_or_else(|| along_edge(vertex.normal, world));
            if let Some(edge) = edge {
                edge.gradient = sum.gradient;
            }
        }
        if world.mirrors() {
            self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
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
            + self.sums.capacity() * size_of::<GradientSum>()
            + self.vertices.capacity() * size_of::<Vertex>()
            + self.shared.capacity() * size_of::<SharedEdge>()
            + self.triangles.capacity() * size_of::<[u32; 3]>()
            + self.active.capacity() * size_of::<Tet>()
            + self.sides.0.capacity()
    }

    /// The isovalue.
    pub(super) fn isovalue(&self) -> f32 {
        self.isovalue
    }

    /// The vertex of a crossed edge, the corner of lower id first; or of a corner itself, as an edge without length.
    pub(super) fn vertex_on(&mut self, cells: &CellSource<'_>, world: &WorldMap, ends: [u32; 2]) -> u32 {
        let corners = Corners { cells, world, isovalue: self.isovalue };
        let edge = ends.map(|c| cells.numbers.map_or(c, |numbers| numbers[c as usize]));
        self.find_or_add_behind(&corners, ends, edge)
    }

    /// Adds to the gradient at a vertex, along an axis of the lattice.
    pub(super) fn pull(&mut self, vertex: u32, axis: usize, units: i64) {
        let sum = &mut self.sums[vertex as usize].gradient[axis];
        *sum = sum.wrapping_add(units);
    }

    /// Adds a triangle of vertices that are there.
    pub(super) fn push_triangle(&mut self, triangle: [u32; 3]) {
        self.triangles.push(triangle);
    }
}

/// The ends of edges, and what is asked about them.
struct Corners<'a> {
    cells: &'a CellSource<'a>,
    world: &'a WorldMap,
    isovalue: f32,
}

impl Corners<'_> {
    /// The power of two that takes |df| |b - a|² to 2^28 … 2^29 (exactly so: only the exponent's bits are looked at); 1 for a
    /// corner itself.
    #[inline]
    fn unit(&self, [a, b]: [u32; 2]) -> f64 {
        if a == b {
            return 1.0;
        }
        let [p, q] = [a, b].map(|c| self.cells.positions[c as usize].map(f64::from));
        let [f, g] = [a, b].map(|c| f64::from(self.cells.values[c as usize]));
        let length2: f64 = (0..3).map(|k| (q[k] - p[k]) * (q[k] - p[k])).sum();
        let exponent = ((g - f).abs() * length2).to_bits() >> 52;
        // The product of an f32 difference (2^-149 … 2^129, or infinite) and a squared length (up to 2^50) is a normal
        // number or infinite, so the exponent below is that of a normal number.
        f64::from_bits((2 * 1023 + 28 - exponent) << 52)
    }

    /// The vertex on an edge. Its normal is for the time being what [`along_edge`] takes.
    #[inline]
    fn vertex(&self, [a, b]: [u32; 2]) -> Vertex {
        let [p, q] = [a, b].map(|c| self.cells.positions[c as usize]);
        let [f, g] = [a, b].map(|c| self.cells.values[c as usize]);
        let (low, high) = if f < g { (p, q) } else { (q, p) };
        // At most 2^24 in size: exact.
        let up = std::array::from_fn(|k| (high[k] as i32 - low[k] as i32) as f32);
        Vertex { position: self.world.between(p, q, self.parameter(f, g)), normal: up }
    }

    /// Where on an edge with these values the surface crosses it.
    #[inline]
    fn parameter(&self, f: f32, g: f32) -> f64 {
        const LEAST: f64 = 1.0 / 1024.0;
        let (f, g) = (f64::from(f), f64::from(g));
        let t = (f64::from(self.isovalue) - f) / (g - f);
        // Two infinities leave no number; the middle is as good as any point.
        if t.is_nan() { 0.5 } else { t.clamp(LEAST, 1.0 - LEAST) }
    }

    /// What is known of an edge that other chunks may have.
    #[inline]
    fn shared_edge(&self, ends: [u32; 2], vertex: u32) -> Option<SharedEdge> {
        let shared = ends.iter().all(|&c| self.cells.shared[c as usize]);
        let [a, b] = ends.map(|c| self.cells.ids[c as usize]);
        shared.then_some(SharedEdge { key: (a, b), vertex, gradient: [0; 3] })
    }
}

/// Tetrahedra that are worked on together.
const BATCH: usize = 64;

/// An active tetrahedron, its corners in the order of their ids.
#[derive(Clone, Copy, Default)]
struct Sorted {
    corners: Tet,
    /// The mask of corners inside, and [`ODD`].
    case: u8,
    gradient: Gradient,
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
        Self { corners, case: order.odd, gradient: Gradient::default() }
    }

    /// Of a tetrahedron that is [`in_order`], by numbers that ascend with the ids.
    #[inline(always)]
    fn of_ordered(&[a, b, c, d]: &Tet) -> Self {
        let odd = u8::from(d < c) * ODD;
        Self { corners: [a, b, c.min(d), c.max(d)], case: odd, gradient: Gradient::default() }
    }

    /// Looks which corners are inside.
    #[inline(always)]
    fn look(&mut self, values: &[f32], isovalue: f32) {
        let inside = |i: usize| u8::from(values[self.corners[i] as usize] >= isovalue) << i;
        self.case |= inside(0) | inside(1) | inside(2) | inside(3);
    }
}

/// The same tetrahedron, its corners in the order of their ids, except that the last two are swapped where its orientation asks for it.
///
/// # Panics
/// When it names a corner that is not there.
#[inline]
pub(crate) fn in_order(ids: &[PointId], tet: &Tet) -> Tet {
    let Sorted { corners: [a, b, c, d], case, .. } = Sorted::new(ids, tet);
    if case == ODD { [a, b, d, c] } else { [a, b, c, d] }
}

/// Finds active tetrahedra: on which side of the isovalue each corner is, a byte, is looked up instead of compared.
#[derive(Clone, Debug, Default)]
pub struct Sides(Vec<u8>);

impl Sides {
    /// A corner inside counts 1, one outside 16, a NaN nothing.
    const OUTSIDE: u8 = 16;
    /// The sums of four corners of which some are inside and all others outside, as bits.
    const ACTIVE: u64 = 1 << (1 + 3 * 16) | 1 << (2 + 2 * 16) | 1 << (3 + 16);

    /// Appends the active tetrahedra to `active`: those of which [`crate::mesh::tet::is_active`] holds.
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

/// 6 V ∇f of the linear interpolant, V > 0. Differences and cross products of lattice positions are exact in `f64`; the
/// rest is rounded, always in the same order because the corners are sorted.
#[inline(always)]
fn gradient(cells: &CellSource<'_>, corners: Tet, case: u8) -> Gradient {
    // At most 2^24; unlike u32, i32 converts in one instruction.
    let p = corners.map(|c| cells.positions[c as usize].map(|x| x as i32));
    let f = corners.map(|c| f64::from(cells.values[c as usize]));
    let e: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|k| f64::from(p[i + 1][k] - p[0][k])));
    let d: [f64; 3] = std::array::from_fn(|i| f[i + 1] - f[0]);
    let (n1, n2, n3) = (cross(e[1], e[2]), cross(e[2], e[0]), cross(e[0], e[1]));
    let sign = if case & ODD != 0 { -1.0 } else { 1.0 };
    Gradient::new(std::array::from_fn(|k| sign * (d[0] * n1[k] + d[1] * n2[k] + d[2] * n3[k])))
}

#[inline]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The normal for an edge without a gradient sum: that of the shortest gradient with the edge's two values, which goes from the
/// lower one to the higher one.
#[cold]
fn along_edge(up: [f32; 3], world: &WorldMap) -> [f32; 3] {
    let up = up.map(f64::from);
    world.unit_normal(up).expect("the two ends of an edge differ, and the world map is invertible")
}

/// 6 V ∇f of a tetrahedron.
#[derive(Clone, Copy, Default)]
struct Gradient {
    along: [f64; 3],
    /// The largest component, in size; infinite or NaN if one of them is.
    largest: f64,
}

impl Gradient {
    #[inline(always)]
    fn new(along: [f64; 3]) -> Self {
        let [x, y, z] = along.map(f64::abs);
        let largest = if x > y { x } else { y };
        let largest = if largest > z { largest } else { z };
        // Nothing is added but where a component is infinite or NaN.
        Self { along, largest: largest + (x + y + z) * 0.0 }
    }
}

/// The gradient around a crossed edge.
#[derive(Clone, Copy, Debug)]
struct GradientSum {
    gradient: [i64; 3],
    /// Units of the sum per value × lattice step².
    unit: f64,
}

impl GradientSum {
    /// Adds one tetrahedron's 6 V ∇f, rounded to integers.
    #[inline]
    fn add(&mut self, g: &Gradient) {
        let mut term = g.along.map(|x| x * self.unit);
        let length = g.largest * self.unit;
        if length > LONGEST || length.is_nan() {
            term = shorten(term);
        }
        for (sum, x) in self.gradient.iter_mut().zip(term) {
            *sum = sum.wrapping_add(round(x));
        }
    }
}

/// Longest component of a term; 2^12 such terms do not overflow.
const LONGEST: f64 = (1u64 << 50) as f64;

/// A term too long to add, shortened by a power of two; nothing for one that is infinite or NaN.
#[cold]
fn shorten(term: [f64; 3]) -> [f64; 3] {
    if !term.iter().all(|x| x.is_finite()) {
        return [0.0; 3];
    }
    let mut term = term;
    while term.iter().any(|x| x.abs() > LONGEST) {
        term = term.map(|x| x * 0.5);
    }
    term
}

/// The nearest integer, for |x| <= 2^50: adding 1.5 · 2^52 leaves it in the low bits.
#[inline]
fn round(x: f64) -> i64 {
    const MAGIC: f64 = (3u64 << 51) as f64;
    ((x + MAGIC).to_bits() as i64).wrapping_sub(MAGIC.to_bits() as i64)
}

#[cfg(test)]
#[path = "marching_tets_tests.rs"]
mod tests;
