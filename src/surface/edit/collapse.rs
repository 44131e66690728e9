//! Edge collapses in a patch of a surface: fewer triangles, the same topology.
//!
//! # How does it work?
//!
//! Every vertex has a *quadric*: the sum over its triangles of area × squared distance to their
//! planes, as a function of the place (Garland, Heckbert). An edge costs the sum of its ends'
//! quadrics where that is least, and there its ends are joined; the cheapest edge of the patch is
//! next, until the goal is reached or no edge may be collapsed:
//!
//! ```text
//!       a                 a           An edge (u, v) may be collapsed when
//!     / | \             / | \         * u and v have exactly two common neighbours, a and b, those of its two triangles, and
//!   x - u - y   ──▶   x   |   y         (u, a, b), (v, a, b) are not both triangles (the link condition: what was
//!     \ | /  \          \ | / \          a manifold stays one, of the same genus);
//!       v - - z           p - - z     * no triangle turns by more than about 78 degrees, or becomes a needle;
//!     / | \             / | \         * the error stays within the goal's.
//! ```
//!
//! A little of the squared distance to the vertices is added to their quadrics, so that the best
//! place is unique on a plane and along a crease, and short edges go first there.
//!
//! **Fixed vertices** stay where they are and are never removed: those that triangles outside the
//! patch use, those on a boundary, those that are no manifold. An edge with one fixed end collapses
//! into it, an edge with two does not. The patch does not know the edges and triangles between
//! fixed vertices that lie outside. So u is not collapsed into a fixed v if u has another fixed
//! neighbour besides a and b: no new edge between fixed vertices ever arises, and patches that
//! share vertices can be worked on side by side.
//!
//! **Vertices on faces of the domain**, where caps are, stay on them. The ends of an edge along a
//! face are joined in it. An edge from a face into the domain, or from a face to the edge of two,
//! collapses into the end that lies on more faces.
//!
//! **The error** of a vertex is an estimate of how far the surface around it is from the original:
//! each collapse adds to the larger one of its ends the largest distance of the new place to the
//! planes of the triangles that it replaces.
//!
//! # Determinism and cost
//! Equal costs are ordered by vertex numbers; only `+ - * /` and `sqrt` decide. O(n log n); up to
//! [`BYTES_PER_TRIANGLE`] for each triangle of the patch.
//!
//! # References
//! Garland, Heckbert 1997, "Surface simplification using quadric error metrics". Dey, Edelsbrunner,
//! Guha, Nekhayev 1999, "Topology preserving edge contraction".

use super::faces::{Faces, OnFaces};
use crate::surface::model::Vertex;
use isospan_io::geom::vec3::{cross, dot, minus};
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// Memory for a triangle of a patch: half a vertex (its fan, quadric, record), three halves of an
/// edge in the queue, and what the queue grows by.
pub(super) const BYTES_PER_TRIANGLE: u64 = 512;
/// No vertex gets more triangles: what a collapse costs grows with them.
const MOST_TRIANGLES: usize = 32;
/// Weight of the squared distance to the vertices, relative to that to the planes.
const NEAR: f64 = 1e-3;
/// Least cosine between the normals of a triangle before and after.
const LEAST_COSINE: f64 = 0.2;
/// Least quality (1 for an equilateral triangle) of a new triangle, unless one that it replaces was
/// worse.
const LEAST_QUALITY: f64 = 0.05;
const GONE: u32 = u32::MAX;

/// A part of a surface.
#[derive(Clone, Debug, Default)]
pub(super) struct Patch {
    pub(super) vertices: Vec<Vertex>,
    /// Estimated distance from the original surface, of each vertex.
    pub(super) errors: Vec<f32>,
    /// Vertices that other triangles than those of the patch use.
    pub(super) fixed: Vec<bool>,
    /// The faces of the domain that each vertex lies on.
    pub(super) on: Vec<OnFaces>,
    /// Counter-clockwise triangles of patch-local vertex numbers.
    pub(super) triangles: Vec<[u32; 3]>,
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub(super) struct Goal {
    /// At this number of triangles.
    pub(super) triangles: usize,
    /// Before a vertex has a larger error.
    pub(super) error: f64,
}

/// Collapses edges of a patch. The triangles that are left keep their order; vertices keep their
/// numbers, though some have no triangle any more.
pub(super) fn collapse_edges(patch: &mut Patch, faces: &Faces, goal: Goal) {
    if patch.triangles.len() <= goal.triangles {
        return;
    }
    let mut work = Work::new(patch, faces);
    while work.alive > goal.triangles {
        let Some(Reverse(edge)) = work.queue.pop() else { break };
        let [u, v] = [edge.u, edge.v];
        if work.age(u, v) == edge.age
            && !work.fans[u as usize].is_empty()
            && !work.fans[v as usize].is_empty()
        {
            work.try_collapse(u, v, goal.error);
        }
    }
    work.patch.triangles.retain(|t| t[0] != GONE);
}

type Vec3 = [f64; 3];

/// x ↦ xᵀ A x + 2 bᵀ x + c, A symmetric: xx xy xz yy yz zz.
#[derive(Clone, Copy, Debug, Default)]
struct Quadric {
    a: [f64; 6],
    b: Vec3,
    c: f64,
}

impl Quadric {
    /// `weight` × squared distance to the plane through `p`, `normal` of unit length.
    fn of_plane(normal: Vec3, p: Vec3, weight: f64) -> Self {
        let [x, y, z] = normal;
        let d = -dot(normal, p);
        Self {
            a: [x * x, x * y, x * z, y * y, y * z, z * z].map(|e| weight * e),
            b: normal.map(|e| weight * d * e),
            c: weight * d * d,
        }
    }

    /// `weight` × squared distance to `p`.
    fn of_point(p: Vec3, weight: f64) -> Self {
        Self { a: [weight, 0.0, 0.0, weight, 0.0, weight], b: p.map(|e| -weight * e), c: weight * dot(p, p) }
    }

    fn plus(mut self, other: &Self) -> Self {
        self.a.iter_mut().zip(other.a).for_each(|(s, x)| *s += x);
        self.b.iter_mut().zip(other.b).for_each(|(s, x)| *s += x);
        self.c += other.c;
        self
    }

    fn at(&self, p: Vec3) -> f64 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let [x, y, z] = p;
        let ap = [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z];
        // Rounding may leave less than nothing.
        (dot(ap, p) + 2.0 * dot(self.b, p) + self.c).max(0.0)
    }

    /// The place where it is least; `None` without such a place.
    fn least(&self) -> Option<Vec3> {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let (r0, r1, r2) = ([xx, xy, xz], [xy, yy, yz], [xz, yz, zz]);
        let columns = [cross(r1, r2), cross(r2, r0), cross(r0, r1)];
        let det = dot(r0, columns[0]);
        let place = [0, 1, 2].map(|k| {
            -(columns[0][k] * self.b[0] + columns[1][k] * self.b[1] + columns[2][k] * self.b[2]) / det
        });
        place.iter().all(|x| x.is_finite()).then_some(place)
    }
}

/// An edge in the queue: cheapest first, then by numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Queued {
    /// The bits of a number that is not negative: ordered as the number is.
    cost: u64,
    u: u32,
    v: u32,
    /// Age of the edge when it was queued.
    age: u32,
}

/// The result of a collapse.
struct JoinedEdge {
    /// The vertex that stays; the other goes.
    stays: u32,
    goes: u32,
    position: [f32; 3],
    cost: f64,
}

struct Work<'a> {
    patch: &'a mut Patch,
    faces: &'a Faces,
    /// Subtracted from positions, so that quadrics lose no digits.
    origin: Vec3,
    /// Triangles of each vertex; none when it is gone.
    fans: Vec<Vec<u32>>,
    quadrics: Vec<Quadric>,
    /// How often a vertex was moved.
    ages: Vec<u32>,
    fixed: Vec<bool>,
    queue: BinaryHeap<Reverse<Queued>>,
    alive: usize,
}

impl<'a> Work<'a> {
    fn new(patch: &'a mut Patch, faces: &'a Faces) -> Self {
        let count = patch.vertices.len();
        let mut fans = vec![vec![]; count];
        for (t, triangle) in (0..).zip(&patch.triangles) {
            triangle.iter().for_each(|&v| fans[v as usize].push(t));
        }
        let origin = patch.vertices.first().map_or([0.0; 3], |v| v.position.map(f64::from));
        let alive = patch.triangles.len();
        let fixed = patch.fixed.clone();
        let quadrics = vec![Quadric::default(); count];
        let mut work = Self {
            patch,
            faces,
            origin,
            fans,
            quadrics,
            ages: vec![0; count],
            fixed,
            queue: BinaryHeap::new(),
            alive,
        };
        for v in 0..count as u32 {
            work.fixed[v as usize] |= !work.is_inside(v);
            work.quadrics[v as usize] = work.quadric(v);
        }
        // Every edge that may be collapsed is run along once in each direction.
        for t in 0..work.patch.triangles.len() {
            let [a, b, c] = work.patch.triangles[t];
            for (u, v) in [(a, b), (b, c), (c, a)] {
                if u < v {
                    work.enqueue(u, v);
                }
            }
        }
        work
    }

    fn on(&self, v: u32) -> OnFaces {
        self.patch.on[v as usize]
    }

    fn place(&self, v: u32) -> Vec3 {
        minus(self.patch.vertices[v as usize].position.map(f64::from), self.origin)
    }

    fn corners(&self, t: u32) -> [Vec3; 3] {
        self.patch.triangles[t as usize].map(|v| self.place(v))
    }

    fn age(&self, u: u32, v: u32) -> u32 {
        self.ages[u as usize].wrapping_add(self.ages[v as usize])
    }

    /// The other two corners of a triangle, in its direction.
    fn opposite(&self, t: u32, v: u32) -> [u32; 2] {
        match self.patch.triangles[t as usize] {
            [a, n, p] | [p, a, n] | [n, p, a] if a == v => [n, p],
            other => unreachable!("triangle {other:?} is in the fan of {v}"),
        }
    }

    /// Whether the triangles of a vertex form one disc around it.
    fn is_inside(&self, v: u32) -> bool {
        let fan = &self.fans[v as usize];
        let arcs: Vec<[u32; 2]> = fan.iter().map(|&t| self.opposite(t, v)).collect();
        let Some(&[start, mut at]) = arcs.first() else { return false };
        let mut steps = 1;
        while at != start && steps <= arcs.len() {
            let mut next = arcs.iter().filter(|arc| arc[0] == at);
            match (next.next(), next.next()) {
                (Some(arc), None) => at = arc[1],
                _ => return false,
            }
            steps += 1;
        }
        at == start && steps == arcs.len() && steps >= 3
    }

    fn quadric(&self, v: u32) -> Quadric {
        let (mut sum, mut weight) = (Quadric::default(), 0.0);
        for &t in &self.fans[v as usize] {
            let [a, b, c] = self.corners(t);
            let normal2 = cross(minus(b, a), minus(c, a));
            let length = dot(normal2, normal2).sqrt();
            if length > 0.0 {
                sum = sum.plus(&Quadric::of_plane(normal2.map(|x| x / length), a, length));
                weight += length;
            }
        }
        sum.plus(&Quadric::of_point(self.place(v), NEAR * weight))
    }

    fn enqueue(&mut self, u: u32, v: u32) {
        if let Some(joined) = self.joined(u, v) {
            let (u, v, age) = (u.min(v), u.max(v), self.age(u, v));
            self.queue.push(Reverse(Queued { cost: joined.cost.to_bits(), u, v, age }));
        }
    }

    /// The place to which an edge would collapse; `None` when both ends are fixed, or the cost is
    /// not a number.
    fn joined(&self, u: u32, v: u32) -> Option<JoinedEdge> {
        let (u, v) = (u.min(v), u.max(v));
        let sum = self.quadrics[u as usize].plus(&self.quadrics[v as usize]);
        let (stays, goes) = match (self.fixed[u as usize], self.fixed[v as usize]) {
            (true, true) => return None,
            (false, true) => (v, u),
            _ => (u, v),
        };
        let (on, of_other) = (self.on(stays), self.on(goes));
        let (stays, goes) = match (on & of_other == of_other, on & of_other == on) {
            (true, _) => (stays, goes),
            // The other end lies on more faces.
            (false, true) if !self.fixed[stays as usize] => (goes, stays),
            _ => return None,
        };
        let position = if self.fixed[stays as usize] || on != of_other {
            self.patch.vertices[stays as usize].position
        } else {
            self.best_place(&sum, self.place(u), self.place(v), on)
        };
        let cost = sum.at(minus(position.map(f64::from), self.origin));
        cost.is_finite().then_some(JoinedEdge { stays, goes, position, cost })
    }

    /// The place where a quadric is least, unless that is far away; else the best of ends and
    /// middle.
    fn best_place(&self, quadric: &Quadric, u: Vec3, v: Vec3, on: OnFaces) -> [f32; 3] {
        let rounded = |p: Vec3| [0, 1, 2].map(|k| (p[k] + self.origin[k]) as f32);
        let middle = [0, 1, 2].map(|k| 0.5 * (u[k] + v[k]));
        let edge = minus(v, u);
        let is_near = |p: &Vec3| dot(minus(*p, middle), minus(*p, middle)) <= 4.0 * dot(edge, edge);
        let cheaper = |a: Vec3, b: Vec3| if quadric.at(b) < quadric.at(a) { b } else { a };
        let of_edge = || cheaper(cheaper(middle, u), v);
        let Some(p) = quadric.least().filter(is_near) else { return rounded(of_edge()) };
        if on == 0 {
            return rounded(p);
        }
        // In the face it may be no better than the ends.
        let way = self.faces.along(on, minus(p, u));
        rounded(cheaper([0, 1, 2].map(|k| u[k] + way[k]), of_edge()))
    }

    fn try_collapse(&mut self, u: u32, v: u32, limit: f64) {
        let Some(joined) = self.joined(u, v) else { return };
        let Some(opposite) = self.linked(joined.stays, joined.goes) else { return };
        let place = minus(joined.position.map(f64::from), self.origin);
        let Some(distance) = self.shape_allows(u, v, place) else { return };
        let larger = self.patch.errors[u as usize].max(self.patch.errors[v as usize]);
        // Rounded up: the estimate of a sum is never below the sum.
        let error = ((f64::from(larger) + distance) as f32).next_up();
        let error = if distance == 0.0 { larger } else { error };
        if f64::from(error) <= limit {
            self.collapse(&joined, opposite, error);
        }
    }

    /// The two vertices opposite an edge that satisfies the link condition.
    fn linked(&self, stays: u32, goes: u32) -> Option<[u32; 2]> {
        let neighbours = |v: u32| {
            let mut all: Vec<u32> = self.fans[v as usize].iter().flat_map(|&t| self.opposite(t, v)).collect();
            all.sort_unstable();
            all.dedup();
            all
        };
        let (of_stays, of_goes) = (neighbours(stays), neighbours(goes));
        let mut common = of_goes.iter().copied().filter(|n| of_stays.binary_search(n).is_ok());
        let (Some(a), Some(b), None) = (common.next(), common.next(), common.next()) else { return None };
        let has = |fan: u32, rest: [u32; 2]| {
            self.fans[fan as usize].iter().any(|&t| {
                let [n, p] = self.opposite(t, fan);
                rest == [n, p] || rest == [p, n]
            })
        };
        if !has(goes, [stays, a]) || !has(goes, [stays, b]) {
            return None;
        }
        let is_fixed = |v: u32| self.fixed[v as usize];
        if is_fixed(stays) && of_goes.iter().any(|&n| is_fixed(n) && ![stays, a, b].contains(&n)) {
            return None;
        }
        let outside = is_fixed(stays) && is_fixed(a) && is_fixed(b);
        if has(goes, [a, b]) && (outside || has(stays, [a, b])) {
            return None;
        }
        // All triangles of a vertex that moves are here.
        (self.fans[stays as usize].len() + self.fans[goes as usize].len() <= MOST_TRIANGLES + 4)
            .then_some([a, b])
    }

    /// The largest distance of the new place to the planes of the triangles around the edge; `None`
    /// when a triangle that is left would turn over or become a needle.
    fn shape_allows(&self, u: u32, v: u32, place: Vec3) -> Option<f64> {
        let (mut farthest, mut worst_before, mut worst) = (0.0f64, 1.0f64, 1.0f64);
        for (fan, other) in [(u, v), (v, u)] {
            for &t in &self.fans[fan as usize] {
                let corners = self.corners(t);
                let (before, quality_before) = shape(corners);
                let length = dot(before, before).sqrt();
                if length > 0.0 {
                    farthest = farthest.max(dot(before, minus(place, corners[0])).abs() / length);
                }
                worst_before = worst_before.min(quality_before);
                let triangle = self.patch.triangles[t as usize];
                if triangle.contains(&other) {
                    continue;
                }
                let moved = [0, 1, 2].map(|k| if triangle[k] == fan { place } else { corners[k] });
                let (after, quality) = shape(moved);
                let cosine = dot(before, after);
                let least = LEAST_COSINE * length * dot(after, after).sqrt();
                // Not a number is no more either.
                if cosine.partial_cmp(&least) != Some(Ordering::Greater) {
                    return None;
                }
                worst = worst.min(quality);
            }
        }
        (worst >= LEAST_QUALITY.min(worst_before)).then_some(farthest)
    }

    fn collapse(&mut self, joined: &JoinedEdge, opposite: [u32; 2], error: f32) {
        let JoinedEdge { stays, goes, position, .. } = *joined;
        let fan = std::mem::take(&mut self.fans[goes as usize]);
        for &t in &fan {
            let triangle = &mut self.patch.triangles[t as usize];
            if triangle.contains(&stays) {
                *triangle = [GONE; 3];
                for v in [stays, opposite[0], opposite[1]] {
                    self.fans[v as usize].retain(|&other| other != t);
                }
                self.alive -= 1;
            } else {
                *triangle = triangle.map(|v| if v == goes { stays } else { v });
                self.fans[stays as usize].push(t);
            }
        }
        self.quadrics[stays as usize] = self.quadrics[stays as usize].plus(&self.quadrics[goes as usize]);
        self.ages[stays as usize] += 1;
        self.patch.errors[stays as usize] = error;
        if !self.fixed[stays as usize] {
            self.patch.vertices[stays as usize] = self.between(stays, goes, position);
        }
        let mut ring: Vec<u32> =
            self.fans[stays as usize].iter().flat_map(|&t| self.opposite(t, stays)).collect();
        ring.sort_unstable();
        ring.dedup();
        ring.into_iter().for_each(|n| self.enqueue(stays, n));
    }

    /// A vertex between two, its normal in the ratio of its distances.
    fn between(&self, a: u32, b: u32, position: [f32; 3]) -> Vertex {
        let (from, to) = (self.place(a), self.place(b));
        let (edge, way) = (minus(to, from), minus(minus(position.map(f64::from), self.origin), from));
        let along = (dot(edge, way) / dot(edge, edge)).clamp(0.0, 1.0);
        let [m, n] = [a, b].map(|v| self.patch.vertices[v as usize].normal);
        let sum: Vec3 = [0, 1, 2].map(|k| (1.0 - along) * f64::from(m[k]) + along * f64::from(n[k]));
        let length = dot(sum, sum).sqrt();
        let normal = if length > 1e-6 { sum.map(|x| (x / length) as f32) } else { m };
        Vertex { position, normal }
    }
}

/// Twice the area vector of a triangle, and its quality: 1 when equilateral, 0 without area.
fn shape([a, b, c]: [Vec3; 3]) -> (Vec3, f64) {
    let (ab, ac, bc) = (minus(b, a), minus(c, a), minus(c, b));
    let normal2 = cross(ab, ac);
    let squares = dot(ab, ab) + dot(ac, ac) + dot(bc, bc);
    let quality =
        if squares > 0.0 { 2.0 * 3f64.sqrt() * dot(normal2, normal2).sqrt() / squares } else { 0.0 };
    (normal2, quality)
}
