//! Unions of rectilinear grids: the regular set and the hyperbolic cross.
//!
//! Each is a list of grids, a grid being three increasing lists of positions ([`Ticks`]) given by a
//! formula. A box takes a range of each list, also by formula, and the product of the ranges is the
//! answer.
//!
//! **Regular** is one grid of voxels: tick i of c is the voxel nearest to i·(dim-1)/(c-1), halves
//! up.
//!
//! **Hyperbolic cross** (Temlyakov 1987; here eq. 2.1 of the thesis with its flexible k): the union
//! over s ∈ N³, Σ (r_j+1)·s_j <= m·(r_min+1), of the grids l_j/2^(s_j+k), l_j = 1 … 2^(s_j+k)-1.
//! Those grids overlap. Reduce a coordinate to odd/2^t: it is on the grid of s_j iff t <= s_j + k,
//! so the least s_j is its *level* max(0, t-k), and the point is in the union iff its levels
//! satisfy the inequality. Level 0 has the 2^k - 1 multiples of 2^-k, level s > 0 the 2^(k+s-1) odd
//! multiples of 2^-(k+s):
//!
//! ```text
//! k = 2:   level 0    1/4   2/4   3/4
//!          level 1    1/8   3/8   5/8   7/8
//!          level 2    1/16  3/16  …     15/16
//! ```
//!
//! Each point has one triple of levels, so a grid for each admissible triple lists the set without
//! duplicates. Only rounding to the lattice can make two points one, and only where the levels are
//! finer than the lattice.

use isospan_io::geom::{Lattice, LatticeBox, LatticePos, PointClass, PointId, Site};
use std::ops::Range;

/// An increasing list of positions on an axis, not stored.
#[derive(Clone, Copy, Debug)]
enum Ticks {
    /// `count` voxels spread over `cells + 1`, each of 2^`log2_steps` lattice steps.
    Voxels { count: u64, cells: u64, log2_steps: u32 },
    /// A level of the hyperbolic cross: multiples of 2^-k, or odd multiples of 2^-(k+level), of
    /// `max`.
    Level { k: u32, level: u32, max: u32 },
}

impl Ticks {
    fn count(self) -> u64 {
        match self {
            Self::Voxels { count, .. } => count,
            Self::Level { k, level: 0, .. } => (1 << k) - 1,
            Self::Level { k, level, .. } => 1 << (k + level - 1),
        }
    }

    /// The i-th position.
    fn at(self, i: u64) -> u32 {
        match self {
            Self::Voxels { count, cells, log2_steps } => {
                let gaps = count - 1;
                (((2 * i * cells + gaps) / (2 * gaps)) << log2_steps) as u32
            }
            Self::Level { k, level, max } => {
                let (l, t) = (if level == 0 { i + 1 } else { 2 * i + 1 }, k + level);
                ((u128::from(l) * 2 * u128::from(max) + (1 << t)) >> (t + 1)) as u32
            }
        }
    }

    /// The first i whose position is at least `p`; the count if there is none.
    fn first_at_least(self, p: u32) -> u64 {
        if p == 0 {
            return 0;
        }
        let i = match self {
            // i·cells/gaps + 1/2 >= voxel
            Self::Voxels { count, cells, log2_steps } => {
                let voxel = u64::from(p).div_ceil(1 << log2_steps);
                ((2 * voxel - 1) * (count - 1)).div_ceil(2 * cells)
            }
            // l·max/2^t + 1/2 >= p; the numerators are i + 1, or 2i + 1.
            Self::Level { k, level, max } => {
                let l = (u128::from(2 * p - 1) << (k + level)).div_ceil(2 * u128::from(max)) as u64;
                if level == 0 { l.saturating_sub(1) } else { l / 2 }
            }
        };
        i.min(self.count())
    }

    fn range(self, lo: u32, hi: u32) -> Range<u64> {
        self.first_at_least(lo)..self.first_at_least(hi)
    }
}

/// A grid of the union.
#[derive(Clone, Copy, Debug)]
struct GridTicks {
    /// Which ticks of each axis.
    ticks: [usize; 3],
    /// Index of its first point; x runs fastest.
    first: u64,
}

/// A union of grids without common points.
#[derive(Clone, Debug)]
pub(super) struct Grids {
    ticks: [Vec<Ticks>; 3],
    grids: Vec<GridTicks>,
    len: u64,
}

impl Grids {
    /// `None` when the points are more than [`super::MOST_POINTS`].
    fn new(ticks: [Vec<Ticks>; 3], choices: impl IntoIterator<Item = [usize; 3]>) -> Option<Self> {
        let mut all = Self { ticks, grids: vec![], len: 0 };
        for ticks in choices {
            all.grids.push(GridTicks { ticks, first: all.len });
            let points = (0..3).map(|a| u128::from(all.ticks[a][ticks[a]].count())).product::<u128>();
            all.len =
                u64::try_from(u128::from(all.len) + points).ok().filter(|&n| n <= super::MOST_POINTS)?;
        }
        Some(all)
    }

    /// `counts[a]` voxels along axis a, from the first to the last; `2 <= counts[a] <= dims[a]`.
    pub(super) fn regular(counts: [u64; 3], lattice: &Lattice) -> Option<Self> {
        let ticks = std::array::from_fn(|a| {
            vec![Ticks::Voxels {
                count: counts[a],
                cells: lattice.dims[a] - 1,
                log2_steps: lattice.log2_steps[a],
            }]
        });
        Self::new(ticks, [[0; 3]])
    }

    /// The hyperbolic cross.
    pub(super) fn hyperbolic_cross(m: u32, k: u32, r: [u32; 3], lattice: &Lattice) -> Option<Self> {
        let max = lattice.max();
        let most = largest_levels(m, r);
        let ticks = std::array::from_fn(|a| {
            (0..=most[a]).map(|level| Ticks::Level { k, level, max: max[a] }).collect()
        });
        Self::new(ticks, level_triples(m, r).map(|s| s.map(|s| s as usize)))
    }

    /// Number of points.
    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// The position of the point of this index; `None` when there is none.
    pub(super) fn position(&self, index: u64) -> Option<LatticePos> {
        if index >= self.len {
            return None;
        }
        // Grids without points share their start with the next: the last that starts here or before
        // has the point.
        let grid = self.grids[self.grids.partition_point(|g| g.first <= index) - 1];
        let ticks = self.ticks_of(&grid);
        let (in_grid, [nx, ny, _]) = (index - grid.first, ticks.map(Ticks::count));
        let ijk = [in_grid % nx, in_grid / nx % ny, in_grid / nx / ny];
        Some(std::array::from_fn(|a| ticks[a].at(ijk[a])))
    }

    fn ticks_of(&self, grid: &GridTicks) -> [Ticks; 3] {
        std::array::from_fn(|a| self.ticks[a][grid.ticks[a]])
    }

    /// The range of every list of ticks in the box.
    fn ranges(&self, b: &LatticeBox) -> [Vec<Range<u64>>; 3] {
        std::array::from_fn(|a| self.ticks[a].iter().map(|t| t.range(b.lo[a], b.hi[a])).collect())
    }

    /// Number of points in a box, exactly (before duplicates).
    pub(super) fn count_in(&self, b: &LatticeBox) -> u64 {
        let counts = self.ranges(b).map(|axis| axis.iter().map(|r| r.end - r.start).collect::<Vec<_>>());
        self.grids.iter().map(|g| (0..3).map(|a| counts[a][g.ticks[a]]).product::<u64>()).sum()
    }

    /// Appends all points in the box, in no particular order, duplicates included.
    pub(super) fn sites_in(&self, b: &LatticeBox, out: &mut Vec<Site>) {
        let ranges = self.ranges(b);
        // Positions of a list of ticks are worked out when the first grid with points in the box
        // needs them.
        let mut tables: [Vec<Vec<u32>>; 3] = std::array::from_fn(|a| vec![vec![]; ranges[a].len()]);
        for grid in &self.grids {
            let range: [_; 3] = std::array::from_fn(|a| ranges[a][grid.ticks[a]].clone());
            if range.iter().any(Range::is_empty) {
                continue;
            }
            let ticks = self.ticks_of(grid);
            for a in 0..3 {
                let table = &mut tables[a][grid.ticks[a]];
                if table.is_empty() {
                    table.extend(range[a].clone().map(|i| ticks[a].at(i)));
                }
            }
            let [xs, ys, zs]: [&[u32]; 3] = std::array::from_fn(|a| &tables[a][grid.ticks[a]][..]);
            let (nx, ny) = (ticks[0].count(), ticks[1].count());
            for (k, &z) in (range[2].start..).zip(zs) {
                for (j, &y) in (range[1].start..).zip(ys) {
                    let row = grid.first + (k * ny + j) * nx;
                    out.extend((row + range[0].start..).zip(xs).map(|(index, &x)| Site {
                        id: PointId::new(PointClass::Interior, index),
                        pos: [x, y, z],
                    }));
                }
            }
        }
    }
}

/// Number of points of a hyperbolic cross.
pub(super) fn hyperbolic_cross_len(m: u32, k: u32, r: [u32; 3]) -> u128 {
    let count = |level| u128::from(Ticks::Level { k, level, max: 1 }.count());
    level_triples(m, r).map(|s| s.map(count).iter().product::<u128>()).sum()
}

/// r_j + 1 of each axis, and m·(r_min + 1).
fn weights(m: u32, r: [u32; 3]) -> ([u64; 3], u64) {
    let w = r.map(|r| u64::from(r) + 1);
    (w, u64::from(m) * w[0].min(w[1]).min(w[2]))
}

fn largest_levels(m: u32, r: [u32; 3]) -> [u32; 3] {
    let (w, most) = weights(m, r);
    w.map(|w| (most / w) as u32)
}

/// All levels s with Σ (r_j+1)·s_j <= m·(r_min+1), x fastest.
fn level_triples(m: u32, r: [u32; 3]) -> impl Iterator<Item = [u32; 3]> {
    let (w, most) = weights(m, r);
    (0..=(most / w[2])).flat_map(move |z| {
        let most = most - z * w[2];
        (0..=(most / w[1])).flat_map(move |y| {
            let most = most - y * w[1];
            (0..=(most / w[0])).map(move |x| [x, y, z].map(|s| s as u32))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn first_at_least_agrees_with_the_positions() {
        let mut lists = vec![
            Ticks::Voxels { count: 7, cells: 30, log2_steps: 3 },
            Ticks::Voxels { count: 30, cells: 30, log2_steps: 0 },
            Ticks::Voxels { count: 2, cells: 1, log2_steps: 4 },
        ];
        for level in 0..6 {
            lists.extend([100, 128, 7].map(|max| Ticks::Level { k: 2, level, max }));
        }
        for ticks in lists {
            let positions: Vec<u32> = (0..ticks.count()).map(|i| ticks.at(i)).collect();
            for p in 0..260 {
                let first = positions.partition_point(|&x| x < p) as u64;
                assert_eq!(ticks.first_at_least(p), first, "{ticks:?} {p}");
            }
        }
    }

    /// Eq. 2.1 word by word: all grids of all s, duplicates removed by a set.
    fn cross_by_the_formula(m: u32, k: u32, r: [u32; 3], max: LatticePos) -> BTreeSet<LatticePos> {
        let (w, most) = weights(m, r);
        let mut set = BTreeSet::new();
        for s in (0..343u32).map(|i| [i % 7, i / 7 % 7, i / 49]) {
            if (0..3).map(|a| w[a] * u64::from(s[a])).sum::<u64>() > most {
                continue;
            }
            let n = s.map(|s| 1u64 << (s + k));
            for (z, y) in (1..n[2]).flat_map(|z| (1..n[1]).map(move |y| (z, y))) {
                for x in 1..n[0] {
                    let l = [x, y, z];
                    set.insert(std::array::from_fn(|a| {
                        ((2 * l[a] * u64::from(max[a]) + n[a]) / (2 * n[a])) as u32
                    }));
                }
            }
        }
        set
    }

    #[test]
    fn hyperbolic_crosses_are_the_union_of_their_grids() {
        let lattice = Lattice::new([65, 33, 50]).unwrap();
        for (m, k, r) in [(2, 2, [1; 3]), (0, 3, [2, 1, 5]), (3, 2, [1, 2, 3]), (4, 2, [0, 0, 0])] {
            let grids = Grids::hyperbolic_cross(m, k, r, &lattice).unwrap();
            let mut sites = vec![];
            grids.sites_in(&lattice.domain(), &mut sites);
            let found: BTreeSet<LatticePos> = sites.iter().map(|s| s.pos).collect();
            assert_eq!(found.len() as u64, grids.len(), "no duplicates on a fine lattice");
            assert_eq!(found, cross_by_the_formula(m, k, r, lattice.max()));
            assert_eq!(u128::from(grids.len()), hyperbolic_cross_len(m, k, r));
            for s in sites {
                assert_eq!(grids.position(s.id.index()), Some(s.pos));
            }
        }
    }

    #[test]
    fn the_published_example_has_495_points() {
        assert_eq!(hyperbolic_cross_len(2, 2, [1; 3]), 495);
    }

    #[test]
    fn more_points_than_ids_are_refused() {
        let lattice = Lattice::new([1 << 24; 3]).unwrap();
        assert!(Grids::regular([1 << 24; 3], &lattice).is_none());
        assert!(Grids::hyperbolic_cross(40, 5, [0; 3], &lattice).is_none());
    }
}
