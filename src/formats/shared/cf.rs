//! What the axes, attributes and coordinate variables of an array mean, by the CF conventions:
//! common to HDF5, NetCDF and Zarr.
//!
//! ```text
//!  temp(time, lev, lat, lon)        three axes are a volume, that of time has its frames: see [`layout`]
//!    scale_factor, add_offset       value = scale_factor · stored + add_offset
//!    _FillValue, missing_value      the stored number that means "no data"
//!    valid_range, valid_min, …      what is outside has no value
//!  lat(lat), lon(lon), …            coordinates: spacing and origin, or a rectilinear grid
//! ```

use super::axes::{Layout, layout};
use super::coordinates::{GridCoordinates, rectilinear, regular};
use super::header::geometry;
use super::lengths::Lengths;
use super::{Frames, OpenOptions};
use crate::error::{Error, Result};
use crate::grid::Geometry;
use crate::volume::units::{Unit, Units};
use crate::volume::{FieldInfo, ScalarType, VolumeInfo};
use std::collections::HashMap;
use std::path::Path;

/// Most frames of an array with four axes.
const MOST_FRAMES: u64 = 1 << 16;
/// The most samples of a coordinate variable that is read.
pub(in crate::formats) const MOST_COORDINATES: u64 = 1 << 24;

/// The numbers of an attribute.
pub(in crate::formats) struct Numbers {
    pub(in crate::formats) values: Vec<f64>,
    /// Whether they are stored as floats.
    pub(in crate::formats) are_floats: bool,
}

/// The attributes of an array.
pub(in crate::formats) trait Attributes {
    /// The numbers of an attribute; `None` where there is none of this name.
    ///
    /// # Errors
    /// [`Error::BadInput`] where it has no numbers.
    fn numbers(&self, name: &str) -> Result<Option<Numbers>>;

    /// The error of attributes that say something else than what is expected.
    fn wrong(&self, names: &str, expected: &str, got: String) -> Error;

    /// An attribute that is one number; `None` where there is none of this name.
    ///
    /// # Errors
    /// [`Error::BadInput`] where it is not one number.
    fn number(&self, name: &str) -> Result<Option<f64>> {
        let Some(Numbers { values, .. }) = self.numbers(name)? else { return Ok(None) };
        match values[..] {
            [value] => Ok(Some(value)),
            _ => Err(self.wrong(name, "one number", format!("{} values", values.len()))),
        }
    }
}

/// What attributes say about stored numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::formats) struct Packing {
    pub(in crate::formats) slope: f64,
    pub(in crate::formats) intercept: f64,
    /// The stored number that means "no data".
    pub(in crate::formats) missing: Option<f64>,
    /// The stored numbers that have values, where there is such a range.
    pub(in crate::formats) valid: Option<[f64; 2]>,
}

impl Packing {
    /// What the attributes of an array of this type say. `usual` gives the stored number that means
    /// "no data" where no attribute names one, for numbers that are packed or not.
    ///
    /// # Errors
    /// [`Error::BadInput`] for attributes that contradict each other, or are not numbers.
    pub(in crate::formats) fn of(
        attributes: &impl Attributes,
        scalar: ScalarType,
        usual: impl FnOnce(bool) -> Option<f64>,
    ) -> Result<Self> {
        let (scale, offset) = (attributes.number("scale_factor")?, attributes.number("add_offset")?);
        let (slope, intercept) = (scale.unwrap_or(1.0), offset.unwrap_or(0.0));
        if !(slope.is_finite() && slope != 0.0 && intercept.is_finite()) {
            let expected = "finite numbers, the first not 0";
            let got = format!("{slope} and {intercept}");
            return Err(attributes.wrong("scale_factor, add_offset", expected, got));
        }
        let missing = match [attributes.number("_FillValue")?, attributes.number("missing_value")?] {
            [None, None] => usual(scale.is_some() || offset.is_some()),
            [Some(a), Some(b)] if a != b && !a.is_nan() && !b.is_nan() => {
                let got = format!("{a} and {b}");
                return Err(attributes
                    .wrong("_FillValue, missing_value", "one value", got)
                    .with_help("replace the one by the other, and delete its attribute"));
            }
            both => both.into_iter().flatten().find(|v| !v.is_nan()),
        };
        // What is not a number is missing anyway.
        let missing = missing.filter(|v| !v.is_nan());
        let valid = valid_range(attributes, scalar, [slope, intercept])?;
        Ok(Self { slope, intercept, missing, valid })
    }

    /// The conversion of stored numbers where some have no value by their range; else `None`, and
    /// `info` has all of it.
    pub(in crate::formats) fn into_info(self, info: &mut VolumeInfo) -> Option<Convert> {
        let Self { slope, intercept, missing, valid } = self;
        let Some(valid) = valid else {
            (info.slope, info.intercept, info.missing) = (slope, intercept, missing);
            return None;
        };
        Some(Convert { valid, missing, lines: vec![[slope, intercept]], slices: [1, 1] })
    }

    /// Applies slope and intercept to the numbers of a coordinate variable.
    pub(in crate::formats) fn unpack(&self, numbers: &mut [f64]) {
        numbers.iter_mut().for_each(|v| *v = self.slope * *v + self.intercept);
    }
}

/// The value of samples that were never written, in the library of NetCDF.
#[allow(clippy::excessive_precision)]
pub(in crate::formats) fn netcdf_fill(scalar: ScalarType) -> Option<f64> {
    Some(match scalar {
        // Every byte may be a value.
        ScalarType::I8 | ScalarType::U8 => return None,
        ScalarType::I16 => -32767.0,
        ScalarType::U16 => 65535.0,
        ScalarType::I32 => -2_147_483_647.0,
        ScalarType::U32 => 4_294_967_295.0,
        ScalarType::I64 => -9_223_372_036_854_775_806.0,
        ScalarType::U64 => 18_446_744_073_709_551_614.0,
        ScalarType::F16 | ScalarType::F32 | ScalarType::F64 => 9.969_209_968_386_869_047e36,
    })
}

/// The range of stored numbers that have values.
fn valid_range(
    attributes: &impl Attributes,
    scalar: ScalarType,
    [slope, intercept]: [f64; 2],
) -> Result<Option<[f64; 2]>> {
    let all = [f64::NEG_INFINITY, f64::INFINITY];
    let (mut valid, mut are_floats) = (all, false);
    for (name, at, count) in [("valid_range", 0, 2), ("valid_min", 0, 1), ("valid_max", 1, 1)] {
        let Some(numbers) = attributes.numbers(name)? else { continue };
        if numbers.values.len() != count {
            let got = format!("{} of them", numbers.values.len());
            return Err(attributes.wrong(name, &format!("{count} number(s)"), got));
        }
        valid[at..at + count].copy_from_slice(&numbers.values);
        are_floats |= numbers.are_floats;
    }
    if valid == all {
        return Ok(None);
    }
    // Where packed integers have a range of floats, it is that of the values.
    if !scalar.is_float() && are_floats {
        valid = valid.map(|v| (v - intercept) / slope);
        valid.sort_by(f64::total_cmp);
    }
    Ok(Some(valid))
}

/// How stored numbers become values. What is outside of `valid` has none.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::formats) struct Convert {
    pub(in crate::formats) valid: [f64; 2],
    /// Stored number that means no data.
    pub(in crate::formats) missing: Option<f64>,
    /// Slope and intercept of each slice along the slowest axes.
    pub(in crate::formats) lines: Vec<[f64; 2]>,
    /// Slices of the lines along y and z: 1 where they do not differ along it.
    pub(in crate::formats) slices: [u64; 2],
}

impl Convert {
    /// The value of a stored number of a row.
    pub(in crate::formats) fn value(&self, stored: f64, [y, z]: [u64; 2]) -> f64 {
        let [lo, hi] = self.valid;
        if !(lo..=hi).contains(&stored) || self.missing == Some(stored) {
            return f64::NAN;
        }
        let at = |n: u64, count: u64| if count == 1 { 0 } else { n };
        let [slope, intercept] =
            self.lines[(at(z, self.slices[1]) * self.slices[0] + at(y, self.slices[0])) as usize];
        slope * stored + intercept
    }
}

/// The kind of an axis with this name: x, y, z, t (time), c (channels, components), or '?'.
pub(in crate::formats) fn kind_of_name(name: &str) -> char {
    match name.rsplit('/').next().unwrap_or(name).to_ascii_lowercase().as_str() {
        "x" | "lon" | "longitude" => 'x',
        "y" | "lat" | "latitude" => 'y',
        "z" | "lev" | "level" | "depth" | "height" | "altitude" | "plev" => 'z',
        "t" | "time" => 't',
        "c" | "channel" | "channels" | "component" | "components" | "band" | "rgb" => 'c',
        _ => '?',
    }
}

/// What an axis with a coordinate variable is, by the variable's attributes, else by its name.
pub(in crate::formats) fn kind_of_coordinate(name: &str, axis: &str, units: &str) -> char {
    match axis {
        "X" => 'x',
        "Y" => 'y',
        "Z" => 'z',
        "T" => 't',
        _ if units.contains(" since ") => 't',
        _ if ["degrees_east", "degree_east", "degrees_E"].contains(&units) => 'x',
        _ if ["degrees_north", "degree_north", "degrees_N"].contains(&units) => 'y',
        _ => kind_of_name(name),
    }
}

/// What the units of a variable, of lengths and of its coordinates of time say.
pub(in crate::formats) fn units(value: &str, lengths: &Lengths, time: Option<String>) -> Units {
    let length = lengths.unit.clone();
    Units { value: Unit::new(value), length, time: time.and_then(|unit| Unit::time(&unit)) }
}

/// The lengths along x, y and z of the world, by the units of the coordinates along an array's last
/// three axes. Degrees are no lengths.
pub(in crate::formats) fn lengths(of_axes: [Option<String>; 3], world: [usize; 3]) -> Lengths {
    let mut units = [None, None, None];
    for (unit, axis) in of_axes.into_iter().zip(world) {
        units[axis] = unit.and_then(|unit| Unit::length(&unit));
    }
    let mut found = Lengths::of_any(units);
    found.unit = found.unit.filter(|unit| !unit.as_str().starts_with("degree"));
    found
}

/// Coordinates along an array's last three axes, as lengths in one unit.
pub(in crate::formats) fn in_one_unit(
    lines: [Option<Line>; 3],
    lengths: &Lengths,
    world: [usize; 3],
) -> [Option<Line>; 3] {
    let mut axes = world.into_iter();
    lines.map(|line| {
        let axis = axes.next().unwrap_or(0);
        line.map(|line| if lengths.is_as_stated(axis) { line } else { line.map(|v| lengths.along(axis, v)) })
    })
}

/// A volume of an array: three axes, at one entry of each other axis.
#[derive(Clone, Debug)]
pub(in crate::formats) struct Part {
    pub(in crate::formats) info: FieldInfo,
    /// The name of the array.
    pub(in crate::formats) array: String,
    /// The axes of the volume, the last one first.
    pub(in crate::formats) axes: [usize; 3],
    /// The entry of each axis; 0 of those of the volume.
    pub(in crate::formats) entries: Vec<u64>,
    /// The channel, where the array has several.
    pub(in crate::formats) channel: Option<u64>,
    /// The axis whose entries are frames, where it is one of several frames.
    pub(in crate::formats) frames: Option<usize>,
    /// The axis of the world along which each axis of the volume lies.
    pub(in crate::formats) world: [usize; 3],
}

impl Part {
    /// Whether it is one of several channels.
    pub(in crate::formats) fn is_channel(&self) -> bool {
        self.channel.is_some()
    }

    /// Whether it is one of several frames.
    pub(in crate::formats) fn is_frame(&self) -> bool {
        self.frames.is_some()
    }

    /// Samples along the axes of the volume, given those of the array.
    pub(in crate::formats) fn dims(&self, shape: &[u64]) -> [u64; 3] {
        self.axes.map(|axis| shape[axis])
    }
}

/// What a convention says about arrays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats) enum Rules {
    /// Nothing: names count, and the first of four axes has frames or channels.
    Plain,
    /// Volumes of three axes alone, as those of MINC in HDF5.
    #[cfg_attr(not(feature = "hdf5"), expect(dead_code, reason = "MINC is HDF5"))]
    Volumes,
    /// Volumes, and vectors whose components are the last of four axes.
    Vectors,
}

/// The volumes of an array with three axes or more, given their sizes and kinds.
///
/// # Errors
/// [`Error::BadInput`] for axes that are not understood.
pub(in crate::formats) fn parts_of(
    path: &Path,
    name: &str,
    (shape, kinds): (&[u64], &[char]),
    scalar: ScalarType,
    rules: Rules,
) -> Result<Vec<Part>> {
    let refuse = |expected: &str| {
        let axis =
            |(n, kind): (&u64, &char)| if *kind == '?' { n.to_string() } else { format!("{n} ({kind})") };
        let got: Vec<String> = shape.iter().zip(kinds).map(axis).collect();
        Error::bad_input(path, name, expected, got.join(" x "))
            .with_help("write the part that is wanted to a dataset of its own, its axes z, y, x")
    };
    if let Some(vectors) = vectors(name, (shape, kinds), scalar, rules) {
        return Ok(vec![vectors]);
    }
    let Layout { space, series, channels } = layout(shape, kinds).map_err(refuse)?;
    let count = |axis: Option<usize>| axis.map_or(1, |axis| shape[axis]);
    let all = count(series).checked_mul(count(channels)).filter(|&all| all <= MOST_FRAMES);
    if all.is_none() || rules != Rules::Plain && all != Some(1) {
        let expected = "three axes of space, and others of at most 65536 frames and channels";
        return Err(refuse(if rules == Rules::Plain { expected } else { "three axes" }));
    }
    let numbers = |axis: Option<usize>| -> Vec<Option<u64>> {
        axis.map_or_else(|| vec![None], |axis| (0..shape[axis]).map(Some).collect())
    };
    let mut parts = vec![];
    for channel in numbers(channels) {
        for frame in numbers(series) {
            let mut entries = vec![0; shape.len()];
            for (axis, number) in [(channels, channel), (series, frame)] {
                if let (Some(axis), Some(number)) = (axis, number) {
                    entries[axis] = number;
                }
            }
            let of_channel = channel.map_or(String::new(), |c| format!(":c{c}"));
            let of_frame = frame.map_or(String::new(), |t| format!(":t{t}"));
            let name_of_part = format!("{name}{of_channel}{of_frame}");
            let info = FieldInfo { name: name_of_part, scalar, components: 1 };
            let (array, world) = (name.into(), world_of(space.map(|axis| kinds[axis])));
            parts.push(Part { info, array, axes: space, entries, channel, frames: series, world });
        }
    }
    Ok(parts)
}

/// The axes of the world of three axes of these kinds: x, y, z by their names, else in this order.
fn world_of(kinds: [char; 3]) -> [usize; 3] {
    let places = kinds.map(|kind| ['x', 'y', 'z'].iter().position(|&k| k == kind));
    let are_all = (0..3).all(|axis| places.contains(&Some(axis)));
    if are_all { places.map(|place| place.unwrap_or(0)) } else { [0, 1, 2] }
}

/// The field of an array of vectors, or of colours, which are the last of its axes.
fn vectors(name: &str, (shape, kinds): (&[u64], &[char]), scalar: ScalarType, rules: Rules) -> Option<Part> {
    let rank = shape.len();
    let is_named = rules == Rules::Plain && kinds.iter().any(|&kind| kind != '?');
    let is_short = rank == 4 && shape[3] <= 4 && shape[1] > 4 && shape[2] > 4 && !is_named;
    let is_told = rank == 4 && rules == Rules::Vectors || rules != Rules::Plain && kinds[rank - 1] == 'c';
    if rank < 4 || shape[rank - 1] < 2 || !(is_short || is_told) {
        return None;
    }
    let components = u32::try_from(shape[rank - 1]).unwrap_or(u32::MAX);
    let info = FieldInfo { name: name.into(), scalar, components };
    let (axes, entries) = ([rank - 2, rank - 3, rank - 4], vec![0; rank]);
    Some(Part { info, array: name.into(), axes, entries, channel: None, frames: None, world: [0, 1, 2] })
}

/// The name of the field that is asked for, with the channel.
///
/// # Errors
/// [`Error::Usage`] for a channel where there is none, or where several arrays have some.
pub(in crate::formats) fn with_channel<'a>(
    path: &Path,
    options: &OpenOptions,
    parts: impl Iterator<Item = &'a Part>,
) -> Result<Option<String>> {
    let Some(channel) = &options.channel else { return Ok(options.field.clone()) };
    let number = channel.strip_prefix('c').unwrap_or(channel);
    let usage = |text: String| Err(Error::usage(format!("{}: {text}", path.display())));
    if let Some(field) = &options.field {
        return match field.rsplit_once(":c") {
            Some((_, of_field)) if of_field.split(':').next() != Some(number) => {
                usage(format!("{field} is another channel than --channel {channel}"))
            }
            Some(_) => Ok(Some(field.clone())),
            None => Ok(Some(format!("{field}:c{number}"))),
        };
    }
    let mut arrays: Vec<&str> = parts.filter(|p| p.is_channel()).map(|p| p.array.as_str()).collect();
    arrays.dedup();
    match arrays[..] {
        [] => usage("no dataset has channels: leave out --channel".into()),
        [array] => Ok(Some(format!("{array}:c{number}"))),
        _ => {
            usage(format!("several datasets have channels ({}): choose one with --field", arrays.join(", ")))
        }
    }
}

/// The frames of the array that has `first`, by the names of their fields, and their times, where
/// all of them have one. Without a choice, none where the file has other fields too.
pub(in crate::formats) fn frames<'a>(
    parts: impl Iterator<Item = &'a Part> + Clone,
    first: &Part,
    is_chosen: bool,
    times: Option<Vec<f64>>,
) -> Frames {
    let all = parts.clone().count();
    let is_of_it = |p: &&Part| p.array == first.array && p.channel == first.channel;
    let frames: Vec<&Part> = parts.filter(is_of_it).collect();
    if !is_chosen && (frames.len() != all || all == 1) {
        return vec![];
    }
    let times = times.filter(|t| t.len() == frames.len() && t.iter().all(|t| t.is_finite()));
    let time = |n: usize| times.as_ref().map(|t| t[n]);
    frames.iter().enumerate().map(|(n, p)| (p.info.name.clone(), time(n))).collect()
}

/// The times of all frames by the names of their fields, given those of each array that has some.
pub(in crate::formats) fn times<'a, P: AsRef<Part> + 'a>(
    parts: impl Iterator<Item = &'a P>,
    mut of_array: impl FnMut(&P) -> Option<Vec<f64>>,
) -> HashMap<String, f64> {
    let (mut out, mut last) = (HashMap::new(), (String::new(), None));
    for of_file in parts {
        let part = of_file.as_ref();
        let Some(axis) = part.frames else { continue };
        if last.0 != part.array {
            last = (part.array.clone(), of_array(of_file));
        }
        let time = last.1.as_ref().and_then(|t| t.get(part.entries[axis] as usize));
        out.extend(time.filter(|t| t.is_finite()).map(|&t| (part.info.name.clone(), t)));
    }
    out
}

/// The coordinates along an axis.
pub(in crate::formats) struct Line {
    pub(in crate::formats) values: Vec<f64>,
    /// Start and step, where they are regular.
    pub(in crate::formats) regular: Option<(f64, f64)>,
}

impl Line {
    /// Coordinates of double or single precision.
    pub(in crate::formats) fn new(values: Vec<f64>, single: bool) -> Self {
        Self { regular: regular(&values, single), values }
    }

    /// The same in another unit.
    fn map(self, unit: impl Fn(f64) -> f64) -> Self {
        let regular = self.regular.map(|(start, step)| (unit(start), unit(step)));
        Self { values: self.values.into_iter().map(unit).collect(), regular }
    }
}

/// Spacing, origin and directions by the coordinates along the axes, where all are regular; where
/// others are not, see [`grid_of`]. Axes without coordinates have the `usual` spacing.
///
/// # Errors
/// [`Error::BadInput`] for coordinates that do not span space.
pub(in crate::formats) fn placed(
    path: &Path,
    lines: &[Option<Line>; 3],
    world: [usize; 3],
    usual: [f64; 3],
) -> Result<Geometry> {
    if lines.iter().flatten().any(|l| l.regular.is_none()) {
        return Ok(Geometry::default());
    }
    let (mut origin, mut columns) = ([0.0; 3], [[0.0; 3]; 3]);
    for (a, line) in lines.iter().enumerate() {
        let along = line.as_ref().and_then(|l| l.regular);
        let (start, step) = along.unwrap_or((0.0, usual[a]));
        (origin[world[a]], columns[a][world[a]]) = (start, step);
    }
    geometry(path, "coordinate variables", origin, columns)
}

/// The coordinates of an array along its axes, where those of one of them are not regular; else
/// `None`.
///
/// # Errors
/// [`Error::BadInput`] where they neither rise nor fall throughout, or the axes have another order.
pub(in crate::formats) fn grid_of(
    path: &Path,
    name: &str,
    lines: [Option<Line>; 3],
    world: [usize; 3],
    dims: [u64; 3],
) -> Result<Option<GridCoordinates>> {
    if lines.iter().flatten().all(|l| l.regular.is_some()) {
        return Ok(None);
    }
    if world != [0, 1, 2] {
        let expected = "axes in the order z, y, x where coordinates are not evenly spaced";
        return Err(Error::bad_input(path, format!("{name}, axes"), expected, "another order")
            .with_help("write the dataset again in the order z, y, x"));
    }
    rectilinear(path, name, lines.map(|l| l.map(|l| l.values)), dims).map(Some)
}
