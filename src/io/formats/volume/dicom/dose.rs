//! Dose grids of radiotherapy (RT Dose): frames without functional groups.
//!
//! Dose Grid Scaling makes stored numbers doses. The Grid Frame Offset Vector places the frames, in
//! one of two ways. From 0 on, its numbers are distances from Image Position along the normal of
//! the frames. From the z of Image Position on, they are the z of each frame; frames are transverse
//! then.
//!
//! The format: the DICOM standard, part PS3.3 (C.8.8.3).

use super::element::*;
use crate::error::{Error, Result};
use crate::geom::vec3::cross;
use std::path::Path;

/// The class of dose grids.
const RT_DOSE: &str = "1.2.840.10008.5.1.4.1.1.481.2";
/// How far two numbers that mean one place may be apart: places are written with few digits.
const SAME: f64 = 1e-2;

/// The factor of stored numbers; `None` of what is no dose grid.
pub(super) fn scaling(path: &Path, reader: &Reader<'_>, all: &DataSet) -> Result<Option<f64>> {
    let is_dose = reader.text(all, CLASS).is_some_and(|class| class == RT_DOSE);
    match reader.numbers(all, DOSE_SCALING)? {
        Some([factor]) if factor > 0.0 => Ok(Some(factor)),
        Some([factor]) => {
            Err(Error::bad_input(path, "Dose Grid Scaling", "a number above 0", factor.to_string()))
        }
        None if is_dose => Err(missing(path, "Dose Grid Scaling", DOSE_SCALING)),
        None => Ok(None),
    }
}

/// The places of the first samples of several frames; `None` of what is no dose grid.
pub(super) fn planes(
    path: &Path,
    reader: &Reader<'_>,
    all: &DataSet,
    count: usize,
) -> Result<Option<Vec<[f64; 3]>>> {
    if count < 2 || !all.has(DOSE_OFFSETS) {
        return Ok(None);
    }
    let offsets = reader.list(all, DOSE_OFFSETS, count)?;
    let offsets = offsets.ok_or_else(|| missing(path, "Grid Frame Offset Vector", DOSE_OFFSETS))?;
    let position: Option<[f64; 3]> = reader.numbers(all, POSITION)?;
    let [x, y, z] = position.ok_or_else(|| missing(path, "Image Position (Patient)", POSITION))?;
    let orientation: Option<[f64; 6]> = reader.numbers(all, ORIENTATION)?;
    let o = orientation.ok_or_else(|| missing(path, "Image Orientation (Patient)", ORIENTATION))?;
    let normal = cross([o[0], o[1], o[2]], [o[3], o[4], o[5]]);
    let is_transverse = normal[0].abs() < 1e-3 && normal[1].abs() < 1e-3;
    let first = offsets[0];
    if first == 0.0 {
        let along = |offset: f64| [x + offset * normal[0], y + offset * normal[1], z + offset * normal[2]];
        return Ok(Some(offsets.into_iter().map(along).collect()));
    }
    if is_transverse && (first - z).abs() < SAME {
        return Ok(Some(offsets.into_iter().map(|z| [x, y, z]).collect()));
    }
    let expected = format!("0 first, or of transverse frames the z of Image Position: {z}");
    Err(Error::bad_input(path, "Grid Frame Offset Vector", expected, first.to_string())
        .with_help("convert it to NRRD, with 3D Slicer"))
}
