//! Reads stored data from the front.

use super::Decoded;
use byteorder::{BE, ByteOrder};

/// Takes numbers, the highest byte first, and bytes from the front of what is stored.
pub(super) struct Front<'a>(pub(super) &'a [u8]);

impl<'a> Front<'a> {
    pub(super) fn bytes(&mut self, count: usize) -> Decoded<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(count).ok_or("data that are cut short")?;
        self.0 = rest;
        Ok(bytes)
    }

    pub(super) fn u32(&mut self) -> Decoded<usize> {
        Ok(BE::read_u32(self.bytes(4)?) as usize)
    }

    /// A number of bytes to be decoded.
    pub(super) fn size(&mut self, limit: usize) -> Decoded<usize> {
        let size = BE::read_u64(self.bytes(8)?);
        usize::try_from(size).ok().filter(|&n| n <= limit).ok_or_else(|| format!("{size} bytes"))
    }
}
