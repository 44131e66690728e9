//! Where the files of a Zarr store are: in a folder, on a server, or in a zip archive, which is one
//! file of either.
//!
//! A name in an archive continues that of the archive: `image.zarr.zip/0/c/1/2/3`. Members are
//! stored or deflated, shards stored, so that they can be read by ranges. Of an archive on a server
//! the directory is fetched, then a member in one request.
//!
//! An archive stays open as long as a volume uses it. Memory: 16 bytes a member; on a server, the
//! directory too.

use crate::bytes::remote::is_remote;
use crate::bytes::{ByteSource, IoMode, place};
use crate::error::{Error, Fault, Result};
use crate::formats::shared::codec::read_to_end;
use crate::formats::shared::has_suffix;
use crate::formats::shared::zip::{Directory, Stored, ZipMember};
use flate2::Crc;
use flate2::bufread::DeflateDecoder;
use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant, SystemTime};
use xxhash_rust::xxh3::xxh3_64;

/// Most members of an archive.
const MOST_MEMBERS: usize = 1 << 24;
/// For so long an archive that nobody holds is taken for what it was.
const LAST_FOR: Duration = Duration::from_secs(5);
/// Bytes of the local header of a member after its name that are fetched with it. Most have fewer.
const EXTRA: u64 = 256;

/// A file of a store, or the part of an archive that it is.
pub(super) struct StorePart {
    source: Arc<ByteSource>,
    range: Range<u64>,
}

impl StorePart {
    fn whole(source: ByteSource) -> Self {
        let range = 0..source.len();
        Self { source: Arc::new(source), range }
    }

    pub(super) fn len(&self) -> u64 {
        self.range.end - self.range.start
    }

    /// The file's name, for messages.
    pub(super) fn path(&self) -> &Path {
        self.source.path()
    }

    /// As [`ByteSource::view`], which [`StorePart::check`] follows.
    pub(super) fn view<'a>(&'a self, range: Range<u64>, buffer: &'a mut Vec<u8>) -> Result<&'a [u8]> {
        if range.start > range.end || range.end > self.len() {
            let got = format!("{} bytes of it", self.len());
            return Err(Error::bad_input(self.path(), "end", format!("{} bytes", range.end), got)
                .with_help("the file is damaged or cut short; fetch it again"));
        }
        let start = self.range.start;
        self.source.view(start + range.start..start + range.end, buffer)
    }

    pub(super) fn check(&self) -> Result<()> {
        self.source.check()
    }
}

/// An archive that is open.
#[derive(Debug)]
pub(super) struct Zip {
    source: Arc<ByteSource>,
    directory: Directory,
    /// Hashes of names, and where in the directory the members are.
    by_name: Vec<(u64, u64)>,
    /// Length and time of change, of a file on this machine.
    state: State,
    opened: Instant,
}

/// Archives that are open, and the one opened last, which is needed several times when a volume is
/// opened: it stays open for some seconds, or until it is asked for another time.
#[derive(Default)]
struct Open {
    all: Vec<(PathBuf, Weak<Zip>)>,
    last: Option<Arc<Zip>>,
}

type State = Option<(u64, Option<SystemTime>)>;

/// The archive that a path names or leads into, and the name in it.
pub(super) fn archive_in(path: &Path) -> Option<(&Path, &Path)> {
    let is_archive = |p: &&Path| has_suffix(p, &[".zip", ".ozx"]) && (is_remote(p) || p.is_file());
    let archive = path.ancestors().filter(is_archive).last()?;
    Some((archive, path.strip_prefix(archive).ok()?))
}

/// Opens the archive that a path names or leads into: it stays open as long as it is held.
pub(super) fn held(path: &Path, io: IoMode) -> Result<Option<Arc<Zip>>> {
    archive_in(path).map(|(archive, _)| Zip::open(archive, io)).transpose()
}

/// All bytes of a small file; `None` where there is none.
pub(super) fn read_if_there(path: &Path, most: u64) -> Result<Option<Vec<u8>>> {
    let Some((archive, name)) = archive_in(path) else { return place::read_if_there(path, most) };
    let Some(part) = Zip::open(archive, IoMode::Auto)?.whole(name, most)? else { return Ok(None) };
    let (mut buffer, len) = (vec![], part.len());
    if len > most {
        return Err(too_long(path, len, most));
    }
    let bytes = part.view(0..len, &mut buffer)?.to_vec();
    part.check()?;
    Ok(Some(bytes))
}

/// A file of which all bytes are needed, at most `most` where they have to be fetched or unpacked;
/// `None` where there is none.
pub(super) fn open_if_there(path: &Path, io: IoMode, most: u64) -> Result<Option<StorePart>> {
    match archive_in(path) {
        Some((archive, name)) => Zip::open(archive, io)?.whole(name, most),
        None => Ok(place::open_if_there(path, io, most)?.map(StorePart::whole)),
    }
}

/// A file that is read by ranges; `None` where there is none.
pub(super) fn ranges_if_there(path: &Path, io: IoMode) -> Result<Option<StorePart>> {
    match archive_in(path) {
        Some((archive, name)) => Zip::open(archive, io)?.ranges(name),
        None => Ok(place::ranges_if_there(path, io)?.map(StorePart::whole)),
    }
}

/// Whether a file is there.
pub(super) fn exists(path: &Path) -> Result<bool> {
    match archive_in(path) {
        Some((archive, name)) => Ok(Zip::open(archive, IoMode::Auto)?.member(name)?.is_some()),
        None => place::exists(path),
    }
}

/// The names of the folders in a folder.
pub(super) fn folders_in(path: &Path) -> Result<Vec<String>> {
    match archive_in(path) {
        Some((archive, name)) => Zip::open(archive, IoMode::Auto)?.folders(name),
        None => place::folders_in(path),
    }
}

fn too_long(path: &Path, len: u64, most: u64) -> Error {
    Error::bad_input(path, "length", format!("at most {most} bytes"), format!("{len} bytes"))
}

/// The name of a member as an archive has it.
fn text(name: &Path) -> String {
    let parts = name.components().map(|c| c.as_os_str().to_string_lossy());
    parts.collect::<Vec<_>>().join("/")
}

impl Zip {
    fn open(path: &Path, io: IoMode) -> Result<Arc<Self>> {
        static OPEN: LazyLock<Mutex<Open>> = LazyLock::new(Mutex::default);
        let about = if is_remote(path) { None } else { std::fs::metadata(path).ok() };
        let state = about.map(|about| (about.len(), about.modified().ok()));
        let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
        open.last = open.last.take().filter(|last| last.opened.elapsed() < LAST_FOR);
        open.all.retain(|(_, zip)| zip.strong_count() > 0);
        let known = open.all.iter().filter(|(at, _)| at == path).filter_map(|(_, zip)| zip.upgrade());
        if let Some(zip) = known.into_iter().find(|zip| zip.state == state) {
            return Ok(zip);
        }
        let zip = Arc::new(Self::read(path, io, state)?);
        open.all.push((path.to_path_buf(), Arc::downgrade(&zip)));
        open.last = Some(Arc::clone(&zip));
        Ok(zip)
    }

    fn read(path: &Path, io: IoMode, state: State) -> Result<Self> {
        let source = ByteSource::open(path, io)?;
        let (directory, mut by_name) = (Directory::of(&source)?, vec![]);
        directory.each(&source, |at, name| {
            if by_name.len() <= MOST_MEMBERS {
                by_name.push((xxh3_64(name), at));
            }
        })?;
        if by_name.len() > MOST_MEMBERS {
            let (expected, got) = (format!("at most {MOST_MEMBERS} members"), "more");
            return Err(Error::bad_input(path, "zip directory", expected, got)
                .with_help("unpack it, or write the array in larger chunks or in shards"));
        }
        by_name.sort_unstable();
        source.check()?;
        Ok(Self { source: Arc::new(source), directory, by_name, state, opened: Instant::now() })
    }

    /// The member of a name; the last one, where it was written again.
    fn member(&self, name: &Path) -> Result<Option<ZipMember>> {
        let name = text(name);
        let hash = xxh3_64(name.as_bytes());
        let first = self.by_name.partition_point(|&(h, _)| h < hash);
        let mut found = None;
        for &(_, at) in self.by_name[first..].iter().take_while(|&&(h, _)| h == hash) {
            let member = self.directory.member(&self.source, at)?;
            if member.name == name {
                found = Some(member);
            }
        }
        Ok(found)
    }

    /// All bytes of a member: as they lie in the archive, or unpacked, or fetched.
    fn whole(&self, name: &Path, most: u64) -> Result<Option<StorePart>> {
        let Some(member) = self.member(name)? else { return Ok(None) };
        // On a server its header comes in the same request, as far as it can be told.
        let fetched = if self.source.is_remote() { member.around(EXTRA, self.source.len()) } else { 0..0 };
        if fetched.end - fetched.start > most.saturating_add(EXTRA + (1 << 16)) {
            return Err(too_long(&self.path_of(&member), fetched.end - fetched.start, most));
        }
        let mut around = vec![0; (fetched.end - fetched.start) as usize];
        self.source.read_at(fetched.start, &mut around)?;
        let stored = member.stored(&self.source, &around)?;
        let (bytes, mut buffer) = (stored.bytes.clone(), vec![]);
        let view = match fetched.start <= bytes.start && bytes.end <= fetched.end {
            true => &around[(bytes.start - fetched.start) as usize..(bytes.end - fetched.start) as usize],
            false if bytes.end - bytes.start > most => {
                return Err(too_long(&self.path_of(&member), bytes.end - bytes.start, most));
            }
            false => self.source.view(bytes.clone(), &mut buffer)?,
        };
        if !stored.deflated && self.source.at_hand(bytes.clone()).is_some() {
            self.check_sum(&member, &stored, view)?;
            self.source.check()?;
            return Ok(Some(StorePart { source: Arc::clone(&self.source), range: bytes }));
        }
        if stored.len > most {
            return Err(too_long(&self.path_of(&member), stored.len, most));
        }
        let mut out = vec![];
        match stored.deflated {
            true => read_to_end(DeflateDecoder::new(view), stored.len as usize, &mut out)
                .map_err(|got| Error::bad_input(self.path_of(&member), "member", "good deflate data", got))?,
            false => out.extend_from_slice(view),
        }
        self.source.check()?;
        self.check_sum(&member, &stored, &out)?;
        Ok(Some(StorePart::whole(ByteSource::from_vec(self.path_of(&member), out))))
    }

    fn path_of(&self, member: &ZipMember) -> PathBuf {
        self.source.path().join(&member.name)
    }

    fn check_sum(&self, member: &ZipMember, stored: &Stored, bytes: &[u8]) -> Result<()> {
        let mut sum = Crc::new();
        sum.update(bytes);
        if bytes.len() as u64 == stored.len && sum.sum() == stored.crc32 {
            return Ok(());
        }
        let got = format!("{} bytes with another one", bytes.len());
        let expected = format!("{} bytes with the CRC-32 of the zip directory", stored.len);
        Err(Error::bad_input(self.path_of(member), "member", expected, got)
            .of_fault(Fault::Checksum)
            .with_help("the archive is damaged; fetch it again"))
    }

    /// A member where it lies in the archive.
    fn ranges(&self, name: &Path) -> Result<Option<StorePart>> {
        let Some(member) = self.member(name)? else { return Ok(None) };
        let stored = member.stored(&self.source, &[])?;
        if stored.deflated {
            return Err(Error::bad_input(
                self.path_of(&member),
                "member",
                "a stored shard",
                "a deflated one",
            )
            .with_help("zip it again without compression (zip -0), or unpack it"));
        }
        Ok(Some(StorePart { source: Arc::clone(&self.source), range: stored.bytes }))
    }

    fn folders(&self, folder: &Path) -> Result<Vec<String>> {
        let prefix = text(folder);
        let mut found = BTreeSet::new();
        self.directory.each(&self.source, |_, name| {
            let inside = name.strip_prefix(prefix.as_bytes());
            let inside = if prefix.is_empty() { inside } else { inside.and_then(|n| n.strip_prefix(b"/")) };
            let Some((first, _)) = inside.and_then(|n| std::str::from_utf8(n).ok()?.split_once('/')) else {
                return;
            };
            if !found.contains(first) {
                found.insert(first.to_owned());
            }
        })?;
        Ok(found.into_iter().collect())
    }
}

/// Whether the store in an archive lies in a folder of it, where it is not looked for.
///
/// # Errors
/// [`Error::BadInput`] where it does.
pub(super) fn refuse_folder(archive: &Path, names: &[&str]) -> Result<()> {
    let zip = Zip::open(archive, IoMode::Auto)?;
    let [mut found, mut other] = [false; 2];
    zip.directory.each(&zip.source, |_, name| {
        let is_metadata = |part: &[u8]| names.iter().any(|n| n.as_bytes() == part);
        let mut parts = name.split(|&b| b == b'/').rev();
        let last = parts.next().unwrap_or_default();
        found |= is_metadata(last) && parts.next().is_some();
        other |= last.ends_with(b".npy");
    })?;
    if !found || other {
        return Ok(());
    }
    let expected = format!("one of {} at the top of the archive", names.join(", "));
    Err(Error::bad_input(archive, "members", expected, "one in a folder of it").with_help(
        "zip what is in the folder, not the folder: cd image.zarr && zip -0 -r ../image.zarr.zip .",
    ))
}
