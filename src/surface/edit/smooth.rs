//! A smoother surface that stays near the one that it was.
//!
//! # How does it work?
//!
//! Each iteration moves every vertex towards the mean of its neighbours, then back a little more
//! (Taubin): what is shorter than some edges goes, what is longer stays, and the volume, too.
//!
//! ```text
//!  p += 0.5 (mean - p)        p -= 0.53 (mean - p)
//! ```
//!
//! No vertex goes farther from its first place than a given length; where it would, it stays at
//! that distance. Vertices of a boundary, and those that are no manifold, do not move. Vertices on
//! a face of the domain, which caps have, move along it. Where a cap meets the surface, vertices
//! look at those before and behind them on the outline alone, so caps do not shrink. A step that
//! would take a vertex to another face is left out. Normals of vertices that may leave the faces
//! are new: the mean of those of the triangles, by area.
//!
//! # Memory and cost
//! A record of 44 bytes a vertex, of which memory holds what it can and a nameless file the rest;
//! two passes over the triangles for each iteration.
//!
//! # References
//! Taubin 1995, "A signal processing approach to fair surface design".

use super::faces::{Faces, OnFaces};
use crate::surface::model::{SurfaceSource, Vertex};
use crate::surface::weld::{BuilderSettings, StoredSurface};
use isospan_io::bytes::paged::Paged;
use isospan_io::error::{Error, Result};
use isospan_io::exec::CancelToken;
use isospan_io::geom::vec3::{cross, dot, minus};
use serde::Serialize;

/// Towards the mean of the neighbours, and back.
const STEPS: [f64; 2] = [0.5, -0.53];
/// More iterations change nothing that is seen.
const MOST: u32 = 10_000;

/// How a surface is smoothed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothing {
    /// How often each vertex moves there and back.
    pub iterations: u32,
    /// The largest distance of a vertex from its first place, in world units.
    pub max_distance: f64,
}

impl Smoothing {
    /// Whether the numbers make sense.
    ///
    /// # Errors
    /// [`Error::Usage`] when not.
    pub fn check(&self) -> Result<()> {
        if !(1..=MOST).contains(&self.iterations) {
            return Err(Error::usage(format!(
                "a surface is smoothed 1 to {MOST} times, not {} times",
                self.iterations
            )));
        }
        if !(self.max_distance.is_finite() && self.max_distance >= 0.0) {
            return Err(Error::usage(
                "the length by which a vertex may move must be a number, and not negative",
            ));
        }
        Ok(())
    }
}

/// What smoothing did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SmoothingReport {
    /// How often each vertex moved there and back.
    pub iterations: u32,
    /// The largest distance that was allowed, in world units.
    pub allowed: f64,
    /// The largest distance of a vertex from its first place, in world units.
    pub max_distance: f64,
    /// The mean of the distances of all vertices.
    pub mean_distance: f64,
    /// Vertices that the allowed distance held.
    pub held: u64,
    /// Vertices of boundaries, which did not move.
    pub fixed: u64,
}

/// A vertex while it moves.
#[derive(Clone, Copy, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Moving {
    start: [f32; 3],
    now: [f32; 3],
    /// The sum of the ways to its neighbours, or of normals by area.
    sum: [f32; 3],
    neighbours: u32,
    state: u32,
}

/// The vertex does not move.
const FIXED: u32 = 1 << 8;
/// The last step would have gone too far.
const HELD: u32 = 1 << 9;
/// The vertex is on the outline of a cap: of its faces, some triangle around it leaves one.
const OUTLINE: u32 = 1 << 10;

impl Moving {
    fn on(&self) -> OnFaces {
        self.state as OnFaces
    }
}

/// A number without order, for each vertex: sums of them differ where the vertices do.
fn mixed(v: u32) -> u64 {
    // The steps of SplitMix64.
    let mut x = (u64::from(v) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// Smooths a surface.
///
/// # Errors
/// [`Error::Usage`] for settings that make no sense; [`Error::Cancelled`]; [`Error::Io`] for the
/// scratch folder.
pub fn smooth(
    surface: &StoredSurface,
    how: &Smoothing,
    faces: &Faces,
    settings: &BuilderSettings,
    cancel: &CancelToken,
) -> Result<(StoredSurface, SmoothingReport)> {
    how.check()?;
    let mut work = Work::new(surface, how, faces, settings)?;
    for _ in 0..how.iterations {
        for step in STEPS {
            cancel.check()?;
            work.add_neighbours()?;
            work.step(step)?;
        }
    }
    work.finish(settings)
}

struct Work<'a> {
    surface: &'a StoredSurface,
    how: &'a Smoothing,
    faces: &'a Faces,
    places: Paged<Moving>,
}

impl<'a> Work<'a> {
    fn new(
        surface: &'a StoredSurface,
        how: &'a Smoothing,
        faces: &'a Faces,
        settings: &BuilderSettings,
    ) -> Result<Self> {
        let (count, share) = (surface.vertex_count(), settings.memory_bytes as u64 / 4);
        // Around a vertex inside of a manifold each neighbour is once behind it, once before it.
        let mut balance = Paged::<u64>::new(count, share, &settings.scratch);
        surface.triangles(&mut |batch| {
            for &[a, b, c] in batch {
                for (v, next, before) in [(a, b, c), (b, c, a), (c, a, b)] {
                    let sum = balance.change(u64::from(v))?;
                    *sum = sum.wrapping_add(mixed(next)).wrapping_sub(mixed(before));
                }
            }
            Ok(())
        })?;
        let (mut places, mut n) = (Paged::<Moving>::new(count, 2 * share, &settings.scratch), 0);
        surface.vertices(&mut |batch| {
            for v in batch {
                let fixed = if balance.get(n)? == 0 { 0 } else { FIXED };
                let state = u32::from(faces.on(v.position)) | fixed;
                let (start, now) = (v.position, v.position);
                places.set(n, Moving { start, now, sum: [0.0; 3], neighbours: 0, state })?;
                n += 1;
            }
            Ok(())
        })?;
        let mut work = Self { surface, how, faces, places };
        work.find_outlines()?;
        Ok(work)
    }

    /// Marks the vertices of outlines.
    fn find_outlines(&mut self) -> Result<()> {
        let places = &mut self.places;
        self.surface.triangles(&mut |batch| {
            for &t in batch {
                let mut on = [0; 3];
                for (on, v) in on.iter_mut().zip(t) {
                    *on = places.get(u64::from(v))?.on();
                }
                for (v, own) in t.into_iter().zip(on) {
                    if on.iter().any(|other| own & !other != 0) {
                        places.change(u64::from(v))?.state |= OUTLINE;
                    }
                }
            }
            Ok(())
        })
    }

    /// The places of a triangle's corners, as they are now.
    fn corners(places: &mut Paged<Moving>, t: [u32; 3]) -> Result<[[f64; 3]; 3]> {
        let mut out = [[0.0; 3]; 3];
        for (place, v) in out.iter_mut().zip(t) {
            *place = places.get(u64::from(v))?.now.map(f64::from);
        }
        Ok(out)
    }

    /// Adds up the ways to neighbours. Inside of a manifold each of them is that of two triangles.
    /// That along an outline is of the one triangle which leaves the cap, or of two of them where
    /// caps meet.
    fn add_neighbours(&mut self) -> Result<()> {
        let places = &mut self.places;
        self.surface.triangles(&mut |batch| {
            for &t in batch {
                let mut corners = [Moving::default(); 3];
                for (corner, v) in corners.iter_mut().zip(t) {
                    *corner = places.get(u64::from(v))?;
                }
                for k in 0..3 {
                    let (own, others) = (corners[k], [corners[(k + 1) % 3], corners[(k + 2) % 3]]);
                    let leaves = others.map(|other| own.on() & !other.on() != 0);
                    let counts = match own.state & OUTLINE != 0 {
                        true => [leaves[1] && !leaves[0], leaves[0] && !leaves[1]],
                        false => [true; 2],
                    };
                    let moving = places.change(u64::from(t[k]))?;
                    for (other, _) in others.iter().zip(counts).filter(|(_, counts)| *counts) {
                        let way = minus(other.now.map(f64::from), own.now.map(f64::from));
                        moving.sum.iter_mut().zip(way).for_each(|(sum, c)| *sum += c as f32);
                        moving.neighbours += 1;
                    }
                }
            }
            Ok(())
        })
    }

    /// Moves all vertices by a part of the way to the mean of their neighbours.
    fn step(&mut self, part: f64) -> Result<()> {
        for n in 0..self.places.len() {
            let moving = self.places.change(n)?;
            let (sum, count) = (std::mem::take(&mut moving.sum), std::mem::take(&mut moving.neighbours));
            // An outline that ends, at an edge of the domain, keeps its end.
            let needed = match moving.state & OUTLINE != 0 {
                true if moving.on().count_ones() > 1 => 4,
                true => 2,
                false => 1,
            };
            if moving.state & FIXED != 0 || count < needed {
                continue;
            }
            let way = sum.map(|x| part * f64::from(x) / f64::from(count));
            let way = self.faces.along(moving.on(), way);
            let start = moving.start.map(f64::from);
            let mut off: [f64; 3] = std::array::from_fn(|k| f64::from(moving.now[k]) + way[k] - start[k]);
            let distance = dot(off, off).sqrt();
            moving.state &= !HELD;
            if distance > self.how.max_distance {
                off = off.map(|x| x * (self.how.max_distance / distance));
                moving.state |= HELD;
            }
            let next = std::array::from_fn(|k| (start[k] + off[k]) as f32);
            if !self.faces.reaches_another(moving.on(), next) {
                moving.now = next;
            }
        }
        Ok(())
    }

    /// Adds up the normals of triangles, by area.
    fn add_normals(&mut self) -> Result<()> {
        let places = &mut self.places;
        self.surface.triangles(&mut |batch| {
            for &t in batch {
                let [a, b, c] = Self::corners(places, t)?;
                let normal = cross(minus(b, a), minus(c, a));
                for v in t {
                    let sum = &mut places.change(u64::from(v))?.sum;
                    (0..3).for_each(|k| sum[k] += normal[k] as f32);
                }
            }
            Ok(())
        })
    }

    fn finish(mut self, settings: &BuilderSettings) -> Result<(StoredSurface, SmoothingReport)> {
        self.add_normals()?;
        let Self { surface, how, mut places, .. } = self;
        let mut out = StoredSurface::like(surface, settings);
        let mut report = SmoothingReport {
            iterations: how.iterations,
            allowed: how.max_distance,
            ..SmoothingReport::default()
        };
        let (mut n, mut sum) = (0, 0.0);
        surface.vertices(&mut |batch| {
            for v in batch {
                let moving = places.get(n)?;
                n += 1;
                let off = minus(moving.now.map(f64::from), moving.start.map(f64::from));
                let distance = dot(off, off).sqrt();
                sum += distance;
                report.max_distance = report.max_distance.max(distance);
                report.held += u64::from(moving.state & HELD != 0);
                report.fixed += u64::from(moving.state & FIXED != 0);
                out.push_vertex(moved(v, &moving))?;
            }
            Ok(())
        })?;
        report.mean_distance = if n > 0 { sum / n as f64 } else { 0.0 };
        surface.triangles(&mut |batch| batch.iter().try_for_each(|&t| out.push_triangle(t)))?;
        Ok((out, report))
    }
}

/// A vertex at its new place. On a face the normal of its triangles is half that of the cap.
fn moved(vertex: &Vertex, moving: &Moving) -> Vertex {
    let sum = moving.sum.map(f64::from);
    let length = dot(sum, sum).sqrt();
    let is_new = moving.state & FIXED == 0 && moving.on() == 0 && length > 0.0;
    let normal = if is_new { sum.map(|x| (x / length) as f32) } else { vertex.normal };
    Vertex { position: moving.now, normal }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::TriMesh;
    use crate::surface::check::check;
    use crate::surface::edit::clip::HalfSpace;
    use crate::surface::testing::Grid;
    use isospan_io::grid::Geometry;

    fn run(mesh: &TriMesh, how: Smoothing, faces: &Faces, memory_bytes: usize) -> (TriMesh, SmoothingReport) {
        let scratch = tempfile::tempdir().unwrap();
        let settings = BuilderSettings { memory_bytes, scratch: scratch.path().to_path_buf() };
        let surface = StoredSurface::of(mesh, &settings).unwrap();
        let (out, report) = smooth(&surface, &how, faces, &settings, &CancelToken::new()).unwrap();
        (TriMesh::from_source(&out).unwrap(), report)
    }

    /// A ball of samples that are 0 or 1: its surface has steps.
    fn steps(n: u64) -> TriMesh {
        let c = (n - 1) as f64 / 2.0;
        let inside = |p: [f64; 3]| p.iter().map(|x| (x - c).powi(2)).sum::<f64>() < (0.8 * c).powi(2);
        let grid = Grid::new([n; 3]);
        grid.surface(&grid.sample(|p| if inside(p) { 1.0 } else { 0.0 }), 0.5, &Geometry::default())
    }

    fn farthest(a: &TriMesh, b: &TriMesh) -> f64 {
        let off = |(a, b): (&Vertex, &Vertex)| {
            let way = minus(a.position.map(f64::from), b.position.map(f64::from));
            dot(way, way).sqrt()
        };
        a.vertices.iter().zip(&b.vertices).map(off).fold(0.0, f64::max)
    }

    #[test]
    fn steps_go_and_the_volume_stays() {
        let mesh = steps(24);
        let how = Smoothing { iterations: 20, max_distance: 0.5 };
        let (even, report) = run(&mesh, how, &Faces::default(), 1 << 30);
        let (before, after) = (check(&mesh), check(&even));
        assert_eq!(mesh.triangles, even.triangles);
        assert!((after.volume.unwrap() / before.volume.unwrap() - 1.0).abs() < 0.02, "{before:?} {after:?}");
        // Of the area that steps have beyond that of the ball, less than a quarter is left.
        let radius = (0.75 * after.volume.unwrap() / std::f64::consts::PI).cbrt();
        let round = 4.0 * std::f64::consts::PI * radius * radius;
        let [had, has] = [before.area, after.area].map(|area| area / round - 1.0);
        assert!(had > 0.15 && has > 0.0 && has < 0.25 * had, "{had} {has}");
        assert!(
            (farthest(&mesh, &even) - report.max_distance).abs() < 1e-6 && report.max_distance < 0.5 + 1e-5
        );
        assert_eq!(report.fixed, 0);
        // Normals point outwards, from the middle.
        let c = 11.5;
        for v in &even.vertices {
            let way = minus(v.position.map(f64::from), [c; 3]);
            assert!(dot(way, v.normal.map(f64::from)) > 0.0);
        }
        // Memory does not show.
        assert_eq!(run(&mesh, how, &Faces::default(), 1 << 12).0, even);
    }

    #[test]
    fn no_vertex_goes_farther_than_it_may() {
        let mesh = steps(20);
        let how = Smoothing { iterations: 30, max_distance: 0.05 };
        let (even, report) = run(&mesh, how, &Faces::default(), 1 << 30);
        assert!(report.held > 0 && farthest(&mesh, &even) <= 0.05 + 1e-5, "{report:?}");
        let still = Smoothing { iterations: 3, max_distance: 0.0 };
        assert_eq!(farthest(&mesh, &run(&mesh, still, &Faces::default(), 1 << 30).0), 0.0);
        for wrong in [Smoothing { iterations: 0, ..how }, Smoothing { max_distance: f64::NAN, ..how }] {
            assert!(wrong.check().is_err());
        }
    }

    #[test]
    fn boundaries_stay_and_faces_are_not_left() {
        // A surface that ends at the box.
        let grid = Grid::new([16; 3]);
        let values = grid.sample(|[x, y, z]| x - 7.3 + 0.8 * (2.0 * y).sin() * (1.7 * z).cos());
        let mesh = grid.surface(&values, 0.0, &Geometry::default());
        let how = Smoothing { iterations: 10, max_distance: 2.0 };
        let (even, report) = run(&mesh, how, &Faces::default(), 1 << 30);
        assert!(report.fixed > 0 && farthest(&mesh, &even) > 0.1);
        let at_end = |v: &Vertex| v.position[1..].iter().any(|&c| c == 0.0 || c == 15.0);
        let ends = mesh.vertices.iter().zip(&even.vertices).filter(|(v, _)| at_end(v));
        assert!(ends.clone().count() > 50 && ends.into_iter().all(|(a, b)| a == b));
        // A ball whose lowest vertices are said to lie on a face.
        let mesh = steps(20);
        let low = mesh.vertices.iter().map(|v| v.position[2]).fold(f32::INFINITY, f32::min);
        let faces = Faces::new(vec![HalfSpace::new([0.0, 0.0, 1.0], low.into(), [20.0; 3])]);
        let (even, _) = run(&mesh, how, &faces, 1 << 30);
        let on: Vec<_> =
            mesh.vertices.iter().zip(&even.vertices).filter(|(v, _)| v.position[2] == low).collect();
        assert!(on.len() >= 4 && on.iter().all(|(_, v)| v.position[2] == low));
        assert!(on.iter().any(|(a, b)| a.position != b.position), "they move along it");
    }
}
