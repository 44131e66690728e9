//! [`Stage`]: the parts of a run whose times are reported.

use serde::Serializer;
use serde::ser::SerializeMap as _;
use std::fmt;
use std::time::Duration;

/// A part of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Stage {
    /// Reading a mesh onto disk.
    Read,
    /// Sorting what was read.
    Sort,
    /// Finding the plan.
    Plan,
    /// Making tetrahedra.
    Mesh,
    /// Sampling the field at the points.
    Sample,
    /// Fitting values to the samples.
    Fit,
    /// Packing blocks.
    Encode,
    /// Summing the contour spectrum.
    Spectrum,
    /// Writing files.
    Write,
    /// Index and manifest.
    Commit,
    /// Measuring errors.
    Measure,
    /// Measuring surfaces.
    Surfaces,
    /// Verifying segments that were made before.
    Verify,
    /// Opening an archive, and reading its index.
    Open,
    /// Extracting surfaces.
    Extract,
    /// Components and decimation.
    Refine,
    /// Reading chunks, and joining their points.
    Join,
    /// All of the run.
    Total,
}

/// Seconds of some stages, in the order of the work.
pub type StageSeconds = Vec<(Stage, f64)>;

/// The seconds of each stage together, in the order in which stages appear first.
pub(in crate::pipeline) fn summed(seconds: &StageSeconds) -> StageSeconds {
    let mut sums = StageSeconds::new();
    for &(stage, time) in seconds {
        match sums.iter_mut().find(|(other, _)| *other == stage) {
            Some((_, sum)) => *sum += time,
            None => sums.push((stage, time)),
        }
    }
    sums
}

/// Writes them as a map from the stage's name to its seconds.
pub(in crate::pipeline) fn by_name<S: Serializer>(seconds: &StageSeconds, to: S) -> Result<S::Ok, S::Error> {
    let mut map = to.serialize_map(None)?;
    for (stage, sum) in summed(seconds) {
        map.serialize_entry(stage.key(), &sum)?;
    }
    map.end()
}

impl Stage {
    /// Its name in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Join => "join",
            other => other.name(),
        }
    }

    /// Its name for a person.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Sort => "sort",
            Self::Plan => "plan",
            Self::Mesh => "mesh",
            Self::Sample => "sample",
            Self::Fit => "fit",
            Self::Encode => "encode",
            Self::Spectrum => "spectrum",
            Self::Write => "write",
            Self::Commit => "commit",
            Self::Measure => "measure",
            Self::Surfaces => "surfaces",
            Self::Verify => "verify",
            Self::Open => "open, index",
            Self::Extract => "extract",
            Self::Refine => "refine",
            Self::Join => "read, join",
            Self::Total => "total",
        }
    }
}

/// Time spent in each stage, summed over threads.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::pipeline) struct StageTimes {
    pub(in crate::pipeline) mesh: Duration,
    pub(in crate::pipeline) sample: Duration,
    pub(in crate::pipeline) fit: Duration,
    pub(in crate::pipeline) measure: Duration,
    pub(in crate::pipeline) encode: Duration,
    pub(in crate::pipeline) spectrum: Duration,
    pub(in crate::pipeline) write: Duration,
}

impl StageTimes {
    pub(in crate::pipeline) fn add(&mut self, other: &Self) {
        self.mesh += other.mesh;
        self.sample += other.sample;
        self.fit += other.fit;
        self.measure += other.measure;
        self.encode += other.encode;
        self.spectrum += other.spectrum;
        self.write += other.write;
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
