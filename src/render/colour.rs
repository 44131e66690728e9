//! Colours: sRGB bytes outside, linear light inside.

use super::ColourMap;
use isospan_io::error::{Error, Result};

/// The colour of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Paint {
    /// One colour, as sRGB.
    Plain([u8; 3]),
    /// Its normals, seen from the camera: red to the right, green up, blue to the viewer.
    Normals,
    /// The values of the vertices, on the scale [`SEQUENTIAL`] from the first number to the second.
    Values([f32; 2]),
    /// The values of the vertices on a colour map, from the first number to the second; grey where
    /// there is no value.
    Map(ColourMap, [f32; 2]),
    /// As [`Paint::Map`], for planes. Light does not change these colours: they are those of the
    /// legend.
    Flat(ColourMap, [f32; 2]),
}

/// A scale from light to dark, for numbers from 0 on: sRGB at evenly spaced places.
pub const SEQUENTIAL: [[u8; 3]; 7] = [
    [0xf7, 0xf3, 0xe6],
    [0xf9, 0xdd, 0xa4],
    [0xf8, 0xb4, 0x62],
    [0xec, 0x7d, 0x46],
    [0xcf, 0x48, 0x4a],
    [0x96, 0x26, 0x54],
    [0x4d, 0x12, 0x4a],
];

/// The colour of a place on [`SEQUENTIAL`], 0 to 1, in linear light.
pub(super) fn scale_linear(place: f32) -> [f32; 3] {
    // A NaN is not above 0.
    let place = if place > 0.0 { place.min(1.0) } else { 0.0 };
    let at = place * (SEQUENTIAL.len() - 1) as f32;
    let n = (at as usize).min(SEQUENTIAL.len() - 2);
    let (a, b) = (linear(SEQUENTIAL[n]), linear(SEQUENTIAL[n + 1]));
    let t = at - n as f32;
    std::array::from_fn(|k| a[k] * (1.0 - t) + b[k] * t)
}

/// The colour of a place on [`SEQUENTIAL`], 0 to 1: what a legend shows.
pub fn scale_colour(place: f32) -> [u8; 3] {
    scale_linear(place).map(encode)
}

/// `#rrggbb`, with or without the `#`.
///
/// # Errors
/// [`Error::Usage`] for anything else.
pub fn parse_colour(text: &str) -> Result<[u8; 3]> {
    let digits = text.strip_prefix('#').unwrap_or(text);
    let all_hex = digits.len() == 6 && digits.bytes().all(|b| b.is_ascii_hexdigit());
    let number = all_hex.then(|| u32::from_str_radix(digits, 16).ok()).flatten();
    number
        .map(|n| [(n >> 16) as u8, (n >> 8) as u8, n as u8])
        .ok_or_else(|| Error::usage(format!("'{text}' is no colour: write #rrggbb, as in #d8cbb4")))
}

/// The light of an sRGB colour (IEC 61966-2-1).
pub(super) fn linear(colour: [u8; 3]) -> [f32; 3] {
    colour.map(|byte| {
        let c = f32::from(byte) / 255.0;
        if c <= 0.040_45 { c / 12.92 } else { libm::powf((c + 0.055) / 1.055, 2.4) }
    })
}

/// The sRGB byte of a light, 0 to 1.
pub(super) fn encode(light: f32) -> u8 {
    let l = light.clamp(0.0, 1.0);
    let c = if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * libm::powf(l, 1.0 / 2.4) - 0.055 };
    (c * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_comes_back_and_colours_are_parsed() {
        for byte in 0..=255u8 {
            assert_eq!(linear([byte; 3]).map(encode), [byte; 3]);
        }
        assert_eq!(parse_colour("#10ff0A").unwrap(), [16, 255, 10]);
        for bad in ["", "#12345", "red", "#1234567", "+12345"] {
            assert_eq!(parse_colour(bad).unwrap_err().exit_code(), 2, "{bad}");
        }
    }

    #[test]
    fn the_scale_darkens_steadily() {
        let lightness = |i: u16| {
            scale_linear(f32::from(i) / 100.0).iter().zip([0.21, 0.72, 0.07]).map(|(c, w)| c * w).sum::<f32>()
        };
        assert!((0..100).all(|i| lightness(i) > lightness(i + 1)));
        assert_eq!((scale_colour(-1.0), scale_colour(2.0)), (SEQUENTIAL[0], SEQUENTIAL[6]));
        assert_eq!(scale_colour(f32::NAN), SEQUENTIAL[0]);
    }
}
