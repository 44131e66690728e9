//! Reads the coordinates of rectilinear and curvilinear grids. Their samples are read as those of a
//! volume.

use crate::cells::NumberStream;
use crate::error::{Error, Result};
use std::path::Path;

/// Where the samples of a grid are.
pub enum GridCoordinates {
    /// Tables of x, y and z.
    Axes([Vec<f64>; 3]),
    /// x, y, z of each sample, x fastest.
    Points(Box<dyn NumberStream>),
}

/// The grid of tables of coordinates along x, y, z, where the samples of an array of that name have
/// them.
///
/// # Errors
/// [`Error::BadInput`] where those of an axis neither rise nor fall throughout.
pub(in crate::formats) fn rectilinear(
    path: &Path,
    name: &str,
    lines: [Option<Vec<f64>>; 3],
    dims: [u64; 3],
) -> Result<GridCoordinates> {
    tables(path, name, lines, dims).map(GridCoordinates::Axes)
}

/// The tables of such a grid.
///
/// # Errors
/// Those of [`rectilinear`].
pub(in crate::formats) fn tables(
    path: &Path,
    name: &str,
    lines: [Option<Vec<f64>>; 3],
    dims: [u64; 3],
) -> Result<[Vec<f64>; 3]> {
    let mut axes: [Vec<f64>; 3] = Default::default();
    for (a, line) in lines.into_iter().enumerate() {
        // An axis without coordinates has the numbers of its samples.
        let values = line.unwrap_or_else(|| (0..dims[a]).map(|i| i as f64).collect());
        let falls = values.windows(2).all(|w| w[1] < w[0]);
        if !falls && !values.windows(2).all(|w| w[1] > w[0]) {
            let at = format!("{name}, coordinates along {}", ["x", "y", "z"][a]);
            let expected = "numbers that rise or fall throughout";
            return Err(Error::bad_input(path, at, expected, "others")
                .with_help("correct the coordinate variable, or write the array without it"));
        }
        axes[a] = values;
    }
    Ok(axes)
}

/// Start and step of numbers that are regular to a thousandth of a step or, with `single`
/// precision, within their rounding.
pub(in crate::formats) fn regular(values: &[f64], single: bool) -> Option<(f64, f64)> {
    let (first, last) = (*values.first()?, *values.last()?);
    let step = if values.len() == 1 { 1.0 } else { (last - first) / (values.len() - 1) as f64 };
    let largest = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let rounding = if single { largest * f64::from(f32::EPSILON) } else { 0.0 };
    let near = (1e-3 * step.abs()).max(rounding.min(0.05 * step.abs()));
    let near = |(i, v): (usize, &f64)| (v - (first + i as f64 * step)).abs() <= near;
    let good = first.is_finite() && step.is_finite() && step != 0.0 && values.iter().enumerate().all(near);
    good.then_some((first, step))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_regular_or_not() {
        assert_eq!(regular(&[1.0, 3.0, 5.0], false), Some((1.0, 2.0)));
        assert_eq!(regular(&[4.0], false), Some((4.0, 1.0)));
        // Longitudes of single precision, 0.01 degrees apart, are even as far as they go.
        let fine: Vec<f64> = (0..36000).map(|i| f64::from(i as f32 * 0.01)).collect();
        assert!(regular(&fine, false).is_none() && regular(&fine, true).is_some());
        for bad in [&[][..], &[1.0, 1.0], &[1.0, 2.0, 4.0], &[f64::NAN, 1.0], &[0.0, f64::INFINITY]] {
            assert_eq!(regular(bad, false), None, "{bad:?}");
        }
    }
}
