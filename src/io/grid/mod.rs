//! Index space: boxes of samples, the affine map to the world, and the grids of bricks and chunks.
//!
//! Brick and chunk arithmetic is here; how wide a halo is follows from the plan
//! (`pipeline/plan/estimate.rs`).
//!
//! * A **brick** is a box of a fixed number of cells that enumerates its own points (about a
//!   thousand).
//! * A **chunk** is a box of bricks whose points are meshed together (about 250 000). Chunks tile
//!   the domain in layers along z, each layer in rows along y, each row in chunks along x; the cuts
//!   balance the number of points, so a set that crowds the middle (a hyperbolic cross) still gets
//!   chunks of equal work. Chunk ids run x fastest: a volume stored slice by slice is read front to
//!   back. Cuts can also be given ([`ChunkCuts`]).

mod cuts;

pub use self::cuts::ChunkCuts;
use crate::error::{Error, Result};
use crate::geom::{Lattice, LatticeBox, LatticePos};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, PoisonError};

/// A half-open box of samples (voxels): `lo <= ijk < hi`, x first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct IndexBox {
    /// Smallest sample, inside.
    pub lo: [u64; 3],
    /// Largest corner, outside.
    pub hi: [u64; 3],
}

impl IndexBox {
    /// The box of a whole volume.
    pub fn whole(dims: [u64; 3]) -> Self {
        Self { lo: [0; 3], hi: dims }
    }

    /// Samples along each axis.
    pub fn dims(&self) -> [u64; 3] {
        std::array::from_fn(|a| self.hi[a].saturating_sub(self.lo[a]))
    }

    /// Samples in the box; `None` where the product does not fit 64 bits.
    pub fn checked_len(&self) -> Option<u64> {
        let d = self.dims();
        d[0].checked_mul(d[1])?.checked_mul(d[2])
    }

    /// Samples in a box known to be small enough to hold in memory.
    ///
    /// # Panics
    /// When the count does not fit `usize`.
    pub fn len(&self) -> usize {
        self.checked_len()
            .and_then(|n| usize::try_from(n).ok())
            .expect("a box held in memory has a countable size")
    }

    /// Whether the box has no sample.
    pub fn is_empty(&self) -> bool {
        (0..3).any(|a| self.lo[a] >= self.hi[a])
    }

    /// Parts of whole slices along z, front to back, of at most so many samples; of one slice where
    /// that has more.
    pub fn slices(self, samples: usize) -> impl Iterator<Item = Self> {
        let [x, y, _] = self.dims();
        let step = (samples as u64 / (x * y).max(1)).max(1);
        let part = move |z: u64| {
            let mut part = self;
            (part.lo[2], part.hi[2]) = (z, self.hi[2].min(z + step));
            part
        };
        (self.lo[2]..self.hi[2]).step_by(step as usize).map(part)
    }

    /// Windows of at most `most` samples each, which tile the box, along z first.
    pub fn windows(self, most: u64) -> impl Iterator<Item = Self> {
        let d = self.dims();
        let x = d[0].min(most);
        let y = d[1].min(most / x).max(1);
        let z = d[2].min(most / x / y).max(1);
        let size = [x, y, z];
        let starts = move |a: usize| (self.lo[a]..self.hi[a]).step_by(size[a] as usize);
        starts(2).flat_map(move |z| {
            starts(1).flat_map(move |y| {
                starts(0).map(move |x| {
                    let lo = [x, y, z];
                    Self { lo, hi: std::array::from_fn(|a| (lo[a] + size[a]).min(self.hi[a])) }
                })
            })
        })
    }

    /// The common part of two boxes.
    #[must_use]
    pub fn intersect(&self, other: &Self) -> Self {
        Self {
            lo: std::array::from_fn(|a| self.lo[a].max(other.lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].min(other.hi[a])),
        }
    }

    /// Position of `ijk` in an x-fastest array of this box.
    #[inline]
    pub fn offset(&self, ijk: [u64; 3]) -> usize {
        let d = self.dims();
        ((((ijk[2] - self.lo[2]) * d[1]) + (ijk[1] - self.lo[1])) * d[0] + (ijk[0] - self.lo[0])) as usize
    }
}

/// The affine map from index space (voxel units) to the world:
/// `origin + direction · (spacing ∘ ijk)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// World position of sample (0, 0, 0).
    pub origin: [f64; 3],
    /// World length of a voxel edge along each index axis.
    pub spacing: [f64; 3],
    /// World direction of each index axis: `direction[a]` is the unit vector of axis a.
    pub direction: [[f64; 3]; 3],
}

impl Default for Geometry {
    fn default() -> Self {
        Self {
            origin: [0.0; 3],
            spacing: [1.0; 3],
            direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        }
    }
}

impl Geometry {
    fn matrix(&self) -> DMat3 {
        let axis = |a: usize| DVec3::from_array(self.direction[a]) * self.spacing[a];
        DMat3::from_cols(axis(0), axis(1), axis(2))
    }

    /// World vectors of a step along each index axis.
    pub fn axes(&self) -> [[f64; 3]; 3] {
        self.matrix().to_cols_array_2d()
    }

    /// The diagonal of the box of so many samples along x, y, z, in world units; axes are taken as
    /// square to each other.
    pub fn diagonal(&self, dims: [u64; 3]) -> f64 {
        let squares = (0..3).map(|a| (self.spacing[a] * dims[a].saturating_sub(1) as f64).powi(2));
        squares.sum::<f64>().sqrt()
    }

    /// World position of an index-space position.
    pub fn to_world(&self, ijk: [f64; 3]) -> [f64; 3] {
        (self.matrix() * DVec3::from_array(ijk) + DVec3::from_array(self.origin)).to_array()
    }

    /// Index-space position of a world position.
    pub fn to_index(&self, world: [f64; 3]) -> [f64; 3] {
        (self.matrix().inverse() * (DVec3::from_array(world) - DVec3::from_array(self.origin))).to_array()
    }

    /// A gradient in index space, as a covector, in the world.
    pub fn gradient_to_world(&self, g: [f64; 3]) -> [f64; 3] {
        (self.matrix().inverse().transpose() * DVec3::from_array(g)).to_array()
    }

    /// Whether the map mirrors: a right-handed triple of index axes becomes left-handed.
    pub fn mirrors(&self) -> bool {
        self.matrix().determinant() < 0.0
    }

    /// The determinant of the linear part: world volume of a voxel, signed.
    pub fn determinant(&self) -> f64 {
        self.matrix().determinant()
    }

    /// Whether the map can be inverted and has only finite numbers.
    pub fn is_valid(&self) -> bool {
        let m = self.matrix();
        m.is_finite()
            && DVec3::from_array(self.origin).is_finite()
            && m.determinant() != 0.0
            && m.inverse().is_finite()
    }
}

/// Number of a brick, x fastest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BrickId(pub u64);

/// Number of a chunk, x fastest within its row, rows within its layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct ChunkId(pub u64);

/// The domain cut into bricks of `edge` cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BrickGrid {
    /// The lattice of the domain.
    pub lattice: Lattice,
    /// Cells along each edge of a brick.
    pub edge: [u64; 3],
}

impl BrickGrid {
    /// Bricks of cells between voxels.
    pub fn new(lattice: Lattice, edge: [u64; 3]) -> Self {
        Self { lattice, edge }
    }

    /// Voxels along each edge of a brick.
    pub fn voxels(&self) -> [f64; 3] {
        self.edge.map(|n| n as f64)
    }

    /// Bricks along each axis.
    pub fn dims(&self) -> [u64; 3] {
        std::array::from_fn(|a| (self.lattice.dims[a] - 1).div_ceil(self.edge[a]))
    }

    /// Number of bricks.
    pub fn len(&self) -> u64 {
        self.dims().iter().product()
    }

    /// Never true: a lattice has at least one cell.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Brick coordinates of a brick.
    pub fn coords(&self, id: BrickId) -> [u64; 3] {
        let d = self.dims();
        [id.0 % d[0], id.0 / d[0] % d[1], id.0 / d[0] / d[1]]
    }

    /// The brick at brick coordinates.
    pub fn id(&self, c: [u64; 3]) -> BrickId {
        let d = self.dims();
        BrickId((c[2] * d[1] + c[1]) * d[0] + c[0])
    }

    /// Where the bricks of an axis begin that have this coordinate; behind the last one, past the
    /// domain.
    fn start(&self, axis: usize, brick: u64) -> u32 {
        match brick * self.edge[axis] {
            voxel if voxel >= self.lattice.dims[axis] - 1 => self.lattice.max()[axis] + 1,
            voxel => (voxel << self.lattice.log2_steps[axis]) as u32,
        }
    }

    /// The lattice box of the bricks `lo <= c < hi`. The last brick of an axis includes the
    /// domain's far face.
    pub fn lattice_box(&self, lo: [u64; 3], hi: [u64; 3]) -> LatticeBox {
        LatticeBox {
            lo: std::array::from_fn(|a| self.start(a, lo[a])),
            hi: std::array::from_fn(|a| self.start(a, hi[a])),
        }
    }

    /// Brick coordinates of the brick that holds a lattice position.
    pub fn brick_at(&self, pos: LatticePos) -> [u64; 3] {
        let (d, s) = (self.dims(), self.lattice.log2_steps);
        std::array::from_fn(|a| (u64::from(pos[a] >> s[a]) / self.edge[a]).min(d[a] - 1))
    }

    /// The lattice box of one brick.
    pub fn brick(&self, id: BrickId) -> LatticeBox {
        let c = self.coords(id);
        self.lattice_box(c, c.map(|x| x + 1))
    }
}

/// One chunk of the domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Its number.
    pub id: ChunkId,
    /// First brick, in brick coordinates.
    pub brick_lo: [u64; 3],
    /// Past the last brick.
    pub brick_hi: [u64; 3],
    /// The lattice positions that the chunk owns.
    pub core: LatticeBox,
}

impl Chunk {
    /// Number of its bricks.
    pub fn brick_count(&self) -> u64 {
        (0..3).map(|a| self.brick_hi[a] - self.brick_lo[a]).product()
    }

    /// The chunk's bricks, x fastest.
    pub fn bricks(&self, grid: &BrickGrid) -> impl Iterator<Item = BrickId> + use<> {
        let (grid, lo, hi) = (*grid, self.brick_lo, self.brick_hi);
        (lo[2]..hi[2]).flat_map(move |z| {
            (lo[1]..hi[1]).flat_map(move |y| (lo[0]..hi[0]).map(move |x| grid.id([x, y, z])))
        })
    }
}

/// Counts the points of a box, exactly or nearly, but always the same.
type Counter = Box<dyn Fn(&LatticeBox) -> u64 + Send + Sync>;

/// Where the cuts along x come from.
enum XCuts {
    /// Points are counted.
    Counted {
        count: Counter,
        /// Cuts of the row asked for last: chunks are asked for in order, and a row may have a
        /// million bricks.
        last: Mutex<Option<(usize, Arc<Vec<u64>>)>>,
    },
    /// The cuts of each row are given.
    Given(Vec<Arc<Vec<u64>>>),
}

/// The domain cut into chunks. Memory: a few bytes for each row of chunks; where cuts are given,
/// for each chunk.
pub struct ChunkGrid {
    bricks: BrickGrid,
    /// Cuts along z, in bricks.
    z_cuts: Vec<u64>,
    /// Cuts along y of each layer.
    y_cuts: Vec<Vec<u64>>,
    x_cuts: XCuts,
    /// First chunk, layer and row in its layer of each row, in chunk order.
    rows: Vec<(u64, usize, usize)>,
    len: u64,
}

impl ChunkGrid {
    /// Cuts the bricks into chunks of about `target` points. Cost: one call of `count` for each
    /// brick layer, and for each row of bricks in a layer of chunks.
    ///
    /// # Errors
    /// [`Error::Usage`] for a target of 0, and for more bricks or rows of bricks than can be
    /// counted in a reasonable time.
    pub fn new(
        bricks: BrickGrid,
        target: u64,
        count: impl Fn(&LatticeBox) -> u64 + Send + Sync + 'static,
    ) -> Result<Self> {
        if target == 0 {
            return Err(Error::usage("a chunk must hold at least one point"));
        }
        check_size(bricks.dims())?;
        let count: Counter = Box::new(count);
        let d = bricks.dims();
        let cells = bricks.lattice.extent();
        let by_z = counts(&bricks, &count, 2, [0; 3], d);
        let wanted = by_z.iter().sum::<u64>().div_ceil(target).max(1) as f64;
        // Cubic chunks: the edge, in voxels of the axis with the fewest lattice steps, that cuts
        // the box into `wanted` cubes.
        let edge = libm::cbrt(cells[0] * cells[1] * cells[2] / wanted);
        // A long thin box is cut into fewer, longer pieces: never more layers than chunks, nor more
        // rows.
        let most = |bricks: u64, wanted: f64| bricks.min(wanted as u64).max(1);
        let z_cuts = balanced_cuts(&by_z, ((cells[2] / edge).round() as u64).clamp(1, most(d[2], wanted)));
        check_rows(z_cuts.len() as u64 - 1, d[1])?;
        let (mut y_cuts, mut rows, mut len) = (vec![], vec![], 0);
        for (layer, z) in z_cuts.windows(2).enumerate() {
            let by_y = counts(&bricks, &count, 1, [0, 0, z[0]], [d[0], d[1], z[1]]);
            let wanted = by_y.iter().sum::<u64>().div_ceil(target).max(1) as f64;
            let in_layer = (wanted * cells[1] / cells[0]).sqrt().round() as u64;
            let cuts = balanced_cuts(&by_y, in_layer.clamp(1, most(d[1], wanted)));
            for (row, y) in cuts.windows(2).enumerate() {
                rows.push((len, layer, row));
                let points = count(&bricks.lattice_box([0, y[0], z[0]], [d[0], y[1], z[1]]));
                len += points.div_ceil(target).clamp(1, d[0]);
            }
            y_cuts.push(cuts);
        }
        let x_cuts = XCuts::Counted { count, last: Mutex::default() };
        Ok(Self { bricks, z_cuts, y_cuts, x_cuts, rows, len })
    }

    /// The cuts along x of a row, by its place in the order of rows.
    fn row_cuts(&self, at: usize) -> Arc<Vec<u64>> {
        let (count, last) = match &self.x_cuts {
            XCuts::Given(rows) => return Arc::clone(&rows[at]),
            XCuts::Counted { count, last } => (count, last),
        };
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        let cuts = match &*last {
            Some((row, cuts)) if *row == at => Arc::clone(cuts),
            _ => {
                let (lo, hi) = self.row(at);
                let in_row = self.rows.get(at + 1).map_or(self.len, |r| r.0) - self.rows[at].0;
                Arc::new(balanced_cuts(&counts(&self.bricks, count, 0, lo, hi), in_row))
            }
        };
        *last = Some((at, Arc::clone(&cuts)));
        cuts
    }

    /// The bricks of a row: first and past the last.
    fn row(&self, at: usize) -> ([u64; 3], [u64; 3]) {
        let (_, layer, row) = self.rows[at];
        let (ys, zs) = (&self.y_cuts[layer], &self.z_cuts);
        ([0, ys[row], zs[layer]], [self.bricks.dims()[0], ys[row + 1], zs[layer + 1]])
    }

    /// Number of chunks.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Never true: there is always at least one chunk.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The bricks that are cut.
    pub fn bricks(&self) -> &BrickGrid {
        &self.bricks
    }

    /// A chunk by its number. Cost: one call of the counter for each brick along x, in the first
    /// chunk of a row asked for.
    ///
    /// # Panics
    /// When `id` is not below [`ChunkGrid::len`].
    pub fn chunk(&self, id: ChunkId) -> Chunk {
        assert!(id.0 < self.len, "chunk {} of {}", id.0, self.len);
        let at = self.rows.partition_point(|r| r.0 <= id.0) - 1;
        let (first, cuts) = (self.rows[at].0, self.row_cuts(at));
        let (mut lo, mut hi) = self.row(at);
        let x = (id.0 - first) as usize;
        (lo[0], hi[0]) = (cuts[x], cuts[x + 1]);
        Chunk { id, brick_lo: lo, brick_hi: hi, core: self.bricks.lattice_box(lo, hi) }
    }

    /// All chunks in order.
    pub fn iter(&self) -> impl Iterator<Item = Chunk> + '_ {
        (0..self.len).map(|i| self.chunk(ChunkId(i)))
    }
}

/// Points in each slice of one brick, across `axis`, of a box of bricks.
fn counts(bricks: &BrickGrid, count: &Counter, axis: usize, lo: [u64; 3], hi: [u64; 3]) -> Vec<u64> {
    let slice = |i: u64| {
        let (mut l, mut h) = (lo, hi);
        (l[axis], h[axis]) = (i, i + 1);
        count(&bricks.lattice_box(l, h))
    };
    (lo[axis]..hi[axis]).map(slice).collect()
}

/// The most bricks of a grid: their numbers fit 64 bits with room to spare.
const MOST_BRICKS: u128 = 1 << 60;
/// The most rows of bricks that are counted for all layers of chunks together. A petabyte at the
/// usual brick size has a few million; more come from parameters that no reduction has.
const MOST_ROWS: u64 = 1 << 23;

fn check_size(d: [u64; 3]) -> Result<()> {
    if d.iter().map(|&n| u128::from(n)).product::<u128>() > MOST_BRICKS {
        return Err(Error::usage(format!("{} x {} x {} bricks are more than 2^60", d[0], d[1], d[2])));
    }
    match d.into_iter().max() {
        Some(longest) if longest > MOST_ROWS => {
            Err(Error::usage(format!("{longest} bricks along an axis are too many: choose fewer points")))
        }
        _ => Ok(()),
    }
}

fn check_rows(layers: u64, rows: u64) -> Result<()> {
    if layers.saturating_mul(rows) > MOST_ROWS {
        return Err(Error::usage(format!(
            "{layers} layers of chunks with {rows} rows of bricks are too many: make chunks larger or points fewer"
        )));
    }
    Ok(())
}

/// Cuts `counts` into `parts` runs of about equal sum, none empty of bricks;
/// `parts <= counts.len()`.
fn balanced_cuts(counts: &[u64], parts: u64) -> Vec<u64> {
    let (n, parts) = (counts.len() as u64, parts.clamp(1, counts.len() as u64));
    let total: u128 = counts.iter().map(|&c| u128::from(c)).sum();
    let mut cuts = vec![0];
    let (mut sum, mut i) = (0u128, 0u64);
    for part in 1..parts {
        let goal = total * u128::from(part) / u128::from(parts);
        let last_allowed = n - (parts - part);
        let first = cuts[cuts.len() - 1] + 1;
        // Take bricks while that brings the sum nearer to the goal.
        while i < last_allowed && (i < first || sum + u128::from(counts[i as usize]) / 2 < goal) {
            sum += u128::from(counts[i as usize]);
            i += 1;
        }
        cuts.push(i);
    }
    cuts.push(n);
    cuts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tiles(grid: &ChunkGrid) {
        let d = grid.bricks().dims();
        let mut seen = vec![0u8; grid.bricks().len() as usize];
        for c in grid.iter() {
            assert!(!c.core.is_empty());
            for b in c.bricks(grid.bricks()) {
                seen[b.0 as usize] += 1;
            }
        }
        assert!(seen.iter().all(|&s| s == 1), "chunks tile the {d:?} bricks");
    }

    #[test]
    fn windows_tile_a_box() {
        const MOST: u64 = 1 << 20;
        for hi in [[10, 20, 30], [5_000_000, 3, 2], [3000, 3000, 3], [1, 1, 1 << 23]] {
            let whole = IndexBox { lo: [1, 0, 0], hi };
            let whole = IndexBox { hi: [whole.hi[0].max(2), whole.hi[1], whole.hi[2]], ..whole };
            let all: Vec<IndexBox> = whole.windows(MOST).collect();
            assert!(all.iter().all(|w| w.checked_len().unwrap() <= MOST && !w.is_empty()));
            let sum: u64 = all.iter().map(|w| w.checked_len().unwrap()).sum();
            assert_eq!(Some(sum), whole.checked_len(), "{hi:?}");
        }
    }

    #[test]
    fn chunks_tile_the_domain_whatever_the_density() {
        let lattice = Lattice::new([103, 94, 161]).unwrap();
        for edge in [[4, 4, 4], [16, 8, 5], [200, 200, 200], [1, 90, 7]] {
            let bricks = BrickGrid::new(lattice, edge);
            for target in [1, 1000, 20_000, 250_000, u64::MAX] {
                let uniform = move |b: &LatticeBox| (b.volume() >> (3 * lattice.log2_steps[0])) as u64 / 8;
                tiles(
                    &ChunkGrid::new(bricks, target.max(if edge[0] < 5 { 500 } else { 1 }), uniform).unwrap(),
                );
                let crowded = |b: &LatticeBox| u64::from(b.contains([1 << 22, 1 << 22, 1 << 22])) * 100_000;
                tiles(&ChunkGrid::new(bricks, target.max(500), crowded).unwrap());
            }
        }
    }

    #[test]
    fn uniform_chunks_are_near_the_target() {
        let lattice = Lattice::new([512, 512, 512]).unwrap();
        let grid = ChunkGrid::new(BrickGrid::new(lattice, [16; 3]), 250_000, move |b| {
            (b.volume() >> (3 * lattice.log2_steps[0])) as u64 / 8
        })
        .unwrap();
        for c in grid.iter() {
            let points = (c.core.volume() >> (3 * lattice.log2_steps[0])) as u64 / 8;
            assert!((125_000..500_000).contains(&points), "{points}");
        }
    }

    #[test]
    fn long_thin_boxes_are_not_cut_to_shreds() {
        for axis in 0..3 {
            let mut dims = [2; 3];
            dims[axis] = 1_048_577;
            let lattice = Lattice::new(dims).unwrap();
            let uniform = move |b: &LatticeBox| (b.volume() >> (3 * lattice.log2_steps[0])) as u64;
            let grid = ChunkGrid::new(BrickGrid::new(lattice, [64; 3]), 50_000, uniform).unwrap();
            assert!(
                (15..=30).contains(&grid.len()),
                "axis {axis}: {} chunks of a million points",
                grid.len()
            );
            tiles(&grid);
        }
    }

    #[test]
    fn slices_make_a_box() {
        for (dims, samples) in
            [([3, 2, 50], 60), ([30, 11, 7], 330), ([30, 11, 7], 329), ([4, 4, 5], 1 << 20)]
        {
            let lo = [5u64, 6, 7];
            let b = IndexBox { lo, hi: std::array::from_fn(|a| lo[a] + dims[a]) };
            let parts: Vec<IndexBox> = b.slices(samples).collect();
            let ends = parts.iter().flat_map(|p| [p.lo[2], p.hi[2]]);
            assert!(
                ends.clone().skip(1).step_by(2).take(parts.len() - 1).eq(ends.clone().skip(2).step_by(2))
            );
            assert_eq!((ends.clone().next(), ends.last()), (Some(b.lo[2]), Some(b.hi[2])));
            let slice = (dims[0] * dims[1]) as usize;
            assert!(parts.iter().all(|p| p.len() <= samples.max(slice) && !p.is_empty()));
            assert_eq!(parts.len() as u64, dims[2].div_ceil((samples / slice).max(1) as u64));
        }
        assert_eq!(IndexBox { lo: [3; 3], hi: [5, 5, 3] }.slices(9).count(), 0);
    }

    #[test]
    fn world_and_back() {
        let g = Geometry {
            origin: [1.0, -2.0, 3.0],
            spacing: [0.5, 2.0, 3.0],
            direction: [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        };
        assert!(g.mirrors() && g.is_valid());
        assert_eq!(g.to_world([2.0, 1.0, 1.0]), [3.0, -1.0, 6.0]);
        assert_eq!(g.to_index([3.0, -1.0, 6.0]), [2.0, 1.0, 1.0]);
    }
}
