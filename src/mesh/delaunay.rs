//! The Delaunay tetrahedralization of lattice points: an incremental Bowyer–Watson kernel.
//!
//! # How it works
//! Points go in one by one, in the [`Order`] of their positions. The tetrahedra whose circumsphere holds the new point form its
//! **cavity**; they are removed, and the facets of the cavity's boundary are joined to the point (Bowyer 1981, Watson 1981):
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
//! Infinity is a vertex: each hull facet has a **ghost** joined to it, so the hull is no special case.
//!
//! **Floating point only filters.** A sphere answers only when its proven error bound lets it (see `Margin` in
//! `arena.rs`); otherwise the exact predicates decide. Ties follow the insertion order ([`crate::geom::predicates`]), so the result is unique:
//! a function of the set of positions and the [`Order`], not of the machine, nor of which code path ran.
//!
//! **Everything degenerate is normal.** Coplanar and cospherical points need no special case. The first tetrahedron takes the first
//! four points that span space; points skipped on the way are then inserted out of order, and until they are in, every test is exact and uses the full
//! tie rule. Coordinates are shifted to the set's corner and divided by the largest common power of two, which makes lattice-like sets small numbers.
//!
//! # Cost
//! Expected time is O(n log n) with small constants (a cavity has about 20 tetrahedra), worst case O(n²) tetrahedra for points on
//! curves. Memory: 64 bytes a tetrahedron, 16 bytes and a sort key (32 bytes) a point; it is kept in the [`Mesher`] and reused.

mod arena;
mod exact;
mod pages;
mod plain;
#[cfg(target_arch = "x86_64")]
mod simd;

use crate::error::{Error, Result};
use crate::geom::curve::Order;
use crate::geom::predicates::orient3d;
use crate::geom::{Lattice, LatticePos};
use crate::mesh::certify::Local;
use crate::mesh::tet::Tet;
use arena::{Arena, FIRST_TAG, INFINITE, MOST_TETS, Margin, Point, Tetra};

/// Which code inserts points; the tetrahedra are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Path {
    Plain,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Default for Path {
    fn default() -> Self {
        #[cfg(target_arch = "x86_64")]
        if simd::is_available() {
            return Self::Avx2;
        }
        Self::Plain
    }
}

/// The reusable memory of one worker, and the mesh that was last built in it.
#[derive(Debug, Default)]
pub struct Mesher {
    arena: Arena,
    path: Path,
    /// Input index of each point in insertion order.
    source: Vec<u32>,
    frame: Frame,
    sorted: Vec<(u64, u32)>,
    spare: Vec<(u64, u32)>,
    /// Scratch of the chunk stage, kept here so that its pages are not asked for again in each chunk.
    pub(super) owned: Vec<Tet>,
}

impl Mesher {
    /// An empty worker.
    pub fn new() -> Self {
        Self::default()
    }

    /// Tetrahedralizes `positions`; of equal positions only the first becomes a vertex. Sets that span no volume (fewer than
    /// four points, all on one line or plane) have no tetrahedra.
    ///
    /// # Errors
    /// [`Error::Usage`] for a coordinate above 2^24, an order finer than [`Order::MOST_BITS`], or more points or tetrahedra than 2^30 records hold.
    pub fn delaunay(&mut self, positions: &[LatticePos], order: &Order) -> Result<()> {
        self.arena.tets.clear();
        self.arena.free.clear();
        check(positions, order)?;
        self.prepare(positions, order);
        let Some(first) = self.first_four() else { return Ok(()) };
        self.start(first);
        self.insert_all(first)
    }

    /// Calls `f` with each tetrahedron: vertex numbers are indices into the `positions` last meshed. The order of calls and
    /// the starting vertex of each are not specified.
    pub fn for_each_tet(&self, mut f: impl FnMut(Tet)) {
        for t in &self.arena.tets {
            if !t.is_dead() && !t.v.contains(&INFINITE) {
                f(t.v.map(|v| self.source[v as usize - 1]));
            }
        }
    }

    /// Calls `f` with the vertices (infinity is 0) and the stored sphere of each tetrahedron and ghost.
    #[inline]
    pub(super) fn for_each_record(&self, mut f: impl FnMut([u32; 4], &[f64; 4])) {
        for t in self.arena.tets.iter().filter(|t| !t.is_dead()) {
            f(t.v, &t.sphere);
        }
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
        Local { origin: self.frame.origin, shift: self.frame.shift, margin: self.arena.margin.e }
    }

    /// Sorts, drops duplicates, and writes the points in scaled local coordinates.
    fn prepare(&mut self, positions: &[LatticePos], order: &Order) {
        order.sort(positions, &mut self.sorted, &mut self.spare);
        self.sorted.dedup_by_key(|e| positions[e.1 as usize]);
        self.source.clear();
        self.source.extend(self.sorted.iter().map(|e| e.1));
        self.frame = Frame::around(positions);
        let frame = &self.frame;
        let points = &mut self.arena.points;
        points.clear();
        points.push(Point { at: [f32::NAN; 3], tag: 0 });
        points.extend(self.source.iter().map(|&i| frame.point(positions[i as usize])));
        self.arena.tag = FIRST_TAG;
        self.arena.margin = margin(points);
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

/// Shift and scale to small local coordinates.
#[derive(Debug, Default)]
struct Frame {
    origin: LatticePos,
    shift: u32,
}

impl Frame {
    fn around(positions: &[LatticePos]) -> Self {
        let origin = positions.iter().fold([u32::MAX; 3], |m, p| std::array::from_fn(|k| m[k].min(p[k])));
        let bits = positions.iter().fold(0, |bits, p| (0..3).fold(bits, |bits, k| bits | (p[k] - origin[k])));
        Self { origin, shift: if bits == 0 { 0 } else { bits.trailing_zeros() } }
    }

    fn point(&self, p: LatticePos) -> Point {
        Point { at: std::array::from_fn(|k| ((p[k] - self.origin[k]) >> self.shift) as f32), tag: 0 }
    }
}

/// The margin that suits the points: small against their spacing, and exact spheres where they look like a lattice.
fn margin(points: &[Point]) -> Margin {
    let finite = &points[1..];
    let size = finite.iter().fold([0f64; 3], |m, p| {
        let at = p.f64s();
        std::array::from_fn(|k| m[k].max(at[k]))
    });
    let largest = size.into_iter().fold(1.0, f64::max);
    let volume = size.into_iter().map(|s| s.max(1.0)).product::<f64>();
    let spacing = (volume / finite.len().max(1) as f64).cbrt();
    let wished = spacing * spacing / f64::from(1u32 << 16);
    Margin::new(wished, largest, largest <= 65_536.0 || mostly_coarse(finite))
}

/// Whether at least a quarter of the points (of a sample) lie on a lattice 16 times coarser.
fn mostly_coarse(points: &[Point]) -> bool {
    let step = (points.len() / 1024).max(1);
    let sample = points.iter().step_by(step);
    let coarse = sample.clone().filter(|p| p.pos().iter().fold(0, |bits, c| bits | c) % 16 == 0).count();
    4 * coarse >= sample.count()
}

#[cfg(test)]
mod tests;
