//! The values of a chunk's vertices, lossless or quantised, in blocks of [`BLOCK_VALUES`].
//!
//! A query needs the values of the vertices of a few tetrahedron blocks: it decodes only the value blocks that hold them (vertex
//! `v` is in block `v / BLOCK_VALUES`). Local ids follow the bricks and the Hilbert curve, so those are few.
//!
//! A block is one chunk of [pcodec](https://docs.rs/pco), which finds out whether numbers are multiples of something or lie on few
//! values, and codes each in a bin of its own with bits of its own; or the values as they are, where that is shorter. On values that were
//! interpolated from ten real volumes (CT, MR, simulations; at 1/8 of the samples) it takes 0.70 to 3.14 bytes a value; zstd of shuffled
//! bytes, of themselves or of differences, whichever is shorter, takes 1 to 26 % more on each of them, and was dropped. Whether differences are
//! worth trying (they are in smooth simulations, for 5 %) is found out with the first block of a chunk.
//!
//! Bits come back as they were, except that every NaN (void) becomes the one NaN `0x7fc00000`: two programs that make
//! a void value differently write the same bytes.
//!
//! **Quantised** values are multiples of a step from an origin, the same for a whole archive: vertices that two chunks share keep equal values.
//! The integers are what is stored.

use super::wire::{Cursor, Malformed};
use pco::standalone::{simple_compress, simple_decompress_into};
use pco::{ChunkConfig, DeltaSpec};
use serde::{Deserialize, Serialize};

/// Values in a block, the last one of a chunk excepted.
pub const BLOCK_VALUES: usize = 4096;
/// Codec: values as they are.
pub const VALUES_RAW: u8 = 0;
/// Codec: pcodec.
pub const VALUES_PCO: u8 = 16;
/// Codec: pcodec of multiples of a step.
pub const VALUES_QUANTISED: u8 = 17;

/// The bits of every void value.
const VOID: u32 = 0x7fc0_0000;
/// The integer of a void value, and the largest of others.
const VOID_STEP: i32 = i32::MIN;
const MOST_STEPS: f64 = (1 << 30) as f64;

/// Rounds values to multiples of a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quantiser {
    /// Bits that were asked for: 2^bits values fill the range of the source.
    pub bits: u8,
    /// What is no step away.
    pub origin: f64,
    /// The distance of two values.
    pub step: f64,
    /// How far a value can be from what it was before.
    pub bound: f64,
}

impl Quantiser {
    /// The fewest and the most bits.
    pub const BITS: std::ops::RangeInclusive<u8> = 4..=24;

    /// Values of `bits` bits from `low` to `high`; what lies beyond (cubic interpolation overshoots) goes on in the same steps.
    pub fn new(bits: u8, [low, high]: [f32; 2]) -> Self {
        let (low, high) = (f64::from(low), f64::from(high));
        let steps = f64::from((1u32 << bits) - 1);
        let step = if high > low { (high - low) / steps } else { 1.0 };
        // Half a step, and half the distance of two f32 where the values are largest.
        let coarse = low.abs().max(high.abs()) * f64::from(f32::EPSILON);
        Self { bits, origin: low, step, bound: step / 2.0 + coarse }
    }

    fn steps(&self, value: f32) -> i32 {
        let steps = ((f64::from(value) - self.origin) / self.step).round();
        steps.clamp(-MOST_STEPS, MOST_STEPS) as i32
    }

    fn value(&self, steps: i32) -> f32 {
        (self.origin + f64::from(steps) * self.step) as f32
    }

    /// The value that stands for a value; void stays void.
    pub fn round(&self, value: f32) -> f32 {
        if value.is_finite() { self.value(self.steps(value)) } else { value }
    }
}

/// Encodes the values of all local vertices of a chunk, core then halo: one block for each [`BLOCK_VALUES`] values. Values that
/// [`Quantiser::round`] has made of others are stored as steps.
pub fn encode_values(values: &[f32], quantiser: Option<&Quantiser>) -> Vec<Vec<u8>> {
    let mut deltas = None;
    values.chunks(BLOCK_VALUES).map(|block| encode_block(block, quantiser, &mut deltas)).collect()
}

fn encode_block(values: &[f32], quantiser: Option<&Quantiser>, deltas: &mut Option<bool>) -> Vec<u8> {
    let plain: Vec<f32> = values.iter().map(|v| if v.is_nan() { f32::from_bits(VOID) } else { *v }).collect();
    if let Some(q) = quantiser
        && let Some(steps) = as_steps(&plain, q)
    {
        let mut out = vec![VALUES_QUANTISED];
        out.extend(q.origin.to_le_bytes());
        out.extend(q.step.to_le_bytes());
        out.extend(packed(&steps, deltas));
        return out;
    }
    let mut out = vec![VALUES_PCO];
    out.extend(packed(&plain, deltas));
    if out.len() > values.len() * 4 {
        out = vec![VALUES_RAW];
        out.extend(plain.iter().flat_map(|v| v.to_le_bytes()));
    }
    out
}

/// The steps of quantised values; `None` if one is no multiple.
fn as_steps(values: &[f32], q: &Quantiser) -> Option<Vec<i32>> {
    let steps = |&v: &f32| {
        if v.to_bits() == VOID {
            return Some(VOID_STEP);
        }
        let steps = q.steps(v);
        (q.value(steps).to_bits() == v.to_bits()).then_some(steps)
    };
    values.iter().map(steps).collect()
}

/// One chunk of pcodec; the first of all finds out whether differences are shorter.
fn packed<T: pco::data_types::Number>(numbers: &[T], deltas: &mut Option<bool>) -> Vec<u8> {
    let with = |spec| {
        let config = ChunkConfig::default().with_delta_spec(spec);
        simple_compress(numbers, &config).expect("the settings are right, and memory takes all bytes")
    };
    let (differences, none) = (DeltaSpec::TryConsecutive(1), DeltaSpec::NoOp);
    match *deltas {
        Some(true) => with(differences),
        Some(false) => with(none),
        None => {
            let (a, b) = (with(differences), with(none));
            *deltas = Some(a.len() < b.len());
            if a.len() < b.len() { a } else { b }
        }
    }
}

/// Decodes a block of `n` values and appends them to `out`.
///
/// # Errors
/// When the bytes are not a block of `n` values; `out` is then unchanged.
pub fn decode_values(bytes: &[u8], n: usize, out: &mut Vec<f32>) -> Result<(), Malformed> {
    if n > BLOCK_VALUES {
        return Err(Malformed::new("values", format!("at most {BLOCK_VALUES} values"), n.to_string()));
    }
    let mut c = Cursor::new(bytes);
    match c.u8("codec")? {
        VALUES_RAW => {
            let body = c.rest();
            if body.len() != 4 * n {
                return Err(Malformed::new("values", format!("{n} values"), format!("{} bytes", body.len())));
            }
            out.extend(body.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)));
        }
        VALUES_PCO => {
            let mut values = [0f32; BLOCK_VALUES];
            unpacked(c.rest(), &mut values[..n])?;
            out.extend(&values[..n]);
        }
        VALUES_QUANTISED => {
            let number = |c: &mut Cursor<'_>| Ok(f64::from_bits(c.u64("quantiser")?));
            let (origin, step) = (number(&mut c)?, number(&mut c)?);
            let q = Quantiser { bits: 0, origin, step, bound: 0.0 };
            let mut steps = [0i32; BLOCK_VALUES];
            unpacked(c.rest(), &mut steps[..n])?;
            let value = |&s: &i32| if s == VOID_STEP { f32::from_bits(VOID) } else { q.value(s) };
            out.extend(steps[..n].iter().map(value));
        }
        other => return Err(Malformed::new("codec", "a known value codec", other.to_string())),
    }
    Ok(())
}

/// Exactly as many numbers as there is room for.
fn unpacked<T: pco::data_types::Number>(bytes: &[u8], numbers: &mut [T]) -> Result<(), Malformed> {
    let progress = simple_decompress_into(bytes, numbers)
        .map_err(|e| Malformed::new("values", "a chunk of pcodec", e.to_string()))?;
    if progress.finished && progress.n_processed == numbers.len() {
        return Ok(());
    }
    let got = format!("{}{}", progress.n_processed, if progress.finished { "" } else { " and more" });
    Err(Malformed::new("values", format!("{} values", numbers.len()), got))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(values: &[f32], quantiser: Option<&Quantiser>) -> Vec<Vec<u8>> {
        let blocks = encode_values(values, quantiser);
        assert_eq!(blocks.len(), values.len().div_ceil(BLOCK_VALUES));
        let mut back = vec![];
        for (block, part) in blocks.iter().zip(values.chunks(BLOCK_VALUES)) {
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
        let values: Vec<f32> =
            noise(10_000).iter().map(|&b| f32::from_bits(b)).filter(|v| !v.is_nan()).collect();
        for (block, part) in round_trip(&values, None).iter().zip(values.chunks(BLOCK_VALUES)) {
            assert!(block[0] == VALUES_RAW || block.len() <= part.len() * 4);
        }
        for special in [0.0, -0.0, f32::INFINITY, f32::NEG_INFINITY, f32::MIN_POSITIVE, 1e-45, f32::MAX] {
            round_trip(&[special], None);
            round_trip(&[special, -special, special, 1.0], None);
        }
        round_trip(&[], None);
    }

    #[test]
    fn smooth_integer_and_constant_fields_shrink() {
        let smooth: Vec<f32> = (0..9000).map(|i| ((i * i) as f32) * 1e-6 - 3.0).collect();
        assert!(round_trip(&smooth, None).iter().all(|b| b.len() < 2 * BLOCK_VALUES));
        let whole: Vec<f32> = noise(9000).iter().map(|b| (b % 200) as f32).collect();
        assert!(round_trip(&whole, None).iter().all(|b| b.len() < BLOCK_VALUES * 11 / 10));
        assert!(round_trip(&[7.0; BLOCK_VALUES], None)[0].len() < 60);
    }

    #[test]
    fn quantised_values_stay_within_the_bound_and_come_back() {
        for (low, high) in [(-3.0f32, 5.0f32), (0.0, 1e-30), (1e6, 1e6 + 1.0), (-2e30, 2e30), (7.0, 7.0)] {
            for bits in [4, 9, 16, 24] {
                let q = Quantiser::new(bits, [low, high]);
                let within = |b: &u32| low + (high - low) * (*b as f32 / u32::MAX as f32);
                let mut values: Vec<f32> = noise(5000).iter().map(within).collect();
                values[77] = f32::NAN;
                let rounded: Vec<f32> = values.iter().map(|&v| q.round(v)).collect();
                for (v, r) in values.iter().zip(&rounded).filter(|(v, _)| !v.is_nan()) {
                    let error = (f64::from(*v) - f64::from(*r)).abs();
                    assert!(error <= q.bound, "{bits} bits of {low}..{high}: {v} became {r}");
                    assert_eq!(q.round(*r).to_bits(), r.to_bits(), "a second time changes nothing");
                }
                let blocks = round_trip(&rounded, Some(&q));
                assert!(blocks[0].len() * 8 < BLOCK_VALUES * (usize::from(bits) + 2) + 2000);
            }
        }
        // Values that are no multiples are stored as they are.
        let q = Quantiser::new(8, [0.0, 1.0]);
        assert_eq!(
            round_trip(&[0.1, 0.7], Some(&q))[0][0],
            VALUES_PCO.min(encode_values(&[0.1, 0.7], None)[0][0])
        );
    }

    #[test]
    fn all_nans_are_one() {
        let nans = [0x7fc0_0000, 0xffc0_0000, 0x7f80_0001, 0x7fff_ffff].map(f32::from_bits);
        assert_eq!(encode_values(&nans, None), encode_values(&[f32::NAN; 4], None));
        let mut back = vec![];
        decode_values(&encode_values(&nans, None)[0], 4, &mut back).unwrap();
        assert!(back.iter().all(|v| v.to_bits() == VOID));
    }

    #[test]
    fn damage_is_refused_or_gives_values_never_a_panic() {
        let smooth: Vec<f32> = (0..300).map(|i| (i * i) as f32).collect();
        let q = Quantiser::new(12, [0.0, 90_000.0]);
        let rounded: Vec<f32> = smooth.iter().map(|&v| q.round(v)).collect();
        for good in [encode_values(&smooth, None).remove(0), encode_values(&rounded, Some(&q)).remove(0)] {
            assert_ne!(good[0], VALUES_RAW);
            for n in [0, 299, 301, BLOCK_VALUES, usize::MAX] {
                assert!(decode_values(&good, n, &mut vec![]).is_err(), "{n}");
            }
            for i in 0..good.len() {
                assert!(decode_values(&good[..i], 300, &mut vec![]).is_err());
                for bit in 0..8 {
                    let mut bad = good.clone();
                    bad[i] ^= 1 << bit;
                    let mut out = vec![];
                    assert!(decode_values(&bad, 300, &mut out).is_err() || out.len() == 300);
                }
            }
        }
        assert!(decode_values(&[99, 0], 1, &mut vec![]).unwrap_err().got.contains("99"));
    }
}
