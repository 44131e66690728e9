//! Points for which there is no formula: they are listed.
//!
//! The boundary of a tetrahedral mesh has any shape, so its samples are a list, made once and kept
//! with the archive. The list is sorted by the cells of a coarse grid, x fastest, and within a cell
//! by x, y, z, each position once; the id of a point is its place in that order. A box finds its
//! points by looking at the cells that it meets.
//!
//! The vertices of a mesh may be listed too ([`ExplicitPoints::with_repeats`]). Of those, several
//! may share a position: bodies that touch have vertices of their own. Each is a point then, and
//! they follow each other.

use isospan_io::geom::{Lattice, LatticeBox, LatticePos, PointClass, PointId, Site};

/// A list of points on a lattice, in canonical order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExplicitPoints {
    positions: Vec<LatticePos>,
    grid: PointCells,
    /// Where each cell begins, and the end.
    starts: Vec<u32>,
    /// No other point of a set lies as near as this; 0 leaves all.
    clear: u32,
}

/// The coarse grid: cells of 2^shift lattice steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PointCells {
    shift: u32,
    dims: [usize; 3],
}

/// A length where there are 2^level times as many points a volume.
fn at_level(length: u32, level: u8) -> u32 {
    // 2^(-1/3) and 2^(-2/3).
    let part = [1 << 16, 52_016, 41_285][usize::from(level % 3)];
    ((u64::from(length) * part) >> (16 + level / 3)) as u32
}

/// Points a cell of the domain, about; those that hold any hold more, as points lie on a surface.
const POINTS_A_CELL: u128 = 4;

impl PointCells {
    fn new(lattice: &Lattice, count: usize) -> Self {
        let max = lattice.max();
        let dims = |shift: u32| -> [usize; 3] { max.map(|m| (m >> shift) as usize + 1) };
        let most = (count as u128 / POINTS_A_CELL).max(1);
        let fits = |&s: &u32| dims(s).iter().map(|&n| n as u128).product::<u128>() <= most;
        let shift = (0..25).find(fits).unwrap_or(25);
        Self { shift, dims: dims(shift) }
    }

    fn len(&self) -> usize {
        self.dims.iter().product()
    }

    fn of(&self, p: LatticePos) -> [usize; 3] {
        p.map(|c| (c >> self.shift) as usize)
    }

    fn number(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.dims[1] + y) * self.dims[0] + x
    }
}

impl ExplicitPoints {
    /// The most points of a list: ids and places are 32 bits.
    pub const MOST: usize = u32::MAX as usize - 1;

    /// Sorts a list of positions in the lattice's domain; equal ones become one.
    ///
    /// # Panics
    /// When there are more than [`ExplicitPoints::MOST`], or one lies outside.
    pub fn new(lattice: &Lattice, mut positions: Vec<LatticePos>) -> Self {
        positions.sort_unstable();
        positions.dedup();
        Self::of_sorted(lattice, positions)
    }

    /// As [`ExplicitPoints::new`], but each position stays as often as it is there.
    ///
    /// # Panics
    /// As [`ExplicitPoints::new`].
    pub fn with_repeats(lattice: &Lattice, mut positions: Vec<LatticePos>) -> Self {
        positions.sort_unstable();
        Self::of_sorted(lattice, positions)
    }

    fn of_sorted(lattice: &Lattice, mut positions: Vec<LatticePos>) -> Self {
        assert!(positions.len() <= Self::MOST, "the caller bounds the list");
        let domain = lattice.domain();
        assert!(positions.iter().all(|&p| domain.contains(p)), "points lie in the domain");
        let grid = PointCells::new(lattice, positions.len());
        // Stable: within a cell the order stays that of x, y, z.
        positions.sort_by_key(|&p| grid.number(grid.of(p)));
        let mut starts = vec![0u32; grid.len() + 1];
        for &p in &positions {
            starts[grid.number(grid.of(p)) + 1] += 1;
        }
        for i in 0..grid.len() {
            starts[i + 1] += starts[i];
        }
        Self { positions, grid, starts, clear: 0 }
    }

    /// The same list, for a set in which no other point lies within `clear` lattice steps of one of
    /// these. In a denser part there are as many fewer steps as its points are closer.
    #[must_use]
    pub fn clearing(self, clear: u32) -> Self {
        Self { clear, ..self }
    }

    /// The distance within which no other point of a set lies.
    pub fn clear(&self) -> u32 {
        self.clear
    }

    /// Removes the sites that lie too near to a point of the list; `level` gives the level at a
    /// position. The sites lie in the box. At each corner of the domain a point stays, for without
    /// it the tetrahedra would not fill the domain.
    pub(super) fn drop_near(
        &self,
        domain: &LatticeBox,
        b: &LatticeBox,
        sites: &mut Vec<Site>,
        level: impl Fn(LatticePos) -> u8,
    ) {
        if self.clear == 0 || self.count_in(&b.grow_within([self.clear; 3], domain)) == 0 {
            return;
        }
        let is_corner = |p: LatticePos| (0..3).all(|a| p[a] == domain.lo[a] || p[a] + 1 == domain.hi[a]);
        sites.retain(|site| {
            let reach = at_level(self.clear, level(site.pos));
            let around =
                LatticeBox { lo: site.pos, hi: site.pos.map(|c| c + 1) }.grow_within([reach; 3], domain);
            let square =
                |p: LatticePos| (0..3).map(|a| u64::from(p[a].abs_diff(site.pos[a])).pow(2)).sum::<u64>();
            let mut is_far = true;
            self.each_in(&around, |i| is_far &= square(self.positions[i]) >= u64::from(reach).pow(2));
            is_far
                || site.id.class() == Some(PointClass::Corner)
                || is_corner(site.pos) && self.find(site.pos).is_none()
        });
    }

    /// Positions in canonical order.
    pub fn positions(&self) -> &[LatticePos] {
        &self.positions
    }

    /// Number of points.
    pub fn len(&self) -> u64 {
        self.positions.len() as u64
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The place in the list of a position; the first, where it is there more than once.
    pub fn find(&self, p: LatticePos) -> Option<usize> {
        let c = self.grid.of(p);
        if (0..3).any(|a| c[a] >= self.grid.dims[a]) {
            return None;
        }
        let n = self.grid.number(c);
        let (from, to) = (self.starts[n] as usize, self.starts[n + 1] as usize);
        let first = from + self.positions[from..to].partition_point(|&q| q < p);
        (first < to && self.positions[first] == p).then_some(first)
    }

    /// Calls `visit` with the place in the list of each point of a box within the domain, in
    /// ascending order of cells.
    pub fn each_in(&self, b: &LatticeBox, mut visit: impl FnMut(usize)) {
        self.each_row(b, |range, _| range.filter(|&i| b.contains(self.positions[i])).for_each(&mut visit));
    }

    /// The position of a point by its index.
    pub(super) fn position(&self, index: u64) -> Option<LatticePos> {
        self.positions.get(usize::try_from(index).ok()?).copied()
    }

    /// Appends the points of a box within the domain.
    pub(super) fn sites_in(&self, b: &LatticeBox, out: &mut Vec<Site>) {
        self.each_row(b, |range, _| {
            let inside = range.filter(|&i| b.contains(self.positions[i]));
            out.extend(
                inside.map(|i| Site {
                    id: PointId::new(PointClass::Explicit, i as u64),
                    pos: self.positions[i],
                }),
            );
        });
    }

    /// The number of points in a box within the domain, exactly.
    pub(super) fn count_in(&self, b: &LatticeBox) -> u64 {
        let mut count = 0;
        self.each_row(b, |range, whole| {
            count +=
                if whole { range.len() } else { range.filter(|&i| b.contains(self.positions[i])).count() }
                    as u64;
        });
        count
    }

    /// Calls `row` with the run of points of each cell, or row of cells, that the box meets; and
    /// whether the box has all of it.
    fn each_row(&self, b: &LatticeBox, mut row: impl FnMut(std::ops::Range<usize>, bool)) {
        if b.is_empty() || self.is_empty() {
            return;
        }
        let (lo, hi) = (self.grid.of(b.lo), self.grid.of(b.hi.map(|h| h - 1)));
        // Cells whose every position is inside.
        let whole = |a: usize, c: usize| {
            let (first, end) = ((c as u64) << self.grid.shift, (c as u64 + 1) << self.grid.shift);
            u64::from(b.lo[a]) <= first && end <= u64::from(b.hi[a])
        };
        let mut run = |x: std::ops::RangeInclusive<usize>, y: usize, z: usize, all: bool| {
            let first = self.starts[self.grid.number([*x.start(), y, z])] as usize;
            let end = self.starts[self.grid.number([*x.end(), y, z]) + 1] as usize;
            if first < end {
                row(first..end, all);
            }
        };
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                let inner = whole(1, y) && whole(2, z);
                if !inner || hi[0] - lo[0] < 2 {
                    run(lo[0]..=hi[0], y, z, false);
                    continue;
                }
                run(lo[0]..=lo[0], y, z, false);
                run(lo[0] + 1..=hi[0] - 1, y, z, true);
                run(hi[0]..=hi[0], y, z, false);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lattice() -> Lattice {
        Lattice::new([65, 33, 49]).unwrap()
    }

    fn mixed(count: u32) -> Vec<LatticePos> {
        let max = lattice().max();
        let mix =
            |i: u32, k: u32| (i + 1).wrapping_mul(2_654_435_761).rotate_left(7 * k).wrapping_mul(40_503);
        (0..count).map(|i| std::array::from_fn(|a| mix(i, a as u32) % (max[a] + 1))).collect()
    }

    #[test]
    fn every_point_is_found_by_its_position_and_its_id() {
        let points = mixed(3000);
        let mut twice = points.clone();
        twice.extend(&points);
        twice.reverse();
        let list = ExplicitPoints::new(&lattice(), twice);
        assert_eq!(list, ExplicitPoints::new(&lattice(), points.clone()), "a set has one order");
        for p in points {
            let at = list.find(p).unwrap();
            assert_eq!(list.position(at as u64), Some(p));
        }
        assert_eq!(list.position(3000), None);
        assert_eq!(list.find([u32::MAX; 3]), None);
        assert!(ExplicitPoints::new(&lattice(), vec![]).is_empty());
    }

    #[test]
    fn repeats_follow_each_other_where_they_are_kept() {
        let points = mixed(900);
        let thrice: Vec<_> = points.iter().chain(&points).chain(&points).copied().collect();
        let list = ExplicitPoints::with_repeats(&lattice(), thrice.clone());
        assert_eq!(list.len(), 3 * ExplicitPoints::new(&lattice(), thrice).len());
        for p in points {
            let first = list.find(p).unwrap();
            assert_eq!(list.positions()[first..first + 3], [p; 3]);
            assert!(first == 0 || list.positions()[first - 1] != p);
        }
        assert_eq!(list.find([u32::MAX; 3]), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(50))]

        #[test]
        fn boxes_have_their_points(count in 0u32..600, lo in [0.0..1.0f64, 0.0..1.0, 0.0..1.0], size in [0.0..1.0f64, 0.0..1.0, 0.0..1.0]) {
            let points = mixed(count);
            let list = ExplicitPoints::new(&lattice(), points.clone());
            let max = lattice().max();
            let lo: LatticePos = std::array::from_fn(|a| (lo[a] * f64::from(max[a])) as u32);
            let hi: LatticePos = std::array::from_fn(|a| (lo[a] + (size[a] * f64::from(max[a])) as u32).min(max[a] + 1));
            let b = LatticeBox { lo, hi };
            let mut found = vec![];
            list.sites_in(&b, &mut found);
            let mut expected: Vec<_> = points.into_iter().filter(|&p| b.contains(p)).collect();
            let mut positions: Vec<_> = found.iter().map(|s| s.pos).collect();
            expected.sort_unstable();
            positions.sort_unstable();
            prop_assert_eq!(positions, expected);
            prop_assert_eq!(list.count_in(&b), found.len() as u64);
            prop_assert!(found.iter().all(|s| list.position(s.id.index()) == Some(s.pos)));
        }
    }
}
