//! Stored samples as values.

use crate::volume::ScalarType;
use byteorder::{BE, ByteOrder, LE};
use half::f16;

/// Converts a row of stored samples to values: `slope · stored + intercept` in `f64`, then rounded
/// to `f32`; a stored value equal to `missing` (as a number of the stored type) becomes NaN.
/// `bytes` holds `out.len()` samples.
///
/// # Panics
/// When the lengths do not match.
pub fn convert_row(
    bytes: &[u8],
    scalar: ScalarType,
    big_endian: bool,
    slope: f64,
    intercept: f64,
    missing: Option<f64>,
    out: &mut [f32],
) {
    assert_eq!(bytes.len(), out.len() * scalar.bytes(), "a sample for each value");
    // A NaN stays NaN without being compared, which also keeps it off the fast path's condition.
    let missing = missing.filter(|m| !m.is_nan());
    let plain = slope == 1.0 && intercept == 0.0 && missing.is_none();
    // One loop for each type, order of bytes and kind of scaling, each simple enough to be
    // vectorised.
    macro_rules! row {
        ($t:ty, $read:expr) => {{
            let stored = bytes.chunks_exact(size_of::<$t>()).map($read);
            let out = out.iter_mut();
            if plain {
                out.zip(stored).for_each(|(o, v)| *o = (v as f64) as f32);
            } else if let Some(m) = missing {
                // Compared in the stored type's precision: a text "-1e20" is no f32.
                let m = scalar.rounded(m);
                out.zip(stored).for_each(|(o, v)| {
                    let v = v as f64;
                    *o = if v == m { f32::NAN } else { (slope * v + intercept) as f32 };
                });
            } else {
                out.zip(stored).for_each(|(o, v)| *o = (slope * (v as f64) + intercept) as f32);
            }
        }};
    }
    macro_rules! typed {
        ($order:ty) => {
            match scalar {
                ScalarType::U8 => row!(u8, |b| b[0]),
                ScalarType::I8 => row!(i8, |b| b[0] as i8),
                ScalarType::U16 => row!(u16, <$order>::read_u16),
                ScalarType::I16 => row!(i16, <$order>::read_i16),
                ScalarType::U32 => row!(u32, <$order>::read_u32),
                ScalarType::I32 => row!(i32, <$order>::read_i32),
                ScalarType::U64 => row!(u64, <$order>::read_u64),
                ScalarType::I64 => row!(i64, <$order>::read_i64),
                ScalarType::F16 => row!(u16, |b| f16::from_bits(<$order>::read_u16(b)).to_f32()),
                ScalarType::F32 => row!(f32, <$order>::read_f32),
                ScalarType::F64 => row!(f64, <$order>::read_f64),
            }
        };
    }
    if big_endian { typed!(BE) } else { typed!(LE) }
}
