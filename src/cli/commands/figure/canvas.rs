//! A picture with words on it: panels, captions, a scale of colours.

use super::FONT;
use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use isospan::{Error, Result};

/// Words that were not typed: what the font lacks is no reason to fail, and is "_".
pub(crate) fn drawable(text: &str) -> String {
    let font = FontRef::try_from_slice(FONT).expect("the font is part of the program, and sound");
    text.chars().map(|c| if font.glyph_id(c).0 == 0 { '_' } else { c }).collect()
}

/// Pixels of red, green, blue, opacity, row by row from the top.
pub(crate) struct Canvas {
    pub(crate) size: [usize; 2],
    pub(crate) pixels: Vec<[u8; 4]>,
    font: FontRef<'static>,
}

impl Canvas {
    /// An even one.
    pub(crate) fn new(size: [usize; 2], colour: [u8; 4]) -> Self {
        let font = FontRef::try_from_slice(FONT).expect("the font is part of the program, and sound");
        Self { size, pixels: vec![colour; size[0] * size[1]], font }
    }

    /// Refuses a text with letters that the font does not have.
    pub(crate) fn check(&self, text: &str) -> Result<()> {
        match text.chars().find(|&c| self.font.glyph_id(c).0 == 0) {
            None => Ok(()),
            Some(c) => Err(Error::usage(format!(
                "'{text}': the program's font has no '{}'; write ASCII",
                c.escape_debug()
            ))),
        }
    }

    /// Copies a picture to a place that holds it.
    pub(crate) fn paste(&mut self, picture: &isospan::render::Image, [left, top]: [usize; 2]) {
        let [width, height] = picture.size.map(|s| s as usize);
        for y in 0..height {
            let to = (top + y) * self.size[0] + left;
            self.pixels[to..to + width].copy_from_slice(&picture.pixels[y * width..(y + 1) * width]);
        }
    }

    /// Fills a box: left, top, width, height; the part of it that lies on the canvas.
    pub(crate) fn fill(&mut self, [left, top, width, height]: [usize; 4], colour: [u8; 3]) {
        let [r, g, b] = colour;
        for y in top..(top + height).min(self.size[1]) {
            let row = y * self.size[0];
            let end = (left + width).min(self.size[0]);
            self.pixels[row + left.min(end)..row + end].fill([r, g, b, 255]);
        }
    }

    /// Pixels from the start of a text to its end.
    pub(crate) fn width(&self, text: &str, size: f32) -> f32 {
        let font = self.font.as_scaled(PxScale::from(size));
        text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum()
    }

    /// Writes a text whose letters stand on `baseline`, its middle at `middle`.
    pub(crate) fn write(&mut self, text: &str, size: f32, [middle, baseline]: [f32; 2], ink: [u8; 3]) {
        let mut x = middle - self.width(text, size) / 2.0;
        let font = self.font.clone();
        let scaled = font.as_scaled(PxScale::from(size));
        for c in text.chars() {
            let id = scaled.glyph_id(c);
            if let Some(glyph) = font.outline_glyph(id.with_scale_and_position(size, point(x, baseline))) {
                let corner = glyph.px_bounds().min;
                glyph.draw(|gx, gy, coverage| {
                    self.blend(
                        corner.x as i64 + i64::from(gx),
                        corner.y as i64 + i64::from(gy),
                        coverage,
                        ink,
                    );
                });
            }
            x += scaled.h_advance(id);
        }
    }

    fn blend(&mut self, x: i64, y: i64, coverage: f32, ink: [u8; 3]) {
        let inside = |v: i64, most: usize| usize::try_from(v).ok().filter(|v| *v < most);
        let (Some(x), Some(y)) = (inside(x, self.size[0]), inside(y, self.size[1])) else { return };
        let pixel = &mut self.pixels[y * self.size[0] + x];
        let (cover, below) = (coverage.clamp(0.0, 1.0), f32::from(pixel[3]) / 255.0);
        let opacity = cover + below * (1.0 - cover);
        if opacity > 0.0 {
            for k in 0..3 {
                let mixed = f32::from(ink[k]) * cover + f32::from(pixel[k]) * below * (1.0 - cover);
                pixel[k] = (mixed / opacity).round() as u8;
            }
            pixel[3] = (opacity * 255.0).round() as u8;
        }
    }

    /// As a PNG file's bytes; without opacity where all is opaque.
    pub(crate) fn png(&self) -> Vec<u8> {
        let opaque = self.pixels.iter().all(|p| p[3] == 255);
        let data: Vec<u8> = if opaque {
            self.pixels.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect()
        } else {
            self.pixels.as_flattened().to_vec()
        };
        let mut out = vec![];
        let mut encoder = png::Encoder::new(&mut out, self.size[0] as u32, self.size[1] as u32);
        encoder.set_color(if opaque { png::ColorType::Rgb } else { png::ColorType::Rgba });
        encoder.set_compression(png::Compression::High);
        let written = encoder.write_header().and_then(|mut w| w.write_image_data(&data));
        written.expect("encoding into memory cannot fail");
        out
    }
}

/// Round numbers from `lo` to `hi`, four to nine of them.
pub(crate) fn ticks(lo: f64, hi: f64) -> Vec<f64> {
    if !(hi > lo && (hi - lo).is_finite()) {
        return vec![lo];
    }
    let rough = (hi - lo) / 5.0;
    let power = libm::pow(10.0, libm::log10(rough).floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough * 0.999).unwrap_or(power);
    let first = (lo / step).ceil() as i64;
    (first..).map(|n| n as f64 * step).take_while(|v| *v <= hi + step * 1e-9).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        let near = |a: Vec<f64>, b: &[f64]| {
            assert!(a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-9), "{a:?}");
        };
        near(ticks(0.0, 1.0), &[0.0, 0.2, 0.4, 0.6, 0.8, 1.0]);
        near(ticks(0.0, 0.37), &[0.0, 0.1, 0.2, 0.3]);
        near(ticks(-3.0, 4.0), &[-2.0, 0.0, 2.0, 4.0]);
        near(ticks(2.0, 2.0), &[2.0]);
    }

    #[test]
    fn letters_are_ink_where_they_should_be() {
        let mut canvas = Canvas::new([200, 40], [255, 255, 255, 0]);
        canvas.write("Ill", 24.0, [100.0, 30.0], [10, 20, 30]);
        let inked: Vec<usize> =
            (0..200 * 40).filter(|&i| canvas.pixels[i][3] > 200).map(|i| i % 200).collect();
        assert!(inked.len() > 50 && inked.iter().all(|x| (80..120).contains(x)));
        assert!(canvas.pixels.contains(&[10, 20, 30, 255]));
        assert!(canvas.check("1/8: RMS 0.3").is_ok() && canvas.check("雪").is_err());
        // Off the canvas is no error.
        canvas.write("far", 24.0, [195.0, 2.0], [0; 3]);
        assert_eq!(&canvas.png()[1..4], b"PNG");
    }
}
