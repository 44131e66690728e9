//! The values of a chunk's vertices, lossless or quantised, in blocks of [`BLOCK_VALUES`].
//!
//! A query needs the values of the vertices of a few tetrahedron blocks: it decodes only the value
//! blocks that hold them (vertex `v` is in block `v / BLOCK_VALUES`). Local ids follow the bricks
//! and the Hilbert curve, so those are few.
//!
//! A block is one chunk of [pcodec](https://docs.rs/pco), or the values as they are, where that is
//! shorter. pcodec finds out whether numbers are multiples of something or lie on few values, and
//! codes each in a bin of its own with bits of its own. On values that were interpolated from ten
//! real volumes (CT, MR, simulations; at 1/8 of the samples) it takes 0.70 to 3.14 bytes a value.
//! zstd of shuffled bytes, of the values or of differences, whichever is shorter, takes 1 to 26 %
//! more on each of them, and was dropped. Some blocks of a chunk are tried to find out two things:
//! whether differences of neighbours are worth trying (they are in smooth simulations, for 5 %),
//! and whether the numbers are multiples of something.
//!
//! Bits come back as they were, except that every NaN (void) becomes the one NaN `0x7fc00000`: two
//! programs that make a void value differently write the same bytes.
//!
//! **Quantised** values are multiples of a step from an origin, the same for a whole archive:
//! vertices that two chunks share keep equal values. The integers are what is stored.
//!
//! **Steps of a series** lie on the same vertices, and the value of a vertex is often near that of
//! the step before. A block may hold the differences to it. For quantised values these are
//! differences of the integers. For others they are differences of the floats' bits as integers, in
//! the order of the floats (as in Lindstrom and Isenburg 2006, "Fast and efficient compression of
//! floating-point data", where the prediction is one of space). Some blocks of a chunk are coded
//! both ways, and the shorter way is taken for all of the chunk.

use crate::archive::wire::{Cursor, Malformed};
use byteorder::{ByteOrder, LE};
use isospan_mesh::sample::Values;
use pco::standalone::{simple_compress, simple_decompress_into};
use pco::{ChunkConfig, DeltaSpec, ModeSpec};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Values in a block, the last one of a chunk excepted.
pub const BLOCK_VALUES: usize = 1024;
/// Codec: values as they are.
pub const VALUES_RAW: u8 = 0;
/// Codec: pcodec.
pub const VALUES_PCO: u8 = 16;
/// Codec: pcodec of multiples of a step.
pub const VALUES_QUANTISED: u8 = 17;

/// Codec: pcodec of differences of the ordered bits to those of the step before.
pub const VALUES_AFTER: u8 = 32;
/// Codec: pcodec of differences of multiples of a step to those of the step before.
pub const VALUES_AFTER_QUANTISED: u8 = 33;

/// The bits of every void value.
const VOID: u32 = 0x7fc0_0000;
/// The integer of a void value, and the largest of others.
const VOID_STEP: i32 = i32::MIN;
const MOST_STEPS: f64 = (1 << 30) as f64;

/// Rounds values to multiples of a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quantiser {
    /// Bits that were asked for: 2^bits values fill the range of the source.
    #[serde(serialize_with = "whole_if_it_is")]
    pub bits: f64,
    /// The value at step 0.
    pub origin: f64,
    /// The distance of two values.
    pub step: f64,
    /// How far a value can be from what it was before.
    pub bound: f64,
}

impl Quantiser {
    /// The fewest and the most bits.
    pub const BITS: std::ops::RangeInclusive<f64> = 4.0..=24.0;

    /// Values of `bits` bits from `low` to `high`; what lies beyond (cubic interpolation
    /// overshoots) goes on in the same steps.
    pub fn new(bits: f64, [low, high]: [f32; 2]) -> Self {
        let (low, high) = (f64::from(low), f64::from(high));
        let steps = steps_of(bits);
        let step = if high > low { (high - low) / steps } else { 1.0 };
        // Half a step, and half the distance of two f32 where the values are largest.
        let coarse = low.abs().max(high.abs()) * f64::from(f32::EPSILON);
        Self { bits, origin: low, step, bound: step / 2.0 + coarse }
    }

    /// The same for values as `values` says: fitted ones are rounded by
    /// [`Quantiser::round_within`], up to a whole step.
    pub fn of(self, values: Values) -> Self {
        let more = if values == Values::Fit { self.step / 2.0 } else { 0.0 };
        Self { bound: self.bound + more, ..self }
    }

    fn steps(&self, value: f32) -> i32 {
        let steps = ((f64::from(value) - self.origin) / self.step).round();
        steps.clamp(-MOST_STEPS, MOST_STEPS) as i32
    }

    fn value(&self, steps: i32) -> f32 {
        // A zero has no sign.
        (self.origin + f64::from(steps) * self.step) as f32 + 0.0
    }

    fn steps_or_void(&self, value: f32) -> i32 {
        if value.is_nan() { VOID_STEP } else { self.steps(value) }
    }

    fn value_or_void(&self, steps: i32) -> f32 {
        if steps == VOID_STEP { f32::from_bits(VOID) } else { self.value(steps) }
    }

    /// As [`Quantiser::round`], to a step that is neither below the lower nor above the upper bound
    /// where one of the two around the value is so: rounding makes no extremum then.
    pub fn round_within(&self, value: f32, [low, high]: [f32; 2]) -> f32 {
        if !value.is_finite() {
            return value;
        }
        let nearest = self.steps(value);
        let is_within = |steps: &i32| (low..=high).contains(&self.value(*steps));
        let around = [nearest, nearest - 1, nearest + 1];
        self.value(around.into_iter().find(is_within).unwrap_or(nearest))
    }

    /// The value that stands for a value; void stays void.
    pub fn round(&self, value: f32) -> f32 {
        if value.is_finite() { self.value(self.steps(value)) } else { value }
    }
}

/// Writes a number without a point if it is whole.
#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn whole_if_it_is<S: serde::Serializer>(n: &f64, out: S) -> Result<S::Ok, S::Error> {
    if n.fract() == 0.0 && (0.0..1e9).contains(n) {
        out.serialize_u32(*n as u32)
    } else {
        out.serialize_f64(*n)
    }
}

/// Steps of a range that is filled by 2^bits values.
fn steps_of(bits: f64) -> f64 {
    libm::exp2(bits) - 1.0
}

/// How the values of a chunk are cut into blocks: [`BLOCK_VALUES`] each, the last one has the rest.
#[derive(Clone, Copy, Debug)]
pub struct ValueBlocks {
    len: usize,
}

impl ValueBlocks {
    /// Blocks of so many values.
    pub fn new(len: usize) -> Self {
        Self { len }
    }

    /// Number of blocks.
    pub fn count(&self) -> usize {
        self.len.div_ceil(BLOCK_VALUES)
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no value.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The block that has a value.
    #[inline]
    pub fn of(&self, value: usize) -> usize {
        value / BLOCK_VALUES
    }

    /// The values of a block.
    pub fn range(&self, block: usize) -> Range<usize> {
        let first = block * BLOCK_VALUES;
        first..self.len.min(first + BLOCK_VALUES)
    }
}

/// Encodes the values of the local vertices of a chunk, core then halo: block by block.
/// Values that [`Quantiser::round`] has made of others are stored as steps. `before` are the values
/// of the same vertices at the step that blocks may refer to.
///
/// # Panics
/// When there is not one value a vertex before.
pub fn encode_values(
    values: &[f32],
    blocks: &ValueBlocks,
    before: Option<&[f32]>,
    quantiser: Option<&Quantiser>,
) -> Vec<Vec<u8>> {
    assert_eq!(values.len(), blocks.len(), "as many values as there are in blocks");
    if let Some(before) = before {
        assert_eq!(values.len(), before.len(), "one value a vertex");
    }
    let mut encoder = Encoder { quantiser, blocks, block: vec![], numbers: vec![], steps: vec![] };
    let how = encoder.choose(values, before);
    let before = before.filter(|_| how.after);
    let encode = |n| encoder.encode(n, values, before, how.coder).to_vec();
    (0..blocks.count()).map(encode).collect()
}

/// How pcodec is to treat the numbers of a block.
#[derive(Clone, Copy)]
struct Coder {
    /// Whether to look for a number that all of them are multiples of.
    searched: bool,
    /// Whether to code differences of neighbours, where they are worth it.
    differences: bool,
}

/// How the blocks of a chunk are coded.
#[derive(Clone, Copy)]
struct How {
    /// Whether values are coded as differences to those of the step before.
    after: bool,
    coder: Coder,
}

/// Encodes block after block.
struct Encoder<'a> {
    quantiser: Option<&'a Quantiser>,
    blocks: &'a ValueBlocks,
    /// The bytes of the block.
    block: Vec<u8>,
    /// Its values, all void ones the same.
    numbers: Vec<f32>,
    /// The integers that are coded in their place.
    steps: Vec<i32>,
}

impl Encoder<'_> {
    /// Finds out which way takes the fewest bytes, with the first block, a middle and the last one.
    fn choose(&mut self, values: &[f32], before: Option<&[f32]>) -> How {
        let blocks = self.blocks.count();
        let mut tried = vec![0, blocks / 2, blocks.saturating_sub(1)];
        tried.dedup();
        let mut bytes_of = |after: Option<&[f32]>, coder| -> usize {
            let block = |&n: &usize| self.encode(n, values, after, coder).len();
            tried.iter().filter(|n| **n < blocks).map(block).sum()
        };
        // The plainest one of those that take the fewest bytes.
        let all = [(false, false), (true, false), (true, true)];
        let [plain, searched, differences] =
            all.map(|(searched, differences)| Coder { searched, differences });
        let mut fewest = |after, coders: &[Coder]| {
            let found = coders.iter().map(|&coder| (bytes_of(after, coder), coder));
            found.min_by_key(|(bytes, _)| *bytes).expect("there are some")
        };
        let (alone, coder) = fewest(None, &[plain, searched, differences]);
        if before.is_some() {
            let (after, coder) = fewest(before, &[plain, searched]);
            // Less than 2 % is not worth to look back for.
            if after * 50 < alone * 49 {
                return How { after: true, coder };
            }
        }
        How { after: false, coder }
    }

    /// The bytes of a block; of one that refers to the values `before`, of the differences to them.
    fn encode(&mut self, n: usize, values: &[f32], before: Option<&[f32]>, coder: Coder) -> &[u8] {
        let Self { quantiser, blocks, block, numbers, steps } = self;
        let range = blocks.range(n);
        let (values, before) = (&values[range.clone()], before.map(|before| &before[range]));
        block.clear();
        numbers.clear();
        numbers.extend(values.iter().map(|&v| one_void(v)));
        let level = if numbers.iter().any(|v| v.is_nan()) { LEVEL_WITH_VOID } else { LEVEL };
        if let Some(q) = quantiser
            && as_steps(numbers, q, steps)
        {
            if let Some(before) = before {
                let differ =
                    |(step, &before): (&mut i32, &f32)| *step = step.wrapping_sub(q.steps_or_void(before));
                steps.iter_mut().zip(before).for_each(differ);
            }
            block.push(if before.is_some() { VALUES_AFTER_QUANTISED } else { VALUES_QUANTISED });
            block.extend(q.origin.to_le_bytes());
            block.extend(q.step.to_le_bytes());
            pack(steps, coder, level, block);
            return block;
        }
        match before {
            None => {
                block.push(VALUES_PCO);
                pack(numbers, coder, level, block);
            }
            Some(before) => {
                steps.clear();
                let difference = |(&v, &b): (&f32, &f32)| ordered(v).wrapping_sub(ordered(one_void(b)));
                steps.extend(numbers.iter().zip(before).map(difference));
                block.push(VALUES_AFTER);
                pack(steps, coder, level, block);
            }
        }
        if block.len() > numbers.len() * 4 {
            block.clear();
            block.push(VALUES_RAW);
            block.extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
        }
        block
    }
}

/// The value, or the one bits of all void ones.
fn one_void(v: f32) -> f32 {
    if v.is_nan() { f32::from_bits(VOID) } else { v }
}

/// The bits as an integer in the order of the floats (IEEE 754 totalOrder); its own inverse but for
/// the type.
fn ordered(v: f32) -> i32 {
    turned(v.to_bits() as i32)
}

/// Turns over all bits but the sign of a negative number.
fn turned(bits: i32) -> i32 {
    bits ^ ((bits >> 31) as u32 >> 1) as i32
}

/// The steps of quantised values; false if one is no multiple.
fn as_steps(values: &[f32], q: &Quantiser, out: &mut Vec<i32>) -> bool {
    out.clear();
    out.extend(values.iter().map(|&v| q.steps_or_void(v)));
    values.iter().zip(out).all(|(v, steps)| q.value_or_void(*steps).to_bits() == v.to_bits())
}

/// pcodec's level: how many bins it tries. Level 5 takes a quarter more time for 0.3 % of an
/// archive's bytes, the default, 8, more than twice the time for 0.4 % (medians of eight volumes at
/// 1/8 of the samples).
const LEVEL: usize = 4;
/// The level for blocks with a void value: it lies far from all others and takes bins from them.
const LEVEL_WITH_VOID: usize = 5;

/// Appends one chunk of pcodec.
fn pack<T: pco::data_types::Number>(numbers: &[T], coder: Coder, level: usize, out: &mut Vec<u8>) {
    let config = ChunkConfig::default()
        .with_compression_level(level)
        .with_mode_spec(if coder.searched { ModeSpec::Auto } else { ModeSpec::Classic })
        .with_delta_spec(if coder.differences { DeltaSpec::TryConsecutive(1) } else { DeltaSpec::NoOp });
    let packed = simple_compress(numbers, &config);
    out.extend(packed.expect("the settings are right, and memory takes all bytes"));
}

/// Whether a block of values is coded against that of the step before.
pub fn needs_before(bytes: &[u8]) -> bool {
    matches!(bytes.first(), Some(&(VALUES_AFTER | VALUES_AFTER_QUANTISED)))
}

/// What is known of a block of values before it is read.
#[derive(Clone, Copy, Debug, Default)]
pub struct KnownOfBlock<'a> {
    /// How many values it has.
    pub n: usize,
    /// The values of the step before, for a block that [`needs_before`]; for others they are not
    /// used.
    pub before: &'a [f32],
}

/// Decodes a block of values and appends them to `out`.
///
/// # Errors
/// When the bytes are not a block of `n` values, or need others that are not there; `out` is then
/// unchanged.
pub fn decode_values(bytes: &[u8], known: &KnownOfBlock<'_>, out: &mut Vec<f32>) -> Result<(), Malformed> {
    let KnownOfBlock { n, before, .. } = *known;
    if n > BLOCK_VALUES {
        return Err(Malformed::new("values", format!("at most {BLOCK_VALUES} values"), n.to_string()));
    }
    if needs_before(bytes) && before.len() != n {
        return Err(Malformed::new("codec", "values that need no others, as of a keyframe", "differences"));
    }
    let mut c = Cursor::new(bytes);
    match c.u8("codec")? {
        VALUES_RAW => {
            let body = c.rest();
            if body.len() != 4 * n {
                return Err(Malformed::new("values", format!("{n} values"), format!("{} bytes", body.len())));
            }
            let before = out.len();
            out.resize(before + n, 0.0);
            LE::read_f32_into(body, &mut out[before..]);
        }
        VALUES_PCO => {
            let mut values = [0f32; BLOCK_VALUES];
            unpacked(c.rest(), &mut values[..n])?;
            out.extend(&values[..n]);
        }
        VALUES_QUANTISED => {
            let (q, mut steps) = (quantiser(&mut c)?, [0i32; BLOCK_VALUES]);
            unpacked(c.rest(), &mut steps[..n])?;
            out.extend(steps[..n].iter().map(|&s| q.value_or_void(s)));
        }
        VALUES_AFTER => {
            let mut numbers = [0i32; BLOCK_VALUES];
            unpacked(c.rest(), &mut numbers[..n])?;
            let value =
                |(d, b): (&i32, &f32)| one_void(f32::from_bits(turned(ordered(*b).wrapping_add(*d)) as u32));
            out.extend(numbers.iter().zip(before).map(value));
        }
        VALUES_AFTER_QUANTISED => {
            let (q, mut steps) = (quantiser(&mut c)?, [0i32; BLOCK_VALUES]);
            unpacked(c.rest(), &mut steps[..n])?;
            let value = |(d, b): (&i32, &f32)| q.value_or_void(q.steps_or_void(*b).wrapping_add(*d));
            out.extend(steps.iter().zip(before).map(value));
        }
        other => return Err(Malformed::new("codec", "a known value codec", other.to_string())),
    }
    Ok(())
}

/// The quantiser at the start of a block.
fn quantiser(c: &mut Cursor<'_>) -> Result<Quantiser, Malformed> {
    let mut number = || Ok(f64::from_bits(c.u64("quantiser")?));
    Ok(Quantiser { bits: 0.0, origin: number()?, step: number()?, bound: 0.0 })
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

    fn encode_even(values: &[f32], before: Option<&[f32]>, quantiser: Option<&Quantiser>) -> Vec<Vec<u8>> {
        encode_values(values, &ValueBlocks::new(values.len()), before, quantiser)
    }

    fn decode_even(bytes: &[u8], n: usize, before: &[f32], out: &mut Vec<f32>) -> Result<(), Malformed> {
        decode_values(bytes, &KnownOfBlock { n, before }, out)
    }

    fn round_trip(values: &[f32], quantiser: Option<&Quantiser>) -> Vec<Vec<u8>> {
        let blocks = encode_even(values, None, quantiser);
        assert_eq!(blocks.len(), values.len().div_ceil(BLOCK_VALUES));
        let mut back = vec![];
        for (block, part) in blocks.iter().zip(values.chunks(BLOCK_VALUES)) {
            decode_even(block, part.len(), &[], &mut back).unwrap();
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
        let bytes: usize = round_trip(&smooth, None).iter().map(Vec::len).sum();
        assert!(bytes * 2 < smooth.len() * 3 + 1000, "{bytes} bytes for {} values", smooth.len());
        let whole: Vec<f32> = noise(9000).iter().map(|b| (b % 200) as f32).collect();
        assert!(round_trip(&whole, None).iter().all(|b| b.len() < BLOCK_VALUES * 11 / 10));
        assert!(round_trip(&[7.0; BLOCK_VALUES], None)[0].len() < 60);
    }

    #[test]
    fn rounding_leaves_no_bounds_that_have_a_step_near() {
        let q = Quantiser::new(4.0, [0.0, 15.0]);
        for (value, bounds, expected) in [
            (3.4, [0.0, 9.0], 3.0),
            (3.6, [0.0, 3.9], 3.0),
            (3.4, [3.1, 9.0], 4.0),
            (4.0, [4.0, 4.0], 4.0),
            // No step is near that lies within.
            (3.6, [3.5, 3.9], 4.0),
            (3.4, [3.3, 3.4], 3.0),
        ] {
            assert_eq!(q.round_within(value, bounds), expected, "{value} {bounds:?}");
        }
        assert!(q.round_within(f32::NAN, [f32::NAN; 2]).is_nan());
        let (plain, fitted) = (q.of(Values::Sample), q.of(Values::Fit));
        assert!(plain.bound == q.bound && fitted.bound > 0.4 && fitted.bound < 1.01);
        for n in 0..1500 {
            let value = n as f32 / 100.0;
            let [low, high] = [value - 0.7, value + 0.01];
            let rounded = q.round_within(value, [low, high]);
            assert!((f64::from(rounded) - f64::from(value)).abs() <= fitted.bound);
            let has_step = (high.floor() - low.ceil()) >= 0.0;
            assert!(!has_step || (low..=high).contains(&rounded), "{value}: {rounded}");
        }
    }

    #[test]
    fn quantised_values_stay_within_the_bound_and_come_back() {
        for (low, high) in [(-3.0f32, 5.0f32), (0.0, 1e-30), (1e6, 1e6 + 1.0), (-2e30, 2e30), (7.0, 7.0)] {
            for bits in [4.0, 6.5, 9.0, 16.0, 24.0] {
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
                // The bits asked for and some fifty bytes a block; the first has a NaN, which is
                // distinguished.
                for (b, own) in blocks.iter().zip([250].into_iter().chain(std::iter::repeat(50))) {
                    assert!(b.len() <= BLOCK_VALUES * bits.ceil() as usize / 8 + own, "{bits}: {}", b.len());
                }
            }
        }
        // Values that are no multiples are stored as they are.
        let q = Quantiser::new(8.0, [0.0, 1.0]);
        assert_eq!(
            round_trip(&[0.1, 0.7], Some(&q))[0][0],
            VALUES_PCO.min(encode_even(&[0.1, 0.7], None, None)[0][0])
        );
    }

    #[test]
    fn all_nans_are_one() {
        let nans = [0x7fc0_0000, 0xffc0_0000, 0x7f80_0001, 0x7fff_ffff].map(f32::from_bits);
        assert_eq!(encode_even(&nans, None, None), encode_even(&[f32::NAN; 4], None, None));
        let mut back = vec![];
        decode_even(&encode_even(&nans, None, None)[0], 4, &[], &mut back).unwrap();
        assert!(back.iter().all(|v| v.to_bits() == VOID));
    }

    #[test]
    fn damage_is_refused_or_gives_values_never_a_panic() {
        let smooth: Vec<f32> = (0..300).map(|i| (i * i) as f32).collect();
        let q = Quantiser::new(12.0, [0.0, 90_000.0]);
        let rounded: Vec<f32> = smooth.iter().map(|&v| q.round(v)).collect();
        for good in
            [encode_even(&smooth, None, None).remove(0), encode_even(&rounded, None, Some(&q)).remove(0)]
        {
            assert_ne!(good[0], VALUES_RAW);
            for n in [0, 299, 301, BLOCK_VALUES, usize::MAX] {
                assert!(decode_even(&good, n, &[], &mut vec![]).is_err(), "{n}");
            }
            for i in 0..good.len() {
                assert!(decode_even(&good[..i], 300, &[], &mut vec![]).is_err());
                for bit in 0..8 {
                    let mut bad = good.clone();
                    bad[i] ^= 1 << bit;
                    let mut out = vec![];
                    assert!(decode_even(&bad, 300, &[], &mut out).is_err() || out.len() == 300);
                }
            }
        }
        assert!(decode_even(&[99, 0], 1, &[], &mut vec![]).unwrap_err().got.contains("99"));
    }

    /// Encodes values after others, decodes them, and gives the codec of the first block.
    fn after(values: &[f32], before: &[f32], q: Option<&Quantiser>) -> u8 {
        let blocks = encode_even(values, Some(before), q);
        let mut back = vec![];
        for (n, (block, part)) in blocks.iter().zip(values.chunks(BLOCK_VALUES)).enumerate() {
            decode_even(block, part.len(), &before[n * BLOCK_VALUES..][..part.len()], &mut back).unwrap();
            let alone = decode_even(block, part.len(), &[], &mut vec![]);
            assert_eq!(alone.is_err(), needs_before(block));
        }
        assert!(back.iter().zip(values).all(|(a, b)| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan()));
        blocks[0][0]
    }

    #[test]
    fn values_near_those_before_are_told_by_them() {
        let wave = |t: f32| -> Vec<f32> {
            noise(9000).iter().map(|&n| n as f32 / 1e9 - 2.0 + t * ((n % 7) as f32)).collect()
        };
        let (mut a, mut b) = (wave(0.0), wave(1e-5));
        // Void, void before, both, and signs that change.
        (a[5], b[6], a[7], b[7], a[8], b[8]) = (f32::NAN, f32::NAN, f32::NAN, f32::NAN, -1e-30, 1e-30);
        (a[9], b[9], a[10], b[10]) = (f32::MAX, f32::MIN, -0.0, 0.0);
        assert_eq!(after(&b, &a, None), VALUES_AFTER);
        let q = Quantiser::new(16.0, [-2.0, 2.5]);
        let mut rounded: Vec<f32> = b.iter().map(|&v| q.round(v)).collect();
        rounded[9] = q.round(0.0);
        assert_eq!(after(&rounded, &a, Some(&q)), VALUES_AFTER_QUANTISED);
        // Values that do not look back are shorter alone.
        let ramp: Vec<f32> = (0..9000).map(|i| i as f32).collect();
        assert_eq!(after(&ramp, &a, None), VALUES_PCO);
        assert!(!needs_before(&encode_even(&a, Some(&ramp), None)[0]));
        assert!(encode_even(&[], Some(&[]), None).is_empty());
    }

    #[test]
    fn damaged_differences_are_refused_or_give_values() {
        let before: Vec<f32> = noise(300).iter().map(|&n| n as f32).collect();
        let values: Vec<f32> = before.iter().map(|v| v * 1.000_001).collect();
        let q = Quantiser::new(20.0, [0.0, 5e9]);
        let rounded: Vec<f32> = values.iter().map(|&v| q.round(v)).collect();
        for good in [
            encode_even(&values, Some(&before), None).remove(0),
            encode_even(&rounded, Some(&before), Some(&q)).remove(0),
        ] {
            assert!(needs_before(&good));
            for i in 0..good.len() {
                assert!(decode_even(&good[..i], 300, &before, &mut vec![]).is_err());
                for bit in 0..8 {
                    let mut bad = good.clone();
                    bad[i] ^= 1 << bit;
                    let mut out = vec![];
                    assert!(decode_even(&bad, 300, &before, &mut out).is_err() || out.len() == 300);
                }
            }
        }
    }
}
