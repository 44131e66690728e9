//! Volumes that are arrays: read in place where they are in memory or in a file that the library
//! reads itself, else copied once, box by box, to a file.

use crate::errors::{exception, usage};
use isospan::bytes::ByteSource;
use isospan::exec::Progress;
use isospan::formats::{Input, OpenOptions, StepSource, counted_from, steps_of};
use isospan::grid::{Geometry, IndexBox};
use isospan::pipeline::{RunSettings, brick};
use isospan::volume::bricked::BrickedVolume;
use isospan::volume::memory::info_of;
use isospan::volume::strided::StridedVolume;
use isospan::volume::{ScalarType, SlabStream, VolumeInfo, VolumeReader, VolumeSource};
use isospan::{Error, Result};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// A volume that Python code gives.
#[pyclass(frozen)]
pub(crate) struct Volume {
    samples: Samples,
    /// Coordinates of its samples along x, y, z, where they are uneven.
    axes: Option<Axes>,
    /// What that code raised while it was asked for samples.
    raised: Raised,
}

enum Samples {
    InPlace(Arc<StridedVolume>),
    Boxes(Box<VolumeInfo>, Py<PyAny>),
    File(Box<StepSource>),
}

/// Coordinates along x, y, z.
type Axes = [Vec<f64>; 3];

/// Where samples of an array lie in the world.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Place {
    origin: [f64; 3],
    spacing: [f64; 3],
    /// The directions of the axes x, y, z.
    direction: Option<[[f64; 3]; 3]>,
    /// Coordinates in place of all these.
    axes: Option<Axes>,
}

impl Place {
    fn geometry(&self) -> Geometry {
        let mut geometry = placed(self.origin, self.spacing);
        geometry.direction = self.direction.unwrap_or(geometry.direction);
        geometry
    }
}

/// Which array of a file is meant, and where it lies, if the user says so.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct InFile {
    path: PathBuf,
    field: Option<String>,
    channel: Option<String>,
    spacing: Option<[f64; 3]>,
    origin: Option<[f64; 3]>,
}

impl InFile {
    fn options(self) -> OpenOptions {
        let Self { field, channel, spacing, origin, .. } = self;
        OpenOptions { field, channel, spacing, origin, replaces_place: true, ..OpenOptions::default() }
    }

    /// The steps of the array, and what its file says of it. A sample is read, so that a filter or
    /// a codec that the library lacks is found here.
    fn steps(self) -> Result<(Vec<StepSource>, VolumeInfo)> {
        let path = self.path.clone();
        let has_spacing = self.spacing.is_some();
        let options = self.options();
        let steps = steps_of(&[path], &options)?;
        let first = &steps[0];
        let Input::Volume(volume) = first.open()? else {
            return Err(Error::bad_input(&first.path, "kind of file", "a volume", "a mesh"));
        };
        if let VolumeSource::Chunked(chunks) = &volume {
            chunks.decode([0; 3], &mut vec![])?;
        }
        let of_file = StepSource::new(&first.path, &OpenOptions { replaces_place: false, ..options.clone() });
        if options.origin.is_some() && !has_spacing && has_coordinates(&of_file) {
            let path = first.path.display();
            return Err(Error::usage(format!("{path} has uneven coordinates: give `spacing` with `origin`")));
        }
        Ok((steps, volume.info().clone()))
    }
}

fn has_coordinates(step: &StepSource) -> bool {
    step.coordinates().is_ok_and(|found| found.is_some())
}

/// What a file says of the samples of an array.
#[derive(IntoPyObject)]
struct Found {
    dims: [u64; 3],
    scalar: String,
    slope: f64,
    intercept: f64,
}

/// An exception that waits to be raised where the work has ended.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// Bytes of an array, which stays as long as this.
struct Held {
    _array: Py<PyAny>,
    first: *const u8,
    len: usize,
}

// SAFETY: the memory is that of an array that is held here, and it is not written to: as with a
// mapped file, the caller promises that, and the documentation of `isospan.reduce` says so.
#[allow(unsafe_code)]
unsafe impl Send for Held {}
// SAFETY: as above; it is only read.
#[allow(unsafe_code)]
unsafe impl Sync for Held {}

impl AsRef<[u8]> for Held {
    #[allow(unsafe_code)]
    fn as_ref(&self) -> &[u8] {
        // SAFETY: `of_array` has computed the range from the array's own address, shape and steps,
        // all of it lies in the array's memory, and the array is held.
        unsafe { std::slice::from_raw_parts(self.first, self.len) }
    }
}

/// The array interface of an array of three dimensions.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Interface {
    shape: [usize; 3],
    typestr: String,
    data: (usize, bool),
    strides: Option<[isize; 3]>,
}

/// The type of samples of a name.
fn scalar_of(name: &str, scalar: &str) -> Result<ScalarType> {
    ScalarType::from_name(scalar).ok_or_else(|| Error::usage(format!("{name}: no type {scalar}")))
}

fn placed(origin: [f64; 3], spacing: [f64; 3]) -> Geometry {
    // A step of a coordinate may go down: then the axis points the other way.
    let mut direction = Geometry::default().direction;
    (0..3).filter(|&a| spacing[a] < 0.0).for_each(|a| direction[a][a] = -1.0);
    Geometry { origin, spacing: spacing.map(f64::abs), direction }
}

impl Interface {
    fn volume(
        &self,
        name: &str,
        array: Py<PyAny>,
        scalar: ScalarType,
        geometry: Geometry,
    ) -> Result<StridedVolume> {
        let big_endian = self.typestr.starts_with('>');
        let size = scalar.bytes() as isize;
        let [nz, ny, nx] = self.shape;
        let packed = [(ny * nx) as isize * size, nx as isize * size, size];
        let steps = self.strides.unwrap_or(packed);
        if self.shape.contains(&0) {
            return Err(Error::usage(format!("{name}: an array of shape {:?} has no samples", self.shape)));
        }
        // The first and the last byte, as far as steps go down and up.
        let reach = |up: bool| -> isize {
            let along = self.shape.iter().zip(steps).filter(|(_, step)| (*step > 0) == up);
            along.map(|(&n, step)| (n as isize - 1) * step).sum()
        };
        let (below, above) = (reach(false), reach(true) + size);
        let first = std::ptr::with_exposed_provenance::<u8>(self.data.0.wrapping_add_signed(below));
        let held = Held { _array: array, first, len: (above - below) as usize };
        let [z, y, x] = steps.map(|step| step as i64);
        let dims = [nx, ny, nz].map(|n| n as u64);
        let source = Arc::new(ByteSource::in_memory(name, held));
        let info = info_of(name, dims, scalar);
        Ok(StridedVolume::new(info, source, below.unsigned_abs() as u64, big_endian, [x, y, z])?
            .placed(geometry))
    }
}

#[pymethods]
impl Volume {
    /// An array of NumPy, which must not change while it is read.
    #[staticmethod]
    fn of_array(name: &str, array: Bound<'_, PyAny>, scalar: &str, place: Place) -> PyResult<Self> {
        let py = array.py();
        let about = array.getattr("__array_interface__")?;
        // A key that is not there means the same as None.
        let about = about.cast::<PyDict>()?.copy()?;
        if !about.contains("strides")? {
            about.set_item("strides", py.None())?;
        }
        let about: Interface = about.extract()?;
        let volume = scalar_of(name, scalar)
            .and_then(|scalar| about.volume(name, array.unbind(), scalar, place.geometry()))
            .map_err(|e| exception(py, &e))?;
        let samples = Samples::InPlace(Arc::new(volume));
        Ok(Self { samples, axes: place.axes, raised: Raised::default() })
    }

    /// What gives, called without arguments, an iterator over boxes that tile the volume: lowest
    /// corner, highest corner (not included), and samples, x fastest, as little-endian bytes.
    #[staticmethod]
    fn of_boxes(
        py: Python<'_>,
        name: &str,
        dims: [u64; 3],
        scalar: &str,
        place: Place,
        boxes: Py<PyAny>,
    ) -> PyResult<Self> {
        let scalar = scalar_of(name, scalar).map_err(|e| exception(py, &e))?;
        if dims.contains(&0) {
            return Err(usage(py, format!("{name}: an array of {dims:?} samples has none")));
        }
        let info = VolumeInfo { geometry: place.geometry(), ..info_of(name, dims, scalar) };
        let samples = Samples::Boxes(Box::new(info), boxes);
        Ok(Self { samples, axes: place.axes, raised: Raised::default() })
    }

    /// An array in a file that the library reads itself: a volume for each of its steps, and what
    /// the file says of it.
    #[staticmethod]
    fn of_file(py: Python<'_>, found: InFile) -> PyResult<(Vec<Self>, Found)> {
        let (steps, info) = py.detach(|| found.steps()).map_err(|e| exception(py, &e))?;
        let volume =
            |step| Self { samples: Samples::File(Box::new(step)), axes: None, raised: Raised::default() };
        let found = Found {
            dims: info.dims,
            scalar: info.field.scalar.name().to_owned(),
            slope: info.slope,
            intercept: info.intercept,
        };
        Ok((steps.into_iter().map(volume).collect(), found))
    }
}

impl Volume {
    /// What Python code has raised, once.
    pub(crate) fn take_raised(&self) -> Option<PyErr> {
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// The volume as a step; what is no array in memory is copied to a file without a name in the
    /// scratch folder.
    pub(crate) fn step(&self, run: &RunSettings, progress: &dyn Progress) -> Result<StepSource> {
        let (info, reader): (_, Arc<dyn VolumeReader>) = match &self.samples {
            Samples::File(step) => return Ok(StepSource::clone(step)),
            Samples::InPlace(volume) => (volume.info(), Arc::clone(volume) as _),
            Samples::Boxes(info, boxes) => {
                let samples = self.copy(info, boxes, run, progress)?;
                (info, Arc::new(Copied { info: VolumeInfo::clone(info), samples }))
            }
        };
        let name = info.path.to_string_lossy();
        match &self.axes {
            Some(axes) => StepSource::given_on_axes(&name, reader, axes.clone()),
            None => Ok(StepSource::given(&name, reader)),
        }
    }

    fn copy(
        &self,
        info: &VolumeInfo,
        boxes: &Py<PyAny>,
        run: &RunSettings,
        progress: &dyn Progress,
    ) -> Result<BrickedVolume> {
        let folder = run.resources.scratch.clone().unwrap_or_else(std::env::temp_dir);
        let place = tempfile::Builder::new()
            .prefix("isospan-array-")
            .tempdir_in(&folder)
            .map_err(|e| Error::io("make a folder in", &folder, e))?;
        let file = place.path().join("samples.bricks");
        let stream = Boxes {
            info: info.clone(),
            boxes: Python::attach(|py| boxes.clone_ref(py)),
            iterator: None,
            raised: Arc::clone(&self.raised),
        };
        let source = VolumeSource::Stream(Box::new(stream));
        brick(source, &file, run.resources.memory / 4, &run.resources.cancel, progress)?;
        // The folder goes; the open file stays until it is closed.
        BrickedVolume::open(&file)
    }
}

/// The copy of an array, by the array's name.
struct Copied {
    info: VolumeInfo,
    samples: BrickedVolume,
}

impl VolumeReader for Copied {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn read_box(&self, voxels: IndexBox, out: &mut [f32]) -> Result<()> {
        self.samples.read_box(voxels, out)
    }

    fn will_need(&self, voxels: IndexBox) {
        self.samples.will_need(voxels);
    }

    fn release(&self, slices: Range<u64>) {
        self.samples.release(slices);
    }

    fn stored_info(&self) -> VolumeInfo {
        self.samples.stored_info()
    }

    fn read_stored(&self, voxels: IndexBox, out: &mut [u8]) -> Result<()> {
        self.samples.read_stored(voxels, out)
    }
}

/// Boxes of samples that Python code gives.
struct Boxes {
    info: VolumeInfo,
    boxes: Py<PyAny>,
    iterator: Option<Py<PyAny>>,
    raised: Raised,
}

/// Corners of a box, and its samples.
type OneBox<'py> = ([u64; 3], [u64; 3], Bound<'py, pyo3::types::PyBytes>);

impl Boxes {
    fn next(&mut self, py: Python<'_>, out: &mut Vec<u8>) -> PyResult<Option<IndexBox>> {
        let iterator = match &self.iterator {
            Some(iterator) => iterator.bind(py).clone(),
            None => self.boxes.bind(py).call0()?.try_iter()?.into_any(),
        };
        self.iterator = Some(iterator.clone().unbind());
        let Some(found) = iterator.try_iter()?.next() else { return Ok(None) };
        let (lo, hi, bytes): OneBox<'_> = found?.extract()?;
        out.extend_from_slice(bytes.as_bytes());
        Ok(Some(IndexBox { lo, hi }))
    }
}

impl SlabStream for Boxes {
    fn info(&self) -> &VolumeInfo {
        &self.info
    }

    fn next_slab(&mut self, out: &mut Vec<u8>) -> Result<Option<IndexBox>> {
        out.clear();
        Python::attach(|py| self.next(py, out)).map_err(|raised| {
            let text = raised.to_string();
            *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(raised);
            Error::bad_input(&self.info.path, "samples", "values", text)
        })
    }
}

/// The steps of volumes. Those of one file hold it open together.
pub(crate) fn steps(
    volumes: &[Py<Volume>],
    run: &RunSettings,
    progress: &dyn Progress,
) -> Result<Vec<StepSource>> {
    let steps = volumes.iter().map(|volume| volume.get().step(run, progress));
    Ok(counted_alike(StepSource::holding_together(steps.collect::<Result<_>>()?)))
}

/// Steps of several files whose times all count from the date of the first one.
fn counted_alike(steps: Vec<StepSource>) -> Vec<StepSource> {
    let first = steps.first().filter(|step| steps.len() > 1 && step.time.is_some() && !step.is_given());
    let Some(Ok(Input::Volume(volume))) = first.map(StepSource::open) else { return steps };
    match volume.info().units.time.clone() {
        Some(unit) => counted_from(steps, &unit),
        None => steps,
    }
}

/// What the code of volumes has raised, if that is why the work has failed.
pub(crate) fn raised_or(error: PyErr, volumes: &[Py<Volume>]) -> PyErr {
    volumes.iter().find_map(|volume| volume.get().take_raised()).unwrap_or(error)
}
