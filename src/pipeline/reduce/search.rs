//! The search for the number of points that has a wanted error or size: which try comes next.
//!
//! ```text
//!  settings ─▶ next_settings ─▶ a reduction ─▶ its report ─▶ note ─▶ next_settings ─▶ … until it is over
//! ```
//!
//! It knows nothing of how a try is made: one process makes all ([`super::target`]), or shards do,
//! with a plan for each ([`super::plan_file`]), which stores the search between two tries.

use super::report::{ReduceReport, TargetReport};
use super::share::Share;
use crate::pipeline::plan::{Estimate, SearchEstimate};
use crate::pipeline::settings::{Amount, CompleteSettings, Target};
use isospan_io::error::{Error, Result};
use isospan_mesh::points::SetKind;
use serde::{Deserialize, Serialize};

impl Target {
    /// The bound, in units of the field or in bytes: any try tells the range of the samples.
    pub(super) fn limit(self, report: &ReduceReport, source: Option<u64>) -> Result<f64> {
        match self {
            Self::Rms(bound) | Self::Max(bound) => {
                Ok(bound.in_units(source_range(report).unwrap_or_default()))
            }
            Self::Surface(target) => target.distance.in_world(None, None),
            Self::Lossless | Self::Labels => Ok(0.0),
            Self::Size(_) | Self::Ratio(_) => self.bytes(source),
        }
    }

    /// The bytes that an archive may have.
    pub(super) fn bytes(self, source: Option<u64>) -> Result<f64> {
        match (self, source) {
            (Self::Size(bytes), _) => Ok(bytes as f64),
            (Self::Ratio(ratio), Some(source)) => Ok(source as f64 / ratio),
            (Self::Ratio(_), None) => Err(Error::usage("the bytes of the source are not known: give a size")),
            _ => Ok(f64::INFINITY),
        }
    }

    /// What an archive came to that was made before, in no try of this run.
    pub(super) fn report_of(
        self,
        report: &ReduceReport,
        source: Option<u64>,
        full_cells: Option<[u64; 2]>,
    ) -> Result<TargetReport> {
        let bound = self.limit(report, source)?;
        let is_of_bytes = self.is_of_bytes();
        let reached = if is_of_bytes { report.archive_bytes as f64 } else { self.reached(report) };
        let met = reached <= bound;
        Ok(TargetReport {
            target: self,
            bound,
            reached,
            met,
            tries: 0,
            of_ranges: self.bound().is_some() && report.of_fields,
            meshed_chunks: [0; 2],
            full_cells,
        })
    }

    /// The error or the size that an archive has; with several steps, that of the worst one.
    fn reached(self, report: &ReduceReport) -> f64 {
        match self {
            Self::Rms(_) | Self::Max(_) | Self::Lossless | Self::Labels => error_of(self, report),
            Self::Surface(_) => {
                report.surfaces.iter().map(|found| found.distance()).fold(0.0, f64::max).min(NO_SURFACE)
            }
            Self::Size(_) | Self::Ratio(_) => (report.archive_bytes + RECORD) as f64,
        }
    }
}

impl ReduceReport {
    /// The report with what its steps have of an error or a distance that is wanted, which was no
    /// target of the run: of further steps, whose precision is that of the archive. A target of
    /// another kind, and one that was not measured, is left out.
    pub(super) fn judged_by(self, target: Target) -> Result<Self> {
        let is_measured = match target {
            Target::Surface(_) => !self.surfaces.is_empty(),
            _ => target.bound().is_some() && self.steps.iter().any(|step| step.error.is_some()),
        };
        let judged = is_measured.then(|| target.report_of(&self, None, None)).transpose()?;
        Ok(Self { target: judged.or(self.target), ..self })
    }
}

/// An archive has hardly ever fewer bytes.
const LEAST_BYTES: u64 = 512;
/// Bytes of the manifest that state the target, at most.
const RECORD: u64 = 64;

/// The range of the samples of all steps. Errors of several fields are parts of the range of each.
fn source_range(report: &ReduceReport) -> Option<[f64; 2]> {
    if report.of_fields { Some([0.0, 1.0]) } else { report.source_range }
}

/// Tries, at most.
const MOST_TRIES: u32 = 10;
/// The aim of a try, as a part of the bound; and the part that is good enough.
const AIM: f64 = 0.985;
const NEAR: f64 = 0.96;
/// The distance where the samples have a surface and the archive has none, or the other way round.
/// JSON, in which a search waits, has no infinite number.
pub const NO_SURFACE: f64 = 1e300;
/// Tries of most searches.
const USUAL_TRIES: u32 = 5;
/// The same of a surface.
const USUAL_TRIES_OF_SURFACES: u32 = 3;
/// A number of points that is this close to one that does not suffice is the least.
const LEAST_STEP: f64 = 1.03;

/// A try: the number of points, or of samples a point where a size is wanted, and the error or the
/// size with it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Try {
    amount: f64,
    reached: f64,
}

/// The tries so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Search {
    bound: f64,
    /// The amount is not less than the first of these, and not more than the second.
    limits: [f64; 2],
    /// The part of the bound that is good enough.
    near: f64,
    /// The bounded quantity is about the amount to the negative of this power.
    usual: f64,
    tries: Vec<Try>,
}

impl Search {
    /// The largest number that does not do, and the smallest that does.
    fn bracket(&self) -> [Option<Try>; 2] {
        let by_amount = |a: &&Try, b: &&Try| a.amount.total_cmp(&b.amount);
        let does = self.tries.iter().filter(|t| t.reached <= self.bound).min_by(by_amount).copied();
        let below = |t: &&Try| t.reached > self.bound && does.is_none_or(|d| t.amount < d.amount);
        [self.tries.iter().filter(below).max_by(by_amount).copied(), does]
    }

    /// The next amount; `None` when the best one is found.
    fn next(&self) -> Option<f64> {
        let [least, cap] = self.limits;
        let [low, high] = self.bracket();
        if self.tries.len() as u32 >= MOST_TRIES && (high.is_some() || low.is_some_and(|l| l.amount >= cap)) {
            return None;
        }
        let amount = match (low, high) {
            (_, Some(h)) if h.reached >= self.near * self.bound => return None,
            (Some(l), Some(h)) if h.amount <= LEAST_STEP * l.amount => return None,
            (Some(l), Some(h)) => {
                let step = libm::sqrt(LEAST_STEP);
                self.aimed(l).clamp(l.amount * step, (h.amount / step).max(l.amount * step))
            }
            (Some(l), None) if l.amount >= cap => return None,
            // After many tries all that is possible.
            (Some(l), None) if self.tries.len() as u32 + 1 >= MOST_TRIES => cap.max(l.amount),
            (Some(l), None) => self.aimed(l).clamp(l.amount * 1.05, l.amount * 8.0),
            (None, Some(h)) if h.amount <= least => return None,
            (None, Some(h)) => self.aimed(h).clamp(h.amount / 8.0, h.amount * 0.95),
            (None, None) => return None,
        };
        Some(amount.clamp(least, cap))
    }

    /// The amount at which the power law through a try has what is aimed at.
    fn aimed(&self, from: Try) -> f64 {
        let others = self.tries.iter().filter(|t| t.amount != from.amount && t.reached > 0.0);
        let distance = |t: &&Try| libm::fabs(libm::log(t.amount / from.amount));
        let nearest = others.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let power = nearest.map_or(self.usual, |t| {
            let power = -libm::log(t.reached / from.reached) / libm::log(t.amount / from.amount);
            if power.is_finite() { power.clamp(0.1, 2.0) } else { self.usual }
        });
        if from.reached <= 0.0 {
            return from.amount / 8.0;
        }
        from.amount * libm::pow(from.reached / (AIM * self.bound), 1.0 / power)
    }
}

/// The powers between errors and numbers of points, and between sizes and samples a point: archives
/// have a manifest besides.
const USUAL_POWERS: [f64; 2] = [0.5, 0.9];

/// The same of a pyramid: the powers between errors and finer steps, and sizes and coarser ones.
const USUAL_POWERS_OF_STEPS: [f64; 2] = [0.8, 0.9];
/// How many times coarser or finer the steps of a pyramid are than at first, at most.
const LIMITS_OF_FACTORS: [f64; 2] = [1e-5, 1e5];
/// A pyramid is made again only for more than this; and after so many tries only if none meets the
/// bound: the error of a small volume leaps as its coefficients become coarser.
const NEAR_OF_PYRAMIDS: f64 = 0.93;
const ENOUGH_TRIES: u32 = 4;

/// Points a sample where a size is wanted, at most.
const MOST_A_SAMPLE: f64 = 4.0;

/// Whether a search is one for a pyramid.
fn is_pyramid(settings: &CompleteSettings) -> bool {
    settings.points == SetKind::Pyramid
}

/// The best try so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct BestTry {
    number: u32,
    made: Try,
    bytes: u64,
    settings: CompleteSettings,
}

/// A search between two tries: all that the next try follows from. One process makes all tries, or
/// shards do, with a plan for each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::pipeline) struct TargetSearch {
    target: Target,
    /// Bytes of the source, if known.
    source: Option<u64>,
    /// The settings that ask for the target.
    settings: CompleteSettings,
    search: Option<Search>,
    /// Points of the next try; of the first they follow from the settings.
    count: Option<u64>,
    /// Tries that were made.
    tries: u32,
    /// Chunks of all these together.
    chunks: u64,
    best: Option<BestTry>,
    /// Of a pyramid: how many times coarser its coefficients are in the next try.
    #[serde(default)]
    factor: Option<f64>,
    /// Whether each step has several fields.
    #[serde(default)]
    of_fields: bool,
    /// Of a surface: how large an error of a sample the factor stands for.
    #[serde(default)]
    share: Share,
}

impl TargetSearch {
    /// A search that begins. `source` is the number of bytes of the source, if known.
    ///
    /// # Errors
    /// [`Error::Usage`] for a target that cannot be one.
    pub(in crate::pipeline) fn new(
        settings: &CompleteSettings,
        target: Target,
        source: Option<u64>,
    ) -> Result<Self> {
        target.check(settings)?;
        Ok(Self {
            target,
            source,
            settings: settings.clone(),
            search: None,
            count: None,
            tries: 0,
            chunks: 0,
            best: None,
            factor: is_pyramid(settings).then_some(1.0),
            of_fields: false,
            share: Share::default(),
        })
    }

    /// The number of the next try: the first is 1.
    pub(in crate::pipeline) fn next_try(&self) -> u32 {
        self.tries + 1
    }

    /// About how many tries there will be.
    pub(in crate::pipeline) fn about(&self) -> u32 {
        let usual = match self.target {
            Target::Surface(_) => USUAL_TRIES_OF_SURFACES,
            _ if is_pyramid(&self.settings) => 1,
            _ => USUAL_TRIES,
        };
        self.next_try().max(usual)
    }

    /// What is known before the first try, which has this estimate; the source has so many samples,
    /// or vertices.
    pub(super) fn estimate(&self, first: &Estimate, samples: u64) -> Result<SearchEstimate> {
        let (target, tries) = (self.target, self.about());
        let archive_bytes = match target {
            Target::Size(_) | Target::Ratio(_) => [LEAST_BYTES, target.bytes(self.source)? as u64],
            // About the bytes of the source.
            Target::Surface(_) => [LEAST_BYTES, self.source.unwrap_or(4 * samples)],
            Target::Rms(_) | Target::Max(_) | Target::Lossless | Target::Labels => {
                let points = samples as f64 / first.points.max(1) as f64;
                [LEAST_BYTES, (first.archive_bytes as f64 * points.max(1.0)) as u64]
            }
        };
        let archive_bytes = [archive_bytes[0].min(archive_bytes[1]), archive_bytes[1]];
        Ok(SearchEstimate { target, tries, archive_bytes, seconds: first.seconds * f64::from(tries) })
    }

    /// The number of the try that a plan is of: the next one, or the best when the search is over.
    pub(in crate::pipeline) fn this_try(&self) -> u32 {
        self.best_try().filter(|_| self.is_over()).unwrap_or_else(|| self.next_try())
    }

    /// The number of the best try so far.
    pub(in crate::pipeline) fn best_try(&self) -> Option<u32> {
        self.best.as_ref().map(|best| best.number)
    }

    /// The settings of the best try so far.
    pub(in crate::pipeline) fn best_settings(&self) -> Option<&CompleteSettings> {
        self.best.as_ref().map(|best| &best.settings)
    }

    /// Whether the best try is what was searched for.
    pub(in crate::pipeline) fn is_over(&self) -> bool {
        self.best.is_some() && self.count.is_none() && self.factor.is_none()
    }

    /// Whether it began with the same question.
    pub(in crate::pipeline) fn asks_as(&self, other: &Self) -> bool {
        (self.target, self.source, &self.settings) == (other.target, other.source, &other.settings)
    }

    /// The settings of the next try.
    pub(in crate::pipeline) fn next_settings(&self) -> CompleteSettings {
        if let Target::Surface(_) = self.target {
            let target = Some(self.share.target(self.factor.unwrap_or(1.0)));
            return CompleteSettings { target, ..self.settings.clone() };
        }
        if is_pyramid(&self.settings) {
            return CompleteSettings { step_factor: self.factor.unwrap_or(1.0), ..self.settings.clone() };
        }
        // For adapted points, the number of points that an error asks for is predicted.
        let adapts = self.settings.adapt.is_some();
        let predicted = self.settings.target.filter(|t| adapts && t.bound().is_some());
        let settings = self.settings.clone();
        match self.count {
            None => CompleteSettings { target: predicted, ..settings },
            Some(count) => CompleteSettings { target: None, amount: Amount::Count(count), ..settings },
        }
    }

    /// Notes the result of a try, and returns it. The try may be the best one now, and the last.
    ///
    /// # Errors
    /// [`Error::Usage`] where the bytes of the source must be known.
    pub(in crate::pipeline) fn note(&mut self, report: &ReduceReport) -> Result<TargetReport> {
        let bound = match &self.search {
            Some(search) => search.bound,
            None => self.target.limit(report, self.source)?,
        };
        self.of_fields = report.of_fields;
        let (settings, number) = (self.next_settings(), self.tries + 1);
        self.share = Share { of_whole: report.whole_range, least: report.least_share };
        self.tries = number;
        self.chunks += report.chunks;
        let made = match is_pyramid(&self.settings) {
            true => self.note_factor(bound, report, settings),
            false => self.note_points(bound, report, settings),
        };
        Ok(self.report(made, bound, None))
    }

    /// Notes a try with a number of points.
    fn note_points(&mut self, bound: f64, report: &ReduceReport, settings: CompleteSettings) -> Try {
        let (target, samples) = (self.target, report.samples as f64);
        let is_size = target.is_of_bytes();
        let limits = if is_size { [1.0 / MOST_A_SAMPLE, samples] } else { [1.0, samples] };
        let usual = USUAL_POWERS[usize::from(is_size)];
        let search =
            self.search.get_or_insert_with(|| Search { bound, limits, near: NEAR, usual, tries: vec![] });
        // This is the number that was asked for, because the resulting number is rounded: the limit
        // must be reached.
        let points = self.count.unwrap_or(report.inner_points).max(1) as f64;
        let amount = if is_size { samples / points } else { points };
        let made = Try { amount, reached: target.reached(report) };
        search.tries.push(made);
        let next = search.next();
        let (meets, bytes) = (made.reached <= bound, report.archive_bytes);
        // The try at the cap is all that is possible.
        let is_best = match &self.best {
            Some(best) if is_size => meets && made.amount < best.made.amount,
            Some(best) => meets && bytes < best.bytes,
            None => meets || next.is_none(),
        };
        if is_best {
            self.best = Some(BestTry { number: self.tries, made, bytes, settings });
        }
        self.count = next
            .map(|amount| if is_size { samples / amount } else { amount })
            .map(|count| count.round().max(1.0) as u64);
        made
    }

    /// Notes a try of a pyramid. Corrections meet a bound of each sample in the first one.
    fn note_factor(&mut self, bound: f64, report: &ReduceReport, settings: CompleteSettings) -> Try {
        let is_size = self.target.is_of_bytes();
        let factor = self.factor.unwrap_or(1.0);
        let amount = if is_size { factor } else { 1.0 / factor };
        let (usual, limits) = match self.target {
            // Where a field is nearly linear, a surface moves as far as its values do.
            Target::Surface(_) => (1.0, self.share.limits()),
            _ => (USUAL_POWERS_OF_STEPS[usize::from(is_size)], LIMITS_OF_FACTORS),
        };
        let near = NEAR_OF_PYRAMIDS;
        let search = self.search.get_or_insert_with(|| Search { bound, limits, near, usual, tries: vec![] });
        let made = Try { amount, reached: self.target.reached(report) };
        search.tries.push(made);
        let meets = made.reached <= bound;
        let next = match self.target {
            target if target.is_of_each_sample() => None,
            _ if search.tries.len() as u32 >= MOST_TRIES => None,
            _ if self.tries >= ENOUGH_TRIES && (meets || self.best.is_some()) => None,
            // A constant has no error, however coarse it is.
            _ if made.reached == 0.0 => None,
            _ => search.next(),
        };
        let is_best = match &self.best {
            Some(best) => meets && made.amount < best.made.amount,
            None => meets || next.is_none(),
        };
        if is_best {
            let (bytes, number) = (report.archive_bytes, self.tries);
            self.best = Some(BestTry { number, made, bytes, settings });
        }
        self.factor = next.map(|amount| if is_size { amount } else { 1.0 / amount });
        made
    }

    /// What one of the tries came to.
    fn report(&self, made: Try, bound: f64, full_cells: Option<[u64; 2]>) -> TargetReport {
        TargetReport {
            target: self.target,
            bound,
            reached: made.reached,
            met: made.reached <= bound,
            tries: self.tries,
            of_ranges: self.target.bound().is_some() && self.of_fields,
            meshed_chunks: [self.chunks; 2],
            full_cells,
        }
    }

    /// What the best try came to. `full_cells` are those of adapted points.
    pub(super) fn best_report(&self, full_cells: Option<[u64; 2]>) -> TargetReport {
        let (Some(BestTry { made, .. }), Some(search)) = (&self.best, &self.search) else {
            unreachable!("the last try is the best if no other is")
        };
        self.report(*made, search.bound, full_cells)
    }

    /// Whether its points adapt.
    pub(super) fn adapts(&self) -> bool {
        self.settings.adapt.is_some()
    }

    /// The settings that ask for the target.
    pub(in crate::pipeline) fn settings(&self) -> &CompleteSettings {
        &self.settings
    }
}

/// The error of the worst step; of several fields as a part of the range of each.
pub(super) fn error_of(target: Target, report: &ReduceReport) -> f64 {
    let which = usize::from(target.is_of_each_sample());
    if report.of_fields {
        return report.shares.iter().map(|shares| shares[which]).fold(0.0, f64::max);
    }
    report.steps.iter().filter_map(|s| s.error).map(|e| e[which]).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many tries a field takes, and the number of points that is kept; the second is the least
    /// one.
    fn look(bound: f64, cap: f64, first: f64, error: impl Fn(f64) -> f64) -> (usize, Option<f64>) {
        let tries = vec![Try { amount: first, reached: error(first) }];
        let usual = USUAL_POWERS[0];
        let mut search = Search { bound, limits: [1.0, cap], near: NEAR, usual, tries };
        while let Some(n) = search.next() {
            search.tries.push(Try { amount: n.round(), reached: error(n.round()) });
        }
        (search.tries.len(), search.bracket()[1].map(|t| t.amount))
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
