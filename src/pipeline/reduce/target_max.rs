//! Meets a wanted largest error: points are made denser where it is exceeded, until it is exceeded
//! nowhere.
//!
//! The largest error of a field is that of a few samples, at a peak, for example. As many points as
//! samples all over the volume need not meet it, where some more points at the peak do. So this is
//! no search for a number of points. The first try has levels at which the predicted error of each
//! cell is the bound. Then errors are measured at all samples (in a mesh: at all vertices). The
//! cells with an error above the bound are raised, with the cells around them up to the distance
//! between points; and so on:
//!
//! ```text
//!  levels of equal errors ─▶ reduce ─▶ measure, cell by cell ─▶ all within the bound: publish
//!            ▲                                │
//!            └────────── raise the cells that are not
//! ```
//!
//! All rounds but the first ones raise few cells. Chunks without a raised cell in their region are
//! reused from the try before ([`super::reuse`]). The places of errors are searched only in chunks
//! that have one above the bound.
//!
//! Levels begin low and only rise, so few points are superfluous. The limit is about as many points
//! as samples in all; in a mesh that fills a part of its box, as many inside as vertices. Where the
//! next levels would exceed it, only the cells with the largest errors are raised. When nothing can
//! be raised any more, the last try is published, and the report says so.
//!
//! Memory: 4 bytes a cell in addition to what measuring takes. The largest of errors does not
//! depend on their order, so the archive is the same for any number of threads.

use super::existing::Existing;
use super::job::{Basis, Job};
use super::kept_search::{KeptSearch, MadeTry};
use super::made_before::published_before;
use super::planned::make;
use super::report::{ReduceReport, TargetReport};
use super::reuse::Round;
use super::search::error_of;
use super::sums::StoredSums;
use super::tries::{full_cells, publish};
use crate::density::Choice;
use crate::pipeline::chunk::{ChunkTets, Originals, SampleErrors, Samples, StepLanes};
use crate::pipeline::field::{AtVertices, MeasureSettings, reopened_values, store_settings};
use crate::pipeline::inputs::{ChunkCache, Reading, boxes_of_chunks, random_access};
use crate::pipeline::plan::{Halo, estimate, folder_bytes};
use crate::pipeline::read::{Blocks, DecodedChunk, OpenArchive, StepView, Visit};
use crate::pipeline::settings::{CompleteSettings, RunSettings, Target};
use isospan_io::cells::CellMesh;
use isospan_io::error::Result;
use isospan_io::exec::{Attempt, Reached};
use isospan_io::formats::{Input, StepSource};
use isospan_io::geom::LatticePos;
use isospan_io::grid::{BrickGrid, ChunkId};
use isospan_io::volume::VolumeSource;
use isospan_mesh::points::PointSpec;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Tries, at most.
const MOST_TRIES: u32 = 16;
/// Tries of most searches.
const USUAL_TRIES: u32 = 5;

/// A search by levels, after a try.
#[derive(Clone, Serialize, Deserialize)]
struct LevelSearch {
    /// Tries that were made; the last one is there.
    tries: u32,
    samples: u64,
    /// The bound, in units of the field, and the largest error of the last try.
    bound: f64,
    reached: f64,
    /// Chunks that were meshed in all tries together, and chunks of all tries.
    meshed_chunks: [u64; 2],
    /// Whether the last try becomes the archive.
    is_over: bool,
    made: MadeTry,
}

impl LevelSearch {
    /// The levels of the next try; `None` where there is none.
    fn choice(&self, job: &Job<'_>, kept: &KeptSearch<'_>) -> Result<Option<Choice>> {
        if self.reached <= self.bound || self.tries == MOST_TRIES {
            return Ok(None);
        }
        raised(job, &kept.try_path(self.tries), self.bound, self.samples)
    }

    fn report(&self, target: Target, archive: &Path) -> Result<TargetReport> {
        let &Self { tries, bound, reached, meshed_chunks, .. } = self;
        let (met, full_cells) = (reached <= bound, Some(full_cells(archive)?));
        let of_ranges = false;
        Ok(TargetReport { target, bound, reached, met, tries, of_ranges, meshed_chunks, full_cells })
    }
}

/// Reduces to the archive `job.out` so that the largest error at a sample meets the target. What a
/// run has found that was stopped is there again.
pub(super) fn reduce_to_max(job: &Job<'_>, target: Target, source: Option<u64>) -> Result<ReduceReport> {
    let (kept, found) = KeptSearch::open::<Option<LevelSearch>>(job, source)?;
    let found = found.flatten();
    let is_published = |last: &LevelSearch| last.is_over && !kept.has(last.tries);
    if found.as_ref().is_some_and(is_published)
        && let Some(report) = published_before(job, target, source)
    {
        return Ok(report);
    }
    let mut state = found.filter(|last| kept.has(last.tries));
    kept.note(&state)?;
    let (mut seconds, mut of_last) = (vec![], None);
    let mut choice = None;
    if let Some(last) = state.as_mut().filter(|last| !last.is_over) {
        choice = last.choice(job, &kept)?;
        last.is_over = choice.is_none();
    }
    while state.as_ref().is_none_or(|last| !last.is_over) {
        let (mut next, report) = make_try(job, target, &kept, state.as_ref().zip(choice.take()))?;
        seconds.extend_from_slice(&report.seconds);
        choice = next.choice(job, &kept)?;
        next.is_over = choice.is_none();
        of_last = Some(report);
        state = Some(next);
        kept.note(&state)?;
    }
    let Some(last) = state else { unreachable!("the last try ends the loop") };
    let archive = kept.try_path(last.tries);
    let report = of_last.map_or_else(|| last.made.clone().report(&archive), Ok)?;
    let found = last.report(target, &archive)?;
    publish(job.settings, &archive, job.out)?;
    // What only a search looks at is gone.
    let archive_bytes = folder_bytes(job.out)?;
    Ok(ReduceReport { target: Some(found), archive_bytes, seconds, ..report })
}

/// Makes the first try, or the next one after a try, with these levels.
fn make_try(
    job: &Job<'_>,
    target: Target,
    kept: &KeptSearch<'_>,
    before: Option<(&LevelSearch, Choice)>,
) -> Result<(LevelSearch, ReduceReport)> {
    let last = before.as_ref().map(|(last, _)| (*last).clone());
    let number = last.as_ref().map_or(1, |last| last.tries + 1);
    let reached = last.as_ref().map(|last| Reached {
        quantity: "largest error",
        value: last.reached,
        wanted: last.bound,
    });
    kept.keep(&[last.as_ref().map(|last| last.tries), Some(number)])?;
    job.progress.attempt(&Attempt { number, about: number.max(USUAL_TRIES), last: reached });
    let round = match before {
        Some((last, choice)) => {
            let view = OpenArchive::open(&kept.try_path(last.tries))?.step_at(0);
            Some(Round::new(choice, view)?)
        }
        None => None,
    };
    let target_of_first = job.settings.target.filter(|_| round.is_none());
    let settings = &CompleteSettings { target: target_of_first, ..job.settings.clone() };
    let (basis, out) = (round.as_ref().map_or(Basis::New, Basis::Round), &kept.try_path(number));
    // What another plan has left there is no part of the search.
    let run = &RunSettings { replace: true, ..job.run.clone() };
    let next = Job { settings, basis, out, run, keeps_sums: true, ..*job };
    let report = make(&next, &Existing::at(out)?)?;
    let [meshed, chunks] = last.as_ref().map_or([0; 2], |last| last.meshed_chunks);
    let search = LevelSearch {
        tries: number,
        samples: report.samples,
        bound: last.map_or_else(|| target.limit(&report, None), |last| Ok(last.bound))?,
        reached: error_of(target, &report),
        meshed_chunks: [meshed + report.chunks - report.reused_chunks, chunks + report.chunks],
        is_over: false,
        made: MadeTry::of(&report),
    };
    Ok((search, report))
}

/// The levels of a try, higher where errors are above the bound; `None` when nothing can be denser.
fn raised(job: &Job<'_>, archive: &Path, bound: f64, samples: u64) -> Result<Option<Choice>> {
    let archive = OpenArchive::open(archive)?;
    let levels = Arc::clone(archive.points.levels().expect("its points adapt"));
    let PointSpec::Halton { n } = archive.manifest.plan.points else {
        unreachable!("levels are those of a Halton set")
    };
    let cells = *levels.cells();
    let worst: Vec<AtomicU32> = levels.as_slice().iter().map(|_| AtomicU32::new(0)).collect();
    let mut filled = 1.0;
    for position in 0..archive.manifest.steps.len() {
        let view = archive.step_at(position);
        let number = view.step().plan.number;
        let (_, source) = job.sources.iter().find(|s| s.0 == number).expect("a step of this job");
        filled = Measuring { archive: &view, cells: &cells, bound, worst: &worst }.add(job, source)?;
    }
    let worst: Vec<f32> = worst.into_iter().map(|e| f32::from_bits(e.into_inner())).collect();
    // Points are those of the box; a mesh may fill only a part of it.
    let most = (samples as f64 / filled) as u64;
    Choice { n, levels: (*levels).clone() }.raised(&worst, bound, most)
}

/// Looks for errors above a bound.
struct Measuring<'a> {
    archive: &'a StepView,
    cells: &'a BrickGrid,
    bound: f64,
    /// The bits of the largest error of each cell: the bits of numbers that are not negative are in
    /// the same order.
    worst: &'a [AtomicU32],
}

impl Measuring<'_> {
    /// Adds the errors at the samples of a step, or at the vertices of its mesh; returns the part
    /// of the box that they fill.
    fn add(&self, job: &Job<'_>, source: &StepSource) -> Result<f64> {
        match source.open()? {
            Input::Volume(volume) => self.add_samples(job, volume).map(|()| 1.0),
            Input::Mesh(mesh) => self.add_vertices(job, &mesh, &source.path),
        }
    }

    fn add_vertices(&self, job: &Job<'_>, mesh: &CellMesh, input: &Path) -> Result<f64> {
        let (archive, run) = (self.archive, job.run);
        let settings = MeasureSettings::of_run(run, run.resources.worker_threads());
        let mut store = None;
        let values = reopened_values(archive, mesh, input, &mut store, &settings)?;
        let store = store.expect("it was laid out for the values");
        let values = values.get()?;
        let rest = |memory: u64| memory.saturating_sub(estimate::BASE + 4 * self.worst.len() as u64);
        let (step, how) = ([archive.position()], store_settings(archive, &settings));
        let mut vertices = AtVertices::new(archive, &store, &step, &run.resources, &rest, &how)?;
        for batch in vertices.batches() {
            vertices.each_in(batch, job.progress, |number, at, reduced, _| {
                let error = (f64::from(values[number as usize]) - f64::from(reduced[0])).abs();
                if error > self.bound {
                    self.note(at, error as f32);
                }
            })?;
        }
        Ok(store.filled())
    }

    fn add_samples(&self, job: &Job<'_>, volume: VolumeSource) -> Result<()> {
        let (run, archive) = (job.run, self.archive);
        let base = estimate::BASE + 4 * self.worst.len() as u64;
        let extra = estimate::error_bytes(1);
        let least = Visit::new(archive, Blocks::All, &run.resources, |_| 0)?.least(extra) + base;
        let boxes = boxes_of_chunks(&archive.points, &archive.chunks, Halo::of(&archive.manifest.plan));
        let cache = ChunkCache::fitting(&volume, boxes, true, least, run);
        let (reader, _scratch) = random_access(volume, cache.map(|c| c.size), run, job.progress)?;
        let reading = Reading::of(&self.archive.step().plan);
        let (reader, missing, stand_in) = (reading.reader(reader), reading.missing(), reading.stand_in());
        let originals = Originals::Volume { reader: &*reader, missing, stand_in };
        let samples = Samples::of(&originals).expect("those of a volume");
        let sample_errors = SampleErrors::new(&self.archive.manifest.plan.lattice);
        let base = base + cache.map_or(0, |c| c.held);
        let share = |memory: u64| memory.saturating_sub(base);
        let mut visit = Visit::new(self.archive, Blocks::All, &run.resources, share)?;
        visit.chunks = self.chunks_above()?;
        visit.check_memory(extra)?;
        job.progress.begin("measure", visit.chunks.len() as u64, "chunks");
        let part = |_, chunk: DecodedChunk| self.add_chunk(&sample_errors, &samples, &chunk);
        visit.each(extra, job.progress, part, |_, ()| Ok(()))
    }

    /// The chunks that have an error above the bound, as is stored with them.
    fn chunks_above(&self) -> Result<Vec<ChunkId>> {
        let (mut above, archive) = (vec![], self.archive);
        for number in 0..archive.layout.segment_count() {
            let stored =
                StoredSums::open(&archive.layout, number, &archive.step().plan, archive.step_hash())?;
            for id in archive.layout.chunks_of(number).map(ChunkId) {
                let sums = stored.errors(id)?.sums;
                // The largest is that of errors rounded to f32.
                let is_above = |error: f64| error * (1.0 + f64::from(f32::EPSILON)) > self.bound;
                let largest = sums.largest.map(|l| (f64::from(l.original) - f64::from(l.reduced)).abs());
                if largest.is_some_and(is_above) {
                    above.push(id);
                }
            }
        }
        Ok(above)
    }

    fn add_chunk(
        &self,
        sample_errors: &SampleErrors,
        samples: &Samples<'_>,
        chunk: &DecodedChunk,
    ) -> Result<()> {
        let DecodedChunk { positions, tets, block_ends, values, .. } = chunk;
        let lattice = self.cells.lattice;
        let read = |_, window, out: &mut [f32]| samples.read(window, out);
        sample_errors.each_sample(
            &ChunkTets { positions, tets, block_ends },
            &StepLanes::one(values),
            read,
            |m| {
                for (n, (original, reduced)) in m.compared.pairs().enumerate() {
                    let error = (f64::from(original) - f64::from(reduced)).abs();
                    if original.is_finite() && error > self.bound {
                        self.note(lattice.of_voxel(m.place(n)), error as f32);
                    }
                }
            },
        )
    }

    /// Notes an error for all cells that touch a sample's position.
    fn note(&self, at: LatticePos, error: f32) {
        let (hi, lo) = (self.cells.brick_at(at), self.cells.brick_at(at.map(|c| c.saturating_sub(1))));
        for corner in 0..8u32 {
            let cell = std::array::from_fn(|a| if corner >> a & 1 == 0 { lo[a] } else { hi[a] });
            let worst = &self.worst[self.cells.id(cell).0 as usize];
            worst.fetch_max(error.to_bits(), Ordering::Relaxed);
        }
    }
}
