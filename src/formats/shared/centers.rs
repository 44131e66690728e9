//! Fields of an image that has both values at its points and values of the cells between them.
//!
//! ```text
//!  points  0───1───2───3     n of them along an axis, the first at the origin
//!  cells     0   1   2       n - 1, the first half a step from it: a cell's value is a sample in its middle
//! ```
//!
//! An image that is one point thick has cells that are just as thin.

use super::pick_field;
use crate::cells::Center;
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
    }
}
