//! The spectrum of a chunk, or of a step, and its bytes in a block: see `FORMAT.md`.

use super::design::{Design, Limits};
use crate::archive::Malformed;
use crate::archive::wire::{Cursor, put_varint, to_zstd, unzstd};

/// What the tetrahedra of a chunk contribute to a spectrum: the spectrum of the chunk.
#[derive(Clone, Debug, PartialEq)]
pub struct ChunkPart {
    pub(super) tetrahedra: u64,
    pub(super) volume: f64,
    /// `None` if every tetrahedron is void.
    pub(super) measured: Option<Measured>,
}

/// The spectrum of tetrahedra that are not void.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Measured {
    pub(super) design: Design,
    /// At each knot: active tetrahedra; area, volume inside, gradient times area.
    pub(super) active: Vec<u64>,
    pub(super) sums: Vec<[f64; 3]>,
    /// Active tetrahedra at each level.
    pub(super) levels: Vec<u64>,
}

/// The values of a chunk's vertices at a step.
#[derive(Clone, Copy, Debug)]
pub struct Vertices<'a> {
    /// NaN is void.
    pub values: &'a [f32],
    /// Least and largest value of the tetrahedra that are not void; the first above the second
    /// where all are.
    pub range: [f32; 2],
}

/// The most tetrahedra that a reader takes.
const MOST_TETRAHEDRA: u64 = 1 << 50;
const ZSTD_LEVEL: i32 = 9;

/// How much of a sum is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Digits {
    /// All of it: it will be added to others.
    All,
    /// Its upper 32 bits, rounded: one part in two million may be lost.
    Few,
}

impl Digits {
    /// Bytes of a sum.
    fn bytes(self) -> usize {
        match self {
            Self::All => 8,
            Self::Few => 4,
        }
    }

    /// The bits of a sum that is not negative, those of few digits in the lower half.
    fn bits(self, sum: f64) -> u64 {
        match self {
            Self::All => sum.to_bits(),
            Self::Few => (sum.to_bits() + (1 << 31)) >> 32,
        }
    }

    fn sum(self, bits: u64) -> f64 {
        f64::from_bits(if self == Self::All { bits } else { bits << 32 })
    }
}

impl ChunkPart {
    /// As the bytes of a block.
    pub fn encode(&self, digits: Digits) -> Vec<u8> {
        let mut out = vec![];
        let range = self.measured.as_ref().map_or([f32::INFINITY, f32::NEG_INFINITY], |m| m.design.range);
        range.iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(self.tetrahedra.to_le_bytes());
        out.extend(self.volume.to_le_bytes());
        if let Some(measured) = &self.measured {
            let mut body = vec![];
            // Sums of neighbours have the same upper bytes, which lie next to each other.
            for byte in (0..digits.bytes()).rev() {
                for column in 0..3 {
                    let bits = |sum: &[f64; 3]| (digits.bits(sum[column]) >> (8 * byte)) as u8;
                    body.extend(measured.sums.iter().map(bits));
                }
            }
            put_differences(&mut body, &measured.active);
            put_differences(&mut body, &measured.levels);
            out.extend(to_zstd(&body, ZSTD_LEVEL));
        }
        out
    }

    /// From the bytes of a block, which was made with these limits.
    ///
    /// # Errors
    /// When they are not such a block.
    pub fn decode(bytes: &[u8], limits: Limits, digits: Digits) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let range = [c.f32("least value")?, c.f32("largest value")?];
        let (tetrahedra, volume) = (c.u64("tetrahedra")?, f64::from_bits(c.u64("volume")?));
        if range == [f32::INFINITY, f32::NEG_INFINITY] && tetrahedra == 0 {
            c.end("spectrum")?;
            return Ok(Self { tetrahedra, volume, measured: None });
        }
        if range.iter().any(|v| !v.is_finite()) || range[0] > range[1] || tetrahedra > MOST_TETRAHEDRA {
            let got = format!("{tetrahedra} of {range:?}");
            return Err(Malformed::new("tetrahedra", "some, of a range of values", got));
        }
        let design = Design::new(range, limits);
        let (knots, levels) = (design.knots.count as usize, design.levels.count as usize);
        let most = 3 * digits.bytes() * knots + (knots + levels) * 10;
        let body = unzstd(c.rest(), most, "sums")?;
        let mut c = Cursor::new(&body);
        let mut bits = vec![[0u64; 3]; knots];
        for _ in 0..digits.bytes() {
            for column in 0..3 {
                for (sum, &byte) in bits.iter_mut().zip(c.take(knots, "sums")?) {
                    sum[column] = sum[column] << 8 | u64::from(byte);
                }
            }
        }
        let sums = bits.iter().map(|sum| sum.map(|bits| digits.sum(bits))).collect();
        let active = differences(&mut c, knots, tetrahedra)?;
        let measured = Measured { design, active, sums, levels: differences(&mut c, levels, tetrahedra)? };
        c.end("active tetrahedra")?;
        Ok(Self { tetrahedra, volume, measured: Some(measured) })
    }
}

/// The difference of each number to the one before, its sign moved to the lowest bit.
fn put_differences(out: &mut Vec<u8>, numbers: &[u64]) {
    let mut before = 0;
    for &n in numbers {
        let d = n.wrapping_sub(before) as i64;
        put_varint(out, (d << 1 ^ d >> 63) as u64);
        before = n;
    }
}

/// Reads `n` numbers, none above `most`.
fn differences(c: &mut Cursor<'_>, n: usize, most: u64) -> Result<Vec<u64>, Malformed> {
    let mut before = 0u64;
    let mut next = || {
        let z = c.varint("active tetrahedra")?;
        before = before.wrapping_add((z >> 1) ^ (z & 1).wrapping_neg());
        if before <= most {
            return Ok(before);
        }
        Err(Malformed::new("active tetrahedra", format!("at most {most}"), before.to_string()))
    };
    (0..n).map(|_| next()).collect()
}
