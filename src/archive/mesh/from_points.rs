//! Blocks of tetrahedra that are not stored, since they follow from the points of the chunk.
//!
//! A Delaunay tetrahedralization is unique, so its tetrahedra can be made again where they are
//! asked for ([`crate::mesh::stars`]). A block is a run of vertices with the tetrahedra of which
//! each is the smallest. What is stored of it is the length of its run, and how far its tetrahedra
//! reach from the run's vertices: a reader that knows that need not make those that are of no use.

use super::runs::block_starts;
use crate::archive::wire::{Cursor, Malformed, put_varint, to_zstd, unzstd};
use crate::geom::LatticePos;
use crate::mesh::tet::{Tet, canonical};
use std::ops::Range;

/// Compression of the two lists.
const LEVEL: i32 = 9;
/// The most bytes of the expanded lists.
const LARGEST: usize = 1 << 28;

/// The runs of a chunk's blocks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StarRuns {
    /// First vertex of each run, and the end of the last: the number of core points.
    starts: Vec<u32>,
    /// For each block, a bound of the distance between a vertex of the run and any vertex of a
    /// tetrahedron of which it is the smallest; in units of which the point set decides the length.
    reaches: Vec<u32>,
}

impl StarRuns {
    /// Cuts the tetrahedra of a chunk into blocks of about `block_tets`, and sorts them as
    /// [`sort_star`] does. The runs cover the `core` first vertices. Reaches are in units of `unit`
    /// lattice steps. Also returns the first tetrahedron of each block, and the number of all.
    ///
    /// # Panics
    /// When `block_tets` or `unit` is 0, or the smallest vertex of a tetrahedron is no core point.
    pub fn of(
        tets: &mut [Tet],
        positions: &[LatticePos],
        core: u32,
        block_tets: u32,
        unit: u32,
    ) -> (Self, Vec<u32>) {
        assert!(block_tets > 0 && unit > 0, "a block and a unit have a size");
        tets.iter_mut().for_each(|t| *t = canonical(*t));
        tets.sort_unstable();
        assert!(tets.last().is_none_or(|t| t[0] < core), "the smallest vertex is a core point");
        let blocks = block_starts(tets, positions, block_tets);
        let (mut starts, mut reaches) = (vec![0], vec![]);
        for block in blocks.windows(2).map(|w| w[0] as usize..w[1] as usize) {
            starts.push(tets.get(block.end).map_or(core, |next| next[0]));
            reaches.push(reach(&tets[block], positions).div_ceil(u64::from(unit)) as u32);
        }
        (Self { starts, reaches }, blocks)
    }

    /// The number of blocks.
    pub fn len(&self) -> usize {
        self.reaches.len()
    }

    /// Whether there is no block.
    pub fn is_empty(&self) -> bool {
        self.reaches.is_empty()
    }

    /// The vertices of a block's run.
    pub fn run(&self, block: usize) -> Range<u32> {
        self.starts[block]..self.starts[block + 1]
    }

    /// How far the tetrahedra of a block reach from its run's vertices at most, in units.
    pub fn reach(&self, block: usize) -> u32 {
        self.reaches[block]
    }

    /// The bytes of the lists.
    pub fn encode(&self) -> Vec<u8> {
        let mut body = vec![];
        put_varint(&mut body, self.reaches.len() as u64);
        self.starts.windows(2).for_each(|w| put_varint(&mut body, u64::from(w[1] - w[0])));
        self.reaches.iter().for_each(|&r| put_varint(&mut body, u64::from(r)));
        to_zstd(&body, LEVEL)
    }

    /// The runs of a chunk with so many core points.
    ///
    /// # Errors
    /// When the bytes are not such lists, or the runs do not cover the core points.
    pub fn decode(bytes: &[u8], core: u32) -> Result<Self, Malformed> {
        let body = unzstd(bytes, LARGEST, "runs")?;
        let mut c = Cursor::new(&body);
        let count = c.varint32("blocks")? as usize;
        // A block takes two bytes at least.
        if count > c.rest().len() / 2 {
            let expected = format!("at most {}", c.rest().len() / 2);
            return Err(Malformed::new("blocks", expected, count.to_string()));
        }
        let mut starts = Vec::with_capacity(count + 1);
        starts.push(0u32);
        let mut last = 0u64;
        for _ in 0..count {
            last += u64::from(c.varint32("vertices of a run")?);
            starts.push(u32::try_from(last).unwrap_or(u32::MAX));
        }
        if last != u64::from(core) && count > 0 {
            return Err(Malformed::new("vertices of runs", core.to_string(), last.to_string()));
        }
        let reaches = (0..count).map(|_| c.varint32("reach")).collect::<Result<_, _>>()?;
        c.end("runs")?;
        Ok(Self { starts, reaches })
    }
}

/// The tetrahedra of one smallest vertex, in the order in which a chunk has them.
pub fn sort_star(star: &mut [Tet]) {
    star.iter_mut().for_each(|t| *t = canonical(*t));
    star.sort_unstable();
}

/// The longest distance, rounded up, between the first vertex of a tetrahedron and another of it.
fn reach(tets: &[Tet], positions: &[LatticePos]) -> u64 {
    let squared =
        |a: LatticePos, b: LatticePos| -> u64 { (0..3).map(|k| u64::from(a[k].abs_diff(b[k])).pow(2)).sum() };
    let of = |t: &Tet| t[1..].iter().map(|&v| squared(positions[t[0] as usize], positions[v as usize])).max();
    let longest = tets.iter().filter_map(of).max().unwrap_or(0);
    let root = longest.isqrt();
    root + u64::from(root * root < longest)
}

#[cfg(test)]
mod tests {
    use super::super::chunk::tests::{corners, cubes, sorted};
    use super::*;

    #[test]
    fn runs_come_back() {
        let positions = corners([9, 7, 8]);
        let core = positions.len() as u32;
        for (block_tets, unit) in [(1, 1), (100, 100), (256, 7), (1_000_000, 1 << 20)] {
            let mut tets = cubes([9, 7, 8]);
            let before = sorted(&tets);
            let (runs, blocks) = StarRuns::of(&mut tets, &positions, core, block_tets, unit);
            assert_eq!((&tets, blocks[runs.len()] as usize), (&before, before.len()));
            assert_eq!(StarRuns::decode(&runs.encode(), core).unwrap(), runs);
            for (n, w) in blocks.windows(2).enumerate() {
                let (run, block) = (runs.run(n), &before[w[0] as usize..w[1] as usize]);
                assert!(block.iter().all(|t| run.contains(&t[0])));
                // The diagonal of a cube.
                let reach = (1000.0 * 3f64.sqrt()).ceil() as u32;
                assert_eq!(runs.reach(n), reach.div_ceil(unit));
            }
            assert_eq!(runs.run(runs.len() - 1).end, core);
        }
        let (none, blocks) = StarRuns::of(&mut [], &[], 0, 256, 1);
        assert!(blocks == [0] && none.is_empty());
        assert_eq!(StarRuns::decode(&none.encode(), 0).unwrap(), none);
    }

    #[test]
    fn damaged_runs_are_refused() {
        let positions = corners([5; 3]);
        let core = positions.len() as u32;
        let (runs, _) = StarRuns::of(&mut cubes([5; 3]), &positions, core, 100, 10);
        assert!(StarRuns::decode(&runs.encode(), core + 1).is_err());
        let body = unzstd(&runs.encode(), 1 << 20, "body").unwrap();
        for i in 0..body.len() {
            assert!(StarRuns::decode(&to_zstd(&body[..i], 1), core).is_err());
            for value in [0, 1, 0x7f, 0x80, 0xff] {
                let mut bad = body.clone();
                bad[i] = value;
                if let Ok(read) = StarRuns::decode(&to_zstd(&bad, 1), core) {
                    assert_eq!(read.starts.last(), Some(&core));
                }
            }
        }
    }
}
