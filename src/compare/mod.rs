//! How far are two surfaces apart?
//!
//! [`compare`] measures from each of two surfaces to the other. From A to B:
//!
//! * A is sampled evenly by area: sample k of n lies where the area of the triangles before it is
//!   (k + ½)/n of the whole, at the place in its triangle that the radical inverses of k in bases 2
//!   and 3 give (a Hammersley set, folded into a triangle by the square root map). The same surface
//!   gives the same samples, and n samples are worth far more than n random ones.
//! * For each the nearest point of B is found, exactly: closest points of triangles
//!   (Ericson, *Real-Time Collision Detection*, 2005, section 5.1.5) in `f64`, those of far
//!   triangles ruled out by a bounding volume hierarchy (crate `obvhs`).
//! * Mean and root mean square of the distances are integrals over A. The largest is looked for
//!   among the vertices of A too; it is a lower bound of the one-sided Hausdorff distance, exact
//!   where that is taken at a vertex.
//! * The normal deviation is the angle between the planes of the sample's triangle and of the
//!   nearest one, 0 to 90 degrees, whichever side is outside. Where several triangles are nearest
//!   (at their common edge), the one that deviates least counts.
//!
//! Distances below 10^-12 of the diagonal of both are reported as 0: vertices are `f32`, that is
//! rounded 10^5 times as coarsely.
//!
//! Cost: for each sample and vertex a walk down the hierarchy, about a microsecond. Memory: both
//! surfaces, and the hierarchy of one at a time ([`needed`]). The report is the same for any number
//! of threads. For surfaces of any size there is [`apart`].
//!
//! ```
//! use isospan::compare::{CompareSettings, compare};
//! use isospan::surface::{TriMesh, Vertex};
//!
//! let square = |z: f32| TriMesh {
//!     vertices: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
//!         .map(|[x, y]| Vertex { position: [x, y, z], normal: [0.0; 3] })
//!         .to_vec(),
//!     triangles: vec![[0, 1, 2], [0, 2, 3]],
//!     ..TriMesh::default()
//! };
//! let report = compare(&square(0.0), &square(0.25), &CompareSettings::default())?;
//! assert!((report.hausdorff - 0.25).abs() < 1e-12 && (report.rms - 0.25).abs() < 1e-12);
//! assert_eq!(report.rms_normal_degrees, 0.0);
//! # Ok::<(), isospan::Error>(())
//! ```

mod nearest;
mod pieces;
mod samples;
#[cfg(test)]
mod tests;

pub use crate::measure::SurfaceDistance;
pub use nearest::{Nearest, NearestPoint, Triangles};
pub use pieces::apart;

use crate::surface::check::{CheckSettings, SurfaceCheckReport, check_source};
use crate::surface::{SurfaceSource, Vertex, vertices_from};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Resources, pool};
use nearest::Walk;
use rayon::prelude::*;
use samples::AreaSamples;
use serde::Serialize;

/// How surfaces are compared.
#[derive(Clone, Debug)]
pub struct CompareSettings {
    /// Samples by area of each surface, besides its vertices.
    pub samples: u64,
    /// Threads, memory, scratch folder, and what stops it.
    pub resources: Resources,
}

impl Default for CompareSettings {
    fn default() -> Self {
        Self { samples: 200_000, resources: Resources::default() }
    }
}

/// Distances from one surface to the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct OneWay {
    /// Largest distance of a sample or a vertex.
    pub max: f64,
    /// The place of that sample or vertex, on the surface that is measured from.
    pub max_at: [f64; 3],
    /// Mean over the area.
    pub mean: f64,
    /// Root mean square over the area.
    pub rms: f64,
    /// Root mean square angle between the planes of a sample's triangle and of the nearest one, in
    /// degrees.
    pub rms_normal_degrees: f64,
}

/// The result of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CompareReport {
    /// The first surface by itself: area, volume, Euler number, components.
    pub a: SurfaceCheckReport,
    /// The second one.
    pub b: SurfaceCheckReport,
    /// From the first to the second.
    pub a_to_b: OneWay,
    /// From the second to the first.
    pub b_to_a: OneWay,
    /// The larger of the two largest distances.
    pub hausdorff: f64,
    /// Mean of both means.
    pub mean: f64,
    /// Root of the mean of both mean squares.
    pub rms: f64,
    /// As `rms`, of the angles.
    pub rms_normal_degrees: f64,
    /// Diagonal of the box around both surfaces, for comparison.
    pub diagonal: f64,
    /// Samples by area of each.
    pub samples: u64,
}

/// What the process needs besides the surfaces.
const FIXED: u64 = 16 << 20;
/// Bytes of a triangle in the hierarchy while it is built: boxes and nodes, some of them several
/// times.
const HIERARCHY: u64 = 320;

/// The least memory for two surfaces of these numbers of vertices and triangles.
pub fn needed(vertices: [u64; 2], triangles: [u64; 2]) -> u64 {
    let [t, u] = triangles;
    let held = vertices.iter().fold(0u64, |sum, v| sum.saturating_add(v.saturating_mul(12)));
    // Corners, and the sums of areas of the one that is sampled.
    let held = held.saturating_add((t.saturating_add(u)).saturating_mul(20));
    held.saturating_add(t.max(u).saturating_mul(HIERARCHY)).saturating_add(FIXED)
}

/// Compares two surfaces.
///
/// # Errors
/// [`Error::Usage`] for a surface without area, or with coordinates beyond 10^15; [`Error::Budget`]
/// when the memory does not suffice; those of reading the surfaces.
pub fn compare(
    a: &dyn SurfaceSource,
    b: &dyn SurfaceSource,
    settings: &CompareSettings,
) -> Result<CompareReport> {
    let least = needed([a.vertex_count(), b.vertex_count()], [a.triangle_count(), b.triangle_count()]);
    if least > settings.resources.memory {
        return Err(Error::memory("", least, settings.resources.memory));
    }
    if settings.samples == 0 {
        return Err(Error::usage("a comparison needs at least one sample"));
    }
    let check =
        CheckSettings { memory: settings.resources.memory, scratch: settings.resources.scratch_folder() };
    let reports = [check_source(a, None, &check)?.0, check_source(b, None, &check)?.0];
    settings.resources.cancel.check()?;
    let origin = common_origin(a, b);
    let [a, b] = [Triangles::read_from(a, origin)?, Triangles::read_from(b, origin)?];
    let diagonal = a.diagonal_with(&b);
    let pool = pool(settings.resources.threads)?;
    let one_way = |from: &Triangles, to: &Triangles| -> Result<OneWay> {
        let nearest = Nearest::new(to, diagonal * ZERO);
        pool.install(|| measure(from, &nearest, settings))
    };
    let (a_to_b, b_to_a) = (one_way(&a, &b)?, one_way(&b, &a)?);
    let root_mean = |of: fn(&OneWay) -> f64| {
        let (x, y) = (of(&a_to_b), of(&b_to_a));
        ((x * x + y * y) / 2.0).sqrt()
    };
    let [a, b] = reports;
    Ok(CompareReport {
        a,
        b,
        hausdorff: a_to_b.max.max(b_to_a.max),
        mean: (a_to_b.mean + b_to_a.mean) / 2.0,
        rms: root_mean(|w| w.rms),
        rms_normal_degrees: root_mean(|w| w.rms_normal_degrees),
        a_to_b,
        b_to_a,
        diagonal,
        samples: settings.samples,
    })
}

/// Distances of all vertices of a surface from another one, in their order; 4 bytes a vertex come
/// on top of [`needed`].
///
/// # Errors
/// As [`compare`].
pub fn distances(
    from: &dyn SurfaceSource,
    to: &dyn SurfaceSource,
    settings: &CompareSettings,
) -> Result<Vec<f32>> {
    let least = needed([from.vertex_count(), to.vertex_count()], [0, to.triangle_count()])
        .saturating_add(from.vertex_count().saturating_mul(4));
    if least > settings.resources.memory {
        return Err(Error::memory("", least, settings.resources.memory));
    }
    let origin = common_origin(from, to);
    let to = Triangles::read_from(to, origin)?;
    let nearest = Nearest::new(&to, to.diagonal_with(&to) * ZERO);
    let pool = pool(settings.resources.threads)?;
    let mut all = Vec::with_capacity(from.vertex_count() as usize);
    vertices_from(from, origin, &mut |batch| {
        settings.resources.cancel.check()?;
        let part: Vec<f32> = pool.install(|| {
            let of = |walk: &mut Walk, v: &Vertex| {
                nearest.nearest(v.position.map(f64::from), walk).distance as f32
            };
            batch.par_iter().map_init(Walk::default, of).collect()
        });
        all.extend(part);
        Ok(())
    })?;
    Ok(all)
}

/// What the positions of two surfaces are counted from: one of them may be far from 0.
fn common_origin(a: &dyn SurfaceSource, b: &dyn SurfaceSource) -> [f64; 3] {
    if a.origin() == [0.0; 3] { b.origin() } else { a.origin() }
}

/// Distances below this part of the diagonal count as 0.
pub const ZERO: f64 = 1e-12;

/// Samples, or vertices, of a job: the sums of each are added in order.
const BATCH: u64 = 1 << 12;

/// Sums over some samples.
#[derive(Clone, Copy, Default)]
struct SampleSums {
    sum: f64,
    squares: f64,
    angles: f64,
    max: f64,
    max_at: [f64; 3],
}

impl SampleSums {
    fn note_max(&mut self, distance: f64, at: [f64; 3]) {
        if distance > self.max {
            (self.max, self.max_at) = (distance, at);
        }
    }

    fn add(&mut self, other: &Self) {
        self.sum += other.sum;
        self.squares += other.squares;
        self.angles += other.angles;
        self.note_max(other.max, other.max_at);
    }
}

fn measure(from: &Triangles, to: &Nearest<'_>, settings: &CompareSettings) -> Result<OneWay> {
    let samples = AreaSamples::new(from, settings.samples)?;
    let sampled = in_batches(samples.len(), settings, |range, walk| {
        let mut part = SampleSums::default();
        for k in range {
            let (at, normal) = samples.get(k);
            let found = to.nearest_aligned(at, normal, walk);
            part.sum += found.distance;
            part.squares += found.distance * found.distance;
            let angle = to.angle(found.triangle, normal);
            part.angles += angle * angle;
            part.note_max(found.distance, at);
        }
        part
    })?;
    let used = from.used_vertices();
    let vertices = in_batches(from.positions.len() as u64, settings, |range, walk| {
        let mut part = SampleSums::default();
        for v in range.filter(|&v| used[v as usize]) {
            let at = from.positions[v as usize].map(f64::from);
            part.note_max(to.nearest(at, walk).distance, at);
        }
        part
    })?;
    let (mut all, n) = (sampled, samples.len() as f64);
    all.note_max(vertices.max, vertices.max_at);
    Ok(OneWay {
        max: all.max,
        max_at: std::array::from_fn(|k| from.origin[k] + all.max_at[k]),
        mean: all.sum / n,
        rms: (all.squares / n).sqrt(),
        rms_normal_degrees: (all.angles / n).sqrt().to_degrees(),
    })
}

/// Sums of all batches, added in order.
fn in_batches(
    count: u64,
    settings: &CompareSettings,
    of: impl Fn(std::ops::Range<u64>, &mut Walk) -> SampleSums + Sync,
) -> Result<SampleSums> {
    let batch = |n: u64| {
        settings.resources.cancel.check()?;
        Ok(of(n * BATCH..((n + 1) * BATCH).min(count), &mut Walk::default()))
    };
    let parts: Vec<SampleSums> =
        (0..count.div_ceil(BATCH)).into_par_iter().map(batch).collect::<Result<_>>()?;
    let mut all = SampleSums::default();
    parts.iter().for_each(|part| all.add(part));
    Ok(all)
}
