//! How far is a surface from another one, of any size?
//!
//! The surface that is measured to is taken in pieces, as many triangles as memory holds with their
//! hierarchy. Each vertex looks in the pieces whose box it lies in first; then only in those whose
//! box is nearer than what it has found. So distances are exact, and do not depend on the pieces.
//! Mean and root mean square are integrals over the triangles, of the means of their corners.

use super::nearest::{Nearest, Triangles, Walk};
use crate::surface::{SurfaceSource, vertices_from};
use glam::DVec3;
use isospan_io::bytes::paged::Paged;
use isospan_io::bytes::store::{Cached, Store};
use isospan_io::error::Result;
use isospan_io::exec::{Resources, pool};
use rayon::ThreadPool;
use rayon::prelude::*;

/// Distances of the vertices of a surface from another one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Apart {
    /// The largest.
    pub max: f64,
    /// The place of that vertex in the world.
    pub max_at: [f64; 3],
    /// Mean over the area.
    pub mean: f64,
    /// Root mean square over the area.
    pub rms: f64,
}

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
) -> Result<Option<Apart>> {
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
    let mut search = Search { own: &own, best, pool: pool(resources.threads)?, resources };
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
                    search.look_in(&Piece::new(&piece, &mut places)?, round)?;
                    piece.clear();
                }
            }
            Ok(())
        })?;
        if !piece.is_empty() {
            search.look_in(&Piece::new(&piece, &mut places)?, round)?;
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
struct Piece {
    triangles: Triangles,
    lo: DVec3,
    hi: DVec3,
}

impl Piece {
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
struct Search<'a> {
    own: &'a Store<[f32; 3]>,
    best: Paged<f64>,
    pool: ThreadPool,
    resources: &'a Resources,
}

impl Search<'_> {
    fn look_in(&mut self, piece: &Piece, round: Round) -> Result<()> {
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
    fn summed_up(mut self, from: &dyn SurfaceSource, held: usize, origin: [f64; 3]) -> Result<Option<Apart>> {
        let mut places = Cached::new(self.own, held);
        let (mut out, mut area, mut sums) = (Apart { max: -1.0, ..Apart::default() }, 0.0, [0.0; 2]);
        from.triangles(&mut |batch| {
            for t in batch {
                let (mut corners, mut found) = ([DVec3::ZERO; 3], [0.0; 3]);
                for (k, v) in t.iter().enumerate() {
                    corners[k] = DVec3::from_array(places.get(u64::from(*v))?.map(f64::from));
                    found[k] = self.best.get(u64::from(*v))?;
                    if found[k] > out.max {
                        out.max = found[k];
                        out.max_at = (corners[k] + DVec3::from_array(origin)).to_array();
                    }
                }
                let [a, b, c] = corners;
                let own = (b - a).cross(c - a).length() / 2.0;
                area += own;
                sums[0] += own * found.iter().sum::<f64>() / 3.0;
                sums[1] += own * found.iter().map(|d| d * d).sum::<f64>() / 3.0;
            }
            Ok(())
        })?;
        (out.mean, out.rms) = (sums[0] / area, (sums[1] / area).sqrt());
        Ok((area > 0.0).then_some(out))
    }
}
