//! Isosurfaces of many steps in one file: VTKHDF, whose arrays have the surfaces one after another.
//!
//! All vertices come before all triangles in such a file, so the surfaces wait, within the memory
//! of the run and beyond it in its scratch folder, until the last step is there.

use super::query::{FinishedSurfaces, report_of};
use super::settings::{SurfaceSettings, file_of, is_each_alone};
use super::steps::{SeriesReport, StepSurfaces, for_each_step};
use super::weld::Extracted;
use crate::files::surface::{SurfaceMeta, SurfacePart, SurfaceStep, write_surface_steps};
use crate::pipeline::read::{OpenArchive, StepView};
use crate::surface::check::zero_area_triangles;
use crate::surface::weld::{BuilderSettings, StoredSurface};
use crate::surface::{Joined, SurfaceSource, vertices_from};
use isospan_io::error::Result;
use isospan_io::exec::Progress;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The surfaces of all steps of a file.
struct Gathered {
    surface: StoredSurface,
    steps: Vec<SurfaceStep>,
    parts: Vec<SurfacePart>,
    meta: SurfaceMeta,
    path: PathBuf,
}

impl Gathered {
    /// Appends the surfaces of a step; returns how many triangles have no area.
    fn add(&mut self, archive: &StepView, surfaces: &[Extracted], place: &BuilderSettings) -> Result<u64> {
        let joined = Joined::new(surfaces.iter().map(|s| &s.surface as &dyn SurfaceSource).collect());
        let (all, is_first) = (&mut self.surface, self.steps.is_empty());
        let without = surfaces[0].in_world(archive, &joined, |s| {
            if is_first {
                all.count_from(s.origin());
            }
            let origin = all.origin();
            vertices_from(s, origin, &mut |batch| batch.iter().try_for_each(|&v| all.push_vertex(v)))?;
            s.triangles(&mut |batch| batch.iter().try_for_each(|&t| all.push_triangle(t)))?;
            zero_area_triangles(s, place.memory_bytes, &place.scratch)
        })?;
        let (vertices, triangles) = (joined.vertex_count(), joined.triangle_count());
        self.steps.push(SurfaceStep { time: archive.step().time_or_number(), vertices, triangles });
        Ok(without)
    }
}

/// The files, one for all isovalues or one for each.
fn files(
    archive: &OpenArchive,
    settings: &SurfaceSettings,
    out: &Path,
    place: &BuilderSettings,
) -> Vec<Gathered> {
    let source = &archive.manifest.steps[0].plan.source;
    let comment = format!("isospan {} of {}", env!("CARGO_PKG_VERSION"), source.path);
    let gathered = |isovalue: Option<f64>, path: PathBuf| Gathered {
        surface: StoredSurface::new(place),
        steps: vec![],
        parts: vec![],
        meta: SurfaceMeta {
            isovalue,
            comments: vec![comment.clone()],
            units: source.units.clone(),
            ..SurfaceMeta::default()
        },
        path,
    };
    match settings.isovalues[..] {
        [one] => vec![gathered(Some(one), file_of(out, one))],
        ref all if is_each_alone(out) => all.iter().map(|&v| gathered(Some(v), file_of(out, v))).collect(),
        _ => vec![gathered(None, out.to_path_buf())],
    }
}

/// Writes isosurfaces of many steps to one file, or to one for each isovalue.
pub(super) fn write_in_one(
    archive: &Arc<OpenArchive>,
    steps: Range<usize>,
    settings: &SurfaceSettings,
    out: &Path,
    progress: &dyn Progress,
) -> Result<SeriesReport> {
    let memory_bytes = usize::try_from(settings.resources.memory / 16).unwrap_or(usize::MAX);
    let scratch = settings.scratch_of(out);
    let place = BuilderSettings { memory_bytes, scratch: scratch.clone() };
    let mut files = files(archive, settings, out, &place);
    let mut made: Vec<StepSurfaces> = vec![];
    let mut gather = |view: &StepView, found: FinishedSurfaces| {
        let mut report = report_of(view, settings, &found, out)?;
        for (n, file) in files.iter_mut().enumerate() {
            let own = if file.meta.isovalue.is_some() { &found.surfaces[n..=n] } else { &found.surfaces[..] };
            report.without_area += file.add(view, own, &place)?;
            if file.meta.isovalue.is_none() {
                let part = |(s, &isovalue): (&Extracted, &f64)| SurfacePart {
                    isovalue,
                    vertices: s.surface.vertex_count(),
                    triangles: s.surface.triangle_count(),
                    label: None,
                };
                file.parts.extend(own.iter().zip(&settings.isovalues).map(part));
            }
        }
        let (step, time) = (view.step().number(), view.step().time_or_number());
        made.push(StepSurfaces { step, time, skipped: !settings.can_answer(view), report });
        Ok(found.surfaces.into_iter().map(|s| s.surface.into_memory()).collect())
    };
    for_each_step(archive, steps, settings, &scratch, progress, &mut gather)?;
    let mut file_bytes = 0;
    for file in files {
        let Gathered { surface, steps, parts, meta, path } = file;
        file_bytes += write_surface_steps(&surface, &steps, &path, &SurfaceMeta { parts, ..meta })?;
    }
    let skipped = made.iter().filter(|s| s.skipped).count() as u64;
    Ok(SeriesReport { skipped, steps: made, lists: vec![], listed_before: 0, file_bytes: Some(file_bytes) })
}
