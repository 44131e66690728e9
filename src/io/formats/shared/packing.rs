//! What attributes say about the stored numbers of an array, by the CF conventions.

use crate::error::{Error, Result};
use crate::grid::IndexBox;
use crate::volume::{ScalarType, VolumeInfo};

/// The numbers of an attribute.
pub(in crate::formats) struct AttributeNumbers {
    pub(in crate::formats) values: Vec<f64>,
    /// Whether they are stored as floats.
    pub(in crate::formats) are_floats: bool,
}

/// The attributes of an array.
pub(in crate::formats) trait Attributes {
    /// The numbers of an attribute; `None` where there is none of this name.
    ///
    /// # Errors
    /// [`Error::BadInput`] where it has no numbers.
    fn numbers(&self, name: &str) -> Result<Option<AttributeNumbers>>;

    /// The text of an attribute; "" where there is no such text.
    fn text(&self, name: &str) -> String;

    /// The error of attributes that say something else than what is expected.
    fn wrong(&self, names: &str, expected: &str, got: String) -> Error;

    /// An attribute that is one number; `None` where there is none of this name.
    ///
    /// # Errors
    /// [`Error::BadInput`] where it is not one number.
    fn number(&self, name: &str) -> Result<Option<f64>> {
        let Some(AttributeNumbers { values, .. }) = self.numbers(name)? else { return Ok(None) };
        match values[..] {
            [value] => Ok(Some(value)),
            _ => Err(self.wrong(name, "one number", format!("{} values", values.len()))),
        }
    }
}

/// What attributes say about stored numbers.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::formats) struct Packing {
    slope: f64,
    intercept: f64,
    /// The stored numbers that mean "no data".
    missing: Vec<f64>,
    /// The stored numbers that have values, where there is such a range.
    valid: Option<[f64; 2]>,
}

impl Packing {
    /// What the attributes of an array of this type say. `usual` gives the stored number that means
    /// "no data" where no attribute names one, for numbers that are packed or not.
    ///
    /// # Errors
    /// [`Error::BadInput`] for attributes that contradict each other, or are not numbers.
    pub(in crate::formats) fn of(
        attributes: &impl Attributes,
        scalar: ScalarType,
        usual: impl FnOnce(bool) -> Option<f64>,
    ) -> Result<Self> {
        let (scale, offset) = (attributes.number("scale_factor")?, attributes.number("add_offset")?);
        let (slope, intercept) = (scale.unwrap_or(1.0), offset.unwrap_or(0.0));
        if !(slope.is_finite() && slope != 0.0 && intercept.is_finite()) {
            let expected = "finite numbers, the first not 0";
            let got = format!("{slope} and {intercept}");
            return Err(attributes.wrong("scale_factor, add_offset", expected, got));
        }
        let sign = Sign::of(attributes, scalar);
        let mut missing = vec![];
        for (name, is_one) in [("_FillValue", true), ("missing_value", false)] {
            let Some(numbers) = attributes.numbers(name)? else { continue };
            if is_one && numbers.values.len() != 1 {
                let got = format!("{} values", numbers.values.len());
                return Err(attributes.wrong(name, "one number", got));
            }
            missing.push(sign.of_numbers(numbers));
        }
        if missing.is_empty() {
            let values = usual(scale.is_some() || offset.is_some()).into_iter().collect();
            missing.push(sign.of_numbers(AttributeNumbers { values, are_floats: scalar.is_float() }));
        }
        // What is not a number is missing anyway.
        let mut missing: Vec<f64> = missing.into_iter().flatten().filter(|v| !v.is_nan()).collect();
        missing.dedup_by_key(|v| scalar.rounded(*v));
        let valid = valid_range(attributes, &sign, [slope, intercept])?;
        Ok(Self { slope, intercept, missing, valid })
    }

    /// The conversion of stored numbers where some have no value by their range, or several numbers
    /// mean "no data"; else `None`, and `info` has all of it.
    pub(in crate::formats) fn into_info(self, info: &mut VolumeInfo) -> Option<Convert> {
        let Self { slope, intercept, missing, valid } = self;
        if let (&[] | &[_], None) = (&missing[..], valid) {
            (info.slope, info.intercept, info.missing) = (slope, intercept, missing.first().copied());
            return None;
        }
        let missing = missing.into_iter().map(|v| info.field.scalar.rounded(v)).collect();
        let valid = valid.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        Some(Convert { valid, missing, lines: vec![[slope, intercept]], slices: [1, 1] })
    }

    /// Applies slope and intercept to the numbers of a coordinate variable.
    pub(in crate::formats) fn unpack(&self, numbers: &mut [f64]) {
        numbers.iter_mut().for_each(|v| *v = self.slope * *v + self.intercept);
    }
}

/// The type of integers of which `_Unsigned` says that they stand for others: some formats have no
/// unsigned ones.
pub(in crate::formats) fn signed_as(scalar: ScalarType, unsigned: &str) -> ScalarType {
    use ScalarType::{I8, I16, I32, I64, U8, U16, U32, U64};
    let pairs = [(I8, U8), (I16, U16), (I32, U32), (I64, U64)];
    let is = |word: &str| unsigned.eq_ignore_ascii_case(word);
    let other = |&(signed, other): &(ScalarType, ScalarType)| match scalar {
        s if s == signed && is("true") => Some(other),
        s if s == other && is("false") => Some(signed),
        _ => None,
    };
    pairs.iter().find_map(other).unwrap_or(scalar)
}

/// What the numbers of attributes stand for where [`signed_as`] changes the type of samples.
struct Sign {
    scalar: ScalarType,
    is_changed: bool,
}

impl Sign {
    fn of(attributes: &impl Attributes, stored: ScalarType) -> Self {
        let unsigned = attributes.text("_Unsigned");
        let scalar = signed_as(stored, &unsigned);
        // Some callers know only what the samples stand for.
        let is_changed = ["true", "false"].iter().any(|word| unsigned.eq_ignore_ascii_case(word));
        Self { scalar, is_changed: is_changed && !scalar.is_float() }
    }

    /// The same bits as numbers of the type that samples have.
    fn of_numbers(&self, numbers: AttributeNumbers) -> Vec<f64> {
        let AttributeNumbers { mut values, are_floats } = numbers;
        let bits = 8 * self.scalar.bytes() as i32;
        let (all, half) = (libm::exp2(f64::from(bits)), libm::exp2(f64::from(bits - 1)));
        let is_unsigned = signed_as(self.scalar, "false") != self.scalar;
        for v in values.iter_mut().filter(|_| self.is_changed && !are_floats) {
            match is_unsigned {
                true if *v < 0.0 => *v += all,
                false if *v >= half => *v -= all,
                _ => {}
            }
        }
        values
    }
}

/// The value of samples that were never written, in the library of NetCDF.
#[allow(clippy::excessive_precision)]
pub(in crate::formats) fn netcdf_fill(scalar: ScalarType) -> Option<f64> {
    Some(match scalar {
        // Every byte may be a value.
        ScalarType::I8 | ScalarType::U8 => return None,
        ScalarType::I16 => -32767.0,
        ScalarType::U16 => 65535.0,
        ScalarType::I32 => -2_147_483_647.0,
        ScalarType::U32 => 4_294_967_295.0,
        ScalarType::I64 => -9_223_372_036_854_775_806.0,
        ScalarType::U64 => 18_446_744_073_709_551_614.0,
        ScalarType::F16 | ScalarType::F32 | ScalarType::F64 => 9.969_209_968_386_869_047e36,
    })
}

/// The range of stored numbers that have values.
fn valid_range(
    attributes: &impl Attributes,
    sign: &Sign,
    [slope, intercept]: [f64; 2],
) -> Result<Option<[f64; 2]>> {
    let all = [f64::NEG_INFINITY, f64::INFINITY];
    let (mut valid, mut are_floats) = (all, false);
    for (name, at, count) in [("valid_range", 0, 2), ("valid_min", 0, 1), ("valid_max", 1, 1)] {
        let Some(numbers) = attributes.numbers(name)? else { continue };
        let own_floats = numbers.are_floats;
        if numbers.values.len() != count {
            let got = format!("{} of them", numbers.values.len());
            return Err(attributes.wrong(name, &format!("{count} number(s)"), got));
        }
        valid[at..at + count].copy_from_slice(&sign.of_numbers(numbers));
        are_floats |= own_floats;
    }
    if valid == all {
        return Ok(None);
    }
    // Where packed integers have a range of floats, it is that of the values.
    if !sign.scalar.is_float() && are_floats {
        valid = valid.map(|v| (v - intercept) / slope);
        valid.sort_by(f64::total_cmp);
    }
    Ok(Some(valid))
}

/// How stored numbers become values. What is outside of `valid` has none.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::formats) struct Convert {
    pub(in crate::formats) valid: [f64; 2],
    /// Stored numbers that mean no data.
    pub(in crate::formats) missing: Vec<f64>,
    /// Slope and intercept of each slice along the slowest axes.
    pub(in crate::formats) lines: Vec<[f64; 2]>,
    /// Slices of the lines along y and z: 1 where they do not differ along it.
    pub(in crate::formats) slices: [u64; 2],
}

impl Convert {
    /// The value of a stored number of a row.
    pub(in crate::formats) fn value(&self, stored: f64, [y, z]: [u64; 2]) -> f64 {
        let [lo, hi] = self.valid;
        if !(lo..=hi).contains(&stored) || self.missing.contains(&stored) {
            return f64::NAN;
        }
        let at = |n: u64, count: u64| if count == 1 { 0 } else { n };
        let [slope, intercept] =
            self.lines[(at(z, self.slices[1]) * self.slices[0] + at(y, self.slices[0])) as usize];
        slope * stored + intercept
    }

    /// Appends the values of the stored numbers of a box, x fastest, as little-endian `f64`.
    pub(in crate::formats) fn push_values(&self, stored: &[f64], voxels: IndexBox, out: &mut Vec<u8>) {
        let ([nx, ny, _], lo) = (voxels.dims(), voxels.lo);
        out.reserve(8 * stored.len());
        for (row, numbers) in (0u64..).zip(stored.chunks(nx.max(1) as usize)) {
            let at = [lo[1] + row % ny, lo[2] + row / ny];
            out.extend(numbers.iter().flat_map(|&v| self.value(v, at).to_le_bytes()));
        }
    }
}
