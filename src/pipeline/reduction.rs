//! [`Reduction`]: from volumes or meshes to an archive, set up one method at a time.

use crate::pipeline::field::{MeasureSettings, measure};
use crate::pipeline::plan::Estimate;
use crate::pipeline::read::OpenArchive;
use crate::pipeline::reduce::{
    ReduceReport, estimate_series, expect_surfaces, measured_isovalues, numbered, reduce_series,
    with_surfaces,
};
use crate::pipeline::settings::{Amount, FieldValue, Focus, ReduceSettings, RunSettings, Target};
use crate::pipeline::shards::{PlanReport, plan_shards};
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Progress, Resources, Silent};
use isospan_io::formats::{Input, StepSource};
use isospan_mesh::points::SetKind;
use std::path::Path;

/// What is to become an archive, and how.
///
/// A source is a file of any format that is read, or a volume of the program: samples in memory
/// ([`volume_of`](crate::volume_of)), or anything that gives boxes of samples
/// ([`VolumeReader`](crate::VolumeReader)). Without further words a volume becomes a
/// wavelet pyramid of all its samples, with an RMS error of 1 % of their range.
///
/// ```
/// use isospan::{Archive, Reduction, volume_of};
/// # fn main() -> isospan::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("ball.isospan");
/// let square = |i: usize| (i as f32 - 31.5).powi(2);
/// let samples: Vec<f32> =
///     (0..64 * 64 * 64).map(|i| (square(i % 64) + square(i / 64 % 64) + square(i / 4096)).sqrt()).collect();
/// let made = Reduction::of(volume_of("ball", [64; 3], samples)?).write(&path)?;
/// assert!(made.error.unwrap().rms < 1.0);
/// let mesh = Archive::open(&path)?.surface(20.0)?;
/// assert!(mesh.triangles.len() > 1_000);
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
#[must_use = "nothing is made before write"]
pub struct Reduction<'a> {
    sources: Vec<StepSource>,
    settings: ReduceSettings,
    run: RunSettings,
    against: Option<StepSource>,
    isovalues: Vec<FieldValue>,
    progress: &'a dyn Progress,
}

impl Reduction<'static> {
    /// A reduction of one file or volume.
    pub fn of(source: impl Into<StepSource>) -> Self {
        Self::of_steps([source.into()])
    }

    /// A reduction of the steps of a series: one mesh, and the values of each step. They are
    /// numbered from 0. [`steps_of`](isospan_io::formats::steps_of) finds them in files.
    pub fn of_steps(sources: impl IntoIterator<Item = StepSource>) -> Self {
        Self {
            sources: sources.into_iter().collect(),
            settings: ReduceSettings::default(),
            run: RunSettings::default(),
            against: None,
            isovalues: vec![],
            progress: &Silent,
        }
    }
}

impl Reduction<'_> {
    /// As many points as this fraction of the samples: of a volume, name their set. 1 keeps a mesh
    /// as it is.
    pub fn fraction(mut self, fraction: f64) -> Self {
        self.settings.amount = Amount::Fraction(fraction);
        self
    }

    /// So many points: of a volume, name their set.
    pub fn count(mut self, points: u64) -> Self {
        self.settings.amount = Amount::Count(points);
        self
    }

    /// The error or the size that is not to be exceeded; the number of points follows from it.
    /// Where it cannot be met, the archive is made all the same: ask [`ReduceReport::unmet`].
    pub fn target(mut self, target: Target) -> Self {
        self.settings.target = Some(target);
        self
    }

    /// Points that are dense where the field needs them.
    pub fn adapt(mut self) -> Self {
        self.settings.adapt = true;
        self
    }

    /// Points that are dense where the field needs them, for values in this range alone.
    pub fn focus(mut self, focus: impl Into<Focus>) -> Self {
        self.settings.focus = Some(focus.into());
        self
    }

    /// The point set.
    pub fn points(mut self, set: SetKind) -> Self {
        self.settings.points = Some(set);
        self
    }

    /// All that decides bytes, in place of what was said before.
    pub fn settings(mut self, settings: ReduceSettings) -> Self {
        self.settings = settings;
        self
    }

    /// What the run may use of the machine.
    pub fn resources(mut self, resources: Resources) -> Self {
        self.run.resources = resources;
        self
    }

    /// Replaces an archive that is already there, which stays whole until the new one is complete.
    pub fn replace(mut self, replace: bool) -> Self {
        self.run.replace = replace;
        self
    }

    /// Leaves out steps of a series that cannot be used, and reports them.
    pub fn keep_going(mut self, keep_going: bool) -> Self {
        self.run.keep_going = keep_going;
        self
    }

    /// Also measures the error of the first step against another file or volume of as many
    /// samples: where an archive is reduced again, against what that was made from. See
    /// [`ReduceReport::against`].
    pub fn against(mut self, source: impl Into<StepSource>) -> Self {
        self.against = Some(source.into());
        self
    }

    /// Also measures the surfaces of these isovalues against those of the samples, of volumes that
    /// are no labels: see [`ReduceReport::surfaces`]. That takes about as long as the reduction, or
    /// several times as long where a surface has many triangles.
    ///
    /// ```
    /// # use isospan::Reduction;
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// let made = Reduction::of("datasets/ironprot.vtk").isovalues([100.0]).write(&path)?;
    /// let surface = &made.surfaces[0];
    /// assert!(surface.to_source.unwrap().mean < 0.1, "a tenth of a voxel");
    /// # Ok(())
    /// # }
    /// ```
    pub fn isovalues(mut self, isovalues: impl IntoIterator<Item = impl Into<FieldValue>>) -> Self {
        self.isovalues = isovalues.into_iter().map(Into::into).collect();
        self
    }

    /// Shows how far it is.
    pub fn progress(self, progress: &dyn Progress) -> Reduction<'_> {
        let Self { sources, settings, run, against, isovalues, .. } = self;
        Reduction { sources, settings, run, against, isovalues, progress }
    }

    /// What writing to this path would need; nothing is made.
    ///
    /// # Errors
    /// As [`Reduction::write`], but a budget that does not suffice is only reported: see
    /// [`Estimate::check`].
    pub fn estimate(&self, path: impl AsRef<Path>) -> Result<Estimate> {
        self.expect_alike()?;
        self.expect_surfaces()?;
        estimate_series(&self.sources, &self.settings, path.as_ref(), &self.run)
    }

    /// Makes the archive.
    ///
    /// Where this very archive is there already, nothing is made but what it has lost: so the same
    /// call continues a run that was killed at any moment, and a search for a target at the try
    /// that it was in.
    ///
    /// # Errors
    /// [`Error::Usage`](crate::Error::Usage) when there is another archive already;
    /// [`Error::BadInput`](crate::Error::BadInput) for an input that cannot be used;
    /// [`Error::Budget`](crate::Error::Budget) when the memory does not suffice for one chunk;
    /// [`Error::Cancelled`](crate::Error::Cancelled) when stopped: the same call continues.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<ReduceReport> {
        let path = path.as_ref();
        self.expect_alike()?;
        self.expect_surfaces()?;
        let mut report = reduce_series(&self.sources, &self.settings, path, &self.run, self.progress)?;
        if let Some(source) = &self.against {
            let resources = self.run.resources.clone();
            let settings = MeasureSettings { resources, ..MeasureSettings::default() };
            let archive = OpenArchive::open(path)?;
            report.against = Some(measure(&archive, source, &settings, self.progress, None)?.error);
        }
        match (&self.settings.target, &self.isovalues[..]) {
            // It has been measured in the last try.
            (Some(Target::Surface(target)), [value]) if *value == target.isovalue => Ok(report),
            (_, []) => Ok(report),
            (_, isovalues) => {
                let (sources, resources) = (numbered(&self.sources), &self.run.resources);
                with_surfaces(report, path, &sources, isovalues, resources, self.progress)
            }
        }
    }

    /// Plans the archive in `shards` parts, which processes of their own make, and writes the plan
    /// next to its path: see [`Shards`](crate::pipeline::Shards). Of a target it plans the first
    /// try. Surfaces are measured by the commit.
    ///
    /// # Errors
    /// As [`Reduction::write`]; [`Error::Usage`](crate::Error::Usage) when there is another plan
    /// already, for a largest error with points that adapt, and with [`Reduction::against`].
    pub fn plan_shards(&self, path: impl AsRef<Path>, shards: u64) -> Result<PlanReport> {
        self.expect_surfaces()?;
        if self.against.is_some() {
            return Err(Error::usage(
                "a plan measures no error against another source: measure the archive when it is there",
            ));
        }
        let (sources, settings) = (&self.sources, &self.settings);
        let isovalues = &measured_isovalues(&self.isovalues, settings.target);
        plan_shards(sources, settings, isovalues, path.as_ref(), shards, &self.run, self.progress)
    }

    /// Refuses surfaces that cannot be measured, before anything is made.
    fn expect_surfaces(&self) -> Result<()> {
        let target = self.settings.target;
        match measured_isovalues(&self.isovalues, target).is_empty() {
            true => Ok(()),
            false => {
                let are_labels = target.map(|target| target == Target::Labels);
                expect_surfaces(&self.sources, are_labels, &self.run)
            }
        }
    }

    /// Refuses what an error cannot be measured against before anything is made. A source that
    /// cannot be opened is named by the run.
    fn expect_alike(&self) -> Result<()> {
        let (Some(first), Some(other)) = (self.sources.first(), &self.against) else { return Ok(()) };
        let (found, Ok(first)) = (other.open()?, first.open()) else { return Ok(()) };
        let size = |input: &Input| match input {
            Input::Volume(volume) => {
                let [x, y, z] = volume.info().dims;
                format!("{x} x {y} x {z} samples")
            }
            Input::Mesh(mesh) => format!("a mesh of {} points", mesh.info().points),
        };
        let [expected, got] = [&first, &found].map(size);
        if expected == got {
            return Ok(());
        }
        Err(Error::bad_input(&other.path, "size", expected, got)
            .with_help("an error is measured against a file of as many samples"))
    }
}
