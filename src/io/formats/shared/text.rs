//! Text in data files: words divided by white space, numbers, and the line where something is
//! wrong.

use super::stream::{PushWord, push_number};
use crate::bytes::ByteSource;
use crate::error::{Error, Place, Result};
use crate::volume::ScalarType;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Goes through the words of a text that may be larger than memory (a mapped file).
#[derive(Clone, Debug)]
pub struct Words<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Words<'a> {
    /// The words of `bytes` from byte `at` on; `path` is for messages.
    pub fn new(path: &'a Path, bytes: &'a [u8], at: usize) -> Self {
        Self { path, bytes, at }
    }

    /// The byte after what was read.
    pub fn at(&self) -> usize {
        self.at
    }

    /// The bytes not read yet.
    pub fn rest(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// The next word, if there is one.
    #[allow(clippy::should_implement_trait, reason = "it can fail, or lends what it gives")]
    pub fn next(&mut self) -> Option<&'a [u8]> {
        let (start, end) = word(self.bytes, self.at)?;
        self.at = end;
        Some(&self.bytes[start..end])
    }

    /// The next word as text; `what` is what it should be.
    pub fn word(&mut self, what: &str) -> Result<&'a str> {
        let found = self.next().ok_or_else(|| self.wrong(what, "the end of the file"))?;
        std::str::from_utf8(found).map_err(|_| self.wrong(what, "bytes that are not text"))
    }

    /// The next word as a number or anything else that parses; `what` is what it should be.
    pub fn parse<T: std::str::FromStr>(&mut self, what: &str) -> Result<T> {
        let found = self.word(what)?;
        found.parse().map_err(|_| self.wrong(what, format!("'{found}'")))
    }

    /// The rest of the line, without its end; `None` at the end of the text. Text that is not UTF-8
    /// is shown with replacement characters.
    pub fn line(&mut self) -> Option<std::borrow::Cow<'a, str>> {
        let rest = self.rest();
        if rest.is_empty() {
            return None;
        }
        let len = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at += (len + 1).min(rest.len());
        Some(String::from_utf8_lossy(rest[..len].strip_suffix(b"\r").unwrap_or(&rest[..len])))
    }

    /// Goes over `n` bytes; `None` when there are fewer.
    pub fn take(&mut self, n: u64) -> Option<&'a [u8]> {
        let bytes = self.rest().get(..usize::try_from(n).ok()?)?;
        self.at += bytes.len();
        Some(bytes)
    }

    /// "line n", n counted from 1, of the last byte read.
    pub fn place(&self) -> String {
        place(self.bytes, self.at.saturating_sub(1))
    }

    /// An error at the last word read.
    pub fn wrong(&self, expected: impl Into<String>, got: impl Into<String>) -> Error {
        Error::bad_input(self.path, self.place(), expected, got)
    }
}

/// "line n" of byte `at`.
pub(in crate::formats) fn place(bytes: &[u8], at: usize) -> String {
    let before = &bytes[..at.min(bytes.len())];
    format!("line {}", before.iter().filter(|&&b| b == b'\n').count() + 1)
}

/// Where the next word at or after `at` starts and ends.
pub(in crate::formats) fn word(bytes: &[u8], at: usize) -> Option<(usize, usize)> {
    let start = at + bytes.get(at..)?.iter().position(|b| !is_space(*b))?;
    let len = bytes[start..].iter().position(|b| is_space(*b)).unwrap_or(bytes.len() - start);
    Some((start, start + len))
}

/// White space as C's `isspace` has it.
fn is_space(b: u8) -> bool {
    b.is_ascii_whitespace() || b == 0x0b
}

/// Numbers in text.
pub(in crate::formats) struct TextNumbers {
    source: Arc<ByteSource>,
    at: u64,
    end: u64,
    push: PushWord,
}

impl TextNumbers {
    pub(in crate::formats) fn new(source: &Arc<ByteSource>, range: Range<u64>) -> Self {
        Self { source: Arc::clone(source), at: range.start, end: range.end, push: push_number }
    }

    /// With words that stand for numbers in another way.
    pub(in crate::formats) fn written(self, push: PushWord) -> Self {
        Self { push, ..self }
    }

    /// Bytes of text not read yet.
    pub(in crate::formats) fn len(&self) -> u64 {
        self.end - self.at
    }

    /// Fills `out` with the next numbers, little-endian.
    pub(in crate::formats) fn fill(&mut self, scalar: ScalarType, out: &mut [u8]) -> Result<()> {
        let bytes = self.source.slice(0..self.end)?;
        let (mut at, mut number) = (self.at as usize, Vec::with_capacity(8));
        for value in out.chunks_exact_mut(scalar.bytes()) {
            let Some((start, end)) = word(bytes, at) else {
                return Err(self.wrong(at, "more numbers".into(), "their end".into()));
            };
            number.clear();
            if !(self.push)(&bytes[start..end], scalar, &mut number) {
                let found = String::from_utf8_lossy(&bytes[start..end.min(start + 40)]).into_owned();
                return Err(self.wrong(start, format!("a number of type {}", scalar.name()), found));
            }
            value.copy_from_slice(&number);
            at = end;
        }
        self.at = at as u64;
        self.source.check()
    }

    /// Must be called after the last number.
    pub(in crate::formats) fn finish(&self) -> Result<()> {
        match word(self.source.slice(0..self.end)?, self.at as usize) {
            None => self.source.check(),
            Some((at, _)) => {
                Err(self.wrong(at, "the end of the array's numbers".into(), "more numbers".into()))
            }
        }
    }

    fn wrong(&self, at: usize, expected: String, got: String) -> Error {
        // A file that was cut meanwhile reads as zeros, which are no numbers.
        if let Err(shrunk) = self.source.check() {
            return shrunk;
        }
        let place = match self.source.slice(0..self.end) {
            Ok(bytes) => place(bytes, at).into(),
            Err(_) => Place::byte(at as u64),
        };
        Error::bad_input(self.source.path(), place, expected, got)
    }
}

/// Text as the value of an XML attribute; control characters, which XML has no way to write, become
/// spaces.
pub fn xml_attribute(text: &str) -> String {
    let text: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_and_lines() {
        let text = b"  one\ttwo\r\nthree 4\n\nx";
        let mut w = Words::new(Path::new("f"), text, 0);
        assert_eq!((w.next(), w.next()), (Some(&b"one"[..]), Some(&b"two"[..])));
        assert_eq!(w.line().unwrap(), "");
        assert_eq!(w.word("a word").unwrap(), "three");
        assert_eq!(w.parse::<u8>("a number").unwrap(), 4);
        assert_eq!((w.line().unwrap().as_ref(), w.line().unwrap().as_ref()), ("", ""));
        let error = w.parse::<f32>("a number").unwrap_err().to_string();
        assert_eq!(error, "f: line 4: expected a number, got 'x'");
        assert!(w.next().is_none() && w.line().is_none());
        assert!(w.word("a word").unwrap_err().to_string().contains("the end of the file"));
    }
}
