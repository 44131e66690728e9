//! The part of a chunk as a block of its values' segment: see `FORMAT.md`.

use super::design::{Design, Limits};
use super::measure::{ChunkPart, Measured};
use super::store::{PAGE_LEVEL, f64_of, put_differences};
use super::sums::CUT_BITS;
use crate::archive::Malformed;
use crate::archive::wire::{Cursor, to_zstd, unzstd};

/// The lowest bytes of a sum, which are 0.
const CUT_BYTES: usize = CUT_BITS as usize / 8;
/// The most tetrahedra of a chunk that a reader takes.
const MOST_TETRAHEDRA: u64 = 1 << 40;

impl ChunkPart {
    /// As the bytes of a block.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = vec![];
        let range = self.measured.as_ref().map_or([f32::INFINITY, f32::NEG_INFINITY], |m| m.design.range);
        range.iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(self.tetrahedra.to_le_bytes());
        out.extend(self.volume.to_le_bytes());
        if let Some(measured) = &self.measured {
            for column in 0..3 {
                let bytes = |sum: &[f64; 3]| sum[column].to_le_bytes();
                measured.sums.iter().for_each(|sum| out.extend(&bytes(sum)[CUT_BYTES..]));
            }
            let mut body = vec![];
            put_differences(&mut body, 0, &measured.active);
            put_differences(&mut body, 0, &measured.levels);
            out.extend(to_zstd(&body, PAGE_LEVEL));
        }
        out
    }

    /// From the bytes of a block, which was made with these limits.
    ///
    /// # Errors
    /// When they are not such a block.
    pub fn decode(bytes: &[u8], limits: Limits) -> Result<Self, Malformed> {
        let mut c = Cursor::new(bytes);
        let range = [c.f32("least value")?, c.f32("largest value")?];
        let (tetrahedra, volume) = (c.u64("tetrahedra")?, f64_of(&mut c, "volume")?);
        if range == [f32::INFINITY, f32::NEG_INFINITY] && tetrahedra == 0 {
            c.end("spectrum of a chunk")?;
            return Ok(Self { tetrahedra, volume, measured: None });
        }
        if range.iter().any(|v| !v.is_finite()) || range[0] > range[1] || tetrahedra > MOST_TETRAHEDRA {
            let got = format!("{tetrahedra} of {range:?}");
            return Err(Malformed::new("tetrahedra", "some, of a range of values", got));
        }
        let design = Design::new(range, limits);
        let (knots, levels) = (design.knots.count as usize, design.levels.count as usize);
        let mut sums = vec![[0.0; 3]; knots];
        for column in 0..3 {
            for sum in &mut sums {
                let mut bytes = [0; 8];
                bytes[CUT_BYTES..].copy_from_slice(c.take(8 - CUT_BYTES, "sums")?);
                sum[column] = f64::from_le_bytes(bytes);
            }
        }
        let body = unzstd(c.rest(), (knots + levels) * 10, "active tetrahedra")?;
        let mut c = Cursor::new(&body);
        let active = differences(&mut c, knots, tetrahedra)?;
        let measured = Measured { design, active, sums, levels: differences(&mut c, levels, tetrahedra)? };
        c.end("active tetrahedra")?;
        Ok(Self { tetrahedra, volume, measured: Some(measured) })
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
