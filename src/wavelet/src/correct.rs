//! What decoded samples lack, so that none is off by more than a bound, or none at all.

use crate::error::{Error, Result};
use crate::lengths::{Lengths, encode_lengths};
use crate::pyramid::{Box3, TILE};
use crate::tile::{decode_numbers, encode_numbers};

/// Magnitudes of samples that are whole numbers: `f32` has each of them.
const WHOLE: f32 = (1 << 24) as f32;

/// How samples are corrected after they are decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Correction {
    /// Not at all.
    None,
    /// By multiples of a quantum.
    Quanta(f64),
    /// Decoded samples are rounded, and corrected by whole numbers.
    Whole,
}

impl Correction {
    /// For an error of at most `bound` at each sample, of samples in a range.
    ///
    /// # Errors
    /// [`Error::Bound`] for one that `f32` does not hold.
    pub fn within(bound: f64, range: [f64; 2]) -> Result<Self> {
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
    pub fn number(self, sample: f32, decoded: f32, bound: f64) -> i32 {
        let (sample, decoded) = (f64::from(sample), f64::from(decoded));
        match self {
            Self::None => 0,
            Self::Quanta(_) if (sample - decoded).abs() <= bound => 0,
            Self::Quanta(quantum) => ((sample - decoded) / quantum).round() as i32,
            Self::Whole => (sample - (decoded + 0.5).floor()) as i32,
        }
    }

    /// A decoded sample, corrected.
    pub fn correct(self, decoded: f32, number: i32) -> f32 {
        match self {
            Self::Quanta(quantum) if number != 0 => (f64::from(decoded) + quantum * f64::from(number)) as f32,
            Self::Whole => ((f64::from(decoded) + 0.5).floor() + f64::from(number)) as f32,
            _ => decoded,
        }
    }
}

/// The boxes whose corrections are coded together, z slowest.
pub(crate) fn boxes(dims: [usize; 3]) -> impl Iterator<Item = Box3> {
    boxes_in(Box3::all(dims))
}

/// Boxes of so many samples along each axis as a tile has, from the first of a box on, z slowest.
pub(crate) fn boxes_in(place: Box3) -> impl Iterator<Item = Box3> {
    let [nx, ny, nz] = place.size.map(|n| n.div_ceil(TILE));
    (0..nx * ny * nz).map(move |i| {
        let at = [i % nx, i / nx % ny, i / nx / ny];
        let start = std::array::from_fn(|a| place.start[a] + TILE * at[a]);
        Box3 { start, size: [TILE; 3] }.cut(&place)
    })
}

/// The corrections of a chunk as bytes: `numbers` of its samples, x fastest. No bytes are no
/// corrections.
///
/// # Errors
/// [`Error::Damaged`] for numbers that are too large.
pub fn encode_corrections(chunk: &Box3, numbers: &[i32]) -> Result<Vec<u8>> {
    if numbers.iter().all(|n| *n == 0) {
        return Ok(vec![]);
    }
    let (mut lengths, mut rest) = (vec![], vec![]);
    for place in boxes_in(*chunk) {
        let bytes = encode_numbers(place, chunk.values_of(numbers, &place))?;
        lengths.push(bytes.len() as u32);
        rest.extend(bytes);
    }
    let lengths = encode_lengths(&lengths);
    let mut out = (lengths.len() as u32).to_le_bytes().to_vec();
    out.extend(lengths);
    out.extend(rest);
    Ok(out)
}

/// Adds to `numbers`, those of a box of samples, what the corrections of a chunk say there.
///
/// # Errors
/// [`Error::Damaged`].
pub fn decode_corrections(chunk: &Box3, bytes: &[u8], wanted: &Box3, numbers: &mut [i32]) -> Result<()> {
    if bytes.is_empty() {
        return Ok(());
    }
    let short = Error::Damaged("corrections end early");
    let (of_lengths, rest) = bytes.split_first_chunk().ok_or(short.clone())?;
    let (lengths, mut rest) =
        rest.split_at_checked(u32::from_le_bytes(*of_lengths) as usize).ok_or(short.clone())?;
    let mut lengths = Lengths::new(lengths);
    for place in boxes_in(*chunk) {
        let (bytes, behind) = rest.split_at_checked(lengths.next()? as usize).ok_or(short.clone())?;
        rest = behind;
        if bytes.is_empty() || place.cut(wanted).is_empty() {
            continue;
        }
        wanted.copy_common(numbers, &place, &decode_numbers(place, bytes)?.numbers);
    }
    lengths.finish()?;
    if rest.is_empty() { Ok(()) } else { Err(Error::Damaged("bytes behind the corrections")) }
}
