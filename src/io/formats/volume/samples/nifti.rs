//! The header of NIfTI: version 1, and version 2 where that does not hold the grid.

use super::super::nifti::INTENT_LABEL;
use super::heads::no_type;
use super::{Anatomy, GridMeta, SampleFormat};
use crate::error::{Error, Result};
use crate::grid::Geometry;
use crate::volume::ScalarType;
use crate::volume::units::Unit;
use glam::{DMat3, DQuat, DVec3};
use std::path::Path;

/// The most samples along an axis in version 1.
const MOST_1: u64 = i16::MAX as u64;
/// Parts of a voxel by which a sample may be misplaced by numbers of version 1.
const LITTLE: f64 = 1e-3;
/// The transformations of a header: of the scanner, and to other coordinates.
const SCANNER: i32 = 1;
const ALIGNED: i32 = 2;

/// NIfTI's number of a unit of lengths, 0 for none; and how many of them one of ours is.
pub(super) fn unit_of(unit: Option<&Unit>) -> (u8, f64) {
    let Some(unit) = unit else { return (0, 1.0) };
    match unit.as_str() {
        "m" => return (1, 1.0),
        "mm" => return (2, 1.0),
        "µm" => return (3, 1.0),
        _ => {}
    }
    let Some((number, power)) = unit.metres() else { return (0, 1.0) };
    let (code, own) = match number * libm::pow(10.0, f64::from(power)) {
        metres if metres >= 1.0 => (1, 0),
        metres if metres >= 1e-3 => (2, -3),
        _ => (3, -6),
    };
    let tens = libm::pow(10.0, f64::from((power - own).abs()));
    (code, if power < own { number / tens } else { number * tens })
}

/// Whether lengths are converted to another unit.
pub(super) fn converts(format: SampleFormat, unit: Option<&Unit>) -> bool {
    let is_nifti = matches!(format, SampleFormat::Nifti | SampleFormat::NiftiGz);
    let is_own = unit.is_some_and(|unit| ["m", "mm", "µm"].contains(&unit.as_str()));
    is_nifti && !is_own && unit_of(unit).0 > 0
}

fn datatype(scalar: ScalarType) -> Result<i16> {
    Ok(match scalar {
        ScalarType::U8 => 2,
        ScalarType::I16 => 4,
        ScalarType::I32 => 8,
        ScalarType::F32 => 16,
        ScalarType::F64 => 64,
        ScalarType::I8 => 256,
        ScalarType::U16 => 512,
        ScalarType::U32 => 768,
        ScalarType::I64 => 1024,
        ScalarType::U64 => 1280,
        ScalarType::F16 => return Err(no_type("NIfTI", scalar)),
    })
}

/// The header, and what stands between it and the samples.
pub(super) fn head(meta: &GridMeta, path: &Path) -> Result<Vec<u8>> {
    let (code, factor) = unit_of(meta.length_unit());
    let mut geometry = meta.geometry_in(Anatomy::Ras);
    geometry.origin = geometry.origin.map(|x| factor * x);
    geometry.spacing = geometry.spacing.map(|x| factor * x);
    let transform = if meta.anatomy == Anatomy::Unknown { ALIGNED } else { SCANNER };
    let header = NiftiHead { meta, kind: datatype(meta.field().scalar)?, geometry, unit: code, transform };
    if meta.dims.iter().any(|&n| n > i64::MAX as u64) {
        return Err(Error::usage(format!("cannot write {}: too many samples along an axis", path.display())));
    }
    let is_1 = meta.dims.iter().all(|&n| n <= MOST_1) && is_in_f32(&geometry, meta.dims);
    Ok(if is_1 { header.version_1() } else { header.version_2() })
}

/// Whether samples lie nearly where they should with a map in `f32`.
fn is_in_f32(geometry: &Geometry, dims: [u64; 3]) -> bool {
    let least = geometry.spacing.iter().copied().fold(f64::INFINITY, f64::min);
    let lost = |x: f64| (f64::from(x as f32) - x).abs();
    let axes = geometry.axes();
    (0..3).all(|r| {
        let along = (0..3).map(|a| lost(axes[a][r]) * dims[a] as f64);
        // False for numbers that f32 does not have, too.
        lost(geometry.origin[r]) + along.sum::<f64>() <= LITTLE * least
    })
}

struct NiftiHead<'a> {
    meta: &'a GridMeta,
    kind: i16,
    geometry: Geometry,
    unit: u8,
    transform: i32,
}

impl NiftiHead<'_> {
    /// The rows of the map to the world.
    fn rows(&self) -> [[f64; 4]; 3] {
        let axes = self.geometry.axes();
        std::array::from_fn(|r| [axes[0][r], axes[1][r], axes[2][r], self.geometry.origin[r]])
    }

    /// The unit quaternion of the directions, b, c, d of it, and the sign of the third axis; none
    /// where the axes are not at right angles.
    fn quaternion(&self) -> Option<([f64; 3], f64)> {
        let [x, y, z] = self.geometry.direction.map(DVec3::from_array);
        let is_right = [x.dot(y), y.dot(z), z.dot(x)].iter().all(|c| c.abs() < 1e-6);
        let hand = if x.cross(y).dot(z) < 0.0 { -1.0 } else { 1.0 };
        let q = DQuat::from_mat3(&DMat3::from_cols(x, y, hand * z)).normalize();
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        (is_right && q.is_finite()).then_some(([sign * q.x, sign * q.y, sign * q.z], hand))
    }

    /// What samples mean: NIfTI's number of labels, or nothing.
    fn intent(&self) -> i32 {
        if self.meta.field().is_labels { INTENT_LABEL } else { 0 }
    }

    fn pixdim(&self) -> [f64; 8] {
        let ([x, y, z], hand) = (self.geometry.spacing, self.quaternion().map_or(1.0, |(_, hand)| hand));
        [hand, x, y, z, 1.0, 1.0, 1.0, 1.0]
    }

    fn dim(&self) -> [u64; 8] {
        let [x, y, z] = self.meta.dims;
        [3, x, y, z, 1, 1, 1, 1]
    }

    /// Text that fills a field of the header.
    fn text(text: &str, size: usize) -> Vec<u8> {
        let mut end = text.len().min(size - 1);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let mut bytes = text.as_bytes()[..end].to_vec();
        bytes.resize(size, 0);
        bytes
    }

    fn version_1(&self) -> Vec<u8> {
        let mut h = vec![0; 352];
        let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
        let floats =
            |list: &[f64]| -> Vec<u8> { list.iter().flat_map(|x| (*x as f32).to_le_bytes()).collect() };
        put(0, &348_i32.to_le_bytes());
        put(38, b"r");
        let dim: Vec<u8> = self.dim().iter().flat_map(|n| (*n as i16).to_le_bytes()).collect();
        put(40, &dim);
        put(68, &(self.intent() as i16).to_le_bytes());
        put(70, &self.kind.to_le_bytes());
        put(72, &(8 * self.meta.field().scalar.bytes() as i16).to_le_bytes());
        put(76, &floats(&self.pixdim()));
        put(108, &floats(&[352.0, 1.0, 0.0]));
        put(123, &[self.unit]);
        put(148, &Self::text(&format!("isospan {}", env!("CARGO_PKG_VERSION")), 80));
        if let Some((quaternion, _)) = self.quaternion() {
            put(252, &(self.transform as i16).to_le_bytes());
            put(256, &floats(&quaternion));
            put(268, &floats(&self.geometry.origin));
        }
        put(254, &(self.transform as i16).to_le_bytes());
        put(280, &floats(self.rows().as_flattened()));
        put(328, &Self::text(&self.meta.field().name, 16));
        put(344, b"n+1\0");
        h
    }

    fn version_2(&self) -> Vec<u8> {
        let mut h = vec![0; 544];
        let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
        let floats = |list: &[f64]| -> Vec<u8> { list.iter().flat_map(|x| x.to_le_bytes()).collect() };
        put(0, &540_i32.to_le_bytes());
        put(4, b"n+2\0\r\n\x1a\n");
        put(12, &self.kind.to_le_bytes());
        put(14, &(8 * self.meta.field().scalar.bytes() as i16).to_le_bytes());
        let dim: Vec<u8> = self.dim().iter().flat_map(|n| (*n as i64).to_le_bytes()).collect();
        put(16, &dim);
        put(104, &floats(&self.pixdim()));
        put(168, &544_i64.to_le_bytes());
        put(176, &floats(&[1.0, 0.0]));
        put(240, &Self::text(&format!("isospan {}", env!("CARGO_PKG_VERSION")), 80));
        if let Some((quaternion, _)) = self.quaternion() {
            put(344, &self.transform.to_le_bytes());
            put(352, &floats(&quaternion));
            put(376, &floats(&self.geometry.origin));
        }
        put(348, &self.transform.to_le_bytes());
        put(400, &floats(self.rows().as_flattened()));
        put(500, &i32::from(self.unit).to_le_bytes());
        put(504, &self.intent().to_le_bytes());
        put(508, &Self::text(&self.meta.field().name, 16));
        h
    }
}
