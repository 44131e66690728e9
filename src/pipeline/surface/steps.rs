//! Step after step of an archive: what is done with the surfaces of each, and what is reported.

use super::pass::{MOST_STEPS, Pass};
use super::query::{FinishedSurfaces, make};
use super::settings::{SurfaceReport, SurfaceSettings};
use super::weld::SurfaceStorage;
use crate::pipeline::read::{OpenArchive, StepView};
use crate::surface::TriMesh;
use isospan_io::error::Result;
use isospan_io::exec::Progress;
use serde::Serialize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The surfaces of a step.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StepSurfaces {
    /// Number of the step.
    pub step: u64,
    /// Its time, or its number where it has none.
    pub time: f64,
    /// Whether nothing was read, because the range of its values shows that the surfaces are empty.
    pub skipped: bool,
    /// What was extracted. Several steps are extracted together: the first one reports what was
    /// read for all of them, and the time that it took.
    #[serde(flatten)]
    pub report: SurfaceReport,
}

/// The surfaces of many steps.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct SeriesReport {
    /// StoredStep by step.
    pub steps: Vec<StepSurfaces>,
    /// Steps that were skipped.
    pub skipped: u64,
    /// The lists of the files: one, or one for each isovalue where these have files of their own.
    pub lists: Vec<PathBuf>,
    /// Files of earlier runs that the lists go on naming, all together.
    pub listed_before: u64,
    /// Bytes of the files that have all steps, where there are such.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file_bytes: Option<u64>,
}

/// What is done with the surfaces of a step; their memory comes back.
pub(super) type Use<'a> = dyn FnMut(&StepView, FinishedSurfaces) -> Result<Vec<TriMesh>> + 'a;

/// Extracts surfaces of step after step, several in a pass.
pub(super) fn for_each_step(
    archive: &Arc<OpenArchive>,
    steps: Range<usize>,
    settings: &SurfaceSettings,
    scratch: &Path,
    progress: &dyn Progress,
    use_them: &mut Use<'_>,
) -> Result<()> {
    let mut positions = steps;
    let mut reused: Vec<Vec<TriMesh>> = vec![];
    let mut before: Option<StepView> = None;
    while !positions.is_empty() {
        let view = archive.step_at(positions.start);
        if view.is_pyramid() {
            let view = view.after(before.take());
            settings.resources.cancel.check()?;
            let storage =
                SurfaceStorage { scratch: scratch.to_path_buf(), reused: reused.pop().unwrap_or_default() };
            reused.push(use_them(&view, make(&view, settings, storage, None, progress)?)?);
            positions.start += 1;
            before = Some(view);
            continue;
        }
        let views: Vec<StepView> = positions.clone().take(MOST_STEPS).map(|n| archive.step_at(n)).collect();
        let made = Pass::next(&views, settings, scratch)?.extract(settings, &mut reused, progress)?;
        for (view, made) in views.iter().zip(made) {
            settings.resources.cancel.check()?;
            reused.push(use_them(view, made)?);
            positions.start = view.position() + 1;
        }
    }
    Ok(())
}
