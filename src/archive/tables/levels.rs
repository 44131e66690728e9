//! How dense the points of an archive are, cell by cell, in a segment of its own.
//!
//! Blocks hold up to [`BLOCK_CELLS`] levels, a byte each, x fastest; the last block holds the rest.
//! Each block is zstd. The plan has the cells' edge and the hash of all levels, so that a mesh is
//! never decoded with others.

use crate::archive::segment::{PlanHash, Segment, SegmentKind, SegmentWriter};
use crate::archive::wire::{Malformed, to_zstd, unzstd};
use isospan_io::error::{Error, Result};
use isospan_io::geom::Lattice;
use isospan_io::grid::BrickGrid;
use isospan_mesh::points::Levels;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Cells of a block.
pub(in crate::archive) const BLOCK_CELLS: usize = 1 << 16;
const LEVEL: i32 = 9;

/// What a plan says of the levels of its points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LevelsRecord {
    /// Voxel cells along each edge of a cell.
    pub edge: u64,
    /// The largest level.
    pub top: u8,
    /// XXH3 (128 bits) of the levels, a byte each, x fastest.
    pub hash: PlanHash,
}

impl LevelsRecord {
    /// The record of a map of levels.
    pub fn of(levels: &Levels) -> Self {
        let hash = PlanHash::of(levels.as_slice());
        Self { edge: levels.cells().edge[0], top: levels.top(), hash }
    }
}

/// Path of the levels' segment.
pub fn levels_path(archive: &Path) -> PathBuf {
    archive.join("mesh/levels.seg")
}

/// Writes the levels.
///
/// # Errors
/// When the file cannot be written.
pub fn write_levels(archive: &Path, plan: PlanHash, levels: &Levels) -> Result<()> {
    let mut out = SegmentWriter::create(levels_path(archive), SegmentKind::Levels, plan)?;
    for block in levels.as_slice().chunks(BLOCK_CELLS) {
        out.push_block(&to_zstd(block, LEVEL))?;
    }
    out.finish().map(|_| ())
}

/// Reads the levels that a plan speaks of.
///
/// # Errors
/// [`Error::BadInput`] when they are damaged, or others; [`Error::Io`] when they are not there.
pub fn read_levels(
    archive: &Path,
    plan: PlanHash,
    lattice: &Lattice,
    record: &LevelsRecord,
) -> Result<Levels> {
    let path = levels_path(archive);
    let bad = |at: &str, expected: String, got: String| Err(Error::bad_input(&path, at, expected, got));
    if record.edge == 0 || record.edge >= Lattice::LARGEST.into() {
        return bad("edge of the plan's cells", "1 to 2^24 voxels".into(), record.edge.to_string());
    }
    let cells = BrickGrid::new(*lattice, [record.edge; 3]);
    let count = cells.dims().iter().map(|&n| u128::from(n)).product::<u128>();
    if count > u128::from(Levels::MOST_CELLS) {
        return bad("cells", format!("at most {}", Levels::MOST_CELLS), count.to_string());
    }
    let segment = Segment::open(&path, SegmentKind::Levels, Some(plan))?;
    let blocks = (count as u64).div_ceil(BLOCK_CELLS as u64);
    if segment.block_count() != blocks {
        return bad("blocks", format!("{blocks}, of {count} cells"), segment.block_count().to_string());
    }
    let (mut levels, mut buffer) = (Vec::with_capacity(count as usize), vec![]);
    for n in 0..blocks {
        segment.block(n, &mut buffer)?;
        let expected = (count as usize - levels.len()).min(BLOCK_CELLS);
        let found = decode(&buffer, expected).map_err(|m| m.in_block(&path, n))?;
        levels.extend_from_slice(&found);
    }
    let found = match Levels::new(cells, levels) {
        Ok(levels) => levels,
        Err(e) => return bad("levels", "graded ones in range".into(), e.to_string()),
    };
    match LevelsRecord::of(&found) {
        same if same == *record => Ok(found),
        other => bad("levels", record.hash.to_string(), other.hash.to_string()),
    }
}

fn decode(bytes: &[u8], expected: usize) -> std::result::Result<Vec<u8>, Malformed> {
    let levels = unzstd(bytes, BLOCK_CELLS, "levels")?;
    if levels.len() != expected {
        return Err(Malformed::new("levels", format!("{expected} cells"), format!("{}", levels.len())));
    }
    Ok(levels)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels() -> Levels {
        let cells = BrickGrid::new(Lattice::new([200, 90, 90]).unwrap(), [2; 3]);
        let mut levels: Vec<u8> = (0..cells.len()).map(|i| (i % 12_347 == 0) as u8 * 7).collect();
        Levels::grade(&cells, &mut levels);
        Levels::new(cells, levels).unwrap()
    }

    #[test]
    fn levels_come_back() {
        let (folder, levels, plan) = (tempfile::tempdir().unwrap(), levels(), PlanHash::of(b"plan"));
        std::fs::create_dir(folder.path().join("mesh")).unwrap();
        write_levels(folder.path(), plan, &levels).unwrap();
        let (lattice, record) = (levels.cells().lattice, LevelsRecord::of(&levels));
        assert_eq!(read_levels(folder.path(), plan, &lattice, &record).unwrap(), levels);
        let refused = |lattice: &Lattice, record: LevelsRecord, word: &str| {
            let error = read_levels(folder.path(), plan, lattice, &record).unwrap_err().to_string();
            assert!(error.contains(word) && error.contains("levels.seg"), "{error}");
        };
        refused(&lattice, LevelsRecord { hash: PlanHash::of(b"other"), ..record }, "levels");
        refused(&lattice, LevelsRecord { edge: 0, ..record }, "edge");
        refused(&lattice, LevelsRecord { edge: 1, ..record }, "blocks");
        refused(&Lattice::new([5000; 3]).unwrap(), record, "at most");
    }
}
