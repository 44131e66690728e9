//! Images of MINC, of version 1 (NetCDF-3) and 2 (HDF5).
//!
//! ```text
//!  xspace, yspace, zspace           start, step, direction_cosines, units: where samples lie
//!  image                            stored numbers; valid_range, signtype
//!  image-min, image-max             the values of the ends of the valid range: one pair for all,
//!                                   or one for each slice or row, of each volume
//!  time                             start, step and units, or all times: an axis of the image
//! ```

use super::cf::{Convert, MOST_COORDINATES};
use super::header::geometry;
use crate::error::{Error, Result};
use crate::grid::Geometry;
use crate::volume::units::{Unit, Units, common};
use crate::volume::{Assumed, ScalarType};
use std::path::Path;

/// The axes of space, in the order x, y, z.
const SPACE: [&str; 3] = ["xspace", "yspace", "zspace"];

/// The axis of time.
const TIME: &str = "time";

/// What each axis of an image is: 't' of time, '?' of others, which its names tell.
pub(in crate::formats) fn kinds(axes: &[String], rank: usize) -> Vec<char> {
    (0..rank).map(|axis| if axes.get(axis).is_some_and(|name| name == TIME) { 't' } else { '?' }).collect()
}

/// The variables of a MINC file, by their names in MINC.
pub(in crate::formats) trait Variables {
    fn path(&self) -> &Path;

    /// A variable's place in the file, for messages.
    fn place(&self, variable: &str) -> String;

    /// The text of an attribute; "" where there is no such text.
    fn text(&self, variable: &str, attribute: &str) -> String;

    /// The numbers of an attribute; `None` where there are none of this name.
    fn numbers(&self, variable: &str, attribute: &str) -> Option<Vec<f64>>;

    /// The sizes of a variable of at most two axes and `most` numbers, and these numbers; `None` of
    /// others.
    ///
    /// # Errors
    /// When it is not there, or cannot be read.
    fn table(&self, variable: &str, most: u64) -> Result<Option<(Vec<u64>, Vec<f64>)>>;
}

/// How an image is stored.
pub(in crate::formats) struct Stored<'a> {
    /// The names of its axes, slowest first.
    pub(in crate::formats) axes: &'a [String],
    pub(in crate::formats) shape: &'a [u64],
    pub(in crate::formats) scalar: ScalarType,
    /// The entry of the axis of time, where there is one.
    pub(in crate::formats) moment: Option<u64>,
}

impl Stored<'_> {
    /// The axis of time.
    fn time(&self) -> Option<usize> {
        self.axes.iter().position(|name| name == TIME)
    }

    /// The names of the axes of one volume.
    fn of_volume(&self) -> Vec<&String> {
        self.axes.iter().filter(|name| *name != TIME).collect()
    }
}

/// What a file says of its image.
pub(in crate::formats) struct Image {
    pub(in crate::formats) geometry: Geometry,
    /// How stored numbers become values, where they are not values themselves.
    pub(in crate::formats) convert: Option<Convert>,
    pub(in crate::formats) units: Units,
    /// Axes without a step.
    pub(in crate::formats) assumed: Assumed,
}

/// Reads what a file says of its image.
///
/// # Errors
/// [`Error::BadInput`] for other axes than those of space, irregular ones, and ranges that are
/// none.
pub(in crate::formats) fn image(file: &impl Variables, stored: &Stored<'_>) -> Result<Image> {
    let axes = stored.of_volume();
    let is_space = axes.len() == 3 && SPACE.iter().all(|n| axes.iter().any(|a| a == n));
    if !is_space || stored.shape.len() != stored.axes.len() {
        let got = format!("'{}'", stored.axes.join(","));
        return Err(bad(file, "dimorder", "xspace, yspace and zspace in some order, and maybe time", got));
    }
    let (mut columns, mut origin, mut lengths) = ([[0.0; 3]; 3], [0.0; 3], vec![]);
    let mut assumed = [false; 3];
    for (n, name) in axes.into_iter().enumerate() {
        let axis = axis(file, name)?;
        // The last name is the fastest axis, our x.
        columns[2 - n] = axis.direction.map(|d| d * axis.step.unwrap_or(1.0));
        assumed[2 - n] = axis.step.is_none();
        lengths.push(axis.unit);
        for (o, d) in origin.iter_mut().zip(axis.direction) {
            *o += d * axis.start;
        }
    }
    if lengths.iter().any(|unit| *unit != lengths[0]) {
        let shown = |unit: &Option<Unit>| unit.as_ref().map_or("none", Unit::as_str).to_owned();
        let got = lengths.iter().map(shown).collect::<Vec<_>>().join(", ");
        return Err(bad(file, "units of the dimensions", "one unit for all", got));
    }
    let geometry = geometry(file.path(), "start, step and direction_cosines", origin, columns)?;
    let convert = if stored.scalar.is_float() { None } else { Some(slices(file, stored)?) };
    let value = Unit::new(&file.text("image", "units"));
    let time = stored.time().and_then(|_| Unit::time(&file.text(TIME, "units")));
    let units = Units { value, time, length: common(lengths) };
    Ok(Image { geometry, convert, units, assumed: Assumed::in_header(assumed) })
}

/// The times of the `count` volumes of a file, where it tells them.
pub(in crate::formats) fn times(file: &impl Variables, count: u64) -> Option<Vec<f64>> {
    if file.text(TIME, "spacing").starts_with("irregular") {
        let (_, times) = file.table(TIME, MOST_COORDINATES).ok()??;
        return Some(times).filter(|times| times.len() as u64 == count);
    }
    let one = |key: &str| file.numbers(TIME, key).and_then(|v| v.first().copied());
    let (start, step) = (one("start").unwrap_or(0.0), one("step").filter(|step| *step > 0.0)?);
    Some((0..count).map(|n| start + n as f64 * step).collect())
}

fn bad(file: &impl Variables, what: &str, expected: &str, got: String) -> Error {
    Error::bad_input(file.path(), format!("{}, {what}", file.place("image")), expected, got)
        .with_help("convert it: mnc2nii, or mincresample to regular axes")
}

struct MincAxis {
    start: f64,
    step: Option<f64>,
    direction: [f64; 3],
    unit: Option<Unit>,
}

/// An axis of an image.
fn axis(file: &impl Variables, name: &str) -> Result<MincAxis> {
    if file.text(name, "spacing").starts_with("irregular") {
        return Err(Error::bad_input(file.path(), file.place(name), "regular spacing", "irregular spacing")
            .with_help("resample it to regular axes (mincresample)"));
    }
    let one = |key: &str| file.numbers(name, key).and_then(|v| v.first().copied());
    let own = SPACE.map(|axis| if axis == name { 1.0 } else { 0.0 });
    let direction = file.numbers(name, "direction_cosines").map_or(Ok(own), |v| {
        <[f64; 3]>::try_from(v).map_err(|v| {
            let (at, got) =
                (format!("{}, direction_cosines", file.place(name)), format!("{} of them", v.len()));
            Error::bad_input(file.path(), at, "three numbers", got)
        })
    })?;
    let unit = Unit::length(&file.text(name, "units"));
    Ok(MincAxis { start: one("start").unwrap_or(0.0), step: one("step"), direction, unit })
}

/// The stored numbers that have values.
fn valid_range(file: &impl Variables, scalar: ScalarType) -> Result<[f64; 2]> {
    let bits = 8 * scalar.bytes() as i32;
    let half = libm::exp2(f64::from(bits - 1));
    let full = match scalar {
        ScalarType::U8 | ScalarType::U16 | ScalarType::U32 | ScalarType::U64 => [0.0, 2.0 * half - 1.0],
        _ => [-half, half - 1.0],
    };
    let end = |name: &str, usual: f64| {
        file.numbers("image", name).and_then(|v| v.first().copied()).unwrap_or(usual)
    };
    let valid = match file.numbers("image", "valid_range") {
        Some(valid) => valid,
        None => vec![end("valid_min", full[0]), end("valid_max", full[1])],
    };
    match valid[..] {
        [a, b] if a < b => Ok([a, b]),
        _ => Err(bad(file, "valid_range", "two numbers, the first the lesser", format!("{valid:?}"))),
    }
}

/// The lines from stored integers to values: the valid range is stretched to `image-min` …
/// `image-max` of each slice.
fn slices(file: &impl Variables, stored: &Stored<'_>) -> Result<Convert> {
    let valid = valid_range(file, stored.scalar)?;
    let table = |name: &str| -> Result<(Vec<u64>, Vec<f64>)> {
        let found = file.table(name, MOST_COORDINATES)?;
        let of_slices = found.filter(|(own, _)| stored.shape.starts_with(own)).map(|t| of_moment(stored, t));
        of_slices.ok_or_else(|| {
            bad(file, name, "one number, one a slice, or one a row", "another number of them".into())
        })
    };
    let ((shape, least), (other, most)) = (table("image-min")?, table("image-max")?);
    if shape != other || least.len() != most.len() {
        let got = format!("{} and {} axes", shape.len(), other.len());
        return Err(bad(file, "image-min, image-max", "as many of either", got));
    }
    let line = |(lo, hi): (&f64, &f64)| {
        let slope = (hi - lo) / (valid[1] - valid[0]);
        [slope, lo - slope * valid[0]]
    };
    let lines: Vec<[f64; 2]> = least.iter().zip(&most).map(line).collect();
    if let Some(wrong) = lines.iter().position(|l| !l[0].is_finite() || !l[1].is_finite()) {
        let got = format!("{} and {}", least[wrong], most[wrong]);
        return Err(bad(file, "image-min, image-max", "finite numbers", got));
    }
    let slices = [shape.get(1).copied().unwrap_or(1), shape.first().copied().unwrap_or(1)];
    Ok(Convert { valid, missing: vec![], lines, slices })
}

/// The part of a table of the first axes of an image that is of one moment.
fn of_moment(stored: &Stored<'_>, (mut shape, numbers): (Vec<u64>, Vec<f64>)) -> (Vec<u64>, Vec<f64>) {
    let found = stored.time().filter(|&axis| axis < shape.len());
    let (Some(axis), Some(moment)) = (found, stored.moment) else { return (shape, numbers) };
    let (inner, count) = (shape[axis + 1..].iter().product::<u64>(), shape[axis]);
    shape.remove(axis);
    let is_of_it = |(n, _): &(usize, f64)| *n as u64 / inner.max(1) % count.max(1) == moment;
    (shape, numbers.into_iter().enumerate().filter(is_of_it).map(|(_, number)| number).collect())
}
