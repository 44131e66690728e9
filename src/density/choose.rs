//! From errors to levels: equal gain for every point; or, where the largest error counts, equal
//! errors.

use super::{Bend, ErrorCurves, NOTHING, SCALES, STEPS};
use isospan_io::error::Result;
use isospan_io::geom::Lattice;
use isospan_io::grid::BrickId;
use isospan_mesh::points::Levels;
use rayon::prelude::*;

/// A density for every cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Points of level 0 in the whole domain.
    pub n: u64,
    /// The level of each cell.
    pub levels: Levels,
}

/// log2 of voxels to a point at level 0, at least.
const DEPTH: u32 = 12;
/// The same below the mean density that is wanted.
const BELOW_MEAN: u32 = 6;
/// Points at level 0 in the whole domain, at least, where a volume has that many samples.
const LEAST_POINTS: u64 = 16;
/// Steps of a factor 2 in which λ is looked for; and its logarithm is between these.
const LAMBDA_STEPS: i32 = 64;
const LAMBDA_RANGE: i32 = 1000;
/// Stored logarithms are multiples of 1/4, and levels are a third of the way from one density to
/// the next.
const PARTS: i32 = 3 * STEPS as i32;

/// Where errors are to be equal, cells that have samples with and without a value have at least
/// this many points a voxel.
const MIXED_DENSITY: f64 = 0.125;
/// Points a voxel, at most, around a sample that is off.
const MOST_IN_VOXEL: f64 = 4096.0;
/// Levels that a cell is raised by at a time, at most; and cells around it that are raised too.
const MOST_RAISE: f64 = 3.0;
const MOST_REACH: u64 = 3;
/// Steps between the bound and the largest error, where points do not suffice for all.
const PARTS_OF_LARGEST: u32 = 16;

/// What the choice of a level depends on.
struct LevelChooser<'a> {
    curves: &'a ErrorCurves,
    /// 2^(i / PARTS).
    powers: [f64; PARTS as usize],
    /// The level of a point a voxel.
    top: u32,
    /// The least level of a cell that has samples with and without a value.
    mean: u8,
}

/// Two prices of a point, and the level of each cell by itself at them. At prices between them the
/// level is between, for the more a point costs, the lower a level is. So most cells need not be
/// looked at again when the range is halved.
struct Prices {
    dense: i32,
    sparse: i32,
    /// At `dense`.
    high: Vec<u8>,
    /// At `sparse`.
    low: Vec<u8>,
}

impl Choice {
    /// The levels of least error for `count` points inside the domain (of a mesh: inside the mesh);
    /// found by the threads of the pool that this is called in.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] when there are more points than a set may have.
    pub fn of_count(curves: &ErrorCurves, count: u64) -> Result<Self> {
        let voxels = curves.voxels();
        if count as f64 >= voxels {
            // Nothing is left to choose; and noise, which fewer points would not lessen, is met.
            let levels = Levels::new(curves.cells, vec![0; curves.logs.len()])?;
            let n = (count as f64 * (curves.box_voxels() / voxels)).round() as u64;
            return Ok(Self { n, levels });
        }
        let search = LevelChooser::new(curves, count as f64 / voxels);
        let prices = search.bisect(|levels| search.points(levels) <= count as f64);
        search.choice(search.graded(search.own_levels(prices.sparse, &prices)), count)
    }
}

impl Choice {
    /// Levels at which the root mean square error of each cell is about a bound, as far as `most`
    /// points suffice for that.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] when there are more points than a set may have.
    pub fn of_bound(curves: &ErrorCurves, bound: f64, most: u64) -> Result<Self> {
        let search = LevelChooser::new(curves, MIXED_DENSITY);
        let cells = 0..curves.logs.len();
        let mut levels: Vec<u8> = cells.into_par_iter().map(|c| search.level_within(c, bound)).collect();
        Levels::grade(&curves.cells, &mut levels);
        let points = search.points(&levels);
        if points > most as f64 {
            return Self::of_count(curves, most);
        }
        search.choice(levels, points.round() as u64)
    }

    /// About the number of points where the curves count them: of a mesh, those inside.
    pub fn points_in(&self, curves: &ErrorCurves) -> u64 {
        let of = |(cell, &level): (usize, &u8)| curves.cell_voxels(cell) * self.density(level);
        self.levels.as_slice().iter().enumerate().map(of).sum::<f64>().round() as u64
    }

    /// Points to a voxel at a level.
    fn density(&self, level: u8) -> f64 {
        let voxels: f64 = self.levels.cells().lattice.dims.iter().map(|&d| (d - 1) as f64).product();
        self.n as f64 / voxels * scale(1.0, level.into())
    }

    /// The same levels on a lattice with more steps a voxel along the axes on which the field bends
    /// most, as far as coordinates have bits for that.
    #[must_use]
    pub fn stretched(self, bend: &Bend) -> Self {
        let dims = self.levels.cells().lattice.dims;
        // The distance that most points see.
        let (mut points, mut squares) = (0.0, 0.0);
        for (level, &voxels) in (0..).zip(&self.levels.voxels_by_level()) {
            let density = self.density(level);
            points += density * voxels as f64;
            squares += density * density * voxels as f64;
        }
        let finer = bend.finer(libm::cbrt(points / squares));
        match Lattice::stretched(dims, finer) {
            Ok(lattice) => Self { levels: self.levels.on(lattice), ..self },
            Err(_) => self,
        }
    }

    /// Denser where errors are above a bound: `worst` has the largest one at a sample in or at each
    /// cell. With more than `most` points the largest errors alone count. `None` when nothing can
    /// be denser.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] when there are more points than a set may have.
    pub fn raised(&self, worst: &[f32], bound: f64, most: u64) -> Result<Option<Self>> {
        let before = self.levels.as_slice();
        let above = worst.iter().map(|&e| f64::from(e) / bound).fold(1.0, f64::max);
        let log = libm::log2(above);
        // For all errors, or only for those above a part of the largest.
        let within = (0..=PARTS_OF_LARGEST).map(|part| {
            let least = libm::exp2(log * f64::from(part) / f64::from(PARTS_OF_LARGEST));
            // A little less, for what rounding does to the largest.
            self.denser(worst, bound, least * 0.999)
        });
        let fits = |levels: &Vec<u8>| self.points(levels) <= most as f64;
        match within.into_iter().find(fits) {
            Some(levels) if levels != before => {
                Ok(Some(Self { n: self.n, levels: Levels::new(*self.levels.cells(), levels)? }))
            }
            _ => Ok(None),
        }
    }

    /// Points that levels make.
    pub(super) fn points(&self, levels: &[u8]) -> f64 {
        let densities: Vec<f64> = (0..=Levels::LARGEST).map(|l| self.density(l)).collect();
        let of = |(cell, &level): (u64, &u8)| {
            densities[usize::from(level)]
                * isospan_mesh::points::cell_voxels(self.levels.cells(), BrickId(cell)) as f64
        };
        (0..).zip(levels).map(of).sum()
    }

    /// Levels raised around the cells whose errors are above `times` times the bound.
    fn denser(&self, worst: &[f32], bound: f64, times: f64) -> Vec<u8> {
        let (cells, before) = (*self.levels.cells(), self.levels.as_slice());
        let [dims, edge] = [cells.dims(), cells.edge];
        let highest = (0..=Levels::LARGEST)
            .rev()
            .find(|&l| self.density(l) <= MOST_IN_VOXEL && self.n <= isospan_mesh::points::MOST_POINTS >> l)
            .unwrap_or(0);
        let mut levels = before.to_vec();
        for (cell, &error) in worst.iter().enumerate() {
            let above = f64::from(error) / bound;
            if above <= 1.0 || above < times {
                continue;
            }
            let level = before[cell];
            // Errors of a smooth field fall with the 2/3 power of the number of points.
            let more = libm::ceil(1.5 * libm::log2(above)).clamp(1.0, MOST_RAISE) as u8;
            let to = level.saturating_add(more).min(highest);
            // The tetrahedron of the sample reaches about so far.
            let spacing = cells.lattice.cube().map(|edge| edge * libm::cbrt(1.0 / self.density(level)));
            let c = cells.coords(BrickId(cell as u64));
            let reach = [0, 1, 2].map(|a| ((spacing[a] / edge[a] as f64) as u64).min(MOST_REACH));
            let [xs, ys, zs] =
                [0, 1, 2].map(|a| c[a].saturating_sub(reach[a])..(c[a] + reach[a] + 1).min(dims[a]));
            for [y, z] in zs.flat_map(|z| ys.clone().map(move |y| [y, z])) {
                let first = cells.id([xs.start, y, z]).0 as usize;
                let row = &mut levels[first..first + (xs.end - xs.start) as usize];
                row.iter_mut().for_each(|l| *l = (*l).max(to));
            }
        }
        Levels::grade(&cells, &mut levels);
        levels
    }

    /// About the least number of points inside the domain with which the root mean square error at
    /// all samples is at most `rms`.
    pub fn count_of_rms(curves: &ErrorCurves, rms: f64) -> u64 {
        let samples = curves.samples;
        let search = LevelChooser::new(curves, 1.0);
        let prices = search.bisect(|levels| search.total_error(levels) > rms * rms * samples);
        let levels = search.graded(search.own_levels(prices.dense, &prices));
        search.points(&levels).min(samples).max(1.0) as u64
    }
}

impl ErrorCurves {
    fn box_voxels(&self) -> f64 {
        self.cells.lattice.dims.iter().map(|&d| (d - 1) as f64).product()
    }

    /// Voxels in which points count; at least one.
    fn voxels(&self) -> f64 {
        let inside = |all: &Vec<f32>| all.iter().map(|&v| f64::from(v)).sum::<f64>().max(1.0);
        self.inside.as_ref().map_or_else(|| self.box_voxels(), inside)
    }

    /// The voxels of a cell.
    fn cell_voxels(&self, cell: usize) -> f64 {
        match &self.inside {
            Some(inside) => f64::from(inside[cell]),
            None => isospan_mesh::points::cell_voxels(&self.cells, BrickId(cell as u64)) as f64,
        }
    }
}

impl<'a> LevelChooser<'a> {
    fn new(curves: &'a ErrorCurves, density: f64) -> Self {
        let below = |x: f64| libm::ceil(-libm::log2(x)).clamp(0.0, f64::from(Levels::LARGEST)) as u32;
        let samples = curves.voxels() as u64;
        let most = (samples / LEAST_POINTS).max(1).ilog2().min(u32::from(Levels::LARGEST));
        let top = DEPTH.max(below(density) + BELOW_MEAN).min(most);
        let powers = std::array::from_fn(|i| libm::exp2(i as f64 / f64::from(PARTS)));
        let mean = top.saturating_sub(below(density)) as u8;
        Self { curves, powers, top, mean }
    }

    /// The error of a cell at a level: sum of squares.
    #[inline]
    fn error(&self, logs: &[i16; SCALES], level: u32) -> f64 {
        // In thirds of a density; the first one measured has 1/8 point a voxel.
        let thirds = (self.top - level) as i32 - 3;
        let last = SCALES as i32 - 1;
        let i = thirds.div_euclid(3).clamp(0, last - 1);
        let [a, b] = [logs[i as usize], logs[i as usize + 1]].map(i32::from);
        let mut slope = b - a;
        if thirds < 0 {
            slope = slope.min(4 * STEPS as i32);
        }
        let parts = 3 * a + slope * (thirds - 3 * i).min(3);
        let power = self.powers[parts.rem_euclid(PARTS) as usize];
        scale(power, parts.div_euclid(PARTS))
    }

    /// The level of a cell by itself, of those from `low` to `high`.
    fn level(&self, cell: usize, lambda: f64, [low, high]: [u8; 2]) -> u8 {
        let logs = self.curves.logs[cell];
        if low == high || logs[SCALES - 1] == NOTHING && logs.iter().all(|&l| l == NOTHING) {
            return low;
        }
        let logs = rising(logs);
        let price = lambda * self.curves.cell_voxels(cell);
        let cost = |level: u32| self.error(&logs, level) + price * scale(1.0, level as i32 - self.top as i32);
        let mut best = (f64::INFINITY, low);
        for level in low..=high {
            let cost = cost(level.into());
            if cost < best.0 {
                best = (cost, level);
            }
        }
        best.1
    }

    /// The least level of a cell with which its root mean square error is at most this.
    fn level_within(&self, cell: usize, rms: f64) -> u8 {
        let logs = self.curves.logs[cell];
        let least = if self.curves.mixed[cell] { self.mean } else { 0 };
        if logs.iter().all(|&l| l == NOTHING) {
            return least;
        }
        let (logs, most) = (rising(logs), rms * rms * self.curves.cell_voxels(cell));
        let level = (0..self.top).find(|&l| self.error(&logs, l) <= most).unwrap_or(self.top);
        (level as u8).max(least)
    }

    /// Halves the range of prices until it is known from which one on `is_sparse` holds of the
    /// graded levels.
    fn bisect(&self, is_sparse: impl Fn(&[u8]) -> bool) -> Prices {
        let (cells, most) = (self.curves.logs.len(), LAMBDA_RANGE * LAMBDA_STEPS);
        let mut prices =
            Prices { dense: -most, sparse: most, high: vec![self.top as u8; cells], low: vec![0; cells] };
        while prices.dense + 1 < prices.sparse {
            let middle = prices.dense.midpoint(prices.sparse);
            let levels = self.own_levels(middle, &prices);
            if is_sparse(&self.graded(levels.clone())) {
                (prices.sparse, prices.low) = (middle, levels);
            } else {
                (prices.dense, prices.high) = (middle, levels);
            }
        }
        prices
    }

    /// The level of each cell by itself for a price of a point, of those between which prices are
    /// known.
    fn own_levels(&self, lambda: i32, prices: &Prices) -> Vec<u8> {
        let lambda = libm::exp2(f64::from(lambda) / f64::from(LAMBDA_STEPS));
        let ranges = prices.low.par_iter().zip(&prices.high).enumerate();
        ranges.map(|(cell, (&low, &high))| self.level(cell, lambda, [low, high])).collect()
    }

    /// No less than cells with samples of both kinds have, and graded.
    fn graded(&self, mut levels: Vec<u8>) -> Vec<u8> {
        let mixed = levels.iter_mut().zip(&self.curves.mixed).filter(|(_, mixed)| **mixed);
        mixed.for_each(|(level, _)| *level = (*level).max(self.mean));
        Levels::grade(&self.curves.cells, &mut levels);
        levels
    }

    /// The sum of squared errors of all cells.
    fn total_error(&self, levels: &[u8]) -> f64 {
        let of = |(logs, &level): (&[i16; SCALES], &u8)| self.error(&rising(*logs), u32::from(level));
        self.curves.logs.iter().zip(levels).map(of).sum()
    }

    fn points(&self, levels: &[u8]) -> f64 {
        let of = |(cell, &level): (usize, &u8)| {
            self.curves.cell_voxels(cell) * scale(1.0, i32::from(level) - self.top as i32)
        };
        levels.iter().enumerate().map(of).sum()
    }

    /// Levels from 0 on, and how many points level 0 has for `count` points in all.
    fn choice(&self, mut levels: Vec<u8>, count: u64) -> Result<Choice> {
        let least = levels.iter().copied().min().unwrap_or(0);
        let first = self.curves.box_voxels() * scale(1.0, i32::from(least) - self.top as i32);
        let n = (first * count as f64 / self.points(&levels)).round().max(1.0) as u64;
        levels.iter_mut().for_each(|l| *l -= least);
        Ok(Choice { n, levels: Levels::new(self.curves.cells, levels)? })
    }
}

/// An error that is less at a lower density is luck; none is a very small one.
#[inline]
fn rising(mut logs: [i16; SCALES]) -> [i16; SCALES] {
    let mut largest = -4000;
    for log in &mut logs {
        largest = largest.max(*log);
        *log = largest;
    }
    logs
}

/// x · 2^e, x from 1 to 2.
#[inline]
fn scale(x: f64, e: i32) -> f64 {
    x * f64::from_bits(((e.clamp(-1022, 1023) + 1023) as u64) << 52)
}
