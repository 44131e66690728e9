//! [`Archive`]: an archive opened for reading, with all its steps.

use crate::files::surface::SurfaceFormat;
use crate::pipeline::check::{ArchiveCheck, check_archive};
use crate::pipeline::field::{GridReport, GridSettings, Moments, archive_sources, export_zarr};
use crate::pipeline::read::{OpenArchive, StepChoice, StepRange, StepSpectrum};
use crate::pipeline::step::Step;
use crate::pipeline::surface::{
    SeriesReport, SurfaceSettings, series_files, surfaces_of_steps, write_series,
};
use crate::surface::TriMesh;
use isospan_io::bytes::remote::{Traffic, traffic, traffic_since};
use isospan_io::error::Result;
use isospan_io::exec::{CancelToken, Clock, Progress};
use isospan_io::formats::StepSource;
use serde::Serialize;
use std::ops::{Deref, Range};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An archive opened for reading.
///
/// Opening reads the manifest. Every question reads what can hold its answer and nothing else.
/// Questions are asked of a [`Step`]: `archive.step(3)?.surface(600.0)?`. Most archives have one,
/// so an archive itself answers as its first step does: `archive.surface(600.0)?`. Questions may be
/// asked from several threads at one time.
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
    open: Arc<OpenArchive>,
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

    /// The contour spectra of many steps. The bytes read are those of each spectrum, and of the
    /// manifest with each.
    ///
    /// # Errors
    /// As [`Step::spectrum`]; [`crate::Error::Usage`] when no step is in the range.
    pub fn spectra(&self, steps: StepRange) -> Result<Vec<StepSpectrum>> {
        self.positions(steps)?.map(|n| StepSpectrum::of(&self.open.step_at(n))).collect()
    }

    /// Extracts the isosurfaces of many steps in memory, step after step. `each` gets the number
    /// and the time of a step, and its surfaces. Several steps are extracted at a time, as memory
    /// allows: what they share is decoded once. The memory of surfaces that `each` does not take is
    /// reused for later ones.
    ///
    /// ```
    /// # use isospan::{Archive, StepSource};
    /// # use isospan::pipeline::{StepRange, SurfaceSettings};
    /// # fn main() -> isospan::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("protein.isospan");
    /// # let steps = vec![StepSource::from("datasets/ironprot.vtk"); 2];
    /// # isospan::Reduction::of_steps(steps).write(&path)?;
    /// let archive = Archive::open(&path)?;
    /// let mut triangles = vec![];
    /// archive.surfaces_of_steps(StepRange::default(), &SurfaceSettings::of(100.0), |_step, time, surfaces| {
    ///     triangles.push((time, surfaces[0].triangles.len()));
    ///     Ok(())
    /// })?;
    /// assert_eq!(triangles.len(), archive.info()?.steps.len());
    /// # assert!(triangles.iter().all(|t| t.1 > 0));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`Archive::write_series`] but for files, and those of `each`.
    pub fn surfaces_of_steps(
        &self,
        steps: StepRange,
        settings: &SurfaceSettings,
        mut each: impl FnMut(u64, f64, &mut Vec<TriMesh>) -> Result<()>,
    ) -> Result<()> {
        surfaces_of_steps(&self.open, self.positions(steps)?, settings, &mut each)
    }

    /// Writes isosurfaces of many steps, as [`Step::write_surface`] does of one; the file's name
    /// holds `%d` or `%04d` in place of the step's number. It also writes a list of the files with
    /// their times.
    ///
    /// # Errors
    /// Those of [`Step::write_surface`]; [`crate::Error::Usage`] for a name without that place, and
    /// when no step is in the range.
    pub fn write_series(
        &self,
        steps: StepRange,
        settings: &SurfaceSettings,
        out: &Path,
        format: SurfaceFormat,
        progress: &dyn Progress,
    ) -> Result<SeriesReport> {
        write_series(&self.open, self.positions(steps)?, settings, out, format, progress)
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

    /// Writes the levels of many steps of a pyramid as one OME-Zarr image with an axis of time: see
    /// [`Step::write_ome_zarr`].
    ///
    /// # Errors
    /// Those of [`Step::write_ome_zarr`]; [`crate::Error::Usage`] when no step is in the range.
    pub fn write_ome_zarr_of_steps(
        &self,
        steps: StepRange,
        settings: &GridSettings,
        out: &Path,
        replace: bool,
        progress: &dyn Progress,
    ) -> Result<GridReport> {
        let moments = Moments::Steps(&self.open, self.positions(steps)?);
        export_zarr(&moments, settings, out, replace, progress)
    }

    /// The files that [`Archive::write_series`] writes: those of the steps, then the lists.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for a name without a place for the step's number, and when no step
    /// is in the range.
    pub fn series_files(
        &self,
        steps: StepRange,
        settings: &SurfaceSettings,
        out: &Path,
        format: SurfaceFormat,
    ) -> Result<Vec<PathBuf>> {
        series_files(&self.open, self.positions(steps)?, settings, out, format)
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
