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
//! The table of the 16 cases is derived at compile time (`derive_case`). A tetrahedron with a NaN corner is *void* and
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
//! One look-up for each crossed edge of an active tetrahedron, in a list of the edges of its lower corner; 4 bytes a corner, 68
//! a vertex and 12 a triangle while a chunk is extracted. Buffers are kept for the next chunk.
//!
//! # References
//! Doi, Koide 1991, "An efficient method of triangulating equi-valued surfaces by using tetrahedral cells". The clamp
//! is the symbolic perturbation of a value off the isovalue, made visible enough to leave every triangle an area.

use super::{Vertex, WorldMap};
use crate::geom::{LatticePos, PointId};
use crate::mesh::tet::Tet;
use rustc_hash::FxHashMap;

/// The corners and tetrahedra of (a part of) one chunk. Corner arrays are indexed by chunk-local numbers; entries that
/// no tetrahedron uses may hold anything.
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
    vertices: Vec<Vertex>,
    shared: Vec<SharedEdge>,
    triangles: Vec<[u32; 3]>,
    /// The active tetrahedra of a block; a buffer.
    active: Vec<Tet>,
}

/// Extracts a chunk whose tetrahedra are all at hand. For several blocks use the three methods that this calls.
///
/// # Panics
/// When a tetrahedron names a corner that is not there.
pub fn extract(cells: &CellSource<'_>, isovalue: f32, world: &WorldMap, out: &mut ChunkSurface) {
    out.start(isovalue);
    out.add(cells);
    out.finish(cells, world);
}

impl ChunkSurface {
    /// Empties the buffers for another chunk, or another isovalue.
    pub fn start(&mut self, isovalue: f32) {
        self.isovalue = isovalue;
        self.active_cells = 0;
        self.edges.clear();
        self.vertices.clear();
        self.shared.clear();
        self.triangles.clear();
    }

    /// Adds the active tetrahedra of a block. All blocks between `start` and `finish` number their corners alike.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub fn add(&mut self, cells: &CellSource<'_>) {
        let mut active = std::mem::take(&mut self.active);
        active.clear();
        select_active(cells.tets, cells.values, self.isovalue, &mut active);
        self.add_active(&CellSource { tets: &active, ..*cells });
        self.active = active;
    }

    /// Adds tetrahedra that are known to be active: those that [`select_active`] finds.
    ///
    /// # Panics
    /// When a tetrahedron names a corner that is not there.
    pub fn add_active(&mut self, cells: &CellSource<'_>) {
        self.edges.reserve(cells.ids.len());
        self.active_cells += cells.tets.len() as u64;
        for &tet in cells.tets {
            self.add_tet(cells, tet);
        }
    }

    /// Turns the edges into vertices of the world, and the triangles over when `world` mirrors. `corners` is any source
    /// of the chunk: its tetrahedra are not looked at.
    pub fn finish(&mut self, corners: &CellSource<'_>, world: &WorldMap) {
        self.vertices.reserve(self.edges.crossings.len());
        for (i, (crossing, sum)) in self.edges.crossings.iter().zip(&self.edges.sums).enumerate() {
            let (a, b) = (crossing.low as usize, crossing.high as usize);
            let sums = sum.gradient.map(|x| x as f64);
            let shared = corners.shared[a] && corners.shared[b];
            // The sum of a shared edge is known only at the end: until then its normal is the one for want of a sum.
            // A corner of a cap has no other for the time being: any part of its sum has a direction.
            let normal = if shared && a != b { None } else { world.unit_normal(sums) };
            self.vertices.push(Vertex {
                position: world.between(
                    corners.positions[a],
                    corners.positions[b],
                    self.parameter(corners, a, b),
                ),
                normal: normal.unwrap_or_else(|| along_edge(corners, a, b, world)),
            });
            if shared {
                self.shared.push(SharedEdge {
                    key: (corners.ids[a], corners.ids[b]),
                    vertex: i as u32,
                    gradient: sum.gradient,
                });
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
        self.edges.heads.capacity() * 4
            + self.edges.overflow.capacity() * 16
            + self.edges.crossings.capacity() * (size_of::<Crossing>() + size_of::<GradientSum>())
            + self.vertices.capacity() * size_of::<Vertex>()
            + self.shared.capacity() * size_of::<SharedEdge>()
            + self.triangles.capacity() * size_of::<[u32; 3]>()
            + self.active.capacity() * size_of::<Tet>()
    }

    /// Where on the edge (a, b) the surface crosses it.
    #[inline]
    fn parameter(&self, corners: &CellSource<'_>, a: usize, b: usize) -> f64 {
        const LEAST: f64 = 1.0 / 1024.0;
        let (fa, fb) = (f64::from(corners.values[a]), f64::from(corners.values[b]));
        let t = (f64::from(self.isovalue) - fa) / (fb - fa);
        // Two infinities leave no number; the middle is as good as any point.
        if t.is_nan() { 0.5 } else { t.clamp(LEAST, 1.0 - LEAST) }
    }

    /// The isovalue.
    pub(super) fn isovalue(&self) -> f32 {
        self.isovalue
    }

    /// Makes room for the corners of a source.
    pub(super) fn reserve(&mut self, cells: &CellSource<'_>) {
        self.edges.reserve(cells.ids.len());
    }

    /// The vertex of a crossed edge, the corner of lower id first.
    pub(super) fn crossing(&mut self, cells: &CellSource<'_>, low: u32, high: u32) -> u32 {
        let [from, to] = [low, high].map(|c| cells.positions[c as usize].map(f64::from));
        let [f, g] = [low, high].map(|c| f64::from(cells.values[c as usize]));
        self.edges.find_or_add(low, high, || unit(g - f, &from, &to))
    }

    /// The vertex at a corner itself: an edge without length. `gradient` is added to its sum.
    pub(super) fn cap_corner(&mut self, corner: u32, gradient: [f64; 3]) -> u32 {
        let at = self.edges.find_or_add(corner, corner, || 1.0);
        self.edges.sums[at as usize].add(gradient);
        at
    }

    /// Adds a triangle of vertices that are there.
    pub(super) fn push_triangle(&mut self, triangle: [u32; 3]) {
        self.triangles.push(triangle);
    }

    #[inline]
    fn add_tet(&mut self, cells: &CellSource<'_>, tet: Tet) {
        let (corners, odd) = sort_by_id(tet, cells.ids);
        let values = corners.map(|c| cells.values[c as usize]);
        // At most 2^24; unlike u32, i32 converts in one instruction.
        let positions = corners.map(|c| cells.positions[c as usize].map(|x| f64::from(x as i32)));
        let inside = (0..4).fold(0, |mask, i| mask | usize::from(values[i] >= self.isovalue) << i);
        let gradient = gradient(&positions, values, odd);
        let case = &CASES[usize::from(odd)][inside];
        let mut vertex = [0u32; 6];
        for &e in &case.edges[..case.crossed] {
            let [i, j] = EDGES[e as usize].map(usize::from);
            let at = self.edges.find_or_add(corners[i], corners[j], || {
                unit(f64::from(values[j]) - f64::from(values[i]), &positions[i], &positions[j])
            });
            self.edges.sums[at as usize].add(gradient);
            vertex[e as usize] = at;
        }
        for t in &case.triangles[..case.count] {
            self.triangles.push(t.map(|e| vertex[e as usize]));
        }
    }
}

/// Appends the active tetrahedra to `active`: those of which [`crate::mesh::tet::is_active`] holds, found without branches.
///
/// # Panics
/// When a tetrahedron names a corner without a value.
pub fn select_active(tets: &[Tet], values: &[f32], isovalue: f32, active: &mut Vec<Tet>) {
    const BATCH: usize = 256;
    let mut found = [[0; 4]; BATCH];
    for tets in tets.chunks(BATCH) {
        let mut count = 0;
        for &tet in tets {
            let v = tet.map(|c| values[c as usize]);
            let inside: u32 = v.iter().map(|&x| u32::from(x >= isovalue)).sum();
            let outside: u32 = v.iter().map(|&x| u32::from(x < isovalue)).sum();
            found[count] = tet;
            // A NaN is neither inside nor outside, so the two counts fall short of 4.
            count += usize::from((inside > 0) & (outside > 0) & (inside + outside == 4));
        }
        active.extend_from_slice(&found[..count]);
    }
}

/// The corners in the order of their ids, and whether that is an odd permutation.
#[inline]
fn sort_by_id(tet: Tet, ids: &[PointId]) -> (Tet, bool) {
    let id = tet.map(|c| ids[c as usize]);
    let swapped = |i: usize, j: usize| usize::from(id[j] < id[i]);
    let (s01, s02, s03) = (swapped(0, 1), swapped(0, 2), swapped(0, 3));
    let (s12, s13, s23) = (swapped(1, 2), swapped(1, 3), swapped(2, 3));
    let rank = [s01 + s02 + s03, 1 - s01 + s12 + s13, 2 - s02 - s12 + s23, 3 - s03 - s13 - s23];
    let mut sorted = [0; 4];
    for (corner, rank) in tet.into_iter().zip(rank) {
        sorted[rank & 3] = corner;
    }
    (sorted, (s01 ^ s02 ^ s03 ^ s12 ^ s13 ^ s23) == 1)
}

/// 6 V ∇f of the linear interpolant, V > 0. Differences and cross products of lattice positions are exact in `f64`; the
/// rest is rounded, always in the same order because the corners are sorted.
#[inline]
fn gradient(p: &[[f64; 3]; 4], f: [f32; 4], odd: bool) -> [f64; 3] {
    let e: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|k| p[i + 1][k] - p[0][k]));
    let d: [f64; 3] = std::array::from_fn(|i| f64::from(f[i + 1]) - f64::from(f[0]));
    let (n1, n2, n3) = (cross(e[1], e[2]), cross(e[2], e[0]), cross(e[0], e[1]));
    let sign = if odd { -1.0 } else { 1.0 };
    std::array::from_fn(|k| sign * (d[0] * n1[k] + d[1] * n2[k] + d[2] * n3[k]))
}

#[inline]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The power of two that takes |df| |b - a|² to 2^28 … 2^29 (exactly so: only the exponent's bits are looked at).
#[inline]
fn unit(df: f64, a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let length2: f64 = (0..3).map(|k| (b[k] - a[k]) * (b[k] - a[k])).sum();
    let exponent = (df.abs() * length2).to_bits() >> 52;
    // The product of an f32 difference (2^-149 … 2^129, or infinite) and a squared length (up to 2^50) is a normal
    // number or infinite, so the exponent below is that of a normal number.
    f64::from_bits((2 * 1023 + 28 - exponent) << 52)
}

/// The normal for an edge without a gradient sum: that of the shortest gradient with the edge's two values.
#[cold]
fn along_edge(corners: &CellSource<'_>, a: usize, b: usize, world: &WorldMap) -> [f32; 3] {
    let rises = corners.values[a] < corners.values[b];
    let (low, high) = if rises { (a, b) } else { (b, a) };
    let (low, high) = (corners.positions[low], corners.positions[high]);
    let up = std::array::from_fn(|k| f64::from(high[k]) - f64::from(low[k]));
    world.unit_normal(up).expect("the two ends of an edge differ, and the world map is invertible")
}

/// A crossed edge while its chunk is extracted.
#[derive(Clone, Copy, Debug)]
struct Crossing {
    /// Chunk-local corners, that of lower id first.
    low: u32,
    high: u32,
    /// The next crossing of the same lower corner.
    next: u32,
}

/// No crossing.
const NONE: u32 = u32::MAX;

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
    fn add(&mut self, g: [f64; 3]) {
        let term = g.map(|x| x * self.unit);
        // False for a NaN too.
        let good = (term[0].abs() <= LONGEST) & (term[1].abs() <= LONGEST) & (term[2].abs() <= LONGEST);
        let term = if good { term } else { shorten(term) };
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

/// The crossed edges of a chunk, found by their corners.
///
/// Each corner heads a list of the edges of which it is the lower one. Neighbouring tetrahedra have neighbouring corners,
/// so both the heads and the lists are in cache, which the slots of a hash table are not (it spent 40 % of the extraction
/// waiting for them); sums are kept apart, so that a list is in few cache lines. A corner of enormous degree would make a list slow: what
/// exceeds `LONGEST_LIST` goes to a hash table.
#[derive(Debug, Default)]
struct EdgeTable {
    crossings: Vec<Crossing>,
    /// As many, of the same numbers.
    sums: Vec<GradientSum>,
    /// First crossing of each corner; `NONE` without.
    heads: Vec<u32>,
    /// The edges that did not fit their lists; looked up, never iterated.
    overflow: FxHashMap<(u32, u32), u32>,
}

impl EdgeTable {
    const LONGEST_LIST: usize = 32;

    /// Forgets all edges, in time proportional to their number.
    fn clear(&mut self) {
        for crossing in self.crossings.drain(..) {
            self.heads[crossing.low as usize] = NONE;
        }
        self.sums.clear();
        self.overflow.clear();
    }

    /// Makes room for corners below `corners`.
    fn reserve(&mut self, corners: usize) {
        if self.heads.len() < corners {
            self.heads.resize(corners, NONE);
        }
    }

    #[inline]
    fn find_or_add(&mut self, low: u32, high: u32, unit: impl FnOnce() -> f64) -> u32 {
        let first = self.heads[low as usize];
        let (mut at, mut length) = (first, 0);
        while at != NONE {
            let crossing = &self.crossings[at as usize];
            if crossing.high == high {
                return at;
            }
            (at, length) = (crossing.next, length + 1);
        }
        let number = self.crossings.len() as u32;
        assert!(number < NONE, "a chunk has fewer than 2^32 - 1 crossed edges");
        if length < Self::LONGEST_LIST {
            self.heads[low as usize] = number;
        } else if let Some(known) = self.find_or_add_overflow((low, high), number) {
            return known;
        }
        self.crossings.push(Crossing { low, high, next: first });
        self.sums.push(GradientSum { gradient: [0; 3], unit: unit() });
        number
    }

    #[cold]
    fn find_or_add_overflow(&mut self, key: (u32, u32), number: u32) -> Option<u32> {
        let known = *self.overflow.entry(key).or_insert(number);
        (known != number).then_some(known)
    }
}

/// The six edges of a tetrahedron with sorted corners, in the order of their keys.
const EDGES: [[u8; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// What to do with a tetrahedron of sorted corners.
#[derive(Clone, Copy, Debug)]
struct Case {
    /// Crossed edges, ascending; the first `crossed` count.
    edges: [u8; 4],
    crossed: usize,
    /// Triangles as edge numbers, each beginning with its smallest; the first `count` count.
    triangles: [[u8; 3]; 2],
    count: usize,
}

/// By orientation (positive, negative) and the mask of corners inside.
static CASES: [[Case; 16]; 2] = {
    let none = Case { edges: [0; 4], crossed: 0, triangles: [[0; 3]; 2], count: 0 };
    let mut cases = [[none; 16]; 2];
    let mut mask = 1;
    while mask < 15 {
        let case = derive_case(mask);
        let [[a, b, c], [d, e, f]] = case.triangles;
        cases[0][mask] = case;
        cases[1][mask] = Case { triangles: [[a, c, b], [d, f, e]], ..case };
        mask += 1;
    }
    cases
};

/// The case of a mask that is neither empty nor full, the corners positively oriented.
///
/// In a positively oriented tetrahedron (i, j, k, l), the triangle (ij, ik, il) looks away from i, and the quadrilateral
/// (ik, il, jl, jk) from i and j to k and l. So list the corners inside, then those outside, each ascending; one corner
/// alone is put first; an odd list, or a corner alone outside, turns the polygon over.
const fn derive_case(mask: usize) -> Case {
    let inside = mask.count_ones();
    let alone_outside = inside == 3;
    let first = if alone_outside { !mask & 15 } else { mask };
    let mut list = [0u8; 4];
    let (mut n, mut corner) = (0, 0);
    while corner < 8 {
        // Two rounds over the four corners: those of `first`, then the others.
        if (first >> (corner % 4) & 1 == 1) == (corner < 4) {
            list[n] = corner as u8 % 4;
            n += 1;
        }
        corner += 1;
    }
    let [i, j, k, l] = list;
    let turn = is_odd(list) != alone_outside;
    if inside != 2 {
        let edges = [edge(i, j), edge(i, k), edge(i, l), 0];
        let triangle = if turn { [edges[0], edges[2], edges[1]] } else { [edges[0], edges[1], edges[2]] };
        return Case { edges, crossed: 3, triangles: [triangle, [0; 3]], count: 1 };
    }
    let quad = [edge(i, k), edge(i, l), edge(j, l), edge(j, k)];
    let quad = if turn { [quad[0], quad[3], quad[2], quad[1]] } else { quad };
    // Begin at the smallest edge: the diagonal starts there.
    let mut s = 0;
    let mut at = 1;
    while at < 4 {
        if quad[at] < quad[s] {
            s = at;
        }
        at += 1;
    }
    let (p, q, r, t) = (quad[s], quad[(s + 1) % 4], quad[(s + 2) % 4], quad[(s + 3) % 4]);
    Case { edges: sorted([p, q, r, t]), crossed: 4, triangles: [[p, q, r], [p, r, t]], count: 2 }
}

/// The number of the edge between two corners.
const fn edge(a: u8, b: u8) -> u8 {
    let mut e = 0;
    while e < 6 {
        let [i, j] = EDGES[e];
        if (i == a && j == b) || (i == b && j == a) {
            return e as u8;
        }
        e += 1;
    }
    panic!("two different corners of a tetrahedron have an edge");
}

const fn is_odd(list: [u8; 4]) -> bool {
    let (mut odd, mut i) = (false, 0);
    while i < 16 {
        odd ^= i / 4 < i % 4 && list[i / 4] > list[i % 4];
        i += 1;
    }
    odd
}

const fn sorted(mut list: [u8; 4]) -> [u8; 4] {
    let mut i = 0;
    while i < 16 {
        let (a, b) = (i / 4, i % 4);
        if a < b && list[a] > list[b] {
            let swap = list[a];
            list[a] = list[b];
            list[b] = swap;
        }
        i += 1;
    }
    list
}

#[cfg(test)]
#[path = "marching_tets_tests.rs"]
mod tests;
