//! Converts stored numbers of any type to those of a mesh: `f64`, and numbers of points.

use crate::volume::{ScalarType, half_at};
use byteorder::{ByteOrder, LE};

/// Applies a function to each of the little-endian numbers in `$bytes`, as their own type.
macro_rules! each {
    ($scalar:expr, $bytes:expr, $v:ident => $body:expr) => {{
        macro_rules! of {
            ($t:ty, $read:expr) => {
                for $v in $bytes.chunks_exact(size_of::<$t>()).map($read) {
                    $body
                }
            };
        }
        match $scalar {
            ScalarType::U8 => of!(u8, |b| b[0]),
            ScalarType::I8 => of!(i8, |b| b[0] as i8),
            ScalarType::U16 => of!(u16, LE::read_u16),
            ScalarType::I16 => of!(i16, LE::read_i16),
            ScalarType::U32 => of!(u32, LE::read_u32),
            ScalarType::I32 => of!(i32, LE::read_i32),
            ScalarType::U64 => of!(u64, LE::read_u64),
            ScalarType::I64 => of!(i64, LE::read_i64),
            ScalarType::F16 => of!(u16, |b| half_at(b)),
            ScalarType::F32 => of!(f32, LE::read_f32),
            ScalarType::F64 => of!(f64, LE::read_f64),
        }
    }};
}

/// Little-endian numbers as `f64`, as many as `out` has room for. Integers beyond 2^53 are rounded.
pub(in crate::formats) fn to_f64(scalar: ScalarType, bytes: &[u8], out: &mut [f64]) {
    let mut slots = out.iter_mut();
    each!(scalar, bytes, v => if let Some(slot) = slots.next() { *slot = v as f64 });
}

/// Appends little-endian integers as counts or numbers of points. A negative number, or one that is
/// no integer, becomes `u64::MAX`, which no mesh can have.
pub(in crate::formats) fn push_ids(scalar: ScalarType, bytes: &[u8], out: &mut Vec<u64>) {
    each!(scalar, bytes, v => {
        // Integers below 2^63 survive i128 unchanged; a float goes through it only when it is one.
        let whole = v as i128;
        out.push(if whole as f64 == v as f64 { u64::try_from(whole).unwrap_or(u64::MAX) } else { u64::MAX });
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type() {
        for scalar in ScalarType::ALL {
            let mut bytes = vec![];
            for word in ["7", "0", "100"] {
                assert!(crate::formats::shared::stream::push_number(word.as_bytes(), scalar, &mut bytes));
            }
            let (mut numbers, mut ids) = ([0.5; 3], vec![]);
            to_f64(scalar, &bytes, &mut numbers);
            push_ids(scalar, &bytes, &mut ids);
            assert_eq!((numbers, &ids[..]), ([7.0, 0.0, 100.0], &[7, 0, 100][..]), "{scalar:?}");
        }
        let mut ids = vec![];
        push_ids(ScalarType::I32, &(-1i32).to_le_bytes(), &mut ids);
        push_ids(ScalarType::F32, &0.5f32.to_le_bytes(), &mut ids);
        push_ids(ScalarType::U64, &(u64::MAX - 1).to_le_bytes(), &mut ids);
        assert_eq!(ids, [u64::MAX, u64::MAX, u64::MAX - 1]);
    }
}
