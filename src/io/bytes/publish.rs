//! A file that appears whole or not at all.
//!
//! It is written under a temporary name in its final folder, synced and renamed; then the folder is
//! synced. (The folders of an archive's parts are synced once for all parts, before the manifest
//! names them: [`sync_folders`].) The temporary name is unique per host, process and file, so two
//! writers of the same file do not disturb each other: they write the same bytes and the later
//! rename wins. A writer that is dropped unfinished removes its temporary.
//!
//! ```text
//!  .000007.seg.tmp-node12-4711-9f3c21d50ab7e644x3
//!   final name     host   process, random number of it, number of the file in it
//! ```
//!
//! The host's name is followed by the number of the process's name space where that is not the
//! machine's first: containers share host names, and then process numbers too. The random number
//! distinguishes everything that these do not.
//!
//! **What a killed writer leaves** starts with a dot, and no reader looks at it. The next writer of
//! the same file removes it, or continues it ([`Unpublished::adopt`]), if it is certainly dead:
//! made on this host, by a process that is no more, and not locked. A living writer holds a lock on
//! its temporary, where the file system has locks. That covers what a process number cannot show
//! (containers that share a host's name, numbers used again).

use super::plain::{kind_of, names_of, open_plain};
use crate::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// A file being written; see the module.
pub struct Unpublished {
    file: Option<File>,
    /// Bytes that are not written yet: less than [`PIECE`].
    rest: Vec<u8>,
    temporary: PathBuf,
    path: PathBuf,
    keep: bool,
}

/// The mark of a temporary's name, between the final name and host, process and number.
pub const TEMPORARY_MARK: &str = ".tmp-";

/// Bytes that are written at once.
const PIECE: usize = 1 << 18;

/// Whether a file has the name of a temporary, of a writer that runs or is dead.
pub fn is_temporary(path: &Path) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy());
    name.is_some_and(|name| name.starts_with('.') && name.contains(TEMPORARY_MARK))
}

/// This host, in letters that may be part of a file name. Two processes of one host know each other
/// by their numbers.
pub fn host() -> &'static str {
    static HOST: LazyLock<String> = LazyLock::new(find_host);
    &HOST
}

fn find_host() -> String {
    #[cfg(unix)]
    let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
    #[cfg(not(unix))]
    let name = std::env::var("COMPUTERNAME").unwrap_or_default();
    let letter = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = name.chars().map(letter).take(64).collect();
    name + &name_space()
}

/// The number of this process's space of process numbers, where that is not the first one of the
/// machine, which Linux gives a fixed number.
fn name_space() -> String {
    const FIRST: &str = "4026531836";
    let link = std::fs::read_link("/proc/self/ns/pid").unwrap_or_default();
    let digits: String = link.to_string_lossy().chars().filter(char::is_ascii_digit).collect();
    if digits == FIRST { String::new() } else { digits }
}

/// A number that no other process has, but for a chance of 2^-64.
fn random() -> u64 {
    static TOKEN: LazyLock<u64> = LazyLock::new(|| RandomState::new().build_hasher().finish());
    *TOKEN
}

/// A name for a temporary of `path`, in the same folder.
pub(crate) fn temporary_name(path: &Path) -> Result<PathBuf> {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let name = path
        .file_name()
        .ok_or_else(|| Error::usage(format!("{} does not name a file", path.display())))?
        .to_string_lossy();
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    let process = std::process::id();
    Ok(path.with_file_name(format!(".{name}{TEMPORARY_MARK}{}-{process}-{:016x}x{number}", host(), random())))
}

impl Unpublished {
    /// Begins a file. What dead writers of it left is removed.
    pub fn create(path: &Path) -> Result<Self> {
        remove_dead(path);
        Self::begin(path)
    }

    /// As [`Unpublished::create`], of a file that this user alone may read, regardless of the
    /// umask: a copy in a folder of all users.
    pub(crate) fn create_private(path: &Path) -> Result<Self> {
        remove_dead(path);
        #[cfg(not(unix))]
        let options = File::options();
        #[cfg(unix)]
        let options = std::os::unix::fs::OpenOptionsExt::mode(&mut File::options(), 0o600).clone();
        Self::begin_with(options, path)
    }

    /// Begins a file without looking for what others left.
    pub fn begin(path: &Path) -> Result<Self> {
        Self::begin_with(File::options(), path)
    }

    fn begin_with(mut options: std::fs::OpenOptions, path: &Path) -> Result<Self> {
        // A rename would replace a device.
        if let Ok(about) = std::fs::symlink_metadata(path)
            && !(about.is_file() || about.is_symlink() || about.is_dir())
        {
            let (path, kind) = (path.display(), kind_of(&about));
            return Err(Error::usage(format!("cannot write {path}: it is {kind}; give the name of a file")));
        }
        let temporary = temporary_name(path)?;
        let file = options.read(true).write(true).create_new(true).open(&temporary);
        let file = file.map_err(|e| Error::io("create", &temporary, e))?;
        // Where there are no locks, the process number alone shows that the writer is alive.
        let _ = file.try_lock();
        Ok(Self::of(file, temporary, path))
    }

    fn of(file: File, temporary: PathBuf, path: &Path) -> Self {
        let path = path.to_path_buf();
        Self { file: Some(file), rest: vec![], temporary, path, keep: false }
    }

    /// Goes on with what a dead writer left, its first `len` bytes.
    pub fn adopt(dead: Dead, path: &Path, len: u64) -> Result<Self> {
        let Dead { mut file, path: temporary } = dead;
        file.set_len(len)
            .and_then(|()| file.seek(SeekFrom::Start(len)))
            .map_err(|e| Error::io("continue", &temporary, e))?;
        Ok(Self::of(file, temporary, path))
    }

    /// The name it has until it is published.
    pub fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// Keeps the temporary from now on when the writer is dropped unfinished, so that the next one
    /// can continue it.
    pub fn keep(&mut self) {
        self.keep = true;
    }

    /// Adds bytes.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses to write.
    pub fn write(&mut self, mut bytes: &[u8]) -> Result<()> {
        while let Some((now, later)) = bytes.split_at_checked(PIECE - self.rest.len()) {
            if self.rest.is_empty() {
                self.hand_on(now)?;
            } else {
                self.rest.extend_from_slice(now);
                self.flush()?;
            }
            bytes = later;
        }
        self.rest.extend_from_slice(bytes);
        Ok(())
    }

    /// Hands all bytes to the system: they survive this process, though not the machine.
    pub fn flush(&mut self) -> Result<()> {
        self.hand_on(&self.rest)?;
        self.rest.clear();
        Ok(())
    }

    fn hand_on(&self, bytes: &[u8]) -> Result<()> {
        self.file().write_all(bytes).map_err(|e| Error::io("write", &self.temporary, e))
    }

    /// The file, with all bytes in it that were flushed.
    pub(crate) fn file(&self) -> &File {
        self.file.as_ref().expect("the file is open until it is published")
    }

    /// Makes the file durable and visible under its name.
    pub fn publish(self) -> Result<()> {
        let path = self.path.clone();
        self.rename(true)?;
        sync_folder(&path)
    }

    /// Makes the file durable, and visible under its name. The name is durable once
    /// [`sync_folders`] has been called. This is for a file that does not count before another file
    /// names it. The writer of that other file calls [`sync_folders`] first, so a folder is synced
    /// once for all that is new in it.
    pub fn publish_part(self) -> Result<()> {
        self.rename(true)
    }

    /// Makes the file visible under its name. This is for a file that only this process reads, and
    /// then removes: what a crash of the machine leaves of it is of no use.
    pub(crate) fn publish_for_now(self) -> Result<()> {
        self.rename(false)
    }

    fn rename(mut self, sync: bool) -> Result<()> {
        self.flush()?;
        let file = self.file.take().expect("the file is open until it is published");
        if sync {
            file.sync_all().map_err(|e| Error::io("sync", &self.temporary, e))?;
        }
        std::fs::rename(&self.temporary, &self.path).map_err(|e| Error::io("rename a new", &self.path, e))?;
        // Closed, and so unlocked, under its final name only: no other process can take it for a
        // leftover.
        drop(file);
        self.temporary = PathBuf::new();
        Ok(())
    }
}

/// Makes names durable: those in each of these folders.
pub fn sync_folders(folders: impl IntoIterator<Item = PathBuf>) -> Result<()> {
    folders.into_iter().try_for_each(|folder| sync(&folder))
}

pub(super) fn sync_folder(path: &Path) -> Result<()> {
    sync(folder_of(path))
}

/// Puts the folder `new` in the place of `out`, and removes what was there. At any moment there is
/// a whole folder under `out`; where the file system cannot exchange two names, but for the moment
/// between two renames: what was there is found under `aside` then, for `restore_folder`.
///
/// # Errors
/// [`Error::Io`]; what was there is in its place.
pub fn replace_folder(new: &Path, out: &Path, aside: &Path) -> Result<()> {
    swap_folder(new, out, aside)?;
    remove_folder(aside)
}

/// As [`replace_folder`], but what was there stays under `aside`.
pub(super) fn swap_folder(new: &Path, out: &Path, aside: &Path) -> Result<()> {
    let failed = |e| Error::io("replace", out, e);
    match () {
        () if !out.exists() => std::fs::rename(new, out).map_err(failed)?,
        () if exchange(new, out) => std::fs::rename(new, aside).map_err(failed)?,
        () => {
            std::fs::rename(out, aside).map_err(failed)?;
            if let Err(e) = std::fs::rename(new, out) {
                std::fs::rename(aside, out).map_err(|e| Error::io("restore", out, e))?;
                return Err(failed(e));
            }
        }
    }
    sync_folder(out)
}

/// Undoes what a run did that was killed within [`replace_folder`], or finishes it.
pub fn restore_folder(out: &Path, aside: &Path) -> Result<()> {
    if aside.exists() && !out.exists() {
        std::fs::rename(aside, out).map_err(|e| Error::io("restore", out, e))?;
    }
    remove_folder(aside)
}

/// Removes a folder, if it is there.
pub fn remove_folder(folder: &Path) -> Result<()> {
    match std::fs::remove_dir_all(folder) {
        Err(e) if e.kind() != ErrorKind::NotFound => Err(Error::io("remove", folder, e)),
        _ => Ok(()),
    }
}

/// Gives each of two folders the name of the other, where the system and the file system can.
fn exchange(a: &Path, b: &Path) -> bool {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE).is_ok()
    }
    #[cfg(not(target_os = "linux"))]
    {
        let _ = (a, b);
        false
    }
}

/// A rename is durable once its folder is; only Unix can sync a folder.
fn sync(folder: &Path) -> Result<()> {
    #[cfg(unix)]
    {
        match File::open(folder).and_then(|f| f.sync_all()) {
            // Some file systems cannot sync a folder, and then need not.
            Err(e) if !matches!(e.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => {
                return Err(Error::io("sync the folder", folder, e));
            }
            _ => {}
        }
    }
    #[cfg(not(unix))]
    let _ = folder;
    Ok(())
}

/// The folder that a file is in.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

impl Drop for Unpublished {
    fn drop(&mut self) {
        if !self.temporary.as_os_str().is_empty() && !self.keep {
            // Nothing can be done about a temporary that cannot be removed; no reader looks at it.
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}

/// A temporary whose writer is no more, locked for us.
#[derive(Debug)]
pub struct Dead {
    /// The open file.
    pub file: File,
    /// Its name.
    pub path: PathBuf,
}

impl Dead {
    /// Gives it a name of this process's; `None` when another process has been faster. So only one
    /// goes on with it, also where the file system has no locks.
    pub fn claim(self, path: &Path) -> Result<Option<Self>> {
        let own = temporary_name(path)?;
        match std::fs::rename(&self.path, &own) {
            Ok(()) => Ok(Some(Self { path: own, ..self })),
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
            Err(e) => Err(Error::io("continue", &self.path, e)),
        }
    }

    /// Deletes it. Another process may have done so already.
    pub(crate) fn remove(self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// What dead writers of `path` left. A folder that cannot be listed gives nothing: writing to it
/// will say why.
pub fn dead_of(path: &Path) -> Vec<Dead> {
    let Some(name) = path.file_name() else { return vec![] };
    let prefix = format!(".{}{TEMPORARY_MARK}", name.to_string_lossy());
    dead_in(folder_of(path), |name| name.starts_with(&prefix))
}

/// Temporaries in some folders, of writers that run or are dead, looked up once. A folder may have
/// many files, each with its own writer.
pub struct Left(Vec<String>);

impl Left {
    /// The temporaries in these folders; a folder that cannot be listed has none.
    pub fn in_folders(folders: &[PathBuf]) -> Self {
        let entries = folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        Self(names.filter(|name| name.starts_with('.') && name.contains(TEMPORARY_MARK)).collect())
    }

    /// Whether there was a temporary of this file.
    pub fn has(&self, path: &Path) -> bool {
        let prefix = path.file_name().map(|name| format!(".{}{TEMPORARY_MARK}", name.to_string_lossy()));
        prefix.is_some_and(|prefix| self.0.iter().any(|name| name.starts_with(&prefix)))
    }
}

fn remove_dead(path: &Path) {
    dead_of(path).into_iter().for_each(Dead::remove);
}

/// Removes what dead writers left in a folder, of files of any name.
pub fn sweep(folder: &Path) {
    dead_in(folder, |_| true).into_iter().for_each(Dead::remove);
}

fn dead_in(folder: &Path, wanted: impl Fn(&str) -> bool) -> Vec<Dead> {
    let Ok(entries) = std::fs::read_dir(folder) else { return vec![] };
    let mut dead = vec![];
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let Some(process) = process_of(&name, host()).filter(|_| wanted(&name)) else { continue };
        dead.extend(dead_file(entry.path(), process));
    }
    // The order of a folder's entries is the system's.
    dead.sort_by(|a, b| a.path.cmp(&b.path));
    dead
}

/// The name that a temporary of this name is to get; `None` of a name that no writer gives.
pub fn final_name(name: &str) -> Option<&str> {
    let (last, rest) = name.strip_prefix('.')?.rsplit_once(TEMPORARY_MARK)?;
    let mut parts = rest.split('-');
    let [host, process, number] = [parts.next()?, parts.next()?, parts.next()?];
    let is_hex = |c: char| c.is_ascii_hexdigit() || c == 'x';
    let of_ours = host.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        && process.parse::<u32>().is_ok()
        && !number.is_empty()
        && number.chars().all(is_hex);
    (of_ours && parts.next().is_none() && !last.is_empty()).then_some(last)
}

/// The process in a temporary's name, if it was made on this host.
pub(super) fn process_of(name: &str, host: &str) -> Option<u32> {
    let (_, rest) = name.strip_prefix('.')?.rsplit_once(TEMPORARY_MARK)?;
    let mut parts = rest.strip_prefix(host)?.strip_prefix('-')?.split('-');
    parts.next()?.parse().ok()
}

/// Opens a temporary for reading and writing; `None` of what no writer makes: a link, a pipe, a
/// device, another name of a file.
pub fn open_own(path: &Path) -> Option<File> {
    let file = open_plain(path, File::options().read(true).write(true)).ok()?;
    (names_of(&file.metadata().ok()?) == 1).then_some(file)
}

fn dead_file(path: PathBuf, process: u32) -> Option<Dead> {
    let ours = process == std::process::id();
    if !ours && is_alive(process) {
        return None;
    }
    let file = open_own(&path)?;
    match file.try_lock() {
        Ok(()) => {}
        // There are no locks here. For our own process number, only a lock could show whether one
        // of our threads writes it.
        Err(TryLockError::Error(_)) if !ours => {}
        Err(_) => return None,
    }
    // Meanwhile another process may have finished and renamed it, or removed it.
    path.exists().then_some(Dead { file, path })
}

/// Whether there is a process of this number.
pub(super) fn is_alive(process: u32) -> bool {
    #[cfg(unix)]
    {
        let pid = i32::try_from(process).ok().and_then(rustix::process::Pid::from_raw);
        // A process of another user is alive too: "not permitted".
        pid.is_some_and(|pid| {
            !matches!(rustix::process::test_kill_process(pid), Err(rustix::io::Errno::SRCH))
        })
    }
    // Nothing is known: what others left stays.
    #[cfg(not(unix))]
    {
        let _ = process;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_published_file_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let mut dropped = Unpublished::create(&path).unwrap();
        dropped.write(b"half").unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "the temporary");
        drop(dropped);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        let (mut one, mut two) = (Unpublished::create(&path).unwrap(), Unpublished::create(&path).unwrap());
        one.write(b"same").unwrap();
        two.write(b"same").unwrap();
        one.publish().unwrap();
        two.publish().unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
        assert_eq!(std::fs::read(&path).unwrap(), b"same");
    }

    #[test]
    fn bytes_are_written_in_pieces_and_in_order() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let bytes: Vec<u8> = (0..3 * PIECE + 5).map(|i| (i / 7 % 251) as u8).collect();
        for cuts in [vec![], vec![1, PIECE], vec![PIECE - 1, PIECE + 1], vec![PIECE, 3 * PIECE + 5]] {
            let mut out = Unpublished::create(&path).unwrap();
            let mut from = 0;
            for to in cuts.into_iter().chain([bytes.len()]) {
                out.write(&bytes[from..to]).unwrap();
                let written = out.file().metadata().unwrap().len();
                assert_eq!(written, (to / PIECE * PIECE) as u64, "up to {to}");
                from = to;
            }
            out.publish().unwrap();
            assert!(std::fs::read(&path).unwrap() == bytes);
        }
    }

    #[test]
    fn a_missing_folder_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let error = Unpublished::create(&dir.path().join("no/a")).err().unwrap();
        assert_eq!(error.exit_code(), 1);
        assert!(error.to_string().contains("no/.a.tmp-"), "{error}");
    }

    #[test]
    fn leftovers_of_dead_processes_of_this_host_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.seg");
        let name = |host: &str, process: u32| dir.path().join(format!(".a.seg.tmp-{host}-{process}-0"));
        // Process numbers are below 2^22 on Linux.
        let dead = name(host(), 1 << 30);
        let others = [
            name("elsewhere", 1 << 30),
            name(host(), 1),
            dir.path().join(format!(".b.seg.tmp-{}-{}-0", host(), 1 << 30)),
            dir.path().join("a.seg.tmp"),
        ];
        for file in others.iter().chain([&dead]) {
            std::fs::write(file, b"left").unwrap();
        }
        let living = Unpublished::create(&path).unwrap();
        assert!(!dead.exists() && living.temporary().exists());
        assert!(others.iter().all(|f| f.exists()));
        sweep(dir.path());
        assert!(living.temporary().exists(), "locked by its writer");
        assert_eq!(others.map(|f| f.exists()), [true, true, false, true]);
    }

    #[test]
    fn only_names_that_writers_give_are_those_of_temporaries() {
        let own = temporary_name(Path::new("mesh/000007.seg")).unwrap();
        let own = own.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(final_name(&own), Some("000007.seg"), "{own}");
        for other in
            [".a.tmp-", ".a.tmp-1", ".a.tmp-host-1", ".a.tmp-host-x-1", "a.tmp-host-1-1", ".a.tmp-h-1-z"]
        {
            assert_eq!(final_name(other), None, "{other}");
        }
    }

    #[test]
    fn a_kept_temporary_is_gone_on_with() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let mut one = Unpublished::create(&path).unwrap();
        one.write(b"good, bad").unwrap();
        one.flush().unwrap();
        one.keep();
        assert!(dead_of(&path).is_empty(), "alive");
        drop(one);
        let mut dead = dead_of(&path);
        let mut two = Unpublished::adopt(dead.remove(0), &path, 6).unwrap();
        assert!(dead_of(&path).is_empty(), "alive again");
        two.write(b"better").unwrap();
        two.publish().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"good, better");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
