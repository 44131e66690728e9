//! The listed points of an archive: positions for which there is no formula, in a segment of their
//! own.
//!
//! Blocks hold up to [`BLOCK_POINTS`] positions in canonical order; the last block holds the rest.
//! Each block is zstd of three columns x, y, z. Each number is the difference to the point before
//! (the first: to 0), its sign moved to the lowest bit, as a varint. The plan has the number of
//! points and the hash of all positions, so that a mesh is never decoded with other points.

use crate::archive::segment::{PlanHash, Segment, SegmentKind, SegmentWriter};
use crate::archive::wire::{Cursor, Malformed, put_varint, to_zstd, unzstd};
use isospan_io::error::{Error, Result};
use isospan_io::geom::{Lattice, LatticePos};
use isospan_mesh::points::ExplicitPoints;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Points of a block.
pub(in crate::archive) const BLOCK_POINTS: usize = 4096;
/// Bytes of a coordinate's varint, at most: a difference of 25 bits and its sign.
const LARGEST_VARINT: usize = 4;
const LEVEL: i32 = 9;

/// What a plan says of its listed points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExplicitRecord {
    /// Number of points.
    pub count: u64,
    /// XXH3 (128 bits) of the positions, x y z as u32, in order.
    pub hash: PlanHash,
    /// Within this many lattice steps of one of these there is no other point, except the corners
    /// of the domain.
    #[serde(default, skip_serializing_if = "is_none")]
    pub clear: u32,
}

fn is_none(clear: &u32) -> bool {
    *clear == 0
}

impl ExplicitRecord {
    /// The record of a list.
    pub fn of(points: &ExplicitPoints) -> Self {
        let bytes: Vec<u8> = points.positions().iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        Self { count: points.len(), hash: PlanHash::of(&bytes), clear: points.clear() }
    }
}

/// Path of the listed points' segment.
pub fn explicit_path(archive: &Path) -> PathBuf {
    archive.join("mesh/points.seg")
}

/// Writes the list.
///
/// # Errors
/// When the file cannot be written.
pub fn write_explicit(archive: &Path, plan: PlanHash, points: &ExplicitPoints) -> Result<()> {
    let mut out = SegmentWriter::create(explicit_path(archive), SegmentKind::Points, plan)?;
    for block in points.positions().chunks(BLOCK_POINTS) {
        out.push_block(&encode(block))?;
    }
    out.finish().map(|_| ())
}

/// Reads the list that a plan speaks of, in which positions may be repeated where they are those of
/// `own` vertices.
///
/// # Errors
/// [`Error::BadInput`] when it is damaged, or another; [`Error::Io`] when it is not there.
pub fn read_explicit(
    archive: &Path,
    plan: PlanHash,
    lattice: &Lattice,
    record: &ExplicitRecord,
    own: bool,
) -> Result<ExplicitPoints> {
    let path = explicit_path(archive);
    let segment = Segment::open(&path, SegmentKind::Points, Some(plan))?;
    let blocks = record.count.div_ceil(BLOCK_POINTS as u64);
    if record.count > ExplicitPoints::MOST as u64 || segment.block_count() != blocks {
        let got = format!("{} blocks", segment.block_count());
        return Err(Error::bad_input(&path, "blocks", format!("{blocks}, of {} points", record.count), got));
    }
    let (mut positions, mut buffer, domain) = (vec![], vec![], lattice.domain());
    for n in 0..blocks {
        segment.block(n, &mut buffer)?;
        let expected = (record.count - n * BLOCK_POINTS as u64).min(BLOCK_POINTS as u64) as usize;
        decode(&buffer, expected, &mut positions).map_err(|m| m.in_block(&path, n))?;
    }
    if let Some(p) = positions.iter().find(|&&p| !domain.contains(p)) {
        return Err(Error::bad_input(&path, "positions", "points of the domain", format!("{p:?}")));
    }
    let list = if own { ExplicitPoints::with_repeats } else { ExplicitPoints::new };
    let points = list(lattice, positions).clearing(record.clear);
    match ExplicitRecord::of(&points) {
        found if found == *record => Ok(points),
        found => Err(Error::bad_input(&path, "positions", record.hash.to_string(), found.hash.to_string())),
    }
}

fn encode(points: &[LatticePos]) -> Vec<u8> {
    let mut body = vec![];
    for a in 0..3 {
        let mut before = 0;
        for p in points {
            let d = i64::from(p[a]) - before;
            before = i64::from(p[a]);
            put_varint(&mut body, (d << 1 ^ d >> 63) as u64);
        }
    }
    to_zstd(&body, LEVEL)
}

fn decode(bytes: &[u8], expected: usize, out: &mut Vec<LatticePos>) -> std::result::Result<(), Malformed> {
    let body = unzstd(bytes, 3 * LARGEST_VARINT * BLOCK_POINTS, "listed points")?;
    let mut c = Cursor::new(&body);
    let first = out.len();
    out.resize(first + expected, [0; 3]);
    for a in 0..3 {
        let mut before = 0i64;
        for p in &mut out[first..] {
            let zigzag = c.varint("coordinate")?;
            let at = before.checked_add((zigzag >> 1) as i64 ^ -((zigzag & 1) as i64));
            before = at.filter(|at| (0..=i64::from(Lattice::LARGEST)).contains(at)).ok_or_else(|| {
                Malformed::new("coordinate", "0 to 2^24", format!("{zigzag:#x} from {before}"))
            })?;
            p[a] = before as u32;
        }
    }
    c.end("listed points")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(count: u32) -> (Lattice, ExplicitPoints) {
        let lattice = Lattice::new([33, 33, 17]).unwrap();
        let max = lattice.max();
        let mix = |i: u32, a: usize| i.wrapping_mul(2_654_435_761).rotate_left(9 * a as u32) % (max[a] + 1);
        let points = (0..count).map(|i| std::array::from_fn(|a| mix(i + 1, a))).collect();
        (lattice, ExplicitPoints::new(&lattice, points))
    }

    #[test]
    fn lists_come_back() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("mesh")).unwrap();
        for count in [0, 1, 4096, 4097, 10_000] {
            let (lattice, points) = list(count);
            let (plan, record) = (PlanHash(u128::from(count)), ExplicitRecord::of(&points));
            write_explicit(dir.path(), plan, &points).unwrap();
            assert_eq!(read_explicit(dir.path(), plan, &lattice, &record, false).unwrap(), points);
            let other = ExplicitRecord { hash: PlanHash(1), ..record };
            assert!(read_explicit(dir.path(), plan, &lattice, &other, false).is_err());
            let other = ExplicitRecord { count: record.count + 4096, ..record };
            assert!(read_explicit(dir.path(), plan, &lattice, &other, false).is_err());
        }
        let (lattice, points) = list(3000);
        let twice = points.positions().iter().chain(points.positions()).copied().collect();
        let twice = ExplicitPoints::with_repeats(&lattice, twice);
        let record = ExplicitRecord::of(&twice);
        write_explicit(dir.path(), PlanHash(2), &twice).unwrap();
        let read = |own| read_explicit(dir.path(), PlanHash(2), &lattice, &record, own);
        assert_eq!(read(true).unwrap(), twice);
        assert!(read(false).is_err(), "samples of a boundary have positions of their own");
    }

    #[test]
    fn damaged_blocks_never_panic() {
        let (_, points) = list(40);
        let body = unzstd(&encode(points.positions()), 1 << 20, "body").unwrap();
        for i in 0..body.len() {
            for value in [0, 1, 0x7f, 0x80, 0xff] {
                let mut bad = body.clone();
                bad[i] = value;
                let _ = decode(&to_zstd(&bad, 1), 40, &mut vec![]);
                let _ = decode(&bad[..i], 40, &mut vec![]);
            }
        }
    }
}
