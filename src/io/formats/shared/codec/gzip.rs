//! Decodes gzip: members one after another, and what may follow the last one.
//!
//! ```text
//!  | header, deflated bytes, checksum, length | another member … | zeros, or other bytes |
//! ```
//!
//! As Python and gzip do, zeros between and after members are passed over. What is no member ends
//! the data, since all samples may be there: who needs more finds them missing. A member must be
//! whole, its checksum included.
//!
//! The format: RFC 1952.

use flate2::bufread::GzDecoder;
use std::io::{self, BufRead, ErrorKind, Read};

/// The decoded bytes of all members.
pub(in crate::formats) struct Members<R> {
    /// The current one; `None` after the last.
    member: Option<GzDecoder<R>>,
    is_first: bool,
}

impl<R: BufRead> Members<R> {
    pub(in crate::formats) fn new(stored: R) -> Self {
        Self { member: Some(GzDecoder::new(stored)), is_first: true }
    }
}

impl<R: BufRead> Read for Members<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        while let Some(mut member) = self.member.take_if(|_| !out.is_empty()) {
            match member.read(out) {
                Ok(0) => self.member = next(member.into_inner())?,
                Err(e) if !self.is_first && is_no_member(&member, &e) => return Ok(0),
                read => {
                    self.member = Some(member);
                    return read;
                }
            }
            self.is_first = false;
        }
        Ok(0)
    }
}

/// The first byte of a member.
const BEGIN: u8 = 0x1f;

/// Whether the bytes after a member do not begin another one.
fn is_no_member<R: BufRead>(member: &GzDecoder<R>, why: &io::Error) -> bool {
    member.header().is_none() && why.kind() == ErrorKind::InvalidInput
}

/// The member that begins after zeros, if anything follows.
fn next<R: BufRead>(mut stored: R) -> io::Result<Option<GzDecoder<R>>> {
    loop {
        let bytes = stored.fill_buf()?;
        let (zeros, first) = match bytes.iter().position(|&b| b != 0) {
            Some(at) => (at, Some(bytes[at])),
            None => (bytes.len(), None),
        };
        let is_over = first.is_some() || bytes.is_empty();
        stored.consume(zeros);
        if is_over {
            return Ok((first == Some(BEGIN)).then(|| GzDecoder::new(stored)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::BufReader;

    /// What Python's `gzip.compress(b"first ", mtime=0)` gives, and the same of `b"second"`.
    #[rustfmt::skip]
    const FIRST: [u8; 26] = [
        0x1f, 0x8b, 0x08, 0x00, 0x00, 0x00, 0x00, 0x00, 0x02, 0x03, 0x4b, 0xcb, 0x2c,
        0x2a, 0x2e, 0x51, 0x00, 0x00, 0xfc, 0x7a, 0xf1, 0x1c, 0x06, 0x00, 0x00, 0x00,
    ];
    #[rustfmt::skip]
    const SECOND: [u8; 26] = [
        0x1f, 0x8b, 0x08, 0x00, 0x00, 0x00, 0x00, 0x00, 0x02, 0x03, 0x2b, 0x4e, 0x4d,
        0xce, 0xcf, 0x4b, 0x01, 0x00, 0x69, 0x11, 0x1f, 0xb6, 0x06, 0x00, 0x00, 0x00,
    ];

    fn decoded(parts: &[&[u8]]) -> io::Result<Vec<u8>> {
        let (stored, mut out) = (parts.concat(), vec![]);
        // Small buffers: members and zeros go across their ends.
        Members::new(BufReader::with_capacity(3, &stored[..])).read_to_end(&mut out).map(|_| out)
    }

    #[test]
    fn what_follows_the_last_member_is_no_obstacle() {
        let both = b"first second".to_vec();
        for (parts, expected) in [
            (&[&FIRST[..], &SECOND][..], &both),
            (&[&FIRST, &[0; 700], &SECOND, &[0; 512]], &both),
            (&[&FIRST, &SECOND, b"other bytes"], &both),
            (&[&FIRST, &SECOND, &[0; 5], b"other bytes"], &both),
            (&[&FIRST, b"other bytes", &SECOND], &b"first ".to_vec()),
            (&[&FIRST, &SECOND, b"few"], &both),
            (&[&FIRST, &SECOND, b"\x1fno member"], &both),
        ] {
            assert_eq!(decoded(parts).unwrap(), *expected);
        }
    }

    #[test]
    fn members_must_be_whole() {
        for cut in 1..FIRST.len() {
            assert!(decoded(&[&FIRST[..cut]]).is_err(), "{cut}");
            // One that begins must be there.
            assert!(decoded(&[&FIRST, &SECOND[..cut]]).is_err(), "{cut}");
        }
        for at in [18, 25] {
            let mut damaged = SECOND;
            damaged[at] ^= 1;
            assert!(decoded(&[&FIRST, &damaged]).is_err(), "{at}");
        }
        assert!(decoded(&[b"no member"]).is_err());
        assert!(decoded(&[&[0; 9], &FIRST]).is_err(), "zeros before the first member are no padding");
    }
}
