//! The axes of an NRRD: which are of space, and which one has the volumes of a series.
//!
//! An axis is what its kind says: `domain` and `space` are of space, `time` and `list` have
//! volumes, others (`vector`, `RGB-color` …) have components and are refused. Where the kind says
//! nothing, an axis without a direction in space is none of space, and a label "time" counts. In a
//! space with time, the axis along it has volumes, whatever its kind says (see the module `space`).

use super::NrrdHeader;
use crate::error::{Error, Result};
use crate::formats::shared::cf::kind_of_name;
use crate::formats::shared::frames;
use crate::formats::shared::header::{geometry, numbers, scaled_axes};
use crate::formats::shared::lengths::Lengths;
use crate::formats::shared::{Frames, axes::layout};
use crate::grid::Geometry;
use crate::volume::units::{Unit, Units};
use crate::volume::{Assumed, ScalarType, VolumeInfo};

/// The most axes of an NRRD.
const MOST_AXES: u32 = 16;

/// The axes of a file, the fastest first.
pub(super) struct Axes {
    sizes: Vec<u64>,
    /// Those along x, y, z.
    space: [usize; 3],
    /// The one with volumes.
    series: Option<usize>,
    /// Whether it is one of time.
    is_time: bool,
    /// The time of the first volume and the step, where directions tell them.
    times: Option<[f64; 2]>,
    /// Lines for the user.
    notes: Vec<String>,
}

impl Axes {
    pub(super) fn of(header: &NrrdHeader) -> Result<Self> {
        let path = &*header.path;
        let [count] = numbers::<u32, 1>(path, "dimension", header.require("dimension")?)?;
        if !(3..=MOST_AXES).contains(&count) {
            return Err(Error::bad_input(path, "dimension", "3, or 4 for a series", count.to_string())
                .with_help("only volumes are read"));
        }
        let count = count as usize;
        let text = header.require("sizes")?;
        let sizes: Option<Vec<u64>> = text.split_whitespace().map(|n| n.parse().ok()).collect();
        let sizes = sizes.filter(|sizes| sizes.len() == count);
        let sizes = sizes.ok_or_else(|| Error::bad_input(path, "sizes", format!("{count} numbers"), text))?;
        let along_time = header.directions(count)?.and_then(|found| found.time);
        let kinds = header.kinds(&sizes)?;
        let reversed = |list: &[char]| list.iter().rev().copied().collect::<Vec<char>>();
        let shape: Vec<u64> = sizes.iter().rev().copied().collect();
        let found = layout(&shape, &reversed(&kinds));
        let found = found.ok().filter(|found| found.channels.is_none()).ok_or_else(|| {
            let words = header.get("kinds").map_or("none".into(), |kinds| format!("kinds {kinds}"));
            let expected = "three axes of space, and at most one more, of kind time or list";
            Error::bad_input(path, "axes", expected, format!("sizes {text}, {words}"))
                .with_help("name the kinds of the axes, or cut out one volume, e.g. with `unu slice`")
        })?;
        // Here the fastest axis is the first.
        let place = |axis: usize| count - 1 - axis;
        let series = found.series.map(place);
        let (mut notes, mut is_time) = (vec![], false);
        if series.is_some() && series == along_time.map(|(axis, _)| axis) {
            is_time = true;
        } else if let Some(axis) = series {
            is_time = header.word("kinds", axis).eq_ignore_ascii_case("time")
                || kind_of_name(&header.quoted("labels", count).get(axis).cloned().unwrap_or_default())
                    == 't';
            if header.word("kinds", axis).is_empty() {
                notes
                    .push(format!("no kind says what axis {axis} is: its {} entries are steps", sizes[axis]));
            }
        }
        let start = header.origin()?.map_or(0.0, |(_, time)| time);
        let times = along_time.map(|(_, step)| [start, step]);
        if times.is_some_and(|[_, step]| step < 0.0) && series.is_some() {
            notes.push("its volumes go back in time: they have no times".into());
        }
        let axes = Self { space: found.space.map(place), sizes, series, is_time, times, notes };
        frames::check_count(path, "sizes", axes.frames())?;
        Ok(axes)
    }

    /// Samples along x, y, z.
    pub(super) fn dims(&self) -> [u64; 3] {
        self.space.map(|axis| self.sizes[axis])
    }

    /// Volumes.
    pub(super) fn frames(&self) -> u64 {
        self.series.map_or(1, |axis| self.sizes[axis])
    }

    /// Whether the samples of a volume follow each other: the volumes lie one after the other.
    pub(super) fn are_in_order(&self) -> bool {
        let [x, y, z] = self.space;
        x < y && y < z && self.series.is_none_or(|axis| axis > z)
    }

    /// Bytes a step along x, y, z, and from volume to volume.
    pub(super) fn strides(&self, scalar: ScalarType) -> [u64; 4] {
        let step = |axis: usize| {
            self.sizes[..axis].iter().fold(scalar.bytes() as u64, |step, &size| step.saturating_mul(size))
        };
        let [x, y, z] = self.space.map(step);
        [x, y, z, self.series.map_or(0, step)]
    }

    /// Sets what the header says of places and units.
    pub(super) fn describe(&self, header: &NrrdHeader, info: &mut VolumeInfo) -> Result<()> {
        let lengths = self.lengths(header)?;
        info.geometry = self.geometry(header, &lengths)?;
        info.assumed = Assumed::in_header(self.space.map(|axis| header.is_assumed(axis)));
        let value = header.get("sampleunits").and_then(|text| Unit::new(text.trim_matches('"')));
        let of_space = header.quoted("spaceunits", 4);
        let of_axes = header.quoted("units", self.sizes.len());
        let named = |axis: usize| if self.times.is_some() { of_space.get(3) } else { of_axes.get(axis) };
        let time = self.series.filter(|_| self.is_time).and_then(|axis| Unit::time(named(axis)?));
        info.units = Units { value, length: lengths.unit, time };
        info.notes.extend(lengths.note.into_iter().chain(self.notes.iter().cloned()));
        Ok(())
    }

    /// The volumes by the names of their fields, and their times.
    pub(super) fn list(&self, header: &NrrdHeader) -> Result<Frames> {
        let Some(axis) = self.series.filter(|_| self.is_time) else {
            return Ok(frames::list(self.frames(), None));
        };
        if self.times.is_some() {
            return Ok(frames::list(self.frames(), self.times));
        }
        let of = |name: &str, label: &str| header.per_axis_number(name, label, self.sizes.len());
        let (spacing, min) = (of("spacings", "spacings")?[axis], of("axismins", "axis mins")?[axis]);
        Ok(frames::list(self.frames(), Some([if min.is_nan() { 0.0 } else { min }, spacing])))
    }

    /// The units of lengths: those of the space, else of the axes.
    fn lengths(&self, header: &NrrdHeader) -> Result<Lengths> {
        let (at, names) = if header.get("space").or(header.get("spacedimension")).is_some() {
            ("space units", header.quoted("spaceunits", header.space_dimension()?))
        } else {
            let all = header.quoted("units", self.sizes.len());
            ("units", self.space.iter().filter_map(|&axis| all.get(axis).cloned()).collect())
        };
        let unit = |axis: usize| names.get(axis).and_then(|name: &String| Unit::length(name));
        Lengths::of_space(&header.path, at, std::array::from_fn(unit))
    }

    fn geometry(&self, header: &NrrdHeader, lengths: &Lengths) -> Result<Geometry> {
        let path = &*header.path;
        let origin = header.origin()?.map(|(in_space, _)| in_space);
        let in_unit = |origin: [f64; 3], columns: [[f64; 3]; 3]| {
            (lengths.of_vector(origin), columns.map(|column| lengths.of_vector(column)))
        };
        if let Some(all) = header.directions(self.sizes.len())? {
            let columns = self.space.map(|axis| all.of_axes[axis].unwrap_or([0.0; 3]));
            let (origin, columns) = in_unit(origin.unwrap_or([0.0; 3]), columns);
            return geometry(path, "space directions", origin, columns);
        }
        let (spacing, start) = self.per_axis(header)?;
        let (origin, columns) = in_unit(origin.unwrap_or(start), scaled_axes(spacing));
        geometry(path, "spacings", origin, columns)
    }

    /// Spacing and first position of each axis from `spacings`, `axis mins`, `axis maxs`; NaN means
    /// unknown there.
    fn per_axis(&self, header: &NrrdHeader) -> Result<([f64; 3], [f64; 3])> {
        let read = |name: &str, label: &str| -> Result<[f64; 3]> {
            let all = header.per_axis_number(name, label, self.sizes.len())?;
            Ok(self.space.map(|axis| all[axis]))
        };
        let (given, mins, maxs) =
            (read("spacings", "spacings")?, read("axismins", "axis mins")?, read("axismaxs", "axis maxs")?);
        let (mut spacing, mut start) = ([1.0; 3], [0.0; 3]);
        let centers: Vec<&str> =
            header.get("centers").or(header.get("centerings")).unwrap_or("").split_whitespace().collect();
        let dims = self.dims();
        for a in 0..3 {
            // A cell-centred axis goes from the outer face of its first sample to that of its last.
            let cell = centers.get(self.space[a]).is_some_and(|c| *c == "cell");
            let steps = if cell { dims[a] } else { dims[a].saturating_sub(1).max(1) } as f64;
            if !given[a].is_nan() {
                spacing[a] = given[a];
            } else if !mins[a].is_nan() && !maxs[a].is_nan() {
                spacing[a] = (maxs[a] - mins[a]) / steps;
            }
            if !mins[a].is_nan() {
                start[a] = mins[a] + if cell { 0.5 * spacing[a] } else { 0.0 };
            }
        }
        Ok((spacing, start))
    }
}

impl NrrdHeader {
    /// What each axis is, for [`layout`], the fastest first.
    fn kinds(&self, sizes: &[u64]) -> Result<Vec<char>> {
        let directions = self.directions(sizes.len())?;
        let along_time = directions.as_ref().and_then(|found| found.time).map(|(axis, _)| axis);
        let labels = self.quoted("labels", sizes.len());
        let mut kinds = vec![];
        for (axis, &size) in sizes.iter().enumerate() {
            let has_direction = directions.as_ref().map(|all| all.of_axes[axis].is_some());
            let of_label = labels.get(axis).map_or('?', |label| kind_of_name(label));
            let kind = match &*self.word("kinds", axis).to_ascii_lowercase() {
                "domain" | "space" | "time" | "list" | "" | "none" | "???" if along_time == Some(axis) => 't',
                "domain" | "space" => 's',
                "time" | "list" => 't',
                "" | "none" | "???" => match has_direction {
                    Some(true) => 's',
                    _ if of_label == 't' || has_direction == Some(false) => 't',
                    _ => '?',
                },
                _ if size == 1 => 'c',
                _ => return Err(self.components(axis)),
            };
            if kind == 's' && has_direction == Some(false) || kind == 't' && has_direction == Some(true) {
                let got = format!("axis {axis} of kind {}", self.word("kinds", axis));
                let expected = "a direction for each axis of space, and none for others";
                return Err(Error::bad_input(&self.path, "space directions", expected, got));
            }
            kinds.push(kind);
        }
        Ok(kinds)
    }

    /// Whether the spacing of an axis is not known.
    fn is_assumed(&self, axis: usize) -> bool {
        let is_known = |name: &str| {
            let word = self.get(name).and_then(|text| text.split_whitespace().nth(axis));
            word.is_some_and(|word| !word.eq_ignore_ascii_case("nan"))
        };
        let has_ends = is_known("axismins") && is_known("axismaxs");
        self.get("spacedirections").is_none() && !is_known("spacings") && !has_ends
    }

    fn components(&self, axis: usize) -> Error {
        let kind = self.word("kinds", axis);
        Error::bad_input(&self.path, "kinds", "axes of space, and of kind time or list", kind)
            .with_help("colours and vectors are not read; cut out one component, e.g. with `unu slice`")
    }

    /// The word for an axis in a field that has one for each; "" where there is none.
    fn word(&self, name: &str, axis: usize) -> String {
        self.get(name).and_then(|text| text.split_whitespace().nth(axis)).unwrap_or_default().into()
    }

    /// Texts in quotes, one for each of `count` axes; none where there are others.
    fn quoted(&self, name: &str, count: usize) -> Vec<String> {
        let text = self.get(name).unwrap_or_default();
        let all: Vec<String> = text.split('"').skip(1).step_by(2).map(str::to_owned).collect();
        if all.len() == count { all } else { vec![] }
    }

    /// A number for each axis; NaN where none is known.
    fn per_axis_number(&self, name: &str, label: &str, count: usize) -> Result<Vec<f64>> {
        let Some(text) = self.get(name) else { return Ok(vec![f64::NAN; count]) };
        let all: Option<Vec<f64>> = text.split_whitespace().map(|n| n.parse().ok()).collect();
        let wrong = || Error::bad_input(&self.path, label, format!("{count} numbers"), text);
        all.filter(|all| all.len() == count).ok_or_else(wrong)
    }
}
