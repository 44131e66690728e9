//! [`Addition`]: further steps for an archive, set up one method at a time.

use crate::pipeline::reduce::{AppendSettings, ReduceReport, append};
use crate::pipeline::settings::{FieldValue, RunSettings, Target};
use isospan_io::error::Result;
use isospan_io::exec::{Progress, Resources, Silent};
use isospan_io::formats::StepSource;
use std::path::Path;

/// Steps that are to be added to an archive that is there already. Its points and all settings are
/// those of the steps that it has.
///
/// ```
/// use isospan::{Addition, Archive, Reduction, volume_of};
/// # fn main() -> isospan::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("run.isospan");
/// let ramp = |t: f32| (0..24 * 24 * 24).map(|i| (i % 24) as f32 + t).collect::<Vec<f32>>();
/// let at = |t: f32| volume_of("ramp", [24; 3], ramp(t));
/// Reduction::of(at(0.0)?).write(&path)?;
/// let added = Addition::of(at(1.0)?).append_to(&path)?;
/// assert_eq!(added.steps[0].number, 1);
/// assert_eq!(Archive::open(&path)?.info()?.steps.len(), 2);
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
#[must_use = "nothing is added before append_to"]
pub struct Addition<'a> {
    sources: Vec<StepSource>,
    settings: AppendSettings,
    run: RunSettings,
    progress: &'a dyn Progress,
}

impl Addition<'static> {
    /// An addition of one file or volume.
    pub fn of(source: impl Into<StepSource>) -> Self {
        Self::of_steps([source.into()])
    }

    /// An addition of several steps. [`steps_of`](crate::formats::steps_of) finds them in files.
    pub fn of_steps(sources: impl IntoIterator<Item = StepSource>) -> Self {
        Self {
            sources: sources.into_iter().collect(),
            settings: AppendSettings::default(),
            run: RunSettings::default(),
            progress: &Silent,
        }
    }
}

impl Addition<'_> {
    /// A value that means "no data", besides what the file declares; that of the last step if none.
    pub fn missing(mut self, value: impl Into<Option<f64>>) -> Self {
        self.settings.missing = value.into();
        self
    }

    /// Steps from one keyframe to the next, by number; as for the last step if none.
    pub fn keyframes(mut self, steps: impl Into<Option<u64>>) -> Self {
        self.settings.keyframes = steps.into();
        self
    }

    /// Whether the error is measured at every sample of the source, as it is without this.
    pub fn measure(mut self, measure: bool) -> Self {
        self.settings.measure = measure;
        self
    }

    /// Replaces a step that the archive has at the same time, or else of the same file.
    pub fn replace(mut self, replace: bool) -> Self {
        self.settings.replace = replace;
        self
    }

    /// Also measures the surfaces of these isovalues at the new steps, against those of their
    /// samples: see [`Reduction::isovalues`](crate::Reduction::isovalues).
    pub fn isovalues(mut self, isovalues: impl IntoIterator<Item = impl Into<FieldValue>>) -> Self {
        self.settings.isovalues = isovalues.into_iter().map(Into::into).collect();
        self
    }

    /// What the new steps are judged by, an error or the distance of a surface. It decides nothing
    /// about them, whose precision is that of the archive; the report says what they came to. A
    /// size or a kind of loss is no such target, and nothing is said of it.
    pub fn judged_by(mut self, target: impl Into<Option<Target>>) -> Self {
        self.settings.target = target.into();
        self
    }

    /// Leaves out steps that cannot be used, and reports them.
    pub fn keep_going(mut self, keep_going: bool) -> Self {
        self.run.keep_going = keep_going;
        self
    }

    /// What the run may use of the machine.
    pub fn resources(mut self, resources: Resources) -> Self {
        self.run.resources = resources;
        self
    }

    /// Shows how far it is.
    pub fn progress(self, progress: &dyn Progress) -> Addition<'_> {
        let Self { sources, settings, run, .. } = self;
        Addition { sources, settings, run, progress }
    }

    /// Adds the steps to an archive, in the order of their times; the report is of them. Steps
    /// behind a new one have new numbers; files of the archive stay as they are.
    ///
    /// Steps that the archive has already (of the same names, contents, fields and times) are not
    /// added again: so the same call continues a run that was killed at any moment.
    ///
    /// The bytes of steps behind all of the archive are those that
    /// [`Reduction::write`](crate::Reduction::write) would have made of all steps at once, with the
    /// same settings.
    ///
    /// # Errors
    /// Those of [`Reduction::write`](crate::Reduction::write);
    /// [`Error::Usage`](crate::Error::Usage) for another step of a time that the archive has,
    /// unless that is to be replaced; [`Error::BadInput`](crate::Error::BadInput) for a damaged
    /// archive, and where dimensions or geometry, or points or cells, are not the archive's;
    /// [`Error::Io`](crate::Error::Io) when another run has changed the archive meanwhile: the same
    /// call then adds the steps at the end.
    pub fn append_to(&self, archive: impl AsRef<Path>) -> Result<ReduceReport> {
        append(&self.sources, &self.settings, archive.as_ref(), &self.run, self.progress)
    }
}
