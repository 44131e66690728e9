//! Checks what a command may write: never an input, and existing files only with `--force`.

use isospan::formats::{self, Input, OpenOptions};
use isospan::{Error, Result};
use std::path::{Path, PathBuf};

/// Whether a command may replace what is there.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(crate) struct Force {
    /// Replace existing files.
    #[arg(long)]
    force: bool,
}

impl Force {
    /// Refuses an output that is one of the inputs, one that cannot be written, and without
    /// `--force` one that exists: before any work begins.
    ///
    /// # Errors
    /// [`Error::Usage`] that names the output.
    pub(crate) fn check<P: AsRef<Path>>(
        self,
        output: &Path,
        inputs: impl IntoIterator<Item = P>,
    ) -> Result<()> {
        expect_no_input(output, inputs)?;
        expect_a_file(output)?;
        self.expect_new(output)
    }

    /// As [`Force::check`], of several outputs.
    ///
    /// # Errors
    /// Those of [`Force::check`].
    pub(crate) fn check_all<P: AsRef<Path>>(self, outputs: &[PathBuf], inputs: &[P]) -> Result<()> {
        outputs.iter().try_for_each(|output| self.check(output, inputs))
    }

    /// As [`Force::check`], of an output that is a folder.
    ///
    /// # Errors
    /// [`Error::Usage`] that names the output.
    pub(crate) fn check_folder<P: AsRef<Path>>(
        self,
        output: &Path,
        inputs: impl IntoIterator<Item = P>,
    ) -> Result<()> {
        expect_no_input(output, inputs)?;
        self.expect_new(output)
    }

    fn expect_new(self, output: &Path) -> Result<()> {
        if output.exists() && !self.force { Err(exists(output)) } else { Ok(()) }
    }

    /// Whether it was given.
    pub(crate) fn is_given(self) -> bool {
        self.force
    }
}

/// The error of an output that exists.
pub(crate) fn exists(output: &Path) -> Error {
    Error::usage(format!("{} exists; choose another name, or --force to replace it", output.display()))
}

/// Refuses what is there and no regular file, and a file in a folder that is not there.
///
/// # Errors
/// [`Error::Usage`] that names it.
pub(crate) fn expect_a_file(output: &Path) -> Result<()> {
    let refuse = |why: String| Err(Error::usage(format!("cannot write {}: {why}", output.display())));
    match std::fs::metadata(output) {
        Ok(about) if about.is_dir() => return refuse("it is a folder; give the name of a file".into()),
        Ok(about) if !about.is_file() => {
            return refuse("it is a pipe, socket or device; give the name of a file".into());
        }
        _ => {}
    }
    match output.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            refuse(format!("there is no folder {}; create it first", folder.display()))
        }
        _ => Ok(()),
    }
}

/// The files that an input is made of: itself, slices, the raw data of a header, pieces. For one
/// that cannot be opened, this is the input itself.
pub(crate) fn files_of(input: &Path, options: &OpenOptions) -> Vec<PathBuf> {
    let mut files = match formats::open_input(input, options) {
        Ok(Input::Volume(volume)) => volume.info().files(),
        Ok(Input::Mesh(mesh)) => mesh.info().files(),
        Err(_) => vec![],
    };
    files.push(input.to_path_buf());
    files
}

/// Refuses an output that is one of the inputs, by any name, or that lies in a folder that is one.
///
/// # Errors
/// [`Error::Usage`] that names both.
pub(crate) fn expect_no_input<P: AsRef<Path>>(
    output: &Path,
    inputs: impl IntoIterator<Item = P>,
) -> Result<()> {
    let refuse = |input: &Path, what: &str| {
        let (output, input) = (output.display(), input.display());
        let of = format!("{input}, which this command reads");
        let text = if output.to_string() == input.to_string() {
            format!("the output {of}, too")
        } else {
            format!("the output {output} {what} {of}")
        };
        Err(Error::usage(format!("{text}: choose another name")))
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
