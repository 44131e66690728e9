//! [`Measurement`]: how far the field of an archive is from a source, set up one method at a time.

use crate::pipeline::archive::Archive;
#[cfg(feature = "compare")]
use crate::pipeline::field::SourceSamples;
use crate::pipeline::field::{MeasureReport, MeasureSettings, measure};
#[cfg(feature = "compare")]
use crate::pipeline::query::Isovalues;
#[cfg(feature = "compare")]
use crate::pipeline::read::StepView;
use crate::pipeline::read::{LevelChoice, OpenArchive};
#[cfg(feature = "compare")]
use crate::pipeline::surface::surface_errors;
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
    #[cfg_attr(not(feature = "compare"), allow(dead_code))]
    isovalues: Vec<f64>,
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
            isovalues: vec![],
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

    /// Isovalues whose surfaces are measured, too: how far each is from marching cubes of the
    /// samples, in both directions, and how large both are. For volumes.
    ///
    /// ```
    /// # use isospan::{Archive, Reduction};
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// Reduction::of("datasets/ironprot.vtk").write(&path)?;
    /// let found = Archive::open(&path)?.measure("datasets/ironprot.vtk").isovalues(100.0).run()?;
    /// let surface = &found.surfaces[0];
    /// assert!(surface.to_source.unwrap().mean < 0.1, "a tenth of a voxel");
    /// # Ok(())
    /// # }
    /// ```
    #[cfg(feature = "compare")]
    #[cfg_attr(docsrs, doc(cfg(feature = "compare")))]
    pub fn isovalues(mut self, isovalues: impl Into<Isovalues>) -> Self {
        self.isovalues = isovalues.into().into_vec();
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
        let Self { open, source, settings, isovalues, .. } = self;
        Measurement { open, source, settings, isovalues, progress }
    }

    /// Measures. Void tetrahedra and missing samples are counted apart.
    ///
    /// # Errors
    /// [`Error::BadInput`](crate::Error::BadInput) for a source of another size, or a damaged
    /// archive; [`Error::Budget`](crate::Error::Budget) when the memory does not suffice;
    /// [`Error::Cancelled`](crate::Error::Cancelled); those of reading the source and of writing
    /// the map.
    pub fn run(&self) -> Result<MeasureReport> {
        let (open, source, settings, progress) = (&self.open, &self.source, &self.settings, self.progress);
        #[cfg(feature = "compare")]
        if !self.isovalues.is_empty() {
            let mut surfaces = vec![];
            let mut also = |archive: &StepView, samples: &SourceSamples| {
                surfaces = surface_errors(archive, samples, &self.isovalues, settings.level, progress)?;
                Ok(())
            };
            let report = measure(open, source, settings, progress, Some(&mut also))?;
            return Ok(MeasureReport { surfaces, ..report });
        }
        measure(open, source, settings, progress, None)
    }
}
