//! A manifest's bytes: its JSON as one zstd frame, and a checksum of that behind it.
//!
//! The frame is compressed with a dictionary, a constant of the format: of a small archive the
//! names of the members would be most of all bytes. The checksum is a frame that zstd skips.

use isospan_io::error::{Error, Fault, Result};
use std::io::{Read, Write};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

/// Text that manifests are likely to have, the likeliest last.
pub const MANIFEST_DICTIONARY: &[u8] = include_bytes!("dictionary.txt");
/// Begins the frame of the checksum: that zstd skips it, and that it has 8 bytes (RFC 8878).
const SKIPPED: [u8; 8] = [0x50, 0x2a, 0x4d, 0x18, 8, 0, 0, 0];

/// The most bytes of the JSON of a manifest of so many bytes. Checksums of segments do not
/// compress.
fn most(packed: u64) -> u64 {
    (1 << 20) + packed.saturating_mul(100).min(super::LARGEST_MANIFEST)
}

/// The bytes of a manifest.
///
/// # Panics
/// Never: memory takes all that is written.
pub fn pack_manifest(json: &str) -> Vec<u8> {
    // The last levels take seconds where there are thousands of segments.
    let level = if json.len() < 1 << 20 { 19 } else { 6 };
    let packed = zstd::Encoder::with_dictionary(Vec::new(), level, MANIFEST_DICTIONARY).and_then(|mut e| {
        e.include_contentsize(false)?;
        e.set_pledged_src_size(Some(json.len() as u64))?;
        e.write_all(json.as_bytes())?;
        e.finish()
    });
    let mut packed = packed.expect("memory takes all that is written");
    let sum = xxh3_64(&packed).to_le_bytes();
    packed.extend([SKIPPED, sum].concat());
    packed
}

/// The JSON of a manifest.
///
/// # Errors
/// When it is damaged, or has more than any manifest of its length.
pub(super) fn unpack(bytes: &[u8], path: &Path) -> Result<Vec<u8>> {
    let bad = |at: &str, got: String| {
        Error::bad_input(path, at, "the manifest of an isospan archive", got).of_fault(Fault::Checksum).with_help(
            "the manifest was damaged or edited: restore it, or delete it and run the same reduction again",
        )
    };
    let Some((frame, end)) = bytes.split_last_chunk::<16>() else {
        return Err(bad("length", format!("{} bytes", bytes.len())));
    };
    if *end != *[SKIPPED, xxh3_64(frame).to_le_bytes()].concat() {
        return Err(bad("checksum", "another or none".into()));
    }
    let (mut json, most) = (Vec::new(), most(bytes.len() as u64));
    let of_zstd = |e: std::io::Error| bad("zstd frame", e.to_string());
    let frame = zstd::Decoder::with_dictionary(frame, MANIFEST_DICTIONARY).map_err(of_zstd)?;
    frame.take(most + 1).read_to_end(&mut json).map_err(of_zstd)?;
    if json.len() as u64 > most {
        return Err(bad("zstd frame", format!("more than {most} bytes of {}", bytes.len())));
    }
    Ok(json)
}
