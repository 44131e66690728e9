//! Arrays that are coded before they are written: they wait in memory and, beyond it, on disk.

use super::encode::{AttributeCoder, PAIRS, TRIANGLES, TriangleCoder};
use crate::surface::weld::BuilderSettings;
use isospan_io::bytes::store::Store;
use isospan_io::error::Result;
use isospan_io::formats::shared::sink::Sink;

/// Bytes of a file begin at a multiple of this.
const ALIGNED: u64 = 4;

/// An array that was coded: its parts, one after another.
pub(super) struct Coded(Vec<Store<u8>>);

impl Coded {
    /// An array of the vertices, of elements of so many bytes, that `write` writes. There is at
    /// least one.
    pub(super) fn attributes(
        stride: u64,
        scratch: &BuilderSettings,
        write: impl FnOnce(&mut Sink<'_>) -> Result<()>,
    ) -> Result<Self> {
        let mut coder = AttributeCoder::new(stride as usize);
        let (mut coded, mut buffer) = (store(scratch), vec![]);
        let mut put = |bytes: &[u8]| {
            buffer.clear();
            coder.put(bytes, &mut buffer);
            coded.extend(&buffer)
        };
        write(&mut Sink::stream(&mut put))?;
        buffer.clear();
        coder.finish(&mut buffer);
        coded.extend(&buffer)?;
        Ok(Self(vec![coded]))
    }

    /// The indices, of so many bytes each, that `write` writes.
    pub(super) fn triangles(
        width: u64,
        scratch: &BuilderSettings,
        write: impl FnOnce(&mut Sink<'_>) -> Result<()>,
    ) -> Result<Self> {
        let (mut coder, width) = (TriangleCoder::new(), width as usize);
        let (mut codes, mut data) = (store(scratch), store(scratch));
        let (mut some_codes, mut some_data) = (vec![], vec![]);
        codes.push(TRIANGLES)?;
        let index = |bytes: &[u8]| bytes.iter().rev().fold(0, |n, &byte| n << 8 | u32::from(byte));
        let mut put = |bytes: &[u8]| {
            some_codes.clear();
            some_data.clear();
            for t in bytes.chunks_exact(3 * width) {
                let triangle = [0, 1, 2].map(|k| index(&t[k * width..][..width]));
                coder.put(triangle, &mut some_codes, &mut some_data);
            }
            codes.extend(&some_codes)?;
            data.extend(&some_data)
        };
        write(&mut Sink::stream(&mut put))?;
        data.extend(&PAIRS)?;
        Ok(Self(vec![codes, data]))
    }

    /// Its bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.0.iter().map(Store::len).sum()
    }

    /// Its bytes in a file, up to where the next one begins.
    pub(super) fn padded_bytes(&self) -> u64 {
        self.bytes().next_multiple_of(ALIGNED)
    }

    /// Writes it, padded.
    pub(super) fn write(&self, sink: &mut Sink<'_>) -> Result<()> {
        self.0.iter().try_for_each(|part| part.each(&mut |bytes| sink.put(bytes)))?;
        sink.put(&[0; ALIGNED as usize][..(self.padded_bytes() - self.bytes()) as usize])
    }
}

fn store(scratch: &BuilderSettings) -> Store<u8> {
    Store::new(scratch.memory_bytes, &scratch.scratch)
}
