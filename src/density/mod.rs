//! Where does a field need more points?
//!
//! A field that is linear in each tetrahedron is off where the field bends within one. How far
//! depends on the field there, and on how many points there are. So for each cell of a few voxels
//! the error is **measured** at five densities, as that of the simplest reduction of all: keep
//! every s-th sample along each axis, s = 2, 4 … 32, and interpolate the others from the eight
//! around them. That needs no mesh and no more than the samples of 32³ voxels at a time, and shows
//! by itself what kind of place it is:
//!
//! ```text
//!  error²                              what more points bring
//!    │ ────────────── noise            nothing, until all samples are there
//!    │          ___---  an edge        about their number
//!    │      _--
//!    │   _-     smooth                 the 4/3 power of their number
//!    └──────────────────── s
//!        2   4   8  16  32
//! ```
//!
//! A cell's **level** l is then a number of points to a voxel, 2^(l - L), L being the level of a
//! point a voxel. The error between two densities is interpolated, both logarithmic; beyond the
//! densest one it goes on as before, but at best as of a smooth field.
//!
//! **Equal gain.** With E(l) the sum of squares of a cell and P(l) its points, the least total
//! error for a number of points has each cell at the l of least E(l) + λ·P(l), with one λ for all
//! (Lagrange): no cell could give a point to another one that would use it better. So noise gets
//! few points: there they would be wasted. λ is found by bisection for the number of points that is
//! wanted; levels are graded ([`Levels`]) before they are counted.
//!
//! **Focus.** Who looks at isovalues from LO to HI alone does not care what happens above and
//! below. Samples are cut off at LO and HI before errors are measured; where all are on one side,
//! nothing is wrong.
//!
//! Everything that decides is an integer or an IEEE operation, and the logarithms are those of
//! `libm`: the same levels on every machine. Time: 15 operations a sample and density. Memory: 11
//! bytes a cell. References: D'Azevedo and Simpson, "On optimal interpolation triangle incidences",
//! 1989 (error by second derivatives); Nadler, "Piecewise linear best L2 approximation on
//! triangulations", 1986 (equal errors).

mod bend;
mod block;
mod choose;

pub use bend::Bend;
pub use block::{BLOCK_EDGE, BlockErrors};
pub use choose::Choice;

use isospan_io::grid::BrickGrid;
use isospan_mesh::points::Levels;

/// Densities at which errors are measured: every 2nd, 4th … sample along each axis.
pub const SCALES: usize = 5;

/// A cell without error, at a density.
const NOTHING: i16 = i16::MIN;
/// Steps of a factor 2 in what is stored.
const STEPS: f64 = 4.0;

/// The error of each cell at each density.
#[derive(Clone, Debug)]
pub struct ErrorCurves {
    cells: BrickGrid,
    /// Four times the logarithm (base 2) of the sum of squared errors, rounded; or [`NOTHING`].
    logs: Vec<[i16; SCALES]>,
    /// Whether the cell has samples with a value, and others without.
    mixed: Vec<bool>,
    /// For a mesh that does not fill the box: how many voxels of each cell it has, about. Points
    /// elsewhere do not count.
    inside: Option<Vec<f32>>,
    /// How many samples the errors are sums over.
    samples: f64,
}

impl ErrorCurves {
    /// Empty curves for the cells of a lattice, which are as small as possible.
    pub fn new(lattice: isospan_io::geom::Lattice) -> Self {
        let at = |edge| BrickGrid::new(lattice, [edge; 3]);
        let count = |edge| at(edge).dims().iter().map(|&n| u128::from(n)).product::<u128>();
        let mut edge = LEAST_EDGE;
        while count(edge) > u128::from(Levels::MOST_CELLS) {
            edge *= 2;
        }
        let cells = at(edge);
        let len = cells.len() as usize;
        let samples = lattice.dims.iter().map(|&d| d as f64).product();
        Self { cells, logs: vec![[NOTHING; SCALES]; len], mixed: vec![false; len], inside: None, samples }
    }

    /// As [`ErrorCurves::new`], of a mesh in the lattice's box; it is where samples have values.
    pub fn of_mesh(lattice: isospan_io::geom::Lattice) -> Self {
        let curves = Self::new(lattice);
        let inside = Some(vec![0.0; curves.logs.len()]);
        Self { inside, ..curves }
    }

    /// Turns errors of a mesh from sums over samples of the grid into sums over its vertices;
    /// `vertices` has their number for each cell. Half of what a cell counts is its part of them,
    /// half its part of the volume.
    ///
    /// # Panics
    /// For curves that are not [of a mesh](Self::of_mesh).
    pub fn weigh(&mut self, vertices: &[u32], all: u64) {
        let inside = self.inside.as_ref().expect("the curves are of a mesh");
        let a_voxel = all as f64 / inside.iter().map(|&v| f64::from(v)).sum::<f64>().max(1.0);
        for ((logs, &voxels), &vertices) in self.logs.iter_mut().zip(inside).zip(vertices) {
            let weight = (f64::from(vertices) / f64::from(voxels.max(1.0)) + a_voxel) / 2.0;
            let log = (libm::log2(weight) * STEPS).round() as i16;
            logs.iter_mut().filter(|l| **l != NOTHING).for_each(|l| *l = l.saturating_add(log));
        }
        self.samples = all as f64;
    }

    /// The cells.
    pub fn cells(&self) -> &BrickGrid {
        &self.cells
    }

    /// Bytes that the curves of a lattice take, and the levels made of them.
    pub fn bytes_for(lattice: isospan_io::geom::Lattice) -> u64 {
        let cells = lattice.dims.iter().map(|&d| (d - 1).div_ceil(LEAST_EDGE)).fold(1, u64::saturating_mul);
        cells.min(Levels::MOST_CELLS) * 16
    }

    /// As [`ErrorCurves::bytes_for`], of a mesh, with the number of vertices of each cell.
    pub fn bytes_for_mesh(lattice: isospan_io::geom::Lattice) -> u64 {
        Self::bytes_for(lattice) / 16 * 24
    }

    /// Adds the errors of a block.
    pub fn add(&mut self, errors: &BlockErrors) {
        for (cell, sums, [good, bad]) in errors.cells() {
            let at = cell.0 as usize;
            self.mixed[at] |= good > 0 && bad > 0;
            if let Some(inside) = &mut self.inside {
                inside[at] += good as f32;
            }
            for (log, &sum) in self.logs[at].iter_mut().zip(sums) {
                *log = to_log(from_log(*log) + sum);
            }
        }
    }

    /// Adds the errors of another field on the same cells, in units in which a square is `scale`
    /// times as large.
    pub fn add_field(&mut self, other: &Self, scale: f64) {
        for (logs, more) in self.logs.iter_mut().zip(&other.logs) {
            for (log, &more) in logs.iter_mut().zip(more) {
                *log = to_log(from_log(*log) + from_log(more) * scale);
            }
        }
        self.mixed.iter_mut().zip(&other.mixed).for_each(|(mixed, more)| *mixed |= more);
    }
}

/// Voxel cells along the edge of a cell, at least.
const LEAST_EDGE: u64 = 2;

fn to_log(sum: f64) -> i16 {
    if sum > 0.0 { (libm::log2(sum) * STEPS).round() as i16 } else { NOTHING }
}

fn from_log(log: i16) -> f64 {
    if log == NOTHING { 0.0 } else { libm::exp2(f64::from(log) / STEPS) }
}

#[cfg(test)]
mod tests;
