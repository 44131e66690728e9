//! Surfaces: the memory in which the library made them, seen by NumPy.

use crate::archive::Machine;
use crate::arrays::interface;
use crate::json::to_python;
use crate::work::run;
use isospan::compare::{CompareSettings, compare};
use isospan::formats::labels::LabelStyle;
use isospan::formats::surface::{SurfaceFormat, SurfaceMeta, SurfacePart, write_surface};
use isospan::pipeline::OneLabel;
use isospan::surface::check::check;
use isospan::surface::edit::components::split;
use isospan::surface::{Joined, SurfaceSource, TriMesh};
use isospan::volume::units::Units;
use isospan::{Resources, Step};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// An isosurface in memory. Arrays that see it keep it alive; none of them can be written to.
#[pyclass(frozen)]
pub(crate) struct Surface {
    mesh: TriMesh,
    isovalue: f64,
    about: About,
}

/// What a file says of a surface besides.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct About {
    /// Where it is from.
    comment: String,
    units: Units,
    time: Option<f64>,
    /// Of a label's surface, the label.
    #[serde(default)]
    label: Option<LabelAbout>,
}

/// A label, and how it is shown.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct LabelAbout {
    label: i64,
    name: String,
    colour: [u8; 4],
    voxels: u64,
}

impl About {
    /// That of a surface of a step.
    pub(crate) fn of(step: &Step) -> Self {
        let comment = format!("isospan {} of {}", env!("CARGO_PKG_VERSION"), step.source());
        Self { comment, units: step.units().clone(), time: step.time(), label: None }
    }

    /// That of the surface of a label.
    pub(crate) fn of_label(&self, one: &OneLabel) -> Self {
        let OneLabel { label, voxels, colour, name, .. } = one;
        let about = LabelAbout { label: *label, name: name.clone(), colour: *colour, voxels: *voxels };
        Self { label: Some(about), ..self.clone() }
    }
}

/// Bytes of a position and a normal.
const VERTEX_BYTES: usize = 24;

impl Surface {
    pub(crate) fn new(mesh: TriMesh, isovalue: f64, about: &About) -> Self {
        Self { mesh, isovalue, about: about.clone() }
    }

    fn meta(&self) -> SurfaceMeta {
        let About { comment, units, time, label } = self.about.clone();
        let (isovalue, parts) = match label {
            None => (Some(self.isovalue), vec![]),
            Some(_) => (None, vec![self.part()]),
        };
        SurfaceMeta { isovalue, comments: vec![comment], parts, units, time, ..SurfaceMeta::default() }
    }

    /// It as one of several in a file.
    fn part(&self) -> SurfacePart {
        let label = self.about.label.clone();
        SurfacePart {
            isovalue: self.isovalue,
            vertices: self.mesh.vertex_count(),
            triangles: self.mesh.triangle_count(),
            label: label.map(|LabelAbout { name, colour, .. }| LabelStyle { name, colour }),
        }
    }
}

#[pymethods]
impl Surface {
    /// A surface whose arrays were bytes.
    #[new]
    fn from_bytes(
        py: Python<'_>,
        vertices: &[u8],
        faces: &[u8],
        isovalue: f64,
        about: &str,
        origin: [f64; 3],
    ) -> PyResult<Self> {
        let broken = || crate::errors::usage(py, "these are no bytes of a surface");
        if !vertices.len().is_multiple_of(VERTEX_BYTES) || !faces.len().is_multiple_of(12) {
            return Err(broken());
        }
        let mesh = TriMesh {
            vertices: bytemuck::pod_collect_to_vec(vertices),
            triangles: bytemuck::pod_collect_to_vec(faces),
            origin,
        };
        let count = mesh.vertices.len() as u64;
        if mesh.triangles.iter().flatten().any(|&v| u64::from(v) >= count) {
            return Err(broken());
        }
        Ok(Self::new(mesh, isovalue, &serde_json::from_str(about).map_err(|_| broken())?))
    }

    #[getter]
    fn isovalue(&self) -> f64 {
        self.isovalue
    }

    /// Comment, units, time and label, as JSON.
    #[getter]
    fn about(&self) -> String {
        serde_json::json!(self.about).to_string()
    }

    /// The place in the world that positions are counted from.
    #[getter]
    fn origin(&self) -> [f64; 3] {
        self.mesh.origin
    }

    #[getter]
    fn vertex_count(&self) -> usize {
        self.mesh.vertices.len()
    }

    #[getter]
    fn face_count(&self) -> usize {
        self.mesh.triangles.len()
    }

    /// The array interface of the vertices: rows of a position and a normal.
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        interface(py, "<f4", &[self.mesh.vertices.len(), 6], self.mesh.vertices.as_ptr().addr(), true)
    }

    /// The array interface of the faces.
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        interface(py, "<u4", &[self.mesh.triangles.len(), 3], self.mesh.triangles.as_ptr().addr(), true)
    }

    /// Both arrays as bytes.
    fn to_bytes<'py>(&self, py: Python<'py>) -> (Bound<'py, PyBytes>, Bound<'py, PyBytes>) {
        let vertices = bytemuck::cast_slice(&self.mesh.vertices);
        (PyBytes::new(py, vertices), PyBytes::new(py, bytemuck::cast_slice(&self.mesh.triangles)))
    }

    /// Area, volume, bounds, and whether it is closed, as `isospan check` reports them.
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let report = py.detach(|| check(&self.mesh));
        to_python(py, &report)
    }

    /// Its connected components, those of most triangles first.
    fn components(&self, py: Python<'_>) -> Vec<Surface> {
        let split = py.detach(|| split(&self.mesh));
        split.into_iter().map(|mesh| Self::new(mesh, self.isovalue, &self.about)).collect()
    }

    /// Distances to another surface and back, as `isospan compare` reports them.
    fn compare<'py>(
        &self,
        py: Python<'py>,
        other: &Bound<'py, Surface>,
        samples: u64,
        machine: Machine,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (resources, other) = (machine.resources(py)?, other.get());
        let report = run(py, None, |cancel, _| {
            let resources = resources.with_cancel(cancel.clone());
            compare(&self.mesh, &other.mesh, &CompareSettings { samples, resources })
        })?;
        to_python(py, &report)
    }

    /// Writes a file; returns its bytes.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<u64> {
        run(py, None, |cancel, _| {
            let resources = Resources::default().with_cancel(cancel.clone());
            write_surface(&self.mesh, &path, SurfaceFormat::from_path(&path)?, &self.meta(), &resources)
        })
    }

    /// Writes several surfaces to one file, as the program does; returns its bytes.
    #[staticmethod]
    fn save_all(py: Python<'_>, surfaces: Vec<Bound<'_, Surface>>, path: PathBuf) -> PyResult<u64> {
        let surfaces: Vec<&Surface> = surfaces.iter().map(Bound::get).collect();
        if let [one] = surfaces[..] {
            return one.save(py, path);
        }
        let Some(first) = surfaces.first() else {
            return Err(crate::errors::usage(py, "there is no surface to write"));
        };
        if surfaces.iter().any(|s| s.about.label.is_some() != first.about.label.is_some()) {
            return Err(crate::errors::usage(py, "surfaces of isovalues and of labels are two files"));
        }
        let parts = surfaces.iter().map(|s| s.part()).collect();
        let meta = SurfaceMeta { isovalue: None, parts, ..first.meta() };
        run(py, None, |cancel, _| {
            let joined = Joined::new(surfaces.iter().map(|s| &s.mesh as &dyn SurfaceSource).collect());
            let resources = Resources::default().with_cancel(cancel.clone());
            write_surface(&joined, &path, SurfaceFormat::from_path(&path)?, &meta, &resources)
        })
    }
}
