//! Slices as one volume: which lie next to each other, and how far apart.

use super::file::{DicomFile, Frame, SampleLayout};
use crate::error::{Error, Result};
use crate::formats::shared::header::geometry;
use crate::geom::vec3::{cross, dot, minus};
use crate::grid::Geometry;
use crate::volume::units::{Unit, common};
use std::path::{Path, PathBuf};

/// How far a place may be from where it should be, in steps between slices: places are written with
/// few digits.
const MOST_OFF: f64 = 0.02;
/// How far directions and spacings of slices may differ, for the same reason.
const SAME: f64 = 1e-4;

/// The slices of a volume, in order.
pub(super) struct Series {
    pub(super) layout: SampleLayout,
    pub(super) slices: Vec<Slice>,
    pub(super) paths: Vec<PathBuf>,
    pub(super) geometry: Geometry,
    /// The unit of values, where all slices have the same one.
    pub(super) unit: Option<Unit>,
}

/// A slice: where its samples are, and what they mean.
pub(super) struct Slice {
    /// Which of the files has it.
    pub(super) file: usize,
    /// The byte of its first sample.
    pub(super) at: u64,
    pub(super) big_endian: bool,
    pub(super) slope: f64,
    pub(super) intercept: f64,
}

/// A frame and its file, and how it is called in messages.
struct PlacedFrame<'a> {
    file: usize,
    frame: &'a Frame,
    name: String,
    /// Millimetres along the normal.
    along: f64,
}

/// Puts the frames of all files in order.
///
/// # Errors
/// [`Error::BadInput`] for frames that are not one volume, naming the files.
pub(super) fn of(path: &Path, files: Vec<DicomFile>) -> Result<Series> {
    expect_one_series(path, &files)?;
    let first = &files[0].frames[0];
    let [x, y] = axes(&first.orientation);
    let normal = cross(x, y);
    let length = |v: [f64; 3]| dot(v, v).sqrt();
    let are_unit = [x, y].iter().all(|&v| (length(v) - 1.0).abs() < 1e-3) && dot(x, y).abs() < 1e-3;
    if !are_unit {
        let got = format!("{:?}", first.orientation);
        let expected = "two directions of length 1 at a right angle";
        return Err(Error::bad_input(&files[0].path, "Image Orientation (Patient)", expected, got));
    }
    let mut all = vec![];
    for (number, file) in files.iter().enumerate() {
        let name = file.path.file_name().unwrap_or_default().to_string_lossy();
        for (n, frame) in file.frames.iter().enumerate() {
            let name = if file.frames.len() > 1 { format!("frame {}", n + 1) } else { name.to_string() };
            let is_near =
                |a: &[f64], b: &[f64], most: f64| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= most);
            if !is_near(&frame.orientation, &first.orientation, SAME) {
                let got = format!("{:?} of {name}", frame.orientation);
                let expected = format!("one for all slices: {:?}", first.orientation);
                return Err(
                    Error::bad_input(path, "Image Orientation (Patient)", expected, got).with_help(PATTERN)
                );
            }
            if !is_near(&frame.spacing, &first.spacing, SAME * first.spacing[0]) {
                let got = format!("{:?} of {name}", frame.spacing);
                let expected = format!("one for all slices: {:?}", first.spacing);
                return Err(Error::bad_input(path, "Pixel Spacing", expected, got).with_help(PATTERN));
            }
            all.push(PlacedFrame { file: number, frame, name, along: dot(frame.position, normal) });
        }
    }
    all.sort_by(|a, b| a.along.total_cmp(&b.along).then_with(|| a.name.cmp(&b.name)));
    let step = step(path, &all)?;
    let [between_rows, between_columns] = first.spacing;
    let columns = [x.map(|v| v * between_columns), y.map(|v| v * between_rows), step];
    let at = "Image Position, Image Orientation and Pixel Spacing";
    let geometry = geometry(path, at, all[0].frame.position, columns)?;
    let slice = |placed: &PlacedFrame<'_>| Slice {
        file: placed.file,
        at: placed.frame.at,
        big_endian: files[placed.file].big_endian,
        slope: placed.frame.slope,
        intercept: placed.frame.intercept,
    };
    let slices = all.iter().map(slice).collect();
    Ok(Series {
        layout: files[0].layout,
        slices,
        geometry,
        unit: common(all.iter().map(|placed| placed.frame.unit.clone())),
        paths: files.iter().map(|f| f.path.clone()).collect(),
    })
}

const PATTERN: &str = "choose the slices by a pattern: \"FOLDER/IM_*.dcm\", in quotes";

/// Refuses files of several series, or with samples of several sizes or types.
fn expect_one_series(path: &Path, files: &[DicomFile]) -> Result<()> {
    let name = |file: &DicomFile| file.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let first = &files[0];
    if let Some(other) = files.iter().find(|f| f.series != first.series) {
        let mut names: Vec<&str> = files.iter().map(|f| f.series.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        let got = format!("{}, as in {} and {}", names.len(), name(first), name(other));
        return Err(Error::bad_input(path, "Series Instance UID", "one series", got).with_help(
            "put each series in a folder of its own, or choose its slices by a pattern, in quotes",
        ));
    }
    if let Some(other) = files.iter().find(|f| f.layout != first.layout) {
        let shown = |f: &DicomFile| format!("{:?} in {}", f.layout, name(f));
        let expected = format!("samples as in the first slice: {}", shown(first));
        return Err(Error::bad_input(path, "slices", expected, shown(other)).with_help(PATTERN));
    }
    if files.len() > 1 && files.iter().any(|f| f.frames.len() > 1) {
        let got = format!("{} files, some with many frames", files.len());
        let expected = "slices in files of their own, or one file of many frames";
        return Err(Error::bad_input(path, "slices", expected, got).with_help("name the file that is meant"));
    }
    Ok(())
}

fn axes(of: &[f64; 6]) -> [[f64; 3]; 2] {
    [[of[0], of[1], of[2]], [of[3], of[4], of[5]]]
}

/// The step from each slice to the next, which is the same for all.
fn step(path: &Path, all: &[PlacedFrame<'_>]) -> Result<[f64; 3]> {
    if all.len() < 2 {
        let got = "one slice";
        return Err(
            Error::bad_input(path, "slices", "two or more", got).with_help("name the folder of a series")
        );
    }
    let gaps: Vec<f64> = all.windows(2).map(|w| w[1].along - w[0].along).collect();
    let mut sorted = gaps.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    // The lower of two in the middle: a gap is larger.
    let usual = sorted[(sorted.len() - 1) / 2];
    let pair = |n: usize| format!("{} and {}", all[n].name, all[n + 1].name);
    let largest = sorted[sorted.len() - 1];
    if let Some(n) = gaps.iter().position(|&gap| gap <= 0.1 * MOST_OFF * largest) {
        let expected = "one slice at each place";
        let got = format!("two at one: {}", pair(n));
        return Err(Error::bad_input(path, "Image Position (Patient)", expected, got)
            .with_help("choose the slices of one time, echo or channel by a pattern, in quotes"));
    }
    let is_off = |gap: f64, expected: f64| (gap - expected).abs() > 2.0 * MOST_OFF * usual;
    if let Some(n) = gaps.iter().position(|&gap| is_off(gap, usual)) {
        let times = (gaps[n] / usual).round();
        let expected = format!("slices {usual} mm apart, as most are");
        let is_gap = times > 1.0 && !is_off(gaps[n], times * usual);
        let got = if is_gap {
            format!("{} missing between {}", times - 1.0, pair(n))
        } else {
            format!("{} mm between {}", gaps[n], pair(n))
        };
        let help = if is_gap {
            "fetch the missing slices, or choose a part by a pattern, in quotes"
        } else {
            "resample it to equal steps, e.g. with 3D Slicer"
        };
        return Err(Error::bad_input(path, "Image Position (Patient)", expected, got).with_help(help));
    }
    let (first, last) = (all[0].frame.position, all[all.len() - 1].frame.position);
    let step = minus(last, first).map(|v| v / (all.len() - 1) as f64);
    for (n, placed) in all.iter().enumerate() {
        let expected: [f64; 3] = std::array::from_fn(|i| first[i] + n as f64 * step[i]);
        let off = minus(placed.frame.position, expected);
        if dot(off, off).sqrt() > MOST_OFF * usual {
            let got = format!("{:?} of {}", placed.frame.position, placed.name);
            let expected = format!("slices along a line, this one at {expected:?}");
            return Err(Error::bad_input(path, "Image Position (Patient)", expected, got)
                .with_help("resample it to equal steps, e.g. with 3D Slicer"));
        }
    }
    Ok(step)
}
