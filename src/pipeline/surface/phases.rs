//! The nodes of a level of a pyramid above and below an isovalue, and the volumes of both, found
//! box by box.
//!
//! Boxes whose bricks are all on one side are not decoded. Volumes are those of marching cubes: the
//! share of each cell is summed as an integer, so the order of boxes changes no bit.

use super::settings::SurfaceSettings;
use crate::archive::tables::CoordinateMap;
use crate::phase::{PhaseMap, PhaseSlab};
use crate::pipeline::read::{Brick, StepView, bounds, bricks_of, chunk_place, world_map};
use crate::surface::WorldMap;
use crate::surface::extract::share_inside;
use isospan_io::error::Result;
use isospan_io::exec::{Progress, Threads, in_order};
use isospan_io::geom::vec3::{cross, dot, minus};
use isospan_io::grid::{ChunkId, IndexBox};
use std::collections::BTreeSet;
use std::path::Path;

/// Cells along each axis of a box, at most: whole words of bits along x, whole bricks.
const PART: [u64; 3] = [128, 128, 32];
/// Parts of a cell of mean size in which volumes are summed.
const UNIT: f64 = (1u64 << 40) as f64;

/// What was found of the cells of a grid.
pub(super) struct Phases {
    pub(super) map: PhaseMap,
    /// Volume in the world above the isovalue, and of all cells that are not void.
    pub(super) above: f64,
    pub(super) all: f64,
}

/// Volumes in units.
#[derive(Clone, Copy, Default)]
struct Volumes {
    above: i128,
    all: i128,
}

/// The shapes of cells.
enum Shapes {
    /// All have this volume.
    Even(f64),
    /// Cells between planes have these widths; a mean volume.
    Axes([Vec<f64>; 3], f64),
    /// Nodes anywhere; a mean volume.
    Placed(Box<CoordinateMap>, f64),
}

/// A level of a pyramid at an isovalue.
struct Level<'a> {
    archive: &'a StepView,
    level: usize,
    isovalue: f32,
    /// Nodes along each axis, and samples of the source from one to the next.
    nodes: [u64; 3],
    stride: [u64; 3],
    shapes: Shapes,
    world: WorldMap,
    has_holes: bool,
    /// The boxes that may have values on both sides; all if not known.
    mixed: Option<BTreeSet<[u64; 3]>>,
}

/// Finds the phases of a level whose cells have a volume.
pub(super) fn phases(
    archive: &StepView,
    level: usize,
    isovalue: f32,
    settings: &SurfaceSettings,
    means: (&Threads, &Path),
    progress: &dyn Progress,
) -> Result<Phases> {
    let of = Level::new(archive, level, isovalue, settings)?;
    let (threads, scratch) = means;
    let held = usize::try_from(settings.resources.memory / 4).unwrap_or(usize::MAX);
    let mut map = PhaseMap::new(of.nodes.map(|n| n as usize), of.has_holes, held, scratch);
    let counts: [u64; 3] = std::array::from_fn(|a| (of.nodes[a] - 1).div_ceil(PART[a]));
    let mut sums = Volumes::default();
    progress.begin("phases", counts.iter().product(), "parts");
    for z in 0..counts[2] {
        let cells: Vec<_> = (0..counts[0] * counts[1])
            .map(|i| {
                let at = [i % counts[0], i / counts[0], z];
                std::array::from_fn(|a| [at[a] * PART[a], ((at[a] + 1) * PART[a]).min(of.nodes[a] - 1)])
            })
            .collect();
        let [first, last] = of.owned(&cells[0])[2];
        let mut slab = map.slab((last - first) as usize);
        let bytes = vec![16 * PART.map(|n| n + 14).iter().product::<u64>(); cells.len()];
        let make = |n: usize| {
            settings.resources.cancel.check()?;
            of.part(&cells[n])
        };
        in_order(&bytes, settings.resources.memory / 4, threads, make, |n, (part, volumes)| {
            slab.put(&part, [cells[n][0][0] as usize, cells[n][1][0] as usize, 0]);
            sums = Volumes { above: sums.above + volumes.above, all: sums.all + volumes.all };
            progress.advance(1);
            Ok(())
        })?;
        map.push(&slab)?;
    }
    let [above, all] = [sums.above, sums.all].map(|v| v as f64 / UNIT * of.shapes.mean());
    Ok(Phases { map, above, all })
}

impl<'a> Level<'a> {
    fn new(archive: &'a StepView, level: usize, isovalue: f32, settings: &SurfaceSettings) -> Result<Self> {
        let pyramid = &archive.pyramid()?.pyramid;
        let [nodes, stride] = [pyramid.nodes(level), pyramid.stride(level)].map(|n| n.map(|n| n as u64));
        // The step behind a moment between two may have holes of its own.
        let has_holes = archive.step().void_points > 0 || archive.is_between();
        let mixed = (level <= pyramid.details() && !has_holes).then(|| -> Result<_> {
            let mut found = BTreeSet::new();
            for entry in archive.ranges()?.query_any(&[isovalue])? {
                let chunk = ChunkId(entry.chunk);
                archive.expect_chunk(chunk)?;
                let bricks = bricks_of(pyramid, chunk_place(pyramid, chunk));
                archive.expect_block(chunk, entry.block, bricks.len())?;
                let Brick { level: of_level, cells } = &bricks[entry.block as usize];
                if *of_level == level {
                    found.insert(std::array::from_fn(|a| cells[a].start as u64 / PART[a]));
                }
            }
            Ok(found)
        });
        Ok(Self {
            archive,
            level,
            isovalue,
            nodes,
            stride,
            shapes: Shapes::of(archive, nodes, stride, settings)?,
            world: world_map(archive),
            has_holes,
            mixed: mixed.transpose()?,
        })
    }

    /// The nodes that a box has alone: those at the lower ends of its cells, and the last ones.
    fn owned(&self, cells: &[[u64; 2]; 3]) -> [[u64; 2]; 3] {
        std::array::from_fn(|a| {
            let [lo, hi] = cells[a];
            [lo, if hi + 1 == self.nodes[a] { hi + 1 } else { hi }]
        })
    }

    /// The phases of a box, and the volumes of its cells.
    fn part(&self, cells: &[[u64; 2]; 3]) -> Result<(PhaseSlab, Volumes)> {
        let key = std::array::from_fn(|a| cells[a][0] / PART[a]);
        let is_mixed = self.mixed.as_ref().is_none_or(|mixed| mixed.contains(&key));
        let lo = cells.map(|c| c[0]);
        let window = IndexBox {
            lo,
            hi: std::array::from_fn(|a| if is_mixed { cells[a][1] + 1 } else { cells[a][0] + 1 }),
        };
        let mut values = self.archive.nodes(self.level, &window)?;
        if !is_mixed {
            let count: u64 = cells.iter().map(|[lo, hi]| hi + 1 - lo).product();
            values.resize(count as usize, values[0]);
        }
        let size = cells.map(|[lo, hi]| (hi + 1 - lo) as usize);
        let owned = self.owned(cells).map(|[lo, hi]| (hi - lo) as usize);
        let mut slab = PhaseSlab::new(owned, self.has_holes);
        for z in 0..owned[2] {
            for y in 0..owned[1] {
                let row = &values[(z * size[1] + y) * size[0]..][..owned[0]];
                slab.note([0, y, z], row, self.isovalue);
            }
        }
        let volumes = self.volumes(&values, size, lo)?;
        self.archive.spare.give_nodes(values);
        Ok((slab, volumes))
    }

    /// The volumes of all cells between nodes of a box, the first of which is at `lo`.
    fn volumes(&self, values: &[f32], [nx, ny, nz]: [usize; 3], lo: [u64; 3]) -> Result<Volumes> {
        let sizes = self.shapes.sizes([nx, ny, nz], lo, self.stride)?;
        let (mut sums, mut corners) = (Volumes::default(), vec![0u8; nx]);
        for z in 0..nz - 1 {
            for y in 0..ny - 1 {
                let first = (z * ny + y) * nx;
                self.look(values, first, [nx, nx * ny], &mut corners);
                for (x, pair) in corners.windows(2).enumerate() {
                    // Bits 0 to 3 say which are inside, bit 4 that one is void.
                    let void = (pair[0] | pair[1]) & 16 != 0;
                    if void {
                        continue;
                    }
                    let size = sizes.as_ref().map_or(1.0, |sizes| sizes[(z * (ny - 1) + y) * (nx - 1) + x]);
                    let whole = (size * UNIT).round() as i128;
                    sums.all += whole;
                    sums.above += match (pair[0] & 15, pair[1] & 15) {
                        (0, 0) => 0,
                        (15, 15) => whole,
                        _ => (self.share(values, first + x, [nx, nx * ny]) * size * UNIT).round() as i128,
                    };
                }
            }
        }
        Ok(sums)
    }

    /// Which nodes of four rows are inside, and where one is void.
    fn look(&self, values: &[f32], first: usize, [row, plane]: [usize; 2], corners: &mut [u8]) {
        corners.fill(0);
        for (n, at) in [first, first + row, first + plane, first + plane + row].into_iter().enumerate() {
            for (corner, v) in corners.iter_mut().zip(&values[at..]) {
                *corner |= u8::from(*v >= self.isovalue) << n | u8::from(v.is_nan()) << 4;
            }
        }
    }

    /// The share inside of the cell with a first node.
    fn share(&self, values: &[f32], first: usize, [row, plane]: [usize; 2]) -> f64 {
        let at = |c: usize| first + (c & 1) + (c >> 1 & 1) * row + (c >> 2) * plane;
        let values = std::array::from_fn(|c| f64::from(values[at(c)]) - f64::from(self.isovalue));
        share_inside(&values, &self.world)
    }
}

impl Shapes {
    fn of(archive: &StepView, nodes: [u64; 3], stride: [u64; 3], settings: &SurfaceSettings) -> Result<Self> {
        let Some(map) = archive.coordinates()? else {
            let axes = archive.step().plan.source.geometry.axes();
            let [x, y, z] = std::array::from_fn(|a| axes[a].map(|k| k * stride[a] as f64));
            return Ok(Self::Even(dot(x, cross(y, z)).abs()));
        };
        let [lo, hi] = bounds(archive, &settings.resources.cancel)?;
        let cells: f64 = nodes.iter().map(|n| (n - 1) as f64).product();
        let mean = (0..3).map(|k| hi[k] - lo[k]).product::<f64>() / cells;
        Ok(match map.axes() {
            Some(axes) => Self::Axes(std::array::from_fn(|a| widths(&axes[a], nodes[a], stride[a])), mean),
            None => Self::Placed(Box::new(map), mean),
        })
    }

    /// The volume that counts as one.
    fn mean(&self) -> f64 {
        match self {
            Self::Even(mean) | Self::Axes(_, mean) | Self::Placed(_, mean) => *mean,
        }
    }

    /// The volumes of cells of a box by the mean one; none where all have it.
    fn sizes(&self, [nx, ny, nz]: [usize; 3], lo: [u64; 3], stride: [u64; 3]) -> Result<Option<Vec<f64>>> {
        let cells = || {
            let count = (nx - 1) * (ny - 1) * (nz - 1);
            (0..count).map(|n| [n % (nx - 1), n / (nx - 1) % (ny - 1), n / (nx - 1) / (ny - 1)])
        };
        match self {
            Self::Even(_) => Ok(None),
            Self::Axes(widths, mean) => {
                let width = |at: [usize; 3], a: usize| widths[a][lo[a] as usize + at[a]];
                Ok(Some(cells().map(|at| width(at, 0) * width(at, 1) * width(at, 2) / mean).collect()))
            }
            Self::Placed(map, mean) => {
                let node = |n: usize| {
                    let at = [n % nx, n / nx % ny, n / nx / ny];
                    map.sample(std::array::from_fn(|a| (lo[a] + at[a] as u64) * stride[a]))
                };
                let places: Vec<[f64; 3]> = (0..nx * ny * nz).map(node).collect::<Result<_>>()?;
                let steps = [1, nx, nx * ny];
                let size = |[x, y, z]: [usize; 3]| mean_volume(&places, (z * ny + y) * nx + x, steps) / mean;
                Ok(Some(cells().map(size).collect()))
            }
        }
    }
}

/// The widths of cells between places along an axis.
fn widths(places: &[f64], nodes: u64, stride: u64) -> Vec<f64> {
    let at = |n: u64| places[(n * stride) as usize];
    (0..nodes - 1).map(|n| (at(n + 1) - at(n)).abs()).collect()
}

/// The volume of the parallelepiped of a cell's mean edges.
fn mean_volume(places: &[[f64; 3]], first: usize, steps: [usize; 3]) -> f64 {
    let edge = |a: usize| {
        let (b, c) = (steps[(a + 1) % 3], steps[(a + 2) % 3]);
        let along =
            [first, first + b, first + c, first + b + c].map(|at| minus(places[at + steps[a]], places[at]));
        std::array::from_fn(|k| along.iter().map(|edge| edge[k] / 4.0).sum())
    };
    let [x, y, z]: [[f64; 3]; 3] = [edge(0), edge(1), edge(2)];
    dot(x, cross(y, z)).abs()
}
