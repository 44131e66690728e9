//! The values of a chunk's vertices, lossless, in blocks of [`BLOCK_VALUES`].
//!
//! A query needs the values of the vertices of a few tetrahedron blocks: it decodes only the value blocks that hold them (vertex
//! `v` is in block `v / BLOCK_VALUES`). Local ids follow the bricks and the Hilbert curve, so those are few.
//!
//! A block is the shortest of three forms, of which the first is never longer than the values by more than a byte:
//! plain; the bytes shuffled (all first bytes, all second bytes, …) and compressed; the same of the differences
//! between neighbours on the curve, taken between the bit patterns in an order that follows the values (so that a small
//! change of value across zero is a small number too). Which one wins depends on the field: values interpolated from a
//! smooth field favour differences, integers on voxels the plain shuffle.
//!
//! Bits come back as they were, except that every NaN (void) becomes the one NaN `0x7fc00000`: two programs that make
//! a void value differently write the same bytes.

use super::wire::{Cursor, Malformed, to_zstd, unzstd};

/// Values in a block, the last one of a chunk excepted.
pub const BLOCK_VALUES: usize = 4096;
/// Codec: values as they are.
pub const VALUES_RAW: u8 = 0;
/// Codec: shuffled bytes, zstd.
pub const VALUES_SHUFFLED: u8 = 1;
/// Codec: shuffled bytes of differences, zstd.
pub const VALUES_DIFFERENCES: u8 = 2;
/// Reserved codec: pcodec.
pub const VALUES_PCO: u8 = 16;
/// Reserved codec: quantised with a reported bound.
pub const VALUES_QUANTISED: u8 = 17;

/// The bits of every void value.
const VOID: u32 = 0x7fc0_0000;
/// Compression level of zstd: on computed tomographies level 5 takes twice the time for 0.6 % fewer bytes, level 1 saves 10 to 25 % of the time
/// for 0.6 % more.
const LEVEL: i32 = 3;

/// Encodes the values of all local vertices of a chunk, core then halo: one block for each [`BLOCK_VALUES`] values.
pub fn encode_values(values: &[f32]) -> Vec<Vec<u8>> {
    values.chunks(BLOCK_VALUES).map(encode_block).collect()
}

fn encode_block(values: &[f32]) -> Vec<u8> {
    let bits: Vec<u32> = values.iter().map(|v| if v.is_nan() { VOID } else { v.to_bits() }).collect();
    let mut differences = bits.iter().map(|&b| ordered(b)).collect::<Vec<u32>>();
    for i in (1..differences.len()).rev() {
        differences[i] = zigzag(differences[i].wrapping_sub(differences[i - 1]));
    }
    let packed = |codec: u8, words: &[u32]| [vec![codec], to_zstd(&shuffle(words), LEVEL)].concat();
    let mut best = vec![VALUES_RAW];
    best.extend(bits.iter().flat_map(|b| b.to_le_bytes()));
    for other in [packed(VALUES_SHUFFLED, &bits), packed(VALUES_DIFFERENCES, &differences)] {
        if other.len() < best.len() {
            best = other;
        }
    }
    best
}

/// Decodes a block of `n` values and appends them to `out`.
///
/// # Errors
/// When the bytes are not a block of `n` values; `out` is then unchanged.
pub fn decode_values(bytes: &[u8], n: usize, out: &mut Vec<f32>) -> Result<(), Malformed> {
    let mut c = Cursor::new(bytes);
    let codec = c.u8("codec")?;
    let expanded;
    let body = match codec {
        VALUES_RAW => c.rest(),
        VALUES_SHUFFLED | VALUES_DIFFERENCES => {
            expanded = unzstd(c.rest(), n.saturating_mul(4), "values")?;
            &expanded
        }
        other => return Err(Malformed::new("codec", "a known value codec", other.to_string())),
    };
    if body.len() != n.saturating_mul(4) {
        return Err(Malformed::new("values", format!("{n} values"), format!("{} bytes", body.len())));
    }
    match codec {
        VALUES_RAW => out.extend(body.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))),
        VALUES_SHUFFLED => out.extend(unshuffle(body).map(f32::from_bits)),
        _ => {
            let mut sum = 0u32;
            out.extend(unshuffle(body).enumerate().map(|(i, w)| {
                sum = if i == 0 { w } else { sum.wrapping_add(unzigzag(w)) };
                f32::from_bits(unordered(sum))
            }));
        }
    }
    Ok(())
}

/// Bit patterns in the order of the values: negative ones reversed below the positive ones.
fn ordered(bits: u32) -> u32 {
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

fn unordered(word: u32) -> u32 {
    if word >> 31 == 1 { word & !(1 << 31) } else { !word }
}

/// Small differences of either sign become small numbers.
fn zigzag(d: u32) -> u32 {
    (d << 1) ^ ((d as i32 >> 31) as u32)
}

fn unzigzag(z: u32) -> u32 {
    (z >> 1) ^ (z & 1).wrapping_neg()
}

fn shuffle(words: &[u32]) -> Vec<u8> {
    (0..4).flat_map(|byte| words.iter().map(move |w| (w >> (8 * byte)) as u8)).collect()
}

fn unshuffle(bytes: &[u8]) -> impl Iterator<Item = u32> {
    let n = bytes.len() / 4;
    let (a, b, c, d) = (&bytes[..n], &bytes[n..2 * n], &bytes[2 * n..3 * n], &bytes[3 * n..4 * n]);
    (0..n).map(move |i| u32::from_le_bytes([a[i], b[i], c[i], d[i]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(values: &[f32]) -> Vec<Vec<u8>> {
        let blocks = encode_values(values);
        assert_eq!(blocks.len(), values.len().div_ceil(BLOCK_VALUES));
        let mut back = vec![];
        for (block, part) in blocks.iter().zip(values.chunks(BLOCK_VALUES)) {
            assert!(block.len() <= part.len() * 4 + 1);
            decode_values(block, part.len(), &mut back).unwrap();
        }
        let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&back), bits(values));
        blocks
    }

    /// A fixed sequence without pattern.
    fn noise(n: usize) -> Vec<u32> {
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 32) as u32
        };
        (0..n).map(|_| next()).collect()
    }

    #[test]
    fn every_bit_pattern_comes_back_and_noise_stays_raw() {
        let bits = noise(10_000);
        let values: Vec<f32> = bits.iter().map(|&b| f32::from_bits(b)).filter(|v| !v.is_nan()).collect();
        assert!(round_trip(&values).iter().all(|b| b[0] == VALUES_RAW));
        for special in [0.0, -0.0, f32::INFINITY, f32::NEG_INFINITY, f32::MIN_POSITIVE, 1e-45, f32::MAX] {
            round_trip(&[special]);
            round_trip(&[special, -special, special, 1.0]);
        }
        round_trip(&[]);
    }

    #[test]
    fn smooth_integer_and_constant_fields_shrink() {
        let smooth: Vec<f32> = (0..9000).map(|i| ((i * i) as f32) * 1e-6 - 3.0).collect();
        assert!(round_trip(&smooth).iter().all(|b| b.len() < 3 * BLOCK_VALUES));
        let whole: Vec<f32> = noise(9000).iter().map(|b| (b % 200) as f32).collect();
        assert!(round_trip(&whole).iter().all(|b| b.len() < BLOCK_VALUES * 3 / 2));
        assert!(round_trip(&[7.0; BLOCK_VALUES])[0].len() < 40);
    }

    #[test]
    fn all_nans_are_one() {
        let nans = [0x7fc0_0000, 0xffc0_0000, 0x7f80_0001, 0x7fff_ffff].map(f32::from_bits);
        assert_eq!(encode_values(&nans), encode_values(&[f32::NAN; 4]));
        let mut back = vec![];
        decode_values(&encode_values(&nans)[0], 4, &mut back).unwrap();
        assert!(back.iter().all(|v| v.to_bits() == VOID));
    }

    #[test]
    fn damage_is_refused_or_gives_values_never_a_panic() {
        let smooth: Vec<f32> = (0..300).map(|i| i as f32).collect();
        let good = encode_values(&smooth).remove(0);
        assert_ne!(good[0], VALUES_RAW);
        for n in [0, 299, 301, usize::MAX] {
            assert!(decode_values(&good, n, &mut vec![]).is_err(), "{n}");
        }
        for i in 0..good.len() {
            assert!(decode_values(&good[..i], 300, &mut vec![]).is_err());
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[i] ^= 1 << bit;
                let _ = decode_values(&bad, 300, &mut vec![]);
            }
        }
        assert!(decode_values(&[VALUES_PCO, 0], 1, &mut vec![]).unwrap_err().got.contains("16"));
    }
}
