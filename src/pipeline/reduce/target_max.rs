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
use super::plan_file::work_folder;
use super::planned::make;
use super::report::{ReduceReport, TargetReport};
use super::reuse::Round;
use super::search::error_of;
use super::sums::StoredSums;
use super::tries::{full_cells, publish, rename};
use crate::bytes::publish::remove_folder;
use crate::cells::CellMesh;
use crate::density::Choice;
use crate::error::{Error, Result};
use crate::formats::{Input, StepSource};
use crate::geom::LatticePos;
use crate::grid::{BrickGrid, ChunkId};
use crate::pipeline::chunk::{ChunkTets, Originals, SampleErrors, Samples, StepLanes};
use crate::pipeline::field::{AtVertices, MeasureSettings, reopened_values, store_settings};
use crate::pipeline::inputs::{ChunkCache, Reading, boxes_of_chunks, random_access};
use crate::pipeline::plan::{Halo, estimate};
use crate::pipeline::read::{Blocks, DecodedChunk, OpenArchive, StepView, Visit};
use crate::pipeline::settings::{ReduceSettings, RunSettings, Target};
use crate::points::PointSpec;
use crate::volume::VolumeSource;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Tries, at most.
const MOST_TRIES: u32 = 16;

/// Reduces to the archive `job.out` so that the largest error at a sample meets the target.
pub(super) fn reduce_to_max(job: &Job<'_>, target: Target) -> Result<ReduceReport> {
    let work = work_folder(job.out);
    let [trying, last] = ["try.isospan", "last.isospan"].map(|name| work.join(name));
    let run = RunSettings { replace: false, ..job.run.clone() };
    let (mut settings, mut round, mut wanted) = (job.settings.clone(), None::<Round>, None);
    let (mut meshed_chunks, mut seconds) = ([0, 0], vec![]);
    remove_folder(&last)?;
    for tries in 1.. {
        remove_folder(&trying)?;
        fs::create_dir_all(&work).map_err(|e| Error::io("create the folder", &work, e))?;
        let basis = round.as_ref().map_or(Basis::New, Basis::Round);
        let next = Job { settings: &settings, basis, out: &trying, run: &run, keeps_sums: true, ..*job };
        let mut report = make(&next, &Existing::Nothing)?;
        meshed_chunks[0] += report.chunks - report.reused_chunks;
        meshed_chunks[1] += report.chunks;
        seconds.append(&mut report.seconds);
        let bound = *wanted.get_or_insert(report.bound.unwrap_or_default());
        let error = error_of(target, &report);
        let met = error <= bound;
        let next =
            if met || tries == MOST_TRIES { None } else { raised(job, &trying, bound, report.samples)? };
        // The try before has served.
        drop(round.take());
        remove_folder(&last)?;
        if let Some(choice) = next {
            rename(&trying, &last)?;
            round = Some(Round::new(choice, OpenArchive::open(&last)?.step_at(0))?);
            settings = ReduceSettings { target: None, ..settings };
            continue;
        }
        let full_cells = Some(full_cells(&trying)?);
        publish(job.settings, &trying, job.out)?;
        report.seconds = seconds;
        let reached = error;
        report.target = Some(TargetReport { target, bound, reached, met, tries, meshed_chunks, full_cells });
        return Ok(report);
    }
    unreachable!("the last try returns")
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
