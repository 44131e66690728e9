//! The parts of a TIFF file around its samples: a page for each slice, uncompressed.
//!
//! ```text
//! "II" 42, place of the first page                  BigTIFF ("II" 43) where 32 bits do not reach
//! samples                                           slice after slice
//! a directory and its long entries, for each page
//! ```
//!
//! ImageJ's description of the first page has the spacing along z and the unit; resolutions of all
//! pages have those along x and y. The format: "TIFF Revision 6.0", Adobe 1992; BigTIFF, AWare
//! Systems.

use super::{FileLayout, GridMeta, GridPlace};
use crate::error::{Error, Result};
use crate::volume::ScalarType;

const SHORT: u16 = 3;
const LONG: u16 = 4;
const RATIONAL: u16 = 5;
const ASCII: u16 = 2;
const LONG8: u16 = 16;

/// The most bytes that the pages' directories may take.
const MOST_TAIL: u64 = 1 << 30;

/// The least bytes of directories and what they point to, for each page.
const PAGE: u64 = 400;

pub(super) fn layout(meta: &GridMeta) -> Result<FileLayout> {
    let field = meta.field();
    let kind = match field.scalar {
        ScalarType::U8 | ScalarType::U16 | ScalarType::U32 | ScalarType::U64 => 1u64,
        ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64 => 2,
        ScalarType::F16 | ScalarType::F32 | ScalarType::F64 => 3,
    };
    let [width, height, slices] = meta.dims;
    if slices.saturating_mul(PAGE) > MOST_TAIL || width.max(height) > u64::from(u32::MAX) {
        return Err(Error::usage(format!(
            "a TIFF file of {slices} pages of {width} x {height} samples is not written: write .nrrd or .zarr"
        )));
    }
    let slice = width * height * field.scalar.bytes() as u64;
    let samples = slice * slices;
    let big = samples + slices * PAGE > u64::from(u32::MAX) - (1 << 16);
    let first: u64 = if big { 16 } else { 8 };
    let mut tail = vec![0; (samples % 2) as usize];
    let mut at = first + samples + tail.len() as u64;
    let head = match big {
        true => [&b"II\x2b\0\x08\0\0\0"[..], &at.to_le_bytes()].concat(),
        false => [&b"II\x2a\0"[..], &(at as u32).to_le_bytes()].concat(),
    };
    let description = description(meta);
    for n in 0..slices {
        let mut entries = vec![
            (256, LONG, vec![width]),
            (257, LONG, vec![height]),
            (258, SHORT, vec![8 * field.scalar.bytes() as u64]),
            (259, SHORT, vec![1]),
            (262, SHORT, vec![1]),
        ];
        if n == 0 {
            entries.push((270, ASCII, description.bytes().chain([0]).map(u64::from).collect()));
        }
        let offset = if big { LONG8 } else { LONG };
        entries.push((273, offset, vec![first + n * slice]));
        entries.push((277, SHORT, vec![1]));
        entries.push((278, LONG, vec![height]));
        entries.push((279, offset, vec![slice]));
        if let GridPlace::Even(geometry) = &meta.place {
            entries.push((282, RATIONAL, resolution(geometry.spacing[0])));
            entries.push((283, RATIONAL, resolution(geometry.spacing[1])));
        }
        entries.push((296, SHORT, vec![1]));
        entries.push((339, SHORT, vec![kind]));
        let bytes = directory(&entries, big, at, n + 1 == slices);
        at += bytes.len() as u64;
        tail.extend(bytes);
    }
    Ok(FileLayout { head, tail, ..FileLayout::default() })
}

/// Samples a unit of length: two numbers of 32 bits, as exact as these are.
fn resolution(spacing: f64) -> Vec<u64> {
    let most = f64::from(u32::MAX);
    let (mut best, mut below) = ([1.0, 1.0], 1.0);
    let value = 1.0 / spacing.abs();
    let off = |[a, b]: [f64; 2]| (a / b / value - 1.0).abs();
    while below <= 1e9 {
        // A number of samples, and of units.
        for pair in [[(value * below).round(), below], [below, (below / value).round()]] {
            let fits = pair.iter().all(|n| (1.0..=most).contains(n));
            if fits && off(pair) < off(best) {
                best = pair;
            }
        }
        below *= 10.0;
    }
    best.map(|n| n as u64).to_vec()
}

/// ImageJ's description.
fn description(meta: &GridMeta) -> String {
    let spacing = match &meta.place {
        GridPlace::Even(geometry) => geometry.spacing[2].abs(),
        _ => 1.0,
    };
    let slices = meta.dims[2];
    let unit = meta.length_unit().map(|unit| match unit.as_str() {
        "µm" => "micron".to_owned(),
        other => other.chars().filter(char::is_ascii).collect(),
    });
    let unit = unit.map_or_else(String::new, |unit| format!("unit={unit}\n"));
    format!("ImageJ=1.54f\nimages={slices}\nslices={slices}\n{unit}spacing={spacing}\nloop=false\n")
}

/// Bytes of a number of a type.
fn bytes_of(kind: u16) -> u64 {
    match kind {
        SHORT => 2,
        LONG => 4,
        RATIONAL | LONG8 => 8,
        _ => 1,
    }
}

/// A directory, and behind it the entries that do not fit in it.
fn directory(entries: &[(u16, u16, Vec<u64>)], big: bool, at: u64, is_last: bool) -> Vec<u8> {
    let (entry, word) = if big { (20, 8) } else { (12, 4) };
    let head = if big { 8 } else { 2 };
    let length = head + entry * entries.len() as u64 + word;
    let (mut out, mut beyond) = (vec![], vec![]);
    match big {
        true => out.extend((entries.len() as u64).to_le_bytes()),
        false => out.extend((entries.len() as u16).to_le_bytes()),
    }
    let put = |out: &mut Vec<u8>, n: u64| out.extend(&n.to_le_bytes()[..word as usize]);
    for (tag, kind, values) in entries {
        let count = if *kind == RATIONAL { 1 } else { values.len() as u64 };
        // A rational is two numbers of four bytes.
        let width = if *kind == RATIONAL { 4 } else { bytes_of(*kind) };
        let mut bytes: Vec<u8> =
            values.iter().flat_map(|v| v.to_le_bytes()[..width as usize].to_vec()).collect();
        out.extend(tag.to_le_bytes());
        out.extend(kind.to_le_bytes());
        put(&mut out, count);
        if bytes.len() as u64 <= word {
            bytes.resize(word as usize, 0);
            out.extend(bytes);
        } else {
            put(&mut out, at + length + beyond.len() as u64);
            bytes.resize(bytes.len().next_multiple_of(2), 0);
            beyond.extend(bytes);
        }
    }
    let next = if is_last { 0 } else { at + length + beyond.len() as u64 };
    put(&mut out, next);
    out.extend(beyond);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resolutions_are_near_what_they_stand_for() {
        for spacing in [1.0, 0.5, 0.3, 1e-4, 2500.0, 1.0 / 3.0, 0.7267] {
            let [a, b] = resolution(spacing)[..] else { panic!() };
            assert!((b as f64 / a as f64 / spacing - 1.0).abs() < 1e-8, "{spacing} {a} {b}");
        }
    }
}
