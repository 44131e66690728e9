//! Arrays without a copy, both ways: NumPy sees our memory, and we see that of arrays, by the array
//! interface.

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

/// The array interface of memory, which the object that has it keeps in its place.
pub(crate) fn interface<'py>(
    py: Python<'py>,
    typestr: &str,
    shape: &[usize],
    address: usize,
    read_only: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let about = PyDict::new(py);
    about.set_item("version", 3)?;
    about.set_item("typestr", typestr)?;
    about.set_item("shape", PyTuple::new(py, shape)?)?;
    about.set_item("data", (address, read_only))?;
    Ok(about)
}

/// Numbers that an array sees, and keeps alive; nothing here reads them again.
#[pyclass(frozen)]
pub(crate) struct Numbers {
    address: usize,
    values: Vec<f64>,
}

impl Numbers {
    pub(crate) fn new(mut values: Vec<f64>) -> Self {
        // Whoever has the array may write: the address is one that may be written to.
        Self { address: values.as_mut_ptr().expose_provenance(), values }
    }
}

#[pymethods]
impl Numbers {
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        interface(py, "<f8", &[self.values.len()], self.address, false)
    }
}
