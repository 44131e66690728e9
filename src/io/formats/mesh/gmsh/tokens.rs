//! Reads integers and reals of a `.msh` file one after another, from text or bytes.

use crate::bytes::ByteSource;
use crate::error::{Error, Place, Result};
use crate::formats::shared::text::{place, word};
use std::sync::Arc;

/// A place in a file.
#[derive(Clone)]
pub(super) struct Tokens {
    pub(super) source: Arc<ByteSource>,
    pub(super) at: u64,
    pub(super) binary: bool,
    pub(super) big_endian: bool,
    /// Bytes of a size in a binary file of version 4: 4 or 8.
    pub(super) size_bytes: usize,
}

/// What precedes the nodes of a block of version 4.
pub(super) struct NodeBlock {
    pub(super) nodes: u64,
    /// Parameters after each position.
    pub(super) extra: u64,
}

impl Tokens {
    /// The next word of text, in either kind of file.
    pub(super) fn word(&mut self) -> Result<&str> {
        let bytes = self.source.slice(0..self.source.len())?;
        let Some((start, end)) = word(bytes, self.at as usize) else {
            return Err(self.wrong("more", "the end of the file"));
        };
        self.at = end as u64;
        std::str::from_utf8(&bytes[start..end]).map_err(|_| self.wrong("text", "bytes that are not text"))
    }

    /// The rest of the line.
    pub(super) fn line(&mut self) -> Result<String> {
        let rest = self.source.slice(self.at..self.source.len())?;
        let end = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        let line = String::from_utf8_lossy(&rest[..end]).trim().to_string();
        self.at = (self.at + end as u64 + 1).min(self.source.len());
        Ok(line)
    }

    /// A number written as text, in either kind of file.
    pub(super) fn parse<T: std::str::FromStr>(&mut self, what: &str) -> Result<T> {
        let found = self.word()?;
        match found.parse() {
            Ok(value) => Ok(value),
            Err(_) => {
                let got = format!("'{found}'");
                Err(self.wrong(what, got))
            }
        }
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N]> {
        let bytes = self.source.slice(self.at..self.source.len())?;
        let Some(found) = bytes.first_chunk::<N>().copied() else {
            return Err(self.wrong(format!("{N} more bytes"), "the end of the file"));
        };
        self.at += N as u64;
        let mut found = found;
        if self.big_endian {
            found.reverse();
        }
        Ok(found)
    }

    /// An `int` that is not negative.
    pub(super) fn int(&mut self) -> Result<u64> {
        if !self.binary {
            return self.parse("an integer, not negative");
        }
        let value = i32::from_le_bytes(self.bytes()?);
        u64::try_from(value).map_err(|_| self.wrong("an integer, not negative", value.to_string()))
    }

    /// An `int` that may be negative, as tags of entities may.
    pub(super) fn skip_int(&mut self) -> Result<()> {
        if self.binary { self.bytes::<4>().map(drop) } else { self.parse::<i64>("an integer").map(drop) }
    }

    /// A `size_t`.
    pub(super) fn size(&mut self) -> Result<u64> {
        match (self.binary, self.size_bytes) {
            (false, _) => self.parse("a size"),
            (true, 4) => Ok(u32::from_le_bytes(self.bytes()?).into()),
            (true, _) => Ok(u64::from_le_bytes(self.bytes()?)),
        }
    }

    /// A `double`.
    pub(super) fn real(&mut self) -> Result<f64> {
        if self.binary { Ok(f64::from_le_bytes(self.bytes()?)) } else { self.parse("a number") }
    }

    /// Goes over `n` numbers of `size` bytes, or words.
    fn skip(&mut self, n: u64, size: usize) -> Result<()> {
        if !self.binary {
            return (0..n).try_for_each(|_| self.word().map(drop));
        }
        let left = self.source.len() - self.at;
        match n.checked_mul(size as u64).filter(|&bytes| bytes <= left) {
            Some(bytes) => {
                self.at += bytes;
                Ok(())
            }
            None => Err(self.wrong(format!("{n} numbers of {size} bytes"), format!("{left} bytes"))),
        }
    }

    /// Goes over sizes.
    pub(super) fn skip_sizes(&mut self, n: u64) -> Result<()> {
        self.skip(n, self.size_bytes)
    }

    /// Goes over ints.
    pub(super) fn skip_ints(&mut self, n: u64) -> Result<()> {
        self.skip(n, 4)
    }

    /// Goes over reals.
    pub(super) fn skip_reals(&mut self, n: u64) -> Result<()> {
        self.skip(n, 8)
    }

    /// The head of a block of nodes of version 4.
    pub(super) fn node_block(&mut self) -> Result<NodeBlock> {
        let dimension = self.int()?;
        self.skip_int()?;
        let parametric = self.int()?;
        let nodes = self.size()?;
        if dimension > 3 || parametric > 1 || nodes > self.source.len() {
            let got = format!("dimension {dimension}, parametric {parametric}, {nodes} nodes");
            return Err(self.wrong("the head of a block of nodes", got));
        }
        Ok(NodeBlock { nodes, extra: parametric * dimension })
    }

    /// Whether the bytes so far were the file's.
    pub(super) fn check(&self) -> Result<()> {
        self.source.check()
    }

    /// An error at the last number read.
    pub(super) fn wrong(&self, expected: impl Into<String>, got: impl Into<String>) -> Error {
        // A file that was cut meanwhile reads as zeros.
        if let Err(shrunk) = self.source.check() {
            return shrunk;
        }
        let at = match self.source.slice(0..self.source.len()) {
            Ok(bytes) if !self.binary => place(bytes, (self.at as usize).saturating_sub(1)).into(),
            _ => Place::byte(self.at),
        };
        Error::bad_input(self.source.path(), at, expected, got)
    }
}
