//! The coordinates of a rectilinear or curvilinear grid, so that its archive needs no other file.
//!
//! Such a grid is sampled and meshed in index space. A position in the world is interpolated
//! trilinearly from the grid's samples around it. A rectilinear grid needs three tables for that, a
//! curvilinear one the eight corners of a cell. A segment holds a head, then either the three
//! tables or runs of [`RUN`] samples in file order (x fastest).
//!
//! [`CoordinateMap`] reads what is asked for and keeps some runs: neighbours on a surface use the
//! same ones.
//!
//! **Folded cells.** The map of a cell has eight determinants, one at each corner. Where they have
//! different signs, or another sign than in most cells, the grid folds over itself. Where all of
//! them are 0, the cell has no volume. (At the axis of a cylinder, say, they vanish at four corners
//! only: such cells are good.) [`CoordinateMap::count_cells`] counts them.

use crate::archive::segment::{PlanHash, Segment, SegmentInfo, SegmentKind, SegmentWriter};
use crate::archive::wire::Malformed;
use byteorder::{ByteOrder, LE};
use glam::{DMat3, DVec3};
use isospan_io::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use xxhash_rust::xxh3::Xxh3;

/// Samples of a run.
pub(in crate::archive) const RUN: u64 = 1024;

/// Runs that are kept: 24 MiB.
const KEPT_RUNS: usize = 1024;

/// Bytes of the head: the kind, and the samples along x, y, z.
const HEAD_BYTES: usize = 32;

/// Head of a rectilinear grid.
pub(in crate::archive) const COORDINATES_AXES: u8 = 1;
/// Head of a curvilinear grid.
pub(in crate::archive) const COORDINATES_POINTS: u8 = 2;

/// Fills a buffer with the next numbers: x, y, z of each sample, x fastest.
pub(in crate::archive) type NextPoints<'a> = &'a mut dyn FnMut(&mut [f64]) -> Result<()>;

/// What is written.
pub enum Coordinates<'a> {
    /// Tables of x, y and z.
    Axes([Vec<f64>; 3]),
    /// A position for each sample.
    Points(NextPoints<'a>),
}

/// How many cells a grid has of each sort.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CellCount {
    /// Cells that fold: their map turns inside out within them, or is oriented the other way than
    /// that of most cells.
    pub folded: u64,
    /// Cells without a volume.
    pub degenerate: u64,
    /// Whether most cells are mirror images of those of index space.
    pub mirrored: bool,
}

/// Writes the coordinates of a grid of `dims` samples.
///
/// # Errors
/// Errors of the coordinates and of writing; [`Error::BadInput`] for a coordinate that is not
/// finite.
pub fn write_coordinates(
    path: &Path,
    plan: PlanHash,
    dims: [u64; 3],
    coordinates: Coordinates<'_>,
) -> Result<SegmentInfo> {
    let mut out = SegmentWriter::create(path, SegmentKind::Coordinates, plan)?;
    let mut block = vec![0; 8];
    block[0] = match &coordinates {
        Coordinates::Axes(_) => COORDINATES_AXES,
        Coordinates::Points(_) => COORDINATES_POINTS,
    };
    block.extend(dims.iter().flat_map(|d| d.to_le_bytes()));
    out.push_block(&block)?;
    let mut push = |numbers: &[f64], at: u64| {
        if let Some(bad) = numbers.iter().position(|x| !x.is_finite()) {
            let got = numbers[bad].to_string();
            let place = format!("coordinate {}", at + bad as u64);
            return Err(Error::bad_input(path, place, "a finite number in the grid", got));
        }
        block.clear();
        block.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
        out.push_block(&block).map(drop)
    };
    match coordinates {
        Coordinates::Axes(axes) => axes.iter().try_for_each(|axis| push(axis, 0))?,
        Coordinates::Points(next) => {
            let (samples, mut run) = (dims.iter().product::<u64>(), vec![]);
            for first in (0..samples).step_by(RUN as usize) {
                run.resize(3 * RUN.min(samples - first) as usize, 0.0);
                next(&mut run)?;
                push(&run, 3 * first)?;
            }
        }
    }
    out.finish()
}

/// A position of index space in the world, and how the map stretches space there.
#[derive(Clone, Copy, Debug)]
pub struct WorldPosition {
    /// The world position.
    pub position: [f64; 3],
    /// Columns: the derivatives along the three index axes.
    pub(super) jacobian: DMat3,
}

impl WorldPosition {
    /// A gradient of index space, as a covector, in the world; its length means nothing.
    pub fn direction(&self, covector: [f64; 3]) -> [f64; 3] {
        let (j, g) = (&self.jacobian, DVec3::from_array(covector));
        // The cofactors: the inverse's transpose times the determinant, whose sign is put back.
        let (a, b, c) = (j.x_axis, j.y_axis, j.z_axis);
        let w = b.cross(c) * g.x + c.cross(a) * g.y + a.cross(b) * g.z;
        let sign = if j.determinant() < 0.0 { -1.0 } else { 1.0 };
        (w * sign).to_array()
    }
}

/// The coordinates of a grid, opened.
pub struct CoordinateMap {
    segment: Segment,
    dims: [u64; 3],
    grid: CoordinateGrid,
}

enum CoordinateGrid {
    Axes([Vec<f64>; 3]),
    Points(Mutex<Runs>),
}

/// Runs that were read last, the latest first.
#[derive(Default)]
struct Runs {
    kept: VecDeque<(u64, PointRun)>,
}

type PointRun = Arc<Vec<[f64; 3]>>;

impl CoordinateMap {
    /// Opens the coordinates of a grid of `dims` samples.
    ///
    /// # Errors
    /// [`Error::BadInput`] for a damaged segment, or one of another plan or size.
    pub fn open(path: &Path, plan: PlanHash, dims: [u64; 3]) -> Result<Self> {
        let segment = Segment::open(path, SegmentKind::Coordinates, Some(plan))?;
        let mut block = vec![];
        segment.block(0, &mut block)?;
        let bad = |what: &'static str, got: String| {
            Malformed::new(what, "that of a grid's coordinates", got).in_block(path, 0)
        };
        let head: &[u8; HEAD_BYTES] =
            block[..].try_into().map_err(|_| bad("head", format!("{} bytes", block.len())))?;
        if head[8..] != dims.iter().flat_map(|d| d.to_le_bytes()).collect::<Vec<u8>>() {
            return Err(bad("dimensions", format!("others than {dims:?}")));
        }
        let samples = dims
            .iter()
            .try_fold(1u64, |n, &d| n.checked_mul(d))
            .ok_or_else(|| bad("dimensions", format!("{dims:?}")))?;
        let (kind, blocks) = (head[0], segment.block_count());
        let grid = match kind {
            COORDINATES_AXES if blocks == 4 => CoordinateGrid::Axes(axes(&segment, dims)?),
            COORDINATES_POINTS if blocks == 1 + samples.div_ceil(RUN) => {
                CoordinateGrid::Points(Mutex::default())
            }
            _ => return Err(bad("kind and blocks", format!("kind {kind}, {blocks} blocks"))),
        };
        Ok(Self { segment, dims, grid })
    }

    /// The segment.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// Samples along x, y, z.
    pub(super) fn dims(&self) -> [u64; 3] {
        self.dims
    }

    /// The tables of x, y and z of a rectilinear grid.
    pub fn axes(&self) -> Option<&[Vec<f64>; 3]> {
        match &self.grid {
            CoordinateGrid::Axes(axes) => Some(axes),
            CoordinateGrid::Points(_) => None,
        }
    }

    /// The positions of the samples from `lo` to `hi`, both included, x fastest.
    pub(super) fn samples(&self, lo: [u64; 3], hi: [u64; 3], out: &mut Vec<DVec3>) -> Result<()> {
        out.clear();
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                let row = (z * self.dims[1] + y) * self.dims[0];
                let (mut next, past) = (row + lo[0], row + hi[0] + 1);
                while next < past {
                    match &self.grid {
                        CoordinateGrid::Axes(axes) => {
                            let [x, y, z] = [next - row, y, z].map(|n| n as usize);
                            out.push(DVec3::new(axes[0][x], axes[1][y], axes[2][z]));
                            next += 1;
                        }
                        CoordinateGrid::Points(runs) => {
                            let (from, to) = (next % RUN, (next % RUN + past - next).min(RUN));
                            self.with_run(runs, next / RUN, |run| {
                                out.extend(
                                    run[from as usize..to as usize].iter().copied().map(DVec3::from_array),
                                );
                            })?;
                            next += to - from;
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// XXH3 (128 bits) of all numbers as little-endian f64: the tables of x, y and z, or x, y, z of
    /// each sample.
    ///
    /// # Errors
    /// When the segment cannot be read, or is damaged.
    pub fn hash(&self) -> Result<u128> {
        let (mut hash, mut block) = (Xxh3::new(), vec![]);
        for number in 1..self.segment.block_count() {
            self.segment.block(number, &mut block)?;
            hash.update(&block);
        }
        Ok(hash.digest128())
    }

    /// The world position of a position in index space, within the grid.
    ///
    /// # Errors
    /// When the segment cannot be read, or is damaged.
    pub fn place(&self, ijk: [f64; 3]) -> Result<WorldPosition> {
        // A position on the far face lies in the last cell.
        let cell: [u64; 3] =
            std::array::from_fn(|a| (ijk[a].max(0.0) as u64).min(self.dims[a].saturating_sub(2)));
        let t = DVec3::from_array(std::array::from_fn(|a| ijk[a] - cell[a] as f64));
        Ok(trilinear(&self.corners(cell)?, t))
    }

    /// The position of a sample of the grid.
    ///
    /// # Errors
    /// When the segment cannot be read, or is damaged.
    pub fn sample(&self, at: [u64; 3]) -> Result<[f64; 3]> {
        match &self.grid {
            CoordinateGrid::Axes(axes) => Ok(std::array::from_fn(|a| axes[a][at[a] as usize])),
            CoordinateGrid::Points(runs) => {
                let number = (at[2] * self.dims[1] + at[1]) * self.dims[0] + at[0];
                Ok(self.point(runs, number)?.to_array())
            }
        }
    }

    /// The positions of the eight corners of a cell, x fastest.
    fn corners(&self, cell: [u64; 3]) -> Result<[DVec3; 8]> {
        let mut out = [DVec3::ZERO; 8];
        match &self.grid {
            CoordinateGrid::Axes(axes) => {
                for (n, corner) in out.iter_mut().enumerate() {
                    *corner = DVec3::from_array(std::array::from_fn(|a| {
                        axes[a][(cell[a] as usize) + (n >> a & 1)]
                    }));
                }
            }
            CoordinateGrid::Points(runs) => {
                for (row, pair) in out.chunks_exact_mut(2).enumerate() {
                    let (y, z) = (cell[1] + (row as u64 & 1), cell[2] + (row as u64 >> 1));
                    let first = (z * self.dims[1] + y) * self.dims[0] + cell[0];
                    for (sample, corner) in (first..).zip(pair) {
                        *corner = self.point(runs, sample)?;
                    }
                }
            }
        }
        Ok(out)
    }

    fn point(&self, runs: &Mutex<Runs>, sample: u64) -> Result<DVec3> {
        self.with_run(runs, sample / RUN, |run| DVec3::from_array(run[(sample % RUN) as usize]))
    }

    fn with_run<T>(
        &self,
        runs: &Mutex<Runs>,
        number: u64,
        use_it: impl FnOnce(&[[f64; 3]]) -> T,
    ) -> Result<T> {
        let mut runs = runs.lock().unwrap_or_else(PoisonError::into_inner);
        let found = runs.kept.iter().position(|(n, _)| *n == number);
        match found {
            Some(0) => {}
            Some(i) => {
                let run = runs.kept.remove(i).expect("it was found there");
                runs.kept.push_front(run);
            }
            None => {
                let run = self.read_run(number)?;
                runs.kept.truncate(KEPT_RUNS - 1);
                runs.kept.push_front((number, run));
            }
        }
        Ok(use_it(&runs.kept[0].1))
    }

    fn read_run(&self, number: u64) -> Result<PointRun> {
        let mut block = vec![];
        self.segment.block(1 + number, &mut block)?;
        let samples = self.dims.iter().product::<u64>();
        let expected = RUN.min(samples - number * RUN) as usize;
        let numbers = numbers(&self.segment, 1 + number, &block, 3 * expected)?;
        Ok(Arc::new(numbers.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()))
    }

    /// Goes through all cells. Memory: the runs that are kept.
    ///
    /// # Errors
    /// When the segment cannot be read, or is damaged.
    pub fn count_cells(&self) -> Result<CellCount> {
        let d = self.dims.map(|d| d.saturating_sub(1));
        let (mut positive, mut negative, mut folded, mut degenerate) = (0u64, 0u64, 0u64, 0u64);
        for z in 0..d[2] {
            for y in 0..d[1] {
                for x in 0..d[0] {
                    match signs(&self.corners([x, y, z])?) {
                        (true, true) => folded += 1,
                        (true, false) => positive += 1,
                        (false, true) => negative += 1,
                        (false, false) => degenerate += 1,
                    }
                }
            }
        }
        let mirrored = negative > positive;
        Ok(CellCount { folded: folded + positive.min(negative), degenerate, mirrored })
    }
}

/// Whether some determinant at a corner is positive, and whether one is negative; what rounding
/// explains is neither.
fn signs(corners: &[DVec3; 8]) -> (bool, bool) {
    let (mut positive, mut negative) = (false, false);
    for n in 0..8 {
        let t = DVec3::from_array(std::array::from_fn(|a| f64::from((n >> a & 1) as u8)));
        let j = trilinear(corners, t).jacobian;
        let size = j.x_axis.length() * j.y_axis.length() * j.z_axis.length();
        let det = j.determinant();
        positive |= det > 1e-12 * size;
        negative |= det < -1e-12 * size;
    }
    (positive, negative)
}

/// The trilinear map of a cell at `t`.
pub(super) fn trilinear(corners: &[DVec3; 8], t: DVec3) -> WorldPosition {
    let mix = |a: DVec3, b: DVec3, t: f64| a + (b - a) * t;
    let c = corners;
    let rows: [DVec3; 4] = std::array::from_fn(|i| mix(c[2 * i], c[2 * i + 1], t.x));
    let (low, high) = (mix(rows[0], rows[1], t.y), mix(rows[2], rows[3], t.y));
    let steps: [DVec3; 4] = std::array::from_fn(|i| c[2 * i + 1] - c[2 * i]);
    let along_x = mix(mix(steps[0], steps[1], t.y), mix(steps[2], steps[3], t.y), t.z);
    let along_y = mix(rows[1] - rows[0], rows[3] - rows[2], t.z);
    let jacobian = DMat3::from_cols(along_x, along_y, high - low);
    WorldPosition { position: mix(low, high, t.z).to_array(), jacobian }
}

fn axes(segment: &Segment, dims: [u64; 3]) -> Result<[Vec<f64>; 3]> {
    let mut out: [Vec<f64>; 3] = Default::default();
    for (a, axis) in out.iter_mut().enumerate() {
        let (number, mut block) = (1 + a as u64, vec![]);
        segment.block(number, &mut block)?;
        *axis = numbers(segment, number, &block, dims[a] as usize)?;
    }
    Ok(out)
}

/// The numbers of a block, finite and as many as there should be.
fn numbers(segment: &Segment, block: u64, bytes: &[u8], count: usize) -> Result<Vec<f64>> {
    let bad = |what: &'static str, expected: String, got: &str| {
        Malformed::new(what, expected, got).in_block(segment.path(), block)
    };
    if bytes.len() != 8 * count {
        return Err(bad("length", format!("{count} numbers"), "another"));
    }
    let mut out = vec![0.0; count];
    LE::read_f64_into(bytes, &mut out);
    if out.iter().all(|x| x.is_finite()) {
        Ok(out)
    } else {
        Err(bad("coordinate", "finite numbers".into(), "others"))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    const PLAN: PlanHash = PlanHash(7);

    /// A shell of radii 1 to 2: angle, height, radius.
    pub(in super::super) fn cylinder([x, y, z]: [f64; 3]) -> [f64; 3] {
        let (angle, radius) = (x * 0.1, 1.0 + z * 0.1);
        [radius * libm::cos(angle), radius * libm::sin(angle), y]
    }

    pub(in super::super) fn grid(
        dims: [u64; 3],
        place: impl Fn([f64; 3]) -> [f64; 3],
    ) -> (tempfile::TempDir, CoordinateMap) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.seg");
        let mut sample = 0u64;
        let mut next = |out: &mut [f64]| {
            for p in out.chunks_exact_mut(3) {
                let (x, y, z) = (sample % dims[0], sample / dims[0] % dims[1], sample / dims[0] / dims[1]);
                p.copy_from_slice(&place([x, y, z].map(|v| v as f64)));
                sample += 1;
            }
            Ok(())
        };
        write_coordinates(&path, PLAN, dims, Coordinates::Points(&mut next)).unwrap();
        let map = CoordinateMap::open(&path, PLAN, dims).unwrap();
        (dir, map)
    }

    #[test]
    fn curvilinear_places_are_trilinear() {
        let dims = [40, 9, 11];
        let (_dir, map) = grid(dims, cylinder);
        for p in [[0.0, 0.0, 0.0], [39.0, 8.0, 10.0], [3.0, 2.0, 10.0]] {
            assert_eq!(map.place(p).unwrap().position, cylinder(p));
        }
        let p = [12.25, 3.5, 4.75];
        let (found, exact) = (map.place(p).unwrap(), cylinder(p));
        assert!((0..3).all(|a| (found.position[a] - exact[a]).abs() < 2e-3));
        // The radius grows along z: its gradient points away from the axis.
        let n = found.direction([0.0, 0.0, 1.0]);
        let length = n.iter().map(|x| x * x).sum::<f64>().sqrt();
        let cosine = (n[0] * exact[0] + n[1] * exact[1]) / length / exact[0].hypot(exact[1]);
        assert!(cosine > 0.999, "{cosine}");
        let count = map.count_cells().unwrap();
        assert_eq!((count.folded, count.degenerate), (0, 0));
    }

    #[test]
    fn axes_are_tables() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.seg");
        let axes = [vec![0.0, 1.0, 4.0], vec![5.0, 3.0], vec![-1.0, 0.0]];
        write_coordinates(&path, PLAN, [3, 2, 2], Coordinates::Axes(axes)).unwrap();
        let map = CoordinateMap::open(&path, PLAN, [3, 2, 2]).unwrap();
        let placed = map.place([1.5, 0.25, 1.0]).unwrap();
        assert_eq!(placed.position, [2.5, 4.5, 0.0]);
        // y descends: the map mirrors, and a gradient along y turns around.
        assert_eq!(map.count_cells().unwrap(), CellCount { folded: 0, degenerate: 0, mirrored: true });
        assert!(placed.direction([0.0, 1.0, 0.0])[1] < 0.0);
        assert!(CoordinateMap::open(&path, PLAN, [3, 2, 3]).is_err());
        let bad = [vec![0.0, f64::NAN], vec![0.0, 1.0], vec![0.0, 1.0]];
        assert!(write_coordinates(&path, PLAN, [2, 2, 2], Coordinates::Axes(bad)).is_err());
    }

    #[test]
    fn folds_and_flat_cells_are_counted() {
        // One corner pulled through its cell; a layer of cells without a thickness.
        let (_dir, map) = grid([4, 4, 4], |p| match p {
            [1.0, 1.0, 1.0] => [2.5, 2.5, 1.0],
            [x, y, z] => [x, y, z.min(2.0)],
        });
        let count = map.count_cells().unwrap();
        assert_eq!((count.degenerate, count.mirrored), (9, false));
        assert!((1..=8).contains(&count.folded), "{count:?}");
    }
}
