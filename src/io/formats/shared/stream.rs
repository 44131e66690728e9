//! Samples that must be read front to back: compressed ones ([`ByteSlabs`]) and text
//! ([`TextSlabs`]).
//!
//! Memory: one slab and the decoder's window. A header may claim any size, so its claim alone
//! allocates nothing: a compressed stream must be long enough to hold the claimed samples at
//! deflate's best possible ratio, a text must have at least two bytes a sample, and a slab grows as
//! its bytes arrive.

use super::codec::gzip;
use crate::bytes::ByteSource;
use crate::error::{Error, Place, Result};
use crate::grid::IndexBox;
use crate::volume::slabs::SlabWalk;
use crate::volume::strided::swap_bytes;
use crate::volume::{ScalarType, SlabStream, VolumeInfo};
use flate2::CrcReader;
use flate2::bufread::{DeflateDecoder, ZlibDecoder};
use std::io::{self, BufRead, BufReader, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How a range of a file is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Codec {
    /// RFC 1952, one or several members, and zeros behind them.
    Gzip,
    /// RFC 1950.
    Zlib,
    /// RFC 1951, without header and checksum: a member of a zip file, whose directory has the
    /// CRC-32.
    Deflate {
        /// The checksum of the decoded bytes.
        crc32: u32,
    },
    /// Runs of AmiraMesh: a byte below 128 repeats the one that follows so often, another one is
    /// followed by that many bytes, less 128, as they are. A byte of 0 ends the runs, as Amira
    /// writes it; it may be missing.
    ByteRuns,
}

impl Codec {
    /// A reader of the decoded bytes of a range of a file.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the range does not lie within the file.
    pub(crate) fn reader(self, source: &Arc<ByteSource>, range: Range<u64>) -> Result<Box<dyn Read + Send>> {
        let stored = BufReader::with_capacity(1 << 16, source.reader(range)?);
        Ok(match self {
            Self::Gzip => Box::new(gzip::Members::new(stored)),
            Self::Zlib => Box::new(ZlibDecoder::new(stored)),
            Self::Deflate { crc32 } => {
                Box::new(Checked { decoded: CrcReader::new(DeflateDecoder::new(stored)), crc32 })
            }
            Self::ByteRuns => Box::new(ByteRuns { stored, left: 0, repeated: None, is_over: false }),
        })
    }

    fn name(self) -> &'static str {
        match self {
            Self::Gzip => "gzip",
            Self::Zlib => "zlib",
            Self::Deflate { .. } => "deflate",
            Self::ByteRuns => "run-length",
        }
    }
}

/// Decodes [`Codec::ByteRuns`].
struct ByteRuns<R> {
    stored: R,
    /// Bytes left of a run, and the byte that it repeats, if it does.
    left: usize,
    repeated: Option<u8>,
    /// Whether the byte that ends the runs was there.
    is_over: bool,
}

impl<R: BufRead> ByteRuns<R> {
    fn byte(&mut self) -> io::Result<Option<u8>> {
        let byte = self.stored.fill_buf()?.first().copied();
        self.stored.consume(usize::from(byte.is_some()));
        Ok(byte)
    }
}

impl<R: BufRead> Read for ByteRuns<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        while self.left == 0 && !out.is_empty() && !self.is_over {
            let Some(count) = self.byte()? else { return Ok(0) };
            self.is_over = count == 0;
            if self.is_over {
                return Ok(0);
            }
            self.left = usize::from(count & 127);
            self.repeated = None;
            if count < 128 {
                self.repeated = Some(self.byte()?.ok_or(io::ErrorKind::UnexpectedEof)?);
            }
        }
        let n = out.len().min(self.left);
        match self.repeated {
            Some(byte) => out[..n].fill(byte),
            None => self.stored.read_exact(&mut out[..n])?,
        }
        self.left -= n;
        Ok(n)
    }
}

/// A reader whose end is an error when the CRC-32 of all its bytes is not the one expected.
struct Checked<R> {
    decoded: CrcReader<R>,
    crc32: u32,
}

impl<R: BufRead> Read for Checked<DeflateDecoder<R>> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let n = self.decoded.read(out)?;
        if n == 0 && !out.is_empty() && self.decoded.crc().sum() != self.crc32 {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "another CRC-32 than the file's directory says",
            ));
        }
        Ok(n)
    }
}

/// What may follow the last sample of a compressed stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tail {
    /// Nothing: more bytes mean a wrong header.
    Nothing,
    /// Anything: other fields, which are not read.
    Ignored,
    /// Anything, read for the checksum at its end.
    Checked,
}

/// Samples from a compressed range of a file.
pub(crate) struct ByteSlabs {
    info: VolumeInfo,
    file: PathBuf,
    codec: Codec,
    decoded: Box<dyn Read + Send>,
    big_endian: bool,
    tail: Tail,
    walk: SlabWalk,
    /// Decoded bytes so far, those skipped included: where an error is.
    at: u64,
    /// Bytes that are skipped when the first slab is asked for.
    before: u64,
}

/// The most bytes that are skipped, and so read, when a stream is opened. Many files are opened
/// only for what their headers say, and their samples are not read.
const SKIPPED_AT_ONCE: u64 = 1 << 16;

impl ByteSlabs {
    /// The samples that follow the first `skip` decoded bytes of a compressed range.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the range is not in the file, cannot hold so many samples, or ends
    /// before `skip`, if that is no more than a header; otherwise reading gives that error.
    pub(crate) fn new(
        info: VolumeInfo,
        source: &Arc<ByteSource>,
        range: Range<u64>,
        codec: Codec,
        skip: u64,
        big_endian: bool,
        tail: Tail,
    ) -> Result<Self> {
        let size = info.field.scalar.bytes();
        let needed = sample_bytes(&info.path, info.dims, info.field.scalar)?;
        let stored = range.end.saturating_sub(range.start);
        // A deflate block codes at most 258 bytes in 2 bits: never more than 1032 bytes from one.
        if skip.saturating_add(needed) > stored.saturating_mul(1032) {
            let expected = format!("{needed} bytes of samples, as the header says");
            let got = format!("{stored} bytes of {} data, too few for that", codec.name());
            return Err(Error::bad_input(source.path(), "samples", expected, got)
                .with_help("the file is cut short, or its dimensions are wrong"));
        }
        let walk = SlabWalk::new(info.dims, size);
        let decoded = codec.reader(source, range)?;
        let file = source.path().to_path_buf();
        let mut slabs = Self { info, file, codec, decoded, big_endian, tail, walk, at: 0, before: skip };
        if skip <= SKIPPED_AT_ONCE {
            slabs.skip_before()?;
        }
        Ok(slabs)
    }

    fn skip_before(&mut self) -> Result<()> {
        let bytes = std::mem::take(&mut self.before);
        let got = io::copy(&mut (&mut self.decoded).take(bytes), &mut io::sink());
        let got = got.map_err(|e| self.damaged(&e))?;
        self.at += got;
        if got < bytes { Err(self.ended(bytes - got)) } else { Ok(()) }
    }

    fn damaged(&self, why: &io::Error) -> Error {
        let at = format!("after {} decoded bytes", self.at);
        Error::bad_input(&self.file, at, format!("good {} data", self.codec.name()), why.to_string())
            .with_help("the file is damaged or cut short; fetch it again")
    }

    fn ended(&self, missing: u64) -> Error {
        let at = format!("after {} decoded bytes", self.at);
        Error::bad_input(&self.file, at, format!("{missing} more bytes of samples"), "the end of the data")
            .with_help("the file is cut short, or its dimensions or type are wrong")
    }

    /// Reads to the end, so that the decoder sees the checksum and nothing is left over. Runs have
    /// no checksum: one that is begun after the last sample is no loss.
    fn finish(&mut self) -> Result<()> {
        let mut one = [0; 1];
        let n = match self.decoded.read(&mut one) {
            Err(e) if self.codec == Codec::ByteRuns && e.kind() == io::ErrorKind::UnexpectedEof => 0,
            read => read.map_err(|e| self.damaged(&e))?,
        };
        if n == 0 {
            return Ok(());
        }
        let at = format!("after {} decoded bytes", self.at);
        Err(Error::bad_input(&self.file, at, "the end of the data", "more bytes")
            .with_help("the header's dimensions or type, or the bytes to skip, are wrong"))
    }
}

impl SlabStream for ByteSlabs {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        self.skip_before()?;
        out.clear();
        let Some(slab) = self.walk.next() else {
            match self.tail {
                Tail::Nothing => self.finish()?,
                Tail::Checked => {
                    io::copy(&mut self.decoded, &mut io::sink()).map_err(|e| self.damaged(&e))?;
                }
                Tail::Ignored => {}
            }
            return Ok(None);
        };
        let size = self.info.field.scalar.bytes();
        let wanted = (slab.len() * size) as u64;
        let got = (&mut self.decoded).take(wanted).read_to_end(out).map_err(|e| self.damaged(&e))? as u64;
        self.at += got;
        if got < wanted {
            return Err(self.ended(wanted - got));
        }
        if self.big_endian {
            swap_bytes(out, size);
        }
        Ok(Some(slab))
    }
}

/// Samples written as text, separated by blanks, line ends or commas.
pub(crate) struct TextSlabs {
    info: VolumeInfo,
    source: Arc<ByteSource>,
    at: u64,
    end: u64,
    walk: SlabWalk,
    push: PushWord,
}

/// Appends a number that is written as a word, little-endian; `false` when it is not one.
pub(crate) type PushWord = fn(&[u8], ScalarType, &mut Vec<u8>) -> bool;

impl TextSlabs {
    /// The samples in a range of a text file.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the range is not in the file or too short for so many samples.
    pub(crate) fn new(info: VolumeInfo, source: Arc<ByteSource>, range: Range<u64>) -> Result<Self> {
        sample_bytes(&info.path, info.dims, info.field.scalar)?;
        let text = source.slice(range.clone())?.len() as u64;
        let count = IndexBox::whole(info.dims).checked_len().expect("the bytes of the samples were counted");
        if count > text.div_ceil(2) {
            let got = format!("{text} bytes of text, too few for that");
            return Err(Error::bad_input(source.path(), "samples", format!("{count} numbers"), got)
                .with_help("the file is cut short, or its dimensions are wrong"));
        }
        let walk = SlabWalk::new(info.dims, info.field.scalar.bytes());
        Ok(Self { info, source, at: range.start, end: range.end, walk, push: push_number })
    }

    /// With words that stand for numbers in another way.
    pub(crate) fn written(self, push: PushWord) -> Self {
        Self { push, ..self }
    }

    fn push_sample(&mut self, out: &mut Vec<u8>) -> Result<()> {
        let scalar = self.info.field.scalar;
        let (at, word) = next_word(&self.source, &mut self.at, self.end)?;
        if (self.push)(word, scalar, out) {
            return Ok(());
        }
        let got = if word.is_empty() { "the end of the text".into() } else { String::from_utf8_lossy(word) };
        let expected = format!("a number of type {}", scalar.name());
        Err(Error::bad_input(self.source.path(), Place::byte(at), expected, got))
    }
}

/// The next word from byte `at` on, and where it starts; empty at the end. `at` moves past it.
fn next_word<'a>(source: &'a ByteSource, at: &mut u64, end: u64) -> Result<(u64, &'a [u8])> {
    let text = source.slice(*at..end)?;
    let start = text.iter().position(|&b| !is_separator(b)).unwrap_or(text.len());
    let word = &text[start..];
    let word = &word[..word.iter().position(|&b| is_separator(b)).unwrap_or(word.len())];
    let found = *at + start as u64;
    *at = found + word.len() as u64;
    Ok((found, word))
}

fn is_separator(byte: u8) -> bool {
    byte.is_ascii_whitespace() || byte == b',' || byte == 0x0b
}

/// Appends a number written as text, little-endian; `false` when it is not one of that type.
pub(crate) fn push_number(word: &[u8], scalar: ScalarType, out: &mut Vec<u8>) -> bool {
    macro_rules! parse {
        ($t:ty) => {
            std::str::from_utf8(word)
                .ok()
                .and_then(|w| w.parse::<$t>().ok())
                .map(|v| out.extend(v.to_le_bytes()))
        };
    }
    let pushed = match scalar {
        ScalarType::U8 => parse!(u8),
        ScalarType::I8 => parse!(i8),
        ScalarType::U16 => parse!(u16),
        ScalarType::I16 => parse!(i16),
        ScalarType::U32 => parse!(u32),
        ScalarType::I32 => parse!(i32),
        ScalarType::U64 => parse!(u64),
        ScalarType::I64 => parse!(i64),
        ScalarType::F16 => parse!(half::f16),
        ScalarType::F32 => parse!(f32),
        ScalarType::F64 => parse!(f64),
    };
    pushed.is_some()
}

/// Appends a byte that is written as a part of 255, from 0 to 1, as VTK writes colours; `false`
/// when it is not one.
pub(crate) fn push_color(word: &[u8], _: ScalarType, out: &mut Vec<u8>) -> bool {
    let part = std::str::from_utf8(word).ok().and_then(|w| w.parse::<f64>().ok());
    let byte = part.filter(|part| (0.0..=1.0).contains(part)).map(|part| (255.0 * part).round() as u8);
    out.extend(byte);
    byte.is_some()
}

impl SlabStream for TextSlabs {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        out.clear();
        let Some(slab) = self.walk.next() else {
            let (at, word) = next_word(&self.source, &mut self.at, self.end)?;
            if word.is_empty() {
                self.source.check()?;
                return Ok(None);
            }
            let (at, got) = (Place::byte(at), String::from_utf8_lossy(word));
            return Err(Error::bad_input(self.source.path(), at, "the end of the samples", got)
                .with_help("the header's dimensions are wrong"));
        };
        let start = self.at;
        let pushed = (0..slab.len()).try_for_each(|_| self.push_sample(out));
        // First of all: a file that was cut meanwhile reads as zeros, which are no numbers.
        self.source.check()?;
        pushed?;
        self.source.release(start..self.at);
        Ok(Some(slab))
    }
}

/// Bytes of all samples of a volume.
///
/// # Errors
/// [`Error::BadInput`] when a dimension is 0 or the product does not fit 63 bits.
pub(crate) fn sample_bytes(path: &Path, dims: [u64; 3], scalar: ScalarType) -> Result<u64> {
    let count = IndexBox::whole(dims).checked_len();
    let bytes = count.and_then(|n| n.checked_mul(scalar.bytes() as u64));
    bytes.filter(|&b| b > 0 && b <= i64::MAX as u64).ok_or_else(|| {
        let got = format!("{} x {} x {} samples of {}", dims[0], dims[1], dims[2], scalar.name());
        Error::bad_input(
            path,
            "dimensions",
            "at least one sample along each axis, fewer than 2^63 bytes",
            got,
        )
    })
}
