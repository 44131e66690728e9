//! Values of another field at the vertices of a surface: they are probed, as `probe` does it.
//!
//! The tetrahedra of a mesh that is stored as it is may overlap. A vertex has the value in the one
//! that the surface cuts, where surface and field are of one archive.

use super::settings::SurfaceSettings;
use crate::files::surface::VertexValues;
use crate::pipeline::field::{ProbeSettings, values_at, values_on_surface};
use crate::pipeline::plan::estimate;
use crate::pipeline::read::StepView;
use crate::surface::SurfaceSource;
use isospan_io::error::{Error, Result};
use isospan_io::exec::{Resources, Silent};
use std::path::Path;
use std::sync::Arc;

/// Bytes of a vertex while it is probed: its place, and what probing takes.
const VERTEX: u64 = 340;
/// The most vertices that are probed together.
const MOST: u64 = 1 << 28;

/// The values at the vertices of surfaces of a step, one after another in the world, given the
/// isovalue and the number of vertices of each; `None` where none are asked for.
pub(super) fn colours(
    archive: &StepView,
    settings: &SurfaceSettings,
    surface: &dyn SurfaceSource,
    parts: &[(f64, u64)],
    scratch: &Path,
) -> Result<Option<Arc<VertexValues>>> {
    let Some(by) = &settings.colour_by else { return Ok(None) };
    let range = by.range.or(by.view.file_range()).unwrap_or([0.0, 1.0]);
    let held = usize::try_from(settings.resources.memory / 16).unwrap_or(usize::MAX);
    let source = &by.view.step().plan.source;
    let values = VertexValues::new(&source.field, range, by.map, held, scratch)?;
    let mut values = values.less(source.offset);
    each_value(archive, &by.view, surface, parts, &settings.resources, |some| values.extend(some))?;
    Ok(Some(Arc::new(values)))
}

/// The values of a field at the vertices of an isosurface of a step, in memory.
pub(in crate::pipeline) fn values_on(
    archive: &StepView,
    field: &StepView,
    surface: &dyn SurfaceSource,
    isovalue: f64,
    resources: &Resources,
) -> Result<Vec<f64>> {
    let (count, source) = (surface.vertex_count(), &field.step().plan.source);
    let mut all = Vec::with_capacity(usize::try_from(count).unwrap_or(0));
    each_value(archive, field, surface, &[(isovalue, count)], resources, |some| {
        all.extend(some.iter().map(|&v| source.in_file(v)));
        Ok(())
    })?;
    Ok(all)
}

/// Hands on the values of a field, less its offset, at the vertices of surfaces of a step, in their
/// order.
///
/// # Errors
/// [`Error::Usage`] where the field of another archive has a value at no vertex.
fn each_value(
    archive: &StepView,
    field: &StepView,
    surface: &dyn SurfaceSource,
    parts: &[(f64, u64)],
    resources: &Resources,
    mut each: impl FnMut(&[f32]) -> Result<()>,
) -> Result<()> {
    let (memory, source) = (resources.memory, &field.step().plan.source);
    // Half for vertices, the rest for chunks.
    let rest = |memory: u64| memory.saturating_sub(estimate::BASE + memory / 16);
    let most = (rest(memory) / 2 / VERTEX).clamp(1, MOST) as usize;
    let probe = ProbeSettings { resources: resources.clone(), level: None };
    let is_one = Arc::ptr_eq(field.archive(), archive.archive());
    let may_overlap =
        archive.manifest.plan.own.is_some() && is_one && !field.is_between() && !archive.is_between();
    let kept = |isovalue: f64| archive.step().plan.source.kept(isovalue);
    let mut isovalues = parts.iter().flat_map(|&(v, count)| std::iter::repeat_n(kept(v), count as usize));
    let mut found_any = false;
    let mut ask = |points: &mut Vec<[f64; 3]>| {
        let share = |memory| rest(memory) / 2;
        let found = if may_overlap {
            let isovalues: Vec<f32> = isovalues.by_ref().take(points.len()).collect();
            values_on_surface(field, archive.position(), points, &isovalues, &probe, &share)?
        } else {
            values_at(field, points, &probe, &share, &Silent)?.values
        };
        points.clear();
        found_any |= found.iter().any(|v| !v.is_nan());
        each(&found)
    };
    let (mut points, origin) = (vec![], surface.origin());
    surface.vertices(&mut |batch| {
        for vertex in batch {
            points.push(vertex.world(origin));
            if points.len() == most {
                ask(&mut points)?;
            }
        }
        Ok(())
    })?;
    ask(&mut points)?;
    if !(found_any || is_one) && surface.vertex_count() > 0 {
        return Err(Error::usage(format!(
            "{}: {} has no value at any vertex of the surface: do both lie in the same place of the world?",
            field.path().display(),
            source.field
        )));
    }
    Ok(())
}
