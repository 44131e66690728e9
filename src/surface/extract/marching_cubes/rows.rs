//! Which nodes of a plane are inside and which have no data, a bit each.

/// The nodes of a plane, row by row. A row ends with a word of nothing.
#[derive(Debug, Default)]
pub(super) struct Plane {
    pub(super) inside: Vec<u64>,
    pub(super) missing: Vec<u64>,
}

impl Plane {
    /// Makes room for rows of so many words.
    pub(super) fn resize(&mut self, rows: usize, words: usize) {
        for bits in [&mut self.inside, &mut self.missing] {
            bits.clear();
            bits.resize(rows * words, 0);
        }
    }

    /// Looks at the values of a row.
    pub(super) fn look(&mut self, row: usize, words: usize, values: &[f32], isovalue: f32) {
        let inside = &mut self.inside[row * words..][..words];
        let missing = &mut self.missing[row * words..][..words];
        for ((values, inside), missing) in values.chunks(64).zip(inside).zip(missing) {
            *inside = bits_of(values, |v| v >= isovalue);
            let any = values.iter().fold(false, |any, v| any | v.is_nan());
            *missing = if any { bits_of(values, f32::is_nan) } else { 0 };
        }
    }
}

/// Up to 64 answers as bits, the first the lowest.
#[inline(always)]
fn bits_of(values: &[f32], is: impl Fn(f32) -> bool) -> u64 {
    let mut bytes = [0u8; 64];
    // A fixed length is compared without a loop.
    match <&[f32; 64]>::try_from(values) {
        Ok(values) => bytes.iter_mut().zip(values).for_each(|(byte, &v)| *byte = u8::from(is(v))),
        Err(_) => bytes.iter_mut().zip(values).for_each(|(byte, &v)| *byte = u8::from(is(v))),
    }
    let (eights, _) = bytes.as_chunks::<8>();
    // The product puts the lowest bits of eight bytes side by side, into the highest byte.
    let gathered = |eight: &[u8; 8]| u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
    eights.iter().enumerate().fold(0, |word, (n, eight)| word | gathered(eight) << (8 * n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_those_of_values() {
        let values: Vec<f32> =
            (0..150).map(|i| if i % 41 == 7 { f32::NAN } else { (i * i % 11) as f32 }).collect();
        for n in [0, 1, 63, 64, 65, 128, 150] {
            let mut plane = Plane::default();
            plane.resize(2, 4);
            plane.look(1, 4, &values[..n], 5.0);
            for i in 0..256 {
                let bit = |bits: &[u64]| bits[4 + i / 64] >> (i % 64) & 1 == 1;
                let value = if i < n { values[i] } else { 0.0 };
                assert_eq!((bit(&plane.inside), bit(&plane.missing)), (value >= 5.0, value.is_nan()));
            }
        }
    }
}
