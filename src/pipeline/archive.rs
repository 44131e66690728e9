//! [`Archive`]: an archive opened for reading, with all its steps.

use crate::pipeline::check::{ArchiveCheck, check_archive};
use crate::pipeline::field::archive_sources;
use crate::pipeline::read::{OpenArchive, StepChoice, StepRange};
use crate::pipeline::step::Step;
use crate::pipeline::steps::Steps;
use isospan_io::bytes::remote::{Traffic, traffic, traffic_since};
use isospan_io::error::Result;
use isospan_io::exec::{CancelToken, Clock};
use isospan_io::formats::StepSource;
use serde::Serialize;
use std::ops::{Deref, Range};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An archive opened for reading.
///
/// Opening reads the manifest. Every question reads what can hold its answer and nothing else.
/// Questions are asked of a [`Step`]: `archive.step(3)?.query(600.0).mesh()?`. Most archives have
/// one, so an archive itself answers as its first step does: `archive.query(600.0).mesh()?`.
/// Questions may be asked from several threads at one time.
///
/// ```
/// use isospan::Archive;
/// # fn main() -> isospan::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("protein.isospan");
/// # isospan::Reduction::of("datasets/ironprot.vtk").write(&path)?;
/// let archive = Archive::open(&path)?;
/// let [lo, hi] = archive.value_range().expect("the field has values");
/// let isovalue = lo + 0.45 * (hi - lo);
///
/// // How large would the surface be? Then make it.
/// let count = archive.count(isovalue)?;
/// let mesh = archive.surface(isovalue)?;
/// assert!(mesh.triangles.len() as u64 >= count.active_cells);
///
/// // The surface lies where the field has the isovalue.
/// let points: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.world(mesh.origin)).collect();
/// let values = archive.probe(&points)?;
/// assert!(values.iter().all(|v| (v - isovalue).abs() < 1e-2 * (hi - lo)));
/// # Ok(())
/// # }
/// ```
pub struct Archive {
    pub(super) open: Arc<OpenArchive>,
    path: PathBuf,
    first: Step,
    kept: usize,
    /// The field of ranges of steps, where each has several.
    field: Option<String>,
    opening: Opening,
}

/// What opening an archive took.
#[derive(Clone, Copy, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Opening {
    /// Bytes of the manifest.
    pub bytes_read: u64,
    /// Seconds of wall time.
    pub seconds: f64,
    /// What was fetched from the server, if the archive is on one.
    pub remote: Option<Traffic>,
}

impl Deref for Archive {
    type Target = Step;

    fn deref(&self) -> &Step {
        &self.first
    }
}

impl Archive {
    /// Bytes of decoded blocks that each step caches, unless said otherwise.
    pub const KEPT_BYTES: usize = 256 << 20;

    /// Opens an archive.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] when there is none, or its manifest is damaged.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let (path, start) = (path.as_ref(), Clock::start());
        let before = traffic(path);
        let open = OpenArchive::open(path)?;
        let opening = Opening {
            bytes_read: open.manifest_bytes()?,
            seconds: start.elapsed().as_secs_f64(),
            remote: traffic_since(path, before),
        };
        let kept = Self::KEPT_BYTES;
        let first = Step::of(open.step_at(0).keeping(kept));
        Ok(Self { open, path: path.to_path_buf(), first, kept, opening, field: None })
    }

    /// The same archive, whose steps cache up to about `bytes` bytes of decoded blocks each; 0 for
    /// none. A pyramid caches that much of its tiles (32 MiB at least), and as much of its nodes.
    #[must_use]
    pub fn keeping(self, bytes: usize) -> Self {
        Self { first: Step::of(self.open.step_at(0).keeping(bytes)), kept: bytes, ..self }
    }

    /// The same archive, of whose steps ranges mean those of a field, where each has several.
    #[must_use]
    pub fn in_field(self, field: Option<String>) -> Self {
        Self { field, ..self }
    }

    /// The positions of a range of steps.
    fn positions(&self, steps: StepRange) -> Result<Range<usize>> {
        steps.positions(&self.open.manifest, self.field.as_deref(), &self.path)
    }

    /// The step of a number.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for a step that is not in the archive.
    pub fn step(&self, number: u64) -> Result<Step> {
        self.at(StepChoice::Number(number))
    }

    /// Some consecutive steps: those of a [`StepRange`], or of `3..=7`, or `..` for all.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] when no step is in the range.
    pub fn steps(&self, range: impl Into<StepRange>) -> Result<Steps> {
        Ok(Steps { open: Arc::clone(&self.open), positions: self.positions(range.into())? })
    }

    /// The archive at a step, or at a time; between two steps values are linear.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for a step or a time that is not in the archive.
    pub fn at(&self, choice: StepChoice) -> Result<Step> {
        Ok(Step::of(self.open.at(choice)?.keeping(self.kept)))
    }

    /// The fields of each step, where it has several.
    pub fn fields(&self) -> Vec<&str> {
        let runs = self.open.manifest.runs();
        runs.filter(|run| run[0].series.is_some()).map(|run| run[0].field()).collect()
    }

    /// What opening took: reports of questions do not count it.
    pub fn opening(&self) -> Opening {
        self.opening
    }

    /// The steps of a pyramid as sources, which are reduced as other volumes are: their samples as
    /// the archive has them, with places, units and times. Those of the field that
    /// [`Archive::in_field`] names, where each step has several.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for an archive of tetrahedra, for a grid with coordinates of its
    /// own, and where a field must be chosen; [`crate::Error::BadInput`] for a damaged archive.
    pub fn sources(&self) -> Result<Vec<StepSource>> {
        self.sources_of_level(0)
    }

    /// As [`Archive::sources`], of the nodes of a level: 0 is the finest, with all samples. Nodes
    /// lie as far apart as [`PyramidLevel::stride`](super::PyramidLevel::stride) says.
    ///
    /// # Errors
    /// As [`Archive::sources`]; [`crate::Error::Usage`] for a level that is not there.
    pub fn sources_of_level(&self, level: u32) -> Result<Vec<StepSource>> {
        archive_sources(&self.open, self.positions(StepRange::default())?, level)
    }

    /// Verifies the whole archive: every checksum, and every invariant that ties its parts
    /// together.
    ///
    /// # Errors
    /// [`crate::Error::BadInput`] that names the first thing that is wrong.
    pub fn check(&self) -> Result<ArchiveCheck> {
        self.check_until(&CancelToken::new())
    }

    /// As [`Archive::check`], until it is stopped.
    ///
    /// # Errors
    /// Those of [`Archive::check`]; [`crate::Error::Cancelled`].
    pub fn check_until(&self, cancel: &CancelToken) -> Result<ArchiveCheck> {
        check_archive(&self.open, cancel)
    }
}
