//! Samples of a boundary that keep their distance: corners first, then edges, then faces.
//!
//! Candidates come one after another. One with a kept sample within the radius is dropped, if that
//! sample stands for the same walls: each normal of the candidate is about one of the sample's. A
//! corner has the normals of all walls there, an edge those of two, a face its own. So neither the
//! two walls of a thin plate thin each other out nor the edges between them; steps of a staircase
//! far below the radius do.
//!
//! | candidates | how dense |
//! |---|---|
//! | corners | all |
//! | edges | four a radius, ends included |
//! | vertices, where the field has its kinks | all |
//! | faces, by area along the curve of the triangles | [`CANDIDATES`] a square of the radius |
//!
//! What is left is nearly maximal: most of the boundary is within a radius of a sample.
//!
//! Reference: Cook 1986, "Stochastic sampling in computer graphics" (discs that keep their
//! distance); Dey and Levine 2009, "Delaunay meshing of piecewise smooth complexes without
//! expensive predicates" (features first).

use super::spacing::Spacing;
use super::store::CellStore;
use super::wall::{OnBoundary, Surface, mean};
use isospan_io::error::Result;
use isospan_io::geom::LatticePos;
use isospan_io::geom::vec3::{cross, difference, dot};
use isospan_mesh::locate::{FINE_BITS, FinePos, rounded};
use std::collections::HashMap;

/// Samples keep this distance, in mean distances of the points inside.
const RADIUS: f64 = 0.8;
/// The radius of a candidate is so much longer or shorter.
const VARIED: f64 = 0.2;
/// Candidates for a square of the radius.
const CANDIDATES: f64 = 8.0;
/// Normals of one side are no further apart than 60 degrees: the cosine.
const ALIKE: f64 = 0.5;

/// The samples of the boundary of a mesh.
pub(super) fn scattered(store: &CellStore, surface: &Surface<'_>) -> Result<Vec<(LatticePos, OnBoundary)>> {
    let triangle = |t: u64| surface.triangles[t as usize];
    let normal = |t: u64| unit_normal(surface.corners(triangle(t)));
    let mut kept = Kept::new(surface.spacing);

    let edges = store.creases.edges.get()?;
    for corner in store.creases.corners.get()?.chunk_by(|a, b| a[0] == b[0]) {
        let vertex = corner[0][0];
        let at = corner.iter().map(|&[_, edge]| edges[edge as usize]);
        // A vertex where bodies touch is a corner of each.
        let mut sides: Vec<[u64; 2]> =
            at.flat_map(|[_, _, s, t]| [s, t]).map(|t| [triangle(t)[3], t]).collect();
        sides.sort_unstable();
        sides.dedup();
        for of_body in sides.chunk_by(|a, b| a[0] == b[0]) {
            let normals: Vec<_> = of_body.iter().map(|&[_, t]| normal(t)).collect();
            kept.offer(
                surface.positions[vertex as usize],
                &normals,
                at_vertex(triangle(of_body[0][1]), vertex),
            );
        }
    }
    for &[a, b, s, t] in edges {
        let [from, to] = [a, b].map(|v| surface.positions[v as usize]);
        let (along, normals) = (difference(to, from), [normal(s), normal(t)]);
        let pieces = (4.0 * dot(along, along).sqrt() / kept.radius(from)).ceil().max(1.0);
        for k in 0..=pieces as u64 {
            let part = k as f64 / pieces;
            let place = on_edge(triangle(s), [a, b], part);
            kept.offer(mean(surface.corners(triangle(s)), place.weights), &normals, place);
        }
    }
    for &t in surface.triangles {
        let corners = surface.corners(t);
        let normal = unit_normal(corners);
        for (vertex, at) in t.into_iter().zip(corners) {
            kept.offer(at, &[normal], at_vertex(t, vertex));
        }
    }
    let radius = kept.radius_at_level_0();
    let each = radius * radius / CANDIDATES;
    surface.each_place(each, |at, place, corners| {
        kept.offer(at, &[unit_normal(corners)], place);
    });
    Ok(kept.samples.into_iter().map(|s| (rounded(s.at), s.place)).collect())
}

/// A vertex of a triangle.
fn at_vertex(triangle: [u64; 4], vertex: u64) -> OnBoundary {
    on_edge(triangle, [vertex, vertex], 0.0)
}

/// A place on an edge of a triangle, this part of the way from its first vertex to its second one.
fn on_edge([a, b, c, body]: [u64; 4], [from, to]: [u64; 2], part: f64) -> OnBoundary {
    let weight = |v: u64| match v {
        v if v == from => 1.0 - part,
        v if v == to => part,
        _ => 0.0,
    };
    OnBoundary { triangle: [a, b, c], body, weights: [a, b, c].map(weight) }
}

fn unit_normal([a, b, c]: [FinePos; 3]) -> [f64; 3] {
    let n = cross(difference(b, a), difference(c, a));
    let length = dot(n, n).sqrt();
    n.map(|c| c / length)
}

/// A factor of the radius, evenly spread between places: else a mesh of even cells would have all
/// vertices at one radius, and half of them at the next.
fn varied(at: FinePos) -> f64 {
    let mixed =
        at.iter().fold(0u64, |h, &c| (h ^ c as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29));
    1.0 - VARIED + 2.0 * VARIED * (mixed >> 11) as f64 / (1u64 << 53) as f64
}

struct Scattered {
    at: FinePos,
    place: OnBoundary,
    /// Where its normals begin, and their end.
    normals: [u32; 2],
}

/// The samples that were kept so far, in cells as wide as the largest radius.
struct Kept<'a> {
    spacing: &'a Spacing,
    samples: Vec<Scattered>,
    normals: Vec<[f64; 3]>,
    cells: HashMap<[i64; 3], Vec<u32>>,
    width: i64,
}

impl<'a> Kept<'a> {
    fn new(spacing: &'a Spacing) -> Self {
        let mut kept = Self { spacing, samples: vec![], normals: vec![], cells: HashMap::new(), width: 1 };
        kept.width = (kept.radius_at_level_0() * (1.0 + VARIED)).ceil() as i64;
        kept
    }

    fn radius_at_level_0(&self) -> f64 {
        RADIUS * f64::from(self.spacing.by_level[0]) * f64::from(1u32 << FINE_BITS)
    }

    fn radius(&self, at: FinePos) -> f64 {
        RADIUS * f64::from(self.spacing.at(rounded(at))) * f64::from(1u32 << FINE_BITS)
    }

    /// Keeps a candidate, unless a sample is too near.
    fn offer(&mut self, at: FinePos, normals: &[[f64; 3]], place: OnBoundary) {
        let cell = at.map(|c| c / self.width);
        let radius = self.radius(at) * varied(at);
        let is_alike = |s: &Scattered| {
            let theirs = &self.normals[s.normals[0] as usize..s.normals[1] as usize];
            normals.iter().all(|n| theirs.iter().any(|m| dot(*n, *m) > ALIKE))
        };
        let is_near = |s: &Scattered| {
            let d = difference(s.at, at);
            s.place.body == place.body && dot(d, d) < radius * radius && is_alike(s)
        };
        for k in 0..27 {
            let beside = std::array::from_fn(|a| cell[a] + k / 3i64.pow(a as u32) % 3 - 1);
            let there = self.cells.get(&beside).into_iter().flatten();
            if there.into_iter().any(|&i| is_near(&self.samples[i as usize])) {
                return;
            }
        }
        self.cells.entry(cell).or_default().push(self.samples.len() as u32);
        let first = self.normals.len() as u32;
        self.normals.extend(normals);
        self.samples.push(Scattered { at, place, normals: [first, self.normals.len() as u32] });
    }
}
