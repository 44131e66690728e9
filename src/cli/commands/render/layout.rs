//! Where everything is on the canvas: panels, words below them, legends, scales.

use super::super::figure::canvas::{Canvas, drawable, ticks};
use super::super::text;
use super::{Args, Colours};
use isospan::render::{Image, scale_colour};
use isospan::volume::units::Unit;
use isospan::{Error, Result};

/// Pixels of a picture, at most.
const MOST_PIXELS: usize = 1 << 28;
/// Pixels of all frames of an animation, at most.
const MOST_FILM: usize = 1 << 32;

/// What is below the panels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parts {
    pub(super) panels: usize,
    pub(super) frames: usize,
    pub(super) captions: bool,
    /// Colours of isovalues, below each panel.
    pub(super) legends: bool,
    /// A bar of colours.
    pub(super) bar: bool,
    pub(super) scale_bar: bool,
}

pub(super) struct PanelLayout {
    columns: usize,
    panel: [usize; 2],
    /// Height of a line of words, and of the letters in it.
    line: usize,
    letters: f32,
    /// Height of a panel with the words below it.
    row: usize,
    has_captions: bool,
    /// Where the scale bar and the bar of colours begin.
    scale_bar_top: usize,
    bar_top: usize,
    pub(super) size: [usize; 2],
    ink: [u8; 3],
}

/// The colour of words on a background.
pub(super) fn ink([r, g, b, opacity]: [u8; 4]) -> [u8; 3] {
    let dark = opacity > 127 && 2 * u32::from(r) + 5 * u32::from(g) + u32::from(b) < 8 * 110;
    if dark { [235; 3] } else { [30; 3] }
}

impl PanelLayout {
    pub(super) fn new(args: &Args, parts: Parts) -> Result<Self> {
        let Parts { panels, frames, .. } = parts;
        let columns = args.columns.unwrap_or(panels.min(4)).clamp(1, panels.max(1));
        let panel = args.size.map(|s| s as usize);
        let letters = (panel[1] as f32 / 24.0).clamp(13.0, 48.0);
        let line = (letters * 2.0) as usize;
        let row = panel[1] + line * (usize::from(parts.captions) + usize::from(parts.legends));
        let scale_bar_top = panels.div_ceil(columns) * row;
        let bar_top = scale_bar_top + if parts.scale_bar { (letters * 2.4) as usize } else { 0 };
        let size = [columns * panel[0], bar_top + if parts.bar { (letters * 4.6) as usize } else { 0 }];
        let pixels = size[0].saturating_mul(size[1]);
        if pixels > MOST_PIXELS {
            return Err(Error::usage(format!("a picture of {} x {} pixels is too large", size[0], size[1])));
        }
        if frames > 1 && pixels.saturating_mul(frames) > MOST_FILM {
            return Err(Error::usage(format!(
                "{frames} frames of {} x {} pixels are too many: take fewer, or a smaller --size",
                size[0], size[1]
            )));
        }
        let ink = ink(args.background);
        let has_captions = parts.captions;
        Ok(Self { columns, panel, line, letters, row, has_captions, scale_bar_top, bar_top, size, ink })
    }

    /// Bytes of the canvas, and of its file.
    pub(super) fn bytes(&self) -> u64 {
        16 * (self.size[0] * self.size[1]) as u64
    }

    /// Whether panels have captions.
    pub(super) fn has_captions(&self) -> bool {
        self.has_captions
    }

    fn corner(&self, n: usize) -> [usize; 2] {
        [n % self.columns * self.panel[0], n / self.columns * self.row]
    }

    pub(super) fn put(&self, canvas: &mut Canvas, n: usize, image: &Image) {
        canvas.paste(image, self.corner(n));
    }

    /// Writes the caption of a panel, as large as fits.
    pub(super) fn caption(&self, canvas: &mut Canvas, n: usize, words: &str) {
        let [left, top] = self.corner(n);
        let fits = 0.96 * self.panel[0] as f32 / canvas.width(words, 1.0).max(0.01);
        let middle = left as f32 + self.panel[0] as f32 / 2.0;
        let baseline = (top + self.panel[1]) as f32 + 1.2 * self.letters;
        canvas.write(words, self.letters.min(fits), [middle, baseline], self.ink);
    }

    /// Which colour has which words, in a line below a panel.
    pub(super) fn legend(&self, canvas: &mut Canvas, n: usize, entries: &[([u8; 3], String)]) {
        if entries.is_empty() {
            return;
        }
        let [left, top] = self.corner(n);
        // A square of colour, a space, the words, and a wider space, in heights of a letter.
        let (square, space, gap) = (0.8, 0.35, 1.2);
        let width = |size: f32| {
            let words: f32 = entries.iter().map(|(_, words)| canvas.width(words, size)).sum();
            words + size * ((square + space + gap) * entries.len() as f32 - gap)
        };
        let letters = 0.9 * self.letters * (0.96 * self.panel[0] as f32 / width(0.9 * self.letters)).min(1.0);
        let captions = if self.has_captions { self.line } else { 0 };
        let baseline = (top + self.panel[1] + captions) as f32 + 1.2 * self.letters;
        let mut x = left as f32 + (self.panel[0] as f32 - width(letters)) / 2.0;
        for (colour, words) in entries {
            let side = (square * letters).round() as usize;
            let from = (baseline as usize).saturating_sub(side);
            canvas.fill([x.max(0.0) as usize, from, side, side], *colour);
            x += (square + space) * letters;
            let wide = canvas.width(words, letters);
            canvas.write(words, letters, [x + wide / 2.0, baseline], self.ink);
            x += wide + gap * letters;
        }
    }

    /// A bar of a round length; `pixel` is the length of a pixel in the world.
    pub(super) fn scale_bar(&self, canvas: &mut Canvas, pixel: f64, unit: Option<&Unit>) {
        let most = 0.3 * self.panel[0].min(self.size[0]) as f64;
        let power = libm::pow(10.0, libm::log10(most * pixel).floor());
        let length = [5.0, 2.0, 1.0].map(|m| m * power).into_iter().find(|l| l / pixel <= most);
        let length = length.unwrap_or(power);
        let wide = (length / pixel).round().max(1.0) as usize;
        let unit = unit.map_or("world units".into(), |unit| drawable(unit.as_str()));
        let words = format!("{} {unit}", text::number(length));
        let letters = 0.85 * self.letters;
        let (gap, written) = (0.6 * letters, canvas.width(&words, letters));
        let left = ((self.size[0] as f32 - wide as f32 - gap - written) / 2.0).max(0.0);
        let baseline = self.scale_bar_top as f32 + 1.5 * self.letters;
        let thick = ((0.22 * letters).round() as usize).max(2);
        let top = (baseline - 0.36 * letters) as usize - thick / 2;
        canvas.fill([left as usize, top, wide, thick], self.ink);
        let middle = left + wide as f32 + gap + written / 2.0;
        canvas.write(&words, letters, [middle, baseline], self.ink);
    }

    /// The colours of distances, with numbers.
    pub(super) fn distances(&self, canvas: &mut Canvas, end: f32, largest: f32, unit: Option<&Unit>) {
        let unit = drawable(&text::unit(unit));
        let title = format!("distance (largest {}{unit})", short(f64::from(largest)));
        let numbers = ticks(0.0, f64::from(end)).into_iter().map(|t| (t, short(t))).collect();
        self.bar(canvas, &title, [0.0, f64::from(end)], numbers, |share| scale_colour(share as f32));
    }

    /// The colours of the field, with numbers.
    pub(super) fn colours(&self, canvas: &mut Canvas, title: &str, colours: &Colours) {
        let range = colours.range;
        let number = |t: f64| (t, text::in_range(t, range).replace('-', "−"));
        let numbers = ticks(range[0], range[1]).into_iter().map(number).collect();
        self.bar(canvas, title, range, numbers, |share| colours.map.colour(share));
    }

    fn bar(
        &self,
        canvas: &mut Canvas,
        title: &str,
        [lo, hi]: [f64; 2],
        mut numbers: Vec<(f64, String)>,
        colour: impl Fn(f64) -> [u8; 3],
    ) {
        let length = (self.size[0] as f32 * 0.6).min(1000.0).round().max(1.0) as usize;
        let (left, letters) = ((self.size[0] - length) / 2, self.letters * 0.85);
        let (top, height) = (self.bar_top + (1.6 * self.letters) as usize, (0.7 * self.letters) as usize);
        for x in 0..length {
            canvas.fill([left + x, top, 1, height], colour((x as f64 + 0.5) / length as f64));
        }
        let fits = 0.96 * self.size[0] as f32 / canvas.width(title, 1.0).max(0.01);
        let middle = self.size[0] as f32 / 2.0;
        canvas.write(title, letters.min(fits), [middle, top as f32 - 0.45 * self.letters], self.ink);
        // Numbers that would touch are thinned out.
        let wide =
            |all: &[(f64, String)]| all.iter().map(|(_, t)| canvas.width(t, letters) + letters).sum::<f32>();
        while numbers.len() > 2 && wide(&numbers) > length as f32 {
            numbers = numbers.into_iter().step_by(2).collect();
        }
        for (tick, words) in numbers {
            let at = if hi > lo { ((tick - lo) / (hi - lo)).clamp(0.0, 1.0) } else { 0.0 };
            let x = left + (at * (length - 1) as f64).round() as usize;
            canvas.fill([x, top + height, 1, (0.25 * self.letters) as usize], self.ink);
            let baseline = (top + height) as f32 + 1.25 * self.letters;
            canvas.write(&words, letters, [x as f32, baseline], self.ink);
        }
    }
}

/// A number of a scale.
fn short(v: f64) -> String {
    text::value(text::figures(v, 3)).replace('-', "−")
}
