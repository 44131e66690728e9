//! Compresses arrays in blocks of 1 MiB: on several threads the bytes are those of one.
//!
//! A block is compressed alone. Where the format has one stream, the blocks are flushed to whole
//! bytes and follow each other in it.

use crate::error::{Error, Result};
use crate::exec::CancelToken;
use flate2::write::ZlibEncoder;
use flate2::{Compress, Compression, Crc, FlushCompress};
use rayon::prelude::*;
use std::io::{self, Write};

/// Bytes that are compressed together.
pub(super) const BLOCK: usize = 1 << 20;
/// Blocks that are compressed at a time.
const BLOCKS: usize = 8;

/// What compressed bytes look like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stream {
    /// A zlib stream for each block, as VTK has them.
    Blocks,
    /// One zlib stream.
    Zlib,
    /// One gzip stream.
    Gzip,
}

/// An array as it is stored.
#[derive(Clone, Debug)]
pub(super) struct Packed {
    /// Its bytes.
    pub(super) plain: u64,
    /// Bytes of each compressed block, or of the whole stream; none where it is not compressed.
    pub(super) blocks: Vec<u64>,
}

impl Packed {
    /// An array that is not compressed.
    pub(super) fn plain(bytes: u64) -> Self {
        Self { plain: bytes, blocks: vec![] }
    }

    /// Whether it is compressed.
    pub(super) fn is_packed(&self) -> bool {
        !self.blocks.is_empty()
    }

    /// Bytes that it takes.
    pub(super) fn bytes(&self) -> u64 {
        if self.is_packed() { self.blocks.iter().sum() } else { self.plain }
    }
}

/// A compressed block, and what its check sum needs.
struct Block {
    bytes: Vec<u8>,
    crc: Crc,
}

/// How arrays are compressed, and what is said where that fails.
pub(super) struct Packer<'a> {
    pub(super) stream: Stream,
    pub(super) pool: Option<&'a rayon::ThreadPool>,
    pub(super) cancel: &'a CancelToken,
    pub(super) failed: &'a dyn Fn(io::Error) -> Error,
}

impl Packer<'_> {
    /// Compresses what stands before an array and the array.
    pub(super) fn pack(
        &self,
        prefix: &[u8],
        length: u64,
        read: &dyn Fn(u64, &mut [u8]) -> io::Result<()>,
        put: &mut dyn FnMut(&[u8]) -> io::Result<()>,
    ) -> Result<Packed> {
        let Self { stream, pool, cancel, failed } = *self;
        let (mut blocks, mut crc, mut adler) = (vec![], Crc::new(), Adler::default());
        let mut push = |bytes: &[u8]| {
            put(bytes).map_err(failed)?;
            blocks.push(bytes.len() as u64);
            Ok(())
        };
        match stream {
            Stream::Blocks => {}
            Stream::Zlib => push(&[0x78, 0x9c])?,
            // No name, no time; made on any system.
            Stream::Gzip => push(&[0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255])?,
        }
        let total = prefix.len() as u64 + length;
        for start in (0..total).step_by(BLOCK * BLOCKS) {
            cancel.check()?;
            let mut plain = vec![0; (total - start).min((BLOCK * BLOCKS) as u64) as usize];
            // The prefix is shorter than a block.
            let own = if start == 0 { prefix.len().min(plain.len()) } else { 0 };
            plain[..own].copy_from_slice(&prefix[..own]);
            let at = (start + own as u64).saturating_sub(prefix.len() as u64);
            read(at, &mut plain[own..]).map_err(failed)?;
            let make = |block: &[u8]| compressed(stream, block);
            let made: io::Result<Vec<Block>> = match pool {
                Some(pool) => pool.install(|| plain.par_chunks(BLOCK).map(make).collect()),
                None => plain.chunks(BLOCK).map(make).collect(),
            };
            if stream == Stream::Zlib {
                adler.add(&plain);
            }
            for block in made.map_err(failed)? {
                crc.combine(&block.crc);
                push(&block.bytes)?;
            }
        }
        // An empty last block ends a stream.
        match stream {
            Stream::Blocks => {}
            Stream::Zlib => push(&[&[3, 0], &adler.sum().to_be_bytes()[..]].concat())?,
            Stream::Gzip => {
                let sums = [crc.sum().to_le_bytes(), crc.amount().to_le_bytes()].concat();
                push(&[&[3, 0], &sums[..]].concat())?;
            }
        }
        let blocks = if stream == Stream::Blocks { blocks } else { vec![blocks.iter().sum()] };
        Ok(Packed { plain: length, blocks })
    }
}

fn compressed(stream: Stream, block: &[u8]) -> io::Result<Block> {
    let mut crc = Crc::new();
    if stream == Stream::Blocks {
        let mut encoder = ZlibEncoder::new(Vec::with_capacity(block.len() / 2), Compression::default());
        encoder.write_all(block)?;
        return Ok(Block { bytes: encoder.finish()?, crc });
    }
    if stream == Stream::Gzip {
        crc.update(block);
    }
    let (mut encoder, mut bytes) = (Compress::new(Compression::default(), false), vec![]);
    loop {
        bytes.reserve(block.len() / 2 + 1024);
        let done = encoder.total_in() as usize;
        encoder.compress_vec(&block[done..], &mut bytes, FlushCompress::Sync).map_err(io::Error::other)?;
        // Space that is left means that all is flushed.
        if encoder.total_in() as usize == block.len() && bytes.len() < bytes.capacity() {
            return Ok(Block { bytes, crc });
        }
    }
}

/// The check sum of zlib.
struct Adler([u32; 2]);

impl Default for Adler {
    fn default() -> Self {
        Self([1, 0])
    }
}

impl Adler {
    fn add(&mut self, bytes: &[u8]) {
        const PRIME: u32 = 65521;
        let [mut a, mut b] = self.0;
        // So many bytes do not overflow 32 bits.
        for part in bytes.chunks(5552) {
            for &byte in part {
                a += u32::from(byte);
                b += a;
            }
            (a, b) = (a % PRIME, b % PRIME);
        }
        self.0 = [a, b];
    }

    fn sum(&self) -> u32 {
        self.0[1] << 16 | self.0[0]
    }
}
