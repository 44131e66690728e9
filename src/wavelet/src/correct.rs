//! What decoded samples lack, so that none is off by more than a bound, or none at all.

use crate::error::{Error, Result};
use crate::pyramid::{Box3, TILE};

/// Magnitudes of samples that are whole numbers: `f32` has each of them.
const WHOLE: f32 = (1 << 24) as f32;

/// How samples are corrected after they are decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Correction {
    /// Not at all.
    None,
    /// By multiples of a quantum.
    Quanta(f64),
    /// Decoded samples are rounded, and corrected by whole numbers.
    Whole,
}

impl Correction {
    /// For an error of at most `bound` at each sample, of samples in a range.
    pub(crate) fn within(bound: f64, range: [f64; 2]) -> Result<Self> {
        // A corrected sample is rounded to f32: by half of its last place, at most.
        let largest = range[0].abs().max(range[1].abs());
        let rounding = (largest + bound) * 0.5_f64.powi(24);
        match bound > 2.0 * rounding && bound.is_finite() {
            true => Ok(Self::Quanta(2.0 * (bound - rounding))),
            false => Err(Error::Bound { bound, least: largest * 0.5_f64.powi(22) }),
        }
    }

    /// For no error of samples that are whole numbers.
    pub(crate) fn lossless(samples: &[f32]) -> Result<Self> {
        let is_whole = |s: &f32| s.fract() == 0.0 && s.abs() <= WHOLE;
        match samples.iter().position(|s| !is_whole(s)) {
            Some(index) => Err(Error::NotWhole { index }),
            None => Ok(Self::Whole),
        }
    }

    /// The number that corrects a decoded sample.
    pub(crate) fn number(self, sample: f32, decoded: f32, bound: f64) -> i32 {
        let (sample, decoded) = (f64::from(sample), f64::from(decoded));
        match self {
            Self::None => 0,
            Self::Quanta(_) if (sample - decoded).abs() <= bound => 0,
            Self::Quanta(quantum) => ((sample - decoded) / quantum).round() as i32,
            Self::Whole => (sample - (decoded + 0.5).floor()) as i32,
        }
    }

    /// A decoded sample, corrected.
    pub(crate) fn correct(self, decoded: f32, number: i32) -> f32 {
        match self {
            Self::Quanta(quantum) if number != 0 => (f64::from(decoded) + quantum * f64::from(number)) as f32,
            Self::Whole => ((f64::from(decoded) + 0.5).floor() + f64::from(number)) as f32,
            _ => decoded,
        }
    }
}

/// The boxes whose corrections are coded together, z slowest.
pub(crate) fn boxes(dims: [usize; 3]) -> impl Iterator<Item = Box3> {
    let [nx, ny, nz] = dims.map(|n| n.div_ceil(TILE));
    (0..nx * ny * nz).map(move |i| {
        let start = [i % nx, i / nx % ny, i / nx / ny].map(|n| TILE * n);
        Box3 { start, size: [TILE; 3] }.cut(&Box3::all(dims))
    })
}
