//! A zip archive that is written front to back.
//!
//! ```text
//!  PK 3 4 | name | member, deflated | PK 7 8 | checksum, sizes       for each member
//!  PK 1 2 | … name                                                   the directory
//!  PK 6 6, PK 6 7, PK 5 6                                            its end, in 64 bits
//! ```
//!
//! Checksum and sizes are known behind a member, so they lie there (a data descriptor), in 64 bits.
//! No member has a time: the same members are the same bytes.
//!
//! The format: PKWARE's APPNOTE.TXT 6.3.10, sections 4.3 to 4.5.

use flate2::write::DeflateEncoder;
use flate2::{Compression, Crc};
use isospan_io::error::{Error, Result};
use isospan_io::formats::shared::sink::Sink;
use std::io::Write;

/// Version 4.5 of the format, which has sizes of 64 bits.
const VERSION: u16 = 45;
/// Sizes follow the member; names are UTF-8.
const FLAGS: u16 = 0x0808;
const DEFLATED: u16 = 8;
/// 1 January 1980, the first day that the format has.
const DATE: u16 = 0x21;
/// What stands where the 64 bits are elsewhere.
const ELSEWHERE: u32 = u32::MAX;
/// Bytes that are handed on at a time.
const HANDED_ON: usize = 1 << 16;

/// A member that is complete.
struct WrittenMember {
    name: &'static str,
    crc: u32,
    packed: u64,
    bytes: u64,
    at: u64,
}

/// A member that is being written.
struct Open {
    name: &'static str,
    at: u64,
    crc: Crc,
    bytes: u64,
    packed: u64,
    encoder: DeflateEncoder<Vec<u8>>,
}

/// An archive that is being written.
#[derive(Default)]
pub(super) struct Zip {
    members: Vec<WrittenMember>,
    open: Option<Open>,
    /// Bytes before the next one.
    at: u64,
}

impl Zip {
    fn write(&mut self, sink: &mut Sink<'_>, bytes: &[u8]) -> Result<()> {
        self.at += bytes.len() as u64;
        sink.put(bytes)
    }

    /// Adds a member.
    pub(super) fn add(&mut self, sink: &mut Sink<'_>, name: &'static str, bytes: &[u8]) -> Result<()> {
        self.begin(sink, name)?;
        self.put(sink, bytes)?;
        self.end(sink)
    }

    /// Begins a member.
    pub(super) fn begin(&mut self, sink: &mut Sink<'_>, name: &'static str) -> Result<()> {
        let at = self.at;
        let mut head = b"PK\x03\x04".to_vec();
        [VERSION, FLAGS, DEFLATED, 0, DATE].iter().for_each(|n| head.extend(n.to_le_bytes()));
        // Checksum and sizes come later; the extra field says that they have 64 bits.
        head.extend([0; 4]);
        head.extend(ELSEWHERE.to_le_bytes().repeat(2));
        head.extend((name.len() as u16).to_le_bytes());
        head.extend(20u16.to_le_bytes());
        head.extend(name.as_bytes());
        [1u16, 16].iter().for_each(|n| head.extend(n.to_le_bytes()));
        head.extend([0; 16]);
        self.write(sink, &head)?;
        let encoder = DeflateEncoder::new(vec![], Compression::default());
        self.open = Some(Open { name, at, crc: Crc::new(), bytes: 0, packed: 0, encoder });
        Ok(())
    }

    /// Appends bytes to the member.
    pub(super) fn put(&mut self, sink: &mut Sink<'_>, bytes: &[u8]) -> Result<()> {
        let Some(open) = &mut self.open else { return Ok(()) };
        open.crc.update(bytes);
        open.bytes += bytes.len() as u64;
        open.encoder.write_all(bytes).map_err(|e| Error::io("compress for", sink.target(), e))?;
        if open.encoder.get_ref().len() < HANDED_ON {
            return Ok(());
        }
        let packed = std::mem::take(open.encoder.get_mut());
        open.packed += packed.len() as u64;
        self.write(sink, &packed)
    }

    /// Ends the member.
    pub(super) fn end(&mut self, sink: &mut Sink<'_>) -> Result<()> {
        let Some(open) = self.open.take() else { return Ok(()) };
        let rest = open.encoder.finish().map_err(|e| Error::io("compress for", sink.target(), e))?;
        let (crc, bytes) = (open.crc.sum(), open.bytes);
        let member = WrittenMember {
            name: open.name,
            crc,
            packed: open.packed + rest.len() as u64,
            bytes,
            at: open.at,
        };
        self.write(sink, &rest)?;
        let mut tail = b"PK\x07\x08".to_vec();
        tail.extend(crc.to_le_bytes());
        [member.packed, member.bytes].iter().for_each(|n| tail.extend(n.to_le_bytes()));
        self.members.push(member);
        self.write(sink, &tail)
    }

    /// Ends the archive.
    pub(super) fn finish(mut self, sink: &mut Sink<'_>) -> Result<()> {
        let (at, mut directory) = (self.at, vec![]);
        for member in &self.members {
            directory.extend(b"PK\x01\x02");
            [VERSION, VERSION, FLAGS, DEFLATED, 0, DATE]
                .iter()
                .for_each(|n| directory.extend(n.to_le_bytes()));
            directory.extend(member.crc.to_le_bytes());
            directory.extend(ELSEWHERE.to_le_bytes().repeat(2));
            directory.extend((member.name.len() as u16).to_le_bytes());
            directory.extend(28u16.to_le_bytes());
            // No comment, disk 0, no attributes.
            directory.extend([0; 10]);
            directory.extend(ELSEWHERE.to_le_bytes());
            directory.extend(member.name.as_bytes());
            [1u16, 24].iter().for_each(|n| directory.extend(n.to_le_bytes()));
            [member.bytes, member.packed, member.at].iter().for_each(|n| directory.extend(n.to_le_bytes()));
        }
        let (count, size) = (self.members.len() as u64, directory.len() as u64);
        let end = at + size;
        directory.extend(b"PK\x06\x06");
        directory.extend(44u64.to_le_bytes());
        directory.extend(VERSION.to_le_bytes().repeat(2));
        directory.extend([0; 8]);
        [count, count, size, at].iter().for_each(|n| directory.extend(n.to_le_bytes()));
        directory.extend(b"PK\x06\x07");
        directory.extend([0; 4]);
        directory.extend(end.to_le_bytes());
        directory.extend(1u32.to_le_bytes());
        directory.extend(b"PK\x05\x06");
        directory.extend([0; 4]);
        directory.extend((count as u16).to_le_bytes().repeat(2));
        directory.extend((size as u32).to_le_bytes());
        directory.extend(ELSEWHERE.to_le_bytes());
        directory.extend([0; 2]);
        self.write(sink, &directory)
    }
}
