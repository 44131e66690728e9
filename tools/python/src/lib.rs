//! The extension module of the Python package `isospan`: what its Python code is built on.
//!
//! Nothing here is for users: names, defaults and documentation are in `python/isospan`. Work is
//! done without the GIL on a thread of its own, while the calling thread looks for signals and
//! reports progress.

mod archive;
mod arrays;
mod errors;
mod json;
mod labels;
mod pictures;
mod reduce;
mod surface;
mod volume;
mod words;
mod work;

use isospan_cli::commands;
use pyo3::prelude::*;
use std::ffi::OsString;

/// Runs the program on arguments, the first of which is its name; returns the exit code.
#[pyfunction]
fn program(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| commands::main(arguments))
}

#[pymodule]
fn _isospan(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(program, module)?)?;
    module.add_function(wrap_pyfunction!(reduce::reduce, module)?)?;
    module.add_function(wrap_pyfunction!(reduce::estimate, module)?)?;
    module.add_function(wrap_pyfunction!(reduce::append, module)?)?;
    module.add_function(wrap_pyfunction!(reduce::plan, module)?)?;
    module.add_function(wrap_pyfunction!(reduce::status, module)?)?;
    module.add_function(wrap_pyfunction!(reduce::work, module)?)?;
    module.add_function(wrap_pyfunction!(reduce::commit, module)?)?;
    module.add_function(wrap_pyfunction!(pictures::render, module)?)?;
    module.add_function(wrap_pyfunction!(pictures::publish, module)?)?;
    module.add_function(wrap_pyfunction!(labels::label_sizes, module)?)?;
    module.add_function(wrap_pyfunction!(labels::label_surfaces, module)?)?;
    module.add_function(wrap_pyfunction!(labels::save_labels, module)?)?;
    module.add_function(wrap_pyfunction!(archive::is_archive, module)?)?;
    module.add_function(wrap_pyfunction!(archive::keep, module)?)?;
    module.add_function(wrap_pyfunction!(words::isovalue, module)?)?;
    module.add_function(wrap_pyfunction!(words::share, module)?)?;
    module.add_class::<archive::Archive>()?;
    module.add_class::<arrays::Numbers>()?;
    module.add_class::<volume::Volume>()?;
    module.add_class::<surface::Surface>()
}
