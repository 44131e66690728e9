//! What the axes, attributes and coordinate variables of an array mean, by the CF conventions:
//! common to HDF5, NetCDF and Zarr.
//!
//! ```text
//!  temp(time, lev, lat, lon)        three axes are a volume, that of time has its frames: see [`layout`]
//!    scale_factor, add_offset       value = scale_factor · stored + add_offset
//!    _FillValue, missing_value      the stored numbers that mean "no data"
//!    valid_range, valid_min, …      what is outside has no value
//!    _Unsigned                      signed integers that stand for unsigned ones
//!  lat(lat), lon(lon), …            coordinates: spacing and origin, or a rectilinear grid
//!  time(time), time()               the time of each frame, or that of all
//! ```

use super::axes::{AxisLayout, layout};
use super::coordinates::{GridCoordinates, rectilinear, regular};
use super::header::geometry;
use super::lengths::Lengths;
pub(in crate::formats) use super::packing::{
    AttributeNumbers, Attributes, Convert, Packing, netcdf_fill, signed_as,
};
use super::{Frames, OpenOptions};
use crate::error::{Error, Result};
use crate::grid::Geometry;
use crate::volume::units::{Unit, Units};
use crate::volume::{FieldInfo, ScalarType};
use std::collections::HashMap;
use std::path::Path;

/// Most frames of an array with four axes.
const MOST_FRAMES: u64 = 1 << 16;
/// The most samples of a coordinate variable that is read.
pub(in crate::formats) const MOST_COORDINATES: u64 = 1 << 24;

/// The kind of an axis with this name: x, y, z, t (time), c (channels, components), or '?'.
pub(in crate::formats) fn kind_of_name(name: &str) -> char {
    match name.rsplit('/').next().unwrap_or(name).to_ascii_lowercase().as_str() {
        "x" | "lon" | "longitude" => 'x',
        "y" | "lat" | "latitude" => 'y',
        "z" | "lev" | "level" | "depth" | "height" | "altitude" | "plev" => 'z',
        "t" | "time" | "times" | "valid_time" => 't',
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
        // With a date, or as CDO writes absolute times.
        _ if units.contains(" since ") || units.starts_with("day as %") => 't',
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
pub(in crate::formats) struct Hyperslab {
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
    /// The axis of time, which may have one entry.
    pub(in crate::formats) time: Option<usize>,
    /// The axis of the world along which each axis of the volume lies.
    pub(in crate::formats) world: [usize; 3],
}

impl Hyperslab {
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
    /// Volumes of three axes, and maybe one that is called time, as those of MINC.
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
    shape: &[u64],
    kinds: &[char],
    scalar: ScalarType,
    rules: Rules,
) -> Result<Vec<Hyperslab>> {
    let refuse = |expected: &str| {
        let axis =
            |(n, kind): (&u64, &char)| if *kind == '?' { n.to_string() } else { format!("{n} ({kind})") };
        let got: Vec<String> = shape.iter().zip(kinds).map(axis).collect();
        let help = if shape.len() == 3 && kinds.contains(&'t') {
            "time is no place, and one time is no volume; to read times as z, rename the axis \
             and leave out its coordinates (xarray: rename(time='z').drop_vars('z'))"
        } else {
            "write the part that is wanted to a dataset of its own, its axes z, y, x"
        };
        Error::bad_input(path, name, expected, got.join(" x ")).with_help(help)
    };
    if let Some(vectors) = vectors(name, shape, kinds, scalar, rules) {
        return Ok(vec![vectors]);
    }
    let AxisLayout { space, series, channels } = layout(shape, kinds).map_err(refuse)?;
    let count = |axis: Option<usize>| axis.map_or(1, |axis| shape[axis]);
    let all = count(series).checked_mul(count(channels)).filter(|&all| all <= MOST_FRAMES);
    let has_times = channels.is_none() && series.is_some_and(|axis| kinds[axis] == 't');
    let may_have_several = rules == Rules::Plain || rules == Rules::Volumes && has_times;
    if all.is_none() || !may_have_several && all != Some(1) {
        let expected = "three axes of space, and others of at most 65536 frames and channels";
        return Err(refuse(if rules == Rules::Plain { expected } else { "three axes" }));
    }
    let numbers = |axis: Option<usize>| -> Vec<Option<u64>> {
        axis.map_or_else(|| vec![None], |axis| (0..shape[axis]).map(Some).collect())
    };
    let time = series.or_else(|| kinds.iter().position(|&kind| kind == 't'));
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
            parts.push(Hyperslab { info, array, axes: space, entries, channel, frames: series, time, world });
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
fn vectors(name: &str, shape: &[u64], kinds: &[char], scalar: ScalarType, rules: Rules) -> Option<Hyperslab> {
    let rank = shape.len();
    let is_named = rules != Rules::Vectors && kinds.iter().any(|&kind| kind != '?');
    let is_short = rank == 4 && shape[3] <= 4 && shape[1] > 4 && shape[2] > 4 && !is_named;
    let is_told = rank == 4 && rules == Rules::Vectors || rules != Rules::Plain && kinds[rank - 1] == 'c';
    if rank < 4 || shape[rank - 1] < 2 || !(is_short || is_told) {
        return None;
    }
    let components = u32::try_from(shape[rank - 1]).unwrap_or(u32::MAX);
    let info = FieldInfo { name: name.into(), scalar, components };
    let (axes, entries) = ([rank - 2, rank - 3, rank - 4], vec![0; rank]);
    let (array, world) = (name.into(), [0, 1, 2]);
    Some(Hyperslab { info, array, axes, entries, channel: None, frames: None, time: None, world })
}

/// Names of the dimensions that meshes of climate models have for their cells, in lower case.
const CELLS: [&str; 9] = ["ncells", "nedges", "nvertices", "ncol", "cell", "nod2", "nod3", "node", "nele"];

/// Fails for an array on the parts of an unstructured mesh, given the names of its dimensions:
/// UGRID and CDO say so, other models by the names alone.
///
/// # Errors
/// [`Error::BadInput`] for such an array.
pub(in crate::formats) fn refuse_mesh(attributes: &impl Attributes, dims: &[String]) -> Result<()> {
    let (mesh, location) = (attributes.text("mesh"), attributes.text("location"));
    let got = if !mesh.is_empty() && ["node", "edge", "face", "volume"].contains(&&*location) {
        format!("values on each {location} of the mesh '{}' (UGRID)", shown(&mesh))
    } else if attributes.text("CDI_grid_type") == "unstructured" {
        "values on an unstructured grid, as CDI_grid_type tells".into()
    } else if let Some(dim) = dims.iter().find(|dim| CELLS.contains(&&*dim.to_ascii_lowercase())) {
        format!("values on the cells of a mesh, as the dimension '{}' tells", shown(dim))
    } else {
        return Ok(());
    };
    Err(attributes
        .wrong("axes", "a grid with axes x, y and z", got)
        .with_help("interpolate it to such a grid (cdo remapcon, UXarray), or write mesh and values as .vtu"))
}

/// A name from a file, for a message.
fn shown(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(60).collect()
}

/// A convention of whole files in which arrays of three axes are no volumes, or are placed by what
/// is not read: by the attributes `Conventions` and `file_format`, or what stands for them. Its
/// name, and what to do.
pub(in crate::formats) fn refused_convention(text: &str) -> Option<(&'static str, &'static str)> {
    let known = [
        ("AMBER", "a trajectory of AMBER", OF_ATOMS),
        ("Pande", "a trajectory of MDTraj", OF_ATOMS),
        ("ETSF", "a file of ETSF, whose cell is not read", "write the density as .xsf, then as .vti"),
    ];
    let found = known.into_iter().find(|(word, ..)| text.starts_with(word));
    found.map(|(_, what, help)| (what, help))
}

/// What to do with positions of atoms.
pub(in crate::formats) const OF_ATOMS: &str = "atoms are no volume: make a density map of them first";

/// The variables that may tell the time of an array without an axis of time, given its attribute
/// `coordinates`, or that of the file; and the most axes that they may have. One that is not named
/// there has none: with an axis it is that of other arrays.
pub(in crate::formats) fn names_of_time(coordinates: &str) -> impl Iterator<Item = (&str, usize)> {
    coordinates.split_whitespace().map(|name| (name, 1)).chain([("time", 0)])
}

/// The time of all fields, where they have one and the same; `None` of a series.
pub(in crate::formats) fn common_time<'a, P: AsRef<Hyperslab> + 'a>(
    fields: impl Iterator<Item = &'a P>,
    mut time_of: impl FnMut(&P) -> Option<f64>,
) -> Option<f64> {
    let mut found = None;
    for field in fields {
        let time = time_of(field).filter(|t| t.is_finite() && !field.as_ref().is_frame())?;
        if found.is_some_and(|found| found != time) {
            return None;
        }
        found = Some(time);
    }
    found
}

/// The name of the field that is asked for, with the channel.
///
/// # Errors
/// [`Error::Usage`] for a channel where there is none, or where several arrays have some.
pub(in crate::formats) fn with_channel<'a>(
    path: &Path,
    options: &OpenOptions,
    parts: impl Iterator<Item = &'a Hyperslab>,
) -> Result<Option<String>> {
    let Some(channel) = &options.channel else { return Ok(options.field.clone()) };
    let number = channel.strip_prefix('c').unwrap_or(channel);
    let usage = |text: String| Err(Error::usage(format!("{}: {text}", path.display())));
    if let Some(field) = &options.field {
        return match field.rsplit_once(":c") {
            Some((_, of_field)) if of_field.split(':').next() != Some(number) => {
                usage(format!("{field} is another channel than `channel={channel}`"))
            }
            Some(_) => Ok(Some(field.clone())),
            None => Ok(Some(format!("{field}:c{number}"))),
        };
    }
    let mut arrays: Vec<&str> = parts.filter(|p| p.is_channel()).map(|p| p.array.as_str()).collect();
    arrays.dedup();
    match arrays[..] {
        [] => usage("no dataset has channels: leave out `channel`".into()),
        [array] => Ok(Some(format!("{array}:c{number}"))),
        _ => {
            usage(format!("several datasets have channels ({}): choose one with `field`", arrays.join(", ")))
        }
    }
}

/// The frames of the array that has `first`, by the names of their fields, and their times, where
/// all of them have one. Without a choice, none where the file has other fields too.
pub(in crate::formats) fn frames<'a>(
    parts: impl Iterator<Item = &'a Hyperslab> + Clone,
    first: &Hyperslab,
    is_chosen: bool,
    times: Option<Vec<f64>>,
) -> Frames {
    let all = parts.clone().count();
    let is_of_it = |p: &&Hyperslab| p.array == first.array && p.channel == first.channel;
    let frames: Vec<&Hyperslab> = parts.filter(is_of_it).collect();
    if !is_chosen && (frames.len() != all || all == 1) {
        return vec![];
    }
    let times = times.filter(|t| t.len() == frames.len() && t.iter().all(|t| t.is_finite()));
    let time = |n: usize| times.as_ref().map(|t| t[n]);
    frames.iter().enumerate().map(|(n, p)| (p.info.name.clone(), time(n))).collect()
}

/// The times of all frames by the names of their fields, given those of each array that has some.
pub(in crate::formats) fn times<'a, P: AsRef<Hyperslab> + 'a>(
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

    /// Coordinates in even steps, their values as far as they are not too many.
    #[cfg_attr(not(feature = "hdf5"), expect(dead_code, reason = "such axes are those of HDF5"))]
    pub(in crate::formats) fn even(start: f64, step: f64, count: u64) -> Self {
        let values = (0..count.min(MOST_COORDINATES)).map(|i| start + step * i as f64).collect();
        Self { regular: Some((start, step)), values }
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
