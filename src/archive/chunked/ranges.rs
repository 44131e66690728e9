//! The ranges of tetrahedron blocks: rounded outwards, and coded.
//!
//! ```text
//!  values of a block ─▶ least, largest ─▶ rounded outwards ─▶ e, a, w in few bits
//!                                          to a · 2^e and (a + w) · 2^e
//! ```
//!
//! A range says only which blocks a surface may cross. If it is wider than need be, some more
//! blocks are decoded in vain, in proportion. So its ends are rounded to a 16th to a 32nd of its
//! own width: about 4 % more blocks, for a quarter of the bytes. Within a chunk no range is wider
//! than all of them together, so the range of a step stays exact.
//!
//! The coder takes any ranges, and gives them back bit by bit; what is not of that form takes 64
//! bits.

use crate::archive::range_coder::{Decoder, Encoder, Odds};
use crate::archive::wire::{Cursor, Malformed};
use isospan_mesh::mesh::tet::Tet;

/// The values of one tetrahedron block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockRange {
    /// Least corner value of the block's tetrahedra that are not void, or less; infinite if all are
    /// void.
    pub min: f32,
    /// Largest corner value, or more.
    pub max: f32,
    /// Tetrahedra that are not void.
    pub tets: u32,
}

/// Widths of a range in its unit: 2^4 and more.
const WIDTH_BITS: i32 = 4;
/// Bits of a width in units, less the least one.
const MORE_BITS: u32 = 5;
/// Units within the bounds, at most.
const MOST_UNITS: f64 = (1u64 << 40) as f64;
/// Exponents of units: those of differences of `f32`, less some.
const EXPONENTS: std::ops::RangeInclusive<i32> = -160..=130;

impl BlockRange {
    /// The range of tetrahedra, given the values of their vertices.
    pub fn of(tets: &[Tet], values: &[f32]) -> Self {
        let [range] = Self::of_steps(tets, values.as_chunks().0);
        range
    }

    /// The same at some steps, whose values lie side by side.
    #[inline(always)]
    pub(crate) fn of_steps<const N: usize>(tets: &[Tet], values: &[[f32; N]]) -> [Self; N] {
        let (mut min, mut max, mut live) = ([f32::INFINITY; N], [f32::NEG_INFINITY; N], [0; N]);
        for tet in tets {
            let &[a, b, c, d] = tet;
            let (a, b) = (values[a as usize], values[b as usize]);
            let (c, d) = (values[c as usize], values[d as usize]);
            let (lo, hi) = (lesser(lesser(a, b), lesser(c, d)), greater(greater(a, b), greater(c, d)));
            for k in 0..N {
                let void = a[k].is_nan() | b[k].is_nan() | c[k].is_nan() | d[k].is_nan();
                let (lo, hi) = if void { (min[k], max[k]) } else { (lo[k], hi[k]) };
                min[k] = if lo < min[k] { lo } else { min[k] };
                max[k] = if hi > max[k] { hi } else { max[k] };
                live[k] += u32::from(!void);
            }
        }
        std::array::from_fn(|k| Self { min: min[k], max: max[k], tets: live[k] })
    }

    /// That of nothing.
    pub(crate) const NONE: Self = Self { min: f32::INFINITY, max: f32::NEG_INFINITY, tets: 0 };

    /// That of what this one and another one hold.
    pub(crate) fn and(self, other: Self) -> Self {
        let (min, max) = (self.min.min(other.min), self.max.max(other.max));
        Self { min, max, tets: self.tets + other.tets }
    }

    /// Rounds ranges outwards, none beyond all of them together.
    pub(crate) fn round(ranges: &mut [Self]) {
        let bounds = Self::bounds(ranges.iter().copied());
        Self::round_within(ranges, bounds);
    }

    /// Rounds ranges outwards, none beyond bounds.
    pub(crate) fn round_within(ranges: &mut [Self], bounds: [f32; 2]) {
        ranges.iter_mut().for_each(|range| *range = range.rounded(bounds));
    }

    /// The least and the largest value; infinite if all are void.
    pub(crate) fn bounds(ranges: impl Iterator<Item = Self>) -> [f32; 2] {
        let none = [f32::INFINITY, f32::NEG_INFINITY];
        ranges.filter(|r| r.tets > 0).fold(none, |[lo, hi], r| [lo.min(r.min), hi.max(r.max)])
    }

    fn rounded(self, [lowest, highest]: [f32; 2]) -> Self {
        let Some(exponent) = self.exponent() else { return self };
        let unit = exp2(exponent);
        // A zero without a sign. All these are numbers of f32 or beyond the bounds.
        let min = (f64::from(self.min) / unit).floor() * unit + 0.0;
        let max = (f64::from(self.max) / unit).ceil() * unit + 0.0;
        Self { min: (min as f32).max(lowest), max: (max as f32).min(highest), ..self }
    }

    /// The exponent of the unit that its ends are rounded to; `None` where it has no width.
    fn exponent(self) -> Option<i32> {
        let width = f64::from(self.max) - f64::from(self.min);
        let exponent = (width.to_bits() >> 52) as i32 - 1023 - WIDTH_BITS;
        (width > 0.0 && width.is_finite()).then_some(exponent)
    }
}

#[inline(always)]
pub(super) fn lesser<const N: usize>(a: [f32; N], mut b: [f32; N]) -> [f32; N] {
    for k in 0..N {
        b[k] = if a[k] < b[k] { a[k] } else { b[k] };
    }
    b
}

#[inline(always)]
pub(super) fn greater<const N: usize>(a: [f32; N], mut b: [f32; N]) -> [f32; N] {
    for k in 0..N {
        b[k] = if a[k] > b[k] { a[k] } else { b[k] };
    }
    b
}

/// A power of two that `f64` has with all its bits.
fn exp2(exponent: i32) -> f64 {
    f64::from_bits(((exponent + 1023) as u64) << 52)
}

/// A range whose ends are multiples of a power of two, or the bounds.
#[derive(Clone, Copy)]
struct ShortRange {
    /// The exponent of the unit.
    exponent: i32,
    /// Units from the one that holds the lower bound to that of the lower end.
    first: u64,
    /// Units from the lower end to the upper one, less the least number.
    more: u64,
}

impl ShortRange {
    /// The form of a range, if it has one that gives it back bit by bit.
    fn of(range: BlockRange, bounds: [f32; 2]) -> Option<Self> {
        let near = range.exponent()?;
        [near, near - 1, near + 1].into_iter().find_map(|exponent| {
            let [lower, units] = units(exponent, bounds)?;
            let unit = exp2(exponent);
            let least = (f64::from(range.min) / unit).floor();
            let first = least - lower;
            let more = (f64::from(range.max) / unit).ceil() - least - f64::from(1 << WIDTH_BITS);
            let fits = (0.0..=units).contains(&first) && (0.0..f64::from(1 << MORE_BITS)).contains(&more);
            let short = Self { exponent, first: first as u64, more: more as u64 };
            let same = |[min, max]: [f32; 2]| {
                (min.to_bits(), max.to_bits()) == (range.min.to_bits(), range.max.to_bits())
            };
            (fits && same(short.ends(lower, bounds))).then_some(short)
        })
    }

    fn ends(self, lower: f64, [lowest, highest]: [f32; 2]) -> [f32; 2] {
        let (unit, first) = (exp2(self.exponent), lower + self.first as f64);
        let last = first + (self.more + (1 << WIDTH_BITS)) as f64;
        [((first * unit + 0.0) as f32).max(lowest), ((last * unit + 0.0) as f32).min(highest)]
    }
}

/// The unit that holds the lower bound, and the number of those from there to the upper one; `None`
/// where there are too many.
fn units(exponent: i32, [lowest, highest]: [f32; 2]) -> Option<[f64; 2]> {
    let unit = EXPONENTS.contains(&exponent).then(|| exp2(exponent))?;
    let [lower, upper] = [lowest, highest].map(|bound| (f64::from(bound) / unit).floor());
    (upper - lower < MOST_UNITS).then_some([lower, upper - lower])
}

/// Bits of a number up to that of units.
fn bits_of(units: f64) -> u32 {
    64 - (units as u64).leading_zeros()
}

/// What has been learned, and the range before.
struct Model {
    is_constant: Odds,
    is_again: Odds,
    is_short: Odds,
    is_same: Odds,
    is_larger: Odds,
    /// Whether the exponent is yet another one further.
    further: [Odds; 4],
    exponent: i32,
    constant: u32,
}

impl Model {
    fn new() -> Self {
        let (often, seldom, even) = (Odds::new(60_000), Odds::new(6_000), Odds::new(1 << 15));
        Self {
            is_constant: seldom,
            is_again: often,
            is_short: often,
            is_same: Odds::new(20_000),
            is_larger: even,
            further: [Odds::new(25_000); 4],
            exponent: 0,
            constant: 0,
        }
    }
}

/// Codes ranges that lie within bounds.
pub(crate) struct RangeEncoder {
    coder: Encoder,
    model: Model,
    bounds: [f32; 2],
    /// The least and the largest number of tetrahedra.
    tets: [u32; 2],
}

impl RangeEncoder {
    /// Begins with the bounds of these ranges, and of their numbers of tetrahedra: 16 bytes.
    pub(crate) fn begin(ranges: impl Iterator<Item = BlockRange> + Clone, out: &mut Vec<u8>) -> Self {
        let bounds = BlockRange::bounds(ranges.clone());
        let counts = ranges.map(|r| r.tets);
        let tets = [counts.clone().min().unwrap_or(0), counts.max().unwrap_or(0)];
        bounds.iter().for_each(|bound| out.extend(bound.to_le_bytes()));
        tets.iter().for_each(|bound| out.extend(bound.to_le_bytes()));
        Self { coder: Encoder::default(), model: Model::new(), bounds, tets }
    }

    /// A number of so many bits.
    pub(crate) fn number(&mut self, bits: u32, value: u64) {
        for from in (0..bits).step_by(16) {
            let here = (bits - from).min(16);
            self.coder.raw(here, (value >> from) as u32 & ((1 << here) - 1));
        }
    }

    pub(crate) fn push(&mut self, range: BlockRange) {
        let [least, most] = self.tets;
        self.number(bits_of(f64::from(most - least)), u64::from(range.tets - least));
        if range.tets == 0 {
            return;
        }
        let [min, max] = [range.min, range.max].map(f32::to_bits);
        self.coder.bit(&mut self.model.is_constant, min == max);
        if min == max {
            self.coder.bit(&mut self.model.is_again, min == self.model.constant);
            if min != self.model.constant {
                self.number(32, u64::from(min));
                self.model.constant = min;
            }
            return;
        }
        let short = ShortRange::of(range, self.bounds);
        self.coder.bit(&mut self.model.is_short, short.is_some());
        let Some(short) = short else {
            self.number(32, u64::from(min));
            self.number(32, u64::from(max));
            return;
        };
        self.exponent(short.exponent);
        let [_, units] = units(short.exponent, self.bounds).expect("a short range has a unit");
        self.number(bits_of(units), short.first);
        self.number(MORE_BITS, short.more);
    }

    fn exponent(&mut self, exponent: i32) {
        let model = &mut self.model;
        let apart = exponent - model.exponent;
        model.exponent = exponent;
        self.coder.bit(&mut model.is_same, apart == 0);
        if apart != 0 {
            self.coder.bit(&mut model.is_larger, apart > 0);
            for n in 1..=apart.unsigned_abs() {
                let odds = &mut model.further[(n as usize - 1).min(3)];
                self.coder.bit(odds, n < apart.unsigned_abs());
            }
        }
    }

    pub(crate) fn finish(mut self, out: &mut Vec<u8>) {
        self.coder.finish(out);
    }
}

/// Reads what [`RangeEncoder`] wrote.
pub(crate) struct RangeDecoder<'a> {
    coder: Decoder<'a>,
    model: Model,
    bounds: [f32; 2],
    tets: [u32; 2],
}

impl<'a> RangeDecoder<'a> {
    /// Reads all bytes that are left.
    pub(crate) fn begin(c: &mut Cursor<'a>) -> Result<Self, Malformed> {
        let bounds = [c.f32("least value of blocks")?, c.f32("largest value of blocks")?];
        let tets = [c.u32("least tetrahedra of a block")?, c.u32("most tetrahedra of a block")?];
        if tets[0] > tets[1] {
            return Err(Malformed::new("tetrahedra of a block", "least <= most", format!("{tets:?}")));
        }
        Ok(Self { coder: Decoder::new(c.rest()), model: Model::new(), bounds, tets })
    }

    /// A number of so many bits, at most 64.
    pub(crate) fn number(&mut self, bits: u32) -> u64 {
        let mut value = 0;
        for from in (0..bits).step_by(16) {
            value |= u64::from(self.coder.raw((bits - from).min(16))) << from;
        }
        value
    }

    pub(crate) fn pull(&mut self) -> Result<BlockRange, Malformed> {
        let [least, most] = self.tets;
        let tets = least.saturating_add(self.number(bits_of(f64::from(most - least))) as u32);
        if tets == 0 {
            return Ok(BlockRange { min: f32::INFINITY, max: f32::NEG_INFINITY, tets });
        }
        let [min, max] = self.ends()?;
        if min <= max {
            return Ok(BlockRange { min, max, tets });
        }
        Err(Malformed::new("range", "min <= max", format!("{min} to {max}")))
    }

    fn ends(&mut self) -> Result<[f32; 2], Malformed> {
        if self.coder.bit(&mut self.model.is_constant) {
            if !self.coder.bit(&mut self.model.is_again) {
                self.model.constant = self.number(32) as u32;
            }
            return Ok([f32::from_bits(self.model.constant); 2]);
        }
        if !self.coder.bit(&mut self.model.is_short) {
            return Ok([0; 2].map(|_| f32::from_bits(self.number(32) as u32)));
        }
        let exponent = self.exponent();
        let wrong = || Malformed::new("unit of a range", "one that fits the bounds", format!("2^{exponent}"));
        let [lower, units] = units(exponent, self.bounds).ok_or_else(wrong)?;
        let (first, more) = (self.number(bits_of(units)), self.number(MORE_BITS));
        Ok(ShortRange { exponent, first, more }.ends(lower, self.bounds))
    }

    fn exponent(&mut self) -> i32 {
        let model = &mut self.model;
        if !self.coder.bit(&mut model.is_same) {
            let sign = if self.coder.bit(&mut model.is_larger) { 1 } else { -1 };
            let most = EXPONENTS.end() - EXPONENTS.start();
            let mut apart = 1;
            while apart < most && self.coder.bit(&mut model.further[(apart as usize - 1).min(3)]) {
                apart += 1;
            }
            model.exponent = model.exponent.saturating_add(sign * apart);
        }
        model.exponent
    }

    /// Nothing may be left.
    pub(crate) fn end(&self) -> Result<(), Malformed> {
        if self.coder.at_end() {
            return Ok(());
        }
        Err(Malformed::new("ranges", "the end of the block", "more or fewer bytes"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn through(ranges: &[BlockRange]) -> (Vec<BlockRange>, usize) {
        let mut bytes = vec![];
        let mut encoder = RangeEncoder::begin(ranges.iter().copied(), &mut bytes);
        for (n, &range) in ranges.iter().enumerate() {
            encoder.push(range);
            encoder.number(37, n as u64);
        }
        encoder.finish(&mut bytes);
        let mut decoder = RangeDecoder::begin(&mut Cursor::new(&bytes)).unwrap();
        let back = (0..ranges.len()).map(|n| {
            let range = decoder.pull().unwrap();
            assert_eq!(decoder.number(37), n as u64);
            range
        });
        let back = back.collect();
        decoder.end().unwrap();
        (back, bytes.len())
    }

    fn range(min: f32, max: f32) -> BlockRange {
        BlockRange { min, max, tets: 256 }
    }

    #[test]
    fn rounded_ranges_are_a_little_wider_and_take_few_bits() {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let exact: Vec<BlockRange> = (0..4000)
            .map(|_| {
                let min = 1000.0 * next() - 300.0;
                range(min, min + 1.0 + 200.0 * next())
            })
            .collect();
        let mut rounded = exact.clone();
        BlockRange::round(&mut rounded);
        for (exact, rounded) in exact.iter().zip(&rounded) {
            assert!(rounded.min <= exact.min && exact.max <= rounded.max);
            assert!(rounded.max - rounded.min <= 1.126 * (exact.max - exact.min));
        }
        assert_eq!(BlockRange::bounds(exact.iter().copied()), BlockRange::bounds(rounded.iter().copied()));
        let (back, bytes) = through(&rounded);
        assert_eq!(back, rounded);
        let bits = 8.0 * bytes as f64 / 4000.0 - 37.0;
        assert!(bits < 20.0, "{bits} bits");
        assert!(8 * through(&exact).1 > 4000 * 90, "those that are not rounded take more");
    }

    #[test]
    fn odd_ranges_come_back() {
        let mut ranges = vec![
            range(0.0, 0.0),
            range(-0.0, -0.0),
            range(-0.0, 1.0),
            range(f32::MIN, f32::MAX),
            range(f32::NEG_INFINITY, 3.0),
            range(1e-45, 2e-45),
            range(16_777_216.0, 16_777_218.0),
            range(0.1, 0.3),
            BlockRange { min: f32::INFINITY, max: f32::NEG_INFINITY, tets: 0 },
            BlockRange { min: 1.0, max: 2.0, tets: 3 },
        ];
        let bits = |ranges: &[BlockRange]| -> Vec<_> {
            ranges.iter().map(|r| (r.min.to_bits(), r.max.to_bits(), r.tets)).collect()
        };
        assert_eq!(bits(&through(&ranges).0), bits(&ranges));
        BlockRange::round(&mut ranges);
        assert_eq!(bits(&through(&ranges).0), bits(&ranges));
        assert_eq!(through(&[]).0, vec![]);
    }

    proptest! {
        #[test]
        fn any_ranges_come_back(ends in prop::collection::vec((any::<f32>(), any::<f32>(), 0u32..300), 0..50)) {
            let ranges: Vec<BlockRange> = ends.into_iter().map(|(a, b, tets)| match (a.is_nan() || b.is_nan(), tets) {
                (false, 1..) => BlockRange { min: a.min(b), max: a.max(b), tets },
                _ => BlockRange { min: f32::INFINITY, max: f32::NEG_INFINITY, tets: 0 },
            }).collect();
            prop_assert_eq!(through(&ranges).0, ranges.clone());
            let mut rounded = ranges.clone();
            BlockRange::round(&mut rounded);
            prop_assert!(rounded.iter().zip(&ranges).all(|(r, e)| r.min <= e.min && e.max <= r.max));
            prop_assert_eq!(through(&rounded).0, rounded);
        }

        #[test]
        fn damage_ends(bytes in prop::collection::vec(any::<u8>(), 16..100)) {
            if let Ok(mut decoder) = RangeDecoder::begin(&mut Cursor::new(&bytes)) {
                (0..200).for_each(|_| { let _ = decoder.pull(); });
            }
        }
    }
}
