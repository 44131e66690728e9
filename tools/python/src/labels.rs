//! Labels of an archive, asked from Python: which there are, and their surfaces.

use crate::archive::{Archive, Machine, When};
use crate::errors::{exception, usage};
use crate::json::to_python;
use crate::surface::{About, Surface};
use crate::work::run;
use isospan::formats::labels::{LabelStyle, LabelTable, palette};
use isospan::formats::surface::Compression;
use isospan::pipeline::{LabelQuery, Labels};
use isospan::{Resources, Step};
use pyo3::prelude::*;
use std::path::PathBuf;

/// A label, its name, and red, green, blue and opacity; by its number if it has no colour.
type Entry = (i64, String, Option<[u8; 4]>);

/// Names and colours.
#[derive(FromPyObject)]
enum Table {
    File(PathBuf),
    Entries(Vec<Entry>),
}

/// What is asked of labels.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct WantedLabels {
    /// None for all but the background.
    labels: Option<Vec<i64>>,
    /// Whether all includes it.
    background: bool,
    smooth: u32,
    table: Option<Table>,
    compress: Option<String>,
}

impl WantedLabels {
    fn labels(&self) -> Labels {
        match (&self.labels, self.background) {
            (Some(labels), _) => labels.clone().into(),
            (None, false) => Labels::All,
            (None, true) => Labels::AllWithBackground,
        }
    }

    fn table(&self) -> isospan::Result<LabelTable> {
        let mut table = LabelTable::default();
        match &self.table {
            None => {}
            Some(Table::File(path)) => table = LabelTable::read(path)?,
            Some(Table::Entries(entries)) => entries.iter().for_each(|(label, name, colour)| {
                let colour = colour.unwrap_or_else(|| palette(*label));
                table.insert(*label, LabelStyle { name: name.clone(), colour });
            }),
        }
        Ok(table)
    }

    /// The question, of a step.
    fn of(
        &self,
        py: Python<'_>,
        step: &Step,
        machine: &Machine,
    ) -> PyResult<(LabelQuery<'static>, Resources)> {
        if self.labels.is_some() && self.background {
            return Err(usage(py, "background is for all labels: name the label 0 among the others"));
        }
        let table = py.detach(|| self.table()).map_err(|e| exception(py, &e))?;
        let query = step.labels(self.labels()).smooth(self.smooth).table(table);
        let query = query.compress(match self.compress.as_deref() {
            None => Compression::None,
            Some("meshopt") => Compression::Meshopt,
            Some(_) => Compression::Quantized,
        });
        Ok((query, machine.resources(py)?))
    }
}

/// Labels with their names, colours and sizes.
#[pyfunction]
pub(crate) fn label_sizes<'py>(
    py: Python<'py>,
    archive: &Bound<'py, Archive>,
    wanted: WantedLabels,
    machine: Machine,
    when: When,
) -> PyResult<Bound<'py, PyAny>> {
    let (query, resources) = wanted.of(py, &archive.get().at(py, when)?, &machine)?;
    let sizes = run(py, None, |cancel, _| query.resources(resources.with_cancel(cancel.clone())).sizes())?;
    to_python(py, &sizes)
}

/// Surfaces in memory, one for each label, ascending.
#[pyfunction]
pub(crate) fn label_surfaces(
    py: Python<'_>,
    archive: &Bound<'_, Archive>,
    wanted: WantedLabels,
    machine: Machine,
    when: When,
) -> PyResult<Vec<Surface>> {
    let step = archive.get().at(py, when)?;
    let (query, resources) = wanted.of(py, &step, &machine)?;
    let meshes = run(py, None, |cancel, _| query.resources(resources.with_cancel(cancel.clone())).meshes())?;
    let about = About::of(&step);
    let surface = |found: isospan::pipeline::LabelMesh| {
        Surface::new(found.mesh, found.label.label as f64, &about.of_label(&found.label))
    };
    Ok(meshes.into_iter().map(surface).collect())
}

/// Surfaces in files, in bounded memory.
#[pyfunction]
pub(crate) fn save_labels<'py>(
    py: Python<'py>,
    archive: &Bound<'py, Archive>,
    out: PathBuf,
    wanted: WantedLabels,
    machine: Machine,
    when: When,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (query, resources) = wanted.of(py, &archive.get().at(py, when)?, &machine)?;
    let report = run(py, progress.as_ref(), |cancel, progress| {
        query.resources(resources.with_cancel(cancel.clone())).progress(progress).write(&out)
    })?;
    to_python(py, &report)
}
