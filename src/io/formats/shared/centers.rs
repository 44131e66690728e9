//! Fields of an image or a grid that has both values at its points and values of the cells between
//! them.
//!
//! ```text
//!  points  0───1───2───3     n of them along an axis, the first at the origin
//!  cells     0   1   2       n - 1, the first half a step from it: a cell's value is a sample in its middle
//! ```
//!
//! An image that is one point thick has cells that are just as thin. The middle of a cell of a grid
//! is the mean of its corners.

use super::pick_field;
use crate::cells::{Center, NumberStream};
use crate::error::Result;
use crate::volume::FieldInfo;
use std::path::Path;

/// Samples along the axes, where there are so many points.
pub(in crate::formats) fn samples(points: [u64; 3], center: Center) -> [u64; 3] {
    match center {
        Center::Point => points,
        Center::Cell => points.map(|n| n.saturating_sub(1).max(1)),
    }
}

/// Where the first sample is, in steps from the first point.
pub(in crate::formats) fn first_sample(points: [u64; 3], center: Center) -> [f64; 3] {
    points.map(|n| if center == Center::Cell && n > 1 { 0.5 } else { 0.0 })
}

/// The coordinates of samples along an axis, given those of the points.
pub(in crate::formats) fn along_axis(points: Vec<f64>, center: Center) -> Vec<f64> {
    match center {
        Center::Cell if points.len() > 1 => points.windows(2).map(|w| 0.5 * w[0] + 0.5 * w[1]).collect(),
        _ => points,
    }
}

/// Numbers that are read together, at most.
const TOGETHER: usize = 1 << 16;

/// The middles of the cells of a grid, given x, y, z of its points. Memory: three planes of cells.
pub(in crate::formats) struct Middles {
    points: Box<dyn NumberStream>,
    /// Points along x, y, z.
    dims: [usize; 3],
    /// Sums over the corners of the faces between the plane given out and the next.
    below: Vec<f64>,
    /// A plane of middles, and how many of its numbers were given out.
    plane: Vec<f64>,
    used: usize,
}

impl Middles {
    pub(in crate::formats) fn new(points: Box<dyn NumberStream>, dims: [u64; 3]) -> Self {
        let dims = dims.map(|n| n as usize);
        Self { points, dims, below: vec![], plane: vec![], used: 0 }
    }

    /// The next row of points, in memory that grows as they arrive.
    fn row(&mut self) -> Result<Vec<f64>> {
        let (count, mut row) = (3 * self.dims[0], vec![]);
        while row.len() < count {
            let old = row.len();
            row.resize(count.min(old + TOGETHER), 0.0);
            self.points.fill(&mut row[old..])?;
        }
        Ok(row)
    }

    /// Sums over the corners of the faces of the next plane of points.
    fn faces(&mut self) -> Result<Vec<f64>> {
        let (mut before, mut out) = (vec![], vec![]);
        for y in 0..self.dims[1] {
            let row = self.row()?;
            let edges = match self.dims[0] {
                1 => row,
                _ => row.iter().zip(&row[3..]).map(|(a, b)| a + b).collect(),
            };
            if self.dims[1] == 1 {
                return Ok(edges);
            }
            if y > 0 {
                out.extend(edges.iter().zip(&before).map(|(a, b): (&f64, &f64)| a + b));
            }
            before = edges;
        }
        Ok(out)
    }

    fn next_plane(&mut self) -> Result<()> {
        let corners = self.dims.iter().filter(|&&n| n > 1).fold(1.0, |n, _| 2.0 * n);
        let mut faces = self.faces()?;
        if self.dims[2] > 1 {
            if self.below.is_empty() {
                self.below = std::mem::replace(&mut faces, self.faces()?);
            }
            self.plane = faces.iter().zip(&self.below).map(|(a, b)| (a + b) / corners).collect();
            self.below = faces;
        } else {
            self.plane = faces.into_iter().map(|sum| sum / corners).collect();
        }
        self.used = 0;
        Ok(())
    }
}

impl NumberStream for Middles {
    fn fill(&mut self, mut out: &mut [f64]) -> Result<()> {
        while !out.is_empty() {
            if self.used == self.plane.len() {
                self.next_plane()?;
            }
            let count = out.len().min(self.plane.len() - self.used);
            let (now, later) = out.split_at_mut(count);
            now.copy_from_slice(&self.plane[self.used..self.used + count]);
            self.used += count;
            out = later;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        self.points.finish()
    }
}

/// A field that was chosen.
pub(in crate::formats) struct Picked {
    pub(in crate::formats) field: FieldInfo,
    pub(in crate::formats) center: Center,
    /// Its position among the fields of its kind.
    pub(in crate::formats) index: usize,
    /// All fields, those at points first.
    pub(in crate::formats) fields: Vec<FieldInfo>,
}

/// Picks a field by its name, one of points before one of cells. Without a name, the choice is
/// among the fields at points or, where none of these is a scalar, those of cells: the one that is
/// `active`, else the only scalar one.
///
/// # Errors
/// As [`pick_field`].
pub(in crate::formats) fn pick<'a>(
    path: &Path,
    points: Vec<FieldInfo>,
    cells: Vec<FieldInfo>,
    wanted: Option<&str>,
    active: impl FnOnce(Center) -> Option<&'a str>,
) -> Result<Picked> {
    let is_scalar = |f: &&FieldInfo| f.components == 1;
    let at_points = points.len();
    let of_cells = points.iter().find(is_scalar).is_none() && cells.iter().any(|f| is_scalar(&f));
    let fields: Vec<FieldInfo> = points.into_iter().chain(cells).collect();
    let (candidates, first) = match (wanted, of_cells) {
        (Some(_), _) => (&fields[..], 0),
        (None, false) => (&fields[..at_points], 0),
        (None, true) => (&fields[at_points..], at_points),
    };
    let active = active(if of_cells { Center::Cell } else { Center::Point });
    let active = active.filter(|name| candidates.iter().filter(is_scalar).any(|f| f.name == *name));
    let chosen = first + pick_field(path, candidates, wanted.or(active))?;
    let (center, index) = match chosen.checked_sub(at_points) {
        Some(index) => (Center::Cell, index),
        None => (Center::Point, chosen),
    };
    Ok(Picked { field: fields[chosen].clone(), center, index, fields })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::ScalarType;

    #[test]
    fn points_come_before_cells() {
        let all = |names: &[(&str, u32)]| -> Vec<FieldInfo> {
            let field = |&(name, components): &(&str, u32)| FieldInfo {
                name: name.into(),
                scalar: ScalarType::F32,
                components,
            };
            names.iter().map(field).collect()
        };
        let one = |points: &[(&str, u32)], cells: &[(&str, u32)], wanted, active| {
            let picked = pick(Path::new("a"), all(points), all(cells), wanted, |_| active);
            picked.ok().map(|p| (p.center, p.index, p.fields.len()))
        };
        let (points, cells) = ([("v", 3), ("a", 1)], [("a", 1), ("b", 1)]);
        assert_eq!(one(&points, &cells, None, None), Some((Center::Point, 1, 4)));
        assert_eq!(one(&points, &cells, Some("a"), None), Some((Center::Point, 1, 4)));
        assert_eq!(one(&points, &cells, Some("b"), Some("a")), Some((Center::Cell, 1, 4)));
        assert_eq!(one(&points, &cells, Some("c"), None), None);
        assert_eq!(one(&points[..1], &cells, None, None), None, "several");
        assert_eq!(one(&points[..1], &cells, None, Some("b")), Some((Center::Cell, 1, 3)));
        assert_eq!(one(&points[..1], &cells[..1], None, Some("v")), Some((Center::Cell, 0, 2)));
        assert_eq!(one(&points[..1], &[], None, None), None, "a vector");
    }

    #[test]
    fn cells_lie_between_points() {
        assert_eq!(samples([4, 1, 2], Center::Cell), [3, 1, 1]);
        assert_eq!(samples([4, 1, 2], Center::Point), [4, 1, 2]);
        assert_eq!(first_sample([4, 1, 2], Center::Cell), [0.5, 0.0, 0.5]);
        assert_eq!(first_sample([4, 1, 2], Center::Point), [0.0; 3]);
        assert_eq!(along_axis(vec![1.0, 2.0, 4.0], Center::Cell), [1.5, 3.0]);
        assert_eq!(along_axis(vec![1.0], Center::Cell), [1.0]);
        assert_eq!(along_axis(vec![1.0, 2.0], Center::Point), [1.0, 2.0]);
    }

    /// Numbers from a list.
    struct Listed(std::vec::IntoIter<f64>);

    impl NumberStream for Listed {
        fn fill(&mut self, out: &mut [f64]) -> Result<()> {
            out.iter_mut().for_each(|slot| *slot = self.0.next().expect("as many as there are"));
            Ok(())
        }

        fn finish(&mut self) -> Result<()> {
            assert!(self.0.next().is_none(), "all were read");
            Ok(())
        }
    }

    #[test]
    fn middles_are_means_of_corners() {
        for dims in [[4, 3, 3], [4, 3, 2], [1, 3, 2], [4, 1, 2], [4, 3, 1], [2, 1, 1], [1, 1, 1]] {
            let cells = samples(dims, Center::Cell);
            let each = |dims: [u64; 3]| {
                let plane = move |z| (0..dims[1]).flat_map(move |y| (0..dims[0]).map(move |x| [x, y, z]));
                (0..dims[2]).flat_map(plane)
            };
            // Sheared, and uneven along x.
            let place = |[x, y, z]: [f64; 3]| [x * x + y, 2.0 * y - z, 10.0 * z];
            let points: Vec<f64> = each(dims).flat_map(|p| place(p.map(|n| n as f64))).collect();
            let mut middles = Middles::new(Box::new(Listed(points.into_iter())), dims);
            let first = first_sample(dims, Center::Cell);
            for cell in each(cells) {
                let [mx, y, z]: [f64; 3] = std::array::from_fn(|a| cell[a] as f64 + first[a]);
                let ends = [mx - first[0], mx + first[0]];
                let mean = 0.5 * (ends[0] * ends[0] + ends[1] * ends[1]);
                let mut found = [0.0; 3];
                middles.fill(&mut found).unwrap();
                assert_eq!(found, [mean + y, 2.0 * y - z, 10.0 * z], "{dims:?} {cell:?}");
            }
            middles.finish().unwrap();
        }
    }
}
