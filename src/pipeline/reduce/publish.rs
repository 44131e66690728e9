//! The end of a reduction: merges what all chunks report, and writes the manifest that makes it an
//! archive.

use super::build::{Build, Segments};
use super::contents::ArchiveContents;
use super::existing;
use super::report::ReduceReport;
use super::series::SeriesPlan;
use super::sums::{FinishedSteps, StoredSums, summed_error};
use crate::archive::chunked::ChunkSegment;
use crate::archive::manifest::{Manifest, StepPlan, StoredStep};
use crate::archive::segment::{PlanHash, Segment, SegmentInfo, SegmentKind};
use crate::index::{BuildSettings, IndexBuilder, index_entries};
use crate::measure::shortest_between;
use crate::pipeline::field::{MeasureSettings, StepErrors, reopened_errors};
use crate::pipeline::plan::{Layout, Plan, estimate};
use crate::pipeline::read::{OpenArchive, limits};
use crate::pipeline::stage::Stage;
use crate::spectrum::{Design, Limits, SpectrumBuilder};
use isospan_io::error::{Error, Result};
use isospan_io::grid::ChunkId;
use isospan_mesh::points::SetKind;
use std::time::Instant;

impl Build<'_> {
    /// Index, spectrum and error of each step, then the manifest. Completes the report.
    pub(super) fn publish(
        &self,
        series: &SeriesPlan,
        mut segments: Segments,
        mut report: ReduceReport,
    ) -> Result<ReduceReport> {
        let (plan, layout, committing) = (&series.plan, self.layout, Instant::now());
        let mut contents = match self.old {
            Some(manifest) => ArchiveContents::of(manifest),
            None => ArchiveContents::of_segments(plan, self.parts, layout)?,
        };
        let (first, finished) = (contents.steps.len(), FinishedSteps::of(layout, plan));
        for n in 0..plan.steps.len() {
            self.run.resources.cancel.check()?;
            // Those of a grid that has some go with the first step of the archive.
            let coordinates = segments.coordinates.filter(|_| contents.steps.is_empty());
            let is_indexed = contents.counts.is_indexed(&plan.mesh);
            contents.steps.push(StoredStep { coordinates, ..self.step(plan, n, is_indexed, &finished)? });
        }
        report.seconds.push((Stage::Commit, committing.elapsed().as_secs_f64()));
        if self.measure {
            let measuring = Instant::now();
            self.measure_stored(series, &mut segments, &mut contents, first, &finished)?;
            let seconds = (measuring.elapsed() + segments.measuring + segments.times.measure).as_secs_f64();
            report.seconds.push((Stage::Measure, seconds));
        }
        if self.old.is_some_and(|old| Manifest::read(layout.root()).ok().as_ref() != Some(old)) {
            let text = "another run has changed the archive meanwhile: run the same command again";
            return Err(Error::io("add steps to", layout.root(), std::io::Error::other(text)));
        }
        layout.sync()?;
        series.watch.check()?;
        let added = contents.steps[first..].iter().map(|step| step.plan.number).min().unwrap_or(0);
        series.put_in_order(self.old, &mut contents);
        let manifest = contents.manifest(plan);
        if existing::lacks_files(layout.root(), &manifest) {
            let text = "another run has removed files meanwhile: run the same command again";
            return Err(Error::io("finish", layout.root(), std::io::Error::other(text)));
        }
        manifest.write(layout.root())?;
        if !self.keeps_sums {
            // Readers of the archive as it was may need what was replaced: `gc` removes it.
            existing::remove_strays(layout.root(), &manifest, self.old);
        }
        // No halo was made of a mesh's own tetrahedra.
        let is_own = manifest.plan.own.is_some();
        let halo_retries = if is_own { 0 } else { contents.halo_retries };
        let (skipped, replaced) = (series.skipped.clone(), series.replaced(self.old));
        let report = ReduceReport { halo_retries, skipped, replaced, ..report };
        report.of_archive(layout.root(), &manifest, added)
    }

    /// The `n`-th step of the plan, without errors. If it is indexed, builds its index, and its
    /// spectrum from what chunks have measured, unless the step is finished.
    fn step(&self, plan: &Plan, n: usize, is_indexed: bool, finished: &FinishedSteps) -> Result<StoredStep> {
        let (step, hash) = (&plan.steps[n], plan.step_hash(n));
        let layout = self.layout.at(step.number);
        let is_pyramid = plan.mesh.points.kind() == SetKind::Pyramid;
        let (mut values, mut ranges, mut void_points) = (vec![], vec![], 0);
        // The ranges of all points, and of the tetrahedra that are not void.
        let mut value_range = [f32::INFINITY, f32::NEG_INFINITY];
        let mut range = value_range;
        let mut index = IndexBuilder::new(&BuildSettings {
            memory: self.run.resources.memory.saturating_sub(estimate::BASE),
            scratch: Some(self.run.resources.scratch_folder()),
        });
        for number in 0..layout.segment_count() {
            let file = ChunkSegment::open(layout.values(number), SegmentKind::Values, Some(hash))?;
            values.push(file.record());
            let file = match is_pyramid {
                true => ChunkSegment::open(layout.ranges(number), SegmentKind::Ranges, Some(hash))?,
                false => file,
            };
            if is_pyramid {
                ranges.push(file.record());
            }
            for chunk in layout.chunks_of(number) {
                let summary = file.value_summary(ChunkId(chunk))?;
                void_points += u64::from(summary.void);
                value_range = [value_range[0].min(summary.min), value_range[1].max(summary.max)];
                for entry in index_entries(chunk, &summary.ranges) {
                    range = [range[0].min(entry.min), range[1].max(entry.max)];
                    if is_indexed {
                        index.push(entry)?;
                    }
                }
            }
        }
        // Those that chunks were measured with: by the set's own number of points, which may be a
        // little off.
        let limits = limits(&plan.mesh, self.parts.points.len());
        let spectrum = match finished.get(step.number) {
            _ if !is_indexed || range[0] > range[1] || is_pyramid => None,
            Some(finished) => finished.spectrum,
            None => Some(sum_spectrum(&layout, step, hash, Design::new(range, limits), limits)?),
        };
        let coarse = match is_pyramid && !plan.mesh.has_labels() {
            true => Some(Segment::open(layout.coarse(), SegmentKind::Coarse, Some(hash))?.info()),
            false => None,
        };
        Ok(StoredStep {
            value_range: (value_range[0] <= value_range[1]).then_some(value_range),
            void_points,
            values,
            ranges,
            coarse,
            index: is_indexed.then(|| index.finish(layout.index(), hash)).transpose()?,
            spectrum,
            ..StoredStep::of(step.clone())
        })
    }

    /// Notes the errors of the steps from position `first` on: adds up those of chunks, and
    /// measures the steps of a mesh that an earlier run has made.
    fn measure_stored(
        &self,
        series: &SeriesPlan,
        segments: &mut Segments,
        contents: &mut ArchiveContents,
        first: usize,
        finished: &FinishedSteps,
    ) -> Result<()> {
        let settings = MeasureSettings::of_run(self.run, self.shares.workers);
        let archive = OpenArchive::of(self.layout.root(), contents.manifest(&series.plan))?;
        let mut missing = vec![];
        for (position, source) in (first..).zip(&series.sources) {
            let step = &mut contents.steps[position];
            let before = finished.get(step.plan.number).filter(|before| before.error.is_some());
            match (segments.errors.remove(&step.plan.number), before) {
                (Some(errors), _) => note_errors(step, errors),
                (None, Some(before)) => {
                    step.error.clone_from(&before.error);
                    step.level_errors.clone_from(&before.level_errors);
                    step.level_rms.clone_from(&before.level_rms);
                }
                (None, None) if step.plan.measured => {
                    note_errors(step, summed_error(&archive.step_at(position))?);
                }
                (None, None) => missing.push((position, &source.source)),
            }
        }
        let errors = reopened_errors(&archive, &missing, &settings, self.progress)?;
        for ((position, _), errors) in missing.into_iter().zip(errors) {
            note_errors(&mut contents.steps[position], errors);
        }
        Ok(())
    }
}

/// Notes the error of a step, and those of its levels. Of a level of a pyramid the RMS alone is
/// kept, in few digits: no less than it is, and at most a thousandth more.
fn note_errors(step: &mut StoredStep, (error, levels): StepErrors) {
    step.error = Some(error);
    match step.plan.wavelet {
        None => step.level_errors = levels,
        Some(_) => {
            let rms = levels.iter().map(|level| shortest_between(level.rms, level.rms * 1.001));
            step.level_rms = rms.collect();
        }
    }
}

/// Adds up what all chunks have measured of a step, and writes it.
fn sum_spectrum(
    layout: &Layout,
    step: &StepPlan,
    hash: PlanHash,
    design: Design,
    limits: Limits,
) -> Result<SegmentInfo> {
    let mut builder = SpectrumBuilder::new(design);
    for number in 0..layout.segment_count() {
        let sums = StoredSums::open(layout, number, step, hash)?;
        for chunk in layout.chunks_of(number) {
            builder.add(&sums.part(ChunkId(chunk), limits)?);
        }
    }
    builder.finish(layout.spectrum(), hash)
}
