//! How far is a surface from another one, of any size?
//!
//! The surface that is measured to is taken in pieces, as many triangles as memory holds with their
//! hierarchy. Each vertex looks in the pieces whose box it lies in first; then only in those whose
//! box is nearer than what it has found. So distances are exact, and do not depend on the pieces.
//! Mean and root mean square are integrals over the triangles, of the means of their corners. Of
//! percentiles, each corner stands for a third of the triangle.

use super::nearest::{Nearest, Triangles, Walk};
use crate::measure::SurfaceDistance;
use crate::surface::{SurfaceSource, vertices_from};
use glam::DVec3;
use isospan_io::bytes::paged::Paged;
use isospan_io::bytes::store::{Cached, Store};
use isospan_io::error::Result;
use isospan_io::exec::{Resources, pool};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Bytes of a triangle of a piece: its corners, its share of vertices, the hierarchy.
const TRIANGLE: u64 = 360;
/// Triangles of a piece at least, with any memory.
const LEAST: u64 = 1 << 12;
/// Vertices that are looked up together.
const BATCH: u64 = 1 << 14;

/// How far a surface is from another one; none where one of them has no triangle or no area. What
/// memory does not hold is in the scratch folder.
///
/// # Errors
/// [`crate::Error::Usage`] for coordinates beyond 10^15; those of reading the surfaces and of the
/// scratch folder; [`crate::Error::Cancelled`].
pub fn apart(
    from: &dyn SurfaceSource,
    to: &dyn SurfaceSource,
    resources: &Resources,
) -> Result<Option<SurfaceDistance>> {
    if from.triangle_count() == 0 || to.triangle_count() == 0 {
        return Ok(None);
    }
    let scratch = resources.scratch_folder();
    let held = usize::try_from(resources.memory / 16).unwrap_or(usize::MAX);
    let origin = super::common_origin(from, to);
    let [own, others] = [from, to].map(|surface| {
        let mut all = Store::new(held, &scratch);
        vertices_from(surface, origin, &mut |batch| batch.iter().try_for_each(|v| all.push(v.position)))?;
        Ok(all)
    });
    let (own, others) = (own?, others?);
    let mut best = Paged::<f64>::new(own.len(), held as u64, &scratch);
    (0..own.len()).try_for_each(|n| best.set(n, f64::INFINITY))?;
    let mut search = NearestSearch { own: &own, best, pool: pool(resources.threads)?, resources };
    let size = (resources.memory / 2 / TRIANGLE).max(LEAST);
    let is_one = to.triangle_count() <= size;
    let mut places = Cached::new(&others, held);
    for round in [Round::Inside, Round::Beside] {
        if is_one && round == Round::Inside {
            continue;
        }
        let round = if is_one { Round::All } else { round };
        let mut piece = vec![];
        to.triangles(&mut |batch| {
            for t in batch {
                piece.push(*t);
                if piece.len() as u64 == size {
                    search.look_in(&BoxedTriangles::new(&piece, &mut places)?, round)?;
                    piece.clear();
                }
            }
            Ok(())
        })?;
        if !piece.is_empty() {
            search.look_in(&BoxedTriangles::new(&piece, &mut places)?, round)?;
        }
    }
    search.summed_up(from, held, origin)
}

/// Which vertices look in a piece.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Round {
    /// Those in its box.
    Inside,
    /// Those beside it that may find something nearer.
    Beside,
    All,
}

/// Triangles that follow each other, and the box around them.
struct BoxedTriangles {
    triangles: Triangles,
    lo: DVec3,
    hi: DVec3,
}

impl BoxedTriangles {
    fn new(triangles: &[[u32; 3]], places: &mut Cached<'_, [f32; 3]>) -> Result<Self> {
        let mut used: Vec<u32> = triangles.as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        let positions = used.iter().map(|v| places.get(u64::from(*v))).collect::<Result<Vec<_>>>()?;
        let number = |v: u32| used.binary_search(&v).expect("each corner is listed") as u32;
        let triangles = triangles.iter().map(|t| t.map(number)).collect();
        let triangles = Triangles { positions, triangles, origin: [0.0; 3] };
        triangles.check()?;
        let places = || triangles.positions.iter().map(|p| DVec3::from_array(p.map(f64::from)));
        let lo = places().fold(DVec3::INFINITY, DVec3::min);
        let hi = places().fold(DVec3::NEG_INFINITY, DVec3::max);
        Ok(Self { triangles, lo, hi })
    }

    /// The distance of a place from the box.
    fn gap(&self, place: DVec3) -> f64 {
        (self.lo - place).max(place - self.hi).max(DVec3::ZERO).length()
    }
}

/// The vertices of a surface, and what each has found.
struct NearestSearch<'a> {
    own: &'a Store<[f32; 3]>,
    best: Paged<f64>,
    pool: ThreadPool,
    resources: &'a Resources,
}

impl NearestSearch<'_> {
    fn look_in(&mut self, piece: &BoxedTriangles, round: Round) -> Result<()> {
        let nearest = Nearest::new(&piece.triangles, 0.0);
        let (mut places, count) = (vec![], self.own.len());
        for first in (0..count).step_by(BATCH as usize) {
            self.resources.cancel.check()?;
            places.resize((count - first).min(BATCH) as usize, [0.0f32; 3]);
            self.own.read_from(first, &mut places)?;
            let known = (first..first + places.len() as u64).map(|n| self.best.get(n));
            let known = known.collect::<Result<Vec<f64>>>()?;
            let look = |walk: &mut Walk, (place, best): (&[f32; 3], &f64)| {
                let place = place.map(f64::from);
                let gap = piece.gap(DVec3::from_array(place));
                let looks = match round {
                    Round::Inside => gap == 0.0,
                    Round::Beside => gap > 0.0 && gap < *best,
                    Round::All => true,
                };
                if looks { best.min(nearest.nearest(place, walk).distance) } else { *best }
            };
            let found: Vec<f64> =
                self.pool.install(|| places.par_iter().zip(&known).map_init(Walk::default, look).collect());
            for (n, (found, known)) in (first..).zip(found.iter().zip(&known)) {
                if found < known {
                    self.best.set(n, *found)?;
                }
            }
        }
        Ok(())
    }

    /// Sums over the triangles of the surface.
    fn summed_up(
        mut self,
        from: &dyn SurfaceSource,
        held: usize,
        origin: [f64; 3],
    ) -> Result<Option<SurfaceDistance>> {
        let mut places = Cached::new(self.own, held);
        let mut sums = DistanceSums { max: -1.0, ..DistanceSums::default() };
        from.triangles(&mut |batch| {
            for t in batch {
                let (mut corners, mut found) = ([DVec3::ZERO; 3], [0.0; 3]);
                for (k, v) in t.iter().enumerate() {
                    corners[k] = DVec3::from_array(places.get(u64::from(*v))?.map(f64::from));
                    found[k] = self.best.get(u64::from(*v))?;
                    if found[k] > sums.max {
                        sums.max = found[k];
                        sums.max_at = (corners[k] + DVec3::from_array(origin)).to_array();
                    }
                }
                let [a, b, c] = corners;
                sums.add((b - a).cross(c - a).length() / 2.0, found);
            }
            Ok(())
        })?;
        Ok(sums.finish())
    }
}

/// Distances, and the areas that have them.
#[derive(Default)]
struct DistanceSums {
    max: f64,
    max_at: [f64; 3],
    area: f64,
    sum: f64,
    squares: f64,
    /// Areas by the upper bits of their distance.
    areas: BTreeMap<u64, f64>,
}

/// Bits of a distance that tell no areas apart: ten of the mantissa do.
const LOWER_BITS: u32 = 42;

impl DistanceSums {
    /// Adds a triangle of this area, whose corners have these distances.
    fn add(&mut self, area: f64, distances: [f64; 3]) {
        self.area += area;
        self.sum += area * distances.iter().sum::<f64>() / 3.0;
        self.squares += area * distances.iter().map(|d| d * d).sum::<f64>() / 3.0;
        for distance in distances {
            *self.areas.entry(distance.to_bits() >> LOWER_BITS).or_default() += area / 3.0;
        }
    }

    /// The distance within which this part of the area lies.
    fn within(&self, part: f64) -> f64 {
        let all: f64 = self.areas.values().sum();
        let mut sum = 0.0;
        for (bits, area) in &self.areas {
            sum += area;
            if sum >= part * all {
                // Distances of 0 are alone.
                return if *bits == 0 { 0.0 } else { f64::from_bits((bits + 1) << LOWER_BITS).min(self.max) };
            }
        }
        self.max
    }

    /// None without an area.
    fn finish(self) -> Option<SurfaceDistance> {
        (self.area > 0.0).then(|| SurfaceDistance {
            max: self.max,
            max_at: self.max_at,
            mean: self.sum / self.area,
            rms: (self.squares / self.area).sqrt(),
            p95: self.within(0.95),
            p99: self.within(0.99),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_areas() {
        let mut sums = DistanceSums { max: 50.0, ..DistanceSums::default() };
        // 94 of 100 at 0, 3 at 1, 2.5 at 3; the last half is far away.
        for (area, distance) in [(94.0, 0.0), (3.0, 1.0), (2.5, 3.0), (0.5, 50.0), (0.0, 70.0)] {
            sums.add(area, [distance; 3]);
        }
        let found = sums.finish().unwrap();
        assert!((1.0..=1.0 + 1.0 / 1024.0).contains(&found.p95), "{found:?}");
        assert!((3.0..=3.0 + 3.0 / 1024.0).contains(&found.p99), "{found:?}");
        assert!((found.mean - 0.355).abs() < 1e-12 && (found.rms - 12.755f64.sqrt()).abs() < 1e-12);
        assert_eq!(DistanceSums::default().finish(), None);
    }
}
