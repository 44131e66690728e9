//! The end of a reduction: merges what all chunks report, and writes the manifest that makes it an
//! archive.

use super::build::{Build, Segments};
use super::contents::ArchiveContents;
use super::existing;
use super::report::ReduceReport;
use super::series::SeriesPlan;
use super::sums::{FinishedSteps, summed_error};
use crate::archive::manifest::Manifest;
use crate::error::{Error, Result};
use crate::pipeline::field::{MeasureSettings, reopened_errors};
use crate::pipeline::read::OpenArchive;
use crate::pipeline::stage::Stage;
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
            let coordinates = segments.coordinates.filter(|_| contents.steps.is_empty());
            contents.add_step(plan, n, layout, &finished, self.parts, coordinates, self.run)?;
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
        let manifest = contents.manifest(plan);
        if existing::lacks_files(layout.root(), &manifest) {
            let text = "another run has removed files meanwhile: run the same command again";
            return Err(Error::io("finish", layout.root(), std::io::Error::other(text)));
        }
        manifest.write(layout.root())?;
        if !self.keeps_sums {
            existing::remove_strays(layout.root(), &manifest);
        }
        // No halo was made of a mesh's own tetrahedra.
        let is_own = manifest.plan.own.is_some();
        let halo_retries = if is_own { 0 } else { contents.halo_retries };
        let report = ReduceReport { halo_retries, skipped: series.skipped.clone(), ..report };
        report.of_archive(layout.root(), &manifest, first)
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
                (Some((error, levels)), _) => (step.error, step.level_errors) = (Some(error), levels),
                (None, Some(before)) => {
                    (step.error, step.level_errors) = (before.error.clone(), before.level_errors.clone());
                }
                (None, None) if step.plan.measured => {
                    let (error, levels) = summed_error(&archive.step_at(position))?;
                    (step.error, step.level_errors) = (Some(error), levels);
                }
                (None, None) => missing.push((position, &source.source)),
            }
        }
        let errors = reopened_errors(&archive, &missing, &settings, self.progress)?;
        for ((position, _), (error, levels)) in missing.into_iter().zip(errors) {
            let step = &mut contents.steps[position];
            (step.error, step.level_errors) = (Some(error), levels);
        }
        Ok(())
    }
}
