//! isospan's index over the same cells: a kd-tree of blocks of 1024 cells, in a file
//! ([`isospan::index`]), and a look at each cell of an active block.
//!
//! A block of cubes is a brick of 8 × 8 × 16, one of tetrahedra 1024 that follow one another. In an
//! archive a block must be decoded besides, from some two bits a tetrahedron; here the cells lie
//! open in memory, as for the other methods.

use super::marching::{range_of, scan};
use super::{Cells, Method, coordinates, sample_of};
use isospan::archive::segment::PlanHash;
use isospan::index::{BuildSettings, Entry, IndexBuilder, SpanIndex};
use isospan::mesh::tet::is_active;
use isospan::{Error, Result};

const BRICK: [usize; 3] = [16, 8, 8];
const BLOCK: usize = 1024;
const PLAN: PlanHash = PlanHash(1);

/// The index, in a folder that goes with it.
pub(crate) struct Blocks {
    index: SpanIndex,
    bytes: u64,
    _folder: tempfile::TempDir,
}

/// Bricks along each axis.
fn bricks(dims: [usize; 3]) -> [usize; 3] {
    std::array::from_fn(|a| (dims[a] - 1).div_ceil(BRICK[a]))
}

/// The cubes of a brick, from to before.
fn of_brick(dims: [usize; 3], n: usize) -> [[usize; 3]; 2] {
    let at = coordinates(bricks(dims), n);
    let lo: [usize; 3] = std::array::from_fn(|a| at[a] * BRICK[a]);
    [lo, std::array::from_fn(|a| (lo[a] + BRICK[a]).min(dims[a] - 1))]
}

/// The range of a block's values, and how many cells it has.
fn summary(cells: &Cells<'_>, n: usize) -> ((f32, f32), usize) {
    match *cells {
        Cells::Cubes { dims, samples } => {
            let [lo, hi] = of_brick(dims, n);
            let rows = (lo[2]..=hi[2]).flat_map(|z| (lo[1]..=hi[1]).map(move |y| (y, z)));
            let of_row = |(y, z)| &samples[sample_of(dims, [lo[0], y, z])..=sample_of(dims, [hi[0], y, z])];
            let count = (0..3).map(|a| hi[a] - lo[a]).product();
            (range_of(rows.flat_map(of_row).copied()), count)
        }
        Cells::Tets { values, corners } => {
            let block = &corners[n * BLOCK..corners.len().min((n + 1) * BLOCK)];
            (range_of(block.iter().flatten().map(|&v| values[v as usize])), block.len())
        }
    }
}

impl Blocks {
    /// # Errors
    /// When the temporary folder cannot be written.
    pub(crate) fn new(cells: &Cells<'_>) -> Result<Self> {
        let place = std::env::temp_dir();
        let folder = tempfile::tempdir().map_err(|e| Error::io("make a temporary folder in", &place, e))?;
        let mut builder = IndexBuilder::new(&BuildSettings::default());
        let count = match *cells {
            Cells::Cubes { dims, .. } => bricks(dims).iter().product(),
            Cells::Tets { corners, .. } => corners.len().div_ceil(BLOCK),
        };
        for n in 0..count {
            let ((min, max), tets) = summary(cells, n);
            builder.push(Entry { min, max, chunk: 0, block: n as u32, tets: tets as u32 })?;
        }
        let path = folder.path().join("index");
        builder.finish(&path, PLAN)?;
        let bytes = std::fs::metadata(&path).map_err(|e| Error::io("look at", &path, e))?.len();
        Ok(Self { index: SpanIndex::open(&path, Some(PLAN))?, bytes, _folder: folder })
    }
}

impl Method for Blocks {
    fn bytes(&self) -> u64 {
        self.bytes
    }

    fn active(&mut self, cells: &Cells<'_>, isovalue: f32, found: &mut Vec<u32>) -> Result<()> {
        for entry in self.index.query(isovalue)? {
            let n = entry.block as usize;
            match *cells {
                Cells::Cubes { dims, samples } => {
                    scan(of_brick(dims, n), dims, samples, isovalue, |id, _| found.push(id));
                }
                Cells::Tets { corners, .. } => {
                    let block = n * BLOCK..corners.len().min((n + 1) * BLOCK);
                    let is_active = |&id: &usize| {
                        let (lo, hi) = cells.range(id);
                        is_active(lo, hi, isovalue)
                    };
                    found.extend(block.filter(is_active).map(|id| id as u32));
                }
            }
        }
        Ok(())
    }
}
