//! An archive, asked from Python.

use crate::arrays::Numbers;
use crate::errors::{exception, usage};
use crate::json::to_python;
use crate::surface::{About, Surface};
use crate::volume::{Volume, raised_or};
use crate::work::run;
use isospan::exec::usable_memory;
use isospan::formats::samples::SampleFormat;
use isospan::formats::{OpenOptions, StepSource};
use isospan::pipeline::{
    self, Corners, ExportSettings, GridSettings, LevelChoice, ProbeSettings, Refine, Roi, RunSettings, Step,
    StepChoice, StepRange,
};
use isospan::surface::edit::{components::ComponentFilter, decimate::Decimation};
use isospan::{Resources, SurfaceQuery};
use isospan_cli::commands::grammar;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::{Mutex, PoisonError};

/// Whether there is an archive of this name.
#[pyfunction]
pub(crate) fn is_archive(path: PathBuf) -> bool {
    pipeline::is_archive(&path)
}

/// Keeps an object for ever. What a fork has copied of an archive is not taken down: its threads
/// are those of the parent, and so may be the owners of its locks.
#[pyfunction]
pub(crate) fn keep(object: Py<PyAny>) {
    std::mem::forget(object);
}

/// An archive, opened at a step; another step that was asked last is open too, with its cached
/// blocks.
#[pyclass(frozen)]
pub(crate) struct Archive {
    archive: isospan::Archive,
    here: Step,
    other: Mutex<Option<(StepChoice, Step)>>,
}

/// A step, by its number or the name of its field, or by both where it has several fields.
#[derive(FromPyObject, PartialEq)]
pub(crate) enum StepName {
    Number(u64),
    Field(String),
    Of(u64, String),
}

/// A step, or a time.
pub(crate) type When = (Option<StepName>, Option<f64>);

fn choice(py: Python<'_>, when: When) -> PyResult<StepChoice> {
    match when {
        (None, None) => Ok(StepChoice::First),
        (Some(StepName::Number(number)), None) => Ok(StepChoice::Number(number)),
        (Some(StepName::Field(name)), None) => Ok(StepChoice::Field(name)),
        (Some(StepName::Of(number, field)), None) => Ok(StepChoice::NumberOf(number, field)),
        (None, Some(time)) => Ok(StepChoice::Time(time)),
        (Some(_), Some(_)) => Err(usage(py, "give a step or a time, not both")),
    }
}

/// What the machine may be used for.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Machine {
    threads: usize,
    memory: Option<String>,
    scratch: Option<PathBuf>,
}

impl Machine {
    fn memory(&self, py: Python<'_>) -> PyResult<u64> {
        match &self.memory {
            None => Ok(usable_memory() / 2),
            Some(text) => grammar::memory(text).map_err(|e| usage(py, format!("memory: {e}"))),
        }
    }

    pub(crate) fn resources(&self, py: Python<'_>) -> PyResult<Resources> {
        let resources = Resources::default().with_threads(self.threads).with_memory(self.memory(py)?);
        Ok(resources.with_scratch(self.scratch.clone()))
    }

    fn probe(&self, py: Python<'_>, level: &LevelOf) -> PyResult<ProbeSettings> {
        Ok(ProbeSettings { resources: self.resources(py)?, level: level_choice(py, level)? })
    }
}

/// Which level of a pyramid is wanted: at most one of its number, a number of triangles, an error.
type LevelOf = (Option<u32>, Option<u64>, Option<String>);

fn level_choice(py: Python<'_>, level: &LevelOf) -> PyResult<Option<LevelChoice>> {
    match level {
        (None, None, None) => Ok(None),
        (Some(level), None, None) => Ok(Some(LevelChoice::Level(*level))),
        (None, Some(most), None) => Ok(Some(LevelChoice::Triangles(*most))),
        (None, None, Some(text)) => {
            let bound = grammar::error(text).map_err(|e| usage(py, format!("error: {e}")))?;
            Ok(Some(LevelChoice::Error(bound)))
        }
        _ => Err(usage(py, "give one of level, triangles and error")),
    }
}

/// Which surfaces are wanted.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Wanted {
    isovalues: Vec<f64>,
    roi: Option<String>,
    cap: bool,
    largest: Option<u64>,
    min_triangles: Option<u64>,
    min_volume: Option<f64>,
    decimate: Option<f64>,
    decimate_error: Option<f64>,
    smooth: Option<u32>,
    smooth_limit: Option<f64>,
    level: LevelOf,
}

fn parsed<T: FromStr>(py: Python<'_>, text: Option<&String>) -> PyResult<Option<T>>
where
    T::Err: std::fmt::Display,
{
    text.map(|text| text.parse().map_err(|e: T::Err| usage(py, e.to_string()))).transpose()
}

impl Wanted {
    fn refine(&self) -> Refine {
        let (all, far) = (ComponentFilter::default(), Decimation::default());
        let chosen = self.largest.is_some() || self.min_triangles.is_some() || self.min_volume.is_some();
        let components = chosen.then(|| ComponentFilter {
            largest: self.largest,
            min_triangles: self.min_triangles.unwrap_or(all.min_triangles),
            min_volume: self.min_volume.unwrap_or(all.min_volume),
        });
        let decimate = (self.decimate.is_some() || self.decimate_error.is_some()).then(|| Decimation {
            ratio: self.decimate.unwrap_or(far.ratio),
            max_error: self.decimate_error.unwrap_or(far.max_error),
        });
        Refine { components, smooth: self.smooth, smooth_limit: self.smooth_limit, decimate }
    }

    /// The question as it is wanted, of a step or of several.
    fn of<'q, Of>(&self, py: Python<'_>, query: SurfaceQuery<'q, Of>) -> PyResult<SurfaceQuery<'q, Of>> {
        let (roi, level) = (parsed::<Roi>(py, self.roi.as_ref())?, level_choice(py, &self.level)?);
        Ok(query.region(roi).cap(self.cap).refine(self.refine()).level(level))
    }
}

/// Which tetrahedra are wanted.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Part {
    range: Option<[f64; 2]>,
    any_corner: bool,
    roi: Option<String>,
    every: u64,
    compress: bool,
    fields: Vec<String>,
}

/// Which samples of a pyramid are wanted.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Grid {
    level: usize,
    roi: Option<String>,
    compress: bool,
    fields: Vec<String>,
    replace: bool,
}

/// What an archive is measured against.
#[derive(FromPyObject)]
pub(crate) enum Against {
    Volume(Py<Volume>),
    File(PathBuf),
}

impl Against {
    fn volumes(&self) -> &[Py<Volume>] {
        match self {
            Self::Volume(volume) => std::slice::from_ref(volume),
            Self::File(_) => &[],
        }
    }
}

impl Archive {
    /// The archive at a step; at the one that it was opened at, if none is given.
    pub(crate) fn at(&self, py: Python<'_>, when: When) -> PyResult<Step> {
        self.at_field(py, when, None)
    }

    /// As [`Archive::at`], of a field that is known.
    fn at_field(&self, py: Python<'_>, when: When, field: Option<&String>) -> PyResult<Step> {
        if when == (None, None) {
            return Ok(self.here.clone());
        }
        let choice = match (choice(py, when)?, field.cloned()) {
            (StepChoice::Number(number), Some(field)) => StepChoice::NumberOf(number, field),
            (StepChoice::Time(time), Some(field)) => StepChoice::TimeOf(time, field),
            (choice, _) => choice,
        };
        py.detach(|| {
            let mut other = self.other.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((known, step)) = &*other
                && *known == choice
            {
                return Ok(step.clone());
            }
            let step = self.archive.at(choice.clone())?;
            *other = Some((choice, step.clone()));
            Ok(step)
        })
        .map_err(|e| exception(py, &e))
    }
}

#[pymethods]
impl Archive {
    #[new]
    fn open(py: Python<'_>, path: PathBuf, when: When) -> PyResult<Self> {
        let choice = choice(py, when)?;
        let open = || isospan::Archive::open(&path).and_then(|a| a.at(choice).map(|step| (a, step)));
        let (archive, here) = py.detach(open).map_err(|e| exception(py, &e))?;
        Ok(Self { archive, here, other: Mutex::new(None) })
    }

    fn info<'py>(&self, py: Python<'py>, when: When) -> PyResult<Bound<'py, PyAny>> {
        let archive = self.at(py, when)?;
        let report = py.detach(|| archive.info()).map_err(|e| exception(py, &e))?;
        to_python(py, &report)
    }

    #[getter]
    fn dims(&self) -> [u64; 3] {
        self.here.dims()
    }

    #[getter]
    fn geometry<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.here.geometry())
    }

    #[getter]
    fn units<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, self.here.units())
    }

    fn value_range(&self, py: Python<'_>, when: When) -> PyResult<Option<[f64; 2]>> {
        Ok(self.at(py, when)?.value_range())
    }

    /// Least and largest value of some steps together; none where no point has a value.
    fn range_of_steps(&self, py: Python<'_>, steps: Option<String>) -> PyResult<Option<[f64; 2]>> {
        let steps: StepRange = parsed(py, steps.as_ref())?.unwrap_or_default();
        let info = py.detach(|| self.archive.info()).map_err(|e| exception(py, &e))?;
        let ranges = info.steps.into_iter().filter(|s| steps.contains(s.number)).filter_map(|s| s.range);
        Ok(ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]))
    }

    fn spectrum<'py>(&self, py: Python<'py>, when: When) -> PyResult<Bound<'py, PyAny>> {
        let archive = self.at(py, when)?;
        let report = run(py, None, |_, _| archive.spectrum())?;
        to_python(py, &report)
    }

    fn count(&self, py: Python<'_>, isovalue: f64, level: LevelOf, when: When) -> PyResult<u64> {
        let archive = self.at(py, when)?;
        let level = level_choice(py, &level)?;
        let query = archive.query(isovalue).level(level);
        let report = run(py, None, |cancel, _| {
            query.resources(Resources::default().with_cancel(cancel.clone())).count()
        })?;
        Ok(report.active_cells)
    }

    /// Area, volumes, pieces and more at an isovalue.
    fn numbers<'py>(
        &self,
        py: Python<'py>,
        isovalue: f64,
        level: LevelOf,
        machine: Machine,
        when: When,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (archive, resources) = (self.at(py, when)?, machine.resources(py)?);
        let query = archive.query(isovalue).level(level_choice(py, &level)?);
        let report =
            run(py, None, |cancel, _| query.resources(resources.with_cancel(cancel.clone())).numbers())?;
        to_python(py, &report)
    }

    /// Surfaces in memory, one for each isovalue.
    fn surfaces(
        &self,
        py: Python<'_>,
        wanted: Wanted,
        machine: Machine,
        when: When,
    ) -> PyResult<Vec<Surface>> {
        let archive = self.at(py, when)?;
        let query = wanted.of(py, archive.query(&wanted.isovalues))?;
        let resources = machine.resources(py)?;
        let meshes =
            run(py, None, |cancel, _| query.resources(resources.with_cancel(cancel.clone())).meshes())?;
        let about = About::of(&archive);
        let surfaces = meshes.into_iter().zip(&wanted.isovalues);
        Ok(surfaces.map(|(mesh, &isovalue)| Surface::new(mesh, isovalue, &about)).collect())
    }

    /// Surfaces in files, in bounded memory.
    #[allow(clippy::too_many_arguments)]
    fn save_surfaces<'py>(
        &self,
        py: Python<'py>,
        out: PathBuf,
        wanted: Wanted,
        machine: Machine,
        when: When,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let archive = self.at(py, when)?;
        let query = wanted.of(py, archive.query(&wanted.isovalues))?;
        let resources = machine.resources(py)?;
        let report = run(py, progress.as_ref(), |cancel, progress| {
            query.resources(resources.with_cancel(cancel.clone())).progress(progress).write(&out)
        })?;
        to_python(py, &report)
    }

    /// Surfaces of many steps in files.
    fn save_series<'py>(
        &self,
        py: Python<'py>,
        out: PathBuf,
        wanted: Wanted,
        machine: Machine,
        steps: Option<String>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let steps: StepRange = parsed(py, steps.as_ref())?.unwrap_or_default();
        let steps = self.archive.steps(steps).map_err(|e| exception(py, &e))?;
        let query = wanted.of(py, steps.query(&wanted.isovalues))?;
        let resources = machine.resources(py)?;
        let report = run(py, progress.as_ref(), |cancel, progress| {
            query.resources(resources.with_cancel(cancel.clone())).progress(progress).write(&out)
        })?;
        to_python(py, &report)
    }

    /// Values at points: three doubles each.
    fn probe(
        &self,
        py: Python<'_>,
        points: &[u8],
        level: LevelOf,
        machine: Machine,
        when: When,
    ) -> PyResult<Numbers> {
        let archive = self.at(py, when)?;
        if !points.len().is_multiple_of(24) {
            return Err(usage(py, "a point is three numbers of 8 bytes"));
        }
        let settings = machine.probe(py, &level)?;
        let points: Vec<[f64; 3]> = bytemuck::pod_collect_to_vec(points);
        let values = run(py, None, |cancel, _| {
            archive.probe_with(
                &points,
                &ProbeSettings { resources: settings.resources.with_cancel(cancel.clone()), ..settings },
            )
        })?;
        Ok(Numbers::new(values))
    }

    /// The field on a grid, x fastest.
    fn sample(
        &self,
        py: Python<'_>,
        dims: [u64; 3],
        level: LevelOf,
        machine: Machine,
        when: When,
    ) -> PyResult<Numbers> {
        let archive = self.at(py, when)?;
        let settings = machine.probe(py, &level)?;
        let values = run(py, None, |cancel, _| {
            archive.sample_with(
                dims,
                &ProbeSettings { resources: settings.resources.with_cancel(cancel.clone()), ..settings },
            )
        })?;
        Ok(Numbers::new(values))
    }

    /// The field on a grid in a file.
    #[allow(clippy::too_many_arguments)]
    fn save_samples<'py>(
        &self,
        py: Python<'py>,
        out: PathBuf,
        dims: [u64; 3],
        level: LevelOf,
        machine: Machine,
        when: When,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let archive = self.at(py, when)?;
        let settings = machine.probe(py, &level)?;
        let report = run(py, progress.as_ref(), |cancel, progress| {
            let resources = settings.resources.with_cancel(cancel.clone());
            let settings = ProbeSettings { resources, ..settings };
            archive.write_samples(dims, &settings, &out, SampleFormat::from_path(&out)?, progress)
        })?;
        to_python(py, &report)
    }

    /// Tetrahedra in a VTU or VTKHDF file.
    #[allow(clippy::too_many_arguments)]
    fn save_tetrahedra<'py>(
        &self,
        py: Python<'py>,
        out: PathBuf,
        part: Part,
        machine: Machine,
        when: When,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let archive = self.at_field(py, when, part.fields.first())?;
        let settings = ExportSettings {
            fields: part.fields,
            resources: machine.resources(py)?,
            range: part.range,
            corners: if part.any_corner { Corners::Any } else { Corners::All },
            roi: parsed(py, part.roi.as_ref())?,
            every: part.every,
            compress: part.compress,
        };
        let report = run(py, progress.as_ref(), |cancel, progress| {
            archive.write_tetrahedra(
                &ExportSettings {
                    resources: settings.resources.clone().with_cancel(cancel.clone()),
                    ..settings
                },
                &out,
                progress,
            )
        })?;
        to_python(py, &report)
    }

    /// Samples of a level of a pyramid in a file, or an OME-Zarr image of all coarser levels too.
    #[allow(clippy::too_many_arguments)]
    fn save_grid<'py>(
        &self,
        py: Python<'py>,
        out: PathBuf,
        grid: Grid,
        machine: Machine,
        when: When,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let archive = self.at_field(py, when, grid.fields.first())?;
        let settings = GridSettings {
            fields: grid.fields,
            level: grid.level,
            roi: parsed(py, grid.roi.as_ref())?,
            compress: grid.compress,
            resources: machine.resources(py)?,
        };
        let report = run(py, progress.as_ref(), |cancel, progress| {
            let resources = settings.resources.clone().with_cancel(cancel.clone());
            let settings = GridSettings { resources, ..settings };
            match out.extension().is_some_and(|e| e == "zarr") {
                true => archive.write_ome_zarr(&settings, &out, grid.replace, progress),
                false => archive.write_grid(&settings, &out, SampleFormat::from_path(&out)?, progress),
            }
        })?;
        to_python(py, &report)
    }

    /// The field against every sample of a file, or of a volume.
    #[allow(clippy::too_many_arguments)]
    fn measure<'py>(
        &self,
        py: Python<'py>,
        against: Against,
        isovalues: Vec<f64>,
        field: Option<String>,
        step: Option<u64>,
        map: Option<PathBuf>,
        level: LevelOf,
        machine: Machine,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (resources, level) = (machine.resources(py)?, level_choice(py, &level)?);
        let options = OpenOptions { field, ..OpenOptions::default() };
        let done = run(py, progress.as_ref(), |cancel, progress| {
            let resources = resources.with_cancel(cancel.clone());
            let source = match &against {
                Against::File(path) => StepSource::new(path, &options),
                Against::Volume(volume) => {
                    let run = RunSettings { resources: resources.clone(), ..RunSettings::default() };
                    volume.get().step(&run, progress)?
                }
            };
            let measurement = self.archive.measure(source).isovalues(isovalues).step(step);
            let measurement = measurement.level(level).map(map);
            measurement.resources(resources).progress(progress).run()
        });
        to_python(py, &done.map_err(|e| raised_or(e, against.volumes()))?)
    }

    /// Verifies all of it.
    fn check(&self, py: Python<'_>) -> PyResult<()> {
        run(py, None, |cancel, _| self.archive.check_until(cancel).map(|_| ()))
    }
}
