//! The Delaunay tetrahedralization of lattice points: an incremental Bowyer–Watson kernel.
//!
//! # How it works
//! Points go in one by one, in the [`Order`] of their positions. The tetrahedra whose circumsphere
//! holds the new point form its **cavity**; they are removed, and the facets of the cavity's
//! boundary are joined to the point (Bowyer 1981, Watson 1981):
//!
//! ```text
//!    ·───────·              ·───────·
//!   ╱ ╲     ╱ ╲            ╱ ╲  ╱   ╲     1. a first tetrahedron in conflict: usually known already (5), else a walk
//!  ╱   ╲  p╱   ╲          ╱   ╲p     ╲    2. breadth first over neighbours: in conflict, or boundary
//! ·─────╲·╱─────·   ──▶  ·───╱─·╲─────·   3. number the boundary's vertices, join its facets along common edges
//!  ╲     ╱ ╲   ╱          ╲ ╱    ╲   ╱    4. write a tetrahedron per facet, with its sphere
//!   ╲   ╱   ╲ ╱            ╲      ╲ ╱     5. those whose sphere holds the *next* point are the start of its cavity
//!    ·───────·              ·───────·
//! ```
//!
//! Infinity is a vertex: each hull facet has a **ghost** joined to it, so the hull is no special
//! case.
//!
//! **Floating point only filters.** A sphere answers only when its proven error bound lets it (see
//! `Margin` in `arena.rs`); otherwise the exact predicates decide. Ties follow the insertion order
//! ([`crate::predicates`]), so the result is unique: a function of the set of positions and
//! the [`Order`], not of the machine, nor of which code path ran.
//!
//! **Everything degenerate is normal.** Coplanar and cospherical points need no special case. The
//! first tetrahedron takes the first four points that span space; points skipped on the way are
//! then inserted out of order, and until they are in, every test is exact and uses the full tie
//! rule. Coordinates are shifted to the set's corner and divided by the largest common power of
//! two, which makes lattice-like sets small numbers.
//!
//! # Cost
//! On uniform points an insertion removes 21 tetrahedra and makes 27. In AVX2 that took 9 500
//! instructions, four a cycle, and some 35 jumps that cannot be predicted (ends of short loops;
//! "does this sphere hold the next point"). These bound it, not memory. `wide.rs` followed from
//! this, a fifth faster. Now a third of the time is the search of the cavity, a chain of loads
//! (record, neighbour, its sphere, the next record), and a fifth the numbering of its vertices.
//!
//! The following were tried and dropped, as slower: plain Hilbert order, walks by orientation,
//! predicates by cached minors, spheres in `f32` (ten times the exact tests), a hash in place of
//! the table of edges, one wide load for neighbour codes just stored one by one (it waits for
//! them), loops of a fixed length over what a batch found. Others made no visible difference, or
//! less than 3 %. These were: prefetching the records of the next batch, those that the round
//! before made near the next points, and new ones; testing eight tetrahedra before the first four
//! are sorted; inserting two points far apart together, their cavities growing by turns (marks of
//! their own show whether they touch). Records at hand would gain a seventh at most: by that much 2
//! 000 points, which fit the second cache, go in faster than 250 000 (on a busy machine).
//!
//! Expected time is O(n log n) with small constants (a cavity has about 20 tetrahedra), worst case
//! O(n²) tetrahedra for points on curves. Memory: 64 bytes a tetrahedron, 16 bytes and a sort key
//! (32 bytes) a point; it is kept in the [`Kernel`] and reused, which makes about 75 bytes a
//! tetrahedron. The sites of a chunk come on top: some 80 in all.

mod arena;
mod exact;
mod pages;
mod plain;
#[cfg(target_arch = "x86_64")]
mod scratch;
#[cfg(target_arch = "x86_64")]
mod simd;
#[cfg(target_arch = "x86_64")]
mod wide;

use crate::mesh::certify::Local;
use crate::mesh::tet::Tet;
use crate::predicates::orient3d;
pub(super) use arena::Tetra;
use arena::{Arena, FIRST_TAG, INFINITE, LocalFrame, MOST_TETS, Margin, Point};
use isospan_io::error::{Error, Result};
use isospan_io::geom::curve::Order;
use isospan_io::geom::{Lattice, LatticePos};
pub(super) use pages::reserve;

/// Which code inserts points; the tetrahedra are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Path {
    Plain,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Path {
    /// The paths that this machine can run, slowest first.
    fn available() -> Vec<Self> {
        let mut all = vec![Self::Plain];
        #[cfg(target_arch = "x86_64")]
        {
            all.extend(simd::is_available().then_some(Self::Avx2));
            all.extend(wide::is_available().then_some(Self::Avx512));
        }
        all
    }
}

impl Default for Path {
    fn default() -> Self {
        Self::available().pop().unwrap_or(Self::Plain)
    }
}

/// Inserts points, and has the mesh that was last made of them.
#[derive(Debug, Default)]
pub(super) struct Kernel {
    arena: Arena,
    path: Path,
    /// Input index of each vertex: in insertion order, then those added late.
    source: Vec<u32>,
    sorted: Vec<(u64, u32)>,
    spare: Vec<(u64, u32)>,
}

impl Kernel {
    /// Takes records that are no longer needed: the next mesh is made in their memory.
    pub(super) fn reuse(&mut self, records: Vec<Tetra>) {
        if records.capacity() > self.arena.tets.capacity() {
            (self.arena.tets, self.arena.free) = (records, vec![]);
            self.arena.tets.clear();
        }
    }

    /// Tetrahedralizes `positions`; of equal positions only the first becomes a vertex. Sets that
    /// span no volume (fewer than four points, all on one line or plane) have no tetrahedra.
    ///
    /// # Errors
    /// [`Error::Usage`] for a coordinate above 2^24, an order finer than [`Order::MOST_BITS`], or
    /// more points or tetrahedra than 2^30 records hold.
    pub(super) fn delaunay(&mut self, positions: &[LatticePos], order: &Order) -> Result<()> {
        self.delaunay_of_first(positions, positions.len(), order)
    }

    /// Tetrahedralizes the first `count` positions; of the others, [`Kernel::add`] may add some.
    ///
    /// # Errors
    /// As [`Kernel::delaunay`].
    pub(super) fn delaunay_of_first(
        &mut self,
        positions: &[LatticePos],
        count: usize,
        order: &Order,
    ) -> Result<()> {
        self.clear();
        check(positions, order)?;
        self.prepare(positions, count, order);
        let Some(first) = self.first_four() else { return Ok(()) };
        self.start(first);
        self.insert_all(first)
    }

    /// Adds a position to a mesh that has tetrahedra, `index` its number among the input positions;
    /// it is not in the mesh yet, and [`Kernel::has_room`] for it. `near` is a record, best one
    /// that it ends. Returns the new records.
    ///
    /// The result is the tetrahedralization of all of them: the tie rule is that of the positions,
    /// whenever they come.
    ///
    /// # Errors
    /// [`Error::Usage`] as [`Kernel::delaunay`].
    pub(super) fn add(&mut self, position: LatticePos, index: u32, near: u32) -> Result<&[u32]> {
        let arena = &mut self.arena;
        arena.in_order = false;
        // The spheres of a half-lattice call a tie "not in conflict", half a quantum beyond the
        // margin; now a tie is a question for the full rule.
        arena.margin.above = arena.margin.e + 1.0;
        let point = arena.frame.point(position);
        arena.points.push(point);
        self.source.push(index);
        let vertex = self.source.len() as u32;
        arena.cavity.clear();
        if !arena.tets[near as usize].is_dead() {
            arena.hint = near;
            if arena.conflicts(near, vertex, point.f64s()) {
                arena.cavity.push(near);
            }
        }
        self.insert(vertex, None)?;
        Ok(&self.arena.star.id)
    }

    /// Where a position is along the curve of the insertion order.
    pub(super) fn key(&self, position: LatticePos) -> u64 {
        self.arena.order.key(position)
    }

    /// Whether [`Kernel::add`] can add a position.
    pub(super) fn has_room(&self, position: LatticePos) -> bool {
        self.arena.frame.has(position)
    }

    /// Makes room for more positions, which now are among `positions`; the others are where they
    /// were.
    ///
    /// # Errors
    /// [`Error::Usage`] as [`Kernel::delaunay`].
    pub(super) fn make_room(&mut self, positions: &[LatticePos]) -> Result<()> {
        check(positions, &self.arena.order)?;
        // Other coordinates, and other spheres for the same tetrahedra.
        let frame = LocalFrame::around(positions);
        let points = &mut self.arena.points;
        for (point, &i) in points[1..].iter_mut().zip(&self.source) {
            point.at = frame.point(positions[i as usize]).at;
        }
        self.arena.margin = margin(points, &frame);
        self.arena.frame = frame;
        for tet in 0..self.arena.tets.len() {
            if !self.arena.tets[tet].is_dead() {
                self.arena.tets[tet].sphere = self.arena.sphere_of(tet as u32);
            }
        }
        Ok(())
    }

    /// Calls `f` with each tetrahedron: vertex numbers are indices into the `positions` last
    /// meshed. The order of calls and the starting vertex of each are not specified.
    pub(super) fn for_each_tet(&self, mut f: impl FnMut(Tet)) {
        for t in &self.arena.tets {
            if !t.is_dead() && !t.v.contains(&INFINITE) {
                f(t.v.map(|v| self.source[v as usize - 1]));
            }
        }
    }

    /// Packs the vertices of some records, ascending, where the records were, four rows each. They
    /// are input indices, turned by `turn`, which also gets what is noted of each record. Returns
    /// the memory of the records, and the number of packed rows; the kernel has no mesh then.
    pub(super) fn pack<T>(
        &mut self,
        kept: impl Iterator<Item = (u32, T)>,
        mut turn: impl FnMut(T, Tet) -> Tet,
    ) -> (Vec<Tetra>, usize) {
        let mut records = std::mem::take(&mut self.arena.tets);
        self.clear();
        let rows: &mut [Tet] = bytemuck::cast_slice_mut(&mut records);
        let mut packed = 0;
        for (id, note) in kept {
            // A record is four rows, and the third has the vertices: nothing that was packed lies
            // behind it.
            let v = rows[4 * id as usize + 2];
            rows[packed] = turn(note, v.map(|v| self.source[v as usize - 1]));
            packed += 1;
        }
        (records, packed)
    }

    /// Forgets the mesh, and keeps the memory.
    pub(super) fn clear(&mut self) {
        self.arena.tets.clear();
        self.arena.free.clear();
    }

    /// Number of records, dead ones included.
    pub(super) fn records(&self) -> u32 {
        self.arena.tets.len() as u32
    }

    /// The vertices (infinity is 0) and the stored sphere of a tetrahedron or ghost; `None` for a
    /// dead record.
    #[inline]
    pub(super) fn record(&self, id: u32) -> Option<([u32; 4], &[f64; 4])> {
        let t = &self.arena.tets[id as usize];
        (!t.is_dead()).then_some((t.v, &t.sphere))
    }

    /// Whether there is no tetrahedron.
    pub(super) fn is_empty(&self) -> bool {
        self.arena.tets.is_empty()
    }

    /// The input index of a finite vertex.
    #[inline]
    pub(super) fn source(&self, vertex: u32) -> u32 {
        self.source[vertex as usize - 1]
    }

    /// The input indices of vertices 1, 2, ….
    pub(super) fn sources(&self) -> &[u32] {
        &self.source
    }

    /// The coordinates and the margin of the stored spheres.
    pub(super) fn local(&self) -> Local {
        let frame = &self.arena.frame;
        Local { origin: frame.origin, shift: frame.shift, margin: self.arena.margin.e }
    }

    /// Sorts, drops duplicates, and writes the points in scaled local coordinates.
    fn prepare(&mut self, positions: &[LatticePos], count: usize, order: &Order) {
        order.sort(&positions[..count], &mut self.sorted, &mut self.spare);
        self.sorted.dedup_by_key(|e| positions[e.1 as usize]);
        self.source.clear();
        self.source.extend(self.sorted.iter().map(|e| e.1));
        let frame = LocalFrame::around(positions);
        let points = &mut self.arena.points;
        points.clear();
        points.push(Point { at: [f32::NAN; 3], tag: 0 });
        points.extend(self.source.iter().map(|&i| frame.point(positions[i as usize])));
        self.arena.margin = margin(points, &frame);
        (self.arena.frame, self.arena.order, self.arena.tag) = (frame, *order, FIRST_TAG);
        // Uniform points have 6.8 tetrahedra each, and ghosts.
        pages::reserve(&mut self.arena.tets, 8 * self.source.len());
    }

    /// The first four vertices, in order, that span a tetrahedron.
    fn first_four(&self) -> Option<[u32; 4]> {
        let n = self.source.len() as u32;
        let at = |v: u32| self.arena.position(v);
        let [a, b] = if n >= 4 { [1, 2] } else { return None };
        let c = (3..=n).find(|&c| !collinear(at(a), at(b), at(c)))?;
        let d = (c + 1..=n).find(|&d| orient3d(at(a), at(b), at(c), at(d)) != 0)?;
        Some([a, b, c, d])
    }

    /// The first tetrahedron and its four ghosts.
    fn start(&mut self, [a, b, c, d]: [u32; 4]) {
        let arena = &mut self.arena;
        let at = |v: u32| arena.position(v);
        let v = if orient3d(at(a), at(b), at(c), at(d)) > 0 { [a, b, c, d] } else { [b, a, c, d] };
        arena.tets.push(Tetra { v, ..Tetra::NONE });
        for i in 0..4 {
            // Infinity takes the place of vertex i, seen from the other side of the facet.
            let mut ghost = v;
            ghost[i] = INFINITE;
            ghost.swap((i + 1) % 4, (i + 2) % 4);
            arena.tets.push(Tetra { v: ghost, ..Tetra::NONE });
        }
        for t in 0..5u32 {
            for i in 0..4 {
                arena.tets[t as usize].n[i] = across(&arena.tets, t, i);
            }
        }
        arena.hint = 0;
        arena.cavity.clear();
    }

    fn insert_all(&mut self, first: [u32; 4]) -> Result<()> {
        let last = self.source.len() as u32;
        let trusted = std::mem::replace(&mut self.arena.margin, Margin::INTEGERS);
        self.arena.in_order = false;
        for vertex in (3..first[3]).filter(|v| !first.contains(v)) {
            self.insert(vertex, None)?;
        }
        // From here on each new point is the latest, and spheres may decide.
        self.arena.in_order = true;
        self.arena.margin = trusted;
        for tet in 0..self.arena.tets.len() {
            self.arena.tets[tet].sphere = self.arena.sphere_of(tet as u32);
        }
        for vertex in first[3] + 1..=last {
            self.insert(vertex, (vertex < last).then_some(vertex + 1))?;
        }
        Ok(())
    }

    #[inline]
    fn insert(&mut self, vertex: u32, next: Option<u32>) -> Result<()> {
        match self.path {
            Path::Plain => self.arena.insert_plain(vertex, next),
            #[cfg(target_arch = "x86_64")]
            Path::Avx2 => simd::insert(&mut self.arena, vertex, next),
            #[cfg(target_arch = "x86_64")]
            Path::Avx512 => wide::insert(&mut self.arena, vertex, next),
        }
        if self.arena.tets.len() > MOST_TETS {
            return Err(Error::usage(
                "a chunk has more than 2^30 tetrahedra; use smaller chunks, or fewer points on one curve",
            ));
        }
        Ok(())
    }
}

/// The places of the other three vertices that make (face, vertex `i`) positively oriented.
pub(super) fn face(i: usize) -> [usize; 3] {
    arena::FACE[i]
}

fn check(positions: &[LatticePos], order: &Order) -> Result<()> {
    if positions.len() >= MOST_TETS {
        return Err(Error::usage(format!("{} points in one chunk; use smaller chunks", positions.len())));
    }
    if order.bits > Order::MOST_BITS {
        return Err(Error::usage(format!(
            "an order of {} bits an axis; at most {} are possible",
            order.bits,
            Order::MOST_BITS
        )));
    }
    match positions.iter().find(|p| p.iter().any(|&c| c > Lattice::LARGEST)) {
        Some(p) => Err(Error::usage(format!("position {p:?} is off the lattice of 2^24 steps"))),
        None => Ok(()),
    }
}

/// The code of face `i` of record `t` as seen from the record across it, among the five of a start.
fn across(tets: &[Tetra], t: u32, i: usize) -> u32 {
    let facet = |t: &Tetra, i: usize| {
        let mut f: Vec<u32> = (0..4).filter(|&k| k != i).map(|k| t.v[k] & !arena::DEAD).collect();
        f.sort_unstable();
        f
    };
    let wanted = facet(&tets[t as usize], i);
    for (other, record) in (0u32..).zip(tets) {
        for k in 0..4usize {
            if other != t && facet(record, k) == wanted {
                return other << 2 | k as u32;
            }
        }
    }
    unreachable!("two of the five tetrahedra of a start share each facet")
}

fn collinear(a: LatticePos, b: LatticePos, c: LatticePos) -> bool {
    let minus = |p: LatticePos| -> [i64; 3] { std::array::from_fn(|k| i64::from(p[k]) - i64::from(a[k])) };
    let (u, v) = (minus(b), minus(c));
    (0..3).all(|k| u[k] * v[(k + 1) % 3] == u[(k + 1) % 3] * v[k])
}

/// The margin that suits the points: small against their spacing, and exact spheres where they look
/// like a lattice.
fn margin(points: &[Point], frame: &LocalFrame) -> Margin {
    let finite = &points[1..];
    let (least, most) = finite.iter().fold(([f32::MAX; 3], [0f32; 3]), |(least, most), p| {
        (std::array::from_fn(|k| least[k].min(p.at[k])), std::array::from_fn(|k| most[k].max(p.at[k])))
    });
    let size: [f64; 3] = std::array::from_fn(|k| f64::from((most[k] - least[k]).max(0.0)));
    let extent = size.into_iter().fold(1.0, f64::max);
    let volume = size.into_iter().map(|s| s.max(1.0)).product::<f64>();
    let spacing = (volume / finite.len().max(1) as f64).cbrt();
    let wished = spacing * spacing / f64::from(1u32 << 16);
    // Positions that come later may be the largest.
    Margin::new(wished, frame.largest(), extent <= 65_536.0 || mostly_coarse(finite))
}

/// Whether at least a quarter of the points (of a sample) lie on a lattice 16 times coarser,
/// wherever its origin: in a chunk, the least coordinates may be those of points that are not on
/// it.
fn mostly_coarse(points: &[Point]) -> bool {
    let step = (points.len() / 1024).max(1);
    let mut residues: Vec<_> = points.iter().step_by(step).map(|p| p.pos().map(|c| c % 16)).collect();
    residues.sort_unstable();
    let most = residues.chunk_by(|a, b| a == b).map(<[_]>::len).max().unwrap_or(0);
    4 * most >= residues.len()
}

#[cfg(test)]
mod tests;
