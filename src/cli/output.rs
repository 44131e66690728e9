//! An output never replaces an input.

use isospan::formats::{self, Input, OpenOptions};
use isospan::{Error, Result};
use std::path::{Path, PathBuf};

/// The files that an input is made of: itself, slices, the raw data of a header, pieces. Of one that cannot be opened, itself.
pub(crate) fn files_of(input: &Path, options: &OpenOptions) -> Vec<PathBuf> {
    let mut files = match formats::open_input(input, options) {
        Ok(Input::Volume(volume)) => volume.info().files(),
        Ok(Input::Mesh(mesh)) => mesh.info().files(),
        Err(_) => vec![],
    };
    files.push(input.to_path_buf());
    files
}

/// Refuses an output that is one of the inputs, by whatever name, or that lies in a folder that is one.
///
/// # Errors
/// [`Error::Usage`] that names both.
pub(crate) fn expect_no_input<P: AsRef<Path>>(
    output: &Path,
    inputs: impl IntoIterator<Item = P>,
) -> Result<()> {
    let refuse = |input: &Path, what: &str| {
        let (output, input) = (output.display(), input.display());
        Err(Error::usage(format!("{output} {what} {input}, which this command reads: choose another name")))
    };
    let place = place_of(output);
    for input in inputs {
        let input = input.as_ref();
        if is_same(output, input) {
            return refuse(input, "is");
        }
        if input.is_dir() && input.canonicalize().is_ok_and(|folder| place.starts_with(folder)) {
            return refuse(input, "lies in");
        }
    }
    Ok(())
}

/// Refuses an archive to be written in whose folder an input lies, or that is one.
///
/// # Errors
/// [`Error::Usage`] that names both.
pub(crate) fn expect_apart<P: AsRef<Path>>(
    archive: &Path,
    inputs: impl IntoIterator<Item = P>,
) -> Result<()> {
    let place = place_of(archive);
    for input in inputs {
        let input = input.as_ref();
        if input.canonicalize().is_ok_and(|input| input.starts_with(&place)) {
            let (input, archive) = (input.display(), archive.display());
            let text = format!("{input}, which this command reads, lies in {archive}: choose another name");
            return Err(Error::usage(text));
        }
    }
    Ok(())
}

/// The absolute path of a file that may not exist yet, links in its folder followed.
fn place_of(path: &Path) -> PathBuf {
    if let Ok(found) = path.canonicalize() {
        return found;
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match (folder.canonicalize(), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => path.to_path_buf(),
    }
}

/// Whether two names are of one file; a hard link is.
fn is_same(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let [a, b] = [a, b].map(|p| std::fs::metadata(p).ok().map(|about| (about.dev(), about.ino())));
        a.is_some() && a == b
    }
    #[cfg(not(unix))]
    {
        let [a, b] = [a, b].map(|p| p.canonicalize().ok());
        a.is_some() && a == b
    }
}
