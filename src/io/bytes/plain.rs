//! Files that are what they seem: opened by their own names, never through a link, never waiting.
//!
//! A name that a program chooses may be taken by something else: a link to a user's file, a pipe, a
//! device, another name (hard link) of a file that is not ours. What is written, copied or removed
//! is opened here first.

use std::fs::{File, Metadata, OpenOptions};
use std::io;
use std::path::Path;

/// What is at a name, where it is no regular file.
pub fn kind_of(about: &Metadata) -> &'static str {
    let kind = about.file_type();
    match () {
        () if kind.is_symlink() => "a link",
        () if kind.is_dir() => "a folder",
        () if kind.is_file() => "a file",
        () => "a pipe, a socket or a device",
    }
}

/// Opens a regular file, without following a link at its name. Never waits.
///
/// # Errors
/// Those of the system; [`io::ErrorKind::InvalidInput`] for what is no regular file.
pub fn open_plain(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    let refuse = |about: &Metadata| {
        io::Error::new(io::ErrorKind::InvalidInput, format!("it is {}, no regular file", kind_of(about)))
    };
    // A file that is to be made is not there.
    if let Ok(about) = std::fs::symlink_metadata(path)
        && !about.is_file()
    {
        return Err(refuse(&about));
    }
    // Another process may put something else in its place after the look above.
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        let flags = OFlags::NONBLOCK | OFlags::NOFOLLOW;
        std::os::unix::fs::OpenOptionsExt::custom_flags(options, flags.bits().cast_signed());
    }
    let file = options.open(path)?;
    let about = file.metadata()?;
    if about.is_file() { Ok(file) } else { Err(refuse(&about)) }
}

/// The number of names of a file; `1` where the system does not tell.
pub fn names_of(about: &Metadata) -> u64 {
    #[cfg(unix)]
    return std::os::unix::fs::MetadataExt::nlink(about);
    #[cfg(not(unix))]
    {
        let _ = about;
        1
    }
}

/// Whether a file belongs to this user.
pub fn is_of_this_user(about: &Metadata) -> bool {
    #[cfg(unix)]
    return std::os::unix::fs::MetadataExt::uid(about) == rustix::process::geteuid().as_raw();
    #[cfg(not(unix))]
    {
        let _ = about;
        true
    }
}

/// Whether an open file is the one of its name, and no link is.
pub fn is_named(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let place = |about: io::Result<Metadata>| about.map(|a| (a.dev(), a.ino())).ok();
        place(file.metadata()).is_some_and(|own| place(std::fs::symlink_metadata(path)) == Some(own))
    }
    #[cfg(not(unix))]
    {
        let _ = (file, path);
        true
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_are_opened_and_none_waits() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("file"), "text").unwrap();
        std::os::unix::fs::symlink(at("file"), at("link")).unwrap();
        std::os::unix::fs::symlink(at("none"), at("dangling")).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(at("pipe")).status().unwrap().success());
        std::fs::create_dir(at("folder")).unwrap();
        assert!(open_plain(&at("file"), File::options().read(true)).is_ok());
        for (name, what) in
            [("link", "a link"), ("dangling", "a link"), ("pipe", "a pipe"), ("folder", "a folder")]
        {
            for write in [false, true] {
                let error = open_plain(&at(name), File::options().read(true).write(write)).unwrap_err();
                assert!(error.to_string().contains(what), "{name}: {error}");
            }
        }
        assert!(open_plain(Path::new("/dev/zero"), File::options().read(true)).is_err());
    }
}
