//! One error type: what was being done, on which file, where in it, what was expected, what was
//! found, and what the user can do. `Display` is always a single line; the command line maps
//! [`Error::exit_code`]. Programs match on [`Error::kind`], and ask [`Error::path`] and
//! [`Error::offset`].

use std::borrow::Cow;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// The result of every fallible function of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused an operation on a file.
    Io {
        /// What was being done, as a verb phrase: "read the header of".
        doing: String,
        /// The file concerned.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// An input file, or an archive, is malformed, truncated, or of a kind that cannot be used.
    BadInput(Box<BadInput>),
    /// Parameters that contradict each other or the input.
    Usage(String),
    /// A step, a time or a field is asked for that is not there.
    NoSuch(String),
    /// The run needs more of a resource than it was given.
    Budget {
        /// The resource.
        resource: Resource,
        /// What it is for, as words that follow its name; may be empty.
        purpose: String,
        /// Bytes that would suffice.
        needed: u64,
        /// Bytes that there are.
        available: u64,
    },
    /// Segments of an archive are missing.
    Incomplete {
        /// The archive.
        path: PathBuf,
        /// What is missing, a name each.
        missing: Vec<String>,
    },
    /// Another process writes the archive.
    Busy {
        /// The archive.
        path: PathBuf,
        /// Who writes it, as its lock file says: "process 17 on node3"; may be empty.
        writer: String,
    },
    /// The run was cancelled; the same command continues it.
    Cancelled,
}

/// An input that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct BadInput {
    /// The file concerned.
    pub path: PathBuf,
    /// What is wrong with it.
    pub fault: Fault,
    /// Where in the file.
    pub at: Place,
    /// What a good file would have there.
    pub expected: String,
    /// What was found.
    pub got: String,
    /// What to do about it; may be empty.
    pub help: String,
}

/// What is wrong with an input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Fault {
    /// It does not mean what it should, or cannot be used.
    #[default]
    Malformed,
    /// Its bytes are not those of its checksum.
    Checksum,
    /// It ends too early.
    CutShort,
}

/// Where in a file: a byte, or a part by its name ("line 3", "block 7: CRC32C").
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Place {
    text: String,
    offset: Option<u64>,
}

impl Place {
    /// A byte, counted from 0.
    pub fn byte(offset: u64) -> Self {
        Self { text: format!("byte {offset}"), offset: Some(offset) }
    }

    /// The byte, where it is known.
    pub fn offset(&self) -> Option<u64> {
        self.offset
    }
}

impl From<String> for Place {
    fn from(text: String) -> Self {
        Self { text, offset: None }
    }
}

impl From<&str> for Place {
    fn from(text: &str) -> Self {
        text.to_owned().into()
    }
}

impl From<&String> for Place {
    fn from(text: &String) -> Self {
        text.clone().into()
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// What kind of error it is: what a program can decide by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// A file or folder is not there.
    NotFound,
    /// The system refused something else.
    Io,
    /// An input is wrong, and in which way.
    BadInput(Fault),
    /// Parameters contradict each other or the input.
    Usage,
    /// A step, a time or a field is not there.
    NoSuch,
    /// There is not enough memory.
    Memory,
    /// There is not enough space on a disk.
    Disk,
    /// Segments of an archive are missing; the same reduction makes them again.
    Incomplete,
    /// Another process writes the archive.
    Busy,
    /// The run was stopped; the same call continues it.
    Cancelled,
}

/// What a run may have too little of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resource {
    /// What [`Resources::with_memory`](crate::exec::Resources::with_memory) limits.
    Memory,
    /// Space in a folder.
    Disk,
}

impl fmt::Display for Resource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Memory => "memory",
            Self::Disk => "disk space",
        })
    }
}

impl Error {
    /// An [`Error::Io`]; use as `.map_err(|e| Error::io("read", &path, e))`.
    pub fn io(doing: impl Into<String>, path: impl AsRef<Path>, source: io::Error) -> Self {
        Self::Io { doing: doing.into(), path: path.as_ref().to_path_buf(), source }
    }

    /// The same error once more.
    pub(crate) fn again(&self) -> Self {
        match self {
            Self::Io { doing, path, source } => {
                Self::io(doing.clone(), path, io::Error::new(source.kind(), source.to_string()))
            }
            Self::BadInput(wrong) => Self::BadInput(wrong.clone()),
            Self::Usage(text) => Self::Usage(text.clone()),
            Self::NoSuch(text) => Self::NoSuch(text.clone()),
            &Self::Budget { resource, ref purpose, needed, available } => {
                Self::Budget { resource, purpose: purpose.clone(), needed, available }
            }
            Self::Incomplete { path, missing } => {
                Self::Incomplete { path: path.clone(), missing: missing.clone() }
            }
            Self::Busy { path, writer } => Self::Busy { path: path.clone(), writer: writer.clone() },
            Self::Cancelled => Self::Cancelled,
        }
    }

    /// An [`Error::Budget`] of memory, in bytes. `purpose` says what it is for; may be empty.
    pub fn memory(purpose: impl Into<String>, needed: u64, available: u64) -> Self {
        Self::Budget { resource: Resource::Memory, purpose: purpose.into(), needed, available }
    }

    /// An [`Error::Budget`] of space in a folder, in bytes.
    pub fn disk(folder: &Path, needed: u64, available: u64) -> Self {
        let purpose = format!("for {}", folder.display());
        Self::Budget { resource: Resource::Disk, purpose, needed, available }
    }

    /// An [`Error::BadInput`] without advice; add some with [`Error::with_help`].
    pub fn bad_input(
        path: impl AsRef<Path>,
        at: impl Into<Place>,
        expected: impl Into<String>,
        got: impl Into<String>,
    ) -> Self {
        Self::BadInput(Box::new(BadInput {
            path: path.as_ref().to_path_buf(),
            fault: Fault::Malformed,
            at: at.into(),
            expected: expected.into(),
            got: got.into(),
            help: String::new(),
        }))
    }

    /// An [`Error::NoSuch`].
    pub fn no_such(message: impl Into<String>) -> Self {
        Self::NoSuch(message.into())
    }

    /// An [`Error::Usage`].
    pub fn usage(message: impl Into<String>) -> Self {
        Self::Usage(message.into())
    }

    /// Whether the right to read is missing.
    pub(crate) fn is_denied(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::PermissionDenied)
    }

    /// The same error, which names the step of a series; only [`Error::BadInput`] does.
    #[must_use]
    pub fn at_step(mut self, number: u64) -> Self {
        if let Self::BadInput(bad) = &mut self {
            bad.at.text = format!("step {number}, {}", bad.at);
        }
        self
    }

    /// The same error of an input, with what is wrong.
    #[must_use]
    pub fn of_fault(mut self, fault: Fault) -> Self {
        if let Self::BadInput(bad) = &mut self {
            bad.fault = fault;
        }
        self
    }

    /// The same error of an input, at another place.
    #[must_use]
    pub fn placed(mut self, place: Place) -> Self {
        if let Self::BadInput(bad) = &mut self {
            bad.at = place;
        }
        self
    }

    /// What kind of error it is.
    ///
    /// ```
    /// use isospan_io::error::ErrorKind;
    /// use isospan_io::formats::{OpenOptions, open_volume};
    /// use std::path::Path;
    /// let error = open_volume(Path::new("nowhere.nrrd"), &OpenOptions::default()).err().unwrap();
    /// assert_eq!(error.kind(), ErrorKind::NotFound);
    /// assert_eq!(error.path().unwrap().to_str(), Some("nowhere.nrrd"));
    /// ```
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } if is_full(source) => ErrorKind::Disk,
            Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound => ErrorKind::NotFound,
            Self::Io { .. } => ErrorKind::Io,
            Self::BadInput(bad) => ErrorKind::BadInput(bad.fault),
            Self::Usage(_) => ErrorKind::Usage,
            Self::NoSuch(_) => ErrorKind::NoSuch,
            Self::Budget { resource: Resource::Memory, .. } => ErrorKind::Memory,
            Self::Budget { resource: Resource::Disk, .. } => ErrorKind::Disk,
            Self::Incomplete { .. } => ErrorKind::Incomplete,
            Self::Busy { .. } => ErrorKind::Busy,
            Self::Cancelled => ErrorKind::Cancelled,
        }
    }

    /// The file or the archive concerned, if one is.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Self::BadInput(bad) => Some(&bad.path),
            Self::Io { path, .. } | Self::Incomplete { path, .. } | Self::Busy { path, .. } => Some(path),
            Self::Usage(_) | Self::NoSuch(_) | Self::Budget { .. } | Self::Cancelled => None,
        }
    }

    /// The byte of the file at which it is wrong, where that is known.
    pub fn offset(&self) -> Option<u64> {
        match self {
            Self::BadInput(bad) => bad.at.offset(),
            _ => None,
        }
    }

    /// Adds what the user can do; only [`Error::BadInput`] carries it.
    #[must_use]
    pub fn with_help(mut self, advice: impl Into<String>) -> Self {
        if let Self::BadInput(bad) = &mut self {
            bad.help = advice.into();
        }
        self
    }

    /// The error of work for which `held` bytes of a run's memory were not left, for the whole run.
    #[must_use]
    pub fn plus_held(mut self, held: u64) -> Self {
        if let Self::Budget { resource: Resource::Memory, needed, available, .. } = &mut self {
            (*needed, *available) = (needed.saturating_add(held), available.saturating_add(held));
        }
        self
    }

    /// The error of work that was given `share` of a run's memory, for the `whole` of it.
    #[must_use]
    pub fn of_share(mut self, share: u64, whole: u64) -> Self {
        if let Self::Budget { resource: Resource::Memory, needed, available, .. } = &mut self {
            let all = u128::from(*needed) * u128::from(whole);
            *needed = u64::try_from(all.div_ceil(u128::from(share.max(1)))).unwrap_or(u64::MAX);
            *available = whole;
        }
        self
    }

    /// The process exit code for this error: 1 failed, 2 usage, 3 incomplete, 4 budget (memory,
    /// disk), 5 bad input, 75 the same command can succeed later: it was stopped, or another
    /// process writes the archive.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Io { source, .. } if is_full(source) => 4,
            Self::Io { .. } => 1,
            Self::Usage(_) | Self::NoSuch(_) => 2,
            Self::Incomplete { .. } => 3,
            Self::Budget { .. } => 4,
            Self::BadInput(_) => 5,
            Self::Cancelled | Self::Busy { .. } => 75,
        }
    }
}

/// Whether there is no room for what was to be written: on the device, within a quota, or within a
/// limit of the process.
fn is_full(error: &io::Error) -> bool {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    matches!(error.kind(), StorageFull | QuotaExceeded | FileTooLarge)
}

/// A text as it may be shown on a terminal: control characters but new lines and tabs, which names
/// from files may have in them to steer the terminal, and those that turn the direction of writing,
/// as `\u001b` (as in JSON).
pub fn printable(text: &str) -> Cow<'_, str> {
    let steers = |c: char| {
        c.is_control() && !matches!(c, '\n' | '\t')
            || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    if !text.contains(steers) {
        return Cow::Borrowed(text);
    }
    let show = |c: char| if steers(c) { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() };
    Cow::Owned(text.chars().map(show).collect())
}

/// Text from a file may hold anything; an error message is one printable line of bounded length.
fn one_line(text: &str) -> String {
    const MOST: usize = 200;
    let clean: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(MOST + 1).collect();
    if clean.chars().count() > MOST {
        format!("{}…", clean.chars().take(MOST).collect::<String>())
    } else {
        clean
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = String::new();
        self.write(&mut text)?;
        f.write_str(&printable(&text).replace(['\n', '\t'], " "))
    }
}

impl Error {
    /// The message, with what names of files and fields have in them.
    fn write(&self, f: &mut impl fmt::Write) -> fmt::Result {
        match self {
            Self::Io { doing, path, source } => {
                write!(f, "cannot {doing} {}: {source}", path.display())?;
                if is_full(source) {
                    f.write_str("; make room, then run the same command again")
                } else {
                    Ok(())
                }
            }
            Self::BadInput(bad) => {
                let BadInput { path, at, expected, got, help, .. } = &**bad;
                write!(
                    f,
                    "{}: {}: expected {}, got {}",
                    path.display(),
                    one_line(&at.text),
                    one_line(expected),
                    one_line(got)
                )?;
                if help.is_empty() { Ok(()) } else { write!(f, "; {}", one_line(help)) }
            }
            Self::Usage(message) | Self::NoSuch(message) => f.write_str(message),
            Self::Budget { resource, purpose, needed, available } => {
                let [needs, has] = [bytes_text(*needed, f64::ceil), bytes_text(*available, f64::floor)];
                write!(f, "not enough {resource}")?;
                if !purpose.is_empty() {
                    write!(f, " ({})", one_line(purpose))?;
                }
                write!(f, ": the run needs {needs} and has {has}; ")?;
                if *resource == Resource::Memory {
                    // The last word can be given as the memory.
                    write!(f, "give it at least {}MiB", needed.div_ceil(1 << 20))
                } else {
                    f.write_str("make room, or choose another folder")
                }
            }
            Self::Incomplete { path, missing } => {
                write!(
                    f,
                    "{}: incomplete: {} missing: {}",
                    path.display(),
                    missing.len(),
                    one_line(&missing.join(" "))
                )
            }
            Self::Busy { path, writer } => {
                let writer = if writer.is_empty() { "another process" } else { writer };
                write!(f, "{} is being written by {}", path.display(), one_line(writer))?;
                f.write_str("; wait until that has ended, or choose another name")
            }
            Self::Cancelled => f.write_str("stopped by a signal; the same command continues"),
        }
    }
}

/// Bytes for a person: "3.4 MiB", rounded to the tenth that `round` tells.
pub fn bytes_text(n: u64, round: fn(f64) -> f64) -> String {
    let (mut value, mut unit) = (n as f64, 0);
    while value >= 1024.0 && unit < 5 {
        (value, unit) = (value / 1024.0, unit + 1);
    }
    let name = ["B", "KiB", "MiB", "GiB", "TiB", "PiB"][unit];
    if unit == 0 { format!("{n} B") } else { format!("{:.1} {name}", round(value * 10.0) / 10.0) }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io { source, .. } => Some(source),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_say_kind_file_and_offset() {
        let cut = Error::bad_input("a.nrrd", Place::byte(40), "8 more bytes", "44 bytes");
        let cut = cut.of_fault(Fault::CutShort).at_step(3);
        assert_eq!(cut.kind(), ErrorKind::BadInput(Fault::CutShort));
        assert_eq!((cut.path(), cut.offset()), (Some(Path::new("a.nrrd")), Some(40)));
        assert_eq!(cut.to_string(), "a.nrrd: step 3, byte 40: expected 8 more bytes, got 44 bytes");
        let line = Error::bad_input("a.vtk", "line 3", "a number", "'x'");
        assert_eq!((line.kind(), line.offset()), (ErrorKind::BadInput(Fault::Malformed), None));
        let of = [Error::memory("to draw", 2, 1), Error::disk(Path::new("a"), 2, 1)].map(|e| e.kind());
        assert_eq!(of, [ErrorKind::Memory, ErrorKind::Disk]);
        let io = |kind: io::ErrorKind| Error::io("read", "a", kind.into()).kind();
        assert_eq!(io(io::ErrorKind::NotFound), ErrorKind::NotFound);
        assert_eq!(io(io::ErrorKind::StorageFull), ErrorKind::Disk);
        assert_eq!(io(io::ErrorKind::PermissionDenied), ErrorKind::Io);
    }

    #[test]
    fn what_suffices_is_said_for_the_whole_run() {
        let memory = || Error::memory("to draw", 101, 30);
        let bytes = |e| match e {
            Error::Budget { needed, available, .. } => (needed, available),
            e => panic!("{e}"),
        };
        // A third of what is left of all but 20 bytes, rounded up.
        assert_eq!(bytes(memory().plus_held(20).of_share(100, 300)), (363, 300));
        assert_eq!(bytes(memory().of_share(0, 7)), (707, 7));
        let disk = Error::disk(Path::new("a"), 101, 30);
        assert_eq!(bytes(disk.plus_held(20).of_share(100, 300)), (101, 30), "not shared out");
    }
}
