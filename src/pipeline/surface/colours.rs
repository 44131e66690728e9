//! Values of another field at the vertices of a surface: they are probed, as `probe` does it.

use super::settings::SurfaceSettings;
use crate::error::Result;
use crate::exec::Silent;
use crate::formats::surface::VertexValues;
use crate::pipeline::field::{ProbeSettings, values_at};
use crate::pipeline::plan::estimate;
use crate::surface::SurfaceSource;
use std::path::Path;
use std::sync::Arc;

/// Bytes of a vertex while it is probed: its place, and what probing takes.
const VERTEX: u64 = 330;
/// The most vertices that are probed together.
const MOST: u64 = 1 << 28;

/// The values at the vertices of a surface in the world; `None` where none are asked for.
pub(super) fn colours(
    settings: &SurfaceSettings,
    surface: &dyn SurfaceSource,
    scratch: &Path,
) -> Result<Option<Arc<VertexValues>>> {
    let Some(by) = &settings.colour_by else { return Ok(None) };
    let (memory, source) = (settings.resources.memory, &by.view.step().plan.source);
    let range = by.range.or(by.view.file_range()).unwrap_or([0.0, 1.0]);
    let held = usize::try_from(memory / 16).unwrap_or(usize::MAX);
    let mut values = VertexValues::new(&source.field, range, by.map, held, scratch)?;
    // Half for vertices, the rest for chunks.
    let rest = |memory: u64| memory.saturating_sub(estimate::BASE + memory / 16);
    let most = (rest(memory) / 2 / VERTEX).clamp(1, MOST) as usize;
    let probe = ProbeSettings { resources: settings.resources.clone() };
    let mut ask = |points: &mut Vec<[f64; 3]>| {
        let found = values_at(&by.view, points, &probe, &|memory| rest(memory) / 2, &Silent)?;
        points.clear();
        values.extend(&found.values.iter().map(|&v| source.in_file(v) as f32).collect::<Vec<_>>())
    };
    let mut points = vec![];
    surface.vertices(&mut |batch| {
        for vertex in batch {
            points.push(vertex.position.map(f64::from));
            if points.len() == most {
                ask(&mut points)?;
            }
        }
        Ok(())
    })?;
    ask(&mut points)?;
    Ok(Some(Arc::new(values)))
}
