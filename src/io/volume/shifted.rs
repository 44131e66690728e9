//! Values that `f32` does not hold well: they are counted from an offset.
//!
//! Internally, all values are `f32`. Pressures of 101325000 Pa that differ by 3 Pa, or numbers near
//! 2^31, would lose their differences. So a field has an *offset*, an `f64`: a sample is kept as
//! its value less the offset, subtracted in `f64` (whole numbers of 64 bits: in integers) and
//! rounded once. It is 0 wherever `f32` holds the range well, which is nearly always.

use super::{ScalarType, SlabStream, VolumeInfo, VolumeReader, half_at};
use crate::error::Result;
use crate::exec::CancelToken;
use crate::grid::IndexBox;
use byteorder::{ByteOrder, LE};
use std::ops::Range;

/// Whole numbers up to this are all `f32`.
const WHOLE: f64 = 16_777_216.0;
/// The rounding that is not reported, as a part of the range: 2^-20.
const LITTLE: f64 = 1.0 / 1_048_576.0;
/// An offset is chosen where values are this many ranges away from 0.
const FAR: f64 = 8.0;

/// The `f64` that prints as the `f32` does: 0.1, not 0.10000000149011612. Cast back it is the same
/// `f32`.
pub fn shortest(v: f32) -> f64 {
    v.to_string().parse().unwrap_or(f64::from(v))
}

/// Whether values of this type, so scaled, may need an offset.
pub fn may_need_offset(scalar: ScalarType, slope: f64, intercept: f64) -> bool {
    use ScalarType::{F16, F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
    let far = |most: f64| intercept.abs() > FAR * most * slope.abs();
    match scalar {
        F64 | U32 | I32 | U64 | I64 => true,
        F16 | F32 => intercept != 0.0,
        U16 | I16 => far(65536.0),
        U8 | I8 => far(256.0),
    }
}

/// Whether all values are whole numbers, each of which counts.
pub fn is_whole(scalar: ScalarType, slope: f64, intercept: f64) -> bool {
    !scalar.is_float() && slope == 1.0 && intercept.fract() == 0.0
}

/// Whether a value is the one that means "no data", which a file may have rounded to `f32`.
pub fn is_missing(value: f64, missing: Option<f64>) -> bool {
    missing.is_some_and(|m| value == m || value == f64::from(m as f32))
}

/// What a pass over samples finds about their values less an offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surveyed {
    /// Least and largest finite value; the first is larger than the second where there is none.
    pub range: [f64; 2],
    /// The largest difference of a value from the `f32` that stands for it.
    pub(crate) lost: f64,
}

impl Surveyed {
    /// What is known before the first value.
    pub const NONE: Self = Self { range: [f64::INFINITY, f64::NEG_INFINITY], lost: 0.0 };

    /// Takes a value into account.
    #[inline]
    pub fn add(&mut self, v: f64) {
        if v.is_finite() {
            self.range = [self.range[0].min(v), self.range[1].max(v)];
            self.lost = self.lost.max((f64::from(v as f32) - v).abs());
        }
    }

    fn is_empty(&self) -> bool {
        self.range[0] > self.range[1]
    }

    fn width(&self) -> f64 {
        self.range[1] - self.range[0]
    }

    fn largest(&self) -> f64 {
        self.range[0].abs().max(self.range[1].abs())
    }

    /// The offset for values of this range: a round number near its middle, or 0 where `f32` holds
    /// them as they are. `whole`: each whole number counts.
    pub fn offset(&self, whole: bool) -> f64 {
        let (lo, width) = (self.range[0], self.width());
        if self.is_empty() || !width.is_finite() || self.lost == 0.0 {
            return 0.0;
        }
        let middle = lo + width / 2.0;
        let middle = if whole { middle.round() } else { middle };
        // Powers of ten below 1 are no f64; their inverses are.
        let digits = if width > 0.0 { libm::floor(libm::log10(width / 2.0)) } else { f64::NAN };
        let unit = libm::pow(10.0, digits.abs());
        let round = match digits {
            d if d >= 0.0 => (middle / unit).round() * unit,
            d if d < 0.0 && !whole && (middle * unit).abs() < 1e15 => (middle * unit).round() / unit,
            _ => middle,
        };
        let reach = |offset: f64| (self.range[0] - offset).abs().max((self.range[1] - offset).abs());
        let exact = [round, middle].into_iter().find(|&offset| whole && reach(offset) <= WHOLE);
        exact.unwrap_or(if middle.abs() >= FAR * width { round } else { 0.0 })
    }

    /// The rounding, where it is worth a report.
    pub fn rounding(&self, whole: bool) -> f64 {
        let matters = !self.is_empty() && (whole || self.lost > LITTLE * self.width());
        if matters { self.lost } else { 0.0 }
    }

    /// Whether `f32` cannot hold the values at all: they are too large, or so small that nothing is
    /// left of them.
    pub fn is_beyond(&self) -> bool {
        let tiny = self.largest() < f64::from(f32::MIN_POSITIVE) && self.lost > 1e-3 * self.width();
        !self.is_empty() && (self.largest() > f64::from(f32::MAX) || tiny)
    }
}

/// Surveys all samples of a stream; `missing` is a value that means no data.
///
/// # Errors
/// Those of the stream.
pub fn survey(
    mut stream: Box<dyn SlabStream>,
    missing: Option<f64>,
    offset: f64,
    cancel: &CancelToken,
) -> Result<Surveyed> {
    let (info, mut bytes, mut out) = (stream.info().clone(), vec![], Surveyed::NONE);
    while stream.next_slab(&mut bytes)?.is_some() {
        each_value(&bytes, &info, missing, offset, |v| out.add(v));
        cancel.check()?;
    }
    // A zero has no sign: which of two zeros is the lesser one differs from machine to machine.
    out.range = out.range.map(|v| v + 0.0);
    Ok(out)
}

/// Calls `take` with the value of each stored sample less an offset, NaN of what means "no data":
/// what the file declares, and the value `missing`.
pub fn each_value(
    bytes: &[u8],
    info: &VolumeInfo,
    missing: Option<f64>,
    offset: f64,
    mut take: impl FnMut(f64),
) {
    let (slope, intercept, scalar) = (info.slope, info.intercept, info.field.scalar);
    let plain = slope == 1.0 && intercept == 0.0;
    let declared = info.missing.map(|m| scalar.rounded(m));
    let mut float = |stored: f64| {
        let value = if plain { stored } else { slope * stored + intercept };
        let none = Some(stored) == declared || is_missing(value, missing);
        take(if none { f64::NAN } else { value - offset });
    };
    macro_rules! floats {
        ($t:ty, $read:expr) => {
            bytes.chunks_exact(size_of::<$t>()).map($read).for_each(|v: $t| float(v as f64))
        };
    }
    // Above 2^53 a whole number is no f64; less the offset, which is whole too, it is.
    macro_rules! wide {
        ($read:expr) => {
            bytes.chunks_exact(8).map($read).for_each(|v| {
                let stored = v as f64;
                let none = Some(stored) == declared || is_missing(stored, missing);
                take(if none { f64::NAN } else { (i128::from(v) - offset as i128) as f64 });
            })
        };
    }
    let whole = plain && offset.fract() == 0.0;
    match scalar {
        ScalarType::U8 => floats!(u8, |b| b[0]),
        ScalarType::I8 => floats!(i8, |b| b[0] as i8),
        ScalarType::U16 => floats!(u16, LE::read_u16),
        ScalarType::I16 => floats!(i16, LE::read_i16),
        ScalarType::U32 => floats!(u32, LE::read_u32),
        ScalarType::I32 => floats!(i32, LE::read_i32),
        ScalarType::U64 if whole => wide!(LE::read_u64),
        ScalarType::I64 if whole => wide!(LE::read_i64),
        ScalarType::U64 => floats!(u64, LE::read_u64),
        ScalarType::I64 => floats!(i64, LE::read_i64),
        ScalarType::F16 => bytes.chunks_exact(2).for_each(|b| float(half_at(b).into())),
        ScalarType::F32 => floats!(f32, LE::read_f32),
        ScalarType::F64 => floats!(f64, LE::read_f64),
    }
}

/// A volume whose values come out less an offset.
pub struct Shifted {
    reader: Box<dyn VolumeReader>,
    stored: VolumeInfo,
    offset: f64,
    missing: Option<f64>,
}

impl Shifted {
    /// `missing` is a value that comes out as NaN, besides what the file declares.
    pub fn new(reader: Box<dyn VolumeReader>, offset: f64, missing: Option<f64>) -> Self {
        let stored = reader.stored_info();
        Self { reader, stored, offset, missing }
    }
}

impl VolumeReader for Shifted {
    fn info(&self) -> &VolumeInfo {
        self.reader.info()
    }

    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        let mut bytes = vec![0; out.len() * self.stored.field.scalar.bytes()];
        self.reader.read_stored(voxels, &mut bytes)?;
        let mut next = out.iter_mut();
        each_value(&bytes, &self.stored, self.missing, self.offset, |v| {
            *next.next().expect("a sample for each value") = v as f32;
        });
        Ok(())
    }

    fn will_need(&self, voxels: IndexBox) {
        self.reader.will_need(voxels);
    }

    fn release(&self, slices: Range<u64>) {
        self.reader.release(slices);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surveyed(values: &[f64]) -> Surveyed {
        values.iter().fold(Surveyed::NONE, |mut s, &v| {
            s.add(v);
            s
        })
    }

    #[test]
    fn offsets_are_chosen_where_f32_is_too_coarse() {
        assert_eq!(surveyed(&[101_324_997.3, 101_325_002.9]).offset(false), 101_325_000.0);
        assert_eq!(surveyed(&[2e9, 2e9 + 1000.0, 2e9 + 7.0]).offset(true), 2_000_000_500.0);
        assert_eq!(surveyed(&[101_325_000.31, 101_325_000.9]).offset(false), 101_325_000.6);
        // A constant is all offset.
        assert_eq!(surveyed(&[101_325_000.3]).offset(false), 101_325_000.3);
        // A hundred million whole numbers from 0 on are too many for any offset; thirty million are
        // not.
        assert_eq!(surveyed(&[0.0, 99_999_999.0]).offset(true), 0.0);
        let s = surveyed(&[1.0, 29_999_999.0]);
        assert_eq!((s.offset(true), s.offset(false)), (15_000_000.0, 0.0));
        for values in
            [&[-0.1, 1.1][..], &[1e6, 1e6 + 1.0], &[], &[f64::NAN], &[3e5 + 0.1, 4e5], &[-1e300, 1e300]]
        {
            assert_eq!(surveyed(values).offset(false), 0.0, "{values:?}");
        }
        let small = surveyed(&[-1e-300, 1e-300]);
        assert!(small.is_beyond() && surveyed(&[1e39]).is_beyond() && !surveyed(&[0.0, 1e38]).is_beyond());
        assert!(!surveyed(&[0.1, 0.3]).is_beyond() && !Surveyed::NONE.is_beyond());
    }

    #[test]
    fn what_is_lost_is_told_where_it_matters() {
        assert_eq!(surveyed(&[0.1, 0.7]).rounding(false), 0.0);
        assert_eq!(surveyed(&[4_000_000_063.0, 0.0]).rounding(true), 63.0);
        assert_eq!(surveyed(&[1e8 + 1.0, 1e8]).rounding(false), 1.0);
    }
}
