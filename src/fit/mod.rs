//! Which values at the vertices bring the reduced field closest to the samples?
//!
//! A field that is linear in each tetrahedron is off between its vertices, even where it has the
//! right value at each of them. So the values are moved, one step, towards those of least squared
//! error over all samples, and not past the samples around. With x the values at the vertices, f a
//! sample, and w its weights in its tetrahedron, that error is
//!
//! ```text
//!     E(x) = Σ (f - Σ w_v x_v)²  +  c Σ (x_v - s_v)²      s: the interpolated values, which hold
//!           samples              vertices                    where few samples are
//! ```
//!
//! and the step from s, over the samples in the tetrahedra at v,
//!
//! ```text
//!     x_v = s_v + ω · Σ (w_v - γ) (f - Σ w s)  /  (c + Σ w_v²)      bounded by the least and the
//!                                                                   largest of these f and s_v
//! ```
//!
//! **Why bounds.** Where a field is steep or is cut off, as air is in CT, values of least error
//! overshoot the samples. Surfaces then have islands where there is nothing: up to 28 point
//! spacings from the surface of all samples. With bounds an edge of the mesh crosses an isovalue
//! only where the samples around its ends, or the interpolated values there, do so too: nothing is
//! further than two spacings on the data tried (`benches/compare_fit`), and no value leaves the
//! range of the samples.
//!
//! **Why γ.** The other corners of a sample's tetrahedron move as well, so a vertex that moves as
//! if it were alone goes too far; ω < 1 damps all of them alike. With γ a vertex follows what is
//! near it, and is turned against what is far, which its neighbours follow. For a tetrahedron
//! alone, densely sampled, γ = 1/5 gives the least squares: its corners' dual functions are 20 (w -
//! 1/5). Around a vertex 1/8 with ω = 1.16 was best, with bounds, over all data tried.
//!
//! **Why one step.** Each step makes values depend on one more ring of tetrahedra, which a chunk
//! would have to mesh beyond its own. RMS errors, to those of the interpolated values; the steps
//! without bounds have γ = 0 and the best ω:
//!
//! | data, points a sample | the bounded step | one step without bounds | two | three | least |
//! |---|---|---|---|---|---|
//! | tooth CT, 1/8 | 0.77 | 0.76 | 0.74 | 0.74 | 0.74 |
//! | tooth CT, 1/64 | 0.85 | 0.84 | 0.82 | 0.81 | 0.81 |
//! | hydrogen, 1/8 | 0.56 | 0.51 | 0.48 | 0.48 | 0.48 |
//! | hurricane, 1/8 | 0.71 | 0.70 | 0.66 | 0.65 | 0.65 |
//!
//! Bounds cost most where samples are cut off at an end of their range (engine CT, 1/8: 0.70
//! where 0.65 was): most of that is lost as soon as values stay within the range of all samples.
//!
//! **The same bits for any chunk.** Sums of floating-point numbers depend on their order. So the
//! samples are taken window by window, each in its order in the volume, for any order of the
//! tetrahedra: scan conversion notes for each sample the tetrahedron it is in, its weights and its
//! difference; the sums follow. Windows are those of the whole volume, and weights come from exact
//! integers. A vertex is right when all its tetrahedra are given.
//!
//! **Several steps of a series.** Which tetrahedron has a sample, and with which weights, does not
//! depend on the step; nor does Σ w² where no corner is void, and no sample NaN, at one step and
//! not at another. So steps are fitted together: one scan conversion, then each step's differences,
//! interleaved (`sums.rs`). The additions are those of each step alone, in their order, and so are
//! the bits.
//!
//! **Meshes.** The samples of a tetrahedral mesh are its vertices. They lie anywhere, so windows
//! are bricks, and the tetrahedra look the samples of a brick up
//! ([`isospan_mesh::raster::PointLocator`]); else all is the same.
//!
//! **What holds.** A constant stays that constant, exactly, since a difference is Σ w (f - s),
//! added in an order that does not depend on the order of the corners; a linear field stays linear
//! but for rounding. A tetrahedron with a void corner (NaN), and a sample that is NaN, contribute
//! nothing. A value is between the least and the largest of its interpolated value and the samples
//! in the tetrahedra around.
//!
//! Cost: one scan conversion of the tetrahedra, some 40 operations a sample and step (or eight
//! steps, with AVX-512). Memory: 60 bytes a vertex, 9 a tetrahedron (what stands empty of a
//! chunk's, as far as that goes), 24 a sample of a window; of each eight steps 168 bytes a vertex
//! (232 where voids differ), and 32 bytes a sample of some slices. Reference: Garland and Heckbert,
//! "Fast polygonal approximation of terrains and height fields", 1995, for the field's error as the
//! measure.

mod sums;
#[cfg(test)]
mod tests;
mod windows;

use self::sums::Lanes;
pub use windows::{BrickTets, Windows, window_edge};

use isospan_io::exec::Room;
use isospan_io::geom::LatticePos;
use isospan_io::grid::IndexBox;
use isospan_mesh::mesh::tet::Tet;
use isospan_mesh::raster::{BatchScan, PointLocator, SampleGrid, Scanner};
use isospan_mesh::simd::with_vectors;

/// Samples of a step that are read at a time, where a slice has no more.
const SLICES: usize = 1 << 13;

/// A sample that is in no tetrahedron.
const NONE: u32 = u32::MAX;

/// Vertices, and the tetrahedra that contribute to their values.
#[derive(Clone, Copy, Debug)]
pub struct FitMesh<'a> {
    /// Lattice positions of the vertices.
    pub positions: &'a [LatticePos],
    /// Positively oriented tetrahedra, as numbers of the vertices; none overlap.
    pub tets: &'a [Tet],
}

/// A sample of a window, as far as it lies in a tetrahedron.
#[derive(Clone, Copy, Debug)]
struct Located {
    /// Its tetrahedron, as a number of those that the window was given with; or [`NONE`].
    tet: u32,
    weights: [f32; 4],
}

const NOTHING: Located = Located { tet: NONE, weights: [0.0; 4] };

/// Sums over the samples of windows, at some steps.
pub struct Fit<'a> {
    mesh: FitMesh<'a>,
    steps: usize,
    lanes: Vec<Lanes<'a>>,
    /// Whether each vertex is void at all steps; empty where none is.
    void: Vec<bool>,
    /// The tetrahedron and the weights of each sample of a window.
    located: Vec<Located>,
    /// The tetrahedra of a window that contribute something.
    tets: Vec<Tet>,
    /// Samples of some slices, step after step.
    samples: Vec<f32>,
    batch: BatchScan,
}

impl<'a> Fit<'a> {
    /// Begins with the interpolated values at each step, one for each vertex; NaN for a void one.
    /// Works in `room`, as far as that goes.
    pub fn new(mesh: FitMesh<'a>, steps: &[&[f32]], room: &mut Room<'a>) -> Self {
        let is_void = |v: usize| steps.iter().all(|values| values[v].is_nan());
        let vertices = 0..mesh.positions.len();
        let some_void = vertices.clone().any(is_void);
        Self {
            mesh,
            steps: steps.len(),
            lanes: Lanes::all(steps, room),
            void: if some_void { vertices.map(is_void).collect() } else { vec![] },
            located: vec![],
            tets: vec![],
            samples: vec![],
            batch: BatchScan::default(),
        }
    }

    /// Words of memory that the sums of some steps take besides those of the first ones.
    pub fn further_words(vertices: usize, steps: usize) -> usize {
        Lanes::words(vertices).saturating_mul(Lanes::count(steps).saturating_sub(1))
    }

    /// The mesh that was given.
    pub fn mesh(&self) -> FitMesh<'a> {
        self.mesh
    }

    /// Adds the samples of a window, given with those of the mesh's tetrahedra that touch it.
    /// `read` reads samples of a step: those of some slices of the window, x fastest; NaN is no
    /// sample. The windows of a volume come in ascending order, and may leave out samples at their
    /// borders that no tetrahedron has.
    ///
    /// For up to eight consecutive steps, all slices are read and added, a few at a time. So what
    /// is read lies in a near cache when it is asked for, and so do the sums.
    ///
    /// # Errors
    /// Errors of `read`.
    pub fn add<E>(
        &mut self,
        grid: &SampleGrid,
        window: &IndexBox,
        tets: &[u32],
        mut read: impl FnMut(usize, IndexBox, &mut [f32]) -> Result<(), E>,
    ) -> Result<(), E> {
        if window.is_empty() {
            return Ok(());
        }
        let scanner = Scanner::new(grid, window);
        with_vectors(
            #[inline(always)]
            || self.scan(&scanner, window.len(), tets),
        );
        let mut first = 0;
        for lanes in &mut self.lanes {
            let (steps, mut rest) = (first..first + lanes.steps(), &*self.located);
            for part in window.slices(SLICES) {
                let located;
                (located, rest) = rest.split_at(part.len());
                self.samples.resize(steps.len() * located.len(), 0.0);
                for (step, out) in steps.clone().zip(self.samples.chunks_exact_mut(located.len())) {
                    read(step, part, out)?;
                }
                lanes.add(located, &self.samples, &self.tets);
            }
            first = steps.end;
        }
        Ok(())
    }

    /// Notes the tetrahedron and the weights of each sample of a window.
    #[inline(always)]
    fn scan(&mut self, scanner: &Scanner<'_>, samples: usize, tets: &[u32]) {
        self.start(samples);
        let Self { mesh, void, located, tets: telling, batch, .. } = self;
        telling.clear();
        let given = tets.iter().map(|&tet| mesh.tets[tet as usize]);
        telling.extend(given.filter(|tet| has_values(void, tet)));
        batch.each_member(
            scanner,
            mesh.positions,
            telling,
            #[inline(always)]
            |members| {
                let [a, b, c, d] = members.weights();
                for (i, (&tet, &place)) in members.tets().iter().zip(members.places()).enumerate() {
                    located[place as usize] =
                        Located { tet, weights: [a[i] as f32, b[i] as f32, c[i] as f32, d[i] as f32] };
                }
            },
        );
    }

    /// Adds samples that lie anywhere, those of each step after those of the one before, given with
    /// those of the mesh's tetrahedra that may have some; NaN is no sample. `points` has their
    /// places, by their numbers in the samples of a step; of those in a tetrahedron the ones count
    /// that count for it, as `counts_for` says (tetrahedron, sample).
    ///
    /// # Panics
    /// When the samples are not as many at each step.
    pub fn add_points(
        &mut self,
        points: &PointLocator,
        samples: &[f32],
        tets: &[u32],
        counts_for: impl Fn(u32, u32) -> bool,
    ) {
        assert_eq!(samples.len() % self.steps, 0, "as many samples at each step");
        self.start(samples.len() / self.steps);
        self.tets.clear();
        for &number in tets {
            let tet = self.mesh.tets[number as usize];
            if !has_values(&self.void, &tet) {
                continue;
            }
            let corners = tet.map(|v| self.mesh.positions[v as usize]);
            points.each_in(corners, |sample, weights| {
                if counts_for(number, sample) {
                    let weights = weights.map(|w| w as f32);
                    self.located[sample as usize] = Located { tet: self.tets.len() as u32, weights };
                }
            });
            self.tets.push(tet);
        }
        self.add_located(samples);
    }

    /// Prepares for this many samples; none of them has a tetrahedron yet.
    #[inline(always)]
    fn start(&mut self, samples: usize) {
        self.located.clear();
        self.located.resize(samples, NOTHING);
    }

    /// Adds what the samples contribute to the sums at the corners of their tetrahedra, in their
    /// order.
    fn add_located(&mut self, samples: &[f32]) {
        let mut rest = samples;
        for lanes in &mut self.lanes {
            let (some, others) = rest.split_at(lanes.steps() * self.located.len());
            lanes.add(&self.located, some, &self.tets);
            rest = others;
        }
    }

    /// The fitted values of the first `count` vertices, at each step.
    pub fn values(&self, count: usize) -> Vec<Vec<f32>> {
        self.values_rounded(count, &|_, value, _| value)
    }

    /// As [`Fit::values`], each rounded by a function of the step, the value, and the least and
    /// largest value that it may have.
    pub fn values_rounded(&self, count: usize, round: &RoundWithin<'_>) -> Vec<Vec<f32>> {
        let mut all = vec![];
        for lanes in &self.lanes {
            let first = all.len();
            all.extend(lanes.values(count, &|lane, value, bounds| round(first + lane, value, bounds)));
        }
        all
    }
}

/// The rounded value of a step, of a value that lies within the bounds, the least first.
pub type RoundWithin<'a> = dyn Fn(usize, f32, [f32; 2]) -> f32 + 'a;

/// Whether a tetrahedron has no corner that is void at all steps: else it contributes nothing.
#[inline(always)]
fn has_values(void: &[bool], tet: &Tet) -> bool {
    void.is_empty() || !tet.iter().any(|&v| void[v as usize])
}
