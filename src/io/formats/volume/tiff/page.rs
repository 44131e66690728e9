//! One page of a TIFF file: its contents, and the decoding of its strips or tiles.

use super::ifd::{Tiff, tag};
use crate::error::{Error, Result};
use crate::volume::ScalarType;
use crate::volume::strided::swap_bytes;
use std::io::Read;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Lzw,
    Deflate,
    PackBits,
    Zstd,
}

impl Compression {
    fn of(code: u64) -> std::result::Result<Self, &'static str> {
        Err(match code {
            1 => return Ok(Self::None),
            5 => return Ok(Self::Lzw),
            8 | 32946 => return Ok(Self::Deflate),
            32773 => return Ok(Self::PackBits),
            50000 => return Ok(Self::Zstd),
            2..=4 => "fax (CCITT)",
            6 | 7 => "JPEG",
            34712 => "JPEG 2000",
            34925 => "LZMA",
            50001 => "WebP",
            50002 | 52546 => "JPEG XL",
            _ => "an unknown compression",
        })
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::None => "raw",
            Self::Lzw => "LZW",
            Self::Deflate => "deflate",
            Self::PackBits => "PackBits",
            Self::Zstd => "zstd",
        }
    }

    /// The most bytes that one compressed byte can give: a larger claim is refused before memory is
    /// reserved.
    fn best_ratio(self) -> u64 {
        match self {
            Self::None => 1,
            // The longest string of a table of 4096 strings, from a code of at least 9 bits.
            Self::Lzw => 4096,
            Self::Deflate => 1032,
            Self::PackBits => 64,
            // A block of 128 KiB of one byte has four bytes.
            Self::Zstd => 1 << 15,
        }
    }
}

/// What all pages of a volume have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) dims: [u64; 2],
    pub(super) scalar: ScalarType,
}

impl std::fmt::Display for Shape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} x {} samples of {}", self.dims[0], self.dims[1], self.scalar.name())
    }
}

/// A page, cut into strips (as wide as the page) or tiles.
#[derive(Clone, Debug)]
pub(super) struct Page {
    pub(super) shape: Shape,
    pub(super) compression: Compression,
    predictor: u64,
    tiled: bool,
    /// Samples of a strip or tile along x and y.
    part: [u64; 2],
    offsets: Vec<u64>,
    counts: Vec<u64>,
    /// A small picture of another page, or its mask.
    pub(super) secondary: bool,
    pub(super) description: String,
    /// Samples a unit along x and y.
    pub(super) resolution: Option<[f64; 2]>,
}

impl Page {
    pub(super) fn parse(tiff: &Tiff, at: u64) -> Result<Self> {
        let ifd = tiff.ifd(at)?;
        // Thumbnails may be of any kind: nothing else of them is read.
        let secondary = ifd.one(tag::SUBFILE_TYPE, Some(0))? & 5 != 0;
        let dims = [ifd.one(tag::WIDTH, None)?, ifd.one(tag::LENGTH, None)?];
        if dims.iter().any(|d| !(1..=1 << 31).contains(d)) {
            return Err(ifd.wrong("size", "1 to 2^31 samples", format!("{} x {}", dims[0], dims[1])));
        }
        let scalar = if secondary { ScalarType::U8 } else { scalar(&ifd)? };
        let compression = Compression::of(ifd.one(tag::COMPRESSION, Some(1))?);
        let compression = match compression {
            Ok(known) => known,
            Err(_) if secondary => Compression::None,
            Err(name) => {
                return Err(ifd
                    .wrong("compression", "none, LZW, deflate, PackBits or zstd", name)
                    .with_help("write it again without compression, or with one of these"));
            }
        };
        let tiled = ifd.numbers(tag::TILE_OFFSETS)?.is_some();
        let part = if tiled {
            [ifd.one(tag::TILE_WIDTH, None)?, ifd.one(tag::TILE_LENGTH, None)?]
        } else {
            [dims[0], ifd.one(tag::ROWS_PER_STRIP, Some(dims[1]))?.min(dims[1])]
        };
        // Below 2^40 samples no product of what follows overflows.
        if part.contains(&0) || part[0].checked_mul(part[1]).is_none_or(|n| n > 1 << 40) {
            return Err(ifd.wrong(
                "strip or tile size",
                "1 to 2^40 samples",
                format!("{} x {}", part[0], part[1]),
            ));
        }
        let tags = if tiled {
            (tag::TILE_OFFSETS, tag::TILE_COUNTS)
        } else {
            (tag::STRIP_OFFSETS, tag::STRIP_COUNTS)
        };
        let resolution = ifd.rational(tag::X_RESOLUTION)?.zip(ifd.rational(tag::Y_RESOLUTION)?);
        let mut page = Self {
            shape: Shape { dims, scalar },
            compression,
            predictor: ifd.one(tag::PREDICTOR, Some(1))?,
            tiled,
            part,
            offsets: ifd.numbers(tags.0)?.unwrap_or_default(),
            counts: ifd.numbers(tags.1)?.unwrap_or_default(),
            secondary,
            description: ifd.text(tag::DESCRIPTION)?,
            resolution: resolution.map(|(x, y)| [x, y]),
        };
        if !secondary {
            page.check(&ifd)?;
        }
        Ok(page)
    }

    /// Strips or tiles along x and y.
    fn parts(&self) -> [u64; 2] {
        std::array::from_fn(|a| self.shape.dims[a].div_ceil(self.part[a]))
    }

    fn check(&mut self, ifd: &super::ifd::Ifd<'_>) -> Result<()> {
        let [across, down] = self.parts();
        let count = across * down;
        let row = self.part[0] * self.shape.scalar.bytes() as u64;
        if self.counts.is_empty()
            && self.compression == Compression::None
            && self.offsets.len() as u64 == count
        {
            // Old writers leave the lengths of uncompressed strips out.
            self.counts = (0..down).map(|y| row * self.rows_of(y)).collect();
        }
        if self.offsets.len() as u64 != count || self.counts.len() as u64 != count {
            let got = format!("{} places and {} lengths", self.offsets.len(), self.counts.len());
            return Err(ifd.wrong("strips or tiles", &format!("{count} of them"), got));
        }
        let float = self.shape.scalar.is_float();
        if !(self.predictor <= 2 || (self.predictor == 3 && float)) || self.predictor == 0 {
            let expected = "1 (none), 2 (horizontal) or, of floats, 3";
            return Err(ifd.wrong("predictor", expected, self.predictor.to_string()));
        }
        Ok(())
    }

    /// Rows stored in the strips or tiles of part-row `y`: tiles are padded, the last strip is not.
    fn rows_of(&self, y: u64) -> u64 {
        if self.tiled { self.part[1] } else { self.part[1].min(self.shape.dims[1] - y * self.part[1]) }
    }

    /// Rows of a row of strips or tiles.
    pub(super) fn part_rows(&self) -> u64 {
        self.part[1]
    }

    /// Bytes of a strip or tile.
    pub(super) fn part_bytes(&self) -> u64 {
        self.part[0] * self.part[1] * self.shape.scalar.bytes() as u64
    }

    /// Where the samples start, if they lie in the file as they are, row after row.
    pub(super) fn in_place(&self) -> Option<u64> {
        let row = self.shape.dims[0] * self.shape.scalar.bytes() as u64;
        let mut next = *self.offsets.first()?;
        let first = next;
        if self.tiled || self.compression != Compression::None || self.predictor != 1 {
            return None;
        }
        for (y, (&at, &count)) in self.offsets.iter().zip(&self.counts).enumerate() {
            let bytes = row * self.rows_of(y as u64);
            // A single strip may claim more than it has: what follows the samples is not read.
            if at != next || count < bytes || (count > bytes && y + 1 < self.offsets.len()) {
                return None;
            }
            next = at.checked_add(bytes)?;
        }
        Some(first)
    }

    /// Decodes the strips or tiles of the rows from `y0` to `y1`: little-endian samples, as wide as
    /// the page, appended to `out`. Each is decoded once where these are multiples of
    /// [`Page::part_rows`].
    pub(super) fn rows(&self, tiff: &Tiff, y0: u64, y1: u64, out: &mut Vec<u8>) -> Result<()> {
        let size = self.shape.scalar.bytes();
        let width = self.shape.dims[0] as usize * size;
        let mut part = vec![];
        let [across, _] = self.parts();
        for y in y0 / self.part[1]..y1.div_ceil(self.part[1]) {
            let part_y = y * self.part[1];
            let before = y0.saturating_sub(part_y) as usize;
            let rows = (y1.min(part_y + self.part[1]) - part_y) as usize - before;
            let start = out.len();
            if across > 1 {
                // Memory as its tiles arrive is not possible: they are interleaved. Each has been
                // claimed by a length.
                self.check_length(tiff, y * across, across)?;
                out.resize(start + rows * width, 0);
            }
            for x in 0..across {
                self.decode(tiff, (y * across + x) as usize, self.rows_of(y), &mut part)?;
                let stored = self.part[0] as usize * size;
                let left = (x * self.part[0]) as usize * size;
                let used = stored.min(width - left);
                let stored_rows = part.chunks_exact(stored).skip(before);
                if across == 1 {
                    stored_rows.take(rows).for_each(|r| out.extend_from_slice(&r[..used]));
                } else {
                    let lines = out[start..].chunks_exact_mut(width).zip(stored_rows);
                    lines.for_each(|(to, from)| to[left..left + used].copy_from_slice(&from[..used]));
                }
            }
        }
        Ok(())
    }

    /// Refuses strips or tiles that are too short for what they should hold.
    fn check_length(&self, tiff: &Tiff, first: u64, count: u64) -> Result<()> {
        let parts = first as usize..(first + count) as usize;
        let stored = self.counts[parts].iter().fold(0u64, |n, &c| n.saturating_add(c));
        let stored = stored.min(tiff.source.len());
        let needed = self.part[0] * self.part[1].min(self.shape.dims[1]) * self.shape.scalar.bytes() as u64;
        let most = stored.saturating_mul(self.compression.best_ratio());
        if needed.saturating_mul(count) <= most.max(1) {
            return Ok(());
        }
        let at = format!("strip or tile {first} at byte {}", self.offsets[first as usize]);
        let expected = format!("{} samples in {}", needed.saturating_mul(count), self.compression.name());
        Err(tiff.wrong(&at, &expected, format!("{stored} bytes, too few for that")))
    }

    /// Decodes one strip or tile to little-endian samples.
    fn decode(&self, tiff: &Tiff, number: usize, rows: u64, out: &mut Vec<u8>) -> Result<()> {
        let size = self.shape.scalar.bytes();
        let row = self.part[0] as usize * size;
        let needed = rows as usize * row;
        let (at, count) = (self.offsets[number], self.counts[number]);
        let mut buffer = vec![];
        let stored = tiff.source.view(at..at.saturating_add(count), &mut buffer)?;
        let damaged = |got: String| {
            let expected = format!("{needed} bytes of good {} data", self.compression.name());
            tiff.wrong(&format!("strip or tile {number} at byte {at}"), &expected, got)
                .with_help("the file is damaged or cut short; fetch it again")
        };
        if (needed as u64) > (stored.len() as u64).saturating_mul(self.compression.best_ratio()) {
            return Err(damaged(format!("{count} bytes, too few for that")));
        }
        out.clear();
        let decoded = decompress(self.compression, stored, needed, out);
        tiff.source.check()?;
        decoded.map_err(damaged)?;
        if out.len() != needed {
            return Err(damaged(format!("{} bytes", out.len())));
        }
        match self.predictor {
            3 => out.chunks_exact_mut(row).for_each(|r| undo_float_predictor(r, size)),
            predictor => {
                if tiff.big_endian {
                    swap_bytes(out, size);
                }
                if predictor == 2 {
                    out.chunks_exact_mut(row).for_each(|r| undo_predictor(r, size));
                }
            }
        }
        Ok(())
    }
}

fn scalar(ifd: &super::ifd::Ifd<'_>) -> Result<ScalarType> {
    let photometric = match ifd.one(tag::PHOTOMETRIC, Some(1))? {
        // WhiteIsZero says how to show the samples, not what they measure.
        0 | 1 => None,
        2 => Some("RGB"),
        3 => Some("a palette"),
        4 => Some("a mask"),
        5 => Some("CMYK"),
        6 => Some("YCbCr"),
        8..=10 => Some("CIE L*a*b*"),
        32803 => Some("a colour filter array"),
        34892 => Some("linear raw"),
        _ => Some("an unknown one"),
    };
    let colours = |e: Error| e.with_help("only grey values are read; convert the slices to grey first");
    if let Some(name) = photometric {
        return Err(colours(ifd.wrong("photometric interpretation", "grey values", name)));
    }
    let samples = ifd.one(tag::SAMPLES, Some(1))?;
    if samples != 1 {
        return Err(colours(ifd.wrong("samples a pixel", "1", samples.to_string())));
    }
    if ifd.one(tag::FILL_ORDER, Some(1))? != 1 {
        return Err(ifd.wrong("fill order", "1", "2: bits in reverse"));
    }
    let (bits, format) = (ifd.one(tag::BITS, Some(1))?, ifd.one(tag::SAMPLE_FORMAT, Some(1))?);
    Ok(match (format, bits) {
        // 4 is "undefined".
        (1 | 4, 8) => ScalarType::U8,
        (1 | 4, 16) => ScalarType::U16,
        (1 | 4, 32) => ScalarType::U32,
        (1 | 4, 64) => ScalarType::U64,
        (2, 8) => ScalarType::I8,
        (2, 16) => ScalarType::I16,
        (2, 32) => ScalarType::I32,
        (2, 64) => ScalarType::I64,
        (3, 16) => ScalarType::F16,
        (3, 32) => ScalarType::F32,
        (3, 64) => ScalarType::F64,
        _ => {
            let got = format!("{bits} bits in sample format {format}");
            return Err(ifd.wrong("sample type", "8, 16, 32 or 64 bits, integers or floats", got));
        }
    })
}

/// Decodes up to `needed` bytes; an error is the reason, in words.
fn decompress(
    how: Compression,
    stored: &[u8],
    needed: usize,
    out: &mut Vec<u8>,
) -> std::result::Result<(), String> {
    match how {
        Compression::None => out.extend_from_slice(&stored[..needed.min(stored.len())]),
        Compression::Lzw => {
            out.resize(needed, 0);
            let mut lzw = weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
            let (mut read, mut written) = (0, 0);
            while written < needed {
                let step = lzw.decode_bytes(&stored[read..], &mut out[written..]);
                read += step.consumed_in;
                written += step.consumed_out;
                match step.status {
                    Ok(weezl::LzwStatus::Ok) if step.consumed_in + step.consumed_out > 0 => {}
                    Ok(_) => break,
                    Err(e) => return Err(e.to_string()),
                }
            }
            out.truncate(written);
        }
        Compression::Deflate => {
            let decoded = flate2::bufread::ZlibDecoder::new(stored);
            decoded.take(needed as u64).read_to_end(out).map_err(|e| e.to_string())?;
        }
        Compression::Zstd => {
            let decoded = zstd::stream::read::Decoder::with_buffer(stored).map_err(|e| e.to_string())?;
            decoded.take(needed as u64).read_to_end(out).map_err(|e| e.to_string())?;
        }
        Compression::PackBits => unpack_bits(stored, needed, out),
    }
    Ok(())
}

/// Apple's run lengths: n < 128 and n + 1 bytes as they are; n > 128 and a byte that stands for 257
/// − n; 128 is nothing.
fn unpack_bits(stored: &[u8], needed: usize, out: &mut Vec<u8>) {
    let mut rest = stored;
    while let [n, tail @ ..] = rest
        && out.len() < needed
    {
        let room = needed - out.len();
        rest = match (*n, tail) {
            (128, _) => tail,
            (n @ 129.., [byte, tail @ ..]) => {
                out.resize(out.len() + room.min(257 - usize::from(n)), *byte);
                tail
            }
            (129.., []) => return,
            (n, _) => {
                let run = (usize::from(n) + 1).min(tail.len());
                out.extend_from_slice(&tail[..run.min(room)]);
                &tail[run..]
            }
        };
    }
}

/// Predictor 2: each sample was stored as its difference to the one before it in the row.
fn undo_predictor(row: &mut [u8], size: usize) {
    macro_rules! add {
        ($t:ty) => {{
            let mut sum: $t = 0;
            for sample in row.chunks_exact_mut(size) {
                sum = sum.wrapping_add(<$t>::from_le_bytes((&*sample).try_into().expect("exact chunks")));
                sample.copy_from_slice(&sum.to_le_bytes());
            }
        }};
    }
    match size {
        1 => add!(u8),
        2 => add!(u16),
        4 => add!(u32),
        _ => add!(u64),
    }
}

/// Predictor 3 (Adobe's technical note 3): the row's most significant bytes first, then the next
/// ones …, all of them as differences of bytes.
fn undo_float_predictor(row: &mut [u8], size: usize) {
    let mut sum = 0u8;
    for byte in row.iter_mut() {
        sum = sum.wrapping_add(*byte);
        *byte = sum;
    }
    let (planes, count) = (row.to_vec(), row.len() / size);
    for (i, sample) in row.chunks_exact_mut(size).enumerate() {
        for (b, byte) in sample.iter_mut().rev().enumerate() {
            *byte = planes[b * count + i];
        }
    }
}
