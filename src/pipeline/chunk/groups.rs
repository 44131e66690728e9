//! Groups the vertices of a chunk that are sampled together, from the samples of one box. The
//! groups are the same at all steps.
//!
//! ```text
//!        ┌──────┬──────┬──────┐        bricks of a chunk that lie side by side along x: a row of them,
//!    . . │ .  . │. .   │   .  │ .      whose points follow each other;
//!      . │  .  .│    . │ .  . │. .     and the halo vertices near it
//!        └──────┴──────┴──────┘
//! ```
//!
//! Long rows of samples are read faster than short ones, and a halo vertex by itself would need a
//! box of its own.

use crate::pipeline::read::MeshedChunk;
use isospan_io::geom::LatticePos;
use isospan_io::grid::BrickGrid;
use std::ops::Range;

/// Samples of a row of bricks, at most, where it has more than one: they stay in the processor's
/// second cache.
const MOST_SAMPLES: u64 = 1 << 16;

/// The vertices of a chunk, those around last, in groups.
#[derive(Clone, Debug, Default)]
pub(super) struct Groups {
    /// For each group, the vertices of the core, and the end of its part of `others`.
    groups: Vec<(Range<usize>, usize)>,
    others: Vec<u32>,
}

/// A row of bricks, in brick coordinates.
struct Row {
    lo: [u64; 3],
    hi: [u64; 3],
    core: Range<usize>,
}

impl Groups {
    /// Groups the vertices of a chunk.
    pub(super) fn of(bricks: &BrickGrid, mesh: &MeshedChunk) -> Self {
        let rows = rows(bricks, mesh);
        let near = Near::new(bricks, &rows);
        let listed: usize = mesh.core_counts.iter().map(|&n| n as usize).sum();
        let outside = mesh.all_positions.iter().enumerate().skip(listed);
        let mut sorted: Vec<(u64, u32)> = outside.map(|(v, &pos)| (near.group(pos), v as u32)).collect();
        sorted.sort_unstable();
        let mut end = 0;
        let mut groups: Vec<(Range<usize>, usize)> = rows
            .into_iter()
            .zip(0..)
            .map(|(row, group)| {
                end += sorted[end..].iter().take_while(|&&(of, _)| of == group).count();
                (row.core, end)
            })
            .collect();
        // Those far from the chunk, by their bricks.
        for far in sorted[end..].chunk_by(|a, b| a.0 == b.0) {
            end += far.len();
            groups.push((0..0, end));
        }
        Self { groups, others: sorted.into_iter().map(|(_, v)| v).collect() }
    }

    /// For each group, the vertices listed by bricks, and the others.
    pub(super) fn iter(&self) -> impl Iterator<Item = (Range<usize>, &[u32])> {
        let mut start = 0;
        self.groups
            .iter()
            .map(move |(core, end)| (core.clone(), &self.others[std::mem::replace(&mut start, *end)..*end]))
    }
}

/// The bricks of a chunk that have vertices, in rows.
fn rows(bricks: &BrickGrid, mesh: &MeshedChunk) -> Vec<Row> {
    let mut rows: Vec<Row> = vec![];
    let mut start = 0;
    for &count in &mesh.core_counts {
        let core = start..start + count as usize;
        start = core.end;
        if core.is_empty() {
            continue;
        }
        let lo = bricks.brick_at(mesh.all_positions[core.start]);
        let hi = lo.map(|c| c + 1);
        match rows.last_mut() {
            Some(row) if row.lo[1..] == lo[1..] && row.hi[0] <= lo[0] && fits(bricks, row, hi[0]) => {
                (row.hi[0], row.core.end) = (hi[0], core.end);
            }
            _ => rows.push(Row { lo, hi, core }),
        }
    }
    rows
}

/// Whether the samples of a row that ends at brick `end` are few.
fn fits(bricks: &BrickGrid, row: &Row, end: u64) -> bool {
    let [x, y, z] = bricks.voxels().map(|edge| edge + 2.0);
    (end - row.lo[0]) as f64 * x * y * z <= MOST_SAMPLES as f64
}

/// The rows of bricks by place.
struct Near<'a> {
    bricks: &'a BrickGrid,
    rows: &'a [Row],
    /// The bricks of all rows.
    lo: [u64; 3],
    hi: [u64; 3],
    /// The row of each of these bricks.
    of: Vec<Option<u32>>,
}

impl<'a> Near<'a> {
    fn new(bricks: &'a BrickGrid, rows: &'a [Row]) -> Self {
        let fold = |first: u64, pick: fn(u64, u64) -> u64, of: fn(&Row, usize) -> u64| -> [u64; 3] {
            std::array::from_fn(|a| rows.iter().fold(first, |all, row| pick(all, of(row, a))))
        };
        let (lo, hi) = (fold(u64::MAX, u64::min, |row, a| row.lo[a]), fold(0, u64::max, |row, a| row.hi[a]));
        let mut near = Self { bricks, rows, lo, hi, of: vec![] };
        if !rows.is_empty() {
            near.of = vec![None; (0..3).map(|a| (hi[a] - lo[a]) as usize).product()];
            for (row, n) in rows.iter().zip(0..) {
                for x in row.lo[0]..row.hi[0] {
                    let at = near.at([x, row.lo[1], row.lo[2]]);
                    near.of[at] = Some(n);
                }
            }
        }
        near
    }

    fn at(&self, brick: [u64; 3]) -> usize {
        let [x, y, z] = std::array::from_fn(|a| (brick[a] - self.lo[a]) as usize);
        let [dx, dy] = std::array::from_fn(|a| (self.hi[a] - self.lo[a]) as usize);
        (z * dy + y) * dx + x
    }

    /// The row that a position is sampled with. A position farther away than half a brick gets a
    /// number of its brick, which is larger.
    fn group(&self, pos: LatticePos) -> u64 {
        let brick = self.bricks.brick_at(pos);
        let alone = self.rows.len() as u64 + self.bricks.id(brick).0;
        if self.of.is_empty() {
            return alone;
        }
        let nearest = std::array::from_fn(|a| brick[a].clamp(self.lo[a], self.hi[a] - 1));
        let Some(group) = self.of[self.at(nearest)] else { return alone };
        let row = &self.rows[group as usize];
        let (core, first) =
            (self.bricks.lattice_box(row.lo, row.hi), self.bricks.lattice_box([0; 3], [1; 3]));
        let is_near = (0..3).all(|a| {
            let half = first.hi[a] / 2;
            pos[a] + half >= core.lo[a] && pos[a] < core.hi[a] + half
        });
        if is_near { group.into() } else { alone }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan_io::geom::{Lattice, PointId};
    use isospan_mesh::mesh::list::TetList;

    #[test]
    fn each_vertex_is_in_one_group() {
        let bricks = BrickGrid::new(Lattice { dims: [101; 3], log2_steps: [4; 3] }, [10; 3]);
        // Three bricks along x, the middle one empty, and one above the first.
        let core: Vec<LatticePos> =
            [[20, 20, 20], [25, 29, 23], [40, 20, 20], [21, 35, 22]].map(scaled).into();
        // Near the first row, near the brick above, within half a brick of a corner, and farther.
        let others =
            [[19, 19, 19], [31, 25, 33], [22, 44, 25], [15, 15, 15], [14, 20, 20], [90, 90, 90]].map(scaled);
        let mesh = MeshedChunk {
            core_counts: vec![2, 0, 1, 1, 0],
            halo: vec![PointId(0); 4],
            all_positions: [&core[..], &others].concat(),
            around: 2,
            shared: vec![],
            tets: TetList::default(),
            retries: 0,
        };
        let found: Vec<(Range<usize>, Vec<u32>)> =
            Groups::of(&bricks, &mesh).iter().map(|(core, others)| (core, others.to_vec())).collect();
        let expected = [(0..3, vec![4, 5, 7]), (3..4, vec![6]), (0..0, vec![8]), (0..0, vec![9])];
        assert_eq!(found, expected);
        // Rows end where a box would have too many samples, and where nothing is.
        let wide = BrickGrid::new(bricks.lattice, [30; 3]);
        assert_eq!(Groups::of(&wide, &mesh).iter().map(|(core, _)| core.len()).sum::<usize>(), 4);
        let none = MeshedChunk { core_counts: vec![], all_positions: others.to_vec(), ..mesh };
        let alone: Vec<usize> = Groups::of(&bricks, &none).iter().map(|(_, others)| others.len()).collect();
        assert_eq!(alone.iter().sum::<usize>(), others.len());
    }

    fn scaled(voxel: [u32; 3]) -> LatticePos {
        voxel.map(|v| v << 4)
    }
}
