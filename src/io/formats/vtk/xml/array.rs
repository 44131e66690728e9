//! The data of one `DataArray`, decoded front to back in constant memory.
//!
//! ```text
//! ascii                    1 2 3 …
//! binary, uncompressed     [length in bytes] [data]
//! binary, compressed       [blocks n] [block length] [length of a shorter last block, or 0]
//!                          [compressed length of block 0 … n-1] [block 0] … [block n-1]
//! ```
//!
//! The numbers of the headers are 32 or 64 bits wide (`header_type`) in the byte order of the file.
//! `format="binary"` is base64 text in the element; `format="appended"` lies after the header, raw
//! or base64.
//!
//! The lengths of the blocks are not kept: a second cursor moves over their table while the first
//! moves over the blocks. A [`BlockArray`] keeps their places instead. A zlib block is inflated
//! piece by piece; an LZ4 block must be decoded whole. So its length is the only length in a header
//! for which memory is reserved: at most 255 times its compressed length (what LZ4 can reach) and
//! [`MOST_LZ4_BLOCK`].

use super::head::{Compressor, Document, Element};
use super::stored::Stored;
use crate::error::Result;
use crate::formats::shared::text::TextNumbers;
use crate::volume::ScalarType;
use byteorder::{BE, ByteOrder, LE};
use flate2::{Decompress, FlushDecompress, Status};

/// The largest LZ4 block that is decoded, in bytes; VTK writes blocks of 32 KiB.
const MOST_LZ4_BLOCK: u64 = 1 << 28;

/// No compressor does better: DEFLATE codes at most 258 bytes with two bits, LZ4 255 bytes with
/// eight.
const BEST_RATIO: u64 = 1032;

/// Bytes of a decoder besides a block: buffers of text and input, the window and tables of zlib.
const DECODER: u64 = 1 << 18;

/// Compressed bytes read at a time.
const INPUT: usize = 1 << 14;

/// The longest that LZ4 makes of a block, where nothing repeats.
fn longest_lz4(block: u64) -> u64 {
    block + block / 255 + 16
}

/// The type of a VTK type name; `None` for `String` and `Bit`.
pub fn scalar_type(name: &str) -> Option<ScalarType> {
    Some(match name {
        "UInt8" => ScalarType::U8,
        "Int8" => ScalarType::I8,
        "UInt16" => ScalarType::U16,
        "Int16" => ScalarType::I16,
        "UInt32" => ScalarType::U32,
        "Int32" => ScalarType::I32,
        "UInt64" => ScalarType::U64,
        "Int64" => ScalarType::I64,
        "Float32" => ScalarType::F32,
        "Float64" => ScalarType::F64,
        _ => return None,
    })
}

/// The longest text of an array that is read.
const LONGEST_TEXT: usize = 1 << 12;

/// The first text of an array of texts: its bytes before a 0.
///
/// # Errors
/// [`Error::BadInput`](crate::Error::BadInput) when there is none, or a longer one than 4 KiB.
pub fn first_text(doc: &Document, element: &Element) -> Result<String> {
    let mut stream = ArrayStream::open_declared(doc, element, ScalarType::U8)?;
    let (mut text, mut next) = (vec![], [0]);
    loop {
        stream.fill(&mut next)?;
        match next {
            [0] => return Ok(String::from_utf8_lossy(&text).into_owned()),
            _ if text.len() == LONGEST_TEXT => {
                return Err(doc.wrong(element, "a text of at most 4 KiB", "a longer one"));
            }
            [byte] => text.push(byte),
        }
    }
}

/// The values of an array, front to back, as little-endian bytes.
pub struct ArrayStream {
    scalar: ScalarType,
    big_endian: bool,
    data: Data,
}

enum Data {
    Text(TextNumbers),
    Plain { stored: Stored, left: u64 },
    Blocks(Box<Blocks>),
    Empty(Stored),
}

/// Where an array's numbers are stored.
enum ArraySource {
    Text(TextNumbers),
    Binary(Stored),
}

impl ArrayStream {
    /// The array of an element, which must hold `bytes` bytes.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the array is malformed, or longer or shorter than that.
    pub fn open(doc: &Document, element: &Element, scalar: ScalarType, bytes: u64) -> Result<Self> {
        let data = match place(doc, element)? {
            // Writers disagree on the header of an empty array, and some leave it out.
            ArraySource::Binary(stored) if bytes == 0 => Data::Empty(stored),
            ArraySource::Text(numbers) => {
                // A digit and a space for each number.
                let most = numbers.len().div_ceil(2).saturating_mul(scalar.bytes() as u64);
                check_room(doc, element, most, bytes)?;
                Data::Text(numbers)
            }
            ArraySource::Binary(mut stored) if doc.compressor == Compressor::None => {
                let length = word(&mut stored, doc)?;
                check_length(doc, element, length, bytes)?;
                check_room(doc, element, stored.most_left(), bytes)?;
                Data::Plain { stored, left: bytes }
            }
            ArraySource::Binary(stored) => {
                let blocks = Blocks::open(doc, stored)?;
                check_length(doc, element, blocks.total(), bytes)?;
                check_room(doc, element, blocks.data.most_left().saturating_mul(BEST_RATIO), bytes)?;
                Data::Blocks(Box::new(blocks))
            }
        };
        Ok(Self { scalar, big_endian: doc.big_endian, data })
    }

    /// The array of an element, with as many values as its own data say. In a text this number is
    /// known only at the end.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the array is malformed, or longer than the file has room for.
    pub(in crate::formats) fn open_declared(
        doc: &Document,
        element: &Element,
        scalar: ScalarType,
    ) -> Result<Self> {
        let data = match place(doc, element)? {
            ArraySource::Text(numbers) => Data::Text(numbers),
            ArraySource::Binary(stored) if stored.most_left() == 0 => Data::Empty(stored),
            ArraySource::Binary(mut stored) if doc.compressor == Compressor::None => {
                let left = word(&mut stored, doc)?;
                check_room(doc, element, stored.most_left(), left)?;
                Data::Plain { stored, left }
            }
            ArraySource::Binary(stored) => {
                let blocks = Blocks::open(doc, stored)?;
                check_room(doc, element, blocks.data.most_left().saturating_mul(BEST_RATIO), blocks.total())?;
                Data::Blocks(Box::new(blocks))
            }
        };
        Ok(Self { scalar, big_endian: doc.big_endian, data })
    }

    /// Bytes of memory that the decoder takes at a time, at most.
    pub(super) fn working_bytes(&self) -> u64 {
        match &self.data {
            Data::Blocks(blocks) => DECODER + blocks.whole_block(),
            _ => DECODER,
        }
    }

    /// Fills `out` with the next values; its length is a multiple of the value's size.
    ///
    /// # Errors
    /// [`Error::BadInput`] when the data end, or cannot be decoded.
    pub fn fill(&mut self, out: &mut [u8]) -> Result<()> {
        match &mut self.data {
            Data::Text(numbers) => return numbers.fill(self.scalar, out),
            Data::Plain { stored, left } => {
                let n = out.len() as u64;
                *left = left.checked_sub(n).ok_or_else(|| stored.wrong("data", "the end of the array"))?;
                stored.read_exact(out)?;
            }
            Data::Blocks(blocks) => blocks.fill(out)?,
            Data::Empty(_) if out.is_empty() => {}
            Data::Empty(stored) => return Err(stored.wrong("data", "an empty array")),
        }
        if self.big_endian {
            out.chunks_exact_mut(self.scalar.bytes()).for_each(<[u8]>::reverse);
        }
        Ok(())
    }

    /// Must be called after the last value: text may continue, and a block's checksum follows its
    /// last byte.
    ///
    /// # Errors
    /// [`Error::BadInput`] when there are more data.
    pub fn finish(&mut self) -> Result<()> {
        match &mut self.data {
            Data::Text(numbers) => numbers.finish(),
            Data::Blocks(blocks) if blocks.to_come > 0 || blocks.left > 0 => {
                Err(blocks.data.wrong("the end of the array", "more data"))
            }
            Data::Blocks(blocks) => blocks.end_block(),
            Data::Plain { stored, left } if *left > 0 => {
                Err(stored.wrong("the end of the array", format!("{left} more bytes")))
            }
            Data::Plain { .. } | Data::Empty(_) => Ok(()),
        }
    }
}

/// Blocks of more bytes than this are decoded front to back alone, and so are more of them.
const MOST_RANDOM_BLOCK: u64 = 4 << 20;
const MOST_RANDOM_BLOCKS: u64 = 8 << 20;

/// A block-compressed array that lies in the file as it is (appended, raw): any of its values, by
/// way of the blocks around them.
pub(super) struct BlockArray {
    scalar: ScalarType,
    /// As the array is opened, before the first block.
    lengths: Stored,
    data: Stored,
    /// Where each block begins, counted from the first one.
    places: Vec<u64>,
    full: u64,
    last: u64,
    wide: bool,
    big_endian: bool,
    compressor: Compressor,
}

impl BlockArray {
    /// The array of an element, which must hold `bytes` bytes; `None` of one that has to be decoded
    /// front to back.
    ///
    /// # Errors
    /// As [`ArrayStream::open`].
    pub(super) fn open(
        doc: &Document,
        element: &Element,
        scalar: ScalarType,
        bytes: u64,
    ) -> Result<Option<Self>> {
        let raw = doc.appended.is_some_and(|a| !a.base64) && element.attribute("format") == Some("appended");
        if !raw || doc.compressor == Compressor::None || bytes == 0 {
            return Ok(None);
        }
        let ArraySource::Binary(stored) = place(doc, element)? else { return Ok(None) };
        let mut blocks = Blocks::open(doc, stored)?;
        check_length(doc, element, blocks.total(), bytes)?;
        check_room(doc, element, blocks.data.most_left().saturating_mul(BEST_RATIO), bytes)?;
        if blocks.full > MOST_RANDOM_BLOCK || blocks.to_come > MOST_RANDOM_BLOCKS {
            return Ok(None);
        }
        let (lengths, most, mut places, mut at) =
            (blocks.lengths.clone(), blocks.data.most_left(), vec![], 0u64);
        for _ in 0..blocks.to_come {
            places.push(at);
            let length = blocks.length()?;
            at = at.checked_add(length).filter(|&end| end <= most).ok_or_else(|| {
                let got = format!("{length} bytes, more than the file has left");
                blocks.data.wrong("the compressed length of a block", got)
            })?;
        }
        let Blocks { data, full, last, wide, big_endian, .. } = blocks;
        let compressor = doc.compressor;
        Ok(Some(Self { scalar, lengths, data, places, full, last, wide, big_endian, compressor }))
    }

    /// Bytes of a block.
    pub(super) fn block_bytes(&self) -> u64 {
        self.full
    }

    /// Bytes of memory that [`BlockArray::fill`] takes, at most.
    pub(super) fn working_bytes(&self) -> u64 {
        // The blocks at both ends are decoded whole, an LZ4 block also before it is given out.
        DECODER + 3 * self.full + longest_lz4(self.full) + 8 * self.places.len() as u64
    }

    /// Fills `out` with the values from byte `at` of the array on. Blocks are decoded, and checked,
    /// to their ends.
    ///
    /// # Errors
    /// [`Error::BadInput`](crate::Error::BadInput) when they cannot be decoded.
    pub(super) fn fill(&self, at: u64, out: &mut [u8]) -> Result<()> {
        let first = at / self.full;
        let mut blocks = self.blocks_from(first);
        blocks.fill(&mut vec![0; (at - first * self.full) as usize])?;
        blocks.fill(out)?;
        blocks.fill(&mut vec![0; blocks.left as usize])?;
        blocks.end_block()?;
        if self.big_endian {
            out.chunks_exact_mut(self.scalar.bytes()).for_each(<[u8]>::reverse);
        }
        Ok(())
    }

    fn blocks_from(&self, number: u64) -> Blocks {
        let word = if self.wide { 8 } else { 4 };
        Blocks {
            lengths: self.lengths.from(number * word),
            data: self.data.from(self.places[number as usize]),
            full: self.full,
            last: self.last,
            to_come: self.places.len() as u64 - number,
            wide: self.wide,
            big_endian: self.big_endian,
            codec: Codec::new(self.compressor),
            left: 0,
        }
    }
}

/// The byte of the file where the array's values lie one after another, where they do: appended,
/// raw, uncompressed.
pub(super) fn in_place(doc: &Document, element: &Element, bytes: u64) -> Result<Option<u64>> {
    let raw = doc.appended.is_some_and(|a| !a.base64) && doc.compressor == Compressor::None;
    if !raw || element.attribute("format") != Some("appended") {
        return Ok(None);
    }
    let ArraySource::Binary(mut stored) = place(doc, element)? else { return Ok(None) };
    let start = doc.source.len() - stored.most_left();
    let length = word(&mut stored, doc)?;
    check_length(doc, element, length, bytes)?;
    Ok(Some(start + if doc.wide { 8 } else { 4 }))
}

fn place(doc: &Document, element: &Element) -> Result<ArraySource> {
    let text = &element.text;
    match element.attribute("format").unwrap_or("ascii") {
        "ascii" => {
            let numbers = TextNumbers::new(&doc.source, text.clone());
            Ok(ArraySource::Text(numbers))
        }
        "binary" => Ok(ArraySource::Binary(Stored::base64(&doc.source, text.start, text.end))),
        "appended" => {
            let appended =
                doc.appended.ok_or_else(|| doc.wrong(element, "an element AppendedData", "none"))?;
            let offset: Option<[u64; 1]> = doc.numbers(element, "offset")?;
            let [offset] = offset.ok_or_else(|| doc.wrong(element, "an attribute 'offset'", "none"))?;
            let end = doc.source.len();
            let start = appended.start.checked_add(offset).filter(|&at| at < end).ok_or_else(|| {
                doc.wrong(element, format!("an offset within a file of {end} bytes"), offset.to_string())
                    .with_help("the file is cut short or damaged")
            })?;
            Ok(ArraySource::Binary(match appended.base64 {
                true => Stored::base64(&doc.source, start, end),
                false => Stored::plain(&doc.source, start, end),
            }))
        }
        other => Err(doc.wrong(element, "format ascii, binary or appended", format!("'{other}'"))),
    }
}

fn check_length(doc: &Document, element: &Element, found: u64, expected: u64) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    let error =
        doc.wrong(element, format!("{expected} bytes of data"), format!("a header that tells {found}"));
    Err(match !doc.wide && expected > u32::MAX.into() {
        true => {
            error.with_help("a UInt32 header cannot tell this length: write the file with header_type UInt64")
        }
        false => error.with_help("the file is damaged, or its extent is wrong"),
    })
}

/// Refuses a header that announces more than the file can hold, before memory is reserved for a
/// part of it.
fn check_room(doc: &Document, element: &Element, most: u64, expected: u64) -> Result<()> {
    if expected <= most {
        return Ok(());
    }
    let error = doc.wrong(element, format!("{expected} bytes of data"), "a file too short for them");
    Err(error.with_help("the file is cut short, or its extent is wrong"))
}

/// A number of a header.
fn word(stored: &mut Stored, doc: &Document) -> Result<u64> {
    let mut b = [0; 8];
    let n = if doc.wide { 8 } else { 4 };
    stored.read_exact(&mut b[..n])?;
    Ok(if doc.big_endian { BE::read_uint(&b, n) } else { LE::read_uint(&b, n) })
}

/// A block-compressed array.
struct Blocks {
    /// The compressed lengths of the blocks to come.
    lengths: Stored,
    /// The blocks.
    data: Stored,
    /// The bytes of a block; the last may have fewer.
    full: u64,
    last: u64,
    /// Blocks to come, the current one not counted.
    to_come: u64,
    wide: bool,
    big_endian: bool,
    codec: Codec,
    /// Bytes of the current block not handed out yet.
    left: u64,
}

enum Codec {
    Zlib {
        inflate: Box<Decompress>,
        /// Compressed bytes of the current block not read yet.
        compressed: u64,
        input: Vec<u8>,
        used: usize,
    },
    Lz4 {
        block: Vec<u8>,
        input: Vec<u8>,
    },
}

impl Codec {
    fn new(compressor: Compressor) -> Self {
        if compressor == Compressor::Lz4 {
            return Self::Lz4 { block: vec![], input: vec![] };
        }
        Self::Zlib { inflate: Box::new(Decompress::new(true)), compressed: 0, input: vec![], used: 0 }
    }
}

impl Blocks {
    fn open(doc: &Document, mut stored: Stored) -> Result<Self> {
        let (count, full, partial) =
            (word(&mut stored, doc)?, word(&mut stored, doc)?, word(&mut stored, doc)?);
        let lengths = stored.clone();
        let table = count.checked_mul(if doc.wide { 8 } else { 4 }).filter(|&t| t <= stored.most_left());
        let table = table.ok_or_else(|| stored.wrong("a table of blocks", format!("{count} blocks")))?;
        stored.skip(table)?;
        let last = if partial == 0 { full } else { partial };
        if partial > full || (count > 0 && last == 0) || full.checked_mul(count).is_none() {
            let got = format!("{count} blocks of {full} bytes, the last of {partial}");
            return Err(stored.wrong("lengths of blocks", got));
        }
        let codec = Codec::new(doc.compressor);
        let (wide, big_endian) = (doc.wide, doc.big_endian);
        Ok(Self { lengths, data: stored, full, last, to_come: count, wide, big_endian, codec, left: 0 })
    }

    /// The bytes of all blocks. Cannot overflow: `open` has seen the product.
    fn total(&self) -> u64 {
        match self.to_come {
            0 => 0,
            n => (n - 1) * self.full + self.last,
        }
    }

    /// Bytes of a block that is decoded as a whole, and of its compressed form.
    fn whole_block(&self) -> u64 {
        let block = self.full.min(MOST_LZ4_BLOCK);
        if matches!(self.codec, Codec::Lz4 { .. }) { block + longest_lz4(block) } else { 0 }
    }

    fn fill(&mut self, mut out: &mut [u8]) -> Result<()> {
        while !out.is_empty() {
            if self.left == 0 {
                self.end_block()?;
                self.next_block()?;
            }
            let n = self.left.min(out.len() as u64) as usize;
            let (now, later) = out.split_at_mut(n);
            self.decode(now)?;
            self.left -= n as u64;
            out = later;
        }
        Ok(())
    }

    fn next_block(&mut self) -> Result<()> {
        if self.to_come == 0 {
            return Err(self.data.wrong("another block", "the end of the array"));
        }
        self.to_come -= 1;
        self.left = if self.to_come == 0 { self.last } else { self.full };
        let length = self.length()?;
        if length > self.data.most_left() {
            let got = format!("{length} bytes, more than the file has left");
            return Err(self.data.wrong("the compressed length of a block", got));
        }
        match &mut self.codec {
            Codec::Zlib { inflate, compressed, input, used } => {
                inflate.reset(true);
                input.clear();
                (*compressed, *used) = (length, 0);
                Ok(())
            }
            Codec::Lz4 { block, input } => {
                let most = length.saturating_mul(255).min(MOST_LZ4_BLOCK);
                if self.left > most {
                    let got = format!("one of {} bytes, {length} compressed", self.left);
                    let error = self.data.wrong(format!("an LZ4 block of at most {most} bytes"), got);
                    return Err(error.with_help("write the file with smaller blocks"));
                }
                if length > longest_lz4(self.left) {
                    let expected = format!("at most {} bytes for a block", longest_lz4(self.left));
                    return Err(self.data.wrong(expected, format!("{length} bytes for {}", self.left)));
                }
                input.resize(length as usize, 0);
                self.data.read_exact(input)?;
                block.resize(self.left as usize, 0);
                match lz4_flex::block::decompress_into(input, block) {
                    Ok(n) if n == block.len() => Ok(()),
                    Ok(n) => Err(self.data.wrong(format!("a block of {} bytes", block.len()), n.to_string())),
                    Err(e) => Err(self.data.wrong("an LZ4 block", e.to_string())),
                }
            }
        }
    }

    /// The compressed length of the next block.
    fn length(&mut self) -> Result<u64> {
        let mut b = [0; 8];
        let n = if self.wide { 8 } else { 4 };
        self.lengths.read_exact(&mut b[..n])?;
        if self.big_endian {
            b[..n].reverse();
        }
        Ok(u64::from_le_bytes(b))
    }

    /// The next bytes of the current block.
    fn decode(&mut self, out: &mut [u8]) -> Result<()> {
        if let Codec::Lz4 { block, .. } = &self.codec {
            let at = block.len() - self.left as usize;
            out.copy_from_slice(&block[at..at + out.len()]);
            return Ok(());
        }
        let mut filled = 0;
        while filled < out.len() {
            let (n, status) = self.inflate(&mut out[filled..])?;
            filled += n;
            if status == Status::StreamEnd && filled < out.len() {
                return Err(self.data.wrong("a longer zlib block", "its end"));
            }
        }
        Ok(())
    }

    /// One step of zlib: bytes put out, and whether the block has ended.
    fn inflate(&mut self, out: &mut [u8]) -> Result<(usize, Status)> {
        let Codec::Zlib { inflate, compressed, input, used } = &mut self.codec else {
            unreachable!("only zlib blocks are inflated")
        };
        if *used == input.len() {
            input.resize((*compressed).min(INPUT as u64) as usize, 0);
            self.data.read_exact(input)?;
            *compressed -= input.len() as u64;
            *used = 0;
        }
        let (taken, put) = (inflate.total_in(), inflate.total_out());
        let status = inflate.decompress(&input[*used..], out, FlushDecompress::None);
        let status = status.map_err(|e| self.data.wrong("a zlib block", e.to_string()))?;
        let (taken, put) = (inflate.total_in() - taken, inflate.total_out() - put);
        *used += taken as usize;
        if taken == 0 && put == 0 && status != Status::StreamEnd {
            return Err(self.data.wrong("a whole zlib block", "one that ends too early"));
        }
        Ok((put as usize, status))
    }

    /// Checks the end of the current block, which has been handed out: its checksum, and that it
    /// has no more values. Bytes after that are passed over, as zlib does.
    fn end_block(&mut self) -> Result<()> {
        match &self.codec {
            // Before the first block.
            Codec::Zlib { inflate, .. } if inflate.total_in() == 0 => return Ok(()),
            Codec::Zlib { .. } => {}
            Codec::Lz4 { .. } => return Ok(()),
        }
        loop {
            let mut more = [0];
            let (n, status) = self.inflate(&mut more)?;
            if n > 0 {
                return Err(self.data.wrong("the end of a zlib block", "more data"));
            }
            if status == Status::StreamEnd {
                break;
            }
        }
        let Codec::Zlib { inflate, compressed, input, used } = &mut self.codec else {
            unreachable!("LZ4 was handled above")
        };
        self.data.skip(std::mem::take(compressed))?;
        input.clear();
        *used = 0;
        inflate.reset(true);
        Ok(())
    }
}
