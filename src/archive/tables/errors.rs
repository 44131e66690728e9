//! The errors of a chunk as a block of its values' segment: see `FORMAT.md`.

use crate::archive::wire::{Cursor, Malformed, put_varint, to_zstd, unzstd};
use crate::measure::{BINS, BrickErrors, EXPONENTS, ErrorSums, LAST_DIGIT, Largest, Mantissas};
use isospan_mesh::points::Levels;

const LEVEL: i32 = 9;
/// More than the numbers of all bins and exponents can take.
const LARGEST: usize = 1 << 18;
/// The most samples of a chunk that a reader takes: sums of this many, over any number of chunks,
/// do not overflow.
const MOST_SAMPLES: u64 = 1 << 40;

/// The errors of a chunk.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ChunkErrors {
    pub(crate) sums: ErrorSums,
    /// Where the density of points differs from place to place, the errors in the cells of each
    /// level; of a pyramid those of each level from 1 on. Up to the last level that has a sample of
    /// the chunk.
    pub(crate) levels: Vec<BrickErrors>,
}

/// As the bytes of a block.
pub(crate) fn encode_errors(errors: &ChunkErrors) -> Vec<u8> {
    let ChunkErrors { sums, levels } = errors;
    let mut body = vec![];
    [sums.measured, sums.missing, sums.void, sums.zeros].iter().for_each(|&n| put_varint(&mut body, n));
    put_filled(&mut body, &sums.bins, |n| *n > 0, |body, &n| put_varint(body, n));
    put_filled(
        &mut body,
        &sums.digits(),
        |m| *m != Mantissas::default(),
        |body, m| {
            put_wide(body, m.sum);
            put_wide(body, zigzag(m.signed));
            put_wide(body, m.squares);
        },
    );
    if let Some(l) = sums.largest {
        put_varint(&mut body, l.sample);
        body.extend(l.original.to_le_bytes());
        body.extend(l.reduced.to_le_bytes());
    }
    if let Some(range) = sums.source_range() {
        range.iter().for_each(|v| body.extend(v.to_le_bytes()));
    }
    // Levels above have no sample in the chunk. It need not know how many there are elsewhere.
    let last = levels.iter().rposition(|l| l.samples > 0);
    let levels = &levels[..last.map_or(0, |n| n + 1)];
    put_varint(&mut body, levels.len() as u64);
    for level in levels {
        put_varint(&mut body, level.samples);
        body.extend(level.squares.to_le_bytes());
        body.extend((level.max as f32).to_le_bytes());
    }
    to_zstd(&body, LEVEL)
}

/// The errors by level.
fn decode_levels(c: &mut Cursor<'_>, measured: u64) -> Result<Vec<BrickErrors>, Malformed> {
    let count = c.varint("levels")?;
    if count > u64::from(Levels::LARGEST) + 1 {
        let most = Levels::LARGEST + 1;
        return Err(Malformed::new("levels", format!("at most {most}"), count.to_string()));
    }
    let mut levels = vec![];
    for _ in 0..count {
        let (samples, squares) = (c.varint("samples")?, c.f64("squares")?);
        let max = f64::from(c.f32("error")?);
        let good = samples <= measured && squares >= 0.0 && max >= 0.0 && max.is_finite();
        if !good || squares > samples as f64 * max * max * 1.001 {
            let got = format!("{samples} samples, {squares}, {max}");
            return Err(Malformed::new("errors of a level", format!("those of {measured} samples"), got));
        }
        levels.push(BrickErrors { samples, squares, max });
    }
    Ok(levels)
}

/// How many are filled; of each its number less the one before, less 1, and what it holds.
fn put_filled<T>(body: &mut Vec<u8>, all: &[T], is_filled: fn(&T) -> bool, put: impl Fn(&mut Vec<u8>, &T)) {
    put_varint(body, all.iter().filter(|t| is_filled(t)).count() as u64);
    let mut next = 0;
    for (n, t) in all.iter().enumerate().filter(|(_, t)| is_filled(t)) {
        put_varint(body, (n - next) as u64);
        put(body, t);
        next = n + 1;
    }
}

/// Hands on the numbers of the filled ones of `most`.
fn each_filled(
    c: &mut Cursor<'_>,
    most: usize,
    mut each: impl FnMut(&mut Cursor<'_>, usize) -> Result<(), Malformed>,
) -> Result<(), Malformed> {
    let mut next = 0u64;
    for _ in 0..c.varint("errors")? {
        let n = next.saturating_add(c.varint("errors")?);
        if n >= most as u64 {
            return Err(Malformed::new("errors", format!("numbers below {most}"), n.to_string()));
        }
        each(c, n as usize)?;
        next = n + 1;
    }
    Ok(())
}

/// The sign moved to the lowest bit.
fn zigzag(v: i128) -> u128 {
    (v << 1 ^ v >> 127) as u128
}

/// A varint of at most 128 bits.
fn put_wide(body: &mut Vec<u8>, mut v: u128) {
    while v >= 0x80 {
        body.push(v as u8 | 0x80);
        v >>= 7;
    }
    body.push(v as u8);
}

fn wide(c: &mut Cursor<'_>) -> Result<u128, Malformed> {
    let mut value = 0u128;
    for shift in (0..128).step_by(7) {
        let byte = c.u8("sum")?;
        let bits = u128::from(byte & 0x7f);
        if bits << shift >> shift != bits {
            break;
        }
        value |= bits << shift;
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err(Malformed::new("sum", "an integer of at most 128 bits", "a longer one"))
}

/// From the bytes of a block.
///
/// # Errors
/// When they are not such a block.
pub(crate) fn decode_errors(bytes: &[u8]) -> Result<ChunkErrors, Malformed> {
    let body = unzstd(bytes, LARGEST, "errors")?;
    let mut c = Cursor::new(&body);
    let mut sums = ErrorSums::default();
    for n in [&mut sums.measured, &mut sums.missing, &mut sums.void, &mut sums.zeros] {
        *n = c.varint("samples")?;
        if *n > MOST_SAMPLES {
            return Err(Malformed::new("samples", format!("at most {MOST_SAMPLES}"), n.to_string()));
        }
    }
    let mut counted = u128::from(sums.zeros);
    each_filled(&mut c, BINS, |c, n| {
        sums.bins[n] = c.varint("errors")?;
        counted += u128::from(sums.bins[n]);
        Ok(())
    })?;
    if counted != u128::from(sums.measured) {
        return Err(Malformed::new("errors", format!("{} in all", sums.measured), counted.to_string()));
    }
    each_filled(&mut c, EXPONENTS, |c, n| {
        let [sum, signed, squares] = [wide(c)?, wide(c)?, wide(c)?];
        let signed = (signed >> 1) as i128 ^ -((signed & 1) as i128);
        // The last digit has all that is left of the largest floats.
        let left = if n == LAST_DIGIT { 13 } else { 0 };
        let most = u128::from(sums.measured) << (24 + left);
        if sum > most || signed.unsigned_abs() > sum || squares > most << (24 + left) {
            let got = format!("{sum}, {signed}, {squares}");
            return Err(Malformed::new("sums", format!("those of {} errors", sums.measured), got));
        }
        sums.mantissas[n] = Mantissas { sum, signed, squares };
        Ok(())
    })?;
    if sums.measured > 0 {
        let sample = c.varint("sample")?;
        sums.largest = Some(Largest::new(sample, c.f32("original")?, c.f32("value")?));
    }
    if sums.measured + sums.void > 0 {
        let range = [c.f32("range")?, c.f32("range")?];
        if !(range[0] <= range[1] && range.iter().all(|v| v.is_finite())) {
            let got = format!("{} .. {}", range[0], range[1]);
            return Err(Malformed::new("range of the samples", "two numbers, the lesser one first", got));
        }
        sums.range = range;
    }
    let levels = decode_levels(&mut c, sums.measured)?;
    c.end("errors")?;
    Ok(ChunkErrors { sums, levels })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> ChunkErrors {
        let (mut sums, mut levels) = (ErrorSums::default(), vec![BrickErrors::default(); 3]);
        for i in 0..1000u32 {
            let v = f32::from_bits(i.wrapping_mul(0x9e37_79b9));
            let reduced = if i % 50 == 0 { f32::NAN } else { 1.5 };
            let original = if i % 7 == 0 { 1.5 } else { v };
            sums.add(original, reduced, || u64::from(i) << 20);
            levels[i as usize % 3].add(original, reduced);
        }
        sums.mantissas = sums.digits();
        ChunkErrors { sums, levels }
    }

    #[test]
    fn errors_come_back() {
        for errors in [ChunkErrors::default(), some(), ChunkErrors { levels: vec![], ..some() }] {
            assert_eq!(decode_errors(&encode_errors(&errors)).unwrap(), errors);
        }
        let mut void = ChunkErrors::default();
        void.sums.add(f32::NAN, 0.0, || 0);
        void.sums.add(0.0, f32::NAN, || 0);
        assert_eq!(decode_errors(&encode_errors(&void)).unwrap(), void);
    }

    #[test]
    fn damage_is_refused_or_gives_errors_that_add_up() {
        let body = unzstd(&encode_errors(&some()), LARGEST, "errors").unwrap();
        for i in (0..body.len()).step_by(3) {
            assert!(decode_errors(&to_zstd(&body[..i], LEVEL)).is_err());
            let mut bad = body.clone();
            bad[i] ^= 1 << (i % 8);
            if let Ok(ChunkErrors { sums, .. }) = decode_errors(&to_zstd(&bad, LEVEL)) {
                let mut twice = sums.clone();
                twice.merge(&sums);
                assert_eq!(twice.samples(), 2 * sums.samples());
                assert!(sums.field_error(sums.samples()).rms >= 0.0);
            }
        }
        assert!(decode_errors(&[]).is_err());
        let mut more = some();
        more.levels[0].samples = more.sums.measured + 1;
        let error = format!("{:?}", decode_errors(&encode_errors(&more)).unwrap_err());
        assert!(error.contains("errors of a level"), "{error}");
    }
}
