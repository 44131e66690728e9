//! Writes pictures one after another: a PNG, an animated PNG, or a GIF.

use super::super::figure::canvas::Canvas;
use isospan::{Error, Result};
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;

/// What a file is, by the ending of its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FilmFormat {
    Png,
    /// A PNG by the name of animated ones.
    Apng,
    Gif,
}

/// Sides of a GIF, at most: the format has 16 bits for them.
const GIF_SIDE: usize = u16::MAX as usize;
/// Pixels that the quantizer of colours looks at: one of so many.
const GIF_SPEED: i32 = 10;

impl FilmFormat {
    pub(super) fn of(file: &Path) -> Result<Self> {
        let ending = file.extension().unwrap_or_default().to_ascii_lowercase();
        match ending.to_str() {
            Some("png") => Ok(Self::Png),
            Some("apng") => Ok(Self::Apng),
            Some("gif") => Ok(Self::Gif),
            _ => Err(Error::usage(format!(
                "{}: a picture's name ends in .png, an animation's in .gif, .apng or .png",
                file.display()
            ))),
        }
    }

    /// Whether a name with this ending says that there are frames.
    pub(super) fn is_of_frames(self) -> bool {
        self != Self::Png
    }
}

/// How frames follow each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    pub(super) frames: u32,
    /// Frames in a second, 0.1 to 50.
    pub(super) rate: f64,
}

/// A file of frames.
pub(super) struct Film<'a> {
    file: &'a Path,
    opaque: bool,
    encoder: Encoder<'a>,
}

enum Encoder<'a> {
    Png(png::Writer<BufWriter<&'a mut File>>),
    Gif { encoder: gif::Encoder<BufWriter<&'a mut File>>, delay: u16 },
}

impl<'a> Film<'a> {
    /// Begins a file; its frames are all opaque, or may have opacities.
    pub(super) fn begin(
        file: &'a Path,
        out: &'a mut File,
        kind: FilmFormat,
        [width, height]: [usize; 2],
        pace: Pace,
        opaque: bool,
    ) -> Result<Self> {
        let failed = |e: std::io::Error| Error::io("write", file, e);
        let out = BufWriter::new(out);
        let encoder = if kind == FilmFormat::Gif {
            if width.max(height) > GIF_SIDE {
                let text =
                    format!("a GIF is at most {GIF_SIDE} pixels wide and high, not {width} x {height}");
                return Err(Error::usage(text));
            }
            let encoder = gif::Encoder::new(out, width as u16, height as u16, &[]);
            let mut encoder = encoder.map_err(|e| failed(gif_error(e)))?;
            encoder.set_repeat(gif::Repeat::Infinite).map_err(|e| failed(gif_error(e)))?;
            Encoder::Gif { encoder, delay: (100.0 / pace.rate).round() as u16 }
        } else {
            let mut encoder = png::Encoder::new(out, width as u32, height as u32);
            encoder.set_color(if opaque { png::ColorType::Rgb } else { png::ColorType::Rgba });
            encoder.set_compression(png::Compression::High);
            let milliseconds = (1000.0 / pace.rate).round() as u16;
            let begun = encoder
                .set_animated(pace.frames, 0)
                .and_then(|()| encoder.set_frame_delay(milliseconds, 1000))
                .and_then(|()| encoder.write_header());
            Encoder::Png(begun.map_err(|e| failed(e.into()))?)
        };
        Ok(Self { file, opaque, encoder })
    }

    pub(super) fn add(&mut self, canvas: &Canvas) -> Result<()> {
        let written = match &mut self.encoder {
            Encoder::Png(writer) if self.opaque => {
                writer.write_image_data(&colours(canvas)).map_err(std::io::Error::from)
            }
            Encoder::Png(writer) => {
                writer.write_image_data(canvas.pixels.as_flattened()).map_err(std::io::Error::from)
            }
            Encoder::Gif { encoder, delay } => {
                let [width, height] = canvas.size.map(|s| s as u16);
                let mut frame = if self.opaque {
                    gif::Frame::from_rgb_speed(width, height, &colours(canvas), GIF_SPEED)
                } else {
                    // A pixel of a GIF is opaque or not there.
                    let whole = |p: &[u8; 4]| if p[3] < 128 { [0; 4] } else { [p[0], p[1], p[2], 255] };
                    let mut pixels: Vec<[u8; 4]> = canvas.pixels.iter().map(whole).collect();
                    gif::Frame::from_rgba_speed(width, height, pixels.as_flattened_mut(), GIF_SPEED)
                };
                frame.delay = *delay;
                frame.dispose =
                    if self.opaque { gif::DisposalMethod::Keep } else { gif::DisposalMethod::Background };
                encoder.write_frame(&frame).map_err(gif_error)
            }
        };
        written.map_err(|e| Error::io("write", self.file, e))
    }

    /// Ends the file; all frames have been added.
    pub(super) fn end(self) -> Result<()> {
        let ended = match self.encoder {
            Encoder::Png(writer) => writer.finish().map_err(std::io::Error::from),
            Encoder::Gif { encoder, .. } => {
                encoder.into_inner().map_err(gif_error).and_then(|mut out| out.flush())
            }
        };
        ended.map_err(|e| Error::io("write", self.file, e))
    }
}

fn gif_error(e: gif::EncodingError) -> std::io::Error {
    match e {
        gif::EncodingError::Io(e) => e,
        other => std::io::Error::other(other),
    }
}

/// Red, green and blue of all pixels.
fn colours(canvas: &Canvas) -> Vec<u8> {
    canvas.pixels.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect()
}
