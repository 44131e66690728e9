//! Reads stored bytes, plain or as base64 text, front to back.
//!
//! VTK encodes a compressed array as two base64 texts in a row, the table of block lengths and the
//! blocks, each with its own padding; other programs write three. So padding ends a group of four
//! here, not the text.

use crate::bytes::ByteSource;
use crate::error::{Error, Place, Result};
use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::sync::Arc;

/// Some writers leave bits set in the last group; they mean nothing.
const ENGINE: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_allow_trailing_bits(true)
        .with_decode_padding_mode(DecodePaddingMode::RequireCanonical),
);

/// Characters decoded at a time; a multiple of 4.
const CHARACTERS: usize = 1 << 15;

/// Stored bytes from a place in a file on.
#[derive(Clone, Debug)]
pub(super) struct Stored {
    source: Arc<ByteSource>,
    /// The next byte of the file.
    at: u64,
    end: u64,
    /// Decoded bytes not handed out yet: the tail of `decoded`. `None` for plain bytes.
    base64: Option<Decoded>,
}

#[derive(Clone, Debug, Default)]
struct Decoded {
    bytes: Vec<u8>,
    used: usize,
}

impl Stored {
    /// The bytes `at..end` of a file as they are.
    pub(super) fn plain(source: &Arc<ByteSource>, at: u64, end: u64) -> Self {
        Self { source: Arc::clone(source), at, end, base64: None }
    }

    /// The bytes that the base64 text `at..end` stands for; the text ends earlier where a tag
    /// begins.
    pub(super) fn base64(source: &Arc<ByteSource>, at: u64, end: u64) -> Self {
        Self { source: Arc::clone(source), at, end, base64: Some(Decoded::default()) }
    }

    /// The plain bytes after the next `bytes` ones.
    pub(super) fn from(&self, bytes: u64) -> Self {
        assert!(self.base64.is_none() && bytes <= self.end - self.at, "a place among plain bytes");
        Self { at: self.at + bytes, ..self.clone() }
    }

    /// More bytes than this do not follow.
    pub(super) fn most_left(&self) -> u64 {
        (self.end - self.at) + self.base64.as_ref().map_or(0, |d| (d.bytes.len() - d.used) as u64)
    }

    /// The place in the file, for messages: where what comes next is stored, or shortly after.
    pub(super) fn place(&self) -> Place {
        Place::byte(self.at)
    }

    /// Reads some bytes; 0 at the end.
    pub(super) fn read(&mut self, out: &mut [u8]) -> Result<usize> {
        if self.base64.is_none() {
            let n = (self.end - self.at).min(out.len() as u64) as usize;
            self.source.read_at(self.at, &mut out[..n])?;
            self.at += n as u64;
            return Ok(n);
        }
        if self.base64.as_ref().is_some_and(|d| d.used == d.bytes.len()) {
            self.decode()?;
        }
        let decoded = self.base64.as_mut().expect("plain bytes were handled above");
        let rest = &decoded.bytes[decoded.used..];
        let n = rest.len().min(out.len());
        out[..n].copy_from_slice(&rest[..n]);
        decoded.used += n;
        Ok(n)
    }

    /// Fills `out`; the end of the bytes is an error.
    pub(super) fn read_exact(&mut self, out: &mut [u8]) -> Result<()> {
        let mut filled = 0;
        while filled < out.len() {
            match self.read(&mut out[filled..])? {
                0 => {
                    return Err(self.wrong(format!("{} more bytes of data", out.len() - filled), "their end"));
                }
                n => filled += n,
            }
        }
        Ok(())
    }

    /// Goes over bytes.
    pub(super) fn skip(&mut self, mut n: u64) -> Result<()> {
        let mut scratch = [0; 4096];
        while n > 0 {
            let part = n.min(scratch.len() as u64);
            self.read_exact(&mut scratch[..part as usize])?;
            n -= part;
        }
        Ok(())
    }

    /// An error at this place.
    pub(super) fn wrong(&self, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(self.source.path(), self.place(), expected, got)
            .with_help("the file is cut short or damaged")
    }

    /// Decodes the next groups of four characters.
    fn decode(&mut self) -> Result<()> {
        let text = self.source.slice(self.at..self.end)?;
        let mut characters = Vec::with_capacity(CHARACTERS);
        let mut seen = 0;
        for &c in text {
            let group_done = characters.len() % 4 == 0;
            let padded = group_done && characters.last() == Some(&b'=');
            if c == b'<' || padded || characters.len() == CHARACTERS {
                break;
            }
            seen += 1;
            if !c.is_ascii_whitespace() {
                characters.push(c);
            }
        }
        let mut bytes = vec![0; characters.len() / 4 * 3 + 3];
        let n = ENGINE.decode_slice(&characters, &mut bytes);
        let n = n.map_err(|e| self.wrong("base64 text", e.to_string()))?;
        bytes.truncate(n);
        self.at += seen;
        self.base64 = Some(Decoded { bytes, used: 0 });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::prelude::BASE64_STANDARD;

    #[test]
    fn texts_in_a_row_and_spaces() {
        let data: Vec<u8> = (0..100_000u32).map(|i| (i * 7 % 251) as u8).collect();
        let mut text = vec![b' '; 3];
        for part in [&data[..8], &data[8..24], &data[24..50_000], &data[50_000..]] {
            for (i, c) in BASE64_STANDARD.encode(part).bytes().enumerate() {
                text.push(c);
                if i % 76 == 75 {
                    text.extend(b"\r\n");
                }
            }
        }
        text.extend(b"\n</DataArray>");
        let len = text.len() as u64;
        let source = Arc::new(ByteSource::from_vec("f", text));
        let mut stored = Stored::base64(&source, 0, len);
        stored.skip(5).unwrap();
        let mut out = vec![0; data.len() - 5];
        stored.read_exact(&mut out).unwrap();
        assert_eq!(out, data[5..]);
        assert_eq!(stored.read(&mut out).unwrap(), 0);
        assert!(stored.read_exact(&mut [0]).unwrap_err().to_string().contains("1 more bytes"));
    }

    #[test]
    fn what_is_no_base64_is_refused() {
        for text in ["AAA", "AA*A", "A===", "AAAAA"] {
            let source = Arc::new(ByteSource::from_vec("f", text.into()));
            assert!(Stored::base64(&source, 0, text.len() as u64).skip(4).is_err(), "{text}");
        }
    }
}
