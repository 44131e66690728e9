//! Little-endian fields and variable-length integers, read with every length checked.

use byteorder::{ByteOrder, LE};
use isospan_io::error::{Error, Fault};
use std::cell::RefCell;
use std::path::Path;
use zstd::bulk::Decompressor;

/// Bytes of a block that do not mean what they should. The decoder of a block knows no file: the
/// reader of the block turns this into an [`Error`] with [`Malformed::in_block`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Malformed {
    /// What is wrong with it.
    pub fault: Fault,
    /// Which field.
    pub at: &'static str,
    /// What a good block has there.
    pub expected: String,
    /// What was found.
    pub got: String,
}

impl Malformed {
    /// A field that is not as expected.
    pub fn new(at: &'static str, expected: impl Into<String>, got: impl Into<String>) -> Self {
        Self { fault: Fault::Malformed, at, expected: expected.into(), got: got.into() }
    }

    /// Bytes whose checksum is not the one stored.
    pub(crate) fn checksum(at: &'static str, expected: String, got: String) -> Self {
        Self { fault: Fault::Checksum, ..Self::new(at, expected, got) }
    }

    /// The error that names the file and the block.
    pub fn in_block(self, path: &Path, block: u64) -> Error {
        Error::bad_input(path, format!("block {block}: {}", self.at), self.expected, self.got)
            .of_fault(self.fault)
            .with_help("the archive is damaged or was written by a faulty program: make it again")
    }
}

/// Reads fields front to back.
pub(crate) struct Cursor<'a> {
    bytes: &'a [u8],
}

macro_rules! field {
    ($name:ident, $type:ty, $read:expr) => {
        pub(crate) fn $name(&mut self, at: &'static str) -> Result<$type, Malformed> {
            self.take(size_of::<$type>(), at).map($read)
        }
    };
}

impl<'a> Cursor<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// The bytes that have not been read.
    pub(crate) fn rest(&self) -> &'a [u8] {
        self.bytes
    }

    pub(crate) fn take(&mut self, n: usize, at: &'static str) -> Result<&'a [u8], Malformed> {
        let Some((head, tail)) = self.bytes.split_at_checked(n) else {
            return Err(Malformed::new(at, format!("{n} bytes"), format!("{} bytes", self.bytes.len())));
        };
        self.bytes = tail;
        Ok(head)
    }

    field!(u8, u8, |b| b[0]);
    field!(u16, u16, LE::read_u16);
    field!(u32, u32, LE::read_u32);
    field!(u64, u64, LE::read_u64);
    field!(u128, u128, LE::read_u128);
    field!(i128, i128, LE::read_i128);
    field!(f32, f32, LE::read_f32);
    field!(f64, f64, LE::read_f64);

    /// An unsigned LEB128 integer: seven bits a byte, lowest first, the high bit set on all but the
    /// last.
    pub(crate) fn varint(&mut self, at: &'static str) -> Result<u64, Malformed> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = self.u8(at)?;
            let bits = u64::from(byte & 0x7f);
            if bits << shift >> shift != bits {
                break;
            }
            value |= bits << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(Malformed::new(at, "an integer of at most 64 bits", "a longer one"))
    }

    /// A [`Cursor::varint`] that must fit 32 bits.
    pub(crate) fn varint32(&mut self, at: &'static str) -> Result<u32, Malformed> {
        let v = self.varint(at)?;
        u32::try_from(v).map_err(|_| Malformed::new(at, "an integer of at most 32 bits", v.to_string()))
    }

    /// Nothing may follow the last field.
    pub(crate) fn end(&self, at: &'static str) -> Result<(), Malformed> {
        if self.bytes.is_empty() {
            return Ok(());
        }
        Err(Malformed::new(at, "the end of the block", format!("{} more bytes", self.bytes.len())))
    }
}

/// Appends an unsigned LEB128 integer.
pub(crate) fn put_varint(out: &mut Vec<u8>, mut v: u64) {
    while v >= 0x80 {
        out.push(v as u8 | 0x80);
        v >>= 7;
    }
    out.push(v as u8);
}

/// Decompresses a zstd frame whose size the format bounds: nothing larger than `most` is allocated.
pub(crate) fn unzstd(bytes: &[u8], most: usize, at: &'static str) -> Result<Vec<u8>, Malformed> {
    let Ok(Some(bound)) = zstd::zstd_safe::get_frame_content_size(bytes) else {
        return Err(Malformed::new(at, "a zstd frame that tells its size", "something else"));
    };
    if bound > most as u64 {
        return Err(Malformed::new(at, format!("at most {most} bytes"), format!("{bound} bytes")));
    }
    unpack(bytes, bound as usize).map_err(|e| Malformed::new(at, "a zstd frame", format!("damage: {e}")))
}

/// Decompresses with what the thread has for that: to make one takes longer than most frames.
fn unpack(bytes: &[u8], bound: usize) -> std::io::Result<Vec<u8>> {
    thread_local! {
        static UNPACKER: RefCell<Option<Decompressor<'static>>> = const { RefCell::new(None) };
    }
    UNPACKER.with_borrow_mut(|unpacker| match unpacker {
        Some(unpacker) => unpacker.decompress(bytes, bound),
        None => unpacker.insert(Decompressor::new()?).decompress(bytes, bound),
    })
}

/// Compresses with zstd at `level`, to a frame that states its size and has no checksum of its own.
pub(crate) fn to_zstd(bytes: &[u8], level: i32) -> Vec<u8> {
    zstd::bulk::compress(bytes, level).expect("compressing memory to memory cannot fail")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn varints_come_back_and_bad_ones_do_not() {
        let mut bytes = vec![];
        let values: Vec<u64> = (0..64).flat_map(|s| [1u64 << s, (1u64 << s) - 1]).chain([u64::MAX]).collect();
        values.iter().for_each(|&v| put_varint(&mut bytes, v));
        let mut c = Cursor::new(&bytes);
        for &v in &values {
            assert_eq!(c.varint("v"), Ok(v));
        }
        c.end("v").unwrap();
        for bad in [vec![0xff; 11], vec![0x80; 3], vec![], [vec![0xff; 9], vec![2]].concat()] {
            assert!(Cursor::new(&bad).varint("v").is_err(), "{bad:?}");
        }
        assert!(Cursor::new(&[0xff, 0xff, 0xff, 0xff, 0x10]).varint32("v").is_err());
    }

    #[test]
    fn a_zstd_frame_that_claims_too_much_is_refused() {
        let frame = to_zstd(&[7; 10_000], 1);
        assert_eq!(unzstd(&frame, 10_000, "f").unwrap(), vec![7; 10_000]);
        assert!(unzstd(&frame, 9_999, "f").is_err());
        assert!(unzstd(&frame[..frame.len() - 1], 10_000, "f").is_err());
    }
}
