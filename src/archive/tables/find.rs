//! Where in a grid with coordinates is a position of the world? The inverse of
//! [`CoordinateMap::place`].
//!
//! The axes of a rectilinear grid are tables, which are searched. A curvilinear grid is cut into
//! boxes of cells, whose bounds in the world are found once ([`CellBoxes`]). A question reads the
//! boxes that hold one of its positions; in each, cells that may hold one are solved by Newton's
//! method for the trilinear map.
//!
//! Cost: a pass over all coordinates once; then the boxes around the positions. Memory: 48 bytes a
//! box, at most 2^18 of them; a box of samples, and 40 bytes for each position. Where the grid
//! folds over itself a position lies in several cells: that of least distance counts, then the
//! first one.

use super::coordinates::{CoordinateMap, trilinear};
use glam::DVec3;
use isospan_io::error::Result;

/// Cells along a side of a box, at least.
const SIDE: u64 = 8;
/// Boxes of a grid, at most.
const MOST_BOXES: u64 = 1 << 18;
/// Steps of Newton's method.
const STEPS: usize = 20;
/// A position this far outside of a cell, in parts of its size, is in it: what rounding moves.
const NEAR: f64 = 1e-4;
/// And in parts of its distance from the place that surfaces are counted from, in `f32`.
const ROUNDED: f64 = 4.0 * f32::EPSILON as f64;

/// The bounds of boxes of cells.
pub struct CellBoxes {
    /// Cells along a side of a box.
    side: u64,
    /// Boxes along x, y, z.
    count: [u64; 3],
    /// Least and largest position, x fastest.
    bounds: Vec<[DVec3; 2]>,
}

/// What is known of a position.
#[derive(Clone, Copy)]
struct Sought {
    world: DVec3,
    number: u32,
    distance: f64,
    ijk: DVec3,
}

impl CoordinateMap {
    /// The bounds of the grid's cells; of a rectilinear grid none are needed.
    ///
    /// # Errors
    /// When the segment cannot be read, or is damaged; those of `check`, which is called for each
    /// box.
    pub fn cell_boxes(&self, check: &dyn Fn() -> Result<()>) -> Result<CellBoxes> {
        let cells = self.dims().map(|d| d.saturating_sub(1));
        let boxes = |side: u64| cells.map(|c| c.div_ceil(side));
        let mut side = SIDE;
        while boxes(side).iter().product::<u64>() > MOST_BOXES {
            side *= 2;
        }
        let mut found = CellBoxes { side, count: boxes(side), bounds: vec![] };
        if self.axes().is_some() {
            return Ok(found);
        }
        let mut samples = vec![];
        for number in 0..found.count.iter().product::<u64>() {
            check()?;
            let (lo, hi) = found.cells_of(number, cells);
            self.samples(lo, hi, &mut samples)?;
            found.bounds.push(bounds(samples.iter().copied()));
        }
        Ok(found)
    }

    /// The places in index space of positions of the world; `None` outside of the grid. Positions
    /// may be rounded as those of a surface are, to `f32` less an origin.
    ///
    /// # Errors
    /// When the segment cannot be read, or is damaged; those of `check`, which is called for each
    /// box.
    pub fn find(
        &self,
        boxes: &CellBoxes,
        positions: &[[f64; 3]],
        origin: [f64; 3],
        check: &dyn Fn() -> Result<()>,
    ) -> Result<Vec<Option<[f64; 3]>>> {
        if let Some(axes) = self.axes() {
            let find = |p: &[f64; 3]| {
                let [x, y, z] = [0, 1, 2].map(|a| along_axis(&axes[a], p[a], origin[a]));
                Some([x?, y?, z?])
            };
            return Ok(positions.iter().map(find).collect());
        }
        let mut sought: Vec<Sought> = (0..)
            .zip(positions)
            .filter(|(_, p)| p.iter().all(|x| x.is_finite()))
            .map(|(number, &p)| Sought {
                world: DVec3::from_array(p),
                number,
                distance: f64::INFINITY,
                ijk: DVec3::ZERO,
            })
            .collect();
        let origin = DVec3::from_array(origin);
        let [least, most] = bounds(sought.iter().map(|s| s.world));
        // The axis along which they are farthest apart tells most of them from others.
        let along = (0..3).fold(0, |best, a| if (most - least)[a] > (most - least)[best] { a } else { best });
        sought
            .sort_unstable_by(|a, b| a.world[along].total_cmp(&b.world[along]).then(a.number.cmp(&b.number)));
        let (cells, mut samples, mut near) = (self.dims().map(|d| d.saturating_sub(1)), vec![], vec![]);
        for (number, &at) in (0..).zip(&boxes.bounds) {
            near.clear();
            near.extend(within(&sought, along, grown(at, origin)).map(|(n, _)| n));
            if near.is_empty() {
                continue;
            }
            check()?;
            let (lo, hi) = boxes.cells_of(number, cells);
            self.samples(lo, hi, &mut samples)?;
            let mut some: Vec<Sought> = near.iter().map(|&n| sought[n]).collect();
            for z in lo[2]..hi[2] {
                for y in lo[1]..hi[1] {
                    for x in lo[0]..hi[0] {
                        let corners = corners_of(&samples, lo, hi, [x, y, z]);
                        improve(&mut some, along, &corners, [x, y, z], origin);
                    }
                }
            }
            near.iter().zip(some).for_each(|(&n, found)| sought[n] = found);
        }
        let mut found = vec![None; positions.len()];
        for s in sought.iter().filter(|s| s.distance.is_finite()) {
            found[s.number as usize] = Some(s.ijk.to_array());
        }
        Ok(found)
    }
}

impl CellBoxes {
    /// The first cell of a box, and the one past the last, along each axis.
    fn cells_of(&self, number: u64, cells: [u64; 3]) -> ([u64; 3], [u64; 3]) {
        let [x, y, _] = self.count;
        let at = [number % x, number / x % y, number / x / y];
        let lo = at.map(|n| n * self.side);
        (lo, std::array::from_fn(|a| (lo[a] + self.side).min(cells[a])))
    }
}

impl CoordinateMap {
    /// The least box of the world that holds the grid, given its boxes of cells.
    pub fn bounds(&self, boxes: &CellBoxes) -> [[f64; 3]; 2] {
        let ends = |axes: &[Vec<f64>; 3]| {
            let end = |first: bool| {
                let fold = if first { f64::min } else { f64::max };
                [0, 1, 2].map(|a| axes[a].iter().copied().fold(axes[a][0], fold))
            };
            [end(true), end(false)]
        };
        let all = || bounds(boxes.bounds.iter().flatten().copied()).map(|p| p.to_array());
        self.axes().map_or_else(all, ends)
    }

    /// A range of the world along an axis of a rectilinear grid in index space; an infinite end is
    /// open, and so is one beyond the grid. `None` where the axis does not rise or fall throughout,
    /// and for a curvilinear grid.
    pub fn index_range(&self, axis: usize, [lo, hi]: [f64; 2]) -> Option<[f64; 2]> {
        let table = &self.axes()?[axis];
        let is_falling = table.iter().rev().is_sorted();
        if !(is_falling || table.is_sorted()) {
            return None;
        }
        let ends = [lo, hi].map(|x| if x.is_finite() { along_axis(table, x, x) } else { None });
        let [a, b] = if is_falling { [ends[1], ends[0]] } else { ends };
        Some([a.unwrap_or(f64::NEG_INFINITY), b.unwrap_or(f64::INFINITY)])
    }
}

fn bounds(positions: impl Iterator<Item = DVec3>) -> [DVec3; 2] {
    let none = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    positions.fold(none, |[lo, hi], p| [lo.min(p), hi.max(p)])
}

/// How far outside of a cell or box a position counts as in it.
fn tolerance([lo, hi]: [DVec3; 2], origin: DVec3) -> f64 {
    let far = (lo - origin).abs().max((hi - origin).abs()).max_element();
    NEAR * (hi - lo).length() + ROUNDED * far
}

fn grown(at: [DVec3; 2], origin: DVec3) -> [DVec3; 2] {
    let more = DVec3::splat(tolerance(at, origin));
    [at[0] - more, at[1] + more]
}

/// Those within bounds, with their places in the list, which ascends along an axis.
fn within(sought: &[Sought], along: usize, [lo, hi]: [DVec3; 2]) -> impl Iterator<Item = (usize, &Sought)> {
    let first = sought.partition_point(|s| s.world[along] < lo[along]);
    let near = sought[first..].iter().take_while(move |s| s.world[along] <= hi[along]);
    let is_in = move |p: DVec3| p.cmpge(lo).all() && p.cmple(hi).all();
    (first..).zip(near).filter(move |(_, s)| is_in(s.world))
}

/// The corners of a cell of a box, x fastest.
fn corners_of(samples: &[DVec3], lo: [u64; 3], hi: [u64; 3], cell: [u64; 3]) -> [DVec3; 8] {
    let size: [usize; 3] = std::array::from_fn(|a| (hi[a] - lo[a] + 1) as usize);
    std::array::from_fn(|n| {
        let at: [usize; 3] = std::array::from_fn(|a| (cell[a] - lo[a]) as usize + (n >> a & 1));
        samples[(at[2] * size[1] + at[1]) * size[0] + at[0]]
    })
}

/// Finds positions in a cell.
fn improve(sought: &mut [Sought], along: usize, corners: &[DVec3; 8], cell: [u64; 3], origin: DVec3) {
    let at = bounds(corners.iter().copied());
    let near: Vec<usize> = within(sought, along, grown(at, origin)).map(|(n, _)| n).collect();
    let cell = DVec3::from_array(cell.map(|c| c as f64));
    for n in near {
        let s = &mut sought[n];
        if s.distance == 0.0 {
            continue;
        }
        let Some((t, distance)) = solve(corners, s.world, (at[1] - at[0]).length()) else { continue };
        if distance <= tolerance(at, origin) && distance < s.distance {
            (s.distance, s.ijk) = (distance, cell + t);
        }
    }
}

/// The place in a cell that is nearest to a position in or by it, and its distance: 0 where only
/// rounding is between them.
fn solve(corners: &[DVec3; 8], world: DVec3, size: f64) -> Option<(DVec3, f64)> {
    let mut t = DVec3::splat(0.5);
    for _ in 0..STEPS {
        let at = trilinear(corners, t);
        let off = world - DVec3::from_array(at.position);
        if off.length() <= 1e-13 * size {
            break;
        }
        let step = at.jacobian.inverse() * off;
        if !step.is_finite() {
            return None;
        }
        t = (t + step).clamp(DVec3::splat(-1.0), DVec3::splat(2.0));
    }
    let t = t.clamp(DVec3::ZERO, DVec3::ONE);
    let off = (world - DVec3::from_array(trilinear(corners, t).position)).length();
    Some((t, if off <= 1e-9 * size { 0.0 } else { off }))
}

/// Where in a table is a coordinate? The table may fall, and the first interval counts.
fn along_axis(table: &[f64], x: f64, origin: f64) -> Option<f64> {
    let (first, last) = (*table.first()?, *table.last()?);
    let far = (first - origin).abs().max((last - origin).abs());
    let near = NEAR * (last - first).abs() / table.len() as f64 + ROUNDED * far;
    let is_rising = table.is_sorted();
    let is_falling = table.iter().rev().is_sorted();
    let x = match (first.min(last), first.max(last)) {
        (lo, hi) if (is_rising || is_falling) && x >= lo - near && x <= hi + near => x.clamp(lo, hi),
        _ if is_rising || is_falling => return None,
        _ => x,
    };
    let holds = |pair: &[f64]| pair[0].min(pair[1]) <= x && x <= pair[0].max(pair[1]);
    let cell = if is_rising {
        table.partition_point(|&c| c < x).saturating_sub(1)
    } else if is_falling {
        table.partition_point(|&c| c > x).saturating_sub(1)
    } else {
        table.windows(2).position(holds)?
    };
    let [a, b] = [table[cell], *table.get(cell + 1)?];
    Some(cell as f64 + if a == b { 0.0 } else { (x - a) / (b - a) })
}

#[cfg(test)]
mod tests {
    use super::super::coordinates::tests::{cylinder, grid};
    use super::*;

    fn found(map: &CoordinateMap, positions: &[[f64; 3]], origin: [f64; 3]) -> Vec<Option<[f64; 3]>> {
        let boxes = map.cell_boxes(&|| Ok(())).unwrap();
        map.find(&boxes, positions, origin, &|| Ok(())).unwrap()
    }

    #[test]
    fn positions_of_a_curvilinear_grid_come_back() {
        let (_dir, map) = grid([40, 19, 11], cylinder);
        let places: Vec<[f64; 3]> = (0..500)
            .map(|n| {
                [n * 7919 % 3900, n * 104_729 % 1800, n * 1_299_709 % 1000]
                    .map(|v| f64::from(v as u32) / 100.0)
            })
            .chain([[0.0, 0.0, 0.0], [39.0, 18.0, 10.0], [8.0, 8.0, 8.0], [39.0, 0.0, 5.0]])
            .collect();
        let world: Vec<_> = places.iter().map(|&p| map.place(p).unwrap().position).collect();
        for (place, found) in places.iter().zip(found(&map, &world, [0.0; 3])) {
            let found = found.unwrap_or_else(|| panic!("{place:?} is in the grid"));
            assert!((0..3).all(|a| (found[a] - place[a]).abs() < 1e-6), "{place:?}: {found:?}");
        }
        // As a surface has them, in f32.
        let rounded: Vec<_> = world.iter().map(|p| p.map(|x| f64::from(x as f32))).collect();
        assert!(found(&map, &rounded, [0.0; 3]).iter().all(Option::is_some));
        // Within the tube, beyond it, and beyond its ends.
        let outside = [[0.0, 0.0, 1.0], [0.9, 0.0, 1.0], [2.1, 0.0, 1.0], [1.5, 0.0, -0.1], [1.5, 0.0, 18.1]];
        assert_eq!(found(&map, &outside, [0.0; 3]), [None; 5]);
        let no_places = [[f64::NAN, 0.0, 0.0], [f64::INFINITY; 3]];
        assert_eq!(found(&map, &no_places, [0.0; 3]), [None; 2]);
    }

    #[test]
    fn cells_are_small_far_from_0() {
        // Of a thousandth, a million from 0; sheared, and as tables.
        let far = 1e6;
        let sheared = |[x, y, z]: [f64; 3]| [far + 1e-3 * (x + 0.25 * y), far + 1e-3 * y, far + 1e-3 * z];
        let (_dir, points) = grid([9, 9, 9], sheared);
        let tables: [Vec<f64>; 3] = [0; 3].map(|_| (0..9).map(|n| far + 1e-3 * f64::from(n)).collect());
        let origin = [far; 3];
        let at = |ijk: [f64; 3]| sheared(ijk);
        let [inside, outside] = [[4.5, 3.25, 2.0], [4.5, 3.25, -1.0]].map(at);
        let places = found(&points, &[inside, outside], origin);
        let place = places[0].unwrap();
        assert!((0..3).all(|a| (place[a] - [4.5, 3.25, 2.0][a]).abs() < 1e-5), "{place:?}");
        assert_eq!(places[1], None, "a cell away is outside");
        let along = |x: f64| along_axis(&tables[0], far + 1e-3 * x, far);
        assert!((along(2.5).unwrap() - 2.5).abs() < 1e-5 && along(-1.0).is_none() && along(9.0).is_none());
        // As a surface that is counted from there has it.
        let rounded = at([8.0, 8.0, 8.0]).map(|x| far + f64::from((x - far) as f32));
        assert!(found(&points, &[rounded], origin)[0].is_some());
    }

    #[test]
    fn places_in_tables_rise_or_fall() {
        for (table, x, place) in [
            (vec![0.0, 1.0, 4.0], 2.5, Some(1.5)),
            (vec![0.0, 1.0, 4.0], 4.0, Some(2.0)),
            (vec![0.0, 1.0, 4.0], 0.0, Some(0.0)),
            (vec![0.0, 1.0, 4.0], 4.1, None),
            (vec![0.0, 1.0, 4.0], -0.1, None),
            (vec![4.0, 1.0, 0.0], 2.5, Some(0.5)),
            (vec![4.0, 1.0, 0.0], 0.0, Some(2.0)),
            (vec![0.0, 2.0, 1.0, 3.0], 2.5, Some(2.75)),
            (vec![0.0, 1.0], f64::NAN, None),
        ] {
            assert_eq!(along_axis(&table, x, 0.0), place, "{x} in {table:?}");
        }
    }
}
