//! What programs of electron microscopy say of the axes of their datasets.
//!
//! ```text
//!  GROUP/data                       the samples
//!  EMD:      GROUP/dim1, dim2, …    coordinates (or the first two), with `name` and `units`;
//!            GROUP/dim0, …          of py4DSTEM, which counts from 0
//!  HyperSpy: GROUP/axis-0, …        groups with `name`, `units`, and `offset` and `scale`, or a
//!                                   dataset `axis` of coordinates
//! ```
//!
//! Such axes may be angles, energies or spatial frequencies, of which no volume is made: they are
//! refused by their names.

use super::{Hdf5Field, Tree, all_f64, attribute_numbers, attribute_text, damaged, scalar_of};
use crate::error::{Error, Result};
use crate::formats::shared::cf::{Line, MOST_COORDINATES, kind_of_name};
use hdf5_reader::attribute_api::Attribute;
use hdf5_reader::error::Error as ReadError;
use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Datatype};
use std::path::Path;

/// The most axes that are looked for.
const MOST_AXES: usize = 16;

/// The axes of the datasets in a group, slowest first.
pub(super) struct Axes {
    /// The convention.
    pub(super) program: &'static str,
    axes: Vec<Hdf5Axis>,
}

struct Hdf5Axis {
    name: String,
    unit: String,
    coordinates: Coordinates,
}

enum Coordinates {
    Regular {
        offset: f64,
        scale: f64,
    },
    Listed(Box<Dataset>),
    /// Something else: names, or a formula.
    Unread,
}

impl Axes {
    /// Those that a group describes, if it follows one of these conventions.
    ///
    /// # Errors
    /// [`Error::BadInput`] where they cannot be read.
    pub(super) fn of(
        path: &Path,
        at: &str,
        group: &Group,
        members: &[Vec<String>; 2],
    ) -> Result<Option<Self>> {
        let [groups, datasets] = members;
        let wrong = |e: ReadError| damaged(path, at, &e);
        let has = |list: &[String], name: &str| list.iter().any(|n| n == name);
        if !has(datasets, "data") {
            return Ok(None);
        }
        if group.attribute("emd_group_type").is_ok() {
            let first = if has(datasets, "dim0") { 0 } else { 1 };
            let names = (first..first + MOST_AXES).map(|n| format!("dim{n}"));
            let axes = names.take_while(|name| has(datasets, name)).map(|name| emd(group, &name));
            let axes: Vec<Hdf5Axis> = axes.collect::<std::result::Result<_, _>>().map_err(wrong)?;
            return Ok((!axes.is_empty()).then_some(Self { program: "EMD", axes }));
        }
        if has(groups, "axis-0") {
            let names = (0..MOST_AXES).map(|n| format!("axis-{n}"));
            let axes = names.take_while(|name| has(groups, name)).map(|name| hyperspy(group, &name));
            let axes = axes.collect::<std::result::Result<_, _>>().map_err(wrong)?;
            return Ok(Some(Self { program: "HyperSpy", axes }));
        }
        Ok(None)
    }

    /// What an axis is, see [`kind_of_name`]; units of time count too.
    pub(super) fn kind(&self, axis: usize) -> char {
        match self.axes.get(axis) {
            Some(found) if is_time(&found.unit) => 't',
            Some(found) => kind_of_name(&found.name),
            None => '?',
        }
    }

    /// The unit of an axis.
    pub(super) fn unit(&self, axis: usize) -> Option<String> {
        Some(self.axes.get(axis)?.unit.clone())
    }

    /// Fails where a dataset has other axes than those of space, and of time or channels before
    /// them.
    pub(super) fn check(&self, path: &Path, name: &str, dataset: &Dataset) -> Result<()> {
        let (rank, shape) = (dataset.ndim(), dataset.shape());
        let refuse = |expected: &str, got: String, help: &str| {
            Err(Error::bad_input(path, format!("{name}, axes"), expected, got).with_help(help))
        };
        if self.axes.len() != rank {
            let got = format!("{} for {rank} axes", self.axes.len());
            return refuse("a description of each axis", got, "write the file again with its program");
        }
        for (n, axis) in self.axes.iter().enumerate() {
            let is_space = !is_time(&axis.unit) && is_length(&axis.unit) && axis.is_read(shape[n]);
            let before = rank > 3 && n < rank - 3;
            let is_known = matches!(self.kind(n), 't' | 'c');
            let good = if before { is_known || shape[n] == 1 } else { is_space };
            if !good {
                let all: Vec<String> = self.axes.iter().map(Hdf5Axis::shown).collect();
                let got = format!("{} of {}", axis.shown(), all.join(", "));
                let help = "cut out a volume of three axes of space, or write it as .nrrd or OME-Zarr";
                return refuse("axes of space, and of time or channels before them", got, help);
            }
        }
        Ok(())
    }

    /// The coordinates along an axis of a dataset.
    pub(super) fn line(&self, axis: usize, count: u64) -> Option<Line> {
        match &self.axes.get(axis)?.coordinates {
            Coordinates::Regular { offset, scale } => Some(Line::even(*offset, *scale, count)),
            Coordinates::Listed(line) => {
                let (scalar, _) = scalar_of(Path::new(""), "", line).ok()?;
                let values = all_f64(line, scalar).ok()?;
                let single = matches!(line.dtype(), Datatype::FloatingPoint { size: 4, .. });
                match values[..] {
                    // The first two stand for all.
                    [first, second] if count != 2 => Some(Line::even(first, second - first, count)),
                    _ => Some(Line::new(values, single)),
                }
            }
            Coordinates::Unread => None,
        }
    }
}

impl Hdf5Axis {
    /// Whether its coordinates are numbers, as many as there are samples.
    fn is_read(&self, count: u64) -> bool {
        match &self.coordinates {
            Coordinates::Regular { offset, scale } => {
                offset.is_finite() && scale.is_finite() && *scale != 0.0
            }
            Coordinates::Listed(line) => {
                let own = line.shape().first().copied().unwrap_or(0);
                let is_number = scalar_of(Path::new(""), "", line).is_ok();
                is_number && own <= MOST_COORDINATES && (own == count || own == 2)
            }
            Coordinates::Unread => false,
        }
    }

    /// "'Energy' (eV)".
    fn shown(&self) -> String {
        let clean = |text: &str| -> String { text.chars().filter(|c| !c.is_control()).take(40).collect() };
        let unit = if self.unit.is_empty() { "no unit" } else { &self.unit };
        format!("'{}' ({})", clean(&self.name), clean(unit))
    }
}

type Read<T> = std::result::Result<T, ReadError>;

fn text(attribute: hdf5_reader::error::Result<Attribute>) -> String {
    let text = attribute.ok().and_then(|a| attribute_text(&a)).unwrap_or_default();
    // What HyperSpy writes for nothing.
    if ["_None_", "<undefined>"].contains(&&*text) { String::new() } else { text }
}

/// An axis of EMD. Units may be written as "[n_m]".
fn emd(group: &Group, name: &str) -> Read<Hdf5Axis> {
    let line = group.dataset(name)?;
    let unit = text(line.attribute("units")).replace(['[', ']', '_'], "");
    let unit = match unit.as_str() {
        "A" => "Å".into(),
        "n/a" | "unknown" => String::new(),
        _ => unit,
    };
    let name = text(line.attribute("name"));
    let is_list = line.ndim() == 1;
    let coordinates = if is_list { Coordinates::Listed(Box::new(line)) } else { Coordinates::Unread };
    Ok(Hdf5Axis { name, unit, coordinates })
}

/// An axis of HyperSpy.
fn hyperspy(group: &Group, name: &str) -> Read<Hdf5Axis> {
    let axis = group.group(name)?;
    let number = |name: &str| {
        let numbers = axis.attribute(name).ok().and_then(|a| attribute_numbers(&a));
        numbers.and_then(|n| n.first().copied())
    };
    let coordinates = match (number("scale"), axis.dataset("axis")) {
        (_, Ok(line)) if line.ndim() == 1 => Coordinates::Listed(Box::new(line)),
        (Some(scale), _) if axis.attribute("expression").is_err() => {
            Coordinates::Regular { offset: number("offset").unwrap_or(0.0), scale }
        }
        _ => Coordinates::Unread,
    };
    Ok(Hdf5Axis { name: text(axis.attribute("name")), unit: text(axis.attribute("units")), coordinates })
}

fn is_time(unit: &str) -> bool {
    ["s", "ms", "µs", "us", "ns", "sec", "second", "seconds", "min", "h"].contains(&unit)
}

/// Whether a unit may be one of lengths: angles, energies and spatial frequencies are none.
fn is_length(unit: &str) -> bool {
    let unit = unit.to_lowercase();
    let others = ["deg", "rad", "°", "ev", "^-1", "1/", "⁻¹", "hz", "%", "-1", "counts", "kelvin"];
    !others.iter().any(|other| unit.contains(other)) && !["k", "v", "c"].contains(&&*unit)
}

impl Tree {
    /// What the group of a dataset says of its axes: of `GROUP/data`, and of the other scalars of
    /// tomviz, which lie a group deeper.
    pub(super) fn axes_of(&self, name: &str) -> Option<&Axes> {
        let (group, short) = name.rsplit_once('/').unwrap_or(("", name));
        let group = match group.strip_suffix("tomviz_scalars") {
            Some(above) => above.trim_end_matches('/'),
            None if short == "data" => group,
            None => return None,
        };
        let prefix = if group.is_empty() { String::new() } else { format!("{group}/") };
        self.described.get(&prefix)
    }
}

impl Hdf5Field {
    /// The coordinates along an axis, by the description of its group.
    pub(super) fn described_line(&self, axis: usize, tree: &Tree) -> Option<Line> {
        tree.axes_of(&self.part.array)?.line(axis, self.dataset.shape()[axis])
    }
}
