//! Decides whether the chunks of sources are read through caches, one for each step made at a time.
//! This applies the rule of `inputs::access` to the chunks of an archive.
//!
//! All steps of a series are read in the same way. Of several cache sizes, the one with the least
//! time of work is chosen; this depends on the threads and steps for which memory is left then. Of
//! equal ones, the largest is chosen.

use super::series::PlannedSource;
use crate::pipeline::inputs::{Met, boxes_of_chunks, most_at_work, most_cached};
use crate::pipeline::plan::{Held, MeshParts, Need, estimate, need_of};
use crate::pipeline::settings::RunSettings;
use isospan_io::volume::chunked::ChunkShape;

/// What the chunks of an archive need, where its steps are made of these sources. Notes the size
/// of the cache with each source of chunks; one without it will be copied.
pub(super) fn need_with_caches(sources: &mut [PlannedSource], parts: &MeshParts, run: &RunSettings) -> Need {
    let (steps, threads, memory) = (sources.len(), run.resources.worker_threads(), run.resources.memory);
    let need = |held| need_of(parts, held, steps, memory, run);
    let mut shapes: Vec<(ChunkShape, Met)> = vec![];
    for shape in sources.iter().filter_map(|s| s.chunks) {
        if shapes.iter().all(|(known, _)| *known != shape) {
            let boxes = boxes_of_chunks(&parts.points, &parts.chunks, parts.halo);
            shapes.push((shape, Met::of(&shape, boxes)));
        }
    }
    let shared = shapes.iter().map(|(shape, _)| shape.shared_bytes()).max().unwrap_or(0);
    let by_worker = shapes.iter().map(|(shape, _)| shape.decoding_bytes).max().unwrap_or(0);
    // What is needed with such caches, and how many workers fit then.
    let with = |size: &dyn Fn(&Met) -> Option<u64>, most: u64| {
        let sizes: Vec<u64> = shapes.iter().map(|(_, met)| size(met)).collect::<Option<_>>()?;
        let by_step = sizes.iter().copied().max().filter(|&largest| largest <= most)?;
        let by_step = by_step.saturating_add(shared);
        let need = need(Held { by_step, most, by_worker, ..Held::default() });
        let workers = need.shares(memory, threads).ok()?.workers;
        Some((workers, need, sizes))
    };
    let found = (0..4).filter_map(|n| with(&|met| met.sizes()[n], most_cached(memory)));
    let found = found.reduce(|a, b| if b.1.seconds(b.0, steps) < a.1.seconds(a.0, steps) { b } else { a });
    // Those at work, where no more workers fit than the cache is for.
    let at_work = |n| with(&|met| met.at_work(n), most_at_work(memory)).filter(|(workers, ..)| *workers <= n);
    let Some((_, need, sizes)) = found.or_else(|| (1..=threads).find_map(at_work)) else {
        return need(Held::default());
    };
    for source in sources {
        let Some(shape) = source.chunks else { continue };
        let known = shapes.iter().position(|(known, _)| *known == shape);
        source.cached = Some(sizes[known.expect("it was just listed")]);
        (source.copied, source.copying) = (0, estimate::BASE.saturating_add(shape.stream_bytes()));
    }
    need
}

#[cfg(test)]
mod tests;
