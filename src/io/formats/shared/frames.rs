//! Volumes of one size that follow each other in a file: the frames of a series, by the names "t0",
//! "t1", ….

use super::{Frames, OpenOptions, pick_field};
use crate::bytes::ByteSource;
use crate::error::{Error, Result};
use crate::volume::{FieldInfo, ScalarType, VolumeSource};
use std::path::Path;
use std::sync::Arc;

/// The most frames of a file.
pub(in crate::formats) const MOST: u64 = 1 << 16;

/// The fields of a file of so many frames.
pub(in crate::formats) fn fields(frames: u64, scalar: ScalarType) -> Vec<FieldInfo> {
    let one = |name: String| FieldInfo { name, scalar, components: 1 };
    if frames == 1 { vec![one("data".into())] } else { (0..frames).map(|t| one(format!("t{t}"))).collect() }
}

/// Options that choose the first of several frames.
pub(in crate::formats) fn first(options: &OpenOptions) -> OpenOptions {
    OpenOptions { field: Some("t0".into()), ..options.clone() }
}

/// Refuses more frames than are listed, and none at all.
///
/// # Errors
/// [`Error::BadInput`] for these.
pub(in crate::formats) fn check_count(path: &Path, at: &str, frames: u64) -> Result<()> {
    if (1..=MOST).contains(&frames) {
        return Ok(());
    }
    Err(Error::bad_input(path, at, format!("1 to {MOST} volumes"), frames.to_string()))
}

/// The frame that is asked for: its number, its field, and all fields.
///
/// # Errors
/// [`Error::Usage`] where there are several, and none is chosen.
pub(in crate::formats) fn choose(
    path: &Path,
    frames: u64,
    scalar: ScalarType,
    options: &OpenOptions,
) -> Result<(u64, Vec<FieldInfo>)> {
    let fields = fields(frames, scalar);
    let frame = pick_field(path, &fields, options.field.as_deref())?;
    Ok((frame as u64, fields))
}

/// Opens the last of several frames where none is chosen: refuses a header that claims more than
/// there is.
///
/// # Errors
/// Those of `open`.
pub(in crate::formats) fn check_last(
    frames: u64,
    options: &OpenOptions,
    open: impl Fn(&OpenOptions) -> Result<VolumeSource>,
) -> Result<()> {
    if frames == 1 || options.field.is_some() {
        return Ok(());
    }
    open(&OpenOptions { field: Some(format!("t{}", frames - 1)), ..options.clone() }).map(drop)
}

/// The frames by the names of their fields, and their times, where the first and the step are
/// known. None where there is one volume.
pub(in crate::formats) fn list(frames: u64, times: Option<[f64; 2]>) -> Frames {
    if frames == 1 {
        return vec![];
    }
    let known = times.filter(|[start, step]| start.is_finite() && step.is_finite() && *step > 0.0);
    let time = |t: u64| known.map(|[start, step]| start + t as f64 * step);
    (0..frames).map(|t| (format!("t{t}"), time(t))).collect()
}

/// A file, and where in it samples begin.
pub(in crate::formats) type PlacedFile = (Arc<ByteSource>, u64);

/// Where a frame lies in files that have the slices of all frames, front to back, `offset` bytes
/// after the beginning of each: parts of equal numbers of slices, and that number.
///
/// # Errors
/// [`Error::BadInput`] where the slices are not equally many in all files.
pub(in crate::formats) fn parts_of(
    path: &Path,
    files: &[Arc<ByteSource>],
    offset: u64,
    [frame, frames]: [u64; 2],
    [slices, slice_bytes]: [u64; 2],
) -> Result<(Vec<PlacedFile>, u64)> {
    let (count, all) = (files.len() as u64, slices.saturating_mul(frames));
    if count == 0 || slices == 0 || !all.is_multiple_of(count) {
        let got = format!("{count} files for {all} slices");
        return Err(Error::bad_input(path, "data files", "whole slices, as many in each file", got));
    }
    let (in_file, each) = (all / count, divisor(all / count, slices));
    let place = |slice: u64| {
        let at = offset.saturating_add((slice % in_file).saturating_mul(slice_bytes));
        (Arc::clone(&files[(slice / in_file) as usize]), at)
    };
    let parts = (0..slices / each).map(|part| place(frame * slices + part * each)).collect();
    Ok((parts, each))
}

/// The greatest common divisor.
fn divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_lie_in_files_of_any_number_of_slices() {
        let dir = tempfile::tempdir().unwrap();
        let file = |n: usize| {
            let path = crate::formats::tests::write(&dir, &format!("{n}"), b"x");
            Arc::new(ByteSource::open(&path, crate::bytes::IoMode::Auto).unwrap())
        };
        let files: Vec<Arc<ByteSource>> = (0..6).map(file).collect();
        let places = |count: usize, frame: u64| {
            let (parts, each) = parts_of(Path::new("h"), &files[..count], 7, [frame, 3], [4, 10]).unwrap();
            let name = |source: &ByteSource| source.path().file_name().unwrap().to_owned();
            let named: Vec<_> = parts.iter().map(|(f, at)| (name(f).into_string().unwrap(), *at)).collect();
            (named, each)
        };
        let at = |name: &str, at: u64| (name.to_string(), at);
        assert_eq!(places(1, 2), (vec![at("0", 87)], 4));
        assert_eq!(places(3, 1), (vec![at("1", 7)], 4));
        assert_eq!(places(6, 1), (vec![at("2", 7), at("3", 7)], 2));
        assert_eq!(places(2, 1), (vec![at("0", 47), at("1", 7)], 2));
        assert!(parts_of(Path::new("h"), &files[..5], 0, [0, 3], [4, 10]).is_err());
    }

    #[test]
    fn times_need_a_step() {
        assert_eq!(list(1, Some([0.0, 1.0])), []);
        assert_eq!(list(2, Some([5.0, 0.5])), [("t0".into(), Some(5.0)), ("t1".into(), Some(5.5))]);
        assert_eq!(list(2, Some([5.0, 0.0])), [("t0".into(), None), ("t1".into(), None)]);
        assert_eq!(list(2, None)[1], ("t1".into(), None));
    }
}
