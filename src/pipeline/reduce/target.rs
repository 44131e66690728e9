//! A wanted error or size instead of a number of points: the fewest points that meet an error, the
//! most that fit a size.
//!
//! Every try is a whole reduction. For adapted points, the pass that finds where points are needed
//! ([`crate::density`]) also predicts the error, to about a third. So the first try has as many
//! points as that asks for. Its error is measured at every sample, and the next number follows from
//! it. Errors are nearly a power of the number of points. So two tries give the power, and a third
//! one is within a few percent:
//!
//! ```text
//!  log error │ ∘ first: as predicted
//!            │   ⟍
//!  wanted ───┼─────∘───────  third, and kept: met by at most 3 % more points than needed
//!            │       ⟍
//!            │         ∘ second: of the usual power
//!            └──────────────── log points
//! ```
//!
//! Other points begin with 1/8 of the samples. A size is searched for in the same way: bytes are a
//! power of the number of points per sample.
//!
//! A lattice's values are rounded to a step of [`STEP`] times the RMS error, unless the settings
//! give the number of bits. So rounding costs a tenth of the error or less, and saves three bits
//! per value and more.
//!
//! Tries lie in the folder `NAME.isospan.work` next to the archive. The levels of all places follow
//! from one number, so another number moves points nearly everywhere: each level takes another
//! piece of the sequence. The last step cannot be confined to a few cells either, as
//! [`target_max`](super::target_max) does: to lower a sum of squares by some percent is not a
//! matter of a few cells. Equal gain for every point means that cells near the next level lie all
//! over the volume, in every chunk. The published archive is a try that met the target, with its
//! measured error in the manifest. The limit is a point per sample. If that is not enough, the try
//! at the limit is published and the report says so. The largest error is a matter of a few places:
//! [`target_max`](super::target_max) makes those denser.
//!
//! The numbers of points follow from measured errors, which depend on nothing but the input. So the
//! archive is the same for any number of threads.

use super::existing::{Existing, exists, lacks_files};
use super::job::Job;
use super::plan_file::work_folder;
use super::planned::make;
use super::report::{ReduceReport, TargetReport};
use super::target_max::reduce_to_max;
use super::tries::{error_of, full_cells, publish, rename};
use crate::archive::manifest::Manifest;
use crate::bytes::publish::remove_folder;
use crate::error::{Error, Result};
use crate::formats::Input;
use crate::pipeline::plan::{Inputs, folder_bytes};
use crate::pipeline::settings::{Amount, Bound, ReduceSettings, RunSettings, Target, ValueBits};
use crate::points::SetKind;
use std::fs;

impl Target {
    /// The bound, in units of the field or in bytes, known from the first try.
    fn limit(self, report: &ReduceReport, source: Option<u64>) -> Result<f64> {
        match self {
            Self::Rms(bound) | Self::Max(bound) => {
                let range = source_range(report).map(|r| r.map(|v| v as f32)).unwrap_or_default();
                Ok(report.bound.unwrap_or_else(|| bound.in_units(range)))
            }
            Self::Size(bytes) => Ok(bytes as f64),
            Self::Ratio(ratio) => match source {
                Some(source) => Ok(source as f64 / ratio),
                None => Err(Error::usage("the bytes of the source are not known: give a size")),
            },
        }
    }

    /// The error or the size that an archive has; with several steps, that of the worst one.
    fn reached(self, report: &ReduceReport) -> f64 {
        match self {
            Self::Rms(_) | Self::Max(_) => error_of(self, report),
            Self::Size(_) | Self::Ratio(_) => (report.archive_bytes + RECORD) as f64,
        }
    }
}

/// Bytes of the manifest that state the target, at most.
const RECORD: u64 = 64;

/// The range of the samples, of all steps as far as it is known.
fn source_range(report: &ReduceReport) -> Option<[f64; 2]> {
    let of_steps = report.steps.iter().filter_map(|s| s.range);
    let of_first = report.error.as_ref().and_then(|e| e.source_range);
    of_first.into_iter().chain(of_steps).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

/// Tries, at most.
const MOST_TRIES: u32 = 10;
/// The aim of a try, as a part of the bound; and the part that is good enough.
const AIM: f64 = 0.985;
const NEAR: f64 = 0.96;
/// A number of points that is this close to one that does not suffice is the least.
const LEAST_STEP: f64 = 1.03;

/// A try: the number of points, or of samples a point where a size is wanted, and the error or the
/// size with it.
#[derive(Clone, Copy, Debug)]
struct Try {
    amount: f64,
    reached: f64,
}

/// The tries so far.
#[derive(Debug)]
struct Search {
    bound: f64,
    /// The amount is not less than the first of these, and not more than the second.
    limits: [f64; 2],
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
            (_, Some(h)) if h.reached >= NEAR * self.bound => return None,
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

/// A lattice's values are rounded to a step of this many times the RMS error.
const STEP: f64 = 1.4;
/// They have this many bits while nothing is known about the error, and bits in this range
/// otherwise.
const USUAL_BITS: u8 = 6;
const BITS: [f64; 2] = [4.0, 16.0];
/// Points a sample where a size is wanted, at most.
const MOST_A_SAMPLE: f64 = 4.0;

/// The bits of values of the tries.
struct Rounding {
    /// Whether they are chosen here.
    is_chosen: bool,
    bits: ValueBits,
    /// Tries whose results have been used to choose the bits.
    learned: u32,
}

impl Rounding {
    fn new(settings: &ReduceSettings, target: Target) -> Self {
        let is_chosen = settings.points == Some(SetKind::Bcc) && settings.value_bits == ValueBits::Usual;
        let mut rounding = Self { is_chosen, bits: settings.value_bits, learned: 0 };
        if is_chosen {
            rounding.bits = ValueBits::Bits(USUAL_BITS);
            if let Some(Bound::OfRange(part)) = target.bound() {
                rounding.choose(target, part);
            }
        }
        rounding
    }

    /// For an error of this part of the range.
    fn choose(&mut self, target: Target, part: f64) {
        // The largest error is several times the RMS error.
        let part = if let Target::Max(_) = target { part / 8.0 } else { part };
        if part > 0.0 && part.is_finite() {
            let bits = (-libm::log2(STEP * part)).round().clamp(BITS[0], BITS[1]);
            self.bits = ValueBits::Bits(bits as u8);
        }
    }

    /// Chooses the bits by the results of the first and the second try. Returns whether they have
    /// changed: then earlier tries cannot be compared with later ones.
    fn learn(&mut self, target: Target, bound: f64, report: &ReduceReport) -> bool {
        let before = self.bits;
        let range = source_range(report).filter(|_| self.is_chosen && self.learned < 2);
        if let Some([lo, hi]) = range {
            self.learned += 1;
            let error = match target.bound() {
                Some(_) => bound,
                None => error_of(Target::Rms(Bound::Value(bound)), report),
            };
            self.choose(target, error / (hi - lo));
        }
        self.bits != before
    }
}

/// Reduces to the archive `job.out` with the fewest points that meet the target of the settings, or
/// the most that do. `source` is the number of bytes of the source, if known.
///
/// # Errors
/// As those of a reduction; [`Error::Usage`] for a target that cannot be one.
pub(super) fn reduce_to_target(
    job: &Job<'_>,
    existing: &Existing,
    target: Target,
    source: Option<u64>,
) -> Result<ReduceReport> {
    target.check(job.settings)?;
    if let Existing::Finished(manifest) = existing
        && !job.run.replace
    {
        return made_before(job, manifest);
    }
    let adapts = job.settings.adapt.is_some();
    if let (Target::Max(_), true) = (target, adapts) {
        return reduce_to_max(job, target);
    }
    let work = work_folder(job.out);
    let [trying, best] = ["try.isospan", "best.isospan"].map(|name| work.join(name));
    [&trying, &best].into_iter().try_for_each(|f| remove_folder(f))?;
    let mut search: Option<Search> = None;
    let mut found: Option<(ReduceReport, Try)> = None;
    let (mut chunks, mut tries, mut wanted) = (0, 0, None);
    let mut seconds = vec![];
    let mut rounding = Rounding::new(job.settings, target);
    // For adapted points, the number of points that an error asks for is predicted.
    let predicted = job.settings.target.filter(|t| adapts && t.bound().is_some());
    let mut settings =
        ReduceSettings { target: predicted, value_bits: rounding.bits, ..job.settings.clone() };
    loop {
        fs::create_dir_all(&work).map_err(|e| Error::io("create the folder", &work, e))?;
        let run = RunSettings { replace: false, ..job.run.clone() };
        let job = Job { settings: &settings, out: &trying, run: &run, ..*job };
        let report = make(&job, &Existing::Nothing)?;
        chunks += report.chunks;
        seconds.extend_from_slice(&report.seconds);
        let bound = match &search {
            Some(search) => search.bound,
            None => target.limit(&report, source)?,
        };
        let samples = report.samples as f64;
        let is_size = target.bound().is_none();
        let limits = if is_size { [1.0 / MOST_A_SAMPLE, samples] } else { [1.0, samples] };
        let usual = USUAL_POWERS[usize::from(is_size)];
        let search = search.get_or_insert_with(|| Search { bound, limits, usual, tries: vec![] });
        // This is the number that was asked for, because the resulting number is rounded: the limit
        // must be reached.
        let points = wanted.unwrap_or(report.inner_points).max(1) as f64;
        let amount = if is_size { samples / points } else { points };
        let made = Try { amount, reached: target.reached(&report) };
        search.tries.push(made);
        tries += 1;
        let mut next = search.next();
        let changes = rounding.learn(target, bound, &report);
        if changes {
            next = next.or(Some(amount));
            search.tries.clear();
            found = None;
        }
        // The try at the cap is all that is possible.
        let better = found.as_ref().is_none_or(|(_, best)| made.amount < best.amount);
        if !changes && (made.reached <= bound && better || next.is_none() && found.is_none()) {
            remove_folder(&best)?;
            rename(&trying, &best)?;
            found = Some((report, made));
        } else {
            remove_folder(&trying)?;
        }
        let Some(amount) = next else { break };
        let count = (if is_size { samples / amount } else { amount }).round().max(1.0) as u64;
        wanted = Some(count);
        let amount = Amount::Count(count);
        settings = ReduceSettings { target: None, amount, value_bits: rounding.bits, ..settings };
    }
    let ((mut report, made), search) = found.zip(search).expect("the last try is kept if no other was");
    let full_cells = if adapts { Some(full_cells(&best)?) } else { None };
    let met = made.reached <= search.bound;
    let (bound, meshed_chunks) = (search.bound, [chunks; 2]);
    publish(job, &best)?;
    report.archive_bytes = folder_bytes(job.out)?;
    report.seconds = seconds;
    let reached = if target.bound().is_some() { made.reached } else { report.archive_bytes as f64 };
    report.target = Some(TargetReport { target, bound, reached, met, tries, meshed_chunks, full_cells });
    Ok(report)
}

/// The report of an archive that this very call has made before: with the same settings, of the
/// same files.
///
/// # Errors
/// [`Error::Usage`] when it is another one.
fn made_before(job: &Job<'_>, manifest: &Manifest) -> Result<ReduceReport> {
    let (mut inputs, mut is_same) = (Inputs::default(), manifest.target == Some(job.settings.hash()));
    is_same &= manifest.steps.len() == job.sources.len() && !lacks_files(job.out, manifest);
    for (step, (number, source)) in manifest.steps.iter().zip(job.sources) {
        if !is_same {
            break;
        }
        let (files, field) = match source.open()? {
            Input::Volume(volume) => (volume.info().files(), volume.info().field.name.clone()),
            Input::Mesh(mesh) => (mesh.info().files(), mesh.field()?.name.clone()),
        };
        let found = inputs.of_source(*number, source, &files, &job.run.resources.cancel)?;
        let (plan, of_source) = (&step.plan, &step.plan.source);
        is_same &= (plan.number, plan.time) == (*number, source.time)
            && (&of_source.fingerprint, &of_source.field) == (&found, &field);
    }
    if !is_same {
        return Err(exists(job.out));
    }
    let samples = manifest.steps[0].plan.source.samples();
    ReduceReport { samples, made_before: true, ..ReduceReport::default() }.of_archive(job.out, manifest, 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many tries a field takes, and the number of points that is kept; the second is the least
    /// one.
    fn look(bound: f64, cap: f64, first: f64, error: impl Fn(f64) -> f64) -> (usize, Option<f64>) {
        let tries = vec![Try { amount: first, reached: error(first) }];
        let usual = USUAL_POWERS[0];
        let mut search = Search { bound, limits: [1.0, cap], usual, tries };
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
