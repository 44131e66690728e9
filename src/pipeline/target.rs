//! An error that is wanted, instead of a number of points: the fewest points that meet it.
//!
//! The pass that finds where points are needed ([`crate::density`]) also foretells how far the field will be off, by about a third. So the first try has as
//! many points as that asks for. Its error is measured at every sample, and the next try's number follows from it: errors are nearly a power of the
//! number of points, so two tries tell the power, and a third one is within a few percent:
//!
//! ```text
//!  log error │ ∘ first: as foretold
//!            │   ⟍
//!  wanted ───┼─────∘───────  third, and kept: met by at most 3 % more points than needed
//!            │       ⟍
//!            │         ∘ second: of the usual power
//!            └──────────────── log points
//! ```
//!
//! Every try is a whole reduction, in the folder `NAME.isospan.work` beside the archive: levels of all places follow from the one number, so another
//! number moves points nearly everywhere: at each level it is another piece of the sequence. The last step is not made in a few cells alone either, while all
//! else is kept as [`target_max`](super::target_max) does: a sum of squares that is to become less by some percent is not the matter of a few cells. Equal gain for every point means that
//! cells near the next level lie all over the volume, and those that would have to be raised are in every chunk. What is published is a try that met the
//! target; its error, as measured, is in its manifest. The cap is a point a sample; where that does not do, the try at the cap is published and the
//! report says so. The largest error is a matter of a few places: [`target_max`](super::target_max) makes those denser.
//!
//! The numbers of points follow from measured errors, which depend on nothing but the input: the same archive for any threads.

use super::beside::Beside;
use super::fingerprint::Inputs;
use super::job::{Job, Part, ReduceReport, RunSettings, finished};
use super::open::StepSummary;
use super::plan::{Amount, Plan, ReduceSettings};
use super::plan_file::{old_archive, work_folder};
use super::reduce::{folder_bytes, is_finished, make};
use super::repair::{exists, lacks_files};
use super::target_max::reduce_to_max;
use crate::archive::manifest::{Manifest, Step};
use crate::archive::publish::{remove_folder, replace_folder};
use crate::error::{Error, Result};
use crate::formats::{self, Input};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

/// An error that is not to be exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// The root of the mean square of the errors at all samples.
    Rms(Bound),
    /// The largest absolute error at a sample, or at a vertex of a mesh.
    Max(Bound),
}

/// How large an error may be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bound {
    /// In units of the field.
    Value(f64),
    /// As a part of the range of the samples.
    OfRange(f64),
}

impl Bound {
    /// The bound in units of the field, whose samples have this range.
    pub fn in_units(self, range: [f32; 2]) -> f64 {
        match self {
            Self::Value(v) => v,
            Self::OfRange(part) => part * (f64::from(range[1]) - f64::from(range[0])),
        }
    }
}

impl Target {
    pub(super) fn bound(self) -> Bound {
        match self {
            Self::Rms(bound) | Self::Max(bound) => bound,
        }
    }

    /// # Errors
    /// [`Error::Usage`] for a bound that is no positive number, and for settings that cannot meet it.
    fn check(self, settings: &ReduceSettings) -> Result<()> {
        let (Bound::Value(bound) | Bound::OfRange(bound)) = self.bound();
        if !(bound > 0.0 && bound.is_finite()) {
            return Err(Error::usage(format!("an error of {bound} cannot be met: give a number above 0")));
        }
        if settings.adapt.is_none() || !settings.measure {
            return Err(Error::usage("a target needs points that adapt, and an error that is measured"));
        }
        Ok(())
    }
}

/// What came of looking for a target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TargetReport {
    /// What was wanted.
    pub target: Target,
    /// In units of the field.
    pub bound: f64,
    /// The error of the archive.
    pub error: f64,
    /// Whether that is within the bound.
    pub met: bool,
    /// Reductions that were made.
    pub tries: u32,
    /// Chunks that were meshed in all these together, and chunks that these had together: those in which nothing changed are taken over.
    pub meshed_chunks: [u64; 2],
    /// Cells that have a point a sample or more, and all cells.
    pub full_cells: [u64; 2],
}

/// Tries, at most.
const MOST_TRIES: u32 = 10;
/// What is aimed at, as a part of the bound; and what is good enough.
const AIM: f64 = 0.985;
const NEAR: f64 = 0.96;
/// A number of points that is this near to one that does not do is the least.
const LEAST_STEP: f64 = 1.03;

/// A number of points, and the error with it.
#[derive(Clone, Copy, Debug)]
struct Try {
    points: f64,
    error: f64,
}

/// The tries so far.
#[derive(Debug)]
struct Search {
    bound: f64,
    /// The number of points is not more than this.
    cap: f64,
    tries: Vec<Try>,
}

impl Search {
    /// The largest number that does not do, and the smallest that does.
    fn bracket(&self) -> [Option<Try>; 2] {
        let by_points = |a: &&Try, b: &&Try| a.points.total_cmp(&b.points);
        let does = self.tries.iter().filter(|t| t.error <= self.bound).min_by(by_points).copied();
        let below = |t: &&Try| t.error > self.bound && does.is_none_or(|d| t.points < d.points);
        [self.tries.iter().filter(below).max_by(by_points).copied(), does]
    }

    /// The next number of points; `None` when the best one is found.
    fn next(&self) -> Option<u64> {
        let [low, high] = self.bracket();
        if self.tries.len() as u32 >= MOST_TRIES
            && (high.is_some() || low.is_some_and(|l| l.points >= self.cap))
        {
            return None;
        }
        let points = match (low, high) {
            (_, Some(h)) if h.error >= NEAR * self.bound => return None,
            (Some(l), Some(h)) if h.points <= LEAST_STEP * l.points => return None,
            (Some(l), Some(h)) => {
                let least = libm::sqrt(LEAST_STEP);
                self.aimed(l).clamp(l.points * least, (h.points / least).max(l.points * least))
            }
            (Some(l), None) if l.points >= self.cap => return None,
            // After many tries all that is possible.
            (Some(l), None) if self.tries.len() as u32 + 1 >= MOST_TRIES => self.cap.max(l.points),
            (Some(l), None) => self.aimed(l).clamp(l.points * 1.05, l.points * 8.0),
            (None, Some(h)) if h.points <= 1.0 => return None,
            (None, Some(h)) => self.aimed(h).clamp(h.points / 8.0, h.points * 0.95),
            (None, None) => return None,
        };
        Some((points.min(self.cap).round() as u64).max(1))
    }

    /// The number of points at which the power law through a try has the error that is aimed at.
    fn aimed(&self, from: Try) -> f64 {
        let others = self.tries.iter().filter(|t| t.points != from.points && t.error > 0.0);
        let distance = |t: &&Try| libm::fabs(libm::log(t.points / from.points));
        let nearest = others.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let power = nearest.map_or(USUAL_POWER, |t| {
            let power = -libm::log(t.error / from.error) / libm::log(t.points / from.points);
            if power.is_finite() { power.clamp(0.1, 2.0) } else { USUAL_POWER }
        });
        if from.error <= 0.0 {
            return from.points / 8.0;
        }
        from.points * libm::pow(from.error / (AIM * self.bound), 1.0 / power)
    }
}

/// Errors are about this power of the number of points, negative.
const USUAL_POWER: f64 = 0.5;

/// Reduces to the archive `job.out` with the fewest points that meet the target of the settings.
///
/// # Errors
/// As those of a reduction; [`Error::Usage`] for a target that cannot be one.
pub(super) fn reduce_to_target(job: &Job<'_>, target: Target) -> Result<ReduceReport> {
    target.check(job.settings)?;
    if let Some(report) = made_before(job)? {
        return Ok(finished(report, job.started));
    }
    if let Target::Max(_) = target {
        return reduce_to_max(job, target);
    }
    let work = work_folder(job.out);
    let [trying, best] = ["try.isospan", "best.isospan"].map(|name| work.join(name));
    [&trying, &best].into_iter().try_for_each(|f| remove_folder(f))?;
    let mut search: Option<Search> = None;
    let mut found: Option<(ReduceReport, Try)> = None;
    let mut chunks = 0;
    let (mut settings, mut wanted) = (job.settings.clone(), None);
    loop {
        fs::create_dir_all(&work).map_err(|e| Error::io("create the folder", &work, e))?;
        let run = RunSettings { replace: false, ..job.run.clone() };
        let report = make(&Job { settings: &settings, out: &trying, run: &run, part: Part::Whole, ..*job })?;
        chunks += report.chunks;
        let bound = report.bound.or(search.as_ref().map(|s| s.bound)).expect("the first try tells it");
        let samples = report.samples as f64;
        let search = search.get_or_insert_with(|| Search { bound, cap: samples, tries: vec![] });
        // What was asked for, as what came of it is rounded: the cap is a number to be reached.
        let points = wanted.unwrap_or(report.inner_points) as f64;
        let made = Try { points, error: error_of(target, &report) };
        search.tries.push(made);
        let next = search.next();
        // The try at the cap is all that is possible.
        let better = found.as_ref().is_none_or(|(_, best)| made.points < best.points);
        if made.error <= bound && better || next.is_none() && found.is_none() {
            remove_folder(&best)?;
            rename(&trying, &best)?;
            found = Some((report, made));
        } else {
            remove_folder(&trying)?;
        }
        let Some(count) = next else { break };
        wanted = Some(count);
        settings = ReduceSettings { target: None, amount: Amount::Count(count), ..settings };
    }
    let ((mut report, made), search) = found.zip(search).expect("the last try is kept if no other was");
    let tries = search.tries.len() as u32;
    let full_cells = full_cells(&best)?;
    let met = made.error <= search.bound;
    let (bound, error, meshed_chunks) = (search.bound, made.error, [chunks; 2]);
    let told = TargetReport { target, bound, error, met, tries, meshed_chunks, full_cells };
    publish(job, &best, &work)?;
    report.target = Some(told);
    report.seconds.retain(|(name, _)| name != "total");
    Ok(finished(report, job.started))
}

/// The report of an archive that this very call has made before: with the same settings, of the same files.
///
/// # Errors
/// [`Error::Usage`] when there is another one.
fn made_before(job: &Job<'_>) -> Result<Option<ReduceReport>> {
    if job.run.replace || !is_finished(job.out) {
        return Ok(None);
    }
    let manifest = Manifest::read(job.out)?;
    let (mut inputs, mut is_same) = (Inputs::default(), manifest.target == Some(job.settings.hash()));
    is_same &= manifest.steps.len() == job.sources.len() && !lacks_files(job.out, &manifest);
    for (step, (number, source)) in manifest.steps.iter().zip(job.sources) {
        if !is_same {
            break;
        }
        let (files, field) = match formats::open_input(&source.path, &source.options)? {
            Input::Volume(volume) => (volume.info().files(), volume.info().field.name.clone()),
            Input::Mesh(mesh) => (mesh.info().files(), mesh.field()?.name.clone()),
        };
        let found = inputs.fingerprint(*number, &files, &job.run.cancel)?;
        let (plan, of_source) = (&step.plan, &step.plan.source);
        is_same &= (plan.number, plan.time) == (*number, source.time)
            && (&of_source.fingerprint, &of_source.field) == (&found, &field);
    }
    if !is_same {
        return Err(exists(job.out));
    }
    let (counts, first) = (manifest.counts, &manifest.steps[0]);
    let ranges = manifest.steps.iter().filter_map(Step::told_range);
    Ok(Some(ReduceReport {
        samples: first.plan.source.samples(),
        points: counts.points,
        void_points: manifest.steps.iter().map(|s| s.void_points).sum(),
        tetrahedra: counts.tetrahedra,
        chunks: counts.chunks,
        blocks: counts.blocks,
        grid_cells: first.coordinates.map(|c| c.cells),
        range: ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]),
        quantiser: first.plan.told_quantiser(),
        error: first.error.clone(),
        steps: manifest.steps.iter().map(StepSummary::of).collect(),
        archive_bytes: folder_bytes(job.out)?,
        made_before: true,
        ..ReduceReport::default()
    }))
}

/// The error of the worst step.
pub(super) fn error_of(target: Target, report: &ReduceReport) -> f64 {
    let which = usize::from(matches!(target, Target::Max(_)));
    report.steps.iter().filter_map(|s| s.error).map(|e| e[which]).fold(0.0, f64::max)
}

/// Cells of an archive that have a point a sample or more, and all cells.
pub(super) fn full_cells(archive: &Path) -> Result<[u64; 2]> {
    let manifest = Manifest::read(archive)?;
    let (plan, beside) = (&manifest.plan, Beside::read(archive, &manifest.plan)?);
    let levels = beside.levels.expect("its points adapt");
    let densities = Plan::densities(plan, &levels);
    let full = levels.as_slice().iter().filter(|&&l| densities[usize::from(l)] >= FULL).count();
    Ok([full as u64, levels.as_slice().len() as u64])
}

/// Points a voxel of which one says that there is one for each: numbers of points are rounded.
const FULL: f64 = 0.9;

/// Puts a try in the place of the archive. One that is there is whole until then.
pub(super) fn publish(job: &Job<'_>, best: &Path, work: &Path) -> Result<()> {
    let mut manifest = Manifest::read(best)?;
    manifest.target = Some(job.settings.hash());
    manifest.write(best)?;
    replace_folder(best, job.out, &old_archive(job.out))?;
    // There may be a plan, or logs, of somebody else.
    let _ = fs::remove_dir(work);
    Ok(())
}

pub(super) fn rename(from: &Path, to: &Path) -> Result<()> {
    fs::rename(from, to).map_err(|e| Error::io("rename", from, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many tries a field takes, and the number of points that is kept; the second is the least one.
    fn look(bound: f64, cap: f64, first: f64, error: impl Fn(f64) -> f64) -> (usize, Option<f64>) {
        let mut search = Search { bound, cap, tries: vec![Try { points: first, error: error(first) }] };
        while let Some(n) = search.next() {
            search.tries.push(Try { points: n as f64, error: error(n as f64) });
        }
        (search.tries.len(), search.bracket()[1].map(|t| t.points))
    }

    #[test]
    fn power_laws_are_met_by_the_third_try() {
        for power in [0.25, 0.5, 1.0, 1.4] {
            for first in [30.0, 1e4, 3e5] {
                let (tries, points) = look(0.01, 1e9, first, |n| n.powf(-power));
                let least = 0.01f64.powf(-1.0 / power);
                if least < 1e9 {
                    let points = points.unwrap();
                    assert!(
                        points >= least * 0.999 && points <= least * 1.2,
                        "{power} {first}: {points} {least}"
                    );
                    assert!(tries <= 9, "{power} {first}: {tries} tries");
                }
            }
        }
    }

    #[test]
    fn uneven_errors_end_as_well() {
        // Steps: there is no number of points near the bound.
        let (tries, points) = look(1.0, 1e6, 100.0, |n| if n < 5000.0 { 7.0 } else { 0.2 });
        assert!(tries <= 10 && points.is_some_and(|n| (5000.0..20_000.0).contains(&n)), "{tries} {points:?}");
        // Up and down.
        let (tries, points) = look(1.0, 1e6, 100.0, |n| (2e3 / n) * (1.0 + 0.3 * (n / 50.0).sin()));
        assert!(tries <= 10 && points.is_some_and(|n| n < 4000.0), "{tries} {points:?}");
    }

    #[test]
    fn what_cannot_be_met_ends_at_the_cap() {
        let (tries, points) = look(0.1, 5e4, 100.0, |_| 3.0);
        assert!(tries <= 10 && points.is_none(), "{tries} {points:?}");
        // And what is exact, with nearly no point.
        let (tries, points) = look(0.1, 5e4, 1e4, |_| 0.0);
        assert!(tries <= 10 && points.is_some_and(|n| n < 10.0), "{tries} {points:?}");
    }
}
