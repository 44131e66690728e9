//! [`Measurement`]: how far the field of an archive is from a source, set up one method at a time.

use crate::pipeline::archive::Archive;
use crate::pipeline::field::{MeasureReport, MeasureSettings, measure};
use crate::pipeline::read::{LevelChoice, OpenArchive};
use isospan_io::error::Result;
use isospan_io::exec::{Progress, Resources, Silent};
use isospan_io::formats::StepSource;
use std::path::PathBuf;
use std::sync::Arc;

/// A comparison of an archive with what it was made from, or with any source of the same size, at
/// every sample: [`Archive::measure`] begins one.
///
/// ```
/// use isospan::{Archive, Reduction};
/// # fn main() -> isospan::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("protein.isospan");
/// let made = Reduction::of("datasets/ironprot.vtk").write(&path)?;
/// let found = Archive::open(&path)?.measure("datasets/ironprot.vtk").run()?;
/// assert!(found.same_source && found.error.rms == made.error.unwrap().rms);
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
#[must_use = "nothing is measured before run"]
pub struct Measurement<'a> {
    open: Arc<OpenArchive>,
    source: StepSource,
    settings: MeasureSettings,
    progress: &'a dyn Progress,
}

impl Archive {
    /// A measurement of the error against a file, or a volume of the program. Of a file with
    /// several fields, the one of the archive is read, unless the source names another.
    pub fn measure(&self, source: impl Into<StepSource>) -> Measurement<'static> {
        Measurement {
            open: Arc::clone(&self.open),
            source: source.into(),
            settings: MeasureSettings::default(),
            progress: &Silent,
        }
    }
}

impl Measurement<'_> {
    /// The number of the step that is measured; without, the one that was made from this source,
    /// else the first.
    pub fn step(mut self, step: impl Into<Option<u64>>) -> Self {
        self.settings.step = step.into();
        self
    }

    /// The level of a pyramid; the finest if none. Samples beyond its last node are outside.
    pub fn level(mut self, level: impl Into<Option<LevelChoice>>) -> Self {
        self.settings.level = level.into();
        self
    }

    /// A VTI file that is written, with the errors of each brick.
    pub fn map(mut self, file: impl Into<Option<PathBuf>>) -> Self {
        self.settings.map = file.into();
        self
    }

    /// Threads, memory, scratch folder, and what stops it.
    pub fn resources(mut self, resources: Resources) -> Self {
        self.settings.resources = resources;
        self
    }

    /// Shows how far it is.
    pub fn progress(self, progress: &dyn Progress) -> Measurement<'_> {
        let Self { open, source, settings, .. } = self;
        Measurement { open, source, settings, progress }
    }

    /// Measures. Void tetrahedra and missing samples are counted apart.
    ///
    /// # Errors
    /// [`Error::BadInput`](crate::Error::BadInput) for a source of another size, or a damaged
    /// archive; [`Error::Budget`](crate::Error::Budget) when the memory does not suffice;
    /// [`Error::Cancelled`](crate::Error::Cancelled); those of reading the source and of writing
    /// the map.
    pub fn run(&self) -> Result<MeasureReport> {
        measure(&self.open, &self.source, &self.settings, self.progress)
    }
}
