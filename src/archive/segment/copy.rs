//! A copy of a segment, made while it is compared with what is known of it.

use super::frame::{header_plan, read_footer};
use super::read::at_frame;
use super::{FOOTER_BYTES, HEADER_BYTES, PlanHash, SegmentInfo};
use isospan_io::bytes::plain::open_plain;
use isospan_io::error::{Error, Fault, Result};
use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use xxhash_rust::xxh3::Xxh3Default;

/// What is known of a segment that is copied.
pub(crate) enum Known {
    /// What the manifest says of it.
    Info(SegmentInfo),
    /// The plan that it belongs to; the rest is in its own footer.
    Plan(PlanHash),
}

/// What was copied.
#[derive(Clone, Debug)]
pub struct Copied {
    /// Length of the file.
    pub bytes: u64,
    /// XXH3 (64 bits) of all its bytes.
    pub hash: u64,
}

/// Copies a segment, which must be a regular file with the contents that are known. The copy is
/// synced. Bytes that come later than the known length are not read.
///
/// # Errors
/// [`Error::BadInput`] for anything else at its name; [`Error::Io`].
pub(crate) fn copy_segment(
    from: &Path,
    to: &Path,
    known: &Known,
    check: &dyn Fn() -> Result<()>,
) -> Result<Copied> {
    let file = open_plain(from, File::options().read(true)).map_err(|e| Error::io("copy", from, e))?;
    let bytes = file.metadata().map_err(|e| Error::io("read the length of", from, e))?.len();
    let differs = |at: &str, expected: String, got: String| {
        Err(Error::bad_input(from, at, expected, got).of_fault(Fault::Checksum))
    };
    if let Known::Info(info) = known
        && info.bytes != bytes
    {
        return differs("length", format!("{} bytes, as the manifest says", info.bytes), format!("{bytes}"));
    }
    if bytes < HEADER_BYTES + FOOTER_BYTES {
        return differs("length", "a whole segment of an archive".into(), format!("{bytes} bytes"));
    }
    let mut out = File::create_new(to).map_err(|e| Error::io("create", to, e))?;
    let mut read = Read::take(&file, bytes);
    let (mut head, mut foot) = ([0; HEADER_BYTES as usize], [0; FOOTER_BYTES as usize]);
    let (mut content, mut all) = (Xxh3Default::new(), Xxh3Default::new());
    let mut put = |part: &[u8]| {
        all.update(part);
        out.write_all(part).map_err(|e| Error::io("write", to, e))
    };
    let failed = |e| Error::io("read", from, e);
    read.read_exact(&mut head).map_err(failed)?;
    content.update(&head);
    put(&head)?;
    let (mut left, mut piece) = (bytes - HEADER_BYTES - FOOTER_BYTES, vec![0; 1 << 20]);
    while left > 0 {
        check()?;
        let part = &mut piece[..left.min(1 << 20) as usize];
        read.read_exact(part).map_err(failed)?;
        content.update(part);
        put(part)?;
        left -= part.len() as u64;
    }
    read.read_exact(&mut foot).map_err(failed)?;
    put(&foot)?;
    let (info, _) = read_footer(&foot, bytes).map_err(|m| at_frame(m, from, "footer"))?;
    let text = |info: SegmentInfo| format!("{} blocks, {:016x}", info.blocks, info.content_hash);
    let found = SegmentInfo { content_hash: content.digest(), ..info };
    let expected = if let Known::Info(info) = known { *info } else { info };
    if found != expected {
        return differs("contents", text(expected), text(found));
    }
    if let Known::Plan(plan) = known
        && header_plan(&head) != Some(*plan)
    {
        return differs("header: plan hash", plan.to_string(), "another".into());
    }
    out.sync_all().map_err(|e| Error::io("sync", to, e))?;
    Ok(Copied { bytes, hash: all.digest() })
}
